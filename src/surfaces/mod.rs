//! Extracts the surfaces of a mesh, as `atomesh surface` does.
//!
//! Faces on features come from the mesh, or from the features of an image. [`model::surface`](crate::model::surface)
//! groups and measures them, [`export::surfaces`](crate::export::surfaces) and
//! [`surface_file`](crate::surface_file) have the formats.
//!
//! - `surface_spec`: all options, as one value
//! - `extract`: from a mesh and options to surfaces
//! - `outcome`: the surfaces with their measures, as table, JSON and file
//! - `table`: tables of the measures

pub(crate) mod extract;
pub(crate) mod outcome;
mod surface_spec;
mod table;

pub use extract::surfaces;
pub use outcome::{InterfaceMeasure, SurfaceOutcome, SurfaceReport};
pub use surface_spec::{GroupBy, SurfaceSpec};

//! Writes and reads labelled surfaces.
//!
//! - `file`: the choice of the format
//! - `extract`: extracts the surfaces of a mesh
//! - `outcome`: the extracted surfaces with their measures, as table, JSON and file
//! - `table`: tables of the measures of surfaces
//! - `vtp`: VTK poly data
//! - `heights`: a surface as a grid of heights
//! - `tsurf`: GOCAD surfaces and lines
//! - `sticks`: fault sticks
//!
//! Wavefront OBJ is in [`meshers`](super::meshers).

pub(crate) mod extract;
pub(crate) mod file;
pub mod heights;
pub(crate) mod outcome;
pub mod sticks;
mod table;
pub(crate) mod tsurf;
pub mod vtp;

pub use crate::model::surface::{AnySurfaces, SurfaceFile};
pub use extract::surfaces;
pub use outcome::{InterfaceMeasure, SurfaceOutcome, SurfaceReport};

//! Writes and reads labelled surfaces.
//!
//! - `file`: the choice of the format
//! - `extract`: extracts the surfaces of a mesh
//! - `outcome`: the extracted surfaces with their measures, as table, JSON and file
//! - `survey_grid`: the bins and the line numbers of a survey
//! - `table`: tables of the measures of surfaces
//! - `vtp`: surfaces as they are drawn
//! - `heights`: a surface as a grid of heights, and as points on it
//!
//! The formats are in [`surface_file`](crate::surface_file), and Wavefront OBJ is in
//! [`meshers`](super::meshers).

pub(crate) mod extract;
pub(crate) mod file;
pub(crate) mod heights;
pub(crate) mod outcome;
pub(crate) mod survey_grid;
mod table;
pub mod vtp;

pub use crate::surface_file::{AnySurfaces, SurfaceFile, sticks, tsurf};
pub use extract::surfaces;
pub use outcome::{InterfaceMeasure, SurfaceOutcome, SurfaceReport};

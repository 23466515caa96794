//! Writes and reads labelled surfaces.
//!
//! - `file`: the choice of the format
//! - `survey_grid`: the bins and the line numbers of a survey
//! - `vtp`: surfaces as they are drawn
//! - `heights`: a surface as a grid of heights, and as points on it
//!
//! The formats are in [`surface_file`](crate::surface_file), and Wavefront OBJ is in
//! [`meshers`](super::meshers).

pub(crate) mod file;
pub(crate) mod heights;
pub(crate) mod survey_grid;
pub mod vtp;

pub use crate::surface_file::{AnySurfaces, SurfaceFile, sticks, tsurf};

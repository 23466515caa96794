//! Surfaces as they are drawn, as grids and as points.
//!
//! - `survey_grid`: the bins and the line numbers of a survey
//! - `vtp`: surfaces as they are drawn
//! - `heights`: a surface as a grid of heights, and as points on it
//!
//! The formats are in [`surface_file`](crate::surface_file).

pub(crate) mod heights;
pub(crate) mod survey_grid;
pub mod vtp;

pub use crate::surface_file::{AnySurfaces, SurfaceFile, sticks, tsurf};

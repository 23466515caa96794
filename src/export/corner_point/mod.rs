//! Corner-point grids, sampled from any cells.
//!
//! - [`grdecl`]: the file
//! - [`pillars`], [`layers`]: the grid
//! - [`walk`]: lines through cells, by which both are found

pub mod grdecl;
pub mod layers;
pub mod pillars;
pub mod walk;

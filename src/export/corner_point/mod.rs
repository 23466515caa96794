//! Corner-point grids, sampled from any cells.
//!
//! - `grdecl`: the file
//! - `pillars`, `layers`: the grid
//! - `walk`: lines through cells, by which both are found

pub(crate) mod grdecl;
pub(crate) mod layers;
pub(crate) mod pillars;
pub(crate) mod walk;

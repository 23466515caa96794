//! Corner-point grids, sampled from any cells.
//!
//! - `grdecl`: the files
//! - `pillars`, `layers`: the grid
//! - `corners`: its cells
//! - `faults`: surfaces as faces between its cells
//! - `wells`: the cells that wells are open to
//! - `walk`: lines through cells, by which both are found

pub(crate) mod cell_walk;
pub(crate) mod faults;
pub(crate) mod grdecl;
pub(crate) mod grid;
pub(crate) mod layers;
pub(crate) mod pillars;
pub(crate) mod wells;

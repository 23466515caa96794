//! Resamples models of any cells on corner-point grids.
//!
//! - `grdecl`: the files
//! - `pillars`, `layers`: the parts of the grid
//! - `grid`: the geometry of its cells
//! - `faults`: surfaces as faces between its cells
//! - `seals`: the grid as the check of seals sees it
//! - `wells`: the cells to which wells are connected
//! - `cell_walk`: lines through the cells of a model, along which layers and faults are found

pub(crate) mod cell_walk;
pub(crate) mod faults;
pub(crate) mod grdecl;
pub(crate) mod grid;
pub(crate) mod layers;
pub(crate) mod pillars;
mod seals;
pub(crate) mod wells;

use super::format::ExportFormat;

/// Formats of this folder, in the order in which they are listed.
pub(crate) const FORMATS: &[&ExportFormat] = &[&grdecl::FORMAT];

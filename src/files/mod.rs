//! What every file has in common, whatever it holds.
//!
//! - [`atomic`]: files that appear whole or not at all
//! - [`vtk`]: VTK's XML container, read and written

pub mod atomic;
pub mod vtk;

pub use atomic::{Batch, atomic_write, check_target, remove_unfinished};

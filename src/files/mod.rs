//! What every file has in common, whatever it holds.
//!
//! - [`atomic`]: files that appear whole or not at all
//! - [`read_exact_at`]: parts of a file, read by many threads at once
//! - [`open`](fn@open): no folder, no pipe
//! - `kept`: values as bytes
//! - [`vtk`]: VTK's XML container, read and written

mod at;
pub mod atomic;
pub mod kept;
mod open;
pub mod vtk;

pub use at::read_exact_at;
pub use atomic::{
    Batch, atomic_write, check_target, check_tree, exit_without_unfinished, remove_unfinished,
    together,
};
pub use open::open;

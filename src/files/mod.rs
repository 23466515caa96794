//! What every file has in common, whatever it holds.
//!
//! - [`atomic`]: files that appear whole or not at all
//! - [`read_exact_at`]: parts of a file, read by many threads at once
//! - [`open`](fn@open): no folder, no pipe
//! - `kept`: values as bytes
//! - [`vtk`]: VTK's XML container, read and written

pub mod atomic;
pub mod codec;
mod open;
mod read_at;
pub mod vtk;

pub use atomic::{
    Batch, atomic_write, check_target, check_tree, exit_without_unfinished, remove_unfinished,
    transaction,
};
pub use open::open;
pub use read_at::read_exact_at;

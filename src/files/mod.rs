//! File access that does not depend on a file's format, and the VTK container format.
//!
//! - [`atomic`]: files and folders that appear completely or not at all
//! - [`codec`]: binary encoding of values
//! - [`output`]: checks of output files, and reports on them
//! - [`table`]: tables in text files
//! - `text`: numbers as text, fast
//! - [`open`](fn@open), [`read`]: open or read regular files only, no folders and no pipes
//! - [`read_exact_at`]: reads parts of one file from many threads at once
//! - [`vtk`]: reads and writes VTK's XML container, and reads legacy VTK files

pub mod atomic;
pub mod codec;
mod open;
pub mod output;
mod read_at;
pub mod table;
pub(crate) mod text;
pub mod vtk;

pub use atomic::{
    Batch, atomic_write, check_target, check_tree, commit_immediately, exit_without_unfinished,
    remove_unfinished, transaction,
};
pub use open::{open, read};
pub use read_at::read_exact_at;

/// The remedy for a damaged file.
pub(crate) const REWRITE_DAMAGED: &str =
    "copy the file again, or write it again with the program that made it";

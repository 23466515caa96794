//! Image files, and writing any file safely.
//!
//! - [`atomic`]: files that appear whole or not at all

pub mod atomic;

pub use atomic::{atomic_write, check_target};

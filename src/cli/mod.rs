//! The command line.
//!
//! - [`args`]: as typed

pub mod args;

//! The command line.
//!
//! - [`args`]: as typed
//! - [`parse`]: the small grammars inside option values
//! - [`job`]: validated
//! - [`console`]: everything that is printed

pub mod args;
pub mod console;
pub mod job;
pub mod parse;

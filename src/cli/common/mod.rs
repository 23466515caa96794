//! Code that several verbs share.
//!
//! - [`global`]: options that every verb has
//! - [`options`]: options of the command line, and errors of the library about them
//! - [`output`]: messages about images that were written

pub mod global;
pub mod options;
pub mod output;

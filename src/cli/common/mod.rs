//! Code that several verbs share.
//!
//! - [`global`]: options that every verb has
//! - [`options`]: options of the command line, and errors of the library about them

pub mod global;
pub mod options;

//! Code that several verbs share.
//!
//! - [`global`]: options that every verb has
//! - [`options`]: options of the command line, and errors of the library about them
//! - [`output`]: checks of output files, and the output of images
//! - [`depth`]: conversion of two-way time to depth

pub mod depth;
pub mod global;
pub mod options;
pub mod output;

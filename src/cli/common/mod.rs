//! What verbs share.
//!
//! - [`global`]: options that every verb has
//! - [`options`]: settings in the words of the command line
//! - [`output`]: what may be written where
//! - [`depth`]: depth of two-way time

pub mod depth;
pub mod global;
pub mod options;
pub mod output;

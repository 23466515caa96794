//! What verbs share.
//!
//! - [`global`]: options that every verb has
//! - [`options`]: settings in the words of the command line
//! - [`output`]: what may be written where
//! - [`feature`]: how features are asked for

pub mod feature;
pub mod global;
pub mod options;
pub mod output;

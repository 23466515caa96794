//! What verbs share.
//!
//! - [`global`]: options that every verb has
//! - [`input`]: how to read an image whose file does not say it all
//! - [`output`]: what may be written where
//! - [`feature`]: how features are asked for

pub mod feature;
pub mod global;
pub mod input;
pub mod output;

//! Detectors as others have published them, kept to compare other detectors with them.
//!
//! - `paths`: the boundary of one object, by random shortest paths

pub(crate) mod paths;

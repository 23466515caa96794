//! Labelled surfaces.
//!
//! - [`file`](mod@file): what is written of them
//! - [`vtp`]: VTK poly data
//! - [`tsurf`]: surfaces for GOCAD
//!
//! Wavefront OBJ is among the [`meshers`](super::meshers).

pub mod file;
pub mod tsurf;
pub mod vtp;

pub use file::SurfaceFile;

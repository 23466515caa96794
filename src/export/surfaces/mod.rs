//! Writes and reads labelled surfaces.
//!
//! - `file`: the surfaces and their values, independent of the format
//! - `vtp`: VTK poly data
//! - `heights`: a surface as a grid of heights
//! - `tsurf`: GOCAD surfaces and lines
//! - `sticks`: fault sticks
//!
//! Wavefront OBJ is in [`meshers`](super::meshers).

pub(crate) mod file;
pub mod heights;
pub mod sticks;
pub(crate) mod tsurf;
pub mod vtp;

pub use file::SurfaceFile;

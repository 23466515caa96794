//! Labelled surfaces.
//!
//! - `file`: what is written of them
//! - `vtp`: VTK poly data
//! - `tsurf`: surfaces for GOCAD
//!
//! Wavefront OBJ is among the [`meshers`](super::meshers).

pub(crate) mod file;
pub(crate) mod tsurf;
pub mod vtp;

pub use file::SurfaceFile;

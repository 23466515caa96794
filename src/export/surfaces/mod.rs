//! Labelled surfaces.
//!
//! - `file`: what is written of them
//! - `vtp`: VTK poly data
//! - `heights`: a surface as a grid
//! - `tsurf`: surfaces of and for GOCAD
//! - `sticks`: fault sticks
//!
//! Wavefront OBJ is among the [`meshers`](super::meshers).

pub(crate) mod file;
pub mod heights;
pub mod sticks;
pub(crate) mod tsurf;
pub mod vtp;

pub use file::SurfaceFile;

//! Meshes to other programs, and surfaces to files. Physical coordinates only.
//!
//! - [`format`](mod@format): the table of formats
//! - [`simulators`]: models for flow simulators
//! - [`corner_point`]: corner-point grids, sampled from any cells
//! - [`meshers`]: triangles and tetrahedra with named faces, for other meshers and for finite elements
//! - [`surfaces`]: labelled surfaces
//! - `containers`: numbers as text and as bytes, and the containers that hold them
//! - `twin`: the VTU beside a format that does not hold the cells' shapes

pub(crate) mod containers;
pub mod corner_point;
pub mod format;
pub mod meshers;
pub mod simulators;
pub mod surfaces;
pub(crate) mod twin;

pub use format::{Content, FORMATS, Format};
pub use meshers::obj::write_obj;
pub use surfaces::SurfaceFile;
pub use surfaces::tsurf::write_tsurf;
pub use surfaces::vtp::write_vtp;

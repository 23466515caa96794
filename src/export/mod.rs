//! Exports meshes and models to the files of other programs, and surfaces to files of their own.
//! All coordinates are physical.
//!
//! This example writes two surfaces, a square and half a square, as OBJ:
//!
//! ```
//! use atomesh::export::{SurfaceFile, write_obj};
//!
//! let nodes = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
//! let triangles = [[0, 1, 2], [0, 2, 3], [0, 1, 4]];
//! let file = SurfaceFile::new(&nodes, &triangles, &[0, 2, 3], "fault");
//! let path = std::env::temp_dir().join("atomesh-export.obj");
//! write_obj(&path, &file)?;
//!
//! let text = std::fs::read_to_string(&path).unwrap_or_default();
//! assert_eq!(text.lines().filter(|line| line.starts_with("f ")).count(), 3);
//! assert!(text.contains("g fault2\nf 1 2 5\n"));
//! # std::fs::remove_file(&path).ok();
//! # Ok::<(), atomesh::Error>(())
//! ```
//!
//! - [`format`](mod@format): the list of formats, and how to add one
//! - `export_spec`: all options of an export, as one value
//! - `export_verb`: exports a mesh, from options to files
//! - `juxtaposition`: what lies against what on faults
//! - [`convert`](mod@convert): images and surfaces in other formats
//! - [`simulators`]: models for flow simulators
//! - [`corner_point`]: corner-point grids, sampled from cells of any shape
//! - [`meshers`]: triangles and tetrahedra with named faces, for other meshers and for finite
//!   elements
//! - [`surfaces`]: labelled surfaces
//! - [`page`]: a page for the browser that shows a mesh with its image and its report
//! - `containers`: numbers as bytes, and container files
//! - `names`: the names of a model's objects in one export
//! - `values`: values of each cell as arrays
//! - `companion`: the VTU beside a file whose format does not hold the shapes of cells

pub(crate) mod companion;
pub(crate) mod containers;
pub mod convert;
pub mod corner_point;
mod export_spec;
mod export_verb;
pub mod format;
mod juxtaposition;
pub mod meshers;
pub(crate) mod names;
pub mod page;
pub mod simulators;
pub mod surfaces;
pub(crate) mod values;

pub use crate::surface_file::obj::write_obj;
pub use export_spec::{ExportSpec, GridCounts};
pub use export_verb::{ExportOutcome, export};
pub use format::{ExportContent, ExportFormat, formats};
pub use surfaces::SurfaceFile;
pub use surfaces::sticks::{FaultSticks, read_sticks, write_sticks};
pub use surfaces::tsurf::{Gocad, read_gocad, write_tsurf};
pub use surfaces::vtp::write_vtp;

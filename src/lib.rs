//! atomesh turns 2-D and 3-D images, above all 3-D seismic volumes, straight into meshes for
//! simulation. An energy pulls a lattice of atoms onto the image's features; only then are the
//! atoms joined into tetrahedra (Hale 2001, 2002).
//!
//! ```text
//!               ground: what images, meshes and their files are
//! error         the error type: place, problem and remedy
//! memory        checks that a task fits into memory
//! progress      reports progress, stops long work, and measures its cost
//! parallel      parallel iterators
//! units         units of length and time, and their names
//! option_text   values of options as texts
//! names         names of objects by the rules of a format
//! geometry      vectors, cell lists, union-find, quantiles: what all other modules use
//! files         files that appear complete or not at all; VTK's XML format; values as bytes
//! comm          processes that share a job, or one process alone; the crate `atomesh-mpi` runs it with MPI
//! grid_file     corner-point grids of reservoir simulators, in files
//! image         samples and their position in the world; formats, synthetic images
//! mesh          cells, their checks and measures; Delaunay triangulations, Voronoi cells
//! mesh_file     mesh files as values, and their writers
//! surface_file  surfaces in files of their own: picks of interpreters, and what programs exchange
//! well_file     trajectories of wells in files
//!
//!               mesher: image in, mesh out
//! feature       image -> points on features, and the potential b(x) with valleys on them
//! lattice       positions of atoms: distance, seeding, energy, optimisation
//! published     methods of others, to compare the default methods with
//! improve       removes slivers and keeps features
//! report        the quality of a mesh
//! job           all of the above in order
//!
//!               uses: what is done with a mesh
//! store         meshes from files
//! model         surfaces, paint, flow, columns, reservoir models, pictures
//! export        meshes and models for other programs; a page for the browser
//!
//!               roof: what needs both the mesher and the uses
//! edit          edits of a mesh: atoms are added, moved and removed
//! assess        quality of a mesh from a file, and a page with it
//! surfaces      surfaces of a mesh, also by the features of an image
//! session       verbs on files, and on objects in memory in place of files
//! workbench     a resident session, whose actions change meshes in memory and can be undone
//! cli           the command line (feature `cli`)
//! ```
//!
//! [`mesh`](mesh()) makes a mesh from an image and its options. [`job::run`] does the same with parameters
//! that are read already:
//!
//! ```
//! use atomesh::image::synth::{self, SyntheticKind};
//! use atomesh::job::{self, MeshSpec, Params};
//! use atomesh::progress::NoProgress;
//!
//! let options = synth::Options { dims: [40, 36, 32], ..Default::default() };
//! let image = synth::make(SyntheticKind::Sphere, &options)?.image;
//! let params = Params::new(MeshSpec { distance: "6".parse().unwrap(), ..Default::default() })?;
//! let outcome = job::run(&image, &params, &mut NoProgress)?;
//! assert!(outcome.report.box_check.as_ref().is_some_and(|check| check.passed()));
//!
//! let path = std::env::temp_dir().join("atomesh-front-page.vtu");
//! outcome.write(&path)?;
//! # std::fs::remove_file(&path).ok();
//! # Ok::<(), atomesh::Error>(())
//! ```

pub mod assess;
#[cfg(feature = "cli")]
#[doc(hidden)]
#[allow(
    rustdoc::broken_intra_doc_links,
    rustdoc::private_intra_doc_links,
    reason = "its documentation is what the program prints as help, and for who works on it"
)]
pub mod cli;
#[cfg_attr(
    not(feature = "cli"),
    allow(dead_code, reason = "ranks are started by the command line")
)]
pub(crate) mod comm;
pub mod edit;
pub mod error;
pub mod export;
pub mod feature;
#[doc(hidden)]
pub mod files;
pub(crate) mod geometry;
pub(crate) mod grid_file;
pub mod image;
pub mod improve;
pub mod job;
pub mod lattice;
pub mod memory;
pub mod mesh;
pub mod mesh_file;
pub mod model;
#[doc(hidden)]
pub mod names;
pub(crate) mod option_text;
pub(crate) mod parallel;
pub mod progress;
pub mod published;
pub mod report;
pub mod session;
pub mod store;
pub mod surface_file;
pub mod surfaces;
pub(crate) mod units;
pub(crate) mod well_file;
pub mod workbench;

pub use assess::{QualitySpec, ReportSpec, quality, report};
#[cfg(feature = "cli")]
#[doc(hidden)]
pub use cli::option_table;
pub use edit::{EditSpec, edit};
pub use error::{Error, ErrorKind, Result};
pub use export::convert::{ConvertSpec, convert};
pub use export::{ExportSpec, export};
pub use image::synth::{SynthSpec, synth};
pub use job::{FeatureSpec, MeshSpec, features, mesh};
pub use model::columns::{ColumnsSpec, columns};
pub use model::flow::{FlowSpec, flow};
pub use model::paint::{PaintSpec, paint};
pub use model::segment::{SegmentSpec, segment};
pub use model::slice::{SliceSpec, slice};
pub use model::validate::validate;
pub use store::info;
pub use surfaces::{SurfaceSpec, surfaces};

/// Makes rustdoc test the examples of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

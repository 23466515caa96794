//! atomesh turns 2-D and 3-D images, above all 3-D seismic volumes, straight into meshes for
//! simulation: a lattice of atoms is pulled onto the image's features by an energy, and only then
//! joined into tetrahedra (Hale 2001, 2002).
//!
//! ```text
//! io        file -> Image: samples and where they lie in the world
//! feature   image -> points on features, and the potential b(x) with valleys on them
//! distance  nominal distance d(x) between atoms
//! seeding   a lattice of atoms that fills the image's box
//! optimize  atoms move to lower their energy among themselves and in b(x)
//! delaunay  atoms are joined into tetrahedra
//! improve   slivers go, features stay
//! report    how good the mesh is, and what it cost
//! export    mesh -> file, in the image's physical coordinates
//! columns   2-D cells of a map, drawn down between horizons
//! segment   object and background by a minimum cut on a mesh's cells
//! edit      atoms added, moved and removed, in their neighbourhood only
//! ```
//!
//! [`pipeline::mesh_image`] does all of it:
//!
//! ```
//! use atomesh::optimize::Unobserved;
//! use atomesh::pipeline::{Params, Spacing, mesh_image};
//! use atomesh::synth::{self, Kind};
//!
//! let options = synth::Options { dims: [40, 36, 32], ..Default::default() };
//! let image = synth::make(Kind::Sphere, &options)?.image;
//! let params = Params { spacing: Spacing::Constant(6.0), ..Params::default() };
//! # if !cfg!(feature = "tetgen") { return Ok(()); }
//! let outcome = mesh_image(&image, &params, &mut Unobserved)?;
//! assert!(outcome.report.filling.is_some_and(|check| check.passed()));
//! # Ok::<(), atomesh::Error>(())
//! ```

pub mod columns;
pub mod delaunay;
pub mod distance;
pub mod edit;
pub mod energy;
pub mod error;
pub mod export;
pub mod feature;
pub mod flow;
pub mod image;
pub mod improve;
pub mod io;
pub mod mesh;
pub mod optimize;
pub mod pipeline;
pub mod report;
pub mod reservoir;
pub mod seeding;
pub mod segment;
pub mod surface;
pub mod synth;
pub mod voronoi;
mod wide;

pub mod cli;

pub use error::{Error, Result};

/// The examples of the README are tested.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

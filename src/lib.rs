//! atomesh turns 2-D and 3-D images, above all 3-D seismic volumes, straight into meshes for
//! simulation: a lattice of atoms is pulled onto the image's features by an energy, and only then
//! joined into tetrahedra (Hale 2001, 2002).
//!
//! ```text
//! geometry  vectors, points in buckets, sets: what all houses stand on
//! files     files that appear whole or not at all; VTK's container
//! image     samples and where they lie in the world; formats, synthetic images
//! mesh      cells, their checks and measures; points joined into Delaunay or Voronoi cells
//! feature   image -> points on features, and the potential b(x) with valleys on them
//! lattice   where atoms stand: distance, seeding, energy, optimisation
//! improve   slivers go, features stay
//! report    how good the mesh is, and what it cost
//! job       all of the above in order: image in, mesh out
//! store     meshes in files, in the image's physical coordinates
//! model     what users do with a mesh: surfaces, paint, flow, columns, reservoir models, edits
//! export    meshes and models to other programs
//! cli       the command line (feature `cli`)
//! ```
//!
//! [`job::mesh_image`] does all of it:
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

#[cfg(feature = "cli")]
pub mod cli;
pub mod error;
pub mod export;
pub mod feature;
pub mod files;
pub mod geometry;
pub mod image;
pub mod improve;
pub mod job;
pub mod lattice;
pub mod mesh;
pub mod model;
pub mod report;
pub mod store;

pub use error::{Error, Result};

/// The examples of the README are tested.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

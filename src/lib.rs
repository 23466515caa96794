//! atomesh turns 2-D and 3-D images, above all 3-D seismic volumes, straight into meshes for
//! simulation: a lattice of atoms is pulled onto the image's features by an energy, and only then
//! joined into tetrahedra (Hale 2001, 2002).

pub mod delaunay;
pub mod distance;
pub mod energy;
pub mod error;
pub mod export;
pub mod feature;
pub mod image;
pub mod improve;
pub mod io;
pub mod mesh;
pub mod optimize;
pub mod pipeline;
pub mod report;
pub mod seeding;
pub mod synth;

pub mod cli;

pub use error::{Error, Result};

/// The examples of the README are tested.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

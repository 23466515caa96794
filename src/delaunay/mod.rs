//! Points -> Delaunay tetrahedra, and second opinions on the result.
//!
//! - [`tetgen`]: the Delaunay triangulation, by TetGen (feature `tetgen`)

pub mod tetgen;

pub use tetgen::{Delaunay, OUTSIDE, delaunay, delaunay_with_neighbors};

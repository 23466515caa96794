//! Points -> Delaunay tetrahedra, and second opinions on the result.
//!
//! - [`tetgen`]: the Delaunay triangulation, by TetGen (feature `tetgen`)
//! - [`cgal`]: the same by CGAL, and its judgement on any mesh (feature `cgal`)

pub mod cgal;
pub mod tetgen;

pub use tetgen::{Delaunay, OUTSIDE, delaunay, delaunay_with_neighbors};

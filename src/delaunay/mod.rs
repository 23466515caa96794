//! Points -> Delaunay tetrahedra or triangles, and second opinions on the result.
//!
//! - [`planar`]: triangles in the plane, by spade
//! - [`tetgen`]: the Delaunay triangulation, by TetGen (feature `tetgen`)
//! - [`cgal`]: the same by CGAL, and its judgement on any mesh (feature `cgal`)

pub mod cgal;
pub mod planar;
pub mod tetgen;

pub use planar::delaunay_plane;
pub use tetgen::{Delaunay, OUTSIDE, delaunay, delaunay_with_neighbors};

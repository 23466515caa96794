//! Points -> Delaunay tetrahedra or triangles, and second opinions on the result.
//!
//! - `planar`: triangles in the plane, by spade
//! - `tetgen`: the Delaunay triangulation, by TetGen (feature `tetgen`)
//! - `cgal`: the same by CGAL, and its judgement on any mesh (feature `cgal`)
//! - `exude`: slivers removed by weights, by CGAL
//! - `refine`: points added until no circumsphere is too large, by spade and CGAL

pub mod cgal;
pub(crate) mod exude;
pub(crate) mod planar;
pub(crate) mod refine;
pub(crate) mod tetgen;

pub use planar::{constrained_plane, delaunay_plane};
pub use tetgen::{
    Delaunay, GlobalPoints, IntervalTets, OUTSIDE, delaunay, delaunay_in_intervals,
    delaunay_with_neighbors,
};
#[cfg(feature = "tetgen")]
pub use tetgen::{peak_mb, run_in_worker, serve, share_with_workers};

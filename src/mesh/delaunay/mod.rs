//! Delaunay triangulation of points into tetrahedra or triangles, and validation and refinement of
//! the result.
//!
//! - `planar`: triangles in the plane, by spade
//! - `tetgen`: tetrahedra, by TetGen (feature `tetgen`)
//! - `cgal`: tetrahedra by CGAL, and its check of any mesh (feature `cgal`)
//! - `exude`: removes slivers by weights, with CGAL
//! - `refine`: adds points until no circumsphere is too large, with spade and CGAL
//! - `bridge`: CGAL's functions for `cgal`, `exude` and `refine`

mod bridge;
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
pub(crate) use tetgen::{distributed_delaunay, distributed_delaunay_with_neighbors};
#[cfg(feature = "tetgen")]
pub use tetgen::{peak_mb, run_in_worker, serve, share_with_workers};

/// Returns the error for `point_count` points that TetGen or CGAL has no memory for.
fn out_of_memory(place: &str, point_count: usize) -> crate::Error {
    crate::Error::Delaunay(crate::error::cause(
        place,
        format!("{point_count} points do not fit in memory"),
        "use a larger nominal distance, or a machine with more memory",
    ))
}

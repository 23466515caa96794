//! Delaunay refinement: adds points at the centres of circumspheres that are too large, the one
//! largest relative to d first (Hale 2002). In 3-D by CGAL (feature `cgal`), in 2-D by spade.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use spade::handles::FixedVertexHandle;
use spade::{DelaunayTriangulation, Point2, Triangulation};

use super::bridge::{call, ffi, to_arrays};
use crate::error::{Error, Result, cause};
use crate::image::ScalarField;
use crate::progress::CancelToken;

/// Place of this module's errors.
const PLACE: &str = "Delaunay refinement";

/// A triangle at whose circumcentre a point may be added.
struct RefineCandidate {
    /// Circumradius over the nominal distance d at the circumcentre.
    ratio: f64,
    corners: [FixedVertexHandle; 3],
    face: spade::handles::FixedFaceHandle<spade::handles::InnerTag>,
    centre: Point2<f64>,
}

impl Ord for RefineCandidate {
    fn cmp(&self, other: &Self) -> Ordering {
        // Equal ratios are sorted by vertices, so that every run gives the same result.
        let corners = |entry: &Self| entry.corners.map(|corner| corner.index());
        let by_ratio = self.ratio.total_cmp(&other.ratio);
        by_ratio.then_with(|| corners(other).cmp(&corners(self)))
    }
}

impl PartialOrd for RefineCandidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for RefineCandidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for RefineCandidate {}

/// Returns the points to add to `points` so that no triangle of their Delaunay triangulation with
/// its circumcentre in the rectangle `[0, extent]` has a circumradius above `limit` times d.
/// Returns fewer points if `cancel` is cancelled.
///
/// # Errors
/// Returns [`Error::Delaunay`] if a coordinate is not finite.
pub fn refine_plane(
    points: &[[f64; 2]],
    extent: [f64; 2],
    d: impl Fn([f64; 2]) -> f64,
    limit: f64,
    cancel: &CancelToken<'_>,
) -> Result<Vec<[f64; 2]>> {
    let mut delaunay: DelaunayTriangulation<Point2<f64>> = DelaunayTriangulation::new();
    let insert = |delaunay: &mut DelaunayTriangulation<_>, x: Point2<f64>| {
        let inserted = delaunay.insert(x);
        inserted.map_err(|error| refine_error(error, "give finite coordinates"))
    };
    for &[x, y] in points {
        insert(&mut delaunay, Point2::new(x, y))?;
    }
    let mut queue = BinaryHeap::new();
    let candidate =
        |face: spade::handles::FaceHandle<spade::handles::InnerTag, Point2<f64>, (), (), ()>| {
            let centre = face.circumcenter();
            let x = [centre.x, centre.y];
            if !(0..2).all(|k| x[k] > 0.0 && x[k] < extent[k]) {
                return None;
            }
            let ratio = centre.distance_2(face.vertices()[0].position()).sqrt() / d(x);
            (ratio > limit).then(|| RefineCandidate {
                ratio,
                corners: face.vertices().map(|vertex| vertex.fix()),
                face: face.fix(),
                centre,
            })
        };
    queue.extend(delaunay.inner_faces().filter_map(candidate));
    let mut added = Vec::new();
    while let Some(worst) = queue.pop() {
        if cancel.is_cancelled() {
            break;
        }
        // spade reuses face handles and never removes them: the triangle still exists if its
        // corners are unchanged.
        let face = delaunay.face(worst.face);
        if face.vertices().map(|vertex| vertex.fix()) != worst.corners {
            continue;
        }
        let before = delaunay.num_vertices();
        let vertex = insert(&mut delaunay, worst.centre)?;
        if delaunay.num_vertices() == before {
            continue;
        }
        added.push([worst.centre.x, worst.centre.y]);
        let out_edges = delaunay.vertex(vertex).out_edges();
        queue.extend(out_edges.filter_map(|edge| edge.face().as_inner().and_then(candidate)));
    }
    Ok(added)
}

/// Returns the points to add to `points` so that no tetrahedron of their Delaunay triangulation
/// with its circumcentre in the box `[0, extent]` has a circumradius above `limit` times d. The
/// field `d` covers the box.
///
/// # Errors
/// Returns [`Error::Delaunay`] if a coordinate is not finite, if the points lie in one plane, if `d`
/// has too few samples, if memory runs out, or without the feature `cgal`.
pub fn refine_space(
    points: &[[f64; 3]],
    extent: [f64; 3],
    d: &ScalarField<3>,
    limit: f64,
) -> Result<Vec<[f64; 3]>> {
    if d.samples.len() != d.dims.iter().product::<usize>() || d.samples.is_empty() {
        return Err(refine_error(
            "d does not have as many samples as it should",
            "give one that covers the box",
        ));
    }
    call(PLACE, points, |points| {
        ffi::cgal_refine(points, &extent, &d.samples, &d.dims, limit)
    })
    .map(to_arrays)
}

fn refine_error(problem: impl std::fmt::Display, remedy: impl std::fmt::Display) -> Error {
    Error::Delaunay(cause(PLACE, problem, remedy))
}

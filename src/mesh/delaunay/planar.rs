//! The Delaunay triangulation of points in the plane, by spade.
//!
//! spade's predicates are exact. Therefore points on a lattice (four on a circle), and points
//! exactly on the sides of a box, need no special treatment: the triangles fill the hull.

use spade::{
    ConstrainedDelaunayTriangulation, DelaunayTriangulation, HasPosition, MIN_ALLOWED_VALUE,
    Point2, Triangulation,
};

use crate::error::cause;
use crate::mesh::TriMesh;
use crate::{Error, Result};

/// A point with its index.
struct IndexedPoint {
    position: Point2<f64>,
    index: u32,
}

impl HasPosition for IndexedPoint {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        self.position
    }
}

/// Returns the Delaunay triangles of `points`, in an order that depends only on the input. Nodes
/// are numbered as the points.
///
/// The expected time is O(n log n); points in a spatial order are fastest. If four points lie on a
/// circle, either diagonal may be chosen, but always the same one for the same input.
///
/// # Errors
/// Returns [`Error::Delaunay`] for fewer than three points, for points on one line, for coinciding
/// points, and for coordinates that are not finite or above 1e60.
pub fn delaunay_plane(points: &[[f64; 2]]) -> Result<TriMesh> {
    let numbered = indexed_points(points)?;
    let triangulation = DelaunayTriangulation::<IndexedPoint>::bulk_load(numbered)
        .or_else(|error| invalid_input(error.to_string(), "give finite coordinates"))?;
    triangles(points, &triangulation)
}

/// Returns the Delaunay triangles of `points` with the constraint that all `edges` (pairs of
/// points) are edges of triangles.
///
/// # Errors
/// Returns the errors of [`delaunay_plane`], and [`Error::Delaunay`] if edges cross one another.
pub fn constrained_plane(points: &[[f64; 2]], edges: &[[u32; 2]]) -> Result<TriMesh> {
    let numbered = indexed_points(points)?;
    let edges = edges.iter().map(|edge| edge.map(|n| n as usize)).collect();
    let mut crossing_count = 0;
    let triangulation = ConstrainedDelaunayTriangulation::<IndexedPoint>::try_bulk_load_cdt(
        numbered,
        edges,
        |_| crossing_count += 1,
    )
    .or_else(|error| invalid_input(error.to_string(), "give finite coordinates"))?;
    if crossing_count > 0 {
        return invalid_input(
            format!("{crossing_count} edges cross others"),
            "leave them out",
        );
    }
    triangles(points, &triangulation)
}

fn invalid_input<T>(problem: String, remedy: &str) -> Result<T> {
    let place = "2-D Delaunay triangulation";
    Err(Error::Delaunay(cause(place, problem, remedy)))
}

/// Returns a coordinate, or 0 in place of one that is so near to 0 that spade refuses it: such values
/// are what rounding leaves of 0.
fn without_underflow(c: f64) -> f64 {
    if c.abs() < MIN_ALLOWED_VALUE { 0.0 } else { c }
}

/// Checks the points and combines them with their indices.
fn indexed_points(points: &[[f64; 2]]) -> Result<Vec<IndexedPoint>> {
    if points.len() < 3 || points.len() >= u32::MAX as usize {
        return invalid_input(
            format!("{} points", points.len()),
            "give at least 3 points, and fewer than 2^32",
        );
    }
    let points = || points.iter().map(|point| point.map(without_underflow));
    for (i, [x, y]) in points().enumerate() {
        if spade::validate_coordinate(x).is_err() || spade::validate_coordinate(y).is_err() {
            return invalid_input(
                format!("the coordinates of point {i}, ({x}, {y}), are too large to compute with"),
                "give finite coordinates",
            );
        }
    }
    Ok((0u32..)
        .zip(points())
        .map(|(index, [x, y])| IndexedPoint {
            position: Point2::new(x, y),
            index,
        })
        .collect())
}

/// Returns the triangles, if every point is a node of a triangle.
fn triangles(
    points: &[[f64; 2]],
    triangulation: &impl Triangulation<Vertex = IndexedPoint>,
) -> Result<TriMesh> {
    if triangulation.num_vertices() < points.len() {
        return invalid_input(
            format!(
                "{} of {} points coincide with another",
                points.len() - triangulation.num_vertices(),
                points.len()
            ),
            "give each point once",
        );
    }
    if triangulation.num_inner_faces() == 0 {
        return invalid_input(
            format!("all {} points lie on one line", points.len()),
            "give points that span the plane",
        );
    }
    let triangles = triangulation
        .inner_faces()
        .map(|face| face.vertices().map(|vertex| vertex.data().index))
        .collect();
    Ok(TriMesh {
        nodes: points.to_vec(),
        triangles,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::check::check;
    use crate::mesh::tri::{angles, double_area};
    use proptest::prelude::*;

    /// Returns `true` if no node lies inside the circle through a triangle's corners (up to
    /// rounding).
    fn is_delaunay(mesh: &TriMesh) -> bool {
        (0..mesh.triangles.len()).all(|t| {
            let p = mesh.corners(t);
            mesh.nodes.iter().all(|q| {
                let [a, b, c] = p.map(|p| [p[0] - q[0], p[1] - q[1]]);
                let lift = |v: [f64; 2]| v[0] * v[0] + v[1] * v[1];
                let minor = |u: [f64; 2], v: [f64; 2]| u[0] * v[1] - u[1] * v[0];
                lift(a) * minor(b, c) + lift(b) * minor(c, a) + lift(c) * minor(a, b) <= 1e-9
            })
        })
    }

    /// Returns points in the unit square: the given ones, its corners and `sides` points on each
    /// side.
    fn points_in_square(inside: Vec<[f64; 2]>, sides: usize) -> Vec<[f64; 2]> {
        let mut points = inside;
        for k in 0..=sides {
            let t = k as f64 / (sides + 1) as f64;
            points.extend([[t, 0.0], [1.0, t], [1.0 - t, 1.0], [0.0, 1.0 - t]]);
        }
        points
    }

    #[test]
    fn a_hexagonal_lattice_has_angles_of_60_degrees() {
        let mut points = Vec::new();
        for row in 0..12 {
            for column in 0..12 {
                let shift = if row % 2 == 1 { 0.5 } else { 0.0 };
                points.push([f64::from(column) + shift, f64::from(row) * 0.75f64.sqrt()]);
            }
        }
        let mesh = delaunay_plane(&points).unwrap();
        let inner = |t: &usize| mesh.corners(*t).iter().all(|p| p[0] > 0.6 && p[0] < 10.9);
        let inner: Vec<usize> = (0..mesh.triangles.len()).filter(inner).collect();
        assert_eq!(inner.len(), 11 * 18);
        for t in inner {
            for angle in angles(&mesh.corners(t)) {
                assert!((angle - 60.0).abs() < 1e-9, "{angle}");
            }
        }
    }

    #[test]
    fn a_square_lattice_is_triangulated() {
        let points: Vec<[f64; 2]> = (0..400)
            .map(|i| [f64::from(i % 20), f64::from(i / 20)])
            .collect();
        let mesh = delaunay_plane(&points).unwrap();
        assert_eq!(mesh.triangles.len(), 2 * 19 * 19);
        let report = check(&mesh, [0.0; 2], [19.0; 2], 1e-12);
        assert!(report.passed(), "{:?}", report.problems);
    }

    #[test]
    fn coordinates_that_rounding_leaves_of_zero_are_zero() {
        let points = [[-1.0, 3e-45], [1.0, -1e-300], [0.0, 1.0], [1e-50, -1.0]];
        let mesh = delaunay_plane(&points).unwrap();
        assert_eq!(
            (mesh.triangles.len(), mesh.nodes.as_slice()),
            (2, &points[..])
        );
    }

    #[test]
    fn points_that_span_no_plane_are_refused() {
        let message = |points: &[[f64; 2]]| delaunay_plane(points).unwrap_err().to_string();
        assert!(message(&[[0.0; 2]; 2]).contains("2 points"));
        assert!(message(&[[0.0; 2], [1.0; 2], [2.0; 2]]).contains("one line"));
        assert!(message(&[[0.0; 2], [1.0, 0.0], [0.0, 1.0], [1.0, 0.0]]).contains("1 of 4"));
        for bad_value in [f64::NAN, f64::INFINITY, 1e70] {
            assert!(message(&[[0.0; 2], [1.0, 0.0], [0.0, bad_value]]).contains("point 2"));
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..Default::default() })]
        #[test]
        fn random_points_fill_their_box(
            inside in proptest::collection::vec(proptest::array::uniform2(0.001f64..0.999), 1..60),
            sides in 0usize..6,
        ) {
            let mut inside = inside;
            inside.sort_by(|a, b| a.partial_cmp(b).unwrap());
            inside.dedup();
            let mesh = delaunay_plane(&points_in_square(inside, sides)).unwrap();
            let report = check(&mesh, [0.0; 2], [1.0; 2], 1e-12);
            prop_assert!(report.passed(), "{:?}", report.problems);
            prop_assert!(is_delaunay(&mesh));
        }

        #[test]
        fn jittered_lattices_fill_their_box(
            jitter in proptest::collection::vec(proptest::array::uniform2(-0.02f64..0.02), 81),
        ) {
            let inside = jitter
                .iter()
                .enumerate()
                .map(|(i, j)| [0.1 * (i % 9 + 1) as f64 + j[0], 0.1 * (i / 9 + 1) as f64 + j[1]])
                .collect();
            let mesh = delaunay_plane(&points_in_square(inside, 9)).unwrap();
            let report = check(&mesh, [0.0; 2], [1.0; 2], 1e-12);
            prop_assert!(report.passed(), "{:?}", report.problems);
            prop_assert!(is_delaunay(&mesh));
            prop_assert_eq!(mesh.triangles.len(), 200);
            let area: f64 = (0..200).map(|t| 0.5 * double_area(&mesh.corners(t))).sum();
            prop_assert!((area - 1.0).abs() < 1e-12);
        }
    }
}

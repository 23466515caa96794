//! Delaunay refinement: adds points at the centres of circumspheres that are too large, the one
//! largest relative to d first (Hale 2002). In 3-D by our own kernel, in 2-D by spade.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use spade::handles::{FaceHandle, InnerTag};
use spade::{DelaunayTriangulation, Point2, Triangulation as _};

use super::native;
use super::native::predicates::WeightedPoint;
use super::native::triangulation::{GHOST, Inserted, Triangulation};
use crate::error::{Error, Result, cause};
use crate::geometry::{cross, distance2, dot, sub};
use crate::progress::CancelToken;

/// Place of this module's errors.
const PLACE: &str = "Delaunay refinement";

/// A cell at whose circumcentre a point may be added: the bits of its circumradius over the nominal
/// distance d at the circumcentre, its vertices, and the cell. The greatest comes first. Equal ratios
/// are ordered by vertices, so that every run gives the same result.
type Candidate<const N: usize, Cell> = (u64, Reverse<[u32; N]>, Cell);

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
    let corners = |face: &FaceHandle<'_, InnerTag, _, _, _, _>| {
        face.vertices().map(|vertex| vertex.index() as u32)
    };
    let candidate = |face: FaceHandle<'_, InnerTag, Point2<f64>, (), (), ()>| {
        let centre = face.circumcenter();
        let x = [centre.x, centre.y];
        if !(0..2).all(|k| x[k] > 0.0 && x[k] < extent[k]) {
            return None;
        }
        let ratio = centre.distance_2(face.vertices()[0].position()).sqrt() / d(x);
        let candidate: Candidate<3, _> = (ratio.to_bits(), Reverse(corners(&face)), face.fix());
        (ratio > limit).then_some(candidate)
    };
    queue.extend(delaunay.inner_faces().filter_map(candidate));
    let mut added = Vec::new();
    while let Some((_, Reverse(vertices), face)) = queue.pop() {
        if cancel.is_cancelled() {
            break;
        }
        // spade reuses face handles and never removes them: the triangle still exists if its
        // corners are unchanged.
        let face = delaunay.face(face);
        if corners(&face) != vertices {
            continue;
        }
        let centre = face.circumcenter();
        let before = delaunay.num_vertices();
        let vertex = insert(&mut delaunay, centre)?;
        if delaunay.num_vertices() == before {
            continue;
        }
        added.push([centre.x, centre.y]);
        let out_edges = delaunay.vertex(vertex).out_edges();
        queue.extend(out_edges.filter_map(|edge| edge.face().as_inner().and_then(candidate)));
    }
    Ok(added)
}

/// Returns the points to add to `points` so that no tetrahedron of their Delaunay triangulation
/// with its circumcentre in the box `[0, extent]` has a circumradius above `limit` times d.
/// Returns fewer points if `cancel` is cancelled.
///
/// # Errors
/// Returns [`Error::Delaunay`] if a coordinate is not finite, or if the points lie in one plane.
pub fn refine_space(
    points: &[[f64; 3]],
    extent: [f64; 3],
    d: impl Fn([f64; 3]) -> f64,
    limit: f64,
    cancel: &CancelToken<'_>,
) -> Result<Vec<[f64; 3]>> {
    super::check_points(points)?;
    let mut delaunay = native::incremental(points)?;
    let candidate = |delaunay: &Triangulation<false>, cell: u32| {
        let vertices = delaunay.cell(cell).vertices;
        if vertices.contains(&GHOST) {
            return None;
        }
        let corners = vertices.map(|v| delaunay.point(v));
        let centre = circumcentre(corners);
        if !(0..3).all(|k| centre[k] > 0.0 && centre[k] < extent[k]) {
            return None;
        }
        let ratio = distance2(&centre, &corners[0]).sqrt() / d(centre);
        let candidate: Candidate<4, u32> = (ratio.to_bits(), Reverse(vertices), cell);
        (ratio > limit).then_some(candidate)
    };
    let cells = 0..delaunay.cell_count() as u32;
    let mut queue: BinaryHeap<_> = cells
        .filter_map(|cell| candidate(&delaunay, cell))
        .collect();
    let mut added: Vec<[f64; 3]> = Vec::new();
    while let Some((_, Reverse(vertices), cell)) = queue.pop() {
        if cancel.is_cancelled() {
            break;
        }
        if delaunay.cell(cell).vertices != vertices {
            continue;
        }
        let centre = circumcentre(vertices.map(|v| delaunay.point(v)));
        let point = WeightedPoint {
            x: centre,
            weight: 0.0,
        };
        let number = (points.len() + added.len()) as u32;
        if delaunay.insert_near(point, number, cell) != Inserted::Vertex {
            continue;
        }
        added.push(centre);
        let new_cells: Vec<u32> = delaunay.new_cells().collect();
        queue.extend(
            new_cells
                .into_iter()
                .filter_map(|cell| candidate(&delaunay, cell)),
        );
    }
    Ok(added)
}

/// Returns the centre of the sphere through four points.
fn circumcentre([a, b, c, d]: [[f64; 3]; 4]) -> [f64; 3] {
    let [b, c, d] = [b, c, d].map(|p| sub(p, a));
    let normals = [cross(c, d), cross(d, b), cross(b, c)];
    let squares = [b, c, d].map(|p| dot(p, p));
    let scale = 0.5 / dot(b, normals[0]);
    std::array::from_fn(|k| a[k] + scale * (0..3).map(|i| squares[i] * normals[i][k]).sum::<f64>())
}

fn refine_error(problem: impl std::fmt::Display, remedy: impl std::fmt::Display) -> Error {
    Error::Delaunay(cause(PLACE, problem, remedy))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::delaunay::delaunay;

    #[test]
    fn no_circumsphere_in_the_box_is_too_large_afterwards() {
        // The sides are filled already.
        let grid = (0..216u32).map(|n| [n % 6, n / 6 % 6, n / 36]);
        let on_sides = grid.filter(|index| index.iter().any(|&i| i == 0 || i == 5));
        let mut points: Vec<[f64; 3]> = on_sides.map(|p| p.map(|i| 2.0 * f64::from(i))).collect();
        points.push([4.1, 5.2, 5.3]);
        let d = |x: [f64; 3]| 2.0 + 0.1 * x[0];
        let added = refine_space(&points, [10.0; 3], d, 0.803, &CancelToken::never()).unwrap();
        points.extend(added);
        let mesh = delaunay(&points).unwrap();
        let mut worst = 0.0f64;
        for t in 0..mesh.tets.len() {
            let corners = mesh.corners(t);
            let centre = circumcentre(corners);
            if centre.iter().all(|&c| 0.0 < c && c < 10.0) {
                worst = worst.max(distance2(&centre, &corners[0]).sqrt() / d(centre));
            }
        }
        assert!(worst <= 0.803 + 1e-9 && worst > 0.7, "{worst}");
        assert!(points.len() > 200, "{}", points.len());
    }

    #[test]
    fn points_in_one_plane_are_refused() {
        let plane = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]];
        let refined = refine_space(&plane, [1.0; 3], |_| 1.0, 1.0, &CancelToken::never());
        assert!(refined.unwrap_err().to_string().contains("span a volume"));
    }
}

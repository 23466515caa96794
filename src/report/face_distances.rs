//! Computes the distances of feature points from the faces of a mesh.
//!
//! Most points have a face close by. So first each face visits the points around it, in a grid, and
//! lowers their distances. Points that no face has reached then search for their nearest face, in a
//! tree. In a distributed mesh, each rank has some of the points and faces. It receives the faces
//! around the box of its points. The few points without any of these faces are sent to all ranks.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use super::mesh_faces::MeshFaces;
use crate::Result;
use crate::geometry::box_tree::BoxTree;
use crate::geometry::point_grid::PointGrid;
use crate::geometry::{bounding_box, cross, dot, squared_distance_to_face, sub, to_3d};
use crate::mesh::view::MeshView;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Radius within which faces visit points, in samples.
const SEARCH_RADIUS: f64 = 1.0;
/// Distance in samples from the box of a rank's points within which it receives faces, and the
/// maximum number of points that a rank sends to all ranks at once. Unit tests have small values.
const EXCHANGE_RADIUS: f64 = if cfg!(test) { 2.0 } else { 32.0 };
const MAX_EXCHANGED_FACES: usize = if cfg!(test) { 100 } else { 1 << 16 };
/// Number of faces or points in one task. Unit tests have a small value.
const ITEMS_PER_TASK: usize = if cfg!(test) { 64 } else { 4096 };

/// Returns the distances from the local points to the nearest face, in any part of a mesh, of each of two
/// sets of faces. Distances are infinite for an empty set. The bits of a face are the sets to which
/// it belongs. Collective.
///
/// # Errors
/// Returns the communication errors of the view.
pub(super) fn distances_to_faces<const D: usize, M>(
    view: &MeshView<'_, D, M>,
    surface: &MeshFaces<'_, D>,
    points: &[[f32; D]],
    queried_sets: [u8; 2],
    cancel: &CancelToken<'_>,
) -> Result<[Vec<f64>; 2]> {
    let mut squares = {
        let nearby = BoxedFaces::gather_near(view, surface, points)?;
        let mut squares = nearby.squared_distances_nearby(points, queried_sets, cancel);
        nearby.search_from_points(points, queried_sets, EXCHANGE_RADIUS, &mut squares, cancel);
        squares
    };
    let exists = queried_sets.map(|set| surface.sets.iter().any(|sets| sets & set != 0));
    let exists = view.merge_parts("sets of faces", exists, |a, b| [a[0] || b[0], a[1] || b[1]])?;
    let is_far = |&i: &usize| (0..2).any(|k| exists[k] && squares[k][i].is_infinite());
    let far_points: Vec<usize> = (0..points.len()).filter(is_far).collect();
    let (mut far_chunks, mut all_local) = (far_points.chunks(MAX_EXCHANGED_FACES), None);
    let messages = ["points far from faces", "squares of distances to faces"];
    loop {
        let chunk = far_chunks.next().unwrap_or_default();
        let chunk_points: Vec<[f32; D]> = chunk.iter().map(|&i| points[i]).collect();
        let answer = |others: &[[f32; D]]| {
            let local = all_local.get_or_insert_with(|| BoxedFaces::from_surface(surface));
            let mut squares = [0, 1].map(|_| vec![f64::INFINITY; others.len()]);
            local.search_from_points(others, queried_sets, f64::INFINITY, &mut squares, cancel);
            let [first, second] = squares;
            first.into_iter().zip(second).collect()
        };
        let Some(answers) = view.ask_parts(messages, chunk_points, answer)? else {
            break;
        };
        for of_part in answers {
            for (&i, (first, second)) in chunk.iter().zip(of_part) {
                squares[0][i] = squares[0][i].min(first);
                squares[1][i] = squares[1][i].min(second);
            }
        }
    }
    for squares in &mut squares {
        squares
            .iter_mut()
            .for_each(|square| *square = square.sqrt());
    }
    Ok(squares)
}

/// Face as it is sent to other ranks: its corners and its sets.
type SentFace<const D: usize> = ([[f64; D]; D], u8);

/// Faces with their bounding boxes.
struct BoxedFaces<const D: usize> {
    shapes: Vec<[[f64; D]; D]>,
    /// Bounding box of each face: its low and its high corner.
    boxes: Vec<[[f64; D]; 2]>,
    sets: Vec<u8>,
}

impl<const D: usize> BoxedFaces<D> {
    /// Copies the local faces.
    fn from_surface(surface: &MeshFaces<'_, D>) -> Self {
        let faces = 0..surface.faces.len();
        Self::from_sent(faces.map(|f| (surface.corners(f), surface.sets[f])))
    }

    /// Gathers the faces of all parts of a mesh that may be within [`EXCHANGE_RADIUS`] of the box of
    /// the local points. Collective.
    fn gather_near<M>(
        view: &MeshView<'_, D, M>,
        surface: &MeshFaces<'_, D>,
        points: &[[f32; D]],
    ) -> Result<Self> {
        let [low, high] = bounding_box(points.iter().map(|p| p.map(f64::from)));
        let bounds = [
            low.map(|c| c - EXCHANGE_RADIUS),
            high.map(|c| c + EXCHANGE_RADIUS),
        ];
        let faces_in_box = |[low, high]: [[f64; D]; 2]| -> Vec<SentFace<D>> {
            let faces = (0..surface.faces.len()).into_par_iter();
            let faces = faces.map(|f| (surface.corners(f), surface.sets[f]));
            let overlaps = |(shape, _): &SentFace<D>| {
                let [face_low, face_high] = bounding_box(shape);
                (0..D).all(|k| face_low[k] <= high[k] && low[k] <= face_high[k])
            };
            faces.filter(overlaps).collect()
        };
        let messages = ["boxes of points", "faces round points"];
        let faces = view.gather_in_box(messages, bounds, faces_in_box)?;
        Ok(Self::from_sent(faces.into_iter()))
    }

    fn from_sent(faces: impl Iterator<Item = SentFace<D>>) -> Self {
        let (shapes, sets): (Vec<_>, _) = faces.unzip();
        Self {
            boxes: shapes.par_iter().map(bounding_box).collect(),
            shapes,
            sets,
        }
    }

    /// Returns for each set and point the squared distance to the nearest face if it is within
    /// [`SEARCH_RADIUS`], otherwise infinity.
    fn squared_distances_nearby(
        &self,
        points: &[[f32; D]],
        queried_sets: [u8; 2],
        cancel: &CancelToken<'_>,
    ) -> [Vec<f64>; 2] {
        let grid = PointGrid::new(points);
        let infinity = || AtomicU64::new(f64::INFINITY.to_bits());
        // Squares are not negative, so their bits have the same order as the numbers. The minimum
        // does not depend on the order of the faces.
        let min_squares: [Vec<AtomicU64>; 2] =
            [0, 1].map(|_| points.iter().map(|_| infinity()).collect());
        let visit_face = |f: usize| {
            let shape = &self.shapes[f];
            let [low, high] = self.boxes[f];
            let [a, b, c] = [shape[0], shape[1], shape[D - 1]].map(to_3d);
            let normal = cross(sub(b, a), sub(c, a));
            let squared_normal = dot(normal, normal) * (1.0 + 1e-9);
            let is_in_set = queried_sets.map(|set| self.sets[f] & set != 0);
            let [low, high] = [(low, -SEARCH_RADIUS), (high, SEARCH_RADIUS)]
                .map(|(p, margin)| p.map(|c| c + margin));
            grid.visit_box(low, high, |i| {
                let known_squares = min_squares
                    .each_ref()
                    .map(|squares| f64::from_bits(squares[i].load(Relaxed)));
                let mut max_square = 0f64;
                for k in 0..2 {
                    max_square = if is_in_set[k] {
                        max_square.max(known_squares[k])
                    } else {
                        max_square
                    };
                }
                let p = grid.position(i).map(f64::from);
                let height = dot(normal, sub(to_3d(p), a));
                if height * height > squared_normal * max_square.min(SEARCH_RADIUS * SEARCH_RADIUS)
                {
                    return;
                }
                let square = squared_distance_to_face(p, shape);
                if square > SEARCH_RADIUS * SEARCH_RADIUS {
                    return;
                }
                for k in 0..2 {
                    if is_in_set[k] && square < known_squares[k] {
                        min_squares[k][i].fetch_min(square.to_bits(), Relaxed);
                    }
                }
            });
        };
        let count = self.shapes.len();
        (0..count.div_ceil(ITEMS_PER_TASK))
            .into_par_iter()
            .for_each(|chunk| {
                if !cancel.is_cancelled() {
                    (chunk * ITEMS_PER_TASK..count.min((chunk + 1) * ITEMS_PER_TASK))
                        .for_each(visit_face);
                }
            });
        min_squares.map(|sorted_squares| {
            let mut squares = vec![f64::INFINITY; points.len()];
            for (&i, square) in grid.order().iter().zip(sorted_squares) {
                squares[i as usize] = f64::from_bits(square.into_inner());
            }
            squares
        })
    }

    /// Searches the nearest face of each set, closer than `limit`, for all points that have none
    /// yet.
    fn search_from_points(
        &self,
        points: &[[f32; D]],
        queried_sets: [u8; 2],
        limit: f64,
        squares: &mut [Vec<f64>; 2],
        cancel: &CancelToken<'_>,
    ) {
        let mut tree = None;
        for (set, squares) in queried_sets.into_iter().zip(squares) {
            let exists = self.sets.iter().any(|s| s & set != 0);
            if !exists || squares.iter().all(|square| square.is_finite()) {
                continue;
            }
            let tree = tree.get_or_insert_with(|| BoxTree::new(&self.boxes, &self.sets));
            let chunks = points
                .par_chunks(ITEMS_PER_TASK)
                .zip(squares.par_chunks_mut(ITEMS_PER_TASK));
            chunks.for_each(|(points, squares)| {
                let mut hint = None;
                for (p, square) in points.iter().zip(squares) {
                    if square.is_finite() || cancel.is_cancelled() {
                        continue;
                    }
                    let p = p.map(f64::from);
                    let square_to = |f: usize| squared_distance_to_face(p, &self.shapes[f]);
                    let nearest = tree.nearest(p, set, limit * limit, hint, square_to);
                    hint = nearest.map(|(f, _)| f);
                    *square = nearest.map_or(f64::INFINITY, |(_, square)| square);
                }
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::{partition_range, run_threads};
    use crate::geometry::random::Random;
    use crate::mesh::TetMesh;

    /// Returns the distances that a single rank computes, and asserts that several ranks compute
    /// the same.
    fn to_faces(
        nodes: &[[f64; 3]],
        faces: &[[u32; 3]],
        sets: &[u8],
        points: &[[f32; 3]],
        queried_sets: [u8; 2],
        cancel: &CancelToken<'_>,
    ) -> [Vec<f64>; 2] {
        let surface_of = |faces: &[[u32; 3]], sets: &[u8]| MeshFaces {
            nodes,
            faces: faces.to_vec(),
            sets: sets.to_vec(),
        };
        let (surface, empty_mesh) = (surface_of(faces, sets), TetMesh::default());
        let view = MeshView::from_mesh(&empty_mesh);
        let expected = distances_to_faces(&view, &surface, points, queried_sets, cancel).unwrap();
        // Points are distributed by position, so that not all ranks have points near all faces.
        let mut order: Vec<usize> = (0..points.len()).collect();
        order.sort_by(|&i, &j| points[i][0].total_cmp(&points[j][0]));
        for count in [2, 7] {
            run_threads(count, |comm| {
                let local_range = |total: usize| partition_range(total, comm.rank(), count);
                let local_points = &order[local_range(points.len())];
                let positions: Vec<[f32; 3]> = local_points.iter().map(|&i| points[i]).collect();
                let local_faces = local_range(faces.len());
                let surface = surface_of(&faces[local_faces.clone()], &sets[local_faces]);
                let view = MeshView::from_cells(&empty_mesh, 0, [0; 2], comm);
                let distances =
                    distances_to_faces(&view, &surface, &positions, queried_sets, cancel).unwrap();
                for (local_distances, expected) in distances.into_iter().zip(&expected) {
                    assert!(
                        local_distances
                            .into_iter()
                            .eq(local_points.iter().map(|&i| expected[i]))
                    );
                }
            });
        }
        expected
    }

    /// Random triangles, some of them flat, of set 1, 2 or both, with points among them and far
    /// away.
    #[test]
    fn distances_are_those_of_a_scan() {
        let mut random = Random::new(5);
        let mut point = |size: f64| -> [f64; 3] { std::array::from_fn(|_| size * random.draw()) };
        let mut nodes = Vec::new();
        for f in 0..120 {
            let origin = point(12.0);
            for _ in 0..3 {
                let offset = point(if f % 7 == 0 { 0.0 } else { 3.0 });
                nodes.push(std::array::from_fn(|k| origin[k] + offset[k]));
            }
        }
        let faces: Vec<[u32; 3]> = (0..120).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
        let sets: Vec<u8> = (0..120).map(|f| [3, 3, 1, 2][f % 4]).collect();
        let points: Vec<[f32; 3]> = (0..6000)
            .map(|_| point(19.0).map(|c| (c - 3.0) as f32))
            .collect();
        let never = CancelToken::never();
        for queried_sets in [[1, 2], [2, 4]] {
            let distances = to_faces(&nodes, &faces, &sets, &points, queried_sets, &never);
            for (set_distances, set) in distances.into_iter().zip(queried_sets) {
                let set_faces: Vec<_> = (faces.iter().zip(&sets))
                    .filter(|(_, s)| **s & set != 0)
                    .map(|(f, _)| f.map(|n| nodes[n as usize]))
                    .collect();
                let mut close = 0;
                for (distance, p) in set_distances.iter().zip(&points) {
                    let p = p.map(f64::from);
                    let squares = set_faces.iter().map(|f| squared_distance_to_face(p, f));
                    assert_eq!(*distance, squares.fold(f64::INFINITY, f64::min).sqrt());
                    close += usize::from(*distance <= SEARCH_RADIUS);
                }
                let expected_range = if set == 4 { 0..1 } else { 500..5500 };
                assert!(expected_range.contains(&close), "{close}");
            }
        }
        let distances_of = |points: &[[f32; 3]]| to_faces(&[], &[], &[], points, [1, 2], &never);
        assert_eq!(
            distances_of(&[[0.0; 3]]),
            [[f64::INFINITY], [f64::INFINITY]]
        );
        assert!(distances_of(&[])[0].is_empty());
    }
}

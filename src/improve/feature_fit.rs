//! Moves nodes on features so that faces lie on the features on average.
//!
//! If the nodes of faces lie on a curved feature, the faces cut off its bulges, and a body that the feature
//! encloses is too small: by a quarter for a ball whose radius is 1.25 times the length of edges. Therefore the
//! faces are fitted, and not the nodes, as in [`regions`](super::regions). Sample points on each face look for
//! the tangent plane of the nearest feature point along the normal of the face. A node moves to where the sum of
//! the squares of these distances, over the faces around it, is smallest.
//!
//! No move makes an angle worse that is outside of the target range, or moves an angle out of that range. The
//! exception is a long move in 3-D, of a node far from where it has to be: it may leave angles down to 25 degrees.

use crate::feature::FeaturePoint;
use crate::geometry::cell_list::CellList;
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{distance2, dot, norm, normal, sorted_distinct, sub, unit};
use crate::improve::node_moves::{MoveEquations, MovingNode, mean_offsets};
use crate::lattice::AtomKind;
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Number of moves of each node.
const SWEEPS: usize = 8;
/// Smallest cosine between the normals of a face and of the feature that it lies on (60 degrees).
const MIN_COSINE: f64 = 0.5;
/// Smallest move, as a share of the shortest edge of a node, that is made.
const MIN_MOVE_RATIO: f64 = 1e-4;
/// Smallest angle, in degrees, that a long move may leave. With 30 degrees, a blurred ball of radius 10 loses 8 % of
/// its volume in cells of 8 samples, with 25 degrees 0.8 %.
const MIN_FITTED_ANGLE: f64 = 25.0;
/// Smallest length of such a move, as a share of the shortest edge of the node.
const MIN_LONG_MOVE_RATIO: f64 = 0.05;
/// Number of parts into which an edge of a face is divided by its sample points.
const PARTS_PER_EDGE: usize = 5;

/// Input of the fit of faces to features.
#[derive(Debug, Clone, Copy)]
pub struct FeatureFit<'a, const D: usize> {
    /// Points on the features.
    pub points: &'a [FeaturePoint<D>],
    /// Faces on features of each cell: bit k for face k.
    pub marks: &'a [u8],
    /// Adjacent cell for every cell and face, in order.
    pub neighbours: &'a [u32],
    /// Kind of each node.
    pub kinds: &'a [AtomKind],
    /// Far corner of the box.
    pub extent: [f64; D],
    /// Largest distance, in lattice units, from a face to its feature.
    pub reach: f64,
    /// Target for the smallest angle, in degrees; the largest angle is 180 degrees less this.
    pub min_angle: f64,
}

/// A face on a feature, with the mean distance of the feature around each of its nodes.
struct FittedFace<const D: usize> {
    nodes: [u32; D],
    normal: [f64; D],
    area: f64,
    /// Distance along the normal, and the share of the sample points that found the feature.
    offsets: [(f64, f64); D],
}

/// Moves the nodes of faces on features so that these lie on the features on average.
pub fn fit_feature_faces<const D: usize, M: Simplices<D>>(
    mesh: &mut M,
    fit: &FeatureFit<'_, D>,
    cancel: &CancelToken<'_>,
) {
    let faces = fit.faces();
    if faces.is_empty() || fit.points.is_empty() {
        return;
    }
    let corners = mesh.connectivity();
    let (start, slots) = sort_by_group(mesh.nodes().len(), corners.iter().map(|&n| n as usize));
    let star_cells: Vec<u32> = slots.iter().map(|slot| slot / (D as u32 + 1)).collect();
    let star = |n: u32| &star_cells[start[n as usize] as usize..start[n as usize + 1] as usize];
    let nodes_of_face = |&(c, k): &(u32, u32)| mesh.face(c as usize, k as usize);
    let nodes = sorted_distinct(faces.iter().flat_map(nodes_of_face));
    let mut index_of_node = vec![0; mesh.nodes().len()];
    for (i, &n) in nodes.iter().enumerate() {
        index_of_node[n as usize] = i;
    }
    let positions: Vec<[f64; D]> = fit
        .points
        .iter()
        .map(|p| p.position.map(f64::from))
        .collect();
    let cells = CellList::new(&positions, 0.5 * fit.reach);
    let weights = sample_weights::<D>();
    for _ in 0..SWEEPS {
        if cancel.is_cancelled() {
            return;
        }
        let measured: Vec<FittedFace<D>> = (faces.par_iter())
            .map(|&(c, k)| {
                let nodes = mesh.face(c as usize, k as usize);
                fit.measure_face(
                    nodes,
                    nodes.map(|n| mesh.nodes()[n as usize]),
                    &cells,
                    &weights,
                )
            })
            .collect();
        let mut equations = vec![MoveEquations::<D>::default(); nodes.len()];
        for face in &measured {
            for (&n, &(offset, confidence)) in face.nodes.iter().zip(&face.offsets) {
                equations[index_of_node[n as usize]].add(
                    face.normal,
                    offset,
                    confidence * face.area,
                );
            }
        }
        for (&n, equation) in nodes.iter().zip(&equations) {
            if let Some(displacement) = fit.allowed_move(mesh.nodes()[n as usize], n, equation) {
                fit.try_move(mesh, n, displacement, star(n));
            }
        }
    }
}

impl<const D: usize> FeatureFit<'_, D> {
    /// Returns the faces on features inside of the mesh, once each: a cell and the index of the face in it.
    fn faces(&self) -> Vec<(u32, u32)> {
        let is_listed = |&(c, k): &(u32, u32)| {
            let neighbour = self.neighbours[(D + 1) * c as usize + k as usize];
            self.marks[c as usize] >> k & 1 == 1 && neighbour != NONE && c < neighbour
        };
        (0..self.marks.len() as u32)
            .flat_map(|c| (0..=D as u32).map(move |k| (c, k)))
            .filter(is_listed)
            .collect()
    }

    /// Measures a face with corners `x` and its distance from the feature.
    fn measure_face(
        &self,
        nodes: [u32; D],
        x: [[f64; D]; D],
        cells: &CellList<D>,
        weights: &[[f64; D]],
    ) -> FittedFace<D> {
        let scaled_normal = normal(&x);
        let area = norm(scaled_normal);
        let normal = unit(scaled_normal);
        FittedFace {
            nodes,
            normal,
            area,
            offsets: mean_offsets(x, weights.iter().copied(), |point| {
                self.distance_along(point, normal, cells)
            }),
        }
    }

    /// Returns the distance from `x` along the unit vector `along` to the tangent plane of the nearest feature
    /// point whose normal is similar.
    fn distance_along(&self, x: [f64; D], along: [f64; D], cells: &CellList<D>) -> Option<f64> {
        let (mut nearest, mut distance) = (self.reach * self.reach, None);
        cells.visit_within(x, self.reach, |i| {
            let point = &self.points[i];
            let position = point.position.map(f64::from);
            let squared = distance2(&x, &position);
            let normal = point.normal.map(f64::from);
            let cosine = dot(normal, along);
            if squared < nearest && cosine.abs() >= MIN_COSINE {
                nearest = squared;
                distance = Some(dot(normal, sub(position, x)) / cosine);
            }
        });
        distance.filter(|distance| distance.abs() <= self.reach)
    }

    /// Returns the move of node `n` at `x` that solves its equations, within the sides of the box; `None` if the
    /// node is fixed.
    fn allowed_move(&self, x: [f64; D], n: u32, equations: &MoveEquations<D>) -> Option<[f64; D]> {
        if matches!(self.kinds[n as usize], AtomKind::Corner | AtomKind::Fixed) {
            return None;
        }
        equations.solve(std::array::from_fn(|k| {
            x[k] <= 0.0 || x[k] >= self.extent[k]
        }))
    }

    /// Moves a node by the largest fraction of the displacement that the angles around it allow.
    fn try_move<M: Simplices<D>>(
        &self,
        mesh: &mut M,
        n: u32,
        displacement: [f64; D],
        star: &[u32],
    ) {
        let moving = MovingNode {
            node: n,
            star,
            extent: self.extent,
        };
        let (shortest, mut min_sine) = moving.limits(mesh, self.min_angle);
        // In the plane, targets leave enough room for moves.
        if D == 3 && norm(displacement) >= MIN_LONG_MOVE_RATIO * shortest {
            min_sine = min_sine.min(MIN_FITTED_ANGLE.to_radians().sin());
        }
        if norm(displacement) >= MIN_MOVE_RATIO * shortest {
            moving.move_by(mesh, displacement, shortest, min_sine);
        }
    }
}

/// Returns evenly distributed points on a face, as weights of its nodes: the centroids of the small faces into
/// which it is divided that have its orientation.
fn sample_weights<const D: usize>() -> Vec<[f64; D]> {
    let n = PARTS_PER_EDGE;
    let weight = |count: usize| (count as f64 + 1.0 / D as f64) / n as f64;
    let mut points = Vec::new();
    for i in 0..n {
        if D == 2 {
            let t = (i as f64 + 0.5) / n as f64;
            points.push(std::array::from_fn(|k| if k == 0 { 1.0 - t } else { t }));
            continue;
        }
        for j in 0..n - i {
            let counts = [i, j, n - 1 - i - j];
            points.push(std::array::from_fn(|k| weight(counts[k])));
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::add_scaled;

    #[test]
    fn sample_points_of_a_face_have_its_centroid_as_their_mean() {
        fn mean<const D: usize>() -> [f64; D] {
            let points = sample_weights::<D>();
            let sum = points
                .iter()
                .fold([0.0; D], |sum, p| add_scaled(sum, 1.0, *p));
            sum.map(|c| c / points.len() as f64)
        }
        assert!(mean::<2>().iter().all(|c| (c - 0.5).abs() < 1e-12));
        assert!(mean::<3>().iter().all(|c| (c - 1.0 / 3.0).abs() < 1e-12));
        for point in sample_weights::<3>() {
            assert!((point.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }
}

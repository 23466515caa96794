//! Smoothing of a triangulation under the weight of its image (Xu 2016, section 2.3): nodes move
//! towards the centroids of the triangles around them, weighted by how steep the image is there, and
//! edges, but for those on features, are flipped back to Delaunay's, in turns.
//!
//! What the steps (formulas 9 to 12) aim at, for a constant image, is a small energy, the sum over
//! triangles of area times the sum of squared edges: up to a constant both the squared distance of the
//! nodes from all that is in the triangles around them (CVT) and the error of the paraboloid's
//! interpolation (ODT; Chen & Holst 2011). With an image each triangle counts with its weight. The
//! steps take the triangles around a node for given, so where these are far from regular, or the weight
//! changes fast, they may miss; so a step is shortened until the energy falls. Delaunay's flips lower the
//! energy without weights.

use serde::{Deserialize, Serialize};

use crate::Result;
use crate::geometry::counting_sort::sort_by_group;
use crate::image::ScalarField;
use crate::mesh::TriMesh;
use crate::mesh::delaunay::{constrained_plane, delaunay_plane};
use crate::mesh::tri::{SIDES, double_area, squared_sides};
use crate::progress::CancelToken;

/// Where a node goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Scheme {
    /// Centroidal: each node to the weighted centroid of the triangles around it (formula 10)
    Cvt,
    /// Optimal Delaunay: half as far again, to the weighted mean of the midpoints of the edges
    /// opposite it (formula 12)
    Odt,
}

/// How a triangulation is smoothed.
#[derive(Debug, Clone, PartialEq)]
pub struct Relaxation<const D: usize> {
    /// Where nodes go.
    pub scheme: Scheme,
    /// How much each place counts, above zero: see [`weight`].
    pub weight: ScalarField<D>,
    /// Times that all nodes are moved, and edges flipped after them.
    pub rounds: usize,
}

/// Rounds after which little changes, as published.
pub const DEFAULT_ROUNDS: usize = 5;

/// Even ground counts for this share of the mean steepness: formula 10 alone leaves a node on it
/// undecided.
const UNIFORM_WEIGHT_SHARE: f64 = 0.1;

/// The weight of an image's places from their `steepness` (the gradient's magnitude).
pub fn weight<const D: usize>(mut steepness: ScalarField<D>) -> ScalarField<D> {
    let samples = &mut steepness.samples;
    let sum: f64 = samples.iter().map(|&s| f64::from(s)).sum();
    let floor = match UNIFORM_WEIGHT_SHARE * sum / samples.len().max(1) as f64 {
        floor if floor > 0.0 => floor as f32,
        _ => 1.0,
    };
    samples.iter_mut().for_each(|s| *s += floor);
    steepness
}

/// What a round did to the energy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelaxationRound {
    /// Before nodes were moved.
    pub energy_before: f64,
    /// After.
    pub energy_after: f64,
    /// Nodes that moved.
    pub moved_count: usize,
}

/// Halvings of a step that does not lower the energy; then the node stays.
const MAX_HALVINGS: usize = 4;

/// The Delaunay triangulation of points, once smoothed, with the edges `kept` (of one triangulation of
/// them) among its own: without, nodes that come near a curve would take edges on it away. `mobility`
/// says which coordinates of each may change: 1 for free, 0 for held; the ends of kept edges are. When
/// `patience` is over, the others stay where they are.
///
/// # Errors
/// Those of [`constrained_plane`].
pub fn relax(
    mut points: Vec<[f64; 2]>,
    kept: &[[u32; 2]],
    mobility: &[[f64; 2]],
    relaxation: &Relaxation<2>,
    patience: &CancelToken<'_>,
) -> Result<(TriMesh, Vec<RelaxationRound>)> {
    let join = |points: &[[f64; 2]]| match kept {
        [] => delaunay_plane(points),
        kept => constrained_plane(points, kept),
    };
    let mut mesh = join(&points)?;
    let mut rounds = Vec::with_capacity(relaxation.rounds);
    for _ in 0..relaxation.rounds {
        let mut round = RelaxationRound {
            energy_before: energy(&mesh, relaxation),
            energy_after: 0.0,
            moved_count: 0,
        };
        let stars = NodeTriangles::new(&mesh);
        for node in 0..points.len() {
            if !patience.is_cancelled() && mobility[node] != [0.0; 2] {
                let star = stars.get(node);
                round.moved_count +=
                    usize::from(relaxation.move_node(&mut mesh, node, star, mobility[node]));
            }
        }
        round.energy_after = energy(&mesh, relaxation);
        rounds.push(round);
        points = mesh.nodes;
        mesh = join(&points)?;
        if round.moved_count == 0 {
            break;
        }
    }
    Ok((mesh, rounds))
}

/// The energy of a mesh: the sum of its triangles' [`Relaxation::cost`].
pub fn energy(mesh: &TriMesh, relaxation: &Relaxation<2>) -> f64 {
    let corners = (0..mesh.triangles.len()).map(|t| mesh.corners(t));
    corners.map(|p| relaxation.cost(&p)).sum()
}

impl Relaxation<2> {
    /// The weight of a triangle: its mean at the centroid and at those of the three triangles which the
    /// centroid makes with the edges (the thesis's figure 2.3).
    fn triangle_weight(&self, p: &[[f64; 2]; 3]) -> f64 {
        let centroid = |p: [[f64; 2]; 3]| [0, 1].map(|k| (p[0][k] + p[1][k] + p[2][k]) / 3.0);
        let middle = centroid(*p);
        let parts = SIDES.map(|[i, j]| centroid([p[i], p[j], middle]));
        // Interpolation may overshoot below the lowest sample.
        let value = |x: [f64; 2]| self.weight.value(x).max(f64::MIN_POSITIVE);
        0.25 * (value(middle) + parts.map(value).iter().sum::<f64>())
    }

    /// Weight times area times the sum of squared edges; infinite for a triangle that is not positive.
    fn cost(&self, p: &[[f64; 2]; 3]) -> f64 {
        let area2 = double_area(p);
        if area2 <= 0.0 {
            return f64::INFINITY;
        }
        0.5 * area2 * self.triangle_weight(p) * squared_sides(p).iter().sum::<f64>()
    }

    /// Moves one node; whether it moved.
    fn move_node(&self, mesh: &mut TriMesh, node: usize, star: &[u32], mobility: [f64; 2]) -> bool {
        let start = mesh.nodes[node];
        let (mut mass, mut moment, mut cost) = (0.0, [0.0; 2], 0.0);
        for &t in star {
            let p = mesh.corners(t as usize);
            let m = double_area(&p) * self.triangle_weight(&p);
            let opposite = |k: usize| 0.5 * (p[0][k] + p[1][k] + p[2][k] - start[k]);
            mass += m;
            moment[0] += m * opposite(0);
            moment[1] += m * opposite(1);
            cost += self.cost(&p);
        }
        // The centroid of a triangle is two thirds of the way to the middle of the opposite edge.
        let share = match self.scheme {
            Scheme::Cvt => 2.0 / 3.0,
            Scheme::Odt => 1.0,
        };
        let way = [0, 1].map(|k| mobility[k] * share * (moment[k] / mass - start[k]));
        let mut length = 1.0;
        for _ in 0..=MAX_HALVINGS {
            mesh.nodes[node] = [0, 1].map(|k| start[k] + length * way[k]);
            let corners = star.iter().map(|&t| mesh.corners(t as usize));
            let then: f64 = corners.map(|p| self.cost(&p)).sum();
            if then < cost * (1.0 - 1e-12) {
                return true;
            }
            length *= 0.5;
        }
        mesh.nodes[node] = start;
        false
    }
}

/// The triangles around each node.
struct NodeTriangles {
    offsets: Vec<u32>,
    triangles: Vec<u32>,
}

impl NodeTriangles {
    fn new(mesh: &TriMesh) -> Self {
        let corners = mesh.triangles.as_flattened().iter().map(|&n| n as usize);
        let (offsets, corners) = sort_by_group(mesh.nodes.len(), corners);
        let triangles = corners.into_iter().map(|corner| corner / 3).collect();
        Self { offsets, triangles }
    }

    fn get(&self, node: usize) -> &[u32] {
        &self.triangles[self.offsets[node] as usize..self.offsets[node + 1] as usize]
    }
}

#[cfg(test)]
mod tests;

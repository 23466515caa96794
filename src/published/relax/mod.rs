//! Smooths a triangulation with the image as the weight (Xu 2016, section 2.3). Two steps
//! alternate: nodes move towards the centroids of the triangles around them, weighted by the image
//! gradient there; and edges, except those on features, are flipped back to Delaunay's.
//!
//! For a constant image, the moves (formulas 9 to 12) aim at a small energy: the sum over all
//! triangles of the area times the sum of the squared edges. Up to a constant this is both the mean
//! squared distance of the nodes from the points of the triangles around them (CVT) and the error
//! of interpolating a paraboloid (ODT; Chen & Holst 2011). With an image, each triangle counts with
//! its weight. The formulas assume that the triangles around a node stay the same. Where these are
//! far from regular, or the weight changes fast, a move may raise the energy; then it is shortened
//! until the energy falls. Delaunay flips lower the energy without weights.

use serde::{Deserialize, Serialize};

use crate::Result;
use crate::geometry::counting_sort::sort_by_group;
use crate::image::ScalarField;
use crate::mesh::TriMesh;
use crate::mesh::delaunay::{constrained_plane, delaunay_plane};
use crate::mesh::tri::{SIDES, double_area, squared_sides};
use crate::progress::CancelToken;

/// Position to which a node moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Scheme {
    /// Centroidal: each node moves to the weighted centroid of the triangles around it (formula 10)
    Cvt,
    /// Optimal Delaunay: each node moves half as far again, to the weighted mean of the midpoints
    /// of the edges opposite it (formula 12)
    Odt,
}

/// Parameters of the smoothing of a triangulation.
#[derive(Debug, Clone, PartialEq)]
pub struct Relaxation<const D: usize> {
    /// Position to which nodes move.
    pub scheme: Scheme,
    /// Positive weight of each position: see [`weight`].
    pub weight: ScalarField<D>,
    /// Number of times that all nodes are moved and edges flipped afterwards.
    pub rounds: usize,
}

/// Number of rounds after which little changes, as published.
pub const DEFAULT_ROUNDS: usize = 5;

/// Weight that is added everywhere, as a share of the mean gradient magnitude. Without it, formula 10
/// does not determine the position of a node where the image has no gradient.
const UNIFORM_WEIGHT_SHARE: f64 = 0.1;

/// Returns the weight of the positions of an image from its gradient magnitude.
pub fn weight<const D: usize>(mut gradient: ScalarField<D>) -> ScalarField<D> {
    let samples = &mut gradient.samples;
    let sum: f64 = samples.iter().map(|&s| f64::from(s)).sum();
    let uniform_weight = match UNIFORM_WEIGHT_SHARE * sum / samples.len().max(1) as f64 {
        uniform_weight if uniform_weight > 0.0 => uniform_weight as f32,
        _ => 1.0,
    };
    samples.iter_mut().for_each(|s| *s += uniform_weight);
    gradient
}

/// Effect of one round on the energy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelaxationRound {
    /// Energy before nodes are moved.
    pub energy_before: f64,
    /// Energy after nodes are moved.
    pub energy_after: f64,
    /// Number of nodes that moved.
    pub moved_count: usize,
}

/// Largest number of halvings of a step that does not lower the energy. After these the node stays.
const MAX_HALVINGS: usize = 4;

/// Returns the smoothed Delaunay triangulation of points, and the energies of the rounds.
///
/// The triangulation contains the edges `kept_edges`, which must belong to one triangulation of the
/// points. Without this, nodes that come near a curve would remove edges on it. `mobility` has the
/// coordinates of each point that may change: 1 for free, 0 for fixed. The ends of the kept edges
/// must be fixed. If `cancel` is cancelled, the remaining nodes stay where they are.
///
/// # Errors
/// Returns the errors of [`delaunay_plane`] or, with kept edges, of [`constrained_plane`].
pub fn relax(
    mut points: Vec<[f64; 2]>,
    kept_edges: &[[u32; 2]],
    mobility: &[[f64; 2]],
    relaxation: &Relaxation<2>,
    cancel: &CancelToken<'_>,
) -> Result<(TriMesh, Vec<RelaxationRound>)> {
    let triangulate = |points: &[[f64; 2]]| match kept_edges {
        [] => delaunay_plane(points),
        kept_edges => constrained_plane(points, kept_edges),
    };
    let mut mesh = triangulate(&points)?;
    let mut rounds = Vec::with_capacity(relaxation.rounds);
    for _ in 0..relaxation.rounds {
        let mut round = RelaxationRound {
            energy_before: energy(&mesh, relaxation),
            energy_after: 0.0,
            moved_count: 0,
        };
        let stars = NodeTriangles::new(&mesh);
        for node in 0..points.len() {
            if !cancel.is_cancelled() && mobility[node] != [0.0; 2] {
                let star = stars.get(node);
                round.moved_count +=
                    usize::from(relaxation.move_node(&mut mesh, node, star, mobility[node]));
            }
        }
        round.energy_after = energy(&mesh, relaxation);
        rounds.push(round);
        points = mesh.nodes;
        mesh = triangulate(&points)?;
        if round.moved_count == 0 {
            break;
        }
    }
    Ok((mesh, rounds))
}

/// Returns the energy of a mesh: the sum of the costs of its triangles.
pub fn energy(mesh: &TriMesh, relaxation: &Relaxation<2>) -> f64 {
    let corners = (0..mesh.triangles.len()).map(|t| mesh.corners(t));
    corners.map(|p| relaxation.cost(&p)).sum()
}

impl Relaxation<2> {
    /// Returns the weight of a triangle: the mean at its centroid and at the centroids of the three
    /// triangles that its centroid forms with its edges (figure 2.3 of the thesis).
    fn triangle_weight(&self, p: &[[f64; 2]; 3]) -> f64 {
        let centroid = |p: [[f64; 2]; 3]| [0, 1].map(|k| (p[0][k] + p[1][k] + p[2][k]) / 3.0);
        let middle = centroid(*p);
        let parts = SIDES.map(|[i, j]| centroid([p[i], p[j], middle]));
        // Interpolation may undershoot the smallest sample.
        let value = |x: [f64; 2]| self.weight.value(x).max(f64::MIN_POSITIVE);
        0.25 * (value(middle) + parts.map(value).iter().sum::<f64>())
    }

    /// Returns weight times area times the sum of squared edges; infinity for a triangle whose area
    /// is not positive.
    fn cost(&self, p: &[[f64; 2]; 3]) -> f64 {
        let area2 = double_area(p);
        if area2 <= 0.0 {
            return f64::INFINITY;
        }
        0.5 * area2 * self.triangle_weight(p) * squared_sides(p).iter().sum::<f64>()
    }

    /// Moves one node. Returns `true` if it moved.
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
        let factor = match self.scheme {
            Scheme::Cvt => 2.0 / 3.0,
            Scheme::Odt => 1.0,
        };
        let step = [0, 1].map(|k| mobility[k] * factor * (moment[k] / mass - start[k]));
        let mut fraction = 1.0;
        for _ in 0..=MAX_HALVINGS {
            mesh.nodes[node] = [0, 1].map(|k| start[k] + fraction * step[k]);
            let corners = star.iter().map(|&t| mesh.corners(t as usize));
            let new_cost: f64 = corners.map(|p| self.cost(&p)).sum();
            if new_cost < cost * (1.0 - 1e-12) {
                return true;
            }
            fraction *= 0.5;
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

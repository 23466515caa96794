//! Moves of nodes that fit the faces around them to a surface.
//!
//! Each face says how far the surface is along its normal. A node moves to where the sum of the squares of these
//! distances, over the faces around it, is smallest, or a part of the way there if angles allow no more.

use crate::geometry::{add_scaled, norm, sub};
use crate::mesh::Simplices;

/// Damping of moves in directions that no face determines, as a share of the trace of the
/// equations.
const DAMPING: f64 = 0.02;
/// Largest move of a node at a time, as a share of its shortest edge.
const MAX_MOVE_RATIO: f64 = 0.25;
/// Fractions of a move that are tried.
const STEP_FRACTIONS: [f64; 4] = [1.0, 0.5, 0.25, 0.1];

/// Least-squares equations of the move of a node, as its faces give them.
#[derive(Debug, Clone, Copy)]
pub(super) struct MoveEquations<const D: usize> {
    pub matrix: [[f64; D]; D],
    rhs: [f64; D],
}

impl<const D: usize> Default for MoveEquations<D> {
    fn default() -> Self {
        Self {
            matrix: [[0.0; D]; D],
            rhs: [0.0; D],
        }
    }
}

impl<const D: usize> MoveEquations<D> {
    /// Adds the equation that the node moves by `offset` along a normal.
    pub fn add(&mut self, normal: [f64; D], offset: f64, weight: f64) {
        for i in 0..D {
            for j in 0..D {
                self.matrix[i][j] += weight * normal[i] * normal[j];
            }
            self.rhs[i] += weight * normal[i] * offset;
        }
    }

    /// Returns the least-squares move along the axes that are not fixed.
    pub fn solve(mut self, is_fixed: [bool; D]) -> Option<[f64; D]> {
        let trace: f64 = (0..D).map(|i| self.matrix[i][i]).sum();
        if trace <= 0.0 {
            return None;
        }
        for i in 0..D {
            self.matrix[i][i] += DAMPING * trace;
            if is_fixed[i] {
                for j in 0..D {
                    self.matrix[i][j] = 0.0;
                    self.matrix[j][i] = 0.0;
                }
                self.matrix[i][i] = 1.0;
                self.rhs[i] = 0.0;
            }
        }
        // The matrix is positive definite, so elimination needs no pivots.
        let (mut a, mut b) = (self.matrix, self.rhs);
        for i in 0..D {
            for j in i + 1..D {
                let factor = a[j][i] / a[i][i];
                for k in i..D {
                    a[j][k] -= factor * a[i][k];
                }
                b[j] -= factor * b[i];
            }
        }
        for i in (0..D).rev() {
            for j in i + 1..D {
                b[i] -= a[i][j] * b[j];
            }
            b[i] /= a[i][i];
        }
        b.iter().all(|c| c.is_finite()).then_some(b)
    }
}

/// Returns for each node of a face with corners `x` the mean distance of the surface around it, and the share of
/// the sample points that found the surface. `weights` has the sample points as weights of the nodes, and
/// `distance` looks for the surface from one of them.
pub(super) fn mean_offsets<const D: usize>(
    x: [[f64; D]; D],
    weights: impl IntoIterator<Item = [f64; D]>,
    distance: impl Fn([f64; D]) -> Option<f64>,
) -> [(f64, f64); D] {
    let mut sums = [(0.0, 0.0, 0.0); D];
    for weights in weights {
        let mut point = [0.0; D];
        for (weight, corner) in weights.iter().zip(&x) {
            point = add_scaled(point, *weight, *corner);
        }
        let distance = distance(point);
        for (sum, weight) in sums.iter_mut().zip(weights) {
            sum.2 += weight;
            if let Some(distance) = distance {
                sum.0 += weight * distance;
                sum.1 += weight;
            }
        }
    }
    sums.map(|(distance_sum, found_weight, total_weight)| {
        let mean = distance_sum / f64::max(found_weight, 1e-12);
        (mean, found_weight / total_weight)
    })
}

/// A node that may move, and the cells around it.
#[derive(Debug, Clone, Copy)]
pub(super) struct MovingNode<'a, const D: usize> {
    pub node: u32,
    pub star: &'a [u32],
    /// Far corner of the box.
    pub extent: [f64; D],
}

impl<const D: usize> MovingNode<'_, D> {
    /// Returns the length of the shortest edge at the node, and the smallest sine of an angle around it, at most
    /// that of `min_angle` degrees.
    pub fn limits<M: Simplices<D>>(&self, mesh: &M, min_angle: f64) -> (f64, f64) {
        let x = mesh.nodes()[self.node as usize];
        let (mut shortest, mut min_sine) = (f64::INFINITY, min_angle.to_radians().sin());
        for &c in self.star {
            min_sine = min_sine.min(mesh.min_sine(c as usize));
            for &m in mesh.cell(c as usize).iter().filter(|m| **m != self.node) {
                shortest = shortest.min(norm(sub(mesh.nodes()[m as usize], x)));
            }
        }
        (shortest, min_sine)
    }

    /// Moves the node by the largest fraction of the displacement after which no sine of an angle around it is
    /// below `min_sine`.
    pub fn move_by<M: Simplices<D>>(
        &self,
        mesh: &mut M,
        displacement: [f64; D],
        shortest_edge: f64,
        min_sine: f64,
    ) {
        let n = self.node as usize;
        let x = mesh.nodes()[n];
        let scale = (MAX_MOVE_RATIO * shortest_edge / norm(displacement)).min(1.0);
        for fraction in STEP_FRACTIONS {
            let mut trial = add_scaled(x, scale * fraction, displacement);
            for k in 0..D {
                trial[k] = trial[k].clamp(0.0, self.extent[k]);
            }
            mesh.parts_mut().0[n] = trial;
            let star = self.star.iter();
            if star.copied().all(|c| mesh.min_sine(c as usize) >= min_sine) {
                return;
            }
        }
        mesh.parts_mut().0[n] = x;
    }
}

//! Max-min smoothing: moves a node to where the smallest angle around it is largest.

use super::TriImprover;
use crate::geometry::{dot, to_3d};
use crate::mesh::tri::{SIDES, worst_cotangent};

/// Number of directions in which a node tries to move.
const DIRECTION_COUNT: u32 = 30;

impl TriImprover<'_> {
    /// Moves a node to where the smallest angle around it is largest; a node on a curve moves along
    /// it only. Returns `true` if the node moved.
    pub(super) fn smooth(&mut self, node: u32) -> bool {
        let i = node as usize;
        let mut constraint = self.constraints[i];
        if constraint.fixed_axes == 7 || constraint.surface_count > 1 {
            return false;
        }
        self.gather_star(node);
        let link: Vec<[[f64; 2]; 2]> = self
            .star
            .iter()
            .map(|&t| {
                let triangle = self.triangles[t as usize];
                let k = triangle.iter().position(|&n| n == node).unwrap_or(0);
                SIDES[k].map(|j| self.nodes[triangle[j] as usize])
            })
            .collect();
        let worst = |x: [f64; 2]| {
            let cotangent = |&[u, v]: &[[f64; 2]; 2]| worst_cotangent(&[x, u, v]);
            link.iter().map(cotangent).fold(0.0, f64::max)
        };
        let start = self.nodes[i];
        let (mut x, mut best) = (start, worst(start));
        if best <= self.smoothing_target {
            return false;
        }
        let shortest = link
            .iter()
            .map(|[u, _]| (u[0] - x[0]).hypot(u[1] - x[1]))
            .fold(f64::INFINITY, f64::min);
        let mut step = 0.25 * shortest;
        while step > 0.004 * shortest {
            let mut moved = false;
            for direction in 0..DIRECTION_COUNT {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(direction)
                    / f64::from(DIRECTION_COUNT))
                .sin_cos();
                let displacement = constraint.freedom().project([step * cos, step * sin, 0.0]);
                // A direction that projection shortens too much is skipped; other directions serve.
                if dot(displacement, displacement) < 0.25 * step * step {
                    continue;
                }
                let mut trial = constraint;
                let target: [f64; 3] = std::array::from_fn(|k| {
                    (to_3d(x)[k] + displacement[k]).clamp(0.0, to_3d(self.extent)[k])
                });
                let Some([u, v, _]) = trial.snap(target, to_3d(self.extent), self.planes) else {
                    continue;
                };
                let value = worst([u, v]);
                if value < best - 1e-3 {
                    (x, best, constraint, moved) = ([u, v], value, trial, true);
                    break;
                }
            }
            if !moved {
                step *= 0.5;
            }
        }
        if x == start {
            return false;
        }
        self.nodes[i] = x;
        self.constraints[i] = constraint;
        self.queue
            .extend(self.star.iter().flat_map(|&t| [(t, 0), (t, 1), (t, 2)]));
        true
    }
}

//! Max-min smoothing: a node goes to where the smallest angle about it is largest.

use super::TriImprover;
use crate::geometry::{dot, to_3d};
use crate::mesh::tri::{SIDES, worst_cotangent};

/// Directions in which a node tries to move.
const DIRECTION_COUNT: u32 = 30;

impl TriImprover<'_> {
    /// Moves a node to where the smallest angle about it is largest; along its curve if it is on one.
    /// Whether it moved.
    pub(super) fn smooth(&mut self, node: u32) -> bool {
        let i = node as usize;
        let mut hold = self.constraints[i];
        if hold.fixed_axes == 7 || hold.surface_count > 1 {
            return false;
        }
        self.gather_star(node);
        let spokes: Vec<[[f64; 2]; 2]> = self
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
            spokes.iter().map(cotangent).fold(0.0, f64::max)
        };
        let start = self.nodes[i];
        let (mut x, mut best) = (start, worst(start));
        if best <= self.smoothing_target {
            return false;
        }
        let shortest = spokes
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
                let along = hold.freedom().project([step * cos, step * sin, 0.0]);
                // A projected direction may have lost its length: the others then serve.
                if dot(along, along) < 0.25 * step * step {
                    continue;
                }
                let mut trial = hold;
                let to: [f64; 3] = std::array::from_fn(|k| {
                    (to_3d(x)[k] + along[k]).clamp(0.0, to_3d(self.extent)[k])
                });
                let Some([u, v, _]) = trial.snap(to, to_3d(self.extent), self.planes) else {
                    continue;
                };
                let value = worst([u, v]);
                if value < best - 1e-3 {
                    (x, best, hold, moved) = ([u, v], value, trial, true);
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
        self.constraints[i] = hold;
        self.queue
            .extend(self.star.iter().flat_map(|&t| [(t, 0), (t, 1), (t, 2)]));
        true
    }
}

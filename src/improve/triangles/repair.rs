//! Raises angles by flips and smoothing and, where that is not enough, by collapses, splits and
//! releasing nodes from curves.

use super::TriImprover;
use crate::geometry::hypot;
use crate::mesh::complex::NONE;
use crate::mesh::tri::SIDES;
use crate::progress::CancelToken;

/// Largest number of rounds of smoothing. Every third round also collapses and splits edges.
const MAX_ROUNDS: usize = 24;

impl TriImprover<'_> {
    /// Flips and smooths, and collapses or splits edges where that is not enough.
    pub(super) fn flip_and_smooth(&mut self, cancel: &CancelToken<'_>) {
        self.flip_all(cancel);
        for round in 0..MAX_ROUNDS {
            if self.triangles_below_target().is_empty() {
                return;
            }
            let mut nodes: Vec<u32> = self
                .triangles_above(self.smoothing_target)
                .iter()
                .flat_map(|&t| self.triangles[t as usize])
                .collect();
            if round % 2 == 1 {
                // Moving the neighbours makes room, too.
                for node in nodes.clone() {
                    self.gather_star(node);
                    let around = self.star.iter().flat_map(|&t| self.triangles[t as usize]);
                    nodes.extend(around);
                }
            }
            nodes.sort_unstable();
            nodes.dedup();
            for node in nodes {
                if cancel.is_cancelled() {
                    return;
                }
                if self.smooth(node) {
                    self.counts.moves += 1;
                }
            }
            self.flip_queue(cancel);
            if round % 3 == 2 {
                for t in self.triangles_below_target() {
                    if self.triangles[t as usize][0] != NONE {
                        self.repair_triangle(t);
                    }
                }
                self.flip_queue(cancel);
            }
        }
    }

    /// Releases nodes from their curves where a triangle would stay unusable: one node if that is
    /// enough, else all three.
    pub(super) fn release_nodes(&mut self, cancel: &CancelToken<'_>) {
        for round in 0..4 {
            let bad = self.triangles_above(self.max_usable_cotangent);
            if bad.is_empty() {
                return;
            }
            for t in bad {
                let triangle = self.triangles[t as usize];
                if self.cotangent(triangle) <= self.max_usable_cotangent {
                    continue;
                }
                let constrained: Vec<u32> = triangle
                    .into_iter()
                    .filter(|&n| self.constraints[n as usize].surface_count > 0)
                    .collect();
                let has_freed_node = constrained.iter().any(|&n| self.free_node(n));
                // In the first rounds, flips around single released nodes may be enough for the
                // other triangles.
                if !has_freed_node && round > 1 {
                    self.counts.released += constrained.len();
                    for n in constrained {
                        self.constraints[n as usize].clear_surfaces();
                    }
                }
            }
            self.flip_all(cancel);
            self.flip_and_smooth(cancel);
        }
    }

    /// Releases a node from its curves and smooths it. Undoes this, and returns `false`, if a
    /// triangle at the node is still unusable.
    fn free_node(&mut self, node: u32) -> bool {
        let i = node as usize;
        let (x, constraint) = (self.nodes[i], self.constraints[i]);
        self.constraints[i].clear_surfaces();
        self.smooth(node);
        self.gather_star(node);
        let around = self.star.iter().map(|&t| self.triangles[t as usize]);
        if around.map(|t| self.cotangent(t)).fold(0.0, f64::max) <= self.max_usable_cotangent {
            self.counts.released += 1;
            return true;
        }
        (self.nodes[i], self.constraints[i]) = (x, constraint);
        false
    }

    /// Collapses the shortest edge of a triangle below target, or else splits its longest edge.
    fn repair_triangle(&mut self, t: u32) {
        let current = self.cotangent(self.triangles[t as usize]);
        if current <= self.target_cotangent {
            return;
        }
        let lengths = SIDES.map(|[i, j]| {
            let [p, q] = [i, j].map(|i| self.nodes[self.triangles[t as usize][i] as usize]);
            hypot(p[0] - q[0], p[1] - q[1])
        });
        let find_side = |better: fn(f64, f64) -> bool| {
            (1..3).fold(0, |best, k| {
                if better(lengths[k], lengths[best]) {
                    k
                } else {
                    best
                }
            })
        };
        let (shortest, longest) = (find_side(|a, b| a < b), find_side(|a, b| a > b));
        let [a, b] = SIDES[shortest].map(|i| self.triangles[t as usize][i]);
        if self.collapse(a, b, current) || self.collapse(b, a, current) {
            self.counts.collapses += 1;
            return;
        }
        let [a, b] = SIDES[longest].map(|i| self.triangles[t as usize][i]);
        let [p, q] = [a, b].map(|n| self.nodes[n as usize]);
        let middle = [0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1])];
        if !self.is_on_feature(a, b) && self.split(t, longest, middle, Some(current)) {
            self.counts.insertions += 1;
        }
    }
}

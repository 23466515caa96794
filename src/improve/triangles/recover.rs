//! Removes the edges that pass through a curve, which is the first step of improvement.

use super::{MAX_COTANGENT, TriImprover};
use crate::geometry::{hypot, to_3d};
use crate::improve::constraint::NodeConstraint;
use crate::mesh::tri::worst_cotangent;

/// Largest distance, in units of d, from which the end of an intersecting edge is snapped onto the
/// curve.
const MAX_SNAP_DISTANCE: f64 = 0.5;

/// Largest number of rounds. Removing one intersecting edge may create another.
const MAX_ROUNDS: usize = 6;

impl TriImprover<'_> {
    /// Removes all edges that pass through a curve, as far as possible.
    pub(super) fn recover(&mut self) {
        for round in 0..MAX_ROUNDS {
            let edges = self.intersecting_edges();
            if round == 0 {
                self.counts.intersecting_before = edges.len();
            }
            self.counts.intersecting_left = edges.len();
            if edges.is_empty() {
                return;
            }
            for [a, b] in edges {
                self.remove_intersecting_edge(a, b);
            }
        }
    }

    /// Removes one edge that passes through a curve.
    fn remove_intersecting_edge(&mut self, a: u32, b: u32) {
        let Some((t, k)) = self.find_edge(a, b) else {
            return;
        };
        let Some(point) = self.find_intersection(a, b) else {
            return;
        };
        if self.flip_away(t, k) {
            return;
        }
        // Snap the nearer end onto the curve if its constraints allow it.
        let distance_to = |n: u32| {
            let x = self.nodes[n as usize];
            hypot(x[0] - point[0], x[1] - point[1])
        };
        let nearest = if distance_to(a) < distance_to(b) {
            a
        } else {
            b
        };
        if distance_to(nearest) < MAX_SNAP_DISTANCE * self.distance.value_at(point)
            && self.snap_node(nearest, point)
        {
            self.counts.intersecting_snapped += 1;
        } else if self.split(t, k, point, None) {
            self.counts.intersecting_split += 1;
        }
    }

    /// Flips an edge that passes through a curve, if the other diagonal does not.
    fn flip_away(&mut self, t: u32, k: usize) -> bool {
        if let Some([p, q]) = self.flip_result(t, k)
            && self.cotangent(p).max(self.cotangent(q)) < MAX_COTANGENT
            && self.find_intersection(p[0], p[2]).is_none()
        {
            self.flip(t, k);
            self.counts.intersecting_flipped += 1;
            return true;
        }
        false
    }

    /// Flips edges that pass through a curve, as long as that removes some. Nodes do not move.
    pub(super) fn flip_intersecting_edges(&mut self) {
        for _ in 0..MAX_ROUNDS {
            let mut flipped = false;
            for [a, b] in self.intersecting_edges() {
                if let Some((t, k)) = self.find_edge(a, b)
                    && self.find_intersection(a, b).is_some()
                {
                    flipped |= self.flip_away(t, k);
                }
            }
            if !flipped {
                return;
            }
        }
    }

    /// Returns the edges that pass through a curve.
    pub(super) fn intersecting_edges(&self) -> Vec<[u32; 2]> {
        let intersects = |&[a, b]: &[u32; 2]| self.find_intersection(a, b).is_some();
        self.edges().filter(intersects).collect()
    }

    /// Moves a node that no feature holds to `point` on a curve, if all triangles stay valid.
    fn snap_node(&mut self, node: u32, point: [f64; 2]) -> bool {
        let i = node as usize;
        let old = self.constraints[i];
        let may_move = old.fixed_axes & 3 != 3 && old.allows_move(self.nodes[i], point);
        if old.surface_count > 0 || !may_move {
            return false;
        }
        self.gather_star(node);
        let sound = self.star.iter().all(|&t| {
            let moved = self.triangles[t as usize].map(|n| {
                if n == node {
                    point
                } else {
                    self.nodes[n as usize]
                }
            });
            worst_cotangent(&moved) < MAX_COTANGENT
        });
        if sound {
            self.nodes[i] = point;
            self.constraints[i] =
                NodeConstraint::new(to_3d(point), self.kinds[i], to_3d(self.extent), self.planes).0;
        }
        sound
    }
}

//! Features first: no edge may pass through a curve.

use super::{MAX_COTANGENT, TriImprover};
use crate::geometry::to_3d;
use crate::improve::constraint::NodeConstraint;
use crate::mesh::tri::worst_cotangent;

/// An end of a pierced edge is pulled onto the curve from this far, in units of d.
const MAX_SNAP_DISTANCE: f64 = 0.5;

/// Edges are freed so many times at most: one that is freed may bring another.
const MAX_ROUNDS: usize = 6;

impl TriImprover<'_> {
    /// No edge may pass through a curve.
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

    /// Rids the mesh of an edge that passes through a curve.
    fn remove_intersecting_edge(&mut self, a: u32, b: u32) {
        let Some((t, k)) = self.find_edge(a, b) else {
            return;
        };
        let Some(at) = self.find_intersection(a, b) else {
            return;
        };
        if self.flip_away(t, k) {
            return;
        }
        // The nearer end goes to the curve if it is free to.
        let gap = |n: u32| {
            let x = self.nodes[n as usize];
            (x[0] - at[0]).hypot(x[1] - at[1])
        };
        let near = if gap(a) < gap(b) { a } else { b };
        if gap(near) < MAX_SNAP_DISTANCE * self.distance.value_at(at) && self.snap_node(near, at) {
            self.counts.intersecting_snapped += 1;
        } else if self.split(t, k, at, None) {
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

    /// Flips edges that pass through a curve, as long as that helps; nodes stay.
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

    /// The edges that pass through a curve.
    pub(super) fn intersecting_edges(&self) -> Vec<[u32; 2]> {
        let pierced = |&[a, b]: &[u32; 2]| self.find_intersection(a, b).is_some();
        self.edges().filter(pierced).collect()
    }

    /// Moves a node that no feature holds to `at` on a curve, if all triangles stay sound.
    fn snap_node(&mut self, node: u32, at: [f64; 2]) -> bool {
        let i = node as usize;
        let old = self.constraints[i];
        let kept: Vec<usize> = (0..2).filter(|k| old.fixed_axes >> k & 1 == 1).collect();
        let moves = |k: &usize| self.nodes[i][*k] != at[*k];
        if old.surface_count > 0 || old.fixed_axes & 3 == 3 || kept.iter().any(moves) {
            return false;
        }
        self.gather_star(node);
        let sound = self.star.iter().all(|&t| {
            let moved = self.triangles[t as usize].map(|n| match n == node {
                true => at,
                false => self.nodes[n as usize],
            });
            worst_cotangent(&moved) < MAX_COTANGENT
        });
        if sound {
            self.nodes[i] = at;
            self.constraints[i] =
                NodeConstraint::new(to_3d(at), self.kinds[i], to_3d(self.extent), self.planes).0;
        }
        sound
    }
}

//! Features first: no edge may pass through a curve.

use super::{Improver, STEEPEST};
use crate::geometry::in_space;
use crate::improve::hold::Hold;
use crate::mesh::tri::worst_cotangent;

/// An end of a pierced edge is pulled onto the curve from this far, in units of d.
const SNAP: f64 = 0.5;

/// Edges are freed so many times at most: one that is freed may bring another.
const ROUNDS: usize = 6;

impl Improver<'_> {
    /// No edge may pass through a curve.
    pub(super) fn recover(&mut self) {
        for round in 0..ROUNDS {
            let edges = self.pierced_edges();
            if round == 0 {
                self.counts.pierced_before = edges.len();
            }
            self.counts.pierced_left = edges.len();
            if edges.is_empty() {
                return;
            }
            for [a, b] in edges {
                self.free_edge(a, b);
            }
        }
    }

    /// Rids the mesh of an edge that passes through a curve.
    fn free_edge(&mut self, a: u32, b: u32) {
        let Some((t, k)) = self.find_edge(a, b) else {
            return;
        };
        let Some(at) = self.pierced(a, b) else { return };
        if self.flip_away(t, k) {
            return;
        }
        // The nearer end goes to the curve if it is free to.
        let gap = |n: u32| {
            let x = self.nodes[n as usize];
            (x[0] - at[0]).hypot(x[1] - at[1])
        };
        let near = if gap(a) < gap(b) { a } else { b };
        if gap(near) < SNAP * self.distance.at(at) && self.snap(near, at) {
            self.counts.pierced_snapped += 1;
        } else if self.split(t, k, at, None) {
            self.counts.pierced_split += 1;
        }
    }

    /// Flips an edge that passes through a curve, if the other diagonal does not.
    fn flip_away(&mut self, t: u32, k: usize) -> bool {
        if let Some([p, q]) = self.flipped(t, k)
            && self.cotangent(p).max(self.cotangent(q)) < STEEPEST
            && self.pierced(p[0], p[2]).is_none()
        {
            self.flip(t, k);
            self.counts.pierced_flipped += 1;
            return true;
        }
        false
    }

    /// Flips edges that pass through a curve, as long as that helps; nodes stay.
    pub(super) fn flip_off_curves(&mut self) {
        for _ in 0..ROUNDS {
            let mut flipped = false;
            for [a, b] in self.pierced_edges() {
                if let Some((t, k)) = self.find_edge(a, b)
                    && self.pierced(a, b).is_some()
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
    pub(super) fn pierced_edges(&self) -> Vec<[u32; 2]> {
        let pierced = |&[a, b]: &[u32; 2]| self.pierced(a, b).is_some();
        self.edges().filter(pierced).collect()
    }

    /// Moves a node that no feature holds to `at` on a curve, if all triangles stay sound.
    fn snap(&mut self, node: u32, at: [f64; 2]) -> bool {
        let i = node as usize;
        let old = self.holds[i];
        let kept: Vec<usize> = (0..2).filter(|k| old.axes >> k & 1 == 1).collect();
        let moves = |k: &usize| self.nodes[i][*k] != at[*k];
        if old.count > 0 || old.axes & 3 == 3 || kept.iter().any(moves) {
            return false;
        }
        self.gather(node);
        let sound = self.star.iter().all(|&t| {
            let moved = self.triangles[t as usize].map(|n| match n == node {
                true => at,
                false => self.nodes[n as usize],
            });
            worst_cotangent(&moved) < STEEPEST
        });
        if sound {
            self.nodes[i] = at;
            self.holds[i] = Hold::new(
                in_space(at),
                self.kinds[i],
                in_space(self.extent),
                self.sheets,
            )
            .0;
        }
        sound
    }
}

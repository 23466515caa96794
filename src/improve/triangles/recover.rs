//! Features first: no edge may pass through a curve.

use super::{Improver, STEEPEST};
use crate::geometry::in_space;
use crate::improve::hold::Hold;
use crate::mesh::complex::NONE;
use crate::mesh::tri::{SIDES, worst_cotangent};

/// An end of a pierced edge is pulled onto the curve from this far, in units of d.
const SNAP: f64 = 0.5;

impl Improver<'_> {
    /// No edge may pass through a curve.
    pub(super) fn recover(&mut self) {
        for round in 0..6 {
            let mut edges = Vec::new();
            for t in self.alive() {
                for k in 0..3 {
                    let [a, b] = SIDES[k].map(|i| self.triangles[t as usize][i]);
                    let once = a < b || self.neighbors[t as usize][k] == NONE;
                    if once && self.pierced(a, b).is_some() {
                        edges.push([a, b]);
                    }
                }
            }
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
        if let Some([p, q]) = self.flipped(t, k)
            && self.cotangent(p).max(self.cotangent(q)) < STEEPEST
            && self.pierced(p[0], p[2]).is_none()
        {
            self.flip(t, k);
            self.counts.pierced_flipped += 1;
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

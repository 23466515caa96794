//! Joe's local transformations, generalised: edge removal (3-2, 4-4, 2-2 and larger) by dynamic
//! programming over the ring (Klincsek 1980; Shewchuk 2002), and the 2-3 swap that creates an edge.
//!
//! A flip is applied only if the smallest sine of its tetrahedra rises, and never if a new edge
//! would pass through a feature: as long as no edge does, every feature surface is a union of mesh
//! faces.
//!
//! ```text
//! edge removal, seen from b along the edge (a, b), whose ring has m nodes: each triangle of the
//! polygon becomes one tetrahedron with a and one with b, 2 (m - 2) in all
//!
//!     r2            r2        r3----r2      r3----r2         r1            r1
//!    /| \          /  \        | \/ |        |   /|         /|\           /  \
//!   / ab \   ->   /    \       | ab |   ->   | /  |        / | \    ->   /    \
//!  / /  \ \      /      \      | /\ |        |/   |       /  |  \       /      \
//! r0------r1    r0------r1    r0----r1      r0----r1    r2--ab--r0     r2------r0
//! 3-2                         4-4                       2-2: a, b, r2, r0 on a side of the box
//!
//! 2-3 swap: (u, v, w, p), (u, w, v, q) -> (q, p, u, v), (q, p, v, w), (q, p, w, u)
//! ```

use super::{ConstrainedPoint, TetImprover};
use crate::mesh::complex::{NONE, Ring};
use crate::mesh::quality::min_sine;
use crate::mesh::{EDGES, FACES};

/// Largest ring that edge removal considers.
const MAX_RING: usize = 10;

/// Smallest gain in sine of a flip. It is well above rounding errors, so that no two configurations
/// alternate endlessly.
const MIN_SINE_GAIN: f64 = 1e-5;

/// A local transformation: the tetrahedra that are removed, and those that take their place.
#[derive(Debug, Default)]
pub(super) struct Flip {
    pub old_tets: Vec<u32>,
    pub new_tets: Vec<[u32; 4]>,
    pub ring: Ring,
}

impl TetImprover<'_> {
    /// Tries every transformation of one tetrahedron and applies the first that helps.
    pub(super) fn flip(&mut self, t: u32) -> bool {
        self.apply_found(|s, flip| s.find_flip(t, flip), None)
    }

    /// Finds the first transformation of one tetrahedron that helps. Returns `false` if none does.
    pub(super) fn find_flip(&self, t: u32, flip: &mut Flip) -> bool {
        let (tet, sine) = (self.complex.tets[t as usize], self.sine_of(t));
        let mut edges = EDGES.iter().map(|e| e.map(|i| tet[i]));
        edges.any(|[a, b]| self.find_edge_removal(t, [a, b], sine, flip))
            || (0..4).any(|k| self.find_face_swap(t, k, flip))
    }

    /// Applies the transformation that `find` returns, if any; it may insert the node `new_node`.
    pub(super) fn apply_found(
        &mut self,
        find: impl FnOnce(&Self, &mut Flip) -> bool,
        new_node: Option<ConstrainedPoint>,
    ) -> bool {
        let mut flip = std::mem::take(&mut self.candidate_flip);
        let is_found = find(self, &mut flip);
        if is_found {
            self.apply(&flip.old_tets, &flip.new_tets, new_node);
        }
        self.candidate_flip = flip;
        is_found
    }

    /// Exchanges `old_tets` for `new_tets`, in which the inserted node is `NONE`.
    pub(super) fn apply(
        &mut self,
        old_tets: &[u32],
        new_tets: &[[u32; 4]],
        new_node: Option<ConstrainedPoint>,
    ) {
        let mut node_id = NONE;
        if let Some((x, constraint)) = new_node {
            node_id = self.complex.add_node(x);
            self.constraints.push(constraint);
            self.moved_nodes.push(node_id);
        }
        let number = |n: u32| if n == NONE { node_id } else { n };
        self.new_tets.clear();
        self.new_tets
            .extend(new_tets.iter().map(|tet| tet.map(number)));
        self.commit(old_tets);
    }

    /// Returns the smallest sine of a tetrahedron with these nodes.
    fn sine_of_nodes(&self, tet: [u32; 4]) -> f64 {
        min_sine(&tet.map(|i| self.complex.nodes[i as usize]))
    }

    /// Finds the removal of edge (a, b) of tetrahedron `t`. Every new tetrahedron must be better
    /// than the worst of the old ones (or than `floor`, if that is lower).
    pub(super) fn find_edge_removal(
        &self,
        t: u32,
        [a, b]: [u32; 2],
        floor: f64,
        flip: &mut Flip,
    ) -> bool {
        let Flip {
            old_tets,
            new_tets,
            ring,
        } = flip;
        if !self.complex.ring(t, a, b, MAX_RING, ring) {
            return false;
        }
        let worst = (ring.tets.iter())
            .map(|&t| self.sine_of(t))
            .fold(f64::INFINITY, f64::min);
        old_tets.clone_from(&ring.tets);
        self.fill_ring(ring, [a, b], worst.min(floor) + MIN_SINE_GAIN, new_tets)
    }

    /// Finds tetrahedra above `floor` that fill the ring of an edge without the edge.
    fn fill_ring(
        &self,
        ring: &Ring,
        [a, b]: [u32; 2],
        floor: f64,
        new_tets: &mut Vec<[u32; 4]>,
    ) -> bool {
        let r = &ring.nodes;
        let m = r.len();
        if m < 3 || (!ring.is_closed && !self.is_in_side(&[a, b, r[0], r[m - 1]])) {
            return false;
        }
        // best[i][j] is the largest smallest sine of a triangulation of the polygon i..=j.
        let mut best = [[f64::INFINITY; MAX_RING + 1]; MAX_RING + 1];
        let mut via = [[0usize; MAX_RING + 1]; MAX_RING + 1];
        let mut is_blocked = [[false; MAX_RING + 1]; MAX_RING + 1];
        // Chords are tested against the features only when the best triangulation uses them, as the
        // test is slow.
        loop {
            for span in 2..m {
                for i in 0..m - span {
                    let j = i + span;
                    best[i][j] = f64::NEG_INFINITY;
                    if is_blocked[i][j] {
                        continue;
                    }
                    for k in i + 1..j {
                        let bound = best[i][k].min(best[k][j]);
                        if bound <= floor || bound <= best[i][j] {
                            continue;
                        }
                        let mut value = bound.min(self.sine_of_nodes([r[i], r[k], r[j], b]));
                        if value > floor && value > best[i][j] {
                            value = value.min(self.sine_of_nodes([r[i], r[j], r[k], a]));
                        }
                        if value > floor && value > best[i][j] {
                            best[i][j] = value;
                            via[i][j] = k;
                        }
                    }
                }
            }
            if best[0][m - 1] <= floor {
                return false;
            }
            new_tets.clear();
            let mut stack = [(0usize, 0usize); MAX_RING + 1];
            stack[0] = (0, m - 1);
            let mut depth = 1;
            let mut has_new_block = false;
            while depth > 0 {
                depth -= 1;
                let (i, j) = stack[depth];
                if j < i + 2 {
                    continue;
                }
                let is_chord = !(i == 0 && j == m - 1 && ring.is_closed);
                if is_chord && self.intersects(r[i], r[j]) {
                    is_blocked[i][j] = true;
                    has_new_block = true;
                    break;
                }
                let k = via[i][j];
                new_tets.push([r[i], r[k], r[j], b]);
                new_tets.push([r[i], r[j], r[k], a]);
                stack[depth] = (i, k);
                stack[depth + 1] = (k, j);
                depth += 2;
            }
            if !has_new_block {
                break;
            }
            if is_blocked[0][m - 1] {
                return false;
            }
        }
        true
    }

    /// Finds the 2-3 swap at face k of `t`, if it helps.
    fn find_face_swap(&self, t: u32, k: usize, flip: &mut Flip) -> bool {
        let Some(n) = self.complex.neighbour(t, k) else {
            return false;
        };
        let tet = self.complex.tets[t as usize];
        let [u, v, w] = FACES[k].map(|i| tet[i]);
        let p = tet[k];
        let back = self.complex.neighbours[n as usize]
            .iter()
            .position(|&x| x == t);
        let Some(back) = back else { return false };
        let q = self.complex.tets[n as usize][back];
        let floor = self.sine_of(t).min(self.sine_of(n)) + MIN_SINE_GAIN;
        self.find_2_3_swap([t, n], [u, v, w], [p, q], floor, flip)
    }

    /// Exchanges two tetrahedra that share face (u, v, w), with apices p (on its positive side) and
    /// q, for the three tetrahedra around the new edge (p, q), if each of these is better than
    /// `floor`.
    pub(super) fn swap_face(
        &mut self,
        old_tets: [u32; 2],
        face: [u32; 3],
        apices: [u32; 2],
        floor: f64,
    ) -> bool {
        let find = |s: &Self, flip: &mut Flip| s.find_2_3_swap(old_tets, face, apices, floor, flip);
        self.apply_found(find, None)
    }

    /// Finds the three tetrahedra around the new edge (p, q) that replace two tetrahedra with the
    /// common face (u, v, w). Each must be better than `floor`.
    fn find_2_3_swap(
        &self,
        old_tets: [u32; 2],
        [u, v, w]: [u32; 3],
        [p, q]: [u32; 2],
        floor: f64,
        flip: &mut Flip,
    ) -> bool {
        flip.old_tets.clear();
        flip.old_tets.extend(old_tets);
        flip.new_tets.clear();
        flip.new_tets
            .extend([[q, p, u, v], [q, p, v, w], [q, p, w, u]]);
        (flip.new_tets.iter()).all(|&f| self.sine_of_nodes(f) > floor) && !self.intersects(p, q)
    }
}

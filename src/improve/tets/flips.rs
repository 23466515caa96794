//! Joe's local transformations, generalised: edge removal (3-2, 4-4, 2-2 and larger) by dynamic
//! programming over the ring (Klincsek 1980; Shewchuk 2002), and the 2-3 swap that makes an edge.
//!
//! A change is made only if the smallest sine of the changed cavity rises, and never if a new edge
//! would pierce a feature: as long as no edge pierces a sheet, the sheet is made of mesh faces.

use super::{ConstrainedPoint, TetImprover};
use crate::mesh::complex::{NONE, Ring};
use crate::mesh::quality::min_sine;
use crate::mesh::{EDGES, FACES};

/// Largest ring that edge removal considers.
const MAX_RING: usize = 10;

/// Least gain in sine: well above rounding, so that no two configurations are exchanged for ever.
const MIN_SINE_GAIN: f64 = 1e-5;

/// A transformation: the tetrahedra that go, and those that take their place.
#[derive(Debug, Default)]
pub(super) struct Flip {
    pub old_tets: Vec<u32>,
    pub new_tets: Vec<[u32; 4]>,
    pub ring: Ring,
}

impl TetImprover<'_> {
    /// Tries every transformation of one tetrahedron and makes the first that helps.
    pub(super) fn flip(&mut self, t: u32) -> bool {
        self.apply_found(|s, found| s.find_flip(t, found), None)
    }

    /// The first transformation of one tetrahedron that helps.
    pub(super) fn find_flip(&self, t: u32, found: &mut Flip) -> bool {
        let (tet, sine) = (self.complex.tets[t as usize], self.sine_of(t));
        let mut edges = EDGES.iter().map(|e| e.map(|i| tet[i]));
        edges.any(|[a, b]| self.find_edge_removal(t, [a, b], sine, found))
            || (0..4).any(|k| self.find_face_swap(t, k, found))
    }

    /// Makes a transformation if there is one, for which a node may come.
    pub(super) fn apply_found(
        &mut self,
        find: impl FnOnce(&Self, &mut Flip) -> bool,
        comes: Option<ConstrainedPoint>,
    ) -> bool {
        let mut found = std::mem::take(&mut self.candidate_flip);
        let any = find(self, &mut found);
        if any {
            self.apply(&found.old_tets, &found.new_tets, comes);
        }
        self.candidate_flip = found;
        any
    }

    /// Exchanges `old` for `fresh`, in which the node that comes is `NONE`.
    pub(super) fn apply(
        &mut self,
        old: &[u32],
        fresh: &[[u32; 4]],
        comes: Option<ConstrainedPoint>,
    ) {
        let mut new = NONE;
        if let Some((x, hold)) = comes {
            new = self.complex.add_node(x);
            self.constraints.push(hold);
            self.moved_nodes.push(new);
        }
        let number = |n: u32| if n == NONE { new } else { n };
        self.new_tets.clear();
        self.new_tets
            .extend(fresh.iter().map(|tet| tet.map(number)));
        self.commit(old);
    }

    fn sine_of_nodes(&self, tet: [u32; 4]) -> f64 {
        min_sine(&tet.map(|i| self.complex.nodes[i as usize]))
    }

    /// The removal of edge (a, b) of tetrahedron `t`, if every new tetrahedron is better than the worst of
    /// the old ones (or than `floor`, if that is lower).
    pub(super) fn find_edge_removal(
        &self,
        t: u32,
        [a, b]: [u32; 2],
        floor: f64,
        found: &mut Flip,
    ) -> bool {
        let Flip {
            old_tets: old,
            new_tets: fresh,
            ring,
        } = found;
        if !self.complex.ring(t, a, b, MAX_RING, ring) {
            return false;
        }
        let worst = (ring.tets.iter())
            .map(|&t| self.sine_of(t))
            .fold(f64::INFINITY, f64::min);
        old.clone_from(&ring.tets);
        self.fill_ring(ring, [a, b], worst.min(floor) + MIN_SINE_GAIN, fresh)
    }

    /// The tetrahedra above `floor` that fill the ring of an edge without it.
    fn fill_ring(
        &self,
        ring: &Ring,
        [a, b]: [u32; 2],
        floor: f64,
        fresh: &mut Vec<[u32; 4]>,
    ) -> bool {
        let r = &ring.nodes;
        let m = r.len();
        if m < 3 || (!ring.is_closed && !self.is_in_side(&[a, b, r[0], r[m - 1]])) {
            return false;
        }
        // best[i][j]: the best smallest sine of a triangulation of the polygon i..=j.
        let mut best = [[f64::INFINITY; MAX_RING + 1]; MAX_RING + 1];
        let mut via = [[0usize; MAX_RING + 1]; MAX_RING + 1];
        let mut barred = [[false; MAX_RING + 1]; MAX_RING + 1];
        // Chords are tested against the features only once they are wanted.
        loop {
            for span in 2..m {
                for i in 0..m - span {
                    let j = i + span;
                    best[i][j] = f64::NEG_INFINITY;
                    if barred[i][j] {
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
            fresh.clear();
            let mut stack = [(0usize, 0usize); MAX_RING + 1];
            stack[0] = (0, m - 1);
            let mut depth = 1;
            let mut pierced = false;
            while depth > 0 {
                depth -= 1;
                let (i, j) = stack[depth];
                if j < i + 2 {
                    continue;
                }
                let is_chord = !(i == 0 && j == m - 1 && ring.is_closed);
                if is_chord && self.intersects(r[i], r[j]) {
                    barred[i][j] = true;
                    pierced = true;
                    break;
                }
                let k = via[i][j];
                fresh.push([r[i], r[k], r[j], b]);
                fresh.push([r[i], r[j], r[k], a]);
                stack[depth] = (i, k);
                stack[depth + 1] = (k, j);
                depth += 2;
            }
            if !pierced {
                break;
            }
            if barred[0][m - 1] {
                return false;
            }
        }
        true
    }

    /// The 2-3 swap at face k of `t`, if it helps.
    fn find_face_swap(&self, t: u32, k: usize, found: &mut Flip) -> bool {
        let Some(n) = self.complex.neighbor(t, k) else {
            return false;
        };
        let tet = self.complex.tets[t as usize];
        let [u, v, w] = FACES[k].map(|i| tet[i]);
        let p = tet[k];
        let back = self.complex.neighbors[n as usize]
            .iter()
            .position(|&x| x == t);
        let Some(back) = back else { return false };
        let q = self.complex.tets[n as usize][back];
        let floor = self.sine_of(t).min(self.sine_of(n)) + MIN_SINE_GAIN;
        self.find_2_3_swap([t, n], [u, v, w], [p, q], floor, found)
    }

    /// Exchanges two tetrahedra that share face (u, v, w), with apices p (positive) and q, for the
    /// three round the new edge (p, q), if each is better than `floor`.
    pub(super) fn swap_face(
        &mut self,
        old: [u32; 2],
        face: [u32; 3],
        apices: [u32; 2],
        floor: f64,
    ) -> bool {
        let find = |s: &Self, found: &mut Flip| s.find_2_3_swap(old, face, apices, floor, found);
        self.apply_found(find, None)
    }

    fn find_2_3_swap(
        &self,
        old: [u32; 2],
        [u, v, w]: [u32; 3],
        [p, q]: [u32; 2],
        floor: f64,
        found: &mut Flip,
    ) -> bool {
        found.old_tets.clear();
        found.old_tets.extend(old);
        found.new_tets.clear();
        found
            .new_tets
            .extend([[q, p, u, v], [q, p, v, w], [q, p, w, u]]);
        (found.new_tets.iter()).all(|&f| self.sine_of_nodes(f) > floor) && !self.intersects(p, q)
    }
}

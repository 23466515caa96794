//! Tetrahedra with neighbours, for local changes: rings of edges, stars of nodes, and the exchange
//! of one set of tetrahedra for another that fills the same cavity.
//!
//! - `neighbours`(fn@neighbours): finds the tetrahedra that share a face
//! - `faces`: faces that still lack a tetrahedron on one side
//! - `part`: a part of a complex as a complex of its own
//!
//! The ring of an inner edge, seen from b along the edge (a, b):
//!
//! ```text
//!     r2---r1
//!     / \ / \        r[0], r[1], ... turn anticlockwise;
//!   r3--ab--r0       tetrahedron i is (a, b, r[i], r[i + 1])
//!     \ / \ /
//!     r4---r5
//! ```

mod faces;
mod neighbours;
mod part;

use super::renumber::new_numbers;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;

use crate::parallel::prelude::*;

use super::{FACES, TetMesh};
use faces::OpenFaces;
use neighbours::face_key;

pub use crate::geometry::NONE;
pub use neighbours::neighbours;
pub use part::PartNumbering;

/// Smallest number of slots that one parallel task renumbers.
const MIN_TASK_SLOTS: usize = 1 << 14;

/// Stands for a tetrahedron that is not in this part of a complex.
pub const NOT_LOCAL: u32 = NONE - 1;

/// A tetrahedral complex that can be changed. A dead slot has `tets[t][0] == NONE`.
#[derive(Debug, Default)]
pub struct Complex {
    /// Node positions.
    pub nodes: Vec<[f64; 3]>,
    /// Node indices, positively oriented; `NONE` first in a dead slot.
    pub tets: Vec<[u32; 4]>,
    /// `neighbours[t][k]` is the tetrahedron across face k (opposite node k), or `NONE`.
    pub neighbours: Vec<[u32; 4]>,
    tet_of_node: Vec<u32>,
    free_slots: Vec<u32>,
    slot_epochs: Vec<u32>,
    epoch: u32,
    open_faces: OpenFaces,
    journal: Option<Vec<JournalEntry>>,
    reached_nonlocal: AtomicBool,
}

/// One write to a complex, with the previous value.
#[derive(Debug, Clone, Copy)]
enum JournalEntry {
    Tet(u32, [u32; 4], [u32; 4]),
    Neighbour(u32, u8, u32),
    TetOfNode(u32, u32),
    NewSlot,
    Freed,
    Reused(u32),
}

/// The tetrahedra around an edge (a, b), in order.
#[derive(Debug, Default, Clone)]
pub struct Ring {
    /// Nodes of the ring: `(a, b, nodes[i], nodes[i + 1])` is the positive tetrahedron `tets[i]`.
    pub nodes: Vec<u32>,
    /// The tetrahedra; as many as nodes if closed, one fewer if the edge lies on the boundary.
    pub tets: Vec<u32>,
    /// `true` if the ring closes, that is, the edge is inside the mesh.
    pub is_closed: bool,
}

impl Complex {
    /// Creates a complex from a mesh and its neighbours (see [`neighbours`]).
    pub fn new(mesh: TetMesh, neighbours: Vec<[u32; 4]>) -> Self {
        let mut tet_of_node = vec![NONE; mesh.nodes.len()];
        for (t, tet) in mesh.tets.iter().enumerate() {
            for &n in tet {
                tet_of_node[n as usize] = t as u32;
            }
        }
        let slot_epochs = vec![0; mesh.tets.len()];
        Self {
            nodes: mesh.nodes,
            tets: mesh.tets,
            neighbours,
            tet_of_node,
            slot_epochs,
            ..Self::default()
        }
    }

    /// Returns `true` if slot `t` contains a tetrahedron.
    #[inline]
    pub fn is_alive(&self, t: u32) -> bool {
        self.tets[t as usize][0] != NONE
    }

    /// Returns the corner positions of tetrahedron `t`.
    #[inline]
    pub fn corners(&self, t: u32) -> [[f64; 3]; 4] {
        self.tets[t as usize].map(|i| self.nodes[i as usize])
    }

    /// Adds a node that no tetrahedron uses yet, and returns its number.
    pub fn add_node(&mut self, x: [f64; 3]) -> u32 {
        self.nodes.push(x);
        self.tet_of_node.push(NONE);
        (self.nodes.len() - 1) as u32
    }

    /// Removes the nodes from number `count` on, which no tetrahedron may use.
    pub fn truncate_nodes(&mut self, count: usize) {
        self.nodes.truncate(count);
        self.tet_of_node.truncate(count);
    }

    /// Starts a journal: every later [`exchange`](Self::exchange) can be undone.
    pub fn begin(&mut self) {
        self.journal = Some(self.journal.take().map_or_else(Vec::new, |mut j| {
            j.clear();
            j
        }));
    }

    /// Keeps all exchanges since [`begin`](Self::begin) and ends the journal.
    pub fn commit(&mut self) {
        self.journal = None;
    }

    /// Undoes every exchange since [`begin`](Self::begin). The caller restores node positions.
    pub fn rollback(&mut self) {
        let Some(journal) = self.journal.take() else {
            return;
        };
        for entry in journal.into_iter().rev() {
            match entry {
                JournalEntry::Tet(t, tet, neighbours) => {
                    self.tets[t as usize] = tet;
                    self.neighbours[t as usize] = neighbours;
                }
                JournalEntry::Neighbour(t, k, n) => self.neighbours[t as usize][usize::from(k)] = n,
                JournalEntry::TetOfNode(n, t) => self.tet_of_node[n as usize] = t,
                JournalEntry::NewSlot => {
                    self.tets.pop();
                    self.neighbours.pop();
                    self.slot_epochs.pop();
                }
                JournalEntry::Freed => {
                    self.free_slots.pop();
                }
                JournalEntry::Reused(slot) => self.free_slots.push(slot),
            }
        }
    }

    #[inline]
    fn log(&mut self, entry: JournalEntry) {
        if let Some(journal) = &mut self.journal {
            journal.push(entry);
        }
    }

    fn set_tet(&mut self, t: u32, tet: [u32; 4]) {
        let i = t as usize;
        self.log(JournalEntry::Tet(t, self.tets[i], self.neighbours[i]));
        self.tets[i] = tet;
        self.neighbours[i] = [NONE; 4];
    }

    fn set_tet_of_node(&mut self, n: u32, t: u32) {
        self.log(JournalEntry::TetOfNode(n, self.tet_of_node[n as usize]));
        self.tet_of_node[n as usize] = t;
    }

    fn next_epoch(&mut self) -> u32 {
        if self.epoch == u32::MAX {
            self.slot_epochs.iter_mut().for_each(|m| *m = 0);
            self.epoch = 0;
        }
        self.epoch += 1;
        self.epoch
    }

    /// Returns the tetrahedron across face k of `t`, if there is one.
    #[inline]
    pub fn neighbour(&self, t: u32, k: usize) -> Option<u32> {
        let n = self.neighbours[t as usize][k];
        if n == NOT_LOCAL {
            self.reached_nonlocal.store(true, Relaxed);
        }
        (n < NOT_LOCAL).then_some(n)
    }

    /// Writes the tetrahedra at a node into `star`.
    pub fn star(&self, node: u32, star: &mut Vec<u32>) {
        star.clear();
        let first = self.tet_of_node[node as usize];
        if first == NONE {
            return;
        }
        star.push(first);
        let mut head = 0;
        while head < star.len() {
            let t = star[head];
            head += 1;
            for k in 0..4 {
                // A linear search is fast enough: a star has about 24 tetrahedra.
                if self.tets[t as usize][k] != node
                    && let Some(n) = self.neighbour(t, k)
                    && !star.contains(&n)
                {
                    star.push(n);
                }
            }
        }
    }

    /// Returns the local index of `node` in tetrahedron `t`.
    #[inline]
    pub fn local_index(&self, t: u32, node: u32) -> usize {
        let tet = &self.tets[t as usize];
        if tet[0] == node {
            0
        } else if tet[1] == node {
            1
        } else if tet[2] == node {
            2
        } else {
            3
        }
    }

    /// Returns the other two nodes (c, d) of tetrahedron `t`, ordered so that (a, b, c, d) is
    /// positive.
    #[inline]
    fn opposite_edge(&self, t: u32, a: u32, b: u32) -> (u32, u32) {
        let tet = &self.tets[t as usize];
        let (i, j) = (self.local_index(t, a), self.local_index(t, b));
        // The remaining local indices, ordered so that (i, j, k, l) is an even permutation.
        const NEXT_NODES: [[[u8; 2]; 4]; 4] = [
            [[0, 0], [2, 3], [3, 1], [1, 2]],
            [[3, 2], [0, 0], [0, 3], [2, 0]],
            [[1, 3], [3, 0], [0, 0], [0, 1]],
            [[2, 1], [0, 2], [1, 0], [0, 0]],
        ];
        let [k, l] = NEXT_NODES[i][j];
        (tet[k as usize], tet[l as usize])
    }

    /// Writes the ring of tetrahedra around edge (a, b) of tetrahedron `t` into `ring`. Stops and
    /// returns `false` if there are more than `max_tets`.
    pub fn ring(&self, t: u32, a: u32, b: u32, max_tets: usize, ring: &mut Ring) -> bool {
        if self.walk_ring(t, [a, b], max_tets, ring) || ring.tets.len() > max_tets {
            return ring.is_closed;
        }
        // There is a boundary: go back to where the ring begins.
        let mut first = t;
        for _ in 0..=max_tets {
            let (_, d) = self.opposite_edge(first, a, b);
            match self.neighbour(first, self.local_index(first, d)) {
                Some(previous) => first = previous,
                None => {
                    self.walk_ring(first, [a, b], max_tets, ring);
                    return ring.tets.len() <= max_tets;
                }
            }
        }
        false
    }

    /// Writes the tetrahedra around edge (a, b) from `first` on into `ring`, up to a boundary, or until
    /// there are more than `max_tets`. Returns `true` if they form a closed ring.
    fn walk_ring(&self, first: u32, [a, b]: [u32; 2], max_tets: usize, ring: &mut Ring) -> bool {
        ring.nodes.clear();
        ring.tets.clear();
        ring.is_closed = false;
        let mut current = first;
        loop {
            let (c, d) = self.opposite_edge(current, a, b);
            ring.tets.push(current);
            ring.nodes.push(c);
            if ring.tets.len() > max_tets {
                return false;
            }
            match self.neighbour(current, self.local_index(current, c)) {
                Some(next) if next == first => {
                    ring.is_closed = true;
                    return true;
                }
                Some(next) => current = next,
                None => {
                    ring.nodes.push(d);
                    return false;
                }
            }
        }
    }

    /// Returns a tetrahedron that has the edge between nodes `a` and `b`, if there is one. `star`
    /// is a buffer.
    pub fn tet_with_edge(&self, a: u32, b: u32, star: &mut Vec<u32>) -> Option<u32> {
        self.star(a, star);
        star.iter()
            .copied()
            .find(|&t| self.tets[t as usize].contains(&b))
    }

    /// Replaces the tetrahedra `old` by `new`, which must fill the same cavity with the same outer
    /// faces. Only faces on the boundary may differ if they cover the same area. The slots of the
    /// new tetrahedra are written to `slots`, in the order of `new`.
    pub fn exchange(&mut self, old: &[u32], new: &[[u32; 4]], slots: &mut Vec<u32>) {
        let epoch = self.next_epoch();
        for &t in old {
            self.slot_epochs[t as usize] = epoch;
        }
        // Collects the outer faces: the face, the neighbour beyond it, and the face's index in that
        // neighbour.
        let mut faces = std::mem::take(&mut self.open_faces);
        faces.clear(old.len());
        for &t in old {
            for k in 0..4 {
                let n = self.neighbours[t as usize][k];
                if n < NOT_LOCAL && self.slot_epochs[n as usize] == epoch {
                    continue;
                }
                let key = face_key(FACES[k].map(|i| self.tets[t as usize][i]));
                let back_index = if n >= NOT_LOCAL {
                    0
                } else {
                    self.neighbours[n as usize]
                        .iter()
                        .position(|&x| x == t)
                        .unwrap_or(0) as u32
                };
                faces.insert(key, n, back_index);
            }
        }
        for &t in old {
            // A node that vanishes with the cavity must not point to a dead tetrahedron.
            for n in self.tets[t as usize] {
                self.set_tet_of_node(n, NONE);
            }
        }
        slots.clear();
        for i in 0..new.len() {
            let slot = if i < old.len() {
                old[i]
            } else if let Some(slot) = self.free_slots.pop() {
                self.log(JournalEntry::Reused(slot));
                slot
            } else {
                self.log(JournalEntry::NewSlot);
                self.tets.push([NONE; 4]);
                self.neighbours.push([NONE; 4]);
                self.slot_epochs.push(0);
                (self.tets.len() - 1) as u32
            };
            slots.push(slot);
        }
        for &t in &old[new.len().min(old.len())..] {
            self.set_tet(t, [NONE; 4]);
            self.log(JournalEntry::Freed);
            self.free_slots.push(t);
        }
        for (&slot, &tet) in slots.iter().zip(new) {
            self.set_tet(slot, tet);
            for n in tet {
                self.set_tet_of_node(n, slot);
            }
            for k in 0..4 {
                let key = face_key(FACES[k].map(|i| tet[i]));
                if let Some((n, back_index)) = faces.remove(key) {
                    // The journal restores these neighbours together with the slot.
                    self.neighbours[slot as usize][k] = n;
                    if n < NOT_LOCAL {
                        self.log(JournalEntry::Neighbour(
                            n,
                            back_index as u8,
                            self.neighbours[n as usize][back_index as usize],
                        ));
                        self.neighbours[n as usize][back_index as usize] = slot;
                    }
                } else {
                    // This is an inner face: the other new tetrahedron that has it completes it.
                    faces.insert(key, slot, k as u32);
                }
            }
        }
        // On the boundary, old faces may vanish and new ones may appear; inside, the faces must
        // match.
        debug_assert!(
            faces
                .remaining_tets()
                .all(|n| n == NONE || slots.contains(&n)),
            "the new tetrahedra have the same outer faces as the old"
        );
        self.open_faces = faces;
    }

    /// Returns the mesh without dead slots and unused nodes, its neighbours, and the old number of
    /// each node.
    pub fn into_mesh(self) -> (TetMesh, Vec<[u32; 4]>, Vec<u32>) {
        let kept: Vec<u32> = (0..self.nodes.len() as u32)
            .filter(|&i| self.tet_of_node[i as usize] != NONE)
            .collect();
        let new_index = new_numbers(self.nodes.len(), &kept);
        let nodes = kept.iter().map(|&i| self.nodes[i as usize]).collect();
        let (mut tets, mut neighbours) = (self.tets, self.neighbours);
        // The new number of each slot.
        let mut live = 0;
        let renumbered: Vec<u32> = tets
            .iter()
            .map(|tet| {
                let index = live;
                live += u32::from(tet[0] != NONE);
                index
            })
            .collect();
        let mut slot = 0;
        neighbours.retain(|_| {
            slot += 1;
            tets[slot - 1][0] != NONE
        });
        tets.retain(|t| t[0] != NONE);
        let pairs = tets.par_iter_mut().zip(&mut neighbours);
        pairs
            .with_min_len(MIN_TASK_SLOTS)
            .for_each(|(tet, adjacent)| {
                *tet = tet.map(|i| new_index[i as usize]);
                *adjacent = adjacent.map(|n| renumbered.get(n as usize).copied().unwrap_or(NONE));
            });
        (TetMesh { nodes, tets }, neighbours, kept)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::volume6;

    /// Returns an octahedron about the axis (0, 1), split into four tetrahedra.
    fn octahedron() -> Complex {
        let nodes = vec![
            [0.0, 0.0, -1.0],
            [0.0, 0.0, 1.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [-1.0, 0.0, 0.0],
            [0.0, -1.0, 0.0],
        ];
        let tets = vec![[0, 1, 2, 3], [0, 1, 3, 4], [0, 1, 4, 5], [0, 1, 5, 2]];
        let n = neighbours(6, &tets).unwrap();
        Complex::new(TetMesh { nodes, tets }, n)
    }

    #[test]
    fn ring_is_closed_ordered_and_positive() {
        let complex = octahedron();
        for t in 0..4 {
            assert!(volume6(&complex.corners(t)) > 0.0);
            let mut ring = Ring::default();
            for (a, b) in [(0, 1), (1, 0)] {
                assert!(complex.ring(t, a, b, 9, &mut ring));
                assert!(ring.is_closed && ring.tets.len() == 4 && ring.nodes.len() == 4);
                for i in 0..4 {
                    let tet = [a, b, ring.nodes[i], ring.nodes[(i + 1) % 4]];
                    let p = tet.map(|n| complex.nodes[n as usize]);
                    assert!(volume6(&p) > 0.0);
                    let mut found = complex.tets[ring.tets[i] as usize];
                    let mut expected = tet;
                    found.sort_unstable();
                    expected.sort_unstable();
                    assert_eq!(found, expected);
                }
            }
            assert!(complex.ring(t, 0, 2, 9, &mut ring) || t == 1 || t == 2);
        }
        let mut star = Vec::new();
        complex.star(2, &mut star);
        assert_eq!(star.len(), 2);
    }

    #[test]
    fn open_ring_runs_from_boundary_to_boundary() {
        let complex = octahedron();
        let mut ring = Ring::default();
        assert!(complex.ring(0, 0, 3, 9, &mut ring));
        assert!(!ring.is_closed);
        assert_eq!((ring.tets.len(), ring.nodes.len()), (2, 3));
    }

    #[test]
    fn faces_are_found_in_list_and_map() {
        for tets in [10, 1000] {
            let mut faces = OpenFaces::default();
            faces.clear(tets);
            let face = |i: u32| [i, i + 1, i + 2];
            (0..100).for_each(|i| faces.insert(face(i), 2 * i, i % 4));
            assert_eq!(faces.remove(face(7)), Some((14, 3)));
            assert_eq!(faces.remove(face(7)), None);
            let mut left: Vec<u32> = faces.remaining_tets().collect();
            left.sort_unstable();
            assert!(left.len() == 99 && left[7] == 16);
        }
    }

    #[test]
    fn exchanging_the_axis_keeps_the_surface() {
        let mut complex = octahedron();
        let mut slots = Vec::new();
        // The exchange removes the edge 0-1 and creates the edge 2-4.
        let new = [[4, 2, 3, 1], [4, 2, 0, 3], [4, 2, 5, 0], [4, 2, 1, 5]];
        for tet in new {
            assert!(volume6(&tet.map(|n| complex.nodes[n as usize])) > 0.0);
        }
        let (tets, adjacent) = (complex.tets.clone(), complex.neighbours.clone());
        complex.begin();
        complex.exchange(&[0, 1, 2, 3], &new, &mut slots);
        complex.exchange(&[slots[0]], &[new[0]], &mut slots);
        complex.rollback();
        assert_eq!(
            (tets, adjacent),
            (complex.tets.clone(), complex.neighbours.clone())
        );
        complex.exchange(&[0, 1, 2, 3], &new, &mut slots);
        let expected = neighbours(6, &complex.tets).unwrap();
        assert_eq!(expected, complex.neighbours);
        // Two tetrahedra become three, and two again, which leaves a dead slot among the others.
        let (mut three, mut two) = (Vec::new(), Vec::new());
        let fresh = [[0, 1, 4, 2], [0, 1, 2, 3], [0, 1, 3, 4]];
        complex.exchange(&slots[..2], &fresh, &mut three);
        complex.exchange(&[three[2], three[0], three[1]], &new[..2], &mut two);
        assert!(!complex.is_alive(three[1]) && complex.tets.len() == 5);
        let (mesh, adjacent, kept) = complex.into_mesh();
        assert_eq!(mesh.tets.len(), 4);
        assert_eq!(adjacent, neighbours(6, &mesh.tets).unwrap());
        assert_eq!(kept.len(), 6);
    }
}

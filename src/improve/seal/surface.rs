//! The marked faces of a mesh, or of a part of one: their ridges, and the rooms between them.

use crate::parallel::prelude::*;

use crate::geometry::union_find::UnionFind;
use crate::mesh::Simplices;
use crate::mesh::complex::{NONE, NOT_LOCAL};

/// Cells of which volumes are reckoned in one go.
const VOLUME_CHUNK: usize = 1 << 20;

/// The nodes of a ridge, in rising order; the last is `NONE` in the plane.
pub(super) type Ridge = [u32; 2];

/// What the way round a ridge is like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RidgeFan {
    /// It closes.
    Closed,
    /// It ends on the outside of the mesh.
    AtBoundary,
    /// It leaves what is here of the mesh.
    NotLocal,
}

/// A mesh, some of whose faces are marked.
pub(super) struct MarkedSurface<'a, const D: usize, M> {
    /// The mesh, or the part of one that is here.
    pub mesh: &'a M,
    /// For every cell and face, in order, the cell beyond: `NONE` outside the mesh, `BEYOND` if it is not here.
    pub neighbors: &'a [u32],
    /// Bit k of a cell for its face k.
    pub marks: &'a mut [u8],
}

impl<const D: usize, M: Simplices<D>> MarkedSurface<'_, D, M> {
    /// The other number of a face, if there is a cell beyond it here.
    pub fn twin(&self, face: u32) -> Option<u32> {
        let n = D as u32 + 1;
        let beyond = self.neighbors[face as usize];
        let back = |k: &u32| self.neighbors[(n * beyond + k) as usize] == face / n;
        (beyond < NOT_LOCAL).then(|| n * beyond + (0..n).find(back).unwrap_or(0))
    }

    /// Whether a face is marked, seen from this side.
    pub fn is_marked(&self, face: u32) -> bool {
        let n = D as u32 + 1;
        self.marks[(face / n) as usize] >> (face % n) & 1 == 1
    }

    /// Marks a face, or takes its mark off, on both sides.
    pub fn set_mark(&mut self, face: u32, on: bool) {
        let n = D as u32 + 1;
        for face in [Some(face), self.twin(face)].into_iter().flatten() {
            let bits = &mut self.marks[(face / n) as usize];
            *bits = *bits & !(1 << (face % n)) | u8::from(on) << (face % n);
        }
    }

    /// Marks every face that is marked on its other side, too.
    pub fn mark_both_sides(&mut self) {
        for face in self.marked_faces() {
            self.set_mark(face, true);
        }
    }

    /// The faces that are marked, from both sides.
    fn marked_faces(&self) -> Vec<u32> {
        let n = D as u32 + 1;
        let of_cell = |(c, &bits): (usize, &u8)| {
            let marked = (0..n).filter(move |k| bits >> k & 1 == 1);
            marked.map(move |k| n * c as u32 + k)
        };
        let some = self
            .marks
            .par_iter()
            .enumerate()
            .filter(|(_, bits)| **bits != 0);
        some.flat_map_iter(of_cell).collect()
    }

    /// The same, each once.
    pub fn unique_marked_faces(&self) -> Vec<u32> {
        let mut marked = self.marked_faces();
        marked.retain(|&face| self.twin(face).is_none_or(|twin| face < twin));
        marked
    }

    /// The ridge of face k of cell c that is opposite node j too.
    fn ridge(&self, c: u32, k: usize, j: usize) -> Ridge {
        let mut ridge = [NONE; 2];
        let nodes = self.mesh.cell(c as usize).iter().enumerate();
        let kept = nodes.filter(|(i, _)| *i != k && *i != j).map(|(_, &n)| n);
        ridge.iter_mut().zip(kept).for_each(|(to, n)| *to = n);
        ridge.sort_unstable();
        ridge
    }

    /// The ridges of a face, each opposite one of its nodes, in their order.
    pub fn ridges(&self, face: u32) -> impl Iterator<Item = Ridge> + '_ {
        let (c, k) = (face / (D as u32 + 1), face as usize % (D + 1));
        (0..=D)
            .filter(move |&j| j != k)
            .map(move |j| self.ridge(c, k, j))
    }

    /// Runs `visit` on the cells round a ridge of cell c.
    pub fn visit_ridge_cells(&self, c: u32, ridge: Ridge, mut visit: impl FnMut(u32)) -> RidgeFan {
        let beyond = |c: u32, k: usize| self.neighbors[(D + 1) * c as usize + k];
        let beside = |c: u32| {
            let nodes = self.mesh.cell(c as usize).iter().enumerate();
            nodes
                .filter(move |(_, n)| !ridge.contains(n))
                .map(|(k, _)| k)
        };
        visit(c);
        let mut way = RidgeFan::AtBoundary;
        for first in beside(c) {
            let (mut last, mut at) = (c, beyond(c, first));
            while at < NOT_LOCAL && at != c {
                visit(at);
                let onward = beside(at).map(|k| beyond(at, k)).find(|&n| n != last);
                (last, at) = (at, onward.unwrap_or(NONE));
            }
            match at {
                NONE => (),
                NOT_LOCAL => way = RidgeFan::NotLocal,
                _ => return RidgeFan::Closed,
            }
        }
        way
    }

    /// The nodes of a face, in the cell's order.
    pub fn face_nodes(&self, face: u32) -> [u32; D] {
        let face = face as usize;
        self.mesh.face(face / (D + 1), face % (D + 1))
    }

    /// The area of a face (length in the plane).
    pub fn face_area(&self, face: u32) -> f64 {
        M::face_area(&self.face_nodes(face).map(|n| self.mesh.nodes()[n as usize]))
    }

    /// The room of each cell, rooms being numbered in the order of their first cells; and their volumes.
    pub fn compartments(&self) -> (Vec<u32>, Vec<f64>) {
        let n = D as u32 + 1;
        let mut rooms = UnionFind::new(self.mesh.len());
        let (neighbors, marks) = (self.neighbors, &*self.marks);
        rooms.unite_neighbours(|c| {
            let beyond = &neighbors[(n * c) as usize..(n * (c + 1)) as usize];
            let open = move |(k, cell): (usize, &u32)| {
                let open = *cell < NOT_LOCAL && *cell > c && marks[c as usize] >> k & 1 == 0;
                open.then_some(*cell)
            };
            beyond.iter().enumerate().filter_map(open)
        });
        let (room, count) = rooms.into_labels();
        let mut volume = vec![0.0; count];
        for first in (0..self.mesh.len()).step_by(VOLUME_CHUNK) {
            let some = (first..self.mesh.len().min(first + VOLUME_CHUNK)).into_par_iter();
            let volumes: Vec<f64> = some.map(|c| self.mesh.volume(c)).collect();
            for (of_cell, &room) in volumes.iter().zip(&room[first..]) {
                volume[room as usize] += of_cell;
            }
        }
        (room, volume)
    }

    /// Takes the marks off the faces between rooms that are `opened` to one another.
    pub fn unmark_between(&mut self, opened: &CompartmentPairs, room: impl Fn(u32) -> u32) {
        if opened.count() == 0 {
            return;
        }
        let n = D as u32 + 1;
        for face in self.marked_faces() {
            let beyond = self.neighbors[face as usize];
            if beyond < NOT_LOCAL && beyond > face / n {
                let beside = [face / n, beyond].map(&room);
                if opened.contains(beside) {
                    self.set_mark(face, false);
                }
            }
        }
    }
}

/// Pairs of rooms that become one.
pub(super) struct CompartmentPairs(Vec<[u32; 2]>);

impl CompartmentPairs {
    /// Of pairs of rooms, each named once.
    pub fn new(mut pairs: Vec<[u32; 2]>) -> Self {
        pairs.iter_mut().for_each(|pair| pair.sort_unstable());
        pairs.sort_unstable();
        Self(pairs)
    }

    /// How many pairs there are.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// Whether these two become one.
    pub fn contains(&self, mut rooms: [u32; 2]) -> bool {
        rooms.sort_unstable();
        self.0.binary_search(&rooms).is_ok()
    }
}

//! The marked faces of a mesh or of a part of one: their ridges, and the compartments between them.

use crate::parallel::prelude::*;

use crate::geometry::union_find::UnionFind;
use crate::mesh::Simplices;
use crate::mesh::complex::{NONE, NOT_LOCAL};

/// Number of cells whose volumes are computed at a time.
const VOLUME_CHUNK: usize = 1 << 20;

/// Nodes of a ridge of a face, in rising order. In the plane the second is `NONE`.
pub(super) type Ridge = [u32; 2];

/// Returns the nodes of a ridge.
pub(super) fn ridge_nodes(ridge: Ridge) -> impl Iterator<Item = u32> {
    ridge.into_iter().filter(|&n| n != NONE)
}

/// How the cells around a ridge end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RidgeFan {
    /// The cells form a closed fan.
    Closed,
    /// The cells end on the outside of the mesh.
    AtBoundary,
    /// The cells continue in a part of the mesh that is not local.
    NotLocal,
}

/// A mesh with marked faces.
pub(super) struct MarkedSurface<'a, const D: usize, M> {
    /// The mesh, or the local part of one.
    pub mesh: &'a M,
    /// The adjacent cell for every cell and face, in order: `NONE` outside of the mesh, `NOT_LOCAL`
    /// if the cell is not local.
    pub neighbours: &'a [u32],
    /// Marks of the faces of each cell: bit k for face k.
    pub marks: &'a mut [u8],
}

impl<const D: usize, M: Simplices<D>> MarkedSurface<'_, D, M> {
    /// Returns the index of a face on its other side, if the cell there is local.
    pub fn twin(&self, face: u32) -> Option<u32> {
        let n = D as u32 + 1;
        let neighbour = self.neighbours[face as usize];
        let back = |k: &u32| self.neighbours[(n * neighbour + k) as usize] == face / n;
        (neighbour < NOT_LOCAL).then(|| n * neighbour + (0..n).find(back).unwrap_or(0))
    }

    /// Returns `true` if a face is marked on this side.
    pub fn is_marked(&self, face: u32) -> bool {
        let n = D as u32 + 1;
        self.marks[(face / n) as usize] >> (face % n) & 1 == 1
    }

    /// Sets or clears the mark of a face on both sides.
    pub fn set_mark(&mut self, face: u32, marked: bool) {
        let n = D as u32 + 1;
        for face in [Some(face), self.twin(face)].into_iter().flatten() {
            let bits = &mut self.marks[(face / n) as usize];
            *bits = *bits & !(1 << (face % n)) | u8::from(marked) << (face % n);
        }
    }

    /// Marks the other side of every marked face.
    pub fn mark_both_sides(&mut self) {
        for face in self.marked_faces() {
            self.set_mark(face, true);
        }
    }

    /// Returns the marked faces, from both sides.
    fn marked_faces(&self) -> Vec<u32> {
        let n = D as u32 + 1;
        let marked_in_cell = |(c, &bits): (usize, &u8)| {
            let marked = (0..n).filter(move |k| bits >> k & 1 == 1);
            marked.map(move |k| n * c as u32 + k)
        };
        let marked_cells = self
            .marks
            .par_iter()
            .enumerate()
            .filter(|(_, bits)| **bits != 0);
        marked_cells.flat_map_iter(marked_in_cell).collect()
    }

    /// Returns the marked faces, each once.
    pub fn unique_marked_faces(&self) -> Vec<u32> {
        let mut marked = self.marked_faces();
        marked.retain(|&face| self.twin(face).is_none_or(|twin| face < twin));
        marked
    }

    /// Returns the ridge of face k of cell c that is opposite node j.
    fn ridge(&self, c: u32, k: usize, j: usize) -> Ridge {
        let mut ridge = [NONE; 2];
        let nodes = self.mesh.cell(c as usize).iter().enumerate();
        let kept = nodes.filter(|(i, _)| *i != k && *i != j).map(|(_, &n)| n);
        ridge.iter_mut().zip(kept).for_each(|(slot, n)| *slot = n);
        ridge.sort_unstable();
        ridge
    }

    /// Returns the ridges of a face: for each of its nodes, in order, the opposite ridge.
    pub fn ridges(&self, face: u32) -> impl Iterator<Item = Ridge> + '_ {
        let (c, k) = (face / (D as u32 + 1), face as usize % (D + 1));
        (0..=D)
            .filter(move |&j| j != k)
            .map(move |j| self.ridge(c, k, j))
    }

    /// Calls `visit` with the cells around a ridge of cell c. Returns how they end.
    pub fn visit_ridge_cells(&self, c: u32, ridge: Ridge, mut visit: impl FnMut(u32)) -> RidgeFan {
        let neighbour = |c: u32, k: usize| self.neighbours[(D + 1) * c as usize + k];
        let faces_at_ridge = |c: u32| {
            let nodes = self.mesh.cell(c as usize).iter().enumerate();
            nodes
                .filter(move |(_, n)| !ridge.contains(n))
                .map(|(k, _)| k)
        };
        visit(c);
        let mut fan = RidgeFan::AtBoundary;
        for first in faces_at_ridge(c) {
            let (mut previous, mut current) = (c, neighbour(c, first));
            while current < NOT_LOCAL && current != c {
                visit(current);
                let next = faces_at_ridge(current)
                    .map(|k| neighbour(current, k))
                    .find(|&n| n != previous);
                (previous, current) = (current, next.unwrap_or(NONE));
            }
            match current {
                NONE => (),
                NOT_LOCAL => fan = RidgeFan::NotLocal,
                _ => return RidgeFan::Closed,
            }
        }
        fan
    }

    /// Returns the nodes of a face, in the order of the cell.
    pub fn face_nodes(&self, face: u32) -> [u32; D] {
        let face = face as usize;
        self.mesh.face(face / (D + 1), face % (D + 1))
    }

    /// Returns the area of a face (length in the plane).
    pub fn face_area(&self, face: u32) -> f64 {
        M::face_area(&self.face_nodes(face).map(|n| self.mesh.nodes()[n as usize]))
    }

    /// Returns the compartment of each cell, and the volumes of the compartments. Compartments are
    /// numbered in the order of their first cells.
    pub fn compartments(&self) -> (Vec<u32>, Vec<f64>) {
        let n = D as u32 + 1;
        let mut union = UnionFind::new(self.mesh.len());
        let (neighbours, marks) = (self.neighbours, &*self.marks);
        union.unite_neighbours(|c| {
            let adjacent = &neighbours[(n * c) as usize..(n * (c + 1)) as usize];
            let open_neighbour = move |(k, cell): (usize, &u32)| {
                let is_open = *cell < NOT_LOCAL && *cell > c && marks[c as usize] >> k & 1 == 0;
                is_open.then_some(*cell)
            };
            adjacent.iter().enumerate().filter_map(open_neighbour)
        });
        let (compartments, count) = union.into_labels();
        let mut volumes = vec![0.0; count];
        for first in (0..self.mesh.len()).step_by(VOLUME_CHUNK) {
            let chunk = (first..self.mesh.len().min(first + VOLUME_CHUNK)).into_par_iter();
            let chunk_volumes: Vec<f64> = chunk.map(|c| self.mesh.volume(c)).collect();
            for (cell_volume, &compartment) in chunk_volumes.iter().zip(&compartments[first..]) {
                volumes[compartment as usize] += cell_volume;
            }
        }
        (compartments, volumes)
    }

    /// Clears the marks of the faces between the pairs of compartments in `opened`.
    pub fn unmark_between(
        &mut self,
        opened: &CompartmentPairs,
        compartment_of: impl Fn(u32) -> u32,
    ) {
        if opened.count() == 0 {
            return;
        }
        let n = D as u32 + 1;
        for face in self.marked_faces() {
            let neighbour = self.neighbours[face as usize];
            if neighbour < NOT_LOCAL && neighbour > face / n {
                let adjacent = [face / n, neighbour].map(&compartment_of);
                if opened.contains(adjacent) {
                    self.set_mark(face, false);
                }
            }
        }
    }
}

/// Pairs of compartments that are united.
pub(super) struct CompartmentPairs(Vec<[u32; 2]>);

impl CompartmentPairs {
    /// Creates the set from distinct pairs.
    pub fn new(mut pairs: Vec<[u32; 2]>) -> Self {
        pairs.iter_mut().for_each(|pair| pair.sort_unstable());
        pairs.sort_unstable();
        Self(pairs)
    }

    /// Returns the number of pairs.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// Returns `true` if these two compartments are united.
    pub fn contains(&self, mut pair: [u32; 2]) -> bool {
        pair.sort_unstable();
        self.0.binary_search(&pair).is_ok()
    }
}

//! The cells of a mesh in pieces that lie at some of its nodes, from all pieces: each member of a group has
//! the same.

use crate::parallel::prelude::*;

use crate::error::cause;
use crate::files::kept::fields;
use crate::mesh::TetMesh;
use crate::mesh::complex::{self, BEYOND, NONE};
use crate::mesh::piece::Piece;
use crate::ranks::Group;
use crate::{Error, Result};

/// A cell as its owner tells of it.
#[derive(Debug, Clone, Copy)]
struct Cell {
    /// The whole's number of it, and of its nodes.
    number: usize,
    nodes: [u32; 4],
    /// Bit k for face k: those that are marked, and those on the outside of the mesh.
    marks: u8,
    outside: u8,
}

fields! {
    Cell as Cell { number, nodes, marks, outside }
}

/// All cells at some nodes.
#[derive(Debug, Default)]
pub(super) struct Near {
    /// In the order of the whole.
    cells: Vec<Cell>,
    /// The whole's numbers of their nodes, rising, and where these are.
    nodes: Vec<(u32, [f64; 3])>,
    /// The nodes of which all cells are here, rising.
    full: Vec<u32>,
}

impl Near {
    /// Takes in the cells at more nodes. Gives the other nodes of these cells, but for those of which all
    /// cells are here.
    ///
    /// # Errors
    /// Those of the others.
    pub fn take(
        &mut self,
        more: &[u32],
        piece: &Piece,
        marks: &[u8],
        group: &dyn Group,
    ) -> Result<Vec<u32>> {
        let (asked, known) = (among(piece, more), among(piece, &self.full));
        let at = |those: &[bool], tet: &[u32; 4]| tet.iter().any(|&n| those[n as usize]);
        let tets = piece.mesh.tets.par_iter().enumerate();
        let cells = tets.filter(|(_, tet)| at(&asked, tet) && !at(&known, tet));
        let cells: Vec<Cell> = cells
            .map(|(c, tet)| Cell {
                number: piece.first + c,
                nodes: tet.map(|n| piece.numbers[n as usize]),
                marks: marks[c],
                outside: (0..4)
                    .filter(|&k| piece.neighbors[c][k] == NONE)
                    .map(|k| 1 << k)
                    .sum(),
            })
            .collect();
        let mut nodes: Vec<u32> = cells
            .iter()
            .flat_map(|cell| piece.mesh.tets[cell.number - piece.first])
            .collect();
        nodes.sort_unstable();
        nodes.dedup();
        let place = |n: u32| (piece.numbers[n as usize], piece.mesh.nodes[n as usize]);
        let nodes: Vec<(u32, [f64; 3])> = nodes.into_iter().map(place).collect();
        let mut others = Vec::new();
        for (cells, nodes) in group.all("cells near rims", (cells, nodes))? {
            others.extend(nodes.iter().map(|(number, _)| *number));
            self.cells.extend(cells);
            self.nodes.extend(nodes);
        }
        self.cells.sort_unstable_by_key(|cell| cell.number);
        self.nodes.sort_unstable_by_key(|(number, _)| *number);
        self.nodes.dedup_by_key(|(number, _)| *number);
        self.full.extend(more);
        self.full.sort_unstable();
        self.full.dedup();
        others.sort_unstable();
        others.dedup();
        others.retain(|number| self.full.binary_search(number).is_err());
        Ok(others)
    }

    /// The cells as a mesh of their own, and the cells beyond their faces: `NONE` outside the whole mesh,
    /// `BEYOND` where it goes on.
    ///
    /// # Errors
    /// [`Error::Mesh`] if more than two cells share a face.
    pub fn mesh(&self) -> Result<(TetMesh, Vec<[u32; 4]>)> {
        let here = |n: u32| self.nodes.partition_point(|(number, _)| *number < n) as u32;
        let mesh = TetMesh {
            nodes: self.nodes.iter().map(|(_, x)| *x).collect(),
            tets: self.cells.iter().map(|cell| cell.nodes.map(here)).collect(),
        };
        let shared = |face: [u32; 3]| {
            Error::Mesh(cause(
                format!("face {:?}", face.map(|n| self.node(n))),
                "belongs to more than two tetrahedra",
                "mesh the image again",
            ))
        };
        let mut neighbors = complex::neighbors(mesh.nodes.len(), &mesh.tets).map_err(shared)?;
        for (around, cell) in neighbors.iter_mut().zip(&self.cells) {
            for (k, beyond) in around.iter_mut().enumerate() {
                if *beyond == NONE && cell.outside >> k & 1 == 0 {
                    *beyond = BEYOND;
                }
            }
        }
        Ok((mesh, neighbors))
    }

    /// The marks of the cells.
    pub fn marks(&self) -> Vec<u8> {
        self.cells.iter().map(|cell| cell.marks).collect()
    }

    /// The whole's number of a cell.
    pub fn cell(&self, c: u32) -> usize {
        self.cells[c as usize].number
    }

    /// Which cell has that number in the whole; it is here.
    pub fn place(&self, number: usize) -> u32 {
        self.cells.partition_point(|cell| cell.number < number) as u32
    }

    /// The whole's number of a node.
    pub fn node(&self, n: u32) -> u32 {
        self.nodes[n as usize].0
    }
}

/// For each node of a piece, whether it is one of those, which are given by the whole's numbers.
fn among(piece: &Piece, those: &[u32]) -> Vec<bool> {
    let mut among = vec![false; piece.numbers.len()];
    for number in those {
        if let Ok(n) = piece.numbers.binary_search(number) {
            among[n] = true;
        }
    }
    among
}

//! The cells of a mesh in pieces that lie at some of its nodes, from all pieces: each member of a group has
//! the same.

use crate::parallel::prelude::*;

use crate::comm::Comm;
use crate::error::cause;
use crate::files::codec::codec_fields;
use crate::mesh::TetMesh;
use crate::mesh::complex::{self, NONE, NOT_LOCAL};
use crate::mesh::partition::MeshPartition;
use crate::{Error, Result};

/// A cell as its owner tells of it.
#[derive(Debug, Clone, Copy)]
struct GatheredCell {
    /// The whole's number of it, and of its nodes.
    global_id: usize,
    nodes: [u32; 4],
    /// Bit k for face k: those that are marked, and those on the outside of the mesh.
    marks: u8,
    boundary_faces: u8,
}

codec_fields! {
    GatheredCell as GatheredCell { global_id, nodes, marks, boundary_faces }
}

/// All cells at some nodes.
#[derive(Debug, Default)]
pub(super) struct GatheredCells {
    /// In the order of the whole.
    cells: Vec<GatheredCell>,
    /// The whole's numbers of their nodes, rising, and where these are.
    nodes: Vec<(u32, [f64; 3])>,
    /// The nodes of which all cells are here, rising.
    complete_nodes: Vec<u32>,
}

impl GatheredCells {
    /// Takes in the cells at more nodes. Gives the other nodes of these cells, but for those of which all
    /// cells are here.
    ///
    /// # Errors
    /// Those of the others.
    pub fn gather(
        &mut self,
        more: &[u32],
        piece: &MeshPartition,
        marks: &[u8],
        group: &dyn Comm,
    ) -> Result<Vec<u32>> {
        let (asked, known) = (
            node_mask(piece, more),
            node_mask(piece, &self.complete_nodes),
        );
        let at = |those: &[bool], tet: &[u32; 4]| tet.iter().any(|&n| those[n as usize]);
        let tets = piece.mesh.tets.par_iter().enumerate();
        let cells = tets.filter(|(_, tet)| at(&asked, tet) && !at(&known, tet));
        let cells: Vec<GatheredCell> = cells
            .map(|(c, tet)| GatheredCell {
                global_id: piece.first_cell + c,
                nodes: tet.map(|n| piece.global_ids[n as usize]),
                marks: marks[c],
                boundary_faces: (0..4)
                    .filter(|&k| piece.neighbors[c][k] == NONE)
                    .map(|k| 1 << k)
                    .sum(),
            })
            .collect();
        let mut nodes: Vec<u32> = cells
            .iter()
            .flat_map(|cell| piece.mesh.tets[cell.global_id - piece.first_cell])
            .collect();
        nodes.sort_unstable();
        nodes.dedup();
        let place = |n: u32| (piece.global_ids[n as usize], piece.mesh.nodes[n as usize]);
        let nodes: Vec<(u32, [f64; 3])> = nodes.into_iter().map(place).collect();
        let mut others = Vec::new();
        for (cells, nodes) in group.all_gather("cells near rims", (cells, nodes))? {
            others.extend(nodes.iter().map(|(number, _)| *number));
            self.cells.extend(cells);
            self.nodes.extend(nodes);
        }
        self.cells.sort_unstable_by_key(|cell| cell.global_id);
        self.nodes.sort_unstable_by_key(|(number, _)| *number);
        self.nodes.dedup_by_key(|(number, _)| *number);
        self.complete_nodes.extend(more);
        self.complete_nodes.sort_unstable();
        self.complete_nodes.dedup();
        others.sort_unstable();
        others.dedup();
        others.retain(|number| self.complete_nodes.binary_search(number).is_err());
        Ok(others)
    }

    /// The cells as a mesh of their own, and the cells beyond their faces: `NONE` outside the whole mesh,
    /// `BEYOND` where it goes on.
    ///
    /// # Errors
    /// [`Error::Mesh`] if more than two cells share a face.
    pub fn local_mesh(&self) -> Result<(TetMesh, Vec<[u32; 4]>)> {
        let here = |n: u32| self.nodes.partition_point(|(number, _)| *number < n) as u32;
        let mesh = TetMesh {
            nodes: self.nodes.iter().map(|(_, x)| *x).collect(),
            tets: self.cells.iter().map(|cell| cell.nodes.map(here)).collect(),
        };
        let shared = |face: [u32; 3]| {
            Error::Mesh(cause(
                format!("face {:?}", face.map(|n| self.global_node(n))),
                "belongs to more than two tetrahedra",
                "mesh the image again",
            ))
        };
        let mut neighbors = complex::neighbors(mesh.nodes.len(), &mesh.tets).map_err(shared)?;
        for (around, cell) in neighbors.iter_mut().zip(&self.cells) {
            for (k, beyond) in around.iter_mut().enumerate() {
                if *beyond == NONE && cell.boundary_faces >> k & 1 == 0 {
                    *beyond = NOT_LOCAL;
                }
            }
        }
        Ok((mesh, neighbors))
    }

    /// The marks of the cells.
    pub fn local_marks(&self) -> Vec<u8> {
        self.cells.iter().map(|cell| cell.marks).collect()
    }

    /// The whole's number of a cell.
    pub fn global_cell(&self, c: u32) -> usize {
        self.cells[c as usize].global_id
    }

    /// Which cell has that number in the whole; it is here.
    pub fn local_cell(&self, number: usize) -> u32 {
        self.cells.partition_point(|cell| cell.global_id < number) as u32
    }

    /// The whole's number of a node.
    pub fn global_node(&self, n: u32) -> u32 {
        self.nodes[n as usize].0
    }
}

/// For each node of a piece, whether it is one of those, which are given by the whole's numbers.
fn node_mask(piece: &MeshPartition, those: &[u32]) -> Vec<bool> {
    let mut among = vec![false; piece.global_ids.len()];
    for number in those {
        if let Ok(n) = piece.global_ids.binary_search(number) {
            among[n] = true;
        }
    }
    among
}

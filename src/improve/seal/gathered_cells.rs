//! The cells at some nodes of a partitioned mesh, gathered from all ranks. Each rank has the same.

use crate::geometry::sorted_distinct;
use crate::parallel::prelude::*;

use crate::comm::Comm;
use crate::error::cause;
use crate::files::codec::codec_fields;
use crate::mesh::TetMesh;
use crate::mesh::complex::{self, NONE, NOT_LOCAL};
use crate::mesh::partition::MeshPartition;
use crate::{Error, Result};

/// A cell as its owner sends it.
#[derive(Debug, Clone, Copy)]
struct GatheredCell {
    /// Global index of the cell, and of its nodes.
    global_id: usize,
    nodes: [u32; 4],
    /// Bit k for face k: the marked faces, and the faces on the outside of the mesh.
    marks: u8,
    boundary_faces: u8,
}

codec_fields! {
    GatheredCell as GatheredCell { global_id, nodes, marks, boundary_faces }
}

/// All cells at some nodes.
#[derive(Debug, Default)]
pub(super) struct GatheredCells {
    /// Cells in the order of their global indices.
    cells: Vec<GatheredCell>,
    /// Global indices of the nodes, rising, and their positions.
    nodes: Vec<(u32, [f64; 3])>,
    /// Global indices of the nodes whose cells are all gathered, rising.
    complete_nodes: Vec<u32>,
}

impl GatheredCells {
    /// Gathers the cells at more nodes. Returns the other nodes of these cells, except those whose
    /// cells are all gathered.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn gather(
        &mut self,
        new_nodes: &[u32],
        partition: &MeshPartition,
        marks: &[u8],
        comm: &dyn Comm,
    ) -> Result<Vec<u32>> {
        let (is_new, is_complete) = (
            node_mask(partition, new_nodes),
            node_mask(partition, &self.complete_nodes),
        );
        let has_any = |mask: &[bool], tet: &[u32; 4]| tet.iter().any(|&n| mask[n as usize]);
        let tets = partition.mesh.tets.par_iter().enumerate();
        let cells = tets.filter(|(_, tet)| has_any(&is_new, tet) && !has_any(&is_complete, tet));
        let cells: Vec<GatheredCell> = cells
            .map(|(c, tet)| GatheredCell {
                global_id: partition.first_cell + c,
                nodes: tet.map(|n| partition.global_ids[n as usize]),
                marks: marks[c],
                boundary_faces: (0..4)
                    .filter(|&k| partition.neighbors[c][k] == NONE)
                    .map(|k| 1 << k)
                    .sum(),
            })
            .collect();
        let nodes = sorted_distinct(
            cells
                .iter()
                .flat_map(|cell| partition.mesh.tets[cell.global_id - partition.first_cell]),
        );
        let with_position = |n: u32| {
            (
                partition.global_ids[n as usize],
                partition.mesh.nodes[n as usize],
            )
        };
        let nodes: Vec<(u32, [f64; 3])> = nodes.into_iter().map(with_position).collect();
        let mut other_nodes = Vec::new();
        for (cells, nodes) in comm.all_gather("cells near rims", (cells, nodes))? {
            other_nodes.extend(nodes.iter().map(|(id, _)| *id));
            self.cells.extend(cells);
            self.nodes.extend(nodes);
        }
        self.cells.sort_unstable_by_key(|cell| cell.global_id);
        self.nodes.sort_unstable_by_key(|(id, _)| *id);
        self.nodes.dedup_by_key(|(id, _)| *id);
        self.complete_nodes.extend(new_nodes);
        self.complete_nodes.sort_unstable();
        self.complete_nodes.dedup();
        other_nodes.sort_unstable();
        other_nodes.dedup();
        other_nodes.retain(|id| self.complete_nodes.binary_search(id).is_err());
        Ok(other_nodes)
    }

    /// Returns the cells as a mesh, and the cells adjacent to their faces: `NONE` outside of the
    /// whole mesh, `NOT_LOCAL` where the mesh continues with cells that are not gathered.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] if more than two cells share a face.
    pub fn local_mesh(&self) -> Result<(TetMesh, Vec<[u32; 4]>)> {
        let to_local = |n: u32| self.nodes.partition_point(|(id, _)| *id < n) as u32;
        let mesh = TetMesh {
            nodes: self.nodes.iter().map(|(_, x)| *x).collect(),
            tets: self
                .cells
                .iter()
                .map(|cell| cell.nodes.map(to_local))
                .collect(),
        };
        let shared_face_error = |face: [u32; 3]| {
            Error::Mesh(cause(
                format!("face {:?}", face.map(|n| self.global_node(n))),
                "belongs to more than two tetrahedra",
                "mesh the image again",
            ))
        };
        let mut neighbors =
            complex::neighbors(mesh.nodes.len(), &mesh.tets).map_err(shared_face_error)?;
        for (adjacent, cell) in neighbors.iter_mut().zip(&self.cells) {
            for (k, neighbor) in adjacent.iter_mut().enumerate() {
                if *neighbor == NONE && cell.boundary_faces >> k & 1 == 0 {
                    *neighbor = NOT_LOCAL;
                }
            }
        }
        Ok((mesh, neighbors))
    }

    /// Returns the marks of the cells.
    pub fn local_marks(&self) -> Vec<u8> {
        self.cells.iter().map(|cell| cell.marks).collect()
    }

    /// Returns the global index of a cell.
    pub fn global_cell(&self, c: u32) -> usize {
        self.cells[c as usize].global_id
    }

    /// Returns the local index of a cell that is gathered, given by its global index.
    pub fn local_cell(&self, global_id: usize) -> u32 {
        self.cells
            .partition_point(|cell| cell.global_id < global_id) as u32
    }

    /// Returns the global index of a node.
    pub fn global_node(&self, n: u32) -> u32 {
        self.nodes[n as usize].0
    }
}

/// Returns, for each node of a partition, `true` if it is one of `global_ids`.
fn node_mask(partition: &MeshPartition, global_ids: &[u32]) -> Vec<bool> {
    let mut mask = vec![false; partition.global_ids.len()];
    for id in global_ids {
        if let Ok(n) = partition.global_ids.binary_search(id) {
            mask[n] = true;
        }
    }
    mask
}

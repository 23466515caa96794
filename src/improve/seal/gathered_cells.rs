//! The cells at some nodes of a mesh, gathered from all ranks. Each rank has the same.

use crate::geometry::sorted_distinct;
use crate::parallel::prelude::*;

use super::local_surface::LocalSurface;
use crate::error::cause;
use crate::files::codec::codec_fields;
use crate::mesh::Simplices;
use crate::mesh::complex::{NONE, NOT_LOCAL};
use crate::mesh::view::MeshView;
use crate::{Error, Result};

/// A cell as its owner sends it.
#[derive(Debug, Clone, Copy)]
struct GatheredCell {
    /// Global index of the cell, and of its nodes. In the plane the last is `NONE`.
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
pub(super) struct GatheredCells<const D: usize> {
    /// Cells in the order of their global indices.
    cells: Vec<GatheredCell>,
    /// Global indices of the nodes, rising, and their positions.
    nodes: Vec<(u32, [f64; D])>,
    /// Global indices of the nodes whose cells are all gathered, rising.
    complete_nodes: Vec<u32>,
}

impl<const D: usize> GatheredCells<D> {
    /// Gathers the cells at more nodes. Returns the other nodes of these cells, except those whose
    /// cells are all gathered.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn gather<M: Simplices<D>>(
        &mut self,
        new_nodes: &[u32],
        local: &LocalSurface<'_, D, M>,
    ) -> Result<Vec<u32>> {
        let (view, surface) = (local.view, &local.surface);
        let (is_new, is_complete) = (
            node_mask(view, new_nodes),
            node_mask(view, &self.complete_nodes),
        );
        let has_any = |mask: &[bool], c: usize| {
            let mut nodes = view.mesh.cell(c).iter();
            nodes.any(|&n| mask[n as usize])
        };
        let cells = (0..view.mesh.len()).into_par_iter();
        let cells = cells.filter(|&c| has_any(&is_new, c) && !has_any(&is_complete, c));
        let cells: Vec<GatheredCell> = cells
            .map(|c| {
                let mut nodes = [NONE; 4];
                for (slot, &n) in nodes.iter_mut().zip(view.mesh.cell(c)) {
                    *slot = view.global_id(n);
                }
                let adjacent = &surface.neighbours[(D + 1) * c..(D + 1) * (c + 1)];
                GatheredCell {
                    global_id: view.first_cell + c,
                    nodes,
                    marks: surface.marks[c],
                    boundary_faces: (0..=D)
                        .filter(|&k| adjacent[k] == NONE)
                        .map(|k| 1 << k)
                        .sum(),
                }
            })
            .collect();
        let nodes = sorted_distinct((cells.iter()).flat_map(|cell| {
            view.mesh
                .cell(cell.global_id - view.first_cell)
                .iter()
                .copied()
        }));
        let with_position = |n: u32| (view.global_id(n), view.mesh.nodes()[n as usize]);
        let nodes: Vec<(u32, [f64; D])> = nodes.into_iter().map(with_position).collect();
        let (cells, nodes) =
            view.merge_parts("cells near rims", (cells, nodes), |mut all, mut part| {
                all.0.append(&mut part.0);
                all.1.append(&mut part.1);
                all
            })?;
        let mut other_nodes = sorted_distinct(nodes.iter().map(|(id, _)| *id));
        self.cells.extend(cells);
        self.nodes.extend(nodes);
        self.cells.sort_unstable_by_key(|cell| cell.global_id);
        self.nodes.sort_unstable_by_key(|(id, _)| *id);
        self.nodes.dedup_by_key(|(id, _)| *id);
        self.complete_nodes.extend(new_nodes);
        self.complete_nodes.sort_unstable();
        self.complete_nodes.dedup();
        other_nodes.retain(|id| self.complete_nodes.binary_search(id).is_err());
        Ok(other_nodes)
    }

    /// Returns the cells as a mesh, and the cells adjacent to their faces: `NONE` outside of the
    /// whole mesh, `NOT_LOCAL` where the mesh continues with cells that are not gathered.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] if more than two cells share a face.
    pub fn local_mesh<M: Simplices<D>>(&self) -> Result<(M, Vec<u32>)> {
        let to_local = |n: &u32| self.nodes.partition_point(|(id, _)| id < n) as u32;
        let corners = self.cells.iter().flat_map(|cell| &cell.nodes[..=D]);
        let mesh = M::from_parts(
            self.nodes.iter().map(|(_, x)| *x).collect(),
            corners.map(to_local).collect(),
        );
        let shared_face_error = |face: Vec<u32>| {
            let face: Vec<u32> = face.into_iter().map(|n| self.global_node(n)).collect();
            Error::Mesh(cause(
                format!("face {face:?}"),
                format!("belongs to more than two {}", M::CELLS_NAME),
                "mesh the image again",
            ))
        };
        let mut neighbours = mesh.neighbours().map_err(shared_face_error)?;
        for (adjacent, cell) in neighbours.chunks_exact_mut(D + 1).zip(&self.cells) {
            for (k, neighbour) in adjacent.iter_mut().enumerate() {
                if *neighbour == NONE && cell.boundary_faces >> k & 1 == 0 {
                    *neighbour = NOT_LOCAL;
                }
            }
        }
        Ok((mesh, neighbours))
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

/// Returns, for each local node, `true` if it is one of `global_ids`.
fn node_mask<const D: usize, M: Simplices<D>>(
    view: &MeshView<'_, D, M>,
    global_ids: &[u32],
) -> Vec<bool> {
    let mut mask = vec![false; view.mesh.nodes().len()];
    for &id in global_ids {
        if let Some(n) = view.local_node(id) {
            mask[n as usize] = true;
        }
    }
    mask
}

//! A view of a mesh for measurements: all of it, or the local part of a distributed mesh. With it
//! each measurement is written once for both cases.

use super::mesh_partition::MeshPartition;
use super::{Mesh, TetMesh};
use crate::Result;
use crate::comm::{Comm, SelfComm};
use crate::files::codec::Codec;
use crate::geometry::sorted;

/// Consecutive cells of a mesh, or all of them, and the ranks that have the others.
pub struct MeshView<'a, const D: usize, M> {
    /// The cells, and their nodes.
    pub mesh: &'a M,
    /// Global number of each node, ascending; `None` if local and global numbers are equal.
    global_ids: Option<&'a [u32]>,
    /// Nodes that other ranks may have too, ascending.
    shared_nodes: Vec<u32>,
    /// Global number of the first cell.
    pub first_cell: usize,
    /// Number of nodes and number of cells of the global mesh.
    pub global_counts: [usize; 2],
    /// The ranks that have the parts of the mesh.
    pub comm: &'a dyn Comm,
}

impl<'a, const D: usize, M: Mesh<D>> MeshView<'a, D, M> {
    /// Creates a view of a whole mesh.
    pub fn from_mesh(mesh: &'a M) -> Self {
        Self {
            mesh,
            global_ids: None,
            shared_nodes: Vec::new(),
            first_cell: 0,
            global_counts: [mesh.nodes().len(), mesh.len()],
            comm: &SelfComm,
        }
    }
}

impl<'a> MeshView<'a, 3, TetMesh> {
    /// Creates a view of the partition of this rank, where each rank of `comm` has one partition.
    pub fn from_partition(partition: &'a MeshPartition, comm: &'a dyn Comm) -> Self {
        Self {
            mesh: &partition.mesh,
            global_ids: Some(&partition.global_ids),
            shared_nodes: partition.shared_nodes(),
            first_cell: partition.first_cell,
            global_counts: partition.global_counts,
            comm,
        }
    }
}

impl<'a, const D: usize, M: super::Simplices<D>> MeshView<'a, D, M> {
    /// Creates a view of the cells of this rank for measurements cell by cell. `first_cell` is the
    /// global number of the first cell; `global_counts` are the numbers of nodes and of cells of
    /// the global mesh.
    pub fn from_cells(
        mesh: &'a M,
        first_cell: usize,
        global_counts: [usize; 2],
        comm: &'a dyn Comm,
    ) -> Self {
        Self {
            mesh,
            global_ids: None,
            shared_nodes: Vec::new(),
            first_cell,
            global_counts,
            comm,
        }
    }
}

impl<'a, const D: usize, M: Mesh<D>> MeshView<'a, D, M> {
    /// Returns a view of the same cells with the nodes of another mesh.
    pub fn with_mesh<'b>(&self, mesh: &'b M) -> MeshView<'b, D, M>
    where
        'a: 'b,
    {
        MeshView {
            mesh,
            shared_nodes: self.shared_nodes.clone(),
            ..*self
        }
    }

    /// Returns the global number of a node.
    #[inline]
    pub fn global_id(&self, node: u32) -> u32 {
        self.global_ids
            .map_or(node, |global_ids| global_ids[node as usize])
    }

    /// Returns the local node with this global number, if there is one.
    pub fn local_node(&self, global_id: u32) -> Option<u32> {
        match self.global_ids {
            None => Some(global_id),
            Some(global_ids) => global_ids.binary_search(&global_id).ok().map(|n| n as u32),
        }
    }

    /// Returns the rank that collects what all ranks know of a node, given by its global number.
    pub fn owner_rank(&self, global_id: u32) -> usize {
        let size = self.comm.size();
        (global_id as usize * size / self.global_counts[0].max(1)).min(size - 1)
    }

    /// Returns for each node whether other ranks may have it.
    pub fn shared_mask(&self) -> Vec<bool> {
        let mut is_shared = vec![false; self.mesh.nodes().len()];
        for &node in &self.shared_nodes {
            is_shared[node as usize] = true;
        }
        is_shared
    }

    /// Marks the local nodes that are marked on any rank. `message` names the communication in
    /// error messages.
    ///
    /// # Errors
    /// Returns the errors of the communication.
    pub fn combine_shared_marks(&self, message: &str, marks: &mut [bool]) -> Result<()> {
        let mut by_rank = vec![Vec::new(); self.comm.size()];
        for &node in &self.shared_nodes {
            let global_id = self.global_id(node);
            by_rank[self.owner_rank(global_id)].push((global_id, marks[node as usize]));
        }
        let mut received = self.comm.all_to_all(message, by_rank)?;
        let marked = received.iter().flatten().filter(|(_, marked)| *marked);
        let marked: Vec<u32> = sorted(marked.map(|(global_id, _)| *global_id).collect());
        for (global_id, is_marked) in received.iter_mut().flatten() {
            *is_marked = marked.binary_search(global_id).is_ok();
        }
        for (global_id, is_marked) in self
            .comm
            .all_to_all(message, received)?
            .into_iter()
            .flatten()
        {
            if let Some(node) = self.local_node(global_id) {
                marks[node as usize] |= is_marked;
            }
        }
        Ok(())
    }

    /// Gathers the values of shared nodes from all ranks that have them. The values of one node
    /// arrive at one rank, its owner; the result is sorted by global number.
    ///
    /// # Errors
    /// Returns the errors of the communication.
    pub fn gather_shared<T: Codec>(
        &self,
        message: &str,
        value_of: impl Fn(u32) -> T,
    ) -> Result<Vec<(u32, T)>> {
        let mut by_rank: Vec<Vec<(u32, T)>> = (0..self.comm.size()).map(|_| Vec::new()).collect();
        for &node in &self.shared_nodes {
            let global_id = self.global_id(node);
            by_rank[self.owner_rank(global_id)].push((global_id, value_of(node)));
        }
        let received = self.comm.all_to_all(message, by_rank)?;
        let mut values: Vec<(u32, T)> = received.into_iter().flatten().collect();
        values.sort_by_key(|(global_id, _)| *global_id);
        Ok(values)
    }
}

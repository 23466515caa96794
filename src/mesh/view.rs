//! A mesh as those see it who measure it: all of it, or some cells, of which others hold the rest. So what is
//! measured is written once.

use super::partition::MeshPartition;
use super::{Simplices, TetMesh};
use crate::comm::{Comm, LocalOrComm, SelfComm};
use crate::files::codec::Codec;

/// Some of a mesh's cells, one after the other, or all; and who holds the others.
pub struct MeshView<'a, const D: usize, M, H: ?Sized> {
    /// The cells, and their nodes.
    pub mesh: &'a M,
    /// The whole's number of each node, rising; `None` if this is the whole.
    global_ids: Option<&'a [u32]>,
    /// The nodes that others may have too, rising.
    shared_nodes: Vec<u32>,
    /// The whole's number of the first cell.
    pub first_cell: usize,
    /// Nodes and cells of the whole.
    pub global_counts: [usize; 2],
    /// Who holds the parts.
    pub comm: &'a H,
}

impl<'a, const D: usize, M: Simplices<D>> MeshView<'a, D, M, SelfComm> {
    /// All of a mesh.
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

impl<'a> MeshView<'a, 3, TetMesh, dyn Comm + 'a> {
    /// A piece of a mesh of which the group holds one each.
    pub fn from_partition(piece: &'a MeshPartition, group: &'a (dyn Comm + 'a)) -> Self {
        Self {
            mesh: &piece.mesh,
            global_ids: Some(&piece.global_ids),
            shared_nodes: piece.shared_nodes(),
            first_cell: piece.first_cell,
            global_counts: piece.global_counts,
            comm: group,
        }
    }
}

impl<'a, const D: usize, M: Simplices<D>> MeshView<'a, D, M, dyn Comm + 'a> {
    /// The cells that one of a group has, of which the `first` has this number in the whole: for what is measured cell
    /// by cell. There are so many nodes and cells in the `whole`.
    pub fn from_cells(
        mesh: &'a M,
        first_cell: usize,
        global_counts: [usize; 2],
        group: &'a (dyn Comm + 'a),
    ) -> Self {
        Self {
            mesh,
            global_ids: None,
            shared_nodes: Vec::new(),
            first_cell,
            global_counts,
            comm: group,
        }
    }
}

impl<'a, const D: usize, M: Simplices<D>, H: LocalOrComm + ?Sized> MeshView<'a, D, M, H> {
    /// The same cells with nodes elsewhere.
    pub fn with_mesh(self, mesh: &'a M) -> Self {
        Self { mesh, ..self }
    }

    /// The whole's number of a node.
    #[inline]
    pub fn global_id(&self, node: u32) -> u32 {
        self.global_ids
            .map_or(node, |numbers| numbers[node as usize])
    }

    /// The node here that has this number in the whole.
    pub fn local_node(&self, number: u32) -> Option<u32> {
        match self.global_ids {
            None => Some(number),
            Some(numbers) => numbers.binary_search(&number).ok().map(|n| n as u32),
        }
    }

    /// Whether others may have a node, for each.
    pub fn shared_mask(&self) -> Vec<bool> {
        let mut is_shared = vec![false; self.mesh.nodes().len()];
        for &node in &self.shared_nodes {
            is_shared[node as usize] = true;
        }
        is_shared
    }

    /// Marks the nodes here that are marked in any part.
    ///
    /// # Errors
    /// Those of the others.
    pub fn combine_shared_marks(&self, what: &str, marks: &mut [bool]) -> Result<(), H::Error> {
        let owner = |node: u32| {
            self.comm
                .owner_rank(self.global_id(node), self.global_counts[0])
        };
        let mut to = vec![Vec::new(); self.comm.size()];
        for &node in &self.shared_nodes {
            to[owner(node)].push((self.global_id(node), marks[node as usize]));
        }
        let mut told = self.comm.try_all_to_all(what, to)?;
        let marked = told.iter().flatten().filter(|(_, marked)| *marked);
        let mut marked: Vec<u32> = marked.map(|(number, _)| *number).collect();
        marked.sort_unstable();
        for (number, is_marked) in told.iter_mut().flatten() {
            *is_marked = marked.binary_search(number).is_ok();
        }
        for (number, is_marked) in self.comm.try_all_to_all(what, told)?.into_iter().flatten() {
            if let Some(node) = self.local_node(number) {
                marks[node as usize] |= is_marked;
            }
        }
        Ok(())
    }

    /// What each part that has a node says of it, of the nodes that parts share: at one of them for each node, by
    /// the whole's numbers, rising.
    ///
    /// # Errors
    /// Those of the others.
    pub fn gather_shared<T: Codec>(
        &self,
        what: &str,
        of: impl Fn(u32) -> T,
    ) -> Result<Vec<(u32, T)>, H::Error> {
        let mut to: Vec<Vec<(u32, T)>> = (0..self.comm.size()).map(|_| Vec::new()).collect();
        for &node in &self.shared_nodes {
            let number = self.global_id(node);
            to[self.comm.owner_rank(number, self.global_counts[0])].push((number, of(node)));
        }
        let from = self.comm.try_all_to_all(what, to)?;
        let mut said: Vec<(u32, T)> = from.into_iter().flatten().collect();
        said.sort_by_key(|(number, _)| *number);
        Ok(said)
    }
}

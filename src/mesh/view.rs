//! A view of a mesh for measurements: all of it, or the local part of a distributed mesh. With it
//! each measurement is written once for both cases.
//!
//! Only the view knows the ranks that have the other parts. Measurements merge what the parts have
//! found, concatenate lists of all parts, number what the parts have, and exchange what parts know
//! of the same nodes. These calls are collective: all ranks make the same ones in the same order,
//! each with a message that names the call if ranks are out of step. They return the errors of the
//! communication.

use super::mesh_partition::MeshPartition;
use super::{Mesh, TetMesh};
use crate::Result;
use crate::comm::selection::{RadixKey, order_statistics};
use crate::comm::{self, Comm, SelfComm};
use crate::files::codec::Codec;

/// Message for [`Result::expect`], for work on a whole mesh whose only errors are those of
/// communication.
pub const WHOLE_MESH_NEVER_FAILS: &str = SelfComm::NEVER_FAILS;

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
    comm: &'a dyn Comm,
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

    /// Returns for each node whether other ranks may have it.
    pub fn shared_mask(&self) -> Vec<bool> {
        let mut is_shared = vec![false; self.mesh.nodes().len()];
        for &node in &self.shared_nodes {
            is_shared[node as usize] = true;
        }
        is_shared
    }

    /// Marks the local nodes that are marked in any part.
    pub fn combine_shared_marks(&self, message: &str, marks: &mut [bool]) -> Result<()> {
        let entry = |&node: &u32| ([self.global_id(node)], marks[node as usize]);
        let entries = self.shared_nodes.iter().map(entry).collect();
        let combined = self.exchange_by_nodes(message, entries, |copies| {
            let is_marked = copies.iter().any(|copy| copy.value);
            vec![is_marked; copies.len()]
        })?;
        for (&node, is_marked) in self.shared_nodes.iter().zip(combined) {
            marks[node as usize] |= is_marked;
        }
        Ok(())
    }

    /// Collects the values of shared nodes from all parts that have them. The values of one node
    /// arrive at one rank; they are sorted by the global number of the node.
    pub fn gather_shared<T: Codec>(
        &self,
        message: &str,
        value_of: impl Fn(u32) -> T,
    ) -> Result<Vec<(u32, T)>> {
        let entry = |&node: &u32| ([self.global_id(node)], value_of(node));
        let entries = self.shared_nodes.iter().map(entry).collect();
        let collected = self.collect_by_nodes(message, entries)?.into_iter();
        Ok(collected.map(|copy| (copy.nodes[0], copy.value)).collect())
    }
}

/// A value that a part of a mesh has at some nodes, such as those of a face.
#[derive(Debug, Clone, Copy)]
pub struct ValueAtNodes<const N: usize, T> {
    /// Global numbers of the nodes.
    pub nodes: [u32; N],
    /// The part that sent the value, and the position of the value among those that it sent.
    pub sender: (usize, usize),
    /// The value.
    pub value: T,
}

impl<const D: usize, M> MeshView<'_, D, M> {
    /// Returns `true` if other ranks have other parts of the mesh.
    pub fn is_partitioned(&self) -> bool {
        self.comm.size() > 1
    }

    /// Merges what the parts have found, in the order of the parts.
    pub fn merge_parts<T: Codec>(
        &self,
        message: &str,
        local: T,
        merge: impl FnMut(T, T) -> T,
    ) -> Result<T> {
        let mut parts = self.comm.all_gather(message, local)?.into_iter();
        let first = parts.next().expect("a mesh has at least one part");
        Ok(parts.fold(first, merge))
    }

    /// Returns `true` if a flag is set in any part.
    pub fn is_any(&self, message: &str, flag: bool) -> Result<bool> {
        self.merge_parts(message, flag, |a, b| a || b)
    }

    /// Concatenates the lists of all parts, in the order of the parts.
    pub fn concatenate<T: Codec>(&self, message: &str, local: Vec<T>) -> Result<Vec<T>> {
        Ok(comm::concatenate(self.comm.all_gather(message, local)?))
    }

    /// Numbers what the parts have, in the order of the parts. Returns the number of the first of
    /// the `count` local ones.
    pub fn first_number(&self, message: &str, count: usize) -> Result<usize> {
        let counts: Vec<usize> = self.comm.all_gather(message, count)?;
        Ok(counts[..self.comm.rank()].iter().sum())
    }

    /// Returns for each series of local values those with the given ranks in sorted order among the
    /// values of all parts, as [`order_statistics`] does.
    pub fn order_statistics<V: RadixKey, R: AsRef<[usize]>>(
        &self,
        series: &[impl Iterator<Item = V> + Clone + Sync],
        ranks: &[impl Fn(usize) -> R],
    ) -> Result<Vec<Vec<f64>>> {
        order_statistics(series, ranks, self.comm)
    }

    /// Returns what all parts have in the box `bounds` of this part. `select` returns what this part
    /// has in a box. The messages name the exchange of the boxes, and that of their contents.
    pub fn gather_in_box<T: Codec>(
        &self,
        messages: [&str; 2],
        bounds: [[f64; D]; 2],
        select: impl Fn([[f64; D]; 2]) -> Vec<T>,
    ) -> Result<Vec<T>> {
        let boxes = self.comm.all_gather(messages[0], bounds)?;
        let selected = boxes.into_iter().map(select).collect();
        Ok(comm::concatenate(
            self.comm.all_to_all(messages[1], selected)?,
        ))
    }

    /// Asks all parts the questions of this part, and returns the answers of each part. `answer`
    /// answers the questions of all parts. Returns `None` if no part has a question. The messages
    /// name the exchange of the questions, and that of the answers.
    pub fn ask_parts<Q: Codec, A: Codec>(
        &self,
        messages: [&str; 2],
        questions: Vec<Q>,
        answer: impl FnOnce(&[Q]) -> Vec<A>,
    ) -> Result<Option<Vec<Vec<A>>>> {
        let all = self.comm.all_gather(messages[0], questions)?;
        let counts: Vec<usize> = all.iter().map(Vec::len).collect();
        let all = comm::concatenate(all);
        if all.is_empty() {
            return Ok(None);
        }
        let mut answers = answer(&all).into_iter();
        let of_part = |count: usize| answers.by_ref().take(count).collect();
        let answers = counts.into_iter().map(of_part).collect();
        self.comm.all_to_all(messages[1], answers).map(Some)
    }

    /// Collects the values that the parts have at the same nodes: all of them arrive at one rank,
    /// sorted by nodes and then by parts.
    pub fn collect_by_nodes<const N: usize, T: Codec>(
        &self,
        message: &str,
        entries: Vec<([u32; N], T)>,
    ) -> Result<Vec<ValueAtNodes<N, T>>> {
        let mut sent: Vec<Vec<([u32; N], T)>> = Vec::new();
        sent.resize_with(self.comm.size(), Vec::new);
        for entry in entries {
            sent[self.collecting_rank(entry.0)].push(entry);
        }
        let mut collected = Vec::new();
        for (part, values) in self.comm.all_to_all(message, sent)?.into_iter().enumerate() {
            let values = values.into_iter().enumerate();
            collected.extend(values.map(|(index, (nodes, value))| ValueAtNodes {
                nodes,
                sender: (part, index),
                value,
            }));
        }
        collected.sort_unstable_by_key(|entry| (entry.nodes, entry.sender));
        Ok(collected)
    }

    /// Exchanges what the parts know of the same nodes. `answers` gets all values at some nodes, in
    /// the order of the parts, and returns the answer to each. Returns the answer to each of the
    /// `entries`.
    pub fn exchange_by_nodes<const N: usize, T: Codec, A: Codec + Clone + Default>(
        &self,
        message: &str,
        entries: Vec<([u32; N], T)>,
        answers: impl Fn(&[ValueAtNodes<N, T>]) -> Vec<A>,
    ) -> Result<Vec<A>> {
        let ranks: Vec<usize> = (entries.iter().map(|entry| entry.0))
            .map(|nodes| self.collecting_rank(nodes))
            .collect();
        let collected = self.collect_by_nodes(message, entries)?;
        let mut sent = vec![Vec::new(); self.comm.size()];
        for entry in &collected {
            sent[entry.sender.0].push(A::default());
        }
        for copies in collected.chunk_by(|a, b| a.nodes == b.nodes) {
            for (copy, answer) in copies.iter().zip(answers(copies)) {
                sent[copy.sender.0][copy.sender.1] = answer;
            }
        }
        let received = self.comm.all_to_all(message, sent)?;
        let mut received: Vec<_> = received.into_iter().map(Vec::into_iter).collect();
        let answer = |rank: usize| received[rank].next().unwrap_or_default();
        Ok(ranks.into_iter().map(answer).collect())
    }

    /// Returns the rank that collects the values at some nodes, given by their global numbers.
    fn collecting_rank<const N: usize>(&self, nodes: [u32; N]) -> usize {
        let size = self.comm.size();
        (nodes[0] as usize * size / self.global_counts[0].max(1)).min(size - 1)
    }
}

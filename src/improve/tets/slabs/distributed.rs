//! The slabs of all ranks: each rank has successive slabs, and the tetrahedra in them. What ranks
//! exchange fails if another rank fails.

use std::ops::Range;

use super::submesh::SubMesh;
use super::{BAND_HALF_WIDTH, ImprovedPart, SlabCuts, SlabResult};
use crate::Result;
use crate::comm::selection::order_statistics;
use crate::comm::{Comm, concatenate, partition_range};
use crate::geometry::sorted;
use crate::improve::{BlockedCell, ImproveReport, OperationCounts};
use crate::lattice::distance::Distance;
use crate::mesh::TetMesh;
use crate::mesh::complex::{NONE, NOT_LOCAL};
use crate::mesh::mesh_partition::MeshPartition;
use crate::parallel::prelude::*;

/// The slabs into which a mesh is cut, of which each rank has successive ones.
pub struct DistributedSlabs<'a> {
    /// The planes between the slabs.
    pub cuts: SlabCuts,
    comm: &'a dyn Comm,
}

impl<'a> DistributedSlabs<'a> {
    /// Cuts a mesh so that all slabs have the same number of atoms, where each rank has a part
    /// of the atoms. Returns `None` if there is only one slab.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn cut(
        owned: &[[f64; 3]],
        extent: [f64; 3],
        distance: &Distance<3>,
        comm: &'a dyn Comm,
    ) -> Result<Option<Self>> {
        let Some(axis) = (0..3).max_by(|&k, &l| extent[k].total_cmp(&extent[l])) else {
            return Ok(None);
        };
        let half_width = BAND_HALF_WIDTH * distance.max();
        let atoms: Vec<usize> = comm.all_gather("atoms", owned.len())?;
        let atoms = atoms.iter().sum();
        let max_count = SlabCuts::max_slabs(atoms, extent[axis], distance.max());
        let coordinates = owned.iter().map(|x| x[axis]);
        for count in (2..=max_count).rev() {
            let order_indices: Vec<usize> = (1..count).map(|i| i * atoms / count).collect();
            let cut_positions = order_statistics(
                std::slice::from_ref(&coordinates),
                &[|_| &order_indices],
                comm,
            )?
            .swap_remove(0);
            let mut ends = vec![0.0];
            ends.extend(&cut_positions);
            ends.push(extent[axis]);
            // Bands must not touch each other.
            if ends
                .windows(2)
                .all(|pair| pair[1] - pair[0] > 3.0 * half_width)
            {
                let cuts = SlabCuts {
                    axis,
                    positions: cut_positions,
                    half_width,
                };
                return Ok(Some(Self::new(cuts, comm)));
            }
        }
        Ok(None)
    }

    /// Shares the slabs between cuts among the ranks of `comm`.
    pub fn new(cuts: SlabCuts, comm: &'a dyn Comm) -> Self {
        Self { cuts, comm }
    }

    /// Returns the slabs of this rank.
    pub fn local_slabs(&self) -> Range<usize> {
        partition_range(self.cuts.count(), self.comm.rank(), self.comm.size())
    }

    /// Returns the rank that has a slab.
    pub(super) fn owner(&self, slab: usize) -> usize {
        let (slabs, ranks) = (self.cuts.count(), self.comm.size());
        let owns = |rank: &usize| partition_range(slabs, *rank, ranks).contains(&slab);
        (0..ranks).find(owns).unwrap_or(0)
    }

    /// Gathers the improved slabs of all ranks on every rank.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn all_gather(&self, mut local: SlabResult) -> Result<SlabResult> {
        if self.comm.size() == 1 {
            // Done in place, as this is the largest of all arrays.
            let neighbours = local.partition.neighbours.as_flattened_mut().par_iter_mut();
            neighbours
                .filter(|n| **n == NOT_LOCAL)
                .for_each(|n| *n = NONE);
            return Ok(local);
        }
        let SlabResult {
            partition,
            kinds,
            feature_faces,
            report,
        } = local;
        let (first_cell, global_counts) = (0, partition.global_counts);
        let submesh = SubMesh {
            constraints: Vec::new(),
            neighbours: partition.local_neighbours(),
            global_ids: partition.global_ids,
            nodes: partition.mesh.nodes,
            kinds,
            tets: partition.mesh.tets,
        };
        let parts: Vec<(SubMesh, Vec<u8>)> = self
            .comm
            .all_gather("partitions", (submesh, feature_faces))?;
        let (parts, marks): (Vec<SubMesh>, Vec<Vec<u8>>) = parts.into_iter().unzip();
        let submesh = SubMesh::merge(parts);
        Ok(SlabResult {
            partition: MeshPartition {
                mesh: TetMesh {
                    nodes: submesh.nodes,
                    tets: submesh.tets,
                },
                neighbours: submesh.neighbours,
                global_ids: submesh.global_ids,
                first_cell,
                global_counts,
            },
            kinds: submesh.kinds,
            feature_faces: marks.concat(),
            report,
        })
    }

    /// Cuts improved bands at their cuts, and returns the halves of bands at each of a rank's own slabs.
    /// The half beyond the cut goes to the rank of the next slab.
    pub(super) fn exchange_bands(&self, bands: Vec<ImprovedPart>) -> Result<Vec<Vec<SubMesh>>> {
        let (cuts, comm, own_slabs) = (&self.cuts, self.comm, self.local_slabs());
        let first = usize::from(own_slabs.start == 0);
        let mut parts: Vec<Vec<SubMesh>> = own_slabs.clone().map(|_| Vec::new()).collect();
        let mut outgoing: Vec<Vec<SubMesh>> = vec![Vec::new(); comm.size()];
        for ((slab, parts), band) in own_slabs.zip(&mut parts).zip(bands) {
            let half_band = |before: bool| {
                (band.submesh).filter_tets(|t| cuts.is_before_cut(&band.submesh, t, slab) == before)
            };
            let (before, after) = rayon::join(|| half_band(true), || half_band(false));
            parts.push(before);
            outgoing[self.owner(slab + 1)].push(after);
        }
        let incoming = comm.all_to_all("bands", outgoing)?.concat();
        for (parts, part) in parts.iter_mut().skip(first).zip(incoming) {
            parts.push(part);
        }
        Ok(parts)
    }

    /// Adds up what all ranks did. The blocked cells are those with the smallest margins first.
    pub(super) fn merge_reports(
        &self,
        below_target_before: usize,
        counts: OperationCounts,
        blocked: Vec<BlockedCell>,
    ) -> Result<ImproveReport> {
        let summaries: Vec<(usize, (OperationCounts, Vec<BlockedCell>))> = self
            .comm
            .all_gather("improvement", (below_target_before, (counts, blocked)))?;
        let mut report = ImproveReport::default();
        for (below_target, (rank_counts, rank_blocked)) in summaries {
            report.below_target_before += below_target;
            report.counts += rank_counts;
            report.blocked.extend(rank_blocked);
        }
        let angle_margin = |cell: &BlockedCell| cell.min_angle.min(180.0 - cell.max_angle);
        let by_margin =
            |a: &BlockedCell, b: &BlockedCell| angle_margin(a).total_cmp(&angle_margin(b));
        report.blocked.sort_by(by_margin);
        Ok(report)
    }

    /// Numbers the new nodes of all ranks, in the order of the parts, starting from `first`. Returns
    /// the next free index.
    pub(super) fn number_new_nodes(&self, parts: &mut [ImprovedPart], first: u32) -> Result<u32> {
        let new_count: u32 = parts.iter().map(|part| part.new_node_count as u32).sum();
        let new_counts: Vec<u32> = self.comm.all_gather("new nodes", new_count)?;
        let mut next = first + new_counts[..self.comm.rank()].iter().sum::<u32>();
        parts
            .iter_mut()
            .for_each(|part| part.number_nodes(&mut next));
        Ok(first + new_counts.iter().sum::<u32>())
    }

    /// Returns the number of the first tetrahedron of this rank, of which it has `count`, and the number
    /// of all tetrahedra.
    pub(super) fn number_tets(&self, count: usize) -> Result<(usize, usize)> {
        let counts: Vec<usize> = self.comm.all_gather("tetrahedra", count)?;
        let first = counts[..self.comm.rank()].iter().sum();
        Ok((first, counts.iter().sum()))
    }

    /// Returns the nodes that any rank removed, in ascending order.
    pub(super) fn all_removed_nodes(&self, local: Vec<u32>) -> Result<Vec<u32>> {
        let all = self.comm.all_gather("removed nodes", local)?;
        Ok(sorted(concatenate(all)))
    }
}

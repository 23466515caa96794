//! Improves a large mesh slab by slab, in parallel and by ranks of which none has the whole mesh.
//! Each slab is a mesh of its own whose outer faces at the cuts do not change.
//!
//! First the *bands* around the cuts are improved, except near their own ends. Then the slabs
//! follow, in which the ends of the bands are in the middle. Slabs on both sides of a cut meet in
//! faces that have been improved before and do not change any more.
//!
//! The cuts depend on the atoms and d alone, so that the result is the same for any number of
//! ranks.
//!
//! - `submesh`: a part of a mesh as a mesh of its own

mod submesh;
#[cfg(test)]
mod tests;

use crate::improve::constraint::common_sides;
use std::ops::Range;

use crate::parallel::prelude::*;

use super::{ImproveContext, TASK_SIZE, TetImprover};
use crate::Result;
use crate::comm::selection::order_statistics;
use crate::comm::{Comm, partition_range};
use crate::improve::{BlockedCell, ImproveReport, OperationCounts};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::Atoms;
use crate::mesh::complex::{NONE, NOT_LOCAL};
use crate::mesh::mesh_partition::MeshPartition;
use crate::mesh::quality::min_sine;
use crate::mesh::{FACES, TetMesh};
use crate::progress::CancelToken;
use submesh::SubMesh;

/// Distance, in units of the largest d, to which a band extends on either side of its cut.
const BAND_HALF_WIDTH: f64 = 6.0;
/// Distance from the cut, in the same units, within which a band is improved. A repair may change
/// tetrahedra some 3 d away.
const BAND_CORE_HALF_WIDTH: f64 = 3.0;
/// Smallest thickness of a slab, in units of the largest d.
const MIN_SLAB_THICKNESS: f64 = 48.0;
/// Smallest number of atoms in a slab.
const MIN_SLAB_ATOMS: usize = 20_480;
/// Largest number of slabs. The slabs and the bands between them are numbered with 16 bits.
const MAX_SLABS: usize = 1 << 14;

/// Planes, normal to the longest axis of the box, that cut a mesh into slabs.
#[derive(Debug, Clone, PartialEq)]
pub struct SlabCuts {
    /// Axis to which the planes are normal.
    pub axis: usize,
    /// Positions of the planes along the axis, rising.
    positions: Vec<f64>,
    half_width: f64,
}

impl SlabCuts {
    /// Chooses the cuts so that all slabs have the same number of atoms, where each rank has a part
    /// of the atoms. Returns `None` if there is only one slab.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn new(
        owned: &[[f64; 3]],
        extent: [f64; 3],
        distance: &Distance<3>,
        comm: &dyn Comm,
    ) -> Result<Option<Self>> {
        let Some(axis) = (0..3).max_by(|&k, &l| extent[k].total_cmp(&extent[l])) else {
            return Ok(None);
        };
        let half_width = BAND_HALF_WIDTH * distance.max();
        let atoms: Vec<usize> = comm.all_gather("atoms", owned.len())?;
        let atoms = atoms.iter().sum();
        let max_count = Self::max_slabs(atoms, extent[axis], distance.max());
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
                return Ok(Some(Self {
                    axis,
                    positions: cut_positions,
                    half_width,
                }));
            }
        }
        Ok(None)
    }

    /// Returns the largest number of slabs for a number of atoms, whose spacing is at most `d`, in
    /// a box of this length.
    pub fn max_slabs(atoms: usize, length: f64, d: f64) -> usize {
        let by_thickness = (length / (MIN_SLAB_THICKNESS * d)) as usize;
        by_thickness.min(atoms / MIN_SLAB_ATOMS).min(MAX_SLABS)
    }

    /// Returns the number of slabs.
    pub fn count(&self) -> usize {
        self.positions.len() + 1
    }

    /// Returns where the first atoms of the tetrahedra begin for each slab but the first, together
    /// with the band after it: at the end of the band before it.
    pub fn first_atom_cuts(&self) -> Vec<f64> {
        self.positions
            .iter()
            .map(|cut| cut + self.half_width)
            .collect()
    }

    /// Returns the region of a tetrahedron whose first atom is at `x`: twice the index of the slab,
    /// plus one in the band after the slab.
    fn region_index(&self, x: [f64; 3]) -> u16 {
        let x = x[self.axis];
        let passed = self
            .positions
            .partition_point(|cut| cut - self.half_width <= x);
        match passed.checked_sub(1) {
            Some(band) if x < self.positions[band] + self.half_width => 2 * band as u16 + 1,
            _ => 2 * passed as u16,
        }
    }

    /// Returns `true` if a tetrahedron of the band after a slab is on the slab's side of the cut.
    fn is_before_cut(&self, part: &SubMesh, t: u32, slab: usize) -> bool {
        part.scaled_centroid(t, self.axis) < 4.0 * self.positions[slab]
    }
}

/// The improved slabs of one rank.
#[derive(Debug)]
pub struct SlabResult {
    /// Tetrahedra of the slabs.
    pub partition: MeshPartition,
    /// Kind of each node.
    pub kinds: Vec<AtomKind>,
    /// Faces of each tetrahedron that lie on a feature: bit k for face k.
    pub feature_faces: Vec<u8>,
    /// Report for the whole mesh.
    pub report: ImproveReport,
}

impl SlabResult {
    /// Gathers the whole mesh on every rank.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn all_gather(mut self, comm: &dyn Comm) -> Result<Self> {
        if comm.size() == 1 {
            // Done in place, as this is the largest of all arrays.
            let neighbours = self.partition.neighbours.as_flattened_mut().par_iter_mut();
            neighbours
                .filter(|n| **n == NOT_LOCAL)
                .for_each(|n| *n = NONE);
            return Ok(self);
        }
        let Self {
            partition,
            kinds,
            feature_faces,
            report,
        } = self;
        let (first_cell, global_counts) = (0, partition.global_counts);
        let submesh = SubMesh {
            constraints: Vec::new(),
            neighbours: partition.local_neighbours(),
            global_ids: partition.global_ids,
            nodes: partition.mesh.nodes,
            kinds,
            tets: partition.mesh.tets,
        };
        let parts: Vec<(SubMesh, Vec<u8>)> =
            comm.all_gather("partitions", (submesh, feature_faces))?;
        let (parts, marks): (Vec<SubMesh>, Vec<Vec<u8>>) = parts.into_iter().unzip();
        let submesh = SubMesh::merge(parts);
        Ok(Self {
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
}

impl ImproveContext<'_> {
    /// Returns `true` if a face lies in a side of the box.
    fn is_in_side(&self, face: [[f64; 3]; 3]) -> bool {
        common_sides(face.into_iter(), self.extent) != 0
    }
}

/// A part after its improvement. New nodes have the global index `NONE`.
struct ImprovedPart {
    submesh: SubMesh,
    /// Number of new nodes.
    new_node_count: usize,
    /// Global indices of the removed nodes.
    removed_nodes: Vec<u32>,
    feature_faces: Vec<u8>,
    counts: OperationCounts,
    blocked: Vec<BlockedCell>,
}

/// Atoms that a rank knows: at least those of its tetrahedra.
#[derive(Debug, Clone, Default)]
pub struct KnownAtoms {
    /// The known atoms.
    pub atoms: Atoms<3>,
    /// Global index of each known atom, rising; `None` if all atoms are known.
    pub global_ids: Option<Vec<u32>>,
    /// Number of atoms in total.
    pub global_count: usize,
}

/// Returns the slabs of this rank.
pub fn slabs_of_rank(slabs: usize, comm: &dyn Comm) -> Range<usize> {
    partition_range(slabs, comm.rank(), comm.size())
}

/// Makes the slabs of each rank follow the features and removes their slivers, as [`improve`] does
/// with a whole mesh.
///
/// `tets` are the Delaunay tetrahedra of the known atoms, at least those of the rank's [own
/// slabs](slabs_of_rank), with their neighbours. The first node of each tetrahedron must be the one
/// with the smallest index.
///
/// # Errors
/// Returns an error if another rank fails.
///
/// [`improve`]: super::improve
pub fn improve_in_slabs(
    known: KnownAtoms,
    tets: Vec<[u32; 4]>,
    neighbours: Vec<[u32; 4]>,
    cuts: &SlabCuts,
    context: ImproveContext<'_>,
    comm: &dyn Comm,
    cancel: &CancelToken<'_>,
) -> Result<SlabResult> {
    let (slabs, bands) = (cuts.count(), cuts.positions.len());
    let own_slabs = slabs_of_rank(slabs, comm);
    let atom_count = known.global_count;
    let (regions_of_rank, below_target_before) = regions(
        tets,
        neighbours,
        cuts,
        &own_slabs,
        known,
        context.target_sine(),
    );
    let (mut slab_parts, mut band_parts) = (Vec::new(), Vec::new());
    for (i, part) in regions_of_rank.into_iter().enumerate() {
        [&mut slab_parts, &mut band_parts][i % 2].push(part);
    }
    let own_bands = own_slabs.start..own_slabs.end.min(bands);
    let mut improved_bands: Vec<ImprovedPart> =
        (own_bands.into_par_iter().zip(band_parts).with_max_len(1))
            .map(|(band, part)| {
                let core = BAND_CORE_HALF_WIDTH / BAND_HALF_WIDTH * cuts.half_width;
                let core_range = [cuts.positions[band] - core, cuts.positions[band] + core];
                improve_part(part, Some((cuts.axis, core_range)), context, cancel)
            })
            .collect::<Result<Vec<ImprovedPart>>>()?;
    let mut id_end = number_all_nodes(&mut improved_bands, atom_count as u32, comm)?;
    let (mut counts, mut removed_nodes) = (OperationCounts::default(), Vec::new());
    for band in &mut improved_bands {
        // Edges that a band left intersecting are treated again in the slab, and counted there.
        counts += OperationCounts {
            intersecting_left: 0,
            ..band.counts
        };
        removed_nodes.append(&mut band.removed_nodes);
    }
    let parts = exchange_bands(improved_bands, cuts, own_slabs, comm)?;
    let mut improved_slabs: Vec<ImprovedPart> =
        (slab_parts.into_par_iter().zip(parts).with_max_len(1))
            .map(|(inner, mut parts)| {
                parts.push(inner);
                improve_part(SubMesh::merge(parts), None, context, cancel)
            })
            .collect::<Result<Vec<ImprovedPart>>>()?;
    id_end = number_all_nodes(&mut improved_slabs, id_end, comm)?;
    let mut blocked = Vec::new();
    for slab in &mut improved_slabs {
        counts += slab.counts;
        removed_nodes.append(&mut slab.removed_nodes);
        blocked.append(&mut slab.blocked);
    }
    let removed_nodes: Vec<Vec<u32>> = comm.all_gather("removed nodes", removed_nodes)?;
    let mut removed_nodes = removed_nodes.concat();
    removed_nodes.sort_unstable();
    let report = gather_report(below_target_before, counts, blocked, comm)?;
    let (parts, marks): (Vec<SubMesh>, Vec<Vec<u8>>) = (improved_slabs.into_iter())
        .map(|slab| (slab.submesh, slab.feature_faces))
        .unzip();
    let mut merged = SubMesh::merge(parts);
    mark_cut_faces(&mut merged, context);
    let compact_id = |id: u32| id - removed_nodes.partition_point(|&removed| removed < id) as u32;
    let tets: Vec<usize> = comm.all_gather("tetrahedra", merged.tets.len())?;
    let partition = MeshPartition {
        global_ids: merged.global_ids.iter().map(|&id| compact_id(id)).collect(),
        first_cell: tets[..comm.rank()].iter().sum(),
        global_counts: [id_end as usize - removed_nodes.len(), tets.iter().sum()],
        neighbours: merged.neighbours,
        mesh: TetMesh {
            nodes: merged.nodes,
            tets: merged.tets,
        },
    };
    Ok(SlabResult {
        partition,
        kinds: merged.kinds,
        feature_faces: marks.concat(),
        report,
    })
}

/// Cuts improved bands at their cuts, and returns the halves of bands at each of a rank's own slabs.
/// The half beyond the cut goes to the rank of the next slab.
///
/// # Errors
/// Returns an error if another rank fails.
fn exchange_bands(
    bands: Vec<ImprovedPart>,
    cuts: &SlabCuts,
    own_slabs: Range<usize>,
    comm: &dyn Comm,
) -> Result<Vec<Vec<SubMesh>>> {
    let first = usize::from(own_slabs.start == 0);
    let mut parts: Vec<Vec<SubMesh>> = own_slabs.clone().map(|_| Vec::new()).collect();
    let mut outgoing: Vec<Vec<SubMesh>> = vec![Vec::new(); comm.size()];
    for ((slab, parts), band) in own_slabs.zip(&mut parts).zip(bands) {
        let half_band = |before: bool| {
            (band.submesh).filter_tets(|t| cuts.is_before_cut(&band.submesh, t, slab) == before)
        };
        let (before, after) = rayon::join(|| half_band(true), || half_band(false));
        parts.push(before);
        outgoing[owner(slab + 1, cuts.count(), comm.size())].push(after);
    }
    let incoming = comm.all_to_all("bands", outgoing)?.concat();
    for (parts, part) in parts.iter_mut().skip(first).zip(incoming) {
        parts.push(part);
    }
    Ok(parts)
}

/// Adds up what all ranks did. The blocked cells are those with the smallest margins first.
///
/// # Errors
/// Returns an error if another rank fails.
fn gather_report(
    below_target_before: usize,
    counts: OperationCounts,
    blocked: Vec<BlockedCell>,
    comm: &dyn Comm,
) -> Result<ImproveReport> {
    let summaries: Vec<(usize, (OperationCounts, Vec<BlockedCell>))> =
        comm.all_gather("improvement", (below_target_before, (counts, blocked)))?;
    let mut report = ImproveReport::default();
    for (below_target, (rank_counts, rank_blocked)) in summaries {
        report.below_target_before += below_target;
        report.counts += rank_counts;
        report.blocked.extend(rank_blocked);
    }
    let angle_margin = |cell: &BlockedCell| cell.min_angle.min(180.0 - cell.max_angle);
    let by_margin = |a: &BlockedCell, b: &BlockedCell| angle_margin(a).total_cmp(&angle_margin(b));
    report.blocked.sort_by(by_margin);
    Ok(report)
}

/// Returns the rank that has a slab.
fn owner(slab: usize, slabs: usize, count: usize) -> usize {
    let owns = |rank: &usize| partition_range(slabs, *rank, count).contains(&slab);
    (0..count).find(owns).unwrap_or(0)
}

/// Returns the regions of some slabs and of the bands after them, each as a part, and the number of
/// their tetrahedra whose smallest sine is below `sine`.
fn regions(
    tets: Vec<[u32; 4]>,
    neighbours: Vec<[u32; 4]>,
    cuts: &SlabCuts,
    own_slabs: &Range<usize>,
    known: KnownAtoms,
    sine: f64,
) -> (Vec<SubMesh>, usize) {
    let Atoms { positions, kinds } = &known.atoms;
    let own_regions = 2 * own_slabs.start..(2 * own_slabs.end).min(2 * cuts.count() - 1);
    let first_node = |tet: &[u32; 4]| tet.iter().fold(NONE, |a, &b| a.min(b)) as usize;
    let region: Vec<u16> = (tets.par_iter())
        .map(|tet| cuts.region_index(positions[first_node(tet)]))
        .collect();
    let extract_region = |index: usize| {
        let chosen: Vec<u32> = (region.par_iter().enumerate())
            .filter(|(_, region)| usize::from(**region) == index)
            .map(|(t, _)| t as u32)
            .collect();
        let mut part = SubMesh::extract(&tets, &neighbours, &chosen, |n| {
            let n = n as usize;
            (positions[n], kinds[n], None)
        });
        if let Some(ids) = &known.global_ids {
            part.global_ids
                .iter_mut()
                .for_each(|id| *id = ids[*id as usize]);
        }
        part
    };
    let parts: Vec<SubMesh> = own_regions
        .into_par_iter()
        .with_max_len(1)
        .map(extract_region)
        .collect();
    let count_below = |part: &SubMesh| {
        let tets = part.tets.par_iter().with_min_len(TASK_SIZE);
        let corners = |tet: &[u32; 4]| tet.map(|n| part.nodes[n as usize]);
        tets.filter(|tet| min_sine(&corners(tet)) < sine).count()
    };
    let below_target = parts.iter().map(count_below).sum();
    (parts, below_target)
}

impl ImprovedPart {
    /// Numbers the new nodes, starting from `next`, which becomes the next free index.
    fn number_nodes(&mut self, next: &mut u32) {
        let first_new = self.submesh.global_ids.len() - self.new_node_count;
        for id in &mut self.submesh.global_ids[first_new..] {
            *id = *next;
            *next += 1;
        }
    }
}

/// Numbers the new nodes of all ranks, in the order of the parts, starting from `first`. Returns
/// the next free index.
fn number_all_nodes(parts: &mut [ImprovedPart], first: u32, comm: &dyn Comm) -> Result<u32> {
    let new_count: u32 = parts.iter().map(|part| part.new_node_count as u32).sum();
    let new_counts: Vec<u32> = comm.all_gather("new nodes", new_count)?;
    let mut next = first + new_counts[..comm.rank()].iter().sum::<u32>();
    parts
        .iter_mut()
        .for_each(|part| part.number_nodes(&mut next));
    Ok(first + new_counts.iter().sum::<u32>())
}

/// Improves a part, or the range of it along an axis, as a mesh of its own. The nodes and faces
/// where it was cut out do not change.
fn improve_part(
    part: SubMesh,
    range: Option<(usize, [f64; 2])>,
    context: ImproveContext<'_>,
    cancel: &CancelToken<'_>,
) -> Result<ImprovedPart> {
    let SubMesh {
        global_ids: ids,
        nodes,
        kinds,
        constraints: known_constraints,
        tets,
        neighbours,
    } = part;
    let mut is_fixed = vec![false; nodes.len()];
    for (tet, around) in tets.iter().zip(&neighbours) {
        for k in (0..4).filter(|&k| around[k] == NONE) {
            let face = FACES[k].map(|i| tet[i] as usize);
            if !context.is_in_side(face.map(|n| nodes[n])) {
                face.iter().for_each(|&n| is_fixed[n] = true);
            }
        }
    }
    let mut improver =
        TetImprover::new(TetMesh { nodes, tets }, neighbours, &kinds, context, cancel);
    improver.axis_range = range;
    for (constraint, known) in improver.constraints.iter_mut().zip(known_constraints) {
        *constraint = known.unwrap_or(*constraint);
    }
    let mut saved_axes = Vec::new();
    for (n, constraint) in improver.constraints.iter_mut().enumerate() {
        if is_fixed[n] {
            saved_axes.push((n, constraint.fixed_axes));
            constraint.fixed_axes = 7;
        }
    }
    let ImproveReport { counts, .. } = improver.improve(cancel)?;
    for (n, axes) in saved_axes {
        improver.constraints[n].fixed_axes = axes;
    }
    let blocked = improver.blocked_cells();
    let finished = improver.finish(&kinds);
    let old_count = finished
        .old_ids
        .partition_point(|&n| (n as usize) < ids.len());
    let mut removed_nodes = Vec::with_capacity(ids.len() - old_count);
    let mut remaining = finished.old_ids[..old_count].iter().peekable();
    for (n, &id) in ids.iter().enumerate() {
        if remaining.next_if(|&&kept| kept as usize == n).is_none() {
            removed_nodes.push(id);
        }
    }
    let new_count = finished.old_ids.len() - old_count;
    let kept = finished.old_ids[..old_count]
        .iter()
        .map(|&n| ids[n as usize]);
    Ok(ImprovedPart {
        new_node_count: new_count,
        removed_nodes,
        feature_faces: finished.feature_faces,
        counts,
        blocked,
        submesh: SubMesh {
            global_ids: kept.chain((0..new_count).map(|_| NONE)).collect(),
            nodes: finished.mesh.nodes,
            kinds: finished.kinds,
            // Slabs are not improved again, so their constraints are not needed.
            constraints: match range {
                Some(_) => finished.constraints.into_iter().map(Some).collect(),
                None => Vec::new(),
            },
            tets: finished.mesh.tets,
            neighbours: finished.neighbours,
        },
    })
}

/// Marks the outer faces that are not in a side of the box as leading to another rank.
fn mark_cut_faces(part: &mut SubMesh, context: ImproveContext<'_>) {
    let tets = part.neighbours.par_iter_mut().zip(&part.tets);
    tets.for_each(|(around, tet)| {
        for (face, n) in FACES.iter().zip(around).filter(|pair| *pair.1 == NONE) {
            if !context.is_in_side(face.map(|i| part.nodes[tet[i] as usize])) {
                *n = NOT_LOCAL;
            }
        }
    });
}

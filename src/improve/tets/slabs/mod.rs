//! A large mesh improved slab by slab, each as a mesh of its own that stays as it is where it was cut out: at the
//! same time, and by processes of which none holds all.
//!
//! First come *bands* round the cuts, which are far from where they end themselves; then slabs, in which what
//! bands left poor at their ends is in the middle. What is on different sides of a cut meets in faces that have
//! been improved before and no longer change.
//!
//! How a mesh is cut depends on its atoms and d alone, so that the result is the same for any number of processes.
//!
//! - `part`: a part of a mesh as one of its own

mod submesh;
#[cfg(test)]
mod tests;

use std::ops::Range;

use crate::parallel::prelude::*;

use super::{TASK_SIZE, TetImprover};
use crate::Result;
use crate::comm::selection::order_statistics;
use crate::comm::{Comm, partition_range};
use crate::improve::feature_planes::FeaturePlanes;
use crate::improve::{BlockedCell, ImproveReport, OperationCounts, Target};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::Atoms;
use crate::mesh::complex::{NONE, NOT_LOCAL};
use crate::mesh::partition::MeshPartition;
use crate::mesh::quality::min_sine;
use crate::mesh::{FACES, TetMesh};
use crate::progress::CancelToken;
use submesh::SubMesh;

/// A band reaches so far to either side of its cut, over the largest d ...
const BAND_HALF_WIDTH: f64 = 6.0;
/// ... and is improved so far from it: what is mended may change what is some 3 d away.
const BAND_CORE_HALF_WIDTH: f64 = 3.0;
/// Slabs are at least so thick, over the same ...
const MIN_SLAB_THICKNESS: f64 = 48.0;
/// ... and have at least so many atoms.
const MIN_SLAB_ATOMS: usize = 20_480;
/// There are not more: they and the bands between them are numbered with 16 bits.
const MAX_SLABS: usize = 1 << 14;

/// Where a mesh is cut: at planes across the longest axis of the box.
#[derive(Debug, Clone, PartialEq)]
pub struct SlabCuts {
    /// The axis.
    pub axis: usize,
    /// Where, rising.
    positions: Vec<f64>,
    half_width: f64,
}

impl SlabCuts {
    /// So that slabs have as many atoms each, of which everyone of the group has a share; none if there is but one slab.
    ///
    /// # Errors
    /// Those of the others.
    pub fn new(
        share: &[[f64; 3]],
        extent: [f64; 3],
        distance: &Distance<3>,
        group: &dyn Comm,
    ) -> Result<Option<Self>> {
        let Some(axis) = (0..3).max_by(|&k, &l| extent[k].total_cmp(&extent[l])) else {
            return Ok(None);
        };
        let half = BAND_HALF_WIDTH * distance.max();
        let atoms: Vec<usize> = group.all_gather("atoms", share.len())?;
        let atoms = atoms.iter().sum();
        let most = Self::max_slabs(atoms, extent[axis], distance.max());
        let mut along: Vec<f64> = share.iter().map(|x| x[axis]).collect();
        for count in (2..=most).rev() {
            let ranks: Vec<usize> = (1..count).map(|i| i * atoms / count).collect();
            let at = match group.size() {
                1 => (ranks.iter())
                    .map(|&rank| *along.select_nth_unstable_by(rank, f64::total_cmp).1)
                    .collect(),
                _ => {
                    order_statistics(&[along.iter().copied()], &[|_| &ranks], group)?.swap_remove(0)
                }
            };
            let mut ends = vec![0.0];
            ends.extend(&at);
            ends.push(extent[axis]);
            // Between bands there must be something.
            if ends.windows(2).all(|two| two[1] - two[0] > 3.0 * half) {
                return Ok(Some(Self {
                    axis,
                    positions: at,
                    half_width: half,
                }));
            }
        }
        Ok(None)
    }

    /// How many slabs there are at most where there are so many atoms, at most `d` apart, in a box so long.
    pub fn max_slabs(atoms: usize, longest: f64, d: f64) -> usize {
        let thick = (longest / (MIN_SLAB_THICKNESS * d)) as usize;
        thick.min(atoms / MIN_SLAB_ATOMS).min(MAX_SLABS)
    }

    /// How many slabs there are.
    pub fn count(&self) -> usize {
        self.positions.len() + 1
    }

    /// Where the atoms begin that are the first of tetrahedra of each slab but the first, and of the band after it:
    /// at the end of the band before.
    pub fn first_atom_cuts(&self) -> Vec<f64> {
        self.positions
            .iter()
            .map(|at| at + self.half_width)
            .collect()
    }

    /// Of a tetrahedron whose first atom is there: twice the number of the slab, and one more in the band after it.
    fn region_index(&self, x: [f64; 3]) -> u16 {
        let x = x[self.axis];
        let begun = self
            .positions
            .partition_point(|at| at - self.half_width <= x);
        match begun.checked_sub(1) {
            Some(band) if x < self.positions[band] + self.half_width => 2 * band as u16 + 1,
            _ => 2 * begun as u16,
        }
    }

    /// Whether a tetrahedron of the band after a slab is on the slab's side of the cut.
    fn is_before_cut(&self, part: &SubMesh, t: u32, slab: usize) -> bool {
        part.scaled_centroid(t, self.axis) < 4.0 * self.positions[slab]
    }
}

/// The slabs of one of those who share a mesh, improved.
#[derive(Debug)]
pub struct SlabResult {
    /// Its tetrahedra.
    pub partition: MeshPartition,
    /// What each of its nodes may do.
    pub kinds: Vec<AtomKind>,
    /// For each tetrahedron which of its faces lie on a feature: bit k for face k.
    pub feature_faces: Vec<u8>,
    /// What was done, of the whole mesh.
    pub report: ImproveReport,
}

impl SlabResult {
    /// All pieces as one, on every member of the group.
    ///
    /// # Errors
    /// Those of other members.
    pub fn all_gather(mut self, group: &dyn Comm) -> Result<Self> {
        if group.size() == 1 {
            // In place: they are the largest array of all.
            let around = self.partition.neighbors.as_flattened_mut().par_iter_mut();
            around.filter(|n| **n == NOT_LOCAL).for_each(|n| *n = NONE);
            return Ok(self);
        }
        let Self {
            partition: piece,
            kinds,
            feature_faces,
            report: improved,
        } = self;
        let (first, whole) = (0, piece.global_counts);
        let part = SubMesh {
            constraints: Vec::new(),
            neighbors: piece.local_neighbors(),
            global_ids: piece.global_ids,
            nodes: piece.mesh.nodes,
            kinds,
            tets: piece.mesh.tets,
        };
        let parts: Vec<(SubMesh, Vec<u8>)> = group.all_gather("pieces", (part, feature_faces))?;
        let (parts, marks): (Vec<SubMesh>, Vec<Vec<u8>>) = parts.into_iter().unzip();
        let part = SubMesh::merge(parts);
        Ok(Self {
            partition: MeshPartition {
                mesh: TetMesh {
                    nodes: part.nodes,
                    tets: part.tets,
                },
                neighbors: part.neighbors,
                global_ids: part.global_ids,
                first_cell: first,
                global_counts: whole,
            },
            kinds: part.kinds,
            feature_faces: marks.concat(),
            report: improved,
        })
    }
}

/// What slabs are improved for.
#[derive(Debug, Clone, Copy)]
pub struct SlabContext<'a> {
    /// The far corner of the box.
    pub extent: [f64; 3],
    /// The features.
    pub planes: &'a FeaturePlanes,
    /// d.
    pub distance: &'a Distance<3>,
    /// What is asked for.
    pub target: &'a Target,
}

impl SlabContext<'_> {
    /// Of the smallest angle asked for.
    fn target_sine(&self) -> f64 {
        self.target.min_dihedral.to_radians().sin()
    }

    /// Whether a face lies in a side of the box.
    fn is_in_side(&self, face: [[f64; 3]; 3]) -> bool {
        (0..3).any(|k| {
            let [x, others @ ..] = face.map(|x| x[k]);
            (x == 0.0 || x == self.extent[k]) && others == [x; 2]
        })
    }
}

/// A part that has been improved. The numbers of nodes that came are `NONE`.
struct ImprovedPart {
    submesh: SubMesh,
    /// Nodes that came.
    new_node_count: usize,
    /// The numbers of those that went.
    removed_nodes: Vec<u32>,
    feature_faces: Vec<u8>,
    counts: OperationCounts,
    blocked: Vec<BlockedCell>,
}

/// Atoms as far as they are known to a member of a group: all that its tetrahedra have.
#[derive(Debug, Clone, Default)]
pub struct KnownAtoms {
    /// The atoms.
    pub atoms: Atoms<3>,
    /// The number of each among all, rising. None where all are known.
    pub global_ids: Option<Vec<u32>>,
    /// How many there are in all.
    pub global_count: usize,
}

/// Which slabs a member of a group has.
pub fn slabs_of_rank(slabs: usize, group: &dyn Comm) -> Range<usize> {
    partition_range(slabs, group.rank(), group.size())
}

/// Makes the slabs of each member of a group follow the features and frees them of slivers, as [`improve`] does a mesh
/// as a whole.
///
/// `tets` are Delaunay tetrahedra of the atoms that are known, at least those of the [own](slabs_of_rank) slabs, with
/// neighbours among them; of each the first node is the least.
///
/// # Errors
/// Those of other members.
///
/// [`improve`]: super::improve
pub fn improve_in_slabs(
    known: KnownAtoms,
    joined: (Vec<[u32; 4]>, Vec<[u32; 4]>),
    cuts: &SlabCuts,
    aim: SlabContext<'_>,
    group: &dyn Comm,
    patience: &CancelToken<'_>,
) -> Result<SlabResult> {
    let (slabs, bands) = (cuts.count(), cuts.positions.len());
    let own = slabs_of_rank(slabs, group);
    let whole = known.global_count;
    let (raw, poor_before) = regions(joined, cuts, &own, known, aim.target_sine());
    let (mut inner, mut between) = (Vec::new(), Vec::new());
    for (i, part) in raw.into_iter().enumerate() {
        [&mut inner, &mut between][i % 2].push(part);
    }
    // Bands: numbers for the nodes that came, and what is beyond the cut to the next slab, which may be another's.
    let own_bands = own.start..own.end.min(bands);
    let mut done: Vec<ImprovedPart> = (own_bands.into_par_iter().zip(between).with_max_len(1))
        .map(|(band, part)| {
            let core = BAND_CORE_HALF_WIDTH / BAND_HALF_WIDTH * cuts.half_width;
            let between = [cuts.positions[band] - core, cuts.positions[band] + core];
            improve_part(part, Some((cuts.axis, between)), aim, patience)
        })
        .collect::<Result<Vec<ImprovedPart>>>()?;
    let mut end = number_all_nodes(&mut done, whole as u32, group)?;
    let (mut counts, mut gone) = (OperationCounts::default(), Vec::new());
    let mut parts: Vec<Vec<SubMesh>> = own.clone().map(|_| Vec::new()).collect();
    let mut to: Vec<Vec<SubMesh>> = vec![Vec::new(); group.size()];
    for ((slab, parts), band) in own.clone().zip(&mut parts).zip(done) {
        let side = |before: bool| {
            (band.submesh).filter_tets(|t| cuts.is_before_cut(&band.submesh, t, slab) == before)
        };
        let (before, after) = rayon::join(|| side(true), || side(false));
        parts.push(before);
        to[owner(slab + 1, slabs, group.size())].push(after);
        // What it left is tried again, and counted then.
        counts += OperationCounts {
            intersecting_left: 0,
            ..band.counts
        };
        gone.extend(band.removed_nodes);
    }
    let beyond = group.all_to_all("bands", to)?.concat();
    let first = usize::from(own.start == 0);
    for (parts, part) in parts.iter_mut().skip(first).zip(beyond) {
        parts.push(part);
    }
    let mut done: Vec<ImprovedPart> = (inner.into_par_iter().zip(parts).with_max_len(1))
        .map(|(inner, mut parts)| {
            parts.push(inner);
            improve_part(SubMesh::merge(parts), None, aim, patience)
        })
        .collect::<Result<Vec<ImprovedPart>>>()?;
    end = number_all_nodes(&mut done, end, group)?;
    let mut blocked = Vec::new();
    for slab in &mut done {
        counts += slab.counts;
        gone.append(&mut slab.removed_nodes);
        blocked.append(&mut slab.blocked);
    }
    let gone: Vec<Vec<u32>> = group.all_gather("nodes that went", gone)?;
    let mut gone = gone.concat();
    gone.sort_unstable();
    let all: Vec<(usize, (OperationCounts, Vec<BlockedCell>))> =
        group.all_gather("improvement", (poor_before, (counts, blocked)))?;
    let (mut poor_before, mut counts, mut blocked) = (0, OperationCounts::default(), Vec::new());
    for (poor, (some, of_some)) in all {
        poor_before += poor;
        counts += some;
        blocked.extend(of_some);
    }
    let worse = |of: &BlockedCell| of.min_angle.min(180.0 - of.max_angle);
    blocked.sort_by(|a, b| worse(a).total_cmp(&worse(b)));
    let improved = ImproveReport {
        below_target_before: poor_before,
        below_target_after: blocked.len(),
        counts,
        blocked,
    };
    let (parts, marks): (Vec<SubMesh>, Vec<Vec<u8>>) = (done.into_iter())
        .map(|slab| (slab.submesh, slab.feature_faces))
        .unzip();
    let mut part = SubMesh::merge(parts);
    mark_cut_faces(&mut part, aim);
    let number = |id: u32| id - gone.partition_point(|&gone| gone < id) as u32;
    let tets: Vec<usize> = group.all_gather("tetrahedra", part.tets.len())?;
    let piece = MeshPartition {
        global_ids: part.global_ids.iter().map(|&id| number(id)).collect(),
        first_cell: tets[..group.rank()].iter().sum(),
        global_counts: [end as usize - gone.len(), tets.iter().sum()],
        neighbors: part.neighbors,
        mesh: TetMesh {
            nodes: part.nodes,
            tets: part.tets,
        },
    };
    Ok(SlabResult {
        partition: piece,
        kinds: part.kinds,
        feature_faces: marks.concat(),
        report: improved,
    })
}

/// Who has a slab.
fn owner(slab: usize, slabs: usize, count: usize) -> usize {
    let has = |rank: &usize| partition_range(slabs, *rank, count).contains(&slab);
    (0..count).find(has).unwrap_or(0)
}

/// The regions of some slabs and of the bands after them, each as a part, and how many of their tetrahedra are poorer than
/// a sine.
fn regions(
    (tets, neighbors): (Vec<[u32; 4]>, Vec<[u32; 4]>),
    cuts: &SlabCuts,
    own: &Range<usize>,
    known: KnownAtoms,
    sine: f64,
) -> (Vec<SubMesh>, usize) {
    let Atoms { positions, kinds } = &known.atoms;
    let own = 2 * own.start..(2 * own.end).min(2 * cuts.count() - 1);
    let least = |tet: &[u32; 4]| tet.iter().fold(NONE, |a, &b| a.min(b)) as usize;
    let region: Vec<u16> = (tets.par_iter())
        .map(|tet| cuts.region_index(positions[least(tet)]))
        .collect();
    let part = |region_here: usize| {
        let chosen: Vec<u32> = (region.par_iter().enumerate())
            .filter(|(_, region)| usize::from(**region) == region_here)
            .map(|(t, _)| t as u32)
            .collect();
        let mut part = SubMesh::extract(&tets, &neighbors, &chosen, |n| {
            let n = n as usize;
            (positions[n], kinds[n], None)
        });
        if let Some(numbers) = &known.global_ids {
            part.global_ids
                .iter_mut()
                .for_each(|id| *id = numbers[*id as usize]);
        }
        part
    };
    let parts: Vec<SubMesh> = own.into_par_iter().with_max_len(1).map(part).collect();
    let poor = |part: &SubMesh| {
        let tets = part.tets.par_iter().with_min_len(TASK_SIZE);
        let corners = |tet: &[u32; 4]| tet.map(|n| part.nodes[n as usize]);
        tets.filter(|tet| min_sine(&corners(tet)) < sine).count()
    };
    let poor = parts.iter().map(poor).sum();
    (parts, poor)
}

impl ImprovedPart {
    /// Gives the nodes that came their numbers, and tells the next.
    fn number_nodes(&mut self, next: &mut u32) {
        let came = self.submesh.global_ids.len() - self.new_node_count;
        for id in &mut self.submesh.global_ids[came..] {
            *id = *next;
            *next += 1;
        }
    }
}

/// Gives all nodes that came their numbers, in the order of parts, from `first` on; tells where they end.
fn number_all_nodes(done: &mut [ImprovedPart], first: u32, group: &dyn Comm) -> Result<u32> {
    let came: u32 = done.iter().map(|part| part.new_node_count as u32).sum();
    let came: Vec<u32> = group.all_gather("nodes that came", came)?;
    let mut next = first + came[..group.rank()].iter().sum::<u32>();
    done.iter_mut()
        .for_each(|part| part.number_nodes(&mut next));
    Ok(first + came.iter().sum::<u32>())
}

/// Improves a part, or what is between two places along an axis, as a mesh of its own: the nodes where it was cut out
/// stay, and so do the faces there.
fn improve_part(
    part: SubMesh,
    between: Option<(usize, [f64; 2])>,
    aim: SlabContext<'_>,
    patience: &CancelToken<'_>,
) -> Result<ImprovedPart> {
    let SubMesh {
        global_ids: ids,
        nodes,
        kinds,
        constraints: holds,
        tets,
        neighbors,
    } = part;
    let mut stays = vec![false; nodes.len()];
    for (tet, around) in tets.iter().zip(&neighbors) {
        for k in (0..4).filter(|&k| around[k] == NONE) {
            let face = FACES[k].map(|i| tet[i] as usize);
            if !aim.is_in_side(face.map(|n| nodes[n])) {
                face.iter().for_each(|&n| stays[n] = true);
            }
        }
    }
    let mut improver = TetImprover::new(
        TetMesh { nodes, tets },
        neighbors,
        &kinds,
        aim.extent,
        aim.planes,
        aim.distance,
        aim.target_sine(),
        patience,
    );
    (improver.is_rank_local, improver.axis_range) = (true, between);
    for (hold, held) in improver.constraints.iter_mut().zip(holds) {
        *hold = held.unwrap_or(*hold);
    }
    let mut sides = Vec::new();
    for (n, hold) in improver.constraints.iter_mut().enumerate() {
        if stays[n] {
            sides.push((n, hold.fixed_axes));
            hold.fixed_axes = 7;
        }
    }
    let ImproveReport { counts, .. } = improver.improve(patience)?;
    for (n, axes) in sides {
        improver.constraints[n].fixed_axes = axes;
    }
    let blocked = improver.blocked_cells();
    let finished = improver.finish(&kinds);
    let before = finished
        .old_ids
        .partition_point(|&n| (n as usize) < ids.len());
    let mut gone = Vec::with_capacity(ids.len() - before);
    let mut left = finished.old_ids[..before].iter().peekable();
    for (n, &id) in ids.iter().enumerate() {
        if left.next_if(|&&kept| kept as usize == n).is_none() {
            gone.push(id);
        }
    }
    let came = finished.old_ids.len() - before;
    let kept = finished.old_ids[..before].iter().map(|&n| ids[n as usize]);
    Ok(ImprovedPart {
        new_node_count: came,
        removed_nodes: gone,
        feature_faces: finished.feature_faces,
        counts,
        blocked,
        submesh: SubMesh {
            global_ids: kept.chain((0..came).map(|_| NONE)).collect(),
            nodes: finished.mesh.nodes,
            kinds: finished.kinds,
            // Of slabs nothing is improved again.
            constraints: match between {
                Some(_) => finished.constraints.into_iter().map(Some).collect(),
                None => Vec::new(),
            },
            tets: finished.mesh.tets,
            neighbors: finished.neighbors,
        },
    })
}

/// From now on faces that are not in a side of the box lead to another piece.
fn mark_cut_faces(part: &mut SubMesh, aim: SlabContext<'_>) {
    let tets = part.neighbors.par_iter_mut().zip(&part.tets);
    tets.for_each(|(around, tet)| {
        for (face, n) in FACES.iter().zip(around).filter(|of| *of.1 == NONE) {
            if !aim.is_in_side(face.map(|i| part.nodes[tet[i] as usize])) {
                *n = NOT_LOCAL;
            }
        }
    });
}

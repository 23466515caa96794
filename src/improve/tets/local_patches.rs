//! Repairs many tetrahedra at once, those near each other in a copy of the mesh around them: a
//! patch. The mesh itself is unchanged until all patches are done, and then takes over their
//! changes. So the result depends neither on the number of threads nor on which rank works on a
//! patch; ranks share them.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use crate::parallel::prelude::*;

use super::attempt_cache::AttemptKind;
use super::{ConstrainedPoint, TetImprover};
use crate::Result;
use crate::files::codec::codec_fields;
use crate::geometry::{dot, sub};
use crate::improve::OperationCounts;
use crate::mesh::complex::{Complex, NONE, PartNumbering};
use crate::progress::CancelToken;

/// Radius, in units of d, around the centroid of a tetrahedron to be repaired. The patch has all
/// tetrahedra at the nodes within this radius. The few repairs that need more are done in the mesh
/// itself.
const PATCH_RADIUS: f64 = 3.5;
/// Edge of a cube, in units of the largest d of the tetrahedra to be repaired in it. Patches of two
/// cubes with another cube in between do not overlap, as tetrahedra extend some 1.3 d beyond their
/// nodes within the radius.
const CUBE_EDGE: f64 = 2.0 * (PATCH_RADIUS + 1.3);
/// Factor by which cubes shrink where d is smaller. The tetrahedra of one group of cubes have about
/// the same d.
const CUBE_SHRINK_FACTOR: f64 = std::f64::consts::SQRT_2;

/// Smallest number of cubes for which patches are used. With fewer cubes there is little parallel
/// work, and to repair the worst of all tetrahedra first is less work and leaves fewer below
/// target.
const MIN_CUBES: usize = 64;

/// A copy of a part of the mesh, in which the tetrahedra of one cube are repaired.
struct LocalPatch<'a> {
    numbering: PartNumbering,
    improver: TetImprover<'a>,
}

/// Result of the repairs in a patch. Indices are those of the mesh; a new node is `NONE` minus its
/// index among the new nodes.
struct PatchResult {
    /// Nodes on whose tetrahedra the result depends.
    nodes: Vec<u32>,
    /// Tetrahedra for which the patch was too small.
    deferred: Vec<u32>,
    /// Tetrahedra that no operation repairs.
    failed: Vec<u32>,
    change: PatchChange,
}

/// Difference between a patch after its repairs and the mesh.
struct PatchChange {
    /// Tetrahedra that are removed, and those that take their place.
    removed_tets: Vec<u32>,
    new_tets: Vec<[u32; 4]>,
    /// Nodes that move, with their new positions and constraints.
    moved_nodes: Vec<(u32, ConstrainedPoint)>,
    new_nodes: Vec<ConstrainedPoint>,
    counts: OperationCounts,
}

/// A cube and the tetrahedra in it. The key of the cube is the number of times that its edge has
/// shrunk, and its index along each axis.
pub(super) type Cube = ((u32, [u32; 3]), Vec<u32>);

codec_fields! {
    PatchResult as PatchResult { nodes, deferred, failed, change }
    PatchChange as PatchChange { removed_tets, new_tets, moved_nodes, new_nodes, counts }
}

impl<'a> TetImprover<'a> {
    /// Repairs tetrahedra: in patches if there are enough cubes, otherwise one by one in the given
    /// order. `set_progress` is called with the fraction done.
    ///
    /// # Errors
    /// Returns an error if another rank that shares the work fails.
    pub(super) fn repair_each(
        &mut self,
        tets: &[u32],
        cancel: &CancelToken<'_>,
        set_progress: impl Fn(f64),
    ) -> Result<()> {
        let d = |&t: &u32| self.centre_and_spacing(t).1;
        let edge = CUBE_EDGE * tets.iter().map(d).fold(0.0, f64::max);
        let cube_groups = self.cubes(tets, edge);
        let (min_progress, deferred) = if cube_groups.iter().flatten().count() < MIN_CUBES {
            (0.0, tets.to_vec())
        } else {
            (
                1.0,
                self.repair_in_patches(cube_groups, edge, cancel, &set_progress)?,
            )
        };
        let count = deferred.len() as f64;
        for (number, t) in deferred.into_iter().enumerate() {
            set_progress((number as f64 / count).max(min_progress));
            if cancel.is_cancelled() {
                break;
            }
            if self.is_below_target(t) && !self.is_known_to_fail(t) {
                self.repair_in_place(t);
            }
        }
        Ok(())
    }

    /// Repairs tetrahedra in patches, one for each cube. Returns the tetrahedra for which the
    /// patches were too small or overlapped.
    pub(super) fn repair_in_patches(
        &mut self,
        cube_groups: Vec<Vec<Cube>>,
        edge: f64,
        cancel: &CancelToken<'_>,
        set_progress: &impl Fn(f64),
    ) -> Result<Vec<u32>> {
        let pool = Mutex::new(Vec::new());
        let mut deferred = Vec::new();
        let phases = cube_groups.len() as f64;
        for (phase, mut cubes) in cube_groups.into_iter().enumerate() {
            set_progress(phase as f64 / phases);
            // Slots of removed tetrahedra are used again, possibly for tetrahedra of another cube.
            for (cube, tets) in &mut cubes {
                tets.retain(|&t| self.is_below_target(t) && self.cube(t, edge) == *cube);
            }
            let try_range = |range: Range<usize>| -> Vec<PatchResult> {
                (cubes[range].par_iter().with_max_len(1))
                    .map(|(_, tets)| self.try_in_patch(tets, &pool, cancel))
                    .collect()
            };
            let weights: Vec<usize> = cubes.iter().map(|(_, tets)| tets.len()).collect();
            let results = self.work.patches(&weights, try_range)?;
            let start = self.attempts.clock();
            for ((_, tets), result) in cubes.into_iter().zip(results) {
                if self.attempts.has_changed(start, &result.nodes) {
                    deferred.extend(tets);
                    continue;
                }
                self.apply_change(&result.change);
                for t in result.failed {
                    self.attempts.record_failure(AttemptKind::Repair, t);
                }
                deferred.extend(result.deferred);
            }
        }
        Ok(deferred)
    }

    /// Returns `true` if a slot has a tetrahedron below target within the range of the work.
    pub(super) fn is_below_target(&self, t: u32) -> bool {
        self.complex.is_alive(t)
            && self.sine_of(t) < self.target_sine
            && self.is_in_range(&self.complex.tets[t as usize])
    }

    /// Returns the cube that contains the centroid of a tetrahedron, where the largest cubes have
    /// this edge.
    fn cube(&self, t: u32, edge: f64) -> (u32, [u32; 3]) {
        let (middle, d) = self.centre_and_spacing(t);
        let shrink_count = (edge / (CUBE_EDGE * d))
            .log(CUBE_SHRINK_FACTOR)
            .max(0.0)
            .floor();
        let edge = edge / CUBE_SHRINK_FACTOR.powf(shrink_count);
        (shrink_count as u32, middle.map(|c| (c / edge) as u32))
    }

    /// Sorts tetrahedra into cubes, and the cubes into groups in which no two patches overlap.
    pub(super) fn cubes(&self, tets: &[u32], edge: f64) -> Vec<Vec<Cube>> {
        let mut cubes: BTreeMap<(u32, [u32; 3]), Vec<u32>> = BTreeMap::new();
        for &t in tets.iter().filter(|&&t| self.is_below_target(t)) {
            cubes.entry(self.cube(t, edge)).or_default().push(t);
        }
        let mut groups: BTreeMap<(u32, [u32; 3]), Vec<Cube>> = BTreeMap::new();
        for (cube, tets) in cubes {
            let (shrink_count, index) = cube;
            let group = (shrink_count, index.map(|c| c % 2));
            groups.entry(group).or_default().push((cube, tets));
        }
        groups.into_values().collect()
    }

    /// Repairs tetrahedra in a copy of the mesh around them.
    fn try_in_patch(
        &self,
        tets: &[u32],
        pool: &Mutex<Vec<LocalPatch<'a>>>,
        cancel: &CancelToken<'_>,
    ) -> PatchResult {
        let lock = || pool.lock().unwrap_or_else(PoisonError::into_inner);
        let taken = lock().pop();
        let mut patch = taken.unwrap_or_else(|| LocalPatch {
            numbering: PartNumbering::default(),
            improver: Self::empty(self.extent, self.planes, self.distance, self.target_sine),
        });
        patch.improver.frozen_axes = self.frozen_axes;
        let result = patch.try_repairs(self, tets, cancel);
        lock().push(patch);
        result
    }

    /// Applies the changes of a patch to the mesh.
    fn apply_change(&mut self, change: &PatchChange) {
        let first = self.complex.nodes.len() as u32;
        let node_id = |n: u32| match NONE - n {
            new if (new as usize) < change.new_nodes.len() => first + new,
            _ => n,
        };
        for &(x, constraint) in &change.new_nodes {
            let node = self.complex.add_node(x);
            self.constraints.push(constraint);
            self.moved_nodes.push(node);
        }
        for &(node, (x, constraint)) in &change.moved_nodes {
            self.complex.nodes[node as usize] = x;
            self.constraints[node as usize] = constraint;
            if !constraint.is_far {
                self.moved_nodes.push(node);
            }
        }
        self.new_tets.clear();
        let new_tets = change.new_tets.iter().map(|tet| tet.map(node_id));
        self.new_tets.extend(new_tets);
        self.commit(&change.removed_tets);
        for &(node, _) in &change.moved_nodes {
            self.complex.star(node, &mut self.star);
            self.measure_star();
        }
        self.counts += change.counts;
    }
}

impl<'a> LocalPatch<'a> {
    /// Copies the mesh around tetrahedra into this patch and repairs them in it. Returns the
    /// changes.
    fn try_repairs(
        &mut self,
        full: &TetImprover<'a>,
        tets: &[u32],
        cancel: &CancelToken<'_>,
    ) -> PatchResult {
        let (numbering, improver) = (&mut self.numbering, &mut self.improver);
        let balls: Vec<([f64; 3], f64)> = tets
            .iter()
            .map(|&t| {
                let (middle, d) = full.centre_and_spacing(t);
                (middle, (PATCH_RADIUS * d).powi(2))
            })
            .collect();
        let is_inside = |x| {
            let is_in_ball = |&(middle, square): &([f64; 3], f64)| {
                let offset = sub(x, middle);
                dot(offset, offset) <= square
            };
            balls.iter().any(is_in_ball)
        };
        (improver.complex).set_to_part(&full.complex, tets, is_inside, numbering);
        let (slots, nodes) = (&numbering.slots, &numbering.nodes);
        improver.sines.clear();
        improver
            .sines
            .extend(slots.iter().map(|&t| full.sines[t as usize]));
        improver.constraints.clear();
        improver
            .constraints
            .extend(nodes.iter().map(|&(n, _)| full.constraints[n as usize]));
        improver.attempts.set_to_part(
            &full.attempts,
            nodes.iter().map(|n| n.0),
            slots.iter().copied(),
        );
        improver.queue.clear();
        improver.moved_nodes.clear();
        improver.counts = OperationCounts::default();
        (
            improver.effort,
            improver.smoothing_target,
            improver.max_deviation,
            improver.axis_range,
        ) = (
            full.effort,
            full.smoothing_target,
            full.max_deviation,
            full.axis_range,
        );

        let (mut deferred, mut failed) = (Vec::new(), Vec::new());
        for t in 0..tets.len() as u32 {
            if cancel.is_cancelled() {
                break;
            }
            if !improver.is_below_target(t) || improver.is_known_to_fail(t) {
                continue;
            }
            let repaired = improver.repair_one(t);
            if improver.complex.take_reached_nonlocal() {
                deferred.push(tets[t as usize]);
            } else if !repaired {
                improver.attempts.record_failure(AttemptKind::Repair, t);
                failed.push(t);
            }
        }
        failed.retain(|&t| improver.is_below_target(t) && improver.is_known_to_fail(t));
        let inner = nodes.iter().filter(|n| n.1).map(|n| n.0);
        PatchResult {
            nodes: inner.collect(),
            deferred,
            failed: failed.into_iter().map(|t| tets[t as usize]).collect(),
            change: self.collect_change(&full.complex),
        }
    }

    /// Returns the difference between the patch and the mesh.
    fn collect_change(&self, full: &Complex) -> PatchChange {
        let Self {
            numbering,
            improver,
        } = self;
        let Complex { nodes, tets, .. } = &improver.complex;
        let (slots, known_count) = (&numbering.slots, numbering.nodes.len());
        let number = |n: u32| match numbering.nodes.get(n as usize) {
            Some(&(number, _)) => number,
            None => NONE - (n - known_count as u32),
        };
        // Slots whose tetrahedron is replaced come first: the removed and the new tetrahedron then
        // have the same position in both lists.
        let (mut removed_tets, mut new_tets, mut only_removed, mut only_new) =
            (vec![], vec![], vec![], vec![]);
        for (t, tet) in tets.iter().enumerate() {
            let alive = tet[0] != NONE;
            let global_tet = tet.map(|n| if alive { number(n) } else { NONE });
            match slots.get(t) {
                Some(&slot) if full.tets[slot as usize] == global_tet => {}
                Some(&slot) if alive => {
                    removed_tets.push(slot);
                    new_tets.push(global_tet);
                }
                Some(&slot) => only_removed.push(slot),
                None => only_new.extend(alive.then_some(global_tet)),
            }
        }
        removed_tets.append(&mut only_removed);
        new_tets.append(&mut only_new);
        let constrained_point = |n: usize| (nodes[n], improver.constraints[n]);
        let moved =
            (0..known_count).filter(|&n| nodes[n] != full.nodes[numbering.nodes[n].0 as usize]);
        PatchChange {
            removed_tets,
            new_tets,
            moved_nodes: moved
                .map(|n| (numbering.nodes[n].0, constrained_point(n)))
                .collect(),
            new_nodes: (known_count..nodes.len()).map(constrained_point).collect(),
            counts: improver.counts,
        }
    }
}

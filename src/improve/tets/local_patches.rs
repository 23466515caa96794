//! Many tetrahedra mended at once, those near one another in a copy of what is round them: a patch. Meanwhile the mesh
//! stays as it is; then it is changed as the patches were. So what becomes of it does not depend on how many are at
//! work, or where: ranks share them.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use crate::parallel::prelude::*;

use super::attempt_cache::AttemptKind;
use super::{ConstrainedPoint, TetImprover};
use crate::files::codec::codec_fields;
use crate::geometry::{dot, sub};
use crate::improve::OperationCounts;
use crate::mesh::complex::{Complex, NONE, PartNumbering};
use crate::progress::CancelToken;
use crate::{Result, comm};

/// A patch has all tetrahedra at the nodes so near to the middle of one that is mended there, over d. What asks for
/// more, as few do, is mended in the mesh itself.
const PATCH_RADIUS: f64 = 3.5;
/// Edge of a cube, over the largest d of what is mended in it: patches of two cubes with one between them do not meet,
/// as tetrahedra go some 1.3 d beyond the nodes that they have there.
const CUBE_EDGE: f64 = 2.0 * (PATCH_RADIUS + 1.3);
/// What is mended at the same time has about the same d: cubes shrink by this with it.
const CUBE_SHRINK_FACTOR: f64 = std::f64::consts::SQRT_2;

/// With fewer cubes there is little to do at the same time, and to mend the poorest of all first is less work and leaves
/// fewer poor.
const MIN_CUBES: usize = 64;

/// What becomes of tetrahedra whose middles are in one cube.
struct LocalPatch<'a> {
    numbering: PartNumbering,
    improver: TetImprover<'a>,
}

/// What became of a patch. Numbers are those of the mesh; a node that is not there yet is `NONE` less its number
/// among the new ones.
struct PatchResult {
    /// What it depends on: nodes.
    nodes: Vec<u32>,
    /// The tetrahedra that it was too small for.
    deferred: Vec<u32>,
    /// Those that nothing mends.
    failed: Vec<u32>,
    change: PatchChange,
}

struct PatchChange {
    /// Tetrahedra that go, and those that take their place.
    removed_tets: Vec<u32>,
    new_tets: Vec<[u32; 4]>,
    /// Nodes that move, and to where.
    moved_nodes: Vec<(u32, ConstrainedPoint)>,
    new_nodes: Vec<ConstrainedPoint>,
    counts: OperationCounts,
}

/// A cube, by how often its edge has shrunk and its number along each axis, and tetrahedra in it.
pub(super) type Cube = ((u32, [u32; 3]), Vec<u32>);

codec_fields! {
    PatchResult as PatchResult { nodes, deferred, failed, change }
    PatchChange as PatchChange { removed_tets, new_tets, moved_nodes, new_nodes, counts }
}

impl<'a> TetImprover<'a> {
    /// Mends tetrahedra: in patches if there are enough, the first ones first otherwise and in each; tells how far it
    /// is.
    ///
    /// # Errors
    /// Those of [`comm::partition`].
    pub(super) fn repair_each(
        &mut self,
        poor: &[u32],
        patience: &CancelToken<'_>,
        reached: impl Fn(f64),
    ) -> Result<()> {
        let d = |&t: &u32| self.centre_and_spacing(t).1;
        let edge = CUBE_EDGE * poor.iter().map(d).fold(0.0, f64::max);
        let apart = self.cubes(poor, edge);
        let (done, later) = match apart.iter().flatten().count() < MIN_CUBES {
            true => (0.0, poor.to_vec()),
            false => (
                1.0,
                self.repair_in_patches(apart, edge, patience, &reached)?,
            ),
        };
        let count = later.len() as f64;
        for (number, t) in later.into_iter().enumerate() {
            reached((number as f64 / count).max(done));
            if patience.is_cancelled() {
                break;
            }
            if self.is_below_target(t) && !self.is_known_to_fail(t) {
                self.repair_in_place(t);
            }
        }
        Ok(())
    }

    /// Mends tetrahedra in patches, those of each cube in one; gives those for which patches were too small.
    pub(super) fn repair_in_patches(
        &mut self,
        apart: Vec<Vec<Cube>>,
        edge: f64,
        patience: &CancelToken<'_>,
        reached: &impl Fn(f64),
    ) -> Result<Vec<u32>> {
        let pool = Mutex::new(Vec::new());
        let mut later = Vec::new();
        let phases = apart.len() as f64;
        for (phase, mut cubes) in apart.into_iter().enumerate() {
            reached(phase as f64 / phases);
            // Numbers of tetrahedra that went are those of others now, which may be anywhere.
            for (cube, tets) in &mut cubes {
                tets.retain(|&t| self.is_below_target(t) && self.cube(t, edge) == *cube);
            }
            let mut all = Vec::with_capacity(cubes.len());
            let work = |own: Range<usize>, give: &mut dyn FnMut(PatchResult)| {
                let tried: Vec<PatchResult> = cubes[own]
                    .par_iter()
                    .with_max_len(1)
                    .map(|(_, tets)| self.try_in_patch(tets, &pool, patience))
                    .collect();
                tried.into_iter().for_each(give);
                Ok(())
            };
            let much: Vec<usize> = cubes.iter().map(|(_, tets)| tets.len()).collect();
            match self.is_rank_local {
                true => work(0..cubes.len(), &mut |tried| all.push(tried))?,
                false => {
                    comm::distribute_weighted("patches", &much, work, &mut |tried| {
                        all.push(tried)
                    })?;
                }
            }
            let begun = self.attempts.clock();
            for ((_, tets), tried) in cubes.into_iter().zip(all) {
                if self.attempts.has_changed(begun, &tried.nodes) {
                    later.extend(tets);
                    continue;
                }
                self.apply_change(&tried.change);
                for t in tried.failed {
                    self.attempts.record_failure(AttemptKind::Mend, t);
                }
                later.extend(tried.deferred);
            }
        }
        Ok(later)
    }

    pub(super) fn is_below_target(&self, t: u32) -> bool {
        self.complex.is_alive(t)
            && self.sine_of(t) < self.target_sine
            && self.is_in_range(&self.complex.tets[t as usize])
    }

    /// The cube that the middle of a tetrahedron is in, where the largest have this edge.
    fn cube(&self, t: u32, edge: f64) -> (u32, [u32; 3]) {
        let (middle, d) = self.centre_and_spacing(t);
        let shrunk = (edge / (CUBE_EDGE * d))
            .log(CUBE_SHRINK_FACTOR)
            .max(0.0)
            .floor();
        let edge = edge / CUBE_SHRINK_FACTOR.powf(shrunk);
        (shrunk as u32, middle.map(|c| (c / edge) as u32))
    }

    /// Tetrahedra by their cubes; groups of cubes of which no two patches meet.
    pub(super) fn cubes(&self, tets: &[u32], edge: f64) -> Vec<Vec<Cube>> {
        let mut cubes: BTreeMap<(u32, [u32; 3]), Vec<u32>> = BTreeMap::new();
        for &t in tets.iter().filter(|&&t| self.is_below_target(t)) {
            cubes.entry(self.cube(t, edge)).or_default().push(t);
        }
        let mut apart: BTreeMap<(u32, [u32; 3]), Vec<Cube>> = BTreeMap::new();
        for (cube, tets) in cubes {
            let (shrunk, place) = cube;
            let group = (shrunk, place.map(|c| c % 2));
            apart.entry(group).or_default().push((cube, tets));
        }
        apart.into_values().collect()
    }

    /// Mends tetrahedra in a copy of what is round them.
    fn try_in_patch(
        &self,
        tets: &[u32],
        pool: &Mutex<Vec<LocalPatch<'a>>>,
        patience: &CancelToken<'_>,
    ) -> PatchResult {
        let lock = || pool.lock().unwrap_or_else(PoisonError::into_inner);
        let taken = lock().pop();
        let mut patch = taken.unwrap_or_else(|| LocalPatch {
            numbering: PartNumbering::default(),
            improver: Self::empty(self.extent, self.planes, self.distance, self.target_sine),
        });
        let tried = patch.try_repairs(self, tets, patience);
        lock().push(patch);
        tried
    }

    /// Changes the mesh as a patch was.
    fn apply_change(&mut self, change: &PatchChange) {
        let first = self.complex.nodes.len() as u32;
        let number = |n: u32| match NONE - n {
            new if (new as usize) < change.new_nodes.len() => first + new,
            _ => n,
        };
        for &(x, hold) in &change.new_nodes {
            let node = self.complex.add_node(x);
            self.constraints.push(hold);
            self.moved_nodes.push(node);
        }
        for &(node, (x, hold)) in &change.moved_nodes {
            self.complex.nodes[node as usize] = x;
            self.constraints[node as usize] = hold;
            if !hold.is_far {
                self.moved_nodes.push(node);
            }
        }
        self.new_tets.clear();
        let made = change.new_tets.iter().map(|tet| tet.map(number));
        self.new_tets.extend(made);
        self.commit(&change.removed_tets);
        for &(node, _) in &change.moved_nodes {
            self.complex.star(node, &mut self.star);
            self.measure_star();
        }
        self.counts += change.counts;
    }
}

impl<'a> LocalPatch<'a> {
    fn try_repairs(
        &mut self,
        whole: &TetImprover<'a>,
        tets: &[u32],
        patience: &CancelToken<'_>,
    ) -> PatchResult {
        let (numbers, part) = (&mut self.numbering, &mut self.improver);
        let balls: Vec<([f64; 3], f64)> = tets
            .iter()
            .map(|&t| {
                let (middle, d) = whole.centre_and_spacing(t);
                (middle, (PATCH_RADIUS * d).powi(2))
            })
            .collect();
        let holds = |x| {
            let within = |&(middle, square): &([f64; 3], f64)| {
                let away = sub(x, middle);
                dot(away, away) <= square
            };
            balls.iter().any(within)
        };
        (part.complex).set_to_part(&whole.complex, tets, holds, numbers);
        let (slots, nodes) = (&numbers.slots, &numbers.nodes);
        part.sines.clear();
        part.sines
            .extend(slots.iter().map(|&t| whole.sines[t as usize]));
        part.constraints.clear();
        part.constraints
            .extend(nodes.iter().map(|&(n, _)| whole.constraints[n as usize]));
        part.attempts.set_to_part(
            &whole.attempts,
            nodes.iter().map(|n| n.0),
            slots.iter().copied(),
        );
        part.queue.clear();
        part.moved_nodes.clear();
        part.counts = OperationCounts::default();
        (part.smoothing_target, part.max_deviation, part.axis_range) = (
            whole.smoothing_target,
            whole.max_deviation,
            whole.axis_range,
        );

        let (mut beyond, mut failed) = (Vec::new(), Vec::new());
        for t in 0..tets.len() as u32 {
            if patience.is_cancelled() {
                break;
            }
            if !part.is_below_target(t) || part.is_known_to_fail(t) {
                continue;
            }
            let mended = part.repair_one(t);
            if part.complex.take_reached_nonlocal() {
                beyond.push(tets[t as usize]);
            } else if !mended {
                part.attempts.record_failure(AttemptKind::Mend, t);
                failed.push(t);
            }
        }
        failed.retain(|&t| part.is_below_target(t) && part.is_known_to_fail(t));
        let inner = nodes.iter().filter(|n| n.1).map(|n| n.0);
        PatchResult {
            nodes: inner.collect(),
            deferred: beyond,
            failed: failed.into_iter().map(|t| tets[t as usize]).collect(),
            change: self.collect_change(&whole.complex),
        }
    }

    /// What has changed.
    fn collect_change(&self, whole: &Complex) -> PatchChange {
        let Self {
            numbering: numbers,
            improver,
        } = self;
        let Complex { nodes, tets, .. } = &improver.complex;
        let (slots, known) = (&numbers.slots, numbers.nodes.len());
        let number = |n: u32| match numbers.nodes.get(n as usize) {
            Some(&(number, _)) => number,
            None => NONE - (n - known as u32),
        };
        // Those with another in their place come first: it has the same number here and there.
        let (mut gone, mut made, mut dead, mut new) = (vec![], vec![], vec![], vec![]);
        for (t, tet) in tets.iter().enumerate() {
            let alive = tet[0] != NONE;
            let now = tet.map(|n| if alive { number(n) } else { NONE });
            match slots.get(t) {
                Some(&slot) if whole.tets[slot as usize] == now => {}
                Some(&slot) if alive => {
                    gone.push(slot);
                    made.push(now);
                }
                Some(&slot) => dead.push(slot),
                None => new.extend(alive.then_some(now)),
            }
        }
        gone.append(&mut dead);
        made.append(&mut new);
        let place = |n: usize| (nodes[n], improver.constraints[n]);
        let moved = (0..known).filter(|&n| nodes[n] != whole.nodes[numbers.nodes[n].0 as usize]);
        PatchChange {
            removed_tets: gone,
            new_tets: made,
            moved_nodes: moved.map(|n| (numbers.nodes[n].0, place(n))).collect(),
            new_nodes: (known..nodes.len()).map(place).collect(),
            counts: improver.counts,
        }
    }
}

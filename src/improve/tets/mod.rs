//! Improves a Delaunay mesh in space: removes its slivers and makes its faces lie on the features.
//!
//! - `recover`: removes edges that pass through a feature
//! - `flips`: Joe's local transformations, generalised
//! - `smooth`: max-min smoothing
//! - `local_link`: the dihedral angles around a node that moves
//! - `batch`: many flips and moves at once
//! - `repair`: several operations at once, kept only if they help together
//! - `local_patches`: many repairs at once
//! - `shared_work`: searches and patches that ranks share
//! - `collapse`: removes nodes that are too close to each other
//! - `attempt_cache`: a cache of attempts that failed
//! - `finish`: the mesh at the end, its faces on features, and what blocks the rest
//! - `exude`: the second method; nodes get weights, and none of them moves
//! - `slabs`: improves large meshes slab by slab
//! - `fixed_side`: makes a mesh match given triangles on sides of its box
//! - `reshape`: adds, removes and moves atoms in a part of a mesh

mod attempt_cache;
mod batch;
mod collapse;
mod exude;
mod finish;
mod fixed_side;
mod flips;
mod local_link;
mod local_patches;
mod recover;
mod repair;
mod reshape;
mod shared_work;
mod slabs;
mod smooth;

pub use exude::exude;
pub use fixed_side::{BoxSide, improve_beside, improve_between};
pub use shared_work::SharedWork;
pub use slabs::{DistributedSlabs, KnownAtoms, SlabCuts, SlabResult};

use crate::parallel::prelude::*;

use self::attempt_cache::{AttemptCache, AttemptKind};
use super::constraint::{NodeConstraint, SurfaceProximity};
use super::feature_planes::{FeaturePlanes, LocalPlane};
use super::intersect::find_intersection;
use super::{Effort, ImproveReport, OperationCounts, Target};
use crate::Result;
use crate::geometry::sub;
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::mesh::complex::Complex;
use crate::mesh::quality::{BLOCK_SIZE, CornerBlock, min_sine};
use crate::mesh::{FACES, TetMesh};
use crate::progress::CancelToken;

/// Margin above the target sine at which the first round of smoothing, over many nodes, stops.
const SMOOTHING_MARGIN: f64 = 0.02;

/// Largest distances, in samples, of nodes from the features that hold them, used one after the
/// other where tetrahedra otherwise stay below target. Features are known to some tenths of a
/// sample only, while an angle that lacks a degree needs little room.
const MAX_DEVIATIONS: [f64; 2] = [0.25, 0.4];

/// Largest distance of nodes from the features that hold them, in units of d.
const MAX_DEVIATION_RATIO: f64 = 0.15;

/// Approximate share of the work that is done once features are recovered.
const RECOVERY_WORK_SHARE: f64 = 0.15;

/// Largest number of rounds of flips and smoothing: while nodes stay on their features, and while
/// they may leave them, when many nodes move little by little.
const MAX_ROUNDS: [usize; 2] = [8, 12];
/// Largest numbers of these rounds in a draft.
const DRAFT_ROUNDS: [usize; 2] = [2, 4];

/// Smallest gain in sine of one step of smoothing, as a share of what is missing to 1 at its start. A
/// draft takes a quarter less time with its larger gain, but covers features less well.
const MIN_STEP_GAIN: f64 = 1e-3;
const DRAFT_MIN_STEP_GAIN: f64 = 5e-3;

/// Degrees above the target at which improvement aims at the best effort, once the target is reached.
const BEST_EXTRA_ANGLE: f64 = 5.0;

/// The box of a mesh, the features in it, and what its improvement aims at.
#[derive(Debug, Clone, Copy)]
pub struct ImproveContext<'a> {
    /// Far corner of the box.
    pub extent: [f64; 3],
    /// Local planes of the features.
    pub planes: &'a FeaturePlanes,
    /// Nominal distance d.
    pub distance: &'a Distance<3>,
    /// Quality to reach.
    pub target: Target,
}

impl ImproveContext<'_> {
    /// Returns the sine of the target for the smallest angle.
    fn target_sine(&self) -> f64 {
        self.target.min_dihedral.to_radians().sin()
    }
}

/// Makes a Delaunay mesh follow the features and removes its slivers, in place.
///
/// `neighbours` are those of the tetrahedra (see [`complex`](crate::mesh::complex)) and are updated.
/// `kinds` are those of the nodes; nodes that are inserted or removed change it. The result also
/// has, for every tetrahedron, its faces on features: bit k for face k (opposite node k). If
/// `cancel` is cancelled, the mesh keeps the changes made so far.
///
/// # Errors
/// Returns an error if another rank that shares the work fails.
pub fn improve(
    mesh: &mut TetMesh,
    neighbours: &mut Vec<[u32; 4]>,
    kinds: &mut Vec<AtomKind>,
    context: ImproveContext<'_>,
    work: SharedWork<'_>,
    cancel: &CancelToken<'_>,
) -> Result<(ImproveReport, Vec<u8>)> {
    let (owned_mesh, owned_neighbours) = (std::mem::take(mesh), std::mem::take(neighbours));
    let mut improver = TetImprover::new(owned_mesh, owned_neighbours, kinds, context, cancel);
    improver.work = work;
    let report = improver.improve(cancel)?;
    let finished = improver.finish(kinds);
    (*mesh, *neighbours, *kinds) = (finished.mesh, finished.neighbours, finished.kinds);
    Ok((report, finished.feature_faces))
}

/// Number of tetrahedra that one task measures or searches.
const TASK_SIZE: usize = 64 * BLOCK_SIZE;

/// Position of a node, and its constraints there.
type ConstrainedPoint = ([f64; 3], NodeConstraint);

/// State of an improvement: the complex, the smallest sine of every slot, and the constraints of
/// every node.
struct TetImprover<'a> {
    complex: Complex,
    sines: Vec<f32>,
    constraints: Vec<NodeConstraint>,
    /// Surfaces close to the nodes at the beginning; empty once any node has moved.
    proximities: Vec<SurfaceProximity>,
    extent: [f64; 3],
    /// Bit k: the faces on the sides normal to axis k do not change.
    frozen_axes: u8,
    planes: &'a FeaturePlanes,
    distance: &'a Distance<3>,
    /// Tetrahedra to be processed.
    queue: Vec<u32>,
    target_sine: f64,
    /// How much work goes into reaching the target.
    effort: Effort,
    /// Sine at which smoothing of a node stops.
    smoothing_target: f64,
    /// Largest distance, in samples, of smoothed nodes from the surfaces that hold them.
    max_deviation: f64,
    /// The ranks that share the work; none if other ranks work on other meshes.
    work: SharedWork<'a>,
    /// Axis and range along it to which the work is limited.
    axis_range: Option<(usize, [f64; 2])>,
    counts: OperationCounts,
    /// Edges that still pass through a feature after recovery, and nodes near features that have
    /// moved or are new since.
    unrecovered_edges: Vec<(u32, u32)>,
    moved_nodes: Vec<u32>,
    /// Values overwritten by the current transaction.
    undo: Option<repair::TransactionLog>,
    attempts: AttemptCache,
    // Scratch space.
    candidate_flip: flips::Flip,
    new_tets: Vec<[u32; 4]>,
    slots: Vec<u32>,
    touched: Vec<bool>,
    star: Vec<u32>,
    star_sines: Vec<f32>,
    link: smooth::NodeLink,
    smooth_scratch: smooth::SmoothScratch,
    scratch_pool: batch::ScratchPool,
    colors: Vec<u8>,
}

impl<'a> TetImprover<'a> {
    fn new(
        mesh: TetMesh,
        neighbours: Vec<[u32; 4]>,
        kinds: &[AtomKind],
        context: ImproveContext<'a>,
        cancel: &CancelToken<'_>,
    ) -> Self {
        let ImproveContext {
            extent,
            planes,
            distance,
            ..
        } = context;
        let (constraints, proximities) = mesh
            .nodes
            .par_iter()
            .zip(kinds)
            .map(|(&x, &kind)| {
                if cancel.is_cancelled() {
                    (
                        NodeConstraint::from_box(x, kind, extent),
                        SurfaceProximity::Nothing,
                    )
                } else {
                    NodeConstraint::new(x, kind, extent, planes)
                }
            })
            .unzip();
        let mut sines = vec![0.0f32; mesh.tets.len()];
        sines
            .par_chunks_mut(TASK_SIZE)
            .zip(mesh.tets.par_chunks(TASK_SIZE))
            .for_each(|(sines, tets)| {
                let (mut corners, mut block) = (CornerBlock::default(), [0.0; BLOCK_SIZE]);
                for (sines, tets) in sines.chunks_mut(BLOCK_SIZE).zip(tets.chunks(BLOCK_SIZE)) {
                    corners.gather(&mesh.nodes, tets);
                    corners.min_sines(&mut block);
                    for (sine, value) in sines.iter_mut().zip(&block) {
                        *sine = *value as f32;
                    }
                }
            });
        Self {
            complex: Complex::new(mesh, neighbours),
            sines,
            constraints,
            proximities,
            effort: context.target.effort,
            ..Self::empty(extent, planes, distance, context.target_sine())
        }
    }

    /// Creates the state without a mesh.
    fn empty(
        extent: [f64; 3],
        planes: &'a FeaturePlanes,
        distance: &'a Distance<3>,
        target_sine: f64,
    ) -> Self {
        Self {
            complex: Complex::default(),
            sines: Vec::new(),
            constraints: Vec::new(),
            proximities: Vec::new(),
            extent,
            frozen_axes: 0,
            planes,
            distance,
            queue: Vec::new(),
            target_sine,
            effort: Effort::Normal,
            smoothing_target: 1.0,
            max_deviation: 0.0,
            work: SharedWork::alone(),
            axis_range: None,
            counts: OperationCounts::default(),
            unrecovered_edges: Vec::new(),
            moved_nodes: Vec::new(),
            undo: None,
            attempts: AttemptCache::default(),
            candidate_flip: flips::Flip::default(),
            new_tets: Vec::new(),
            slots: Vec::new(),
            touched: Vec::new(),
            star: Vec::new(),
            star_sines: Vec::new(),
            link: smooth::NodeLink::default(),
            smooth_scratch: smooth::SmoothScratch::default(),
            scratch_pool: batch::ScratchPool::default(),
            colors: Vec::new(),
        }
    }

    /// Returns the limits within which nodes are smoothed.
    #[inline]
    fn smoothing_limits(&self) -> smooth::SmoothingLimits<'a> {
        smooth::SmoothingLimits {
            extent: self.extent,
            planes: self.planes,
            max_deviation: self.max_deviation,
            target_sine: self.smoothing_target,
            min_step_gain: match self.effort {
                Effort::Draft => DRAFT_MIN_STEP_GAIN,
                Effort::Normal | Effort::Best => MIN_STEP_GAIN,
            },
        }
    }

    /// Returns the smallest sine of the dihedral angles of a tetrahedron.
    #[inline]
    fn sine_of(&self, t: u32) -> f64 {
        f64::from(self.sines[t as usize])
    }

    /// Returns `true` if an edge between two nodes would pass through a feature or cut a corner of
    /// it.
    fn intersects(&self, a: u32, b: u32) -> bool {
        self.find_intersection(a, b).is_some()
    }

    /// Returns `false` only if [`find_intersection`](Self::find_intersection) returns `None`. This
    /// test is fast.
    fn may_intersect(&self, a: u32, b: u32) -> bool {
        let (i, j) = (a as usize, b as usize);
        let (p, q) = (&self.constraints[i], &self.constraints[j]);
        let (x, y) = (self.complex.nodes[i], self.complex.nodes[j]);
        let is_isolated = [p.is_isolated, q.is_isolated];
        // A chord of a surface may be off it in its middle.
        let is_chord = is_isolated == [true; 2];
        if !is_chord
            && let (Some(at_x), Some(at_y)) = (self.proximities.get(i), self.proximities.get(j))
        {
            // A surface that passes through the edge is close to one of its ends.
            if at_x.is_same_side(*at_y, sub(y, x), is_isolated) {
                return false;
            }
        }
        !(p.is_far && q.is_far) && self.planes.may_intersect(x, y, is_isolated)
    }

    /// Returns where the edge between two nodes passes through a feature or cuts a corner of it,
    /// and the local plane there.
    fn find_intersection(&self, a: u32, b: u32) -> Option<([f64; 3], LocalPlane)> {
        let (i, j) = (a as usize, b as usize);
        find_intersection(
            self.planes,
            [&self.constraints[i], &self.constraints[j]],
            [self.complex.nodes[i], self.complex.nodes[j]],
        )
    }

    /// Exchanges `old_tets` for the tetrahedra in `new_tets`, and queues those below target.
    fn commit(&mut self, old_tets: &[u32]) {
        if self.complex.has_reached_nonlocal() {
            // A part of the mesh is missing here, and the transaction will be rolled back.
            return;
        }
        if let Some(undo) = &mut self.undo {
            // The old state must include the slots that become empty.
            undo.record_slots(old_tets, &self.sines);
        }
        let Self {
            complex, new_tets, ..
        } = self;
        let old_nodes = old_tets.iter().flat_map(|&t| complex.tets[t as usize]);
        self.attempts
            .record_change(old_nodes.chain(new_tets.iter().flatten().copied()));
        self.complex
            .exchange(old_tets, &self.new_tets, &mut self.slots);
        for &t in &old_tets[self.new_tets.len().min(old_tets.len())..] {
            self.sines[t as usize] = f32::INFINITY;
        }
        for i in 0..self.slots.len() {
            self.measure(self.slots[i]);
        }
    }

    /// Measures a tetrahedron again and queues it if it is below target.
    fn measure(&mut self, t: u32) {
        let sine = min_sine(&self.complex.corners(t)) as f32;
        self.set_sine(t, sine);
    }

    /// Sets the smallest sine of a tetrahedron and queues it if it is below target.
    fn set_sine(&mut self, t: u32, sine: f32) {
        if t as usize == self.sines.len() {
            self.sines.push(f32::INFINITY);
        }
        if let Some(undo) = &mut self.undo {
            undo.record_slots(&[t], &self.sines);
        }
        self.sines[t as usize] = sine;
        if f64::from(sine) < self.target_sine {
            self.queue.push(t);
        }
    }

    /// Processes the queue with flips.
    fn flip_queue(&mut self, cancel: &CancelToken<'_>) {
        while let Some(t) = self.queue.pop() {
            if cancel.is_cancelled() || self.complex.has_reached_nonlocal() {
                self.queue.clear();
                break;
            }
            if !self.complex.is_alive(t) || self.sine_of(t) >= self.target_sine {
                continue;
            }
            // The flips of a tetrahedron depend only on what is at its nodes.
            let tet = self.complex.tets[t as usize];
            if self.attempts.is_known_to_fail(AttemptKind::Flip, t, &tet) {
                continue;
            }
            if self.flip(t) {
                self.counts.flips += 1;
            } else {
                self.attempts.record_failure(AttemptKind::Flip, t);
            }
        }
    }

    /// Collects the tetrahedra at `node`: their slots into `star`, the positions of the other three
    /// nodes into `link`.
    fn gather_star(&mut self, node: u32) {
        self.complex.star(node, &mut self.star);
        let mut link = std::mem::take(&mut self.link);
        self.collect_link(node, &self.star, &mut link);
        self.link = link;
    }

    /// Collects the positions of the other three nodes of each of the tetrahedra at `node`.
    fn collect_link(&self, node: u32, star: &[u32], link: &mut smooth::NodeLink) {
        link.clear();
        for &t in star {
            let tet = self.complex.tets[t as usize];
            let k = self.complex.local_index(t, node);
            // (face k, k) is positive, and (k, face k) is an odd permutation of it: swap two nodes.
            let [u, v, w] = FACES[k].map(|i| self.complex.nodes[tet[i] as usize]);
            link.push([u, w, v]);
        }
    }

    /// Smooths one node. Returns `true` if it moved.
    fn smooth(&mut self, node: u32) -> bool {
        let mut constraint = self.constraints[node as usize];
        if constraint.fixed_axes == 7
            || self
                .attempts
                .is_known_to_fail(AttemptKind::Smooth, node, &[node])
        {
            return false;
        }
        self.gather_star(node);
        let best = smooth::best_position(
            self.complex.nodes[node as usize],
            &self.link,
            &mut constraint,
            self.smoothing_limits(),
            &mut self.smooth_scratch,
        );
        let Some((x, _)) = best else {
            self.attempts.record_failure(AttemptKind::Smooth, node);
            return false;
        };
        let mut sines = std::mem::take(&mut self.star_sines);
        smooth::link_sines(x, &self.link, &mut sines);
        self.move_smoothed(node, (x, constraint), &sines);
        self.star_sines = sines;
        true
    }

    /// Moves a node whose star has been collected, and whose tetrahedra have these sines then.
    fn move_smoothed(&mut self, node: u32, (x, constraint): ConstrainedPoint, sines: &[f32]) {
        self.place(node, x, constraint);
        self.record_star_change();
        for (i, &sine) in sines.iter().enumerate() {
            self.set_sine(self.star[i], sine);
        }
    }

    /// Moves a node whose star has been collected.
    fn move_to(&mut self, node: u32, x: [f64; 3], constraint: NodeConstraint) {
        self.place(node, x, constraint);
        self.measure_star();
    }

    /// Sets the position and the constraints of a node.
    fn place(&mut self, node: u32, x: [f64; 3], constraint: NodeConstraint) {
        let i = node as usize;
        if let Some(undo) = &mut self.undo {
            undo.nodes
                .push((node, self.complex.nodes[i], self.constraints[i]));
        }
        self.complex.nodes[i] = x;
        self.constraints[i] = constraint;
        if !constraint.is_far {
            self.moved_nodes.push(node);
        }
    }

    /// Records that the tetrahedra in `star` have changed.
    fn record_star_change(&mut self) {
        let tets = &self.complex.tets;
        let around = self.star.iter().flat_map(|&t| tets[t as usize]);
        self.attempts.record_change(around);
    }

    /// Measures the tetrahedra in `star`, which have changed.
    fn measure_star(&mut self) {
        self.record_star_change();
        for i in 0..self.star.len() {
            self.measure(self.star[i]);
        }
    }

    /// Returns `true` if all of the nodes are in the range to which the work is limited.
    #[inline]
    fn is_in_range(&self, nodes: &[u32]) -> bool {
        self.axis_range.is_none_or(|(axis, [low, high])| {
            let mut coordinates = nodes.iter().map(|&n| self.complex.nodes[n as usize][axis]);
            coordinates.all(|x| low <= x && x <= high)
        })
    }

    /// Returns the slots of the tetrahedra below target.
    fn tets_below_target(&self) -> Vec<u32> {
        let tasks = self.sines.par_chunks(TASK_SIZE).enumerate();
        let below_target_in = |(task, sines): (usize, &[f32])| {
            let mut below_target = Vec::new();
            for (block, sines) in sines.chunks(BLOCK_SIZE).enumerate() {
                // Most blocks contain none. The sine of an empty slot is infinite.
                let has_low = |low, &sine: &f32| low | (f64::from(sine) < self.target_sine);
                if sines.iter().fold(false, has_low) {
                    let first = (task * TASK_SIZE + block * BLOCK_SIZE) as u32;
                    let slots = first..first + sines.len() as u32;
                    let is_below = |t: &u32| {
                        self.sine_of(*t) < self.target_sine
                            && self.is_in_range(&self.complex.tets[*t as usize])
                    };
                    below_target.extend(slots.filter(is_below));
                }
            }
            below_target
        };
        tasks.flat_map_iter(below_target_in).collect()
    }
}

impl TetImprover<'_> {
    /// Flips and smooths while nodes may leave the surfaces that hold them by up to `max_deviation`
    /// samples.
    fn flip_and_smooth_within(
        &mut self,
        max_deviation: f64,
        rounds: usize,
        cancel: &CancelToken<'_>,
    ) -> Result<()> {
        self.max_deviation = max_deviation.min(MAX_DEVIATION_RATIO * self.distance.min());
        self.attempts.clear();
        self.flip_and_smooth(rounds, cancel)
    }

    /// Improves tetrahedra above target, too. None of them becomes worse than the target.
    fn raise_angles(&mut self, cancel: &CancelToken<'_>) -> Result<()> {
        let target_sine = self.target_sine;
        self.target_sine = (target_sine.asin() + BEST_EXTRA_ANGLE.to_radians()).sin();
        // Nodes move along their features first, so that fewer need to leave them.
        for deviation in [&[0.0], &MAX_DEVIATIONS[..]].concat() {
            self.flip_and_smooth_within(deviation, MAX_ROUNDS[1], cancel)?;
            self.repair(cancel)?;
        }
        self.target_sine = target_sine;
        Ok(())
    }

    /// Runs all steps in order.
    ///
    /// # Errors
    /// Returns an error if another rank that shares the work fails.
    fn improve(&mut self, cancel: &CancelToken<'_>) -> Result<ImproveReport> {
        let below_target_before = self.tets_below_target().len();
        cancel.set_range(0.0, RECOVERY_WORK_SHARE);
        self.recover(cancel)?;
        let deviations = match self.effort {
            Effort::Draft => &MAX_DEVIATIONS[1..],
            Effort::Normal | Effort::Best => &MAX_DEVIATIONS,
        };
        let stage_count = 1 + deviations.len() + usize::from(self.effort == Effort::Best);
        let stage_share = (1.0 - RECOVERY_WORK_SHARE) / stage_count as f64;
        let start_stage = |stages_done: usize| {
            let start = RECOVERY_WORK_SHARE + stages_done as f64 * stage_share;
            cancel.set_range(start, start + stage_share);
        };
        let rounds = match self.effort {
            Effort::Draft => DRAFT_ROUNDS,
            Effort::Normal | Effort::Best => MAX_ROUNDS,
        };
        start_stage(0);
        self.flip_and_smooth(rounds[0], cancel)?;
        // Where features leave the lattice too little room, more tetrahedra are below target than
        // can be repaired one by one. Most of these need only that nodes leave their features a
        // little, so that comes first.
        if self.effort != Effort::Draft && !self.has_too_many(self.tets_below_target().len()) {
            self.repair(cancel)?;
        }
        for (number, deviation) in deviations.iter().enumerate() {
            start_stage(1 + number);
            self.flip_and_smooth_within(*deviation, rounds[1], cancel)?;
            self.repair(cancel)?;
        }
        if self.effort != Effort::Draft {
            self.smooth_around_poor(cancel)?;
        }
        self.release_nodes(cancel)?;
        if self.effort == Effort::Best {
            start_stage(stage_count - 1);
            self.raise_angles(cancel)?;
        }
        self.counts.intersecting_left = self.count_intersecting_edges(cancel);
        Ok(ImproveReport {
            below_target_before,
            counts: self.counts,
            blocked: self.blocked_cells(),
        })
    }
}

#[cfg(test)]
mod tests;

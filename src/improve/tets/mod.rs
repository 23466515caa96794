//! From a Delaunay mesh in space to one without slivers whose faces lie on the features.
//!
//! - `recover`: features first: no edge may pierce one
//! - `flips`: Joe's local transformations, generalised
//! - `smooth`: max-min smoothing
//! - `sweep`: many flips and moves at once
//! - `mend`: several changes at once, kept only if together they help
//! - `patches`: many mended at once
//! - `collapse`: nodes that stand too close
//! - `finish`: the mesh at the end, its faces on features, what blocks the rest
//! - `exude`(fn@exude): the second method: nodes get weights, none of them moves
//! - `slabs`: large meshes, slab by slab
//! - `reshape`(fn@reshape): atoms come, go and move in a part of a mesh

mod attempt_cache;
mod batch;
mod collapse;
mod exude;
mod finish;
mod flips;
mod local_patches;
mod recover;
mod repair;
mod reshape;
mod slabs;
mod smooth;

pub use exude::exude;
pub use reshape::reshape;
pub use slabs::{KnownAtoms, SlabContext, SlabCuts, SlabResult, improve_in_slabs, slabs_of_rank};

use crate::parallel::prelude::*;

use self::attempt_cache::{AttemptCache, AttemptKind};
use super::constraint::{NodeConstraint, SurfaceProximity};
use super::feature_planes::{FeaturePlanes, LocalPlane};
use super::intersect::find_intersection;
use super::{ImproveReport, OperationCounts, Target};
use crate::Result;
use crate::geometry::sub;
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::mesh::complex::Complex;
use crate::mesh::quality::{BLOCK_SIZE, CornerBlock, min_sine};
use crate::mesh::{FACES, TetMesh};
use crate::progress::CancelToken;

/// The first round of smoothing, over many nodes, stops this far above target (sine).
const SMOOTHING_MARGIN: f64 = 0.02;

/// Where tetrahedra stay below target otherwise, their nodes may at last be so far (samples) off the
/// features that hold them. No feature is known better than to some tenths of a sample, while an angle
/// that lacks a degree needs little room.
const MAX_DEVIATIONS: [f64; 2] = [0.25, 0.4];

/// And at most so far, over d.
const MAX_DEVIATION_RATIO: f64 = 0.15;

/// The share of the work that is done once features are recovered, roughly.
const RECOVERY_WORK_SHARE: f64 = 0.15;

/// Rounds of flips and smoothing, and where nodes may stray, as many then do little by little.
const MAX_ROUNDS: [usize; 2] = [8, 12];

/// Makes a Delaunay mesh follow the features and frees it of slivers, in place.
///
/// `neighbors` are those of the tetrahedra (see [`complex`](crate::mesh::complex)) and stay so.
/// `kinds` says what each node is and follows the nodes that come and go; the result also says
/// for every tetrahedron which of its faces lie on a feature: bit k for face k (opposite node k).
/// When `patience` is over, the mesh is left as far as it has come.
///
/// # Errors
/// Those of other ranks, with which the work is shared.
pub fn improve(
    mesh: &mut TetMesh,
    neighbors: &mut Vec<[u32; 4]>,
    kinds: &mut Vec<AtomKind>,
    extent: [f64; 3],
    sheets: &FeaturePlanes,
    distance: &Distance<3>,
    target: &Target,
    patience: &CancelToken<'_>,
) -> Result<(ImproveReport, Vec<u8>)> {
    let target = target.min_dihedral.to_radians().sin();
    let (taken, around) = (std::mem::take(mesh), std::mem::take(neighbors));
    let mut improver = TetImprover::new(
        taken, around, kinds, extent, sheets, distance, target, patience,
    );
    let outcome = improver.improve(patience)?;
    let finished = improver.finish(kinds);
    (*mesh, *neighbors, *kinds) = (finished.mesh, finished.neighbors, finished.kinds);
    Ok((outcome, finished.feature_faces))
}

/// Tetrahedra that are measured, or looked through, in one task.
const TASK_SIZE: usize = 64 * BLOCK_SIZE;

/// Where a node is, and what holds it there.
type ConstrainedPoint = ([f64; 3], NodeConstraint);

/// State of an improvement: the complex, the quality of every slot, what holds every node.
struct TetImprover<'a> {
    complex: Complex,
    sines: Vec<f32>,
    constraints: Vec<NodeConstraint>,
    /// What was beside the nodes at first; empty once any has moved.
    proximities: Vec<SurfaceProximity>,
    extent: [f64; 3],
    planes: &'a FeaturePlanes,
    distance: &'a Distance<3>,
    /// Tetrahedra to look at.
    queue: Vec<u32>,
    target_sine: f64,
    /// Smoothing a node stops at this sine.
    smoothing_target: f64,
    /// Smoothing may take nodes so far off the sheets that hold them.
    max_deviation: f64,
    /// The mesh is this process's: other ranks are at work on others.
    is_rank_local: bool,
    /// What is looked at is between two places along an axis.
    axis_range: Option<(usize, [f64; 2])>,
    counts: OperationCounts,
    /// Edges that recovery left piercing a feature, and nodes near features that have moved or come
    /// since.
    unrecovered_edges: Vec<(u32, u32)>,
    moved_nodes: Vec<u32>,
    /// What a transaction under way has overwritten.
    undo: Option<repair::TransactionLog>,
    attempts: AttemptCache,
    // Scratch.
    candidate_flip: flips::Flip,
    new_tets: Vec<[u32; 4]>,
    slots: Vec<u32>,
    touched: Vec<bool>,
    star: Vec<u32>,
    link: smooth::NodeLink,
    smooth_scratch: smooth::SmoothScratch,
    scratch_pool: batch::ScratchPool,
    colors: Vec<u8>,
}

impl<'a> TetImprover<'a> {
    fn new(
        mesh: TetMesh,
        neighbors: Vec<[u32; 4]>,
        kinds: &[AtomKind],
        extent: [f64; 3],
        sheets: &'a FeaturePlanes,
        distance: &'a Distance<3>,
        target: f64,
        patience: &CancelToken<'_>,
    ) -> Self {
        let (constraints, proximities) = mesh
            .nodes
            .par_iter()
            .zip(kinds)
            .map(|(&x, &kind)| match patience.is_cancelled() {
                true => (
                    NodeConstraint::from_box(x, kind, extent),
                    SurfaceProximity::Nothing,
                ),
                false => NodeConstraint::new(x, kind, extent, sheets),
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
            complex: Complex::new(mesh, neighbors),
            sines,
            constraints,
            proximities,
            ..Self::empty(extent, sheets, distance, target)
        }
    }

    /// Of no mesh.
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
            planes,
            distance,
            queue: Vec::new(),
            target_sine,
            smoothing_target: 1.0,
            max_deviation: 0.0,
            is_rank_local: false,
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
            link: smooth::NodeLink::default(),
            smooth_scratch: smooth::SmoothScratch::default(),
            scratch_pool: batch::ScratchPool::default(),
            colors: Vec::new(),
        }
    }

    #[inline]
    fn sine_of(&self, t: u32) -> f64 {
        f64::from(self.sines[t as usize])
    }

    /// Whether an edge between two nodes would pass through a feature, or cut a corner of it.
    fn intersects(&self, a: u32, b: u32) -> bool {
        self.find_intersection(a, b).is_some()
    }

    /// A quick and safe test before [`piercing`](Self::find_intersection).
    fn may_intersect(&self, a: u32, b: u32) -> bool {
        let (i, j) = (a as usize, b as usize);
        let (p, q) = (&self.constraints[i], &self.constraints[j]);
        let (x, y) = (self.complex.nodes[i], self.complex.nodes[j]);
        let alone = [p.is_isolated, q.is_isolated];
        // A chord of a sheet may stray from it.
        let chord = alone == [true; 2];
        if !chord
            && let (Some(at_x), Some(at_y)) = (self.proximities.get(i), self.proximities.get(j))
        {
            // What passes the middle of the edge is beside one of its ends.
            if at_x.is_same_side(*at_y, sub(y, x), alone) {
                return false;
            }
        }
        !(p.is_far && q.is_far) && self.planes.may_intersect(x, y, alone)
    }

    fn find_intersection(&self, a: u32, b: u32) -> Option<([f64; 3], LocalPlane)> {
        let (i, j) = (a as usize, b as usize);
        find_intersection(
            self.planes,
            [&self.constraints[i], &self.constraints[j]],
            [self.complex.nodes[i], self.complex.nodes[j]],
        )
    }

    /// Exchanges `old` for the tetrahedra in `fresh`, and queues those below target.
    fn commit(&mut self, old: &[u32]) {
        if self.complex.has_reached_nonlocal() {
            // Something is missing here; all will be taken back.
            return;
        }
        if let Some(undo) = &mut self.undo {
            // Slots that die must count among what was there before.
            undo.record_slots(old, &self.sines);
        }
        let Self {
            complex,
            new_tets: fresh,
            ..
        } = self;
        let before = old.iter().flat_map(|&t| complex.tets[t as usize]);
        self.attempts
            .record_change(before.chain(fresh.iter().flatten().copied()));
        self.complex.exchange(old, &self.new_tets, &mut self.slots);
        for &t in &old[self.new_tets.len().min(old.len())..] {
            self.sines[t as usize] = f32::INFINITY;
        }
        for i in 0..self.slots.len() {
            self.measure(self.slots[i]);
        }
    }

    /// Measures a tetrahedron anew and queues it if it is below target.
    fn measure(&mut self, t: u32) {
        let sine = min_sine(&self.complex.corners(t)) as f32;
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

    /// Works through the queue with flips.
    fn flip_queue(&mut self, patience: &CancelToken<'_>) {
        while let Some(t) = self.queue.pop() {
            if patience.is_cancelled() || self.complex.has_reached_nonlocal() {
                self.queue.clear();
                break;
            }
            if !self.complex.is_alive(t) || self.sine_of(t) >= self.target_sine {
                continue;
            }
            // All that flips of it depend on is at its nodes.
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

    /// The tetrahedra at `node`: slots into `star`, the other three nodes' positions into `spokes`.
    fn gather_star(&mut self, node: u32) {
        self.complex.star(node, &mut self.star);
        let mut spokes = std::mem::take(&mut self.link);
        self.collect_link(node, &self.star, &mut spokes);
        self.link = spokes;
    }

    /// Positions of the other three nodes of each of the tetrahedra at `node`.
    fn collect_link(&self, node: u32, star: &[u32], spokes: &mut smooth::NodeLink) {
        spokes.clear();
        for &t in star {
            let tet = self.complex.tets[t as usize];
            let k = self.complex.local_index(t, node);
            // (face k, k) is positive; (k, face k) is the odd permutation: swap two.
            let [u, v, w] = FACES[k].map(|i| self.complex.nodes[tet[i] as usize]);
            spokes.push([u, w, v]);
        }
    }

    /// Smooths one node; true if it moved.
    fn smooth(&mut self, node: u32) -> bool {
        let mut hold = self.constraints[node as usize];
        if hold.fixed_axes == 7
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
            &mut hold,
            self.extent,
            self.planes,
            self.max_deviation,
            self.smoothing_target,
            &mut self.smooth_scratch,
        );
        let Some((x, _)) = best else {
            self.attempts.record_failure(AttemptKind::Smooth, node);
            return false;
        };
        self.move_to(node, x, hold);
        true
    }

    /// Moves a node whose star has been gathered.
    fn move_to(&mut self, node: u32, x: [f64; 3], hold: NodeConstraint) {
        let i = node as usize;
        if let Some(undo) = &mut self.undo {
            undo.nodes
                .push((node, self.complex.nodes[i], self.constraints[i]));
        }
        self.complex.nodes[i] = x;
        self.constraints[i] = hold;
        if !hold.is_far {
            self.moved_nodes.push(node);
        }
        self.measure_star();
    }

    /// Measures the tetrahedra gathered, which have changed.
    fn measure_star(&mut self) {
        let tets = &self.complex.tets;
        let around = self.star.iter().flat_map(|&t| tets[t as usize]);
        self.attempts.record_change(around);
        for i in 0..self.star.len() {
            self.measure(self.star[i]);
        }
    }

    /// Whether nodes are where this looks.
    #[inline]
    fn is_in_range(&self, nodes: &[u32]) -> bool {
        self.axis_range.is_none_or(|(axis, [from, to])| {
            let mut along = nodes.iter().map(|&n| self.complex.nodes[n as usize][axis]);
            along.all(|x| from <= x && x <= to)
        })
    }

    /// Slots of the tetrahedra below target.
    fn tets_below_target(&self) -> Vec<u32> {
        let tasks = self.sines.par_chunks(TASK_SIZE).enumerate();
        let poor_in = |(task, sines): (usize, &[f32])| {
            let mut poor = Vec::new();
            for (block, sines) in sines.chunks(BLOCK_SIZE).enumerate() {
                // Most blocks have none. A dead slot's sine is infinite.
                let any = |any, &sine: &f32| any | (f64::from(sine) < self.target_sine);
                if sines.iter().fold(false, any) {
                    let first = (task * TASK_SIZE + block * BLOCK_SIZE) as u32;
                    let slots = first..first + sines.len() as u32;
                    let poor_here = |t: &u32| {
                        self.sine_of(*t) < self.target_sine
                            && self.is_in_range(&self.complex.tets[*t as usize])
                    };
                    poor.extend(slots.filter(poor_here));
                }
            }
            poor
        };
        tasks.flat_map_iter(poor_in).collect()
    }
}

impl TetImprover<'_> {
    /// All steps, in order.
    ///
    /// # Errors
    /// Those of other ranks, with which the work is shared.
    fn improve(&mut self, patience: &CancelToken<'_>) -> Result<ImproveReport> {
        let poor_before = self.tets_below_target().len();
        patience.set_range(0.0, RECOVERY_WORK_SHARE);
        self.recover(patience)?;
        let turn = (1.0 - RECOVERY_WORK_SHARE) / (1 + MAX_DEVIATIONS.len()) as f64;
        let part = |turns: usize| {
            let done = RECOVERY_WORK_SHARE + turns as f64 * turn;
            patience.set_range(done, done + turn);
        };
        part(0);
        self.flip_and_smooth(MAX_ROUNDS[0], patience)?;
        // Where features leave the lattice no room, more are poor than can be mended one by one: sooner than that, nodes
        // may stray, which most need but little.
        if !self.has_too_many(self.tets_below_target().len()) {
            self.repair(patience)?;
        }
        for (number, stray) in MAX_DEVIATIONS.into_iter().enumerate() {
            part(1 + number);
            self.max_deviation = stray.min(MAX_DEVIATION_RATIO * self.distance.min());
            self.attempts.clear();
            self.flip_and_smooth(MAX_ROUNDS[1], patience)?;
            self.repair(patience)?;
        }
        self.release_nodes(patience)?;
        self.counts.intersecting_left = self.count_intersecting_edges(patience);
        let blocked = self.blocked_cells();
        Ok(ImproveReport {
            below_target_before: poor_before,
            below_target_after: blocked.len(),
            counts: self.counts,
            blocked,
        })
    }
}

#[cfg(test)]
mod tests;

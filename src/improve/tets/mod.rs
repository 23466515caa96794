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

mod collapse;
mod exude;
mod finish;
mod flips;
mod memory;
mod mend;
mod patches;
mod recover;
mod reshape;
mod slabs;
mod smooth;
mod sweep;

pub use exude::exude;
pub use reshape::reshape;
pub use slabs::{Aim, Cuts, InSlabs, KnownAtoms, improve_in_slabs, own_slabs};

use crate::parallel::prelude::*;

use self::memory::{Memory, Trial};
use super::hold::{Beside, Hold};
use super::pierce::piercing;
use super::sheets::{Sheet, Sheets};
use super::{Counts, Improved, Target};
use crate::Result;
use crate::geometry::sub;
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::mesh::complex::Complex;
use crate::mesh::quality::{BLOCK, Corners, min_sine};
use crate::mesh::{FACES, TetMesh};
use crate::observer::Patience;

/// The first round of smoothing, over many nodes, stops this far above target (sine).
const MARGIN: f64 = 0.02;

/// Where tetrahedra stay below target otherwise, their nodes may at last be so far (samples) off the
/// features that hold them. No feature is known better than to some tenths of a sample, while an angle
/// that lacks a degree needs little room.
const STRAYS: [f64; 2] = [0.25, 0.4];

/// And at most so far, over d.
const FARTHEST: f64 = 0.15;

/// The share of the work that is done once features are recovered, roughly.
const RECOVERED: f64 = 0.15;

/// Rounds of flips and smoothing, and where nodes may stray, as many then do little by little.
const ROUNDS: [usize; 2] = [8, 12];

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
    sheets: &Sheets,
    distance: &Distance<3>,
    target: &Target,
    patience: &Patience<'_>,
) -> Result<(Improved, Vec<u8>)> {
    let target = target.min_dihedral.to_radians().sin();
    let (taken, around) = (std::mem::take(mesh), std::mem::take(neighbors));
    let mut improver = Improver::new(
        taken, around, kinds, extent, sheets, distance, target, patience,
    );
    let outcome = improver.improve(patience)?;
    let finished = improver.finish(kinds);
    (*mesh, *neighbors, *kinds) = (finished.mesh, finished.neighbors, finished.kinds);
    Ok((outcome, finished.feature_faces))
}

/// Tetrahedra that are measured, or looked through, in one task.
const SINES: usize = 64 * BLOCK;

/// Where a node is, and what holds it there.
type Place = ([f64; 3], Hold);

/// State of an improvement: the complex, the quality of every slot, what holds every node.
struct Improver<'a> {
    complex: Complex,
    sines: Vec<f32>,
    holds: Vec<Hold>,
    /// What was beside the nodes at first; empty once any has moved.
    beside: Vec<Beside>,
    extent: [f64; 3],
    sheets: &'a Sheets,
    distance: &'a Distance<3>,
    /// Tetrahedra to look at.
    queue: Vec<u32>,
    target: f64,
    /// Smoothing a node stops at this sine.
    enough: f64,
    /// Smoothing may take nodes so far off the sheets that hold them.
    stray: f64,
    /// The mesh is this process's: other ranks are at work on others.
    alone: bool,
    /// What is looked at is between two places along an axis.
    between: Option<(usize, [f64; 2])>,
    counts: Counts,
    /// Edges that recovery left piercing a feature, and nodes near features that have moved or come
    /// since.
    unrecovered: Vec<(u32, u32)>,
    stirred: Vec<u32>,
    /// What a transaction under way has overwritten.
    undo: Option<mend::Undo>,
    memory: Memory,
    // Scratch.
    found: flips::Flip,
    fresh: Vec<[u32; 4]>,
    slots: Vec<u32>,
    touched: Vec<bool>,
    star: Vec<u32>,
    spokes: smooth::Star,
    smoothing: smooth::Scratch,
    scratches: sweep::Scratches,
    colors: Vec<u8>,
}

impl<'a> Improver<'a> {
    fn new(
        mesh: TetMesh,
        neighbors: Vec<[u32; 4]>,
        kinds: &[AtomKind],
        extent: [f64; 3],
        sheets: &'a Sheets,
        distance: &'a Distance<3>,
        target: f64,
        patience: &Patience<'_>,
    ) -> Self {
        let (holds, beside) = mesh
            .nodes
            .par_iter()
            .zip(kinds)
            .map(|(&x, &kind)| match patience.over() {
                true => (Hold::by_box(x, kind, extent), Beside::Nothing),
                false => Hold::new(x, kind, extent, sheets),
            })
            .unzip();
        let mut sines = vec![0.0f32; mesh.tets.len()];
        sines
            .par_chunks_mut(SINES)
            .zip(mesh.tets.par_chunks(SINES))
            .for_each(|(sines, tets)| {
                let (mut corners, mut block) = (Corners::default(), [0.0; BLOCK]);
                for (sines, tets) in sines.chunks_mut(BLOCK).zip(tets.chunks(BLOCK)) {
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
            holds,
            beside,
            ..Self::empty(extent, sheets, distance, target)
        }
    }

    /// Of no mesh.
    fn empty(extent: [f64; 3], sheets: &'a Sheets, distance: &'a Distance<3>, target: f64) -> Self {
        Self {
            complex: Complex::default(),
            sines: Vec::new(),
            holds: Vec::new(),
            beside: Vec::new(),
            extent,
            sheets,
            distance,
            queue: Vec::new(),
            target,
            enough: 1.0,
            stray: 0.0,
            alone: false,
            between: None,
            counts: Counts::default(),
            unrecovered: Vec::new(),
            stirred: Vec::new(),
            undo: None,
            memory: Memory::default(),
            found: flips::Flip::default(),
            fresh: Vec::new(),
            slots: Vec::new(),
            touched: Vec::new(),
            star: Vec::new(),
            spokes: smooth::Star::default(),
            smoothing: smooth::Scratch::default(),
            scratches: sweep::Scratches::default(),
            colors: Vec::new(),
        }
    }

    #[inline]
    fn sine_of(&self, t: u32) -> f64 {
        f64::from(self.sines[t as usize])
    }

    /// Whether an edge between two nodes would pass through a feature, or cut a corner of it.
    fn pierces(&self, a: u32, b: u32) -> bool {
        self.piercing(a, b).is_some()
    }

    /// A quick and safe test before [`piercing`](Self::piercing).
    fn may_pierce(&self, a: u32, b: u32) -> bool {
        let (i, j) = (a as usize, b as usize);
        let (p, q) = (&self.holds[i], &self.holds[j]);
        let (x, y) = (self.complex.nodes[i], self.complex.nodes[j]);
        let alone = [p.alone, q.alone];
        // A chord of a sheet may stray from it.
        let chord = alone == [true; 2];
        if !chord && let (Some(at_x), Some(at_y)) = (self.beside.get(i), self.beside.get(j)) {
            // What passes the middle of the edge is beside one of its ends.
            if at_x.on_one_side(*at_y, sub(y, x), alone) {
                return false;
            }
        }
        !(p.far && q.far) && self.sheets.may_pierce(x, y, alone)
    }

    fn piercing(&self, a: u32, b: u32) -> Option<([f64; 3], Sheet)> {
        let (i, j) = (a as usize, b as usize);
        piercing(
            self.sheets,
            [&self.holds[i], &self.holds[j]],
            [self.complex.nodes[i], self.complex.nodes[j]],
        )
    }

    /// Exchanges `old` for the tetrahedra in `fresh`, and queues those below target.
    fn commit(&mut self, old: &[u32]) {
        if self.complex.has_left() {
            // Something is missing here; all will be taken back.
            return;
        }
        if let Some(undo) = &mut self.undo {
            // Slots that die must count among what was there before.
            undo.touch(old, &self.sines);
        }
        let Self { complex, fresh, .. } = self;
        let before = old.iter().flat_map(|&t| complex.tets[t as usize]);
        self.memory
            .change(before.chain(fresh.iter().flatten().copied()));
        self.complex.exchange(old, &self.fresh, &mut self.slots);
        for &t in &old[self.fresh.len().min(old.len())..] {
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
            undo.touch(&[t], &self.sines);
        }
        self.sines[t as usize] = sine;
        if f64::from(sine) < self.target {
            self.queue.push(t);
        }
    }

    /// Works through the queue with flips.
    fn flip_queue(&mut self, patience: &Patience<'_>) {
        while let Some(t) = self.queue.pop() {
            if patience.over() || self.complex.has_left() {
                self.queue.clear();
                break;
            }
            if !self.complex.alive(t) || self.sine_of(t) >= self.target {
                continue;
            }
            // All that flips of it depend on is at its nodes.
            let tet = self.complex.tets[t as usize];
            if self.memory.in_vain(Trial::Flip, t, &tet) {
                continue;
            }
            if self.flip(t) {
                self.counts.flips += 1;
            } else {
                self.memory.failed(Trial::Flip, t);
            }
        }
    }

    /// The tetrahedra at `node`: slots into `star`, the other three nodes' positions into `spokes`.
    fn gather(&mut self, node: u32) {
        self.complex.star(node, &mut self.star);
        let mut spokes = std::mem::take(&mut self.spokes);
        self.spokes(node, &self.star, &mut spokes);
        self.spokes = spokes;
    }

    /// Positions of the other three nodes of each of the tetrahedra at `node`.
    fn spokes(&self, node: u32, star: &[u32], spokes: &mut smooth::Star) {
        spokes.clear();
        for &t in star {
            let tet = self.complex.tets[t as usize];
            let k = self.complex.local(t, node);
            // (face k, k) is positive; (k, face k) is the odd permutation: swap two.
            let [u, v, w] = FACES[k].map(|i| self.complex.nodes[tet[i] as usize]);
            spokes.push([u, w, v]);
        }
    }

    /// Smooths one node; true if it moved.
    fn smooth(&mut self, node: u32) -> bool {
        let mut hold = self.holds[node as usize];
        if hold.axes == 7 || self.memory.in_vain(Trial::Smooth, node, &[node]) {
            return false;
        }
        self.gather(node);
        let best = smooth::best_position(
            self.complex.nodes[node as usize],
            &self.spokes,
            &mut hold,
            self.extent,
            self.sheets,
            self.stray,
            self.enough,
            &mut self.smoothing,
        );
        let Some((x, _)) = best else {
            self.memory.failed(Trial::Smooth, node);
            return false;
        };
        self.move_to(node, x, hold);
        true
    }

    /// Moves a node whose star has been gathered.
    fn move_to(&mut self, node: u32, x: [f64; 3], hold: Hold) {
        let i = node as usize;
        if let Some(undo) = &mut self.undo {
            undo.nodes
                .push((node, self.complex.nodes[i], self.holds[i]));
        }
        self.complex.nodes[i] = x;
        self.holds[i] = hold;
        if !hold.far {
            self.stirred.push(node);
        }
        self.measure_star();
    }

    /// Measures the tetrahedra gathered, which have changed.
    fn measure_star(&mut self) {
        let tets = &self.complex.tets;
        let around = self.star.iter().flat_map(|&t| tets[t as usize]);
        self.memory.change(around);
        for i in 0..self.star.len() {
            self.measure(self.star[i]);
        }
    }

    /// Whether nodes are where this looks.
    #[inline]
    fn looks_at(&self, nodes: &[u32]) -> bool {
        self.between.is_none_or(|(axis, [from, to])| {
            let mut along = nodes.iter().map(|&n| self.complex.nodes[n as usize][axis]);
            along.all(|x| from <= x && x <= to)
        })
    }

    /// Slots of the tetrahedra below target.
    fn poor(&self) -> Vec<u32> {
        let tasks = self.sines.par_chunks(SINES).enumerate();
        let poor_in = |(task, sines): (usize, &[f32])| {
            let mut poor = Vec::new();
            for (block, sines) in sines.chunks(BLOCK).enumerate() {
                // Most blocks have none. A dead slot's sine is infinite.
                let any = |any, &sine: &f32| any | (f64::from(sine) < self.target);
                if sines.iter().fold(false, any) {
                    let first = (task * SINES + block * BLOCK) as u32;
                    let slots = first..first + sines.len() as u32;
                    let poor_here = |t: &u32| {
                        self.sine_of(*t) < self.target
                            && self.looks_at(&self.complex.tets[*t as usize])
                    };
                    poor.extend(slots.filter(poor_here));
                }
            }
            poor
        };
        tasks.flat_map_iter(poor_in).collect()
    }
}

impl Improver<'_> {
    /// All steps, in order.
    ///
    /// # Errors
    /// Those of other ranks, with which the work is shared.
    fn improve(&mut self, patience: &Patience<'_>) -> Result<Improved> {
        let poor_before = self.poor().len();
        patience.part(0.0, RECOVERED);
        self.recover(patience)?;
        let turn = (1.0 - RECOVERED) / (1 + STRAYS.len()) as f64;
        let part = |turns: usize| {
            let done = RECOVERED + turns as f64 * turn;
            patience.part(done, done + turn);
        };
        part(0);
        self.polish(ROUNDS[0], patience)?;
        // Where features leave the lattice no room, more are poor than can be mended one by one: sooner than that, nodes
        // may stray, which most need but little.
        if !self.too_many(self.poor().len()) {
            self.mend(patience)?;
        }
        for (number, stray) in STRAYS.into_iter().enumerate() {
            part(1 + number);
            self.stray = stray.min(FARTHEST * self.distance.min());
            self.memory.forget();
            self.polish(ROUNDS[1], patience)?;
            self.mend(patience)?;
        }
        self.release(patience)?;
        self.counts.pierced_left = self.count_pierced(patience);
        let blocked = self.blocked();
        Ok(Improved {
            poor_before,
            poor_after: blocked.len(),
            counts: self.counts,
            blocked,
        })
    }
}

#[cfg(test)]
mod tests;

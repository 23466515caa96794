//! From a Delaunay mesh of an optimised lattice to one without slivers whose faces lie on the
//! features.
//!
//! - [`sheets`]: the features as local planes
//! - [`hold`]: what holds a node (box sides, features)
//! - `mend`: several changes at once, kept only if together they help
//! - `recover`: features first: no edge may pierce a feature
//! - `apart`: atoms pulled to one place go back
//! - `collapse`: nodes that stand too close
//! - `flips`: Joe's local transformations, generalised
//! - `smooth`: max-min smoothing
//! - [`exude`](mod@exude): the second method: nodes get weights, none of them moves
//! - [`reshape`](mod@reshape): atoms come, go and move in a part of a mesh
//! - [`plane`]: the same for triangles in the plane
//!
//! The invariant that keeps the features: *no edge passes through a sheet*. Then every tetrahedron
//! lies on one side of it or has its nodes on it, so the sheet is a union of mesh faces, whatever
//! flips exchange them. It is established once (`recover`) and every later change keeps it.

pub mod exude;
pub mod hold;
pub mod plane;
pub mod reshape;
pub mod sheets;

mod apart;
mod collapse;
mod flips;
mod mend;
mod recover;
mod smooth;

use crate::geometry::{cross, dot, norm, sub};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::mesh::complex::{Complex, Ring};
use crate::mesh::quality::{BLOCK, Corners, min_sine};
use crate::mesh::{FACES, TetMesh};
use crate::observer::Patience;
use hold::{Beside, Hold};
use rayon::prelude::*;
use serde::Serialize;
use sheets::{SAME_SHEET, Sheets};

/// How often each kind of change was made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Local transformations.
    pub flips: usize,
    /// Nodes moved by smoothing.
    pub moves: usize,
    /// Edges that pierced a feature before anything was changed.
    pub pierced_before: usize,
    /// Edges that pierced a feature and went by a flip.
    pub pierced_flipped: usize,
    /// Nodes pulled onto the feature that one of their edges pierced.
    pub pierced_snapped: usize,
    /// Edges that pierced a feature and were split on it.
    pub pierced_split: usize,
    /// Edges that still pierce a feature.
    pub pierced_left: usize,
    /// Edges collapsed.
    pub collapses: usize,
    /// Nodes inserted to mend bad tetrahedra.
    pub insertions: usize,
    /// Times that nodes were let go of a feature because a tetrahedron was of no use otherwise.
    pub released: usize,
}

/// Tetrahedra that are first measured in one task.
const SINES: usize = 64 * BLOCK;

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
    counts: Counts,
    /// Edges that recovery left piercing a feature, and nodes near features that have moved or come
    /// since.
    unrecovered: Vec<(u32, u32)>,
    stirred: Vec<u32>,
    /// What a transaction under way has overwritten.
    undo: Option<mend::Undo>,
    // Scratch.
    ring: Ring,
    fresh: Vec<[u32; 4]>,
    slots: Vec<u32>,
    touched: Vec<bool>,
    star: Vec<u32>,
    spokes: smooth::Star,
    smoothing: smooth::Scratch,
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
    ) -> Self {
        let (holds, beside) = mesh
            .nodes
            .par_iter()
            .zip(kinds)
            .map(|(&x, &kind)| Hold::new(x, kind, extent, sheets))
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
            extent,
            sheets,
            distance,
            queue: Vec::new(),
            target,
            enough: 1.0,
            counts: Counts::default(),
            unrecovered: Vec::new(),
            stirred: Vec::new(),
            undo: None,
            ring: Ring::default(),
            fresh: Vec::new(),
            slots: Vec::new(),
            touched: Vec::new(),
            star: Vec::new(),
            spokes: smooth::Star::default(),
            smoothing: smooth::Scratch::default(),
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

    fn piercing(&self, a: u32, b: u32) -> Option<([f64; 3], sheets::Sheet)> {
        let (i, j) = (a as usize, b as usize);
        piercing(
            self.sheets,
            [&self.holds[i], &self.holds[j]],
            [self.complex.nodes[i], self.complex.nodes[j]],
        )
    }

    /// Exchanges `old` for the tetrahedra in `fresh`, and queues those below target.
    fn commit(&mut self, old: &[u32]) {
        if let Some(undo) = &mut self.undo {
            // Slots that die must count among what was there before.
            undo.touch(old, &self.sines);
        }
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
    fn flip_queue(&mut self, patience: &mut Patience<'_>) {
        while let Some(t) = self.queue.pop() {
            if patience.over() {
                self.queue.clear();
                break;
            }
            if self.complex.alive(t) && self.sine_of(t) < self.target && self.flip(t) {
                self.counts.flips += 1;
            }
        }
    }

    /// The tetrahedra at `node`: slots into `star`, the other three nodes' positions into `spokes`.
    fn gather(&mut self, node: u32) {
        self.complex.star(node, &mut self.star);
        self.spokes.clear();
        for &t in &self.star {
            let tet = self.complex.tets[t as usize];
            let k = self.complex.local(t, node);
            // (face k, k) is positive; (k, face k) is the odd permutation: swap two.
            let [u, v, w] = FACES[k].map(|i| self.complex.nodes[tet[i] as usize]);
            self.spokes.push([u, w, v]);
        }
    }

    /// Smooths one node; true if it moved.
    fn smooth(&mut self, node: u32) -> bool {
        let mut hold = self.holds[node as usize];
        if hold.axes == 7 {
            return false;
        }
        self.gather(node);
        let best = smooth::best_position(
            self.complex.nodes[node as usize],
            &self.spokes,
            &mut hold,
            self.extent,
            self.sheets,
            self.enough,
            &mut self.smoothing,
        );
        let Some((x, _)) = best else { return false };
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
        for i in 0..self.star.len() {
            self.measure(self.star[i]);
        }
    }

    /// Slots of the tetrahedra below target.
    fn poor(&self) -> Vec<u32> {
        let mut poor = Vec::new();
        for (block, sines) in self.sines.chunks(BLOCK).enumerate() {
            // Most blocks have none. A dead slot's sine is infinite.
            let any = |any, &sine: &f32| any | (f64::from(sine) < self.target);
            if sines.iter().fold(false, any) {
                let first = (block * BLOCK) as u32;
                let slots = first..first + sines.len() as u32;
                poor.extend(slots.filter(|&t| self.sine_of(t) < self.target));
            }
        }
        poor
    }

    /// Flips and smoothing in turn until neither helps any more.
    fn polish(&mut self, rounds: usize, patience: &mut Patience<'_>) {
        let mut before = usize::MAX;
        for round in 0..rounds {
            self.enough = if round == 0 {
                self.target + MARGIN
            } else {
                1.0
            };
            self.queue = self.poor();
            self.queue.reverse();
            self.flip_queue(patience);
            let mut nodes: Vec<u32> = self
                .poor()
                .iter()
                .flat_map(|&t| self.complex.tets[t as usize])
                .collect();
            nodes.sort_unstable();
            nodes.dedup();
            if nodes.is_empty() || nodes.len() >= before {
                break;
            }
            before = nodes.len();
            for node in nodes {
                if patience.over() {
                    return;
                }
                if self.smooth(node) {
                    self.counts.moves += 1;
                }
            }
            self.flip_queue(patience);
        }
    }
}

/// Where the edge between two nodes passes through a feature, or cuts a corner of it.
fn piercing(
    sheets: &Sheets,
    [p, q]: [&Hold; 2],
    [x, y]: [[f64; 3]; 2],
) -> Option<([f64; 3], sheets::Sheet)> {
    if p.far && q.far {
        return None;
    }
    // A chord of a sheet must not stray from it where the sheet is curved.
    if let Some(normal) = p.normals().find(|&n| q.on(n)) {
        let middle = std::array::from_fn(|k| 0.5 * (x[k] + y[k]));
        let near = sheets.near(middle);
        if let Some(sheet) = near
            .iter()
            .find(|s| s.offset.abs() > STRAY && dot(s.normal, normal).abs() > SAME_SHEET)
        {
            return Some((middle, *sheet));
        }
        // No other sheet is near the ends, nor between them.
        if p.alone && q.alone && near.iter().count() == 1 {
            return None;
        }
    }
    sheets.pierced(x, y, [p.alone, q.alone], |end, normal| {
        if end == 0 { p.on(normal) } else { q.on(normal) }
    })
}

/// The first round of smoothing, over many nodes, stops this far above target (sine).
const MARGIN: f64 = 0.02;

/// The centroid of a face on a sheet is at most this far off it.
const FACE_ON_SHEET: f64 = 0.75;

/// The middle of an edge between two nodes of a sheet may be off the sheet by this much.
const STRAY: f64 = 0.4;

/// Moves the atoms within `reach` of a feature onto it (onto all of them, where several cross),
/// never off the box's sides, and no two to one place. Returns how many were moved.
pub fn settle(
    positions: &mut [[f64; 3]],
    kinds: &[AtomKind],
    extent: [f64; 3],
    sheets: &Sheets,
    reach: f64,
) -> usize {
    let before = positions.to_vec();
    let moved: usize = positions
        .par_iter_mut()
        .zip(kinds)
        .map(|(x, &kind)| {
            if sheets.far(*x) || !sheets.close(*x) {
                return 0;
            }
            let mut hold = Hold::by_box(*x, kind, extent);
            let near = sheets.near(*x);
            for sheet in near.iter().filter(|s| s.offset.abs() < reach) {
                hold.add(sheet.normal);
            }
            // On both features if that can be reached, else on the nearer one.
            while hold.count > 0 {
                let mut trial = hold;
                if let Some(y) = trial.settle(*x, extent, sheets)
                    && norm(sub(y, *x)) < 1.5 * reach
                {
                    *x = y;
                    return 1;
                }
                hold.count -= 1;
            }
            0
        })
        .sum();
    // Two atoms pulled to one place would be one node.
    moved - apart::keep_apart(positions, &before, 0.1 * reach)
}

/// What to aim at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Every dihedral angle shall lie in [min_dihedral, 180 - min_dihedral] degrees.
    pub min_dihedral: f64,
    /// How, in space.
    pub method: Method,
}

/// How slivers are removed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Joe's local transformations and smoothing ([`improve`]).
    #[default]
    Joe,
    /// CGAL's exudation ([`exude`](exude::exude)).
    Exude,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            min_dihedral: 30.0,
            method: Method::Joe,
        }
    }
}

impl std::fmt::Display for Method {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Joe => "flips and smoothing",
            Self::Exude => "exudation",
        })
    }
}

/// A tetrahedron that stayed below target, and what blocks it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Blocked {
    /// Where: its centroid in lattice space.
    pub centroid: [f64; 3],
    /// Its smallest dihedral angle, in degrees.
    pub smallest: f64,
    /// Its largest dihedral angle, in degrees.
    pub largest: f64,
    /// Its nodes that lie in a side of the box.
    pub nodes_on_sides: usize,
    /// Its nodes that lie on a feature.
    pub nodes_on_features: usize,
    /// Its nodes that lie on several features at once.
    pub nodes_on_crossings: usize,
}

/// What [`improve`] did.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Outcome {
    /// Tetrahedra below target before and after.
    pub poor_before: usize,
    /// See `poor_before`.
    pub poor_after: usize,
    /// Changes made.
    pub counts: Counts,
    /// The tetrahedra that stayed below target, worst first.
    pub blocked: Vec<Blocked>,
}

/// Makes a Delaunay mesh follow the features and frees it of slivers, in place.
///
/// `neighbors` are those of the tetrahedra (see [`complex`](crate::mesh::complex)) and stay so.
/// `kinds` says what each node is and follows the nodes that come and go; the result also says
/// for every tetrahedron which of its faces lie on a feature: bit k for face k (opposite node k).
/// When `patience` is over, the mesh is left as far as it has come.
pub fn improve(
    mesh: &mut TetMesh,
    neighbors: &mut Vec<[u32; 4]>,
    kinds: &mut Vec<AtomKind>,
    extent: [f64; 3],
    sheets: &Sheets,
    distance: &Distance<3>,
    options: &Options,
    mut patience: Patience<'_>,
) -> (Outcome, Vec<u8>) {
    let target = options.min_dihedral.to_radians().sin();
    let (taken, around) = (std::mem::take(mesh), std::mem::take(neighbors));
    let mut improver = Improver::new(taken, around, kinds, extent, sheets, distance, target);
    let outcome = improver.improve(&mut patience);
    let finished = improver.finish(kinds);
    (*mesh, *neighbors, *kinds) = (finished.mesh, finished.neighbors, finished.kinds);
    (outcome, finished.feature_faces)
}

/// A mesh whose improvement is over.
struct Finished {
    mesh: TetMesh,
    neighbors: Vec<[u32; 4]>,
    kinds: Vec<AtomKind>,
    /// The number that each node had while the mesh was improved.
    kept: Vec<u32>,
    holds: Vec<Hold>,
    feature_faces: Vec<u8>,
}

impl Improver<'_> {
    /// All steps, in order.
    fn improve(&mut self, patience: &mut Patience<'_>) -> Outcome {
        let poor_before = self.poor().len();
        self.recover(patience);
        self.polish(8, patience);
        self.mend(patience);
        self.release(patience);
        self.counts.pierced_left = self.count_pierced();
        let blocked = self.blocked();
        Outcome {
            poor_before,
            poor_after: blocked.len(),
            counts: self.counts,
            blocked,
        }
    }

    /// The mesh, and what is known of its nodes and faces; `kinds` are those of the first nodes.
    fn finish(self, kinds: &[AtomKind]) -> Finished {
        let Self {
            complex,
            holds,
            sheets,
            ..
        } = self;
        let (mesh, neighbors, kept) = complex.into_mesh();
        let kinds = kept
            .iter()
            .map(|&i| match kinds.get(i as usize) {
                Some(&kind) => kind,
                None => match holds[i as usize].axes.count_ones() {
                    0 => AtomKind::Interior,
                    1 => AtomKind::Side,
                    2 => AtomKind::Edge,
                    _ => AtomKind::Corner,
                },
            })
            .collect();
        let holds: Vec<Hold> = kept.iter().map(|&i| holds[i as usize]).collect();
        Finished {
            feature_faces: faces_on_sheets(&mesh, &holds, sheets),
            mesh,
            neighbors,
            kinds,
            kept,
            holds,
        }
    }

    /// Whether nodes lie in one side of the box.
    fn in_side(&self, nodes: &[u32]) -> bool {
        self.common_sides(nodes) != 0
    }

    /// The sides in which all of the nodes lie: bit k for those normal to axis k.
    fn common_sides(&self, nodes: &[u32]) -> u8 {
        let within = |&k: &usize| {
            let mut at = nodes.iter().map(|&n| self.complex.nodes[n as usize][k]);
            let first = at.next().unwrap_or(f64::NAN);
            (first == 0.0 || first == self.extent[k]) && at.all(|x| x == first)
        };
        (0..3).filter(within).fold(0, |bits, k| bits | 1 << k)
    }
}

/// For every tetrahedron which of its faces lie on a feature: bit k for face k (opposite node k).
fn faces_on_sheets(mesh: &TetMesh, holds: &[Hold], sheets: &Sheets) -> Vec<u8> {
    (0..mesh.tets.len())
        .into_par_iter()
        .map(|t| faces_on_features(mesh, t, holds, sheets))
        .collect()
}

/// Which faces of tetrahedron `t` lie on a feature: their nodes are held by one sheet, they lie along
/// it, and their centroid is on it too.
fn faces_on_features(mesh: &TetMesh, t: usize, holds: &[Hold], sheets: &Sheets) -> u8 {
    let tet = mesh.tets[t];
    if tet.iter().filter(|&&n| holds[n as usize].count > 0).count() < 3 {
        return 0;
    }
    let on_feature = |k: usize| {
        let [a, b, c] = FACES[k].map(|i| tet[i] as usize);
        let [x, y, z] = [a, b, c].map(|n| mesh.nodes[n]);
        let normal = cross(sub(y, x), sub(z, x));
        let length = norm(normal);
        let along = |n: [f64; 3]| dot(n, normal).abs() > SAME_SHEET * length;
        if !holds[a]
            .normals()
            .any(|n| along(n) && holds[b].on(n) && holds[c].on(n))
        {
            return false;
        }
        let centroid = std::array::from_fn(|i| (x[i] + y[i] + z[i]) / 3.0);
        let near = sheets.near(centroid);
        near.iter()
            .any(|s| s.offset.abs() < FACE_ON_SHEET && along(s.normal))
    };
    (0..4)
        .filter(|&k| on_feature(k))
        .fold(0, |bits, k| bits | 1 << k)
}

impl Improver<'_> {
    fn blocked(&self) -> Vec<Blocked> {
        let mut poor = self.poor();
        poor.sort_by(|a, b| self.sine_of(*a).total_cmp(&self.sine_of(*b)).then(a.cmp(b)));
        let Complex { nodes, tets, .. } = &self.complex;
        blocked(nodes, tets, &self.holds, &poor)
    }
}

/// What blocks the tetrahedra `poor`, in that order.
fn blocked(nodes: &[[f64; 3]], tets: &[[u32; 4]], holds: &[Hold], poor: &[u32]) -> Vec<Blocked> {
    poor.iter()
        .map(|&t| {
            let tet = tets[t as usize];
            let p = tet.map(|n| nodes[n as usize]);
            let angles = crate::mesh::quality::dihedral_angles(&p);
            let holds = tet.map(|n| holds[n as usize]);
            let count = |f: &dyn Fn(&Hold) -> bool| holds.iter().filter(|h| f(h)).count();
            Blocked {
                centroid: std::array::from_fn(|k| p.iter().map(|x| x[k]).sum::<f64>() / 4.0),
                smallest: angles.iter().copied().fold(f64::INFINITY, f64::min),
                largest: angles.iter().copied().fold(0.0, f64::max),
                nodes_on_sides: count(&|h| h.axes != 0),
                nodes_on_features: count(&|h| h.count > 0),
                nodes_on_crossings: count(&|h| h.count > 1),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests;

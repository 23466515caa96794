//! From a Delaunay triangulation of atoms in the plane to one whose edges lie on the features and
//! whose angles are all large enough.
//!
//! The same rules as in space, and the same code for what holds a node and where the features are:
//! the plane is z = 0, and a curve is a sheet that stands upright on it. Instead of tetrahedra and
//! their many local transformations there are triangles and one flip, so all is simpler:
//!
//! 1. no edge may pass through a curve: such an edge is flipped away, or one of its ends is pulled
//!    onto the curve, or it is split there;
//! 2. other edges are flipped, nodes smoothed (those on a curve along it only), and, where that is
//!    not enough, short edges collapsed and long ones split, whatever raises the smallest angle;
//! 3. where a triangle would be of no use otherwise, its nodes may leave their curves.
//!
//! An angle of at least 30 degrees everywhere means none above 120.

mod edges;
mod recover;
pub mod relax;
mod reshape;
mod smooth;

pub use reshape::reshape;

use super::hold::Hold;
use super::mend::UNUSABLE;
use super::sheets::{SAME_SHEET, Sheets};
use super::{Blocked, Counts, FACE_ON_SHEET, Outcome, piercing};
use crate::error::{Error, Result, cause};
use crate::geometry::{add_scaled, dot, norm, sub};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::Atoms;
use crate::mesh::TriMesh;
use crate::mesh::complex::NONE;
use crate::mesh::tri::{SIDES, angles, neighbors, worst_cotangent};
use crate::observer::Patience;

/// A point of the plane as a point of space.
pub fn lift([x, y]: [f64; 2]) -> [f64; 3] {
    [x, y, 0.0]
}

/// Moves the atoms within `reach` of a curve onto it, as [`improve::settle`](super::settle).
pub fn settle(
    positions: &mut [[f64; 2]],
    kinds: &[AtomKind],
    extent: [f64; 2],
    sheets: &Sheets,
    reach: f64,
) -> usize {
    let mut lifted: Vec<[f64; 3]> = positions.iter().map(|&x| lift(x)).collect();
    let moved = super::settle(&mut lifted, kinds, lift(extent), sheets, reach);
    for (x, [u, v, _]) in positions.iter_mut().zip(lifted) {
        *x = [u, v];
    }
    moved
}

/// Which coordinates of each atom may change where what lies on a feature shall stay: 1 for free, 0 for
/// held. Atoms on the sides of the box keep to them.
pub fn mobility(atoms: &Atoms<2>, extent: [f64; 2], sheets: &Sheets) -> Vec<[f64; 2]> {
    let mut mobility = atoms.mobility(extent);
    for ((free, &x), &kind) in mobility.iter_mut().zip(&atoms.positions).zip(&atoms.kinds) {
        if Hold::new(lift(x), kind, lift(extent), sheets).0.count > 0 {
            *free = [0.0; 2];
        }
    }
    mobility
}

/// Makes a Delaunay mesh follow the features and raises its smallest angles to `min_angle` degrees
/// where that can be, in place.
///
/// `kinds` says what each node is and follows the nodes that come and go; the result also says
/// for every triangle which of its edges lie on a feature: bit k for edge k (opposite node k). When
/// `patience` is over, the mesh is left as far as it has come.
///
/// # Errors
/// [`Error::Mesh`] if triangles overlap or more than two share an edge; nothing is changed then.
pub fn improve(
    mesh: &mut TriMesh,
    kinds: &mut Vec<AtomKind>,
    extent: [f64; 2],
    sheets: &Sheets,
    distance: &Distance<2>,
    min_angle: f64,
    mut patience: Patience<'_>,
) -> Result<(Outcome, Vec<u8>)> {
    let neighbors = adjacency(mesh)?;
    let taken = std::mem::take(mesh);
    let mut improver = Improver::new(taken, neighbors, kinds, extent, sheets, distance, min_angle);
    let outcome = improver.improve(&mut patience);
    let finished = improver.finish();
    (*mesh, *kinds) = (finished.mesh, finished.kinds);
    Ok((outcome, finished.feature_faces))
}

/// Neighbours of every triangle.
fn adjacency(mesh: &TriMesh) -> Result<Vec<[u32; 3]>> {
    neighbors(mesh.nodes.len(), &mesh.triangles).map_err(|edge| {
        Error::Mesh(cause(
            format!("edge {edge:?}"),
            "belongs to more than two triangles, or to two that overlap",
            "mesh the image again",
        ))
    })
}

/// A mesh whose improvement is over.
struct Finished {
    mesh: TriMesh,
    kinds: Vec<AtomKind>,
    /// The number that each node had while the mesh was improved.
    kept: Vec<u32>,
    feature_faces: Vec<u8>,
}

struct Improver<'a> {
    nodes: Vec<[f64; 2]>,
    /// Node numbers; `NONE` first where the triangle is gone.
    triangles: Vec<[u32; 3]>,
    neighbors: Vec<[u32; 3]>,
    triangle_of: Vec<u32>,
    holds: Vec<Hold>,
    kinds: Vec<AtomKind>,
    extent: [f64; 2],
    sheets: &'a Sheets,
    distance: &'a Distance<2>,
    /// Largest cotangent that an angle shall have.
    target: f64,
    /// Smoothing stops at this one, a little smaller.
    enough: f64,
    counts: Counts,
    /// Edges to look at, as (triangle, side).
    queue: Vec<(u32, u8)>,
    /// Triangles around a node.
    star: Vec<u32>,
}

impl<'a> Improver<'a> {
    fn new(
        mesh: TriMesh,
        neighbors: Vec<[u32; 3]>,
        kinds: &[AtomKind],
        extent: [f64; 2],
        sheets: &'a Sheets,
        distance: &'a Distance<2>,
        min_angle: f64,
    ) -> Self {
        let cotangent = |degrees: f64| 1.0 / degrees.to_radians().tan();
        let TriMesh { nodes, triangles } = mesh;
        let holds = nodes
            .iter()
            .zip(kinds)
            .map(|(&x, &kind)| Hold::new(lift(x), kind, lift(extent), sheets).0)
            .collect();
        let mut triangle_of = vec![NONE; nodes.len()];
        for (t, triangle) in triangles.iter().enumerate() {
            for &n in triangle {
                triangle_of[n as usize] = t as u32;
            }
        }
        Self {
            neighbors,
            nodes,
            triangles,
            triangle_of,
            holds,
            kinds: kinds.to_vec(),
            extent,
            sheets,
            distance,
            target: cotangent(min_angle),
            enough: cotangent((min_angle + MARGIN).min(59.0)),
            counts: Counts::default(),
            queue: Vec::new(),
            star: Vec::new(),
        }
    }

    /// All steps, in order.
    fn improve(&mut self, patience: &mut Patience<'_>) -> Outcome {
        let poor_before = self.poor().len();
        self.recover();
        self.polish(patience);
        self.release(patience);
        let blocked = self.blocked();
        Outcome {
            poor_before,
            poor_after: blocked.len(),
            counts: self.counts,
            blocked,
        }
    }

    /// The compact mesh, and which edges of it lie on features.
    fn finish(self) -> Finished {
        let on_feature = |t: u32| {
            let on = |k: &usize| {
                let [a, b] = SIDES[*k].map(|i| self.triangles[t as usize][i]);
                self.on_feature(a, b)
            };
            (0..3).filter(on).fold(0, |bits, k| bits | 1 << k)
        };
        let feature_faces = self.alive().map(on_feature).collect();
        let mut used = vec![false; self.nodes.len()];
        for t in self.alive() {
            for n in self.triangles[t as usize] {
                used[n as usize] = true;
            }
        }
        let kept: Vec<u32> = (0..used.len() as u32)
            .filter(|&n| used[n as usize])
            .collect();
        let mut number = vec![NONE; self.nodes.len()];
        for (new, &n) in kept.iter().enumerate() {
            number[n as usize] = new as u32;
        }
        let triangles = self
            .alive()
            .map(|t| self.triangles[t as usize].map(|n| number[n as usize]))
            .collect();
        Finished {
            mesh: TriMesh {
                nodes: kept.iter().map(|&n| self.nodes[n as usize]).collect(),
                triangles,
            },
            kinds: kept.iter().map(|&n| self.kinds[n as usize]).collect(),
            kept,
            feature_faces,
        }
    }

    fn alive(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.triangles.len() as u32).filter(|&t| self.triangles[t as usize][0] != NONE)
    }

    fn corners(&self, triangle: [u32; 3]) -> [[f64; 2]; 3] {
        triangle.map(|n| self.nodes[n as usize])
    }

    /// The cotangent of a triangle's smallest angle; infinite if it is not positive.
    fn cotangent(&self, triangle: [u32; 3]) -> f64 {
        worst_cotangent(&self.corners(triangle))
    }

    /// Triangles below target, worst first.
    fn poor(&self) -> Vec<u32> {
        self.above(self.target)
    }

    /// Triangles with a cotangent above a limit, worst first.
    fn above(&self, limit: f64) -> Vec<u32> {
        let value = |t: u32| self.cotangent(self.triangles[t as usize]);
        let mut poor: Vec<(f64, u32)> = self
            .alive()
            .map(|t| (value(t), t))
            .filter(|(value, _)| *value > limit)
            .collect();
        poor.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        poor.into_iter().map(|(_, t)| t).collect()
    }

    /// Where the edge between two nodes passes through a curve.
    fn pierced(&self, a: u32, b: u32) -> Option<[f64; 2]> {
        let ends = [a as usize, b as usize];
        let holds = ends.map(|n| &self.holds[n]);
        let positions = ends.map(|n| lift(self.nodes[n]));
        piercing(self.sheets, holds, positions).map(|([x, y, _], _)| [x, y])
    }

    /// Whether an edge lies on a feature: one curve holds both ends, the edge runs along it, and its
    /// middle is on it too.
    fn on_feature(&self, a: u32, b: u32) -> bool {
        let (p, q) = (&self.holds[a as usize], &self.holds[b as usize]);
        if p.count == 0 || q.count == 0 {
            return false;
        }
        let (x, y) = (lift(self.nodes[a as usize]), lift(self.nodes[b as usize]));
        let edge = sub(y, x);
        // The sine of the angle that SAME_SHEET is the cosine of.
        let across = (1.0 - SAME_SHEET * SAME_SHEET).sqrt() * norm(edge);
        let along = |n: [f64; 3]| dot(n, edge).abs() < across;
        if !p.normals().any(|n| along(n) && q.on(n)) {
            return false;
        }
        let near = self.sheets.near(add_scaled(x, 0.5, edge));
        near.iter()
            .any(|s| s.offset.abs() < FACE_ON_SHEET && along(s.normal))
    }

    /// The sides of the box in which an edge lies: bit k for those normal to axis k.
    fn sides_of(&self, a: u32, b: u32) -> u8 {
        let (x, y) = (self.nodes[a as usize], self.nodes[b as usize]);
        let within = |&k: &usize| x[k] == y[k] && (x[k] == 0.0 || x[k] == self.extent[k]);
        (0..2).filter(within).fold(0, |bits, k| bits | 1 << k)
    }

    /// Flips side `k` of `t` if that raises the smallest angle and no feature is lost.
    fn try_flip(&mut self, t: u32, k: usize) -> bool {
        let Some([p, q]) = self.flipped(t, k) else {
            return false;
        };
        let [a, b] = [p[1], q[2]];
        let (c, d) = (p[0], p[2]);
        let other = [d, b, a];
        let now = self
            .cotangent(self.triangles[t as usize])
            .max(self.cotangent(other));
        let then = self.cotangent(p).max(self.cotangent(q));
        if then >= now - 1e-9 || self.on_feature(a, b) || self.pierced(c, d).is_some() {
            return false;
        }
        self.flip(t, k);
        true
    }

    /// Flips edges until none raises the smallest angle about it.
    fn flip_all(&mut self, patience: &mut Patience<'_>) {
        self.queue.clear();
        let all: Vec<u32> = self.alive().collect();
        self.queue
            .extend(all.iter().flat_map(|&t| [(t, 0), (t, 1), (t, 2)]));
        self.flip_queue(patience);
    }

    fn flip_queue(&mut self, patience: &mut Patience<'_>) {
        while let Some((t, k)) = self.queue.pop() {
            if patience.over() {
                self.queue.clear();
                break;
            }
            if self.triangles[t as usize][0] != NONE {
                self.try_flip(t, usize::from(k));
            }
        }
    }

    /// Flips and smooths, and collapses or splits edges where that is not enough.
    fn polish(&mut self, patience: &mut Patience<'_>) {
        self.flip_all(patience);
        for round in 0..ROUNDS {
            if self.poor().is_empty() {
                return;
            }
            let mut nodes: Vec<u32> = self
                .above(self.enough)
                .iter()
                .flat_map(|&t| self.triangles[t as usize])
                .collect();
            if round % 2 == 1 {
                // Room is made by their neighbours, too.
                for node in nodes.clone() {
                    self.gather(node);
                    let around = self.star.iter().flat_map(|&t| self.triangles[t as usize]);
                    nodes.extend(around);
                }
            }
            nodes.sort_unstable();
            nodes.dedup();
            for node in nodes {
                if patience.over() {
                    return;
                }
                if self.smooth(node) {
                    self.counts.moves += 1;
                }
            }
            self.flip_queue(patience);
            if round % 3 == 2 {
                for t in self.poor() {
                    if self.triangles[t as usize][0] != NONE {
                        self.mend(t);
                    }
                }
                self.flip_queue(patience);
            }
        }
    }

    /// Lets nodes leave their curves where a triangle would otherwise stay unusable: one node if that
    /// is enough, else all three.
    fn release(&mut self, patience: &mut Patience<'_>) {
        let usable = 1.0 / UNUSABLE.to_radians().tan();
        for round in 0..4 {
            let bad = self.above(usable);
            if bad.is_empty() {
                return;
            }
            for t in bad {
                let triangle = self.triangles[t as usize];
                if self.cotangent(triangle) <= usable {
                    continue;
                }
                let held: Vec<u32> = triangle
                    .into_iter()
                    .filter(|&n| self.holds[n as usize].count > 0)
                    .collect();
                let one = held.iter().any(|&n| self.let_go(n, usable));
                // Flips about the first ones may be enough for the others.
                if !one && round > 1 {
                    self.counts.released += held.len();
                    for n in held {
                        self.holds[n as usize].clear_sheets();
                    }
                }
            }
            self.flip_all(patience);
            self.polish(patience);
        }
    }

    /// Frees a node from the curves that hold it and smooths it; takes that back if an angle about it
    /// still has a cotangent above `usable`.
    fn let_go(&mut self, node: u32, usable: f64) -> bool {
        let i = node as usize;
        let (x, hold) = (self.nodes[i], self.holds[i]);
        self.holds[i].clear_sheets();
        self.smooth(node);
        self.gather(node);
        let around = self.star.iter().map(|&t| self.triangles[t as usize]);
        if around.map(|t| self.cotangent(t)).fold(0.0, f64::max) <= usable {
            self.counts.released += 1;
            return true;
        }
        (self.nodes[i], self.holds[i]) = (x, hold);
        false
    }

    /// Collapses the shortest edge of a poor triangle, or else splits its longest.
    fn mend(&mut self, t: u32) {
        let now = self.cotangent(self.triangles[t as usize]);
        if now <= self.target {
            return;
        }
        let lengths = SIDES.map(|[i, j]| {
            let [p, q] = [i, j].map(|i| self.nodes[self.triangles[t as usize][i] as usize]);
            (p[0] - q[0]).hypot(p[1] - q[1])
        });
        let by = |better: fn(f64, f64) -> bool| {
            (1..3).fold(0, |best, k| {
                if better(lengths[k], lengths[best]) {
                    k
                } else {
                    best
                }
            })
        };
        let (shortest, longest) = (by(|a, b| a < b), by(|a, b| a > b));
        let [a, b] = SIDES[shortest].map(|i| self.triangles[t as usize][i]);
        if self.collapse(a, b, now) || self.collapse(b, a, now) {
            self.counts.collapses += 1;
            return;
        }
        let [a, b] = SIDES[longest].map(|i| self.triangles[t as usize][i]);
        let [p, q] = [a, b].map(|n| self.nodes[n as usize]);
        let middle = [0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1])];
        if !self.on_feature(a, b) && self.split(t, longest, middle, Some(now)) {
            self.counts.insertions += 1;
        }
    }

    fn blocked(&self) -> Vec<Blocked> {
        self.poor()
            .iter()
            .map(|&t| {
                let triangle = self.triangles[t as usize];
                let p = self.corners(triangle);
                let angles = angles(&p);
                let holds = triangle.map(|n| self.holds[n as usize]);
                let count = |f: &dyn Fn(&Hold) -> bool| holds.iter().filter(|h| f(h)).count();
                let [x, y] = [0, 1].map(|k| p.iter().map(|x| x[k]).sum::<f64>() / 3.0);
                Blocked {
                    centroid: [x, y, 0.0],
                    smallest: angles.iter().copied().fold(f64::INFINITY, f64::min),
                    largest: angles.iter().copied().fold(0.0, f64::max),
                    nodes_on_sides: count(&|h| h.axes & 3 != 0),
                    nodes_on_features: count(&|h| h.count > 0),
                    nodes_on_crossings: count(&|h| h.count > 1),
                }
            })
            .collect()
    }
}

/// No change may leave an angle whose cotangent is above this (about 3 degrees).
const STEEPEST: f64 = 20.0;

/// Smoothing aims this many degrees above the target.
const MARGIN: f64 = 4.0;

/// Rounds of smoothing; every third also collapses and splits.
const ROUNDS: usize = 24;

#[cfg(test)]
mod tests;

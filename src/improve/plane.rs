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
//!    not enough, short edges collapsed and long ones split, whatever raises the smallest angle.
//!
//! An angle of at least 30 degrees everywhere means none above 120.

use super::hold::Hold;
use super::sheets::{SAME_SHEET, Sheets};
use super::{Blocked, Counts, FACE_ON_SHEET, Outcome, piercing};
use crate::distance::Distance;
use crate::mesh::complex::NONE;
use crate::mesh::tri::{SIDES, angles, neighbors, worst_cotangent};
use crate::mesh::{AtomKind, TriMesh, add_scaled, dot, norm, sub};

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

/// Makes a Delaunay mesh follow the features and raises its smallest angles to `min_angle` degrees
/// where that can be, in place.
///
/// `kinds` says what each node is and follows the nodes that come and go; the result also says
/// for every triangle which of its edges lie on a feature: bit k for edge k (opposite node k).
pub fn improve(
    mesh: &mut TriMesh,
    kinds: &mut Vec<AtomKind>,
    extent: [f64; 2],
    sheets: &Sheets,
    distance: &Distance<2>,
    min_angle: f64,
) -> (Outcome, Vec<u8>) {
    let mut improver = Improver::new(std::mem::take(mesh), kinds, extent, sheets, distance);
    let cotangent = |degrees: f64| 1.0 / degrees.to_radians().tan();
    improver.target = cotangent(min_angle);
    improver.enough = cotangent((min_angle + MARGIN).min(59.0));
    let poor_before = improver.poor().len();
    improver.recover();
    improver.polish();
    let (counts, blocked) = (improver.counts, improver.blocked());
    let outcome = Outcome {
        poor_before,
        poor_after: blocked.len(),
        counts,
        blocked,
    };
    let on_features = improver.finish(mesh, kinds);
    (outcome, on_features)
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
        kinds: &[AtomKind],
        extent: [f64; 2],
        sheets: &'a Sheets,
        distance: &'a Distance<2>,
    ) -> Self {
        let TriMesh { nodes, triangles } = mesh;
        let holds = nodes
            .iter()
            .zip(kinds)
            .map(|(&x, &kind)| Hold::new(lift(x), kind, lift(extent), sheets))
            .collect();
        let mut triangle_of = vec![NONE; nodes.len()];
        for (t, triangle) in triangles.iter().enumerate() {
            for &n in triangle {
                triangle_of[n as usize] = t as u32;
            }
        }
        Self {
            neighbors: neighbors(nodes.len(), &triangles).unwrap_or_default(),
            nodes,
            triangles,
            triangle_of,
            holds,
            kinds: kinds.to_vec(),
            extent,
            sheets,
            distance,
            target: f64::INFINITY,
            enough: f64::INFINITY,
            counts: Counts::default(),
            queue: Vec::new(),
            star: Vec::new(),
        }
    }

    /// The compact mesh, and which edges of it lie on features.
    fn finish(self, mesh: &mut TriMesh, kinds: &mut Vec<AtomKind>) -> Vec<u8> {
        let on_features = self
            .alive()
            .map(|t| {
                let on = |k: &usize| {
                    let [a, b] = SIDES[*k].map(|i| self.triangles[t as usize][i]);
                    self.on_feature(a, b)
                };
                (0..3).filter(on).fold(0, |bits, k| bits | 1 << k)
            })
            .collect();
        let mut used = vec![false; self.nodes.len()];
        for t in self.alive() {
            for n in self.triangles[t as usize] {
                used[n as usize] = true;
            }
        }
        let mut number = vec![NONE; self.nodes.len()];
        kinds.clear();
        mesh.nodes.clear();
        for n in (0..used.len()).filter(|&n| used[n]) {
            number[n] = mesh.nodes.len() as u32;
            mesh.nodes.push(self.nodes[n]);
            kinds.push(self.kinds[n]);
        }
        mesh.triangles = self
            .alive()
            .map(|t| self.triangles[t as usize].map(|n| number[n as usize]))
            .collect();
        on_features
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

    /// Whether an edge lies in a side of the box.
    fn on_side(&self, a: u32, b: u32) -> bool {
        self.holds[a as usize].axes & self.holds[b as usize].axes & 3 != 0
    }

    /// The triangle across side `k` of `t`, and the side of it that is shared.
    fn across(&self, t: u32, k: usize) -> Option<(u32, usize)> {
        let other = self.neighbors[t as usize][k];
        if other == NONE {
            return None;
        }
        let back = self.neighbors[other as usize].iter().position(|&n| n == t);
        back.map(|j| (other, j))
    }

    /// Writes a triangle with its neighbours and tells these.
    fn put(&mut self, t: u32, triangle: [u32; 3], around: [u32; 3]) {
        self.triangles[t as usize] = triangle;
        self.neighbors[t as usize] = around;
        for k in 0..3 {
            self.triangle_of[triangle[k] as usize] = t;
            let [a, b] = SIDES[k].map(|i| triangle[i]);
            self.tell(around[k], [b, a], t);
        }
    }

    /// Tells `other` that `t` is now across its edge (a, b).
    fn tell(&mut self, other: u32, [a, b]: [u32; 2], t: u32) {
        if other != NONE {
            let triangle = self.triangles[other as usize];
            for k in 0..3 {
                if SIDES[k].map(|i| triangle[i]) == [a, b] {
                    self.neighbors[other as usize][k] = t;
                }
            }
        }
    }

    /// Exchanges the edge opposite node `k` of `t` for the other diagonal; the caller has made sure
    /// that both new triangles are positive.
    fn flip(&mut self, t: u32, k: usize) {
        let Some((u, j)) = self.across(t, k) else {
            return;
        };
        let (tt, uu) = (self.triangles[t as usize], self.triangles[u as usize]);
        let (nt, nu) = (self.neighbors[t as usize], self.neighbors[u as usize]);
        // Quadrilateral: apex c, then a, d, b anticlockwise; the old diagonal is (a, b).
        let (c, a, b) = (tt[k], tt[(k + 1) % 3], tt[(k + 2) % 3]);
        let d = uu[j];
        let (ca, cb) = (nt[(k + 2) % 3], nt[(k + 1) % 3]);
        // In u the shared edge is (b, a): node j+1 is b, node j+2 is a.
        let (db, da) = (nu[(j + 2) % 3], nu[(j + 1) % 3]);
        self.triangles[t as usize] = [c, a, d];
        self.triangles[u as usize] = [c, d, b];
        self.put(t, [c, a, d], [da, u, ca]);
        self.put(u, [c, d, b], [db, cb, t]);
        self.counts.flips += 1;
        for (t, sides) in [(t, [0, 2]), (u, [0, 1])] {
            self.queue.extend(sides.map(|k| (t, k)));
        }
    }

    /// The two triangles that a flip of side `k` of `t` would give, with the far node.
    fn flipped(&self, t: u32, k: usize) -> Option<[[u32; 3]; 2]> {
        let (u, j) = self.across(t, k)?;
        let tt = self.triangles[t as usize];
        let (c, a, b) = (tt[k], tt[(k + 1) % 3], tt[(k + 2) % 3]);
        let d = self.triangles[u as usize][j];
        Some([[c, a, d], [c, d, b]])
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
    fn flip_all(&mut self) {
        self.queue.clear();
        let all: Vec<u32> = self.alive().collect();
        self.queue
            .extend(all.iter().flat_map(|&t| [(t, 0), (t, 1), (t, 2)]));
        self.flip_queue();
    }

    fn flip_queue(&mut self) {
        while let Some((t, k)) = self.queue.pop() {
            if self.triangles[t as usize][0] != NONE {
                self.try_flip(t, usize::from(k));
            }
        }
    }

    /// No edge may pass through a curve.
    fn recover(&mut self) {
        for round in 0..6 {
            let mut edges = Vec::new();
            for t in self.alive() {
                for k in 0..3 {
                    let [a, b] = SIDES[k].map(|i| self.triangles[t as usize][i]);
                    let once = a < b || self.neighbors[t as usize][k] == NONE;
                    if once && self.pierced(a, b).is_some() {
                        edges.push([a, b]);
                    }
                }
            }
            if round == 0 {
                self.counts.pierced_before = edges.len();
            }
            self.counts.pierced_left = edges.len();
            if edges.is_empty() {
                return;
            }
            for [a, b] in edges {
                self.free_edge(a, b);
            }
        }
    }

    /// Rids the mesh of an edge that passes through a curve.
    fn free_edge(&mut self, a: u32, b: u32) {
        let Some((t, k)) = self.find_edge(a, b) else {
            return;
        };
        let Some(at) = self.pierced(a, b) else { return };
        if let Some([p, q]) = self.flipped(t, k)
            && self.cotangent(p).max(self.cotangent(q)) < STEEPEST
            && self.pierced(p[0], p[2]).is_none()
        {
            self.flip(t, k);
            self.counts.pierced_flipped += 1;
            return;
        }
        // The nearer end goes to the curve if it is free to.
        let gap = |n: u32| {
            let x = self.nodes[n as usize];
            (x[0] - at[0]).hypot(x[1] - at[1])
        };
        let near = if gap(a) < gap(b) { a } else { b };
        if gap(near) < SNAP * self.distance.at(at) && self.snap(near, at) {
            self.counts.pierced_snapped += 1;
        } else if self.split(t, k, at, None) {
            self.counts.pierced_split += 1;
        }
    }

    /// Moves a node that no feature holds to `at` on a curve, if all triangles stay sound.
    fn snap(&mut self, node: u32, at: [f64; 2]) -> bool {
        let i = node as usize;
        let old = self.holds[i];
        let kept: Vec<usize> = (0..2).filter(|k| old.axes >> k & 1 == 1).collect();
        let moves = |k: &usize| self.nodes[i][*k] != at[*k];
        if old.count > 0 || old.axes & 3 == 3 || kept.iter().any(moves) {
            return false;
        }
        self.gather(node);
        let sound = self.star.iter().all(|&t| {
            let moved = self.triangles[t as usize].map(|n| match n == node {
                true => at,
                false => self.nodes[n as usize],
            });
            worst_cotangent(&moved) < STEEPEST
        });
        if sound {
            self.nodes[i] = at;
            self.holds[i] = Hold::new(lift(at), self.kinds[i], lift(self.extent), self.sheets);
        }
        sound
    }

    /// The triangle and side that are the edge (a, b).
    fn find_edge(&mut self, a: u32, b: u32) -> Option<(u32, usize)> {
        self.gather(a);
        for &t in &self.star {
            let triangle = self.triangles[t as usize];
            for k in 0..3 {
                let [p, q] = SIDES[k].map(|i| triangle[i]);
                if [p, q] == [a, b] || [q, p] == [a, b] {
                    return Some((t, k));
                }
            }
        }
        None
    }

    /// The triangles around a node, into `star`.
    fn gather(&mut self, node: u32) {
        self.star.clear();
        let first = self.triangle_of[node as usize];
        // Anticlockwise, and from a side of the box clockwise too.
        for turn in [1, 2] {
            let mut t = first;
            while t != NONE && !(self.star.contains(&t) && t != first) {
                if t != first || turn == 1 {
                    self.star.push(t);
                }
                let triangle = self.triangles[t as usize];
                let k = triangle.iter().position(|&n| n == node).unwrap_or(0);
                t = self.neighbors[t as usize][(k + turn) % 3];
                if t == first {
                    return;
                }
            }
        }
    }

    /// Splits side `k` of `t` at a point of it. With `better_than`, only if the smallest angle of
    /// the new triangles has a smaller cotangent than that.
    fn split(&mut self, t: u32, k: usize, at: [f64; 2], better_than: Option<f64>) -> bool {
        let triangle = self.triangles[t as usize];
        let (c, a, b) = (triangle[k], triangle[(k + 1) % 3], triangle[(k + 2) % 3]);
        let across = self.across(t, k);
        let node = self.nodes.len() as u32;
        let mut fresh = vec![[c, a, node], [c, node, b]];
        let far = across.map(|(u, j)| self.triangles[u as usize][j]);
        if let Some(d) = far {
            fresh.extend([[d, b, node], [d, node, a]]);
        }
        let mut at = at;
        if self.on_side(a, b) {
            // Exactly in the side.
            let axes = self.holds[a as usize].axes & self.holds[b as usize].axes;
            for i in (0..2).filter(|i| axes >> i & 1 == 1) {
                at[i] = self.nodes[a as usize][i];
            }
        }
        self.nodes.push(at);
        let worst = fresh.iter().map(|&f| self.cotangent(f)).fold(0.0, f64::max);
        if worst >= better_than.unwrap_or(STEEPEST) {
            self.nodes.pop();
            return false;
        }
        let hold = Hold::new(lift(at), AtomKind::Interior, lift(self.extent), self.sheets);
        self.kinds.push(match (hold.axes & 3).count_ones() {
            0 => AtomKind::Interior,
            1 => AtomKind::Edge,
            _ => AtomKind::Corner,
        });
        self.holds.push(hold);
        self.triangle_of.push(t);
        let around = self.neighbors[t as usize];
        let (ca, cb) = (around[(k + 2) % 3], around[(k + 1) % 3]);
        let second = self.triangles.len() as u32;
        self.triangles.push(fresh[1]);
        self.neighbors.push([NONE; 3]);
        let beyond = across.map(|(u, j)| {
            let around = self.neighbors[u as usize];
            let fourth = self.triangles.len() as u32;
            self.triangles.push(fresh[3]);
            self.neighbors.push([NONE; 3]);
            (u, fourth, around[(j + 2) % 3], around[(j + 1) % 3])
        });
        let (third, fourth) = beyond.map_or((NONE, NONE), |(u, fourth, ..)| (u, fourth));
        self.triangles[t as usize] = fresh[0];
        if let Some((u, ..)) = beyond {
            self.triangles[u as usize] = fresh[2];
        }
        self.put(t, fresh[0], [fourth, second, ca]);
        self.put(second, fresh[1], [third, cb, t]);
        if let Some((u, fourth, db, da)) = beyond {
            self.put(u, fresh[2], [second, fourth, db]);
            self.put(fourth, fresh[3], [t, da, u]);
        }
        for t in [t, second, third, fourth] {
            if t != NONE {
                self.queue.extend([(t, 0), (t, 1), (t, 2)]);
            }
        }
        true
    }

    /// Flips and smooths, and collapses or splits edges where that is not enough.
    fn polish(&mut self) {
        self.flip_all();
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
                if self.smooth(node) {
                    self.counts.moves += 1;
                }
            }
            self.flip_queue();
            if round % 3 == 2 {
                for t in self.poor() {
                    if self.triangles[t as usize][0] != NONE {
                        self.mend(t);
                    }
                }
                self.flip_queue();
            }
        }
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

    /// Moves node `a` to node `b` and so removes their edge, if `b` is held by all that holds `a`, no
    /// new edge passes through a curve, and the worst new angle has a cotangent below `limit`.
    fn collapse(&mut self, a: u32, b: u32, limit: f64) -> bool {
        let (p, q) = (self.holds[a as usize], self.holds[b as usize]);
        let fixed = self.kinds[a as usize] == AtomKind::Fixed;
        if fixed || !p.within(&q) {
            return false;
        }
        self.gather(a);
        let star = std::mem::take(&mut self.star);
        let moved = |triangle: [u32; 3]| triangle.map(|n| if n == a { b } else { n });
        let holds_b = |t: &u32| self.triangles[*t as usize].contains(&b);
        let sound = star.iter().filter(|t| !holds_b(t)).all(|&t| {
            let triangle = self.triangles[t as usize];
            let free = |&n: &u32| n == a || self.pierced(n, b).is_none();
            self.cotangent(moved(triangle)) < limit && triangle.iter().all(free)
        });
        // On a side of the box only along it.
        let along = p.axes & 3 == 0 || self.on_side(a, b);
        if sound && along {
            for &t in star.iter().filter(|t| holds_b(t)).collect::<Vec<_>>() {
                let triangle = self.triangles[t as usize];
                let side = |n: u32| triangle.iter().position(|&m| m == n).unwrap_or(0);
                let (over_a, over_b) = (
                    self.neighbors[t as usize][side(b)],
                    self.neighbors[t as usize][side(a)],
                );
                // What lies across (a, c) and across (b, c) become neighbours.
                for (from, to) in [(over_a, over_b), (over_b, over_a)] {
                    if from != NONE {
                        for slot in &mut self.neighbors[from as usize] {
                            if *slot == t {
                                *slot = to;
                            }
                        }
                        for n in self.triangles[from as usize] {
                            self.triangle_of[n as usize] = from;
                        }
                    }
                }
                self.triangles[t as usize] = [NONE; 3];
            }
            for &t in &star {
                if self.triangles[t as usize][0] != NONE {
                    self.triangles[t as usize] = moved(self.triangles[t as usize]);
                    self.triangle_of[b as usize] = t;
                    self.queue.extend([(t, 0), (t, 1), (t, 2)]);
                }
            }
        }
        self.star = star;
        sound && along
    }

    /// Moves a node to where the smallest angle about it is largest; along its curve if it is on one.
    /// Whether it moved.
    fn smooth(&mut self, node: u32) -> bool {
        let i = node as usize;
        let mut hold = self.holds[i];
        if hold.axes == 7 || hold.count > 1 {
            return false;
        }
        self.gather(node);
        let spokes: Vec<[[f64; 2]; 2]> = self
            .star
            .iter()
            .map(|&t| {
                let triangle = self.triangles[t as usize];
                let k = triangle.iter().position(|&n| n == node).unwrap_or(0);
                SIDES[k].map(|j| self.nodes[triangle[j] as usize])
            })
            .collect();
        let worst = |x: [f64; 2]| {
            let cotangent = |&[u, v]: &[[f64; 2]; 2]| worst_cotangent(&[x, u, v]);
            spokes.iter().map(cotangent).fold(0.0, f64::max)
        };
        let start = self.nodes[i];
        let (mut x, mut best) = (start, worst(start));
        if best <= self.enough {
            return false;
        }
        let shortest = spokes
            .iter()
            .map(|[u, _]| (u[0] - x[0]).hypot(u[1] - x[1]))
            .fold(f64::INFINITY, f64::min);
        let mut step = 0.25 * shortest;
        while step > 0.004 * shortest {
            let mut moved = false;
            for direction in 0..DIRECTIONS {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(direction)
                    / f64::from(DIRECTIONS))
                .sin_cos();
                let along = hold.project([step * cos, step * sin, 0.0]);
                // A projected direction may have lost its length: the others then serve.
                if dot(along, along) < 0.25 * step * step {
                    continue;
                }
                let mut trial = hold;
                let to: [f64; 3] = std::array::from_fn(|k| {
                    (lift(x)[k] + along[k]).clamp(0.0, lift(self.extent)[k])
                });
                let Some([u, v, _]) = trial.settle(to, lift(self.extent), self.sheets) else {
                    continue;
                };
                let value = worst([u, v]);
                if value < best - 1e-3 {
                    (x, best, hold, moved) = ([u, v], value, trial, true);
                    break;
                }
            }
            if !moved {
                step *= 0.5;
            }
        }
        if x == start {
            return false;
        }
        self.nodes[i] = x;
        self.holds[i] = hold;
        self.queue
            .extend(self.star.iter().flat_map(|&t| [(t, 0), (t, 1), (t, 2)]));
        true
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

/// An end of a pierced edge is pulled onto the curve from this far, in units of d.
const SNAP: f64 = 0.5;

/// Smoothing aims this many degrees above the target.
const MARGIN: f64 = 4.0;

/// Rounds of smoothing; every third also collapses and splits.
const ROUNDS: usize = 15;

/// Directions in which a node tries to move.
const DIRECTIONS: u32 = 12;

#[cfg(test)]
#[path = "plane_tests.rs"]
mod tests;

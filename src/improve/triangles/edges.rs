//! Topological changes of the triangulation: flips, splits and collapses of edges.
//!
//! ```text
//!  flip                   split                    collapse of a into b
//!     b           b          b           b           o---o            o---o
//!    /|\         / \        /|\         /|\         / \ / \          /  `. \
//!   c | d   ->  c---d      c | d   ->  c-x-d       o---a---b   ->   o-------b
//!    \|/         \ /        \|/         \|/         \ / \ /          \  ,' /
//!     a           a          a           a           o---o            o---o
//! ```

use super::{MAX_COTANGENT, TriImprover};
use crate::geometry::{sub, to_3d};
use crate::improve::constraint::NodeConstraint;
use crate::lattice::AtomKind;
use crate::mesh::complex::NONE;
use crate::mesh::tri::SIDES;

impl TriImprover<'_> {
    /// Returns the triangle across side `k` of `t`, and the side of it that is shared.
    pub(super) fn neighbour(&self, t: u32, k: usize) -> Option<(u32, usize)> {
        let other = self.neighbours[t as usize][k];
        if other == NONE {
            return None;
        }
        let back = self.neighbours[other as usize].iter().position(|&n| n == t);
        back.map(|j| (other, j))
    }

    /// Writes a triangle with its neighbours, and updates the neighbours' own entries.
    pub(super) fn set_triangle(&mut self, t: u32, triangle: [u32; 3], neighbours: [u32; 3]) {
        self.triangles[t as usize] = triangle;
        self.neighbours[t as usize] = neighbours;
        for k in 0..3 {
            self.triangle_of_node[triangle[k] as usize] = t;
            let [a, b] = SIDES[k].map(|i| triangle[i]);
            self.set_neighbour(neighbours[k], [b, a], t);
        }
    }

    /// Sets `t` as the neighbour of `other` across its edge (a, b).
    pub(super) fn set_neighbour(&mut self, other: u32, [a, b]: [u32; 2], t: u32) {
        if other != NONE {
            let triangle = self.triangles[other as usize];
            for k in 0..3 {
                if SIDES[k].map(|i| triangle[i]) == [a, b] {
                    self.neighbours[other as usize][k] = t;
                }
            }
        }
    }

    /// Exchanges the edge opposite node `k` of `t` for the other diagonal. The caller must make
    /// sure that both new triangles have a positive area.
    pub(super) fn flip(&mut self, t: u32, k: usize) {
        let Some((u, j)) = self.neighbour(t, k) else {
            return;
        };
        let (tt, uu) = (self.triangles[t as usize], self.triangles[u as usize]);
        let (nt, nu) = (self.neighbours[t as usize], self.neighbours[u as usize]);
        // The quadrilateral is apex c, then a, d, b anticlockwise; the old diagonal is (a, b).
        let (c, a, b) = (tt[k], tt[(k + 1) % 3], tt[(k + 2) % 3]);
        let d = uu[j];
        let (ca, cb) = (nt[(k + 2) % 3], nt[(k + 1) % 3]);
        // In u the shared edge is (b, a): node j+1 is b, node j+2 is a.
        let (db, da) = (nu[(j + 2) % 3], nu[(j + 1) % 3]);
        self.triangles[t as usize] = [c, a, d];
        self.triangles[u as usize] = [c, d, b];
        self.set_triangle(t, [c, a, d], [da, u, ca]);
        self.set_triangle(u, [c, d, b], [db, cb, t]);
        self.counts.flips += 1;
        for (t, sides) in [(t, [0, 2]), (u, [0, 1])] {
            self.queue.extend(sides.map(|k| (t, k)));
        }
    }

    /// Returns the two triangles that a flip of side `k` of `t` would create.
    pub(super) fn flip_result(&self, t: u32, k: usize) -> Option<[[u32; 3]; 2]> {
        let (u, j) = self.neighbour(t, k)?;
        let tt = self.triangles[t as usize];
        let (c, a, b) = (tt[k], tt[(k + 1) % 3], tt[(k + 2) % 3]);
        let d = self.triangles[u as usize][j];
        Some([[c, a, d], [c, d, b]])
    }

    /// Returns the triangle and the side that form the edge (a, b).
    pub(super) fn find_edge(&mut self, a: u32, b: u32) -> Option<(u32, usize)> {
        self.gather_star(a);
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

    /// Collects the triangles around a node into `star`.
    pub(super) fn gather_star(&mut self, node: u32) {
        self.star.clear();
        let first = self.triangle_of_node[node as usize];
        // Walk anticlockwise. If that ends at a side of the box, walk clockwise from the first
        // triangle, too.
        for turn in [1, 2] {
            let mut t = first;
            while t != NONE {
                if t != first || turn == 1 {
                    self.star.push(t);
                }
                let triangle = self.triangles[t as usize];
                let k = triangle.iter().position(|&n| n == node).unwrap_or(0);
                t = self.neighbours[t as usize][(k + turn) % 3];
                if t == first {
                    return;
                }
            }
        }
    }

    /// Splits side `k` of `t` at a point on it. Returns `false`, and changes nothing, if the
    /// largest cotangent of the new triangles is not below `better_than` (by default
    /// [`MAX_COTANGENT`]).
    pub(super) fn split(
        &mut self,
        t: u32,
        k: usize,
        point: [f64; 2],
        better_than: Option<f64>,
    ) -> bool {
        let triangle = self.triangles[t as usize];
        let (c, a, b) = (triangle[k], triangle[(k + 1) % 3], triangle[(k + 2) % 3]);
        let across = self.neighbour(t, k);
        let node = self.nodes.len() as u32;
        let mut new_triangles = vec![[c, a, node], [c, node, b]];
        let opposite_node = across.map(|(u, j)| self.triangles[u as usize][j]);
        if let Some(d) = opposite_node {
            new_triangles.extend([[d, b, node], [d, node, a]]);
        }
        let mut point = point;
        let sides = self.common_sides(a, b);
        let are_fixed = [a, b].map(|n| self.kinds[n as usize] == AtomKind::Fixed) == [true; 2];
        let is_fixed = self.has_fixed_sides && are_fixed;
        if across.is_none() && (sides == 0 || is_fixed) {
            // The edge is on the outline of a part of a mesh, and the triangle beyond it cannot be
            // split here; or the mesh has to match another one along it.
            return false;
        }
        for i in (0..2).filter(|i| sides >> i & 1 == 1) {
            // The coordinate must be exactly that of the side.
            point[i] = self.nodes[a as usize][i];
        }
        self.nodes.push(point);
        let worst = new_triangles
            .iter()
            .map(|&f| self.cotangent(f))
            .fold(0.0, f64::max);
        if worst >= better_than.unwrap_or(MAX_COTANGENT) {
            self.nodes.pop();
            return false;
        }
        let (constraint, _) = NodeConstraint::new(
            to_3d(point),
            AtomKind::Interior,
            to_3d(self.extent),
            self.planes,
        );
        self.kinds
            .push(match (constraint.fixed_axes & 3).count_ones() {
                0 => AtomKind::Interior,
                1 => AtomKind::Edge,
                _ => AtomKind::Corner,
            });
        self.constraints.push(constraint);
        self.triangle_of_node.push(t);
        let neighbours = self.neighbours[t as usize];
        let (ca, cb) = (neighbours[(k + 2) % 3], neighbours[(k + 1) % 3]);
        let second = self.triangles.len() as u32;
        self.triangles.push(new_triangles[1]);
        self.neighbours.push([NONE; 3]);
        let other_side = across.map(|(u, j)| {
            let neighbours = self.neighbours[u as usize];
            let fourth = self.triangles.len() as u32;
            self.triangles.push(new_triangles[3]);
            self.neighbours.push([NONE; 3]);
            (u, fourth, neighbours[(j + 2) % 3], neighbours[(j + 1) % 3])
        });
        let (third, fourth) = other_side.map_or((NONE, NONE), |(u, fourth, ..)| (u, fourth));
        self.triangles[t as usize] = new_triangles[0];
        if let Some((u, ..)) = other_side {
            self.triangles[u as usize] = new_triangles[2];
        }
        self.set_triangle(t, new_triangles[0], [fourth, second, ca]);
        self.set_triangle(second, new_triangles[1], [third, cb, t]);
        if let Some((u, fourth, db, da)) = other_side {
            self.set_triangle(u, new_triangles[2], [second, fourth, db]);
            self.set_triangle(fourth, new_triangles[3], [t, da, u]);
        }
        for t in [t, second, third, fourth] {
            if t != NONE {
                self.queue.extend([(t, 0), (t, 1), (t, 2)]);
            }
        }
        true
    }

    /// Moves node `a` to node `b` and so removes their edge, if `b` has all constraints of `a`, no
    /// new edge passes through a curve, and the largest new cotangent is below `limit`.
    pub(super) fn collapse(&mut self, a: u32, b: u32, limit: f64) -> bool {
        let (p, q) = (self.constraints[a as usize], self.constraints[b as usize]);
        // A node with all axes fixed is a fixed node or a corner of the box. Another such node has
        // the same constraints but cannot take its place.
        let displacement = to_3d(sub(self.nodes[b as usize], self.nodes[a as usize]));
        if p.fixed_axes == 7 || !p.is_subset_of(&q, displacement) {
            return false;
        }
        self.gather_star(a);
        let star = std::mem::take(&mut self.star);
        let moved = |triangle: [u32; 3]| triangle.map(|n| if n == a { b } else { n });
        let holds_b = |t: &u32| self.triangles[*t as usize].contains(&b);
        let is_sound = star.iter().filter(|t| !holds_b(t)).all(|&t| {
            let triangle = self.triangles[t as usize];
            let is_free = |&n: &u32| n == a || self.find_intersection(n, b).is_none();
            self.cotangent(moved(triangle)) < limit && triangle.iter().all(is_free)
        });
        // A node on a side of the box may move along it only.
        let stays_in_side = p.fixed_axes & 3 == 0 || self.common_sides(a, b) != 0;
        if is_sound && stays_in_side {
            for &t in star.iter().filter(|t| holds_b(t)).collect::<Vec<_>>() {
                let triangle = self.triangles[t as usize];
                let side = |n: u32| triangle.iter().position(|&m| m == n).unwrap_or(0);
                let (over_a, over_b) = (
                    self.neighbours[t as usize][side(b)],
                    self.neighbours[t as usize][side(a)],
                );
                // The triangles across (a, c) and across (b, c) become neighbours.
                for (outer, new_neighbour) in [(over_a, over_b), (over_b, over_a)] {
                    if outer != NONE {
                        for slot in &mut self.neighbours[outer as usize] {
                            if *slot == t {
                                *slot = new_neighbour;
                            }
                        }
                        for n in self.triangles[outer as usize] {
                            self.triangle_of_node[n as usize] = outer;
                        }
                    }
                }
                self.triangles[t as usize] = [NONE; 3];
            }
            for &t in &star {
                if self.triangles[t as usize][0] != NONE {
                    self.triangles[t as usize] = moved(self.triangles[t as usize]);
                    self.triangle_of_node[b as usize] = t;
                    self.queue.extend([(t, 0), (t, 1), (t, 2)]);
                }
            }
        }
        self.star = star;
        is_sound && stays_in_side
    }
}

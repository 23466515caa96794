//! Features first: every edge that pierces a feature goes, by a flip, by pulling one of its ends
//! onto the feature, or by splitting it there.

use super::{Hold, Improver};
use crate::geometry::{dot, norm, sub};
use crate::mesh::EDGES;
use crate::mesh::quality::min_sine;
use crate::observer::Patience;
use rayon::prelude::*;

/// A flip that removes a piercing edge may leave tetrahedra as flat as this, round by round: at
/// first only good ones, so that surfaces are not spanned by long chords; smoothing follows.
const FLOORS: [f64; 4] = [0.3, 0.15, 0.08, 0.05];

/// A node put on a feature keeps this distance, over d, from the ends of the edge it splits.
const SPACING: f64 = 0.35;

/// The least that pulling a node onto a feature may leave.
const FLOOR: f64 = 0.05;

/// So many tetrahedra are searched for piercing edges at a time, remembering so many edges.
const CHUNK: usize = 1 << 14;
const SEEN: usize = 1 << 13;

impl Improver<'_> {
    /// The edges of the given tetrahedra that pierce a feature, as pairs of nodes in rising order; of
    /// all if `patience` lasts.
    fn pierced_among(&self, tets: &[u32], patience: &Patience<'_>) -> Vec<(u32, u32)> {
        // Four nodes of each of millions of tetrahedra: a byte a node stays in the cache.
        let near: Vec<bool> = self.holds.iter().map(|hold| !hold.far).collect();
        let mut edges: Vec<(u32, u32)> = tets
            .par_chunks(CHUNK)
            .take_any_while(|_| !patience.over())
            .flat_map_iter(|tets| {
                // An edge has some five tetrahedra, most of them close by in memory: those seen
                // last need no second look.
                let mut seen = vec![(0u32, 0u32); SEEN];
                let mut found = Vec::new();
                for &t in tets.iter().filter(|&&t| self.complex.alive(t)) {
                    let tet = self.complex.tets[t as usize];
                    let near = tet.map(|n| near[n as usize]);
                    if near == [false; 4] {
                        continue;
                    }
                    for [i, j] in EDGES {
                        if !near[i] && !near[j] {
                            continue;
                        }
                        let edge = (tet[i].min(tet[j]), tet[i].max(tet[j]));
                        let place = edge.0.wrapping_mul(31).wrapping_add(edge.1) as usize % SEEN;
                        if seen[place] != edge {
                            seen[place] = edge;
                            if self.may_pierce(edge.0, edge.1) {
                                found.push(edge);
                            }
                        }
                    }
                }
                found
            })
            .collect();
        edges.par_sort_unstable();
        edges.dedup();
        edges
            .into_par_iter()
            .take_any_while(|_| !patience.over())
            .filter(|&(a, b)| self.pierces(a, b))
            .collect()
    }

    /// Counts the edges that pierce a feature: those that recovery left, and those that moved or
    /// new nodes have made since. Once `patience` is over, only the former.
    pub(super) fn count_pierced(&mut self, patience: &Patience<'_>) -> usize {
        if patience.over() {
            return self.unrecovered.len();
        }
        let mut nodes = std::mem::take(&mut self.stirred);
        nodes.extend(self.unrecovered.iter().flat_map(|&(a, b)| [a, b]));
        nodes.sort_unstable();
        nodes.dedup();
        // Not those of changes that were taken back.
        nodes.retain(|&n| (n as usize) < self.complex.nodes.len());
        let tets = self.stars(nodes);
        self.pierced_among(&tets, patience).len()
    }

    /// The tetrahedra at any of the nodes, each once.
    fn stars(&mut self, nodes: impl IntoIterator<Item = u32>) -> Vec<u32> {
        let mut tets = Vec::new();
        for node in nodes {
            self.complex.star(node, &mut self.star);
            tets.extend_from_slice(&self.star);
        }
        tets.sort_unstable();
        tets.dedup();
        tets
    }

    /// Makes the mesh follow the features.
    pub(super) fn recover(&mut self, patience: &Patience<'_>) {
        let all: Vec<u32> = (0..self.complex.tets.len() as u32).collect();
        let mut pierced = self.pierced_among(&all, patience);
        self.beside = Vec::new();
        self.counts.pierced_before = pierced.len();
        for (round, floor) in FLOORS.into_iter().enumerate() {
            // Flips never make a piercing edge: only moved and new nodes need another look.
            let mut again = Vec::new();
            let edges = std::mem::take(&mut pierced);
            for (i, &(a, b)) in edges.iter().enumerate() {
                let done = (round as f64 + i as f64 / edges.len() as f64) / FLOORS.len() as f64;
                patience.reached(done);
                if patience.over() {
                    // They stay, and are counted.
                    self.unrecovered = edges[i..].to_vec();
                    return;
                }
                if self.recover_by_flip(a, b, floor) {
                    self.counts.pierced_flipped += 1;
                } else if self.recover_by_snap(a, b) {
                    self.counts.pierced_snapped += 1;
                } else if round > 0 && self.recover_by_split(a, b) {
                    self.counts.pierced_split += 1;
                }
                again.extend([a, b]);
            }
            let tets = self.stars(again);
            pierced = self.pierced_among(&tets, patience);
        }
        self.unrecovered = pierced;
        self.stirred.clear();
    }

    fn edge(&mut self, a: u32, b: u32) -> Option<u32> {
        let mut star = std::mem::take(&mut self.star);
        let t = self.complex.find_edge(a, b, &mut star);
        self.star = star;
        t
    }

    fn recover_by_flip(&mut self, a: u32, b: u32, floor: f64) -> bool {
        match self.edge(a, b) {
            // Gone already, with another edge.
            None => true,
            Some(t) => self.remove_edge(t, a, b, floor),
        }
    }

    /// Pulls the end that is nearer to the feature onto it.
    fn recover_by_snap(&mut self, a: u32, b: u32) -> bool {
        let Some((at, sheet)) = self.piercing(a, b) else {
            return true;
        };
        let reach = |n: u32| dot(sub(self.complex.nodes[n as usize], at), sheet.normal).abs();
        let length = norm(sub(
            self.complex.nodes[a as usize],
            self.complex.nodes[b as usize],
        ));
        let mut ends = [(reach(a), a), (reach(b), b)];
        ends.sort_by(|x, y| x.0.total_cmp(&y.0));
        ends.iter()
            .take_while(|(r, _)| *r < 0.4 * length)
            .any(|&(_, n)| self.snap(n, sheet.normal, 0.5 * length))
    }

    /// Moves a node onto the sheet of that normal if its tetrahedra stay well-formed.
    fn snap(&mut self, node: u32, normal: [f64; 3], reach: f64) -> bool {
        let mut hold = self.holds[node as usize];
        if hold.axes == 7 || hold.count >= 2 || hold.on(normal) {
            return false;
        }
        hold.add(normal);
        let old = self.complex.nodes[node as usize];
        let Some(x) = hold.settle(old, self.extent, self.sheets) else {
            return false;
        };
        if norm(sub(x, old)) > reach {
            return false;
        }
        self.gather(node);
        if super::smooth::worst(x, &self.spokes, FLOOR) <= FLOOR {
            return false;
        }
        self.move_to(node, x, hold);
        true
    }

    fn recover_by_split(&mut self, a: u32, b: u32) -> bool {
        let Some(t) = self.edge(a, b) else {
            return true;
        };
        let Some((at, sheet)) = self.piercing(a, b) else {
            return true;
        };
        let (p, q) = (
            self.complex.nodes[a as usize],
            self.complex.nodes[b as usize],
        );
        let mut hold = Hold {
            axes: self.common_sides(&[a, b]),
            ..Hold::default()
        };
        hold.add(sheet.normal);
        let Some(x) = hold.settle(at, self.extent, self.sheets) else {
            return false;
        };
        // A lattice of spacing d cannot resolve more: what would crowd is left, and counted.
        let room = SPACING * self.distance.at(x);
        if norm(sub(x, p)) < room || norm(sub(x, q)) < room {
            return false;
        }
        self.split_edge(t, a, b, x, hold, 0.02)
    }

    /// Puts a new node on edge (a, b) if every new tetrahedron is better than `floor`.
    pub(super) fn split_edge(
        &mut self,
        t: u32,
        a: u32,
        b: u32,
        x: [f64; 3],
        hold: Hold,
        floor: f64,
    ) -> bool {
        let mut ring = std::mem::take(&mut self.ring);
        let mut done = false;
        let whole = self.complex.ring(t, a, b, 40, &mut ring);
        // What lies beyond the end of a part of a mesh must not be split from here.
        let in_side = |r: Option<&u32>| r.is_some_and(|&r| self.in_side(&[a, b, r]));
        let ends = ring.closed || in_side(ring.nodes.first()) && in_side(ring.nodes.last());
        if whole && ends {
            let new = self.complex.nodes.len() as u32;
            self.fresh.clear();
            let m = ring.nodes.len();
            for i in 0..ring.tets.len() {
                let (r, s) = (ring.nodes[i], ring.nodes[(i + 1) % m]);
                self.fresh.push([a, new, r, s]);
                self.fresh.push([new, b, r, s]);
            }
            let position = |n: u32| {
                if n == new {
                    x
                } else {
                    self.complex.nodes[n as usize]
                }
            };
            if self
                .fresh
                .iter()
                .all(|f| min_sine(&f.map(position)) > floor)
            {
                self.complex.add_node(x);
                self.holds.push(hold);
                self.stirred.push(new);
                self.commit(&ring.tets);
                done = true;
            }
        }
        self.ring = ring;
        done
    }
}

//! Features first: every edge that pierces a feature goes, by a flip, by pulling one of its ends
//! onto the feature, or by splitting it there.

use super::flips::Flip;
use super::sweep::{Met, Scratch, Step};
use super::{Hold, Improver, Place, smooth};
use crate::Result;
use crate::geometry::{dot, norm, sub};
use crate::mesh::EDGES;
use crate::mesh::complex::NONE;
use crate::mesh::quality::min_sine;
use crate::observer::Patience;
use crate::parallel::prelude::*;

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
                        let edge = (tet[i].min(tet[j]), tet[i].max(tet[j]));
                        if !near[i] && !near[j] || !self.looks_at(&[edge.0, edge.1]) {
                            continue;
                        }
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
    ///
    /// # Errors
    /// Those of other ranks, with which the work is shared.
    pub(super) fn recover(&mut self, patience: &Patience<'_>) -> Result<()> {
        let all: Vec<u32> = (0..self.complex.tets.len() as u32).collect();
        let mut pierced = self.pierced_among(&all, patience);
        self.beside = Vec::new();
        self.counts.pierced_before = pierced.len();
        for (round, floor) in FLOORS.into_iter().enumerate() {
            // Flips never make a piercing edge: only moved and new nodes need another look.
            let again: Vec<u32> = pierced.iter().flat_map(|&(a, b)| [a, b]).collect();
            let count = pierced.len() as f64;
            while !pierced.is_empty() {
                let done = 1.0 - pierced.len() as f64 / count;
                patience.reached((round as f64 + done) / FLOORS.len() as f64);
                pierced = self.recover_all(pierced, floor, round > 0, patience)?;
                if patience.over() {
                    // They stay, and are counted.
                    self.unrecovered = pierced;
                    return Ok(());
                }
            }
            let tets = self.stars(again);
            pierced = self.pierced_among(&tets, patience);
        }
        self.unrecovered = pierced;
        self.stirred.clear();
        Ok(())
    }

    /// Does what it can about edges that pierce a feature; gives those that are to be looked at again.
    fn recover_all(
        &mut self,
        edges: Vec<(u32, u32)>,
        floor: f64,
        may_split: bool,
        patience: &Patience<'_>,
    ) -> Result<Vec<(u32, u32)>> {
        let found = self.each("piercing edges", &edges, |s, edge, scratch| {
            let idle = patience.over();
            (!idle).then(|| s.find_recovery(edge, floor, may_split, scratch))
        })?;
        let mut met = Met::new(self);
        let mut left = Vec::new();
        for (edge, found) in edges.into_iter().zip(found) {
            match found {
                None => left.push(edge),
                Some(None) => {}
                Some(Some(step)) if met.any(&step.old) => left.push(edge),
                Some(Some(step)) => {
                    match step.put {
                        None => self.counts.pierced_flipped += 1,
                        Some((NONE, _)) => self.counts.pierced_split += 1,
                        Some(_) => self.counts.pierced_snapped += 1,
                    }
                    met.make(self, step);
                }
            }
        }
        met.forget(self);
        Ok(left)
    }

    /// What to do about an edge that pierces a feature.
    fn find_recovery(
        &self,
        (a, b): (u32, u32),
        floor: f64,
        may_split: bool,
        scratch: &mut Scratch,
    ) -> Option<Step> {
        let Some(t) = self.complex.find_edge(a, b, &mut scratch.star) else {
            // Gone already, with another edge.
            return Some(Step::default());
        };
        if self.find_removal(t, [a, b], floor, &mut scratch.flip) {
            return Some(Step::of(&scratch.flip, None));
        }
        let Some((at, sheet)) = self.piercing(a, b) else {
            return Some(Step::default());
        };
        let snapped = self.find_snap([a, b], at, sheet.normal, scratch);
        snapped.or_else(|| {
            let (x, hold) = may_split.then(|| self.split_at(a, b, at, sheet.normal))??;
            let flip = &mut scratch.flip;
            self.find_edge_split(t, [a, b], x, 0.02, flip)
                .then(|| Step::of(flip, Some((NONE, (x, hold)))))
        })
    }

    /// Pulls the end that is nearer to the feature onto it.
    fn find_snap(
        &self,
        [a, b]: [u32; 2],
        at: [f64; 3],
        normal: [f64; 3],
        scratch: &mut Scratch,
    ) -> Option<Step> {
        let reach = |n: u32| dot(sub(self.complex.nodes[n as usize], at), normal).abs();
        let length = norm(sub(
            self.complex.nodes[a as usize],
            self.complex.nodes[b as usize],
        ));
        let mut ends = [(reach(a), a), (reach(b), b)];
        ends.sort_by(|x, y| x.0.total_cmp(&y.0));
        ends.iter()
            .take_while(|(r, _)| *r < 0.4 * length)
            .find_map(|&(_, node)| {
                let place = self.snapped(node, normal, 0.5 * length, scratch)?;
                Some(Step {
                    old: scratch.star.clone(),
                    fresh: Vec::new(),
                    put: Some((node, place)),
                })
            })
    }

    /// Where a node is on the sheet of that normal, if its tetrahedra stay well-formed there.
    fn snapped(
        &self,
        node: u32,
        normal: [f64; 3],
        reach: f64,
        scratch: &mut Scratch,
    ) -> Option<Place> {
        let mut hold = self.holds[node as usize];
        if hold.axes == 7 || hold.count >= 2 || hold.on(normal) {
            return None;
        }
        hold.add(normal);
        let old = self.complex.nodes[node as usize];
        let x = hold.settle(old, self.extent, self.sheets)?;
        if norm(sub(x, old)) > reach {
            return None;
        }
        let Scratch { star, spokes, .. } = scratch;
        self.complex.star(node, star);
        self.spokes(node, star, spokes);
        (smooth::worst(x, spokes, FLOOR) > FLOOR).then_some((x, hold))
    }

    /// Where a node on edge (a, b) is on the sheet of that normal.
    fn split_at(&self, a: u32, b: u32, at: [f64; 3], normal: [f64; 3]) -> Option<Place> {
        let mut hold = Hold {
            axes: self.common_sides(&[a, b]),
            ..Hold::default()
        };
        hold.add(normal);
        let x = hold.settle(at, self.extent, self.sheets)?;
        // A lattice of spacing d cannot resolve more: what would crowd is left, and counted.
        let room = SPACING * self.distance.at(x);
        let near = |n: u32| norm(sub(x, self.complex.nodes[n as usize])) < room;
        (!near(a) && !near(b)).then_some((x, hold))
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
        self.make_found(
            |s, found| s.find_edge_split(t, [a, b], x, floor, found),
            Some((x, hold)),
        )
    }

    /// The tetrahedra that take the place of those at edge (a, b) if there is a new node, `NONE`, on it; each must be
    /// better than `floor`.
    fn find_edge_split(
        &self,
        t: u32,
        [a, b]: [u32; 2],
        x: [f64; 3],
        floor: f64,
        found: &mut Flip,
    ) -> bool {
        let Flip { old, fresh, ring } = found;
        let whole = self.complex.ring(t, a, b, 40, ring);
        // What lies beyond the end of a part of a mesh must not be split from here.
        let in_side = |r: Option<&u32>| r.is_some_and(|&r| self.in_side(&[a, b, r]));
        let ends = ring.closed || in_side(ring.nodes.first()) && in_side(ring.nodes.last());
        if !whole || !ends {
            return false;
        }
        old.clone_from(&ring.tets);
        fresh.clear();
        let m = ring.nodes.len();
        for i in 0..ring.tets.len() {
            let (r, s) = (ring.nodes[i], ring.nodes[(i + 1) % m]);
            fresh.extend([[a, NONE, r, s], [NONE, b, r, s]]);
        }
        let position = |n: u32| match n {
            NONE => x,
            _ => self.complex.nodes[n as usize],
        };
        let sound = |f: &[u32; 4]| min_sine(&f.map(position)) > floor;
        fresh.iter().all(sound)
    }
}

//! Features first: every edge that pierces a feature goes, by a flip, by pulling one of its ends
//! onto the feature, or by splitting it there.

use super::batch::{BatchChange, ChangedTets, SearchScratch};
use super::flips::Flip;
use super::{ConstrainedPoint, NodeConstraint, TetImprover, smooth};
use crate::Result;
use crate::geometry::{dot, norm, sub};
use crate::mesh::EDGES;
use crate::mesh::complex::NONE;
use crate::mesh::quality::min_sine;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// A flip that removes a piercing edge may leave tetrahedra as flat as this, round by round: at
/// first only good ones, so that surfaces are not spanned by long chords; smoothing follows.
const MIN_FLIP_SINES: [f64; 4] = [0.3, 0.15, 0.08, 0.05];

/// A node put on a feature keeps this distance, over d, from the ends of the edge it splits.
const MIN_SPLIT_DISTANCE: f64 = 0.35;

/// The least that pulling a node onto a feature may leave.
const MIN_SNAP_SINE: f64 = 0.05;

/// So many tetrahedra are searched for piercing edges at a time, remembering so many edges.
const CHUNK: usize = 1 << 14;
const EDGE_CACHE_SIZE: usize = 1 << 13;

impl TetImprover<'_> {
    /// The edges of the given tetrahedra that pierce a feature, as pairs of nodes in rising order; of
    /// all if `patience` lasts.
    fn find_intersecting_edges(&self, tets: &[u32], patience: &CancelToken<'_>) -> Vec<(u32, u32)> {
        // Four nodes of each of millions of tetrahedra: a byte a node stays in the cache.
        let near: Vec<bool> = self.constraints.iter().map(|hold| !hold.is_far).collect();
        let mut edges: Vec<(u32, u32)> = tets
            .par_chunks(CHUNK)
            .take_any_while(|_| !patience.is_cancelled())
            .flat_map_iter(|tets| {
                // An edge has some five tetrahedra, most of them close by in memory: those seen
                // last need no second look.
                let mut seen = vec![(0u32, 0u32); EDGE_CACHE_SIZE];
                let mut found = Vec::new();
                for &t in tets.iter().filter(|&&t| self.complex.is_alive(t)) {
                    let tet = self.complex.tets[t as usize];
                    let near = tet.map(|n| near[n as usize]);
                    if near == [false; 4] {
                        continue;
                    }
                    for [i, j] in EDGES {
                        let edge = (tet[i].min(tet[j]), tet[i].max(tet[j]));
                        if !near[i] && !near[j] || !self.is_in_range(&[edge.0, edge.1]) {
                            continue;
                        }
                        let place =
                            edge.0.wrapping_mul(31).wrapping_add(edge.1) as usize % EDGE_CACHE_SIZE;
                        if seen[place] != edge {
                            seen[place] = edge;
                            if self.may_intersect(edge.0, edge.1) {
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
            .take_any_while(|_| !patience.is_cancelled())
            .filter(|&(a, b)| self.intersects(a, b))
            .collect()
    }

    /// Counts the edges that pierce a feature: those that recovery left, and those that moved or
    /// new nodes have made since. Once `patience` is over, only the former.
    pub(super) fn count_intersecting_edges(&mut self, patience: &CancelToken<'_>) -> usize {
        if patience.is_cancelled() {
            return self.unrecovered_edges.len();
        }
        let mut nodes = std::mem::take(&mut self.moved_nodes);
        nodes.extend(self.unrecovered_edges.iter().flat_map(|&(a, b)| [a, b]));
        nodes.sort_unstable();
        nodes.dedup();
        // Not those of changes that were taken back.
        nodes.retain(|&n| (n as usize) < self.complex.nodes.len());
        let tets = self.tets_at_nodes(nodes);
        self.find_intersecting_edges(&tets, patience).len()
    }

    /// The tetrahedra at any of the nodes, each once.
    fn tets_at_nodes(&mut self, nodes: impl IntoIterator<Item = u32>) -> Vec<u32> {
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
    pub(super) fn recover(&mut self, patience: &CancelToken<'_>) -> Result<()> {
        let all: Vec<u32> = (0..self.complex.tets.len() as u32).collect();
        let mut pierced = self.find_intersecting_edges(&all, patience);
        self.proximities = Vec::new();
        self.counts.intersecting_before = pierced.len();
        for (round, floor) in MIN_FLIP_SINES.into_iter().enumerate() {
            // Flips never make a piercing edge: only moved and new nodes need another look.
            let again: Vec<u32> = pierced.iter().flat_map(|&(a, b)| [a, b]).collect();
            let count = pierced.len() as f64;
            while !pierced.is_empty() {
                let done = 1.0 - pierced.len() as f64 / count;
                patience.set_fraction((round as f64 + done) / MIN_FLIP_SINES.len() as f64);
                pierced = self.recover_edges(pierced, floor, round > 0, patience)?;
                if patience.is_cancelled() {
                    // They stay, and are counted.
                    self.unrecovered_edges = pierced;
                    return Ok(());
                }
            }
            let tets = self.tets_at_nodes(again);
            pierced = self.find_intersecting_edges(&tets, patience);
        }
        self.unrecovered_edges = pierced;
        self.moved_nodes.clear();
        Ok(())
    }

    /// Does what it can about edges that pierce a feature; gives those that are to be looked at again.
    fn recover_edges(
        &mut self,
        edges: Vec<(u32, u32)>,
        floor: f64,
        may_split: bool,
        patience: &CancelToken<'_>,
    ) -> Result<Vec<(u32, u32)>> {
        let found = self.search_each("piercing edges", &edges, |s, edge, scratch| {
            let idle = patience.is_cancelled();
            (!idle).then(|| s.find_recovery(edge, floor, may_split, scratch))
        })?;
        let mut met = ChangedTets::new(self);
        let mut left = Vec::new();
        for (edge, found) in edges.into_iter().zip(found) {
            match found {
                None => left.push(edge),
                Some(None) => {}
                Some(Some(step)) if met.contains_any(&step.old_tets) => left.push(edge),
                Some(Some(step)) => {
                    match step.placed_node {
                        None => self.counts.intersecting_flipped += 1,
                        Some((NONE, _)) => self.counts.intersecting_split += 1,
                        Some(_) => self.counts.intersecting_snapped += 1,
                    }
                    met.apply(self, step);
                }
            }
        }
        met.return_buffer(self);
        Ok(left)
    }

    /// What to do about an edge that pierces a feature.
    fn find_recovery(
        &self,
        (a, b): (u32, u32),
        floor: f64,
        may_split: bool,
        scratch: &mut SearchScratch,
    ) -> Option<BatchChange> {
        let Some(t) = self.complex.tet_with_edge(a, b, &mut scratch.star) else {
            // Gone already, with another edge.
            return Some(BatchChange::default());
        };
        if self.find_edge_removal(t, [a, b], floor, &mut scratch.flip) {
            return Some(BatchChange::from_flip(&scratch.flip, None));
        }
        let Some((at, sheet)) = self.find_intersection(a, b) else {
            return Some(BatchChange::default());
        };
        let snapped = self.find_snap([a, b], at, sheet.normal, scratch);
        snapped.or_else(|| {
            let (x, hold) = may_split.then(|| self.split_position(a, b, at, sheet.normal))??;
            let flip = &mut scratch.flip;
            self.find_edge_split(t, [a, b], x, 0.02, flip)
                .then(|| BatchChange::from_flip(flip, Some((NONE, (x, hold)))))
        })
    }

    /// Pulls the end that is nearer to the feature onto it.
    fn find_snap(
        &self,
        [a, b]: [u32; 2],
        at: [f64; 3],
        normal: [f64; 3],
        scratch: &mut SearchScratch,
    ) -> Option<BatchChange> {
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
                let place = self.snap_position(node, normal, 0.5 * length, scratch)?;
                Some(BatchChange {
                    old_tets: scratch.star.clone(),
                    new_tets: Vec::new(),
                    placed_node: Some((node, place)),
                })
            })
    }

    /// Where a node is on the sheet of that normal, if its tetrahedra stay well-formed there.
    fn snap_position(
        &self,
        node: u32,
        normal: [f64; 3],
        reach: f64,
        scratch: &mut SearchScratch,
    ) -> Option<ConstrainedPoint> {
        let mut hold = self.constraints[node as usize];
        if hold.fixed_axes == 7 || hold.surface_count >= 2 || hold.is_on_surface(normal) {
            return None;
        }
        hold.add_surface(normal);
        let old = self.complex.nodes[node as usize];
        let x = hold.snap(old, self.extent, self.planes)?;
        if norm(sub(x, old)) > reach {
            return None;
        }
        let SearchScratch {
            star, link: spokes, ..
        } = scratch;
        self.complex.star(node, star);
        self.collect_link(node, star, spokes);
        (smooth::worst_sine(x, spokes, MIN_SNAP_SINE) > MIN_SNAP_SINE).then_some((x, hold))
    }

    /// Where a node on edge (a, b) is on the sheet of that normal.
    fn split_position(
        &self,
        a: u32,
        b: u32,
        at: [f64; 3],
        normal: [f64; 3],
    ) -> Option<ConstrainedPoint> {
        let mut hold = NodeConstraint {
            fixed_axes: self.common_sides(&[a, b]),
            ..NodeConstraint::default()
        };
        hold.add_surface(normal);
        let x = hold.snap(at, self.extent, self.planes)?;
        // A lattice of spacing d cannot resolve more: what would crowd is left, and counted.
        let room = MIN_SPLIT_DISTANCE * self.distance.value_at(x);
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
        hold: NodeConstraint,
        floor: f64,
    ) -> bool {
        self.apply_found(
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
        let Flip {
            old_tets: old,
            new_tets: fresh,
            ring,
        } = found;
        let whole = self.complex.ring(t, a, b, 40, ring);
        // What lies beyond the end of a part of a mesh must not be split from here.
        let in_side = |r: Option<&u32>| r.is_some_and(|&r| self.is_in_side(&[a, b, r]));
        let ends = ring.is_closed || in_side(ring.nodes.first()) && in_side(ring.nodes.last());
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

//! Recovers the features: removes every edge that passes through a feature, by a flip, by snapping
//! one of its ends onto the feature, or by splitting it there.
//!
//! ```text
//!               flip           snap          split
//!     a           a             a             a       flip:  without the edge (a, b), see `flips`
//!     |         /   \           |             |       snap:  the end nearer to the feature moves
//!  ===|===  -> r=====s   or  ===b===   or  ===x===           onto it
//!     |         \   /                         |       split: (a, b, r, s) -> (a, x, r, s) and
//!     b           b                           b              (x, b, r, s) all around the edge
//!  === feature
//! ```

use super::batch::{BatchChange, ChangedTets, SearchScratch};
use super::flips::Flip;
use super::{ConstrainedPoint, Effort, NodeConstraint, TetImprover, smooth};
use crate::Result;
use crate::geometry::{dot, norm, sorted_distinct, sub};
use crate::mesh::EDGES;
use crate::mesh::complex::NONE;
use crate::mesh::quality::min_sine;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Smallest sines that a flip of an intersecting edge may leave, round by round. The first rounds
/// accept only good tetrahedra, so that surfaces are not spanned by long chords. Smoothing follows.
const MIN_FLIP_SINES: [f64; 4] = [0.3, 0.15, 0.08, 0.05];
/// These sines in a draft. Where surfaces cross, many of its edges cannot be recovered, however often
/// that is tried.
const DRAFT_MIN_FLIP_SINES: [f64; 2] = [0.15, 0.05];

/// Smallest distance, in units of d, of a node on a feature from the ends of the edge that it
/// splits.
const MIN_SPLIT_DISTANCE: f64 = 0.35;

/// Smallest sine that snapping a node onto a feature may leave.
const MIN_SNAP_SINE: f64 = 0.05;

/// Number of edges for which one task searches a change.
const EDGES_PER_TASK: usize = 32;

/// Number of tetrahedra that one task searches for intersecting edges.
const TETS_PER_CHUNK: usize = 1 << 14;
/// Number of edges that such a task remembers.
const EDGE_CACHE_SIZE: usize = 1 << 13;

impl TetImprover<'_> {
    /// Returns the edges of the given tetrahedra that pass through a feature, as pairs of nodes in
    /// rising order. The list is complete unless `cancel` is cancelled.
    fn find_intersecting_edges(&self, tets: &[u32], cancel: &CancelToken<'_>) -> Vec<(u32, u32)> {
        // The loop reads four nodes of each of millions of tetrahedra. One byte per node stays in
        // the CPU cache.
        let is_near: Vec<bool> = self
            .constraints
            .iter()
            .map(|constraint| !constraint.is_far)
            .collect();
        let mut edges: Vec<(u32, u32)> = tets
            .par_chunks(TETS_PER_CHUNK)
            .take_any_while(|_| !cancel.is_cancelled())
            .flat_map_iter(|tets| {
                // An edge belongs to some five tetrahedra, most of them close by in memory. Edges
                // that were seen recently are skipped.
                let mut seen = vec![(0u32, 0u32); EDGE_CACHE_SIZE];
                let mut found = Vec::new();
                for &t in tets.iter().filter(|&&t| self.complex.is_alive(t)) {
                    let tet = self.complex.tets[t as usize];
                    let tet_is_near = tet.map(|n| is_near[n as usize]);
                    if tet_is_near == [false; 4] {
                        continue;
                    }
                    for [i, j] in EDGES {
                        let edge = (tet[i].min(tet[j]), tet[i].max(tet[j]));
                        if !tet_is_near[i] && !tet_is_near[j]
                            || !self.is_in_range(&[edge.0, edge.1])
                        {
                            continue;
                        }
                        let slot =
                            edge.0.wrapping_mul(31).wrapping_add(edge.1) as usize % EDGE_CACHE_SIZE;
                        if seen[slot] != edge {
                            seen[slot] = edge;
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
            .take_any_while(|_| !cancel.is_cancelled())
            .filter(|&(a, b)| self.intersects(a, b))
            .collect()
    }

    /// Counts the edges that pass through a feature: those that recovery left, and those that moved
    /// or new nodes have created since. If `cancel` is cancelled, counts only the former.
    pub(super) fn count_intersecting_edges(&mut self, cancel: &CancelToken<'_>) -> usize {
        if cancel.is_cancelled() {
            return self.unrecovered_edges.len();
        }
        let mut nodes = std::mem::take(&mut self.moved_nodes);
        nodes.extend(self.unrecovered_edges.iter().flat_map(|&(a, b)| [a, b]));
        nodes.sort_unstable();
        nodes.dedup();
        // Some recorded nodes belong to changes that were rolled back.
        nodes.retain(|&n| (n as usize) < self.complex.nodes.len());
        let tets = self.collect_node_tets(&nodes).into_distinct_tets();
        self.find_intersecting_edges(&tets, cancel).len()
    }

    /// Makes the mesh follow the features.
    ///
    /// # Errors
    /// Returns an error if another rank that shares the work fails.
    pub(super) fn recover(&mut self, cancel: &CancelToken<'_>) -> Result<()> {
        let all: Vec<u32> = (0..self.complex.tets.len() as u32).collect();
        let mut edges = self.find_intersecting_edges(&all, cancel);
        self.proximities = Vec::new();
        self.counts.intersecting_before = edges.len();
        let floors = match self.effort {
            Effort::Draft => &DRAFT_MIN_FLIP_SINES[..],
            Effort::Normal | Effort::Best => &MIN_FLIP_SINES,
        };
        for (round, &floor) in floors.iter().enumerate() {
            // Flips never create an intersecting edge. Only moved and new nodes need another test.
            let changed_nodes = sorted_distinct(edges.iter().flat_map(|&(a, b)| [a, b]));
            let count = edges.len() as f64;
            while !edges.is_empty() {
                let done = 1.0 - edges.len() as f64 / count;
                cancel.set_fraction((round as f64 + done) / floors.len() as f64);
                edges = self.recover_edges(edges, floor, round > 0, cancel)?;
                if cancel.is_cancelled() {
                    // The remaining edges are only counted.
                    self.unrecovered_edges = edges;
                    return Ok(());
                }
            }
            let tets = self.collect_node_tets(&changed_nodes).into_distinct_tets();
            edges = self.find_intersecting_edges(&tets, cancel);
        }
        self.unrecovered_edges = edges;
        self.moved_nodes.clear();
        Ok(())
    }

    /// Treats the edges that pass through a feature. Returns those that must be treated again.
    fn recover_edges(
        &mut self,
        edges: Vec<(u32, u32)>,
        floor: f64,
        may_split: bool,
        cancel: &CancelToken<'_>,
    ) -> Result<Vec<(u32, u32)>> {
        let outcomes = self.search_each(
            "intersecting edges",
            EDGES_PER_TASK,
            &edges,
            |s, edge, scratch| {
                let is_cancelled = cancel.is_cancelled();
                (!is_cancelled).then(|| s.find_recovery(edge.0, edge.1, floor, may_split, scratch))
            },
        )?;
        let mut changed = ChangedTets::new(self);
        let mut remaining = Vec::new();
        for (edge, outcome) in edges.into_iter().zip(outcomes) {
            match outcome {
                None => remaining.push(edge),
                Some(None) => {}
                Some(Some(change)) if changed.contains_any(&change.old_tets) => {
                    remaining.push(edge)
                }
                Some(Some(change)) => {
                    match change.placed_node {
                        None => self.counts.intersecting_flipped += 1,
                        Some((NONE, _)) => self.counts.intersecting_split += 1,
                        Some(_) => self.counts.intersecting_snapped += 1,
                    }
                    changed.apply(self, change);
                }
            }
        }
        changed.return_buffer(self);
        Ok(remaining)
    }

    /// Returns the change that removes an edge that passes through a feature; an empty change if
    /// the edge needs none, and `None` if no change is possible.
    fn find_recovery(
        &self,
        a: u32,
        b: u32,
        floor: f64,
        may_split: bool,
        scratch: &mut SearchScratch,
    ) -> Option<BatchChange> {
        let Some(t) = self.complex.tet_with_edge(a, b, &mut scratch.star) else {
            // Another change has removed the edge already.
            return Some(BatchChange::default());
        };
        if self.find_edge_removal(t, [a, b], floor, &mut scratch.flip) {
            return Some(BatchChange::from_flip(&scratch.flip, None));
        }
        let Some((point, plane)) = self.find_intersection(a, b) else {
            return Some(BatchChange::default());
        };
        let snapped = self.find_snap([a, b], point, plane.normal, scratch);
        snapped.or_else(|| {
            let (x, constraint) =
                may_split.then(|| self.split_position(a, b, point, plane.normal))??;
            let flip = &mut scratch.flip;
            self.find_edge_split(t, [a, b], x, 0.02, flip)
                .then(|| BatchChange::from_flip(flip, Some((NONE, (x, constraint)))))
        })
    }

    /// Returns the change that snaps the end nearer to the feature onto it.
    fn find_snap(
        &self,
        [a, b]: [u32; 2],
        point: [f64; 3],
        normal: [f64; 3],
        scratch: &mut SearchScratch,
    ) -> Option<BatchChange> {
        let distance = |n: u32| dot(sub(self.complex.nodes[n as usize], point), normal).abs();
        let length = norm(sub(
            self.complex.nodes[a as usize],
            self.complex.nodes[b as usize],
        ));
        let mut ends = [(distance(a), a), (distance(b), b)];
        ends.sort_by(|x, y| x.0.total_cmp(&y.0));
        ends.iter()
            .take_while(|(r, _)| *r < 0.4 * length)
            .find_map(|&(_, node)| {
                let position = self.snap_position(node, normal, 0.5 * length, scratch)?;
                Some(BatchChange {
                    old_tets: scratch.star.clone(),
                    new_tets: Vec::new(),
                    placed_node: Some((node, position)),
                })
            })
    }

    /// Returns the position of a node on the surface with this normal, if its tetrahedra stay valid
    /// there.
    fn snap_position(
        &self,
        node: u32,
        normal: [f64; 3],
        reach: f64,
        scratch: &mut SearchScratch,
    ) -> Option<ConstrainedPoint> {
        let mut constraint = self.constraints[node as usize];
        if constraint.fixed_axes == 7
            || constraint.surface_count >= 2
            || constraint.is_on_surface(normal)
        {
            return None;
        }
        constraint.add_surface(normal);
        let old = self.complex.nodes[node as usize];
        let x = constraint.snap(old, self.extent, self.planes)?;
        if norm(sub(x, old)) > reach {
            return None;
        }
        let SearchScratch { star, link, .. } = scratch;
        self.complex.star(node, star);
        self.collect_link(node, star, link);
        (smooth::worst_sine(x, link, MIN_SNAP_SINE) > MIN_SNAP_SINE).then_some((x, constraint))
    }

    /// Returns the position, on the surface with this normal, of a new node on edge (a, b).
    fn split_position(
        &self,
        a: u32,
        b: u32,
        point: [f64; 3],
        normal: [f64; 3],
    ) -> Option<ConstrainedPoint> {
        let mut constraint = NodeConstraint {
            fixed_axes: self.common_sides(&[a, b]),
            ..NodeConstraint::default()
        };
        constraint.add_surface(normal);
        let x = constraint.snap(point, self.extent, self.planes)?;
        // A lattice of spacing d cannot resolve more detail. Edges that would become too short are
        // left and counted.
        let min_distance = MIN_SPLIT_DISTANCE * self.distance.value_at(x);
        let is_near = |n: u32| norm(sub(x, self.complex.nodes[n as usize])) < min_distance;
        (!is_near(a) && !is_near(b)).then_some((x, constraint))
    }

    /// Inserts a new node on edge (a, b) if every new tetrahedron is better than `floor`.
    pub(super) fn split_edge(
        &mut self,
        t: u32,
        a: u32,
        b: u32,
        x: [f64; 3],
        constraint: NodeConstraint,
        floor: f64,
    ) -> bool {
        self.apply_found(
            |s, flip| s.find_edge_split(t, [a, b], x, floor, flip),
            Some((x, constraint)),
        )
    }

    /// Finds the tetrahedra that replace those at edge (a, b) when a new node, `NONE`, is inserted
    /// on it. Each must be better than `floor`.
    fn find_edge_split(
        &self,
        t: u32,
        [a, b]: [u32; 2],
        x: [f64; 3],
        floor: f64,
        flip: &mut Flip,
    ) -> bool {
        let Flip {
            old_tets,
            new_tets,
            ring,
        } = flip;
        let has_ring = self.complex.ring(t, a, b, 40, ring);
        // The edge is on the outside of a part of a mesh, and the tetrahedra beyond it cannot be
        // split here.
        let ends_in_side = |r: Option<&u32>| r.is_some_and(|&r| self.is_in_side(&[a, b, r]));
        let is_complete =
            ring.is_closed || ends_in_side(ring.nodes.first()) && ends_in_side(ring.nodes.last());
        if !has_ring || !is_complete {
            return false;
        }
        old_tets.clone_from(&ring.tets);
        new_tets.clear();
        let m = ring.nodes.len();
        for i in 0..ring.tets.len() {
            let (r, s) = (ring.nodes[i], ring.nodes[(i + 1) % m]);
            new_tets.extend([[a, NONE, r, s], [NONE, b, r, s]]);
        }
        let position = |n: u32| match n {
            NONE => x,
            _ => self.complex.nodes[n as usize],
        };
        let is_sound = |f: &[u32; 4]| min_sine(&f.map(position)) > floor;
        new_tets.iter().all(is_sound)
    }
}

//! Where no change helps by itself: one is tried together with the flips and the smoothing that follow.

use std::cmp::Ordering;
use std::collections::HashSet;

use crate::parallel::prelude::*;

use super::{MAX_COTANGENT, TriImprover};
use crate::geometry::{add_scaled, to_3d};
use crate::improve::feature_planes::MAX_FACE_OFFSET;
use crate::mesh::complex::NONE;
use crate::mesh::tri::SIDES;
use crate::progress::CancelToken;

/// A change is tried in a part of the mesh that reaches this many triangles from a poor one.
const PATCH_RINGS: usize = 3;

/// Of the length of features in such a part, so much stays at least.
const MIN_FEATURE_LENGTH_RATIO: f64 = 0.98;

/// Of so many changes that do not help, a second is tried.
const MAX_SECOND_TRIES: usize = 12;

/// Times that all poor triangles are tried.
const MAX_PASSES: usize = 3;

/// A change that may help once flips and smoothing have followed.
#[derive(Debug, Clone, Copy)]
enum CompoundOperation {
    /// The first node goes to the second.
    Collapse([u32; 2]),
    /// A node comes in the middle of an edge.
    Split([u32; 2]),
}

/// How good a part of a mesh is: less is better.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
struct Badness {
    /// Triangles of no use.
    unusable_count: usize,
    /// Triangles below target.
    below_target_count: usize,
    /// The cotangent of the smallest angle.
    worst_cotangent: f64,
}

impl Badness {
    fn total_cmp(&self, other: &Self) -> Ordering {
        let counts = |b: &Self| (b.unusable_count, b.below_target_count);
        counts(self)
            .cmp(&counts(other))
            .then(self.worst_cotangent.total_cmp(&other.worst_cotangent))
    }
}

/// A part of a mesh by itself.
struct TrianglePatch<'a> {
    improver: TriImprover<'a>,
    /// The part's triangles and nodes in the mesh.
    triangles: Vec<u32>,
    nodes: Vec<u32>,
}

impl<'a> TriImprover<'a> {
    /// Raises the smallest angle about each triangle with a cotangent above `limit`, as far as that can be
    /// without features being lost.
    pub(super) fn apply_compound(&mut self, limit: f64, patience: &CancelToken<'_>) {
        let mut in_vain = HashSet::new();
        for _ in 0..MAX_PASSES {
            let mut better = false;
            for t in self.triangles_above(limit) {
                if patience.is_cancelled() {
                    return;
                }
                let triangle = self.triangles[t as usize];
                if triangle[0] == NONE
                    || self.cotangent(triangle) <= limit
                    || in_vain.contains(&triangle)
                {
                    continue;
                }
                if self.apply_compound_at(t, patience) {
                    better = true;
                } else {
                    in_vain.insert(triangle);
                }
            }
            if !better {
                return;
            }
        }
    }

    /// Tries all changes about one triangle and keeps the best; whether there was one. For a triangle of
    /// no use, the most promising are tried with a second change.
    fn apply_compound_at(&mut self, t: u32, patience: &CancelToken<'_>) -> bool {
        let patch = self.extract_patch(t);
        let part = &patch.improver;
        let (now, length, pierced) = (
            part.badness(),
            part.feature_length(),
            part.intersecting_edges().len(),
        );
        let keeps = |trial: &TriImprover<'a>| {
            trial.feature_length() >= MIN_FEATURE_LENGTH_RATIO * length
                && trial.intersecting_edges().len() <= pierced
        };
        let better = |(then, trial): &(Badness, TriImprover<'a>)| *then < now && keeps(trial);
        let mut tried = part.try_operations(0, now, keeps, patience);
        let mut found = tried.iter().position(better);
        if found.is_none() && now.unusable_count > 0 {
            let promising = tried.iter().filter(|(_, trial)| keeps(trial));
            let promising: Vec<_> = promising.take(MAX_SECOND_TRIES).collect();
            let second = promising.into_par_iter().flat_map_iter(|(_, trial)| {
                let worst = trial.triangles_above(0.0)[0];
                trial.try_operations(worst, now, keeps, patience)
            });
            let mut second: Vec<_> = second.collect();
            second.sort_by(|(a, _), (b, _)| a.total_cmp(b));
            found = second.iter().position(better);
            tried = second;
        }
        let Some(found) = found else {
            return false;
        };
        let (_, done) = tried.swap_remove(found);
        let done = TrianglePatch {
            triangles: patch.triangles,
            nodes: patch.nodes,
            improver: done,
        };
        self.insert_patch(done);
        true
    }

    /// What becomes of a part by each change about a triangle, the best first; no more are tried after one
    /// that leaves fewer triangles poor and `keeps` what shall be kept.
    fn try_operations(
        &self,
        t: u32,
        now: Badness,
        keeps: impl Fn(&Self) -> bool,
        patience: &CancelToken<'_>,
    ) -> Vec<(Badness, Self)> {
        let mut tried = Vec::new();
        let fewest = (now.unusable_count, now.below_target_count);
        for change in self.candidate_operations(t) {
            let mut trial = self.copy_for_trial();
            if trial.apply_operation(change) {
                trial.flip_queue(patience);
                trial.flip_and_smooth(patience);
                let badness = trial.badness();
                let fewer = (badness.unusable_count, badness.below_target_count) < fewest;
                let enough = fewer && keeps(&trial);
                tried.push((badness, trial));
                if enough {
                    break;
                }
            }
        }
        tried.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        tried
    }

    /// Puts a part in the place that it was taken from.
    fn insert_patch(&mut self, patch: TrianglePatch<'a>) {
        let TrianglePatch {
            improver: part,
            triangles: mut slots,
            nodes: mut numbers,
        } = patch;
        let mut beyond: Vec<([u32; 2], u32)> = Vec::new();
        for &t in &slots {
            for k in 0..3 {
                let other = self.neighbors[t as usize][k];
                if other != NONE && !slots.contains(&other) {
                    let edge = SIDES[k].map(|i| self.triangles[t as usize][i]);
                    beyond.push((edge, other));
                }
            }
        }
        for i in 0..part.nodes.len() {
            let (x, kind, hold) = (part.nodes[i], part.kinds[i], part.constraints[i]);
            match numbers.get(i) {
                // Such a node stayed as it was, and may be held because of the part alone.
                Some(_) if hold.fixed_axes == 7 => (),
                Some(&n) => {
                    self.nodes[n as usize] = x;
                    self.kinds[n as usize] = kind;
                    self.constraints[n as usize] = hold;
                }
                None => {
                    numbers.push(self.nodes.len() as u32);
                    self.nodes.push(x);
                    self.kinds.push(kind);
                    self.constraints.push(hold);
                    self.triangle_of_node.push(NONE);
                }
            }
        }
        for &t in &slots {
            self.triangles[t as usize] = [NONE; 3];
        }
        while slots.len() < part.triangles.len() {
            slots.push(self.triangles.len() as u32);
            self.triangles.push([NONE; 3]);
            self.neighbors.push([NONE; 3]);
        }
        for t in part.live_triangles().map(|t| t as usize) {
            self.triangles[slots[t] as usize] = part.triangles[t].map(|n| numbers[n as usize]);
        }
        for t in part.live_triangles().map(|t| t as usize) {
            let triangle = self.triangles[slots[t] as usize];
            let around = std::array::from_fn(|k| match part.neighbors[t][k] {
                NONE => {
                    let edge = SIDES[k].map(|i| triangle[i]);
                    let other = beyond.iter().find(|(e, _)| *e == edge);
                    other.map_or(NONE, |&(_, other)| other)
                }
                u => slots[u as usize],
            });
            self.set_triangle(slots[t], triangle, around);
        }
        self.counts = part.counts;
    }

    /// The triangles within some rings of one, whose first triangle that is.
    fn extract_patch(&self, t: u32) -> TrianglePatch<'a> {
        let mut triangles = vec![t];
        for _ in 0..PATCH_RINGS {
            for i in 0..triangles.len() {
                for other in self.neighbors[triangles[i] as usize] {
                    if other != NONE && !triangles.contains(&other) {
                        triangles.push(other);
                    }
                }
            }
        }
        let corners = triangles.iter().map(|&t| self.triangles[t as usize]);
        let mut nodes: Vec<u32> = corners.clone().flatten().collect();
        nodes.sort_unstable();
        nodes.dedup();
        let local = |n: u32| nodes.partition_point(|&m| m < n) as u32;
        let inside = |t: u32| triangles.iter().position(|&u| u == t);
        let neighbors = triangles
            .iter()
            .map(|&t| self.neighbors[t as usize].map(|u| inside(u).map_or(NONE, |u| u as u32)));
        let neighbors: Vec<[u32; 3]> = neighbors.collect();
        let local_triangles: Vec<[u32; 3]> = corners.map(|c| c.map(local)).collect();
        let mut holds: Vec<_> = nodes
            .iter()
            .map(|&n| self.constraints[n as usize])
            .collect();
        let mut triangle_of = vec![NONE; nodes.len()];
        for (i, triangle) in local_triangles.iter().enumerate() {
            for k in 0..3 {
                triangle_of[triangle[k] as usize] = i as u32;
                // What other triangles share stays.
                if neighbors[i][k] == NONE && self.neighbors[triangles[i] as usize][k] != NONE {
                    for n in SIDES[k].map(|i| triangle[i]) {
                        holds[n as usize].fixed_axes = 7;
                    }
                }
            }
        }
        let improver = TriImprover {
            nodes: nodes.iter().map(|&n| self.nodes[n as usize]).collect(),
            triangles: local_triangles,
            neighbors,
            triangle_of_node: triangle_of,
            constraints: holds,
            kinds: nodes.iter().map(|&n| self.kinds[n as usize]).collect(),
            extent: self.extent,
            planes: self.planes,
            distance: self.distance,
            max_usable_cotangent: self.max_usable_cotangent,
            target_cotangent: self.target_cotangent,
            smoothing_target: self.smoothing_target,
            counts: self.counts,
            queue: Vec::new(),
            star: Vec::new(),
        };
        TrianglePatch {
            improver,
            triangles,
            nodes,
        }
    }

    fn copy_for_trial(&self) -> Self {
        Self {
            nodes: self.nodes.clone(),
            triangles: self.triangles.clone(),
            neighbors: self.neighbors.clone(),
            triangle_of_node: self.triangle_of_node.clone(),
            constraints: self.constraints.clone(),
            kinds: self.kinds.clone(),
            queue: Vec::new(),
            star: Vec::new(),
            ..*self
        }
    }

    fn badness(&self) -> Badness {
        let none = Badness {
            unusable_count: 0,
            below_target_count: 0,
            worst_cotangent: 0.0,
        };
        let cotangents = self
            .live_triangles()
            .map(|t| self.cotangent(self.triangles[t as usize]));
        cotangents.fold(none, |all, value| Badness {
            unusable_count: all.unusable_count + usize::from(value > self.max_usable_cotangent),
            below_target_count: all.below_target_count + usize::from(value > self.target_cotangent),
            worst_cotangent: all.worst_cotangent.max(value),
        })
    }

    /// How long the edges on features are.
    fn feature_length(&self) -> f64 {
        let length = |[a, b]: [u32; 2]| {
            let [p, q] = [a, b].map(|n| self.nodes[n as usize]);
            (p[0] - q[0]).hypot(p[1] - q[1])
        };
        self.edges()
            .filter(|&[a, b]| self.is_on_feature(a, b))
            .map(length)
            .sum()
    }

    /// What may help a triangle: its edges, and those of its neighbours, collapse or are split.
    fn candidate_operations(&self, t: u32) -> Vec<CompoundOperation> {
        let around = self.neighbors[t as usize];
        let near = around.into_iter().filter(|&t| t != NONE);
        let near = std::iter::once(t)
            .chain(near)
            .map(|t| self.triangles[t as usize]);
        let mut edges: Vec<[u32; 2]> = near
            .flat_map(|triangle| SIDES.map(|side| side.map(|i| triangle[i])))
            .map(|[a, b]| [a.min(b), a.max(b)])
            .collect();
        edges.sort_unstable();
        edges.dedup();
        let changes = |[a, b]: [u32; 2]| {
            [
                CompoundOperation::Collapse([a, b]),
                CompoundOperation::Collapse([b, a]),
                CompoundOperation::Split([a, b]),
            ]
        };
        edges.into_iter().flat_map(changes).collect()
    }

    /// Makes a change if all triangles stay sound.
    fn apply_operation(&mut self, change: CompoundOperation) -> bool {
        match change {
            CompoundOperation::Collapse([a, b]) => {
                let done = self.collapse(a, b, MAX_COTANGENT);
                self.counts.collapses += usize::from(done);
                done
            }
            CompoundOperation::Split([a, b]) => {
                let [p, q] = [a, b].map(|n| to_3d(self.nodes[n as usize]));
                let mut at = std::array::from_fn(|k| 0.5 * (p[k] + q[k]));
                if self.is_on_feature(a, b) {
                    let near = self.planes.planes_near(at);
                    let nearest = near.iter().filter(|s| s.offset.abs() < MAX_FACE_OFFSET);
                    if let Some(s) =
                        nearest.min_by(|s, t| s.offset.abs().total_cmp(&t.offset.abs()))
                    {
                        at = add_scaled(at, -s.offset, s.normal);
                    }
                }
                let Some((t, k)) = self.find_edge(a, b) else {
                    return false;
                };
                let done = self.split(t, k, [at[0], at[1]], None);
                self.counts.insertions += usize::from(done);
                done
            }
        }
    }
}

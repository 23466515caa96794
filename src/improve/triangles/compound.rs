//! Compound operations: where no single operation helps, one is tried together with the flips and
//! the smoothing that follow.

use std::cmp::Ordering;
use std::collections::HashSet;

use crate::parallel::prelude::*;

use super::{MAX_COTANGENT, TriImprover};
use crate::geometry::{add_scaled, hypot, sorted_distinct, to_3d};
use crate::improve::feature_planes::MAX_FACE_OFFSET;
use crate::mesh::complex::NONE;
use crate::mesh::tri::SIDES;
use crate::progress::CancelToken;

/// Number of rings of triangles around a triangle below target that make up the patch in which an
/// operation is tried.
const PATCH_RINGS: usize = 3;

/// Smallest share of the length of features in a patch that an operation must keep.
const MIN_FEATURE_LENGTH_RATIO: f64 = 0.98;

/// Number of the most promising operations that are tried together with a second operation.
const MAX_SECOND_TRIES: usize = 12;

/// Largest number of passes over all triangles below target.
const MAX_PASSES: usize = 3;

/// An operation that may help once flips and smoothing have followed.
#[derive(Debug, Clone, Copy)]
enum CompoundOperation {
    /// Moves the first node to the second.
    Collapse([u32; 2]),
    /// Inserts a node in the middle of an edge.
    Split([u32; 2]),
}

/// Defects of a part of a mesh: less is better. Fields are compared in their order.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
struct Defects {
    /// Number of unusable triangles.
    unusable_count: usize,
    /// Number of triangles below target.
    below_target_count: usize,
    /// Cotangent of the smallest angle.
    worst_cotangent: f64,
}

impl Defects {
    /// Compares two values in a total order: the fields in their order.
    fn total_cmp(&self, other: &Self) -> Ordering {
        let counts = |b: &Self| (b.unusable_count, b.below_target_count);
        counts(self)
            .cmp(&counts(other))
            .then(self.worst_cotangent.total_cmp(&other.worst_cotangent))
    }
}

/// A part of a mesh, copied out of it.
struct TrianglePatch<'a> {
    improver: TriImprover<'a>,
    /// Indices of the patch's triangles and nodes in the mesh.
    triangles: Vec<u32>,
    nodes: Vec<u32>,
}

impl<'a> TriImprover<'a> {
    /// Raises the smallest angle around each triangle with a cotangent above `limit`, as far as
    /// features allow.
    pub(super) fn apply_compound(&mut self, limit: f64, cancel: &CancelToken<'_>) {
        let mut failed = HashSet::new();
        for _ in 0..MAX_PASSES {
            let mut improved = false;
            for t in self.triangles_above(limit) {
                if cancel.is_cancelled() {
                    return;
                }
                let triangle = self.triangles[t as usize];
                if triangle[0] == NONE
                    || self.cotangent(triangle) <= limit
                    || failed.contains(&triangle)
                {
                    continue;
                }
                if self.apply_compound_at(t, cancel) {
                    improved = true;
                } else {
                    failed.insert(triangle);
                }
            }
            if !improved {
                return;
            }
        }
    }

    /// Tries all operations around one triangle and keeps the best. Returns `true` if one helps.
    /// For an unusable triangle, the most promising operations are also tried with a second
    /// operation.
    fn apply_compound_at(&mut self, t: u32, cancel: &CancelToken<'_>) -> bool {
        let patch = self.extract_patch(t);
        let original = &patch.improver;
        let (current, length, intersecting_count) = (
            original.defects(),
            original.feature_length(),
            original.intersecting_edges().len(),
        );
        let keeps_features = |trial: &TriImprover<'a>| {
            trial.feature_length() >= MIN_FEATURE_LENGTH_RATIO * length
                && trial.intersecting_edges().len() <= intersecting_count
        };
        let better = |(defects, trial): &(Defects, TriImprover<'a>)| {
            *defects < current && keeps_features(trial)
        };
        let mut tried = original.try_operations(0, current, keeps_features, cancel);
        let mut best = tried.iter().position(better);
        if best.is_none() && current.unusable_count > 0 {
            let promising = tried.iter().filter(|(_, trial)| keeps_features(trial));
            let promising: Vec<_> = promising.take(MAX_SECOND_TRIES).collect();
            let second = promising.into_par_iter().flat_map_iter(|(_, trial)| {
                let worst = trial.triangles_above(0.0)[0];
                trial.try_operations(worst, current, keeps_features, cancel)
            });
            let mut second: Vec<_> = second.collect();
            second.sort_by(|(a, _), (b, _)| a.total_cmp(b));
            best = second.iter().position(better);
            tried = second;
        }
        let Some(best) = best else {
            return false;
        };
        let (_, improver) = tried.swap_remove(best);
        let patch = TrianglePatch {
            triangles: patch.triangles,
            nodes: patch.nodes,
            improver,
        };
        self.insert_patch(patch);
        true
    }

    /// Returns the results of the operations around a triangle, the best first. Stops after an
    /// operation that leaves fewer triangles below target and for which `keeps_features` is true.
    fn try_operations(
        &self,
        t: u32,
        current: Defects,
        keeps_features: impl Fn(&Self) -> bool,
        cancel: &CancelToken<'_>,
    ) -> Vec<(Defects, Self)> {
        let mut tried = Vec::new();
        let counts = (current.unusable_count, current.below_target_count);
        for operation in self.candidate_operations(t) {
            let mut trial = self.copy_for_trial();
            if trial.apply_operation(operation) {
                trial.flip_queue(cancel);
                trial.flip_and_smooth(cancel);
                let defects = trial.defects();
                let fewer = (defects.unusable_count, defects.below_target_count) < counts;
                let enough = fewer && keeps_features(&trial);
                tried.push((defects, trial));
                if enough {
                    break;
                }
            }
        }
        tried.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        tried
    }

    /// Writes a patch back to where it was taken from.
    fn insert_patch(&mut self, patch: TrianglePatch<'a>) {
        let TrianglePatch {
            improver,
            triangles: mut slots,
            nodes: mut node_ids,
        } = patch;
        let mut outer_neighbours: Vec<([u32; 2], u32)> = Vec::new();
        for &t in &slots {
            for k in 0..3 {
                let other = self.neighbours[t as usize][k];
                if other != NONE && !slots.contains(&other) {
                    let edge = SIDES[k].map(|i| self.triangles[t as usize][i]);
                    outer_neighbours.push((edge, other));
                }
            }
        }
        for i in 0..improver.nodes.len() {
            let (x, kind, constraint) = (
                improver.nodes[i],
                improver.kinds[i],
                improver.constraints[i],
            );
            match node_ids.get(i) {
                // Such a node did not move. Its constraint may hold for the patch only.
                Some(_) if constraint.fixed_axes == 7 => (),
                Some(&n) => {
                    self.nodes[n as usize] = x;
                    self.kinds[n as usize] = kind;
                    self.constraints[n as usize] = constraint;
                }
                None => {
                    node_ids.push(self.nodes.len() as u32);
                    self.nodes.push(x);
                    self.kinds.push(kind);
                    self.constraints.push(constraint);
                    self.triangle_of_node.push(NONE);
                }
            }
        }
        for &t in &slots {
            self.triangles[t as usize] = [NONE; 3];
        }
        while slots.len() < improver.triangles.len() {
            slots.push(self.triangles.len() as u32);
            self.triangles.push([NONE; 3]);
            self.neighbours.push([NONE; 3]);
        }
        for t in improver.live_triangles().map(|t| t as usize) {
            self.triangles[slots[t] as usize] = improver.triangles[t].map(|n| node_ids[n as usize]);
        }
        for t in improver.live_triangles().map(|t| t as usize) {
            let triangle = self.triangles[slots[t] as usize];
            let neighbours = std::array::from_fn(|k| match improver.neighbours[t][k] {
                NONE => {
                    let edge = SIDES[k].map(|i| triangle[i]);
                    let other = outer_neighbours.iter().find(|(e, _)| *e == edge);
                    other.map_or(NONE, |&(_, other)| other)
                }
                u => slots[u as usize],
            });
            self.set_triangle(slots[t], triangle, neighbours);
        }
        self.counts = improver.counts;
    }

    /// Returns the triangles within some rings of one, which comes first.
    fn extract_patch(&self, t: u32) -> TrianglePatch<'a> {
        let mut triangles = vec![t];
        for _ in 0..PATCH_RINGS {
            for i in 0..triangles.len() {
                for other in self.neighbours[triangles[i] as usize] {
                    if other != NONE && !triangles.contains(&other) {
                        triangles.push(other);
                    }
                }
            }
        }
        let corners = triangles.iter().map(|&t| self.triangles[t as usize]);
        let nodes = sorted_distinct(corners.clone().flatten());
        let local = |n: u32| nodes.partition_point(|&m| m < n) as u32;
        let local_triangle = |t: u32| triangles.iter().position(|&u| u == t);
        let neighbours = triangles.iter().map(|&t| {
            self.neighbours[t as usize].map(|u| local_triangle(u).map_or(NONE, |u| u as u32))
        });
        let neighbours: Vec<[u32; 3]> = neighbours.collect();
        let local_triangles: Vec<[u32; 3]> = corners.map(|c| c.map(local)).collect();
        let mut constraints: Vec<_> = nodes
            .iter()
            .map(|&n| self.constraints[n as usize])
            .collect();
        let mut triangle_of_node = vec![NONE; nodes.len()];
        for (i, triangle) in local_triangles.iter().enumerate() {
            for k in 0..3 {
                triangle_of_node[triangle[k] as usize] = i as u32;
                // Nodes that other triangles share must not move.
                if neighbours[i][k] == NONE && self.neighbours[triangles[i] as usize][k] != NONE {
                    for n in SIDES[k].map(|i| triangle[i]) {
                        constraints[n as usize].fixed_axes = 7;
                    }
                }
            }
        }
        let improver = TriImprover {
            nodes: nodes.iter().map(|&n| self.nodes[n as usize]).collect(),
            triangles: local_triangles,
            neighbours,
            triangle_of_node,
            constraints,
            kinds: nodes.iter().map(|&n| self.kinds[n as usize]).collect(),
            has_fixed_sides: self.has_fixed_sides,
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

    /// Returns a copy in which an operation can be tried.
    fn copy_for_trial(&self) -> Self {
        Self {
            nodes: self.nodes.clone(),
            triangles: self.triangles.clone(),
            neighbours: self.neighbours.clone(),
            triangle_of_node: self.triangle_of_node.clone(),
            constraints: self.constraints.clone(),
            kinds: self.kinds.clone(),
            queue: Vec::new(),
            star: Vec::new(),
            ..*self
        }
    }

    /// Returns the defects of all triangles.
    fn defects(&self) -> Defects {
        let empty = Defects {
            unusable_count: 0,
            below_target_count: 0,
            worst_cotangent: 0.0,
        };
        let cotangents = self
            .live_triangles()
            .map(|t| self.cotangent(self.triangles[t as usize]));
        cotangents.fold(empty, |total, value| Defects {
            unusable_count: total.unusable_count + usize::from(value > self.max_usable_cotangent),
            below_target_count: total.below_target_count
                + usize::from(value > self.target_cotangent),
            worst_cotangent: total.worst_cotangent.max(value),
        })
    }

    /// Returns the total length of the edges on features.
    fn feature_length(&self) -> f64 {
        let length = |[a, b]: [u32; 2]| {
            let [p, q] = [a, b].map(|n| self.nodes[n as usize]);
            hypot(p[0] - q[0], p[1] - q[1])
        };
        self.edges()
            .filter(|&[a, b]| self.is_on_feature(a, b))
            .map(length)
            .sum()
    }

    /// Returns the operations that may help a triangle: collapses and splits of its edges and of
    /// those of its neighbours.
    fn candidate_operations(&self, t: u32) -> Vec<CompoundOperation> {
        let neighbours = self.neighbours[t as usize];
        let nearby = neighbours.into_iter().filter(|&t| t != NONE);
        let nearby = std::iter::once(t)
            .chain(nearby)
            .map(|t| self.triangles[t as usize]);
        let edges = sorted_distinct(
            nearby
                .flat_map(|triangle| SIDES.map(|side| side.map(|i| triangle[i])))
                .map(|[a, b]| [a.min(b), a.max(b)]),
        );
        let operations = |[a, b]: [u32; 2]| {
            [
                CompoundOperation::Collapse([a, b]),
                CompoundOperation::Collapse([b, a]),
                CompoundOperation::Split([a, b]),
            ]
        };
        edges.into_iter().flat_map(operations).collect()
    }

    /// Applies an operation if all triangles stay valid.
    fn apply_operation(&mut self, operation: CompoundOperation) -> bool {
        match operation {
            CompoundOperation::Collapse([a, b]) => {
                let done = self.collapse(a, b, MAX_COTANGENT);
                self.counts.collapses += usize::from(done);
                done
            }
            CompoundOperation::Split([a, b]) => {
                let [p, q] = [a, b].map(|n| to_3d(self.nodes[n as usize]));
                let mut middle = std::array::from_fn(|k| 0.5 * (p[k] + q[k]));
                if self.is_on_feature(a, b) {
                    let nearby = self.planes.planes_near(middle);
                    let nearest = nearby.iter().filter(|s| s.offset.abs() < MAX_FACE_OFFSET);
                    if let Some(s) =
                        nearest.min_by(|s, t| s.offset.abs().total_cmp(&t.offset.abs()))
                    {
                        middle = add_scaled(middle, -s.offset, s.normal);
                    }
                }
                let Some((t, k)) = self.find_edge(a, b) else {
                    return false;
                };
                let done = self.split(t, k, [middle[0], middle[1]], None);
                self.counts.insertions += usize::from(done);
                done
            }
        }
    }
}

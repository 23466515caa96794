//! Repairs the tetrahedra that flips and smoothing cannot improve: a split, a collapse or a swap
//! that by itself makes things worse is followed by flips and smoothing around it. All is kept only
//! if the worst of the changed tetrahedra has become better.
//!
//! ```text
//! tried in this order, for a tetrahedron (0, 1, 2, 3) below target:
//!  4 faces   2-3 swap, drawn at `flips`                           2 tetrahedra -> 3
//!  1 centre  new node in the middle, drawn at `reshape`           a cavity -> its outer faces with x
//!  6 edges   collapse, drawn at `collapse`, if short              the tetrahedra at the edge vanish
//!  6 edges   split at the middle, drawn at `recover`, if long     m tetrahedra -> 2 m
//!  4 faces   new node in the middle of the face                   as for the centre
//! ```

use super::attempt_cache::AttemptKind;
use super::{NodeConstraint, SMOOTHING_MARGIN, TetImprover};
use crate::Result;
use crate::geometry::{norm, sorted_distinct, sub};
use crate::improve::target::UNUSABLE_ANGLE;
use crate::mesh::{EDGES, FACES};
use crate::progress::CancelToken;

/// Smallest sine that a split, collapse or swap may leave.
const MIN_SINE: f64 = 0.01;

/// Smallest gain in sine of a repair that does not reach the target.
const MIN_SINE_GAIN: f32 = 2e-3;

/// Longest edge that may be collapsed, in units of d: the lattice keeps its spacing.
const MAX_COLLAPSE_LENGTH: f64 = 0.85;
/// Shortest edge that may be split, in units of d.
const MIN_SPLIT_LENGTH: f64 = 0.95;

/// Smallest distance, in units of d, of an inserted node from others: about that of the middle of a
/// face of a regular tetrahedron from its corners.
const MIN_NODE_DISTANCE: f64 = 0.5;

/// Largest number of tetrahedra that are repaired in a round; one in a hundred tetrahedra if that is
/// more.
const MAX_TETS_PER_ROUND: usize = 1000;
/// Largest number of rounds of repairs.
const MAX_ROUNDS: usize = 4;

/// Values that a transaction has overwritten, except those in the journal of the complex.
#[derive(Debug, Default)]
pub(super) struct TransactionLog {
    /// Slots in the order of their first change, with their old sines.
    slots: Vec<(u32, f32)>,
    /// `true` for each slot in `slots`; its length is limited to the slots that were changed so
    /// far.
    touched: Vec<bool>,
    pub(super) nodes: Vec<(u32, [f64; 3], NodeConstraint)>,
    node_count: usize,
}

impl TransactionLog {
    /// Clears the marks of changed slots and returns their buffer for the next transaction.
    fn take_touched(&mut self) -> Vec<bool> {
        for (t, _) in &self.slots {
            self.touched[*t as usize] = false;
        }
        std::mem::take(&mut self.touched)
    }

    /// Records the sines of slots, unless they are recorded already.
    pub(super) fn record_slots(&mut self, slots: &[u32], sines: &[f32]) {
        for &t in slots {
            let i = t as usize;
            if i >= self.touched.len() {
                self.touched.resize(i + 1, false);
            }
            if !std::mem::replace(&mut self.touched[i], true) {
                self.slots.push((t, sines[i]));
            }
        }
    }
}

impl TetImprover<'_> {
    /// Repairs the tetrahedra below target, the worst first.
    ///
    /// # Errors
    /// Returns an error if another rank that shares the work fails.
    pub(super) fn repair(&mut self, cancel: &CancelToken<'_>) -> Result<()> {
        // For the progress: each round is assumed to halve the remaining work.
        let mut remaining = 1.0;
        for _ in 0..MAX_ROUNDS {
            let mut below_target = self.tets_below_target();
            below_target
                .sort_by(|a, b| self.sine_of(*a).total_cmp(&self.sine_of(*b)).then(a.cmp(b)));
            let old_count = below_target.len();
            // Where features demand what no lattice can do, the time must be limited.
            below_target.truncate(self.max_tets_per_round());
            let set_progress =
                |fraction| cancel.set_fraction(1.0 - remaining * (1.0 - 0.5 * fraction));
            self.repair_each(&below_target, cancel, set_progress)?;
            remaining *= 0.5;
            self.flip_and_smooth(2, cancel)?;
            if self.tets_below_target().len() >= old_count {
                break;
            }
        }
        Ok(())
    }

    /// Smooths also the nodes next to those of the tetrahedra that are still below target, and
    /// repairs these again. Some are below target only because their neighbours leave them no room.
    ///
    /// # Errors
    /// Returns an error if another rank that shares the work fails.
    pub(super) fn smooth_around_poor(&mut self, cancel: &CancelToken<'_>) -> Result<()> {
        for _ in 0..MAX_ROUNDS {
            let below_target = self.tets_below_target();
            if below_target.is_empty() || self.has_too_many(below_target.len()) {
                break;
            }
            let nodes_of = |slots: &[u32]| {
                sorted_distinct(slots.iter().flat_map(|&t| self.complex.tets[t as usize]))
            };
            let around = self.collect_node_tets(&nodes_of(&below_target));
            let mut around = around.into_distinct_tets();
            around.retain(|&t| self.is_in_range(&self.complex.tets[t as usize]));
            let nodes = nodes_of(&around);
            self.smoothing_target = 1.0;
            self.smooth_all(nodes, cancel)?;
            self.flip_and_smooth(1, cancel)?;
            self.repair(cancel)?;
        }
        Ok(())
    }

    /// Returns the largest number of tetrahedra that are repaired in a round.
    fn max_tets_per_round(&self) -> usize {
        MAX_TETS_PER_ROUND.max(self.complex.tets.len() / 100)
    }

    /// Returns `true` if more tetrahedra are below target than can be repaired.
    pub(super) fn has_too_many(&self, count: usize) -> bool {
        count > MAX_ROUNDS * self.max_tets_per_round()
    }

    /// Releases nodes from their features where a tetrahedron would stay unusable.
    ///
    /// # Errors
    /// Returns an error if another rank that shares the work fails.
    pub(super) fn release_nodes(&mut self, cancel: &CancelToken<'_>) -> Result<()> {
        let usable_sine = UNUSABLE_ANGLE.to_radians().sin();
        for _ in 0..4 {
            let mut unusable = self.tets_below_target();
            unusable.retain(|&t| self.sine_of(t) < usable_sine);
            if unusable.is_empty() {
                break;
            }
            for t in unusable {
                if cancel.is_cancelled() {
                    return Ok(());
                }
                if !self.complex.is_alive(t)
                    || self.sine_of(t) >= usable_sine
                    || !self.is_known_to_fail(t) && self.repair_in_place(t)
                {
                    continue;
                }
                let tet = self.complex.tets[t as usize];
                let has_freed_node = (0..4).any(|k| self.attempt(|s| s.free_nodes(t, &tet[k..=k])));
                if has_freed_node || self.attempt(|s| s.free_nodes(t, &tet)) {
                    self.counts.released += 1;
                }
            }
            self.flip_and_smooth(2, cancel)?;
        }
        Ok(())
    }

    /// Releases nodes of tetrahedron `t` from the features that hold them.
    fn free_nodes(&mut self, t: u32, nodes: &[u32]) -> bool {
        let mut changed = false;
        for &node in nodes {
            let i = node as usize;
            let (x, constraint) = (self.complex.nodes[i], self.constraints[i]);
            if constraint.surface_count > 0 {
                if let Some(undo) = &mut self.undo {
                    undo.nodes.push((node, x, constraint));
                }
                self.constraints[i].clear_surfaces();
                self.attempts.record_change(self.complex.tets[t as usize]);
                changed = true;
            }
        }
        self.measure(t);
        changed
    }

    /// Returns `true` if the repair of a tetrahedron has failed, and nothing has changed at its
    /// neighbours since.
    pub(super) fn is_known_to_fail(&mut self, t: u32) -> bool {
        let mut around = Vec::new();
        for node in self.complex.tets[t as usize] {
            self.complex.star(node, &mut self.star);
            around.extend(
                self.star
                    .iter()
                    .flat_map(|&t| self.complex.tets[t as usize]),
            );
        }
        self.attempts
            .is_known_to_fail(AttemptKind::Repair, t, &around)
    }

    /// Repairs a tetrahedron in the mesh itself. Returns `false`, and records it, if that fails.
    pub(super) fn repair_in_place(&mut self, t: u32) -> bool {
        let repaired = self.repair_one(t);
        if !repaired {
            self.attempts.record_failure(AttemptKind::Repair, t);
        }
        repaired
    }

    /// Returns the centroid of a tetrahedron, and d there.
    pub(super) fn centre_and_spacing(&self, t: u32) -> ([f64; 3], f64) {
        let p = self.complex.corners(t);
        let middle = std::array::from_fn(|k| p.iter().map(|x| x[k]).sum::<f64>() / 4.0);
        (middle, self.distance.value_at(middle))
    }

    /// Tries all operations that may repair a tetrahedron, until one succeeds.
    pub(super) fn repair_one(&mut self, t: u32) -> bool {
        let tet = self.complex.tets[t as usize];
        let (_, d) = self.centre_and_spacing(t);
        let length = |s: &Self, a: u32, b: u32| {
            norm(sub(
                s.complex.nodes[a as usize],
                s.complex.nodes[b as usize],
            )) / d
        };
        for k in 0..4 {
            if self.attempt(|s| s.force_split_face(t, k)) {
                self.counts.flips += 1;
                return true;
            }
        }
        if self.attempt(|s| s.insert_centre(t, &tet)) {
            self.counts.insertions += 1;
            return true;
        }
        for [i, j] in EDGES {
            let (a, b) = (tet[i], tet[j]);
            if length(self, a, b) > MAX_COLLAPSE_LENGTH {
                continue;
            }
            for (removed, kept) in [(a, b), (b, a)] {
                if self.attempt(|s| s.collapse(removed, kept, MIN_SINE)) {
                    self.counts.collapses += 1;
                    return true;
                }
            }
        }
        for [i, j] in EDGES {
            let (a, b) = (tet[i], tet[j]);
            if length(self, a, b) > MIN_SPLIT_LENGTH && self.attempt(|s| s.split_at_middle(t, a, b))
            {
                self.counts.insertions += 1;
                return true;
            }
        }
        for face in FACES {
            if self.attempt(|s| s.insert_centre(t, &face.map(|i| tet[i]))) {
                self.counts.insertions += 1;
                return true;
            }
        }
        false
    }

    /// Inserts a node in the middle of tetrahedron `t` or of one of its faces, whose `nodes` are
    /// given, and joins it with the tetrahedra around.
    fn insert_centre(&mut self, t: u32, nodes: &[u32]) -> bool {
        // In a face on a side of the box or on a feature, the node would need constraints.
        let position = |n: u32| self.complex.nodes[n as usize];
        let is_shared = |normal| {
            nodes.iter().all(|&n| {
                let displacement = sub(position(n), position(nodes[0]));
                self.constraints[n as usize].shares_surface(normal, displacement)
            })
        };
        let first = self.constraints[nodes[0] as usize];
        let mut normals = first.normals();
        if self.is_in_side(nodes) || nodes.len() == 3 && normals.any(is_shared) {
            return false;
        }
        let x: [f64; 3] = std::array::from_fn(|k| {
            let sum: f64 = (nodes.iter())
                .map(|&n| self.complex.nodes[n as usize][k])
                .sum();
            sum / nodes.len() as f64
        });
        let constraint = NodeConstraint {
            is_far: self.planes.is_far(x),
            ..NodeConstraint::default()
        };
        let node = self.complex.add_node(x);
        self.constraints.push(constraint);
        let Some(cavity) = self.cavity(t, node, true, MIN_SINE) else {
            return false;
        };
        let rim = sorted_distinct(self.new_tets.iter().flatten().copied());
        let min_distance = MIN_NODE_DISTANCE * self.distance.value_at(x);
        let is_near = |n: u32| norm(sub(self.complex.nodes[n as usize], x)) < min_distance;
        if (rim.iter()).any(|&n| n != node && (is_near(n) || self.intersects(n, node))) {
            return false;
        }
        self.moved_nodes.push(node);
        self.commit(&cavity);
        true
    }

    /// Applies a change, repairs the mesh around it, and keeps both only if the worst of the
    /// changed tetrahedra has become better.
    fn attempt(&mut self, change: impl FnOnce(&mut Self) -> bool) -> bool {
        if self.complex.has_reached_nonlocal() {
            return false;
        }
        self.complex.begin();
        self.attempts.begin();
        self.undo = Some(TransactionLog {
            node_count: self.complex.nodes.len(),
            touched: std::mem::take(&mut self.touched),
            ..TransactionLog::default()
        });
        let outer_queue = std::mem::take(&mut self.queue);
        let changed = change(self);
        if changed {
            self.repair_around();
        }
        let inner_queue = std::mem::replace(&mut self.queue, outer_queue);
        let mut undo = self.undo.take().unwrap_or_default();
        self.touched = undo.take_touched();
        let old_sine = undo.slots.iter().map(|s| s.1).fold(f32::INFINITY, f32::min);
        let new_sine = undo
            .slots
            .iter()
            .filter(|s| self.complex.is_alive(s.0))
            .map(|s| self.sines[s.0 as usize])
            .fold(f32::INFINITY, f32::min);
        let target = self.target_sine as f32;
        let better = new_sine > old_sine + MIN_SINE_GAIN || new_sine >= target && old_sine < target;
        if changed && better && !self.complex.has_reached_nonlocal() {
            self.complex.commit();
            self.attempts.commit();
            self.queue.extend(inner_queue);
            return true;
        }
        self.complex.rollback();
        self.attempts.rollback();
        for (t, sine) in undo.slots {
            self.sines[t as usize] = sine;
        }
        self.sines.truncate(self.complex.tets.len());
        for (node, x, constraint) in undo.nodes.into_iter().rev() {
            self.complex.nodes[node as usize] = x;
            self.constraints[node as usize] = constraint;
        }
        self.complex.truncate_nodes(undo.node_count);
        self.constraints.truncate(undo.node_count);
        false
    }

    /// Flips and smooths where the change left tetrahedra below target.
    fn repair_around(&mut self) {
        let mut nodes = Vec::new();
        self.smoothing_target = self.target_sine + SMOOTHING_MARGIN;
        for round in 0..3 {
            let mut touched: Vec<u32> = self.queue.clone();
            self.flip_queue(&CancelToken::never());
            touched.extend_from_slice(&self.queue);
            if round == 0 {
                touched.extend(self.undo.iter().flat_map(|u| u.slots.iter().map(|s| s.0)));
            }
            nodes.clear();
            for &t in &touched {
                if self.complex.is_alive(t) && self.sine_of(t) < self.target_sine {
                    nodes.extend_from_slice(&self.complex.tets[t as usize]);
                }
            }
            nodes.sort_unstable();
            nodes.dedup();
            if nodes.is_empty() || nodes.len() > 60 {
                break;
            }
            for &node in &nodes {
                self.smooth(node);
            }
            if self.queue.is_empty() {
                break;
            }
        }
    }

    /// Exchanges the two tetrahedra at face k of `t` for the three around a new edge, even if that
    /// makes the smallest sine worse.
    fn force_split_face(&mut self, t: u32, k: usize) -> bool {
        let tet = self.complex.tets[t as usize];
        self.complex.neighbour(t, k).is_some_and(|n| {
            let back = self.complex.neighbours[n as usize]
                .iter()
                .position(|&x| x == t);
            back.is_some_and(|back| {
                let q = self.complex.tets[n as usize][back];
                self.swap_face([t, n], FACES[k].map(|i| tet[i]), [tet[k], q], MIN_SINE)
            })
        })
    }

    /// Splits edge (a, b) of `t` at its middle, moved onto the surfaces that hold both ends.
    fn split_at_middle(&mut self, t: u32, a: u32, b: u32) -> bool {
        let (p, q) = (
            self.complex.nodes[a as usize],
            self.complex.nodes[b as usize],
        );
        let (ha, hb) = (self.constraints[a as usize], self.constraints[b as usize]);
        let mut constraint = NodeConstraint {
            fixed_axes: self.common_sides(&[a, b]),
            ..NodeConstraint::default()
        };
        for normal in (ha.normals()).filter(|&n| hb.shares_surface(n, sub(q, p))) {
            constraint.add_surface(normal);
        }
        let middle = std::array::from_fn(|k| 0.5 * (p[k] + q[k]));
        constraint
            .snap(middle, self.extent, self.planes)
            .is_some_and(|x| self.split_edge(t, a, b, x, constraint, MIN_SINE))
    }
}

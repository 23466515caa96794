//! For the tetrahedra that flips and smoothing cannot mend: a split, a collapse or a swap that by
//! itself makes things worse, followed by flips and smoothing around it, and kept only if the worst
//! tetrahedron of all that was touched has become better.

use super::attempt_cache::AttemptKind;
use super::{NodeConstraint, SMOOTHING_MARGIN, TetImprover};
use crate::Result;
use crate::geometry::{norm, sub};
use crate::improve::target::UNUSABLE_ANGLE;
use crate::mesh::{EDGES, FACES};
use crate::progress::CancelToken;

/// A split, collapse or swap must at least leave tetrahedra with volume.
const MIN_SINE: f64 = 0.01;

/// Least gain in sine, where target is not reached.
const MIN_SINE_GAIN: f32 = 2e-3;

/// Longest edge that may be collapsed and shortest that may be split, over d: the lattice keeps its
/// spacing.
const MAX_COLLAPSE_LENGTH: f64 = 0.85;
const MIN_SPLIT_LENGTH: f64 = 0.95;

/// A node put into a tetrahedron keeps this distance, over d, from others: about what it has in the
/// middle of a face of a regular one.
const MIN_NODE_DISTANCE: f64 = 0.5;

/// So many tetrahedra, or one in a hundred if that is more, are worked on in a round ...
const MAX_TETS_PER_ROUND: usize = 1000;
/// ... of which there are so many at most.
const MAX_ROUNDS: usize = 4;

/// What a transaction has overwritten, beside the complex's own journal.
#[derive(Debug, Default)]
pub(super) struct TransactionLog {
    /// Slots in the order of their first touch, with the sine they had.
    slots: Vec<(u32, f32)>,
    /// Whether a slot is among them; no more slots than have been touched ever.
    touched: Vec<bool>,
    pub(super) nodes: Vec<(u32, [f64; 3], NodeConstraint)>,
    node_count: usize,
}

impl TransactionLog {
    /// Its memory of what was touched, for the next transaction: with nothing in it.
    fn take_touched(&mut self) -> Vec<bool> {
        for (t, _) in &self.slots {
            self.touched[*t as usize] = false;
        }
        std::mem::take(&mut self.touched)
    }

    /// Remembers what slots hold, unless it is remembered already.
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
    /// Works on the tetrahedra below target, the worst first.
    ///
    /// # Errors
    /// Those of other ranks, with which the work is shared.
    pub(super) fn repair(&mut self, patience: &CancelToken<'_>) -> Result<()> {
        // Each round halves what is left, as a guess.
        let mut left = 1.0;
        for _ in 0..MAX_ROUNDS {
            let mut poor = self.tets_below_target();
            poor.sort_by(|a, b| self.sine_of(*a).total_cmp(&self.sine_of(*b)).then(a.cmp(b)));
            let before = poor.len();
            // Where features ask for what no lattice can do, patience must end.
            poor.truncate(self.max_tets_per_round());
            let reached = |share| patience.set_fraction(1.0 - left * (1.0 - 0.5 * share));
            self.repair_each(&poor, patience, reached)?;
            left *= 0.5;
            self.flip_and_smooth(2, patience)?;
            if self.tets_below_target().len() >= before {
                break;
            }
        }
        Ok(())
    }

    /// How many tetrahedra are worked on in a round.
    fn max_tets_per_round(&self) -> usize {
        MAX_TETS_PER_ROUND.max(self.complex.tets.len() / 100)
    }

    /// Whether so many are poor that not all are worked on.
    pub(super) fn has_too_many(&self, poor: usize) -> bool {
        poor > MAX_ROUNDS * self.max_tets_per_round()
    }

    /// Lets nodes leave their features where a tetrahedron would otherwise stay unusable.
    ///
    /// # Errors
    /// Those of other ranks, with which the work is shared.
    pub(super) fn release_nodes(&mut self, patience: &CancelToken<'_>) -> Result<()> {
        let usable = UNUSABLE_ANGLE.to_radians().sin();
        for _ in 0..4 {
            let mut bad = self.tets_below_target();
            bad.retain(|&t| self.sine_of(t) < usable);
            if bad.is_empty() {
                break;
            }
            for t in bad {
                if patience.is_cancelled() {
                    return Ok(());
                }
                if !self.complex.is_alive(t)
                    || self.sine_of(t) >= usable
                    || !self.is_known_to_fail(t) && self.repair_in_place(t)
                {
                    continue;
                }
                let tet = self.complex.tets[t as usize];
                let one = (0..4).any(|k| self.attempt(|s| s.free_nodes(t, &tet[k..=k])));
                if one || self.attempt(|s| s.free_nodes(t, &tet)) {
                    self.counts.released += 1;
                }
            }
            self.flip_and_smooth(2, patience)?;
        }
        Ok(())
    }

    /// Frees nodes of tetrahedron `t` from the features that hold them.
    fn free_nodes(&mut self, t: u32, nodes: &[u32]) -> bool {
        let mut any = false;
        for &node in nodes {
            let i = node as usize;
            let (x, hold) = (self.complex.nodes[i], self.constraints[i]);
            if hold.surface_count > 0 {
                if let Some(undo) = &mut self.undo {
                    undo.nodes.push((node, x, hold));
                }
                self.constraints[i].clear_surfaces();
                self.attempts.record_change(self.complex.tets[t as usize]);
                any = true;
            }
        }
        self.measure(t);
        any
    }

    /// Whether mending a tetrahedron was in vain, and nothing has changed at its neighbours since.
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
            .is_known_to_fail(AttemptKind::Mend, t, &around)
    }

    /// Mends a tetrahedron in the mesh itself; false if that fails, and is known to.
    pub(super) fn repair_in_place(&mut self, t: u32) -> bool {
        let mended = self.repair_one(t);
        if !mended {
            self.attempts.record_failure(AttemptKind::Mend, t);
        }
        mended
    }

    /// The middle of a tetrahedron, and d there.
    pub(super) fn centre_and_spacing(&self, t: u32) -> ([f64; 3], f64) {
        let p = self.complex.corners(t);
        let middle = std::array::from_fn(|k| p.iter().map(|x| x[k]).sum::<f64>() / 4.0);
        (middle, self.distance.value_at(middle))
    }

    /// Tries all that may mend a tetrahedron, until something does.
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
            for (gone, kept) in [(a, b), (b, a)] {
                if self.attempt(|s| s.collapse(gone, kept, MIN_SINE)) {
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

    /// Puts a node into the middle of tetrahedron `t`, or of one of its faces, and joins it anew with
    /// what is around.
    fn insert_centre(&mut self, t: u32, middle_of: &[u32]) -> bool {
        // In a face on a side of the box, or on a feature, the node would have to stay.
        let shared = |normal| {
            middle_of
                .iter()
                .all(|&n| self.constraints[n as usize].is_on_surface(normal))
        };
        let first = self.constraints[middle_of[0] as usize];
        let mut normals = first.normals();
        if self.is_in_side(middle_of) || middle_of.len() == 3 && normals.any(shared) {
            return false;
        }
        let x: [f64; 3] = std::array::from_fn(|k| {
            let sum: f64 = (middle_of.iter())
                .map(|&n| self.complex.nodes[n as usize][k])
                .sum();
            sum / middle_of.len() as f64
        });
        let hold = NodeConstraint {
            is_far: self.planes.is_far(x),
            ..NodeConstraint::default()
        };
        let new = self.complex.add_node(x);
        self.constraints.push(hold);
        let Some(cavity) = self.cavity(t, new, true, MIN_SINE) else {
            return false;
        };
        let mut rim: Vec<u32> = self.new_tets.iter().flatten().copied().collect();
        rim.sort_unstable();
        rim.dedup();
        let room = MIN_NODE_DISTANCE * self.distance.value_at(x);
        let near = |n: u32| norm(sub(self.complex.nodes[n as usize], x)) < room;
        if (rim.iter()).any(|&n| n != new && (near(n) || self.intersects(n, new))) {
            return false;
        }
        self.moved_nodes.push(new);
        self.commit(&cavity);
        true
    }

    /// Makes a change, mends around it, and keeps it all only if the worst tetrahedron of what was
    /// touched has become better.
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
        let outside = std::mem::take(&mut self.queue);
        let changed = change(self);
        if changed {
            self.repair_around();
        }
        let inside = std::mem::replace(&mut self.queue, outside);
        let mut undo = self.undo.take().unwrap_or_default();
        self.touched = undo.take_touched();
        let before = undo.slots.iter().map(|s| s.1).fold(f32::INFINITY, f32::min);
        let after = undo
            .slots
            .iter()
            .filter(|s| self.complex.is_alive(s.0))
            .map(|s| self.sines[s.0 as usize])
            .fold(f32::INFINITY, f32::min);
        let target = self.target_sine as f32;
        let better = after > before + MIN_SINE_GAIN || after >= target && before < target;
        if changed && better && !self.complex.has_reached_nonlocal() {
            self.complex.commit();
            self.attempts.commit();
            self.queue.extend(inside);
            return true;
        }
        self.complex.rollback();
        self.attempts.rollback();
        for (t, sine) in undo.slots {
            self.sines[t as usize] = sine;
        }
        self.sines.truncate(self.complex.tets.len());
        for (node, x, hold) in undo.nodes.into_iter().rev() {
            self.complex.nodes[node as usize] = x;
            self.constraints[node as usize] = hold;
        }
        self.complex.truncate_nodes(undo.node_count);
        self.constraints.truncate(undo.node_count);
        false
    }

    /// Flips and smoothing of what the change left below target.
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

    fn force_split_face(&mut self, t: u32, k: usize) -> bool {
        let tet = self.complex.tets[t as usize];
        self.complex.neighbor(t, k).is_some_and(|n| {
            let back = self.complex.neighbors[n as usize]
                .iter()
                .position(|&x| x == t);
            back.is_some_and(|back| {
                let q = self.complex.tets[n as usize][back];
                self.swap_face([t, n], FACES[k].map(|i| tet[i]), [tet[k], q], MIN_SINE)
            })
        })
    }

    fn split_at_middle(&mut self, t: u32, a: u32, b: u32) -> bool {
        let (p, q) = (
            self.complex.nodes[a as usize],
            self.complex.nodes[b as usize],
        );
        let (ha, hb) = (self.constraints[a as usize], self.constraints[b as usize]);
        let mut hold = NodeConstraint {
            fixed_axes: self.common_sides(&[a, b]),
            ..NodeConstraint::default()
        };
        for normal in ha.normals().filter(|&n| hb.is_on_surface(n)) {
            hold.add_surface(normal);
        }
        let middle = std::array::from_fn(|k| 0.5 * (p[k] + q[k]));
        hold.snap(middle, self.extent, self.planes)
            .is_some_and(|x| self.split_edge(t, a, b, x, hold, MIN_SINE))
    }
}

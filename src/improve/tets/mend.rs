//! For the tetrahedra that flips and smoothing cannot mend: a split, a collapse or a swap that by
//! itself makes things worse, followed by flips and smoothing around it, and kept only if the worst
//! tetrahedron of all that was touched has become better.

use super::memory::Trial;
use super::{Hold, Improver, MARGIN};
use crate::Result;
use crate::geometry::{norm, sub};
use crate::improve::target::UNUSABLE;
use crate::mesh::{EDGES, FACES};
use crate::observer::Patience;

/// A split, collapse or swap must at least leave tetrahedra with volume.
const FLOOR: f64 = 0.01;

/// Least gain in sine, where target is not reached.
const GAIN: f32 = 2e-3;

/// Longest edge that may be collapsed and shortest that may be split, over d: the lattice keeps its
/// spacing.
const LONGEST_COLLAPSE: f64 = 0.85;
const SHORTEST_SPLIT: f64 = 0.95;

/// A node put into a tetrahedron keeps this distance, over d, from others: about what it has in the
/// middle of a face of a regular one.
const ROOM: f64 = 0.5;

/// So many tetrahedra, or one in a hundred if that is more, are worked on in a round ...
const PATIENCE: usize = 1000;
/// ... of which there are so many at most.
const TURNS: usize = 4;

/// What a transaction has overwritten, beside the complex's own journal.
#[derive(Debug, Default)]
pub(super) struct Undo {
    /// Slots in the order of their first touch, with the sine they had.
    slots: Vec<(u32, f32)>,
    /// Whether a slot is among them; no more slots than have been touched ever.
    touched: Vec<bool>,
    pub(super) nodes: Vec<(u32, [f64; 3], Hold)>,
    node_count: usize,
}

impl Undo {
    /// Its memory of what was touched, for the next transaction: with nothing in it.
    fn forget(&mut self) -> Vec<bool> {
        for (t, _) in &self.slots {
            self.touched[*t as usize] = false;
        }
        std::mem::take(&mut self.touched)
    }

    /// Remembers what slots hold, unless it is remembered already.
    pub(super) fn touch(&mut self, slots: &[u32], sines: &[f32]) {
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

impl Improver<'_> {
    /// Works on the tetrahedra below target, the worst first.
    ///
    /// # Errors
    /// Those of other ranks, with which the work is shared.
    pub(super) fn mend(&mut self, patience: &Patience<'_>) -> Result<()> {
        // Each round halves what is left, as a guess.
        let mut left = 1.0;
        for _ in 0..TURNS {
            let mut poor = self.poor();
            poor.sort_by(|a, b| self.sine_of(*a).total_cmp(&self.sine_of(*b)).then(a.cmp(b)));
            let before = poor.len();
            // Where features ask for what no lattice can do, patience must end.
            poor.truncate(self.most());
            let reached = |share| patience.reached(1.0 - left * (1.0 - 0.5 * share));
            self.mend_each(&poor, patience, reached)?;
            left *= 0.5;
            self.polish(2, patience)?;
            if self.poor().len() >= before {
                break;
            }
        }
        Ok(())
    }

    /// How many tetrahedra are worked on in a round.
    fn most(&self) -> usize {
        PATIENCE.max(self.complex.tets.len() / 100)
    }

    /// Whether so many are poor that not all are worked on.
    pub(super) fn too_many(&self, poor: usize) -> bool {
        poor > TURNS * self.most()
    }

    /// Lets nodes leave their features where a tetrahedron would otherwise stay unusable.
    ///
    /// # Errors
    /// Those of other ranks, with which the work is shared.
    pub(super) fn release(&mut self, patience: &Patience<'_>) -> Result<()> {
        let usable = UNUSABLE.to_radians().sin();
        for _ in 0..4 {
            let mut bad = self.poor();
            bad.retain(|&t| self.sine_of(t) < usable);
            if bad.is_empty() {
                break;
            }
            for t in bad {
                if patience.over() {
                    return Ok(());
                }
                if !self.complex.alive(t)
                    || self.sine_of(t) >= usable
                    || !self.in_vain(t) && self.mend_here(t)
                {
                    continue;
                }
                let tet = self.complex.tets[t as usize];
                let one = (0..4).any(|k| self.attempt(|s| s.let_go(t, &tet[k..=k])));
                if one || self.attempt(|s| s.let_go(t, &tet)) {
                    self.counts.released += 1;
                }
            }
            self.polish(2, patience)?;
        }
        Ok(())
    }

    /// Frees nodes of tetrahedron `t` from the features that hold them.
    fn let_go(&mut self, t: u32, nodes: &[u32]) -> bool {
        let mut any = false;
        for &node in nodes {
            let i = node as usize;
            let (x, hold) = (self.complex.nodes[i], self.holds[i]);
            if hold.count > 0 {
                if let Some(undo) = &mut self.undo {
                    undo.nodes.push((node, x, hold));
                }
                self.holds[i].clear_sheets();
                self.memory.change(self.complex.tets[t as usize]);
                any = true;
            }
        }
        self.measure(t);
        any
    }

    /// Whether mending a tetrahedron was in vain, and nothing has changed at its neighbours since.
    pub(super) fn in_vain(&mut self, t: u32) -> bool {
        let mut around = Vec::new();
        for node in self.complex.tets[t as usize] {
            self.complex.star(node, &mut self.star);
            around.extend(
                self.star
                    .iter()
                    .flat_map(|&t| self.complex.tets[t as usize]),
            );
        }
        self.memory.in_vain(Trial::Mend, t, &around)
    }

    /// Mends a tetrahedron in the mesh itself; false if that fails, and is known to.
    pub(super) fn mend_here(&mut self, t: u32) -> bool {
        let mended = self.mend_one(t);
        if !mended {
            self.memory.failed(Trial::Mend, t);
        }
        mended
    }

    /// The middle of a tetrahedron, and d there.
    pub(super) fn middle(&self, t: u32) -> ([f64; 3], f64) {
        let p = self.complex.corners(t);
        let middle = std::array::from_fn(|k| p.iter().map(|x| x[k]).sum::<f64>() / 4.0);
        (middle, self.distance.at(middle))
    }

    /// Tries all that may mend a tetrahedron, until something does.
    pub(super) fn mend_one(&mut self, t: u32) -> bool {
        let tet = self.complex.tets[t as usize];
        let (_, d) = self.middle(t);
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
        if self.attempt(|s| s.put_in(t, &tet)) {
            self.counts.insertions += 1;
            return true;
        }
        for [i, j] in EDGES {
            let (a, b) = (tet[i], tet[j]);
            if length(self, a, b) > LONGEST_COLLAPSE {
                continue;
            }
            for (gone, kept) in [(a, b), (b, a)] {
                if self.attempt(|s| s.collapse(gone, kept, FLOOR)) {
                    self.counts.collapses += 1;
                    return true;
                }
            }
        }
        for [i, j] in EDGES {
            let (a, b) = (tet[i], tet[j]);
            if length(self, a, b) > SHORTEST_SPLIT
                && self.attempt(|s| s.split_in_the_middle(t, a, b))
            {
                self.counts.insertions += 1;
                return true;
            }
        }
        for face in FACES {
            if self.attempt(|s| s.put_in(t, &face.map(|i| tet[i]))) {
                self.counts.insertions += 1;
                return true;
            }
        }
        false
    }

    /// Puts a node into the middle of tetrahedron `t`, or of one of its faces, and joins it anew with
    /// what is around.
    fn put_in(&mut self, t: u32, middle_of: &[u32]) -> bool {
        // In a face on a side of the box, or on a feature, the node would have to stay.
        let shared = |normal| middle_of.iter().all(|&n| self.holds[n as usize].on(normal));
        let first = self.holds[middle_of[0] as usize];
        let mut normals = first.normals();
        if self.in_side(middle_of) || middle_of.len() == 3 && normals.any(shared) {
            return false;
        }
        let x: [f64; 3] = std::array::from_fn(|k| {
            let sum: f64 = (middle_of.iter())
                .map(|&n| self.complex.nodes[n as usize][k])
                .sum();
            sum / middle_of.len() as f64
        });
        let hold = Hold {
            far: self.sheets.far(x),
            ..Hold::default()
        };
        let new = self.complex.add_node(x);
        self.holds.push(hold);
        let Some(cavity) = self.cavity(t, new, true, FLOOR) else {
            return false;
        };
        let mut rim: Vec<u32> = self.fresh.iter().flatten().copied().collect();
        rim.sort_unstable();
        rim.dedup();
        let room = ROOM * self.distance.at(x);
        let near = |n: u32| norm(sub(self.complex.nodes[n as usize], x)) < room;
        if (rim.iter()).any(|&n| n != new && (near(n) || self.pierces(n, new))) {
            return false;
        }
        self.stirred.push(new);
        self.commit(&cavity);
        true
    }

    /// Makes a change, mends around it, and keeps it all only if the worst tetrahedron of what was
    /// touched has become better.
    fn attempt(&mut self, change: impl FnOnce(&mut Self) -> bool) -> bool {
        if self.complex.has_left() {
            return false;
        }
        self.complex.begin();
        self.memory.begin();
        self.undo = Some(Undo {
            node_count: self.complex.nodes.len(),
            touched: std::mem::take(&mut self.touched),
            ..Undo::default()
        });
        let outside = std::mem::take(&mut self.queue);
        let changed = change(self);
        if changed {
            self.mend_around();
        }
        let inside = std::mem::replace(&mut self.queue, outside);
        let mut undo = self.undo.take().unwrap_or_default();
        self.touched = undo.forget();
        let before = undo.slots.iter().map(|s| s.1).fold(f32::INFINITY, f32::min);
        let after = undo
            .slots
            .iter()
            .filter(|s| self.complex.alive(s.0))
            .map(|s| self.sines[s.0 as usize])
            .fold(f32::INFINITY, f32::min);
        let target = self.target as f32;
        let better = after > before + GAIN || after >= target && before < target;
        if changed && better && !self.complex.has_left() {
            self.complex.keep();
            self.memory.keep();
            self.queue.extend(inside);
            return true;
        }
        self.complex.take_back();
        self.memory.take_back();
        for (t, sine) in undo.slots {
            self.sines[t as usize] = sine;
        }
        self.sines.truncate(self.complex.tets.len());
        for (node, x, hold) in undo.nodes.into_iter().rev() {
            self.complex.nodes[node as usize] = x;
            self.holds[node as usize] = hold;
        }
        self.complex.forget_nodes(undo.node_count);
        self.holds.truncate(undo.node_count);
        false
    }

    /// Flips and smoothing of what the change left below target.
    fn mend_around(&mut self) {
        let mut nodes = Vec::new();
        self.enough = self.target + MARGIN;
        for round in 0..3 {
            let mut touched: Vec<u32> = self.queue.clone();
            self.flip_queue(&Patience::endless());
            touched.extend_from_slice(&self.queue);
            if round == 0 {
                touched.extend(self.undo.iter().flat_map(|u| u.slots.iter().map(|s| s.0)));
            }
            nodes.clear();
            for &t in &touched {
                if self.complex.alive(t) && self.sine_of(t) < self.target {
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
        self.complex.across(t, k).is_some_and(|n| {
            let back = self.complex.neighbors[n as usize]
                .iter()
                .position(|&x| x == t);
            back.is_some_and(|back| {
                let q = self.complex.tets[n as usize][back];
                self.swap_face([t, n], FACES[k].map(|i| tet[i]), [tet[k], q], FLOOR)
            })
        })
    }

    fn split_in_the_middle(&mut self, t: u32, a: u32, b: u32) -> bool {
        let (p, q) = (
            self.complex.nodes[a as usize],
            self.complex.nodes[b as usize],
        );
        let (ha, hb) = (self.holds[a as usize], self.holds[b as usize]);
        let mut hold = Hold {
            axes: self.common_sides(&[a, b]),
            ..Hold::default()
        };
        for normal in ha.normals().filter(|&n| hb.on(n)) {
            hold.add(normal);
        }
        let middle = std::array::from_fn(|k| 0.5 * (p[k] + q[k]));
        hold.settle(middle, self.extent, self.sheets)
            .is_some_and(|x| self.split_edge(t, a, b, x, hold, FLOOR))
    }
}

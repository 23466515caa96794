//! Many tetrahedra mended at once, those near one another in a copy of what is round them: a patch. Meanwhile the mesh
//! stays as it is; then it is changed as the patches were. So what becomes of it does not depend on how many are at
//! work, or where: ranks share them.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use crate::parallel::prelude::*;

use super::memory::Trial;
use super::{Improver, Place};
use crate::files::kept::fields;
use crate::geometry::{dot, sub};
use crate::improve::Counts;
use crate::mesh::complex::{Complex, NONE, Numbers};
use crate::observer::Patience;
use crate::{Result, ranks};

/// A patch has all tetrahedra at the nodes so near to the middle of one that is mended there, over d. What asks for
/// more, as few do, is mended in the mesh itself.
const REACH: f64 = 3.5;
/// Edge of a cube, over the largest d of what is mended in it: patches of two cubes with one between them do not meet,
/// as tetrahedra go some 1.3 d beyond the nodes that they have there.
const CUBE: f64 = 2.0 * (REACH + 1.3);
/// What is mended at the same time has about the same d: cubes shrink by this with it.
const SHRINK: f64 = std::f64::consts::SQRT_2;

/// With fewer cubes there is little to do at the same time, and to mend the poorest of all first is less work and leaves
/// fewer poor.
const FEW: usize = 64;

/// What becomes of tetrahedra whose middles are in one cube.
struct Patch<'a> {
    numbers: Numbers,
    improver: Improver<'a>,
}

/// What became of a patch. Numbers are those of the mesh; a node that is not there yet is `NONE` less its number
/// among the new ones.
struct Tried {
    /// What it depends on: nodes.
    nodes: Vec<u32>,
    /// The tetrahedra that it was too small for.
    beyond: Vec<u32>,
    /// Those that nothing mends.
    in_vain: Vec<u32>,
    change: Change,
}

struct Change {
    /// Tetrahedra that go, and those that take their place.
    gone: Vec<u32>,
    made: Vec<[u32; 4]>,
    /// Nodes that move, and to where.
    moved: Vec<(u32, Place)>,
    new: Vec<Place>,
    counts: Counts,
}

/// A cube, by how often its edge has shrunk and its number along each axis, and tetrahedra in it.
pub(super) type Cube = ((u32, [u32; 3]), Vec<u32>);

fields! {
    Tried as Tried { nodes, beyond, in_vain, change }
    Change as Change { gone, made, moved, new, counts }
}

impl<'a> Improver<'a> {
    /// Mends tetrahedra: in patches if there are enough, the first ones first otherwise and in each; tells how far it
    /// is.
    ///
    /// # Errors
    /// Those of [`ranks::share`].
    pub(super) fn mend_each(
        &mut self,
        poor: &[u32],
        patience: &Patience<'_>,
        reached: impl Fn(f64),
    ) -> Result<()> {
        let d = |&t: &u32| self.middle(t).1;
        let edge = CUBE * poor.iter().map(d).fold(0.0, f64::max);
        let apart = self.cubes(poor, edge);
        let (done, later) = match apart.iter().flatten().count() < FEW {
            true => (0.0, poor.to_vec()),
            false => (1.0, self.mend_apart(apart, edge, patience, &reached)?),
        };
        let count = later.len() as f64;
        for (number, t) in later.into_iter().enumerate() {
            reached((number as f64 / count).max(done));
            if patience.over() {
                break;
            }
            if self.is_poor(t) && !self.in_vain(t) {
                self.mend_here(t);
            }
        }
        Ok(())
    }

    /// Mends tetrahedra in patches, those of each cube in one; gives those for which patches were too small.
    pub(super) fn mend_apart(
        &mut self,
        apart: Vec<Vec<Cube>>,
        edge: f64,
        patience: &Patience<'_>,
        reached: &impl Fn(f64),
    ) -> Result<Vec<u32>> {
        let pool = Mutex::new(Vec::new());
        let mut later = Vec::new();
        let phases = apart.len() as f64;
        for (phase, mut cubes) in apart.into_iter().enumerate() {
            reached(phase as f64 / phases);
            // Numbers of tetrahedra that went are those of others now, which may be anywhere.
            for (cube, tets) in &mut cubes {
                tets.retain(|&t| self.is_poor(t) && self.cube(t, edge) == *cube);
            }
            let mut all = Vec::with_capacity(cubes.len());
            let work = |own: Range<usize>, give: &mut dyn FnMut(Tried)| {
                let tried: Vec<Tried> = cubes[own]
                    .par_iter()
                    .with_max_len(1)
                    .map(|(_, tets)| self.try_apart(tets, &pool, patience))
                    .collect();
                tried.into_iter().for_each(give);
                Ok(())
            };
            let much: Vec<usize> = cubes.iter().map(|(_, tets)| tets.len()).collect();
            match self.alone {
                true => work(0..cubes.len(), &mut |tried| all.push(tried))?,
                false => {
                    ranks::share_fairly("patches", &much, work, &mut |tried| all.push(tried))?;
                }
            }
            let begun = self.memory.now();
            for ((_, tets), tried) in cubes.into_iter().zip(all) {
                if self.memory.has_changed(begun, &tried.nodes) {
                    later.extend(tets);
                    continue;
                }
                self.make_change(&tried.change);
                for t in tried.in_vain {
                    self.memory.failed(Trial::Mend, t);
                }
                later.extend(tried.beyond);
            }
        }
        Ok(later)
    }

    pub(super) fn is_poor(&self, t: u32) -> bool {
        self.complex.alive(t)
            && self.sine_of(t) < self.target
            && self.looks_at(&self.complex.tets[t as usize])
    }

    /// The cube that the middle of a tetrahedron is in, where the largest have this edge.
    fn cube(&self, t: u32, edge: f64) -> (u32, [u32; 3]) {
        let (middle, d) = self.middle(t);
        let shrunk = (edge / (CUBE * d)).log(SHRINK).max(0.0).floor();
        let edge = edge / SHRINK.powf(shrunk);
        (shrunk as u32, middle.map(|c| (c / edge) as u32))
    }

    /// Tetrahedra by their cubes; groups of cubes of which no two patches meet.
    pub(super) fn cubes(&self, tets: &[u32], edge: f64) -> Vec<Vec<Cube>> {
        let mut cubes: BTreeMap<(u32, [u32; 3]), Vec<u32>> = BTreeMap::new();
        for &t in tets.iter().filter(|&&t| self.is_poor(t)) {
            cubes.entry(self.cube(t, edge)).or_default().push(t);
        }
        let mut apart: BTreeMap<(u32, [u32; 3]), Vec<Cube>> = BTreeMap::new();
        for (cube, tets) in cubes {
            let (shrunk, place) = cube;
            let group = (shrunk, place.map(|c| c % 2));
            apart.entry(group).or_default().push((cube, tets));
        }
        apart.into_values().collect()
    }

    /// Mends tetrahedra in a copy of what is round them.
    fn try_apart(
        &self,
        tets: &[u32],
        pool: &Mutex<Vec<Patch<'a>>>,
        patience: &Patience<'_>,
    ) -> Tried {
        let lock = || pool.lock().unwrap_or_else(PoisonError::into_inner);
        let taken = lock().pop();
        let mut patch = taken.unwrap_or_else(|| Patch {
            numbers: Numbers::default(),
            improver: Self::empty(self.extent, self.sheets, self.distance, self.target),
        });
        let tried = patch.try_in(self, tets, patience);
        lock().push(patch);
        tried
    }

    /// Changes the mesh as a patch was.
    fn make_change(&mut self, change: &Change) {
        let first = self.complex.nodes.len() as u32;
        let number = |n: u32| match NONE - n {
            new if (new as usize) < change.new.len() => first + new,
            _ => n,
        };
        for &(x, hold) in &change.new {
            let node = self.complex.add_node(x);
            self.holds.push(hold);
            self.stirred.push(node);
        }
        for &(node, (x, hold)) in &change.moved {
            self.complex.nodes[node as usize] = x;
            self.holds[node as usize] = hold;
            if !hold.far {
                self.stirred.push(node);
            }
        }
        self.fresh.clear();
        let made = change.made.iter().map(|tet| tet.map(number));
        self.fresh.extend(made);
        self.commit(&change.gone);
        for &(node, _) in &change.moved {
            self.complex.star(node, &mut self.star);
            self.measure_star();
        }
        self.counts += change.counts;
    }
}

impl<'a> Patch<'a> {
    fn try_in(&mut self, whole: &Improver<'a>, tets: &[u32], patience: &Patience<'_>) -> Tried {
        let (numbers, part) = (&mut self.numbers, &mut self.improver);
        let balls: Vec<([f64; 3], f64)> = tets
            .iter()
            .map(|&t| {
                let (middle, d) = whole.middle(t);
                (middle, (REACH * d).powi(2))
            })
            .collect();
        let holds = |x| {
            let within = |&(middle, square): &([f64; 3], f64)| {
                let away = sub(x, middle);
                dot(away, away) <= square
            };
            balls.iter().any(within)
        };
        (part.complex).become_part(&whole.complex, tets, holds, numbers);
        let (slots, nodes) = (&numbers.slots, &numbers.nodes);
        part.sines.clear();
        part.sines
            .extend(slots.iter().map(|&t| whole.sines[t as usize]));
        part.holds.clear();
        part.holds
            .extend(nodes.iter().map(|&(n, _)| whole.holds[n as usize]));
        part.memory.become_part(
            &whole.memory,
            nodes.iter().map(|n| n.0),
            slots.iter().copied(),
        );
        part.queue.clear();
        part.stirred.clear();
        part.counts = Counts::default();
        (part.enough, part.stray, part.between) = (whole.enough, whole.stray, whole.between);

        let (mut beyond, mut failed) = (Vec::new(), Vec::new());
        for t in 0..tets.len() as u32 {
            if patience.over() {
                break;
            }
            if !part.is_poor(t) || part.in_vain(t) {
                continue;
            }
            let mended = part.mend_one(t);
            if part.complex.had_left() {
                beyond.push(tets[t as usize]);
            } else if !mended {
                part.memory.failed(Trial::Mend, t);
                failed.push(t);
            }
        }
        failed.retain(|&t| part.is_poor(t) && part.in_vain(t));
        let inner = nodes.iter().filter(|n| n.1).map(|n| n.0);
        Tried {
            nodes: inner.collect(),
            beyond,
            in_vain: failed.into_iter().map(|t| tets[t as usize]).collect(),
            change: self.change(&whole.complex),
        }
    }

    /// What has changed.
    fn change(&self, whole: &Complex) -> Change {
        let Self { numbers, improver } = self;
        let Complex { nodes, tets, .. } = &improver.complex;
        let (slots, known) = (&numbers.slots, numbers.nodes.len());
        let number = |n: u32| match numbers.nodes.get(n as usize) {
            Some(&(number, _)) => number,
            None => NONE - (n - known as u32),
        };
        // Those with another in their place come first: it has the same number here and there.
        let (mut gone, mut made, mut dead, mut new) = (vec![], vec![], vec![], vec![]);
        for (t, tet) in tets.iter().enumerate() {
            let alive = tet[0] != NONE;
            let now = tet.map(|n| if alive { number(n) } else { NONE });
            match slots.get(t) {
                Some(&slot) if whole.tets[slot as usize] == now => {}
                Some(&slot) if alive => {
                    gone.push(slot);
                    made.push(now);
                }
                Some(&slot) => dead.push(slot),
                None => new.extend(alive.then_some(now)),
            }
        }
        gone.append(&mut dead);
        made.append(&mut new);
        let place = |n: usize| (nodes[n], improver.holds[n]);
        let moved = (0..known).filter(|&n| nodes[n] != whole.nodes[numbers.nodes[n].0 as usize]);
        Change {
            gone,
            made,
            moved: moved.map(|n| (numbers.nodes[n].0, place(n))).collect(),
            new: (known..nodes.len()).map(place).collect(),
            counts: improver.counts,
        }
    }
}

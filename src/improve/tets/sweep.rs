//! Many flips and many moves at once: each is found in the mesh as it is, then those that do not meet are made. So what
//! becomes of the mesh does not depend on how many look for them, or where: ranks share long sweeps.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use crate::parallel::prelude::*;

use super::flips::Flip;
use super::memory::Trial;
use super::{Improver, MARGIN, Place, smooth};
use crate::files::kept::{Kept, fields};
use crate::mesh::complex::NONE;
use crate::observer::Patience;
use crate::{Result, ranks};

/// So many are looked at in one task.
const TASK: usize = 32;

/// Fewer are looked at sooner than they are passed on to other ranks.
const MANY: usize = 1 << 12;

/// Where more tetrahedra are poor than can be mended, the last round before nodes may stray is the one that leaves more
/// than this share of the nodes to smooth.
const SLOW: f64 = 0.92;

/// Colours of nodes; there are some ten.
const COLORS: usize = 64;

/// A node without a colour.
pub(super) const PLAIN: u8 = u8::MAX;

/// What one who looks needs.
#[derive(Default)]
pub(super) struct Scratch {
    pub flip: Flip,
    pub star: Vec<u32>,
    pub spokes: smooth::Star,
    smoothing: smooth::Scratch,
}

/// Those not in use.
pub(super) type Scratches = Mutex<Vec<Scratch>>;

/// A change: tetrahedra that go, and those that take their place; or a node, and the tetrahedra at it, that moves or
/// (`NONE`) comes with those.
#[derive(Debug, Default)]
pub(super) struct Step {
    pub old: Vec<u32>,
    pub fresh: Vec<[u32; 4]>,
    pub put: Option<(u32, Place)>,
}

fields! {
    Step as Step { old, fresh, put }
}

impl Step {
    pub fn of(flip: &Flip, put: Option<(u32, Place)>) -> Self {
        let (old, fresh) = (flip.old.clone(), flip.fresh.clone());
        Self { old, fresh, put }
    }
}

/// The tetrahedra that have changed since others were found in the mesh.
pub(super) struct Met {
    is: Vec<bool>,
    all: Vec<u32>,
}

impl Met {
    pub fn new(improver: &mut Improver<'_>) -> Self {
        let is = std::mem::take(&mut improver.touched);
        Self {
            is,
            all: Vec::new(),
        }
    }

    /// Whether any of these is among them.
    pub fn any(&self, tets: &[u32]) -> bool {
        tets.iter().any(|&t| self.is.get(t as usize) == Some(&true))
    }

    /// Makes a change.
    pub fn make(&mut self, improver: &mut Improver<'_>, step: Step) {
        improver.slots.clear();
        match step.put {
            Some((node, (x, hold))) if node != NONE => {
                improver.star.clone_from(&step.old);
                improver.move_to(node, x, hold);
            }
            put => improver.make(&step.old, &step.fresh, put.map(|put| put.1)),
        }
        for &t in step.old.iter().chain(&improver.slots) {
            let t = t as usize;
            if t >= self.is.len() {
                self.is.resize(t + 1, false);
            }
            self.is[t] = true;
        }
        self.all.extend(step.old);
        self.all.extend_from_slice(&improver.slots);
    }

    /// Gives its memory back, with nothing in it.
    pub fn forget(mut self, improver: &mut Improver<'_>) {
        for t in self.all {
            self.is[t as usize] = false;
        }
        improver.touched = self.is;
    }
}

/// The tetrahedra at each of some nodes.
pub(super) struct Stars {
    tets: Vec<u32>,
    ends: Vec<usize>,
}

impl Stars {
    fn of(&self, i: usize) -> &[u32] {
        let begin = i.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.tets[begin..self.ends[i]]
    }
}

impl Improver<'_> {
    /// Flips and smoothing in turn until neither helps any more.
    ///
    /// # Errors
    /// Those of other ranks, with which the work is shared.
    pub(super) fn polish(&mut self, rounds: usize, patience: &Patience<'_>) -> Result<()> {
        let mut before = f64::INFINITY;
        for round in 0..rounds {
            self.enough = if round == 0 {
                self.target + MARGIN
            } else {
                1.0
            };
            self.queue = self.poor();
            self.flip_all(patience)?;
            let poor = self.poor();
            let many = self.too_many(poor.len());
            let mut nodes: Vec<u32> = (poor.iter())
                .flat_map(|&t| self.complex.tets[t as usize])
                .collect();
            nodes.sort_unstable();
            nodes.dedup();
            let slow = match self.stray == 0.0 && many {
                true => SLOW,
                false => 1.0,
            };
            if nodes.is_empty() || nodes.len() as f64 >= slow * before {
                break;
            }
            before = nodes.len() as f64;
            self.smooth_all(nodes, patience)?;
            self.flip_all(patience)?;
        }
        Ok(())
    }

    /// Works through the queue with flips, round by round, the poorest first.
    fn flip_all(&mut self, patience: &Patience<'_>) -> Result<()> {
        while !self.queue.is_empty() {
            let mut poor = std::mem::take(&mut self.queue);
            if patience.over() {
                break;
            }
            poor.sort_unstable();
            poor.dedup();
            poor.retain(|&t| {
                // All that flips of it depend on is at its nodes.
                let tet = self.complex.tets[t as usize];
                self.is_poor(t) && !self.memory.in_vain(Trial::Flip, t, &tet)
            });
            // Where two meet, the poorer one is made: in whatever other order, planes that cross lose more faces.
            poor.sort_by(|&a, &b| self.sine_of(a).total_cmp(&self.sine_of(b)).then(a.cmp(&b)));
            let found = self.each("flips", &poor, |s, t, scratch| {
                let flip = &mut scratch.flip;
                let any = !patience.over() && s.find_flip(t, flip);
                any.then(|| Step::of(flip, None))
            })?;
            for (&t, _) in poor.iter().zip(&found).filter(|(_, flip)| flip.is_none()) {
                self.memory.failed(Trial::Flip, t);
            }
            let mut met = Met::new(self);
            for (t, flip) in poor.into_iter().zip(found) {
                match flip {
                    None => {}
                    Some(step) if met.any(&step.old) => self.queue.push(t),
                    Some(step) => {
                        met.make(self, step);
                        self.counts.flips += 1;
                    }
                }
            }
            met.forget(self);
        }
        Ok(())
    }

    /// Smooths each of the nodes once, those without a tetrahedron in common at the same time.
    fn smooth_all(&mut self, mut nodes: Vec<u32>, patience: &Patience<'_>) -> Result<()> {
        nodes.retain(|&n| self.holds[n as usize].axes != 7);
        let stars = self.stars_of(&nodes);
        for group in self.groups(&nodes, &stars) {
            if patience.over() {
                return Ok(());
            }
            let begun = self.memory.now();
            let found = self.each("smoothing", &group, |s, i, scratch| {
                let node = nodes[i as usize];
                let idle = patience.over() || s.memory.in_vain(Trial::Smooth, node, &[node]);
                (!idle)
                    .then(|| s.smoothed(node, stars.of(i as usize), scratch))
                    .flatten()
            })?;
            for (i, place) in group.into_iter().zip(found) {
                let node = nodes[i as usize];
                match place {
                    None => self.memory.failed(Trial::Smooth, node),
                    // Colours may not suffice.
                    Some(_) if self.memory.has_changed(begun, &[node]) => {}
                    Some((x, hold)) => {
                        self.star.clear();
                        self.star.extend_from_slice(stars.of(i as usize));
                        self.move_to(node, x, hold);
                        self.counts.moves += 1;
                    }
                }
            }
        }
        Ok(())
    }

    /// Where smoothing puts a node, and what holds it there, if that helps.
    fn smoothed(&self, node: u32, star: &[u32], scratch: &mut Scratch) -> Option<Place> {
        let mut hold = self.holds[node as usize];
        self.spokes(node, star, &mut scratch.spokes);
        let best = smooth::best_position(
            self.complex.nodes[node as usize],
            &scratch.spokes,
            &mut hold,
            self.extent,
            self.sheets,
            self.stray,
            self.enough,
            &mut scratch.smoothing,
        );
        best.map(|(x, _)| (x, hold))
    }

    pub(super) fn stars_of(&self, nodes: &[u32]) -> Stars {
        let parts: Vec<(Vec<u32>, Vec<usize>)> = nodes
            .par_chunks(8 * TASK)
            .map(|nodes| {
                let (mut tets, mut counts, mut star) = (Vec::new(), Vec::new(), Vec::new());
                for &node in nodes {
                    self.complex.star(node, &mut star);
                    tets.extend_from_slice(&star);
                    counts.push(star.len());
                }
                (tets, counts)
            })
            .collect();
        let (mut stars, mut end) = (
            Stars {
                tets: Vec::new(),
                ends: Vec::new(),
            },
            0,
        );
        for (tets, counts) in parts {
            stars.tets.extend(tets);
            stars.ends.extend(counts.into_iter().map(|count| {
                end += count;
                end
            }));
        }
        stars
    }

    /// Groups of nodes, by their places among them, of which no two have a tetrahedron in common: each has the first
    /// colour that none of those before it has beside it.
    pub(super) fn groups(&mut self, nodes: &[u32], stars: &Stars) -> Vec<Vec<u32>> {
        let Self {
            colors, complex, ..
        } = self;
        colors.resize(complex.nodes.len(), PLAIN);
        let mut groups: Vec<Vec<u32>> = Vec::new();
        for (i, &node) in nodes.iter().enumerate() {
            let mut used = 0u64;
            for &t in stars.of(i) {
                for n in complex.tets[t as usize] {
                    let color = colors[n as usize];
                    used |= u64::from(color != PLAIN) << (color & 63);
                }
            }
            let color = (used.trailing_ones() as usize).min(COLORS - 1);
            colors[node as usize] = color as u8;
            if color == groups.len() {
                groups.push(Vec::new());
            }
            groups[color].push(i as u32);
        }
        for &node in nodes {
            colors[node as usize] = PLAIN;
        }
        groups
    }

    /// What is found for each.
    ///
    /// # Errors
    /// Those of other ranks.
    pub(super) fn each<I: Copy + Sync, T: Kept + Send>(
        &self,
        what: &str,
        items: &[I],
        find: impl Fn(&Self, I, &mut Scratch) -> T + Sync,
    ) -> Result<Vec<T>> {
        let pool = || {
            self.scratches
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
        };
        let look = |items: &[I]| {
            let taken = pool().pop();
            let mut scratch = taken.unwrap_or_default();
            let found: Vec<T> = (items.iter())
                .map(|&item| find(self, item, &mut scratch))
                .collect();
            pool().push(scratch);
            found
        };
        let all = |own: Range<usize>| -> Vec<T> {
            let tasks = items[own].par_chunks(TASK);
            tasks.flat_map_iter(look).collect()
        };
        if self.alone || items.len() < MANY {
            return Ok(all(0..items.len()));
        }
        let mut found = Vec::with_capacity(items.len());
        let work = |own, give: &mut dyn FnMut(T)| {
            all(own).into_iter().for_each(give);
            Ok(())
        };
        ranks::share(what, items.len(), work, &mut |one| found.push(one))?;
        Ok(found)
    }
}

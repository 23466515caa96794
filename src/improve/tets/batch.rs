//! Many flips and many moves at once: each is found in the mesh as it is, then those that do not meet are made. So what
//! becomes of the mesh does not depend on how many look for them, or where: ranks share long sweeps.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use crate::parallel::prelude::*;

use super::attempt_cache::AttemptKind;
use super::flips::Flip;
use super::{ConstrainedPoint, SMOOTHING_MARGIN, TetImprover, smooth};
use crate::files::codec::{Codec, codec_fields};
use crate::mesh::complex::NONE;
use crate::progress::CancelToken;
use crate::{Result, comm};

/// So many are looked at in one task.
const TASK_SIZE: usize = 32;

/// Fewer are looked at sooner than they are passed on to other ranks.
const MIN_SHARED_COUNT: usize = 1 << 12;

/// Where more tetrahedra are poor than can be mended, the last round before nodes may stray is the one that leaves more
/// than this share of the nodes to smooth.
const SLOW_PROGRESS_RATIO: f64 = 0.92;

/// Colours of nodes; there are some ten.
const MAX_COLORS: usize = 64;

/// A node without a colour.
pub(super) const NO_COLOR: u8 = u8::MAX;

/// What one who looks needs.
#[derive(Default)]
pub(super) struct SearchScratch {
    pub flip: Flip,
    pub star: Vec<u32>,
    pub link: smooth::NodeLink,
    smooth_scratch: smooth::SmoothScratch,
}

/// Those not in use.
pub(super) type ScratchPool = Mutex<Vec<SearchScratch>>;

/// A change: tetrahedra that go, and those that take their place; or a node, and the tetrahedra at it, that moves or
/// (`NONE`) comes with those.
#[derive(Debug, Default)]
pub(super) struct BatchChange {
    pub old_tets: Vec<u32>,
    pub new_tets: Vec<[u32; 4]>,
    pub placed_node: Option<(u32, ConstrainedPoint)>,
}

codec_fields! {
    BatchChange as BatchChange { old_tets, new_tets, placed_node }
}

impl BatchChange {
    pub fn from_flip(flip: &Flip, placed_node: Option<(u32, ConstrainedPoint)>) -> Self {
        let (old_tets, new_tets) = (flip.old_tets.clone(), flip.new_tets.clone());
        Self {
            old_tets,
            new_tets,
            placed_node,
        }
    }
}

/// The tetrahedra that have changed since others were found in the mesh.
pub(super) struct ChangedTets {
    is_changed: Vec<bool>,
    tets: Vec<u32>,
}

impl ChangedTets {
    pub fn new(improver: &mut TetImprover<'_>) -> Self {
        let is_changed = std::mem::take(&mut improver.touched);
        Self {
            is_changed,
            tets: Vec::new(),
        }
    }

    /// Whether any of these is among them.
    pub fn contains_any(&self, tets: &[u32]) -> bool {
        tets.iter()
            .any(|&t| self.is_changed.get(t as usize) == Some(&true))
    }

    /// Makes a change.
    pub fn apply(&mut self, improver: &mut TetImprover<'_>, step: BatchChange) {
        improver.slots.clear();
        match step.placed_node {
            Some((node, (x, hold))) if node != NONE => {
                improver.star.clone_from(&step.old_tets);
                improver.move_to(node, x, hold);
            }
            put => improver.apply(&step.old_tets, &step.new_tets, put.map(|put| put.1)),
        }
        for &t in step.old_tets.iter().chain(&improver.slots) {
            let t = t as usize;
            if t >= self.is_changed.len() {
                self.is_changed.resize(t + 1, false);
            }
            self.is_changed[t] = true;
        }
        self.tets.extend(step.old_tets);
        self.tets.extend_from_slice(&improver.slots);
    }

    /// Gives its memory back, with nothing in it.
    pub fn return_buffer(mut self, improver: &mut TetImprover<'_>) {
        for t in self.tets {
            self.is_changed[t as usize] = false;
        }
        improver.touched = self.is_changed;
    }
}

/// The tetrahedra at each of some nodes.
pub(super) struct NodeTets {
    tets: Vec<u32>,
    ends: Vec<usize>,
}

impl NodeTets {
    fn get(&self, i: usize) -> &[u32] {
        let begin = i.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.tets[begin..self.ends[i]]
    }
}

impl TetImprover<'_> {
    /// Flips and smoothing in turn until neither helps any more.
    ///
    /// # Errors
    /// Those of other ranks, with which the work is shared.
    pub(super) fn flip_and_smooth(
        &mut self,
        rounds: usize,
        patience: &CancelToken<'_>,
    ) -> Result<()> {
        let mut before = f64::INFINITY;
        for round in 0..rounds {
            self.smoothing_target = if round == 0 {
                self.target_sine + SMOOTHING_MARGIN
            } else {
                1.0
            };
            self.queue = self.tets_below_target();
            self.flip_all(patience)?;
            let poor = self.tets_below_target();
            let many = self.has_too_many(poor.len());
            let mut nodes: Vec<u32> = (poor.iter())
                .flat_map(|&t| self.complex.tets[t as usize])
                .collect();
            nodes.sort_unstable();
            nodes.dedup();
            let slow = match self.max_deviation == 0.0 && many {
                true => SLOW_PROGRESS_RATIO,
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
    fn flip_all(&mut self, patience: &CancelToken<'_>) -> Result<()> {
        while !self.queue.is_empty() {
            let mut poor = std::mem::take(&mut self.queue);
            if patience.is_cancelled() {
                break;
            }
            poor.sort_unstable();
            poor.dedup();
            poor.retain(|&t| {
                // All that flips of it depend on is at its nodes.
                let tet = self.complex.tets[t as usize];
                self.is_below_target(t)
                    && !self.attempts.is_known_to_fail(AttemptKind::Flip, t, &tet)
            });
            // Where two meet, the poorer one is made: in whatever other order, planes that cross lose more faces.
            poor.sort_by(|&a, &b| self.sine_of(a).total_cmp(&self.sine_of(b)).then(a.cmp(&b)));
            let found = self.search_each("flips", &poor, |s, t, scratch| {
                let flip = &mut scratch.flip;
                let any = !patience.is_cancelled() && s.find_flip(t, flip);
                any.then(|| BatchChange::from_flip(flip, None))
            })?;
            for (&t, _) in poor.iter().zip(&found).filter(|(_, flip)| flip.is_none()) {
                self.attempts.record_failure(AttemptKind::Flip, t);
            }
            let mut met = ChangedTets::new(self);
            for (t, flip) in poor.into_iter().zip(found) {
                match flip {
                    None => {}
                    Some(step) if met.contains_any(&step.old_tets) => self.queue.push(t),
                    Some(step) => {
                        met.apply(self, step);
                        self.counts.flips += 1;
                    }
                }
            }
            met.return_buffer(self);
        }
        Ok(())
    }

    /// Smooths each of the nodes once, those without a tetrahedron in common at the same time.
    fn smooth_all(&mut self, mut nodes: Vec<u32>, patience: &CancelToken<'_>) -> Result<()> {
        nodes.retain(|&n| self.constraints[n as usize].fixed_axes != 7);
        let stars = self.collect_node_tets(&nodes);
        for group in self.independent_groups(&nodes, &stars) {
            if patience.is_cancelled() {
                return Ok(());
            }
            let begun = self.attempts.clock();
            let found = self.search_each("smoothing", &group, |s, i, scratch| {
                let node = nodes[i as usize];
                let idle = patience.is_cancelled()
                    || s.attempts
                        .is_known_to_fail(AttemptKind::Smooth, node, &[node]);
                (!idle)
                    .then(|| s.smooth_position(node, stars.get(i as usize), scratch))
                    .flatten()
            })?;
            for (i, place) in group.into_iter().zip(found) {
                let node = nodes[i as usize];
                match place {
                    None => self.attempts.record_failure(AttemptKind::Smooth, node),
                    // Colours may not suffice.
                    Some(_) if self.attempts.has_changed(begun, &[node]) => {}
                    Some((x, hold)) => {
                        self.star.clear();
                        self.star.extend_from_slice(stars.get(i as usize));
                        self.move_to(node, x, hold);
                        self.counts.moves += 1;
                    }
                }
            }
        }
        Ok(())
    }

    /// Where smoothing puts a node, and what holds it there, if that helps.
    fn smooth_position(
        &self,
        node: u32,
        star: &[u32],
        scratch: &mut SearchScratch,
    ) -> Option<ConstrainedPoint> {
        let mut hold = self.constraints[node as usize];
        self.collect_link(node, star, &mut scratch.link);
        let best = smooth::best_position(
            self.complex.nodes[node as usize],
            &scratch.link,
            &mut hold,
            self.extent,
            self.planes,
            self.max_deviation,
            self.smoothing_target,
            &mut scratch.smooth_scratch,
        );
        best.map(|(x, _)| (x, hold))
    }

    pub(super) fn collect_node_tets(&self, nodes: &[u32]) -> NodeTets {
        let parts: Vec<(Vec<u32>, Vec<usize>)> = nodes
            .par_chunks(8 * TASK_SIZE)
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
            NodeTets {
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
    pub(super) fn independent_groups(&mut self, nodes: &[u32], stars: &NodeTets) -> Vec<Vec<u32>> {
        let Self {
            colors, complex, ..
        } = self;
        colors.resize(complex.nodes.len(), NO_COLOR);
        let mut groups: Vec<Vec<u32>> = Vec::new();
        for (i, &node) in nodes.iter().enumerate() {
            let mut used = 0u64;
            for &t in stars.get(i) {
                for n in complex.tets[t as usize] {
                    let color = colors[n as usize];
                    used |= u64::from(color != NO_COLOR) << (color & 63);
                }
            }
            let color = (used.trailing_ones() as usize).min(MAX_COLORS - 1);
            colors[node as usize] = color as u8;
            if color == groups.len() {
                groups.push(Vec::new());
            }
            groups[color].push(i as u32);
        }
        for &node in nodes {
            colors[node as usize] = NO_COLOR;
        }
        groups
    }

    /// What is found for each.
    ///
    /// # Errors
    /// Those of other ranks.
    pub(super) fn search_each<I: Copy + Sync, T: Codec + Send>(
        &self,
        what: &str,
        items: &[I],
        find: impl Fn(&Self, I, &mut SearchScratch) -> T + Sync,
    ) -> Result<Vec<T>> {
        let pool = || {
            self.scratch_pool
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
            let tasks = items[own].par_chunks(TASK_SIZE);
            tasks.flat_map_iter(look).collect()
        };
        if self.is_rank_local || items.len() < MIN_SHARED_COUNT {
            return Ok(all(0..items.len()));
        }
        let mut found = Vec::with_capacity(items.len());
        let work = |own, give: &mut dyn FnMut(T)| {
            all(own).into_iter().for_each(give);
            Ok(())
        };
        comm::distribute(what, items.len(), work, &mut |one| found.push(one))?;
        Ok(found)
    }
}

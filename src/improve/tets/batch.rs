//! Flips and moves in batches: all changes are searched in the unchanged mesh, and then those that
//! do not overlap are applied. So the result depends neither on the number of threads nor on which
//! rank searches; ranks share large batches.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use crate::geometry::sorted_distinct;
use crate::parallel::prelude::*;

use super::attempt_cache::AttemptKind;
use super::flips::Flip;
use super::{ConstrainedPoint, SMOOTHING_MARGIN, TetImprover, smooth};
use crate::Result;
use crate::files::codec::{Codec, codec_fields};
use crate::mesh::complex::NONE;
use crate::progress::CancelToken;

/// Number of flips that one task searches.
const FLIPS_PER_TASK: usize = 32;
/// Number of nodes that one task smooths. A colour often has a few dozen nodes only.
const NODES_PER_TASK: usize = 4;

/// Number of nodes whose tetrahedra one task collects.
const NODES_PER_STAR_TASK: usize = 256;

/// Largest ratio of the numbers of nodes to smooth in two successive rounds at which another round
/// follows, while nodes may not leave their features and more tetrahedra are below target than can
/// be repaired.
const SLOW_PROGRESS_RATIO: f64 = 0.92;

/// Largest number of colours of nodes; about ten are used.
const MAX_COLORS: usize = 64;

/// Colour of a node that has none.
pub(super) const NO_COLOR: u8 = u8::MAX;

/// Scratch space of a search task.
#[derive(Default)]
pub(super) struct SearchScratch {
    pub flip: Flip,
    pub star: Vec<u32>,
    pub link: smooth::NodeLink,
    smooth_scratch: smooth::SmoothScratch,
}

/// Scratch space that is not in use.
pub(super) type ScratchPool = Mutex<Vec<SearchScratch>>;

/// A change of the mesh: tetrahedra that are removed, and those that take their place. Or a node
/// with its new position and constraints: `old_tets` are then the tetrahedra at it, or, if the node
/// is `NONE`, it is inserted with the new tetrahedra.
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
    /// Creates the change of a flip, which may place a node.
    pub fn from_flip(flip: &Flip, placed_node: Option<(u32, ConstrainedPoint)>) -> Self {
        let (old_tets, new_tets) = (flip.old_tets.clone(), flip.new_tets.clone());
        Self {
            old_tets,
            new_tets,
            placed_node,
        }
    }
}

/// The tetrahedra that have changed since the changes of a batch were searched.
pub(super) struct ChangedTets {
    is_changed: Vec<bool>,
    tets: Vec<u32>,
}

impl ChangedTets {
    /// Creates an empty set, with the buffer of the improver.
    pub fn new(improver: &mut TetImprover<'_>) -> Self {
        let is_changed = std::mem::take(&mut improver.touched);
        Self {
            is_changed,
            tets: Vec::new(),
        }
    }

    /// Returns `true` if any of these tetrahedra has changed.
    pub fn contains_any(&self, tets: &[u32]) -> bool {
        tets.iter()
            .any(|&t| self.is_changed.get(t as usize) == Some(&true))
    }

    /// Applies a change.
    pub fn apply(&mut self, improver: &mut TetImprover<'_>, change: BatchChange) {
        improver.slots.clear();
        match change.placed_node {
            Some((node, (x, constraint))) if node != NONE => {
                improver.star.clone_from(&change.old_tets);
                improver.move_to(node, x, constraint);
            }
            placed => improver.apply(
                &change.old_tets,
                &change.new_tets,
                placed.map(|placed| placed.1),
            ),
        }
        for &t in change.old_tets.iter().chain(&improver.slots) {
            let t = t as usize;
            if t >= self.is_changed.len() {
                self.is_changed.resize(t + 1, false);
            }
            self.is_changed[t] = true;
        }
        self.tets.extend(change.old_tets);
        self.tets.extend_from_slice(&improver.slots);
    }

    /// Clears the marks and returns their buffer to the improver.
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
    /// Returns the tetrahedra at any of the nodes, each once.
    pub fn into_distinct_tets(self) -> Vec<u32> {
        let mut tets = self.tets;
        tets.par_sort_unstable();
        tets.dedup();
        tets
    }

    /// Returns the tetrahedra at the node with index `i` in the list of nodes.
    fn get(&self, i: usize) -> &[u32] {
        let begin = i.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.tets[begin..self.ends[i]]
    }
}

impl TetImprover<'_> {
    /// Flips and smooths in turn until neither helps any more.
    ///
    /// # Errors
    /// Returns an error if another rank that shares the work fails.
    pub(super) fn flip_and_smooth(
        &mut self,
        rounds: usize,
        cancel: &CancelToken<'_>,
    ) -> Result<()> {
        let mut old_count = f64::INFINITY;
        for round in 0..rounds {
            self.smoothing_target = if round == 0 {
                self.target_sine + SMOOTHING_MARGIN
            } else {
                1.0
            };
            self.queue = self.tets_below_target();
            self.flip_all(cancel)?;
            let below_target = self.tets_below_target();
            let too_many = self.has_too_many(below_target.len());
            let nodes =
                sorted_distinct((below_target.iter()).flat_map(|&t| self.complex.tets[t as usize]));
            let max_ratio = if self.max_deviation == 0.0 && too_many {
                SLOW_PROGRESS_RATIO
            } else {
                1.0
            };
            if nodes.is_empty() || nodes.len() as f64 >= max_ratio * old_count {
                break;
            }
            old_count = nodes.len() as f64;
            self.smooth_all(nodes, cancel)?;
            self.flip_all(cancel)?;
        }
        Ok(())
    }

    /// Works through the queue with flips, in rounds, the worst tetrahedron first.
    fn flip_all(&mut self, cancel: &CancelToken<'_>) -> Result<()> {
        while !self.queue.is_empty() {
            let mut below_target = std::mem::take(&mut self.queue);
            if cancel.is_cancelled() {
                break;
            }
            below_target.sort_unstable();
            below_target.dedup();
            below_target.retain(|&t| {
                // The flips of a tetrahedron depend only on what is at its nodes.
                let tet = self.complex.tets[t as usize];
                self.is_below_target(t)
                    && !self.attempts.is_known_to_fail(AttemptKind::Flip, t, &tet)
            });
            // Of two flips that overlap, the one of the worse tetrahedron is applied. In any other
            // order, planes that cross lose more faces.
            below_target
                .sort_by(|&a, &b| self.sine_of(a).total_cmp(&self.sine_of(b)).then(a.cmp(&b)));
            let flips =
                self.search_each("flips", FLIPS_PER_TASK, &below_target, |s, t, scratch| {
                    let flip = &mut scratch.flip;
                    let is_found = !cancel.is_cancelled() && s.find_flip(t, flip);
                    is_found.then(|| BatchChange::from_flip(flip, None))
                })?;
            for (&t, _) in below_target
                .iter()
                .zip(&flips)
                .filter(|(_, flip)| flip.is_none())
            {
                self.attempts.record_failure(AttemptKind::Flip, t);
            }
            let mut changed = ChangedTets::new(self);
            for (t, flip) in below_target.into_iter().zip(flips) {
                match flip {
                    None => {}
                    Some(change) if changed.contains_any(&change.old_tets) => self.queue.push(t),
                    Some(change) => {
                        changed.apply(self, change);
                        self.counts.flips += 1;
                    }
                }
            }
            changed.return_buffer(self);
        }
        Ok(())
    }

    /// Smooths each of the nodes once. Nodes without a common tetrahedron are smoothed at the same
    /// time.
    pub(super) fn smooth_all(
        &mut self,
        mut nodes: Vec<u32>,
        cancel: &CancelToken<'_>,
    ) -> Result<()> {
        nodes.retain(|&n| self.constraints[n as usize].fixed_axes != 7);
        let stars = self.collect_node_tets(&nodes);
        for group in self.independent_groups(&nodes, &stars) {
            if cancel.is_cancelled() {
                return Ok(());
            }
            let start = self.attempts.clock();
            let positions =
                self.search_each("smoothing", NODES_PER_TASK, &group, |s, i, scratch| {
                    let node = nodes[i as usize];
                    let skip = cancel.is_cancelled()
                        || s.attempts
                            .is_known_to_fail(AttemptKind::Smooth, node, &[node]);
                    (!skip)
                        .then(|| s.smooth_position(node, stars.get(i as usize), scratch))
                        .flatten()
                })?;
            for (i, position) in group.into_iter().zip(positions) {
                let node = nodes[i as usize];
                match position {
                    None => self.attempts.record_failure(AttemptKind::Smooth, node),
                    // With too few colours, nodes of one group may share a tetrahedron.
                    Some(_) if self.attempts.has_changed(start, &[node]) => {}
                    Some((point, sines)) => {
                        self.star.clear();
                        self.star.extend_from_slice(stars.get(i as usize));
                        self.move_smoothed(node, point, &sines);
                        self.counts.moves += 1;
                    }
                }
            }
        }
        Ok(())
    }

    /// Returns the position to which smoothing moves a node, its constraints there, and the sines of
    /// its tetrahedra, if that helps.
    fn smooth_position(
        &self,
        node: u32,
        star: &[u32],
        scratch: &mut SearchScratch,
    ) -> Option<(ConstrainedPoint, Vec<f32>)> {
        let mut constraint = self.constraints[node as usize];
        self.collect_link(node, star, &mut scratch.link);
        let best = smooth::best_position(
            self.complex.nodes[node as usize],
            &scratch.link,
            &mut constraint,
            self.smoothing_limits(),
            &mut scratch.smooth_scratch,
        );
        best.map(|(x, _)| {
            let mut sines = Vec::new();
            smooth::link_sines(x, &scratch.link, &mut sines);
            ((x, constraint), sines)
        })
    }

    /// Collects the tetrahedra at each of the nodes.
    pub(super) fn collect_node_tets(&self, nodes: &[u32]) -> NodeTets {
        let parts: Vec<(Vec<u32>, Vec<usize>)> = nodes
            .par_chunks(NODES_PER_STAR_TASK)
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

    /// Divides nodes into groups of which no two nodes share a tetrahedron; a group has indices
    /// into `nodes`. Each node takes the first colour that no node before it uses in a common
    /// tetrahedron.
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

    /// Returns the result of `find` for each item. One task works on `task_size` items.
    ///
    /// # Errors
    /// Returns an error if another rank that shares the work fails.
    pub(super) fn search_each<I: Copy + Sync, T: Codec + Send>(
        &self,
        name: &str,
        task_size: usize,
        items: &[I],
        find: impl Fn(&Self, I, &mut SearchScratch) -> T + Sync,
    ) -> Result<Vec<T>> {
        let pool = || {
            self.scratch_pool
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
        };
        let search = |items: &[I]| {
            let taken = pool().pop();
            let mut scratch = taken.unwrap_or_default();
            let found: Vec<T> = (items.iter())
                .map(|&item| find(self, item, &mut scratch))
                .collect();
            pool().push(scratch);
            found
        };
        let search_range = |range: Range<usize>| -> Vec<T> {
            let tasks = items[range].par_chunks(task_size);
            tasks.flat_map_iter(search).collect()
        };
        self.work.search(name, items.len(), search_range)
    }
}

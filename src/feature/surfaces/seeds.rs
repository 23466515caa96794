//! Grows surfaces from seeds, one after the other: the strongest seed first.
//!
//! Ranks work speculatively. Each rank grows surfaces from its own seeds as long as no other rank
//! sees these surfaces. The first surface, in the order of all seeds, that other ranks see is grown
//! by all ranks together; results of later seeds are undone. So every surface finds the state that
//! all surfaces before it left, as if one rank had grown them all.

use super::growth::{SurfaceGrowth, UNASSIGNED};
use crate::error::Result;
use crate::feature::candidate::Candidate;
use crate::parallel::prelude::*;

/// Largest number of seeds that a rank grows before it synchronises with the other ranks.
const MAX_SPECULATIVE_SEEDS: usize = 1 << 8;

/// Position of a seed in the order of all seeds: its class of strength, then its global index.
type SeedOrder = u64;

/// Order that is after all seeds.
const NO_SEED: SeedOrder = SeedOrder::MAX;
/// Number of bits of the global index in a [`SeedOrder`].
const CLASS_SHIFT: u32 = 48;
/// Number of classes of strength.
const CLASS_COUNT: usize = 1 << 12;

/// A surface that was grown speculatively.
struct Speculation {
    order: SeedOrder,
    /// Index of the seed among those of this rank.
    seed: usize,
    /// Lengths of the log, and number of kept surfaces, before this surface was grown.
    log_before: LogLengths,
    kept_before: usize,
}

/// Record of speculative surfaces, to undo them.
#[derive(Default)]
struct UndoLog {
    trials: Vec<Speculation>,
    /// Candidates that are no longer unassigned.
    changed_candidates: Vec<usize>,
    /// Fragments among them that other ranks see.
    fragments: Vec<usize>,
}

/// Lengths of the lists in a log.
#[derive(Clone, Copy)]
struct LogLengths {
    changed_candidates: usize,
    fragments: usize,
}

impl UndoLog {
    fn lengths(&self) -> LogLengths {
        LogLengths {
            changed_candidates: self.changed_candidates.len(),
            fragments: self.fragments.len(),
        }
    }

    /// Makes all surfaces of seeds before `order` permanent.
    fn commit_before(&mut self, order: SeedOrder) {
        let committed = self.trials.partition_point(|trial| trial.order < order);
        let end = self.trials.get(committed).map(|trial| trial.log_before);
        let changed_count = end.map_or(self.changed_candidates.len(), |end| end.changed_candidates);
        self.changed_candidates.drain(..changed_count);
        self.trials.drain(..committed);
        for trial in &mut self.trials {
            trial.log_before.changed_candidates -= changed_count;
        }
    }
}

/// Surfaces that are kept: the order of the seed, and the provisional number of the surface.
pub(super) type KeptSurfaces = Vec<(SeedOrder, u32)>;

/// Grows all surfaces from the seeds of this rank.
pub(super) struct SeedQueue<'s, 'a, const D: usize> {
    growth: &'s mut SurfaceGrowth<'a, D>,
    /// Seeds of this rank, in their order.
    seeds: Vec<u32>,
    /// Index of the next seed.
    next_seed: usize,
    /// A seed whose surface other ranks see.
    visible_seed: Option<usize>,
    kept: KeptSurfaces,
    log: UndoLog,
    /// Number of surfaces that this rank has numbered.
    numbered_count: usize,
}

/// The point at which a rank stops speculative growth.
struct StopPoint {
    order: SeedOrder,
    /// `true` if other ranks see the surface of the next seed.
    is_visible: bool,
}

impl<'s, 'a, const D: usize> SeedQueue<'s, 'a, D> {
    /// Takes the owned candidates that are at least as strong as `high` for seeds.
    pub fn new(growth: &'s mut SurfaceGrowth<'a, D>, high: f32) -> Self {
        let (owned, candidates) = (growth.slab.owned.clone(), &growth.slab.candidates);
        let strong = owned.filter(|&i| candidates[i].strength >= high);
        let mut seeds: Vec<u32> = strong.map(|i| i as u32).collect();
        // The sort is stable: seeds of one class stay in the order of samples.
        seeds.par_sort_by_key(|&i| strength_class(&candidates[i as usize]));
        Self {
            growth,
            seeds,
            next_seed: 0,
            visible_seed: None,
            kept: KeptSurfaces::new(),
            log: UndoLog::default(),
            numbered_count: 0,
        }
    }

    /// Grows the surfaces of all ranks, and returns the kept surfaces of this rank's seeds.
    ///
    /// # Errors
    /// Returns an [`Error::Interrupted`](crate::Error::Interrupted) if the search is cancelled, and
    /// the errors of other ranks.
    pub fn grow_all(mut self) -> Result<KeptSurfaces> {
        let grid = self.growth.slab.grid;
        // Ranks go through one class after the other; otherwise they would speculate too far ahead.
        let mut end = if grid.is_shared() { 0 } else { NO_SEED };
        loop {
            let StopPoint { order, is_visible } = self.grow_speculatively(end)?;
            let stop = (u64::from(self.new_number()), is_visible);
            let first = grid.first("seeds", order, stop)?;
            let Some((first, (number, is_visible), is_own)) =
                first.filter(|(order, ..)| *order != NO_SEED)
            else {
                return Ok(self.kept);
            };
            end = ((first >> CLASS_SHIFT) + 1) << CLASS_SHIFT;
            self.log.commit_before(first);
            if is_visible {
                self.undo_speculation();
                self.grow_collectively(first, is_own, number as u32)?;
            }
        }
    }

    /// Grows one surface by all ranks together; one of them owns the seed.
    fn grow_collectively(&mut self, order: SeedOrder, owns_seed: bool, number: u32) -> Result<()> {
        let fragments = std::mem::take(&mut self.log.fragments);
        self.growth.exchange_fragments(&fragments)?;
        let seed = owns_seed.then(|| self.seeds[self.next_seed] as usize);
        let is_surface = self.growth.grow_collectively(seed, number)?;
        if owns_seed {
            self.next_seed += 1;
            if is_surface {
                self.numbered_count += 1;
                self.kept.push((order, number));
            }
        }
        Ok(())
    }

    /// Grows surfaces from this rank's seeds before `end`, as long as no other rank sees them.
    fn grow_speculatively(&mut self, end: SeedOrder) -> Result<StopPoint> {
        let is_shared = self.growth.slab.grid.is_shared();
        while let Some(&seed) = self.seeds.get(self.next_seed) {
            let seed = seed as usize;
            let order = self.seed_order(seed);
            let stop = |is_visible| Ok(StopPoint { order, is_visible });
            if self.growth.state[seed] == UNASSIGNED {
                if order >= end || is_shared && self.log.trials.len() >= MAX_SPECULATIVE_SEEDS {
                    return stop(false);
                }
                if self.visible_seed == Some(seed) {
                    return stop(true);
                }
                let (log_before, kept_before) = (self.log.lengths(), self.kept.len());
                let number = self.new_number();
                let Some(is_surface) = self.growth.grow_locally(seed, number)? else {
                    self.visible_seed = Some(seed);
                    return stop(true);
                };
                if is_surface {
                    self.numbered_count += 1;
                    self.kept.push((order, number));
                }
                if is_shared {
                    self.log
                        .changed_candidates
                        .extend(self.growth.changed_candidates());
                    if !self.growth.slab.is_inner(seed) {
                        self.log.fragments.push(seed);
                    }
                    self.log.trials.push(Speculation {
                        order,
                        seed: self.next_seed,
                        log_before,
                        kept_before,
                    });
                }
            }
            self.next_seed += 1;
        }
        Ok(StopPoint {
            order: NO_SEED,
            is_visible: false,
        })
    }

    /// Undoes the surfaces that were grown speculatively.
    fn undo_speculation(&mut self) {
        for &i in &self.log.changed_candidates {
            self.growth.state[i] = UNASSIGNED;
        }
        if let Some(trial) = self.log.trials.first() {
            self.next_seed = trial.seed;
            self.kept.truncate(trial.kept_before);
            self.log.fragments.truncate(trial.log_before.fragments);
        }
        self.log.trials.clear();
        self.log.changed_candidates.clear();
    }

    /// Returns the order of a seed of this rank.
    fn seed_order(&self, seed: usize) -> SeedOrder {
        let slab = self.growth.slab;
        (strength_class(&slab.candidates[seed]) as u64) << CLASS_SHIFT
            | slab.global_index(seed) as u64
    }

    /// Returns a number that no other surface has.
    fn new_number(&self) -> u32 {
        self.growth.slab.grid.unique_number(self.numbered_count) as u32
    }
}

/// Returns the class of a candidate's strength, of [`CLASS_COUNT`] logarithmic classes: 0 is the
/// strongest.
fn strength_class<const D: usize>(c: &Candidate<D>) -> usize {
    // The bits of a positive float sort like the float; its upper bits are a logarithmic class.
    CLASS_COUNT - 1 - (c.strength.max(0.0).to_bits() >> 19) as usize
}

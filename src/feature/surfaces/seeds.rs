//! From which candidates sheets are grown, one after the other: the strongest first.
//!
//! Ranks go on side by side where they can. Each goes ahead with its own seeds as long as their sheets stay where no
//! other rank sees them. The first sheet, in the order of all seeds, that does not is grown by all together; what a
//! rank has made of later seeds by then is undone. So every sheet finds what is there once all before it are grown,
//! as if one had grown all.

use super::growth::{SurfaceGrowth, UNASSIGNED};
use crate::error::Result;
use crate::feature::candidate::Candidate;
use crate::parallel::prelude::*;

/// A rank goes ahead with so many seeds, before it hears how far others are.
const MAX_SPECULATIVE_SEEDS: usize = 1 << 8;

/// The place of a seed in the order of all: its class, and its place in the order of samples.
type SeedOrder = u64;

/// After all seeds.
const NO_SEED: SeedOrder = SeedOrder::MAX;
/// Turns of one class, as a power of two.
const CLASS_SHIFT: u32 = 48;
/// Classes of strength.
const CLASS_COUNT: usize = 1 << 12;

/// What was done ahead of others.
struct Speculation {
    order: SeedOrder,
    /// Which of this rank's seeds it was grown from.
    seed: usize,
    /// How much there was in the log, and how many sheets were kept, before.
    log_before: LogLengths,
    kept_before: usize,
}

/// What was done ahead of others may have to be undone.
#[derive(Default)]
struct UndoLog {
    trials: Vec<Speculation>,
    /// Candidates that are not free any more.
    changed_candidates: Vec<usize>,
    /// Those of them that are crumbs, and that other ranks see.
    fragments: Vec<usize>,
}

/// How much there is in a log.
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

    /// What was done before this turn stays done.
    fn commit_before(&mut self, turn: SeedOrder) {
        let settled = self.trials.partition_point(|trial| trial.order < turn);
        let end = self.trials.get(settled).map(|trial| trial.log_before);
        let marked = end.map_or(self.changed_candidates.len(), |end| end.changed_candidates);
        self.changed_candidates.drain(..marked);
        self.trials.drain(..settled);
        for trial in &mut self.trials {
            trial.log_before.changed_candidates -= marked;
        }
    }
}

/// Sheets that were grown and are kept: whose turn it was, and their number for the time being.
pub(super) type KeptSurfaces = Vec<(SeedOrder, u32)>;

/// One sheet after the other.
pub(super) struct SeedQueue<'s, 'a, const D: usize> {
    growth: &'s mut SurfaceGrowth<'a, D>,
    /// This rank's, in their order.
    seeds: Vec<u32>,
    /// The next of them.
    next_seed: usize,
    /// A seed whose sheet others see.
    visible_seed: Option<usize>,
    kept: KeptSurfaces,
    log: UndoLog,
    /// Sheets that this rank has numbered.
    numbered_count: usize,
}

/// Where a rank stops to go ahead.
struct StopPoint {
    order: SeedOrder,
    /// Whether the sheet whose turn it is is seen by others.
    is_visible: bool,
}

impl<'s, 'a, const D: usize> SeedQueue<'s, 'a, D> {
    /// From candidates at least as strong as `high`.
    pub fn new(growth: &'s mut SurfaceGrowth<'a, D>, high: f32) -> Self {
        let (own, candidates) = (growth.slab.owned.clone(), &growth.slab.candidates);
        let strong = own.filter(|&i| candidates[i].strength >= high);
        let mut seeds: Vec<u32> = strong.map(|i| i as u32).collect();
        // Those of one class stay in the order of samples.
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

    /// Grows all sheets; those of this rank's seeds that are kept.
    ///
    /// # Errors
    /// That of patience, and those of other ranks.
    pub fn grow_all(mut self) -> Result<KeptSurfaces> {
        let group = self.growth.slab.comm();
        // Ranks go through one class after the other, or they would go too far ahead for nothing.
        let mut end = match group.size() {
            1 => NO_SEED,
            _ => 0,
        };
        loop {
            let StopPoint {
                order: turn,
                is_visible: is_seen,
            } = self.grow_speculatively(end)?;
            let number = u64::from(self.new_number());
            let all: Vec<([u64; 2], bool)> =
                group.all_gather("seeds", ([turn, number], is_seen))?;
            let turns = all.iter().enumerate().map(|(rank, told)| (told.0[0], rank));
            let Some((first, rank)) = turns.min().filter(|(turn, _)| *turn != NO_SEED) else {
                return Ok(self.kept);
            };
            end = ((first >> CLASS_SHIFT) + 1) << CLASS_SHIFT;
            self.log.commit_before(first);
            let ([_, number], is_seen) = all[rank];
            if is_seen {
                self.undo_speculation();
                self.grow_collectively(first, rank == group.rank(), number as u32)?;
            }
        }
    }

    /// Grows the sheet whose turn it is by all ranks, of which one has the seed.
    fn grow_collectively(&mut self, turn: SeedOrder, is_own: bool, number: u32) -> Result<()> {
        let crumbs = std::mem::take(&mut self.log.fragments);
        self.growth.exchange_fragments(&crumbs)?;
        let seed = is_own.then(|| self.seeds[self.next_seed] as usize);
        let is_sheet = self.growth.grow_collectively(seed, number)?;
        if is_own {
            self.next_seed += 1;
            if is_sheet {
                self.numbered_count += 1;
                self.kept.push((turn, number));
            }
        }
        Ok(())
    }

    /// Grows sheets of own seeds up to this turn, as long as no other rank sees them.
    fn grow_speculatively(&mut self, end: SeedOrder) -> Result<StopPoint> {
        let is_shared = self.growth.slab.comm().size() > 1;
        while let Some(&seed) = self.seeds.get(self.next_seed) {
            let seed = seed as usize;
            let turn = self.seed_order(seed);
            let stop = |is_seen| {
                Ok(StopPoint {
                    order: turn,
                    is_visible: is_seen,
                })
            };
            if self.growth.state[seed] == UNASSIGNED {
                if turn >= end || is_shared && self.log.trials.len() >= MAX_SPECULATIVE_SEEDS {
                    return stop(false);
                }
                if self.visible_seed == Some(seed) {
                    return stop(true);
                }
                let (before, kept) = (self.log.lengths(), self.kept.len());
                let number = self.new_number();
                let Some(is_sheet) = self.growth.grow_locally(seed, number)? else {
                    self.visible_seed = Some(seed);
                    return stop(true);
                };
                if is_sheet {
                    self.numbered_count += 1;
                    self.kept.push((turn, number));
                }
                if is_shared {
                    self.log
                        .changed_candidates
                        .extend(self.growth.changed_candidates());
                    if !self.growth.slab.is_inner(seed) {
                        self.log.fragments.push(seed);
                    }
                    self.log.trials.push(Speculation {
                        order: turn,
                        seed: self.next_seed,
                        log_before: before,
                        kept_before: kept,
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

    /// Undoes what was done ahead.
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

    /// The turn of an own candidate.
    fn seed_order(&self, seed: usize) -> SeedOrder {
        let slab = self.growth.slab;
        (strength_class(&slab.candidates[seed]) as u64) << CLASS_SHIFT
            | slab.global_index(seed) as u64
    }

    /// A number that no other sheet has.
    fn new_number(&self) -> u32 {
        let group = self.growth.slab.comm();
        (self.numbered_count * group.size() + group.rank()) as u32
    }
}

/// The class of a candidate's strength, of [`CLASS_COUNT`] logarithmic ones: 0 is the strongest.
fn strength_class<const D: usize>(c: &Candidate<D>) -> usize {
    // The bits of a positive float sort like the float; the upper ones are class enough.
    CLASS_COUNT - 1 - (c.strength.max(0.0).to_bits() >> 19) as usize
}

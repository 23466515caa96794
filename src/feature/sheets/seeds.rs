//! From which candidates sheets are grown, one after the other: the strongest first.
//!
//! Ranks go on side by side where they can. Each goes ahead with its own seeds as long as their sheets stay where no
//! other rank sees them. The first sheet, in the order of all seeds, that does not is grown by all together; what a
//! rank has made of later seeds by then is undone. So every sheet finds what is there once all before it are grown,
//! as if one had grown all.

use super::growth::{FREE, Growth};
use crate::error::Result;
use crate::feature::crossing::Candidate;
use crate::parallel::prelude::*;

/// A rank goes ahead with so many seeds, before it hears how far others are.
const AHEAD: usize = 1 << 8;

/// The place of a seed in the order of all: its class, and its place in the order of samples.
type Turn = u64;

/// After all seeds.
const NONE: Turn = Turn::MAX;
/// Turns of one class, as a power of two.
const OF_CLASS: u32 = 48;
/// Classes of strength.
const CLASSES: usize = 1 << 12;

/// What was done ahead of others.
struct Trial {
    turn: Turn,
    /// Which of this rank's seeds it was grown from.
    seed: usize,
    /// How much there was in the log, and how many sheets were kept, before.
    before: Lengths,
    kept: usize,
}

/// What was done ahead of others may have to be undone.
#[derive(Default)]
struct Log {
    trials: Vec<Trial>,
    /// Candidates that are not free any more.
    marked: Vec<usize>,
    /// Those of them that are crumbs, and that other ranks see.
    crumbs: Vec<usize>,
}

/// How much there is in a log.
#[derive(Clone, Copy)]
struct Lengths {
    marked: usize,
    crumbs: usize,
}

impl Log {
    fn lengths(&self) -> Lengths {
        Lengths {
            marked: self.marked.len(),
            crumbs: self.crumbs.len(),
        }
    }

    /// What was done before this turn stays done.
    fn settle_before(&mut self, turn: Turn) {
        let settled = self.trials.partition_point(|trial| trial.turn < turn);
        let end = self.trials.get(settled).map(|trial| trial.before);
        let marked = end.map_or(self.marked.len(), |end| end.marked);
        self.marked.drain(..marked);
        self.trials.drain(..settled);
        for trial in &mut self.trials {
            trial.before.marked -= marked;
        }
    }
}

/// Sheets that were grown and are kept: whose turn it was, and their number for the time being.
pub(super) type Kept = Vec<(Turn, u32)>;

/// One sheet after the other.
pub(super) struct Seeds<'s, 'a, const D: usize> {
    growth: &'s mut Growth<'a, D>,
    /// This rank's, in their order.
    seeds: Vec<u32>,
    /// The next of them.
    next: usize,
    /// A seed whose sheet others see.
    seen: Option<usize>,
    kept: Kept,
    log: Log,
    /// Sheets that this rank has numbered.
    numbered: usize,
}

/// Where a rank stops to go ahead.
struct Stop {
    turn: Turn,
    /// Whether the sheet whose turn it is is seen by others.
    is_seen: bool,
}

impl<'s, 'a, const D: usize> Seeds<'s, 'a, D> {
    /// From candidates at least as strong as `high`.
    pub fn new(growth: &'s mut Growth<'a, D>, high: f32) -> Self {
        let (own, candidates) = (growth.slab.own.clone(), &growth.slab.candidates);
        let strong = own.filter(|&i| candidates[i].strength >= high);
        let mut seeds: Vec<u32> = strong.map(|i| i as u32).collect();
        // Those of one class stay in the order of samples.
        seeds.par_sort_by_key(|&i| class(&candidates[i as usize]));
        Self {
            growth,
            seeds,
            next: 0,
            seen: None,
            kept: Kept::new(),
            log: Log::default(),
            numbered: 0,
        }
    }

    /// Grows all sheets; those of this rank's seeds that are kept.
    ///
    /// # Errors
    /// That of patience, and those of other ranks.
    pub fn grow(mut self) -> Result<Kept> {
        let group = self.growth.slab.group();
        // Ranks go through one class after the other, or they would go too far ahead for nothing.
        let mut end = match group.count() {
            1 => NONE,
            _ => 0,
        };
        loop {
            let Stop { turn, is_seen } = self.go_ahead(end)?;
            let number = u64::from(self.number());
            let all: Vec<([u64; 2], bool)> = group.all("seeds", ([turn, number], is_seen))?;
            let turns = all.iter().enumerate().map(|(rank, told)| (told.0[0], rank));
            let Some((first, rank)) = turns.min().filter(|(turn, _)| *turn != NONE) else {
                return Ok(self.kept);
            };
            end = ((first >> OF_CLASS) + 1) << OF_CLASS;
            self.log.settle_before(first);
            let ([_, number], is_seen) = all[rank];
            if is_seen {
                self.undo();
                self.grow_together(first, rank == group.rank(), number as u32)?;
            }
        }
    }

    /// Grows the sheet whose turn it is by all ranks, of which one has the seed.
    fn grow_together(&mut self, turn: Turn, is_own: bool, number: u32) -> Result<()> {
        let crumbs = std::mem::take(&mut self.log.crumbs);
        self.growth.hear_of_crumbs(&crumbs)?;
        let seed = is_own.then(|| self.seeds[self.next] as usize);
        let is_sheet = self.growth.together(seed, number)?;
        if is_own {
            self.next += 1;
            if is_sheet {
                self.numbered += 1;
                self.kept.push((turn, number));
            }
        }
        Ok(())
    }

    /// Grows sheets of own seeds up to this turn, as long as no other rank sees them.
    fn go_ahead(&mut self, end: Turn) -> Result<Stop> {
        let is_shared = self.growth.slab.group().count() > 1;
        while let Some(&seed) = self.seeds.get(self.next) {
            let seed = seed as usize;
            let turn = self.turn(seed);
            let stop = |is_seen| Ok(Stop { turn, is_seen });
            if self.growth.state[seed] == FREE {
                if turn >= end || is_shared && self.log.trials.len() >= AHEAD {
                    return stop(false);
                }
                if self.seen == Some(seed) {
                    return stop(true);
                }
                let (before, kept) = (self.log.lengths(), self.kept.len());
                let number = self.number();
                let Some(is_sheet) = self.growth.alone(seed, number)? else {
                    self.seen = Some(seed);
                    return stop(true);
                };
                if is_sheet {
                    self.numbered += 1;
                    self.kept.push((turn, number));
                }
                if is_shared {
                    self.log.marked.extend(self.growth.marked());
                    if !self.growth.slab.is_inner(seed) {
                        self.log.crumbs.push(seed);
                    }
                    self.log.trials.push(Trial {
                        turn,
                        seed: self.next,
                        before,
                        kept,
                    });
                }
            }
            self.next += 1;
        }
        Ok(Stop {
            turn: NONE,
            is_seen: false,
        })
    }

    /// Undoes what was done ahead.
    fn undo(&mut self) {
        for &i in &self.log.marked {
            self.growth.state[i] = FREE;
        }
        if let Some(trial) = self.log.trials.first() {
            self.next = trial.seed;
            self.kept.truncate(trial.kept);
            self.log.crumbs.truncate(trial.before.crumbs);
        }
        self.log.trials.clear();
        self.log.marked.clear();
    }

    /// The turn of an own candidate.
    fn turn(&self, seed: usize) -> Turn {
        let slab = self.growth.slab;
        (class(&slab.candidates[seed]) as u64) << OF_CLASS | slab.number(seed) as u64
    }

    /// A number that no other sheet has.
    fn number(&self) -> u32 {
        let group = self.growth.slab.group();
        (self.numbered * group.count() + group.rank()) as u32
    }
}

/// The class of a candidate's strength, of [`CLASSES`] logarithmic ones: 0 is the strongest.
fn class<const D: usize>(c: &Candidate<D>) -> usize {
    // The bits of a positive float sort like the float; the upper ones are class enough.
    CLASSES - 1 - (c.strength.max(0.0).to_bits() >> 19) as usize
}

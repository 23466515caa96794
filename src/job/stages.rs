//! What clock and observer are told.

use crate::error::cause;
use crate::observer::{Observer, Stage};
use crate::report::{Clock, StageCost};
use crate::{Error, Result};

/// Tells clock and observer of each stage, and remembers whether one was stopped.
pub struct Stages<'a> {
    clock: Clock,
    pub(super) observer: &'a mut dyn Observer,
    interrupted: bool,
}

impl<'a> Stages<'a> {
    /// No stage yet.
    pub fn new(observer: &'a mut dyn Observer) -> Self {
        Self {
            clock: Clock::new(),
            observer,
            interrupted: false,
        }
    }

    /// A stage begins.
    pub fn begin(&mut self, stage: Stage) {
        self.clock.begin(stage);
        self.observer.stage(stage);
    }

    /// A stage begins before there is a lattice.
    ///
    /// # Errors
    /// As [`need_to_go_on`](Self::need_to_go_on).
    pub fn begin_unless_stopped(&mut self, stage: Stage) -> Result<()> {
        self.begin(stage);
        self.need_to_go_on(stage)
    }

    /// Asks whether to go on where there is no result to stop with.
    ///
    /// # Errors
    /// [`Error::Interrupted`] if the observer says no.
    pub fn need_to_go_on(&mut self, stage: Stage) -> Result<()> {
        if self.keep_going() {
            return Ok(());
        }
        Err(Error::Interrupted(cause(
            stage,
            "interrupted before there was a lattice",
            "start the job again",
        )))
    }

    /// Whether to go on; if not, the outcome will say that it was interrupted.
    pub fn keep_going(&mut self) -> bool {
        let go_on = self.observer.keep_going();
        self.interrupted |= !go_on;
        go_on
    }

    /// A stage has ended because the observer said no to it.
    pub(super) fn stopped(&mut self) {
        self.interrupted = true;
    }

    /// What every stage cost, and whether one was stopped.
    pub(super) fn end(mut self) -> (Vec<StageCost>, bool) {
        self.clock.end();
        (self.clock.costs().to_vec(), self.interrupted)
    }
}

//! Watching, and stopping, long work.

use std::fmt;
use std::sync::Mutex;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::time::Instant;

use serde::{Serialize, Serializer};

use crate::error::cause;
use crate::{Error, Result};

/// What is being done: a step of making or editing a mesh, in this order as far as a job takes them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum Stage {
    /// Files are read.
    Reading,
    /// Features are sought in the image.
    Features,
    /// Atoms are placed.
    Placing,
    /// Atoms move onto features, or alongside.
    Optimising,
    /// Atoms are joined.
    Triangulating,
    /// A triangulation of the plane is smoothed under the weight of its image.
    Smoothing,
    /// Slivers are removed by the method that is only compared with.
    ApplyingBaseline,
    /// Features are recovered and slivers removed.
    Improving,
    /// Sites are put on either side of features, and atoms around them (Voronoi cells).
    Conforming,
    /// Voronoi cells are cut.
    Cutting,
    /// The mesh is measured.
    Measuring,
    /// Files are written.
    Writing,
    /// Of an edit: features are sought everywhere, as the mesh does not say how they were found.
    FeaturesEverywhere,
    /// Of an edit: what of the mesh it concerns.
    Neighbourhoods,
    /// Of an edit: atoms around the edited ones.
    Neighbours,
    /// Of an edit: these move.
    Moving,
    /// Of an edit: cells are made anew.
    Rebuilding,
    /// Of an edit: the parts become one mesh.
    Assembling,
}

impl Stage {
    /// Whether a job that is stopped in this stage still gives a mesh: there is a lattice.
    pub fn has_lattice(self) -> bool {
        (Self::Optimising..=Self::Writing).contains(&self)
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Reading => "reading",
            Self::Features => "finding features",
            Self::Placing => "placing atoms",
            Self::Optimising => "moving atoms onto features",
            Self::Triangulating => "joining atoms",
            Self::Smoothing => "smoothing",
            Self::ApplyingBaseline => "removing slivers the other way",
            Self::Improving => "removing slivers",
            Self::Conforming => "putting sites beside features",
            Self::Cutting => "cutting cells",
            Self::Measuring => "measuring the mesh",
            Self::Writing => "writing",
            Self::FeaturesEverywhere => "finding features everywhere",
            Self::Neighbourhoods => "finding neighbourhoods",
            Self::Neighbours => "finding neighbours",
            Self::Moving => "moving atoms",
            Self::Rebuilding => "mending the mesh",
            Self::Assembling => "putting it together",
        })
    }
}

impl Serialize for Stage {
    /// The words of [`fmt::Display`].
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Where an optimisation stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OptimizeStatus {
    /// Rounds of perturbation begun, from 1.
    pub round: usize,
    /// Steps accepted, over all rounds.
    pub iterations: usize,
    /// Evaluations of the energy, over all rounds.
    pub evaluations: usize,
    /// P = (1 - beta) A + beta B now.
    pub energy: f64,
    /// A, of the lattice, now.
    pub lattice_energy: f64,
    /// B, of the image, now.
    pub image_energy: f64,
}

/// A lattice on its way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LatticeSnapshot<'a> {
    /// Of which round it is the result, from 1; 0 for the lattice with which an optimisation begins.
    pub round: usize,
    /// Where the atoms are, in lattice space.
    pub positions: &'a [[f64; 3]],
    /// P = (1 - beta) A + beta B as published.
    pub energy: f64,
    /// A, between atoms, as published.
    pub lattice_energy: f64,
    /// B, in the image.
    pub image_energy: f64,
}

/// How large a mesh will become, before it is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SizeEstimate {
    /// Atoms.
    pub atoms: f64,
    /// Tetrahedra, triangles, or Voronoi cells.
    pub cells: f64,
    /// Bytes of memory that it takes more.
    pub bytes: f64,
}

/// Sees what goes on inside the library, which itself never prints, and may ask it to stop. All
/// methods have a default that does nothing. They are called by whichever thread is at work, but never
/// by two at once.
///
/// # Stopping
/// Every long stage asks [`keep_going`](Self::keep_going) some fifty times a second, in the midst of its
/// passes over samples, atoms and cells too. What a stop gives:
///
/// | asked for | gives |
/// |---|---|
/// | before atoms move ([`Stage::Reading`] to [`Stage::Placing`]) | [`Error::Interrupted`] |
/// | while they move ([`Stage::Optimising`], [`Stage::Conforming`]) | the best lattice so far, joined and improved |
/// | while the mesh is smoothed or improved | the mesh as far as it has come: valid, with more slivers or edges across features |
/// | while it is measured | the mesh, with those figures that were found by then; whether it is valid may be missing, too |
/// | in an edit | [`Error::Interrupted`]: the mesh stays as it was |
/// | in a flow, by a [`CancelToken`] | [`Error::Interrupted`] |
///
/// Three things run to their end once they are begun: reading a file, one evaluation of the energy of all
/// atoms, and what joins all atoms at once ([`SmoothingStage::Triangulating`] and [`Stage::Cutting`], where TetGen is at
/// work, and refinement in space, where CGAL is): a stop takes effect after them. A program that must
/// end sooner has to end its process, as the command line does.
///
/// A mesh of a job that was stopped says so: its `stop` is
/// [`Stop::Interrupted`](crate::densest_lattice::optimize::StopPoint::Interrupted). Every stage asks afresh: an
/// observer that goes on saying no from stage to stage leaves out all that can be left out.
pub trait Progress: Send {
    /// A stage begins.
    fn stage(&mut self, _stage: Stage) {}

    /// A line that a user should know.
    fn note(&mut self, _line: &str) {}

    /// The distance between atoms is known, none is placed.
    fn estimate(&mut self, _estimate: &SizeEstimate) {}

    /// A step of the optimiser has been accepted.
    fn optimize_step(&mut self, _progress: &OptimizeStatus) {}

    /// So much of the stage is done, in [0, 1], where that is known; said now and then, and never less
    /// than before.
    fn fraction_done(&mut self, _share: f64) {}

    /// The lattice before atoms move, and after each round of the optimiser (each generation of a
    /// genetic algorithm).
    fn lattice(&mut self, _snapshot: &LatticeSnapshot<'_>) {}

    /// Whether [`lattice`](Self::lattice) shall be called: each call takes an evaluation of the energy.
    fn wants_lattices(&self) -> bool {
        false
    }

    /// Whether to go on; `false` ends the stage soon.
    fn keep_going(&mut self) -> bool {
        true
    }
}

/// An observer that does not look.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoProgress;

impl Progress for NoProgress {}

/// Asks an observer whether to go on, now and then, from any thread that is at work; once told to stop,
/// it does not ask again.
///
/// What takes long asks it once a row or a step, and where it is over leaves the rest undone: whoever
/// gave it must look whether it is [`over`](Self::is_cancelled) before trusting the result.
pub struct CancelToken<'a> {
    callback: Option<&'a (dyn Fn(Option<f64>) -> bool + Sync)>,
    start: Instant,
    /// When to ask again, in milliseconds from the beginning.
    next_poll_ms: AtomicU64,
    is_cancelled: AtomicBool,
    /// The bits of the share that is done, which rise with it; and of where the part at work begins and
    /// ends.
    fraction_bits: AtomicU64,
    range_bits: [AtomicU64; 2],
}

/// What a [`CancelToken`] asks, given the share that is done where that is known.
type ProgressCallback<'a> = &'a mut (dyn FnMut(Option<f64>) -> bool + Send);

/// Milliseconds between two questions; unit tests count them all.
const POLL_INTERVAL_MS: u64 = if cfg!(test) { 0 } else { 20 };

impl<'a> CancelToken<'a> {
    /// Without end.
    pub fn never() -> Self {
        Self {
            callback: None,
            start: Instant::now(),
            next_poll_ms: AtomicU64::new(0),
            is_cancelled: AtomicBool::new(false),
            fraction_bits: AtomicU64::new(0),
            range_bits: [0.0, 1.0].map(|share: f64| AtomicU64::new(share.to_bits())),
        }
    }

    /// Until `ask` says no.
    fn new(ask: &'a (dyn Fn(Option<f64>) -> bool + Sync)) -> Self {
        Self {
            callback: Some(ask),
            ..Self::never()
        }
    }

    /// What `work` gives as long as an observer has patience, which is asked at once.
    pub fn run<T>(
        keep_going: &mut (dyn FnMut() -> bool + Send),
        work: impl FnOnce(&CancelToken<'_>) -> T,
    ) -> T {
        Self::run_with_progress(&mut |_| keep_going(), work)
    }

    /// The same, and whoever is asked is told how much is done.
    pub fn run_with_progress<T>(
        keep_going: ProgressCallback<'_>,
        work: impl FnOnce(&CancelToken<'_>) -> T,
    ) -> T {
        // The answer is kept beside the question: whoever comes between a no and its being known to all
        // does not ask again.
        let asked = Mutex::new((true, keep_going));
        // Who finds another asking goes on.
        let ask = |share| {
            asked.try_lock().map_or(true, |mut asked| {
                let (patient, keep_going) = &mut *asked;
                *patient = *patient && keep_going(share);
                *patient
            })
        };
        work(&CancelToken::new(&ask))
    }

    /// Whether to stop here.
    #[inline]
    pub fn is_cancelled(&self) -> bool {
        if self.is_cancelled.load(Relaxed) {
            return true;
        }
        let Some(ask) = self.callback else {
            return false;
        };
        let now = self.start.elapsed().as_millis() as u64;
        let next = self.next_poll_ms.load(Relaxed);
        let due = now >= next
            && self
                .next_poll_ms
                .compare_exchange(next, now + POLL_INTERVAL_MS, Relaxed, Relaxed)
                .is_ok();
        if due && !ask(self.fraction()) {
            self.is_cancelled.store(true, Relaxed);
        }
        self.is_cancelled.load(Relaxed)
    }

    /// So much of the [part](Self::submesh) at work is done, in [0, 1]. A guess will do: it is for whoever
    /// waits.
    pub fn set_fraction(&self, share: f64) {
        let [from, to] = [0, 1].map(|k| f64::from_bits(self.range_bits[k].load(Relaxed)));
        let share = from + (to - from) * share.clamp(0.0, 1.0);
        self.fraction_bits.fetch_max(share.to_bits(), Relaxed);
    }

    /// What comes now takes the work from one share of the whole to another.
    pub fn set_range(&self, from: f64, to: f64) {
        self.range_bits[0].store(from.to_bits(), Relaxed);
        self.range_bits[1].store(to.to_bits(), Relaxed);
        self.set_fraction(0.0);
    }

    /// How much is done, where any work has said so.
    fn fraction(&self) -> Option<f64> {
        let share = f64::from_bits(self.fraction_bits.load(Relaxed));
        (share > 0.0).then_some(share)
    }

    /// Refuses to go on once it is over, where there is no result to stop with.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub fn check(&self, stage: Stage) -> Result<()> {
        if self.is_cancelled() {
            return Err(interrupted_error(stage));
        }
        Ok(())
    }
}

/// An observer that only looks whether there is patience left.
pub(crate) struct TokenProgress<'a>(pub &'a CancelToken<'a>);

impl Progress for TokenProgress<'_> {
    fn keep_going(&mut self) -> bool {
        !self.0.is_cancelled()
    }
}

impl fmt::Debug for CancelToken<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let over = self.is_cancelled.load(Relaxed);
        f.debug_struct("Patience").field("over", &over).finish()
    }
}

/// What is said of a stage that was stopped before there was a result.
pub(crate) fn interrupted_error(stage: Stage) -> Error {
    Error::Interrupted(cause(
        stage,
        "interrupted before there was a lattice",
        "start the job again",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_done_is_told_part_by_part_and_never_less_than_before() {
        let mut told = Vec::new();
        let mut ask = |share: Option<f64>| {
            told.push(share);
            true
        };
        CancelToken::run_with_progress(&mut ask, |patience| {
            let say = |share| {
                patience.set_fraction(share);
                patience.is_cancelled();
            };
            say(0.0);
            say(0.5);
            say(0.25);
            patience.set_range(0.75, 1.0);
            say(0.0);
            say(0.5);
            say(7.0);
        });
        let all = [0.5, 0.5, 0.75, 0.875, 1.0].map(Some);
        assert_eq!(told[0], None);
        assert_eq!(told[1..], all);
    }

    #[test]
    fn after_a_no_nobody_asks_again_however_many_ask_at_once() {
        for _ in 0..200 {
            let mut asked = 0;
            let mut ask = || {
                asked += 1;
                asked < 50
            };
            CancelToken::run(&mut ask, |patience| {
                std::thread::scope(|scope| {
                    for _ in 0..4 {
                        scope.spawn(|| while !patience.is_cancelled() {});
                    }
                });
            });
            assert_eq!(asked, 50);
        }
    }
}

//! Reports the progress of long work, and stops it on request.
//!
//! - [`Progress`]: the trait by which a caller follows a job and may stop it
//! - [`CancelToken`]: what long loops poll to learn whether to stop
//! - [`Stage`]: the stages of a job or an edit
//! - [`cost`]: seconds and memory of each stage

pub mod cost;

use std::fmt;
use std::sync::Mutex;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::time::Instant;

use serde::{Serialize, Serializer};

use crate::error::cause;
use crate::memory::Bytes;
use crate::{Error, Result};
pub use cost::{Clock, StageCost};

/// A stage of making, editing or using a mesh. The variants up to [`Writing`](Self::Writing) are in
/// the order in which a job runs them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum Stage {
    /// Files are read.
    Reading,
    /// Features are detected in the image.
    Features,
    /// Atoms are placed.
    Placing,
    /// Atoms move onto features, or to places alongside them.
    Optimising,
    /// Atoms are joined by a Delaunay triangulation.
    Triangulating,
    /// A triangulation of the plane is smoothed, weighted by its image.
    Smoothing,
    /// Slivers are removed by the baseline method, whose result is only compared with.
    ApplyingBaseline,
    /// Features are recovered and slivers removed.
    Improving,
    /// Sites are placed on both sides of features, and atoms around the sites (Voronoi cells).
    Conforming,
    /// Voronoi cells are cut.
    Cutting,
    /// The mesh is measured.
    Measuring,
    /// The mesh is continued beyond its image.
    Padding,
    /// Files are written.
    Writing,
    /// In an edit: features are detected in the whole image, as the mesh does not record how they
    /// were found.
    FeaturesEverywhere,
    /// In an edit: the parts of the mesh that the edit changes are found.
    Neighbourhoods,
    /// In an edit: the atoms around the edited ones are found.
    Neighbours,
    /// In an edit: the edited atoms and their neighbours move.
    Moving,
    /// In an edit: the cells of the changed parts are built again.
    Rebuilding,
    /// In an edit: the changed and the unchanged parts are assembled into one mesh.
    Assembling,
    /// Faces on features are grouped into surfaces.
    GroupingFaces,
    /// In a flow computation: faces on features are grouped into faults.
    GroupingFaults,
    /// In a flow computation: pressure is computed.
    Pressure,
    /// The cells of a map are extended through layers.
    BuildingColumns,
    /// Regions grow from seeds.
    Painting,
    /// In a segmentation: the image is averaged over cells.
    Averaging,
    /// In a segmentation: object and background are separated.
    Separating,
    /// In a segmentation: the image's samples are separated.
    SeparatingSamples,
    /// A picture is drawn.
    Drawing,
    /// In an export: the properties of cells are set.
    FillingCells,
    /// In an export: the model is checked.
    Checking,
}

impl Stage {
    /// Returns `true` if a job that is stopped in this stage still returns a mesh, because there is
    /// a lattice.
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
            Self::ApplyingBaseline => "removing slivers (baseline)",
            Self::Improving => "removing slivers",
            Self::Conforming => "placing sites along features",
            Self::Cutting => "cutting cells",
            Self::Padding => "continuing beyond the image",
            Self::Measuring => "measuring the mesh",
            Self::Writing => "writing",
            Self::FeaturesEverywhere => "finding features everywhere",
            Self::Neighbourhoods => "finding neighbourhoods",
            Self::Neighbours => "finding neighbours",
            Self::Moving => "moving atoms",
            Self::Rebuilding => "rebuilding the mesh",
            Self::Assembling => "assembling the mesh",
            Self::GroupingFaces => "grouping faces",
            Self::GroupingFaults => "grouping faces into faults",
            Self::Pressure => "computing pressure",
            Self::BuildingColumns => "building columns",
            Self::Painting => "painting",
            Self::Averaging => "averaging",
            Self::Separating => "cutting",
            Self::SeparatingSamples => "cutting samples",
            Self::Drawing => "drawing",
            Self::FillingCells => "filling cells",
            Self::Checking => "checking",
        })
    }
}

impl Serialize for Stage {
    /// Serialises the stage as the text of [`fmt::Display`].
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// The state of an optimisation that is running.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OptimiseStatus {
    /// Number of the current round of perturbation, from 1.
    pub round: usize,
    /// Number of accepted steps, over all rounds.
    pub iterations: usize,
    /// Number of evaluations of the energy, over all rounds.
    pub evaluations: usize,
    /// Largest number of evaluations, over all rounds.
    pub max_evaluations: usize,
    /// Current total energy P = (1 - beta) A + beta B.
    pub energy: f64,
    /// Current energy A of the lattice.
    pub lattice_energy: f64,
    /// Current energy B of the image.
    pub image_energy: f64,
}

/// A lattice between two rounds of an optimisation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LatticeSnapshot<'a> {
    /// The round whose result this lattice is, from 1; 0 for the lattice with which an optimisation
    /// begins.
    pub round: usize,
    /// Positions of the atoms, in lattice space.
    pub positions: &'a [[f64; 3]],
    /// Total energy P = (1 - beta) A + beta B, as published.
    pub energy: f64,
    /// Energy A between atoms, as published.
    pub lattice_energy: f64,
    /// Energy B of the atoms in the image.
    pub image_energy: f64,
}

/// Start of a note on what neither the files nor the options say, and was assumed. The verdict repeats
/// these notes.
pub(crate) const ASSUMED: &str = "assumed: ";

/// Estimated size of a mesh, before it is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SizeEstimate {
    /// Number of atoms.
    pub atoms: f64,
    /// Number of tetrahedra, triangles or Voronoi cells.
    pub cells: f64,
    /// Memory in bytes that the mesh takes in addition to what is used already.
    pub bytes: f64,
}

impl fmt::Display for OptimiseStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "round {}, energy {:.4e}", self.round, self.energy)
    }
}

impl OptimiseStatus {
    /// Returns the fraction of the evaluations that are done.
    pub fn fraction(&self) -> f64 {
        self.evaluations as f64 / self.max_evaluations as f64
    }
}

impl fmt::Display for SizeEstimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "about {} atoms, {} cells, {} of memory",
            round_to_two_digits(self.atoms),
            round_to_two_digits(self.cells),
            Bytes(self.bytes)
        )
    }
}

/// Formats a number with two significant digits.
fn round_to_two_digits(number: f64) -> String {
    match number {
        n if n >= 1e6 => format!("{:.1} million", n / 1e6),
        n => {
            let step = 10f64.powf((n.max(10.0)).log10().floor() - 1.0);
            format!("{:.0}", (n / step).round() * step)
        }
    }
}

/// Follows a job, and may stop it.
///
/// The library itself never prints. All methods have a default that does nothing. The thread that
/// is at work calls them, and never two threads at once.
///
/// # Stopping
/// Every long stage calls [`keep_going`](Self::keep_going) about fifty times a second, also inside
/// its loops over samples, atoms and cells. The result of a stop depends on the stage:
///
/// | stopped | result |
/// |---|---|
/// | before atoms move ([`Stage::Reading`] to [`Stage::Placing`]) | [`Error::Interrupted`] |
/// | while they move ([`Stage::Optimising`], [`Stage::Conforming`]) | the best lattice so far, joined and improved |
/// | while the mesh is smoothed or improved | the mesh so far: valid, with more slivers or edges across features |
/// | while it is measured | the mesh, with the figures that were complete by then; the validity check may be missing, too |
/// | in an edit | [`Error::Interrupted`]; the mesh stays as it was |
/// | in a flow computation | [`Error::Interrupted`] |
///
/// Three operations run to their end once they have begun, and a stop takes effect after them:
/// reading a file, one evaluation of the energy of all atoms, and an operation that joins all atoms
/// at once (in [`Stage::Triangulating`] and [`Stage::Cutting`]). A program that must end sooner has to
/// end its process, as the command line does.
///
/// The result of a job that was stopped has the `stop` reason `StopReason::Interrupted`. Every stage
/// polls again: if `keep_going` continues to return `false`, all later stages are shortened as
/// well.
pub trait Progress: Send {
    /// Is called when a stage begins.
    fn stage(&mut self, _stage: Stage) {}

    /// Is called with a line of text that the user should read.
    fn note(&mut self, _line: &str) {}

    /// Is called when the distance between atoms is known and no atom is placed yet.
    fn estimate(&mut self, _estimate: &SizeEstimate) {}

    /// Is called after each accepted step of the optimiser.
    fn optimise_step(&mut self, _progress: &OptimiseStatus) {}

    /// Is called from time to time with the fraction of the stage that is done, in [0, 1], if it is
    /// known. The fraction never decreases within a stage.
    fn fraction_done(&mut self, _fraction: f64) {}

    /// Is called with the lattice before atoms move, and after each round of the optimiser (each
    /// generation of a genetic algorithm).
    fn lattice(&mut self, _snapshot: &LatticeSnapshot<'_>) {}

    /// Returns `true` if [`lattice`](Self::lattice) is to be called. Each call costs an evaluation
    /// of the energy.
    fn wants_lattices(&self) -> bool {
        false
    }

    /// Returns `true` if the work is to continue; `false` ends the stage soon.
    fn keep_going(&mut self) -> bool {
        true
    }
}

/// A [`Progress`] that ignores everything and never stops the work.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoProgress;

impl Progress for NoProgress {}

/// A token by which long work learns, from any of its threads, whether to stop. Once it is
/// cancelled, it does not call back again.
///
/// Long work polls the token once per row or step and leaves the rest undone when it is cancelled.
/// The caller must check [`is_cancelled`](Self::is_cancelled) before it trusts the result.
pub struct CancelToken<'a> {
    callback: Option<&'a (dyn Fn(Option<f64>) -> bool + Sync)>,
    start: Instant,
    /// Time of the next callback, in milliseconds after `start`.
    next_poll_ms: AtomicU64,
    is_cancelled: AtomicBool,
    /// Bits of the fraction that is done. Non-negative floats have the same order as their bits, so
    /// that an atomic maximum of the bits is one of the fractions.
    fraction_bits: AtomicU64,
    range_bits: [AtomicU64; 2],
}

/// The callback of a [`CancelToken`]. It receives the fraction that is done, if that is known, and
/// returns `true` if the work is to continue.
type ProgressCallback<'a> = &'a mut (dyn FnMut(Option<f64>) -> bool + Send);

/// Time between two callbacks, in milliseconds. It is 0 in unit tests, which count the callbacks.
const POLL_INTERVAL_MS: u64 = if cfg!(test) { 0 } else { 20 };

impl<'a> CancelToken<'a> {
    /// Returns a token that is never cancelled.
    pub fn never() -> Self {
        Self {
            callback: None,
            start: Instant::now(),
            next_poll_ms: AtomicU64::new(0),
            is_cancelled: AtomicBool::new(false),
            fraction_bits: AtomicU64::new(0),
            range_bits: [0.0, 1.0].map(|fraction: f64| AtomicU64::new(fraction.to_bits())),
        }
    }

    /// Returns a token that is cancelled when `callback` returns `false`.
    fn new(callback: &'a (dyn Fn(Option<f64>) -> bool + Sync)) -> Self {
        Self {
            callback: Some(callback),
            ..Self::never()
        }
    }

    /// Runs `work` with a token that is cancelled when `keep_going` returns `false`, and returns
    /// the result of `work`. The first poll calls `keep_going` at once.
    pub fn run<T>(
        keep_going: &mut (dyn FnMut() -> bool + Send),
        work: impl FnOnce(&CancelToken<'_>) -> T,
    ) -> T {
        Self::run_with_progress(&mut |_| keep_going(), work)
    }

    /// Runs `work` like [`run`](Self::run), with a callback that also receives the fraction that is
    /// done.
    pub fn run_with_progress<T>(
        keep_going: ProgressCallback<'_>,
        work: impl FnOnce(&CancelToken<'_>) -> T,
    ) -> T {
        // The last answer is stored under the same lock as the callback. A thread that polls after
        // a `false` and before `is_cancelled` is set must not call back again.
        let state = Mutex::new((true, keep_going));
        // A thread that finds the lock taken continues: another thread is calling back.
        let callback = |fraction| {
            state.try_lock().map_or(true, |mut state| {
                let (is_running, keep_going) = &mut *state;
                *is_running = *is_running && keep_going(fraction);
                *is_running
            })
        };
        work(&CancelToken::new(&callback))
    }

    /// Returns `true` if the work must stop.
    #[inline]
    pub fn is_cancelled(&self) -> bool {
        if self.is_cancelled.load(Relaxed) {
            return true;
        }
        let Some(callback) = self.callback else {
            return false;
        };
        let now = self.start.elapsed().as_millis() as u64;
        let next = self.next_poll_ms.load(Relaxed);
        let due = now >= next
            && self
                .next_poll_ms
                .compare_exchange(next, now + POLL_INTERVAL_MS, Relaxed, Relaxed)
                .is_ok();
        if due && !callback(self.fraction()) {
            self.is_cancelled.store(true, Relaxed);
        }
        self.is_cancelled.load(Relaxed)
    }

    /// Records that this fraction of the current [range](Self::set_range) is done, in [0, 1]. An
    /// approximate value is enough, as it is only shown to the user.
    pub fn set_fraction(&self, fraction: f64) {
        let [start, end] = [0, 1].map(|k| f64::from_bits(self.range_bits[k].load(Relaxed)));
        let fraction = start + (end - start) * fraction.clamp(0.0, 1.0);
        self.fraction_bits.fetch_max(fraction.to_bits(), Relaxed);
    }

    /// Declares that the work that follows takes the total fraction from `start` to `end`.
    pub fn set_range(&self, start: f64, end: f64) {
        self.range_bits[0].store(start.to_bits(), Relaxed);
        self.range_bits[1].store(end.to_bits(), Relaxed);
        self.set_fraction(0.0);
    }

    /// Returns the fraction that is done, if any work has recorded one.
    fn fraction(&self) -> Option<f64> {
        let fraction = f64::from_bits(self.fraction_bits.load(Relaxed));
        (fraction > 0.0).then_some(fraction)
    }

    /// Returns an error if the token is cancelled. For stages without a result so far.
    ///
    /// # Errors
    /// Returns [`Error::Interrupted`] if the token is cancelled.
    pub fn check(&self, stage: Stage) -> Result<()> {
        if self.is_cancelled() {
            return Err(interrupted_error(stage));
        }
        Ok(())
    }
}

/// A [`Progress`] that stops the work when a token is cancelled.
pub(crate) struct TokenProgress<'a>(pub &'a CancelToken<'a>);

impl Progress for TokenProgress<'_> {
    fn keep_going(&mut self) -> bool {
        !self.0.is_cancelled()
    }
}

impl fmt::Debug for CancelToken<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let is_cancelled = self.is_cancelled.load(Relaxed);
        f.debug_struct("CancelToken")
            .field("is_cancelled", &is_cancelled)
            .finish()
    }
}

/// Returns the error of a stage that was stopped before there was a result.
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
    fn progress_is_reported_range_by_range_and_never_decreases() {
        let mut reported = Vec::new();
        let mut callback = |fraction: Option<f64>| {
            reported.push(fraction);
            true
        };
        CancelToken::run_with_progress(&mut callback, |cancel| {
            let report = |fraction| {
                cancel.set_fraction(fraction);
                cancel.is_cancelled();
            };
            report(0.0);
            report(0.5);
            report(0.25);
            cancel.set_range(0.75, 1.0);
            report(0.0);
            report(0.5);
            report(7.0);
        });
        let all = [0.5, 0.5, 0.75, 0.875, 1.0].map(Some);
        assert_eq!(reported[0], None);
        assert_eq!(reported[1..], all);
    }

    #[test]
    fn a_cancelled_token_does_not_call_back_again() {
        for _ in 0..200 {
            let mut calls = 0;
            let mut keep_going = || {
                calls += 1;
                calls < 50
            };
            CancelToken::run(&mut keep_going, |cancel| {
                std::thread::scope(|scope| {
                    for _ in 0..4 {
                        scope.spawn(|| while !cancel.is_cancelled() {});
                    }
                });
            });
            assert_eq!(calls, 50);
        }
    }
}

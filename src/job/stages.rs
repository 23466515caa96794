//! Reports the stages of a job to the clock and the caller.

use super::checkpoint::{Codec, JobCheckpoint, StoredStage};
use crate::Result;
use crate::comm::{Comm, SelfComm};
use crate::lattice::owned_atoms::OwnedAtoms;
use crate::lattice::seeding::Atoms;
use crate::mesh::delaunay::DelaunayKernel;
use crate::progress::{CancelToken, Progress, Stage, interrupted_error};
use crate::report::{Clock, StageCost};

/// Runs the stages of a job: reports each to the clock and the caller, stores results in the
/// checkpoint, and records whether a stage was stopped.
pub struct StageRunner<'a> {
    clock: Clock,
    pub(super) progress: &'a mut dyn Progress,
    interrupted: bool,
    checkpoint: Option<JobCheckpoint>,
    /// `true` if each rank may hold only a part of the mesh.
    pub(super) may_partition: bool,
    /// The program that joins atoms to tetrahedra.
    pub(super) kernel: DelaunayKernel,
    /// The ranks that share the job.
    pub(super) comm: &'a dyn Comm,
}

impl<'a> StageRunner<'a> {
    /// Returns a runner that has not begun a stage.
    pub fn new(progress: &'a mut dyn Progress) -> Self {
        Self {
            clock: Clock::new(),
            progress,
            interrupted: false,
            checkpoint: None,
            may_partition: false,
            kernel: DelaunayKernel::Auto,
            comm: &SelfComm,
        }
    }

    /// Joins atoms by `kernel`.
    pub(super) fn with_kernel(self, kernel: DelaunayKernel) -> Self {
        Self { kernel, ..self }
    }

    /// Shares the job among the ranks of `comm`.
    pub(super) fn with_comm(self, comm: &'a dyn Comm) -> Self {
        Self { comm, ..self }
    }

    /// Returns this runner with a checkpoint that stores the results of stages.
    pub(super) fn with_checkpoint(mut self, checkpoint: Option<JobCheckpoint>) -> Self {
        self.checkpoint = checkpoint;
        self
    }

    /// Returns this runner, which may distribute the mesh over ranks.
    pub(super) fn with_partitioning(self, may_partition: bool) -> Self {
        Self {
            may_partition,
            ..self
        }
    }

    /// Runs `work` and stores its result under this name, or loads the result that an earlier run
    /// of the job stored.
    ///
    /// # Errors
    /// Returns the errors of the work, and those of storing its result.
    pub(super) fn load_or_run<T: Codec>(
        &mut self,
        name: &str,
        work: impl FnOnce(&mut Self) -> Result<T>,
    ) -> Result<T> {
        if self.checkpoint.is_some()
            && let Some(value) = self
                .comm
                .broadcast_from_root(name, || Ok(self.load(name)))?
        {
            return Ok(value);
        }
        let value = work(self)?;
        if self.comm.is_root() {
            self.save(name, &value)?;
        }
        Ok(value)
    }

    /// Loads the result of this name from the checkpoint.
    fn load<T: Codec>(&mut self, name: &str) -> Option<T> {
        match self.checkpoint.as_ref()?.load(name) {
            StoredStage::Complete(value) => Some(value),
            StoredStage::Unusable(reason) => {
                self.progress.note(&reason);
                None
            }
            StoredStage::Missing => None,
        }
    }

    /// Stores the result of a stage, unless it was stopped and the result is incomplete.
    fn save<T: Codec>(&mut self, name: &str, value: &T) -> Result<()> {
        let is_complete = self.checkpoint.is_some() && self.keep_going() && !self.interrupted;
        let checkpoint = self.checkpoint.as_ref().filter(|_| is_complete);
        checkpoint.map_or(Ok(()), |checkpoint| checkpoint.save(name, value))
    }

    /// Runs `work` like [`load_or_run`](Self::load_or_run), for a lattice of which each rank has a
    /// share. Only the root rank ever holds all atoms, and only if they are stored.
    ///
    /// # Errors
    /// Returns the errors of the work, and those of storing its result.
    pub(super) fn load_or_run_shares<const D: usize, T: Codec>(
        &mut self,
        name: &str,
        work: impl FnOnce(&mut Self) -> Result<(OwnedAtoms<D>, T)>,
    ) -> Result<(OwnedAtoms<D>, T)> {
        if self.checkpoint.is_none() {
            return work(self);
        }
        let mut atoms = Atoms::default();
        let stored = self.comm.broadcast_from_root(name, || {
            Ok(self.load(name).map(|(loaded, value)| {
                atoms = loaded;
                value
            }))
        })?;
        if let Some(value) = stored {
            return Ok((OwnedAtoms::scatter_from_root(atoms, self.comm)?, value));
        }
        let (owned, value) = work(self)?;
        let result = (owned.clone().gather_to_root(self.comm)?, value);
        if self.comm.is_root() {
            self.save(name, &result)?;
        }
        Ok((owned, result.1))
    }

    /// Begins a stage.
    pub fn begin(&mut self, stage: Stage) {
        self.clock.begin(stage);
        self.progress.stage(stage);
    }

    /// Begins a stage before there is a lattice.
    ///
    /// # Errors
    /// Returns the errors of [`check_interrupted`](Self::check_interrupted).
    pub fn begin_unless_stopped(&mut self, stage: Stage) -> Result<()> {
        self.begin(stage);
        self.check_interrupted(stage)
    }

    /// Checks whether to continue, for stages without a result so far.
    ///
    /// # Errors
    /// Returns [`Error::Interrupted`](crate::Error::Interrupted) if the caller has stopped the job.
    pub fn check_interrupted(&mut self, stage: Stage) -> Result<()> {
        if self.keep_going() {
            return Ok(());
        }
        Err(interrupted_error(stage))
    }

    /// Runs `work`, which ends soon after the caller stops the job.
    pub(super) fn run_cancellable<T>(&mut self, work: impl FnOnce(&CancelToken<'_>) -> T) -> T {
        let callback = &mut |fraction: Option<f64>| {
            if let Some(fraction) = fraction {
                self.progress.fraction_done(fraction);
            }
            self.keep_going()
        };
        CancelToken::run_with_progress(callback, work)
    }

    /// Runs `work`, for stages without a result so far.
    ///
    /// # Errors
    /// Returns the errors of the work, and [`Error::Interrupted`](crate::Error::Interrupted) if the
    /// caller stops the job.
    pub(super) fn run_or_interrupt<T>(
        &mut self,
        stage: Stage,
        work: impl FnOnce(&CancelToken<'_>) -> Result<T>,
    ) -> Result<T> {
        self.run_cancellable(|cancel| {
            let result = work(cancel);
            // Work that was left undone after an interruption may look like another error.
            cancel.check(stage)?;
            result
        })
    }

    /// Returns `true` if the job is to continue. Otherwise, it records that the job was
    /// interrupted.
    pub fn keep_going(&mut self) -> bool {
        let keeps_going = self.progress.keep_going();
        self.interrupted |= !keeps_going;
        keeps_going
    }

    /// Records that a stage ended because the caller stopped the job.
    pub(super) fn mark_interrupted(&mut self) {
        self.interrupted = true;
    }

    /// Returns the cost of every stage, and `true` if a stage was stopped.
    pub(super) fn finish(mut self) -> (Vec<StageCost>, bool) {
        self.clock.end();
        (self.clock.costs().to_vec(), self.interrupted)
    }
}

#[cfg(test)]
mod tests {
    use crate::job::Optimizer;
    use crate::job::spec::{DistanceSource, MeshSpec, NominalDistance, SeedingKind};
    use std::collections::BTreeMap;

    use super::*;
    use crate::ErrorKind;
    use crate::feature::{FeatureKind, SharedGrid};
    use crate::image::synth::{self, SyntheticKind};
    use crate::image::{Geometry, Image, ImageSource};
    use crate::job::{self, BOX_TOLERANCE, CellKind, MeshImage, MeshResult, Outcome, Params};
    use crate::lattice::optimise::StopReason;
    use crate::mesh::Space;
    use crate::mesh::check::{CheckHints, check, check_with_hints};

    /// Counts polls by stage; stops the job from some poll of one stage on.
    #[derive(Default)]
    struct CountingProgress {
        current: Option<Stage>,
        polls: BTreeMap<Stage, usize>,
        stop_at: Option<(Stage, usize)>,
        is_stopped: bool,
    }

    impl Progress for CountingProgress {
        fn stage(&mut self, stage: Stage) {
            self.current = Some(stage);
        }

        fn keep_going(&mut self) -> bool {
            let Some(stage_now) = self.current else {
                return true;
            };
            let count = self.polls.entry(stage_now).or_default();
            *count += 1;
            self.is_stopped |= self
                .stop_at
                .is_some_and(|(stage, after)| stage == stage_now && *count > after);
            !self.is_stopped
        }
    }

    fn run<const D: usize>(
        image: &Image<D>,
        params: &Params<D>,
        stop: Option<(Stage, usize)>,
    ) -> (Result<Outcome<D>>, CountingProgress)
    where
        Space<D>: MeshImage<D>,
    {
        let mut progress = CountingProgress {
            stop_at: stop,
            ..CountingProgress::default()
        };
        let outcome = job::run(image, params, &mut progress);
        (outcome, progress)
    }

    /// Checks that every named stage polls at least this often, and that a stop at its first poll,
    /// its second and in the middle has the documented result.
    fn assert_stops<const D: usize>(image: &Image<D>, params: &Params<D>, stages: &[(Stage, usize)])
    where
        Space<D>: MeshImage<D>,
    {
        let (outcome, counted) = run(image, params, None);
        assert_ne!(outcome.unwrap().stop, StopReason::Interrupted);
        for &(stage, min_count) in stages {
            let count = counted.polls.get(&stage).copied().unwrap_or(0);
            assert!(count >= min_count, "{stage}: polled {count} times");
            for after in [0, 1, count / 2].into_iter().filter(|&n| n < count) {
                let (outcome, progress) = run(image, params, Some((stage, after)));
                if !progress.is_stopped {
                    // Loops poll at intervals of time, so a run on an idle machine polls less often.
                    let polls = progress.polls.get(&stage).copied().unwrap_or(0);
                    assert!(
                        after > 1 && polls <= after,
                        "{stage}: went on after {after}"
                    );
                    continue;
                }
                match outcome {
                    Err(error) => {
                        assert_eq!(error.kind(), ErrorKind::Interrupted, "{stage}: {error}");
                        assert!(!stage.has_lattice(), "{stage}: {error}");
                    }
                    Ok(outcome) => {
                        assert!(stage.has_lattice(), "{stage} gave a mesh after {after}");
                        assert_eq!(
                            outcome.stop,
                            StopReason::Interrupted,
                            "{stage} after {after}"
                        );
                        let (low, tolerance) = ([0.0; D], BOX_TOLERANCE);
                        let check = match &outcome.mesh {
                            MeshResult::Simplices(annotated) => {
                                check(&annotated.mesh, low, outcome.extent, tolerance)
                            }
                            MeshResult::Voronoi { mesh, weld } => {
                                let hints = CheckHints {
                                    weld: *weld,
                                    ..CheckHints::default()
                                };
                                check_with_hints(mesh, hints, low, outcome.extent, tolerance)
                            }
                        };
                        assert!(check.passed(), "{stage} after {after}: {check:?}");
                        // The job stays stopped, so that only figures that were measured before are
                        // present.
                        let report = outcome.report;
                        let is_measured = report.box_check.is_some() || report.voronoi.is_some();
                        let may_measure = stage == Stage::Measuring && after > 0;
                        assert!(may_measure || !is_measured, "{stage} after {after}");
                        let is_compared = report.fidelity.is_some();
                        assert!(may_measure || !is_compared, "{stage} after {after}");
                    }
                }
            }
        }
    }

    fn ball() -> Image<3> {
        let options = synth::Options {
            dims: [36, 33, 30],
            ..Default::default()
        };
        synth::make(SyntheticKind::Sphere, &options).unwrap().image
    }

    /// Returns an image of a disc with a soft edge.
    fn disc() -> Image<2> {
        let off = |i: usize| ((i % 60) as f32 - 30.0).hypot((i / 60) as f32 - 25.0) - 15.0;
        let samples = (0..60 * 50).map(|i| 50.0 - 20.0 * off(i).clamp(-2.0, 2.0));
        Image::new([60, 50], samples.collect(), Geometry::default())
    }

    /// Returns parameters with this feature and seeding, as fine at features as the sizes of these
    /// images allow.
    fn params<const D: usize>(feature: FeatureKind, seeding: SeedingKind) -> Params<D> {
        Params::new(MeshSpec {
            feature,
            seeding,
            distance: NominalDistance::Range { min: 5.0, max: 7.0 },
            distance_from: DistanceSource::Features,
            ..MeshSpec::default()
        })
        .unwrap()
    }

    #[test]
    fn detection_of_every_kind_of_feature_can_be_stopped() {
        use FeatureKind::*;
        let image = ball();
        // One poll for each row of samples in each pass; there are at least three passes.
        let rows = 33 * 30;
        for kind in [
            Ridges,
            Valleys,
            Edges,
            Canny,
            Horizons,
            Faults,
            FaultsAndHorizons,
        ] {
            let params = params::<3>(kind, SeedingKind::Fcc);
            let options = params.feature_options([1.0; 3]);
            let detect = |stop: usize| {
                let mut progress = CountingProgress {
                    current: Some(Stage::Features),
                    stop_at: Some((Stage::Features, stop)),
                    ..CountingProgress::default()
                };
                let result = CancelToken::run(&mut || progress.keep_going(), |cancel| {
                    crate::feature::detect_with_cancel(
                        ImageSource::InMemory(&image),
                        &options,
                        SharedGrid::of_one_process(image.dims()),
                        cancel,
                    )
                });
                (result, progress.polls[&Stage::Features])
            };
            let (result, count) = detect(usize::MAX);
            assert!(
                result.is_ok() && count > 3 * rows,
                "{kind}: polled {count} times"
            );
            for stop in [0, 1, count / 4, count / 2, count * 3 / 4] {
                let (result, count) = detect(stop);
                let error = result.unwrap_err();
                assert_eq!(error.kind(), ErrorKind::Interrupted, "{kind}: {error}");
                assert_eq!(count, stop + 1, "{kind} polls again");
            }
        }
    }

    #[test]
    fn tetrahedra_are_stopped_at_any_poll_of_every_stage() {
        use Stage::*;
        let params = params(FeatureKind::Edges, SeedingKind::Fcc);
        let stages = [
            (Features, 1000),
            (Placing, 100),
            (Optimising, 5),
            (Improving, 10),
            (Measuring, 8),
        ];
        assert_stops(&ball(), &params, &stages);
        let genetic = Params::new(MeshSpec {
            optimizer: Optimizer::Genetic,
            ..params.spec
        })
        .unwrap();
        assert_stops(&ball(), &genetic, &[(Optimising, 20)]);
    }

    #[test]
    fn triangles_and_cells_are_stopped_at_any_poll_of_every_stage() {
        use Stage::*;
        let seedings = [
            SeedingKind::Grown,
            SeedingKind::Guide,
            SeedingKind::Projection,
            SeedingKind::Refine,
        ];
        for seeding in seedings {
            let params = params(FeatureKind::Edges, seeding);
            assert_stops(
                &disc(),
                &params,
                &[
                    (Features, 100),
                    (Placing, 100),
                    (Improving, 5),
                    (Measuring, 8),
                ],
            );
        }
        let canny = Params::new(MeshSpec {
            feature: FeatureKind::Canny,
            seeding: SeedingKind::Canny,
            ..MeshSpec::default()
        })
        .unwrap();
        assert_stops(&disc(), &canny, &[(Features, 100), (Placing, 50)]);
        let cells = Params::new(MeshSpec {
            cells: Some(CellKind::Voronoi),
            align: None,
            ..params::<2>(FeatureKind::Edges, SeedingKind::Fcc).spec
        })
        .unwrap();
        let stages = [
            (Features, 100),
            (Placing, 100),
            (Optimising, 5),
            (Conforming, 1),
            (Measuring, 100),
        ];
        assert_stops(&disc(), &cells, &stages);
    }
}

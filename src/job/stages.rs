//! What clock and observer are told.

use super::checkpoint::{Codec, JobCheckpoint, StoredStage};
use crate::Result;
use crate::comm::{self, WorldComm};
use crate::lattice::partition::OwnedAtoms;
use crate::lattice::seeding::Atoms;
use crate::progress::{CancelToken, Progress, Stage, interrupted_error};
use crate::report::{Clock, StageCost};

/// Tells clock and observer of each stage, and remembers whether one was stopped.
pub struct StageRunner<'a> {
    clock: Clock,
    pub(super) observer: &'a mut dyn Progress,
    interrupted: bool,
    checkpoint: Option<JobCheckpoint>,
    /// Each rank may have a part of the mesh only.
    pub(super) may_partition: bool,
}

impl<'a> StageRunner<'a> {
    /// No stage yet.
    pub fn new(observer: &'a mut dyn Progress) -> Self {
        Self {
            clock: Clock::new(),
            observer,
            interrupted: false,
            checkpoint: None,
            may_partition: false,
        }
    }

    /// The same; what they give is kept there.
    pub(super) fn with_checkpoint(mut self, checkpoint: Option<JobCheckpoint>) -> Self {
        self.checkpoint = checkpoint;
        self
    }

    /// The same; each rank may have a part of the mesh only.
    pub(super) fn with_partitioning(self, in_pieces: bool) -> Self {
        Self {
            may_partition: in_pieces,
            ..self
        }
    }

    /// What `work` gives, or what was kept of it under this name when the job was run before.
    ///
    /// # Errors
    /// Those of the work, and of keeping its result.
    pub(super) fn load_or_run<T: Codec>(
        &mut self,
        name: &str,
        work: impl FnOnce(&mut Self) -> Result<T>,
    ) -> Result<T> {
        if self.checkpoint.is_some()
            && let Some(value) = comm::broadcast_from_root(name, || Ok(self.load(name)))?
        {
            return Ok(value);
        }
        let value = work(self)?;
        if comm::is_root() {
            self.save(name, &value)?;
        }
        Ok(value)
    }

    /// What was kept under this name.
    fn load<T: Codec>(&mut self, name: &str) -> Option<T> {
        match self.checkpoint.as_ref()?.load(name) {
            StoredStage::Complete(value) => Some(value),
            StoredStage::Unusable(why) => {
                self.observer.note(&why);
                None
            }
            StoredStage::Missing => None,
        }
    }

    /// Keeps what a stage gave, unless it was stopped: then that is no whole result.
    fn save<T: Codec>(&mut self, name: &str, value: &T) -> Result<()> {
        let whole = self.checkpoint.is_some() && self.keep_going() && !self.interrupted;
        let checkpoint = self.checkpoint.as_ref().filter(|_| whole);
        checkpoint.map_or(Ok(()), |checkpoint| checkpoint.save(name, value))
    }

    /// The same of a lattice of which each rank has a share, and of what all have: only the first rank ever has all
    /// atoms, and only where they are kept.
    ///
    /// # Errors
    /// Those of the work, and of keeping its result.
    pub(super) fn load_or_run_shares<const D: usize, T: Codec>(
        &mut self,
        name: &str,
        work: impl FnOnce(&mut Self) -> Result<(OwnedAtoms<D>, T)>,
    ) -> Result<(OwnedAtoms<D>, T)> {
        if self.checkpoint.is_none() {
            return work(self);
        }
        let mut atoms = Atoms::default();
        let found = comm::broadcast_from_root(name, || {
            Ok(self.load(name).map(|(all, rest)| {
                atoms = all;
                rest
            }))
        })?;
        if let Some(rest) = found {
            return Ok((OwnedAtoms::scatter_from_root(atoms, &WorldComm)?, rest));
        }
        let (share, rest) = work(self)?;
        let kept = (share.clone().gather_to_root(&WorldComm)?, rest);
        if comm::is_root() {
            self.save(name, &kept)?;
        }
        Ok((share, kept.1))
    }

    /// A stage begins.
    pub fn begin(&mut self, stage: Stage) {
        self.clock.begin(stage);
        self.observer.stage(stage);
    }

    /// A stage begins before there is a lattice.
    ///
    /// # Errors
    /// As [`need_to_go_on`](Self::check_interrupted).
    pub fn begin_unless_stopped(&mut self, stage: Stage) -> Result<()> {
        self.begin(stage);
        self.check_interrupted(stage)
    }

    /// Asks whether to go on where there is no result to stop with.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::Error::Interrupted) if the observer says no.
    pub fn check_interrupted(&mut self, stage: Stage) -> Result<()> {
        if self.keep_going() {
            return Ok(());
        }
        Err(interrupted_error(stage))
    }

    /// What `work` gives, which ends soon where the observer says no.
    pub(super) fn run_cancellable<T>(&mut self, work: impl FnOnce(&CancelToken<'_>) -> T) -> T {
        let ask = &mut |share: Option<f64>| {
            if let Some(share) = share {
                self.observer.fraction_done(share);
            }
            self.keep_going()
        };
        CancelToken::run_with_progress(ask, work)
    }

    /// The same where there is no result to stop with.
    ///
    /// # Errors
    /// Those of the work; [`Error::Interrupted`](crate::Error::Interrupted) if the observer says no.
    pub(super) fn run_or_interrupt<T>(
        &mut self,
        stage: Stage,
        work: impl FnOnce(&CancelToken<'_>) -> Result<T>,
    ) -> Result<T> {
        self.run_cancellable(|patience| {
            let done = work(patience);
            // What was left undone may look like another fault.
            patience.check(stage)?;
            done
        })
    }

    /// Whether to go on; if not, the outcome will say that it was interrupted.
    pub fn keep_going(&mut self) -> bool {
        let go_on = self.observer.keep_going();
        self.interrupted |= !go_on;
        go_on
    }

    /// A stage has ended because the observer said no to it.
    pub(super) fn mark_interrupted(&mut self) {
        self.interrupted = true;
    }

    /// What every stage cost, and whether one was stopped.
    pub(super) fn finish(mut self) -> (Vec<StageCost>, bool) {
        self.clock.end();
        (self.clock.costs().to_vec(), self.interrupted)
    }
}

#[cfg(test)]
mod tests {
    use crate::job::spec::{DistanceSource, MeshSpec, NominalDistance, SeedingKind};
    use std::collections::BTreeMap;

    use super::*;
    use crate::ErrorKind;
    use crate::feature::FeatureKind;
    use crate::image::synth::{self, SyntheticKind};
    use crate::image::{Geometry, Image, ImageSource};
    use crate::job::{
        self, BOX_TOLERANCE, CellKind, MeshResult, MeshSpace, Meshing, Outcome, Params,
    };
    use crate::lattice::optimize::{Method, StopReason};
    use crate::mesh::check::{CheckHints, check, check_with_hints};

    /// Counts questions by stage; says no from some question of one stage on.
    #[derive(Default)]
    struct CountingObserver {
        current: Option<Stage>,
        questions: BTreeMap<Stage, usize>,
        stop_at: Option<(Stage, usize)>,
        is_over: bool,
    }

    impl Progress for CountingObserver {
        fn stage(&mut self, stage: Stage) {
            self.current = Some(stage);
        }

        fn keep_going(&mut self) -> bool {
            let Some(now) = self.current else { return true };
            let asked = self.questions.entry(now).or_default();
            *asked += 1;
            self.is_over |= self
                .stop_at
                .is_some_and(|(stage, after)| stage == now && *asked > after);
            !self.is_over
        }
    }

    fn run<const D: usize>(
        image: &Image<D>,
        params: &Params<D>,
        stop: Option<(Stage, usize)>,
    ) -> (Result<Outcome<D>>, CountingObserver)
    where
        MeshSpace<D>: Meshing<D>,
    {
        let mut observer = CountingObserver {
            stop_at: stop,
            ..CountingObserver::default()
        };
        let outcome = job::run(image, params, &mut observer);
        (outcome, observer)
    }

    /// Every stage named asks at least so often, and a stop at its first question, at its second and in
    /// its midst gives what the stage promises.
    fn assert_stops<const D: usize>(image: &Image<D>, params: &Params<D>, stages: &[(Stage, usize)])
    where
        MeshSpace<D>: Meshing<D>,
    {
        let (outcome, counted) = run(image, params, None);
        assert_ne!(outcome.unwrap().stop, StopReason::Interrupted);
        for &(stage, least) in stages {
            let asked = counted.questions.get(&stage).copied().unwrap_or(0);
            assert!(asked >= least, "{stage}: asked {asked} times");
            for after in [0, 1, asked / 2].into_iter().filter(|&n| n < asked) {
                let (outcome, observer) = run(image, params, Some((stage, after)));
                assert!(observer.is_over, "{stage}: never stopped after {after}");
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
                            MeshResult::Simplices(made) => {
                                check(&made.mesh, low, outcome.extent, tolerance)
                            }
                            MeshResult::Voronoi { mesh, weld } => {
                                let known = CheckHints {
                                    weld: *weld,
                                    ..CheckHints::default()
                                };
                                check_with_hints(mesh, known, low, outcome.extent, tolerance)
                            }
                        };
                        assert!(check.passed(), "{stage} after {after}: {check:?}");
                        // It goes on saying no: only what was measured before is there.
                        let report = outcome.report;
                        let measured = report.box_check.is_some() || report.voronoi.is_some();
                        let may = stage == Stage::Measuring && after > 0;
                        assert!(may || !measured, "{stage} after {after}");
                        let compared = report.fidelity.is_some();
                        assert!(may || !compared, "{stage} after {after}");
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

    /// A disc with a soft edge.
    fn disc() -> Image<2> {
        let off = |i: usize| ((i % 60) as f32 - 30.0).hypot((i / 60) as f32 - 25.0) - 15.0;
        let samples = (0..60 * 50).map(|i| 50.0 - 20.0 * off(i).clamp(-2.0, 2.0));
        Image::new([60, 50], samples.collect(), Geometry::default())
    }

    /// Of that kind, and as fine at features as the sizes of these images allow.
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
    fn every_kind_of_feature_is_stopped_while_it_is_sought() {
        use FeatureKind::*;
        let image = ball();
        // One question for each row of samples in each pass: there are at least three.
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
            let seek = |stop: usize| {
                let mut observer = CountingObserver {
                    current: Some(Stage::Features),
                    stop_at: Some((Stage::Features, stop)),
                    ..CountingObserver::default()
                };
                let found = CancelToken::run(&mut || observer.keep_going(), |patience| {
                    crate::feature::detect_with_cancel(
                        ImageSource::InMemory(&image),
                        &options,
                        patience,
                    )
                });
                (found, observer.questions[&Stage::Features])
            };
            let (found, asked) = seek(usize::MAX);
            assert!(
                found.is_ok() && asked > 3 * rows,
                "{kind}: asked {asked} times"
            );
            for stop in [0, 1, asked / 4, asked / 2, asked * 3 / 4] {
                let (found, asked) = seek(stop);
                let error = found.unwrap_err();
                assert_eq!(error.kind(), ErrorKind::Interrupted, "{kind}: {error}");
                assert_eq!(asked, stop + 1, "{kind} asks on");
            }
        }
    }

    #[test]
    #[cfg(feature = "tetgen")]
    fn tetrahedra_are_stopped_at_any_question_of_every_stage() {
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
            optimizer: Method::Genetic,
            ..params.spec
        })
        .unwrap();
        assert_stops(&ball(), &genetic, &[(Optimising, 20)]);
    }

    #[test]
    fn triangles_and_cells_are_stopped_at_any_question_of_every_stage() {
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

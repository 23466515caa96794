//! What clock and observer are told.

use super::checkpoint::{Found, Kept, OfJob};
use crate::Result;
use crate::lattice::seeding::Atoms;
use crate::lattice::share::OwnAtoms;
use crate::observer::{Observer, Patience, Stage, interrupted};
use crate::ranks::{self, Ranks};
use crate::report::{Clock, StageCost};

/// Tells clock and observer of each stage, and remembers whether one was stopped.
pub struct Stages<'a> {
    clock: Clock,
    pub(super) observer: &'a mut dyn Observer,
    interrupted: bool,
    checkpoint: Option<OfJob>,
    /// Each rank may have a part of the mesh only.
    pub(super) in_pieces: bool,
}

impl<'a> Stages<'a> {
    /// No stage yet.
    pub fn new(observer: &'a mut dyn Observer) -> Self {
        Self {
            clock: Clock::new(),
            observer,
            interrupted: false,
            checkpoint: None,
            in_pieces: false,
        }
    }

    /// The same; what they give is kept there.
    pub(super) fn keeping(mut self, checkpoint: Option<OfJob>) -> Self {
        self.checkpoint = checkpoint;
        self
    }

    /// The same; each rank may have a part of the mesh only.
    pub(super) fn in_pieces(self, in_pieces: bool) -> Self {
        Self { in_pieces, ..self }
    }

    /// What `work` gives, or what was kept of it under this name when the job was run before.
    ///
    /// # Errors
    /// Those of the work, and of keeping its result.
    pub(super) fn kept<T: Kept>(
        &mut self,
        name: &str,
        work: impl FnOnce(&mut Self) -> Result<T>,
    ) -> Result<T> {
        if self.checkpoint.is_some()
            && let Some(value) = ranks::of_first(name, || Ok(self.found(name)))?
        {
            return Ok(value);
        }
        let value = work(self)?;
        if ranks::is_first() {
            self.keep(name, &value)?;
        }
        Ok(value)
    }

    /// What was kept under this name.
    fn found<T: Kept>(&mut self, name: &str) -> Option<T> {
        match self.checkpoint.as_ref()?.found(name) {
            Found::Whole(value) => Some(value),
            Found::Useless(why) => {
                self.observer.note(&why);
                None
            }
            Found::Nothing => None,
        }
    }

    /// Keeps what a stage gave, unless it was stopped: then that is no whole result.
    fn keep<T: Kept>(&mut self, name: &str, value: &T) -> Result<()> {
        let whole = self.checkpoint.is_some() && self.keep_going() && !self.interrupted;
        let checkpoint = self.checkpoint.as_ref().filter(|_| whole);
        checkpoint.map_or(Ok(()), |checkpoint| checkpoint.keep(name, value))
    }

    /// The same of a lattice of which each rank has a share, and of what all have: only the first rank ever has all
    /// atoms, and only where they are kept.
    ///
    /// # Errors
    /// Those of the work, and of keeping its result.
    pub(super) fn kept_in_shares<const D: usize, T: Kept>(
        &mut self,
        name: &str,
        work: impl FnOnce(&mut Self) -> Result<(OwnAtoms<D>, T)>,
    ) -> Result<(OwnAtoms<D>, T)> {
        if self.checkpoint.is_none() {
            return work(self);
        }
        let mut atoms = Atoms::default();
        let found = ranks::of_first(name, || {
            Ok(self.found(name).map(|(all, rest)| {
                atoms = all;
                rest
            }))
        })?;
        if let Some(rest) = found {
            return Ok((OwnAtoms::dealt(atoms, &Ranks)?, rest));
        }
        let (share, rest) = work(self)?;
        let kept = (share.clone().gathered_by_first(&Ranks)?, rest);
        if ranks::is_first() {
            self.keep(name, &kept)?;
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
    /// As [`need_to_go_on`](Self::need_to_go_on).
    pub fn begin_unless_stopped(&mut self, stage: Stage) -> Result<()> {
        self.begin(stage);
        self.need_to_go_on(stage)
    }

    /// Asks whether to go on where there is no result to stop with.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::Error::Interrupted) if the observer says no.
    pub fn need_to_go_on(&mut self, stage: Stage) -> Result<()> {
        if self.keep_going() {
            return Ok(());
        }
        Err(interrupted(stage))
    }

    /// What `work` gives, which ends soon where the observer says no.
    pub(super) fn patiently<T>(&mut self, work: impl FnOnce(&Patience<'_>) -> T) -> T {
        let ask = &mut |share: Option<f64>| {
            if let Some(share) = share {
                self.observer.share(share);
            }
            self.keep_going()
        };
        Patience::telling(ask, work)
    }

    /// The same where there is no result to stop with.
    ///
    /// # Errors
    /// Those of the work; [`Error::Interrupted`](crate::Error::Interrupted) if the observer says no.
    pub(super) fn unless_stopped<T>(
        &mut self,
        stage: Stage,
        work: impl FnOnce(&Patience<'_>) -> Result<T>,
    ) -> Result<T> {
        self.patiently(|patience| {
            let done = work(patience);
            // What was left undone may look like another fault.
            patience.lasts(stage)?;
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
    pub(super) fn stopped(&mut self) {
        self.interrupted = true;
    }

    /// What every stage cost, and whether one was stopped.
    pub(super) fn end(mut self) -> (Vec<StageCost>, bool) {
        self.clock.end();
        (self.clock.costs().to_vec(), self.interrupted)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::ErrorKind;
    use crate::feature::FeatureKind;
    use crate::image::synth::{self, Kind};
    use crate::image::{Geometry, Image, Source};
    use crate::job::{
        self, BOX_TOLERANCE, CellKind, Made, Meshing, Outcome, Params, Space, Spacing,
    };
    use crate::lattice::optimize::{Method, Stop};
    use crate::lattice::seeding::Seeding;
    use crate::mesh::check::{Known, check, check_known};

    /// Counts questions by stage; says no from some question of one stage on.
    #[derive(Default)]
    struct Counting {
        now: Option<Stage>,
        questions: BTreeMap<Stage, usize>,
        stop: Option<(Stage, usize)>,
        over: bool,
    }

    impl Observer for Counting {
        fn stage(&mut self, stage: Stage) {
            self.now = Some(stage);
        }

        fn keep_going(&mut self) -> bool {
            let Some(now) = self.now else { return true };
            let asked = self.questions.entry(now).or_default();
            *asked += 1;
            self.over |= self
                .stop
                .is_some_and(|(stage, after)| stage == now && *asked > after);
            !self.over
        }
    }

    fn run<const D: usize>(
        image: &Image<D>,
        params: &Params<D>,
        stop: Option<(Stage, usize)>,
    ) -> (Result<Outcome<D>>, Counting)
    where
        Space<D>: Meshing<D>,
    {
        let mut observer = Counting {
            stop,
            ..Counting::default()
        };
        let outcome = job::run(image, params, &mut observer);
        (outcome, observer)
    }

    /// Every stage named asks at least so often, and a stop at its first question, at its second and in
    /// its midst gives what the stage promises.
    fn stopped<const D: usize>(image: &Image<D>, params: &Params<D>, stages: &[(Stage, usize)])
    where
        Space<D>: Meshing<D>,
    {
        let (outcome, counted) = run(image, params, None);
        assert_ne!(outcome.unwrap().stop, Stop::Interrupted);
        for &(stage, least) in stages {
            let asked = counted.questions.get(&stage).copied().unwrap_or(0);
            assert!(asked >= least, "{stage}: asked {asked} times");
            for after in [0, 1, asked / 2].into_iter().filter(|&n| n < asked) {
                let (outcome, observer) = run(image, params, Some((stage, after)));
                assert!(observer.over, "{stage}: never stopped after {after}");
                match outcome {
                    Err(error) => {
                        assert_eq!(error.kind(), ErrorKind::Interrupted, "{stage}: {error}");
                        assert!(!stage.has_lattice(), "{stage}: {error}");
                    }
                    Ok(outcome) => {
                        assert!(stage.has_lattice(), "{stage} gave a mesh after {after}");
                        assert_eq!(outcome.stop, Stop::Interrupted, "{stage} after {after}");
                        let (low, tolerance) = ([0.0; D], BOX_TOLERANCE);
                        let check = match &outcome.made {
                            Made::Simplices(made) => {
                                check(&made.mesh, low, outcome.extent, tolerance)
                            }
                            Made::Voronoi { mesh, weld } => {
                                let known = Known {
                                    weld: *weld,
                                    ..Known::default()
                                };
                                check_known(mesh, known, low, outcome.extent, tolerance)
                            }
                        };
                        assert!(check.passed(), "{stage} after {after}: {check:?}");
                        // It goes on saying no: only what was measured before is there.
                        let report = outcome.report;
                        let measured = report.filling.is_some() || report.voronoi.is_some();
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
        synth::make(Kind::Sphere, &options).unwrap().image
    }

    /// A disc with a soft edge.
    fn disc() -> Image<2> {
        let off = |i: usize| ((i % 60) as f32 - 30.0).hypot((i / 60) as f32 - 25.0) - 15.0;
        let samples = (0..60 * 50).map(|i| 50.0 - 20.0 * off(i).clamp(-2.0, 2.0));
        Image::new([60, 50], samples.collect(), Geometry::default())
    }

    /// Of that kind, and as fine at features as the sizes of these images allow.
    fn params<const D: usize>(feature: FeatureKind, seeding: Seeding) -> Params<D> {
        Params {
            feature,
            seeding,
            spacing: Spacing::FromFeatures { min: 5.0, max: 7.0 },
            ..Params::default()
        }
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
            let params = params::<3>(kind, Seeding::Fcc);
            let options = params.feature_options([1.0; 3]);
            let seek = |stop: usize| {
                let mut observer = Counting {
                    now: Some(Stage::Features),
                    stop: Some((Stage::Features, stop)),
                    ..Counting::default()
                };
                let found = Patience::of(&mut || observer.keep_going(), |patience| {
                    crate::feature::detect_while(Source::Held(&image), &options, patience)
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
        let params = params(FeatureKind::Edges, Seeding::Fcc);
        let stages = [
            (Features, 1000),
            (Placing, 100),
            (Optimising, 5),
            (Improving, 10),
            (Measuring, 8),
        ];
        stopped(&ball(), &params, &stages);
        let genetic = Params {
            optimizer: Method::Genetic,
            ..params
        };
        stopped(&ball(), &genetic, &[(Optimising, 20)]);
    }

    #[test]
    fn triangles_and_cells_are_stopped_at_any_question_of_every_stage() {
        use Stage::*;
        let seedings = [
            Seeding::Grown,
            Seeding::Guide {
                seed: 1,
                most: usize::MAX,
            },
            Seeding::Projection,
            Seeding::Refine { seed: 1 },
        ];
        for seeding in seedings {
            let params = params(FeatureKind::Edges, seeding);
            stopped(
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
        let canny = Params {
            spacing: Spacing::OfAtoms { min: 2.0, max: 7.0 },
            ..params(FeatureKind::Canny, Seeding::Canny)
        };
        stopped(&disc(), &canny, &[(Features, 100), (Placing, 50)]);
        let cells = Params {
            cells: CellKind::Voronoi,
            ..params(FeatureKind::Edges, Seeding::Fcc)
        };
        let stages = [
            (Features, 100),
            (Placing, 100),
            (Optimising, 5),
            (Conforming, 1),
            (Measuring, 100),
        ];
        stopped(&disc(), &cells, &stages);
    }
}

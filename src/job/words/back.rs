//! From a job to settings.

use std::path::PathBuf;

use crate::feature::LabelOptions;
use crate::improve;
use crate::job::asked::{
    Apart, BetaFrom, Cells, DistanceFrom, Followed, Job, LatticeEnergy, LatticeJob, LatticeSpace,
    PlacementJob, Slivers, Start, VelocityFrom, What,
};
use crate::job::settings::{AlignName, CellsName, SeedingName, Settings, SliversName};

impl From<Job> for Settings {
    /// All that the job says, what is so by default included.
    fn from(job: Job) -> Self {
        let mut settings = Self {
            output: job.outputs.mesh,
            report: job.outputs.report,
            potential_out: job.outputs.potential,
            lines: job.outputs.lines,
            page: job.outputs.page,
            surfaces: job.outputs.surfaces,
            checkpoint: job.outputs.checkpoint,
            atoms_from: job.atoms_from,
            metric: Some(match &job.metric {
                LatticeSpace::Samples => "samples".into(),
                LatticeSpace::Physical => "physical".into(),
                LatticeSpace::Shape => "shape".into(),
                LatticeSpace::Scales(scales) => joined(scales),
            }),
            velocity: job.velocity.as_ref().map(VelocityFrom::to_string),
            rng_seed: Some(job.seed.0),
            input: job.input,
            ..Self::default()
        };
        settings.say_features(job.features);
        settings.say_cells(&job.cells);
        match job.placement {
            PlacementJob::Canny => settings.seeding = Some(SeedingName::Canny),
            PlacementJob::Lattice(lattice) => settings.say_lattice(lattice),
        }
        settings
    }
}

/// Numbers with commas between them.
fn joined(numbers: &[f64]) -> String {
    let words: Vec<String> = numbers.iter().map(f64::to_string).collect();
    words.join(",")
}

/// A file's name as a text; one that is no UTF-8 came from no text.
fn file_text(path: PathBuf) -> String {
    path.to_string_lossy().into_owned()
}

impl Settings {
    /// What all jobs have by default: those of a lattice and tetrahedra, and those of cells of the
    /// other kind.
    pub(super) fn of_defaults() -> Self {
        Self {
            weld: Some(0.0),
            feature_weights: Some("1,1".into()),
            ..Job::default().into()
        }
    }

    fn say_features(&mut self, features: Followed) {
        self.feature = Some(features.kind());
        self.sigma = features.sigma;
        self.threshold = features.threshold();
        let texts = |points: Vec<Vec<f64>>| {
            let texts: Vec<String> = points.iter().map(|point| joined(point)).collect();
            (!texts.is_empty()).then_some(texts)
        };
        match features.what {
            What::FaultsAndHorizons { weights, .. } => {
                self.feature_weights = Some(joined(&weights));
            }
            What::Paths { object, background } => {
                self.object = texts(object);
                self.background = texts(background);
            }
            What::Labels { wishes } => {
                let texts: Vec<String> = wishes.iter().map(LabelOptions::to_string).collect();
                self.label = (!texts.is_empty()).then_some(texts);
            }
            What::Strong { .. } => {}
        }
    }

    fn say_cells(&mut self, cells: &Cells) {
        match *cells {
            Cells::Voronoi { weld } => {
                self.cells = Some(CellsName::Voronoi);
                self.align = Some(AlignName::Alongside);
                self.weld = Some(weld);
            }
            Cells::Simplices { slivers, smooth } => {
                self.cells = Some(CellsName::Tets);
                self.align = Some(AlignName::On);
                self.smooth = smooth;
                match slivers {
                    Slivers::Left => self.slivers = Some(SliversName::None),
                    Slivers::Removed {
                        method,
                        min_dihedral,
                    } => {
                        self.slivers = Some(match method {
                            improve::SliverMethod::Joe => SliversName::Joe,
                            improve::SliverMethod::Exude => SliversName::Exude,
                        });
                        self.min_dihedral = Some(min_dihedral);
                    }
                }
            }
        }
    }

    fn say_lattice(&mut self, lattice: LatticeJob) {
        match lattice.apart {
            Apart::Everywhere(d) => self.distance = Some(d.to_string()),
            Apart::Varying { min, max, by } => {
                self.distance = Some(format!("{min}:{max}"));
                self.distance_from = Some(match by {
                    DistanceFrom::Gaps => "gaps".into(),
                    DistanceFrom::Features => "features".into(),
                    DistanceFrom::Image => "image".into(),
                    DistanceFrom::Laplacian => "laplacian".into(),
                    DistanceFrom::File(path) => file_text(path),
                });
            }
        }
        self.seeding = Some(match lattice.start {
            Start::Fcc => SeedingName::Fcc,
            Start::Grown => SeedingName::Grown,
            Start::Refine => SeedingName::Refine,
            Start::Guide { .. } => SeedingName::Guide,
            Start::Projection => SeedingName::Projection,
        });
        if let Start::Guide { most } = lattice.start {
            self.max_atoms = most;
        }
        if let Some(wells) = lattice.wells {
            self.well = Some(wells.files);
            self.well_distance = wells.distance;
        }
        self.beta = Some(match lattice.beta {
            BetaFrom::Constant(beta) => beta.to_string(),
            BetaFrom::File(path) => file_text(path),
        });
        self.evaluator = Some(lattice.energy.evaluator());
        if let LatticeEnergy::Pairwise { kappa } = lattice.energy {
            self.kappa = Some(kappa);
        }
        self.optimizer = Some(lattice.optimizer);
        self.rounds = lattice.rounds;
        self.coarse_to_fine = Some(lattice.coarse_passes);
        self.trace = lattice.trace;
    }
}

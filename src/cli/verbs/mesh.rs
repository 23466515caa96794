//! `atomesh mesh`: from a checked job to the files it writes.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Args;

use crate::cli::common::feature::seeds;
use crate::cli::common::global::Ending;
use crate::cli::common::output::potential_image;
use crate::cli::console::{Console, complain, in_words, print};
use crate::cli::job::{Beta, MeshJob};
use crate::cli::options::MeshOptions;
use crate::cli::parse;
use crate::cli::provenance::file_hash;
use crate::cli::wells::WellFile;
use crate::error::{cause, os};
use crate::image::formats;
use crate::image::formats::{AnyLoaded, Loaded, ReadOptions};
use crate::image::{Geometry, Image};
use crate::improve::Method;
use crate::job::{
    CellsOutcome, FixedAtom, Meshing, Outcome, Params, Space, Spacing, Weight, WellPath,
};
use crate::lattice::optimize::{Observer, Progress, Stop};
use crate::lattice::seeding::Seeding;
use crate::mesh::Simplices;
use crate::report::{Clock, Input, quality};
use crate::store::cells::cells_to_file;
use crate::store::file::{Provenance, to_file};
use crate::store::{Trace, write_cells_vtu, write_vtu};
use crate::{Error, Result, job};

/// `atomesh mesh`.
#[derive(Debug, Args)]
pub struct MeshArgs {
    /// The image: SEG-Y, .npy, .vti, .nrrd, .mha, .nii, .tif, .inr, .png (2-D), or bare samples with --raw
    #[arg(value_name = "IMAGE", required_unless_present = "print_config")]
    pub image: Option<PathBuf>,
    /// The job's options.
    #[command(flatten)]
    pub options: MeshOptions,
    /// Options from a TOML file; those typed here win
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Print the effective options as TOML and stop
    #[arg(long)]
    pub print_config: bool,
}

/// Runs the verb.
pub fn mesh(args: &MeshArgs, console: &mut Console) -> Result<Ending> {
    let options = effective_options(args)?;
    let image = args.image.as_deref().unwrap_or(Path::new("image"));
    let job = MeshJob::new(image, &options)?;
    if args.print_config {
        print(options.to_toml()?.trim_end());
        return Ok(Ending::Done);
    }

    let interrupts = Interrupts::watch()?;
    let mut clock = Clock::new();
    console.begin_stage("reading");
    clock.begin("reading");
    let loaded = formats::read_any(&job.image, &job.input)?;
    clock.end();
    let run = Run {
        job: &job,
        options: &options,
        interrupts: &interrupts,
        clock,
    };
    match loaded {
        AnyLoaded::Plane(loaded) => run.mesh(loaded, console),
        AnyLoaded::Space(loaded) if cfg!(feature = "tetgen") => run.mesh(loaded, console),
        AnyLoaded::Space(_) => Err(Error::Job(cause(
            "atomesh mesh",
            "this program was built without TetGen and makes no 3-D mesh",
            "build it with the default features",
        ))),
    }
}

/// The options of a job: the command line's over the configuration file's over the defaults.
///
/// # Errors
/// [`Error::Io`] if the configuration file cannot be read, [`Error::Job`] if it holds what is no
/// option.
fn effective_options(args: &MeshArgs) -> Result<MeshOptions> {
    let from_file = match &args.config {
        None => MeshOptions::default(),
        Some(path) => {
            let text = std::fs::read_to_string(path).map_err(|e| os(path, "read", e))?;
            toml::from_str(&text).map_err(|e| {
                let line = e
                    .span()
                    .map_or(1, |span| 1 + text[..span.start].matches('\n').count());
                Error::Job(cause(
                    format!("{}:{line}", path.display()),
                    e.message().replace('\n', ", "),
                    "atomesh mesh --print-config shows how it is written",
                ))
                .because(e)
            })?
        }
    };
    args.options
        .over(&from_file)?
        .over(&MeshOptions::defaults())
}

/// A job whose image is read.
struct Run<'a> {
    job: &'a MeshJob,
    options: &'a MeshOptions,
    interrupts: &'a Interrupts,
    clock: Clock,
}

impl Run<'_> {
    fn mesh<const D: usize, M: Simplices<D>>(
        self,
        loaded: Loaded<D>,
        console: &mut Console,
    ) -> Result<Ending>
    where
        Space<D>: Meshing<D, Mesh = M>,
    {
        let Self {
            job,
            options,
            interrupts,
            mut clock,
        } = self;
        let Loaded { image, notes, .. } = loaded;
        let input_sha256 = file_hash(&job.image)?;
        image.check(&job.image.display().to_string())?;
        let params = job.params::<D>()?;

        let step = params.metric.step(&image.geometry);
        let mut watcher = Watcher {
            console,
            most: job::moving(&params).max_evaluations,
            interrupts,
            trace_path: job.trace.as_deref(),
            trace: None,
            geometry: image.geometry.in_space(),
            step: std::array::from_fn(|k| step.get(k).copied().unwrap_or(1.0)),
            failed: None,
        };
        let outcome = if job.voronoi {
            job::voronoi_image(&image, &params, &mut watcher).map(Made::Cells)
        } else {
            job::mesh_image(&image, &params, &mut watcher).map(Made::Simplices)
        };
        let Watcher { trace, failed, .. } = watcher;
        let outcome = match failed.map_or(outcome, Err) {
            Ok(outcome) => outcome,
            Err(error) => {
                if let Some(trace) = trace {
                    trace.discard();
                }
                return match interrupts.wanted() {
                    true => {
                        complain(format_args!("error: {}", in_words(&error)));
                        Ok(Ending::Interrupted)
                    }
                    false => Err(error),
                };
            }
        };

        console.begin_stage("writing");
        clock.begin("writing");
        let provenance = Provenance {
            parameters: options.reproducible()?,
            input_sha256,
        };
        let (features, optimised, mut report) = match outcome {
            Made::Simplices(mut outcome) => {
                let file = to_file(&outcome, &image.geometry, &provenance);
                write_vtu(&job.output, &file)?;
                if !image.geometry.has_shape_of(outcome.step) {
                    outcome.report.quality_physical = Some(quality(&file.mesh));
                }
                (outcome.features, outcome.optimised, outcome.report)
            }
            Made::Cells(outcome) => {
                let file = cells_to_file(&outcome, &image.geometry, &provenance);
                write_cells_vtu(&job.output, &file)?;
                (outcome.features, outcome.optimised, outcome.report)
            }
        };
        if let Some(path) = &job.potential_out {
            formats::write(path, &potential_image(&features.potential, &image.geometry))?;
        }
        clock.end();

        report.input = Some(Input {
            file: job.image.display().to_string(),
            dims: image.dims().to_vec(),
            hash: format!("sha256:{}", provenance.input_sha256),
        });
        report.parameters = serde_json::to_value(options).unwrap_or_default();
        report.notes.splice(0..0, notes);
        report
            .stages
            .splice(0..0, clock.costs()[..1].iter().cloned());
        report.stages.extend_from_slice(&clock.costs()[1..]);
        let json = serde_json::to_value(&report).unwrap_or_default();
        if let Some(path) = &job.report {
            crate::files::atomic_write(path, |out| writeln!(out, "{json:#}"))?;
        }
        console.result(
            format_args!(
                "{}\nwrote {}",
                report.table().trim_end(),
                job.output.display()
            ),
            &json,
        );
        Ok(match optimised.stop {
            Stop::Interrupted => Ending::Interrupted,
            _ => Ending::Done,
        })
    }
}

/// What a job made.
enum Made<const D: usize>
where
    Space<D>: Meshing<D>,
{
    Simplices(Outcome<D>),
    Cells(CellsOutcome<D>),
}

impl MeshJob {
    /// What the pipeline is told; reads the files that the options name.
    pub(super) fn params<const D: usize>(&self) -> Result<Params<D>> {
        let beta = match &self.beta {
            Beta::Constant(beta) => Weight::Constant(*beta),
            Beta::File(path) => Weight::Image(Box::new(read_beta(path)?)),
        };
        let mut fixed = Vec::new();
        if let Some(path) = &self.atoms_from {
            fixed = parse::points(path)?
                .into_iter()
                .map(|(line, position)| FixedAtom {
                    name: format!("{}:{line}", path.display()),
                    position,
                })
                .collect();
        }
        let mut wells = Vec::new();
        for path in &self.wells {
            let file = WellFile::<D>::read(path, D - 1)?;
            wells.push(WellPath {
                name: path.display().to_string(),
                radius: file.points.iter().map(|p| p.2).fold(0.0, f64::max),
                points: file.points.iter().map(|p| p.1).collect(),
            });
        }
        let distances = match &self.distances {
            Some(path) => Some(Box::new(read_distances(path)?)),
            None => None,
        };
        if D == 2 && self.slivers == Method::Exude {
            return Err(Error::Job(cause(
                "--slivers exude",
                "moves nothing in the plane, where the Delaunay triangulation has no slivers",
                "leave it away",
            )));
        }
        Ok(Params {
            spacing: match self.seeding {
                Seeding::Canny => Spacing::of_canny(D),
                _ => self.spacing,
            },
            distances,
            feature_weights: self.feature_weights,
            feature: self.feature.into(),
            sigma: self.sigma,
            threshold: self.threshold,
            seeds: seeds(&self.object, &self.background, self.seed)?,
            beta,
            fixed,
            wells,
            well_distance: self.well_distance,
            seeding: self.seeding,
            evaluator: self.evaluator,
            kappa: self.kappa,
            optimizer: self.optimizer,
            coarse_passes: self.coarse_passes,
            min_dihedral: self.min_dihedral,
            slivers: self.slivers,
            weld: self.weld,
            smooth: self.smooth,
            metric: self.metric.metric()?,
            seed: self.seed,
        })
    }
}

/// An image of distances.
fn read_distances<const D: usize>(path: &Path) -> Result<Image<D>> {
    let read = formats::read_any(path, &ReadOptions::default())?;
    read.image().ok_or_else(|| {
        Error::Job(cause(
            format!("--distance-from {}", path.display()),
            format!("is no {D}-D image"),
            "give one distance per sample of the image",
        ))
    })
}

/// An image of weights.
fn read_beta<const D: usize>(path: &Path) -> Result<Image<D>> {
    let read = formats::read_any(path, &ReadOptions::default())?;
    let Some(image) = read.image() else {
        return Err(Error::Job(cause(
            format!("--beta {}", path.display()),
            format!("is no {D}-D image"),
            "give one weight per sample of the image",
        )));
    };
    let stats = image.stats();
    if stats.first_bad.is_some() || stats.min < 0.0 || stats.max >= 1.0 {
        return Err(Error::Job(cause(
            format!("--beta {}", path.display()),
            format!("holds weights from {} to {}, or none", stats.min, stats.max),
            "give weights that are at least 0 and below 1",
        )));
    }
    Ok(image)
}

/// What the interrupt handler and the job tell each other.
#[derive(Debug, Default)]
struct Interrupts {
    /// There is a lattice worth keeping.
    lattice: AtomicBool,
    /// The user wants to stop.
    wanted: AtomicBool,
}

impl Interrupts {
    /// Ctrl-C ends the process at once while there is nothing to keep, and when it comes a second
    /// time; else it asks the job to stop with what it has.
    fn watch() -> Result<Arc<Self>> {
        let state = Arc::new(Self::default());
        let shared = Arc::clone(&state);
        ctrlc::set_handler(move || {
            let again = shared.wanted.swap(true, Ordering::Relaxed);
            if again || !shared.lattice.load(Ordering::Relaxed) {
                std::process::exit(130);
            }
        })
        .map_err(|e| {
            Error::Job(cause("interrupt handler", &e, "start the job again").because(e))
        })?;
        Ok(state)
    }

    fn wanted(&self) -> bool {
        self.wanted.load(Ordering::Relaxed)
    }
}

/// Shows the pipeline's progress, keeps its lattices, and passes on the wish to stop.
struct Watcher<'a> {
    console: &'a mut Console,
    /// Most evaluations of the energy.
    most: usize,
    interrupts: &'a Interrupts,
    trace_path: Option<&'a Path>,
    /// Begun with the first lattice.
    trace: Option<Trace>,
    geometry: Geometry<3>,
    step: [f64; 3],
    /// Why a lattice could not be written.
    failed: Option<Error>,
}

impl Watcher<'_> {
    /// Adds a lattice to the trace.
    fn keep(&mut self, path: &Path, round: usize, positions: &[[f64; 3]]) -> Result<()> {
        let physical = |x: &[f64; 3]| {
            self.geometry
                .to_physical(std::array::from_fn(|k| x[k] / self.step[k]))
        };
        let atoms: Vec<[f64; 3]> = positions.iter().map(physical).collect();
        let trace = match &mut self.trace {
            Some(trace) => trace,
            none => none.insert(Trace::create(path)?),
        };
        trace.add(round as f64, &atoms, &[])
    }
}

impl Observer for Watcher<'_> {
    fn stage(&mut self, name: &str) {
        self.console.begin_stage(name);
        if name == job::OPTIMISING {
            self.interrupts.lattice.store(true, Ordering::Relaxed);
        }
    }

    fn progress(&mut self, progress: &Progress) {
        self.console.progress(
            progress.evaluations as f64 / self.most as f64,
            format_args!("round {}, energy {:.4e}", progress.round, progress.energy),
        );
    }

    fn round(&mut self, round: usize, positions: &[[f64; 3]]) {
        if let Some(path) = self.trace_path
            && self.failed.is_none()
        {
            self.failed = self.keep(path, round, positions).err();
        }
    }

    fn keep_going(&mut self) -> bool {
        !self.interrupts.wanted() && self.failed.is_none()
    }
}

//! `atomesh mesh`: from a checked job to the files it writes.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;

use crate::cli::allocator;
use crate::cli::common::depth::{image_in_depth, warn_if_time};
use crate::cli::common::global::VerbStatus;
use crate::cli::common::options::{Typed, option_name, with_option_name};
use crate::cli::common::output::potential_image;
use crate::cli::console::{Console, PendingHash, print};
use crate::cli::interrupts::Interrupts;
use crate::cli::job_files::{check_files, output_path};
use crate::error::{cause, io_error};
use crate::export::page::{self, MAX_PAGE_BYTES, PageInfo, PageStats};
use crate::feature::FeatureKind;
use crate::files::vtk::DataArray;
use crate::image::formats::stream::{ImageStream, OpenedImage};
use crate::image::formats::{AnyImage, LoadedImage, into_any_image};
use crate::image::{Geometry, Image, ImageSource, Modality};
use crate::job::spec::NumberOrFile;
use crate::job::{
    Checkpoint, MeshResult, MeshSpace, MeshSpec, Meshing, Outcome, Params, Provenance, RunOptions,
};
use crate::lattice::optimize::StopReason;
use crate::memory::Bytes;
use crate::mesh::Simplices;
use crate::mesh::delaunay::{delaunay, delaunay_plane};
use crate::progress::{LatticeSnapshot, OptimizeStatus, Progress, SizeEstimate, Stage};
use crate::report::{Clock, Input, TracedLattice, quality, smallest_angles};
use crate::store::cell_output::cell_mesh_file;
use crate::store::output::{simplex_mesh_file, with_image};
use crate::store::pvtu::is_pvtu;
use crate::store::{FieldValue, MeshFile, PvdSeries, StoredMesh, to_physical};
use crate::{Error, Result, comm};

/// `atomesh mesh`.
#[derive(Debug, Args)]
pub struct MeshArgs {
    /// The image: SEG-Y, Zarr, MDIO, .npy, .vti, .nrrd, .mha, .nii, .tif, .inr, .png (2-D), or raw
    /// samples with --raw
    #[arg(value_name = "IMAGE", required_unless_present = "print_config")]
    pub image: Option<PathBuf>,
    /// Options of the job.
    #[command(flatten)]
    pub spec: Typed<MeshSpec>,
    /// Options from a TOML file; those typed here win
    #[arg(long, value_name = "FILE.toml", help_heading = None)]
    pub config: Option<PathBuf>,
    /// Print the effective options as TOML and stop
    #[arg(long, help_heading = None)]
    pub print_config: bool,
}

/// Runs the verb.
pub fn mesh(args: &MeshArgs, interrupts: &Interrupts, console: &mut Console) -> Result<VerbStatus> {
    let spec = read_spec(args)?;
    let image = args.image.as_deref().unwrap_or(Path::new("image"));
    check_files(image, &spec, args.config.as_deref())?;
    if args.print_config {
        print(spec.to_toml()?.trim_end());
        return Ok(VerbStatus::Done);
    }

    let mut clock = Clock::new();
    console.begin_stage(Stage::Reading);
    clock.begin(Stage::Reading);
    // Traces are stretched in memory.
    let stretched = matches!(spec.velocity, Some(NumberOrFile::File(_)));
    let opened = match console.open_image(image, &spec.input)? {
        OpenedImage::Stream(stream) if stretched || !stream.stays_in_file() => stream
            .into_loaded(image)
            .map(into_any_image)
            .map(OpenedImage::InMemory)?,
        opened => opened,
    };
    clock.end();
    let run = MeshRun {
        path: image,
        spec: &spec,
        interrupts,
        clock,
    };
    let able = cfg!(feature = "tetgen");
    match opened {
        OpenedImage::InMemory(AnyImage::Plane(loaded)) => run.mesh_in_memory(loaded, console),
        OpenedImage::InMemory(AnyImage::Space(loaded)) if able => {
            run.mesh_in_memory(loaded, console)
        }
        OpenedImage::Stream(mut stream) if able => {
            if let Some(NumberOrFile::Constant(velocity)) = spec.velocity {
                let geometry = &mut stream.header.geometry;
                *geometry = geometry.to_depth(velocity).map_err(with_option_name)?.0;
            }
            let (image, dims) = (ImageSource::Layered(&stream), stream.header.dims);
            let params = Params {
                modality: Modality::detect(stream.header.format, &stream.header.geometry),
                ..Params::read(&spec).map_err(with_option_name)?
            };
            run.mesh(image, dims, params, &|| stream_notes(&stream), console)
        }
        _ => Err(Error::Job(cause(
            "atomesh mesh",
            "this program was built without TetGen and makes no 3-D mesh",
            "build it with the default features",
        ))),
    }
}

/// What is to be said of an image that is still in its file.
fn stream_notes(stream: &ImageStream) -> Vec<String> {
    let mut notes = stream.header.notes.clone();
    notes.extend(stream.rounding_note());
    notes.push("the image is left in its file, some layers of which are read at a time".into());
    notes
}

/// Returns the options: those that were typed, over those of the configuration file.
///
/// # Errors
/// [`Error::Io`] if the configuration file cannot be read, [`Error::Job`] if it holds something else
/// than options, or for an option that is impossible.
fn read_spec(args: &MeshArgs) -> Result<MeshSpec> {
    let Some(path) = &args.config else {
        let spec = args.spec.options.clone();
        spec.validate().map_err(with_option_name)?;
        return Ok(spec.resolved());
    };
    let text = std::fs::read_to_string(path).map_err(|e| io_error(path, "read", e))?;
    let from_file: MeshSpec = toml::from_str(&text).map_err(|e| {
        let line = e
            .span()
            .map_or(1, |span| 1 + text[..span.start].matches('\n').count());
        Error::Job(cause(
            format!("{}:{line}", path.display()),
            e.message().replace('\n', ", "),
            "atomesh mesh --print-config shows how it is written",
        ))
        .with_source(e)
    })?;
    let spec = args.spec.over(&from_file)?;
    spec.validate().map_err(|error| {
        let place = &error.cause().place;
        // An option that was not typed stands in the file.
        if option_name(place).is_some_and(|name| !args.spec.names.contains(name)) {
            let place = format!("{}: {place}", path.display());
            error.with_place(place)
        } else {
            with_option_name(error)
        }
    })?;
    Ok(spec.resolved())
}

/// A job whose image is read.
struct MeshRun<'a> {
    path: &'a Path,
    spec: &'a MeshSpec,
    interrupts: &'a Interrupts,
    clock: Clock,
}

impl MeshRun<'_> {
    /// Meshes an image in memory.
    fn mesh_in_memory<const D: usize, M: Simplices<D>>(
        self,
        loaded: LoadedImage<D>,
        console: &mut Console,
    ) -> Result<VerbStatus>
    where
        MeshSpace<D>: Meshing<D, Mesh = M>,
    {
        let LoadedImage {
            image,
            mut notes,
            format,
            ..
        } = loaded;
        let dims = image.dims();
        image.check(&self.path.display().to_string())?;
        let mut params = Params::<D>::read(self.spec).map_err(with_option_name)?;
        params.modality = Modality::detect(format, &image.geometry);
        let velocity = self.spec.velocity.as_ref();
        let labels = params.spec.feature == FeatureKind::Labels;
        let (image, stretch) = image_in_depth(image, velocity, labels, console)?;
        if let Some(conversion) = &stretch {
            params
                .convert_to_depth(conversion)
                .map_err(with_option_name)?;
        }
        notes.extend(stretch.into_iter().flat_map(|stretch| stretch.notes));
        self.mesh(
            ImageSource::InMemory(&image),
            dims,
            params,
            &|| notes.clone(),
            console,
        )
    }

    /// Meshes an image, of which there are `notes`; its file is of so many samples.
    fn mesh<const D: usize, M: Simplices<D>>(
        self,
        image: ImageSource<'_, D>,
        dims: [usize; D],
        params: Params<D>,
        notes: &dyn Fn() -> Vec<String>,
        console: &mut Console,
    ) -> Result<VerbStatus>
    where
        MeshSpace<D>: Meshing<D, Mesh = M>,
    {
        let Self {
            path,
            spec,
            interrupts,
            mut clock,
        } = self;
        let geometry = image.geometry();
        warn_if_time(geometry, console);
        let hashing = comm::is_root().then(|| console.start_hash(path));
        let output = output_path(path, spec);

        let step = params.spec.metric.step(geometry);
        let mut watcher = MeshProgress {
            console,
            max_evaluations: crate::job::optimize_options(&params).max_evaluations,
            interrupts,
            trace_path: spec.trace.as_deref(),
            trace: None,
            traced_lattices: Vec::new(),
            is_planar: D == 2,
            geometry: geometry.to_3d(),
            step: std::array::from_fn(|k| step.get(k).copied().unwrap_or(1.0)),
            trace_error: None,
            stage: Stage::Reading,
            interrupted_stage: None,
        };
        let checkpoint = spec
            .checkpoint
            .as_deref()
            .map(Checkpoint::new)
            .transpose()?;
        let whole = [&spec.lines, &spec.page, &spec.surfaces, &spec.potential_out];
        let way = RunOptions {
            checkpoint: checkpoint.as_ref(),
            may_partition: is_pvtu(&output) && whole.iter().all(|path| path.is_none()),
        };
        let outcome = crate::job::run_from(image, &params, way, &mut watcher);
        let (failed, traced) = (watcher.trace_error, watcher.traced_lattices);
        let mut outcome = match failed.map_or(outcome, Err) {
            Ok(outcome) => outcome,
            Err(error) => {
                // What was left undone may look like another fault.
                return Err(match interrupts.is_requested() {
                    true => Error::Interrupted(error.cause().clone()),
                    false => error,
                });
            }
        };

        allocator::trim();
        console.begin_stage(Stage::Writing);
        interrupts.set_stage(Stage::Writing);
        clock.begin(Stage::Writing);
        let found = || hashing.map_or_else(|| console.hash(path), PendingHash::wait);
        let input_sha256 = comm::broadcast_from_root("the image's hash", found)?;
        outcome.provenance = Provenance {
            parameters: spec.clone().reproducible().to_toml()?,
            input_sha256,
        };
        let ending = match outcome.stop == StopReason::Interrupted || interrupts.is_requested() {
            true => VerbStatus::Interrupted,
            false => VerbStatus::Done,
        };
        if comm::is_root() || is_pvtu(&output) {
            console.write_outcome(&output, &outcome, image)?;
        }
        let in_world = match comm::is_root() || outcome.share.is_some() {
            true => outcome.quality_in_world()?,
            false => None,
        };
        if !comm::is_root() {
            return Ok(ending);
        }
        if let Some(path) = &spec.lines {
            outcome.write_lines(path)?;
        }
        outcome.report.quality_physical = in_world;
        let modality = params.modality.or_detect(geometry);
        outcome.report.used_in_physical_space = modality != Modality::Survey;
        if let Some(path) = &spec.potential_out {
            let potential = outcome.features.potential.to_dense();
            console.write_image(path, potential_image(potential, geometry))?;
        }
        clock.end();

        let mut report = std::mem::take(&mut outcome.report);
        report.input = Some(Input {
            file: path.display().to_string(),
            dims: dims.to_vec(),
            hash: format!("sha256:{}", outcome.provenance.input_sha256),
        });
        report.parameters = serde_json::to_value(spec).unwrap_or_default();
        report.trace = traced;
        report.notes.splice(0..0, notes());
        report
            .stages
            .splice(0..0, clock.costs()[..1].iter().cloned());
        report.stages.extend_from_slice(&clock.costs()[1..]);
        let json = report.to_json();
        if let Some(path) = &spec.report {
            crate::files::atomic_write(path, |out| writeln!(out, "{json:#}"))?;
        }
        let mut said = format!("{}\nwrote {}", report.table().trim_end(), output.display());
        if let Some(path) = &spec.page {
            let written = write_page(path, &output, &*image.to_image()?, &outcome, json.clone())?;
            said = format!("{said}\n{}", super::report::written_message(path, written));
        }
        if let Some(path) = &spec.surfaces {
            let surfaces = write_surfaces(path, &output, &outcome, console)?;
            said = format!("{said}\nwrote {}: {surfaces} surfaces", path.display());
        }
        console.result(said, &json);
        Ok(ending)
    }
}

/// Writes the faces on features of a mesh that has just been made and written to `output`, each with the
/// number of its surface; says how many surfaces there are.
fn write_surfaces<const D: usize, M: Simplices<D>>(
    path: &Path,
    output: &Path,
    outcome: &Outcome<D>,
    console: &mut Console,
) -> Result<usize>
where
    MeshSpace<D>: Meshing<D, Mesh = M>,
{
    let place = output.display().to_string();
    match &outcome.mesh {
        MeshResult::Simplices(made) => {
            let stored = StoredMesh::new(simplex_mesh_file(outcome, made), &place)?;
            super::surface::write_tagged_surfaces(path, &stored, console)
        }
        MeshResult::Voronoi { mesh, weld } => {
            let stored = StoredMesh::new(cell_mesh_file(outcome, mesh, *weld), &place)?;
            super::surface::write_tagged_surfaces(path, &stored, console)
        }
    }
}

/// The page of a mesh that has just been made and written to `output`.
fn write_page<const D: usize, M: Simplices<D>>(
    path: &Path,
    output: &Path,
    image: &Image<D>,
    outcome: &Outcome<D>,
    report: serde_json::Value,
) -> Result<PageStats>
where
    MeshSpace<D>: Meshing<D, Mesh = M>,
{
    let name = output.file_name().unwrap_or(output.as_os_str());
    let about = PageInfo {
        title: name.to_string_lossy().into_owned(),
        report,
        parameters: outcome.provenance.parameters.clone(),
        input_hash: outcome.provenance.input_sha256.clone(),
    };
    let place = output.display().to_string();
    // As the file has it.
    match &outcome.mesh {
        MeshResult::Simplices(made) => {
            let file = with_image(
                simplex_mesh_file(outcome, made),
                ImageSource::InMemory(image),
            )?;
            let stored = StoredMesh::new(file, &place)?;
            page::write(path, Some(image), &stored, &about, MAX_PAGE_BYTES)
        }
        MeshResult::Voronoi { mesh, weld } => {
            let file = with_image(
                cell_mesh_file(outcome, mesh, *weld),
                ImageSource::InMemory(image),
            )?;
            let stored = StoredMesh::new(file, &place)?;
            page::write(path, Some(image), &stored, &about, MAX_PAGE_BYTES)
        }
    }
}

/// A large number in two digits.
fn round_to_two_digits(number: f64) -> String {
    match number {
        n if n >= 1e6 => format!("{:.1} million", n / 1e6),
        n => {
            let step = 10f64.powf((n.max(10.0)).log10().floor() - 1.0);
            format!("{:.0}", (n / step).round() * step)
        }
    }
}

/// Shows the pipeline's progress, keeps its lattices, and passes on the wish to stop.
struct MeshProgress<'a> {
    console: &'a mut Console,
    /// Most evaluations of the energy.
    max_evaluations: usize,
    interrupts: &'a Interrupts,
    trace_path: Option<&'a Path>,
    /// Begun with the first lattice.
    trace: Option<PvdSeries>,
    /// The lattices in it.
    traced_lattices: Vec<TracedLattice>,
    /// Whether lattices lie in the plane z = 0.
    is_planar: bool,
    geometry: Geometry<3>,
    step: [f64; 3],
    /// Why a lattice could not be written.
    trace_error: Option<Error>,
    stage: Stage,
    /// In which stage it heard that the user wants to stop.
    interrupted_stage: Option<Stage>,
}

impl MeshProgress<'_> {
    /// Adds a lattice to the trace.
    fn add_snapshot(&mut self, path: &Path, snapshot: &LatticeSnapshot<'_>) -> Result<()> {
        // The lattice with which another optimisation begins is there already.
        if self.trace.is_some() && snapshot.round == 0 {
            return Ok(());
        }
        if self.is_planar {
            let atoms: Vec<[f64; 2]> = snapshot.positions.iter().map(|x| [x[0], x[1]]).collect();
            let step = [self.step[0], self.step[1]];
            let geometry = self.geometry.flatten();
            return self.add_cells(path, &delaunay_plane(&atoms)?, step, &geometry, snapshot);
        }
        let (mesh, geometry) = (delaunay(snapshot.positions)?, self.geometry.clone());
        self.add_cells(path, &mesh, self.step, &geometry, snapshot)
    }

    /// Adds the cells of a lattice to the trace, in the world, and what is said of it.
    fn add_cells<const D: usize, M: Simplices<D>>(
        &mut self,
        path: &Path,
        mesh: &M,
        step: [f64; D],
        geometry: &Geometry<D>,
        snapshot: &LatticeSnapshot<'_>,
    ) -> Result<()> {
        let energies = [
            ("energy", snapshot.energy),
            ("energy_lattice", snapshot.lattice_energy),
            ("energy_image", snapshot.image_energy),
        ];
        let field = |(name, value): (&str, f64)| (name.into(), FieldValue::F64s(vec![value]));
        let shapes = quality(mesh);
        let mesh = to_physical(mesh, step, geometry);
        let frame = MeshFile {
            point_data: Vec::new(),
            cell_data: vec![DataArray::scalars(
                M::MIN_ANGLE_ARRAY,
                smallest_angles(&mesh),
            )],
            field_data: energies.into_iter().map(field).collect(),
            mesh,
        };
        let trace = match &mut self.trace {
            Some(trace) => trace,
            none => none.insert(PvdSeries::create(path)?),
        };
        let step = self.traced_lattices.len();
        trace.add(step as f64, &frame)?;
        self.traced_lattices.push(TracedLattice {
            step,
            worst_quality: shapes.mean_ratio.worst,
            mean_quality: shapes.mean_ratio_mean,
            energy: snapshot.energy,
            energy_lattice: snapshot.lattice_energy,
            energy_image: snapshot.image_energy,
        });
        Ok(())
    }
}

impl Progress for MeshProgress<'_> {
    fn stage(&mut self, stage: Stage) {
        allocator::trim();
        self.stage = stage;
        self.console.begin_stage(stage);
        self.interrupts.set_stage(stage);
    }

    fn note(&mut self, line: &str) {
        self.console.note(line);
    }

    fn estimate(&mut self, estimate: &SizeEstimate) {
        let SizeEstimate {
            atoms,
            cells,
            bytes,
        } = *estimate;
        self.console.log_line(format_args!(
            "about {} atoms, {} cells, {} of memory",
            round_to_two_digits(atoms),
            round_to_two_digits(cells),
            Bytes(bytes)
        ));
    }

    fn optimize_step(&mut self, progress: &OptimizeStatus) {
        self.console.progress(
            progress.evaluations as f64 / self.max_evaluations as f64,
            format_args!("round {}, energy {:.4e}", progress.round, progress.energy),
        );
    }

    fn fraction_done(&mut self, share: f64) {
        self.console.progress(share, "");
    }

    fn lattice(&mut self, snapshot: &LatticeSnapshot<'_>) {
        if let Some(path) = self.trace_path
            && self.trace_error.is_none()
        {
            self.trace_error = self.add_snapshot(path, snapshot).err();
        }
    }

    fn wants_lattices(&self) -> bool {
        self.trace_path.is_some()
    }

    fn keep_going(&mut self) -> bool {
        if self.trace_error.is_some() {
            return false;
        }
        if self.interrupted_stage.is_none() && self.interrupts.is_requested() {
            self.interrupted_stage = Some(self.stage);
            self.console
                .note("interrupted: what there is becomes a mesh if that takes no longer than two seconds; press Ctrl-C again to end at once");
        }
        // Atoms that were stopped are joined and improved in full.
        self.interrupted_stage
            .is_none_or(|heard| heard == Stage::Optimising && heard != self.stage)
    }
}

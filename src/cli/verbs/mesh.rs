//! The verb `mesh`: checks the options, runs the job and writes its files.

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
use crate::comm::Comm;
use crate::error::{cause, io_error};
use crate::export::page::{self, MAX_PAGE_BYTES, PageInfo, PageStats};
use crate::export::surfaces::extract::default_surfaces;
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
use crate::report::{Clock, Input, Report, StageCost, TracedLattice, quality, smallest_angles};
use crate::store::cell_output::cell_mesh_file;
use crate::store::output::{simplex_mesh_file, with_image};
use crate::store::pvtu::is_pvtu;
use crate::store::{FieldValue, MeshFile, PvdSeries, StoredMesh, to_physical};
use crate::{Error, Result};

/// Arguments of `atomesh mesh`.
#[derive(Debug, Args)]
pub struct MeshArgs {
    /// The image to mesh: SEG-Y, Zarr, MDIO, .npy, .vti, .nrrd, .mha, .nii, .tif, .inr, .png (2-D),
    /// or raw samples with --raw
    #[arg(value_name = "IMAGE", required_unless_present = "print_config")]
    pub image: Option<PathBuf>,
    /// Options of the job.
    #[command(flatten)]
    pub spec: Typed<MeshSpec>,
    /// A TOML file of options. Options on the command line take precedence
    #[arg(long, value_name = "FILE.toml", help_heading = None)]
    pub config: Option<PathBuf>,
    /// Print the effective options as TOML and stop
    #[arg(long, help_heading = None)]
    pub print_config: bool,
}

/// Runs the verb.
pub(crate) fn mesh(
    args: &MeshArgs,
    interrupts: &Interrupts,
    console: &mut Console,
    comm: &dyn Comm,
) -> Result<VerbStatus> {
    let spec = read_spec(args)?;
    let image = args.image.as_deref().unwrap_or(Path::new("image"));
    check_files(image, &spec, args.config.as_deref(), comm.size())?;
    if args.print_config {
        print(spec.to_toml()?.trim_end());
        return Ok(VerbStatus::Done);
    }

    let mut clock = Clock::new();
    console.begin_stage(Stage::Reading);
    clock.begin(Stage::Reading);
    // Conversion to depth with a file of velocities resamples the traces in memory.
    let resamples = matches!(spec.velocity, Some(NumberOrFile::File(_)));
    let opened = match console.open_image(image, &spec.input)? {
        OpenedImage::Stream(stream) if resamples || !stream.stays_in_file(comm.size() > 1) => {
            stream
                .into_loaded(image)
                .map(into_any_image)
                .map(OpenedImage::InMemory)?
        }
        opened => opened,
    };
    clock.end();
    let run = MeshRun {
        path: image,
        spec: &spec,
        interrupts,
        clock,
        comm,
    };
    match opened {
        OpenedImage::InMemory(AnyImage::Plane(loaded)) => run.mesh_in_memory(loaded, console),
        OpenedImage::InMemory(AnyImage::Space(loaded)) => run.mesh_in_memory(loaded, console),
        OpenedImage::Stream(mut stream) => {
            if let Some(NumberOrFile::Constant(velocity)) = spec.velocity {
                let geometry = &mut stream.header.geometry;
                *geometry = geometry
                    .to_depth(velocity)
                    .map_err(with_option_name::<MeshSpec>)?
                    .0;
            }
            let (image, dims) = (ImageSource::Layered(&stream), stream.header.dims);
            let params = Params {
                modality: Modality::detect(stream.header.format, &stream.header.geometry),
                ..Params::read_with(&spec, &console.reader())
                    .map_err(with_option_name::<MeshSpec>)?
            };
            run.mesh(image, dims, params, &|| stream_notes(&stream), console)
        }
    }
}

/// Returns the notes on an image that is still in its file.
fn stream_notes(stream: &ImageStream) -> Vec<String> {
    let mut notes = stream.header.notes.clone();
    notes.extend(stream.rounding_note());
    notes.push("the image stays in its file and is read a few layers at a time".into());
    notes
}

/// Returns the typed options, with those of the configuration file for all others.
///
/// # Errors
/// Returns [`Error::Io`] if the configuration file cannot be read, and [`Error::Job`] if it holds
/// anything but options, or for an option that is impossible.
fn read_spec(args: &MeshArgs) -> Result<MeshSpec> {
    let Some(path) = &args.config else {
        let spec = args.spec.options.clone();
        spec.validate().map_err(with_option_name::<MeshSpec>)?;
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
    let spec = args.spec.with_fallback(&from_file)?;
    spec.validate().map_err(|error| {
        let place = &error.cause().place;
        // An option that was not typed comes from the configuration file.
        if option_name::<MeshSpec>(place).is_some_and(|name| !args.spec.names.contains(name)) {
            let place = format!("{}: {place}", path.display());
            error.with_place(place)
        } else {
            with_option_name::<MeshSpec>(error)
        }
    })?;
    Ok(spec.resolved())
}

/// A job whose image has been opened.
struct MeshRun<'a> {
    path: &'a Path,
    spec: &'a MeshSpec,
    interrupts: &'a Interrupts,
    clock: Clock,
    comm: &'a dyn Comm,
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
        let mut params = Params::<D>::read_with(self.spec, &console.reader())
            .map_err(with_option_name::<MeshSpec>)?;
        params.modality = Modality::detect(format, &image.geometry);
        let velocity = self.spec.velocity.as_ref();
        let is_labels = params.spec.feature.has_labels();
        let (image, conversion) = image_in_depth(image, velocity, is_labels, console)?;
        if let Some(conversion) = &conversion {
            params
                .convert_to_depth(conversion)
                .map_err(with_option_name::<MeshSpec>)?;
        }
        notes.extend(
            conversion
                .into_iter()
                .flat_map(|conversion| conversion.notes),
        );
        self.mesh(
            ImageSource::InMemory(&image),
            dims,
            params,
            &|| notes.clone(),
            console,
        )
    }

    /// Meshes an image. `notes` returns the notes on it, and `dims` are the dimensions of the image
    /// in its file.
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
            comm,
        } = self;
        let geometry = image.geometry();
        warn_if_time(geometry, console);
        let pending_hash = comm.is_root().then(|| console.start_hash(path));
        let output = output_path(path, spec);

        let mut progress = MeshProgress::new(&params, spec, geometry, interrupts, comm, console);
        let checkpoint = spec
            .checkpoint
            .as_deref()
            .map(Checkpoint::new)
            .transpose()?;
        let whole_mesh_outputs = [&spec.lines, &spec.page, &spec.surfaces, &spec.potential_out];
        let run_options = RunOptions {
            checkpoint: checkpoint.as_ref(),
            may_partition: is_pvtu(&output) && whole_mesh_outputs.iter().all(|path| path.is_none()),
            comm,
        };
        let outcome = crate::job::run_from(image, &params, run_options, &mut progress);
        let (trace_error, traced) = (progress.trace_error, progress.traced_lattices);
        let result = trace_error.map_or(outcome, Err);
        let mut outcome = result.map_err(|error| job_error(error, interrupts))?;

        allocator::trim();
        console.begin_stage(Stage::Writing);
        interrupts.set_stage(Stage::Writing, comm);
        clock.begin(Stage::Writing);
        let hash = || pending_hash.map_or_else(|| console.hash(path), PendingHash::wait);
        let input_sha256 = comm.broadcast_from_root("the image's hash", hash)?;
        outcome.provenance = Provenance {
            parameters: spec.clone().reproducible().to_toml()?,
            input_sha256,
        };
        let status = if outcome.stop == StopReason::Interrupted || interrupts.is_requested() {
            VerbStatus::Interrupted
        } else {
            VerbStatus::Done
        };
        if comm.is_root() || is_pvtu(&output) {
            console.write_outcome(&output, &outcome, image, comm)?;
        }
        if comm.is_root() || outcome.share.is_some() {
            outcome.report.quality_physical = outcome.quality_in_world(comm)?;
        }
        if !comm.is_root() {
            return Ok(status);
        }
        let modality = params.modality.or_detect(geometry);
        outcome.report.used_in_physical_space = modality != Modality::Survey;
        outcome.report.input = Some(Input {
            file: path.display().to_string(),
            dims: dims.to_vec(),
            hash: format!("sha256:{}", outcome.provenance.input_sha256),
        });
        outcome.report.trace = traced;
        outcome.report.notes.splice(0..0, notes());
        let written = WrittenMesh {
            spec,
            output: &output,
            outcome,
        };
        written.write_others(image, clock, console)?;
        Ok(status)
    }
}

/// A mesh that was written, with its report.
struct WrittenMesh<'a, const D: usize>
where
    MeshSpace<D>: Meshing<D>,
{
    spec: &'a MeshSpec,
    output: &'a Path,
    outcome: Outcome<D>,
}

impl<const D: usize, M: Simplices<D>> WrittenMesh<'_, D>
where
    MeshSpace<D>: Meshing<D, Mesh = M>,
{
    /// Writes the other files of the job, and reports the result.
    fn write_others(
        self,
        image: ImageSource<'_, D>,
        mut clock: Clock,
        console: &mut Console,
    ) -> Result<()> {
        let Self {
            spec,
            output,
            mut outcome,
        } = self;
        if let Some(path) = &spec.lines {
            outcome.write_lines(path)?;
        }
        if let Some(path) = &spec.potential_out {
            let potential = outcome.features.potential.to_dense();
            console.write_image(path, potential_image(potential, image.geometry()))?;
        }
        clock.end();

        let mut report = std::mem::take(&mut outcome.report);
        report.parameters = serde_json::to_value(spec).unwrap_or_default();
        add_own_stages(&mut report, clock.costs());
        let json = report.to_json();
        if let Some(path) = &spec.report {
            crate::files::atomic_write(path, |out| writeln!(out, "{json:#}"))?;
        }
        let mut text = format!("{}\nwrote {}", report.table().trim_end(), output.display());
        if let Some(path) = &spec.page {
            let written = write_page(path, output, &*image.to_image()?, &outcome, json.clone())?;
            text = format!("{text}\n{}", super::report::written_message(path, written));
        }
        if let Some(path) = &spec.surfaces {
            let surfaces = write_surfaces(path, output, &outcome, console)?;
            text = format!("{text}\nwrote {}: {surfaces} surfaces", path.display());
        }
        console.result(text, &json);
        Ok(())
    }
}

/// Returns the error of a job: after an interruption, work that was left undone may look like
/// another error.
fn job_error(error: Error, interrupts: &Interrupts) -> Error {
    if interrupts.is_requested() {
        Error::Interrupted(error.cause().clone())
    } else {
        error
    }
}

/// Adds the stages before and after the job.
fn add_own_stages(report: &mut Report, costs: &[StageCost]) {
    report.stages.splice(0..0, costs[..1].iter().cloned());
    report.stages.extend_from_slice(&costs[1..]);
}

/// Writes the faces on features of a mesh that was written to `output`, each with the number of its
/// surface. Returns the number of surfaces.
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
        MeshResult::Simplices(annotated) => {
            let stored = StoredMesh::new(simplex_mesh_file(outcome, annotated), &place)?;
            let file = default_surfaces(&stored)?;
            let count = file.names.len();
            console.write_surfaces(path, file)?;
            Ok(count)
        }
        MeshResult::Voronoi { mesh, weld } => {
            let stored = StoredMesh::new(cell_mesh_file(outcome, mesh, *weld), &place)?;
            let file = default_surfaces(&stored)?;
            let count = file.names.len();
            console.write_surfaces(path, file)?;
            Ok(count)
        }
    }
}

/// Writes the page of a mesh that was written to `output`.
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
    let info = PageInfo {
        title: name.to_string_lossy().into_owned(),
        report,
        parameters: outcome.provenance.parameters.clone(),
        input_hash: outcome.provenance.input_sha256.clone(),
    };
    let place = output.display().to_string();
    // The page shows the mesh as its file holds it.
    match &outcome.mesh {
        MeshResult::Simplices(annotated) => {
            let file = with_image(
                simplex_mesh_file(outcome, annotated),
                ImageSource::InMemory(image),
            )?;
            let stored = StoredMesh::new(file, &place)?;
            page::write(path, Some(image), &stored, &info, MAX_PAGE_BYTES)
        }
        MeshResult::Voronoi { mesh, weld } => {
            let file = with_image(
                cell_mesh_file(outcome, mesh, *weld),
                ImageSource::InMemory(image),
            )?;
            let stored = StoredMesh::new(file, &place)?;
            page::write(path, Some(image), &stored, &info, MAX_PAGE_BYTES)
        }
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

/// Shows the progress of the job, writes its lattices to the trace, and stops the job when the user
/// asks for it.
struct MeshProgress<'a> {
    console: &'a mut Console,
    /// Largest number of evaluations of the energy.
    max_evaluations: usize,
    interrupts: &'a Interrupts,
    comm: &'a dyn Comm,
    trace_path: Option<&'a Path>,
    /// The trace, which is created with the first lattice.
    trace: Option<PvdSeries>,
    /// Report entries of the lattices in the trace.
    traced_lattices: Vec<TracedLattice>,
    /// `true` if lattices lie in the plane z = 0.
    is_planar: bool,
    geometry: Geometry<3>,
    step: [f64; 3],
    /// The error of a lattice that could not be written.
    trace_error: Option<Error>,
    stage: Stage,
    /// The stage in which the user asked to stop, if so.
    interrupted_stage: Option<Stage>,
}

impl<'a> MeshProgress<'a> {
    fn new<const D: usize>(
        params: &Params<D>,
        spec: &'a MeshSpec,
        geometry: &Geometry<D>,
        interrupts: &'a Interrupts,
        comm: &'a dyn Comm,
        console: &'a mut Console,
    ) -> Self
    where
        MeshSpace<D>: Meshing<D>,
    {
        let step = params.spec.metric.step(geometry);
        Self {
            console,
            max_evaluations: crate::job::optimize_options(params).max_evaluations,
            interrupts,
            comm,
            trace_path: spec.trace.as_deref(),
            trace: None,
            traced_lattices: Vec::new(),
            is_planar: D == 2,
            geometry: geometry.to_3d(),
            step: std::array::from_fn(|k| step.get(k).copied().unwrap_or(1.0)),
            trace_error: None,
            stage: Stage::Reading,
            interrupted_stage: None,
        }
    }

    /// Adds a lattice to the trace.
    fn add_snapshot(&mut self, path: &Path, snapshot: &LatticeSnapshot<'_>) -> Result<()> {
        // The first lattice of a further optimisation is in the trace already.
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

    /// Adds the cells of a lattice to the trace, in physical coordinates, with its energies and
    /// quality.
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
        let lattice_quality = quality(mesh);
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
            worst_quality: lattice_quality.mean_ratio.worst,
            mean_quality: lattice_quality.mean_ratio_mean,
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
        self.interrupts.set_stage(stage, self.comm);
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

    fn fraction_done(&mut self, fraction: f64) {
        self.console.progress(fraction, "");
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
                .note("interrupted: the lattice becomes a mesh if this takes no longer than two seconds; press Ctrl-C again to stop at once");
        }
        // After a stop of the optimisation, the later stages run in full.
        self.interrupted_stage
            .is_none_or(|stage| stage == Stage::Optimising && stage != self.stage)
    }
}

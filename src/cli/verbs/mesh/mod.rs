//! The verb `mesh`: checks the options, runs the job and writes its files.
//!
//! - `files`: the files beside the mesh: report, page, surfaces, lines, potential
//! - `progress`: the progress on the console, and the trace of lattices

mod files;
mod progress;

use std::path::{Path, PathBuf};

use clap::Args;

use crate::cli::allocator;
use crate::cli::common::depth::{image_in_depth, warn_if_time};
use crate::cli::common::global::VerbStatus;
use crate::cli::common::options::{Typed, option_name, with_option_name};
use crate::cli::console::{Console, PendingHash, print};
use crate::cli::interrupts::Interrupts;
use crate::cli::job_files::{check_files, output_path};
use crate::comm::Comm;
use crate::error::{cause, io_error};
use crate::feature::FeatureKind;
use crate::image::formats::stream::{ImageStream, OpenedImage};
use crate::image::formats::with_loaded;
use crate::image::formats::{LoadedImage, into_any_image};
use crate::image::{ImageSource, Modality};
use crate::job::spec::NumberOrFile;
use crate::job::{Checkpoint, MeshSpace, MeshSpec, Meshing, Params, Provenance, RunOptions};
use crate::lattice::optimize::StopReason;
use crate::mesh::Simplices;
use crate::mesh_file::pvtu::is_pvtu;
use crate::progress::Stage;
use crate::report::{Clock, Input};
use crate::{Error, Result};
use files::WrittenMesh;
use progress::MeshProgress;

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
    /// Print the whole report, which --report writes as JSON in any case
    #[arg(long, help_heading = None)]
    pub details: bool,
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
        shows_details: args.details,
        interrupts,
        clock,
        comm,
    };
    match opened {
        OpenedImage::InMemory(image) => {
            with_loaded!(image, loaded => run.mesh_in_memory(loaded, console))
        }
        OpenedImage::Stream(mut stream) => {
            let file_geometry = stream.header.geometry.clone();
            if let Some(NumberOrFile::Constant(velocity)) = spec.velocity {
                let geometry = &mut stream.header.geometry;
                *geometry = geometry
                    .to_depth(velocity)
                    .map_err(with_option_name::<MeshSpec>)?
                    .0;
            }
            let (image, dims) = (ImageSource::Layered(&stream), stream.header.dims);
            let mut params = Params {
                modality: Modality::detect(stream.header.format, &stream.header.geometry),
                ..Params::read_with(&spec, &console.reader())
                    .map_err(with_option_name::<MeshSpec>)?
            };
            params.note_time_unit(&file_geometry);
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
    shows_details: bool,
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
        let place = self.path.display().to_string();
        if self.spec.feature == FeatureKind::NoFeatures {
            image.check_samples(&place)?;
        } else {
            image.check(&place)?;
        }
        let mut params = Params::<D>::read_with(self.spec, &console.reader())
            .map_err(with_option_name::<MeshSpec>)?;
        params.modality = Modality::detect(format, &image.geometry);
        params.note_time_unit(&image.geometry);
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
            shows_details,
            interrupts,
            mut clock,
            comm,
        } = self;
        let geometry = image.geometry();
        let params = params.with_metric_for(geometry).into_owned();
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
            parameters: MeshSpec {
                metric: params.spec.metric.clone(),
                ..spec.clone().reproducible()
            }
            .to_toml()?,
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
            let quality = outcome.quality_in_world(comm)?;
            quality
                .into_iter()
                .for_each(|quality| outcome.report.set_physical_quality(quality));
        }
        if !comm.is_root() {
            return Ok(status);
        }
        outcome.report.set_angle_space(geometry);
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
            shows_details,
            outcome,
        };
        written.write_others(image, clock, console)?;
        Ok(status)
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

//! The verb `mesh`: a job with the files that it reads and writes.

use std::panic::resume_unwind;
use std::path::Path;
use std::thread::{self, JoinHandle};

use super::check::{check_files, output_path};
use super::trace::TracedProgress;
use super::{Answer, Output, Session, others};
use crate::comm::{Comm, SelfComm};
use crate::feature::FeatureKind;
use crate::image::formats::stream::ImageStream;
use crate::image::formats::{LoadedImage, OpenedImage, file_hash, into_any_image, with_loaded};
use crate::image::{self, Geometry, Image, ImageSource, Modality};
use crate::job::{
    Checkpoint, MeshImage, MeshSpec, Outcome, Params, Provenance, RunOptions, run_from,
};
use crate::lattice::optimise::StopReason;
use crate::mesh::poly::PolyMesh;
use crate::mesh::{Simplices, Space};
use crate::mesh_file::pvtu::is_pvtu;
use crate::mesh_file::{AnyMesh, MeshFile};
use crate::option_text::NumberOrFile;
use crate::progress::{Progress, Stage};
use crate::report::{Clock, Input};
use crate::store::input::time_warning;
use crate::{Error, Result, memory};

impl Session<'_> {
    /// Makes a mesh of an image. The options must be checked, as
    /// [`MeshSpec::with_config`] does; they name the files that are written.
    ///
    /// # Errors
    /// Returns the errors of files that cannot be read or written, and of [`run_from`].
    pub fn mesh(&mut self, image: &Path, spec: &MeshSpec) -> Result<Answer> {
        check_files(image, spec, None, 1)?;
        run_distributed(self, image, spec, false, &SelfComm)
    }
}

/// Makes a mesh with the ranks of a communicator, after the names of the files have been checked. The
/// text of the report has all its `details` or only a summary. Only the root rank returns a report.
pub(crate) fn run_distributed(
    session: &mut Session<'_>,
    path: &Path,
    spec: &MeshSpec,
    details: bool,
    comm: &dyn Comm,
) -> Result<Answer> {
    let mut clock = Clock::new();
    session.progress.stage(Stage::Reading);
    clock.begin(Stage::Reading);
    // Conversion to depth with a file of velocities resamples the traces in memory.
    let resamples = matches!(spec.velocity, Some(NumberOrFile::File(_)));
    let opened = match session.objects.open_image(path, &spec.input)? {
        OpenedImage::Stream(stream) if resamples || !stream.stays_in_file(comm.size() > 1) => {
            OpenedImage::InMemory(into_any_image(stream.into_loaded(path)?))
        }
        opened => opened,
    };
    clock.end();
    let run = JobRun {
        path,
        spec,
        details,
        clock,
        comm,
        session,
    };
    match opened {
        OpenedImage::InMemory(image) => {
            with_loaded!(image, loaded => run.mesh_in_memory(loaded))
        }
        OpenedImage::Stream(mut stream) => {
            let file_geometry = stream.header.geometry.clone();
            if let Some(NumberOrFile::Constant(velocity)) = spec.velocity {
                stream.header.geometry = file_geometry.to_depth(velocity)?.0;
            }
            let (image, dims) = (ImageSource::Layered(&stream), stream.header.dims);
            let mut params = Params {
                modality: Modality::detect(stream.header.format, &stream.header.geometry),
                ..run.params()?
            };
            params.note_time_unit(&file_geometry);
            run.mesh(image, dims, params, &|| stream_notes(&stream))
        }
    }
}

/// Returns the notes on an image that is still in its file.
fn stream_notes(stream: &ImageStream) -> Vec<String> {
    let mut notes = stream.header.notes.clone();
    notes.extend(stream.rounding_note());
    if !stream.header.label_names.is_empty() {
        notes.push(
            "names of labels are not used, since the image stays in its file: --label gives them"
                .into(),
        );
    }
    notes.push("the image stays in its file and is read a few layers at a time".into());
    notes
}

/// Starts to compute the hash of a file in a thread of its own.
fn start_hash(path: &Path) -> Option<JoinHandle<Result<String>>> {
    let path = path.to_path_buf();
    thread::Builder::new().spawn(move || file_hash(&path)).ok()
}

/// A job whose image has been opened.
struct JobRun<'a, 'b> {
    path: &'a Path,
    spec: &'a MeshSpec,
    details: bool,
    clock: Clock,
    comm: &'a dyn Comm,
    session: &'a mut Session<'b>,
}

impl JobRun<'_, '_> {
    /// Reads the files that the options name.
    fn params<const D: usize>(&self) -> Result<Params<D>> {
        let objects = self.session.objects;
        Params::read_with(self.spec, &|path, input| objects.read_image(path, input))
    }

    /// Meshes an image in memory.
    fn mesh_in_memory<const D: usize, M: Simplices<D>>(
        self,
        loaded: LoadedImage<D>,
    ) -> Result<Answer>
    where
        Space<D>: MeshImage<D, Mesh = M>,
        MeshFile<M>: Into<AnyMesh>,
        MeshFile<PolyMesh<D>>: Into<AnyMesh>,
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
        notes.extend(self.spec.notes_on_names(&image.label_names));
        let mut params = self.params::<D>()?;
        params.modality = Modality::detect(format, &image.geometry);
        params.note_time_unit(&image.geometry);
        let velocity = self.spec.velocity.as_ref();
        note_velocity_unit(&image, velocity, self.session.progress);
        let is_labels = params.spec.feature.has_labels();
        let objects = self.session.objects;
        let (image, conversion) =
            image::image_in_depth(image, velocity, is_labels, &|path, input| {
                objects.read_image(path, input)
            })?;
        if let Some(conversion) = conversion {
            params.convert_to_depth(&conversion)?;
            notes.extend(conversion.notes);
        }
        let source = ImageSource::InMemory(&image);
        self.mesh(source, dims, params, &|| notes.clone())
    }

    /// Meshes an image. `notes` returns the notes on it, and `dims` are the dimensions of the image
    /// in its file.
    fn mesh<const D: usize, M: Simplices<D>>(
        self,
        image: ImageSource<'_, D>,
        dims: [usize; D],
        params: Params<D>,
        notes: &dyn Fn() -> Vec<String>,
    ) -> Result<Answer>
    where
        Space<D>: MeshImage<D, Mesh = M>,
        MeshFile<M>: Into<AnyMesh>,
        MeshFile<PolyMesh<D>>: Into<AnyMesh>,
    {
        let Self {
            path,
            spec,
            details,
            mut clock,
            comm,
            session: Session { objects, progress },
        } = self;
        let geometry = image.geometry();
        let params = params.with_metric_for(image)?.into_owned();
        let warning = time_warning(geometry);
        warning.iter().for_each(|line| progress.note(line));
        let known_hash = objects.known_hash(path);
        let needs_hash = comm.is_root() && known_hash.is_none();
        let hash_thread = needs_hash.then(|| start_hash(path)).flatten();
        let output = output_path(path, spec);

        let mut traced = TracedProgress::new(&params, spec, geometry, *progress);
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
            is_trial: false,
        };
        let outcome = run_from(image, &params, run_options, &mut traced);
        let (trace_error, lattices) = (traced.error, traced.lattices);
        let mut outcome = trace_error.map_or(outcome, Err).map_err(|error| {
            // After an interruption, work that was left undone may look like another error.
            if progress.keep_going() {
                error
            } else {
                Error::Interrupted(error.cause().clone())
            }
        })?;

        memory::trim();
        progress.stage(Stage::Writing);
        clock.begin(Stage::Writing);
        let hash = || match (known_hash, hash_thread) {
            (Some(hash), _) => Ok(hash),
            (None, Some(thread)) => thread.join().unwrap_or_else(|panic| resume_unwind(panic)),
            (None, None) => file_hash(path),
        };
        let input_sha256 = comm.broadcast_from_root("the image's hash", hash)?;
        outcome.provenance = Provenance {
            parameters: MeshSpec {
                metric: params.spec.metric.clone(),
                ..spec.clone().reproducible()
            }
            .with_lengths_in(geometry)?
            .to_toml()?,
            input_sha256,
        };
        let mut answer = Answer {
            is_interrupted: outcome.stop == StopReason::Interrupted || !progress.keep_going(),
            ..Answer::default()
        };
        if objects.keeps(&output) {
            let mesh = Output::Mesh(outcome.mesh_file(image)?);
            answer = answer.with_result(objects, &output, mesh)?;
        } else if comm.is_root() || is_pvtu(&output) {
            outcome.write_distributed(&output, image, comm)?;
        }
        if comm.is_root() || outcome.share.is_some() {
            let quality = outcome.quality_in_world(comm)?;
            quality
                .into_iter()
                .for_each(|quality| outcome.report.set_physical_quality(quality));
        }
        if !comm.is_root() {
            return Ok(answer);
        }
        set_input(&mut outcome, path, geometry, dims);
        outcome.report.trace = lattices;
        outcome.report.notes.splice(0..0, notes());
        others::write_others(spec, &output, outcome, image, (clock, details), answer)
    }
}

/// Describes the image in the report.
fn set_input<const D: usize, M: Simplices<D>>(
    outcome: &mut Outcome<D, M>,
    path: &Path,
    geometry: &Geometry<D>,
    dims: [usize; D],
) {
    outcome.report.set_angle_space(geometry);
    outcome.report.body = outcome.body_size();
    outcome.report.input = Some(Input {
        file: path.display().to_string(),
        dims: dims.to_vec(),
        hash: format!("sha256:{}", outcome.provenance.input_sha256),
    });
}

/// Notes that the velocity is in m/s if the depth will be in another unit than metres.
fn note_velocity_unit<const D: usize>(
    image: &Image<D>,
    velocity: Option<&NumberOrFile>,
    progress: &mut dyn Progress,
) {
    if let (Some(NumberOrFile::Constant(v)), Ok(time)) = (velocity, image.geometry.two_way_time())
        && time.depth_unit != "m"
    {
        let per_second = (v * time.depth_units_per_metre()).round();
        let unit = time.depth_unit;
        progress.note(&format!(
            "depth is in {unit}, as x and y are; the velocity is in m/s: {v} m/s are {per_second} {unit}/s"
        ));
    }
}

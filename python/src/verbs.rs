//! The verbs: each calls a function of the library with its options and its inputs.

use std::path::{Path, PathBuf};

use atomesh::assess::{QualitySpec, ReportSpec};
use atomesh::edit::{EditSpec, input_options};
use atomesh::error::cause;
use atomesh::export::convert::{ConvertSpec, Converted};
use atomesh::export::surfaces::vtp::read_shapes;
use atomesh::export::{ExportFormat, ExportSpec};
use atomesh::files::output::{file_report, path_text};
use atomesh::image::formats::{AnyImage, InputOptions, LoadedImage, OpenedImage};
use atomesh::image::synth::SynthSpec;
use atomesh::job::{FeatureSpec, MeshSpec};
use atomesh::job_files::{self, JobInput};
use atomesh::model::columns::given::GivenHorizon;
use atomesh::model::columns::{ColumnsInput, ColumnsSpec};
use atomesh::model::flow::FlowSpec;
use atomesh::model::paint::PaintSpec;
use atomesh::model::segment::SegmentSpec;
use atomesh::model::slice::{SliceInput, SliceSpec};
use atomesh::model::validate::CheckerVerdict;
use atomesh::progress::{Progress, Stage};
use atomesh::report::Clock;
use atomesh::store::{AnyMesh, ImageInput, MeshInput};
use atomesh::surfaces::SurfaceSpec;
use atomesh::{Error, Result, files, memory};
use serde_json::{Value, json};

use crate::memory::{Answer, Memory, Output, is_in_memory};
use crate::options::Options;

/// A call of a verb.
pub struct Call {
    pub verb: String,
    /// The positional arguments.
    pub arguments: Vec<PathBuf>,
    pub options: Options,
    pub memory: Memory,
}

impl Call {
    /// Runs the verb. Output files appear when it has succeeded, or not at all.
    ///
    /// # Errors
    /// Returns the errors of the options, of the files and of the library. An error that begins with
    /// the name of an option begins with its two hyphens.
    pub fn run(mut self, progress: &mut dyn Progress) -> Result<Answer> {
        if let Some(bytes) = self.options.take_max_memory()? {
            memory::set_limit(bytes);
        }
        let verb = self.verb.clone();
        files::transaction(|| self.run_verb(progress)).map_err(|error| with_hyphens(error, &verb))
    }

    fn run_verb(mut self, progress: &mut dyn Progress) -> Result<Answer> {
        let output = match self.verb.as_str() {
            "mesh" | "convert" => PathBuf::new(),
            _ => self.options.take_path("output").unwrap_or_default(),
        };
        match self.verb.as_str() {
            "mesh" => self.mesh(progress),
            "feature" => self.feature(&output, progress),
            "columns" => self.columns(&output, progress),
            "convert" => self.convert(progress),
            "edit" => self.edit(&output, progress),
            "flow" => self.flow(&output, progress),
            "info" => self.info(),
            "paint" => self.paint(&output, progress),
            "quality" => self.quality(progress),
            "report" => self.report(&output, progress),
            "segment" => self.segment(&output, progress),
            "slice" => self.slice(&output, progress),
            "surface" => self.surface(&output, progress),
            "synth" => self.synth(&output),
            "validate" => self.validate(progress),
            "export" => self.export(&output, progress),
            other => Err(Error::Job(cause(other, "is no verb", "give another"))),
        }
    }

    fn argument(&self, k: usize) -> &Path {
        self.arguments
            .get(k)
            .map_or(Path::new(""), PathBuf::as_path)
    }

    /// Reads the mesh that an argument names, and runs a function of the library on it.
    fn on_mesh<T>(
        &self,
        argument: usize,
        progress: &mut dyn Progress,
        work: impl FnOnce(MeshInput<'_>, &mut dyn Progress) -> Result<T>,
    ) -> Result<T> {
        progress.stage(Stage::Reading);
        let path = self.argument(argument);
        let mesh = self.memory.read_mesh(path, progress)?;
        self.on_read_mesh(mesh, path, progress, work)
    }

    /// Runs a function of the library on a mesh of this name.
    fn on_read_mesh<T>(
        &self,
        mesh: AnyMesh,
        name: &Path,
        progress: &mut dyn Progress,
        work: impl FnOnce(MeshInput<'_>, &mut dyn Progress) -> Result<T>,
    ) -> Result<T> {
        let read_image = |path: &Path, input: &InputOptions| self.memory.read_image(path, input);
        let input = MeshInput {
            mesh,
            name: &path_text(name),
            read_image: &read_image,
        };
        work(input, progress)
    }

    fn mesh(mut self, progress: &mut dyn Progress) -> Result<Answer> {
        let config = self.options.take_path("config");
        let names = self.options.0.keys().cloned().collect();
        let spec: MeshSpec = self.options.spec()?;
        let spec = spec.with_config(&names, config.as_deref())?;
        let name = self.argument(0);
        let image = self.memory.image(name, &spec.input)?;
        let input = JobInput {
            name,
            image: match image {
                Some(image) => Some((image, self.memory.hash(name)?)),
                None => None,
            },
            read_image: &|path, input| self.memory.read_image(path, input),
        };
        let output = spec.output.clone().unwrap_or_default();
        let finished = job_files::run(input, &spec, is_in_memory(&output), progress)?;
        Ok(Answer {
            text: finished.report.summary().trim_end().to_string(),
            json: finished.json,
            kept: finished
                .mesh
                .map(|mesh| (path_text(&output), Output::Mesh(mesh))),
            is_interrupted: finished.is_interrupted,
        })
    }

    fn feature(self, output: &Path, progress: &mut dyn Progress) -> Result<Answer> {
        fn detect<const D: usize>(
            loaded: &LoadedImage<D>,
            name: &Path,
            spec: &FeatureSpec,
            any: fn(LoadedImage<D>) -> AnyImage,
            progress: &mut dyn Progress,
        ) -> Result<(AnyImage, Value)> {
            loaded.notes.iter().for_each(|note| progress.note(note));
            loaded.image.check(&path_text(name))?;
            let outcome = atomesh::features(loaded, spec, progress)?;
            let geometry = &loaded.image.geometry;
            outcome.write_others(spec, geometry)?;
            let json = outcome.to_json(spec);
            let potential = outcome.features.potential.to_dense().into_image(geometry);
            Ok((any(potential.into()), json))
        }
        let (spec, name) = (self.options.spec::<FeatureSpec>()?, self.argument(0));
        spec.check_files(name, output)?;
        let (potential, json) = match self.memory.read_image(name, &spec.input)? {
            AnyImage::Plane(loaded) => detect(&loaded, name, &spec, AnyImage::Plane, progress),
            AnyImage::Space(loaded) => detect(&loaded, name, &spec, AnyImage::Space, progress),
        }?;
        answer(
            output,
            Output::Image(potential),
            String::new(),
            file_report(output, json),
        )
    }

    fn columns(mut self, output: &Path, progress: &mut dyn Progress) -> Result<Answer> {
        let horizons = self.options.take_texts("horizon");
        let (spec, name) = (self.options.spec::<ColumnsSpec>()?, self.argument(0));
        spec.check_files(name, &horizons, output)?;
        progress.stage(Stage::Reading);
        let map = self.memory.read_mesh(name, progress)?;
        let read_image = |path: &Path, input: &InputOptions| self.memory.read_image(path, input);
        let read = |text: &String| GivenHorizon::read(text, &spec.input, &read_image, progress);
        let horizons = horizons.iter().map(read).collect::<Result<_>>()?;
        let input = ColumnsInput {
            map,
            name: &path_text(name),
            sha256: self.memory.hash(name)?,
            horizons,
        };
        let outcome = atomesh::columns(input, &spec, progress)?;
        let (text, json) = (outcome.table(), file_report(output, outcome.to_json()));
        answer(
            output,
            Output::Mesh(AnyMesh::Polyhedra(outcome.mesh)),
            text,
            json,
        )
    }

    fn convert(self, progress: &mut dyn Progress) -> Result<Answer> {
        let (input, output) = (self.argument(0), self.argument(1));
        let spec: ConvertSpec = self.options.spec()?;
        spec.check_files(input, output)?;
        let keeps = is_in_memory(output);
        let open = |path: &Path, input: &InputOptions| match keeps {
            true => self
                .memory
                .read_image(path, input)
                .map(OpenedImage::InMemory),
            false => self.memory.open_image(path, input),
        };
        let (converted, notes) = atomesh::convert(input, output, &spec, &open)?;
        notes.iter().for_each(|note| progress.note(note));
        let json = json!({ "dims": converted.dims(), "surfaces": converted.surface_count() });
        let json = file_report(output, json);
        match converted {
            Converted::Image(image) if keeps => {
                answer(output, Output::Image(image), String::new(), json)
            }
            Converted::Surfaces(surfaces) if keeps => {
                answer(output, Output::Surfaces(surfaces), String::new(), json)
            }
            other => {
                let notes = other.write(output)?;
                notes.iter().for_each(|note| progress.note(note));
                Ok(report_alone(String::new(), json))
            }
        }
    }

    fn edit(self, output: &Path, progress: &mut dyn Progress) -> Result<Answer> {
        let spec: EditSpec = self.options.spec()?;
        let (mesh_name, image_name) = (self.argument(0), self.argument(1));
        spec.check_files(mesh_name, image_name, output)?;
        let mut clock = Clock::new();
        progress.stage(Stage::Reading);
        clock.begin(Stage::Reading);
        let mesh = self.memory.read_mesh(mesh_name, progress)?;
        let input = input_options(&mesh, &path_text(mesh_name), &spec.input)?;
        let image = ImageInput {
            image: self.memory.read_image(image_name, &input)?,
            name: &path_text(image_name),
            sha256: Some(self.memory.hash(image_name)?),
        };
        clock.end();
        let outcome = self.on_read_mesh(mesh, mesh_name, progress, |mesh, progress| {
            atomesh::edit(mesh, image, &spec, progress)
        })?;
        let mut report = outcome.report;
        report.add_costs(clock.costs());
        let (text, json) = (report.table(), file_report(output, report.to_json()));
        answer(output, Output::Mesh(outcome.mesh), text, json)
    }

    fn flow(self, output: &Path, progress: &mut dyn Progress) -> Result<Answer> {
        let spec: FlowSpec = self.options.spec()?;
        spec.check_files(self.argument(0), output)?;
        let outcome = self.on_mesh(0, progress, |mesh, progress| {
            atomesh::flow(mesh, &spec, progress)
        })?;
        outcome.write_others(&spec)?;
        let (text, json) = (outcome.report.table(), json!(outcome.report));
        answer(output, Output::Mesh(outcome.mesh), text, json)
    }

    fn info(self) -> Result<Answer> {
        let info = atomesh::info(self.argument(0), &self.options.spec()?)?;
        Ok(report_alone(info.text, info.json))
    }

    fn paint(self, output: &Path, progress: &mut dyn Progress) -> Result<Answer> {
        let spec: PaintSpec = self.options.spec()?;
        spec.check_files(self.argument(0), output)?;
        let outcome = self.on_mesh(0, progress, |mesh, progress| {
            atomesh::paint(mesh, &spec, progress)
        })?;
        outcome.write_others(&spec)?;
        let (text, json) = (outcome.table(), file_report(output, outcome.to_json(&spec)));
        answer(output, Output::Mesh(outcome.mesh), text, json)
    }

    fn quality(self, progress: &mut dyn Progress) -> Result<Answer> {
        let spec: QualitySpec = self.options.spec()?;
        spec.check_files(self.argument(0))?;
        let report = self.on_mesh(0, progress, |mesh, progress| {
            atomesh::quality(mesh, &spec, progress)
        })?;
        Ok(report_alone(report.table(), report.to_json()))
    }

    fn report(self, output: &Path, progress: &mut dyn Progress) -> Result<Answer> {
        let (spec, name) = (self.options.spec::<ReportSpec>()?, self.argument(0));
        spec.check_files(name, self.argument(1), output)?;
        let image = ImageInput {
            image: self.memory.read_image(name, &spec.input)?,
            name: &path_text(name),
            // The figures of a run hold the hash already.
            sha256: match spec.figures {
                Some(_) => None,
                None => Some(self.memory.hash(name)?),
            },
        };
        let stats = self.on_mesh(1, progress, |mesh, progress| {
            atomesh::report(mesh, image, output, &spec, progress)
        })?;
        let json = file_report(output, json!({ "page": stats }));
        Ok(report_alone(String::new(), json))
    }

    fn segment(self, output: &Path, progress: &mut dyn Progress) -> Result<Answer> {
        let (spec, name) = (self.options.spec::<SegmentSpec>()?, self.argument(0));
        spec.check_files(name, self.argument(1), output)?;
        let image = ImageInput {
            image: self.memory.read_image(name, &spec.input)?,
            name: &path_text(name),
            sha256: None,
        };
        let outcome = self.on_mesh(1, progress, |mesh, progress| {
            atomesh::segment(mesh, image, &spec, progress)
        })?;
        outcome.write_others(&spec)?;
        let (text, json) = (outcome.table(), file_report(output, outcome.to_json(&spec)));
        answer(output, Output::Mesh(outcome.mesh), text, json)
    }

    fn slice(self, output: &Path, progress: &mut dyn Progress) -> Result<Answer> {
        let spec: SliceSpec = self.options.spec()?;
        let names = spec.check_files(&self.arguments, output)?;
        progress.stage(Stage::Reading);
        let open = |name: &PathBuf| self.memory.open_image(name, &spec.input);
        let read_mesh = |name: &PathBuf| self.memory.read_mesh(name, progress);
        let shapes = names.shapes.iter().map(|path| read_shapes(path));
        let input = SliceInput {
            image: names.image.as_ref().map(open).transpose()?,
            mesh: names.mesh.as_ref().map(read_mesh).transpose()?,
            shapes: shapes.collect::<Result<Vec<_>>>()?.concat(),
            names,
        };
        let picture = atomesh::slice(input, &spec, progress)?;
        picture.write(output)?;
        let json = file_report(output, json!({ "size": picture.size() }));
        Ok(report_alone(String::new(), json))
    }

    fn surface(mut self, output: &Path, progress: &mut dyn Progress) -> Result<Answer> {
        if let Some(image) = self.arguments.get(1) {
            let image = image.to_string_lossy().into_owned();
            self.options.0.insert("image".into(), image.into());
        }
        let spec: SurfaceSpec = self.options.spec()?;
        spec.check_files(self.argument(0), output)?;
        let outcome = self.on_mesh(0, progress, |mesh, progress| {
            atomesh::surfaces(mesh, &spec, progress)
        })?;
        outcome.write_mesh(&spec)?;
        let text = outcome.table(spec.meets);
        let json = file_report(output, outcome.to_json(&spec));
        if is_in_memory(output) {
            return answer(output, Output::Surfaces(outcome.surfaces), text, json);
        }
        let note = outcome.grid_note(output, &spec);
        note.iter().for_each(|note| progress.note(note));
        outcome.write(output, &spec)?;
        Ok(report_alone(text, json))
    }

    fn synth(self, output: &Path) -> Result<Answer> {
        let spec: SynthSpec = self.options.spec()?;
        spec.check_files(output)?;
        let image = atomesh::synth(self.argument(0).to_string_lossy().parse()?, &spec)?;
        let json = file_report(output, json!({ "dims": image.dims() }));
        if is_in_memory(output) {
            return answer(output, Output::Image(image), String::new(), json);
        }
        SynthSpec::write(&image, output)?;
        Ok(report_alone(String::new(), json))
    }

    fn validate(self, progress: &mut dyn Progress) -> Result<Answer> {
        let name = self.argument(0);
        let verdicts = self.on_mesh(0, progress, |mesh, progress| {
            atomesh::validate(mesh, progress)
        })?;
        CheckerVerdict::require_valid(&verdicts, &path_text(name))?;
        let json = file_report(name, CheckerVerdict::to_json(&verdicts));
        Ok(report_alone(String::new(), json))
    }

    fn export(mut self, output: &Path, progress: &mut dyn Progress) -> Result<Answer> {
        let format = self.options.take_path("to").unwrap_or_default();
        let spec: ExportSpec = self.options.spec()?;
        let format = ExportFormat::from_name(&format.to_string_lossy())?;
        spec.validate(format)?;
        format.check_files(self.argument(0), output)?;
        let outcome = self.on_mesh(0, progress, |mesh, progress| {
            atomesh::export(mesh, format, output, &spec, progress)
        })?;
        Ok(report_alone(outcome.table(), outcome.to_json()))
    }
}

/// Returns the answer of a verb that makes no result for Python.
fn report_alone(text: String, json: Value) -> Answer {
    Answer {
        text,
        json,
        ..Answer::default()
    }
}

/// Keeps a result in memory or writes it, by the name of the output.
fn answer(output: &Path, result: Output, text: String, json: Value) -> Result<Answer> {
    let mut answer = report_alone(text, json);
    if is_in_memory(output) {
        answer.kept = Some((path_text(output), result));
        return Ok(answer);
    }
    match result {
        Output::Mesh(mesh) => mesh.write(output)?,
        Output::Image(image) => image.write(output)?,
        Output::Surfaces(surfaces) => surfaces.write(output)?,
    }
    Ok(answer)
}

/// Returns the error with two hyphens before a place that begins with the name of an option of the
/// verb, as messages of the library name options elsewhere.
fn with_hyphens(error: Error, verb: &str) -> Error {
    let place = &error.cause().place;
    let name = place.split(' ').next().unwrap_or_default();
    let table = atomesh::option_table();
    let has_option = |verb: &str| {
        let options = table[verb]["options"].as_array();
        options.is_some_and(|options| options.iter().any(|option| option["name"] == name))
    };
    // An edit also repeats the options of the mesh.
    if has_option(verb) || verb == "edit" && has_option("mesh") {
        let place = format!("--{place}");
        return error.with_place(place);
    }
    error
}

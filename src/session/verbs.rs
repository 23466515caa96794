//! The verbs: each checks its options and files, reads, calls a function of the library, and writes.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::{Answer, Output, Session};
use crate::Result;
use crate::assess::{QualitySpec, ReportSpec};
use crate::edit::{EditSpec, edit_with_cache, input_options, prepare_edits};
use crate::export::convert::{ConvertSpec, Converted};
use crate::export::surfaces::vtp::read_shapes;
use crate::export::{ExportFormat, ExportSpec};
use crate::files::output::{file_report, path_text};
use crate::image::formats::{AnyImage, InputOptions, LoadedImage, OpenedImage, with_loaded};
use crate::image::synth::SynthSpec;
use crate::job::FeatureSpec;
use crate::model::columns::given::GivenHorizon;
use crate::model::columns::{ColumnsInput, ColumnsSpec};
use crate::model::flow::FlowSpec;
use crate::model::paint::{PaintSpec, paint_with_cache};
use crate::model::segment::SegmentSpec;
use crate::model::slice::{SliceInput, SliceSpec};
use crate::model::validate::CheckerVerdict;
use crate::progress::{Progress, Stage};
use crate::report::Clock;
use crate::store::{AnyMesh, ImageInput, MeshInput};
use crate::surfaces::SurfaceSpec;

impl Session<'_> {
    /// Reads a mesh, and runs a function of the library on it.
    fn on_mesh<T>(
        &mut self,
        name: &Path,
        work: impl FnOnce(MeshInput<'_>, &mut dyn Progress) -> Result<T>,
    ) -> Result<T> {
        self.progress.stage(Stage::Reading);
        let mesh = self.objects.read_mesh(name, self.progress)?;
        self.on_read_mesh(mesh, name, work)
    }

    /// Runs a function of the library on a mesh of this name.
    fn on_read_mesh<T>(
        &mut self,
        mesh: AnyMesh,
        name: &Path,
        work: impl FnOnce(MeshInput<'_>, &mut dyn Progress) -> Result<T>,
    ) -> Result<T> {
        let objects = self.objects;
        let input = MeshInput {
            mesh,
            name: &path_text(name),
            read_image: &|path, input| objects.read_image(path, input),
        };
        work(input, self.progress)
    }

    fn notes(&mut self, notes: &[String]) {
        notes.iter().for_each(|note| self.progress.note(note));
    }

    /// Detects the features of an image.
    ///
    /// # Errors
    /// Returns the errors of the options, of the files, and of [`features`](crate::features).
    pub fn feature(&mut self, image: &Path, output: &Path, spec: &FeatureSpec) -> Result<Answer> {
        spec.check_files(image, output)?;
        with_loaded!(self.objects.read_image(image, &spec.input)?,
            loaded => self.features_of(&loaded, image, output, spec))
    }

    fn features_of<const D: usize>(
        &mut self,
        loaded: &LoadedImage<D>,
        name: &Path,
        output: &Path,
        spec: &FeatureSpec,
    ) -> Result<Answer>
    where
        AnyImage: From<LoadedImage<D>>,
    {
        self.notes(&loaded.notes);
        loaded.image.check(&path_text(name))?;
        let outcome = crate::features(loaded, spec, self.progress)?;
        let geometry = &loaded.image.geometry;
        let others = outcome.write_others(spec, geometry)?;
        let potential = outcome.features.potential.to_dense().into_image(geometry);
        let dims = samples(&potential.dims());
        let report = file_report(output, outcome.to_json(spec));
        let mut answer = Answer::new(outcome.features.notes.join("\n"), report)
            .with_file(output, &dims)
            .with_result(
                self.objects,
                output,
                Output::Image(Box::new(LoadedImage::from(potential).into())),
            )?;
        answer.files.extend(others);
        Ok(answer)
    }

    /// Extends the cells of a map down through layers. `horizons` are the values of the option.
    ///
    /// # Errors
    /// Returns the errors of the options, of the files, and of [`columns`](crate::columns).
    pub fn columns(
        &mut self,
        map: &Path,
        horizons: &[String],
        output: &Path,
        spec: &ColumnsSpec,
    ) -> Result<Answer> {
        spec.check_files(map, horizons, output)?;
        self.progress.stage(Stage::Reading);
        let objects = self.objects;
        let read_image = |path: &Path, input: &InputOptions| objects.read_image(path, input);
        let read =
            |text: &String| GivenHorizon::read(text, &spec.input, &read_image, self.progress);
        let horizons = horizons.iter().map(read).collect::<Result<_>>()?;
        let input = ColumnsInput {
            map: objects.read_mesh(map, self.progress)?,
            name: &path_text(map),
            sha256: objects.hash(map)?,
            horizons,
        };
        let outcome = crate::columns(input, spec, self.progress)?;
        self.progress.stage(Stage::Writing);
        Answer::new(outcome.table(), file_report(output, outcome.to_json()))
            .with_file(output, "")
            .with_result(
                objects,
                output,
                Output::Mesh(AnyMesh::Polyhedra(outcome.mesh)),
            )
    }

    /// Converts an image, a grid or surfaces.
    ///
    /// # Errors
    /// Returns the errors of the options, of the files, and of [`convert`](crate::convert()).
    pub fn convert(&mut self, input: &Path, output: &Path, spec: &ConvertSpec) -> Result<Answer> {
        spec.check_files(input, output)?;
        let objects = self.objects;
        let open = |path: &Path, input: &InputOptions| {
            if objects.keeps(output) {
                objects.read_image(path, input).map(OpenedImage::InMemory)
            } else {
                objects.open_image(path, input)
            }
        };
        let (converted, notes) = crate::convert(input, output, spec, &open)?;
        self.notes(&notes);
        let (content, fields) = match &converted.dims()[..] {
            [] => {
                let surfaces = converted.surface_count();
                (
                    format!("{surfaces} surfaces"),
                    json!({ "surfaces": surfaces }),
                )
            }
            dims if matches!(converted, Converted::Grid(_)) => {
                let cells = samples(dims).replace("samples", "cells");
                (cells, json!({ "dims": dims }))
            }
            dims => (samples(dims), json!({ "dims": dims })),
        };
        let mut answer = Answer::new("", file_report(output, fields)).with_file(output, &content);
        if let Some(table) = &spec.label_table_out {
            let count = converted.write_label_table(table)?;
            answer = answer.with_file(table, &format!("names of {count} labels"));
        }
        match converted {
            Converted::Image(image) => {
                answer.with_result(objects, output, Output::Image(Box::new(image)))
            }
            Converted::Surfaces(surfaces) => {
                answer.with_result(objects, output, Output::Surfaces(surfaces))
            }
            other => {
                self.notes(&other.write(output)?);
                Ok(answer)
            }
        }
    }

    /// Reads a mesh, and the image that was meshed, which has this name.
    fn read_for_edit<'b>(
        &mut self,
        mesh: &Path,
        (image, name): (&Path, &'b str),
        input: &InputOptions,
    ) -> Result<(AnyMesh, ImageInput<'b>)> {
        let read_mesh = self.objects.read_mesh(mesh, self.progress)?;
        let input = input_options(&read_mesh, &path_text(mesh), input)?;
        let image = ImageInput {
            image: self.objects.read_image(image, &input)?,
            name,
            sha256: Some(self.objects.hash(image)?),
        };
        Ok((read_mesh, image))
    }

    /// Detects the features that the edits of a resident session share, so that the first edit takes no
    /// longer than later ones.
    ///
    /// # Errors
    /// Returns the errors of the files, and of [`prepare_edits`].
    pub(crate) fn prepare_edits(&mut self, mesh: &Path, image: &Path) -> Result<()> {
        let Some(resident) = &self.objects.resident else {
            return Ok(());
        };
        self.progress.stage(Stage::Reading);
        let image_name = path_text(image);
        let input = InputOptions::default();
        let (read_mesh, image) = self.read_for_edit(mesh, (image, &image_name), &input)?;
        self.on_read_mesh(read_mesh, mesh, |mesh, progress| {
            prepare_edits(mesh, image, &resident.edits, progress)
        })
    }

    /// Edits the atoms of a mesh of an image.
    ///
    /// # Errors
    /// Returns the errors of the options, of the files, and of [`edit_with_cache`].
    pub fn edit(
        &mut self,
        mesh: &Path,
        image: &Path,
        output: &Path,
        spec: &EditSpec,
    ) -> Result<Answer> {
        spec.check_files(mesh, image, output)?;
        let mut clock = Clock::new();
        self.progress.stage(Stage::Reading);
        clock.begin(Stage::Reading);
        let image_name = path_text(image);
        let (read_mesh, image) = self.read_for_edit(mesh, (image, &image_name), &spec.input)?;
        clock.end();
        let cache = self
            .objects
            .resident
            .as_ref()
            .map(|resident| &resident.edits);
        let outcome = self.on_read_mesh(read_mesh, mesh, |mesh, progress| {
            edit_with_cache(mesh, image, spec, cache, progress)
        })?;
        self.progress.stage(Stage::Writing);
        clock.begin(Stage::Writing);
        let mut answer =
            Answer::default().with_result(self.objects, output, Output::Mesh(outcome.mesh))?;
        clock.end();
        let mut report = outcome.report;
        report.add_costs(clock.costs());
        answer.text = report.table();
        answer.json = file_report(output, report.to_json());
        Ok(answer.with_file(output, ""))
    }

    /// Computes the flow through a mesh.
    ///
    /// # Errors
    /// Returns the errors of the options, of the files, and of [`flow`](crate::flow).
    pub fn flow(&mut self, mesh: &Path, output: &Path, spec: &FlowSpec) -> Result<Answer> {
        spec.check_files(mesh, output)?;
        let outcome = self.on_mesh(mesh, |mesh, progress| crate::flow(mesh, spec, progress))?;
        self.progress.stage(Stage::Writing);
        outcome.write_others(spec)?;
        Answer::new(outcome.report.table(), json!(outcome.report))
            .with_file(output, "")
            .with_result(self.objects, output, Output::Mesh(outcome.mesh))
    }

    /// Describes a file.
    ///
    /// # Errors
    /// Returns the errors of [`info`](crate::info).
    pub fn info(&mut self, file: &Path, input: &InputOptions) -> Result<Answer> {
        let info = crate::info(file, input)?;
        Ok(Answer::new(info.text, info.json))
    }

    /// Paints the cells of a mesh.
    ///
    /// # Errors
    /// Returns the errors of the options, of the files, and of [`paint_with_cache`].
    pub fn paint(&mut self, mesh: &Path, output: &Path, spec: &PaintSpec) -> Result<Answer> {
        spec.check_files(mesh, output)?;
        let cache = self
            .objects
            .resident
            .as_ref()
            .map(|resident| &resident.paints);
        let outcome = self.on_mesh(mesh, |mesh, progress| {
            paint_with_cache(mesh, spec, cache, progress)
        })?;
        self.progress.stage(Stage::Writing);
        outcome.write_others(spec)?;
        Answer::new(outcome.table(), file_report(output, outcome.to_json(spec)))
            .with_file(output, &format!("{} regions", outcome.regions.len()))
            .with_result(self.objects, output, Output::Mesh(outcome.mesh))
    }

    /// Measures the quality of a mesh.
    ///
    /// # Errors
    /// Returns the errors of the options, of the files, and of [`quality`](crate::quality).
    pub fn quality(&mut self, mesh: &Path, spec: &QualitySpec) -> Result<Answer> {
        spec.check_files(mesh)?;
        let report = self.on_mesh(mesh, |mesh, progress| crate::quality(mesh, spec, progress))?;
        Ok(Answer::new(report.table().trim_end(), report.to_json()))
    }

    /// Writes a page with a mesh and its image.
    ///
    /// # Errors
    /// Returns the errors of the options, of the files, and of [`report`](crate::report()).
    pub fn report(
        &mut self,
        image: &Path,
        mesh: &Path,
        output: &Path,
        spec: &ReportSpec,
    ) -> Result<Answer> {
        spec.check_files(image, mesh, output)?;
        self.progress.stage(Stage::Reading);
        // The figures of a run hold the hash already.
        let hash = || self.objects.hash(image);
        let image = ImageInput {
            image: self.objects.read_image(image, &spec.input)?,
            name: &path_text(image),
            sha256: spec.figures.is_none().then(hash).transpose()?,
        };
        let stats = self.on_mesh(mesh, |mesh, progress| {
            crate::report(mesh, image, output, spec, progress)
        })?;
        let report = file_report(output, json!({ "page": stats }));
        Ok(Answer::new("", report).with_file(output, &stats.size_text()))
    }

    /// Separates an object from the background.
    ///
    /// # Errors
    /// Returns the errors of the options, of the files, and of [`segment`](crate::segment).
    pub fn segment(
        &mut self,
        image: &Path,
        mesh: &Path,
        output: &Path,
        spec: &SegmentSpec,
    ) -> Result<Answer> {
        spec.check_files(image, mesh, output)?;
        self.progress.stage(Stage::Reading);
        let image = ImageInput {
            image: self.objects.read_image(image, &spec.input)?,
            name: &path_text(image),
            sha256: None,
        };
        let outcome = self.on_mesh(mesh, |mesh, progress| {
            crate::segment(mesh, image, spec, progress)
        })?;
        self.progress.stage(Stage::Writing);
        outcome.write_others(spec)?;
        Answer::new(outcome.table(), file_report(output, outcome.to_json(spec)))
            .with_file(output, "")
            .with_result(self.objects, output, Output::Mesh(outcome.mesh))
    }

    /// Draws a picture of an image, a mesh, surfaces and lines.
    ///
    /// # Errors
    /// Returns the errors of the options, of the files, and of [`slice`](crate::slice).
    pub fn slice(&mut self, files: &[PathBuf], output: &Path, spec: &SliceSpec) -> Result<Answer> {
        let names = spec.check_files(files, output)?;
        self.progress.stage(Stage::Reading);
        let open = |name: &PathBuf| self.objects.open_image(name, &spec.input);
        let image = names.image.as_ref().map(open).transpose()?;
        let read_mesh = |name: &PathBuf| self.objects.read_mesh(name, self.progress);
        let mesh = names.mesh.as_ref().map(read_mesh).transpose()?;
        let shapes = names.shapes.iter().map(|path| read_shapes(path));
        let input = SliceInput {
            image,
            mesh,
            shapes: shapes.collect::<Result<Vec<_>>>()?.concat(),
            names,
        };
        let picture = crate::slice(input, spec, self.progress)?;
        picture.write(output)?;
        let [width, height] = picture.size();
        let report = file_report(output, json!({ "size": [width, height] }));
        Ok(Answer::new("", report).with_file(output, &format!("{width} x {height} pixels")))
    }

    /// Groups the faces on features of a mesh into surfaces.
    ///
    /// # Errors
    /// Returns the errors of the options, of the files, and of [`surfaces`](crate::surfaces()).
    pub fn surface(&mut self, mesh: &Path, output: &Path, spec: &SurfaceSpec) -> Result<Answer> {
        spec.check_files(mesh, output)?;
        let outcome = self.on_mesh(mesh, |mesh, progress| crate::surfaces(mesh, spec, progress))?;
        self.progress.stage(Stage::Writing);
        let report = file_report(output, outcome.to_json(spec));
        let mut answer = Answer::new(outcome.table(spec.meets), report);
        if let (Some(path), Some(mesh)) = (&spec.mesh_out, &outcome.mesh) {
            mesh.write(path)?;
            answer = answer.with_file(path, "the mesh with these names");
        }
        if self.objects.keeps(output) {
            let surfaces = Output::Surfaces(outcome.surfaces);
            return answer.with_result(self.objects, output, surfaces);
        }
        let note = outcome.grid_note(output, spec);
        note.iter().for_each(|note| self.progress.note(note));
        let files = outcome.write(output, spec)?;
        if let [only] = &files[..] {
            let content = match spec.number {
                Some(number) => format!("surface {number}"),
                None => format!("{} surfaces", outcome.len()),
            };
            return Ok(answer.with_file(only, &content));
        }
        answer.json["files"] = files.iter().map(|file| path_text(file)).collect();
        answer
            .files
            .extend(files.iter().map(|file| path_text(file)));
        Ok(answer)
    }

    /// Makes a synthetic image.
    ///
    /// # Errors
    /// Returns the errors of the options, of the files, and of [`synth`](crate::synth).
    pub fn synth(&mut self, kind: &str, output: &Path, spec: &SynthSpec) -> Result<Answer> {
        spec.check_files(output)?;
        let image = crate::synth(kind.parse()?, spec)?;
        let dims = image.dims();
        let answer = Answer::new("", file_report(output, json!({ "dims": dims })))
            .with_file(output, &samples(&dims));
        if self.objects.keeps(output) {
            return answer.with_result(self.objects, output, Output::Image(Box::new(image)));
        }
        SynthSpec::write(&image, output)?;
        Ok(answer)
    }

    /// Checks a mesh. The report is also that of a mesh that is not valid;
    /// [`CheckerVerdict::require_valid`] returns its error.
    ///
    /// # Errors
    /// Returns the errors of the file and of [`validate`](crate::validate).
    pub fn validate(&mut self, mesh: &Path) -> Result<(Answer, Vec<CheckerVerdict>)> {
        let verdicts = self.on_mesh(mesh, |mesh, progress| crate::validate(mesh, progress))?;
        let lines: Vec<String> = verdicts.iter().map(CheckerVerdict::summary_line).collect();
        let report = file_report(mesh, CheckerVerdict::to_json(&verdicts));
        Ok((Answer::new(lines.join("\n"), report), verdicts))
    }

    /// Exports a mesh in a format of this name.
    ///
    /// # Errors
    /// Returns the errors of the options, of the files, and of [`export`](crate::export()).
    pub fn export(
        &mut self,
        mesh: &Path,
        format: &str,
        output: &Path,
        spec: &ExportSpec,
    ) -> Result<Answer> {
        let format = ExportFormat::from_name(format)?;
        spec.validate(format)?;
        format.check_files(mesh, output)?;
        let outcome = self.on_mesh(mesh, |mesh, progress| {
            crate::export(mesh, format, output, spec, progress)
        })?;
        Ok(Answer::new(outcome.table(), outcome.to_json()))
    }
}

/// Returns dimensions as `3 x 4 x 5 samples`.
fn samples(dims: &[usize]) -> String {
    let words: Vec<String> = dims.iter().map(usize::to_string).collect();
    format!("{} samples", words.join(" x "))
}

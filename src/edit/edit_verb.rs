//! Edits a mesh as `atomesh edit` does.

use serde_json::{Value, json};

use std::sync::Arc;

use super::cells::{self, edit_cells};
use super::edit_cache::{EditCache, PreparedImage};
use super::edit_spec::EditSpec;
use super::whole_features::EditImage;
use super::{Edit, EditedMesh, Summary, edit_simplices, editable_mesh};
use crate::error::cause;
use crate::feature;
use crate::image::formats::{InputOptions, ReadImage};
use crate::image::image_in_depth;
use crate::image::{Image, ImageSource};
use crate::job::output::{with_image, with_live};
use crate::job::spec::{CellKind, DistanceSource};
use crate::job::{MeshSpec, Params};
use crate::progress::Progress;
use crate::report::{Report, StageCost};
use crate::store::input::{ImageInput, MeshInput};
use crate::store::{AnyMesh, FieldValue, MeshFile, Storable, with_mesh};
use crate::{Error, Result};

/// An edited mesh.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct EditOutcome {
    /// The mesh, with the image's values at its nodes or cells.
    pub mesh: AnyMesh,
    /// The report.
    pub report: EditReport,
}

/// The report on an edited mesh.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct EditReport {
    /// The names of the edits.
    pub edits: Vec<String>,
    /// The number of cells of the mesh before and after the edits.
    pub cells: [usize; 2],
    /// The name of the kind of cells.
    pub cells_name: &'static str,
    /// Summary of the edits.
    pub summary: Summary,
}

/// Adds, moves and removes atoms of a mesh, and meshes only their neighbourhood again, as
/// `atomesh edit` does. `image` is the one that was meshed.
///
/// ```
/// use atomesh::image::formats::AnyImage;
/// use atomesh::image::{Geometry, Image};
/// use atomesh::progress::NoProgress;
/// use atomesh::{EditSpec, MeshSpec};
///
/// let disc = |i: usize| f32::from(u8::from((i % 40).abs_diff(20) < 11 && (i / 40).abs_diff(18) < 9));
/// let image = Image::new([40, 36], (0..40 * 36).map(disc).collect(), Geometry::default());
/// let spec = MeshSpec { distance: "5".parse()?, ..MeshSpec::default() };
/// let mesh = atomesh::mesh(&image, &spec, &mut NoProgress)?.mesh_file(&image)?;
/// let spec = EditSpec { add: vec!["19.5,17.25".parse()?], ..EditSpec::default() };
/// let image = AnyImage::Plane(image.into());
/// let outcome = atomesh::edit(mesh, image, &spec, &mut NoProgress)?;
/// assert!(outcome.report.summary.atoms[0].is_some());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Returns the errors of [`EditSpec::validate`], those of reading the files that the options of the
/// mesh name, and [`Error::Mesh`] for a mesh that does not record how it was made. If an edit is
/// impossible, the error begins with its name.
pub fn edit<'a>(
    mesh: impl Into<MeshInput<'a>>,
    image: impl Into<ImageInput<'a>>,
    spec: &EditSpec,
    progress: &mut dyn Progress,
) -> Result<EditOutcome> {
    edit_with_cache(mesh, image, spec, None, progress)
}

/// Edits a mesh as [`edit`] does. With a cache, all edits of an image share its features, which the
/// first of them detects in the whole image; an image whose hash is not known is not shared.
///
/// # Errors
/// Returns the errors of [`edit`].
pub fn edit_with_cache<'a>(
    mesh: impl Into<MeshInput<'a>>,
    image: impl Into<ImageInput<'a>>,
    spec: &EditSpec,
    cache: Option<&EditCache>,
    progress: &mut dyn Progress,
) -> Result<EditOutcome> {
    spec.validate()?;
    let MeshInput {
        mesh,
        name,
        read_image,
    } = mesh.into();
    let run = EditRun {
        spec,
        name,
        image: image.into(),
        read_image,
        cache,
        is_preparation: false,
        progress,
    };
    run.edit_any(mesh)
}

/// Detects the features that edits of this mesh share, and keeps them in the cache, so that the first
/// edit takes no longer than later ones.
///
/// # Errors
/// Returns the errors of [`edit`] for a mesh or an image that cannot be edited.
pub fn prepare_edits<'a>(
    mesh: impl Into<MeshInput<'a>>,
    image: impl Into<ImageInput<'a>>,
    cache: &EditCache,
    progress: &mut dyn Progress,
) -> Result<()> {
    let MeshInput {
        mesh,
        name,
        read_image,
    } = mesh.into();
    let run = EditRun {
        spec: &EditSpec::default(),
        name,
        image: image.into(),
        read_image,
        cache: Some(cache),
        is_preparation: true,
        progress,
    };
    run.edit_any(mesh).map(|_| ())
}

/// Returns the options for reading the image of a mesh: those of `input`, and for all others those
/// with which the image was read when it was meshed. `name` is that of the mesh in messages.
///
/// # Errors
/// Returns [`Error::Mesh`] if the mesh does not record how it was made.
pub fn input_options(mesh: &AnyMesh, name: &str, input: &InputOptions) -> Result<InputOptions> {
    with_mesh!(mesh, file => Ok(input.with_fallback(&recorded_spec(name, file)?.0.input)))
}

/// The function that edits a mesh of one kind of cells.
type EditFn<const D: usize, M> = fn(
    MeshFile<M>,
    &str,
    EditImage<'_, D>,
    &[Edit<D>],
    bool,
    &mut dyn Progress,
) -> Result<EditedMesh<M>>;

/// The input, the options and the progress of an edit.
struct EditRun<'a> {
    spec: &'a EditSpec,
    /// The name of the mesh in messages.
    name: &'a str,
    image: ImageInput<'a>,
    read_image: ReadImage<'a>,
    cache: Option<&'a EditCache>,
    /// `true` if nothing is edited, but what edits share is prepared.
    is_preparation: bool,
    progress: &'a mut dyn Progress,
}

impl EditRun<'_> {
    /// Edits a mesh.
    fn edit_any(self, mesh: AnyMesh) -> Result<EditOutcome> {
        with_mesh!(mesh,
            simplices file => {
                let dropped = editable_mesh::dropped_arrays(&file);
                self.edit(file, edit_simplices, dropped)
            },
            cells file => {
                let dropped = cells::dropped_arrays(&file);
                self.edit(file, edit_cells, dropped)
            }
        )
    }

    /// Edits a mesh of any dimension and kind of cells. Arrays in `dropped` are not in the edited
    /// mesh.
    fn edit<const D: usize, M: Storable<D>>(
        self,
        file: MeshFile<M>,
        edit: EditFn<D, M>,
        dropped: Vec<String>,
    ) -> Result<EditOutcome>
    where
        MeshFile<M>: Into<AnyMesh>,
    {
        let edits = if self.is_preparation {
            Vec::new()
        } else {
            self.spec.edits()?
        };
        let (mut recorded, mut notes) = recorded_spec(self.name, &file)?;
        recorded.input = self.spec.input.with_fallback(&recorded.input);
        notes.extend(notes_on_input(&self.image, &file, &dropped));
        let hash = self.image.sha256.clone();
        let (image, read_image) = (self.image, self.read_image);
        let prepare = || prepare_image(image.checked()?, &recorded, read_image);
        let shared = self.cache.zip(hash);
        let prepared = match &shared {
            Some((cache, hash)) => cache.prepared(hash, &recorded, prepare)?,
            None => Arc::new(PreparedImage::new("", &recorded, prepare()?)),
        };
        let input = prepared.for_edit(shared.is_some());
        let image = input.image;
        let before = file.mesh.len();
        let free = self.spec.free;
        let edited = edit(file, self.name, input, &edits, free, self.progress)?;
        let mut summary = edited.summary;
        summary.notes.splice(0..0, notes);
        Ok(EditOutcome {
            report: EditReport {
                edits: edits.into_iter().map(|edit| edit.name).collect(),
                cells: [before, edited.file.mesh.len()],
                cells_name: M::CELLS_NAME,
                summary,
            },
            mesh: {
                let file = with_live(edited.file, image)?;
                with_image(file, ImageSource::InMemory(image))?.into()
            },
        })
    }
}

/// Returns the image as the job prepared it that made the mesh, and the parameters of this job.
fn prepare_image<const D: usize>(
    image: Image<D>,
    recorded: &MeshSpec,
    read_image: ReadImage<'_>,
) -> Result<(Image<D>, Params<D>)> {
    let mut params = Params::<D>::read_with(recorded, read_image)?;
    params.note_time_unit(&image.geometry);
    // An image that is in depth already is not converted.
    let velocity = recorded.velocity.as_ref();
    let velocity = velocity.filter(|_| image.geometry.time_coordinate().is_some());
    let is_labels = params.spec.feature.has_labels();
    let (image, conversion) = image_in_depth(image, velocity, is_labels, read_image)?;
    if let Some(conversion) = &conversion {
        params.convert_to_depth(conversion)?;
    }
    if !feature::fills_gaps(&image, params.spec.feature, params.modality) {
        return Ok((image, params));
    }
    let marked = image.mark_dead(!params.spec.input.keeps_nulls())?;
    Ok((marked.map_or(image, |marked| marked.image), params))
}

/// Returns notes on another image than the one that was meshed, and on arrays that are dropped.
fn notes_on_input<M>(
    image: &ImageInput<'_>,
    file: &MeshFile<M>,
    dropped: &[String],
) -> Vec<String> {
    let mut notes = Vec::new();
    if let (Some(hash), Some(recorded)) = (&image.sha256, text_field(file, "input_sha256"))
        && recorded.trim() != hash
    {
        notes.push(format!(
            "{} is not the file that was meshed: its checksum (SHA-256) differs",
            image.name
        ));
    }
    if !dropped.is_empty() {
        notes.push(format!(
            "dropped the arrays {}, which an edit cannot update",
            dropped.join(", ")
        ));
    }
    notes
}

/// Returns the field data of this name, if it is a text.
fn text_field<'a, M>(file: &'a MeshFile<M>, name: &str) -> Option<&'a str> {
    match file.field_value(name)? {
        FieldValue::Text(text) => Some(text.as_str()),
        _ => None,
    }
}

/// Returns the options with which the mesh was made, as far as an edit needs them, and notes on
/// steps that an edit does not repeat.
fn recorded_spec<M>(name: &str, file: &MeshFile<M>) -> Result<(MeshSpec, Vec<String>)> {
    let refuse = |problem: String, remedy| Error::Mesh(cause(name, problem, remedy));
    let record = text_field(file, "parameters").ok_or_else(|| {
        refuse(
            "does not record how it was made (no field data `parameters`)".into(),
            "give a mesh that atomesh mesh wrote",
        )
    })?;
    // Earlier versions accepted options that had no effect.
    let unknown = |problem: &str| {
        refuse(
            format!("has parameters that this version does not accept: {problem}"),
            "mesh the image again",
        )
    };
    let mut spec: MeshSpec = toml::from_str(record.trim())
        .map_err(|e| unknown(&e.message().replace('\n', ", ")).with_source(e))?;
    if let Some(topography) = &spec.topography {
        return Err(refuse(
            format!(
                "continues above its image (topography {topography}), where an edit has no image"
            ),
            "edit the mesh that is made without --topography",
        ));
    }
    if let Some(padding) = spec.pad {
        return Err(refuse(
            format!("continues beyond its image (pad {padding}), where an edit has no image"),
            "edit the mesh that is made without --pad",
        ));
    }
    if let Some(axes) = spec.periodic {
        return Err(refuse(
            format!(
                "is periodic along {axes}, where an edit would have to change opposite sides alike"
            ),
            "edit the mesh that is made without --periodic",
        ));
    }
    let mut notes = Vec::new();
    let mut note = |line: &str| notes.push(line.to_string());
    // The mesh holds its fixed atoms and its distances, while the files may no longer exist.
    // Voronoi cells hold their fixed atoms only after a first edit.
    let needs_files =
        spec.cell_kind() == CellKind::Voronoi && file.cell_array(cells::ATOM_KIND).is_none();
    if !needs_files {
        spec.atoms_from = None;
        spec.well.clear();
        spec.well_distance = None;
    }
    if spec.distance.varies() {
        spec.distance_from = DistanceSource::Features;
    }
    if spec.coarse_to_fine > 0 {
        note(
            "the passes of --coarse-to-fine are skipped, as atoms are close to their final positions already",
        );
    }
    if spec.smooth.is_some() {
        note("the mesh was smoothed (--smooth), but the edited part is not");
    }
    if spec.slivers.is_exudation() {
        note(
            "slivers were removed by exudation; in the edited part they are removed by flips and smoothing",
        );
    }
    spec.validate().map_err(|e| unknown(&e.to_string()))?;
    Ok((spec, notes))
}

impl EditReport {
    /// Adds the costs of reading, which comes before the edit, and of writing, which comes after it.
    pub fn add_costs(&mut self, costs: &[StageCost]) {
        let (reading, writing) = costs.split_at(costs.len().min(1));
        self.summary.stages.splice(0..0, reading.iter().cloned());
        self.summary.stages.extend_from_slice(writing);
    }

    /// Returns a table of the edits, the changed parts and their quality.
    pub fn table(&self) -> String {
        let Self {
            edits,
            summary,
            cells,
            cells_name: kind,
        } = self;
        let mut lines = Vec::new();
        let mut line = |name: &str, text: String| lines.push(format!("{name:<12}{text}"));
        for (edit, atom) in edits.iter().zip(&summary.atoms) {
            let state = atom.map_or("gone".into(), |n| format!("atom {n}"));
            line(
                "edit",
                format!("{} is {state}", edit.trim_start_matches('-')),
            );
        }
        let [before, after] = summary.nodes;
        line(
            "mesh",
            format!(
                "{after} nodes, {} {kind}; before {before} and {}",
                cells[1], cells[0]
            ),
        );
        line(
            "changed",
            format!(
                "{} of {} {kind} rebuilt, around {} movable atoms; {} neighbours removed",
                summary.cells[1],
                summary.cells[0],
                summary.movable_atoms,
                summary.removed_neighbours
            ),
        );
        if let [Some(before), Some(after)] = &summary.quality {
            line(
                "quality",
                format!(
                    "in the rebuilt part, angles {:.1} to {:.1}, mean ratio {:.3}; before {:.1} to {:.1}, {:.3}",
                    after.smallest_angle.worst,
                    after.largest_angle.worst,
                    after.mean_ratio_mean,
                    before.smallest_angle.worst,
                    before.largest_angle.worst,
                    before.mean_ratio_mean,
                ),
            );
        }
        line(
            "work",
            format!(
                "features detected in {} samples; {} evaluations of the energy",
                summary.samples, summary.evaluations
            ),
        );
        let report = Report {
            stages: summary.stages.clone(),
            notes: summary.notes.clone(),
            ..Report::default()
        };
        lines.push(report.table().trim_end().to_string());
        lines.join("\n")
    }

    /// Returns the report as JSON.
    pub fn to_json(&self) -> Value {
        let mut report = json!({ "edits": self.edits });
        if let (Some(report), Ok(Value::Object(fields))) =
            (report.as_object_mut(), serde_json::to_value(&self.summary))
        {
            report.extend(fields);
        }
        report
    }
}

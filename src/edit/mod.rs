//! Edits a mesh locally: atoms are added, moved and removed, and only their neighbourhood changes.
//!
//! The method is that of Hale (2002). The temperature of an atom falls from 1 at an edited position
//! to 0 at a distance of five d. Atoms with a temperature above 0 are called warm; the others are
//! frozen. Warm atoms move again to lower the energy of the lattice in the image, and only cells
//! with a warm atom are rebuilt. The work is limited to the neighbourhood: its atoms, its cells,
//! and the part of the image that its filters need. Only the search for the neighbourhood visits
//! the whole mesh.
//!
//! - `resolve`: checks the edits and sorts them into groups whose neighbourhoods do not overlap
//! - `window`: the part of an image around an edit
//! - `local_fields`: the features, the nominal distance and the image weight in a window
//! - `whole_features`: the features of a whole image, which several edits share
//! - `edit_cache`: images that stay prepared between edits
//! - `spacing`: the nominal distance d(x) around an edit, from the nodes of the mesh
//! - `neighbourhood`: the atoms and cells around an edit, and how they change
//! - `editable_mesh`: a mesh of simplices whose nodes and cells can be replaced
//! - `edit_spec`: all options, as one value
//! - `edit_verb`: the whole edit, from a mesh, its image and the options
//! - `cells`: local edits of Voronoi cells

pub(crate) mod cells;
mod edit_cache;
mod edit_spec;
mod edit_verb;
pub(crate) mod editable_mesh;
pub(crate) mod local_fields;
pub(crate) mod neighbourhood;
pub(crate) mod resolve;
pub(crate) mod spacing;
mod whole_features;
pub(crate) mod window;

pub use edit_cache::EditCache;
pub use edit_spec::{AtomMove, AtomNumber, EditSpec};
pub use edit_verb::{EditOutcome, EditReport, edit, edit_with_cache, input_options, prepare_edits};
pub use whole_features::{EditImage, WholeFeatures};

use serde::Serialize;

use crate::error::cause;
use crate::feature::ResolvedOptions;
use crate::image::Image;
use crate::improve::Reshape;
use crate::job::output::{resolved_options, resolved_options_field};
use crate::job::{self, LatticeParams, Params};
use crate::mesh::Simplices;
use crate::progress::{CancelToken, Progress, Stage};
use crate::report::{Clock, Quality, StageCost};
use crate::store::{FieldValue, MeshFile};
use crate::{Error, Result};
use editable_mesh::EditableMesh;
use local_fields::Context;
use neighbourhood::Neighbourhood;

/// A change of one atom; positions are physical coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AtomChange<const D: usize> {
    /// Adds an atom at this position.
    Add([f64; D]),
    /// Moves the atom of this number to this position.
    Move(u32, [f64; D]),
    /// Removes the atom of this number.
    Remove(u32),
}

/// One edit of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct Edit<const D: usize> {
    /// Name of the edit in error messages, e.g. `--add 1,2,3`.
    pub name: String,
    /// The change of the atom.
    pub change: AtomChange<D>,
}

/// Result of all edits, with figures on their neighbourhoods.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// For each edit, the number of its atom in the new mesh; `None` for an atom that was removed.
    pub atoms: Vec<Option<u32>>,
    /// Number of atoms that could move.
    pub movable_atoms: usize,
    /// Number of atoms that were removed to make room for added and moved ones.
    pub removed_neighbours: usize,
    /// Numbers of nodes of the mesh before and after the edits.
    pub nodes: [usize; 2],
    /// Numbers of cells of the neighbourhoods before and after the edits.
    pub cells: [usize; 2],
    /// Number of image samples in which features were detected.
    pub samples: usize,
    /// Number of evaluations of the energy.
    pub evaluations: usize,
    /// Quality of the neighbourhoods' cells before and after the edits, in lattice space.
    pub quality: [Option<Quality>; 2],
    /// Notes for the user, one line each.
    pub notes: Vec<String>,
    /// Cost of each stage.
    pub stages: Vec<StageCost>,
}

/// An edited mesh.
#[derive(Debug, Clone)]
pub struct EditedMesh<M> {
    /// The mesh, with its arrays and fields.
    pub file: MeshFile<M>,
    /// Summary of the edits.
    pub summary: Summary,
}

/// Edits a mesh that [`job::run`](crate::job::run()) made of the image and with the parameters of
/// `input`.
///
/// Added and moved atoms stay exactly where the edits put them, unless `free` is `true`: then they
/// start there and move like other atoms. `place` names the mesh in error messages.
///
/// Nodes and cells that are farther than five d and one cell from every edited position keep
/// exactly the same bits. Nodes keep their numbers, except that new nodes take the numbers of
/// removed ones, and the last nodes of the mesh take the numbers that remain unused.
///
/// # Errors
/// Returns [`Error::Mesh`] if the mesh does not record what an edit needs, or if an atom does not
/// exist or cannot be removed; [`Error::Seeding`] if a position is outside the box or at the place
/// of another atom; [`Error::Image`] if the image has other dimensions than the mesh;
/// [`Error::Interrupted`] if `progress` cancels the edit.
pub fn edit_simplices<const D: usize, M: Reshape<D>>(
    file: MeshFile<M>,
    place: &str,
    input: EditImage<'_, D>,
    edits: &[Edit<D>],
    free: bool,
    progress: &mut dyn Progress,
) -> Result<EditedMesh<M>> {
    let EditImage { image, params, .. } = input;
    refuse_given_surfaces(params, place)?;
    let clock = Clock::new();
    let mut stages = EditStages { clock, progress };
    let resolved = resolved_options(&file);
    let mut editable = EditableMesh::new(file, place)?;
    editable.check_dims(image.dims())?;
    let params = &LatticeParams::for_step(params, &image.geometry, editable.step);
    let mut summary = Summary {
        nodes: [editable.nodes.len(), 0],
        atoms: vec![None; edits.len()],
        ..Summary::default()
    };
    let (step, fields) = (editable.step, &mut editable.fields);
    let resolved = match resolved {
        Some(resolved) => resolved,
        None => stages.resolve_detection(image, params, step, &mut summary, fields)?,
    };
    let mut context = Context::new(image, params, edits, resolved, step)?;
    context.whole_features = stages.whole_features(input, &context, step)?;
    let groups = stages.run_stage(Stage::Neighbourhoods, |_| {
        resolve::resolve(&editable.lattice(), edits, free)
    })?;
    let mut merged: [Option<M>; 2] = [None, None];
    for group in groups {
        let mut neighbourhood = stages.run_stage(Stage::Neighbours, |_| {
            Ok(Neighbourhood::new(&editable, group, &context))
        })?;
        let fields = stages.run_stage(Stage::Features, |cancel| {
            neighbourhood.local_fields(&editable, &context, cancel)
        })?;
        stages.run_stage(Stage::Moving, |cancel| {
            neighbourhood.relax(&fields, &context, &mut summary, cancel)
        })?;
        let parts = stages.run_stage(Stage::Rebuilding, |_| {
            neighbourhood.remesh(&mut editable, &fields, &context, &mut summary)
        })?;
        refuse_invalid(&parts)?;
        for (mesh, part) in merged.iter_mut().zip(parts) {
            append(mesh, part);
        }
    }
    let mut clock = stages.clock;
    clock.begin(Stage::Assembling);
    summary.quality = merged.map(|mesh| mesh.as_ref().map(crate::report::quality));
    editable.compact(&mut summary.atoms);
    editable.fields.push(history(&editable.fields, edits));
    summary.nodes[1] = editable.nodes.len();
    let file = editable.into_file();
    clock.end();
    summary.stages = clock.costs().to_vec();
    Ok(EditedMesh { file, summary })
}

/// Checks that the mesh follows no surfaces that the user gave, because their names are stored by
/// cells, which an edit changes.
///
/// # Errors
/// Returns [`Error::Mesh`] if it does.
fn refuse_given_surfaces<const D: usize>(params: &Params<D>, place: &str) -> Result<()> {
    match params.surfaces.first() {
        None => Ok(()),
        Some(given) => Err(Error::Mesh(cause(
            place,
            format!(
                "follows given surfaces ({}), whose names an edit would lose",
                given.surface.name
            ),
            "mesh the image again; fixed atoms can be given in a file",
        ))),
    }
}

/// Runs the stages of an edit; reports each stage to the clock and to `progress`.
struct EditStages<'a> {
    clock: Clock,
    progress: &'a mut dyn Progress,
}

impl EditStages<'_> {
    /// Detects the features of the whole image, for a mesh that does not record its resolved
    /// detection options; returns these options and adds them to `fields`, so that the new mesh
    /// records them.
    ///
    /// # Errors
    /// Returns an error if the detection fails.
    fn resolve_detection<const D: usize>(
        &mut self,
        image: &Image<D>,
        params: &LatticeParams<'_, D>,
        step: [f64; D],
        summary: &mut Summary,
        fields: &mut Vec<(String, FieldValue)>,
    ) -> Result<Vec<ResolvedOptions>> {
        let options = params.feature_options(step);
        let detect = |cancel: &CancelToken<'_>| job::detect_in_one_process(image, &options, cancel);
        let resolved = self.run_stage(Stage::FeaturesEverywhere, detect)?.resolved;
        summary.notes.push(
            "the mesh does not record how its features were detected, so they were detected again \
             in the whole image; the new mesh records it"
                .into(),
        );
        fields.extend(resolved_options_field(&resolved));
        Ok(resolved)
    }

    /// Returns the features of the whole image, if several edits share them. Detects them if this
    /// is the first of these edits. `context` has the options of the detection. Features of labels and
    /// of large images are not shared.
    ///
    /// # Errors
    /// Returns the errors of the detection.
    fn whole_features<'b, const D: usize>(
        &mut self,
        input: EditImage<'b, D>,
        context: &Context<'_, D>,
        step: [f64; D],
    ) -> Result<Option<&'b WholeFeatures<D>>> {
        let samples = input.image.dims().iter().product::<usize>();
        let has_labels = context.resolved_options.iter().any(|r| r.kind.has_labels());
        let Some(shared) = input
            .features
            .filter(|_| samples <= MAX_SHARED_SAMPLES && !has_labels)
        else {
            return Ok(None);
        };
        if let Some(known) = shared.get() {
            return Ok(Some(known));
        }
        let (params, resolved) = (context.params, &context.resolved_options);
        let features = self.run_stage(Stage::FeaturesEverywhere, |cancel| {
            WholeFeatures::detect(input.image, params, resolved, step, cancel)
        })?;
        Ok(Some(shared.get_or_init(|| features)))
    }

    /// Runs `work` as a stage and returns its result.
    ///
    /// # Errors
    /// Returns the errors of `work`, or [`Error::Interrupted`] if `progress` cancels the edit.
    fn run_stage<T>(
        &mut self,
        stage: Stage,
        work: impl FnOnce(&CancelToken<'_>) -> Result<T>,
    ) -> Result<T> {
        self.clock.begin(stage);
        self.progress.stage(stage);
        let poll = &mut |fraction: Option<f64>| {
            if let Some(fraction) = fraction {
                self.progress.fraction_done(fraction);
            }
            self.progress.keep_going()
        };
        CancelToken::run_with_progress(poll, |cancel| {
            let interrupted =
                || Error::Interrupted(cause(stage, "interrupted", "start the edit again"));
            if cancel.is_cancelled() {
                return Err(interrupted());
            }
            let outcome = work(cancel);
            if cancel.is_cancelled() {
                Err(interrupted())
            } else {
                outcome
            }
        })
    }
}

/// Returns the names of a mesh's point and cell arrays that are not in `known`.
fn unknown_arrays<M>(file: &MeshFile<M>, known: &[&str]) -> Vec<String> {
    let arrays = file.point_data.iter().chain(&file.cell_data);
    let names = arrays.map(|array| array.name.clone());
    names
        .filter(|name| !known.contains(&name.as_str()))
        .collect()
}

/// Checks that the cells `[before, after]` of a neighbourhood fill the same volume and that no new
/// cell is inverted. This guards against errors that the other checks miss.
fn refuse_invalid<const D: usize, M: Simplices<D>>(parts: &[M; 2]) -> Result<()> {
    let [before, after] = parts.each_ref().map(|part| {
        let volumes = part.volumes();
        let min_volume = volumes.iter().copied().fold(f64::INFINITY, f64::min);
        (min_volume, volumes.iter().sum::<f64>())
    });
    if after.0 > 0.0 && (after.1 - before.1).abs() <= MAX_VOLUME_CHANGE * before.1 {
        return Ok(());
    }
    Err(Error::Mesh(cause(
        "the edited mesh",
        format!(
            "is not valid: around an edit its {} fill {} instead of {}, and the smallest has {}",
            M::CELLS_NAME,
            after.1,
            before.1,
            after.0
        ),
        "give other positions, or mesh the image again; please also report this error, with the mesh",
    )))
}

/// Largest number of samples of an image whose features edits share. In larger images, the first edit
/// would wait minutes for them.
const MAX_SHARED_SAMPLES: usize = 1 << 24;

/// Maximum relative difference between the volume of the rebuilt cells and that of the cells they
/// replace.
const MAX_VOLUME_CHANGE: f64 = 1e-9;

/// Appends the nodes and cells of `part` to those in `total`.
fn append<const D: usize, M: Simplices<D>>(total: &mut Option<M>, part: M) {
    let Some(mesh) = total.take() else {
        *total = Some(part);
        return;
    };
    let offset = mesh.nodes().len() as u32;
    let nodes = [mesh.nodes(), part.nodes()].concat();
    let mut corners = mesh.connectivity().to_vec();
    corners.extend(part.connectivity().iter().map(|n| n + offset));
    *total = Some(M::from_parts(nodes, corners));
}

/// Name of the field in which a file records its edits.
const EDITS: &str = "edits";

/// Returns the field that lists all edits since the mesh was made, one per line. The file needs
/// them, because after an edit its parameters alone no longer describe the mesh.
fn history<const D: usize>(
    fields: &[(String, FieldValue)],
    edits: &[Edit<D>],
) -> (String, FieldValue) {
    let mut lines: Vec<String> = Vec::new();
    for (name, value) in fields {
        if let (EDITS, FieldValue::Text(text)) = (name.as_str(), value) {
            lines.extend(text.lines().map(str::to_string));
        }
    }
    let point = |x: &[f64; D]| x.map(|c| c.to_string()).join(",");
    lines.extend(edits.iter().map(|edit| match &edit.change {
        AtomChange::Add(x) => format!("add {}", point(x)),
        AtomChange::Move(n, x) => format!("move {n} {}", point(x)),
        AtomChange::Remove(n) => format!("remove {n}"),
    }));
    (EDITS.into(), FieldValue::Text(lines.join("\n")))
}

/// Returns the fields without those that a later field of the same name replaces.
fn newest_fields(
    fields: impl IntoIterator<Item = (String, FieldValue)>,
) -> Vec<(String, FieldValue)> {
    let mut newest: Vec<(String, FieldValue)> = Vec::new();
    for (name, value) in fields {
        match newest.iter_mut().find(|(existing, _)| *existing == name) {
            Some(field) => field.1 = value,
            None => newest.push((name, value)),
        }
    }
    newest
}

#[cfg(test)]
mod tests;

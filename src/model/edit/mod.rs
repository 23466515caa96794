//! Local edits of a mesh: atoms are added, moved and removed, and only their neighbourhood changes.
//!
//! As Hale (2002) describes it: atoms near an edited one are warm, those five d away and beyond are
//! frozen. Warm atoms move again to lower the lattice's energy in the image, and only the cells that
//! have a warm atom are made anew. All work is done on the neighbourhood: its atoms, its cells, and
//! the part of the image that filters see from there; only looking for it goes over the whole mesh.
//!
//! - `resolve`: what the user asks for -> changes, checked, in groups that do not meet
//! - `window`: the part of an image round an edit
//! - `around`: the features there
//! - `spacing`: d(x) there, as the mesh knows it
//! - `neighbourhood`: the atoms and cells round an edit, and what becomes of them
//! - `body`: a mesh that can be changed in places
//! - `cells`: the same of Voronoi cells

pub mod cells;
pub mod editable_mesh;
pub(crate) mod local_fields;
pub(crate) mod neighbourhood;
pub(crate) mod resolve;
pub(crate) mod spacing;
pub(crate) mod window;

use serde::Serialize;

use crate::error::cause;
use crate::feature::{self, ResolvedOptions};
use crate::image::{Image, ImageSource};
use crate::job::{MeshSpace, Meshing, Params, lattice_beta};
use crate::mesh::Simplices;
use crate::progress::{CancelToken, Progress, Stage};
use crate::report::{Clock, Quality, StageCost};
use crate::store::output::{resolved_options, resolved_options_field};
use crate::store::{FieldValue, MeshFile};
use crate::{Error, Result};
use editable_mesh::EditableMesh;
use local_fields::Context;
use neighbourhood::Neighbourhood;

/// What shall happen to one atom; positions are physical.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AtomChange<const D: usize> {
    /// A new atom.
    Add([f64; D]),
    /// The atom goes elsewhere.
    Move(u32, [f64; D]),
    /// The atom goes away.
    Remove(u32),
}

/// One edit.
#[derive(Debug, Clone, PartialEq)]
pub struct Edit<const D: usize> {
    /// What to call it in an error, e.g. `--add 1,2,3`.
    pub name: String,
    /// What shall happen.
    pub change: AtomChange<D>,
}

/// What became of the neighbourhoods of all edits.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// For each edit, the number that its atom has in the new mesh.
    pub atoms: Vec<Option<u32>>,
    /// Atoms that could move.
    pub movable_atoms: usize,
    /// Atoms that made room for added and moved ones.
    pub removed_neighbours: usize,
    /// Nodes of the mesh before and after.
    pub nodes: [usize; 2],
    /// Cells of the neighbourhoods before and after.
    pub cells: [usize; 2],
    /// Samples of the image in which features were sought.
    pub samples: usize,
    /// Evaluations of the energy.
    pub evaluations: usize,
    /// Shapes of the neighbourhoods' cells before and after, in lattice space.
    pub quality: [Option<Quality>; 2],
    /// Lines that the user should know.
    pub notes: Vec<String>,
    /// What each stage cost.
    pub stages: Vec<StageCost>,
}

/// An edited mesh.
#[derive(Debug, Clone)]
pub struct EditedMesh<M> {
    /// The mesh, with all that was known of it.
    pub file: MeshFile<M>,
    /// What was done.
    pub summary: Summary,
}

/// Edits a mesh that [`job::run`](crate::job::run) made of `image`, with the parameters
/// it was made with. Added and moved atoms stay exactly where they are put, unless `free`: then they
/// only begin there and move as others do.
///
/// Nodes and cells farther than five d and a cell from every edited position are the same bits as
/// before. Nodes keep their numbers, but that nodes that go leave theirs to new ones or else to the
/// last ones.
///
/// # Errors
/// [`Error::Mesh`] for a mesh that does not say what it is or an atom that does not exist or cannot
/// go; [`Error::Seeding`] for a position outside the box or at the place of another atom;
/// [`Error::Image`] for an image of other dims; [`Error::Interrupted`] if the observer asked to stop.
pub fn edit<const D: usize, M: Simplices<D>>(
    file: MeshFile<M>,
    place: &str,
    image: &Image<D>,
    params: &Params<D>,
    edits: &[Edit<D>],
    free: bool,
    observer: &mut dyn Progress,
) -> Result<EditedMesh<M>>
where
    MeshSpace<D>: Meshing<D, Mesh = M>,
{
    let clock = Clock::new();
    let mut stages = EditStages { clock, observer };
    let settled = resolved_options(&file);
    let mut body = EditableMesh::new(file, place)?;
    body.check_dims(image.dims())?;
    // The file knows the units of its lattice space.
    let lengths = params.metric.lengths(&image.geometry);
    let params = &*params.in_lattice_units(lengths[0] / body.step[0]);
    let mut summary = Summary {
        nodes: [body.nodes.len(), 0],
        atoms: vec![None; edits.len()],
        ..Summary::default()
    };
    let settled = match settled {
        Some(settled) => settled,
        None => {
            stages.resolve_detection(image, params, body.step, &mut summary, &mut body.fields)?
        }
    };
    let beta = lattice_beta(&params.beta, image.dims(), body.step)?;
    let context = Context {
        image,
        params,
        resolved_options: &settled,
        beta: &beta,
        edits,
    };
    let groups = stages.run_stage(Stage::Neighbourhoods, |_| {
        resolve::resolve(&body.lattice(), edits, free)
    })?;
    let mut quality: [Option<M>; 2] = [None, None];
    for group in groups {
        let mut scope = stages.run_stage(Stage::Neighbours, |_| {
            Ok(Neighbourhood::new(&body, group, &context))
        })?;
        let scene = stages.run_stage(Stage::Features, |patience| {
            scope.local_fields(&body, &context, patience)
        })?;
        stages.run_stage(Stage::Moving, |patience| {
            scope.relax(&scene, &context, &mut summary, patience)
        })?;
        let parts = stages.run_stage(Stage::Rebuilding, |_| {
            scope.remesh(&mut body, &scene, &context, &mut summary)
        })?;
        refuse_invalid(&parts)?;
        for (all, part) in quality.iter_mut().zip(parts) {
            append(all, part);
        }
    }
    let mut clock = stages.clock;
    clock.begin(Stage::Assembling);
    summary.quality = quality.map(|mesh| mesh.as_ref().map(crate::report::quality));
    body.compact(&mut summary.atoms);
    body.fields.push(history(&body.fields, edits));
    summary.nodes[1] = body.nodes.len();
    let file = body.into_file();
    clock.end();
    summary.stages = clock.costs().to_vec();
    Ok(EditedMesh { file, summary })
}

/// Tells clock and observer of each stage.
struct EditStages<'a> {
    clock: Clock,
    observer: &'a mut dyn Progress,
}

impl EditStages<'_> {
    /// What detection settles on for the whole image, where a mesh does not record it: the new one does.
    ///
    /// # Errors
    /// Those of detection.
    fn resolve_detection<const D: usize>(
        &mut self,
        image: &Image<D>,
        params: &Params<D>,
        step: [f64; D],
        summary: &mut Summary,
        fields: &mut Vec<(String, FieldValue)>,
    ) -> Result<Vec<ResolvedOptions>> {
        let options = params.feature_options(step);
        let look = |patience: &CancelToken<'_>| {
            feature::detect_with_cancel(ImageSource::InMemory(image), &options, patience)
        };
        let settled = self.run_stage(Stage::FeaturesEverywhere, look)?.resolved;
        summary.notes.push(
            "the mesh does not record how its features were found, so they were sought in the \
             whole image; the new mesh records how"
                .into(),
        );
        fields.extend(resolved_options_field(&settled));
        Ok(settled)
    }

    /// What the work of a stage gives.
    ///
    /// # Errors
    /// Those of the work; [`Error::Interrupted`] if the observer says no.
    fn run_stage<T>(
        &mut self,
        stage: Stage,
        work: impl FnOnce(&CancelToken<'_>) -> Result<T>,
    ) -> Result<T> {
        self.clock.begin(stage);
        self.observer.stage(stage);
        let ask = &mut |share: Option<f64>| {
            if let Some(share) = share {
                self.observer.fraction_done(share);
            }
            self.observer.keep_going()
        };
        CancelToken::run_with_progress(ask, |patience| {
            let stopped =
                || Error::Interrupted(cause(stage, "interrupted", "start the edit again"));
            if patience.is_cancelled() {
                return Err(stopped());
            }
            let done = work(patience);
            if patience.is_cancelled() {
                Err(stopped())
            } else {
                done
            }
        })
    }
}

/// Names of a mesh's arrays that are not among those that are `known`.
fn unknown_arrays<M>(file: &MeshFile<M>, known: &[&str]) -> Vec<String> {
    let arrays = file.point_data.iter().chain(&file.cell_data);
    let names = arrays.map(|array| array.name.clone());
    names
        .filter(|name| !known.contains(&name.as_str()))
        .collect()
}

/// The last safety net: the cells `[before, after]` of a neighbourhood must fill the same room.
fn refuse_invalid<const D: usize, M: Simplices<D>>(parts: &[M; 2]) -> Result<()> {
    let [before, after] = parts.each_ref().map(|part| {
        let volumes = part.volumes();
        let least = volumes.iter().copied().fold(f64::INFINITY, f64::min);
        (least, volumes.iter().sum::<f64>())
    });
    if after.0 > 0.0 && (after.1 - before.1).abs() <= MAX_VOLUME_CHANGE * before.1 {
        return Ok(());
    }
    Err(Error::Mesh(cause(
        "the edited mesh",
        format!(
            "came out invalid: around an edit its {} fill {} instead of {}, the smallest has {}",
            M::CELLS_NAME,
            after.1,
            before.1,
            after.0
        ),
        "give other positions, or mesh the image again; and please report it with the mesh, for this \
         should never happen",
    )))
}

/// Cells made anew may differ by this share in volume from those that they replace.
const MAX_VOLUME_CHANGE: f64 = 1e-9;

/// Adds a part's cells to those of others.
fn append<const D: usize, M: Simplices<D>>(all: &mut Option<M>, part: M) {
    let Some(mesh) = all.take() else {
        *all = Some(part);
        return;
    };
    let shift = mesh.nodes().len() as u32;
    let nodes = [mesh.nodes(), part.nodes()].concat();
    let mut corners = mesh.connectivity().to_vec();
    corners.extend(part.connectivity().iter().map(|n| n + shift));
    *all = Some(M::from_parts(nodes, corners));
}

/// The name under which a file keeps its edits.
const EDITS: &str = "edits";

/// All edits since the mesh was made, one a line: parameters alone do not say any more what it is.
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

#[cfg(test)]
mod tests;

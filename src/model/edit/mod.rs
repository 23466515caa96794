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

pub(crate) mod around;
pub mod body;
pub mod cells;
pub(crate) mod neighbourhood;
pub(crate) mod resolve;
pub(crate) mod spacing;
pub(crate) mod window;

use serde::Serialize;

use crate::error::cause;
use crate::feature::{self, Settled};
use crate::image::{Image, Source};
use crate::job::{Meshing, Params, Space, lattice_beta};
use crate::mesh::Simplices;
use crate::observer::{Observer, Patience, Stage};
use crate::report::{Clock, Quality, StageCost};
use crate::store::file::{settled_field, settled_of};
use crate::store::{FieldValue, MeshFile};
use crate::{Error, Result};
use around::Context;
use body::Body;
use neighbourhood::Scope;

/// What shall happen to one atom; positions are physical.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Change<const D: usize> {
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
    pub change: Change<D>,
}

/// What became of the neighbourhoods of all edits.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// For each edit, the number that its atom has in the new mesh.
    pub atoms: Vec<Option<u32>>,
    /// Atoms that could move.
    pub warm: usize,
    /// Atoms that made room for added and moved ones.
    pub made_room: usize,
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
pub struct Edited<M> {
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
    observer: &mut dyn Observer,
) -> Result<Edited<M>>
where
    Space<D>: Meshing<D, Mesh = M>,
{
    let clock = Clock::new();
    let mut stages = EditStages { clock, observer };
    let settled = settled_of(&file);
    let mut body = Body::new(file, place)?;
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
        None => stages.settle(image, params, body.step, &mut summary, &mut body.fields)?,
    };
    let beta = lattice_beta(&params.beta, image.dims(), body.step)?;
    let context = Context {
        image,
        params,
        settled: &settled,
        beta: &beta,
        edits,
    };
    let groups = stages.run(Stage::Neighbourhoods, |_| {
        resolve::resolve(&body.lattice(), edits, free)
    })?;
    let mut quality: [Option<M>; 2] = [None, None];
    for group in groups {
        let mut scope = stages.run(Stage::Neighbours, |_| {
            Ok(Scope::new(&body, group, &context))
        })?;
        let scene = stages.run(Stage::Features, |patience| {
            scope.look(&body, &context, patience)
        })?;
        stages.run(Stage::Moving, |patience| {
            scope.relax(&scene, &context, &mut summary, patience)
        })?;
        let parts = stages.run(Stage::Mending, |_| {
            scope.rejoin(&mut body, &scene, &context, &mut summary)
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
    Ok(Edited { file, summary })
}

/// Tells clock and observer of each stage.
struct EditStages<'a> {
    clock: Clock,
    observer: &'a mut dyn Observer,
}

impl EditStages<'_> {
    /// What detection settles on for the whole image, where a mesh does not record it: the new one does.
    ///
    /// # Errors
    /// Those of detection.
    fn settle<const D: usize>(
        &mut self,
        image: &Image<D>,
        params: &Params<D>,
        step: [f64; D],
        summary: &mut Summary,
        fields: &mut Vec<(String, FieldValue)>,
    ) -> Result<Vec<Settled>> {
        let options = params.feature_options(step);
        let look = |patience: &Patience<'_>| {
            feature::detect_while(Source::Held(image), &options, patience)
        };
        let settled = self.run(Stage::FeaturesEverywhere, look)?.settled;
        summary.notes.push(
            "the mesh does not record how its features were found, so they were sought in the \
             whole image; the new mesh records how"
                .into(),
        );
        fields.extend(settled_field(&settled));
        Ok(settled)
    }

    /// What the work of a stage gives.
    ///
    /// # Errors
    /// Those of the work; [`Error::Interrupted`] if the observer says no.
    fn run<T>(&mut self, stage: Stage, work: impl FnOnce(&Patience<'_>) -> Result<T>) -> Result<T> {
        self.clock.begin(stage);
        self.observer.stage(stage);
        let ask = &mut |share: Option<f64>| {
            if let Some(share) = share {
                self.observer.share(share);
            }
            self.observer.keep_going()
        };
        Patience::telling(ask, |patience| {
            let stopped =
                || Error::Interrupted(cause(stage, "interrupted", "start the edit again"));
            if patience.over() {
                return Err(stopped());
            }
            let done = work(patience);
            if patience.over() {
                Err(stopped())
            } else {
                done
            }
        })
    }
}

/// Names of a mesh's arrays that are not among those that are `known`.
fn unknown<M>(file: &MeshFile<M>, known: &[&str]) -> Vec<String> {
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
    if after.0 > 0.0 && (after.1 - before.1).abs() <= FILLING * before.1 {
        return Ok(());
    }
    Err(Error::Mesh(cause(
        "the edited mesh",
        format!(
            "came out invalid: around an edit its {} fill {} instead of {}, the smallest has {}",
            M::CELLS,
            after.1,
            before.1,
            after.0
        ),
        "give other positions, or mesh the image again; and please report it with the mesh, for this \
         should never happen",
    )))
}

/// Cells made anew may differ by this share in volume from those that they replace.
const FILLING: f64 = 1e-9;

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
        Change::Add(x) => format!("add {}", point(x)),
        Change::Move(n, x) => format!("move {n} {}", point(x)),
        Change::Remove(n) => format!("remove {n}"),
    }));
    (EDITS.into(), FieldValue::Text(lines.join("\n")))
}

#[cfg(test)]
mod tests;

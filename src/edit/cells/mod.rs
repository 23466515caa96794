//! Edits Voronoi cells locally.
//!
//! Voronoi cells follow from their sites. A node stays unchanged as long as the sites on the sphere
//! around it stay and no site enters the sphere. All nodes farther than five d from every edit are
//! therefore kept, and so are the nodes of faces on features that still fit. The sites of cells at
//! kept nodes do not move. All other sites near an edit are warm. Where features, or sites next to
//! features, have changed, the faces on features are rebuilt. Then the warm atoms move to a minimum
//! of the energy, and their cells are cut.
//!
//! - `editable_cells`: the cells before the edit
//! - `preserved`: the nodes and cells that stay
//! - `patch`: the neighbourhood of an edit, and the patch that replaces its cells
//! - `rebuilt`: the new cells of a neighbourhood
//! - `stitching`: the mesh with patches in place of the cells that they replace

mod editable_cells;
mod patch;
mod preserved;
mod rebuilt;
mod stitching;

use super::local_fields::Context;
use super::whole_features::EditImage;
use super::{AtomChange, Edit, EditStages, EditedMesh, Summary, history, resolve};
use crate::Result;
use crate::job::output::resolved_options;
use crate::job::{JoinAtoms, LatticeParams};
use crate::mesh::poly::PolyMesh;
use crate::mesh::{Dimension, Space};
use crate::progress::{Progress, Stage};
use crate::report::Clock;
use crate::store::MeshFile;
pub(crate) use editable_cells::ATOM_KIND;
use editable_cells::EditableCells;
pub use editable_cells::dropped_arrays;
use patch::{CellNeighbourhood, CellPatch};

/// Edits Voronoi cells that [`job::run`](crate::job::run()) made of the image of `input`. It works like
/// [`edit`](super::edit()) for simplices; the number of an atom is that of its cell.
///
/// Nodes that are farther than five d from every edited position, and cells with only such nodes,
/// keep exactly the same bits.
///
/// # Errors
/// Returns the errors of [`edit`](super::edit()), and [`Error::Seeding`](crate::Error::Seeding)
/// also if a position lies on a side of the box, where cells end.
pub fn edit_cells<const D: usize>(
    file: MeshFile<PolyMesh<D>>,
    place: &str,
    input: EditImage<'_, D>,
    edits: &[Edit<D>],
    free: bool,
    progress: &mut dyn Progress,
) -> Result<EditedMesh<PolyMesh<D>>>
where
    Space<D>: Dimension<D, Mesh: JoinAtoms<D>>,
{
    let EditImage { image, params, .. } = input;
    super::refuse_given_surfaces(params, place)?;
    let clock = Clock::new();
    let mut stages = EditStages { clock, progress };
    let resolved = resolved_options(&file);
    let mut editable = EditableCells::new(file, place, params)?;
    editable.space.check_dims(image.dims(), "the image")?;
    let step = editable.space.step;
    let params = &LatticeParams::for_step(params, &image.geometry, step);
    let mut summary = Summary {
        nodes: [editable.mesh.nodes.len(), 0],
        atoms: vec![None; edits.len()],
        ..Summary::default()
    };
    let fields = &mut editable.fields;
    let resolved = match resolved {
        Some(resolved) => resolved,
        None => stages.resolve_detection(image, params, step, &mut summary, fields)?,
    };
    let mut context = Context::new(image, params, edits, resolved, step)?;
    context.whole_features = stages.whole_features(input, &context, step)?;
    let groups = stages.run_stage(Stage::Neighbourhoods, |_| {
        resolve::resolve(&editable.lattice(), edits, free)
    })?;
    let mut patches: Vec<CellPatch<D>> = Vec::new();
    for group in groups {
        let neighbourhood = stages.run_stage(Stage::Neighbours, |_| {
            Ok(CellNeighbourhood::new(&editable, group, &context))
        })?;
        let fields = stages.run_stage(Stage::Features, |cancel| {
            neighbourhood.local_fields(&context, cancel)
        })?;
        summary.samples += fields.detected_samples;
        let surface = stages.run_stage(Stage::Conforming, |cancel| {
            neighbourhood.surface(&fields, &context, cancel)
        })?;
        patches.push(stages.run_stage(Stage::Cutting, |cancel| {
            neighbourhood.patch(&fields, &surface, &context, &mut summary, cancel)
        })?);
    }
    let history = history(&editable.fields, edits);
    editable.fields.push(history);
    let file = stages.run_stage(Stage::Assembling, |_| {
        stitching::stitch_patches(editable, patches, &mut summary)
    })?;
    let mut clock = stages.clock;
    clock.end();
    summary.stages = clock.costs().to_vec();
    Ok(EditedMesh { file, summary })
}

/// Returns the position at which an edit puts its atom; `None` if it removes the atom.
fn target_position<const D: usize>(edit: &Edit<D>) -> Option<[f64; D]> {
    match edit.change {
        AtomChange::Add(x) | AtomChange::Move(_, x) => Some(x),
        AtomChange::Remove(_) => None,
    }
}

#[cfg(test)]
mod tests;

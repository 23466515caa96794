//! Local edits of Voronoi cells.
//!
//! Cells follow from their sites: what stays are nodes, each as long as the sites on the sphere round it
//! stay and none comes inside. So beyond five d of every edit all nodes are kept, and so are those of
//! the faces on features that are as good as before; the sites at kept nodes do not move. All others near an
//! edit are warm: where features or sites at them have changed, faces on features are made anew; atoms
//! come to rest, and their cells are cut.
//!
//! - `grid`: the cells as they are
//! - `kept`: what of them stays
//! - `patch`: the cells round an edit, and what is new there
//! - `anew`: cells made anew while others stay
//! - `stitch`: the mesh with patches in place of what they are made for

mod editable_cells;
mod patch;
mod preserved;
mod rebuilt;
mod stitching;

use super::{AtomChange, Context, Edit, EditStages, EditedMesh, Summary, history, resolve};
use crate::Result;
use crate::image::Image;
use crate::job::{MeshSpace, Meshing, Params, lattice_beta};
use crate::mesh::poly::PolyMesh;
use crate::progress::{Progress, Stage};
use crate::report::Clock;
use crate::store::MeshFile;
use crate::store::output::resolved_options;
#[cfg(feature = "cli")]
pub(crate) use editable_cells::ATOM_KIND;
use editable_cells::EditableCells;
pub use editable_cells::dropped_arrays;
use patch::{CellNeighbourhood, CellPatch};

/// Edits Voronoi cells that [`job::run`](crate::job::run) made of `image`, as [`edit`](super::edit()) edits
/// simplices; the number of an atom is that of its cell.
///
/// Cells all of whose nodes are farther than five d from every edited position are the same bits as before,
/// and so are those nodes.
///
/// # Errors
/// As [`edit`](super::edit()); [`Error::Seeding`](crate::Error::Seeding) also for a position on a side of the
/// box, where cells end.
pub fn edit_cells<const D: usize>(
    file: MeshFile<PolyMesh<D>>,
    place: &str,
    image: &Image<D>,
    params: &Params<D>,
    edits: &[Edit<D>],
    free: bool,
    observer: &mut dyn Progress,
) -> Result<EditedMesh<PolyMesh<D>>>
where
    MeshSpace<D>: Meshing<D>,
{
    let clock = Clock::new();
    let mut stages = EditStages { clock, observer };
    let settled = resolved_options(&file);
    let mut grid = EditableCells::new(file, place, params)?;
    grid.space.check_dims(image.dims(), "the image")?;
    let step = grid.space.step;
    // The file knows the units of its lattice space.
    let lengths = params.metric.lengths(&image.geometry);
    let params = &*params.in_lattice_units(lengths[0] / step[0]);
    let mut summary = Summary {
        nodes: [grid.mesh.nodes.len(), 0],
        atoms: vec![None; edits.len()],
        ..Summary::default()
    };
    let settled = match settled {
        Some(settled) => settled,
        None => stages.resolve_detection(image, params, step, &mut summary, &mut grid.fields)?,
    };
    let beta = lattice_beta(&params.beta, image.dims(), step)?;
    let context = Context {
        image,
        params,
        resolved_options: &settled,
        beta: &beta,
        edits,
    };
    let groups = stages.run_stage(Stage::Neighbourhoods, |_| {
        resolve::resolve(&grid.lattice(), edits, free)
    })?;
    let mut patches: Vec<CellPatch<D>> = Vec::new();
    for group in groups {
        let scope = stages.run_stage(Stage::Neighbours, |_| {
            Ok(CellNeighbourhood::new(&grid, group, &context))
        })?;
        let around = stages.run_stage(Stage::Features, |patience| {
            scope.local_fields(&context, patience)
        })?;
        summary.samples += around.features.potential.dims.iter().product::<usize>();
        let surface = stages.run_stage(Stage::Conforming, |patience| {
            scope.surface(&around, &context, patience)
        })?;
        patches.push(stages.run_stage(Stage::Cutting, |patience| {
            scope.patch(&around, &surface, &context, &mut summary, patience)
        })?);
    }
    let history = history(&grid.fields, edits);
    grid.fields.push(history);
    let file = stages.run_stage(Stage::Assembling, |_| {
        stitching::stitch_patches(grid, patches, &mut summary)
    })?;
    let mut clock = stages.clock;
    clock.end();
    summary.stages = clock.costs().to_vec();
    Ok(EditedMesh { file, summary })
}

/// Where the user has put an atom.
fn target_position<const D: usize>(edit: &Edit<D>) -> Option<[f64; D]> {
    match edit.change {
        AtomChange::Add(x) | AtomChange::Move(_, x) => Some(x),
        AtomChange::Remove(_) => None,
    }
}

#[cfg(test)]
mod tests;

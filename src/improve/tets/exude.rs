//! Removes slivers by exudation, our own or CGAL's. Features are recovered as for the other method; after that
//! nodes stay where they are, and only the tetrahedra change.
//!
//! ```text
//!    q           q
//!   /|\         / \     As the weight of node p grows, p enters the circumsphere of a tetrahedron
//!  p | t  ->   p---t    next to its star, drawn in 2-D as (q, s, t). The star takes the place of
//!   \|/         \ /     that tetrahedron.
//!    s           s
//! ```

use super::finish::{blocked_cells, faces_on_surfaces};
use super::{ImproveContext, SharedWork, TetImprover};
use crate::Result;
use crate::improve::{ImproveReport, SliverMethod};
use crate::lattice::AtomKind;
use crate::mesh::delaunay::{self, cgal, exude};
use crate::mesh::quality::min_sine;
use crate::mesh::{FACES, TetMesh};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Improves a mesh as [`improve`](super::improve) does, but by weights of the nodes instead of
/// flips and smoothing. Faces on features are kept. Edges that pass through a feature are not
/// searched again.
///
/// # Errors
/// Returns the errors of [`exude`](exude::exude), and an error if another rank fails.
pub fn exude(
    mesh: &mut TetMesh,
    neighbours: Vec<[u32; 4]>,
    kinds: &mut Vec<AtomKind>,
    context: ImproveContext<'_>,
    work: SharedWork<'_>,
    cancel: &CancelToken<'_>,
) -> Result<(ImproveReport, Vec<u8>)> {
    let (planes, target_sine) = (context.planes, context.target_sine());
    let owned_mesh = std::mem::take(mesh);
    let mut improver = TetImprover::new(owned_mesh, neighbours, kinds, context, cancel);
    improver.work = work;
    let below_target_before = improver.tets_below_target().len();
    improver.recover(cancel)?;
    let counts = improver.counts;
    let finished = improver.finish(kinds);
    (*mesh, *kinds) = (finished.mesh, finished.kinds);
    let constraints = finished.constraints;

    mesh.tets = delaunay::delaunay(&mesh.nodes)?.tets;
    let kept_faces: Vec<[u32; 3]> = faces_on_surfaces(mesh, &constraints, planes)
        .iter()
        .zip(&mesh.tets)
        .flat_map(|(&bits, tet)| {
            let on_feature = (0..4).filter(move |k| bits >> k & 1 == 1);
            on_feature.map(|k| FACES[k].map(|i| tet[i]))
        })
        .collect();
    let min_dihedral = context.target.min_dihedral;
    mesh.tets = match context.target.method {
        SliverMethod::ExudeCgal => cgal::exude(&mesh.nodes, &kept_faces, min_dihedral)?,
        _ => exude::exude(&mesh.nodes, &kept_faces, min_dihedral)?,
    };

    let sines: Vec<f64> = (0..mesh.tets.len())
        .into_par_iter()
        .map(|t| min_sine(&mesh.corners(t)))
        .collect();
    let mut below_target: Vec<u32> = (0..mesh.tets.len() as u32).collect();
    below_target.retain(|&t| sines[t as usize] < target_sine);
    below_target.sort_by(|&a, &b| sines[a as usize].total_cmp(&sines[b as usize]));
    let report = ImproveReport {
        below_target_before,
        counts,
        blocked: blocked_cells(&mesh.nodes, &mesh.tets, &constraints, &below_target),
    };
    Ok((report, faces_on_surfaces(mesh, &constraints, planes)))
}

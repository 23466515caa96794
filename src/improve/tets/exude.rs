//! The second method against slivers: CGAL's exudation. Features are recovered as for the first, and
//! the nodes that this leaves stay where they are; only what joins them changes.

use super::TetImprover;
use super::finish::{blocked_cells, faces_on_surfaces};
use crate::Result;
use crate::improve::feature_planes::FeaturePlanes;
use crate::improve::{ImproveReport, Target};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::mesh::delaunay::exude;
use crate::mesh::quality::min_sine;
use crate::mesh::{FACES, TetMesh};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// As [`improve`](super::improve), by weights of the nodes instead of flips and smoothing: faces that
/// lie on a feature are kept, edges that pierce one are not looked for again.
///
/// # Errors
/// Those of [`exude`](exude::exude).
pub fn exude(
    mesh: &mut TetMesh,
    neighbors: Vec<[u32; 4]>,
    kinds: &mut Vec<AtomKind>,
    extent: [f64; 3],
    sheets: &FeaturePlanes,
    distance: &Distance<3>,
    aim: &Target,
    patience: &CancelToken<'_>,
) -> Result<(ImproveReport, Vec<u8>)> {
    let target = aim.min_dihedral.to_radians().sin();
    let taken = std::mem::take(mesh);
    let mut improver = TetImprover::new(
        taken, neighbors, kinds, extent, sheets, distance, target, patience,
    );
    let poor_before = improver.tets_below_target().len();
    improver.recover(patience)?;
    let counts = improver.counts;
    let finished = improver.finish(kinds);
    (*mesh, *kinds) = (finished.mesh, finished.kinds);
    let holds = finished.constraints;

    mesh.tets = exude::unweighted_delaunay(&mesh.nodes)?;
    let keep: Vec<[u32; 3]> = faces_on_surfaces(mesh, &holds, sheets)
        .iter()
        .zip(&mesh.tets)
        .flat_map(|(&bits, tet)| {
            let on_feature = (0..4).filter(move |k| bits >> k & 1 == 1);
            on_feature.map(|k| FACES[k].map(|i| tet[i]))
        })
        .collect();
    mesh.tets = exude::exude(&mesh.nodes, &keep, aim.min_dihedral)?;

    let sines: Vec<f64> = (0..mesh.tets.len())
        .into_par_iter()
        .map(|t| min_sine(&mesh.corners(t)))
        .collect();
    let mut poor: Vec<u32> = (0..mesh.tets.len() as u32).collect();
    poor.retain(|&t| sines[t as usize] < target);
    poor.sort_by(|&a, &b| sines[a as usize].total_cmp(&sines[b as usize]));
    let outcome = ImproveReport {
        below_target_before: poor_before,
        below_target_after: poor.len(),
        counts,
        blocked: blocked_cells(&mesh.nodes, &mesh.tets, &holds, &poor),
    };
    Ok((outcome, faces_on_surfaces(mesh, &holds, sheets)))
}

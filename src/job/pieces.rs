//! A large mesh made in pieces by several ranks, none of which holds all of it: from atoms at rest to figures.

use super::join::{Marked, Scene};
use super::measure::figures_of_pieces;
use super::{Stages, join};
use crate::Result;
use crate::improve::tets::{self, Aim, Cuts, InSlabs};
use crate::improve::{self, SliverMethod, Target};
use crate::lattice::seeding::Atoms;
use crate::mesh::TetMesh;
use crate::mesh::delaunay::{Delaunay, Stretches, delaunay_of_stretches, delaunay_with_neighbors};
use crate::mesh::piece::Piece;
use crate::observer::Stage;
use crate::ranks::{Group, Ranks};
use crate::report::{Improvement, Report};

/// Which nodes and cells of a mesh this rank has, where others have the rest.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Share {
    /// The number of each node in the whole mesh, rising; several ranks may have one.
    pub nodes: Vec<u32>,
    /// The number of the first cell; the others follow.
    pub first: usize,
    /// Nodes and cells of the whole mesh.
    pub whole: [usize; 2],
}

/// What a rank has of a mesh, and the figures of the whole.
pub struct InPieces<M> {
    pub made: Marked<M>,
    pub share: Share,
    pub report: Report,
}

/// Joins atoms, removes slivers, closes holes and measures, each rank what is its own. None where the mesh is not
/// large enough to be cut, or is asked for in a way that needs all of it.
///
/// # Errors
/// Those of the triangulation, and of other ranks.
pub fn made(
    atoms: &mut Atoms<3>,
    scene: &Scene<'_, 3>,
    target: Option<&Target>,
    stages: &mut Stages<'_>,
) -> Result<Option<InPieces<TetMesh>>> {
    let (extent, distance) = (scene.extent, scene.distance);
    let (Some(cuts), Some(target)) = (Cuts::new(&atoms.positions, extent, distance), target) else {
        return Ok(None);
    };
    if target.method != SliverMethod::Joe || scene.features.labels.is_some() {
        return Ok(None);
    }
    let group: &dyn Group = &Ranks;
    let Atoms { positions, kinds } = atoms;
    let sheets = join::put_onto_sheets(positions, kinds, scene);
    stages.begin(Stage::Joining);
    let Stretches { tets, neighbors } = own_tetrahedra(positions, &cuts, group)?;
    stages.begin(Stage::Improving);
    let aim = Aim {
        extent,
        sheets: &sheets,
        distance,
        target,
    };
    let InSlabs {
        piece,
        kinds,
        mut feature_faces,
        improved,
    } = stages.patiently(|patience| {
        let atoms = (&positions[..], &kinds[..]);
        let joined = (tets, neighbors);
        tets::improve_in_slabs(atoms, joined, &cuts, aim, group, patience)
    })?;
    drop(sheets);
    let mut improvement = Improvement::from(&improved);
    improvement.sealed = stages.patiently(|patience| {
        let (points, marks) = (&scene.features.points, &mut feature_faces);
        improve::seal_pieces(&piece, points, extent, distance, marks, group, patience)
    })?;
    stages.begin(Stage::Measuring);
    let mut figures = stages.patiently(|patience| {
        let marks = &feature_faces[..];
        figures_of_pieces(&piece, Some(marks), marks, scene, group, patience)
    })?;
    let judged = figures.judged.take().unwrap_or_default();
    if let Some(quality) = &mut figures.quality {
        quality.angles = Some(judged.angles.clone());
    }
    let report = Report {
        quality: figures.quality,
        filling: figures.filling,
        fidelity: figures.fidelity,
        lattice: figures.lattice,
        improvement: Some(improvement),
        ..Report::default()
    };
    let Piece {
        mesh,
        numbers,
        first,
        whole,
        ..
    } = piece;
    Ok(Some(InPieces {
        made: Marked {
            regions: Vec::new(),
            mesh,
            kinds,
            feature_faces,
            judged,
        },
        share: Share {
            nodes: numbers,
            first,
            whole,
        },
        report,
    }))
}

/// The Delaunay tetrahedra of a rank's slabs, with neighbours among them.
fn own_tetrahedra(positions: &[[f64; 3]], cuts: &Cuts, group: &dyn Group) -> Result<Stretches> {
    let own = tets::own_slabs(cuts.count(), group);
    let some = delaunay_of_stretches(positions, cuts.axis, &cuts.ends(), own)?;
    let all_have: Vec<bool> = group.all("tetrahedra of slabs", some.is_some())?;
    match some {
        Some(some) if all_have.iter().all(|&has| has) => Ok(some),
        _ => {
            let Delaunay { mesh, neighbors } = delaunay_with_neighbors(positions)?;
            Ok(Stretches {
                tets: mesh.tets,
                neighbors,
            })
        }
    }
}

//! A large mesh made in pieces by several ranks, none of which holds all of it: from atoms at rest to figures.

use super::join::{Marked, Scene};
use super::measure::figures_of_pieces;
use super::{Stages, join};
use crate::feature::NearPoints;
use crate::geometry::spread;
use crate::image::synth::truth::REACH;
use crate::improve::tets::{self, Aim, Cuts, InSlabs, KnownAtoms};
use crate::improve::{self, SliverMethod, Target};
use crate::lattice::distance::{Distance, Shared};
use crate::lattice::share::{Numbered, OwnAtoms};
use crate::mesh::TetMesh;
use crate::mesh::delaunay::{
    Delaunay, Stretches, Whole, delaunay_of_stretches, delaunay_with_neighbors,
};
use crate::mesh::piece::Piece;
use crate::observer::Stage;
use crate::ranks::{Group, Ranks};
use crate::report::{Improvement, Report};
use crate::{Error, Result};

/// From how far around the atoms of its slabs a rank knows d, in units of the largest.
const ROOM: f64 = 2.0;

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

/// What a rank has of a mesh, and the points of features near it; and the figures of the whole.
pub struct InPieces<M, const D: usize> {
    pub made: Marked<M>,
    pub share: Share,
    pub points: NearPoints<D>,
    pub distance: Distance<D>,
    pub report: Report,
}

/// Tetrahedra, and the neighbours of each.
type Joined = (Vec<[u32; 4]>, Vec<[u32; 4]>);

/// Joins atoms, removes slivers, closes holes and measures, each rank what is its own. None where the mesh is not
/// large enough to be cut, or is asked for in a way that needs all of it.
///
/// # Errors
/// Those of the triangulation, and of other ranks.
pub fn made(
    atoms: &mut OwnAtoms<3>,
    scene: &Scene<'_, 3>,
    distance: &Shared<3>,
    target: Option<&Target>,
    stages: &mut Stages<'_>,
) -> Result<Option<InPieces<TetMesh, 3>>> {
    let (extent, outline) = (scene.extent, scene.distance);
    let Some(target) = target else {
        return Ok(None);
    };
    if target.method != SliverMethod::Joe || scene.features.labels.is_some() {
        return Ok(None);
    }
    let group: &dyn Group = &Ranks;
    let Some(cuts) = Cuts::new(&atoms.atoms.positions, extent, outline, group)? else {
        return Ok(None);
    };
    let mut atoms = std::mem::take(atoms);
    let near = |positions: &[[f64; 3]]| {
        let points = scene.features.points_near(positions, seen(scene), group)?;
        let sheets = join::planes(&points.points, extent, outline);
        Ok::<_, Error>((points, sheets))
    };
    let (_, sheets) = near(&atoms.atoms.positions)?;
    improve::settle_together(&mut atoms, extent, &sheets, join::settling(scene), group)?;
    drop(sheets);
    stages.begin(Stage::Joining);
    let (atoms, joined) = own_tetrahedra(atoms, &cuts, group)?;
    stages.begin(Stage::Improving);
    let (points, sheets) = near(&atoms.atoms.positions)?;
    // All nodes that there will be are among these atoms; where one might be put is no farther off.
    let room = ROOM * distance.max();
    let heights = atoms.atoms.positions.iter().map(|x| x[cuts.axis]);
    let heights = heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| {
        [low.min(at - room), high.max(at + room)]
    });
    let near_slabs = distance.between(cuts.axis, heights, group)?.into_owned();
    let scene = &Scene {
        distance: &near_slabs,
        ..*scene
    };
    let aim = Aim {
        extent,
        sheets: &sheets,
        distance: &near_slabs,
        target,
    };
    let InSlabs {
        piece,
        kinds,
        mut feature_faces,
        improved,
    } = stages
        .patiently(|patience| tets::improve_in_slabs(atoms, joined, &cuts, aim, group, patience))?;
    drop(sheets);
    let mut improvement = Improvement::from(&improved);
    improvement.sealed = stages.patiently(|patience| {
        let (points, marks) = (&points.points, &mut feature_faces);
        improve::seal_pieces(&piece, points, extent, distance, marks, group, patience)
    })?;
    stages.begin(Stage::Measuring);
    let mut figures = stages.patiently(|patience| {
        let marks = &feature_faces[..];
        let near = &points.points;
        figures_of_pieces(&piece, Some(marks), marks, scene, near, group, patience)
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
        notes: unknown(&near_slabs, group)?.into_iter().collect(),
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
        points,
        distance: near_slabs,
        report,
    }))
}

/// What is to be said where d was asked for and a rank does not know it, which should never be.
fn unknown(distance: &Distance<3>, group: &dyn Group) -> Result<Option<String>> {
    let missed: Vec<bool> = group.all("distances", distance.missed())?;
    Ok(missed.contains(&true).then(|| {
        "the distance was asked for farther from its part of the mesh than a rank knows it, and was taken to be the \
         largest: one process may give another mesh; please report it with the image"
            .into()
    }))
}

/// How far from nodes of a mesh, along each axis, points of features matter: to where atoms are put, to which edges pierce
/// features, and to how far faces are from them.
fn seen(scene: &Scene<'_, 3>) -> f64 {
    let sample = scene
        .features
        .potential
        .step
        .into_iter()
        .fold(0.0, f64::max);
    let measured = f64::from(REACH) * sample;
    measured.max(2.0 * join::reach(scene.distance)) + 2.0 * scene.distance.max()
}

/// The atoms of a rank's slabs and of some room round them, and the Delaunay tetrahedra of the slabs, with neighbours
/// among them.
fn own_tetrahedra(
    share: OwnAtoms<3>,
    cuts: &Cuts,
    group: &dyn Group,
) -> Result<(KnownAtoms, Joined)> {
    let (own, whole) = (tets::own_slabs(cuts.count(), group), share.whole);
    let spreads: Vec<[[f64; 3]; 2]> =
        group.all("where atoms are", spread(&share.atoms.positions))?;
    let [low, high] = spread(&spreads.concat());
    let all = Whole {
        low,
        high,
        count: whole,
    };
    let ends = cuts.ends();
    // From where to where each wants them.
    let wanted = match own.is_empty() {
        true => [f64::INFINITY, f64::NEG_INFINITY],
        false => [
            (own.start.checked_sub(1))
                .map_or(f64::NEG_INFINITY, |before| ends[before] - all.halo()),
            (ends.get(own.end - 1)).map_or(f64::INFINITY, |end| end + all.halo()),
        ],
    };
    let wanted: Vec<[f64; 2]> = group.all("slabs", wanted)?;
    let wants = |rank: usize, n: usize| {
        let ([from, to], x) = (wanted[rank], share.atoms.positions[n][cuts.axis]);
        from <= x && x <= to
    };
    let Numbered { numbers, atoms } = share.passed("atoms of slabs", wants, group)?;
    let some = delaunay_of_stretches(&atoms.positions, all, cuts.axis, &ends, own)?;
    let all_have: Vec<bool> = group.all("tetrahedra of slabs", some.is_some())?;
    if let Some(Stretches { tets, neighbors }) = some
        && all_have.iter().all(|&has| has)
    {
        let known = KnownAtoms {
            atoms,
            numbers: Some(numbers),
            whole,
        };
        return Ok((known, (tets, neighbors)));
    }
    drop((numbers, atoms));
    let atoms = share.gathered(group)?;
    let Delaunay { mesh, neighbors } = delaunay_with_neighbors(&atoms.positions)?;
    let known = KnownAtoms {
        atoms,
        numbers: None,
        whole,
    };
    Ok((known, (mesh.tets, neighbors)))
}

//! A large mesh made in pieces by several ranks, none of which holds all of it: from atoms at rest to figures.

use super::join::{AnnotatedMesh, MeshScene};
use super::measure::figures_of_partition;
use super::{StageRunner, join};
use crate::comm::{Comm, WorldComm};
use crate::feature::PointSubset;
use crate::geometry::bounding_box;
use crate::image::synth::truth::MAX_DISTANCE;
use crate::improve::tets::{self, KnownAtoms, SlabContext, SlabCuts, SlabResult};
use crate::improve::{self, SliverMethod, Target};
use crate::lattice::distance::{Distance, DistributedDistance};
use crate::lattice::partition::{IndexedAtoms, OwnedAtoms};
use crate::mesh::TetMesh;
use crate::mesh::delaunay::{
    Delaunay, GlobalPoints, IntervalTets, delaunay_in_intervals, delaunay_with_neighbors,
};
use crate::mesh::partition::MeshPartition;
use crate::progress::Stage;
use crate::report::{Improvement, Report};
use crate::{Error, Result};

/// From how far around the atoms of its slabs a rank knows d, in units of the largest.
const HALO_WIDTH: f64 = 2.0;

/// Which nodes and cells of a mesh this rank has, where others have the rest.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct MeshShare {
    /// The number of each node in the whole mesh, rising; several ranks may have one.
    pub nodes: Vec<u32>,
    /// The number of the first cell; the others follow.
    pub first_cell: usize,
    /// Nodes and cells of the whole mesh.
    pub global_counts: [usize; 2],
}

/// What a rank has of a mesh, and the points of features near it; and the figures of the whole.
pub struct PartitionResult<M, const D: usize> {
    pub annotated_mesh: AnnotatedMesh<M>,
    pub share: MeshShare,
    pub near_points: PointSubset<D>,
    pub distance: Distance<D>,
    pub report: Report,
}

/// Tetrahedra, and the neighbours of each.
type TetsAndNeighbours = (Vec<[u32; 4]>, Vec<[u32; 4]>);

/// Joins atoms, removes slivers, closes holes and measures, each rank what is its own. None where the mesh is not
/// large enough to be cut, or is asked for in a way that needs all of it.
///
/// # Errors
/// Those of the triangulation, and of other ranks.
pub fn make_partition(
    atoms: &mut OwnedAtoms<3>,
    scene: &MeshScene<'_, 3>,
    distance: &DistributedDistance<3>,
    target: Option<&Target>,
    stages: &mut StageRunner<'_>,
) -> Result<Option<PartitionResult<TetMesh, 3>>> {
    let (extent, outline) = (scene.extent, scene.distance);
    let Some(target) = target else {
        return Ok(None);
    };
    if target.method != SliverMethod::Joe || scene.features.labels.is_some() {
        return Ok(None);
    }
    let group: &dyn Comm = &WorldComm;
    let Some(cuts) = SlabCuts::new(&atoms.atoms.positions, extent, outline, group)? else {
        return Ok(None);
    };
    let mut atoms = std::mem::take(atoms);
    let near = |positions: &[[f64; 3]]| {
        let points = scene
            .features
            .points_near(positions, feature_range(scene), group)?;
        let sheets = join::planes_near(&points.points, extent, outline);
        Ok::<_, Error>((points, sheets))
    };
    let (_, sheets) = near(&atoms.atoms.positions)?;
    improve::snap_distributed(
        &mut atoms,
        extent,
        &sheets,
        join::snap_distance(scene),
        group,
    )?;
    drop(sheets);
    stages.begin(Stage::Triangulating);
    let (atoms, joined) = local_tetrahedra(atoms, &cuts, group)?;
    stages.begin(Stage::Improving);
    let (points, sheets) = near(&atoms.atoms.positions)?;
    // All nodes that there will be are among these atoms; where one might be put is no farther off.
    let room = HALO_WIDTH * distance.max();
    let heights = atoms.atoms.positions.iter().map(|x| x[cuts.axis]);
    let heights = heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| {
        [low.min(at - room), high.max(at + room)]
    });
    let near_slabs = distance
        .fetch_between(cuts.axis, heights, group)?
        .into_owned();
    let scene = &MeshScene {
        distance: &near_slabs,
        ..*scene
    };
    let aim = SlabContext {
        extent,
        planes: &sheets,
        distance: &near_slabs,
        target,
    };
    let SlabResult {
        partition: piece,
        kinds,
        mut feature_faces,
        report: improved,
    } = stages.run_cancellable(|patience| {
        tets::improve_in_slabs(atoms, joined, &cuts, aim, group, patience)
    })?;
    drop(sheets);
    let mut improvement = Improvement::from(&improved);
    improvement.sealed = stages.run_cancellable(|patience| {
        let (points, marks) = (&points.points, &mut feature_faces);
        improve::seal_distributed(&piece, points, extent, distance, marks, group, patience)
    })?;
    stages.begin(Stage::Measuring);
    let mut figures = stages.run_cancellable(|patience| {
        let marks = &feature_faces[..];
        let near = &points.points;
        figures_of_partition(&piece, Some(marks), marks, scene, near, group, patience)
    })?;
    let judged = figures.angle_assessment.take().unwrap_or_default();
    if let Some(quality) = &mut figures.quality {
        quality.angles = Some(judged.angles.clone());
    }
    let report = Report {
        quality: figures.quality,
        box_check: figures.box_check,
        fidelity: figures.fidelity,
        lattice: figures.lattice,
        improvement: Some(improvement),
        notes: missing_distance_note(&near_slabs, group)?
            .into_iter()
            .collect(),
        ..Report::default()
    };
    let MeshPartition {
        mesh,
        global_ids: numbers,
        first_cell: first,
        global_counts: whole,
        ..
    } = piece;
    Ok(Some(PartitionResult {
        annotated_mesh: AnnotatedMesh {
            regions: Vec::new(),
            mesh,
            node_kinds: kinds,
            feature_faces,
            angle_assessment: judged,
        },
        share: MeshShare {
            nodes: numbers,
            first_cell: first,
            global_counts: whole,
        },
        near_points: points,
        distance: near_slabs,
        report,
    }))
}

/// What is to be said where d was asked for and a rank does not know it, which should never be.
fn missing_distance_note(distance: &Distance<3>, group: &dyn Comm) -> Result<Option<String>> {
    let missed: Vec<bool> = group.all_gather("distances", distance.has_misses())?;
    Ok(missed.contains(&true).then(|| {
        "the distance was asked for farther from its part of the mesh than a rank knows it, and was taken to be the \
         largest: one process may give another mesh; please report it with the image"
            .into()
    }))
}

/// How far from nodes of a mesh, along each axis, points of features matter: to where atoms are put, to which edges pierce
/// features, and to how far faces are from them.
fn feature_range(scene: &MeshScene<'_, 3>) -> f64 {
    let sample = scene
        .features
        .potential
        .step
        .into_iter()
        .fold(0.0, f64::max);
    let measured = f64::from(MAX_DISTANCE) * sample;
    measured.max(2.0 * join::search_radius(scene.distance)) + 2.0 * scene.distance.max()
}

/// The atoms of a rank's slabs and of some room round them, and the Delaunay tetrahedra of the slabs, with neighbours
/// among them.
fn local_tetrahedra(
    share: OwnedAtoms<3>,
    cuts: &SlabCuts,
    group: &dyn Comm,
) -> Result<(KnownAtoms, TetsAndNeighbours)> {
    let (own, whole) = (tets::slabs_of_rank(cuts.count(), group), share.global_count);
    let spreads: Vec<[[f64; 3]; 2]> =
        group.all_gather("where atoms are", bounding_box(&share.atoms.positions))?;
    let [low, high] = bounding_box(&spreads.concat());
    let all = GlobalPoints {
        low,
        high,
        count: whole,
    };
    let ends = cuts.first_atom_cuts();
    // From where to where each wants them.
    let wanted = match own.is_empty() {
        true => [f64::INFINITY, f64::NEG_INFINITY],
        false => [
            (own.start.checked_sub(1))
                .map_or(f64::NEG_INFINITY, |before| ends[before] - all.max_halo()),
            (ends.get(own.end - 1)).map_or(f64::INFINITY, |end| end + all.max_halo()),
        ],
    };
    let wanted: Vec<[f64; 2]> = group.all_gather("slabs", wanted)?;
    let wants = |rank: usize, n: usize| {
        let ([from, to], x) = (wanted[rank], share.atoms.positions[n][cuts.axis]);
        from <= x && x <= to
    };
    let IndexedAtoms {
        indices: numbers,
        atoms,
    } = share.exchange_wanted("atoms of slabs", wants, group)?;
    let some = delaunay_in_intervals(&atoms.positions, all, cuts.axis, &ends, own)?;
    let all_have: Vec<bool> = group.all_gather("tetrahedra of slabs", some.is_some())?;
    if let Some(IntervalTets { tets, neighbors }) = some
        && all_have.iter().all(|&has| has)
    {
        let known = KnownAtoms {
            atoms,
            global_ids: Some(numbers),
            global_count: whole,
        };
        return Ok((known, (tets, neighbors)));
    }
    drop((numbers, atoms));
    let atoms = share.all_gather(group)?;
    let Delaunay { mesh, neighbors } = delaunay_with_neighbors(&atoms.positions)?;
    let known = KnownAtoms {
        atoms,
        global_ids: None,
        global_count: whole,
    };
    Ok((known, (mesh.tets, neighbors)))
}

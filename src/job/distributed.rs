//! Large meshes that several ranks make together, from atoms at rest to the report. No rank holds
//! the whole mesh.
//!
//! All other meshes are made by `simplices`: small ones, which are not cut into slabs, those with
//! labels, those of other methods, and those that are written to one file. There, all atoms, feature
//! points and distances are in memory. Here, each rank receives those near its slabs, both before
//! and after atoms are snapped, and triangulates only these; a process that has all of them would
//! copy them. What follows is the same code for both: improving slabs, closing holes, measuring.

use super::join::AnnotatedMesh;
use super::measure::MeasuredMesh;
use super::regions::has_fitted_faces;
use super::{MeshScene, StageRunner};
use crate::Result;
use crate::comm::Comm;
use crate::feature::{FeaturePoint, PointSubset};
use crate::geometry::bounding_box;
use crate::image::synth::truth::MAX_DISTANCE;
use crate::improve::feature_planes::FeaturePlanes;
use crate::improve::tets::{DistributedSlabs, ImproveContext, KnownAtoms, SlabResult};
use crate::improve::{self, SealReport, SliverMethod, Target};
use crate::lattice::distance::{Distance, DistributedDistance};
use crate::lattice::halo::OwnedAndGhosts;
use crate::lattice::owned_atoms::{IndexedAtoms, OwnedAtoms};
use crate::mesh::delaunay::{
    Delaunay, DelaunayKernel, DelaunayTets, GlobalPoints, delaunay_in_intervals,
    distributed_delaunay_with_neighbours,
};
use crate::mesh::view::MeshView;
use crate::mesh::{TetMesh, TriMesh};
use crate::progress::Stage;
use crate::report::{Improvement, Report};

/// Distance around the atoms of its slabs to which a rank knows the nominal distance, in units of
/// the largest nominal distance.
const HALO_WIDTH: f64 = 2.0;

/// The nodes and cells of a mesh that this rank holds.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct MeshShare {
    /// Global number of each node, in ascending order. Several ranks may hold the same node.
    pub nodes: Vec<u32>,
    /// Global number of the first cell; the others follow consecutively.
    pub first_cell: usize,
    /// Numbers of nodes and cells of the global mesh.
    pub global_counts: [usize; 2],
}

/// A rank's part of a mesh, the feature points near it, and the report on the global mesh.
pub struct PartitionResult<M, const D: usize> {
    pub annotated_mesh: AnnotatedMesh<M>,
    pub share: MeshShare,
    pub near_points: PointSubset<D>,
    pub distance: Distance<D>,
    pub report: Report,
}

/// Tetrahedra, and the four neighbours of each.
type TetsAndNeighbours = (Vec<[u32; 4]>, Vec<[u32; 4]>);

/// Simplices that several ranks can make together.
pub(super) trait MakePartition<const D: usize>: Sized {
    /// Joins atoms, removes slivers, closes holes and measures the mesh, each rank for its own part.
    /// Returns `None` in the plane, if the mesh is too small to be divided, or if the options need
    /// the whole mesh on one rank.
    ///
    /// # Errors
    /// Returns the errors of the triangulation, and those of other ranks.
    fn make_partition(
        _: &mut OwnedAtoms<D>,
        _: &MeshScene<'_, D>,
        _: &DistributedDistance<D>,
        _: Option<&Target>,
        _: &mut StageRunner<'_>,
    ) -> Result<Option<PartitionResult<Self, D>>> {
        Ok(None)
    }
}

impl MakePartition<2> for TriMesh {}

impl MakePartition<3> for TetMesh {
    fn make_partition(
        atoms: &mut OwnedAtoms<3>,
        scene: &MeshScene<'_, 3>,
        distance: &DistributedDistance<3>,
        target: Option<&Target>,
        stages: &mut StageRunner<'_>,
    ) -> Result<Option<PartitionResult<Self, 3>>> {
        let (extent, outline) = (scene.extent, scene.distance);
        let has_labels = scene.features.labels.is_some() || has_fitted_faces(scene.features);
        let Some(target) = target.filter(|t| t.method == SliverMethod::Joe && !has_labels) else {
            return Ok(None);
        };
        let comm = stages.comm;
        let positions = &atoms.atoms.positions;
        let Some(slabs) = DistributedSlabs::cut(positions, extent, outline, comm)? else {
            return Ok(None);
        };
        let mut atoms = std::mem::take(atoms);
        snap(&mut atoms, scene, comm)?;
        stages.begin(Stage::Triangulating);
        let (atoms, (tets, neighbours)) = local_tetrahedra(atoms, &slabs, stages.kernel, comm)?;
        stages.begin(Stage::Improving);
        let (points, planes) = features_near(&atoms.atoms.positions, scene, comm)?;
        let local_distance =
            distance_around(&atoms.atoms.positions, distance, slabs.cuts.axis, comm)?;
        let scene = &MeshScene {
            distance: &local_distance,
            ..*scene
        };
        let context = ImproveContext {
            extent,
            planes: &planes,
            distance: &local_distance,
            target: *target,
        };
        let SlabResult {
            partition,
            kinds,
            mut feature_faces,
            report: improved,
        } = stages
            .run_cancellable(|cancel| slabs.improve(atoms, tets, neighbours, context, cancel))?;
        drop(planes);
        let mut improvement = Improvement::from(improved);
        let view = MeshView::from_partition(&partition, comm);
        let neighbours = partition.neighbours.as_flattened();
        improvement.sealed = seal_partition(
            &view,
            neighbours,
            &points.points,
            extent,
            distance,
            &mut feature_faces,
            stages,
        )?;
        stages.begin(Stage::Measuring);
        let measured = MeasuredMesh {
            view,
            neighbours: Some(neighbours),
            tagged_faces: Some(&feature_faces),
            feature_faces: Some(&feature_faces),
            scene,
            near_points: &points.points,
        };
        let figures = stages.run_cancellable(|cancel| measured.figures(comm, cancel))?;
        let (mut report, assessment) = figures.into_report(Some(improvement));
        let note = missing_distance_note(&local_distance, comm)?;
        report.notes.extend(note);
        Ok(Some(PartitionResult {
            share: MeshShare {
                nodes: partition.global_ids,
                first_cell: partition.first_cell,
                global_counts: partition.global_counts,
            },
            annotated_mesh: AnnotatedMesh {
                regions: Vec::new(),
                mesh: partition.mesh,
                node_kinds: kinds,
                feature_faces,
                angle_assessment: assessment,
            },
            near_points: points,
            distance: local_distance,
            report,
        }))
    }
}

/// Snaps the atoms of this rank that are close to a feature onto it.
fn snap(atoms: &mut OwnedAtoms<3>, scene: &MeshScene<'_, 3>, comm: &dyn Comm) -> Result<()> {
    let (_, planes) = features_near(&atoms.atoms.positions, scene, comm)?;
    let snap_distance = scene.snap_distance();
    let halo_width = improve::snap_halo_width(snap_distance);
    let local = OwnedAndGhosts::with_halo(atoms, halo_width, comm)?;
    improve::snap_distributed(atoms, local, scene.extent, &planes, snap_distance)?;
    Ok(())
}

/// Returns the feature points near these positions, and the planes through them.
fn features_near(
    positions: &[[f64; 3]],
    scene: &MeshScene<'_, 3>,
    comm: &dyn Comm,
) -> Result<(PointSubset<3>, FeaturePlanes)> {
    let features = scene.features;
    let points = features.points_near(positions, feature_range(scene), comm)?;
    let planes = scene.planes_of(&points.points);
    Ok((points, planes))
}

/// Returns the nominal distance around atoms. All nodes of the final mesh are among these atoms, and
/// no node moves out of this range along `axis`.
fn distance_around(
    positions: &[[f64; 3]],
    distance: &DistributedDistance<3>,
    axis: usize,
    comm: &dyn Comm,
) -> Result<Distance<3>> {
    let margin = HALO_WIDTH * distance.max();
    let coordinates = positions.iter().map(|x| x[axis]);
    let range = coordinates.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| {
        [low.min(at - margin), high.max(at + margin)]
    });
    Ok(distance.fetch_between(axis, range, comm)?.into_owned())
}

/// Closes the holes in the features of a partition. Faces that close them are added to the marks.
fn seal_partition(
    view: &MeshView<'_, 3, TetMesh>,
    neighbours: &[u32],
    points: &[FeaturePoint<3>],
    extent: [f64; 3],
    distance: &DistributedDistance<3>,
    marks: &mut [u8],
    stages: &mut StageRunner<'_>,
) -> Result<SealReport> {
    let comm = stages.comm;
    let distance_near = |nodes: &[[f64; 3]]| distance.fetch_near(nodes, 0.0, comm);
    stages.run_cancellable(|cancel| {
        let max_distance = distance.max();
        improve::seal(
            view,
            neighbours,
            points,
            extent,
            max_distance,
            distance_near,
            marks,
            cancel,
        )
    })
}

/// Returns a note if the nominal distance was requested at a point where a rank does not know it,
/// which is an error in this program.
fn missing_distance_note(distance: &Distance<3>, comm: &dyn Comm) -> Result<Option<String>> {
    let missed: Vec<bool> = comm.all_gather("distances", distance.has_misses())?;
    Ok(missed.contains(&true).then(|| {
        "a rank needed the distance between atoms at a point beyond those where it knows it, and used the largest \
         distance: one process may give another mesh; please report it with the image"
            .into()
    }))
}

/// Returns the distance, along each axis, from nodes of a mesh within which feature points matter:
/// for snapping atoms, for edges that intersect features, and for the distances of faces to
/// features.
fn feature_range(scene: &MeshScene<'_, 3>) -> f64 {
    let sample = scene
        .features
        .potential
        .step
        .into_iter()
        .fold(0.0, f64::max);
    let measured = f64::from(MAX_DISTANCE) * sample;
    measured.max(2.0 * scene.search_radius()) + 2.0 * scene.distance.max()
}

/// Returns the atoms of a rank's slabs and of a halo around them, and the Delaunay tetrahedra of
/// the slabs with their neighbours.
fn local_tetrahedra(
    owned: OwnedAtoms<3>,
    slabs: &DistributedSlabs<'_>,
    kernel: DelaunayKernel,
    comm: &dyn Comm,
) -> Result<(KnownAtoms, TetsAndNeighbours)> {
    let (cuts, slabs, atom_count) = (&slabs.cuts, slabs.local_slabs(), owned.global_count);
    let bounds: Vec<[[f64; 3]; 2]> =
        comm.all_gather("where atoms are", bounding_box(&owned.atoms.positions))?;
    let [low, high] = bounding_box(bounds.concat());
    let points = GlobalPoints {
        low,
        high,
        count: atom_count,
    };
    let ends = cuts.first_atom_cuts();
    // The interval of coordinates in which each rank needs atoms.
    let interval = if slabs.is_empty() {
        [f64::INFINITY, f64::NEG_INFINITY]
    } else {
        [
            (slabs.start.checked_sub(1))
                .map_or(f64::NEG_INFINITY, |index| ends[index] - points.max_halo()),
            (ends.get(slabs.end - 1)).map_or(f64::INFINITY, |end| end + points.max_halo()),
        ]
    };
    let interval: Vec<[f64; 2]> = comm.all_gather("slabs", interval)?;
    let is_wanted = |rank: usize, n: usize| {
        let ([start, end], x) = (interval[rank], owned.atoms.positions[n][cuts.axis]);
        start <= x && x <= end
    };
    let IndexedAtoms { indices, atoms } =
        owned.exchange_wanted("atoms of slabs", is_wanted, comm)?;
    let interval_tets =
        delaunay_in_intervals(&atoms.positions, points, cuts.axis, &ends, slabs, kernel)?;
    let has_tets: Vec<bool> = comm.all_gather("tetrahedra of slabs", interval_tets.is_some())?;
    if let Some(DelaunayTets { tets, neighbours }) = interval_tets
        && has_tets.iter().all(|&has| has)
    {
        let known = KnownAtoms {
            atoms,
            global_ids: Some(indices),
            global_count: atom_count,
        };
        return Ok((known, (tets, neighbours)));
    }
    drop((indices, atoms));
    let atoms = owned.all_gather(comm)?;
    let Delaunay { mesh, neighbours } =
        distributed_delaunay_with_neighbours(&atoms.positions, kernel, comm)?;
    let known = KnownAtoms {
        atoms,
        global_ids: None,
        global_count: atom_count,
    };
    Ok((known, (mesh.tets, neighbours)))
}

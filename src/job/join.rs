//! The step from atoms at rest to a mesh, which differs between the plane and space.

use std::borrow::Cow;

use super::checkpoint::Codec;
use super::distributed::{self, PartitionResult};
use super::padding::{self, PaddingCells};
use super::spec::Padding;
use super::topography::Topography;
use super::{Outcome, Params, RunOptions, StageRunner, mesh_verb};
use crate::comm::{Comm, SelfComm};
use crate::error::cause;
use crate::feature::{FeaturePoint, Features};
use crate::geometry::to_3d;
use crate::image::{Geometry, ImageSource};
use crate::improve::feature_planes::FeaturePlanes;
use crate::improve::tets::{DistributedSlabs, ImproveContext, KnownAtoms, SharedWork};
use crate::improve::{
    self, ImproveReport, ReshapeError, ReshapeRequest, ReshapeResult, SealReport, SliverMethod,
    Target, tets, triangles,
};
use crate::lattice::AtomKind;
use crate::lattice::distance::{Distance, DistributedDistance};
use crate::lattice::owned_atoms::OwnedAtoms;
use crate::lattice::seeding::Atoms;
use crate::mesh::delaunay::{self, Delaunay, DelaunayKernel};
use crate::mesh::poly::PolyMesh;
use crate::mesh::view::MeshView;
use crate::mesh::voronoi;
use crate::mesh::{Dimension, Simplices, Space as MeshSpace, TetMesh, TriMesh};
use crate::progress::{CancelToken, Progress, Stage};
use crate::published::relax::{self, Relaxation};
use crate::report::{AngleAssessment, Improvement, PaddingReport};
use crate::{Error, Result};

/// A space in which meshes are made.
pub trait Meshing<const D: usize>: Dimension<D, Mesh: Simplices<D> + Codec> {
    /// Runs a job as [`run_from`](super::run_from) does. It is compiled once with this crate and
    /// not again in each crate that meshes.
    ///
    /// # Errors
    /// Returns the errors of [`run_from`](super::run_from).
    fn run(
        source: ImageSource<'_, D>,
        params: &Params<D>,
        run_options: RunOptions<'_>,
        progress: &mut dyn Progress,
    ) -> Result<Outcome<D>>
    where
        MeshSpace<D>: Meshing<D>;

    /// Snaps the atoms that are close to a feature onto it, joins all atoms, and improves the mesh
    /// until every angle is at least as large as `improvement` requires, if that is possible.
    /// Without `improvement` the atoms are only joined. In the plane, the triangulation is smoothed
    /// before that as `relaxation` says. If the job is stopped, smoothing and improvement end
    /// early.
    ///
    /// # Errors
    /// Returns the errors of the triangulation.
    fn join(
        atoms: Atoms<D>,
        scene: &MeshScene<'_, D>,
        relaxation: Option<&Relaxation<D>>,
        improvement: Option<&Target>,
        stages: &mut StageRunner<'_>,
    ) -> Result<JoinedMesh<Self::Mesh>>;

    /// Makes and measures a mesh that is distributed over ranks. Each rank has a share of the atoms
    /// and of the distance, of which `scene` has the outline. Returns `None` if the mesh is too
    /// small to be divided.
    ///
    /// # Errors
    /// Returns the errors of [`join`](Self::join), and those of other ranks.
    fn join_distributed(
        _: &mut OwnedAtoms<D>,
        _: &MeshScene<'_, D>,
        _: &DistributedDistance<D>,
        _: Option<&Target>,
        _: &mut StageRunner<'_>,
    ) -> Result<Option<PartitionResult<Self::Mesh, D>>> {
        Ok(None)
    }

    /// Continues a mesh of tetrahedra beyond its image, as the options say. Returns `None` if the job is
    /// stopped, and in the plane.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for padding that is too thin and a topography that is too steep, and the errors
    /// of the triangulation.
    fn pad(
        _: &Self::Mesh,
        _: &Padding,
        _: Option<&Topography>,
        _: &MeshScene<'_, D>,
        _: &Geometry<D>,
        _: f64,
        _: &mut StageRunner<'_>,
    ) -> Result<Option<(PaddingCells<D>, PaddingReport)>> {
        Ok(None)
    }

    /// Joins the atoms of a part of a mesh again, after atoms have been added, removed and moved.
    /// The rest of the mesh and the part's outer faces do not change.
    ///
    /// # Errors
    /// Returns the node that cannot be moved to its target or cannot be removed, or another error.
    fn rejoin(
        part: Self::Mesh,
        request: ReshapeRequest<D>,
        scene: &MeshScene<'_, D>,
        min_angle: f64,
    ) -> std::result::Result<ReshapeResult<Self::Mesh>, ReshapeError>;

    /// Returns the Voronoi cells of atoms inside the box `[0, extent]`, clipped to it, with welded
    /// nodes.
    ///
    /// # Errors
    /// Returns the errors of [`voronoi_welded`](crate::mesh::voronoi::voronoi_welded).
    fn voronoi_cells(
        atoms: &[[f64; D]],
        extent: [f64; D],
        weld: f64,
        comm: &dyn Comm,
    ) -> Result<PolyMesh<D>>;

    /// Returns the features as local planes. Features of the plane become planes that are
    /// perpendicular to it.
    fn local_planes(scene: &MeshScene<'_, D>) -> FeaturePlanes;

    /// Converts a feature point to one in space.
    fn point_in_space(point: &FeaturePoint<D>) -> FeaturePoint<3>;
}

/// The box, the features and the nominal distance with which atoms are joined.
#[derive(Debug, Clone, Copy)]
pub struct MeshScene<'a, const D: usize> {
    /// The far corner of the box.
    pub extent: [f64; D],
    /// The features that the mesh follows.
    pub features: &'a Features<D>,
    /// Nominal distance between nodes.
    pub distance: &'a Distance<D>,
}

/// A mesh of simplices, with data on its nodes, faces and cells.
#[derive(Debug, Clone)]
pub struct AnnotatedMesh<M> {
    /// The mesh.
    pub mesh: M,
    /// The kind of each node, which says how it may move.
    pub node_kinds: Vec<AtomKind>,
    /// For each cell, bit k: its face (edge, in the plane) k, opposite node k, lies on a feature.
    pub feature_faces: Vec<u8>,
    /// The region of each cell; empty if the image has no labels.
    pub regions: Vec<i32>,
    /// Which angles the features explain; empty until the mesh is measured.
    pub angle_assessment: AngleAssessment,
}

/// A mesh into which atoms were joined.
#[derive(Debug)]
pub struct JoinedMesh<M> {
    /// The mesh.
    pub annotated_mesh: AnnotatedMesh<M>,
    /// For every cell and face, in order, the cell on the other side, if known.
    pub neighbours: Option<Vec<u32>>,
    /// Report of the improvement, if there was one.
    pub improvement: Option<Improvement>,
    /// For exudation, the mesh that Joe's transformations make of the same atoms, and its faces on
    /// features.
    pub baseline: Option<(M, Vec<u8>)>,
}

impl<M> JoinedMesh<M> {
    /// Returns a mesh that is not improved.
    fn unimproved<const D: usize>(
        mesh: M,
        kinds: Vec<AtomKind>,
        neighbours: Option<Vec<u32>>,
    ) -> Self
    where
        M: Simplices<D>,
    {
        Self {
            annotated_mesh: AnnotatedMesh {
                feature_faces: vec![0; mesh.len()],
                mesh,
                node_kinds: kinds,
                regions: Vec::new(),
                angle_assessment: AngleAssessment::default(),
            },
            neighbours,
            improvement: None,
            baseline: None,
        }
    }
}

/// Radius of the patches from which local planes of features are fitted, in units of d. It is
/// clamped to 2 to 6.5 samples; from 3 samples on, a patch of a curve contains four points.
const PATCH_RADIUS: f64 = 0.8;

/// Distance from a feature, in units of d, below which atoms are snapped onto it before they are
/// joined.
const SNAP_RADIUS: f64 = 0.35;

/// Returns the features as local planes. `points` and `extent` are in space.
pub(super) fn planes_near<const D: usize>(
    points: &[FeaturePoint<3>],
    extent: [f64; 3],
    distance: &Distance<D>,
) -> FeaturePlanes {
    let min_radius = if D == 2 { 3.0 } else { 2.0 };
    let radius = (PATCH_RADIUS * distance.min()).clamp(min_radius, 6.5);
    FeaturePlanes::new(points, extent, radius, search_radius(distance))
}

/// Returns the distance within which features are searched. An edge is at most 1.7 d long, and a
/// feature that it intersects is within half of that from one of its ends.
pub(super) fn search_radius<const D: usize>(distance: &Distance<D>) -> f64 {
    0.85 * distance.max() + 1.5
}

/// Snaps the atoms that are close to a feature onto it. Returns the features as local planes.
fn snap_to_planes<const D: usize>(
    positions: &mut [[f64; D]],
    kinds: &[AtomKind],
    scene: &MeshScene<'_, D>,
) -> FeaturePlanes
where
    MeshSpace<D>: Meshing<D>,
{
    let planes = MeshSpace::<D>::local_planes(scene);
    let max_distance = snap_distance(scene);
    improve::snap_to_features(positions, kinds, scene.extent, &planes, max_distance);
    planes
}

/// Returns the distance within which atoms are snapped onto features.
pub(super) fn snap_distance<const D: usize>(scene: &MeshScene<'_, D>) -> f64 {
    SNAP_RADIUS * scene.distance.min()
}

/// Adds the faces that close holes to the faces on features (`marks`), or on the feature surface of
/// this number alone.
pub(super) fn close_holes<const D: usize>(
    mesh: &<MeshSpace<D> as Dimension<D>>::Mesh,
    neighbours: &[u32],
    scene: &MeshScene<'_, D>,
    surface: Option<u32>,
    marks: &mut [u8],
    cancel: &CancelToken<'_>,
) -> Result<SealReport>
where
    MeshSpace<D>: Meshing<D>,
{
    let points = points_in_space(scene, surface);
    let (view, extent, d_max) = (
        MeshView::from_mesh(mesh),
        scene.extent,
        scene.distance.max(),
    );
    let distance = |_: &[[f64; D]]| Ok(Cow::Borrowed(scene.distance));
    improve::seal(
        &view, neighbours, &points, extent, d_max, distance, marks, cancel,
    )
}

/// Returns the feature points in space, or those of the feature surface of this number alone.
pub(super) fn points_in_space<const D: usize>(
    scene: &MeshScene<'_, D>,
    surface: Option<u32>,
) -> Vec<FeaturePoint<3>>
where
    MeshSpace<D>: Meshing<D>,
{
    let features = scene.features;
    let is_selected = |index: usize| surface.is_none_or(|s| features.surface[index] == s);
    let points = features.points.iter().enumerate();
    let selected = points.filter(|(index, _)| is_selected(*index));
    selected
        .map(|(_, point)| MeshSpace::<D>::point_in_space(point))
        .collect()
}

/// Closes holes in a part of a mesh.
fn close_partition_holes<const D: usize>(
    mut part: ReshapeResult<<MeshSpace<D> as Dimension<D>>::Mesh>,
    scene: &MeshScene<'_, D>,
) -> std::result::Result<ReshapeResult<<MeshSpace<D> as Dimension<D>>::Mesh>, ReshapeError>
where
    MeshSpace<D>: Meshing<D>,
{
    let neighbours = cell_neighbours(&part.mesh).map_err(ReshapeError::Mesh)?;
    let (marks, cancel) = (&mut part.feature_faces, CancelToken::never());
    close_holes(&part.mesh, &neighbours, scene, None, marks, &cancel)
        .map_err(ReshapeError::Mesh)?;
    Ok(part)
}

/// Returns for every cell and face, in order, the cell on the other side, or `NONE`.
///
/// # Errors
/// Returns [`Error::Mesh`] if a face belongs to more than two cells.
pub(super) fn cell_neighbours<const D: usize, M: Simplices<D>>(mesh: &M) -> Result<Vec<u32>> {
    mesh.neighbours().map_err(|face| {
        Error::Mesh(cause(
            format!("face {face:?}"),
            format!("belongs to more than two {}", M::CELLS_NAME),
            "mesh the image again",
        ))
    })
}

/// Improves a whole mesh slab by slab, as [`tets::improve`] does it at once.
fn improve_slabs(
    mesh: &mut TetMesh,
    neighbours: &mut Vec<[u32; 4]>,
    kinds: &mut Vec<AtomKind>,
    slabs: &DistributedSlabs<'_>,
    context: ImproveContext<'_>,
    cancel: &CancelToken<'_>,
) -> Result<(ImproveReport, Vec<u8>)> {
    let TetMesh { nodes, tets } = std::mem::take(mesh);
    let joined = std::mem::take(neighbours);
    let atoms = KnownAtoms {
        global_count: nodes.len(),
        atoms: Atoms {
            positions: nodes,
            kinds: std::mem::take(kinds),
        },
        global_ids: None,
    };
    let improved = slabs.improve(atoms, tets, joined, context, cancel)?;
    let improved = slabs.all_gather(improved)?;
    (*mesh, *neighbours) = (improved.partition.mesh, improved.partition.neighbours);
    *kinds = improved.kinds;
    Ok((improved.report, improved.feature_faces))
}

impl Meshing<3> for MeshSpace<3> {
    fn run(
        source: ImageSource<'_, 3>,
        params: &Params<3>,
        run_options: RunOptions<'_>,
        progress: &mut dyn Progress,
    ) -> Result<Outcome<3>> {
        mesh_verb::run_precompiled(source, params, run_options, progress)
    }

    fn join_distributed(
        atoms: &mut OwnedAtoms<3>,
        scene: &MeshScene<'_, 3>,
        distance: &DistributedDistance<3>,
        target: Option<&Target>,
        stages: &mut StageRunner<'_>,
    ) -> Result<Option<PartitionResult<TetMesh, 3>>> {
        distributed::make_partition(atoms, scene, distance, target, stages)
    }

    fn pad(
        mesh: &TetMesh,
        padding: &Padding,
        topography: Option<&Topography>,
        scene: &MeshScene<'_, 3>,
        geometry: &Geometry<3>,
        min_dihedral: f64,
        stages: &mut StageRunner<'_>,
    ) -> Result<Option<(PaddingCells<3>, PaddingReport)>> {
        padding::pad(
            mesh,
            padding,
            topography,
            scene,
            geometry,
            min_dihedral,
            stages,
        )
    }

    fn join(
        mut atoms: Atoms<3>,
        scene: &MeshScene<'_, 3>,
        _: Option<&Relaxation<3>>,
        improvement: Option<&Target>,
        stages: &mut StageRunner<'_>,
    ) -> Result<JoinedMesh<TetMesh>> {
        let (extent, distance, comm) = (scene.extent, scene.distance, stages.comm);
        let kernel = stages.kernel;
        // The cuts are at the same places, whether this rank has all atoms or not.
        let slabs = match improvement {
            Some(_) => DistributedSlabs::cut(&atoms.positions, extent, distance, &SelfComm)?,
            None => None,
        };
        let slabs = slabs.map(|slabs| DistributedSlabs::new(slabs.cuts, comm));
        let Atoms { positions, kinds } = &mut atoms;
        let planes = improvement.map(|_| snap_to_planes(positions, kinds, scene));
        stages.begin(Stage::Triangulating);
        let Delaunay {
            mut mesh,
            mut neighbours,
        } = stages.load_or_run("4-joined", |_| {
            delaunay::distributed_delaunay_with_neighbours(&atoms.positions, kernel, comm)
        })?;
        let mut kinds = atoms.kinds;
        let (Some(&target), Some(planes)) = (improvement, &planes) else {
            return Ok(JoinedMesh::unimproved(
                mesh,
                kinds,
                Some(neighbours.into_flattened()),
            ));
        };
        let context = ImproveContext {
            extent,
            planes,
            distance,
            target,
        };
        let (mut baseline, work) = (None, SharedWork::among(comm));
        let (neighbours, (outcome, feature_faces)) = match target.method {
            SliverMethod::Joe => {
                stages.begin(Stage::Improving);
                let result = stages.run_cancellable(|cancel| match &slabs {
                    Some(slabs) => {
                        let (mesh, neighbours) = (&mut mesh, &mut neighbours);
                        improve_slabs(mesh, neighbours, &mut kinds, slabs, context, cancel)
                    }
                    None => {
                        let (mesh, neighbours) = (&mut mesh, &mut neighbours);
                        tets::improve(mesh, neighbours, &mut kinds, context, work, cancel)
                    }
                })?;
                (Some(neighbours.into_flattened()), result)
            }
            SliverMethod::Exude | SliverMethod::ExudeCgal => {
                stages.begin(Stage::ApplyingBaseline);
                let (mut baseline_mesh, mut baseline_kinds) = (mesh.clone(), kinds.clone());
                let (_, faces) = stages.run_cancellable(|cancel| {
                    let (mesh, neighbours) = (&mut baseline_mesh, &mut neighbours.clone());
                    tets::improve(mesh, neighbours, &mut baseline_kinds, context, work, cancel)
                })?;
                baseline = Some((baseline_mesh, faces));
                stages.begin(Stage::Improving);
                let result = stages.run_cancellable(|cancel| {
                    tets::exude(&mut mesh, neighbours, &mut kinds, context, work, cancel)
                })?;
                (None, result)
            }
        };
        Ok(JoinedMesh {
            annotated_mesh: AnnotatedMesh {
                mesh,
                node_kinds: kinds,
                feature_faces,
                regions: Vec::new(),
                angle_assessment: AngleAssessment::default(),
            },
            neighbours,
            improvement: Some(Improvement::from(&outcome)),
            baseline,
        })
    }

    fn rejoin(
        part: TetMesh,
        mut request: ReshapeRequest<3>,
        scene: &MeshScene<'_, 3>,
        min_angle: f64,
    ) -> std::result::Result<ReshapeResult<TetMesh>, ReshapeError> {
        let (extent, distance) = (scene.extent, scene.distance);
        let planes = snap_to_planes(&mut request.targets, &request.kinds, scene);
        let context = ImproveContext {
            extent,
            planes: &planes,
            distance,
            target: Target {
                min_dihedral: min_angle,
                ..Target::default()
            },
        };
        let part = tets::reshape(part, &request, context)?;
        close_partition_holes(part, scene)
    }

    fn voronoi_cells(
        atoms: &[[f64; 3]],
        extent: [f64; 3],
        weld: f64,
        comm: &dyn Comm,
    ) -> Result<PolyMesh<3>> {
        voronoi::voronoi_by(atoms, extent, weld, |points| {
            delaunay::distributed_delaunay(points, DelaunayKernel::Auto, comm)
        })
    }

    fn local_planes(scene: &MeshScene<'_, 3>) -> FeaturePlanes {
        planes_near(&scene.features.points, scene.extent, scene.distance)
    }

    fn point_in_space(point: &FeaturePoint<3>) -> FeaturePoint<3> {
        *point
    }
}

impl Meshing<2> for MeshSpace<2> {
    fn run(
        source: ImageSource<'_, 2>,
        params: &Params<2>,
        run_options: RunOptions<'_>,
        progress: &mut dyn Progress,
    ) -> Result<Outcome<2>> {
        mesh_verb::run_precompiled(source, params, run_options, progress)
    }

    fn join(
        mut atoms: Atoms<2>,
        scene: &MeshScene<'_, 2>,
        relaxation: Option<&Relaxation<2>>,
        improvement: Option<&Target>,
        stages: &mut StageRunner<'_>,
    ) -> Result<JoinedMesh<TriMesh>> {
        let (extent, distance) = (scene.extent, scene.distance);
        let needs_planes = improvement.is_some() || relaxation.is_some();
        let Atoms { positions, kinds } = &mut atoms;
        let planes = needs_planes.then(|| snap_to_planes(positions, kinds, scene));
        stages.begin(Stage::Triangulating);
        let mut mesh = match (relaxation, &planes) {
            (Some(relaxation), Some(planes)) => {
                stages.begin(Stage::Smoothing);
                let mobility = triangles::mobility(&atoms, extent, planes);
                let feature_edges = triangles::feature_edges(&atoms, extent, planes, distance)?;
                stages
                    .run_cancellable(|cancel| {
                        let points = atoms.positions;
                        relax::relax(points, &feature_edges, &mobility, relaxation, cancel)
                    })?
                    .0
            }
            _ => delaunay::delaunay_plane(&atoms.positions)?,
        };
        let mut kinds = atoms.kinds;
        let (Some(options), Some(planes)) = (improvement, &planes) else {
            return Ok(JoinedMesh::unimproved(mesh, kinds, None));
        };
        stages.begin(Stage::Improving);
        let (outcome, feature_faces) = stages.run_cancellable(|cancel| {
            triangles::improve(
                &mut mesh,
                &mut kinds,
                extent,
                planes,
                distance,
                options.min_dihedral,
                cancel,
            )
        })?;
        Ok(JoinedMesh {
            annotated_mesh: AnnotatedMesh {
                mesh,
                node_kinds: kinds,
                feature_faces,
                regions: Vec::new(),
                angle_assessment: AngleAssessment::default(),
            },
            neighbours: None,
            improvement: Some(Improvement::from(&outcome)),
            baseline: None,
        })
    }

    fn rejoin(
        part: TriMesh,
        mut request: ReshapeRequest<2>,
        scene: &MeshScene<'_, 2>,
        min_angle: f64,
    ) -> std::result::Result<ReshapeResult<TriMesh>, ReshapeError> {
        let (extent, distance) = (scene.extent, scene.distance);
        let planes = snap_to_planes(&mut request.targets, &request.kinds, scene);
        let part = triangles::reshape(&part, &request, extent, &planes, distance, min_angle)?;
        close_partition_holes(part, scene)
    }

    fn voronoi_cells(
        atoms: &[[f64; 2]],
        extent: [f64; 2],
        weld: f64,
        _: &dyn Comm,
    ) -> Result<PolyMesh<2>> {
        voronoi::voronoi_plane_welded(atoms, extent, weld)
    }

    fn local_planes(scene: &MeshScene<'_, 2>) -> FeaturePlanes {
        // Curves in the plane become surfaces that are perpendicular to it.
        let points = scene.features.points.iter().map(Self::point_in_space);
        let points: Vec<FeaturePoint<3>> = points.collect();
        planes_near(&points, to_3d(scene.extent), scene.distance)
    }

    fn point_in_space(point: &FeaturePoint<2>) -> FeaturePoint<3> {
        FeaturePoint {
            position: to_3d(point.position),
            normal: to_3d(point.normal),
            strength: point.strength,
        }
    }
}

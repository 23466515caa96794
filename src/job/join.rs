//! How atoms at rest become a mesh: what differs between the plane and space.

use super::checkpoint::Codec;
use super::distributed::{self, PartitionResult};
use super::{Outcome, Params, RunOptions, StageRunner, run};
use crate::comm::{SelfComm, WorldComm};
use crate::error::cause;
use crate::feature::{FeaturePoint, Features};
use crate::geometry::to_3d;
use crate::image::ImageSource;
use crate::improve::feature_planes::FeaturePlanes;
use crate::improve::tets::{KnownAtoms, SlabContext, SlabCuts};
use crate::improve::triangles::relax::Relaxation;
use crate::improve::{
    self, ReshapeError, ReshapeRequest, ReshapeResult, SealReport, SliverMethod, Target, tets,
    triangles,
};
use crate::lattice::AtomKind;
use crate::lattice::distance::{Distance, DistributedDistance};
use crate::lattice::partition::OwnedAtoms;
use crate::lattice::seeding::Atoms;
use crate::mesh::delaunay::{self, Delaunay};
use crate::mesh::poly::PolyMesh;
use crate::mesh::voronoi;
use crate::mesh::{Simplices, TetMesh, TriMesh};
use crate::progress::{CancelToken, Progress, Stage};
use crate::report::{AngleAssessment, Improvement};
use crate::{Error, Result};

/// The plane (`D` = 2) or space (`D` = 3).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MeshSpace<const D: usize>;

/// A space in which meshes are made.
pub trait Meshing<const D: usize> {
    /// What is made: triangles or tetrahedra.
    type Mesh: Simplices<D> + Codec;

    /// [`run_from`](super::run_from) in this space, compiled with this crate and not again with each that
    /// meshes.
    ///
    /// # Errors
    /// Those of [`run_from`](super::run_from).
    fn run(
        source: ImageSource<'_, D>,
        params: &Params<D>,
        way: RunOptions<'_>,
        observer: &mut dyn Progress,
    ) -> Result<Outcome<D>>
    where
        MeshSpace<D>: Meshing<D>;

    /// Puts the atoms that are next to a feature onto it, joins all and improves the result until
    /// every angle is at least as large as `improvement` asks, where that can be; without it, only
    /// joins. Before that a triangulation of the plane is smoothed as `relaxation` says. Smoothing and
    /// improvement end where they are when they are stopped.
    ///
    /// # Errors
    /// Those of the triangulation.
    fn join(
        atoms: Atoms<D>,
        scene: &MeshScene<'_, D>,
        relaxation: Option<&Relaxation<D>>,
        improvement: Option<&Target>,
        stages: &mut StageRunner<'_>,
    ) -> Result<JoinedMesh<Self::Mesh>>;

    /// The mesh of atoms in pieces, each made and measured by one of the ranks, which have shares of the atoms and of the
    /// distance, of which the scene has the outline; none if it is not large enough.
    ///
    /// # Errors
    /// As [`join`](Self::join), and those of other ranks.
    fn join_distributed(
        _: &mut OwnedAtoms<D>,
        _: &MeshScene<'_, D>,
        _: &DistributedDistance<D>,
        _: Option<&Target>,
        _: &mut StageRunner<'_>,
    ) -> Result<Option<PartitionResult<Self::Mesh, D>>> {
        Ok(None)
    }

    /// [`join`](Self::join) for a part of a mesh whose atoms have come, gone and moved. The rest of the mesh stays,
    /// and so do the part's outer faces.
    ///
    /// # Errors
    /// The node that cannot be put where it must be, or cannot go; or what else is wrong.
    fn rejoin(
        part: Self::Mesh,
        wanted: ReshapeRequest<D>,
        scene: &MeshScene<'_, D>,
        min_angle: f64,
    ) -> std::result::Result<ReshapeResult<Self::Mesh>, ReshapeError>;

    /// The Voronoi cells of atoms inside the box `[0, extent]`, cut by it, their nodes welded.
    ///
    /// # Errors
    /// Those of [`voronoi_welded`](crate::mesh::voronoi::voronoi_welded).
    fn voronoi_cells(atoms: &[[f64; D]], extent: [f64; D], weld: f64) -> Result<PolyMesh<D>>;

    /// The features as local planes; those of the plane stand upright on it.
    fn local_planes(scene: &MeshScene<'_, D>) -> FeaturePlanes;

    /// A feature point as one of space.
    fn point_in_space(point: &FeaturePoint<D>) -> FeaturePoint<3>;
}

/// What is known about the space in which atoms are joined.
#[derive(Debug, Clone, Copy)]
pub struct MeshScene<'a, const D: usize> {
    /// The far corner of the box.
    pub extent: [f64; D],
    /// What the mesh follows.
    pub features: &'a Features<D>,
    /// Nominal distance between nodes.
    pub distance: &'a Distance<D>,
}

/// A mesh of simplices, and what is known of its nodes and faces.
#[derive(Debug, Clone)]
pub struct AnnotatedMesh<M> {
    /// The mesh.
    pub mesh: M,
    /// What each node may do.
    pub node_kinds: Vec<AtomKind>,
    /// For each cell, bit k: its face (edge, in the plane) k, opposite node k, lies on a feature.
    pub feature_faces: Vec<u8>,
    /// The region of each cell; empty if the image has no labels.
    pub regions: Vec<i32>,
    /// Which angles the features explain; empty until the mesh is measured.
    pub angle_assessment: AngleAssessment,
}

/// Atoms joined to a mesh.
#[derive(Debug)]
pub struct JoinedMesh<M> {
    /// The mesh.
    pub annotated_mesh: AnnotatedMesh<M>,
    /// For every cell and face, in order, the cell on its other side, where that is known.
    pub neighbors: Option<Vec<u32>>,
    /// What was improved, if anything should be.
    pub improvement: Option<Improvement>,
    /// Where exudation was asked for, what Joe's transformations make of the same atoms.
    pub baseline: Option<(M, Vec<u8>)>,
}

impl<M> JoinedMesh<M> {
    /// Of which nothing shall be improved.
    fn unimproved<const D: usize>(
        mesh: M,
        kinds: Vec<AtomKind>,
        neighbors: Option<Vec<u32>>,
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
            neighbors,
            improvement: None,
            baseline: None,
        }
    }
}

/// Radius of the patches by which features are known locally, in units of d (and from 2 to 6.5; a patch
/// of a curve holds four points from 3 on).
const PATCH_RADIUS: f64 = 0.8;

/// Atoms this near to a feature, in units of d, are put onto it before they are joined.
const SNAP_RADIUS: f64 = 0.35;

/// The features as local planes; `points` and `extent` in space.
pub(super) fn planes_near<const D: usize>(
    points: &[FeaturePoint<3>],
    extent: [f64; 3],
    distance: &Distance<D>,
) -> FeaturePlanes {
    let least = if D == 2 { 3.0 } else { 2.0 };
    let radius = (PATCH_RADIUS * distance.min()).clamp(least, 6.5);
    FeaturePlanes::new(points, extent, radius, search_radius(distance))
}

/// From how far features are looked for: an edge is at most 1.7 d long, and what it pierces is within half of that of
/// one of its ends.
pub(super) fn search_radius<const D: usize>(distance: &Distance<D>) -> f64 {
    0.85 * distance.max() + 1.5
}

/// Puts the atoms that are next to a feature onto it; gives the features as local planes.
fn snap_to_sheets<const D: usize>(
    positions: &mut [[f64; D]],
    kinds: &[AtomKind],
    scene: &MeshScene<'_, D>,
) -> FeaturePlanes
where
    MeshSpace<D>: Meshing<D>,
{
    let sheets = MeshSpace::<D>::local_planes(scene);
    let reach = snap_distance(scene);
    improve::snap_to_features(positions, kinds, scene.extent, &sheets, reach);
    sheets
}

/// From how far atoms are put onto features.
pub(super) fn snap_distance<const D: usize>(scene: &MeshScene<'_, D>) -> f64 {
    SNAP_RADIUS * scene.distance.min()
}

/// Adds to the faces on features (`marks`) those that close holes.
pub(super) fn close_holes<const D: usize>(
    mesh: &<MeshSpace<D> as Meshing<D>>::Mesh,
    neighbors: &[u32],
    scene: &MeshScene<'_, D>,
    marks: &mut [u8],
    patience: &CancelToken<'_>,
) -> SealReport
where
    MeshSpace<D>: Meshing<D>,
{
    let points = scene
        .features
        .points
        .iter()
        .map(MeshSpace::<D>::point_in_space);
    let points: Vec<FeaturePoint<3>> = points.collect();
    let (extent, distance) = (scene.extent, scene.distance);
    improve::seal(mesh, neighbors, &points, extent, distance, marks, patience)
}

/// The same in a part of a mesh.
fn close_partition_holes<const D: usize>(
    mut part: ReshapeResult<<MeshSpace<D> as Meshing<D>>::Mesh>,
    scene: &MeshScene<'_, D>,
) -> std::result::Result<ReshapeResult<<MeshSpace<D> as Meshing<D>>::Mesh>, ReshapeError>
where
    MeshSpace<D>: Meshing<D>,
{
    let neighbors = cell_neighbours(&part.mesh).map_err(ReshapeError::Mesh)?;
    let (marks, patience) = (&mut part.feature_faces, CancelToken::never());
    close_holes(&part.mesh, &neighbors, scene, marks, &patience);
    Ok(part)
}

/// For every cell and face, in order, the cell on its other side, or `NONE`.
pub(super) fn cell_neighbours<const D: usize, M: Simplices<D>>(mesh: &M) -> Result<Vec<u32>> {
    mesh.neighbors().map_err(|face| {
        Error::Mesh(cause(
            format!("face {face:?}"),
            format!("belongs to more than two {}", M::CELLS_NAME),
            "mesh the image again",
        ))
    })
}

impl Meshing<3> for MeshSpace<3> {
    type Mesh = TetMesh;

    fn run(
        source: ImageSource<'_, 3>,
        params: &Params<3>,
        way: RunOptions<'_>,
        observer: &mut dyn Progress,
    ) -> Result<Outcome<3>> {
        run::run_precompiled(source, params, way, observer)
    }

    fn join_distributed(
        share: &mut OwnedAtoms<3>,
        scene: &MeshScene<'_, 3>,
        distance: &DistributedDistance<3>,
        target: Option<&Target>,
        stages: &mut StageRunner<'_>,
    ) -> Result<Option<PartitionResult<TetMesh, 3>>> {
        distributed::make_partition(share, scene, distance, target, stages)
    }

    fn join(
        mut atoms: Atoms<3>,
        scene: &MeshScene<'_, 3>,
        _: Option<&Relaxation<3>>,
        improvement: Option<&Target>,
        stages: &mut StageRunner<'_>,
    ) -> Result<JoinedMesh<TetMesh>> {
        let (extent, distance) = (scene.extent, scene.distance);
        // Whether all of it is here or not, it is cut at the same places.
        let cuts = match improvement {
            Some(_) => SlabCuts::new(&atoms.positions, extent, distance, &SelfComm)?,
            None => None,
        };
        let Atoms { positions, kinds } = &mut atoms;
        let sheets = improvement.map(|_| snap_to_sheets(positions, kinds, scene));
        stages.begin(Stage::Triangulating);
        let Delaunay {
            mut mesh,
            mut neighbors,
        } = stages.load_or_run("4-joined", |_| {
            delaunay::delaunay_with_neighbors(&atoms.positions)
        })?;
        let mut kinds = atoms.kinds;
        let (Some(options), Some(sheets)) = (improvement, &sheets) else {
            return Ok(JoinedMesh::unimproved(
                mesh,
                kinds,
                Some(neighbors.into_flattened()),
            ));
        };
        let mut rival = None;
        let (neighbors, (outcome, feature_faces)) = match options.method {
            SliverMethod::Joe => {
                stages.begin(Stage::Improving);
                stages.run_cancellable(|patience| match &cuts {
                    Some(cuts) => {
                        let aim = SlabContext {
                            extent,
                            planes: sheets,
                            distance,
                            target: options,
                        };
                        let TetMesh { nodes, tets } = std::mem::take(&mut mesh);
                        let joined = (tets, std::mem::take(&mut neighbors));
                        let atoms = KnownAtoms {
                            global_count: nodes.len(),
                            atoms: Atoms {
                                positions: nodes,
                                kinds: std::mem::take(&mut kinds),
                            },
                            global_ids: None,
                        };
                        let made =
                            tets::improve_in_slabs(atoms, joined, cuts, aim, &WorldComm, patience)?;
                        let made = made.all_gather(&WorldComm)?;
                        (mesh, kinds) = (made.partition.mesh, made.kinds);
                        let around = made.partition.neighbors.into_flattened();
                        Ok((Some(around), (made.report, made.feature_faces)))
                    }
                    None => {
                        let done = tets::improve(
                            &mut mesh,
                            &mut neighbors,
                            &mut kinds,
                            extent,
                            sheets,
                            distance,
                            options,
                            patience,
                        )?;
                        Ok::<_, Error>((Some(neighbors.into_flattened()), done))
                    }
                })?
            }
            SliverMethod::Exude => {
                stages.begin(Stage::ApplyingBaseline);
                let (mut other, mut their_kinds) = (mesh.clone(), kinds.clone());
                let (_, faces) = stages.run_cancellable(|patience| {
                    tets::improve(
                        &mut other,
                        &mut neighbors.clone(),
                        &mut their_kinds,
                        extent,
                        sheets,
                        distance,
                        options,
                        patience,
                    )
                })?;
                rival = Some((other, faces));
                stages.begin(Stage::Improving);
                let done = stages.run_cancellable(|patience| {
                    tets::exude(
                        &mut mesh, neighbors, &mut kinds, extent, sheets, distance, options,
                        patience,
                    )
                })?;
                (None, done)
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
            neighbors,
            improvement: Some(Improvement::from(&outcome)),
            baseline: rival,
        })
    }

    fn rejoin(
        part: TetMesh,
        mut wanted: ReshapeRequest<3>,
        scene: &MeshScene<'_, 3>,
        min_angle: f64,
    ) -> std::result::Result<ReshapeResult<TetMesh>, ReshapeError> {
        let (extent, distance) = (scene.extent, scene.distance);
        let sheets = snap_to_sheets(&mut wanted.targets, &wanted.kinds, scene);
        let options = Target {
            min_dihedral: min_angle,
            method: SliverMethod::Joe,
        };
        let part = tets::reshape(part, &wanted, extent, &sheets, distance, &options)?;
        close_partition_holes(part, scene)
    }

    fn voronoi_cells(atoms: &[[f64; 3]], extent: [f64; 3], weld: f64) -> Result<PolyMesh<3>> {
        voronoi::voronoi_welded(atoms, extent, weld)
    }

    fn local_planes(scene: &MeshScene<'_, 3>) -> FeaturePlanes {
        planes_near(&scene.features.points, scene.extent, scene.distance)
    }

    fn point_in_space(point: &FeaturePoint<3>) -> FeaturePoint<3> {
        *point
    }
}

impl Meshing<2> for MeshSpace<2> {
    type Mesh = TriMesh;

    fn run(
        source: ImageSource<'_, 2>,
        params: &Params<2>,
        way: RunOptions<'_>,
        observer: &mut dyn Progress,
    ) -> Result<Outcome<2>> {
        run::run_precompiled(source, params, way, observer)
    }

    fn join(
        mut atoms: Atoms<2>,
        scene: &MeshScene<'_, 2>,
        relaxation: Option<&Relaxation<2>>,
        improvement: Option<&Target>,
        stages: &mut StageRunner<'_>,
    ) -> Result<JoinedMesh<TriMesh>> {
        let (extent, distance) = (scene.extent, scene.distance);
        let wanted = improvement.is_some() || relaxation.is_some();
        let Atoms { positions, kinds } = &mut atoms;
        let sheets = wanted.then(|| snap_to_sheets(positions, kinds, scene));
        stages.begin(Stage::Triangulating);
        let mut mesh = match (relaxation, &sheets) {
            (Some(relaxation), Some(sheets)) => {
                stages.begin(Stage::Smoothing);
                let mobility = triangles::mobility(&atoms, extent, sheets);
                let kept = triangles::feature_edges(&atoms, extent, sheets, distance)?;
                stages
                    .run_cancellable(|patience| {
                        let points = atoms.positions;
                        triangles::relax::relax(points, &kept, &mobility, relaxation, patience)
                    })?
                    .0
            }
            _ => delaunay::delaunay_plane(&atoms.positions)?,
        };
        let mut kinds = atoms.kinds;
        let (Some(options), Some(sheets)) = (improvement, &sheets) else {
            return Ok(JoinedMesh::unimproved(mesh, kinds, None));
        };
        stages.begin(Stage::Improving);
        let (outcome, feature_faces) = stages.run_cancellable(|patience| {
            triangles::improve(
                &mut mesh,
                &mut kinds,
                extent,
                sheets,
                distance,
                options.min_dihedral,
                patience,
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
            neighbors: None,
            improvement: Some(Improvement::from(&outcome)),
            baseline: None,
        })
    }

    fn rejoin(
        part: TriMesh,
        mut wanted: ReshapeRequest<2>,
        scene: &MeshScene<'_, 2>,
        min_angle: f64,
    ) -> std::result::Result<ReshapeResult<TriMesh>, ReshapeError> {
        let (extent, distance) = (scene.extent, scene.distance);
        let sheets = snap_to_sheets(&mut wanted.targets, &wanted.kinds, scene);
        let part = triangles::reshape(&part, &wanted, extent, &sheets, distance, min_angle)?;
        close_partition_holes(part, scene)
    }

    fn voronoi_cells(atoms: &[[f64; 2]], extent: [f64; 2], weld: f64) -> Result<PolyMesh<2>> {
        voronoi::voronoi_plane_welded(atoms, extent, weld)
    }

    fn local_planes(scene: &MeshScene<'_, 2>) -> FeaturePlanes {
        // Curves in the plane are sheets that stand upright on it.
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

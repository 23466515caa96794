//! How atoms at rest become a mesh: what differs between the plane and space.

use super::checkpoint::Kept;
use super::pieces::{self, InPieces};
use super::{Outcome, Params, Stages, Way, run};
use crate::error::cause;
use crate::feature::{FeaturePoint, Features};
use crate::geometry::in_space;
use crate::image::Source;
use crate::improve::sheets::Sheets;
use crate::improve::tets::{Aim, Cuts, KnownAtoms};
use crate::improve::triangles::relax::Relaxation;
use crate::improve::{
    self, Refusal, Reshaped, Sealed, SliverMethod, Target, Wanted, tets, triangles,
};
use crate::lattice::AtomKind;
use crate::lattice::distance::{Distance, Shared};
use crate::lattice::seeding::Atoms;
use crate::lattice::share::OwnAtoms;
use crate::mesh::delaunay::{self, Delaunay};
use crate::mesh::poly::PolyMesh;
use crate::mesh::voronoi;
use crate::mesh::{Simplices, TetMesh, TriMesh};
use crate::observer::{Observer, Patience, Stage};
use crate::ranks::{Alone, Ranks};
use crate::report::{Improvement, Judged};
use crate::{Error, Result};

/// The plane (`D` = 2) or space (`D` = 3).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Space<const D: usize>;

/// A space in which meshes are made.
pub trait Meshing<const D: usize> {
    /// What is made: triangles or tetrahedra.
    type Mesh: Simplices<D> + Kept;

    /// [`run_from`](super::run_from) in this space, compiled with this crate and not again with each that
    /// meshes.
    ///
    /// # Errors
    /// Those of [`run_from`](super::run_from).
    fn run(
        source: Source<'_, D>,
        params: &Params<D>,
        way: Way<'_>,
        observer: &mut dyn Observer,
    ) -> Result<Outcome<D>>
    where
        Space<D>: Meshing<D>;

    /// Puts the atoms that are next to a feature onto it, joins all and improves the result until
    /// every angle is at least as large as `improvement` asks, where that can be; without it, only
    /// joins. Before that a triangulation of the plane is smoothed as `relaxation` says. Smoothing and
    /// improvement end where they are when they are stopped.
    ///
    /// # Errors
    /// Those of the triangulation.
    fn join(
        atoms: Atoms<D>,
        scene: &Scene<'_, D>,
        relaxation: Option<&Relaxation<D>>,
        improvement: Option<&Target>,
        stages: &mut Stages<'_>,
    ) -> Result<Joined<Self::Mesh>>;

    /// The mesh of atoms in pieces, each made and measured by one of the ranks, which have shares of the atoms and of the
    /// distance, of which the scene has the outline; none if it is not large enough.
    ///
    /// # Errors
    /// As [`join`](Self::join), and those of other ranks.
    fn in_pieces(
        _: &mut OwnAtoms<D>,
        _: &Scene<'_, D>,
        _: &Shared<D>,
        _: Option<&Target>,
        _: &mut Stages<'_>,
    ) -> Result<Option<InPieces<Self::Mesh, D>>> {
        Ok(None)
    }

    /// [`join`](Self::join) for a part of a mesh whose atoms have come, gone and moved. The rest of the mesh stays,
    /// and so do the part's outer faces.
    ///
    /// # Errors
    /// The node that cannot be put where it must be, or cannot go; or what else is wrong.
    fn rejoin(
        part: Self::Mesh,
        wanted: Wanted<D>,
        scene: &Scene<'_, D>,
        min_angle: f64,
    ) -> std::result::Result<Reshaped<Self::Mesh>, Refusal>;

    /// The Voronoi cells of atoms inside the box `[0, extent]`, cut by it, their nodes welded.
    ///
    /// # Errors
    /// Those of [`voronoi_welded`](crate::mesh::voronoi::voronoi_welded).
    fn cells(atoms: &[[f64; D]], extent: [f64; D], weld: f64) -> Result<PolyMesh<D>>;

    /// The features as local planes; those of the plane stand upright on it.
    fn sheets(scene: &Scene<'_, D>) -> Sheets;

    /// A feature point as one of space.
    fn in_space(point: &FeaturePoint<D>) -> FeaturePoint<3>;
}

/// What is known about the space in which atoms are joined.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a, const D: usize> {
    /// The far corner of the box.
    pub extent: [f64; D],
    /// What the mesh follows.
    pub features: &'a Features<D>,
    /// Nominal distance between nodes.
    pub distance: &'a Distance<D>,
}

/// A mesh of simplices, and what is known of its nodes and faces.
#[derive(Debug, Clone)]
pub struct Marked<M> {
    /// The mesh.
    pub mesh: M,
    /// What each node may do.
    pub kinds: Vec<AtomKind>,
    /// For each cell, bit k: its face (edge, in the plane) k, opposite node k, lies on a feature.
    pub feature_faces: Vec<u8>,
    /// The region of each cell; empty if the image has no labels.
    pub regions: Vec<i32>,
    /// Which angles the features explain; empty until the mesh is measured.
    pub judged: Judged,
}

/// Atoms joined to a mesh.
#[derive(Debug)]
pub struct Joined<M> {
    /// The mesh.
    pub made: Marked<M>,
    /// For every cell and face, in order, the cell on its other side, where that is known.
    pub neighbors: Option<Vec<u32>>,
    /// What was improved, if anything should be.
    pub improvement: Option<Improvement>,
    /// Where exudation was asked for, what Joe's transformations make of the same atoms.
    pub rival: Option<(M, Vec<u8>)>,
}

impl<M> Joined<M> {
    /// Of which nothing shall be improved.
    fn as_it_is<const D: usize>(mesh: M, kinds: Vec<AtomKind>, neighbors: Option<Vec<u32>>) -> Self
    where
        M: Simplices<D>,
    {
        Self {
            made: Marked {
                feature_faces: vec![0; mesh.len()],
                mesh,
                kinds,
                regions: Vec::new(),
                judged: Judged::default(),
            },
            neighbors,
            improvement: None,
            rival: None,
        }
    }
}

/// Radius of the patches by which features are known locally, in units of d (and from 2 to 6.5; a patch
/// of a curve holds four points from 3 on).
const PATCH: f64 = 0.8;

/// Atoms this near to a feature, in units of d, are put onto it before they are joined.
const SETTLE: f64 = 0.35;

/// The features as local planes; `points` and `extent` in space.
pub(super) fn planes<const D: usize>(
    points: &[FeaturePoint<3>],
    extent: [f64; 3],
    distance: &Distance<D>,
) -> Sheets {
    let least = if D == 2 { 3.0 } else { 2.0 };
    let radius = (PATCH * distance.min()).clamp(least, 6.5);
    Sheets::new(points, extent, radius, reach(distance))
}

/// From how far features are looked for: an edge is at most 1.7 d long, and what it pierces is within half of that of
/// one of its ends.
pub(super) fn reach<const D: usize>(distance: &Distance<D>) -> f64 {
    0.85 * distance.max() + 1.5
}

/// Puts the atoms that are next to a feature onto it; gives the features as local planes.
fn put_onto_sheets<const D: usize>(
    positions: &mut [[f64; D]],
    kinds: &[AtomKind],
    scene: &Scene<'_, D>,
) -> Sheets
where
    Space<D>: Meshing<D>,
{
    let sheets = Space::<D>::sheets(scene);
    let reach = settling(scene);
    improve::settle(positions, kinds, scene.extent, &sheets, reach);
    sheets
}

/// From how far atoms are put onto features.
pub(super) fn settling<const D: usize>(scene: &Scene<'_, D>) -> f64 {
    SETTLE * scene.distance.min()
}

/// Adds to the faces on features (`marks`) those that close holes.
pub(super) fn close_holes<const D: usize>(
    mesh: &<Space<D> as Meshing<D>>::Mesh,
    neighbors: &[u32],
    scene: &Scene<'_, D>,
    marks: &mut [u8],
    patience: &Patience<'_>,
) -> Sealed
where
    Space<D>: Meshing<D>,
{
    let points = scene.features.points.iter().map(Space::<D>::in_space);
    let points: Vec<FeaturePoint<3>> = points.collect();
    let (extent, distance) = (scene.extent, scene.distance);
    improve::seal(mesh, neighbors, &points, extent, distance, marks, patience)
}

/// The same in a part of a mesh.
fn close_holes_of_part<const D: usize>(
    mut part: Reshaped<<Space<D> as Meshing<D>>::Mesh>,
    scene: &Scene<'_, D>,
) -> std::result::Result<Reshaped<<Space<D> as Meshing<D>>::Mesh>, Refusal>
where
    Space<D>: Meshing<D>,
{
    let neighbors = neighbors_of(&part.mesh).map_err(Refusal::Part)?;
    let (marks, patience) = (&mut part.feature_faces, Patience::endless());
    close_holes(&part.mesh, &neighbors, scene, marks, &patience);
    Ok(part)
}

/// For every cell and face, in order, the cell on its other side, or `NONE`.
pub(super) fn neighbors_of<const D: usize, M: Simplices<D>>(mesh: &M) -> Result<Vec<u32>> {
    mesh.neighbors().map_err(|face| {
        Error::Mesh(cause(
            format!("face {face:?}"),
            format!("belongs to more than two {}", M::CELLS),
            "mesh the image again",
        ))
    })
}

impl Meshing<3> for Space<3> {
    type Mesh = TetMesh;

    fn run(
        source: Source<'_, 3>,
        params: &Params<3>,
        way: Way<'_>,
        observer: &mut dyn Observer,
    ) -> Result<Outcome<3>> {
        run::made(source, params, way, observer)
    }

    fn in_pieces(
        share: &mut OwnAtoms<3>,
        scene: &Scene<'_, 3>,
        distance: &Shared<3>,
        target: Option<&Target>,
        stages: &mut Stages<'_>,
    ) -> Result<Option<InPieces<TetMesh, 3>>> {
        pieces::made(share, scene, distance, target, stages)
    }

    fn join(
        mut atoms: Atoms<3>,
        scene: &Scene<'_, 3>,
        _: Option<&Relaxation<3>>,
        improvement: Option<&Target>,
        stages: &mut Stages<'_>,
    ) -> Result<Joined<TetMesh>> {
        let (extent, distance) = (scene.extent, scene.distance);
        // Whether all of it is here or not, it is cut at the same places.
        let cuts = match improvement {
            Some(_) => Cuts::new(&atoms.positions, extent, distance, &Alone)?,
            None => None,
        };
        let Atoms { positions, kinds } = &mut atoms;
        let sheets = improvement.map(|_| put_onto_sheets(positions, kinds, scene));
        stages.begin(Stage::Joining);
        let Delaunay {
            mut mesh,
            mut neighbors,
        } = stages.kept("4-joined", |_| {
            delaunay::delaunay_with_neighbors(&atoms.positions)
        })?;
        let mut kinds = atoms.kinds;
        let (Some(options), Some(sheets)) = (improvement, &sheets) else {
            return Ok(Joined::as_it_is(
                mesh,
                kinds,
                Some(neighbors.into_flattened()),
            ));
        };
        let mut rival = None;
        let (neighbors, (outcome, feature_faces)) = match options.method {
            SliverMethod::Joe => {
                stages.begin(Stage::Improving);
                stages.patiently(|patience| match &cuts {
                    Some(cuts) => {
                        let aim = Aim {
                            extent,
                            sheets,
                            distance,
                            target: options,
                        };
                        let TetMesh { nodes, tets } = std::mem::take(&mut mesh);
                        let joined = (tets, std::mem::take(&mut neighbors));
                        let atoms = KnownAtoms {
                            whole: nodes.len(),
                            atoms: Atoms {
                                positions: nodes,
                                kinds: std::mem::take(&mut kinds),
                            },
                            numbers: None,
                        };
                        let made =
                            tets::improve_in_slabs(atoms, joined, cuts, aim, &Ranks, patience)?;
                        let made = made.whole(&Ranks)?;
                        (mesh, kinds) = (made.piece.mesh, made.kinds);
                        let around = made.piece.neighbors.into_flattened();
                        Ok((Some(around), (made.improved, made.feature_faces)))
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
                stages.begin(Stage::Comparing);
                let (mut other, mut their_kinds) = (mesh.clone(), kinds.clone());
                let (_, faces) = stages.patiently(|patience| {
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
                let done = stages.patiently(|patience| {
                    tets::exude(
                        &mut mesh, neighbors, &mut kinds, extent, sheets, distance, options,
                        patience,
                    )
                })?;
                (None, done)
            }
        };
        Ok(Joined {
            made: Marked {
                mesh,
                kinds,
                feature_faces,
                regions: Vec::new(),
                judged: Judged::default(),
            },
            neighbors,
            improvement: Some(Improvement::from(&outcome)),
            rival,
        })
    }

    fn rejoin(
        part: TetMesh,
        mut wanted: Wanted<3>,
        scene: &Scene<'_, 3>,
        min_angle: f64,
    ) -> std::result::Result<Reshaped<TetMesh>, Refusal> {
        let (extent, distance) = (scene.extent, scene.distance);
        let sheets = put_onto_sheets(&mut wanted.targets, &wanted.kinds, scene);
        let options = Target {
            min_dihedral: min_angle,
            method: SliverMethod::Joe,
        };
        let part = tets::reshape(part, &wanted, extent, &sheets, distance, &options)?;
        close_holes_of_part(part, scene)
    }

    fn cells(atoms: &[[f64; 3]], extent: [f64; 3], weld: f64) -> Result<PolyMesh<3>> {
        voronoi::voronoi_welded(atoms, extent, weld)
    }

    fn sheets(scene: &Scene<'_, 3>) -> Sheets {
        planes(&scene.features.points, scene.extent, scene.distance)
    }

    fn in_space(point: &FeaturePoint<3>) -> FeaturePoint<3> {
        *point
    }
}

impl Meshing<2> for Space<2> {
    type Mesh = TriMesh;

    fn run(
        source: Source<'_, 2>,
        params: &Params<2>,
        way: Way<'_>,
        observer: &mut dyn Observer,
    ) -> Result<Outcome<2>> {
        run::made(source, params, way, observer)
    }

    fn join(
        mut atoms: Atoms<2>,
        scene: &Scene<'_, 2>,
        relaxation: Option<&Relaxation<2>>,
        improvement: Option<&Target>,
        stages: &mut Stages<'_>,
    ) -> Result<Joined<TriMesh>> {
        let (extent, distance) = (scene.extent, scene.distance);
        let wanted = improvement.is_some() || relaxation.is_some();
        let Atoms { positions, kinds } = &mut atoms;
        let sheets = wanted.then(|| put_onto_sheets(positions, kinds, scene));
        stages.begin(Stage::Joining);
        let mut mesh = match (relaxation, &sheets) {
            (Some(relaxation), Some(sheets)) => {
                stages.begin(Stage::Smoothing);
                let mobility = triangles::mobility(&atoms, extent, sheets);
                let kept = triangles::feature_edges(&atoms, extent, sheets, distance)?;
                stages
                    .patiently(|patience| {
                        let points = atoms.positions;
                        triangles::relax::relax(points, &kept, &mobility, relaxation, patience)
                    })?
                    .0
            }
            _ => delaunay::delaunay_plane(&atoms.positions)?,
        };
        let mut kinds = atoms.kinds;
        let (Some(options), Some(sheets)) = (improvement, &sheets) else {
            return Ok(Joined::as_it_is(mesh, kinds, None));
        };
        stages.begin(Stage::Improving);
        let (outcome, feature_faces) = stages.patiently(|patience| {
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
        Ok(Joined {
            made: Marked {
                mesh,
                kinds,
                feature_faces,
                regions: Vec::new(),
                judged: Judged::default(),
            },
            neighbors: None,
            improvement: Some(Improvement::from(&outcome)),
            rival: None,
        })
    }

    fn rejoin(
        part: TriMesh,
        mut wanted: Wanted<2>,
        scene: &Scene<'_, 2>,
        min_angle: f64,
    ) -> std::result::Result<Reshaped<TriMesh>, Refusal> {
        let (extent, distance) = (scene.extent, scene.distance);
        let sheets = put_onto_sheets(&mut wanted.targets, &wanted.kinds, scene);
        let part = triangles::reshape(&part, &wanted, extent, &sheets, distance, min_angle)?;
        close_holes_of_part(part, scene)
    }

    fn cells(atoms: &[[f64; 2]], extent: [f64; 2], weld: f64) -> Result<PolyMesh<2>> {
        voronoi::voronoi_plane_welded(atoms, extent, weld)
    }

    fn sheets(scene: &Scene<'_, 2>) -> Sheets {
        // Curves in the plane are sheets that stand upright on it.
        let points = scene.features.points.iter().map(Self::in_space);
        let points: Vec<FeaturePoint<3>> = points.collect();
        planes(&points, in_space(scene.extent), scene.distance)
    }

    fn in_space(point: &FeaturePoint<2>) -> FeaturePoint<3> {
        FeaturePoint {
            position: in_space(point.position),
            normal: in_space(point.normal),
            strength: point.strength,
        }
    }
}

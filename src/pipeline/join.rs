//! How atoms at rest become a mesh: what differs between the plane and space.

use crate::Result;
use crate::delaunay::{self, Delaunay};
use crate::distance::Distance;
use crate::feature::{FeaturePoint, Features};
use crate::improve::sheets::Sheets;
use crate::improve::{self, plane};
use crate::mesh::poly::PolyMesh;
use crate::mesh::{AtomKind, TetMesh, TriMesh};
use crate::report::{Improvement, Measured};
use crate::seeding::Atoms;
use crate::voronoi;

/// The plane (`D` = 2) or space (`D` = 3).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Space<const D: usize>;

/// A space in which meshes are made.
pub trait Meshing<const D: usize> {
    /// What is made: triangles or tetrahedra.
    type Mesh: Measured<D>;

    /// Puts the atoms that are next to a feature onto it, joins all and improves the result until
    /// every angle is at least `min_angle` degrees where that can be; without `min_angle`, only
    /// joins. `begin` is told of each stage.
    ///
    /// # Errors
    /// Those of the triangulation.
    fn join(
        atoms: Atoms<D>,
        scene: &Scene<'_, D>,
        min_angle: Option<f64>,
        begin: &mut dyn FnMut(&str),
    ) -> Result<Joined<Self::Mesh>>;

    /// The Voronoi cells of atoms inside the box `[0, extent]`, cut by it.
    ///
    /// # Errors
    /// Those of [`voronoi`](crate::voronoi::voronoi).
    fn cells(atoms: &[[f64; D]], extent: [f64; D]) -> Result<PolyMesh<D>>;

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

/// Atoms joined to a mesh.
#[derive(Debug)]
pub struct Joined<M> {
    /// The mesh.
    pub mesh: M,
    /// For every cell and face, in order, the cell on its other side, where that is known.
    pub neighbors: Option<Vec<u32>>,
    /// What each node may do.
    pub kinds: Vec<AtomKind>,
    /// For each cell, bit k: its face k, opposite node k, lies on a feature.
    pub feature_faces: Vec<u8>,
    /// What was improved, if anything should be.
    pub improvement: Option<Improvement>,
}

/// Radius of the patches by which features are known locally, in units of d (and from 2 to 6.5).
const PATCH: f64 = 0.8;

/// Atoms this near to a feature, in units of d, are put onto it before they are joined.
const SETTLE: f64 = 0.35;

/// The features as local planes; `points` and `extent` in space.
fn planes<const D: usize>(
    points: &[FeaturePoint<3>],
    extent: [f64; 3],
    distance: &Distance<D>,
) -> Sheets {
    let radius = (PATCH * distance.min()).clamp(2.0, 6.5);
    // An edge is at most 1.7 d long: what it pierces is within half of that of one of its ends.
    let reach = 0.85 * distance.max() + 1.5;
    Sheets::new(points, extent, radius, reach)
}

/// The last stages, as an observer is told of them.
const JOINING: &str = "joining atoms";
const IMPROVING: &str = "removing slivers";

impl Meshing<3> for Space<3> {
    type Mesh = TetMesh;

    fn join(
        mut atoms: Atoms<3>,
        scene: &Scene<'_, 3>,
        min_angle: Option<f64>,
        begin: &mut dyn FnMut(&str),
    ) -> Result<Joined<TetMesh>> {
        let Scene {
            extent, distance, ..
        } = *scene;
        let sheets = min_angle.map(|_| Self::sheets(scene));
        if let Some(sheets) = &sheets {
            let reach = SETTLE * distance.min();
            improve::settle(&mut atoms.positions, &atoms.kinds, extent, sheets, reach);
        }
        begin(JOINING);
        let Delaunay {
            mut mesh,
            mut neighbors,
        } = delaunay::delaunay_with_neighbors(&atoms.positions)?;
        let mut kinds = atoms.kinds;
        let (Some(min_dihedral), Some(sheets)) = (min_angle, &sheets) else {
            return Ok(Joined {
                feature_faces: vec![0; mesh.tets.len()],
                mesh,
                neighbors: Some(neighbors.into_flattened()),
                kinds,
                improvement: None,
            });
        };
        begin(IMPROVING);
        let options = improve::Options { min_dihedral };
        let (outcome, feature_faces) = improve::improve(
            &mut mesh,
            &mut neighbors,
            &mut kinds,
            extent,
            sheets,
            distance,
            &options,
        );
        Ok(Joined {
            mesh,
            neighbors: Some(neighbors.into_flattened()),
            kinds,
            feature_faces,
            improvement: Some(Improvement::from(&outcome)),
        })
    }

    fn cells(atoms: &[[f64; 3]], extent: [f64; 3]) -> Result<PolyMesh<3>> {
        voronoi::voronoi(atoms, extent)
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

    fn join(
        mut atoms: Atoms<2>,
        scene: &Scene<'_, 2>,
        min_angle: Option<f64>,
        begin: &mut dyn FnMut(&str),
    ) -> Result<Joined<TriMesh>> {
        let Scene {
            extent, distance, ..
        } = *scene;
        let Some(min_angle) = min_angle else {
            begin(JOINING);
            let mesh = delaunay::delaunay_plane(&atoms.positions)?;
            return Ok(Joined {
                feature_faces: vec![0; mesh.triangles.len()],
                mesh,
                neighbors: None,
                kinds: atoms.kinds,
                improvement: None,
            });
        };
        let sheets = Self::sheets(scene);
        let reach = SETTLE * distance.min();
        plane::settle(&mut atoms.positions, &atoms.kinds, extent, &sheets, reach);
        begin(JOINING);
        let mut mesh = delaunay::delaunay_plane(&atoms.positions)?;
        begin(IMPROVING);
        let mut kinds = atoms.kinds;
        let (outcome, feature_faces) =
            plane::improve(&mut mesh, &mut kinds, extent, &sheets, distance, min_angle);
        Ok(Joined {
            mesh,
            neighbors: None,
            kinds,
            feature_faces,
            improvement: Some(Improvement::from(&outcome)),
        })
    }

    fn cells(atoms: &[[f64; 2]], extent: [f64; 2]) -> Result<PolyMesh<2>> {
        voronoi::voronoi_plane(atoms, extent)
    }

    fn sheets(scene: &Scene<'_, 2>) -> Sheets {
        // Curves in the plane are sheets that stand upright on it.
        let points = scene.features.points.iter().map(Self::in_space);
        let points: Vec<FeaturePoint<3>> = points.collect();
        planes(&points, plane::lift(scene.extent), scene.distance)
    }

    fn in_space(point: &FeaturePoint<2>) -> FeaturePoint<3> {
        let [x, y] = point.position;
        let [u, v] = point.normal;
        FeaturePoint {
            position: [x, y, 0.0],
            normal: [u, v, 0.0],
            strength: point.strength,
        }
    }
}

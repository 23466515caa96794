//! The dimension of space as a type, for code that is the same in the plane and in space.

use super::delaunay::{delaunay, delaunay_plane};
use super::poly::PolyMesh;
use super::voronoi::{voronoi_by, voronoi_plane_welded};
use super::{Simplices, TetMesh, TriMesh};
use crate::Result;

/// Marker of the plane (`D` = 2) or of space (`D` = 3).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Space<const D: usize>;

/// A dimension in which there are meshes.
pub trait Dimension<const D: usize> {
    /// Type of its meshes of simplices: triangles or tetrahedra.
    type Mesh: Simplices<D>;

    /// Returns the Delaunay triangulation of points.
    ///
    /// # Errors
    /// Returns the errors of [`delaunay`] and [`delaunay_plane`].
    fn delaunay(points: &[[f64; D]]) -> Result<Self::Mesh>;

    /// Returns the Voronoi cells of atoms inside the box `[0, extent]`, clipped to it, with welded
    /// nodes. In space, `triangulate` returns the Delaunay tetrahedra of points.
    ///
    /// # Errors
    /// Returns the errors of [`voronoi_welded`](super::voronoi::voronoi_welded).
    fn voronoi_cells(
        atoms: &[[f64; D]],
        extent: [f64; D],
        weld: f64,
        triangulate: &dyn Fn(&[[f64; 3]]) -> Result<TetMesh>,
    ) -> Result<PolyMesh<D>>;
}

/// Triangles in the plane, tetrahedra in space.
pub type SimplexMesh<const D: usize> = <Space<D> as Dimension<D>>::Mesh;

impl Dimension<2> for Space<2> {
    type Mesh = TriMesh;

    fn delaunay(points: &[[f64; 2]]) -> Result<TriMesh> {
        delaunay_plane(points)
    }

    fn voronoi_cells(
        atoms: &[[f64; 2]],
        extent: [f64; 2],
        weld: f64,
        _: &dyn Fn(&[[f64; 3]]) -> Result<TetMesh>,
    ) -> Result<PolyMesh<2>> {
        voronoi_plane_welded(atoms, extent, weld)
    }
}

impl Dimension<3> for Space<3> {
    type Mesh = TetMesh;

    fn delaunay(points: &[[f64; 3]]) -> Result<TetMesh> {
        delaunay(points)
    }

    fn voronoi_cells(
        atoms: &[[f64; 3]],
        extent: [f64; 3],
        weld: f64,
        triangulate: &dyn Fn(&[[f64; 3]]) -> Result<TetMesh>,
    ) -> Result<PolyMesh<3>> {
        voronoi_by(atoms, extent, weld, triangulate)
    }
}

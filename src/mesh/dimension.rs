//! The dimension of space as a type, for code that is the same in the plane and in space.

use super::{Simplices, TetMesh, TriMesh};

/// Marker of the plane (`D` = 2) or of space (`D` = 3).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Space<const D: usize>;

/// A dimension in which there are meshes.
pub trait Dimension<const D: usize> {
    /// Type of its meshes of simplices: triangles or tetrahedra.
    type Mesh: Simplices<D>;
}

impl Dimension<2> for Space<2> {
    type Mesh = TriMesh;
}

impl Dimension<3> for Space<3> {
    type Mesh = TetMesh;
}

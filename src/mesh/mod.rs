//! Meshes: topology, adjacency, checks and quality. This module knows nothing about images.
//!
//! - `interface`: the traits that every mesh implements, whatever its cells are
//! - [`quality`]: dihedral angles and the measure that improvement maximises
//! - `complex`: tetrahedra with neighbours, for local changes
//! - `tri`: triangles in the plane
//! - [`check`](mod@check): checks that a mesh is valid and fills its box
//! - [`poly`]: meshes of polyhedra, or of polygons in 2-D
//! - `mesh_partition`: tetrahedra that are distributed over several MPI ranks
//! - `view`: all of a mesh or one partition of it, for code that measures meshes
//! - `periodic`: opposite sides that match node by node
//! - `renumber`: new numbers of the nodes or cells that are kept
//! - `poly_columns`: geometry of cells that stand in columns
//! - `poly_convert`: polyhedra made from simplices, or by lifting polygons to prisms
//! - `dimension`: the dimension of space as a type
//! - [`graph`]: cells and connections, for flow and for simulators
//! - [`delaunay`]: points -> tetrahedra by our own kernel or TetGen, triangles by spade; refinement,
//!   exudation; validation by CGAL
//! - [`voronoi`]: atoms in a box -> their Voronoi cells, cut exactly by the box
//! - `boxes`: meshes of boxes, for tests
//!
//! The tetrahedron, its numbering and its orientation:
//!
//! ```text
//!            3
//!           /|\            det(x1 - x0, x2 - x0, x3 - x0) > 0:
//!          / | \           seen from node 3, nodes 0, 1, 2 turn anticlockwise.
//!         /  |  \          Face k is the face opposite node k; neighbour k is
//!        0---|---2         the tetrahedron on the other side of face k.
//!         \  |  /
//!          \ | /
//!            1
//! ```
//!
//! ```text
//! face k   nodes (FACES)   seen from node k        edge e     nodes (EDGES)
//! 0        1, 3, 2         the nodes of each       0, 1, 2    (0, 1), (0, 2), (0, 3)
//! 1        0, 2, 3         face turn               3, 4, 5    (1, 2), (1, 3), (2, 3)
//! 2        0, 3, 1         anticlockwise           e, 5 - e   opposite edges
//! 3        0, 1, 2
//! ```

#[cfg(test)]
pub(crate) mod boxes;
pub mod check;
pub(crate) mod complex;
#[allow(
    clippy::too_many_arguments,
    reason = "parts of one triangulation are passed on as they are"
)]
pub mod delaunay;
pub(crate) mod dimension;
pub mod graph;
pub(crate) mod interface;
pub(crate) mod mesh_partition;
pub mod periodic;
pub mod poly;
mod poly_columns;
pub(crate) mod poly_convert;
pub mod quality;
pub(crate) mod renumber;
pub(crate) mod tri;
pub(crate) mod view;
pub mod voronoi;

pub use dimension::{Dimension, SimplexMesh, Space};
pub use interface::{Mesh, Positions, Simplices};
pub use tri::TriMesh;

/// A tetrahedral mesh in one space: lattice or physical, as the code that owns the mesh documents.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TetMesh {
    /// Node positions.
    pub nodes: Vec<[f64; 3]>,
    /// Node indices of each tetrahedron, positively oriented (see the module's figure).
    pub tets: Vec<[u32; 4]>,
}

impl TetMesh {
    /// Returns the four corner positions of tetrahedron `t`.
    pub fn corners(&self, t: usize) -> [[f64; 3]; 4] {
        self.tets[t].map(|i| self.nodes[i as usize])
    }
}

/// Nodes of face k (opposite node k), ordered so that `(face, k)` is positively oriented. Seen from
/// inside the tetrahedron the nodes turn anticlockwise.
pub const FACES: [[usize; 3]; 4] = [[1, 3, 2], [0, 2, 3], [0, 3, 1], [0, 1, 2]];

/// The six edges as pairs of local nodes. Edge e is opposite edge 5 - e.
pub const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

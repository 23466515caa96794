//! Meshes: topology, adjacency, checks, quality. Nothing here knows about images.
//!
//! - `interface`: what every mesh answers, whatever its cells are
//! - [`quality`]: dihedral angles and the measure that improvement maximises
//! - `complex`: tetrahedra with neighbours, for local changes
//! - `tri`: triangles in the plane
//! - [`check`](mod@check): the one checker: is this a valid mesh that fills its box?
//! - [`poly`]: meshes of polyhedra, or of polygons in 2-D
//! - `piece`: tetrahedra that several processes hold, each some of them
//! - `part`: all of a mesh or a piece of it, as seen by what measures it
//! - `poly_columns`: what is known of cells that stand in columns
//! - `poly_from`: those made from simplices, or by lifting polygons to prisms
//! - [`graph`]: cells and connections, for flow and for simulators
//! - [`delaunay`]: points -> tetrahedra by TetGen, triangles by spade; CGAL's opinion and refinement
//! - [`voronoi`]: atoms in a box -> their Voronoi cells, cut exactly by the box
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

#[cfg(test)]
pub(crate) mod boxes;
pub mod check;
pub(crate) mod complex;
pub mod delaunay;
pub mod graph;
pub(crate) mod interface;
pub(crate) mod partition;
pub mod poly;
mod poly_columns;
pub(crate) mod poly_convert;
pub mod quality;
pub(crate) mod tri;
pub(crate) mod view;
pub mod voronoi;

pub use interface::{Mesh, Positions, Simplices};
pub use tri::TriMesh;

/// A tetrahedral mesh in one space (lattice or physical; the owner says which).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TetMesh {
    /// Node positions.
    pub nodes: Vec<[f64; 3]>,
    /// Node indices of each tetrahedron, positively oriented (see the module's figure).
    pub tets: Vec<[u32; 4]>,
}

impl TetMesh {
    /// The four corner positions of tetrahedron `t`.
    pub fn corners(&self, t: usize) -> [[f64; 3]; 4] {
        self.tets[t].map(|i| self.nodes[i as usize])
    }
}

/// Nodes of face k (opposite node k), ordered so that `(face, k)` is positively oriented; seen from
/// inside the tetrahedron they turn anticlockwise.
pub const FACES: [[usize; 3]; 4] = [[1, 3, 2], [0, 2, 3], [0, 3, 1], [0, 1, 2]];

/// The six edges as pairs of local nodes; edge e is opposite edge 5 - e.
pub const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

//! Meshes: topology, adjacency, checks, quality. Nothing here knows about images.
//!
//! - [`quality`]: dihedral angles and the measure that improvement maximises
//! - [`complex`]: tetrahedra with neighbours, for local changes
//! - [`tri`]: triangles in the plane
//! - [`check`]: the one public checker: is this a valid mesh that fills its box?
//! - [`poly`]: meshes of polyhedra, or of polygons in 2-D
//! - [`poly_check`]: the checker of those
//! - `poly_columns`: what is known of cells that stand in columns
//! - [`poly_from`]: those made from simplices, or by lifting polygons to prisms
//! - [`graph`]: cells and connections, for flow and for simulators
//! - [`faceted`]: meshes whose faces can be cut into facets, whatever their cells are
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

pub mod check;
pub mod complex;
pub mod delaunay;
pub mod faceted;
pub mod graph;
pub mod poly;
pub mod poly_check;
mod poly_columns;
pub mod poly_from;
pub mod quality;
pub mod tri;
pub mod voronoi;

pub use tri::TriMesh;

use crate::geometry::{cross, norm, sub, volume6};

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

/// A mesh of D-simplices: triangles in the plane, tetrahedra in space. What is the same for both is
/// written once, for this.
///
/// Face k of a cell (an edge in the plane) is the face opposite its node k.
pub trait Simplices<const D: usize>: Clone + std::fmt::Debug + Send + Sync {
    /// What the cells are called, in the plural.
    const CELLS: &'static str;
    /// VTK's number of the cell.
    const VTK_CELL: u8;

    /// A mesh of the given nodes and cells; `corners` holds D + 1 node numbers a cell.
    fn from_parts(nodes: Vec<[f64; D]>, corners: Vec<u32>) -> Self;

    /// Node positions.
    fn nodes(&self) -> &[[f64; D]];

    /// Node numbers, D + 1 a cell, positively oriented.
    fn connectivity(&self) -> &[u32];

    /// Number of cells.
    fn len(&self) -> usize {
        self.connectivity().len() / (D + 1)
    }

    /// Whether there are no cells.
    fn is_empty(&self) -> bool {
        self.connectivity().is_empty()
    }

    /// The node numbers of cell `c`.
    fn cell(&self, c: usize) -> &[u32] {
        &self.connectivity()[(D + 1) * c..(D + 1) * (c + 1)]
    }

    /// The node numbers of face `k` of cell `c`, in the cell's order.
    fn face(&self, c: usize, k: usize) -> [u32; D] {
        let cell = self.cell(c);
        std::array::from_fn(|i| cell[i + usize::from(i >= k)])
    }

    /// Signed volume (area) of cell `c`.
    fn volume(&self, c: usize) -> f64;

    /// For every cell and face, in order, the cell on its other side, or
    /// [`NONE`](complex::NONE).
    ///
    /// # Errors
    /// The nodes of a face that more than two cells share.
    fn neighbors(&self) -> Result<Vec<u32>, Vec<u32>>;

    /// Area of a face (length of an edge).
    fn face_area(face: &[[f64; D]; D]) -> f64;
}

impl Simplices<3> for TetMesh {
    const CELLS: &'static str = "tetrahedra";
    const VTK_CELL: u8 = 10;

    fn from_parts(nodes: Vec<[f64; 3]>, corners: Vec<u32>) -> Self {
        let tets = corners.as_chunks().0.to_vec();
        Self { nodes, tets }
    }

    fn nodes(&self) -> &[[f64; 3]] {
        &self.nodes
    }

    fn connectivity(&self) -> &[u32] {
        self.tets.as_flattened()
    }

    fn volume(&self, c: usize) -> f64 {
        volume6(&self.corners(c)) / 6.0
    }

    fn neighbors(&self) -> Result<Vec<u32>, Vec<u32>> {
        match complex::neighbors(self.nodes.len(), &self.tets) {
            Ok(neighbors) => Ok(neighbors.into_flattened()),
            Err(face) => Err(face.to_vec()),
        }
    }

    fn face_area([a, b, c]: &[[f64; 3]; 3]) -> f64 {
        0.5 * norm(cross(sub(*b, *a), sub(*c, *a)))
    }
}

impl Simplices<2> for TriMesh {
    const CELLS: &'static str = "triangles";
    const VTK_CELL: u8 = 5;

    fn from_parts(nodes: Vec<[f64; 2]>, corners: Vec<u32>) -> Self {
        let triangles = corners.as_chunks().0.to_vec();
        Self { nodes, triangles }
    }

    fn nodes(&self) -> &[[f64; 2]] {
        &self.nodes
    }

    fn connectivity(&self) -> &[u32] {
        self.triangles.as_flattened()
    }

    fn volume(&self, c: usize) -> f64 {
        0.5 * tri::area2(&self.corners(c))
    }

    fn neighbors(&self) -> Result<Vec<u32>, Vec<u32>> {
        match tri::neighbors(self.nodes.len(), &self.triangles) {
            Ok(neighbors) => Ok(neighbors.into_flattened()),
            Err(edge) => Err(edge.to_vec()),
        }
    }

    fn face_area([a, b]: &[[f64; 2]; 2]) -> f64 {
        (b[0] - a[0]).hypot(b[1] - a[1])
    }
}

/// Nodes of face k (opposite node k), ordered so that `(face, k)` is positively oriented; seen from
/// inside the tetrahedron they turn anticlockwise.
pub const FACES: [[usize; 3]; 4] = [[1, 3, 2], [0, 2, 3], [0, 3, 1], [0, 1, 2]];

/// The six edges as pairs of local nodes; edge e is opposite edge 5 - e.
pub const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

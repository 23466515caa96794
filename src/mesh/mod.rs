//! Meshes: topology, adjacency, checks, quality. Nothing here knows about images.
//!
//! - [`quality`]: dihedral angles and the measure that improvement maximises
//! - [`complex`]: tetrahedra with neighbours, for local changes
//! - [`check`]: the one public checker: is this a valid mesh that fills its box?
//! - [`poly`]: meshes of polyhedra, or of polygons in 2-D
//! - [`graph`]: cells and connections, for flow and for simulators
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
pub mod graph;
pub mod poly;
pub mod quality;

/// What an atom (mesh node) may do: how many of the box's sides hold it, or a user.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum AtomKind {
    /// Moves freely inside the box.
    Interior = 0,
    /// Moves in a side of the box.
    Side = 1,
    /// Moves along an edge of the box.
    Edge = 2,
    /// A corner of the box: does not move.
    Corner = 3,
    /// Placed by the user (a well, a source): does not move.
    Fixed = 4,
}

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

/// `a - b`.
#[inline]
pub fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a + s b`.
#[inline]
pub fn add_scaled(a: [f64; 3], s: f64, b: [f64; 3]) -> [f64; 3] {
    [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]
}

/// Scalar product.
#[inline]
pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Vector product.
#[inline]
pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Length.
#[inline]
pub fn norm(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

/// Six times the signed volume of a tetrahedron; positive for the module's orientation.
#[inline]
pub fn volume6(p: &[[f64; 3]; 4]) -> f64 {
    dot(sub(p[1], p[0]), cross(sub(p[2], p[0]), sub(p[3], p[0])))
}

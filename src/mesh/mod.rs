//! Meshes: topology, adjacency, checks, quality. Nothing here knows about images.
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

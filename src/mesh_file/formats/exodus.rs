//! Names and numberings of Exodus II. Source: "EXODUS: A Finite Element Data Model" (Sandia National
//! Laboratories), chapter 5 and appendix A.

/// A kind of objects that a file lists: blocks or sets.
pub struct ObjectKind {
    /// Beginning of the names of the arrays that list the objects.
    pub prefix: &'static str,
    /// Name of the dimension that counts the objects.
    pub count: &'static str,
}

/// Blocks of elements.
pub const ELEMENT_BLOCKS: ObjectKind = ObjectKind {
    prefix: "eb",
    count: "num_el_blk",
};
/// Blocks of faces.
pub const FACE_BLOCKS: ObjectKind = ObjectKind {
    prefix: "fa",
    count: "num_fa_blk",
};
/// Sets of sides of elements.
pub const SIDE_SETS: ObjectKind = ObjectKind {
    prefix: "ss",
    count: "num_side_sets",
};
/// Sets of nodes.
pub const NODE_SETS: ObjectKind = ObjectKind {
    prefix: "ns",
    count: "num_node_sets",
};

/// Arrays of a side set: the elements, and the number of the side of each.
pub const SIDE_SET_ARRAYS: [&str; 2] = ["elem_ss", "side_ss"];
/// Array of the nodes of a node set.
pub const NODE_SET_ARRAY: &str = "node_ns";
/// Arrays of the coordinates of nodes along each axis.
pub const COORDINATES: [&str; 3] = ["coordx", "coordy", "coordz"];
/// Attribute of a block's list of parts: the type of its elements.
pub const ELEMENT_TYPE: &str = "elem_type";
/// Array of the names of values of elements.
pub const ELEMENT_VALUE_NAMES: &str = "name_elem_var";

/// Types of cells that are lists of faces, and of faces that are lists of nodes.
pub const NFACED: &str = "NFACED";
pub const NSIDED: &str = "NSIDED";

/// Names in the file for a block's list of parts (nodes or faces), the number of parts of each
/// element, the dimensions of both, and the types of the parts and of the elements.
pub struct BlockNames {
    pub list: &'static str,
    pub counts: &'static str,
    pub len: &'static str,
    pub size: &'static str,
    pub types: [&'static str; 2],
}

/// Blocks of elements that are lists of nodes.
pub const ELEMENTS: BlockNames = BlockNames {
    list: "connect",
    counts: "ebepecnt",
    len: "num_el_in_blk",
    size: "num_nod_per_el",
    types: ["NODE", "ELEM"],
};
/// Blocks of elements that are lists of faces.
pub const ELEMENTS_OF_FACES: BlockNames = BlockNames {
    list: "facconn",
    size: "num_fac_per_el",
    types: ["FACE", "ELEM"],
    ..ELEMENTS
};
/// Blocks of faces.
pub const FACES: BlockNames = BlockNames {
    list: "fbconn",
    counts: "fbepecnt",
    len: "num_fa_in_blk",
    size: "num_nod_per_fa",
    types: ["NODE", "FACE"],
};

/// The corners of each side of a tetrahedron, in the order of the sides' numbers, which begin with 1.
pub const TETRAHEDRON_SIDES: [[usize; 3]; 4] = [[0, 1, 3], [1, 2, 3], [0, 2, 3], [0, 1, 2]];
/// The corners of each side of a triangle.
pub const TRIANGLE_SIDES: [[usize; 2]; 3] = [[0, 1], [1, 2], [2, 0]];
/// Number of faces of a shell, which come before its edges. A triangle in space is a shell.
pub const SHELL_FACE_COUNT: usize = 2;

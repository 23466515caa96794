//! Gmsh's numbers of element types. Source: the chapter "MSH file format" of Gmsh's manual.

/// A type of simplices of first or second order.
pub struct SimplexType {
    /// Gmsh's number of the type.
    pub number: u8,
    /// Number of corners: 1 of a point to 4 of a tetrahedron.
    pub corners: usize,
    /// Number of nodes, corners first.
    pub nodes: usize,
}

impl SimplexType {
    const fn new(number: u8, corners: usize, nodes: usize) -> Self {
        Self {
            number,
            corners,
            nodes,
        }
    }
}

/// The types of simplices, first order before second order.
pub const SIMPLEX_TYPES: [SimplexType; 7] = [
    SimplexType::new(15, 1, 1),
    SimplexType::new(1, 2, 2),
    SimplexType::new(8, 2, 3),
    SimplexType::new(2, 3, 3),
    SimplexType::new(9, 3, 6),
    SimplexType::new(4, 4, 4),
    SimplexType::new(11, 4, 10),
];

/// The number of the type of points.
pub const POINT_TYPE: u8 = SIMPLEX_TYPES[0].number;

/// The number of the type of prisms of first order.
pub const PRISM_TYPE: u8 = 6;

/// Numbers of the types of other elements, of first and second order, with their name in messages.
pub const OTHER_TYPES: [([i64; 3], &str); 4] = [
    ([3, 16, 10], "quadrilaterals"),
    ([5, 17, 12], "hexahedra"),
    ([PRISM_TYPE as i64, 18, 13], "prisms"),
    ([7, 19, 14], "pyramids"),
];

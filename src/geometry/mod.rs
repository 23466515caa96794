//! Basic geometry and data structures that do not depend on images or meshes.
//!
//! - `vector`: vector algebra
//! - `cell_list`: points sorted into cells, to find nearby points
//! - `point_grid`: the nearest of many points, by a cell list
//! - `incremental_grid`: points added to cells one by one
//! - `box_tree`: a tree of bounding boxes, to find items near a point or at a point
//! - `face_distance`: distances from points to triangles and segments
//! - `grid_index`: indices and memory offsets of the cells of a regular grid
//! - `conjugate_gradients`: solutions of symmetric systems of equations
//! - `eigen`: eigenvalues and eigenvectors of small symmetric matrices
//! - `distinct`: sorted lists, with and without duplicates
//! - `hypot`: the length of a vector with two components, the same on every system
//! - `counting_sort`: numbers sorted by group
//! - `morphology`: dilation of marked cells of a grid
//! - `union_find`: disjoint sets that are united pair by pair
//! - `random`: random numbers that are a function of seed and counter
//! - `spread`: points spread evenly over paths and triangles
//! - `statistics`: medians and other quantiles
//! - `simd`: loops compiled for the widest vector registers of the machine

pub(crate) mod box_tree;
pub(crate) mod cell_list;
pub(crate) mod conjugate_gradients;
pub(crate) mod counting_sort;
mod distinct;
pub(crate) mod eigen;
mod face_distance;
pub(crate) mod grid_index;
mod hypot;
pub(crate) mod incremental_grid;
pub(crate) mod morphology;
pub(crate) mod point_grid;
pub(crate) mod random;
pub(crate) mod simd;
pub(crate) mod spread;
pub(crate) mod statistics;
pub(crate) mod union_find;
pub(crate) mod vector;

/// The index that stands for no item: no node, no cell, no point.
pub const NONE: u32 = u32::MAX;

pub(crate) use distinct::{sorted, sorted_distinct};
pub(crate) use face_distance::squared_distance_to_face;
pub use hypot::hypot;
pub use vector::{
    add_scaled, bounding_box, cross, distance2, dot, norm, normal, solve_positive, sub, to_3d,
    unit, volume6,
};

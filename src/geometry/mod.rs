//! Basic geometry and data structures that do not depend on images or meshes.
//!
//! - `vector`: vector algebra
//! - `cell_list`: points sorted into cells, to find nearby points
//! - `grid_index`: indices and memory offsets of the cells of a regular grid
//! - `distinct`: sorted lists without duplicates
//! - `hypot`: the length of a vector with two components, the same on every system
//! - `incremental_grid`: points added to cells one by one
//! - `counting_sort`: numbers sorted by group
//! - `morphology`: dilation of marked cells of a grid
//! - `union_find`: disjoint sets that are united pair by pair
//! - `random`: random numbers that are a function of seed and counter
//! - `simd`: loops compiled for the widest vector registers of the machine

pub(crate) mod cell_list;
pub(crate) mod counting_sort;
mod distinct;
pub(crate) mod grid_index;
mod hypot;
pub(crate) mod incremental_grid;
pub(crate) mod morphology;
pub(crate) mod random;
pub(crate) mod simd;
pub(crate) mod union_find;
pub(crate) mod vector;

pub(crate) use distinct::sorted_distinct;
pub use hypot::hypot;
pub use vector::{
    add_scaled, bounding_box, cross, distance2, dot, norm, normal, solve_positive, sub, to_3d,
    unit, volume6,
};

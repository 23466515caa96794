//! What every house stands on: vectors, points in cells, sets, random numbers, loops on wide registers.
//! Nothing here knows of images or meshes.
//!
//! - `vector`: sums and products of vectors
//! - `buckets`: points sorted into cells, to find those nearby
//! - `scatter`: points put into cells one by one
//! - `groups`: numbers sorted by the group that each belongs to
//! - `marks`: marked cells of a grid
//! - `sets`: sets that are united pair by pair
//! - `random`: random numbers that are a function of seed and count
//! - `wide`: loops run with the widest vectors that the machine has

pub(crate) mod cell_list;
pub(crate) mod counting_sort;
pub(crate) mod incremental_grid;
pub(crate) mod morphology;
pub(crate) mod random;
pub(crate) mod simd;
pub(crate) mod union_find;
pub(crate) mod vector;

pub use vector::{
    add_scaled, bounding_box, cross, distance2, dot, norm, normal, solve_positive, sub, to_3d,
    unit, volume6,
};

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

pub(crate) mod buckets;
pub(crate) mod groups;
pub(crate) mod marks;
pub(crate) mod random;
pub(crate) mod scatter;
pub(crate) mod sets;
pub(crate) mod vector;
pub(crate) mod wide;

pub use vector::{
    add_scaled, cross, distance2, dot, in_space, norm, normal, solve_positive, spread, sub, unit,
    volume6,
};

//! What every house stands on: vectors, points in buckets, loops on wide registers. Nothing here knows
//! of images or meshes.
//!
//! - [`vector`]: sums and products of vectors
//! - [`near`]: points that are near
//! - [`sets`]: sets that are united pair by pair
//! - `wide`: loops run with the widest vectors that the machine has

pub mod near;
pub mod sets;
pub mod vector;
pub(crate) mod wide;

pub use vector::{add_scaled, cross, dot, norm, normal, sub, unit, volume6};

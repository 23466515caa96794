//! Applications of a finished mesh: surfaces, regions, segmentation, columns, flow and pictures.
//!
//! - [`surface`]: surfaces made of the faces on features, labelled as faults or horizons
//! - `geodesics`: shortest paths through a mesh
//! - [`paint`](mod@paint): regions between surfaces, and regions grown from seeds
//! - [`segment`](mod@segment): object and background, separated by a minimum cut
//! - [`columns`]: the cells of a map, extended vertically between horizons
//! - [`flow`]: steady flow
//! - [`reservoir`]: a mesh as a reservoir model
//! - [`validate`](mod@validate): checks of a mesh
//! - [`slice`](mod@slice): pictures of a mesh over its image

pub mod columns;
pub mod flow;
pub(crate) mod geodesics;
pub mod paint;
pub mod reservoir;
pub mod segment;
pub mod slice;
pub mod surface;
pub mod validate;

pub use crate::store::{ImageInput, MeshInput};

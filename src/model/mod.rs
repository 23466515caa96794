//! Applications of a finished mesh: surfaces, regions, segmentation, columns, flow, edits and
//! pictures.
//!
//! - [`surface`]: surfaces made of the faces on features, labelled as faults or horizons
//! - `geodesics`: shortest paths through a mesh
//! - [`paint`](mod@paint): regions between surfaces, and regions grown from seeds
//! - [`segment`](mod@segment): object and background, separated by a minimum cut
//! - [`columns`]: the cells of a map, extended vertically between horizons
//! - [`flow`]: steady flow
//! - [`reservoir`]: a mesh as a reservoir model
//! - [`quality`](mod@quality): measures of a mesh
//! - [`validate`](mod@validate): checks of a mesh
//! - [`edit`](mod@edit): atoms that are added, moved and removed
//! - [`slice`](mod@slice): pictures of a mesh over its image

pub mod columns;
pub mod edit;
pub mod flow;
pub(crate) mod geodesics;
pub(crate) mod input;
pub mod paint;
pub mod quality;
pub mod reservoir;
pub mod segment;
pub mod slice;
pub mod surface;
pub mod validate;

pub use input::{ImageInput, MeshInput};

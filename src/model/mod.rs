//! What users do with a mesh.
//!
//! - [`surface`]: faces on features -> labelled surfaces, faults or horizons
//! - [`paint`](mod@paint): blocks between surfaces; cells grown from seeds
//! - [`segment`](mod@segment): object and background by a minimum cut
//! - [`columns`]: cells of a map, drawn down between horizons
//! - [`flow`]: steady flow
//! - [`reservoir`]: a mesh as a reservoir model
//! - [`edit`](mod@edit): atoms added, moved and removed
//! - [`slice`](mod@slice): pictures of a mesh over its image

pub mod columns;
pub mod edit;
pub mod flow;
pub mod geodesics;
pub mod paint;
pub mod reservoir;
pub mod segment;
pub mod slice;
pub mod surface;

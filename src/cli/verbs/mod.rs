//! The verbs.

pub mod columns;
pub mod edit;
pub mod export;
pub mod flow;
pub mod images;
pub mod mesh;
pub mod meshes;
pub mod paint;
pub mod segment;
pub mod slice;
pub mod surface;

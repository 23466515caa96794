//! From a Delaunay mesh of an optimised lattice to one without slivers whose faces lie on the
//! features.
//!
//! The two that do it:
//!
//! - `tets`: tetrahedra in space
//! - `triangles`: triangles in the plane
//!
//! What they share; the plane is z = 0 of space, and a curve a sheet that stands upright on it:
//!
//! - `sheets`: the features as local planes
//! - `lookup`: the local planes, remembered where they were asked for
//! - `hold`: what holds a node (box sides, features)
//! - `settle`: atoms near features go onto them
//! - `pierce`: where edges pass through features
//! - `seal`: faces that close holes
//! - `regions`: cells take the labels of the image, and faces between them lie where labels change
//! - `target`: what to aim at
//! - `improved`: what was done, and what blocked more
//! - `part`: what is asked of a part of a mesh, and what becomes of it
//!
//! The invariant that keeps the features: *no edge passes through a sheet*. Then every cell lies on one
//! side of it or has its nodes on it, so the sheet is a union of faces, whatever flips exchange them.
//! It is established once (`recover`) and every later change keeps it.

pub(crate) mod constraint;
pub(crate) mod feature_planes;
pub mod regions;
pub(crate) mod tets;
pub(crate) mod triangles;

mod improve_report;
mod intersect;
mod plane_cache;
mod reshape;
mod seal;
mod snap;
mod target;

pub use improve_report::{BlockedCell, ImproveReport, OperationCounts};
pub use reshape::{ReshapeError, ReshapeRequest, ReshapeResult};
pub use seal::{SealReport, seal, seal_distributed};
pub(crate) use snap::snap_distributed;
pub use snap::snap_to_features;
pub use target::{SliverMethod, Target};
pub use triangles::relax::Scheme;

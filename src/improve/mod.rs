//! Improves a Delaunay mesh of an optimised lattice: removes its slivers and makes its faces lie on
//! the features.
//!
//! Two modules do this work:
//!
//! - `tets`: tetrahedra in space
//! - `triangles`: triangles in the plane
//!
//! They share the modules below. Code for the plane uses the plane z = 0 of space, where a curve is
//! a feature surface normal to that plane.
//!
//! - `feature_planes`: the features as local planes
//! - `plane_cache`: a cache of these local planes
//! - `constraint`: constraints of a node (sides of the box, feature surfaces)
//! - `snap`: snaps atoms near features onto them
//! - `intersect`: finds where edges pass through features
//! - `seal`: adds the faces that close holes in feature surfaces
//! - `angle_moves`: moves of single nodes that enlarge the smallest angles
//! - `node_moves`: moves of nodes that fit the faces around them to a surface
//! - `feature_fit`: moves nodes on features so that faces lie on the features on average
//! - `regions`: assigns the image's labels to cells, and fits faces to the interfaces between
//!   labels
//! - `target`: the quality to reach
//! - `improve_report`: counts of operations, and the cells that stay below target
//! - `reshape`: the trait of meshes whose parts get other nodes, with request and result
//!
//! One invariant keeps the features: *no edge passes through a feature surface*. Then every cell
//! lies on one side of the surface or has its nodes on it, so the surface is a union of faces,
//! whatever flips exchange them. The `recover` modules establish the invariant once, and every
//! later operation keeps it.

pub(crate) mod constraint;
mod feature_fit;
pub(crate) mod feature_planes;
pub mod regions;
pub(crate) mod tets;
pub(crate) mod triangles;

mod angle_moves;
mod improve_report;
mod intersect;
mod node_moves;
mod plane_cache;
mod reshape;
mod seal;
mod snap;
mod target;

pub(crate) use angle_moves::enlarge_angles;
pub use feature_fit::{FeatureFit, fit_feature_faces};
pub use improve_report::{BlockedCell, ImproveReport, OperationCounts};
pub use reshape::{Reshape, ReshapeError, ReshapeRequest, ReshapeResult};
pub use seal::SealReport;
pub(crate) use seal::seal;
pub use snap::snap_to_features;
pub(crate) use snap::{snap_distributed, snap_halo_width};
pub use target::{Effort, SliverMethod, Target};

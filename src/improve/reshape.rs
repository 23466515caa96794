//! The trait of meshes of which a part gets other nodes, with request and result: atoms are added, removed and
//! moved.

use super::ImproveReport;
use super::feature_planes::FeaturePlanes;
use crate::Error;
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::mesh::Simplices;

/// Nodes that a part of a mesh is to have.
#[derive(Debug, Clone, PartialEq)]
pub struct ReshapeRequest<const D: usize> {
    /// Position of each node: first the nodes that the part has, then the new ones.
    pub targets: Vec<[f64; D]>,
    /// Kind of each node. An [`AtomKind::Fixed`] node must be exactly at its target and not move
    /// from there. All nodes that the part shares with the rest of the mesh must be fixed.
    pub kinds: Vec<AtomKind>,
    /// `true` for each node that is to be removed.
    pub is_removed: Vec<bool>,
}

/// Reason why a part of a mesh cannot be reshaped.
#[derive(Debug, Clone)]
pub enum ReshapeError {
    /// This node cannot reach its target or cannot be removed.
    Node(u32),
    /// The mesh has this problem, which no single node causes.
    Mesh(Error),
}

/// A part of a mesh after reshaping.
#[derive(Debug, Clone)]
pub struct ReshapeResult<M> {
    /// Mesh of the part.
    pub mesh: M,
    /// Kind of each node.
    pub kinds: Vec<AtomKind>,
    /// Index of each node in the [`ReshapeRequest`]; nodes that improvement has inserted have
    /// larger numbers than all of these.
    pub request_nodes: Vec<u32>,
    /// Faces on features, for each cell: bit k is set if its face k (opposite node k) lies on a
    /// feature.
    pub feature_faces: Vec<u8>,
    /// Report of the improvement that followed.
    pub report: ImproveReport,
}

/// Simplices of which a part can be reshaped.
pub trait Reshape<const D: usize>: Simplices<D> {
    /// Reshapes a part of a mesh in the box `[0, extent]`: inserts new nodes, removes those that are
    /// to be removed, moves all nodes to their targets as far as the mesh allows, and improves the
    /// part up to this smallest angle, in degrees. Its outer faces do not change.
    ///
    /// # Errors
    /// Returns the node that cannot reach its target or cannot be removed, or
    /// [`ReshapeError::Mesh`] for another problem.
    fn reshape(
        &self,
        request: &ReshapeRequest<D>,
        extent: [f64; D],
        planes: &FeaturePlanes,
        distance: &Distance<D>,
        min_angle: f64,
    ) -> Result<ReshapeResult<Self>, ReshapeError>;
}

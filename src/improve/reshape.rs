//! What is asked of a part of a mesh in which atoms come, go and move, and what becomes of it.

use super::ImproveReport;
use crate::Error;
use crate::lattice::AtomKind;

/// What shall become of the nodes of a part of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct ReshapeRequest<const D: usize> {
    /// Where each node shall be: first those that the part has, then new ones.
    pub targets: Vec<[f64; D]>,
    /// What each may do. [`AtomKind::Fixed`]: be at its target exactly, and not move from there, as
    /// all nodes must that the rest of the mesh has, too.
    pub kinds: Vec<AtomKind>,
    /// For each, whether it shall go.
    pub is_removed: Vec<bool>,
}

/// Why a part of a mesh cannot be reshaped.
#[derive(Debug, Clone)]
pub enum ReshapeError {
    /// This node cannot be put where it must be, or cannot go.
    Node(u32),
    /// No single node is to blame: this is what is wrong.
    Mesh(Error),
}

/// A part of a mesh after that.
#[derive(Debug, Clone)]
pub struct ReshapeResult<M> {
    /// The part.
    pub mesh: M,
    /// What each node may do.
    pub kinds: Vec<AtomKind>,
    /// The number that each node has in [`ReshapeRequest`], or one beyond if improvement has put it in.
    pub request_nodes: Vec<u32>,
    /// For each cell, bit k: its face k, opposite node k, lies on a feature.
    pub feature_faces: Vec<u8>,
    /// What was improved.
    pub report: ImproveReport,
}

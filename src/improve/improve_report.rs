//! Report of an improvement: the operations made, and the cells that stay below target.

use serde::Serialize;

use super::constraint::NodeConstraint;
use crate::geometry::to_3d;

/// Number of operations of each kind.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct OperationCounts {
    /// Flips (local transformations).
    pub flips: usize,
    /// Nodes moved by smoothing.
    pub moves: usize,
    /// Edges that passed through a feature before any operation.
    pub intersecting_before: usize,
    /// Edges through a feature that a flip removed.
    pub intersecting_flipped: usize,
    /// Nodes snapped onto the feature that one of their edges passed through.
    pub intersecting_snapped: usize,
    /// Edges through a feature that were split on it.
    pub intersecting_split: usize,
    /// Edges that still pass through a feature. If improvement was cancelled, this counts only the
    /// known edges that were not yet treated.
    pub intersecting_left: usize,
    /// Edges collapsed.
    pub collapses: usize,
    /// Nodes inserted to repair cells below target.
    pub insertions: usize,
    /// Times that nodes were released from a feature because a cell would have stayed unusable.
    pub released: usize,
}

impl std::ops::AddAssign for OperationCounts {
    fn add_assign(&mut self, other: Self) {
        self.flips += other.flips;
        self.moves += other.moves;
        self.intersecting_before += other.intersecting_before;
        self.intersecting_flipped += other.intersecting_flipped;
        self.intersecting_snapped += other.intersecting_snapped;
        self.intersecting_split += other.intersecting_split;
        self.intersecting_left += other.intersecting_left;
        self.collapses += other.collapses;
        self.insertions += other.insertions;
        self.released += other.released;
    }
}

/// A cell that stays below target, and what may block its improvement.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BlockedCell {
    /// Centroid of the cell in lattice space.
    pub centroid: [f64; 3],
    /// Smallest angle of the cell (dihedral angle in space), in degrees.
    pub min_angle: f64,
    /// Largest angle of the cell, in degrees.
    pub max_angle: f64,
    /// Number of its nodes that lie in a side of the box.
    pub nodes_on_sides: usize,
    /// Number of its nodes that lie on a feature.
    pub nodes_on_features: usize,
    /// Number of its nodes that lie on several features at once.
    pub nodes_on_crossings: usize,
}

impl BlockedCell {
    /// Creates the entry of a cell from its corners, its angles in degrees and the constraints of
    /// its nodes. `axes` is the bit mask of the axes: 7 in space and 3 in the plane.
    pub(super) fn new<const D: usize>(
        corners: &[[f64; D]],
        angles: &[f64],
        constraints: &[NodeConstraint],
        axes: u8,
    ) -> Self {
        let count =
            |f: &dyn Fn(&NodeConstraint) -> bool| constraints.iter().filter(|h| f(h)).count();
        let mean = |k: usize| corners.iter().map(|x| x[k]).sum::<f64>() / corners.len() as f64;
        Self {
            centroid: to_3d(std::array::from_fn::<f64, D, _>(mean)),
            min_angle: angles.iter().copied().fold(f64::INFINITY, f64::min),
            max_angle: angles.iter().copied().fold(0.0, f64::max),
            nodes_on_sides: count(&|h| h.fixed_axes & axes != 0),
            nodes_on_features: count(&|h| h.surface_count > 0),
            nodes_on_crossings: count(&|h| h.surface_count > 1),
        }
    }
}

/// Report of an improvement.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImproveReport {
    /// Number of cells below target before improvement.
    pub below_target_before: usize,
    /// Operations made.
    pub counts: OperationCounts,
    /// The cells that stay below target, worst first.
    pub blocked: Vec<BlockedCell>,
}

//! What improvement did, and what blocked it.

use serde::Serialize;

use super::constraint::NodeConstraint;
use crate::geometry::to_3d;

/// How often each kind of change was made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct OperationCounts {
    /// Local transformations.
    pub flips: usize,
    /// Nodes moved by smoothing.
    pub moves: usize,
    /// Edges that pierced a feature before anything was changed.
    pub intersecting_before: usize,
    /// Edges that pierced a feature and went by a flip.
    pub intersecting_flipped: usize,
    /// Nodes pulled onto the feature that one of their edges pierced.
    pub intersecting_snapped: usize,
    /// Edges that pierced a feature and were split on it.
    pub intersecting_split: usize,
    /// Edges that still pierce a feature; where improvement was stopped, only those that it knew of and
    /// had not come to.
    pub intersecting_left: usize,
    /// Edges collapsed.
    pub collapses: usize,
    /// Nodes inserted to mend bad tetrahedra.
    pub insertions: usize,
    /// Times that nodes were let go of a feature because a tetrahedron was of no use otherwise.
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

/// A cell that stayed below target, and what blocks it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BlockedCell {
    /// Where: its centroid in lattice space.
    pub centroid: [f64; 3],
    /// Its smallest angle (dihedral in space), in degrees.
    pub min_angle: f64,
    /// Its largest, in degrees.
    pub max_angle: f64,
    /// Its nodes that lie in a side of the box.
    pub nodes_on_sides: usize,
    /// Its nodes that lie on a feature.
    pub nodes_on_features: usize,
    /// Its nodes that lie on several features at once.
    pub nodes_on_crossings: usize,
}

impl BlockedCell {
    /// A cell with these corners, angles in degrees, and what holds its nodes; `axes` is 7 in space, and
    /// 3 in the plane.
    pub(super) fn new<const D: usize>(
        corners: &[[f64; D]],
        angles: &[f64],
        holds: &[NodeConstraint],
        axes: u8,
    ) -> Self {
        let count = |f: &dyn Fn(&NodeConstraint) -> bool| holds.iter().filter(|h| f(h)).count();
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

/// What improvement did.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ImproveReport {
    /// Cells below target before and after.
    pub below_target_before: usize,
    /// See `poor_before`.
    pub below_target_after: usize,
    /// Changes made.
    pub counts: OperationCounts,
    /// The cells that stayed below target, worst first.
    pub blocked: Vec<BlockedCell>,
}

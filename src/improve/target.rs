//! What to aim at.

use serde::Serialize;

/// An angle (degrees) below which, or above its supplement, a cell is of no use.
pub(super) const UNUSABLE_ANGLE: f64 = 21.0;

/// What to aim at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Every dihedral angle shall lie in [min_dihedral, 180 - min_dihedral] degrees.
    pub min_dihedral: f64,
    /// How, in space.
    pub method: SliverMethod,
}

/// How slivers are removed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SliverMethod {
    /// Joe's local transformations and smoothing.
    #[default]
    Joe,
    /// CGAL's exudation.
    Exude,
}

impl Default for Target {
    fn default() -> Self {
        Self {
            min_dihedral: 30.0,
            method: SliverMethod::Joe,
        }
    }
}

impl std::fmt::Display for SliverMethod {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Joe => "flips and smoothing",
            Self::Exude => "exudation",
        })
    }
}

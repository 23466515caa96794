//! The mesh quality that improvement aims at.

use serde::{Deserialize, Serialize};

/// Smallest usable angle, in degrees. A cell with an angle below this, or above 180 degrees less
/// this, is unusable.
pub(super) const UNUSABLE_ANGLE: f64 = 21.0;

/// How much work goes into a mesh.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Effort {
    /// Less time: angles from 15 degrees, no search for crossing surfaces, atoms
    /// that come to rest only roughly
    Draft,
    /// Angles from 30 degrees
    #[default]
    Normal,
    /// More time: once the angles have reached their target, they are improved by up to 5 degrees
    Best,
}

impl Effort {
    /// Returns the target for the smallest angle, in degrees, if none is given.
    pub fn min_angle(self) -> f64 {
        match self {
            Self::Draft => 15.0,
            Self::Normal | Self::Best => 30.0,
        }
    }
}

/// Mesh quality that improvement aims at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Smallest dihedral angle, in degrees: every one is to lie in [min_dihedral, 180 -
    /// min_dihedral].
    pub min_dihedral: f64,
    /// Method that removes slivers in 3-D.
    pub method: SliverMethod,
    /// How much work goes into reaching it.
    pub effort: Effort,
}

/// Method that removes slivers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum SliverMethod {
    /// Local transformations (Joe) and smoothing.
    #[default]
    Joe,
    /// Sliver exudation.
    Exude,
    /// Sliver exudation by CGAL.
    ExudeCgal,
}

impl Default for Target {
    fn default() -> Self {
        Self {
            min_dihedral: Effort::Normal.min_angle(),
            method: SliverMethod::Joe,
            effort: Effort::Normal,
        }
    }
}

impl std::fmt::Display for SliverMethod {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Joe => "flips and smoothing",
            Self::Exude => "exudation",
            Self::ExudeCgal => "exudation by CGAL",
        })
    }
}

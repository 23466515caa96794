//! Cells beyond the image.

use serde::Serialize;

use super::quality::Quantiles;

/// Cells beyond the image, by which the mesh continues.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PaddingReport {
    /// Its regions that have cells.
    pub regions: Vec<PaddingRegion>,
    /// Smallest dihedral angle of each cell in lattice space, in degrees.
    pub smallest_angle: Quantiles,
    /// Largest dihedral angle of each cell in lattice space, in degrees.
    pub largest_angle: Quantiles,
    /// Largest distance of the mesh's top from the topography, along the vertical axis, in the image's
    /// physical units; `None` without a topography.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub topography_deviation: Option<f64>,
}

/// A region beyond the image.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PaddingRegion {
    /// Name of the region.
    pub name: &'static str,
    /// Number of its cells.
    pub cells: usize,
    /// Its volume in lattice space.
    pub volume: f64,
}

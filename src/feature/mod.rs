//! Image -> feature image -> potential b(x).

use crate::image::Field;

/// One detected point of a feature (fault, horizon, wall) at its sub-sample position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeaturePoint<const D: usize> {
    /// Position in lattice space.
    pub position: [f32; D],
    /// Unit normal of the feature there (its sign means nothing).
    pub normal: [f32; D],
    /// Feature strength, in units of the feature image.
    pub strength: f32,
}

/// What feature detection hands to the rest of the pipeline.
#[derive(Debug, Clone)]
pub struct Features<const D: usize> {
    /// The features as points, in a fixed order (the order of samples).
    pub points: Vec<FeaturePoint<D>>,
    /// The image potential b(x) in [-1, 0]: every feature a valley of depth 1 and width `sigma`.
    pub potential: Field<D>,
    /// Width of the valleys in lattice units: d_min / 4.
    pub sigma: f64,
    /// One or more plain lines: what was picked and why, threshold, counts.
    pub notes: Vec<String>,
}

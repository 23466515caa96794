//! The boundary of one object, by random shortest paths (Xu 2016, chapter 5), in the plane.
//!
//! Points in an object and points around it are drawn at random, near in *marching distance* to those
//! that the user gave: fronts that start there hardly pass edges. Between all pairs the shortest paths
//! run along edges, where a step is cheap. How often a sample is passed is the *confidence* that it is
//! an edge, and the cheapest closed path over confident samples round the object is its boundary.
//! The boundary is a path from sample to sample: what it surrounds is smoothed, and points are where
//! that is steepest ([`steepest`](mod@crate::feature::non_max_suppression)).
//!
//! - `enhance`: the paths, their confidence, and the closed path
//! - `marching`: how long a front takes to reach every sample
//!
//! Scale: one sample for the gradient, 1.5 for the closed path. Assumptions: the object's edge is
//! steep nearly all the way round, and the first of its points lies inside it.

pub(crate) mod enhance;
pub(crate) mod marching;

use super::{Detector, DetectorInput, DetectorOutput, Thresholds};
use crate::error::Result;
use crate::feature::gradient_magnitude::gradient_magnitude;
use crate::feature::non_max_suppression::gradient_maxima;
use crate::feature::volume::Volume;
use crate::feature::{FeatureKind, gaussian};

/// Points of an object and around it, and how many are drawn near them.
#[derive(Debug, Clone, PartialEq)]
pub struct PathSeeds<const D: usize> {
    /// Points of the object, in the image's physical coordinates. The boundary goes round the first.
    pub object: Vec<[f64; D]>,
    /// Points of the background; the image's outermost samples if there are none.
    pub background: Vec<[f64; D]>,
    /// Ends of paths in the object.
    pub sources: usize,
    /// Ends of paths in the background.
    pub sinks: usize,
    /// Decides which.
    pub seed: u64,
}

impl<const D: usize> Default for PathSeeds<D> {
    /// The thesis's 50 sources and 100 sinks, near no point yet.
    fn default() -> Self {
        Self {
            object: Vec::new(),
            background: Vec::new(),
            sources: 50,
            sinks: 100,
            seed: 1,
        }
    }
}

/// Finds the boundary of an object.
pub struct Paths;

/// Width (samples) of the Gaussian that makes a smooth curve of a path from sample to sample.
const PATH_SCALE: f64 = 1.5;

/// A step from 0 to 1, smoothed over [`PATH_SCALE`], is 0.26 steep.
const MIN_STEP: Thresholds = Thresholds {
    low: 0.1,
    high: 0.1,
    origin: "of a step",
};

impl<const D: usize> Detector<D> for Paths {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Paths
    }

    fn find(
        &self,
        scene: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        let (dims, scale, seeds) = (scene.dims(), scene.scale(), &scene.options.seeds);
        let samples = scene.smoothed()?;
        let smoothed = Volume::new(dims, &samples);
        let found = enhance::enhance(smoothed, scene.source.geometry(), seeds, scene.cancel)?;
        let drawn = format!(
            "shortest paths at scale {scale} from {} sources in the object to {} sinks around it",
            seeds.sources, seeds.sinks
        );
        let mut candidates = Vec::new();
        if let Some(path) = &found.boundary {
            let mut values = enhance::inside_mask(smoothed, path);
            let inside = values.iter().filter(|v| **v == 1.0).count();
            let length = path.len();
            notes.push(format!(
                "{drawn}: a boundary of {length} samples around {inside}"
            ));
            gaussian::smooth(dims, &mut values, [PATH_SCALE; D], scene.cancel);
            let closed = Volume::new(dims, &values);
            let steepness = gradient_magnitude(closed, scene.cancel);
            candidates = gradient_maxima(
                closed,
                Volume::new(dims, &steepness),
                MIN_STEP.low,
                scene.cancel,
            );
        } else {
            notes.push(format!("{drawn}: no path goes around the object"));
        }
        Ok(DetectorOutput {
            confidence: Some(found.confidence),
            ..DetectorOutput::new(candidates, scale, MIN_STEP)
        })
    }
}

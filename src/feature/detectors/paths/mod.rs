//! The boundary of one object in the plane, by random shortest paths (Xu 2016, chapter 5).
//!
//! Points in the object and points around it are drawn at random, near the points that the user
//! gave. Nearness is measured by the *marching distance*: fronts that start at the given points
//! hardly cross edges. The shortest paths between all pairs of drawn points run along edges, where
//! steps are cheap. The share of the paths that pass a sample is the *confidence* that the sample
//! is on an edge. The cheapest closed path around the object, over confident samples, is its
//! boundary.
//!
//! The boundary is a path from sample to sample. The indicator of its inside is smoothed, and
//! feature points are the maxima of its gradient magnitude
//! ([`non_max_suppression`](mod@crate::feature::non_max_suppression)).
//!
//! - `enhance`: the paths, their confidence, and the closed path
//! - `marching`: travel time of a front to every sample
//!
//! Scale: one sample for the gradient, 1.5 for the closed path. Assumptions: the edge of the object
//! is steep nearly all around, and the first of the object's points lies inside it.

pub(crate) mod enhance;
pub(crate) mod marching;

use crate::error::Result;
use crate::feature::detection::MAX_IN_MEMORY_SAMPLES;
use crate::feature::detectors::{
    Detector, DetectorInput, DetectorOutput, ThresholdMeaning, Thresholds,
};
use crate::feature::gradient_magnitude::gradient_magnitude;
use crate::feature::non_max_suppression::gradient_maxima;
use crate::feature::volume::Volume;
use crate::feature::{FeatureKind, gaussian};

/// Points of an object and of the background, and numbers of points that are drawn near them.
#[derive(Debug, Clone, PartialEq)]
pub struct PathSeeds<const D: usize> {
    /// Points of the object, in the image's physical coordinates. The boundary goes around the
    /// first one.
    pub object: Vec<[f64; D]>,
    /// Points of the background; the samples on the sides of the image if there are none.
    pub background: Vec<[f64; D]>,
    /// Number of path ends in the object.
    pub sources: usize,
    /// Number of path ends in the background.
    pub sinks: usize,
    /// Seed of the random numbers.
    pub seed: u64,
}

impl<const D: usize> Default for PathSeeds<D> {
    /// Returns 50 sources and 100 sinks, as in the thesis, without points.
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

/// Detector of the boundary of an object.
pub struct Paths;

/// Width (samples) of the Gaussian that turns a path from sample to sample into a smooth curve.
const PATH_SCALE: f64 = 1.5;

/// Thresholds of the gradient magnitude: that of a step from 0 to 1 is 0.26 after smoothing over
/// [`PATH_SCALE`].
const MIN_STEP: Thresholds = Thresholds {
    low: 0.1,
    high: 0.1,
    origin: "of a step",
};

impl<const D: usize> Detector<D> for Paths {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Paths
    }

    /// Returns half of the usual number: paths search a graph of two copies of the image.
    fn max_samples(&self) -> u64 {
        MAX_IN_MEMORY_SAMPLES / 2
    }

    fn whole_image_reason(&self) -> Option<&'static str> {
        Some("comes from paths through the whole image and cannot be found again in a part")
    }

    fn fills_gaps(&self) -> bool {
        false
    }

    fn threshold_meaning(&self) -> ThresholdMeaning {
        ThresholdMeaning::Unused
    }

    fn find(
        &self,
        input: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        let (dims, scale, seeds) = (input.dims(), input.scale(), &input.options.seeds);
        let samples = input.smoothed()?;
        let smoothed = Volume::new(dims, &samples);
        let enhanced = enhance::enhance(smoothed, input.source.geometry(), seeds, input.cancel)?;
        let summary = format!(
            "shortest paths, on the image smoothed over {scale} samples, from {} points in the object to {} around it",
            seeds.sources, seeds.sinks
        );
        let mut candidates = Vec::new();
        if let Some(path) = &enhanced.boundary {
            let mut values = enhance::inside_mask(smoothed, path);
            let inside = values.iter().filter(|v| **v == 1.0).count();
            let length = path.len();
            notes.push(format!(
                "{summary}: a boundary of {length} samples around {inside}"
            ));
            gaussian::smooth(dims, &mut values, [PATH_SCALE; D], input.cancel);
            let inside_volume = Volume::new(dims, &values);
            let magnitudes = gradient_magnitude(inside_volume, input.cancel);
            candidates = gradient_maxima(
                inside_volume,
                Volume::new(dims, &magnitudes),
                MIN_STEP.low,
                input.cancel,
            );
        } else {
            notes.push(format!("{summary}: no path goes around the object"));
        }
        Ok(DetectorOutput {
            confidence: Some(enhanced.confidence),
            ..DetectorOutput::new(candidates, scale, MIN_STEP)
        })
    }
}

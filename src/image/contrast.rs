//! The contrast of faults and horizons in seismic amplitudes, over that at random places.
//!
//! The contrast at a fault is how much better traces on one side agree than those on both sides do
//! ([`FaultPoint::correlate`]). At a horizon it is the mean amplitude of a piece of it, less the image's mean.

use super::Image;
use super::fault_traces::FaultPoint;
use crate::geometry::random::Random;
use crate::geometry::statistics::upper_median;
use crate::parallel::prelude::*;

/// Number of random places for the contrast without features.
const RANDOM_PLACES: usize = 1000;

/// Largest confidence: images without noise have no contrast away from features.
const MAX_CONFIDENCE: f64 = 50.0;

/// The mean of an image's amplitudes, and their median distance from it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AmplitudeScale {
    pub mean: f64,
    pub deviation: f64,
}

impl AmplitudeScale {
    /// Measures an image. The deviation is that at random places.
    pub fn new<const D: usize>(image: &Image<D>) -> Self {
        let samples = image.as_slice();
        let sum: f64 = samples.iter().map(|&value| f64::from(value)).sum();
        let mean = sum / samples.len().max(1) as f64;
        let mut random = Random::new(1);
        let mut deviations: Vec<f64> = (0..RANDOM_PLACES)
            .map(|_| (random.draw() * samples.len() as f64) as usize)
            .map(|i| (f64::from(samples[i]) - mean).abs())
            .collect();
        let deviation = upper_median(&mut deviations).unwrap_or(0.0);
        Self { mean, deviation }
    }

    /// Returns the confidence of a horizon with this mean amplitude.
    pub fn horizon_confidence(self, amplitude: f64, is_peak: bool) -> f64 {
        let sign = if is_peak { 1.0 } else { -1.0 };
        let contrast = sign * (amplitude - self.mean);
        (contrast / self.deviation.max(f64::MIN_POSITIVE)).min(MAX_CONFIDENCE)
    }
}

/// Returns the confidence of a fault with this contrast in an image with the contrast
/// `random_contrast` at random places.
pub(crate) fn fault_confidence(contrast: f64, random_contrast: f64) -> f64 {
    (contrast / random_contrast).min(MAX_CONFIDENCE)
}

/// Returns the median of the absolute contrast at random places of an image, for planes with the
/// directions of `points`. `mean` is the image's mean.
pub(crate) fn random_contrast<const D: usize>(
    points: &[FaultPoint<D>],
    image: &Image<D>,
    vertical: usize,
    mean: f64,
) -> f64 {
    let mut random = Random::new(2);
    let dims = image.dims();
    let places: Vec<FaultPoint<D>> = (0..RANDOM_PLACES.min(points.len() * RANDOM_PLACES))
        .map(|_| FaultPoint {
            normal: points[(random.draw() * points.len() as f64) as usize].normal,
            position: dims.map(|n| random.range(0.0, (n - 1) as f64)),
        })
        .collect();
    let contrasts: Vec<Option<f64>> = (places.par_iter())
        .map(|place| place.correlate(image, vertical, mean))
        .map(|correlation| correlation.map(|c| c.contrast.abs()))
        .collect();
    let mut contrasts: Vec<f64> = contrasts.into_iter().flatten().collect();
    // The largest contrast is about 1.
    upper_median(&mut contrasts)
        .unwrap_or(1.0)
        .max(1.0 / MAX_CONFIDENCE)
}

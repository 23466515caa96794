//! Canny's edges, in the plane (1986) and, after Xu (2016), in space.
//!
//! The image is smoothed by a Gaussian. A sample is on an edge if the gradient magnitude is largest
//! along the gradient ([`non_max_suppression`](mod@crate::feature::non_max_suppression)). Two
//! thresholds then separate edges from noise: a weak edge is kept if it continues a strong one, as
//! [`surfaces`](mod@crate::feature::surfaces) does for every kind of feature.
//!
//! Scale: one sample. Thresholds: the gradient magnitudes that one sample in 100 and one in 100 000
//! of white noise exceed (quantiles of the chi distribution); the noise is estimated from the
//! median. Assumptions: half of the image or more is flat except for noise, which is white before
//! smoothing; the radius of curvature of an edge is large compared with the smoothing.

use super::{Detector, DetectorInput, DetectorOutput, Thresholds};
use crate::error::Result;
use crate::feature::FeatureKind;
use crate::feature::candidate::Candidate;
use crate::feature::corners::{self, sharpen_corners};
use crate::feature::gradient_magnitude::gradient_magnitude;
use crate::feature::non_max_suppression::gradient_maxima;
use crate::feature::ridges::typical_strength;
use crate::feature::volume::Volume;
use crate::geometry::statistics::upper_median;

/// Detector of edges at maxima of the gradient magnitude.
pub struct Canny;

impl<const D: usize> Detector<D> for Canny {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Canny
    }

    fn find(
        &self,
        input: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        let (dims, scale) = (input.dims(), input.scale());
        let samples = input.smoothed()?;
        let smoothed = Volume::new(dims, &samples);
        let magnitudes = gradient_magnitude(smoothed, input.cancel);
        let noise = noise_thresholds::<D>(&magnitudes);
        let given_thresholds = input.thresholds();
        // If the image has no flat parts, the thresholds are lower than those of the noise.
        let low = given_thresholds.map_or(0.5 * noise[0], |thresholds| thresholds.low);
        let mut candidates =
            gradient_maxima(smoothed, Volume::new(dims, &magnitudes), low, input.cancel);
        let thresholds = given_thresholds.unwrap_or_else(|| thresholds(noise, &candidates));
        candidates.retain(|c| c.strength >= thresholds.low);
        notes.push(format!(
            "edges: the steepest places of the image, smoothed over {scale} samples; {thresholds}; noise has up \
             to {:.4} per sample",
            noise[1]
        ));
        let candidates = sharpen_corners(dims, candidates, scale, thresholds.high, input.cancel);
        Ok(DetectorOutput::new(candidates, scale, thresholds))
    }

    /// Returns the reach of detection, which includes that of corners along their arms.
    fn reach(&self, scale: f64) -> usize {
        (3.0 * scale).ceil() as usize + 3 + corners::corner_reach(scale)
    }
}

/// Returns the median of the gradient magnitude of smoothed white noise, and the magnitudes that
/// one sample in 100 and one in 100 000 exceed, in units of one component's standard deviation.
/// Such gradients have D independent, normally distributed components, so that these are quantiles
/// of the chi distribution of D degrees of freedom.
const fn noise_quantiles(dimensions: usize) -> (f32, [f32; 2]) {
    if dimensions == 3 {
        (1.5382, [3.3682, 5.0894])
    } else {
        (1.1774, [3.0349, 4.7985])
    }
}

/// Returns the thresholds (low, high) that noise rarely reaches. Half of an image or more is taken
/// for noise on a flat background, so that the median of the gradient magnitude measures the noise.
fn noise_thresholds<const D: usize>(magnitudes: &[f32]) -> [f32; 2] {
    // About 10^5 samples give the median to one per cent.
    let stride = (magnitudes.len() / 200_000).max(1) | 1;
    let mut subsample: Vec<f32> = magnitudes.iter().step_by(stride).copied().collect();
    let Some(median) = upper_median(&mut subsample) else {
        return [0.0; 2];
    };
    let (median_quantile, exceeded) = noise_quantiles(D);
    exceeded.map(|e| e / median_quantile * median)
}

/// Returns the thresholds (low, high) of edges. They are above the noise, and at least a tenth and
/// a quarter of the typical strength of edges (sum of cubes divided by sum of squares), so that
/// faint edges of an image without noise are dropped. If the image has no flat parts, the median is
/// not noise, so that the thresholds are at most a half and nine tenths of the typical strength.
fn thresholds<const D: usize>(noise: [f32; 2], candidates: &[Candidate<D>]) -> Thresholds {
    let typical = typical_strength(candidates.iter().map(|c| c.strength));
    let [low, high] = noise;
    Thresholds {
        low: low.max(0.1 * typical).min(0.5 * typical),
        high: high.max(0.25 * typical).min(0.9 * typical),
        origin: "chosen from the noise",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::Noise;
    use crate::feature::{DetectionOptions, FeatureKind, detect};
    use crate::image::{Geometry, Image};
    use crate::progress::CancelToken;

    /// Returns an image of a ball (a disc in 2-D), 100 inside and 0 outside, with an edge one
    /// sample wide and noise.
    fn ball<const D: usize>(
        dims: [usize; D],
        centre: [f64; D],
        radius: f64,
        noise: f64,
    ) -> Image<D> {
        let mut random = Noise::new(5);
        let empty = Volume { dims, samples: &[] };
        let samples = (0..dims.iter().product()).map(|i| {
            let distance = distance_to_ball(empty.coordinates(i).map(|c| c as f64), centre, radius);
            (100.0 * (0.5 - distance).clamp(0.0, 1.0) + noise * random.normal()) as f32
        });
        Image::new(dims, samples.collect(), Geometry::default())
    }

    fn distance_to_ball<const D: usize>(p: [f64; D], centre: [f64; D], radius: f64) -> f64 {
        let squares: f64 = (0..D).map(|k| (p[k] - centre[k]).powi(2)).sum();
        squares.sqrt() - radius
    }

    /// Checks the edge of a ball: every point is within half a sample of it, its normal is along
    /// the radius, the root mean square distance is below `rms`, and the points have no gaps.
    fn check_ball_edge<const D: usize>(
        dims: [usize; D],
        centre: [f64; D],
        radius: f64,
        noise: f64,
        rms: f64,
    ) {
        let image = ball(dims, centre, radius, noise);
        let features = detect(
            &image,
            &DetectionOptions::with_kind(FeatureKind::Canny, 4.0),
        )
        .unwrap();
        let (mut worst, mut squares) = (0.0f64, 0.0);
        for point in &features.points {
            let p = point.position.map(f64::from);
            let distance = distance_to_ball(p, centre, radius);
            worst = worst.max(distance.abs());
            squares += distance * distance;
            let radial: f64 = (0..D)
                .map(|k| (p[k] - centre[k]) / radius * f64::from(point.normal[k]))
                .sum();
            assert!(radial.abs() > 0.95, "{radial}");
        }
        let measured_rms = (squares / features.points.len() as f64).sqrt();
        assert!(
            worst < 0.5 && measured_rms < rms,
            "worst {worst}, rms {measured_rms}, {:?}",
            features.notes
        );
        // Every sample within half a sample of the edge has a point at most 1.3 samples away.
        let empty = Volume { dims, samples: &[] };
        for i in 0..dims.iter().product() {
            let p = empty.coordinates(i).map(|c| c as f64);
            if distance_to_ball(p, centre, radius).abs() < 0.5 {
                let has_near_point = features.points.iter().any(|point| {
                    let squares = (0..D).map(|k| (f64::from(point.position[k]) - p[k]).powi(2));
                    squares.sum::<f64>() < 1.3 * 1.3
                });
                assert!(has_near_point, "no point near {p:?}");
            }
        }
    }

    #[test]
    fn a_circle_and_a_sphere_are_found_within_half_a_sample() {
        check_ball_edge([90, 80], [44.3, 40.7], 27.4, 0.0, 0.06);
        check_ball_edge([90, 80], [44.3, 40.7], 27.4, 5.0, 0.15);
        check_ball_edge([46, 44, 42], [22.3, 21.7, 20.5], 14.6, 0.0, 0.11);
        check_ball_edge([46, 44, 42], [22.3, 21.7, 20.5], 14.6, 5.0, 0.2);
    }

    /// Shares of the samples of pure noise that reach the lower and the upper threshold.
    const FALSE_ALARM_RATES: [f64; 2] = [1e-2, 1e-5];

    #[test]
    fn noise_reaches_the_thresholds_at_the_stated_rates() {
        fn exceedance_rates<const D: usize>(dims: [usize; D]) -> [f64; 2] {
            let mut random = Noise::new(11);
            let mut samples: Vec<f32> = (0..dims.iter().product())
                .map(|_| random.normal() as f32)
                .collect();
            crate::feature::gaussian::smooth(dims, &mut samples, [1.0; D], &CancelToken::never());
            let magnitudes = gradient_magnitude(
                Volume {
                    dims,
                    samples: &samples,
                },
                &CancelToken::never(),
            );
            noise_thresholds::<D>(&magnitudes).map(|t| {
                let above = magnitudes.iter().filter(|s| **s >= t).count();
                above as f64 / magnitudes.len() as f64
            })
        }
        for [low, high] in [
            exceedance_rates([900, 800]),
            exceedance_rates([80, 90, 100]),
        ] {
            assert!((low / FALSE_ALARM_RATES[0] - 1.0).abs() < 0.25, "{low}");
            assert!(high < 10.0 * FALSE_ALARM_RATES[1], "{high}");
        }
    }
}

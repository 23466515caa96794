//! Canny's edges, in the plane (1986) and, as Xu (2016) finds them, in space.
//!
//! The image is smoothed by a Gaussian; a sample is an edge's where the magnitude of the gradient is
//! largest along the gradient ([`steepest`](mod@crate::feature::non_max_suppression)). Two thresholds then tell
//! edges from noise: a weak edge is kept where it continues a strong one, which is what
//! [`sheets`](mod@crate::feature::surfaces) does for every kind of feature.
//!
//! Scale: one sample. Thresholds: of gradients of white noise, the magnitudes that one sample in 100 and
//! one in 100 000 exceeds (quantiles of the chi distribution), the noise judged by the median.
//! Assumptions: half of the image or more is flat but for noise, which is white before smoothing; an
//! edge's bend is wide against the smoothing.

use super::{Detector, DetectorInput, DetectorOutput, Thresholds};
use crate::error::Result;
use crate::feature::FeatureKind;
use crate::feature::candidate::Candidate;
use crate::feature::corners::{self, sharpen_corners};
use crate::feature::gradient_magnitude::gradient_magnitude;
use crate::feature::non_max_suppression::gradient_maxima;
use crate::feature::ridges::typical_strength;
use crate::feature::volume::Volume;

/// Finds edges where the gradient is steepest.
pub struct Canny;

impl<const D: usize> Detector<D> for Canny {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Canny
    }

    fn find(
        &self,
        scene: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        let (dims, scale) = (scene.dims(), scene.scale());
        let samples = scene.smoothed()?;
        let smoothed = Volume::new(dims, &samples);
        let steepness = gradient_magnitude(smoothed, scene.cancel);
        let noise = noise_thresholds::<D>(&steepness);
        let given = scene.thresholds();
        // Where there is no flat ground the thresholds are lower than noise would ask.
        let floor = given.map_or(0.5 * noise[0], |given| given.low);
        let mut candidates =
            gradient_maxima(smoothed, Volume::new(dims, &steepness), floor, scene.cancel);
        let thresholds = given.unwrap_or_else(|| thresholds(noise, &candidates));
        candidates.retain(|c| c.strength >= thresholds.low);
        notes.push(format!(
            "steepest places at scale {scale}: {thresholds}, noise up to {:.4} per sample",
            noise[1]
        ));
        let candidates = sharpen_corners(dims, candidates, scale, thresholds.high, scene.cancel);
        Ok(DetectorOutput::new(candidates, scale, thresholds))
    }

    /// Corners look along their arms.
    fn reach(&self, scale: f64) -> usize {
        (3.0 * scale).ceil() as usize + 3 + corners::corner_reach(scale)
    }
}

/// Gradients of smoothed white noise have D independent, normally distributed components: medians of
/// their magnitude, and what it exceeds at one sample in 100 and at one in 100 000, in units of one
/// component's standard deviation (quantiles of the chi distribution of D degrees of freedom).
const fn noise_quantiles(dimensions: usize) -> (f32, [f32; 2]) {
    if dimensions == 3 {
        (1.5382, [3.3682, 5.0894])
    } else {
        (1.1774, [3.0349, 4.7985])
    }
}

/// Thresholds (low, high) that noise hardly reaches: half of an image or more is taken for noise on
/// flat ground, so the median of the gradient's magnitude tells how strong that is.
fn noise_thresholds<const D: usize>(steepness: &[f32]) -> [f32; 2] {
    // Some 10^5 samples tell the median to a per cent.
    let stride = (steepness.len() / 200_000).max(1) | 1;
    let mut some: Vec<f32> = steepness.iter().step_by(stride).copied().collect();
    let middle = some.len() / 2;
    if some.is_empty() {
        return [0.0; 2];
    }
    let median = *some.select_nth_unstable_by(middle, f32::total_cmp).1;
    let (of_median, exceeded) = noise_quantiles(D);
    exceeded.map(|e| e / of_median * median)
}

/// Thresholds (low, high) of edges: above the noise, and at least a tenth and a quarter of the typical
/// edge's strength (sum of cubes over sum of squares, which the strong ones decide), so that faint
/// edges of an image without noise are left out; but where there is no flat ground and the median is
/// not noise, at most half and nine tenths of it.
fn thresholds<const D: usize>(noise: [f32; 2], candidates: &[Candidate<D>]) -> Thresholds {
    let typical = typical_strength(candidates.iter().map(|c| c.strength));
    let [low, high] = noise;
    Thresholds {
        low: low.max(0.1 * typical).min(0.5 * typical),
        high: high.max(0.25 * typical).min(0.9 * typical),
        origin: "chosen",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::Noise;
    use crate::feature::{DetectionOptions, FeatureKind, detect};
    use crate::image::{Geometry, Image};
    use crate::progress::CancelToken;

    /// An image of a ball (a disc in 2-D), 100 inside and 0 outside, with an edge one sample wide and
    /// noise.
    fn ball<const D: usize>(
        dims: [usize; D],
        centre: [f64; D],
        radius: f64,
        noise: f64,
    ) -> Image<D> {
        let mut random = Noise::new(5);
        let empty = Volume { dims, samples: &[] };
        let samples = (0..dims.iter().product()).map(|i| {
            let off = distance_to_ball(empty.coordinates(i).map(|c| c as f64), centre, radius);
            (100.0 * (0.5 - off).clamp(0.0, 1.0) + noise * random.normal()) as f32
        });
        Image::new(dims, samples.collect(), Geometry::default())
    }

    fn distance_to_ball<const D: usize>(p: [f64; D], centre: [f64; D], radius: f64) -> f64 {
        let squares: f64 = (0..D).map(|k| (p[k] - centre[k]).powi(2)).sum();
        squares.sqrt() - radius
    }

    /// Finds the edge of a ball: every point within half a sample of it, its normal along the radius,
    /// the rms below `rms`, and no way round without meeting one.
    fn check_ball_edge<const D: usize>(
        dims: [usize; D],
        centre: [f64; D],
        radius: f64,
        noise: f64,
        rms: f64,
    ) {
        let image = ball(dims, centre, radius, noise);
        let found = detect(
            &image,
            &DetectionOptions::with_kind(FeatureKind::Canny, 4.0),
        )
        .unwrap();
        let (mut worst, mut squares) = (0.0f64, 0.0);
        for point in &found.points {
            let p = point.position.map(f64::from);
            let off = distance_to_ball(p, centre, radius);
            worst = worst.max(off.abs());
            squares += off * off;
            let along: f64 = (0..D)
                .map(|k| (p[k] - centre[k]) / radius * f64::from(point.normal[k]))
                .sum();
            assert!(along.abs() > 0.95, "{along}");
        }
        let got = (squares / found.points.len() as f64).sqrt();
        assert!(
            worst < 0.5 && got < rms,
            "worst {worst}, rms {got}, {:?}",
            found.notes
        );
        // Every sample within half a sample of the edge has a point at most a sample (and a bit) away.
        let empty = Volume { dims, samples: &[] };
        for i in 0..dims.iter().product() {
            let p = empty.coordinates(i).map(|c| c as f64);
            if distance_to_ball(p, centre, radius).abs() < 0.5 {
                let near = found.points.iter().any(|point| {
                    let squares = (0..D).map(|k| (f64::from(point.position[k]) - p[k]).powi(2));
                    squares.sum::<f64>() < 1.3 * 1.3
                });
                assert!(near, "no point near {p:?}");
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

    /// Shares of the samples of pure noise that reach the lower and the higher threshold.
    const FALSE_ALARM_RATES: [f64; 2] = [1e-2, 1e-5];

    #[test]
    fn noise_alone_reaches_the_thresholds_as_often_as_said() {
        fn exceedance_rates<const D: usize>(dims: [usize; D]) -> [f64; 2] {
            let mut random = Noise::new(11);
            let mut samples: Vec<f32> = (0..dims.iter().product())
                .map(|_| random.normal() as f32)
                .collect();
            crate::feature::gaussian::smooth(dims, &mut samples, [1.0; D], &CancelToken::never());
            let steepness = gradient_magnitude(
                Volume {
                    dims,
                    samples: &samples,
                },
                &CancelToken::never(),
            );
            noise_thresholds::<D>(&steepness).map(|t| {
                let above = steepness.iter().filter(|s| **s >= t).count();
                above as f64 / steepness.len() as f64
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

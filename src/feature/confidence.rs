//! Confidence of faults and horizons: their contrast in seismic amplitudes over that at random places.
//!
//! The contrast at a fault is how much better traces on one side agree than those on both sides do
//! (`image::fault_traces`). At a horizon it is the mean amplitude of a piece of it, less the image's mean. Surfaces in
//! noise have confidences below 1, because the contrasts of their points have both signs.

use std::collections::BTreeMap;

use serde::Serialize;

use super::surfaces::FeatureSurfaces;
use crate::geometry::statistics::upper_median;
use crate::geometry::unit;
use crate::image::Image;
use crate::image::contrast::{AmplitudeScale, fault_confidence, random_contrast};
use crate::image::fault_traces::FaultPoint;
use crate::parallel::prelude::*;

/// Largest number of points of a fault that are measured, and smallest number of points with a contrast.
const MAX_POINTS: usize = 400;
const MIN_POINTS: usize = 5;

/// Edge of the cubes (samples) in which amplitudes of a horizon are averaged. In each its sign is the same,
/// unless it jumps to another reflector there.
const PIECE_EDGE: f64 = 16.0;

/// Confidence below which a surface has no more contrast than noise. In seven synthetic volumes with
/// signal-to-noise ratios from 0.5 to 4, the faults that were found have 1.3 or more and the horizons 0.8 or
/// more; in a volume of noise the horizons have 0.4 to 0.5 at the median.
pub const DOUBTFUL_CONFIDENCE: f64 = 1.0;

/// Confidences of the surfaces of one kind.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Confidences {
    /// Number of surfaces that are followed and have a confidence.
    pub surfaces: usize,
    /// The lowest confidence of those.
    pub lowest: f64,
    /// The median confidence of those.
    pub median: f64,
    /// Number of those with a confidence below [`DOUBTFUL_CONFIDENCE`].
    pub doubtful: usize,
    /// Share of the followed points that lie on doubtful surfaces.
    pub doubtful_share: f64,
    /// Number of surfaces that are left out because their confidence is below
    /// [`min_confidence`](super::DetectionOptions::min_confidence).
    pub dropped: usize,
}

/// Returns the confidence of each surface in an image of amplitudes; `None` where it cannot be
/// measured: near the sides of the image, and on faults that are too flat. Points are in lattice
/// space, with samples `step` apart. `vertical` is the vertical axis for faults, and `None` for
/// horizons.
pub(super) fn confidences<const D: usize>(
    image: &Image<D>,
    surfaces: &FeatureSurfaces<'_, D>,
    step: [f64; D],
    vertical: Option<usize>,
) -> Vec<Option<f64>> {
    let mut on_surface: Vec<Vec<usize>> = vec![Vec::new(); surfaces.surface_count];
    for (i, &surface) in surfaces.surface.iter().enumerate() {
        on_surface[surface as usize - 1].push(i);
    }
    let scale = AmplitudeScale::new(image);
    let in_samples = |i: usize| {
        let point = &surfaces.points[i];
        FaultPoint {
            position: std::array::from_fn(|k| f64::from(point.position[k]) / step[k]),
            normal: unit(std::array::from_fn(|k| {
                f64::from(point.normal[k]) * step[k]
            })),
        }
    };
    let Some(vertical) = vertical else {
        let confidence = |points: &Vec<usize>| {
            // Sum of contrasts in each piece.
            let mut pieces: BTreeMap<[i64; D], f64> = BTreeMap::new();
            for &i in points {
                let position = in_samples(i).position;
                let piece = position.map(|c| (c / PIECE_EDGE) as i64);
                let contrast = f64::from(image.interpolate_linear(position)) - scale.mean;
                *pieces.entry(piece).or_default() += contrast;
            }
            let sum: f64 = pieces.values().map(|sum| sum.abs()).sum();
            let amplitude = scale.mean + sum / points.len() as f64;
            (points.len() >= MIN_POINTS).then(|| scale.horizon_confidence(amplitude, true))
        };
        return on_surface.iter().map(confidence).collect();
    };
    for points in &mut on_surface {
        let every = points.len().div_ceil(MAX_POINTS).max(1);
        *points = points.iter().copied().step_by(every).collect();
    }
    let all: Vec<FaultPoint<D>> = on_surface
        .iter()
        .flatten()
        .map(|&i| in_samples(i))
        .collect();
    let random = random_contrast(&all, image, vertical, scale.mean);
    let confidence = |points: &Vec<usize>| {
        let contrasts: Vec<Option<f64>> = (points.par_iter())
            .map(|&i| in_samples(i).correlate(image, vertical, scale.mean))
            .map(|correlation| correlation.map(|c| c.contrast))
            .collect();
        let contrasts: Vec<f64> = contrasts.into_iter().flatten().collect();
        let mean = contrasts.iter().sum::<f64>() / contrasts.len() as f64;
        (contrasts.len() >= MIN_POINTS).then(|| fault_confidence(mean, random))
    };
    on_surface.iter().map(confidence).collect()
}

impl Confidences {
    /// Summarises the confidences of `surfaces`, of all ranks, and says which surfaces are to stay:
    /// those with a confidence of at least `min` and those without one. `None` if no surface has one.
    pub(super) fn summarise<const D: usize>(
        surfaces: &FeatureSurfaces<'_, D>,
        confidences: &[Option<f64>],
        min: Option<f64>,
    ) -> Option<(Self, Vec<bool>)> {
        let is_below = |confidence: &Option<f64>, limit: f64| confidence.is_some_and(|c| c < limit);
        let stays = |confidence| min.is_none_or(|min| !is_below(confidence, min));
        let stays: Vec<bool> = confidences.iter().map(stays).collect();
        let dropped = stays.iter().filter(|stays| !**stays).count();
        let kept = confidences.iter().zip(&stays).filter(|(_, stays)| **stays);
        let mut known: Vec<f64> = kept.filter_map(|(confidence, _)| *confidence).collect();
        if known.is_empty() && dropped == 0 {
            return None;
        }
        let median = upper_median(&mut known).unwrap_or_default();
        let (mut doubtful_points, mut points) = (0, 0);
        for &surface in &surfaces.surface {
            let s = surface as usize - 1;
            points += usize::from(stays[s]);
            doubtful_points +=
                usize::from(stays[s] && is_below(&confidences[s], DOUBTFUL_CONFIDENCE));
        }
        let summary = Self {
            surfaces: known.len(),
            lowest: (known.iter().copied().min_by(f64::total_cmp)).unwrap_or_default(),
            median,
            doubtful: known.iter().filter(|c| **c < DOUBTFUL_CONFIDENCE).count(),
            doubtful_share: f64::from(doubtful_points as u32) / f64::from(points.max(1) as u32),
            dropped,
        };
        Some((summary, stays))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::{DroppedPoints, FeaturePoint, SharedGrid};
    use crate::geometry::random::Random;
    use crate::image::Geometry;

    const DIMS: [usize; 3] = [60, 50, 96];

    /// Returns layers that a fault at x = 30 displaces by 7 samples, with noise of this amplitude.
    fn faulted_layers(noise: f64) -> Image<3> {
        let mut random = Random::new(5);
        let spikes: Vec<f64> = (0..DIMS[2] + 16).map(|_| random.range(-1.0, 1.0)).collect();
        let layer = |window: &[f64]| -> f64 {
            let weights = [0.1, 0.2, 0.4, 0.2, 0.1];
            window.iter().zip(weights).map(|(c, w)| 3.0 * c * w).sum()
        };
        let layers: Vec<f64> = spikes.windows(5).map(layer).collect();
        let mut samples = Vec::with_capacity(DIMS.iter().product());
        for k in 0..DIMS[2] {
            for _ in 0..DIMS[1] {
                for i in 0..DIMS[0] {
                    let shift = if i > 30 { 7 } else { 0 };
                    samples.push((layers[k + shift] + noise * random.range(-1.0, 1.0)) as f32);
                }
            }
        }
        Image::new(DIMS, samples, Geometry::default())
    }

    /// Returns the points of the planes x = 30.5 (surface 1), on the fault, and x = 14.3 (surface 2), in
    /// lattice space with steps of 2 along x.
    fn planes() -> FeatureSurfaces<'static, 3> {
        let mut points = Vec::new();
        let mut surface = Vec::new();
        for (number, x) in [(1, 30.5), (2, 14.3)] {
            for j in 0..DIMS[1] {
                for k in 0..DIMS[2] {
                    points.push(FeaturePoint {
                        position: [2.0 * x, j as f32, k as f32 + 0.3],
                        normal: [1.0, 0.0, 0.0],
                        strength: 1.0,
                    });
                    surface.push(number);
                }
            }
        }
        FeatureSurfaces {
            grid: SharedGrid::of_one_process(DIMS),
            is_rim: vec![false; points.len()],
            total_points: points.len(),
            points,
            surface,
            surface_count: 2,
            dropped: DroppedPoints::default(),
        }
    }

    #[test]
    fn a_displacement_has_a_confidence_above_four_and_unbroken_layers_have_less_than_one_and_a_half()
     {
        for noise in [0.3, 1.0] {
            let image = faulted_layers(noise);
            let found = confidences(&image, &planes(), [2.0, 1.0, 1.0], Some(2));
            let [on_fault, beside] = [0, 1].map(|s| found[s].unwrap());
            assert!(on_fault > 4.0, "{noise}: {on_fault}");
            assert!(beside < 1.5, "{noise}: {beside}");
        }
    }

    #[test]
    fn surfaces_in_noise_have_less_than_one() {
        let mut random = Random::new(7);
        let samples: Vec<f32> = (0..DIMS.iter().product())
            .map(|_| random.range(-1.0, 1.0) as f32)
            .collect();
        let image = Image::new(DIMS, samples, Geometry::default());
        for vertical in [Some(2), None] {
            for confidence in confidences(&image, &planes(), [2.0, 1.0, 1.0], vertical) {
                assert!(confidence.unwrap().abs() < 1.0, "{confidence:?}");
            }
        }
    }

    #[test]
    fn surfaces_below_the_smallest_confidence_are_dropped_and_the_others_numbered_again() {
        let mut surfaces = planes();
        let all = surfaces.clone();
        let (summary, stays) =
            Confidences::summarise(&all, &[Some(0.9), Some(4.0)], Some(2.0)).unwrap();
        assert_eq!(stays, [false, true]);
        assert_eq!(
            (summary.surfaces, summary.dropped, summary.doubtful),
            (1, 1, 0)
        );
        assert_eq!((summary.lowest, summary.median), (4.0, 4.0));
        surfaces.keep(&stays, &all);
        assert_eq!(
            (surfaces.surface_count, surfaces.total_points),
            (1, all.total_points / 2)
        );
        assert!(surfaces.surface.iter().all(|&s| s == 1));
        assert!(
            surfaces
                .points
                .iter()
                .all(|point| point.position[0] == 28.6)
        );

        // Without a limit all stay, and the doubtful ones are counted. Unknown confidences stay always.
        let (summary, stays) = Confidences::summarise(&all, &[Some(0.9), None], None).unwrap();
        assert_eq!(stays, [true, true]);
        assert_eq!((summary.doubtful, summary.doubtful_share), (1, 0.5));
        assert_eq!(Confidences::summarise(&all, &[None, None], Some(2.0)), None);
    }
}

//! Edges: steps between low and high values, found as ridges of the gradient magnitude.
//!
//! The gradient magnitude is Prewitt's ([`prewitt`]), as Hale (2001) uses it for a medical image,
//! of the image under a Gaussian of one sample. Its ridges are found as those of any image
//! ([`ridges`](super::ridges)), so that it is smoothed once more.
//!
//! Scale: one sample, for the gradient and its ridges. Where noise hides the ridges, larger scales
//! are used. Assumption: the radius of curvature of an edge is large compared with the smoothing.
//! Smoothing moves an edge of radius r towards its centre of curvature, by 0.19 samples for r = 19.

use super::ridges::RidgeSearch;
use super::{Detector, DetectorInput, DetectorOutput};
use crate::error::Result;
use crate::feature::FeatureKind;
use crate::feature::corners::{self, sharpen_corners};
use crate::feature::gradient_magnitude::prewitt;
use crate::geometry::hypot;

/// Detector of steps between low and high values.
pub struct Edges;

impl<const D: usize> Detector<D> for Edges {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Edges
    }

    fn find(
        &self,
        input: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        let dims = input.dims();
        let smoothed = input.smoothed_in_layers()?;
        let magnitude =
            smoothed.map_windows(1, input.cancel, |stack| prewitt(stack.volume, input.cancel))?;
        drop(smoothed);
        let search = RidgeSearch {
            min_scale: 1.0,
            uses_oriented_filters: false,
            ..RidgeSearch::new(input)
        };
        let mut output = search.find(magnitude, notes)?;
        // The image is smoothed before the gradient is taken, and the gradient magnitude before its
        // ridges are.
        let width = hypot(input.scale(), output.scale);
        let min_strength = output.thresholds.high;
        if D == 2 {
            let candidates = output.gather_candidates(input.grid)?;
            output.candidates =
                sharpen_corners(dims, candidates, width, min_strength, input.cancel);
        }
        Ok(output)
    }

    fn is_streamable(&self) -> bool {
        true
    }

    fn has_scattered_normals(&self) -> bool {
        true
    }

    /// Returns the reach of detection, which includes that of corners along their arms.
    fn reach(&self, scale: f64) -> usize {
        (3.0 * scale).ceil() as usize + 3 + corners::corner_reach(hypot(scale, scale))
    }
}

#[cfg(test)]
mod tests {
    use crate::feature::scenes::{ExactSurface, Noise, image_of, measure_fit};
    use crate::feature::{DetectionOptions, FeatureKind, detect};

    #[test]
    fn edges_of_a_ball() {
        // Smoothing moves an edge towards its centre of curvature, by 0.19 samples at this radius;
        // the remaining error is noise.
        let (dims, ball) = ([60, 56, 52], ExactSurface::Sphere([30.0, 28.0, 26.0], 19.0));
        let mut noise = Noise::new(3);
        let image = image_of(dims, |p| {
            100.0 / (1.0 + ball.distance(p).exp()) + 5.0 * noise.normal()
        });
        let features = detect(
            &image,
            &DetectionOptions::with_kind(FeatureKind::Edges, 5.0),
        )
        .unwrap();
        let fit = measure_fit(dims, &[ball], &features.points);
        assert!(
            fit.coverage > 0.98 && fit.precision > 0.98 && fit.rms < 0.24,
            "{fit:?}"
        );
    }

    #[test]
    fn straight_edges_lie_where_they_are() {
        let (dims, wall) = (
            [48, 44, 40],
            [ExactSurface::plane([1.0, 0.45, -0.3], [24.0, 22.0, 20.0])],
        );
        let mut noise = Noise::new(4);
        let image = image_of(dims, |p| {
            100.0 / (1.0 + wall[0].distance(p).exp()) + 5.0 * noise.normal()
        });
        let features = detect(
            &image,
            &DetectionOptions::with_kind(FeatureKind::Edges, 5.0),
        )
        .unwrap();
        let fit = measure_fit(dims, &wall, &features.points);
        assert!(
            fit.coverage > 0.99 && fit.precision > 0.99 && fit.rms < 0.08 && fit.angle < 2.0,
            "{fit:?}"
        );
    }
}

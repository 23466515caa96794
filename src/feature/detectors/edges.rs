//! Edges: steps between low and high values, as ridges of the gradient's magnitude.
//!
//! The magnitude is Prewitt's ([`prewitt`]), as Hale (2001) takes it for a medical image, of the image
//! under a Gaussian of one sample; its ridges are found as those of any image
//! ([`ridges`](super::ridges)), so it is smoothed once more.
//!
//! Scale: one sample, for gradient and ridges alike; where ridges drown in noise they are sought on
//! coarser ones. Assumption: an edge's bend is wide against the smoothing. It draws an edge of radius r
//! towards its centre of curvature, by 0.19 samples where r = 19.

use super::ridges::RidgeSearch;
use super::{Detector, Found, Scene};
use crate::error::Result;
use crate::feature::FeatureKind;
use crate::feature::corners::{self, cornered};
use crate::feature::steepness::prewitt;
use crate::ranks::Ranks;

/// Finds steps between low and high values.
pub struct Edges;

impl<const D: usize> Detector<D> for Edges {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Edges
    }

    fn find(&self, scene: &Scene<'_, D>, notes: &mut Vec<String>) -> Result<Found<D>> {
        let dims = scene.dims();
        let smoothed = scene.smoothed_in_layers()?;
        let steepness = smoothed.changed(1, scene.patience, |stack| {
            prewitt(stack.volume, scene.patience)
        })?;
        drop(smoothed);
        let search = RidgeSearch {
            finest: 1.0,
            lifts: false,
            ..RidgeSearch::new(scene)
        };
        let mut found = search.find(steepness, notes)?;
        // Smoothed for the gradient and for its ridges.
        let width = scene.scale().hypot(found.scale);
        let sure = found.thresholds.high;
        if D == 2 {
            let candidates = found.of_all(&Ranks)?;
            found.candidates = cornered(dims, candidates, width, sure, scene.patience);
        }
        Ok(found)
    }

    fn in_layers(&self) -> bool {
        true
    }

    /// Corners look along their arms.
    fn reach(&self, scale: f64) -> usize {
        (3.0 * scale).ceil() as usize + 3 + corners::reach(scale.hypot(scale))
    }
}

#[cfg(test)]
mod tests {
    use crate::feature::scenes::{Noise, Sheet, fit, image_of};
    use crate::feature::{Detection, FeatureKind, detect};

    #[test]
    fn edges_of_a_ball() {
        // Smoothing draws an edge towards its centre of curvature: here by 0.19 samples, the more the
        // stronger it bends; what is left is noise.
        let (dims, ball) = ([60, 56, 52], Sheet::Sphere([30.0, 28.0, 26.0], 19.0));
        let mut noise = Noise::new(3);
        let image = image_of(dims, |p| {
            100.0 / (1.0 + ball.distance(p).exp()) + 5.0 * noise.normal()
        });
        let features = detect(&image, &Detection::of(FeatureKind::Edges, 5.0)).unwrap();
        let fit = fit(dims, &[ball], &features.points);
        assert!(
            fit.coverage > 0.98 && fit.precision > 0.98 && fit.rms < 0.24,
            "{fit:?}"
        );
    }

    #[test]
    fn straight_edges_lie_where_they_are() {
        let (dims, wall) = (
            [48, 44, 40],
            [Sheet::plane([1.0, 0.45, -0.3], [24.0, 22.0, 20.0])],
        );
        let mut noise = Noise::new(4);
        let image = image_of(dims, |p| {
            100.0 / (1.0 + wall[0].distance(p).exp()) + 5.0 * noise.normal()
        });
        let features = detect(&image, &Detection::of(FeatureKind::Edges, 5.0)).unwrap();
        let fit = fit(dims, &wall, &features.points);
        assert!(
            fit.coverage > 0.99 && fit.precision > 0.99 && fit.rms < 0.08 && fit.angle < 2.0,
            "{fit:?}"
        );
    }
}

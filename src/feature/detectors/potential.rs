//! An image that is b(x) itself: -1 on features, 0 away from them.
//!
//! b(x) is used sample by sample. The feature points, to which the mesh is fitted, are those of its
//! valleys ([`Ridges`]), with the scale and thresholds of valleys. Assumption: the image is in
//! [-1, 0], and its valleys are as wide as the lattice needs (a standard deviation of d_min / 4,
//! Hale 2002).

use super::ridges::Ridges;
use super::{Brightness, Detector, DetectorInput, DetectorOutput};
use crate::error::{Error, Result, cause};
use crate::feature::FeatureKind;
use crate::image::Image;

/// Detector for an image that is b(x).
pub struct Potential;

impl<const D: usize> Detector<D> for Potential {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Potential
    }

    /// Returns `false`: b(x) is used as it is.
    fn fills_gaps(&self) -> bool {
        false
    }

    fn find(
        &self,
        input: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        let mut samples = input.image()?.as_slice().iter();
        if let Some(value) = samples.find(|s| !(-1.0..=0.0).contains(*s)) {
            return Err(Error::Image(cause(
                "image",
                format!("holds {value}, but values of a potential lie from -1 (on features) to 0"),
                "scale the image, or choose another --feature",
            )));
        }
        Ridges(Brightness::Dark).find(input, notes)
    }

    fn potential(&self, image: &Image<D>) -> Option<Vec<f32>> {
        let mut samples = image.as_slice().to_vec();
        let rows = samples.chunks_mut(image.dims()[0].max(1));
        for (row, _) in rows.zip(&image.missing).filter(|(_, missing)| **missing) {
            row.fill(0.0);
        }
        Some(samples)
    }
}

#[cfg(test)]
mod tests {
    use crate::feature::scenes::{ExactSurface, measure_fit, ridge_image};
    use crate::feature::{DetectionOptions, FeatureKind, detect};
    use crate::image::{Geometry, Image};

    #[test]
    fn a_ready_potential_is_kept() {
        let (dims, surfaces) = (
            [32, 32, 32],
            [ExactSurface::plane([1.0, 0.3, 0.2], [16.0; 3])],
        );
        let ridges = ridge_image(dims, &surfaces, 2.0, 0.0);
        let b: Vec<f32> = ridges.as_slice().iter().map(|s| -s).collect();
        let image = Image::new(dims, b.clone(), Geometry::default());
        let features =
            detect(&image, &DetectionOptions::with_kind(FeatureKind::Auto, 8.0)).unwrap();
        assert!(
            features.notes[0].contains("potential"),
            "{:?}",
            features.notes
        );
        assert_eq!(features.potential.to_dense().samples, b);
        assert!(measure_fit(dims, &surfaces, &features.points).coverage > 0.99);
        assert!(
            detect(
                &ridges,
                &DetectionOptions::with_kind(FeatureKind::Potential, 8.0)
            )
            .is_err()
        );
    }
}

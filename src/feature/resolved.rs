//! Scales and thresholds that detection chose for a whole image, so that a part of the image can be
//! treated alike. A local edit looks for features only near the edit, and must find those that the
//! whole image has there.

use super::FeatureKind;
use super::detectors;
use serde::{Deserialize, Serialize};

/// Scale and thresholds for one kind of feature, chosen from a whole image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct ResolvedOptions {
    /// The kind of feature: a single kind, never [`FeatureKind::Auto`].
    pub kind: FeatureKind,
    /// Width (samples) of the Gaussian under which surfaces are searched for.
    pub scale: f64,
    /// Strength down to which a surface is followed.
    pub low: f32,
    /// Strength that a surface must reach somewhere.
    pub high: f32,
    /// Smallest area of a surface, in square lattice units (in 2-D smallest length).
    pub min_area: f64,
    /// Value of a thin mask whose middle is the feature, for labels and masks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mask: Option<f32>,
    /// Values of isosurfaces, in ascending order, if there are several.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub levels: Vec<f32>,
}

/// Returns how far (samples) detection looks to either side. At a larger distance from the cut, a
/// part of an image of `D` dimensions has the features of the whole image.
pub fn detection_reach<const D: usize>(resolved: &[ResolvedOptions]) -> usize {
    let reach = |s: &ResolvedOptions| {
        detectors::detector_for::<D>(s.kind).map(|detector| detector.reach(s.scale))
    };
    resolved.iter().filter_map(reach).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::{DetectionOptions, detect_part};
    use crate::image::{Geometry, Image};
    use crate::progress::CancelToken;

    fn image_part() -> Image<2> {
        let samples = (0..400).map(|i| (i % 7) as f32).collect();
        Image::new([20, 20], samples, Geometry::default())
    }

    #[test]
    fn a_constant_part_has_no_features() {
        let part = Image::new([20, 20], vec![3.0; 400], Geometry::default());
        let features = detect_part(
            &part,
            &DetectionOptions::default(),
            &[],
            &[[true; 2]; 2],
            &CancelToken::never(),
        )
        .unwrap();
        assert!(features.points.is_empty() && features.potential.is_zero());
    }

    #[test]
    fn kinds_that_need_the_whole_image_are_refused_for_a_part() {
        let error_for = |kind| {
            let resolved = ResolvedOptions {
                kind,
                scale: 1.0,
                low: 0.1,
                high: 0.2,
                min_area: 1.0,
                mask: None,
                levels: Vec::new(),
            };
            detect_part(
                &image_part(),
                &DetectionOptions::default(),
                &[resolved],
                &[[true; 2]; 2],
                &CancelToken::never(),
            )
            .unwrap_err()
            .to_string()
        };
        assert!(error_for(FeatureKind::Paths).contains("through the whole image"));
        assert!(error_for(FeatureKind::Auto).contains("feature 'auto'"));
        assert!(error_for(FeatureKind::FaultsAndHorizons).contains("feature 'faults+horizons'"));
    }
}

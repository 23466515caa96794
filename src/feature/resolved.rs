//! What detection settles on for a whole image, so that a part of it can be treated alike: a local
//! edit looks for features near the edit only, and must find those that the whole image has there.

use super::FeatureKind;
use super::detectors;
use serde::{Deserialize, Serialize};

/// Scale and thresholds for one kind of feature, found from a whole image.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct ResolvedOptions {
    /// The kind of feature, never [`FeatureKind::Auto`] and only one.
    pub kind: FeatureKind,
    /// Width in samples of the Gaussian under which sheets are sought.
    pub scale: f64,
    /// Strength down to which a sheet is followed.
    pub low: f32,
    /// Strength that a sheet has somewhere.
    pub high: f32,
    /// Least area of a sheet, in square lattice units (in 2-D length).
    pub min_area: f64,
    /// Of labels: the value of a thin mask, whose middle is the feature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mask: Option<f32>,
}

/// How far (samples) detection looks to either side: beyond this from where a part of an image of `D`
/// dimensions was cut, the features are those of the whole image.
pub fn detection_reach<const D: usize>(settled: &[ResolvedOptions]) -> usize {
    let reach =
        |s: &ResolvedOptions| detectors::detector_for::<D>(s.kind).map(|one| one.reach(s.scale));
    settled.iter().filter_map(reach).max().unwrap_or(0)
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
        let found = detect_part(
            &part,
            &DetectionOptions::default(),
            &[],
            &[[true; 2]; 2],
            &CancelToken::never(),
        )
        .unwrap();
        assert!(found.points.is_empty() && found.potential.is_zero());
    }

    #[test]
    fn a_part_is_not_searched_for_what_only_the_whole_shows() {
        let says = |kind| {
            let settled = ResolvedOptions {
                kind,
                scale: 1.0,
                low: 0.1,
                high: 0.2,
                min_area: 1.0,
                mask: None,
            };
            detect_part(
                &image_part(),
                &DetectionOptions::default(),
                &[settled],
                &[[true; 2]; 2],
                &CancelToken::never(),
            )
            .unwrap_err()
            .to_string()
        };
        assert!(says(FeatureKind::Paths).contains("through the whole image"));
        assert!(says(FeatureKind::Auto).contains("feature 'auto'"));
        assert!(says(FeatureKind::FaultsAndHorizons).contains("feature 'faults+horizons'"));
    }
}

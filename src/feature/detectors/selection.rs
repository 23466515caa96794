//! Choice of the detectors for the options, and combination of their results.

use super::{Detector, FeatureKind, ThresholdMeaning, auto, faults_and_horizons};
use crate::error::{Error, Result, cause};
use crate::feature::{DetectionOptions, Doubt, Features, SharedGrid};
use crate::image::Image;

/// A detector and its options.
pub type DetectorTask<const D: usize> = (&'static dyn Detector<D>, DetectionOptions<D>);

/// The detectors to run; and the reason, if the image decided on one.
pub type DetectorSelection<const D: usize> = (Vec<DetectorTask<D>>, Option<SelectionReason>);

/// Reason for a choice that the image decided.
pub struct SelectionReason {
    /// A line for the report.
    pub note: String,
    /// Question that the image leaves open.
    pub doubt: Option<Doubt>,
}

/// Returns the detector of one kind. [`FeatureKind::Auto`], which is a choice, and
/// [`FeatureKind::FaultsAndHorizons`], which needs two detectors, have none.
pub fn detector_for<const D: usize>(kind: FeatureKind) -> Option<&'static dyn Detector<D>> {
    match kind.detectors() {
        [detector] => Some(*detector),
        _ => None,
    }
}

/// Returns the detectors for the options; and the reason, if the image decided on one.
///
/// # Errors
/// Returns an [`Error::Feature`] if the image decided on features to which the threshold does not
/// apply, and an [`Error::Image`] if the image has samples that are not finite.
pub fn select_detectors<const D: usize>(
    image: &Image<D>,
    options: &DetectionOptions<D>,
    grid: SharedGrid<'_, D>,
) -> Result<DetectorSelection<D>> {
    match requested_detectors(options) {
        Some(tasks) => Ok((tasks, None)),
        None => selection_from_choice(
            auto::choose(image, options.modality.or_detect(&image.geometry), grid)?,
            options,
        ),
    }
}

/// Returns the detectors for the options, or `None` if the image decides.
pub fn requested_detectors<const D: usize>(
    options: &DetectionOptions<D>,
) -> Option<Vec<DetectorTask<D>>> {
    match options.kind {
        FeatureKind::FaultsAndHorizons => Some(faults_and_horizons::detector_tasks(options)),
        kind => detector_for(kind).map(|detector| vec![(detector, options.clone())]),
    }
}

/// Returns the detector on which an image decided, and the reason.
///
/// # Errors
/// Returns an [`Error::Feature`] if the requested threshold does not apply to its features.
pub fn selection_from_choice<const D: usize>(
    choice: auto::DetectorChoice<D>,
    options: &DetectionOptions<D>,
) -> Result<DetectorSelection<D>> {
    let auto::DetectorChoice {
        detector,
        reason,
        doubt,
    } = choice;
    let kind = detector.kind();
    if options.min_part > 1 && !detector.has_labels() {
        return Err(Error::Feature(cause(
            format!("min-part {}", options.min_part),
            format!("is about parts of labels, but the image has {kind} ({reason})"),
            "omit it, or choose --feature labels or isosurface",
        )));
    }
    match options.threshold {
        Some(threshold) if detector.threshold_meaning() == ThresholdMeaning::Unused => {
            Err(Error::Feature(cause(
                format!("threshold {threshold}"),
                format!("applies to the strength of features, but the image has {kind} ({reason})"),
                "omit it, or choose another kind of feature",
            )))
        }
        _ => {
            let note = format!("features: {kind}, chosen from the image ({reason})");
            let reason = SelectionReason { note, doubt };
            Ok((vec![(detector, options.clone())], Some(reason)))
        }
    }
}

/// Returns the detector that finds in a part of an image what it found in the whole image.
///
/// # Errors
/// Returns an [`Error::Feature`] if features of this kind can only be found in the whole image.
pub fn detector_for_part<const D: usize>(kind: FeatureKind) -> Result<&'static dyn Detector<D>> {
    let problem = match detector_for(kind) {
        Some(detector) => match detector.whole_image_reason() {
            Some(reason) => reason,
            None => return Ok(detector),
        },
        None => "is not one kind that can be found again in a part of an image",
    };
    Err(Error::Feature(cause(
        format!("feature '{kind}'"),
        problem,
        "mesh the image again",
    )))
}

/// Combines the results of one or two detectors.
///
/// # Errors
/// Returns the errors of other ranks.
pub fn combine_features<const D: usize>(
    features: Vec<Features<D>>,
    options: &DetectionOptions<D>,
    grid: SharedGrid<'_, D>,
) -> Result<Features<D>> {
    let mut features = features.into_iter();
    Ok(match (features.next(), features.next()) {
        (Some(faults), Some(horizons)) => {
            faults_and_horizons::combine(faults, horizons, options.weights, grid)?
        }
        (Some(single), None) => single,
        _ => Features::empty(grid.dims, options),
    })
}

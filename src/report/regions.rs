//! Reports the regions that the labels of an image become.

use crate::image::LabelValue;
use serde::Serialize;

/// Volumes by which those of regions are judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum VolumeReference {
    /// Volumes of the samples of labels.
    Samples,
    /// Volumes between isosurfaces of the values, which are interpolated between samples.
    InterpolatedValues,
}

/// Regions of a mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RegionSummary {
    /// Volumes by which those of the regions are judged.
    pub volume_reference: VolumeReference,
    /// Region of each label, in ascending order of labels.
    pub regions: Vec<RegionReport>,
    /// Pairs of labels that touch in the mesh but nowhere in the image, the largest contact first.
    pub holes: Vec<Hole>,
    /// Connected parts of labels that are not in the mesh, by label.
    pub lost: Vec<LostParts>,
    /// Connected parts of labels that are largely missing in the mesh, by label.
    pub damaged: Vec<LostParts>,
}

/// Pair of labels that touch in the mesh although something lies between them in the image. So the
/// thing between them has holes in the mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Hole {
    /// The two labels.
    pub labels: [LabelValue; 2],
    /// Area of the contact, in square samples (in 2-D length, in samples).
    pub area: f64,
}

/// Region of a mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RegionReport {
    /// Value of its samples.
    pub label: LabelValue,
    /// Value of its cells.
    pub region: i32,
    /// Name of the label.
    pub name: Option<String>,
    /// Number of connected parts in the image.
    pub parts: usize,
    /// Number of samples.
    pub samples: usize,
    /// Number of cells.
    pub cells: usize,
    /// Volume (in 2-D area) of its cells, in the units of the image.
    pub volume: f64,
    /// Volume of its samples inside the box through the outermost samples; for regions between isosurfaces,
    /// volume between these.
    pub sample_volume: f64,
    /// Difference of the volume from that of the samples, in percent.
    pub volume_error_percent: f64,
    /// Distance between atoms, in samples, that suits its thickness. `None` if atoms are close
    /// enough already.
    pub distance: Option<f64>,
}

/// Fraction of the volume of a part that is missing if the part counts as damaged.
pub const MIN_MISSING_SHARE: f64 = 0.25;

/// Parts of a label that are not in the mesh, or largely missing.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LostParts {
    /// Label.
    pub label: LabelValue,
    /// Name of the label.
    pub name: Option<String>,
    /// Number of parts.
    pub parts: usize,
    /// `true` if these are all parts of the label.
    pub is_whole_label: bool,
    /// Number of samples of these parts.
    pub samples: usize,
    /// Number of samples of the largest part.
    pub largest_samples: usize,
    /// Position of the first sample of the largest part, in the coordinates of the image.
    pub first_sample: Vec<f64>,
    /// Distance between atoms, in samples, that would keep the largest part. `None` if no distance
    /// would.
    pub distance: Option<f64>,
}

impl LostParts {
    /// Returns the option that would keep the largest part, if there is one.
    pub fn remedy(&self) -> Option<String> {
        distance_option(self.label, self.distance)
    }

    /// Returns the message about lost parts.
    pub fn message(&self) -> String {
        self.message_with_fate("LOST")
    }

    fn message_with_fate(&self, fate: &str) -> String {
        let name = self
            .name
            .as_ref()
            .map_or(String::new(), |name| format!(" ({name})"));
        let coordinates: Vec<String> = self
            .first_sample
            .iter()
            .map(|x| format!("{x:.4}"))
            .collect();
        let coordinates = coordinates
            .iter()
            .map(|x| x.trim_end_matches('0').trim_end_matches('.'));
        let coordinates = coordinates.collect::<Vec<_>>().join(", ");
        let description = match self.parts {
            1 if self.largest_samples == 1 => format!("a part of 1 sample at ({coordinates})"),
            1 => format!(
                "a part of {} samples at ({coordinates})",
                self.largest_samples
            ),
            parts => format!(
                "{parts} parts of {} samples, the largest of {} at ({coordinates})",
                self.samples, self.largest_samples
            ),
        };
        format!("{fate} of label {}{name}: {description}", self.label)
    }
}

/// Advice if a smaller distance between atoms does not help.
pub const RESAMPLING_ADVICE: &str = "an image with twice as many samples along each axis keeps it";

/// Returns the option that sets the distance of a label.
pub fn distance_option(label: LabelValue, distance: Option<f64>) -> Option<String> {
    Some(format!("--label {label}:distance={}", distance?))
}

/// Smallest distance between atoms that is suggested, in lattice units.
const MIN_ATOM_DISTANCE: f64 = 0.25;

/// Returns `distance`, or a smaller one if the distance that is in use is not larger than it. Returns
/// `None` if that would be too small.
pub(crate) fn finer_distance(distance: f64, in_use: Option<f64>) -> Option<f64> {
    match in_use {
        Some(in_use) if distance >= in_use => {
            let finer = (70.0 * in_use).floor() / 100.0;
            (finer >= MIN_ATOM_DISTANCE).then_some(finer)
        }
        _ => Some(distance.max(MIN_ATOM_DISTANCE)),
    }
}

impl RegionSummary {
    /// Makes all suggested distances smaller than the finest one that is in use.
    pub(crate) fn suggest_below(&mut self, in_use: Option<f64>) {
        let regions = self.regions.iter_mut().map(|region| &mut region.distance);
        let parts = self.lost.iter_mut().chain(&mut self.damaged);
        for distance in regions.chain(parts.map(|lost| &mut lost.distance)) {
            *distance = distance.and_then(|distance| finer_distance(distance, in_use));
        }
    }
}

/// Maximum number of regions that are shown.
const MAX_SHOWN_REGIONS: usize = 40;

impl RegionSummary {
    /// Returns the lines of the table.
    pub(super) fn lines(&self) -> Vec<String> {
        let reference = match self.volume_reference {
            VolumeReference::Samples => "of samples",
            VolumeReference::InterpolatedValues => "of the image",
        };
        let mut lines = vec![format!(
            "{:>8} {:>9} {:>14} {:>14} {:>8}  name",
            "label", "cells", "volume", reference, "off %"
        )];
        for region in self.regions.iter().take(MAX_SHOWN_REGIONS) {
            let number = |x: f64| match x.abs() {
                a if a >= 1e9 || (a < 1e-2 && a > 0.0) => format!("{x:.4e}"),
                _ => format!("{x:.1}"),
            };
            lines.push(format!(
                "{:>8} {:>9} {:>14} {:>14} {:>+8.2}  {}",
                region.label.to_string(),
                super::table::group_digits(region.cells),
                number(region.volume),
                number(region.sample_volume),
                region.volume_error_percent,
                region.name.as_deref().unwrap_or("")
            ));
        }
        if self.regions.len() > MAX_SHOWN_REGIONS {
            lines.push(format!(
                "... {} more in JSON",
                self.regions.len() - MAX_SHOWN_REGIONS
            ));
        }
        if self.volume_reference == VolumeReference::InterpolatedValues {
            lines.push(
                "volumes of the image are those that its values, interpolated between samples, have there"
                    .into(),
            );
        }
        lines.extend(self.holes.iter().take(MAX_SHOWN_REGIONS).map(|hole| {
            let [a, b] = hole.labels;
            format!("HOLES: labels {a} and {b} touch over {:.1} square samples, and nowhere in the image", hole.area)
        }));
        lines.extend(self.lost.iter().map(LostParts::message));
        let damaged = self.damaged.iter();
        lines.extend(damaged.map(|lost| lost.message_with_fate("DAMAGED")));
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advice_starts_from_the_distance_in_use() {
        assert_eq!(finer_distance(5.4, None), Some(5.4));
        assert_eq!(finer_distance(5.4, Some(8.0)), Some(5.4));
        assert_eq!(finer_distance(5.4, Some(2.0)), Some(1.4));
        assert_eq!(finer_distance(5.4, Some(0.3)), None);
    }

    #[test]
    fn lost_parts_are_reported_with_their_size() {
        let lost = LostParts {
            label: LabelValue::Whole(13),
            name: Some("cyst".into()),
            parts: 2,
            is_whole_label: false,
            samples: 20,
            largest_samples: 18,
            first_sample: vec![29.0, 42.5, 71.0],
            distance: Some(1.4),
        };
        assert_eq!(
            lost.message(),
            "LOST of label 13 (cyst): 2 parts of 20 samples, the largest of 18 at (29, 42.5, 71)"
        );
    }
}

//! What became of the labels of an image.

use crate::image::LabelValue;
use serde::Serialize;

/// The regions of a mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RegionSummary {
    /// One for each label, in ascending order.
    pub regions: Vec<RegionReport>,
    /// Pairs of labels that touch in the mesh and nowhere in the image, the largest contact first.
    pub holes: Vec<Hole>,
    /// Connected parts of labels that the mesh does not have, by label.
    pub lost: Vec<LostParts>,
    /// Connected parts of labels of which much is missing, by label.
    pub damaged: Vec<LostParts>,
}

/// Two labels that touch in the mesh although something lies between them in the image, which so has holes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Hole {
    /// The two labels.
    pub labels: [LabelValue; 2],
    /// The area over which they touch, in square samples (in the plane the length, in samples).
    pub area: f64,
}

/// A region of the mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RegionReport {
    /// The value that its samples have.
    pub label: LabelValue,
    /// The value that its cells have.
    pub region: i32,
    /// What it is called.
    pub name: Option<String>,
    /// Number of connected parts in the image.
    pub parts: usize,
    /// Number of samples.
    pub samples: usize,
    /// Number of cells.
    pub cells: usize,
    /// Volume (area in 2-D) of its cells, in the image's units.
    pub volume: f64,
    /// Volume of its samples, as far as they lie in the box through the outermost samples.
    pub sample_volume: f64,
    /// By how much the volume is off that of the samples, in percent.
    pub volume_error_percent: f64,
    /// The distance between atoms, in samples, that suits its thickness; `None` if it has that already.
    pub distance: Option<f64>,
}

/// The share of the largest part's volume that is missing where it is damaged.
pub const MIN_MISSING_SHARE: f64 = 0.25;

/// Parts of a label that the mesh does not have.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LostParts {
    /// The label.
    pub label: LabelValue,
    /// What it is called.
    pub name: Option<String>,
    /// How many parts.
    pub parts: usize,
    /// Whether that is all of the label.
    pub is_whole_label: bool,
    /// Their samples.
    pub samples: usize,
    /// The samples of the largest.
    pub largest_samples: usize,
    /// Where its first sample is, in the image's coordinates.
    pub first_sample: Vec<f64>,
    /// The distance between atoms, in samples, that would keep it; `None` if it has that already.
    pub distance: Option<f64>,
}

impl LostParts {
    /// The option that would keep the largest, if one would.
    pub fn remedy(&self) -> Option<String> {
        distance_option(self.label, self.distance)
    }

    /// What to say of parts that are lost.
    pub fn message(&self) -> String {
        self.message_with_fate("LOST")
    }

    fn message_with_fate(&self, what_became: &str) -> String {
        let name = self
            .name
            .as_ref()
            .map_or(String::new(), |name| format!(" ({name})"));
        let at: Vec<String> = self
            .first_sample
            .iter()
            .map(|x| format!("{x:.4}"))
            .collect();
        let at = at
            .iter()
            .map(|x| x.trim_end_matches('0').trim_end_matches('.'));
        let at = at.collect::<Vec<_>>().join(", ");
        let what = match self.parts {
            1 => format!("a part of {} samples at ({at})", self.largest_samples),
            parts => format!(
                "{parts} parts of {} samples, the largest of {} at ({at})",
                self.samples, self.largest_samples
            ),
        };
        let remedy = match self.remedy() {
            Some(option) => format!("{option} keeps it"),
            None => RESAMPLING_ADVICE.to_string(),
        };
        format!(
            "{what_became} of label {}{name}: {what}; {remedy}",
            self.label
        )
    }
}

/// What helps where atoms cannot be nearer together.
pub const RESAMPLING_ADVICE: &str = "an image of twice as many samples along each axis keeps it";

/// The option that gives a label a distance.
pub fn distance_option(label: LabelValue, distance: Option<f64>) -> Option<String> {
    Some(format!("--label {label}:distance={}", distance?))
}

/// How many regions are shown.
const MAX_SHOWN_REGIONS: usize = 40;

impl RegionSummary {
    /// The lines of the table.
    pub(super) fn lines(&self) -> Vec<String> {
        let mut lines = vec![format!(
            "{:>8} {:>9} {:>14} {:>14} {:>8}  name",
            "label", "cells", "volume", "of samples", "off %"
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
    fn what_is_lost_is_named_with_its_size_and_what_keeps_it() {
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
            "LOST of label 13 (cyst): 2 parts of 20 samples, the largest of 18 at (29, 42.5, 71); \
             --label 13:distance=1.4 keeps it"
        );
    }
}

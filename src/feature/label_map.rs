//! Labels of an image, at samples and at positions between them.

use super::components::Components;
use super::value_field::ValueField;
use super::volume::Volume;
use crate::error::{Error, Result, cause};
use crate::geometry::grid_index::index_at;
use crate::image::{ExactLabels, Image, LabelTable, LabelValue};
use crate::names::NameRules;
use crate::units::{Unit, split_length};
use std::fmt;

/// User options for one label.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelOptions {
    /// Value of the label's samples.
    pub label: LabelValue,
    /// Distance between atoms in the label, in lattice units, or in `unit`; the general distance if `None`.
    pub distance: Option<f64>,
    /// The unit of length of the distance, until it is converted to lattice units.
    pub unit: Option<Unit>,
    /// Name of the label in the mesh.
    pub name: Option<String>,
    /// The label into which this one is merged.
    pub merge_into: Option<LabelValue>,
}

impl LabelOptions {
    /// Parses `VALUE:distance=D,name=NAME` or `VALUE:into=VALUE`.
    ///
    /// # Errors
    /// Returns the problem and its remedy if the text has another form.
    pub fn parse(text: &str) -> std::result::Result<Self, (String, &'static str)> {
        let remedy = "give VALUE:distance=D,name=NAME or VALUE:into=VALUE";
        let (label, settings) = text
            .split_once(':')
            .ok_or_else(|| ("gives a label, but no options for it".into(), remedy))?;
        let label = LabelValue::parse(label)
            .ok_or_else(|| (format!("'{label}' is not the value of a label"), remedy))?;
        let mut options = Self {
            label,
            distance: None,
            unit: None,
            name: None,
            merge_into: None,
        };
        for part in settings.split(',') {
            let (key, value) = part.split_once('=').unwrap_or((part, ""));
            match key.trim() {
                "distance" => match split_length(value) {
                    Ok((d, unit)) if d > 0.0 => {
                        (options.distance, options.unit) = (Some(d), unit);
                    }
                    Ok(_) => {
                        return Err((
                            format!("distance '{value}' is not a positive number of samples"),
                            remedy,
                        ));
                    }
                    Err(problem) => return Err((format!("distance '{value}' {problem}"), remedy)),
                },
                "into" => match LabelValue::parse(value) {
                    Some(into) if into != label => options.merge_into = Some(into),
                    _ => {
                        return Err((
                            format!("'{value}' is not the value of another label"),
                            remedy,
                        ));
                    }
                },
                "name" if is_name(value) => options.name = Some(value.trim().to_string()),
                "name" => {
                    let problem = format!("name '{value}' is empty or has a control character");
                    return Err((problem, "give a name such as left_lung"));
                }
                _ => return Err((format!("'{part}' is not an option of a label"), remedy)),
            }
        }
        if options.merge_into.is_some() && (options.distance.is_some() || options.name.is_some()) {
            return Err((
                "has a distance or a name for a label that is merged into another".into(),
                "give them for the other label",
            ));
        }
        Ok(options)
    }
}

/// Returns `true` if a text can be a name.
fn is_name(text: &str) -> bool {
    NameRules::TEXT.is_legal(text.trim()) && !text.trim().is_empty()
}

impl fmt::Display for LabelOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = [
            (self.distance)
                .map(|d| format!("distance={d}{}", self.unit.map_or("", |unit| unit.symbol))),
            self.name.as_ref().map(|name| format!("name={name}")),
            self.merge_into.map(|into| format!("into={into}")),
        ];
        let parts: Vec<String> = parts.into_iter().flatten().collect();
        write!(f, "{}:{}", self.label, parts.join(","))
    }
}

/// Returns the error of options for a label that the image does not have.
pub fn missing_label_error(options: &LabelOptions, values: &[LabelValue]) -> Error {
    let max_names = 12;
    let mut names: Vec<String> = values
        .iter()
        .take(max_names)
        .map(LabelValue::to_string)
        .collect();
    if values.len() > max_names {
        names.push("...".into());
    }
    Error::Feature(cause(
        format!("label {}", options.label),
        format!("is not in the image, whose labels are {}", names.join(", ")),
        "name a label of the image",
    ))
}

/// Returns the image with labels merged into others as `options` say, all at once; `None` if no
/// label is merged.
///
/// # Errors
/// Returns an [`Error::Feature`] if a label that is to be merged is not in the image.
pub fn merge_labels<const D: usize>(
    image: &Image<D>,
    options: &[LabelOptions],
) -> Result<Option<Image<D>>> {
    let merge: Vec<(LabelValue, LabelValue)> = (options.iter())
        .filter_map(|label_options| Some((label_options.label, label_options.merge_into?)))
        .collect();
    if merge.is_empty() {
        return Ok(None);
    }
    let table = LabelTable::from_image(image).ok_or_else(too_many_labels_error)?;
    let absent = |label_options: &&LabelOptions| {
        label_options.merge_into.is_some() && !table.values.contains(&label_options.label)
    };
    if let Some(label_options) = options.iter().find(absent) {
        return Err(missing_label_error(label_options, &table.values));
    }
    let merged_value = |value: &LabelValue| {
        let target = merge.iter().find(|(label, _)| label == value);
        target.map_or(*value, |(_, into)| *into)
    };
    let values: Vec<LabelValue> = table.values.iter().map(merged_value).collect();
    let samples = table.indices.iter();
    let samples = samples.map(|&index| values[index as usize].as_sample());
    let mut merged = Image::new(image.dims(), samples.collect(), image.geometry.clone());
    if image.labels.is_some() {
        let to_integer = |value: &LabelValue| match *value {
            LabelValue::Whole(whole) => whole,
            LabelValue::Real(real) => real as i128,
        };
        let integers: Vec<i128> = values.iter().map(to_integer).collect();
        let samples = table.indices.iter().map(|&index| integers[index as usize]);
        merged.labels = Some(ExactLabels::from_integers(samples));
    }
    Ok(Some(merged.with_missing(image.missing.clone())))
}

/// Returns the error of an image whose samples are no labels.
pub fn too_many_labels_error() -> Error {
    Error::Feature(cause(
        "feature 'labels'",
        "the samples have too many different values to be labels: more than 255, and with fractions or \
         without equal neighbours",
        "choose ridges, edges or horizons, or give an image of labels",
    ))
}

/// Labels after smoothing: the winning label of each sample, and its lead over the others. Between
/// two samples with different winners, the interface lies where the lead changes its sign.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelMap<const D: usize> {
    /// Number of samples along each axis.
    pub dims: [usize; D],
    /// Lattice-space distance between samples.
    pub step: [f64; D],
    /// Values of the labels, in ascending order.
    pub labels: Vec<LabelValue>,
    /// Names of the labels, if they have any.
    pub names: Vec<Option<String>>,
    /// Index into `labels` of the winner at each sample.
    pub winner: Vec<u32>,
    /// Lead of the winner over the second label at each sample, from 0 to 1.
    pub lead: Vec<f32>,
    /// Values and thresholds, if these make the labels. They then say where interfaces are; `lead` is the
    /// difference from the nearest threshold.
    pub values: Option<ValueField<D>>,
    /// Volume of each label's samples inside the box, in lattice units. Components that are too
    /// small to be kept count for the label that absorbed them.
    pub volumes: Vec<f64>,
}

impl<const D: usize> LabelMap<D> {
    /// Returns the region number of the cells of each label.
    pub fn regions(&self) -> Vec<i32> {
        regions(&self.labels)
    }

    /// Returns `true` if a neighbour of a sample along an axis has another winner.
    pub fn is_at_interface(&self, sample: usize) -> bool {
        let volume = Volume::new(self.dims, &[]);
        let at: [usize; D] = volume.coordinates(sample);
        let strides = volume.strides();
        let differs = |neighbour: usize| self.winner[neighbour] != self.winner[sample];
        (0..D).any(|k| {
            at[k] > 0 && differs(sample - strides[k])
                || at[k] + 1 < self.dims[k] && differs(sample + strides[k])
        })
    }

    /// Returns the smallest distance between samples in lattice space.
    pub fn min_step(&self) -> f64 {
        self.step.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// Calls `visit` with the index and the multilinear weight of each sample around a position in
    /// lattice space.
    #[inline]
    fn for_each_weight(&self, x: [f64; D], mut visit: impl FnMut(usize, f64)) {
        let (mut corner, mut stride) = (0, 1);
        let (mut strides, mut fraction) = ([0; D], [0.0; D]);
        for k in 0..D {
            let last = self.dims[k] - 1;
            if last > 0 {
                let u = (x[k] / self.step[k]).clamp(0.0, last as f64);
                let low = (u as usize).min(last - 1);
                corner += low * stride;
                strides[k] = stride;
                fraction[k] = u - low as f64;
            }
            stride *= self.dims[k];
        }
        for c in 0..1usize << D {
            let (mut at, mut weight) = (corner, 1.0);
            for k in 0..D {
                let high = c >> k & 1 == 1;
                at += if high { strides[k] } else { 0 };
                weight *= if high { fraction[k] } else { 1.0 - fraction[k] };
            }
            visit(at, weight);
        }
    }

    /// Returns a position in lattice space as one in samples.
    fn to_samples(&self, x: [f64; D]) -> [f64; D] {
        std::array::from_fn(|k| x[k] / self.step[k])
    }

    /// Returns the index of the label at a position in lattice space.
    pub fn label_at(&self, x: [f64; D]) -> u32 {
        if let Some(values) = &self.values {
            return values.region_at(self.to_samples(x));
        }
        let (mut first, mut is_same) = (None, true);
        self.for_each_weight(x, |i, _| {
            let label = self.winner[i];
            is_same &= *first.get_or_insert(label) == label;
        });
        if let (Some(label), true) = (first, is_same) {
            return label;
        }
        // A position in space has at most eight samples around it.
        let (mut sums, mut count) = ([(0u32, 0.0f64); 8], 0);
        self.for_each_weight(x, |i, weight| {
            let (label, lead) = (self.winner[i], weight * f64::from(self.lead[i]));
            match sums[..count].iter_mut().find(|(known, _)| *known == label) {
                Some((_, sum)) => *sum += lead,
                None => {
                    sums[count] = (label, lead);
                    count += 1;
                }
            }
        });
        let larger = |a: (u32, f64), &b: &(u32, f64)| if b.1 > a.1 { b } else { a };
        sums[..count].iter().fold(sums[0], larger).0
    }

    /// Returns the lead of label `a` over label `b` at a position: negative where `b` leads, zero
    /// where other labels lead, unless thresholds make the labels.
    #[inline]
    pub fn lead_between(&self, x: [f64; D], [a, b]: [u32; 2]) -> f64 {
        if let Some(values) = &self.values {
            return values.lead_between(self.to_samples(x), [a, b]);
        }
        let mut sum = 0.0;
        self.for_each_weight(x, |i, weight| {
            let sign = match self.winner[i] {
                winner if winner == a => 1.0,
                winner if winner == b => -1.0,
                _ => 0.0,
            };
            sum += sign * weight * f64::from(self.lead[i]);
        });
        sum
    }

    /// Returns the signed distance from `x`, along the unit vector `along`, to the nearest
    /// interface between labels `a` and `b` within `reach` lattice units.
    pub fn interface_distance(
        &self,
        x: [f64; D],
        along: [f64; D],
        pair: [u32; 2],
        reach: f64,
    ) -> Option<f64> {
        let stride = SEARCH_STEP * self.step.iter().copied().fold(f64::INFINITY, f64::min);
        let lead = |t: f64| self.lead_between(std::array::from_fn(|k| x[k] + t * along[k]), pair);
        let mut before = lead(0.0);
        if before == 0.0 {
            return None;
        }
        let stride = stride.copysign(before);
        let mut t: f64 = 0.0;
        while t.abs() < reach {
            let after = lead(t + stride);
            if after == 0.0 {
                return None;
            }
            if (after > 0.0) != (before > 0.0) {
                return Some(t + stride * before / (before - after));
            }
            before = after;
            t += stride;
        }
        None
    }
}

/// Returns the region number of each label: its value if all values are whole numbers of 32 bits,
/// else its index.
pub fn regions(labels: &[LabelValue]) -> Vec<i32> {
    let values: Option<Vec<i32>> = labels.iter().map(|label| label.as_i32()).collect();
    values.unwrap_or_else(|| (0..labels.len() as i32).collect())
}

/// Returns `true` if all values of labels can be region numbers.
pub fn are_valid_regions(labels: &[LabelValue]) -> bool {
    labels.iter().all(|label| label.as_i32().is_some())
}

/// Step, in samples, of the search for interfaces.
const SEARCH_STEP: f64 = 0.25;

/// Returns the volume of each label's samples inside the box of the image: samples on a side of the
/// box count by half.
pub fn volumes<const D: usize>(
    dims: [usize; D],
    step: [f64; D],
    label: &[u32],
    count: usize,
) -> Vec<f64> {
    let mut volumes = vec![0.0; count];
    let sample_volume: f64 = step.iter().product();
    let row_len = dims[0].max(1);
    for (number, labels) in label.chunks(row_len).enumerate() {
        let at = index_at(dims, number * row_len);
        let is_on_side = |&k: &usize| at[k] == 0 || at[k] + 1 == dims[k];
        let weight = sample_volume * 0.5f64.powi((1..D).filter(is_on_side).count() as i32);
        let numbered = labels.iter().enumerate();
        for (at, &label) in numbered {
            let end_weight = if at == 0 || at + 1 == row_len {
                0.5
            } else {
                1.0
            };
            volumes[label as usize] += weight * end_weight;
        }
    }
    volumes
}

/// Returns the labels of an image with the label index of each sample, and their connected
/// components. Returns `None` if the samples are no labels.
pub fn components<const D: usize>(image: &Image<D>) -> Option<(LabelTable, Components<D>)> {
    let table = LabelTable::from_image(image)?;
    let components = Components::from_labels(image.dims(), &table.indices);
    Some((table, components))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn label_options_are_parsed_and_written() {
        for text in [
            "3:distance=4,name=fault",
            "-2:into=7",
            "0.5:name=a-b_1",
            "4:name=two words 1.5",
            "18446744073709551615:into=-9223372036854775808",
        ] {
            assert_eq!(LabelOptions::parse(text).unwrap().to_string(), text);
        }
        for (text, word) in [
            ("3", "no options"),
            ("x:distance=3", "not the value of a label"),
            ("3:distance=0", "not a positive"),
            ("3:distance=nan", "not a finite"),
            ("3:into=3", "another label"),
            ("3:name= ", "is empty"),
            ("3:colour=red", "not an option"),
            ("3:into=4,name=x", "merged into another"),
        ] {
            let (problem, _) = LabelOptions::parse(text).unwrap_err();
            assert!(problem.contains(word), "{text}: {problem}");
        }
    }

    #[test]
    fn an_interface_is_found_from_either_side() {
        let label_map = LabelMap {
            values: None,
            dims: [6, 2],
            step: [1.0, 1.0],
            labels: [1.0, 2.0, 3.0].map(LabelValue::from_sample).to_vec(),
            names: vec![None; 3],
            winner: [[0, 0, 1, 1, 1, 2]; 2].concat(),
            lead: [[0.9, 0.3, 0.1, 0.8, 0.6, 0.6]; 2].concat(),
            volumes: vec![0.0; 3],
        };
        for x in [0.2, 1.1, 1.9, 3.0] {
            let distance = label_map
                .interface_distance([x, 0.5], [1.0, 0.0], [0, 1], 4.0)
                .unwrap();
            assert!((x + distance - 1.75).abs() < 1e-6, "{x} {distance}");
        }
        assert!(
            label_map
                .interface_distance([3.0, 0.5], [-1.0, 0.0], [0, 1], 4.0)
                .is_none()
        );
        let distance = label_map
            .interface_distance([4.1, 0.5], [-1.0, 0.0], [2, 1], 4.0)
            .unwrap();
        assert!((distance + 0.4).abs() < 1e-6, "{distance}");
        assert_eq!(label_map.label_at([1.6, 0.0]), 0);
        assert_eq!(label_map.label_at([1.9, 0.0]), 1);
        assert_eq!(
            volumes([6, 2], [1.0, 1.0], &label_map.winner, 3),
            [1.5, 3.0, 0.5]
        );
    }
}

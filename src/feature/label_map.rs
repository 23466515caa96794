//! Which label is where, between samples too.

use super::components::Components;
use crate::error::{Error, Result, cause};
use crate::image::{ExactLabels, Image, LabelTable, LabelValue};
use std::fmt;

/// What a user wants of one label.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelOptions {
    /// The value of its samples.
    pub label: LabelValue,
    /// The distance between atoms in it, in lattice units; as elsewhere if `None`.
    pub distance: Option<f64>,
    /// What it is called.
    pub name: Option<String>,
    /// The label that its samples are given to.
    pub merge_into: Option<LabelValue>,
}

impl LabelOptions {
    /// Reads `VALUE:distance=D,name=NAME` or `VALUE:into=VALUE`.
    ///
    /// # Errors
    /// The problem, and what to give instead.
    pub fn parse(text: &str) -> std::result::Result<Self, (String, &'static str)> {
        let remedy = "give VALUE:distance=D,name=NAME or VALUE:into=VALUE";
        let number = |text: &str| text.trim().parse::<f64>().ok().filter(|x| x.is_finite());
        let (label, wishes) = text
            .split_once(':')
            .ok_or_else(|| ("says nothing of a label".into(), remedy))?;
        let label = LabelValue::parse(label)
            .ok_or_else(|| (format!("'{label}' is no value of a label"), remedy))?;
        let mut wish = Self {
            label,
            distance: None,
            name: None,
            merge_into: None,
        };
        for part in wishes.split(',') {
            let (key, value) = part.split_once('=').unwrap_or((part, ""));
            match key.trim() {
                "distance" => match number(value) {
                    Some(d) if d > 0.0 => wish.distance = Some(d),
                    _ => {
                        return Err((
                            format!("distance '{value}' is not a positive number of samples"),
                            remedy,
                        ));
                    }
                },
                "into" => match LabelValue::parse(value) {
                    Some(into) if into != label => wish.merge_into = Some(into),
                    _ => return Err((format!("'{value}' is no other label"), remedy)),
                },
                "name" if is_name(value) => wish.name = Some(value.trim().to_string()),
                "name" => {
                    let problem = format!("name '{value}' is not made of letters, digits, - and _");
                    return Err((problem, "give a name such as left_lung"));
                }
                _ => return Err((format!("'{part}' is not known"), remedy)),
            }
        }
        if wish.merge_into.is_some() && (wish.distance.is_some() || wish.name.is_some()) {
            return Err((
                "says more of a label that becomes part of another".into(),
                "say it of the other",
            ));
        }
        Ok(wish)
    }
}

/// Whether formats with named sets can hold a name.
fn is_name(text: &str) -> bool {
    let text = text.trim();
    !text.is_empty()
        && text.len() <= 60
        && text
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
}

impl fmt::Display for LabelOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = [
            self.distance.map(|d| format!("distance={d}")),
            self.name.as_ref().map(|name| format!("name={name}")),
            self.merge_into.map(|into| format!("into={into}")),
        ];
        let parts: Vec<String> = parts.into_iter().flatten().collect();
        write!(f, "{}:{}", self.label, parts.join(","))
    }
}

/// What to say of a wish for a label that is not among those of the image.
pub fn missing_label_error(wish: &LabelOptions, values: &[LabelValue]) -> Error {
    let most = 12;
    let mut names: Vec<String> = values
        .iter()
        .take(most)
        .map(LabelValue::to_string)
        .collect();
    if values.len() > most {
        names.push("...".into());
    }
    Error::Feature(cause(
        format!("label {}", wish.label),
        format!("is not in the image, whose labels are {}", names.join(", ")),
        "name a label of the image",
    ))
}

/// Returns an image with labels given to others as `wishes` say, all at once; `None` if none is.
///
/// # Errors
/// [`Error::Feature`] if one that shall be given away is not in the image.
pub fn merge_labels<const D: usize>(
    image: &Image<D>,
    wishes: &[LabelOptions],
) -> Result<Option<Image<D>>> {
    let merge: Vec<(LabelValue, LabelValue)> = (wishes.iter())
        .filter_map(|wish| Some((wish.label, wish.merge_into?)))
        .collect();
    if merge.is_empty() {
        return Ok(None);
    }
    let table = LabelTable::from_image(image).ok_or_else(too_many_labels_error)?;
    let absent =
        |wish: &&LabelOptions| wish.merge_into.is_some() && !table.values.contains(&wish.label);
    if let Some(wish) = wishes.iter().find(absent) {
        return Err(missing_label_error(wish, &table.values));
    }
    let into = |value: &LabelValue| {
        let merge = merge.iter().find(|(label, _)| label == value);
        merge.map_or(*value, |(_, into)| *into)
    };
    let values: Vec<LabelValue> = table.values.iter().map(into).collect();
    let samples = table.indices.iter();
    let samples = samples.map(|&number| values[number as usize].as_sample());
    let mut made = Image::new(image.dims(), samples.collect(), image.geometry.clone());
    if image.labels.is_some() {
        let whole = |value: &LabelValue| match *value {
            LabelValue::Whole(whole) => whole,
            LabelValue::Real(real) => real as i128,
        };
        let whole: Vec<i128> = values.iter().map(whole).collect();
        let samples = table.indices.iter().map(|&number| whole[number as usize]);
        made.labels = Some(ExactLabels::from_integers(samples));
    }
    Ok(Some(made.with_missing(image.missing.clone())))
}

/// The error of an image whose samples are no labels.
pub fn too_many_labels_error() -> Error {
    Error::Feature(cause(
        "feature 'labels'",
        "the samples are too many different values to be labels: more than 255, and with fractions or \
         without equal neighbours",
        "choose ridges, edges or horizons, or give an image of labels",
    ))
}

/// Labels after smoothing: which leads at each sample, and by how much. Between two samples that
/// different labels lead, the interface is where the lead changes hands.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelMap<const D: usize> {
    /// Number of samples along each axis.
    pub dims: [usize; D],
    /// Lattice-space distance between samples.
    pub step: [f64; D],
    /// The labels' values, ascending.
    pub labels: Vec<LabelValue>,
    /// What they are called, where they have names.
    pub names: Vec<Option<String>>,
    /// For each sample the number of the label that leads.
    pub winner: Vec<u32>,
    /// How far it is ahead of the next, from 0 to 1.
    pub lead: Vec<f32>,
    /// Volume of each label's samples, as far as they lie in the box, in lattice units; what is too
    /// small to be kept counts as what it lies in.
    pub volumes: Vec<f64>,
}

impl<const D: usize> LabelMap<D> {
    /// Returns the region that cells of each label have.
    pub fn regions(&self) -> Vec<i32> {
        regions(&self.labels)
    }

    /// The least distance between samples in lattice space.
    pub fn min_step(&self) -> f64 {
        self.step.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// The samples round a position in lattice space, each with its weight.
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

    /// The number of the label at a position in lattice space.
    pub fn label_at(&self, x: [f64; D]) -> u32 {
        // As many as there are samples round a position in space.
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
        let most = |a: (u32, f64), &b: &(u32, f64)| if b.1 > a.1 { b } else { a };
        sums[..count].iter().fold(sums[0], most).0
    }

    /// How far label `a` leads over label `b` at a position: negative where `b` leads, zero where others
    /// do.
    #[inline]
    fn lead_between(&self, x: [f64; D], [a, b]: [u32; 2]) -> f64 {
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

    /// How far from `x`, along the unit vector `along`, label `a` ends and label `b` begins: the nearest
    /// such place within `reach` lattice units either way.
    pub fn interface_distance(
        &self,
        x: [f64; D],
        along: [f64; D],
        pair: [u32; 2],
        reach: f64,
    ) -> Option<f64> {
        let pace = SEARCH_STEP * self.step.iter().copied().fold(f64::INFINITY, f64::min);
        let lead = |t: f64| self.lead_between(std::array::from_fn(|k| x[k] + t * along[k]), pair);
        let mut before = lead(0.0);
        if before == 0.0 {
            return None;
        }
        let pace = pace.copysign(before);
        let mut t: f64 = 0.0;
        while t.abs() < reach {
            let after = lead(t + pace);
            if after == 0.0 {
                return None;
            }
            if (after > 0.0) != (before > 0.0) {
                return Some(t + pace * before / (before - after));
            }
            before = after;
            t += pace;
        }
        None
    }
}

/// Returns the region of each of several labels: its value, where all values are whole numbers of 32 bits, else
/// its number.
pub fn regions(labels: &[LabelValue]) -> Vec<i32> {
    let values: Option<Vec<i32>> = labels.iter().map(|label| label.as_i32()).collect();
    values.unwrap_or_else(|| (0..labels.len() as i32).collect())
}

/// Returns whether cells can have the values of labels as their regions.
pub fn are_valid_regions(labels: &[LabelValue]) -> bool {
    labels.iter().all(|label| label.as_i32().is_some())
}

/// Interfaces are sought in steps of this many samples.
const SEARCH_STEP: f64 = 0.25;

/// The volume of the samples of each label, as far as they lie in the image's box: samples on its sides
/// are there by half.
pub fn volumes<const D: usize>(
    dims: [usize; D],
    step: [f64; D],
    label: &[u32],
    count: usize,
) -> Vec<f64> {
    let mut volumes = vec![0.0; count];
    let sample: f64 = step.iter().product();
    let row = dims[0].max(1);
    for (number, labels) in label.chunks(row).enumerate() {
        let mut rest = number;
        let mut weight = sample;
        for &n in &dims[1..] {
            let at = rest % n;
            rest /= n;
            weight *= if at == 0 || at + 1 == n { 0.5 } else { 1.0 };
        }
        let inside = labels.iter().enumerate();
        for (at, &label) in inside {
            let end = if at == 0 || at + 1 == row { 0.5 } else { 1.0 };
            volumes[label as usize] += weight * end;
        }
    }
    volumes
}

/// Returns the values of the labels of an image, the number of that of each sample, and their connected parts;
/// `None` where its samples are no labels.
pub fn components<const D: usize>(image: &Image<D>) -> Option<(LabelTable, Components<D>)> {
    let table = LabelTable::from_image(image)?;
    let components = Components::from_labels(image.dims(), &table.indices);
    Some((table, components))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wishes_are_read_and_written() {
        for text in [
            "3:distance=4,name=fault",
            "-2:into=7",
            "0.5:name=a-b_1",
            "18446744073709551615:into=-9223372036854775808",
        ] {
            assert_eq!(LabelOptions::parse(text).unwrap().to_string(), text);
        }
        for (text, word) in [
            ("3", "says nothing"),
            ("x:distance=3", "no value of a label"),
            ("3:distance=0", "not a positive"),
            ("3:distance=nan", "not a positive"),
            ("3:into=3", "no other label"),
            ("3:name=two words", "letters"),
            ("3:colour=red", "not known"),
            ("3:into=4,name=x", "says more"),
        ] {
            let (problem, _) = LabelOptions::parse(text).unwrap_err();
            assert!(problem.contains(word), "{text}: {problem}");
        }
    }

    #[test]
    fn an_interface_is_found_from_either_side() {
        let labelled = LabelMap {
            dims: [6, 2],
            step: [1.0, 1.0],
            labels: [1.0, 2.0, 3.0].map(LabelValue::from_sample).to_vec(),
            names: vec![None; 3],
            winner: [[0, 0, 1, 1, 1, 2]; 2].concat(),
            lead: [[0.9, 0.3, 0.1, 0.8, 0.6, 0.6]; 2].concat(),
            volumes: vec![0.0; 3],
        };
        for x in [0.2, 1.1, 1.9, 3.0] {
            let off = labelled
                .interface_distance([x, 0.5], [1.0, 0.0], [0, 1], 4.0)
                .unwrap();
            assert!((x + off - 1.75).abs() < 1e-6, "{x} {off}");
        }
        assert!(
            labelled
                .interface_distance([3.0, 0.5], [-1.0, 0.0], [0, 1], 4.0)
                .is_none()
        );
        let off = labelled
            .interface_distance([4.1, 0.5], [-1.0, 0.0], [2, 1], 4.0)
            .unwrap();
        assert!((off + 0.4).abs() < 1e-6, "{off}");
        assert_eq!(labelled.label_at([1.6, 0.0]), 0);
        assert_eq!(labelled.label_at([1.9, 0.0]), 1);
        assert_eq!(
            volumes([6, 2], [1.0, 1.0], &labelled.winner, 3),
            [1.5, 3.0, 0.5]
        );
    }
}

//! Exact values of labels: any number of different 64-bit integers.
//!
//! Samples are 32-bit floats, which hold integers up to 2^24 exactly. An image from a file of wider
//! integers therefore has exact labels in addition to its samples ([`ExactLabels`]). In all other
//! images the samples are exact.

use std::borrow::Cow;
use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::fmt;
use std::io::{self, Write};
use std::sync::Arc;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::Image;
use super::check::{are_whole_numbers, distinct_values, equal_neighbour_count};
use crate::files::codec::Codec;
use crate::parallel::prelude::*;

/// Largest number of different values that are labels although they are not whole numbers.
pub const MAX_REAL_LABELS: usize = 255;

/// Smallest share of equal neighbours in an image with more than [`MAX_REAL_LABELS`] labels.
const MIN_EQUAL_SHARE_MANY: f64 = 0.3;

/// Largest difference between a sample and the whole number that it stands for, as a share of that number
/// (at least of 1): other programs scale and resample labels in floating point.
const WHOLE_TOLERANCE: f32 = 1e-5;

/// Largest difference between a sample and the whole number that it stands for.
const MAX_WHOLE_DIFFERENCE: f32 = 0.05;

/// Value of the samples of a label.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LabelValue {
    /// A whole number, in the range of signed or unsigned 64-bit integers.
    Whole(i128),
    /// A number with a fraction.
    Real(f32),
}

impl LabelValue {
    /// Returns the label value of a sample.
    pub fn from_sample(sample: f32) -> Self {
        if sample.trunc() == sample && sample.abs() < 1e18 {
            Self::Whole(sample as i128)
        } else {
            Self::Real(sample)
        }
    }

    /// Parses a number. Returns `None` if the text is not a number, or if an integer does not fit
    /// into 64 bits.
    pub fn parse(text: &str) -> Option<Self> {
        let text = text.trim();
        match text.parse::<i128>() {
            Ok(whole) if fits_64_bits(whole) => Some(Self::Whole(whole)),
            Ok(_) => None,
            Err(_) => {
                let number = text.parse::<f64>().ok().filter(|x| x.is_finite())?;
                Some(Self::from_sample(number as f32))
            }
        }
    }

    /// Returns the value as the nearest 64-bit float.
    pub fn as_f64(self) -> f64 {
        match self {
            Self::Whole(whole) => whole as f64,
            Self::Real(real) => real.into(),
        }
    }

    /// Returns the value as the nearest sample.
    pub fn as_sample(self) -> f32 {
        match self {
            Self::Whole(whole) => whole as f32,
            Self::Real(real) => real,
        }
    }

    /// Returns the value if it is a whole number that fits into a signed 32-bit integer.
    pub fn as_i32(self) -> Option<i32> {
        match self {
            Self::Whole(whole) => whole.try_into().ok(),
            Self::Real(_) => None,
        }
    }
}

/// Returns `true` if a number fits into a signed or unsigned 64-bit integer.
fn fits_64_bits(number: i128) -> bool {
    (i128::from(i64::MIN)..=i128::from(u64::MAX)).contains(&number)
}

impl PartialEq<f64> for LabelValue {
    fn eq(&self, other: &f64) -> bool {
        self.as_f64() == *other
    }
}

impl PartialOrd for LabelValue {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        match (self, other) {
            (Self::Whole(a), Self::Whole(b)) => Some(a.cmp(b)),
            (a, b) => a.as_f64().partial_cmp(&b.as_f64()),
        }
    }
}

impl fmt::Display for LabelValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Whole(whole) => whole.fmt(f),
            Self::Real(real) => real.fmt(f),
        }
    }
}

impl Serialize for LabelValue {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match *self {
            Self::Whole(whole) => match (i64::try_from(whole), u64::try_from(whole)) {
                (Ok(signed), _) => serializer.serialize_i64(signed),
                (_, Ok(unsigned)) => serializer.serialize_u64(unsigned),
                _ => serializer.serialize_f64(whole as f64),
            },
            Self::Real(real) => serializer.serialize_f64(real.into()),
        }
    }
}

impl<'de> Deserialize<'de> for LabelValue {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let number = serde_json::Number::deserialize(deserializer)?;
        Ok(match (number.as_i64(), number.as_u64()) {
            (Some(signed), _) => Self::Whole(signed.into()),
            (_, Some(unsigned)) => Self::Whole(unsigned.into()),
            _ => Self::from_sample(number.as_f64().unwrap_or(f64::NAN) as f32),
        })
    }
}

impl Codec for LabelValue {
    fn encode(&self, out: &mut dyn Write) -> io::Result<()> {
        // A whole number is encoded as two halves of 64 bits, a real number as `None` and its 32
        // bits.
        let (high, low) = match *self {
            Self::Whole(whole) => (Some((whole >> 64) as u64), whole as u64),
            Self::Real(real) => (None, real.to_bits().into()),
        };
        high.encode(out)?;
        low.encode(out)
    }

    fn decode(bytes: &mut &[u8]) -> Option<Self> {
        let (high, low) = (
            <Option<u64> as Codec>::decode(bytes)?,
            <u64 as Codec>::decode(bytes)?,
        );
        Some(match high {
            Some(high) => Self::Whole(i128::from(high as i64) << 64 | i128::from(low)),
            None => Self::Real(f32::from_bits(u32::try_from(low).ok()?)),
        })
    }
}

/// Labels of samples that 32-bit floats would round.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExactLabels {
    /// The different values in ascending order.
    pub values: Vec<i128>,
    /// For each sample, in memory order, the index of its value in `values`.
    pub indices: Vec<u32>,
}

impl ExactLabels {
    /// Collects the labels of samples, given in memory order.
    pub fn from_integers(samples: impl IntoIterator<Item = i128>) -> Arc<Self> {
        let mut collector = LabelCollector::default();
        collector.extend(samples);
        collector.finish()
    }

    /// Returns the labels of the first `count` samples.
    pub fn take_first(&self, count: usize) -> Arc<Self> {
        let index = self.indices.iter().take(count);
        Self::from_integers(index.map(|&number| self.values[number as usize]))
    }
}

/// A sample of a type that holds whole numbers which 32-bit floats round.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ExactSample {
    /// A whole number of at most 64 bits.
    Whole(i128),
    /// NaN, infinite, or larger than any integer of 64 bits: no data.
    Missing,
    /// A number with a fraction, so that the image does not hold labels.
    Fraction,
}

/// Largest difference between a 64-bit float and the whole number that it stands for.
const EXACT_TOLERANCE: f64 = 1e-5;

impl From<f64> for ExactSample {
    fn from(number: f64) -> Self {
        let whole = number.round();
        if !number.is_finite() || whole.abs() >= i64::MAX as f64 {
            Self::Missing
        } else if (number - whole).abs() <= EXACT_TOLERANCE {
            Self::Whole(whole as i128)
        } else {
            Self::Fraction
        }
    }
}

/// Collector of [`ExactLabels`] for samples that arrive in parts.
#[derive(Debug, Default)]
pub struct LabelCollector {
    /// Index of each value, in the order in which the values were first seen.
    value_indices: BTreeMap<i128, u32>,
    last_entry: Option<(i128, u32)>,
    indices: Vec<u32>,
    /// Number of samples without data before the first value.
    leading_missing: usize,
    /// `true` if a sample has a fraction.
    has_fraction: bool,
}

impl LabelCollector {
    /// Adds the next samples, in memory order. Those without data get the label of the sample before
    /// them, or of the first that has one. Returns `false` if a sample has a fraction, so that more
    /// samples change nothing.
    pub fn extend_exact(&mut self, samples: impl IntoIterator<Item = ExactSample>) -> bool {
        for sample in samples {
            match (sample, self.last_entry) {
                (ExactSample::Whole(number), None) => {
                    let leading = std::mem::take(&mut self.leading_missing);
                    self.extend(std::iter::repeat_n(number, leading + 1));
                }
                (ExactSample::Whole(number), _) => self.extend([number]),
                (ExactSample::Missing, None) => self.leading_missing += 1,
                (ExactSample::Missing, Some((_, index))) => self.indices.push(index),
                (ExactSample::Fraction, _) => self.has_fraction = true,
            }
            if self.has_fraction {
                return false;
            }
        }
        true
    }

    /// Returns the labels of all samples that were added, or `None` if a sample has a fraction or
    /// none has data.
    pub fn finish_exact(self) -> Option<Arc<ExactLabels>> {
        let are_labels = !self.has_fraction && self.last_entry.is_some();
        are_labels.then(|| self.finish())
    }

    /// Adds the next samples, in memory order.
    pub fn extend(&mut self, samples: impl IntoIterator<Item = i128>) {
        for sample in samples {
            let number = match self.last_entry {
                Some((value, number)) if value == sample => number,
                _ => {
                    let next = self.value_indices.len() as u32;
                    *self.value_indices.entry(sample).or_insert(next)
                }
            };
            self.last_entry = Some((sample, number));
            self.indices.push(number);
        }
    }

    /// Returns the labels of all samples that were added.
    pub fn finish(mut self) -> Arc<ExactLabels> {
        let mut rank = vec![0; self.value_indices.len()];
        for (ascending, &number) in self.value_indices.values().enumerate() {
            rank[number as usize] = ascending as u32;
        }
        let index = self.indices.par_iter_mut();
        index.for_each(|number| *number = rank[*number as usize]);
        Arc::new(ExactLabels {
            values: self.value_indices.into_keys().collect(),
            indices: self.indices,
        })
    }
}

/// The different labels of an image, and the label of each sample.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelTable {
    /// The values in ascending order.
    pub values: Vec<LabelValue>,
    /// For each sample, in memory order, the index of its value in `values`.
    pub indices: Vec<u32>,
}

impl LabelTable {
    /// Returns the labels of an image, or `None` if its samples have too many different values to
    /// be labels.
    pub fn from_image<const D: usize>(image: &Image<D>) -> Option<Self> {
        if let Some(exact) = &image.labels {
            return Some(Self {
                values: exact.values.iter().map(|&v| LabelValue::Whole(v)).collect(),
                indices: exact.indices.clone(),
            });
        }
        let samples = without_rounding_errors(image.as_slice());
        let mut values = label_values(&samples)?;
        values
            .iter_mut()
            .for_each(|v| *v = without_rounding_error(*v));
        values.dedup();
        let number = |&s: &f32| values.partition_point(|&v| v < without_rounding_error(s)) as u32;
        let index = samples.par_iter().map(number).collect();
        Some(Self {
            values: values.into_iter().map(LabelValue::from_sample).collect(),
            indices: index,
        })
    }
}

impl<const D: usize> Image<D> {
    /// Returns an image of labels in which the samples without data have a label of their own, and this
    /// label: a whole number above the largest, or below the smallest if there is none above. Returns `None` if
    /// all samples hold data, or none does.
    pub(crate) fn with_outside_label(&self) -> Option<(Self, LabelValue)> {
        let samples = self.as_slice();
        let finite = || samples.iter().copied().filter(|s| s.is_finite());
        let [low, high] = [finite().reduce(f32::min)?, finite().reduce(f32::max)?];
        if finite().count() == samples.len() {
            return None;
        }
        let outside = match high.ceil() + 1.0 {
            above if above > high => above,
            _ => low.floor() - 1.0,
        };
        let filled = samples
            .iter()
            .map(|&s| if s.is_finite() { s } else { outside });
        let mut image = Self::new(self.dims(), filled.collect(), self.geometry.clone());
        image.label_names.clone_from(&self.label_names);
        let Some(exact) = &self.labels else {
            return Some((image, LabelValue::from_sample(outside)));
        };
        let value = |(sample, &index): (&f32, &u32)| {
            sample.is_finite().then(|| exact.values[index as usize])
        };
        let values = || samples.iter().zip(&exact.indices).map(value);
        let [low, high] = [values().flatten().min()?, values().flatten().max()?];
        let outside = if high < i128::from(i64::MAX) {
            high + 1
        } else {
            low - 1
        };
        image.labels = Some(ExactLabels::from_integers(
            values().map(|v| v.unwrap_or(outside)),
        ));
        Some((image, LabelValue::Whole(outside)))
    }
}

/// Returns the whole number that a sample equals up to rounding, or else the sample.
fn without_rounding_error(sample: f32) -> f32 {
    let whole = sample.round();
    let tolerance = WHOLE_TOLERANCE * whole.abs().max(1.0);
    if (sample - whole).abs() <= tolerance.min(MAX_WHOLE_DIFFERENCE) {
        // The sum turns -0 to 0.
        whole + 0.0
    } else {
        sample
    }
}

/// Returns samples that are whole numbers up to rounding as whole numbers, if there are several of
/// them; other samples as they are.
pub fn without_rounding_errors(samples: &[f32]) -> Cow<'_, [f32]> {
    let whole = |s: &f32| without_rounding_error(*s);
    let is_near_whole = |s: &f32| s.is_nan() || whole(s).trunc() == whole(s);
    let chunks = samples.par_chunks(1 << 16);
    if !chunks.all(|chunk| chunk.iter().all(is_near_whole)) || are_exact(samples) {
        return Cow::Borrowed(samples);
    }
    let first = samples.iter().find(|s| s.is_finite()).map(whole);
    let differ = samples
        .iter()
        .any(|s| s.is_finite() && Some(whole(s)) != first);
    if differ {
        Cow::Owned(samples.par_iter().map(whole).collect())
    } else {
        Cow::Borrowed(samples)
    }
}

/// Returns `true` if no sample has a fraction.
fn are_exact(samples: &[f32]) -> bool {
    let chunks = samples.par_chunks(1 << 16);
    chunks.all(|chunk| chunk.iter().all(|s| s.is_nan() || s.trunc() == *s))
}

/// Returns the largest difference of the samples from the whole numbers as which
/// [`LabelTable::from_image`] takes them, or `None` if it takes them as they are.
pub fn rounding_of_labels<const D: usize>(image: &Image<D>) -> Option<f32> {
    if image.labels.is_some() {
        return None;
    }
    let Cow::Owned(whole) = without_rounding_errors(image.as_slice()) else {
        return None;
    };
    let samples = image.as_slice().iter().zip(&whole);
    Some(samples.fold(0.0f32, |max, (s, w)| max.max((s - w).abs())))
}

/// Returns the different values of the samples in ascending order. Returns `None` if they are not
/// labels: more than [`MAX_REAL_LABELS`] values that are not whole numbers, or that neighbours
/// rarely share.
fn label_values(samples: &[f32]) -> Option<Vec<f32>> {
    if let Some(values) = distinct_values(samples, MAX_REAL_LABELS) {
        return Some(values);
    }
    let equal = equal_neighbour_count(samples) as f64;
    let shared = equal >= MIN_EQUAL_SHARE_MANY * samples.len() as f64;
    if !shared || !samples.par_chunks(1 << 16).all(are_whole_numbers) {
        return None;
    }
    distinct_values(samples, usize::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Geometry;

    #[test]
    fn values_of_64_bits_are_read_and_written_exactly() {
        for text in [
            "0",
            "-7",
            "16777217",
            "9223372036854775807",
            "-9223372036854775808",
            "18446744073709551615",
            "0.25",
        ] {
            let value = LabelValue::parse(text).unwrap();
            assert_eq!(value.to_string(), text);
            let json = serde_json::to_string(&value).unwrap();
            assert_eq!(json, text);
            assert_eq!(serde_json::from_str::<LabelValue>(&json).unwrap(), value);
            let mut bytes = Vec::new();
            value.encode(&mut bytes).unwrap();
            assert_eq!(LabelValue::decode(&mut &bytes[..]), Some(value));
        }
        assert_eq!(LabelValue::parse("18446744073709551616"), None);
        assert_eq!(LabelValue::parse("nan"), None);
        // Files of earlier versions hold whole numbers as floats.
        let old: LabelValue = serde_json::from_str("3.0").unwrap();
        assert_eq!(old, LabelValue::Whole(3));
    }

    #[test]
    fn labels_beyond_floats_stay_apart_and_are_ascending() {
        let big = 1i128 << 60;
        let samples = [big + 1, big, big + 1, 5, big];
        let exact = ExactLabels::from_integers(samples);
        assert_eq!(exact.values, [5, big, big + 1]);
        assert_eq!(exact.indices, [2, 1, 2, 0, 1]);
        assert_eq!(exact.take_first(2).values, [big, big + 1]);
        let rounded = samples.iter().map(|&v| v as f32).collect();
        let mut image = Image::new([5, 1], rounded, Geometry::default());
        assert_eq!(LabelTable::from_image(&image).unwrap().values.len(), 2);
        image.labels = Some(exact);
        assert_eq!(
            LabelTable::from_image(&image).unwrap().indices,
            [2, 1, 2, 0, 1]
        );
    }

    #[test]
    fn values_that_differ_by_rounding_are_one_label() {
        let samples = vec![-3e-7, 0.0, 1.9999999, 2.0, 2.0000002, 2.001, 0.5, 59.999996];
        let image = Image::new([4, 2], samples, Geometry::default());
        let table = LabelTable::from_image(&image).unwrap();
        assert_eq!(table.values, [0.0, 0.5, 2.0, f64::from(2.001_f32), 60.0]);
        assert_eq!(table.indices, [0, 0, 2, 2, 2, 3, 1, 4]);
    }

    #[test]
    fn many_labels_are_distinguished_from_many_grey_values() {
        let count = 70_000;
        let blocks: Vec<f32> = (0..4 * count)
            .map(|i| (i / 4 * 31 % count) as f32)
            .collect();
        let table_of = |samples: Vec<f32>| {
            LabelTable::from_image(&Image::new(
                [samples.len(), 1],
                samples,
                Geometry::default(),
            ))
        };
        let table = table_of(blocks.clone()).unwrap();
        assert_eq!(table.values.len(), count);
        assert_eq!(
            table.values[table.indices[5] as usize],
            LabelValue::Whole(31)
        );
        assert_eq!(table_of(blocks.iter().map(|v| v + 0.5).collect()), None);
        assert_eq!(
            table_of((0..1000).map(|i| (i * 7 % 1000) as f32).collect()),
            None
        );
    }
}

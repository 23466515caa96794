//! Finds the samples of an image that hold no data.
//!
//! A sample is dead if it is not finite, if it holds a null value, if it belongs to a trace that the survey
//! lacks or that is zero throughout, or if it stands alone far outside the range of all others.

use super::Image;
use crate::error::{Error, Result, cause};
use crate::memory;
use crate::parallel::prelude::*;

/// Values that programs write where there are no data: Kingdom and Petrel, LAS files, grids of GIS, IRAP,
/// CPS-3, ZMAP+, Surfer, netCDF.
const COMMON_NULLS: [f32; 11] = [
    -999.25,
    -999.0,
    -9999.0,
    -99999.0,
    -999_999.0,
    9_999_900.0,
    1e30,
    -1e30,
    1.701_41e38,
    f32::MAX,
    f32::MIN,
];

/// The least magnitude among the common null values.
const MIN_NULL_MAGNITUDE: f32 = 999.0;

/// One sample of a null value of this magnitude or more is enough: no measurement is so large.
const CERTAIN_NULL_MAGNITUDE: f32 = 1e29;

/// A null value of lesser magnitude has at least so many samples.
const MIN_NULL_COUNT: usize = 8;

/// Traces shorter than this (samples) may be zero by chance.
const MIN_TRACE_LEN: usize = 8;

/// In an image with a larger share of zeros outside of traces that are zero throughout, zero is a value
/// like others.
const MAX_ZERO_SHARE: f64 = 0.3;

/// A sample is an outlier if it is farther from the median than all features by this factor.
const OUTLIER_FACTOR: f32 = 8.0;

/// Outliers are no larger share of the samples than this: what is more is a part of the image.
const MAX_OUTLIER_SHARE: f64 = 1e-3;

/// Samples, evenly spread, by which the usual distance from the median is judged.
const MEDIAN_SAMPLE_COUNT: usize = 100_000;

/// An image whose dead samples are marked, and notes on what was found.
#[derive(Debug, Clone)]
pub struct MaskedImage<const D: usize> {
    /// The image; its dead samples are zeros.
    pub image: Image<D>,
    /// One line for each kind of dead samples.
    pub notes: Vec<String>,
}

impl<const D: usize> Image<D> {
    /// Returns the image with those of its samples marked as dead that are not finite and, if `recognise`
    /// is set, those of common null values, of traces that are zero throughout, and outliers. Returns `None` if there
    /// are none but those that are marked already.
    ///
    /// # Errors
    /// [`Error::Image`] if no sample is left, [`Error::Job`] if there is no memory for the marks.
    pub fn mark_dead(&self, recognise: bool) -> Result<Option<MaskedImage<D>>> {
        let samples = self.as_slice();
        let count = samples.len();
        let percent = |part: usize| 100.0 * part as f64 / count.max(1) as f64;
        let nulls = match recognise {
            true => self.common_nulls(),
            false => Vec::new(),
        };
        let is_finite = |part: &[f32]| part.iter().fold(true, |all, s| all & s.is_finite());
        let finite = samples.par_chunks(4096).all(is_finite);
        let zeros = match recognise {
            true => self.zero_traces(&nulls),
            false => Vec::new(),
        };
        let outliers = match recognise {
            true => self.outliers(&nulls),
            false => Vec::new(),
        };
        if finite && nulls.is_empty() && zeros.is_empty() && outliers.is_empty() {
            return Ok(None);
        }
        memory::ensure_available(
            "the image",
            5.0 * count as f64,
            format!("marks of {count} samples, some of which hold no data"),
            "mesh a part of it",
        )?;
        let mut notes = Vec::new();
        let dead = |s: &f32| !s.is_finite() || nulls.iter().any(|null| is_null(*s, null.value));
        let mut flags: Vec<bool> = samples.par_iter().map(dead).collect();
        if !finite {
            let bad = samples.iter().filter(|s| !s.is_finite()).count();
            notes.push(format!(
                "{bad} samples ({:.2} %) are not finite and count as missing",
                percent(bad)
            ));
        }
        for null in &nulls {
            notes.push(format!(
                "{} samples ({:.2} %) hold {}, a common null value, and count as missing (--null none \
                 keeps them)",
                null.count,
                percent(null.count),
                null.value,
            ));
        }
        if !outliers.is_empty() {
            outliers.iter().for_each(|&i| flags[i] = true);
            let farthest = outliers
                .iter()
                .map(|&i| samples[i])
                .max_by(|a, b| a.abs().total_cmp(&b.abs()));
            notes.push(format!(
                "{} single samples ({:.2} %) lie {OUTLIER_FACTOR} times farther out than all others (up to {}) and \
                 count as missing (--null none keeps them)",
                outliers.len(),
                percent(outliers.len()),
                farthest.unwrap_or_default(),
            ));
        }
        if !zeros.is_empty() {
            let vertical = self.vertical_axis();
            let (length, stride) = (self.dims()[vertical], self.stride(vertical));
            for &start in &zeros {
                (0..length).for_each(|i| flags[start + i * stride] = true);
            }
            let traces = count / length;
            notes.push(format!(
                "{} of {traces} traces ({:.2} %) are zero throughout and count as missing (--null none keeps \
                 them)",
                zeros.len(),
                100.0 * zeros.len() as f64 / traces as f64
            ));
        }
        if !self.dead.is_empty() {
            flags
                .iter_mut()
                .zip(&self.dead)
                .for_each(|(to, dead)| *to |= dead);
        }
        for (row, _) in self
            .missing
            .iter()
            .enumerate()
            .filter(|(_, missing)| **missing)
        {
            flags[row * self.dims()[0]..][..self.dims()[0]].fill(true);
        }
        if !flags.contains(&false) {
            return Err(Error::Image(cause(
                "image",
                "has no sample that holds data",
                "check that the right file and attribute were read, or give --null none",
            )));
        }
        let mut samples = samples.to_vec();
        for (sample, _) in samples.iter_mut().zip(&flags).filter(|(_, dead)| **dead) {
            *sample = 0.0;
        }
        let image = Self::new(self.dims(), samples, self.geometry.clone()).with_dead(flags);
        Ok(Some(MaskedImage { image, notes }))
    }

    /// Returns the image with these samples marked as dead, one flag a sample.
    pub fn with_dead(mut self, flags: Vec<bool>) -> Self {
        let rows = flags.chunks(self.dims()[0].max(1));
        let whole = rows
            .clone()
            .all(|row| row.iter().all(|dead| *dead == row[0]));
        if whole {
            let missing = rows.map(|row| row[0]).collect();
            self.dead = Vec::new();
            return self.with_missing(missing);
        }
        self.missing = Vec::new();
        self.dead = flags;
        self
    }

    /// Returns the axis that runs along the vertical, or nearest to it.
    fn vertical_axis(&self) -> usize {
        let upright = |k: usize| {
            let axis = self.geometry.axes[k];
            let length = axis.iter().map(|c| c * c).sum::<f64>().sqrt();
            axis[D - 1].abs() / length.max(f64::MIN_POSITIVE)
        };
        (1..D).fold(
            0,
            |best, k| if upright(k) >= upright(best) { k } else { best },
        )
    }

    pub(super) fn stride(&self, axis: usize) -> usize {
        self.dims()[..axis].iter().product()
    }

    /// Returns the common null values that the image has.
    fn common_nulls(&self) -> Vec<NullValue> {
        let samples = self.as_slice();
        let dims = self.dims();
        let strides: [usize; D] = std::array::from_fn(|k| self.stride(k));
        let has_twin = |i: usize| {
            strides.iter().zip(dims).any(|(&stride, n)| {
                let at = i / stride % n;
                at > 0 && samples[i - stride] == samples[i]
                    || at + 1 < n && samples[i + stride] == samples[i]
            })
        };
        // For each value: samples, those beside a sample that is alike, and samples of the opposite value.
        type NullCounts = [[usize; 3]; COMMON_NULLS.len()];
        const CHUNK_LEN: usize = 1 << 14;
        let count = |(chunk, part): (usize, &[f32])| {
            let mut counts: NullCounts = Default::default();
            for (i, &s) in part.iter().enumerate() {
                if s.abs() < MIN_NULL_MAGNITUDE {
                    continue;
                }
                for (counts, &null) in counts.iter_mut().zip(&COMMON_NULLS) {
                    if is_null(s, null) {
                        counts[0] += 1;
                        counts[1] += usize::from(has_twin(chunk * CHUNK_LEN + i));
                    }
                    counts[2] += usize::from(is_null(s, -null));
                }
            }
            counts
        };
        let parts: Vec<NullCounts> = samples
            .par_chunks(CHUNK_LEN)
            .enumerate()
            .map(count)
            .collect();
        let total = |value: usize, which: usize| parts.iter().map(|part| part[value][which]).sum();
        let found = COMMON_NULLS.iter().enumerate().filter_map(|(i, &value)| {
            let [count, twins, opposite]: [usize; 3] = [0, 1, 2].map(|which| total(i, which));
            // What is clipped is so at both ends.
            let is_fill =
                count >= MIN_NULL_COUNT && 10 * twins >= 9 * count && 4 * opposite < count;
            let impossible = value.abs() >= CERTAIN_NULL_MAGNITUDE && count > 0;
            (is_fill || impossible).then_some(NullValue { value, count })
        });
        found.collect()
    }

    /// Returns the samples that stand alone and lie far outside the range of all others.
    fn outliers(&self, nulls: &[NullValue]) -> Vec<usize> {
        let samples = self.as_slice();
        let is_data = |s: f32| s.is_finite() && !nulls.iter().any(|null| is_null(s, null.value));
        let every = samples.len().div_ceil(MEDIAN_SAMPLE_COUNT) | 1;
        let some = samples.iter().step_by(every).copied();
        let mut some: Vec<f32> = some.filter(|s| is_data(*s)).collect();
        if some.is_empty() {
            return Vec::new();
        }
        let middle = some.len() / 2;
        let median = *some.select_nth_unstable_by(middle, f32::total_cmp).1;
        let mut usual: Vec<f32> = some.iter().map(|s| (s - median).abs()).collect();
        usual.retain(|off| *off > 0.0);
        if usual.is_empty() {
            return Vec::new();
        }
        let most = usual.len() * 99 / 100;
        let usual = *usual.select_nth_unstable_by(most, f32::total_cmp).1;
        let is_far = |s: f32, bound: f32| (s - median).abs() > bound && is_data(s);
        let range = |part: &[f32]| {
            part.iter()
                .fold(0.0, |most: f32, s| most.max((s - median).abs()))
        };
        let bound = OUTLIER_FACTOR * usual;
        if samples.par_chunks(4096).all(|part| range(part) <= bound) {
            return Vec::new();
        }
        let far = |i: &usize| is_far(samples[*i], bound);
        let far: Vec<usize> = (0..samples.len()).into_par_iter().filter(far).collect();
        if far.len() as f64 > MAX_OUTLIER_SHARE * samples.len() as f64 {
            return Vec::new();
        }
        // Of a sheet of such samples each has many others within two samples.
        let dims = self.dims();
        let strides: [usize; D] = std::array::from_fn(|k| self.stride(k));
        let alone = if D == 2 { 4 } else { 8 };
        let stands_alone = |i: usize| {
            let mut near = 0;
            for number in 0..5usize.pow(D as u32) {
                let (mut rest, mut to, mut inside) = (number, 0, true);
                for k in 0..D {
                    let at = i / strides[k] % dims[k] + rest % 5;
                    inside &= (2..dims[k] + 2).contains(&at);
                    to += at.saturating_sub(2) * strides[k];
                    rest /= 5;
                }
                near += usize::from(inside && is_far(samples[to], bound));
            }
            near <= alone
        };
        let (single, together): (Vec<usize>, Vec<usize>) =
            far.into_iter().partition(|&i| stands_alone(i));
        let largest = together.iter().map(|&i| (samples[i] - median).abs());
        let bound = OUTLIER_FACTOR * largest.fold(usual, f32::max);
        let single = single.into_iter().filter(|&i| is_far(samples[i], bound));
        single.collect()
    }

    /// Returns the first sample of each trace that is zero throughout but not marked yet, if the image is one
    /// of amplitudes, which are hardly ever zero.
    fn zero_traces(&self, nulls: &[NullValue]) -> Vec<usize> {
        let (samples, vertical) = (self.as_slice(), self.vertical_axis());
        let (length, stride) = (self.dims()[vertical], self.stride(vertical));
        if length < MIN_TRACE_LEN {
            return Vec::new();
        }
        let lanes = samples.len() / length;
        let start = |lane: usize| lane / stride * stride * length + lane % stride;
        let is_marked = |i: usize| {
            self.dead.get(i).copied().unwrap_or(false)
                || self
                    .missing
                    .get(i / self.dims()[0])
                    .copied()
                    .unwrap_or(false)
        };
        let is_null = |s: f32| !s.is_finite() || nulls.iter().any(|null| is_null(s, null.value));
        let is_zero = |&start: &usize| {
            let mut zeros = 0;
            let all = (0..length).map(|i| start + i * stride).all(|i| {
                let zero = samples[i] == 0.0 && !is_marked(i);
                zeros += usize::from(zero);
                zero || samples[i] == 0.0 || is_null(samples[i])
            });
            all && 2 * zeros > length
        };
        let found: Vec<usize> = (0..lanes)
            .into_par_iter()
            .map(start)
            .filter(is_zero)
            .collect();
        if found.is_empty() {
            return found;
        }
        // Positive, negative and zero samples outside of them.
        let sign = |part: &[f32]| {
            part.iter().fold([0usize; 3], |[more, less, zero], &s| {
                let live = !is_null(s);
                [
                    more + usize::from(live && s > 0.0),
                    less + usize::from(live && s < 0.0),
                    zero + usize::from(s == 0.0),
                ]
            })
        };
        let add = |a: [usize; 3], b: [usize; 3]| std::array::from_fn(|k| a[k] + b[k]);
        let [more, less, zero] = samples.par_chunks(4096).map(sign).reduce(|| [0; 3], add);
        let marked = match self.dead.is_empty() {
            true => self.missing.iter().filter(|m| **m).count() * self.dims()[0],
            false => self.dead.iter().filter(|m| **m).count(),
        };
        let zero = zero.saturating_sub(found.len() * length + marked) as f64;
        let values = (more + less) as f64;
        let has_both_signs = more.min(less) as f64 > 0.1 * values;
        match has_both_signs && zero < MAX_ZERO_SHARE * (zero + values) {
            true => found,
            false => Vec::new(),
        }
    }
}

/// A null value that an image has.
struct NullValue {
    value: f32,
    count: usize,
}

/// Returns whether a sample holds a null value; floats of IBM round it.
pub(crate) fn is_null(sample: f32, null: f32) -> bool {
    sample == null
        || (sample - null).abs() <= 1e-6 * null.abs() && null.fract() != 0.0
        || null.abs() >= CERTAIN_NULL_MAGNITUDE && (sample / null - 1.0).abs() <= 1e-5
}

/// Returns whether a sample holds a common null value.
pub(crate) fn may_be_null(sample: f32) -> bool {
    COMMON_NULLS.iter().any(|&null| is_null(sample, null))
}

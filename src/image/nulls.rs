//! Finds the samples of an image that hold no data.
//!
//! A sample is dead if it is not finite, if it holds a null value, if it belongs to a trace that
//! the survey lacks or that is zero throughout, or if it is an isolated outlier far outside the
//! range of all other samples.

use super::Image;
use crate::error::{Error, Result, cause};
use crate::geometry::grid_index::{index_at, offset_of, strides};
use crate::geometry::statistics::{upper_median, upper_quantile};
use crate::geometry::unit;
use crate::memory;
use crate::parallel::prelude::*;

/// Values that programs write where there is no data: Kingdom and Petrel, LAS files, GIS grids,
/// IRAP, CPS-3, ZMAP+, Surfer, xtgeo, netCDF.
pub(super) const COMMON_NULLS: [f32; 12] = [
    -999.25,
    -999.0,
    -9999.0,
    -99999.0,
    -999_999.0,
    9_999_900.0,
    1e30,
    -1e30,
    1e33,
    1.701_41e38,
    f32::MAX,
    f32::MIN,
];

/// Smallest magnitude of the common null values.
const MIN_NULL_MAGNITUDE: f32 = 999.0;

/// Magnitude from which a single sample is enough to identify a null value, because no measurement
/// is so large.
pub(super) const CERTAIN_NULL_MAGNITUDE: f32 = 1e29;

/// Smallest number of samples of a null value below [`CERTAIN_NULL_MAGNITUDE`].
pub(super) const MIN_NULL_COUNT: usize = 8;

/// Largest difference between a value and a null value that counts as near, as a share of the null
/// value.
const NEAR_NULL_RATIO: f32 = 0.1;

/// Shortest trace, in samples, that counts as missing if it is zero throughout. Shorter traces may
/// be zero by chance.
const MIN_TRACE_LEN: usize = 8;

/// Largest share of zeros outside of traces that are zero throughout. If an image has more zeros,
/// zero is an ordinary value.
const MAX_ZERO_SHARE: f64 = 0.3;

/// Smallest ratio between the distance of an outlier from the median and that of all other samples.
const OUTLIER_FACTOR: f32 = 8.0;

/// Largest share of outliers among the samples. If there are more, they are a part of the image.
const MAX_OUTLIER_SHARE: f64 = 1e-3;

/// Number of samples, evenly spread, from which the usual distance from the median is estimated.
const MEDIAN_SAMPLE_COUNT: usize = 100_000;

/// An image whose dead samples are marked, and notes for the user.
#[derive(Debug, Clone)]
pub struct MaskedImage<const D: usize> {
    /// The image; its dead samples are zeros.
    pub image: Image<D>,
    /// One line for each kind of dead sample.
    pub notes: Vec<String>,
}

/// Samples of an image that hold no data, by the reason for which they are recognised.
#[derive(Default)]
struct DeadSamples {
    /// Number of samples that are not finite.
    non_finite: usize,
    nulls: Vec<NullValue>,
    /// First sample of each trace that is zero throughout.
    zero_traces: Vec<usize>,
    outliers: Vec<usize>,
}

impl DeadSamples {
    /// Finds the samples that are not finite and, if `recognise` is set, the others; outliers only
    /// with `with_outliers`.
    fn find<const D: usize>(image: &Image<D>, recognise: bool, with_outliers: bool) -> Self {
        let non_finite = |part: &[f32]| part.iter().filter(|s| !s.is_finite()).count();
        let mut found = Self {
            non_finite: image.as_slice().par_chunks(4096).map(non_finite).sum(),
            ..Self::default()
        };
        if recognise {
            found.nulls = image.common_nulls();
            found.zero_traces = image.zero_traces(&found.nulls);
        }
        if recognise && with_outliers {
            found.outliers = image.outliers(&found.nulls);
        }
        found
    }

    /// Returns `true` if every sample holds data.
    fn is_empty(&self) -> bool {
        self.non_finite == 0
            && self.nulls.is_empty()
            && self.zero_traces.is_empty()
            && self.outliers.is_empty()
    }

    /// Returns one line for each kind of dead sample.
    fn notes<const D: usize>(&self, image: &Image<D>) -> Vec<String> {
        let samples = image.as_slice();
        let percent = |part: usize| 100.0 * part as f64 / samples.len().max(1) as f64;
        let mut notes = Vec::new();
        if self.non_finite > 0 {
            notes.push(format!(
                "{} samples ({:.2} %) are NaN or infinite and count as missing",
                self.non_finite,
                percent(self.non_finite)
            ));
        }
        for null in &self.nulls {
            notes.push(format!(
                "{} samples ({:.2} %) hold {}, a common null value, and count as missing (--null none \
                 keeps them)",
                null.count,
                percent(null.count),
                null_text(null.value),
            ));
        }
        if !self.outliers.is_empty() {
            let values = self.outliers.iter().map(|&i| samples[i]);
            let farthest = values.max_by(|a, b| a.abs().total_cmp(&b.abs()));
            notes.push(format!(
                "{} isolated samples ({:.2} %) lie {OUTLIER_FACTOR} times farther from the median than all others (up to {}) and \
                 count as missing (--null none keeps them)",
                self.outliers.len(),
                percent(self.outliers.len()),
                farthest.unwrap_or_default(),
            ));
        }
        if !self.zero_traces.is_empty() {
            let traces = samples.len() / image.dims()[image.vertical_axis()];
            notes.push(format!(
                "{} of {traces} traces ({:.2} %) are zero throughout and count as missing (--null none keeps \
                 them)",
                self.zero_traces.len(),
                100.0 * self.zero_traces.len() as f64 / traces as f64
            ));
        }
        notes
    }

    /// Returns `true` for each sample that is dead, those that the image has marked already
    /// included.
    fn flags<const D: usize>(&self, image: &Image<D>) -> Vec<bool> {
        let is_dead =
            |s: &f32| !s.is_finite() || self.nulls.iter().any(|null| is_null(*s, null.value));
        let mut flags: Vec<bool> = image.as_slice().par_iter().map(is_dead).collect();
        self.outliers.iter().for_each(|&i| flags[i] = true);
        let (dims, vertical) = (image.dims(), image.vertical_axis());
        let stride = strides(dims)[vertical];
        for &start in &self.zero_traces {
            (0..dims[vertical]).for_each(|i| flags[start + i * stride] = true);
        }
        let marked = flags.iter_mut().zip(&image.dead);
        marked.for_each(|(flag, dead)| *flag |= dead);
        let rows = image.missing.iter().enumerate();
        for (row, _) in rows.filter(|(_, missing)| **missing) {
            flags[row * dims[0]..][..dims[0]].fill(true);
        }
        flags
    }
}

impl<const D: usize> Image<D> {
    /// Returns the image with dead samples marked, or `None` if there are no others than those
    /// marked already.
    ///
    /// Samples that are not finite are always marked. If `recognise` is set, common null values,
    /// traces that are zero throughout, and outliers are marked, too.
    ///
    /// # Errors
    /// Returns an [`Error::Image`] if no sample is left, and an [`Error::Job`] if there is not
    /// enough memory for the marks.
    pub fn mark_dead(&self, recognise: bool) -> Result<Option<MaskedImage<D>>> {
        self.mark(&DeadSamples::find(self, recognise, true))
    }

    /// Returns the image with dead samples marked as [`mark_dead`](Self::mark_dead) does, except that
    /// outliers count as data: a few samples of a permeability may be far above all others.
    ///
    /// # Errors
    /// Returns the errors of [`mark_dead`](Self::mark_dead).
    pub(crate) fn mark_nulls(&self, recognise: bool) -> Result<Option<MaskedImage<D>>> {
        self.mark(&DeadSamples::find(self, recognise, false))
    }

    /// Returns the image with these samples marked as dead, or `None` if there are none.
    fn mark(&self, found: &DeadSamples) -> Result<Option<MaskedImage<D>>> {
        let samples = self.as_slice();
        let count = samples.len();
        if found.is_empty() {
            return Ok(None);
        }
        memory::ensure_available(
            "the image",
            5.0 * count as f64,
            format!("marks of {count} samples, some of which hold no data"),
            "give a part of the image",
        )?;
        let notes = found.notes(self);
        let flags = found.flags(self);
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
        let mut image = Self::new(self.dims(), samples, self.geometry.clone()).with_dead(flags);
        image.labels.clone_from(&self.labels);
        image.label_names.clone_from(&self.label_names);
        Ok(Some(MaskedImage { image, notes }))
    }

    /// Returns the image with these samples marked as dead, one flag per sample.
    pub fn with_dead(mut self, flags: Vec<bool>) -> Self {
        let rows = flags.chunks(self.dims()[0].max(1));
        let has_uniform_rows = rows
            .clone()
            .all(|row| row.iter().all(|dead| *dead == row[0]));
        if has_uniform_rows {
            let missing = rows.map(|row| row[0]).collect();
            self.dead = Vec::new();
            return self.with_missing(missing);
        }
        self.missing = Vec::new();
        self.dead = flags;
        self
    }

    /// Returns the image axis that is closest to the vertical.
    fn vertical_axis(&self) -> usize {
        let verticality = |k: usize| unit(self.geometry.axes[k])[D - 1].abs();
        (1..D).fold(0, |best, k| {
            if verticality(k) >= verticality(best) {
                k
            } else {
                best
            }
        })
    }

    /// Returns the common null values that occur in the image.
    fn common_nulls(&self) -> Vec<NullValue> {
        let samples = self.as_slice();
        let dims = self.dims();
        let strides = strides(dims);
        let has_equal_neighbour = |i: usize| {
            let index = index_at(dims, i);
            (0..D).any(|k| {
                index[k] > 0 && samples[i - strides[k]] == samples[i]
                    || index[k] + 1 < dims[k] && samples[i + strides[k]] == samples[i]
            })
        };
        // For each value: the number of its samples, of those with an equal neighbour, of samples of
        // the opposite value, of other samples near the value, and of other samples that are at
        // least half as large and have the same sign.
        type NullCounts = [[usize; 5]; COMMON_NULLS.len()];
        const CHUNK_LEN: usize = 1 << 14;
        let count = |(chunk, part): (usize, &[f32])| {
            let mut counts: NullCounts = Default::default();
            for (i, &s) in part.iter().enumerate() {
                if s.abs() < 0.5 * MIN_NULL_MAGNITUDE || !s.is_finite() {
                    continue;
                }
                let is_value = !may_be_null(s);
                for (counts, &null) in counts.iter_mut().zip(&COMMON_NULLS) {
                    if is_null(s, null) {
                        counts[0] += 1;
                        counts[1] += usize::from(has_equal_neighbour(chunk * CHUNK_LEN + i));
                    }
                    counts[2] += usize::from(is_null(s, -null));
                    let ratio = s / null;
                    counts[3] += usize::from(is_value && (ratio - 1.0).abs() < NEAR_NULL_RATIO);
                    counts[4] += usize::from(is_value && ratio >= 0.5);
                }
            }
            counts
        };
        let parts: Vec<NullCounts> = samples
            .par_chunks(CHUNK_LEN)
            .enumerate()
            .map(count)
            .collect();
        let total = |value: usize, kind: usize| parts.iter().map(|part| part[value][kind]).sum();
        let nulls = COMMON_NULLS.iter().enumerate().filter_map(|(i, &value)| {
            let [count, repeated, opposite, near, beyond]: [usize; 5] =
                std::array::from_fn(|kind| total(i, kind));
            // A fill value covers areas, or it is much more frequent than the values next to it.
            let is_frequent = 10 * repeated >= 9 * count || 4 * near < count;
            // Clipped amplitudes occur at both ends of the range, null values do not.
            let is_fill = count >= MIN_NULL_COUNT && is_frequent && 4 * opposite < count;
            // A few samples are enough where no other value comes near.
            let stands_apart = beyond + opposite == 0;
            let impossible = value.abs() >= CERTAIN_NULL_MAGNITUDE;
            (count > 0 && (is_fill || stands_apart || impossible))
                .then_some(NullValue { value, count })
        });
        nulls.collect()
    }

    /// Returns the samples that are isolated and lie far outside the range of all others.
    fn outliers(&self, nulls: &[NullValue]) -> Vec<usize> {
        let samples = self.as_slice();
        let is_data = |s: f32| s.is_finite() && !nulls.iter().any(|null| is_null(s, null.value));
        let sample_step = samples.len().div_ceil(MEDIAN_SAMPLE_COUNT) | 1;
        let subset = samples.iter().step_by(sample_step).copied();
        let mut subset: Vec<f32> = subset.filter(|s| is_data(*s)).collect();
        let Some(median) = upper_median(&mut subset) else {
            return Vec::new();
        };
        let mut deviations: Vec<f32> = subset.iter().map(|s| (s - median).abs()).collect();
        deviations.retain(|off| *off > 0.0);
        let Some(typical_deviation) = upper_quantile(&mut deviations, 0.99) else {
            return Vec::new();
        };
        let is_far = |s: f32, bound: f32| (s - median).abs() > bound && is_data(s);
        let range = |part: &[f32]| {
            part.iter()
                .fold(0.0, |max: f32, s| max.max((s - median).abs()))
        };
        let bound = OUTLIER_FACTOR * typical_deviation;
        if samples.par_chunks(4096).all(|part| range(part) <= bound) {
            return Vec::new();
        }
        let is_candidate = |i: &usize| is_far(samples[*i], bound);
        let candidates: Vec<usize> = (0..samples.len())
            .into_par_iter()
            .filter(is_candidate)
            .collect();
        if candidates.len() as f64 > MAX_OUTLIER_SHARE * samples.len() as f64 {
            return Vec::new();
        }
        // On a surface of such samples each sample has many others within a distance of two.
        let dims = self.dims();
        let max_neighbours = if D == 2 { 4 } else { 8 };
        let stands_alone = |i: usize| {
            let middle = index_at(dims, i);
            let is_outlier = |number: &usize| {
                let shift = index_at([5; D], *number);
                let index = std::array::from_fn(|k| (middle[k] + shift[k]).wrapping_sub(2));
                let inside = (0..D).all(|k| index[k] < dims[k]);
                inside && is_far(samples[offset_of(dims, index)], bound)
            };
            let outliers = (0..5usize.pow(D as u32)).filter(is_outlier);
            outliers.count() <= max_neighbours
        };
        let (single, clustered): (Vec<usize>, Vec<usize>) =
            candidates.into_iter().partition(|&i| stands_alone(i));
        let largest = clustered.iter().map(|&i| (samples[i] - median).abs());
        let bound = OUTLIER_FACTOR * largest.fold(typical_deviation, f32::max);
        let single = single.into_iter().filter(|&i| is_far(samples[i], bound));
        single.collect()
    }

    /// Returns the first sample of each trace that is zero throughout and not marked yet. The
    /// result is empty unless the image holds amplitudes, which are rarely exactly zero.
    fn zero_traces(&self, nulls: &[NullValue]) -> Vec<usize> {
        let (samples, vertical) = (self.as_slice(), self.vertical_axis());
        let (length, stride) = (self.dims()[vertical], strides(self.dims())[vertical]);
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
            let is_blank = (0..length).map(|i| start + i * stride).all(|i| {
                let zero = samples[i] == 0.0 && !is_marked(i);
                zeros += usize::from(zero);
                zero || samples[i] == 0.0 || is_null(samples[i])
            });
            is_blank && 2 * zeros > length
        };
        let traces: Vec<usize> = (0..lanes)
            .into_par_iter()
            .map(start)
            .filter(is_zero)
            .collect();
        if traces.is_empty() {
            return traces;
        }
        // Numbers of positive, negative and zero samples.
        let sign = |part: &[f32]| {
            part.iter()
                .fold([0usize; 3], |[positive, negative, zero], &s| {
                    let live = !is_null(s);
                    [
                        positive + usize::from(live && s > 0.0),
                        negative + usize::from(live && s < 0.0),
                        zero + usize::from(s == 0.0),
                    ]
                })
        };
        let add = |a: [usize; 3], b: [usize; 3]| std::array::from_fn(|k| a[k] + b[k]);
        let [positive, negative, zero] = samples.par_chunks(4096).map(sign).reduce(|| [0; 3], add);
        let marked = if self.dead.is_empty() {
            self.missing.iter().filter(|m| **m).count() * self.dims()[0]
        } else {
            self.dead.iter().filter(|m| **m).count()
        };
        let zero = zero.saturating_sub(traces.len() * length + marked) as f64;
        let values = (positive + negative) as f64;
        let has_both_signs = positive.min(negative) as f64 > 0.1 * values;
        if has_both_signs && zero < MAX_ZERO_SHARE * (zero + values) {
            traces
        } else {
            Vec::new()
        }
    }
}

/// A null value that occurs in an image.
struct NullValue {
    value: f32,
    count: usize,
}

/// Returns a null value as files have it: 1e30 rather than thirty zeros.
fn null_text(null: f32) -> String {
    if null.abs() >= CERTAIN_NULL_MAGNITUDE {
        format!("{null:e}")
    } else {
        null.to_string()
    }
}

/// Returns `true` if a sample holds a null value. A tolerance covers the rounding of IBM floats.
pub(crate) fn is_null(sample: f32, null: f32) -> bool {
    sample == null
        || (sample - null).abs() <= 1e-6 * null.abs() && null.fract() != 0.0
        || null.abs() >= CERTAIN_NULL_MAGNITUDE && (sample / null - 1.0).abs() <= 1e-5
}

/// Returns `true` if a sample holds a common null value.
pub(crate) fn may_be_null(sample: f32) -> bool {
    COMMON_NULLS.iter().any(|&null| is_null(sample, null))
}

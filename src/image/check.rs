//! Statistics of an image's samples, and checks whether it can be meshed.

use crate::parallel::prelude::*;

use super::labels::without_rounding_errors;
use super::{Image, Modality};
use crate::error::{Error, Result, cause};
use crate::geometry::grid_index::index_at;

/// Statistics of all samples of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Stats<const D: usize> {
    /// Smallest finite sample; positive infinity if there is none.
    pub min: f32,
    /// Largest finite sample; negative infinity if there is none.
    pub max: f32,
    /// Mean of the finite samples; 0 if there is none.
    pub mean: f64,
    /// Number of samples that are not a number.
    pub nan: usize,
    /// Number of infinite samples.
    pub infinite: usize,
    /// Index (x first) of the first sample that is not finite.
    pub first_non_finite: Option<[usize; D]>,
}

impl<const D: usize> Image<D> {
    /// Computes the statistics in one parallel pass. The result does not depend on the number of
    /// threads.
    pub fn stats(&self) -> Stats<D> {
        let mut tally = StatsAccumulator::default();
        tally.add(self.as_slice());
        tally.stats(self.dims())
    }

    /// Checks that the image can be processed: it has samples, and its finite samples are not all
    /// equal. `place` names the image in the error. Samples that are not finite count as samples
    /// without data.
    ///
    /// # Errors
    /// Returns an [`Error::Image`] if the image has no samples, no finite samples, or only equal
    /// ones.
    pub fn check(&self, place: &str) -> Result<()> {
        self.check_samples(place)?;
        let stats = self.stats();
        // Exact labels can differ although the rounded samples are equal.
        let labels = self.labels.as_ref();
        let differ = labels.is_some_and(|labels| labels.values.len() > 1);
        if stats.min == stats.max && !differ {
            return Err(Error::Image(cause(
                place,
                format!(
                    "has the value {} in all samples, so that it has no features",
                    stats.min
                ),
                "check that the right file or attribute was given, or give --feature none for a mesh of the plain box",
            )));
        }
        Ok(())
    }

    /// Checks that the image has finite samples, which may all be equal. `place` names the image in the
    /// error.
    ///
    /// # Errors
    /// Returns an [`Error::Image`] if the image has no samples or no finite samples.
    pub fn check_samples(&self, place: &str) -> Result<()> {
        let refuse =
            |problem: String, remedy: &str| Err(Error::Image(cause(place, problem, remedy)));
        if self.samples.is_empty() {
            let dims = self.dims();
            return refuse(
                format!("has no samples (dimensions {dims:?})"),
                "give an image with samples",
            );
        }
        let stats = self.stats();
        if stats.min > stats.max {
            let Stats { nan, infinite, .. } = stats;
            return refuse(
                format!(
                    "none of its {} samples is finite ({nan} NaN, {infinite} infinite)",
                    self.samples.len(),
                ),
                "check that the right file or attribute was given",
            );
        }
        Ok(())
    }
}

/// Evidence that the samples of an image are labels: there are few different values, and most
/// neighbours have the same value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LabelEvidence {
    /// Number of different values.
    pub value_count: usize,
    /// Share of pairs of neighbours along x whose values are equal.
    pub equal_share: f64,
}

impl<const D: usize> Image<D> {
    /// Returns evidence that the samples are labels, or `None` if they do not look like labels.
    ///
    /// Samples look like labels if they have at most `MAX_DETECTED_LABELS` different values and
    /// most neighbours are equal. Outside surveys, more different values are accepted, too, if they
    /// are whole numbers, most neighbours are equal, and the steps between values are not those of
    /// a smooth grey value.
    pub fn label_evidence(&self, modality: Modality) -> Option<LabelEvidence> {
        let samples = without_rounding_errors(self.as_slice());
        let samples = &*samples;
        if let Some(exact) = &self.labels {
            // Exact labels are integers of more than 24 bits, which no scanner produces. Most
            // neighbours must be equal nevertheless.
            let equal = exact.indices.windows(2).filter(|w| w[0] == w[1]).count();
            let equal = equal as f64 / (samples.len().max(2) - 1) as f64;
            return (equal > MIN_EQUAL_SHARE).then_some(LabelEvidence {
                value_count: exact.values.len(),
                equal_share: equal,
            });
        }
        if let Some(values) = distinct_values(samples, MAX_DETECTED_LABELS) {
            let equal = equal_neighbour_count(samples) as f64 / (samples.len().max(2) - 1) as f64;
            return (equal > 0.75).then_some(LabelEvidence {
                value_count: values.len(),
                equal_share: equal,
            });
        }
        if modality == Modality::Survey || !samples.par_chunks(CHUNK).all(are_whole_numbers) {
            return None;
        }
        let equal = equal_neighbour_count(samples) as f64 / (samples.len().max(2) - 1) as f64;
        if equal <= MIN_EQUAL_SHARE {
            return None;
        }
        let values = distinct_values(samples, samples.len() / MIN_SAMPLES_PER_LABEL)?;
        has_unordered_values(samples, &values).then_some(LabelEvidence {
            value_count: values.len(),
            equal_share: equal,
        })
    }
}

/// Smallest share of equal neighbours in an image of many labels.
pub const MIN_EQUAL_SHARE: f64 = 0.6;

/// Smallest mean number of samples per label.
const MIN_SAMPLES_PER_LABEL: usize = 8;

/// Returns `true` if whole numbers change as labels do. Outside the background (the most frequent
/// value) most neighbours must be equal, and most different neighbours must not be adjacent in the
/// sorted list of values, as they are where a grey value rises and falls smoothly.
fn has_unordered_values(samples: &[f32], values: &[f32]) -> bool {
    let rank = |s: f32| values.partition_point(|v| *v < s);
    let mut counts = vec![0usize; values.len()];
    let mut last = (f32::NAN, 0);
    for &s in samples {
        if s != last.0 {
            last = (s, rank(s));
        }
        if let Some(count) = counts.get_mut(last.1) {
            *count += 1;
        }
    }
    let max_count = counts.iter().max().copied().unwrap_or(0);
    let background = counts
        .iter()
        .position(|count| *count == max_count)
        .unwrap_or(0);
    let (mut equal, mut different, mut adjacent) = (0usize, 0usize, 0usize);
    let mut previous: Option<(f32, usize)> = None;
    for &s in samples {
        match previous {
            Some((value, rank)) if value == s => equal += usize::from(rank != background),
            _ => {
                let current_rank = rank(s);
                if let Some((_, previous_rank)) = previous {
                    different += 1;
                    adjacent += usize::from(previous_rank.abs_diff(current_rank) == 1);
                }
                previous = Some((s, current_rank));
            }
        }
    }
    let foreground = (equal + different).max(1) as f64;
    equal as f64 > 0.5 * foreground && 2 * adjacent < different.max(1)
}

/// Returns `true` if all samples are whole numbers.
pub fn are_whole_numbers(samples: &[f32]) -> bool {
    samples.iter().all(|s| s.trunc() == *s)
}

/// Returns the number of samples that equal the next sample in memory.
pub fn equal_neighbour_count(samples: &[f32]) -> usize {
    // Each chunk also compares its last sample with the first sample of the next chunk.
    let count = |chunk: usize| {
        let end = ((chunk + 1) * CHUNK + 1).min(samples.len());
        let part = &samples[chunk * CHUNK..end];
        part.windows(2).filter(|w| w[0] == w[1]).count()
    };
    (0..samples.len().div_ceil(CHUNK))
        .into_par_iter()
        .map(count)
        .sum()
}

/// Largest number of different values of an image that is taken as labels without the user saying
/// so.
pub const MAX_DETECTED_LABELS: usize = 64;

/// Returns the different values of the samples in ascending order, or `None` if there are more than
/// `max_count`.
pub fn distinct_values(samples: &[f32], max_count: usize) -> Option<Vec<f32>> {
    let mut values: Vec<f32> = Vec::new();
    for part in samples.chunks(CHUNK) {
        let mut last = f32::NAN;
        let mut new: Vec<f32> = Vec::new();
        for &s in part {
            if s != last {
                last = s;
                // -0 and 0 are the same label.
                let s = s + 0.0;
                if values.binary_search_by(|v| v.total_cmp(&s)).is_err() {
                    new.push(s);
                }
            }
        }
        if new.is_empty() {
            continue;
        }
        new.sort_by(f32::total_cmp);
        new.dedup();
        values.extend(new);
        if values.len() > max_count {
            return None;
        }
        values.sort_by(f32::total_cmp);
    }
    Some(values)
}

/// Number of samples that are summed together, so that sums do not depend on the number of threads.
const CHUNK: usize = 1 << 16;

/// Accumulator for the statistics of samples that arrive in parts, in memory order. The result does
/// not depend on how the samples are divided into parts.
#[derive(Default)]
pub(crate) struct StatsAccumulator {
    chunks: Vec<ChunkStats>,
    /// Samples of a chunk that is not complete yet.
    partial_chunk: Vec<f32>,
}

impl StatsAccumulator {
    /// Adds the next samples.
    pub fn add(&mut self, mut samples: &[f32]) {
        if !self.partial_chunk.is_empty() {
            let (first, rest) =
                samples.split_at((CHUNK - self.partial_chunk.len()).min(samples.len()));
            self.partial_chunk.extend_from_slice(first);
            samples = rest;
            if self.partial_chunk.len() == CHUNK {
                self.chunks
                    .push(ChunkStats::from_samples(&self.partial_chunk));
                self.partial_chunk.clear();
            }
        }
        let (chunks, rest) = samples.split_at(samples.len() - samples.len() % CHUNK);
        self.chunks
            .par_extend(chunks.par_chunks(CHUNK).map(ChunkStats::from_samples));
        self.partial_chunk.extend_from_slice(rest);
    }

    /// Returns the statistics of an image of dimensions `dims`, all of whose samples were added.
    pub fn stats<const D: usize>(mut self, dims: [usize; D]) -> Stats<D> {
        self.chunks
            .push(ChunkStats::from_samples(&self.partial_chunk));
        let parts = &self.chunks;
        let first_bad = parts
            .iter()
            .enumerate()
            .find_map(|(chunk, part)| Some(chunk * CHUNK + part.first_non_finite?))
            .map(|position| index_at(dims, position));
        let finite: usize = parts.iter().map(|part| part.finite_count).sum();
        let nan: usize = parts.iter().map(|part| part.nan_count).sum();
        let sum: f64 = parts.iter().map(|part| part.sum).sum();
        Stats {
            min: parts.iter().fold(f32::INFINITY, |m, part| m.min(part.min)),
            max: parts
                .iter()
                .fold(f32::NEG_INFINITY, |m, part| m.max(part.max)),
            mean: sum / finite.max(1) as f64,
            nan,
            infinite: parts.iter().map(|part| part.len).sum::<usize>() - finite - nan,
            first_non_finite: first_bad,
        }
    }
}

/// Statistics of one chunk of samples.
struct ChunkStats {
    len: usize,
    finite_count: usize,
    nan_count: usize,
    sum: f64,
    min: f32,
    max: f32,
    /// Position of the first sample that is not finite.
    first_non_finite: Option<usize>,
}

impl ChunkStats {
    fn from_samples(samples: &[f32]) -> Self {
        let mut part = Self {
            len: samples.len(),
            finite_count: 0,
            nan_count: 0,
            sum: 0.0,
            min: f32::INFINITY,
            max: f32::NEG_INFINITY,
            first_non_finite: samples.iter().position(|v| !v.is_finite()),
        };
        for &v in samples {
            let finite = v.is_finite();
            part.finite_count += usize::from(finite);
            part.nan_count += usize::from(v.is_nan());
            part.sum += if finite { f64::from(v) } else { 0.0 };
            part.min = part.min.min(if finite { v } else { f32::INFINITY });
            part.max = part.max.max(if finite { v } else { f32::NEG_INFINITY });
        }
        part
    }
}

#[cfg(test)]
mod tests {
    use crate::image::{Geometry, Image};

    fn ramp(dims: [usize; 3]) -> Image<3> {
        let n = dims.iter().product::<usize>();
        Image::new(
            dims,
            (0..n).map(|i| i as f32).collect(),
            Geometry::default(),
        )
    }

    #[test]
    fn statistics_of_a_ramp() {
        // The ramp fills more than one chunk, so that several chunks are combined.
        let image = ramp([70, 60, 50]);
        let n = 70.0 * 60.0 * 50.0;
        let stats = image.stats();
        assert_eq!((stats.min, stats.max), (0.0, n as f32 - 1.0));
        assert!((stats.mean - (n - 1.0) / 2.0).abs() < 1e-6);
        assert_eq!(
            (stats.nan, stats.infinite, stats.first_non_finite),
            (0, 0, None)
        );
        assert!(image.check("ramp").is_ok());
    }

    #[test]
    fn statistics_do_not_depend_on_the_division_into_parts() {
        let mut image = ramp([70, 60, 50]);
        image.samples[[40, 3, 2]] = f32::NAN;
        let expected = image.stats();
        for part in [1000, 70 * 60, (1 << 16) - 1, 1 << 16, (1 << 17) + 5] {
            let mut tally = super::StatsAccumulator::default();
            image
                .as_slice()
                .chunks(part)
                .for_each(|part| tally.add(part));
            assert_eq!(tally.stats(image.dims()), expected, "{part}");
        }
    }

    #[test]
    fn bad_samples_are_counted_and_the_first_is_named() {
        let mut image = ramp([70, 60, 50]);
        image.samples[[40, 3, 2]] = f32::NAN; // (z, y, x)
        image.samples[[45, 0, 0]] = f32::NEG_INFINITY;
        let stats = image.stats();
        assert_eq!((stats.nan, stats.infinite), (1, 1));
        assert_eq!(stats.first_non_finite, Some([2, 3, 40]));
        assert_eq!(stats.min, 0.0);
        assert!(image.check("ramp.npy").is_ok());
        image.samples.fill(f32::NAN);
        let error = image.check("ramp.npy").unwrap_err().to_string();
        assert!(error.starts_with("ramp.npy: none of its 210000"), "{error}");
    }

    #[test]
    fn empty_and_constant_images_are_refused() {
        let empty = Image::new([4, 0, 3], Vec::new(), Geometry::default());
        assert!(
            empty
                .check("e")
                .unwrap_err()
                .to_string()
                .contains("no samples")
        );
        let constant = Image::new([2, 2, 2], vec![7.0; 8], Geometry::default());
        assert!(
            constant
                .check("c")
                .unwrap_err()
                .to_string()
                .contains("the value 7")
        );
    }
}

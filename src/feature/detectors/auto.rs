//! Chooses the kind of features of an image from its values.
//!
//! The kinds are tried in this order:
//! - labels, if neighbours mostly share one of a few values, or one of many whole numbers without
//!   order
//! - b(x), if all values are in [-1, 0] and most are near 0
//! - ridges or valleys, if the rarer half of the values, the one farther from the median, lies in
//!   thin surfaces
//! - horizons, if values are spread symmetrically about zero
//! - edges otherwise
//!
//! Values are means over 3^D samples, which reduces noise, at about 10^5 places.
//!
//! The origin of the image ([`Modality`]) decides what values cannot. Two values, one of them thin,
//! are paint on faults in a survey, and an object elsewhere. A scan has no horizons, and more
//! likely solid objects than thin surfaces. If neither format nor geometry gives the origin, values
//! are amplitudes if their mean is near zero and they are not correlated over some samples along
//! some axis.
//!
//! Assumption: most of the rarer values belong to features. Faults, Canny's edges and paths are
//! never chosen: an amplitude volume has horizons as well, and the other two are alternatives to
//! edges.

use super::edges::Edges;
use super::horizons::Horizons;
use super::labels::Labels;
use super::masks::{Masks, ThinMask};
use super::potential::Potential;
use super::ridges::Ridges;
use super::{Brightness, Detector};
use crate::error::Result;
use crate::feature::detection::{first_non_finite, non_finite_error};
use crate::feature::volume::Volume;
use crate::feature::windows::{LayerWindow, Samples, layer_len};
use crate::feature::{Doubt, FeatureKind, SharedGrid};
use crate::files::codec::codec_fields;
use crate::geometry::grid_index::block_rows;
use crate::geometry::simd::dispatch_simd;
use crate::geometry::statistics::lower_quantile;
use crate::image::check::{
    MAX_DETECTED_LABELS, MIN_EQUAL_SHARE, are_whole_numbers, distinct_values, equal_neighbour_count,
};
use crate::image::nulls::may_be_null;
use crate::image::{Image, Modality};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use std::collections::BTreeSet;

/// Result of a choice for an image whose layers were read one after the other.
pub enum LayerChoice<const D: usize> {
    /// The detector that fits it.
    Chosen(DetectorChoice<D>),
    /// The image may have labels, which needs the whole image in memory to decide.
    NeedsMemory,
    /// Some samples may hold no data, so that the image must be searched in memory.
    HasGaps,
}

/// A detector that fits an image.
pub struct DetectorChoice<const D: usize> {
    /// The detector.
    pub detector: &'static dyn Detector<D>,
    /// Reason for the choice.
    pub reason: String,
    /// Question that the image leaves open.
    pub doubt: Option<Doubt>,
}

/// Chooses the detector that fits an image.
///
/// # Errors
/// Returns an [`Error::Image`](crate::Error::Image) if a sample is not finite.
pub fn choose<const D: usize>(
    image: &Image<D>,
    modality: Modality,
    grid: SharedGrid<'_, D>,
) -> Result<DetectorChoice<D>> {
    if let Some(labels) = image.label_evidence(modality) {
        let reason = format!(
            "{} different values, {:.0} % of neighbours equal",
            labels.value_count,
            100.0 * labels.equal_share
        );
        return Ok(choose_for_labels(image, modality, reason));
    }
    let samples = Samples::in_memory(image.dims(), image.as_slice()).with_grid(grid);
    let survey = ImageSurvey::measure(&samples, &CancelToken::never())?;
    match survey.first_non_finite {
        Some((at, value)) => Err(non_finite_error(at, value)),
        None => Ok(survey.choice(modality)),
    }
}

/// Chooses the detector for an image of labels. Two labels, one of which is thin everywhere, are
/// paint on faults in a survey, and an object in a scan.
fn choose_for_labels<const D: usize>(
    image: &Image<D>,
    modality: Modality,
    reason: String,
) -> DetectorChoice<D> {
    let samples = image.as_slice();
    let mask = match distinct_values(samples, 2).as_deref() {
        Some(&[a, b]) if modality != Modality::Scan => {
            let volume = Volume::new(image.dims(), samples);
            ThinMask::detect(volume, [a, b], &CancelToken::never())
        }
        _ => None,
    };
    match mask {
        Some(_) if modality == Modality::Survey => DetectorChoice {
            detector: &Masks,
            reason,
            doubt: None,
        },
        Some(mask) => DetectorChoice {
            detector: &Labels,
            reason,
            doubt: Some(Doubt {
                question: format!(
                    "objects of the value {} are {:.1} samples thick and were taken for regions, but may be \
                     paint on faults",
                    mask.value, mask.thickness
                ),
                assumed: FeatureKind::Labels,
                other: FeatureKind::Mask,
            }),
        },
        None => DetectorChoice {
            detector: &Labels,
            reason,
            doubt: None,
        },
    }
}

/// Chooses the detector that fits an image whose layers are read one after the other.
///
/// # Errors
/// Returns the errors of reading.
pub fn choose_in_layers<const D: usize>(
    samples: &Samples<'_, D>,
    modality: Modality,
    cancel: &CancelToken<'_>,
) -> Result<LayerChoice<D>> {
    let survey = ImageSurvey::measure(samples, cancel)?;
    let may_be_labels = modality != Modality::Survey && survey.may_be_labelled;
    Ok(if survey.has_gaps() {
        LayerChoice::HasGaps
    } else if survey.has_many_values && !may_be_labels {
        LayerChoice::Chosen(survey.choice(modality))
    } else {
        LayerChoice::NeedsMemory
    })
}

/// Statistics of an image, measured in one pass.
struct ImageSurvey<const D: usize> {
    percentiles: Percentiles,
    min: f32,
    max: f32,
    /// `true` if the image has more different values than an image of labels.
    has_many_values: bool,
    /// Coordinates and value of the first sample that is not finite.
    first_non_finite: Option<([usize; D], f32)>,
    /// `true` if a row along x is zero throughout.
    has_zero_row: bool,
    /// `true` if samples are whole numbers that neighbours mostly share, as in an image of many
    /// labels.
    may_be_labelled: bool,
}

impl<const D: usize> ImageSurvey<D> {
    fn measure(samples: &Samples<'_, D>, cancel: &CancelToken<'_>) -> Result<Self> {
        let mut total = WindowSurvey {
            range: EMPTY_RANGE,
            distinct_values: Vec::new(),
            first_non_finite: None,
            has_zero_row: false,
            local_means: LocalMeans::default(),
            is_integer: true,
            equal_pairs: 0,
            pair_count: 0,
        };
        let mut measure = |window: &LayerWindow<'_, D>| WindowSurvey::measure(window);
        let mut take = |next: WindowSurvey<D>| total.merge(next);
        samples.for_each_window(
            THIN_DISTANCE + 1,
            None,
            &|_| 1,
            cancel,
            &mut measure,
            &mut take,
        )?;
        let [min, max] = total.range;
        Ok(Self {
            percentiles: total.local_means.percentiles(),
            min,
            max,
            has_many_values: total.distinct_values.len() > MAX_DETECTED_LABELS,
            first_non_finite: total.first_non_finite,
            has_zero_row: total.has_zero_row,
            may_be_labelled: total.is_integer
                && total.equal_pairs as f64 > MIN_EQUAL_SHARE * total.pair_count as f64,
        })
    }

    /// Returns `true` if samples may hold no data; the image in memory gives the exact answer.
    fn has_gaps(&self) -> bool {
        let has_both_signs = self.min < 0.0 && self.max > 0.0;
        let has_null = [self.min, self.max].into_iter().any(may_be_null);
        self.first_non_finite.is_some() || has_null || self.has_zero_row && has_both_signs
    }

    fn choice(&self, modality: Modality) -> DetectorChoice<D> {
        let Self {
            percentiles,
            min,
            max,
            ..
        } = self;
        let span = (percentiles.high - percentiles.low).max(f32::MIN_POSITIVE);
        // Asymmetry: how much farther the high values are from the median than the low ones.
        let skew = (percentiles.high + percentiles.low - 2.0 * percentiles.median) / span;
        let figures = format!(
            "1 %, 50 % and 99 % of the values lie below {:.4}, {:.4} and {:.4}; {:.0} % are in the upper half of \
             that range; objects of the rarer half are thin in {:.0} % of their samples",
            percentiles.low,
            percentiles.median,
            percentiles.high,
            100.0 * percentiles.share_above,
            100.0 * percentiles.thin_share,
        );
        let is_scan = modality == Modality::Scan;
        let are_amplitudes = !is_scan && (modality == Modality::Survey || percentiles.alternates());
        let mut doubt = None;
        let mut or_edges = |detector: &'static dyn Detector<D>, other, finding: &'static str| {
            if !is_scan {
                return (detector, finding);
            }
            doubt = Some(Doubt {
                question: format!("{finding} in a scan, of which the edges were followed"),
                assumed: FeatureKind::Edges,
                other,
            });
            (&Edges as &dyn Detector<D>, "a scan")
        };
        let (detector, finding): (&'static dyn Detector<D>, _) =
            if (-1.0..-0.9).contains(min) && *max <= 0.0 && percentiles.median > -0.1 {
                (&Potential, "all values in [-1, 0], most near 0")
            } else if skew > 0.3
                && percentiles.share_above < 0.4
                && percentiles.thin_share > MIN_THIN_SHARE
            {
                or_edges(
                    &Ridges(Brightness::Bright),
                    FeatureKind::Ridges,
                    "thin surfaces of high values on a low background",
                )
            } else if skew < -0.3
                && percentiles.share_above > 0.6
                && percentiles.thin_share > MIN_THIN_SHARE
            {
                or_edges(
                    &Ridges(Brightness::Dark),
                    FeatureKind::Valleys,
                    "thin surfaces of low values on a high background",
                )
            } else if are_amplitudes
                && skew.abs() < 0.35
                && percentiles.median.abs() < 0.15 * span
                && percentiles.low < 0.0
            {
                (&Horizons, "values are spread symmetrically about zero")
            } else {
                (&Edges, "neither thin surfaces nor values about zero")
            };
        DetectorChoice {
            detector,
            reason: format!("{finding}: {figures}"),
            doubt,
        }
    }
}

/// Smallest share of the rarer values that lies in something thin, if they are thin surfaces. It is
/// less than a half, because surfaces that run close together are not thin.
const MIN_THIN_SHARE: f64 = 0.33;

/// Number of samples that are processed together.
const CHUNK_SAMPLES: usize = 4096;
/// Number of samples in vector registers.
const LANES: usize = 32;

/// Distance (samples) along some axis at which samples on either side of a thin surface are outside
/// it.
const THIN_DISTANCE: usize = 6;

/// Percentiles and moments of local means, which reduce noise.
struct Percentiles {
    low: f32,
    median: f32,
    high: f32,
    /// Share of the values above the middle between `low` and `high`.
    share_above: f64,
    /// Share of the values on the rarer side of the middle that lie in something thin.
    thin_share: f64,
    /// Mean of all values, in standard deviations.
    mean: f64,
    /// Correlation of values at a distance of [`THIN_DISTANCE`] samples, along the axis on which it
    /// is lowest.
    correlation: f64,
}

impl Percentiles {
    /// Returns `true` if values alternate about zero, as seismic amplitudes do and densities do
    /// not.
    fn alternates(&self) -> bool {
        self.mean.abs() < 0.2 && self.correlation < 0.7
    }
}

/// Local means at some places of an image.
#[derive(Default)]
struct LocalMeans<const D: usize> {
    means: Vec<f32>,
    /// For each place, the local means [`THIN_DISTANCE`] samples to either side along each axis.
    adjacent: Vec<[[f32; 2]; D]>,
}

codec_fields! {
    @(const D: usize) LocalMeans<D> as LocalMeans { means, adjacent }
    @(const D: usize) WindowSurvey<D> as WindowSurvey { range, distinct_values, first_non_finite, has_zero_row, local_means, is_integer, equal_pairs, pair_count }
}

/// Statistics of a window, or of all windows so far.
struct WindowSurvey<const D: usize> {
    /// Smallest and largest value.
    range: [f32; 2],
    /// Different values, as bits in ascending order, at most one more than [`MAX_DETECTED_LABELS`].
    distinct_values: Vec<u32>,
    /// Coordinates and value of the first sample that is not finite.
    first_non_finite: Option<([usize; D], f32)>,
    /// `true` if a row along x is zero throughout.
    has_zero_row: bool,
    local_means: LocalMeans<D>,
    /// `true` if all samples are whole numbers.
    is_integer: bool,
    /// Number of pairs of neighbours along x that are equal, and number of all such pairs.
    equal_pairs: usize,
    pair_count: usize,
}

impl<const D: usize> WindowSurvey<D> {
    fn measure(window: &LayerWindow<'_, D>) -> Self {
        let interior = window.raw.layers(&window.interior.layers);
        let mut distinct = BTreeSet::new();
        for part in interior.chunks(CHUNK_SAMPLES) {
            if distinct.len() > MAX_DETECTED_LABELS {
                break;
            }
            // Adding 0 turns -0 into 0.
            distinct.extend(part.iter().map(|v| (v + 0.0).to_bits()));
        }
        let is_integer = interior.par_chunks(CHUNK_SAMPLES).all(are_whole_numbers);
        let equal_pairs = if is_integer {
            equal_neighbour_count(interior)
        } else {
            0
        };
        let parts = interior.par_chunks(CHUNK_SAMPLES).map(range);
        let union = |[a, b]: [f32; 2], [c, d]: [f32; 2]| [a.min(c), b.max(d)];
        let locate = |i| {
            let mut at = Volume::new(window.dims, &[]).coordinates(i);
            at[D - 1] += window.interior.layers.start;
            (at, interior[i])
        };
        Self {
            range: parts.reduce(|| EMPTY_RANGE, union),
            distinct_values: distinct.into_iter().take(MAX_DETECTED_LABELS + 1).collect(),
            first_non_finite: first_non_finite(interior).map(locate),
            has_zero_row: interior
                .chunks(window.dims[0].max(1))
                .any(|row| row.iter().all(|s| *s == 0.0)),
            local_means: LocalMeans::measure(window),
            is_integer,
            equal_pairs,
            pair_count: interior.len().saturating_sub(1),
        }
    }

    /// Adds the statistics of the next window.
    fn merge(&mut self, next: Self) {
        self.range = [
            self.range[0].min(next.range[0]),
            self.range[1].max(next.range[1]),
        ];
        self.distinct_values.extend(next.distinct_values);
        self.distinct_values.sort_unstable();
        self.distinct_values.dedup();
        self.distinct_values.truncate(MAX_DETECTED_LABELS + 1);
        self.first_non_finite = self.first_non_finite.or(next.first_non_finite);
        self.has_zero_row |= next.has_zero_row;
        self.is_integer &= next.is_integer;
        self.equal_pairs += next.equal_pairs;
        self.pair_count += next.pair_count;
        self.local_means.means.extend(next.local_means.means);
        self.local_means.adjacent.extend(next.local_means.adjacent);
    }
}

/// Range of an empty set of values.
const EMPTY_RANGE: [f32; 2] = [f32::MAX, f32::MIN];

/// Returns the smallest and the largest of finite values.
fn range(values: &[f32]) -> [f32; 2] {
    let [mut min, mut max] = EMPTY_RANGE.map(|v| [v; LANES]);
    dispatch_simd(
        #[inline(always)]
        || {
            let (chunks, remainder) = values.as_chunks::<LANES>();
            let remainder = remainder.iter().map(|&v| [v; LANES]);
            for values in chunks.iter().copied().chain(remainder) {
                for l in 0..LANES {
                    min[l] = if values[l] < min[l] {
                        values[l]
                    } else {
                        min[l]
                    };
                    max[l] = if values[l] > max[l] {
                        values[l]
                    } else {
                        max[l]
                    };
                }
            }
        },
    );
    let fold = |all: [f32; LANES], best: fn(f32, f32) -> f32| all.into_iter().fold(all[0], best);
    [fold(min, f32::min), fold(max, f32::max)]
}

impl<const D: usize> LocalMeans<D> {
    /// Measures the means in the interior of a window; in the whole image there are about 10^5 of
    /// them.
    fn measure(window: &LayerWindow<'_, D>) -> Self {
        let count: usize = window.dims.iter().product();
        let stride = (count / 100_000).max(1) | 1;
        let volume = window.raw.volume;
        let (image_volume, layer) = (Volume::new(window.dims, &[]), layer_len(window.dims));
        let first = (window.interior.layers.start * layer).next_multiple_of(stride);
        let places: Vec<usize> = (first..window.interior.layers.end * layer)
            .step_by(stride)
            .collect();
        let measure = |i| {
            let at = window.raw.to_stack(image_volume.coordinates(i));
            let adjacent = std::array::from_fn(|k| {
                let (mut before, mut after) = (at, at);
                before[k] = at[k].saturating_sub(THIN_DISTANCE);
                after[k] = (at[k] + THIN_DISTANCE).min(volume.dims[k] - 1);
                [before, after].map(|at| local_mean(volume, at))
            });
            (local_mean(volume, at), adjacent)
        };
        let (means, adjacent) = places.into_par_iter().map(measure).unzip();
        Self { means, adjacent }
    }

    fn percentiles(self) -> Percentiles {
        let means = self.means;
        let mut sorted = means.clone();
        let [low, median, high] =
            [0.01, 0.5, 0.99].map(|share| lower_quantile(&mut sorted, share).unwrap_or(0.0));
        let middle = 0.5 * (low + high);
        let above = means.iter().filter(|m| **m > middle).count() as f64 / means.len() as f64;
        let is_upper_rarer = above < 0.5;
        let count = means.len().max(1) as f64;
        let mean = means.iter().map(|&m| f64::from(m)).sum::<f64>() / count;
        let square = |m: f32| (f64::from(m) - mean).powi(2);
        let variance = means.iter().map(|&m| square(m)).sum::<f64>() / count;
        let deviation = variance.sqrt().max(f64::MIN_POSITIVE);
        let product = |k: usize| {
            let product_at = |(m, adjacent): (&f32, &[[f32; 2]; D])| {
                let [before, after] = adjacent[k].map(|b| f64::from(b) - mean);
                0.5 * (f64::from(*m) - mean) * (before + after)
            };
            means
                .iter()
                .zip(&self.adjacent)
                .map(product_at)
                .sum::<f64>()
                / count
        };
        let min_product = (0..D).map(product).fold(f64::INFINITY, f64::min);
        let correlation = min_product / variance.max(f64::MIN_POSITIVE);
        let (mut inside, mut thin) = (0usize, 0usize);
        let rarer = means.iter().zip(&self.adjacent);
        for (_, adjacent) in rarer.filter(|(m, _)| (**m > middle) == is_upper_rarer) {
            inside += 1;
            let are_outside =
                |pair: &[f32; 2]| pair.iter().all(|&m| (m > middle) != is_upper_rarer);
            thin += usize::from(adjacent.iter().any(are_outside));
        }
        Percentiles {
            low,
            median,
            high,
            share_above: above,
            thin_share: thin as f64 / inside.max(1) as f64,
            mean: mean / deviation,
            correlation,
        }
    }
}

/// Returns the mean over a sample and the samples that touch it.
fn local_mean<const D: usize>(volume: Volume<'_, D>, at: [usize; D]) -> f32 {
    let low = at.map(|i| i.saturating_sub(1));
    let span: [usize; D] =
        std::array::from_fn(|k| (at[k] + 1).min(volume.dims[k] - 1) + 1 - low[k]);
    let mut sum = 0.0;
    for start in block_rows(volume.dims, low, span) {
        sum += volume.samples[start..start + span[0]].iter().sum::<f32>();
    }
    sum / span.iter().product::<usize>() as f32
}

#[cfg(test)]
mod tests {
    use crate::feature::scenes::{Noise, crossing_surfaces, image_of, ridge_image};
    use crate::feature::{DetectionOptions, FeatureKind, detect};
    use crate::image::Image;

    #[test]
    fn auto_distinguishes_ridges_and_edges() {
        let (dims, surfaces) = crossing_surfaces();
        let note = |image: &Image<3>| {
            detect(image, &DetectionOptions::with_kind(FeatureKind::Auto, 8.0))
                .unwrap()
                .notes[0]
                .clone()
        };
        let ridges = note(&ridge_image(dims, &surfaces, 1.5, 0.25));
        assert!(ridges.contains("features: ridges"), "{ridges}");
        let mut noise = Noise::new(9);
        let blob = image_of([48, 48, 48], |p| {
            let r = (0..3).map(|k| (p[k] - 24.0).powi(2)).sum::<f64>().sqrt();
            80.0 + 60.0 * f64::from(u8::from(r < 18.0)) + 4.0 * noise.normal()
        });
        let edges = note(&blob);
        assert!(edges.contains("features: edges"), "{edges}");
    }

    #[test]
    fn range_finds_the_smallest_and_largest_value_anywhere() {
        for place in [0, 31, 32, 63, 64, 69] {
            let values: Vec<f32> = (0..70)
                .map(|i| if i == place { -3.0 } else { -1.0 })
                .collect();
            assert_eq!(super::range(&values), [-3.0, -1.0]);
            let other: Vec<f32> = values.iter().map(|v| -v).collect();
            assert_eq!(super::range(&other), [1.0, 3.0]);
        }
        assert_eq!(super::range(&[]), super::EMPTY_RANGE);
    }

    #[test]
    fn a_threshold_is_refused_where_auto_chooses_labels() {
        let image = image_of([32, 32, 32], |p| f64::from(u8::from(p[0] < 16.0)));
        let options_with = |threshold| DetectionOptions {
            threshold,
            ..DetectionOptions::with_kind(FeatureKind::Auto, 8.0)
        };
        let features = detect(&image, &options_with(None)).unwrap();
        assert!(features.notes[0].contains("labels"), "{:?}", features.notes);
        let error = detect(&image, &options_with(Some(0.5))).unwrap_err();
        let message = error.to_string();
        for word in ["threshold 0.5", "labels", "2 different values", "omit it"] {
            assert!(message.contains(word), "no '{word}' in: {message}");
        }
    }
}

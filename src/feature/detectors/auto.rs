//! What kind of features an image has, judged by its values.
//!
//! In this order: labels where neighbours mostly share one of a few values, or one of many whole numbers
//! without order; b(x) where all
//! values are in [-1, 0] and most near 0; ridges or valleys where the rarer half of the values, that
//! farther from the median, lies in thin sheets; horizons where values are spread symmetrically about zero; edges
//! otherwise. Values are means over 3^D samples, which noise disturbs little, of some 10^5 places.
//!
//! Where the image comes from ([`Modality`]) decides what values cannot: two values, one of them thin, are paint on faults in
//! a survey, and an object elsewhere; a scan has no horizons, and solid objects sooner than sheets. Where neither format nor
//! geometry tells, amplitudes are what has no mean and does not go on along some axis.
//!
//! Assumption: the features are what most of the rarer values belong to. Faults, Canny's edges and paths
//! are never chosen: an amplitude volume has horizons as well, and the others are other ways to edges.

use super::Detector;
use super::edges::Edges;
use super::horizons::Horizons;
use super::labels::Labels;
use super::masks::{Masks, ThinMask};
use super::potential::Potential;
use super::ridges::{Ridges, Valleys};
use crate::error::Result;
use crate::feature::detection::{first_non_finite, non_finite_error};
use crate::feature::volume::Volume;
use crate::feature::windows::{LayerWindow, Samples, layer_len};
use crate::feature::{Doubt, FeatureKind};
use crate::files::codec::codec_fields;
use crate::geometry::simd::dispatch_simd;
use crate::image::check::{
    MAX_DETECTED_LABELS, MIN_EQUAL_SHARE, are_whole_numbers, distinct_values, equal_neighbour_count,
};
use crate::image::nulls::may_be_null;
use crate::image::{Image, Modality};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use std::collections::BTreeSet;

/// What is known of an image whose layers were read one after the other.
pub enum LayerChoice<const D: usize> {
    /// The detector that fits it.
    Chosen(DetectorChoice<D>),
    /// It may be one of labels, which only the whole image in memory tells.
    NeedsMemory,
    /// Some samples may hold no data, so that it is searched in memory.
    HasGaps,
}

/// A detector that fits an image.
pub struct DetectorChoice<const D: usize> {
    /// The detector.
    pub detector: &'static dyn Detector<D>,
    /// Why it fits.
    pub reason: String,
    /// What the image leaves open.
    pub doubt: Option<Doubt>,
}

/// Chooses the detector that fits an image.
///
/// # Errors
/// [`Error::Image`](crate::Error::Image) for samples that are not finite.
pub fn choose<const D: usize>(image: &Image<D>, modality: Modality) -> Result<DetectorChoice<D>> {
    if let Some(labels) = image.label_evidence(modality) {
        let why = format!(
            "{} different values, {:.0} % of neighbours equal",
            labels.value_count,
            100.0 * labels.equal_share
        );
        return Ok(choose_for_labels(image, modality, why));
    }
    let samples = Samples::in_memory(image.dims(), image.as_slice());
    let survey = ImageSurvey::measure(&samples, &CancelToken::never())?;
    match survey.first_non_finite {
        Some((at, value)) => Err(non_finite_error(at, value)),
        None => Ok(survey.choice(modality)),
    }
}

/// Chooses what to follow in an image of labels. Two of them, one of which is thin everywhere, are paint on
/// faults in a survey, and an object in a scan.
fn choose_for_labels<const D: usize>(
    image: &Image<D>,
    modality: Modality,
    why: String,
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
            reason: why,
            doubt: None,
        },
        Some(mask) => DetectorChoice {
            detector: &Labels,
            reason: why,
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
            reason: why,
            doubt: None,
        },
    }
}

/// Returns the detector that fits an image whose layers are read one after the other.
///
/// # Errors
/// That of reading.
pub fn choose_in_layers<const D: usize>(
    samples: &Samples<'_, D>,
    modality: Modality,
    patience: &CancelToken<'_>,
) -> Result<LayerChoice<D>> {
    let survey = ImageSurvey::measure(samples, patience)?;
    let labelled = modality != Modality::Survey && survey.may_be_labelled;
    Ok(match survey.has_many_values && !labelled {
        _ if survey.has_gaps() => LayerChoice::HasGaps,
        true => LayerChoice::Chosen(survey.choice(modality)),
        false => LayerChoice::NeedsMemory,
    })
}

/// What is seen of an image on one way through it.
struct ImageSurvey<const D: usize> {
    percentiles: Percentiles,
    min: f32,
    max: f32,
    /// Whether it has more different values than an image of labels.
    has_many_values: bool,
    /// The first sample that is not finite, and its value.
    first_non_finite: Option<([usize; D], f32)>,
    /// Whether a row along x is zero throughout.
    has_zero_row: bool,
    /// Whether samples are integers that neighbours mostly share, as in an image of many labels.
    may_be_labelled: bool,
}

impl<const D: usize> ImageSurvey<D> {
    fn measure(samples: &Samples<'_, D>, patience: &CancelToken<'_>) -> Result<Self> {
        let mut all = WindowSurvey {
            range: EMPTY_RANGE,
            distinct_values: Vec::new(),
            first_non_finite: None,
            has_zero_row: false,
            local_means: LocalMeans::default(),
            is_integer: true,
            equal_pairs: 0,
            pair_count: 0,
        };
        let mut look = |window: &LayerWindow<'_, D>| WindowSurvey::measure(window);
        let mut take = |seen: WindowSurvey<D>| all.merge(seen);
        samples.for_each_window(
            THIN_DISTANCE + 1,
            None,
            &|_| 1,
            patience,
            &mut look,
            &mut take,
        )?;
        let [least, most] = all.range;
        Ok(Self {
            percentiles: all.local_means.percentiles(),
            min: least,
            max: most,
            has_many_values: all.distinct_values.len() > MAX_DETECTED_LABELS,
            first_non_finite: all.first_non_finite,
            has_zero_row: all.has_zero_row,
            may_be_labelled: all.is_integer
                && all.equal_pairs as f64 > MIN_EQUAL_SHARE * all.pair_count as f64,
        })
    }

    /// Returns whether samples may hold no data: an image in memory tells.
    fn has_gaps(&self) -> bool {
        let amplitudes = self.min < 0.0 && self.max > 0.0;
        let null = [self.min, self.max].into_iter().any(may_be_null);
        self.first_non_finite.is_some() || null || self.has_zero_row && amplitudes
    }

    fn choice(&self, modality: Modality) -> DetectorChoice<D> {
        let Self {
            percentiles: spread,
            min: least,
            max: most,
            ..
        } = self;
        let span = (spread.high - spread.low).max(f32::MIN_POSITIVE);
        // Far ends: how much farther the high values lie from the median than the low ones.
        let lean = (spread.high + spread.low - 2.0 * spread.median) / span;
        let figures = format!(
            "1 %, 50 % and 99 % of values at {:.4}, {:.4}, {:.4}; {:.0} % in the upper \
             half, {:.0} % of the rarer half thin",
            spread.low,
            spread.median,
            spread.high,
            100.0 * spread.share_above,
            100.0 * spread.thin_share,
        );
        let scan = modality == Modality::Scan;
        let amplitudes = !scan && (modality == Modality::Survey || spread.alternates());
        let mut doubt = None;
        let mut or_edges = |detector: &'static dyn Detector<D>, other, what: &'static str| {
            if !scan {
                return (detector, what);
            }
            doubt = Some(Doubt {
                question: format!("{what} in a scan, of which the edges were followed"),
                assumed: FeatureKind::Edges,
                other,
            });
            (&Edges as &dyn Detector<D>, "a scan")
        };
        let (detector, what): (&'static dyn Detector<D>, _) =
            if (-1.0..-0.9).contains(least) && *most <= 0.0 && spread.median > -0.1 {
                (&Potential, "all values in [-1, 0], most near 0")
            } else if lean > 0.3 && spread.share_above < 0.4 && spread.thin_share > MIN_THIN_SHARE {
                or_edges(
                    &Ridges,
                    FeatureKind::Ridges,
                    "thin sheets of high values on a low background",
                )
            } else if lean < -0.3 && spread.share_above > 0.6 && spread.thin_share > MIN_THIN_SHARE
            {
                or_edges(
                    &Valleys,
                    FeatureKind::Valleys,
                    "thin sheets of low values on a high background",
                )
            } else if amplitudes
                && lean.abs() < 0.35
                && spread.median.abs() < 0.15 * span
                && spread.low < 0.0
            {
                (&Horizons, "values are spread symmetrically about zero")
            } else {
                (&Edges, "neither thin sheets nor values about zero")
            };
        DetectorChoice {
            detector,
            reason: format!("{what}: {figures}"),
            doubt,
        }
    }
}

/// The rarer values are thin sheets if at least this share of them lies in something thin: less than
/// half of it does where sheets run close together.
const MIN_THIN_SHARE: f64 = 0.33;

/// Samples looked at together ...
const CHUNK_SAMPLES: usize = 4096;
/// ... and at once.
const LANES: usize = 32;

/// Samples to either side of a thin sheet that are outside it, this far along some axis.
const THIN_DISTANCE: usize = 6;

/// Percentiles of local means, which noise disturbs little.
struct Percentiles {
    low: f32,
    median: f32,
    high: f32,
    /// Share of values above the middle between `low` and `high`.
    share_above: f64,
    /// Share of the values on the rarer side of the middle that lie in something thin.
    thin_share: f64,
    /// The mean of all, in standard deviations.
    mean: f64,
    /// Correlation of values with those [`THIN_DISTANCE`] samples beside them along the axis on which it is least.
    correlation: f64,
}

impl Percentiles {
    /// Returns whether values alternate about zero, as seismic amplitudes do and densities do not.
    fn alternates(&self) -> bool {
        self.mean.abs() < 0.2 && self.correlation < 0.7
    }
}

/// Means at some places of an image.
#[derive(Default)]
struct LocalMeans<const D: usize> {
    means: Vec<f32>,
    /// Those of the places [`THIN_DISTANCE`] samples to either side along each axis.
    adjacent: Vec<[[f32; 2]; D]>,
}

codec_fields! {
    @(const D: usize) LocalMeans<D> as LocalMeans { means, adjacent }
    @(const D: usize) WindowSurvey<D> as WindowSurvey { range, distinct_values, first_non_finite, has_zero_row, local_means, is_integer, equal_pairs, pair_count }
}

/// What is seen of a window, or of all.
struct WindowSurvey<const D: usize> {
    /// The least and the largest value.
    range: [f32; 2],
    /// Some different values, as bits, ascending: more than [`MAX_DETECTED_LABELS`] only if there are more.
    distinct_values: Vec<u32>,
    /// The first sample that is not finite, and its value.
    first_non_finite: Option<([usize; D], f32)>,
    /// Whether a row along x is zero throughout.
    has_zero_row: bool,
    local_means: LocalMeans<D>,
    /// Whether all samples are whole numbers.
    is_integer: bool,
    /// Pairs of neighbours along x that are equal, and all such pairs.
    equal_pairs: usize,
    pair_count: usize,
}

impl<const D: usize> WindowSurvey<D> {
    fn measure(window: &LayerWindow<'_, D>) -> Self {
        let own = window.raw.layers(&window.interior.layers);
        let mut some = BTreeSet::new();
        for part in own.chunks(CHUNK_SAMPLES) {
            if some.len() > MAX_DETECTED_LABELS {
                break;
            }
            // -0 is 0.
            some.extend(part.iter().map(|v| (v + 0.0).to_bits()));
        }
        let is_integer = own.par_chunks(CHUNK_SAMPLES).all(are_whole_numbers);
        let equal_pairs = if is_integer {
            equal_neighbour_count(own)
        } else {
            0
        };
        let parts = own.par_chunks(CHUNK_SAMPLES).map(range);
        let of_both = |[a, b]: [f32; 2], [c, d]: [f32; 2]| [a.min(c), b.max(d)];
        let place = |i| {
            let mut at = Volume::new(window.dims, &[]).coordinates(i);
            at[D - 1] += window.interior.layers.start;
            (at, own[i])
        };
        Self {
            range: parts.reduce(|| EMPTY_RANGE, of_both),
            distinct_values: some.into_iter().take(MAX_DETECTED_LABELS + 1).collect(),
            first_non_finite: first_non_finite(own).map(place),
            has_zero_row: own
                .chunks(window.dims[0].max(1))
                .any(|row| row.iter().all(|s| *s == 0.0)),
            local_means: LocalMeans::measure(window),
            is_integer,
            equal_pairs,
            pair_count: own.len().saturating_sub(1),
        }
    }

    /// Adds those of the next window.
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

/// The range of no values.
const EMPTY_RANGE: [f32; 2] = [f32::MAX, f32::MIN];

/// Of values that are finite, the least and the largest.
fn range(values: &[f32]) -> [f32; 2] {
    let [mut least, mut most] = EMPTY_RANGE.map(|v| [v; LANES]);
    dispatch_simd(
        #[inline(always)]
        || {
            let (many, few) = values.as_chunks::<LANES>();
            let few = few.iter().map(|&v| [v; LANES]);
            for values in many.iter().copied().chain(few) {
                for l in 0..LANES {
                    least[l] = if values[l] < least[l] {
                        values[l]
                    } else {
                        least[l]
                    };
                    most[l] = if values[l] > most[l] {
                        values[l]
                    } else {
                        most[l]
                    };
                }
            }
        },
    );
    let fold = |all: [f32; LANES], best: fn(f32, f32) -> f32| all.into_iter().fold(all[0], best);
    [fold(least, f32::min), fold(most, f32::max)]
}

impl<const D: usize> LocalMeans<D> {
    /// A window's own places, of some 10^5 in all.
    fn measure(window: &LayerWindow<'_, D>) -> Self {
        let count: usize = window.dims.iter().product();
        let stride = (count / 100_000).max(1) | 1;
        let volume = window.raw.volume;
        let (whole, layer) = (Volume::new(window.dims, &[]), layer_len(window.dims));
        let first = (window.interior.layers.start * layer).next_multiple_of(stride);
        let places: Vec<usize> = (first..window.interior.layers.end * layer)
            .step_by(stride)
            .collect();
        let look = |i| {
            let at = window.raw.to_stack(whole.coordinates(i));
            let beside = std::array::from_fn(|k| {
                let (mut before, mut after) = (at, at);
                before[k] = at[k].saturating_sub(THIN_DISTANCE);
                after[k] = (at[k] + THIN_DISTANCE).min(volume.dims[k] - 1);
                [before, after].map(|at| local_mean(volume, at))
            });
            (local_mean(volume, at), beside)
        };
        let (means, adjacent) = places.into_par_iter().map(look).unzip();
        Self { means, adjacent }
    }

    fn percentiles(self) -> Percentiles {
        let means = self.means;
        let mut sorted = means.clone();
        sorted.sort_by(f32::total_cmp);
        let at = |share: f64| {
            let rank = (sorted.len().saturating_sub(1) as f64 * share) as usize;
            sorted.get(rank).copied().unwrap_or(0.0)
        };
        let (low, median, high) = (at(0.01), at(0.5), at(0.99));
        let middle = 0.5 * (low + high);
        let above = means.iter().filter(|m| **m > middle).count() as f64 / means.len() as f64;
        let rare = above < 0.5;
        let count = means.len().max(1) as f64;
        let mean = means.iter().map(|&m| f64::from(m)).sum::<f64>() / count;
        let square = |m: f32| (f64::from(m) - mean).powi(2);
        let variance = means.iter().map(|&m| square(m)).sum::<f64>() / count;
        let deviation = variance.sqrt().max(f64::MIN_POSITIVE);
        let product = |k: usize| {
            let of_place = |(m, beside): (&f32, &[[f32; 2]; D])| {
                let [before, after] = beside[k].map(|b| f64::from(b) - mean);
                0.5 * (f64::from(*m) - mean) * (before + after)
            };
            means.iter().zip(&self.adjacent).map(of_place).sum::<f64>() / count
        };
        let least = (0..D).map(product).fold(f64::INFINITY, f64::min);
        let correlation = least / variance.max(f64::MIN_POSITIVE);
        let (mut inside, mut thin) = (0usize, 0usize);
        let rarer = means.iter().zip(&self.adjacent);
        for (_, beside) in rarer.filter(|(m, _)| (**m > middle) == rare) {
            inside += 1;
            let outside = |pair: &[f32; 2]| pair.iter().all(|&m| (m > middle) != rare);
            thin += usize::from(beside.iter().any(outside));
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

/// Mean over the samples that touch one, and itself.
fn local_mean<const D: usize>(volume: Volume<'_, D>, at: [usize; D]) -> f32 {
    let low = at.map(|i| i.saturating_sub(1));
    let span: [usize; D] =
        std::array::from_fn(|k| (at[k] + 1).min(volume.dims[k] - 1) + 1 - low[k]);
    let mut sum = 0.0;
    let rows: usize = span[1..].iter().product();
    for number in 0..rows {
        let mut rest = number;
        let mut first = low;
        for k in 1..D {
            first[k] += rest % span[k];
            rest /= span[k];
        }
        let start = volume.index(first);
        sum += volume.samples[start..start + span[0]].iter().sum::<f32>();
    }
    sum / (rows * span[0]) as f32
}

#[cfg(test)]
mod tests {
    use crate::feature::scenes::{Noise, crossing_surfaces, image_of, ridge_image};
    use crate::feature::{DetectionOptions, FeatureKind, detect};
    use crate::image::Image;

    #[test]
    fn auto_tells_ridges_and_edges() {
        let (dims, sheets) = crossing_surfaces();
        let note = |image: &Image<3>| {
            detect(image, &DetectionOptions::with_kind(FeatureKind::Auto, 8.0))
                .unwrap()
                .notes[0]
                .clone()
        };
        let ridges = note(&ridge_image(dims, &sheets, 1.5, 0.25));
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
    fn the_least_and_the_largest_value_are_found_wherever_they_are() {
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
        let threshold = |threshold| DetectionOptions {
            threshold,
            ..DetectionOptions::with_kind(FeatureKind::Auto, 8.0)
        };
        let found = detect(&image, &threshold(None)).unwrap();
        assert!(found.notes[0].contains("labels"), "{:?}", found.notes);
        let said = detect(&image, &threshold(Some(0.5))).unwrap_err();
        let said = said.to_string();
        for word in ["threshold 0.5", "labels", "2 different values", "omit it"] {
            assert!(said.contains(word), "no '{word}' in: {said}");
        }
    }
}

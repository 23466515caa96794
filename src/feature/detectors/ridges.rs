//! Ridges, which are surfaces of high values; and valleys, which are surfaces of low ones.
//!
//! Method: after smoothing by a Gaussian, ridge points are the zeros of the derivative across the
//! surface (Hale 2002; Steger 1998: [`ridges`](mod@crate::feature::ridges)). Where surfaces cross,
//! branch or run close to each other, ridges are searched for at all orientations
//! ([`oriented`](mod@crate::feature::oriented)). They are extended to the sides of the box by
//! [`boundary_extension`](mod@crate::feature::boundary_extension).
//!
//! Scale: 1.5 samples at first. Where noise hides the ridges at this scale (see
//! [`RidgeStatistics::is_hidden_by_noise`]), it is increased by factors of 1.25 up to 3 samples.
//! Assumptions: a surface is a few samples wide, bends little within three times the scale, and is
//! higher than its surroundings within that distance. Two surfaces that are nearer than twice their
//! width after smoothing are seen as one.

use super::{Brightness, Detector, DetectorInput, DetectorOutput, Thresholds};
use crate::error::Result;
use crate::feature::boundary_extension::{self, BoundaryShell, extend_to_sides};
use crate::feature::candidate::Candidate;
use crate::feature::oriented::{
    AmbiguityMask, CANDIDATE_HALO_LAYERS, OrientedSearch, merge_points,
};
use crate::feature::ridges::{self, RidgeStatistics, ridges};
use crate::feature::shared_grid::CandidateSlab;
use crate::feature::volume::Volume;
use crate::feature::windows::{CoveredLayers, LayerStack, LayerWindow, Samples, layer_len};
use crate::feature::{FeatureKind, SharedGrid};
use crate::parallel::prelude::*;
use std::ops::Range;

/// Detector of surfaces of high or of low values. Surfaces of low values are the ridges of the
/// negated image.
pub struct Ridges(pub Brightness);

impl<const D: usize> Detector<D> for Ridges {
    fn kind(&self) -> FeatureKind {
        match self.0 {
            Brightness::Bright => FeatureKind::Ridges,
            Brightness::Dark => FeatureKind::Valleys,
        }
    }

    fn brightness(&self) -> Option<Brightness> {
        Some(self.0)
    }

    fn suggestion_in_doubt(&self) -> &'static str {
        "follows the surfaces themselves; --feature edges confirms the sides of solid objects"
    }

    fn min_strong_share(&self) -> f64 {
        MIN_STRONG_SHARE
    }

    fn find(
        &self,
        input: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        let sign = match self.0 {
            Brightness::Bright => 1.0,
            Brightness::Dark => -1.0,
        };
        RidgeSearch::new(input).find(input.samples(sign)?, notes)
    }

    fn is_streamable(&self) -> bool {
        true
    }
}

/// Scale (samples) at which ridges are searched for first.
const MIN_SCALE: f64 = 1.5;
/// Largest scale (samples), used if noise hides ridges at smaller ones.
const MAX_SCALE: f64 = 3.0;

/// Share of ambiguous samples above which oriented filters are not used: in foam or pores, long
/// filters see several surfaces at once and cannot distinguish them.
const MAX_AMBIGUOUS_SHARE: f64 = 0.85;

/// Smallest share of a small surface that must be strong. Measured: up to 0.13 for fragments of
/// noise, 0.5 and more for surfaces.
const MIN_STRONG_SHARE: f64 = 0.2;

/// Strength of a single ridge that two surfaces side by side form, as a share of the upper
/// threshold.
const WEAK_STRENGTH_SHARE: f32 = 0.6;

/// Search for ridges, in the image or in an attribute that a detector computes from it.
pub struct RidgeSearch<'a, const D: usize> {
    /// The image, and the scales and thresholds to use.
    pub input: &'a DetectorInput<'a, D>,
    /// Scale (samples) to begin with; it is increased if noise hides ridges.
    pub min_scale: f64,
    /// The only scale, if given.
    pub scale: Option<f64>,
    /// `true` if surfaces may cross at shallow angles or run close to each other, so that ridges
    /// are searched for at all orientations.
    pub uses_oriented_filters: bool,
    /// Share of ambiguous samples from which oriented filters are not used.
    pub max_ambiguous_share: f64,
    /// Strength, as a share of the upper threshold, from which ridges decide where oriented filters
    /// look, and at which angles.
    pub weak_share: f32,
    /// Strength, as a share of that of strong points, down to which points of oriented filters are
    /// kept if no threshold is given.
    pub min_strength_share: fn(&Thresholds) -> f32,
    /// Smallest strength of a candidate, as a share of the height of the smoothed image there: where
    /// an attribute is high all around, as in chaotic parts, a weak ridge is not a feature.
    pub min_height_share: f32,
    /// Thresholds (low, high) if none are given.
    pub auto_thresholds: fn(&RidgeStatistics) -> (f32, f32),
}

impl<'a, const D: usize> RidgeSearch<'a, D> {
    /// Creates the search for ridges of the image itself.
    pub fn new(input: &'a DetectorInput<'a, D>) -> Self {
        Self {
            input,
            min_scale: MIN_SCALE,
            scale: input.options.scale,
            uses_oriented_filters: input.options.seeks_crossings,
            max_ambiguous_share: MAX_AMBIGUOUS_SHARE,
            weak_share: WEAK_STRENGTH_SHARE,
            min_strength_share: |_| 0.46,
            min_height_share: 0.0,
            auto_thresholds: RidgeStatistics::thresholds,
        }
    }

    /// Finds the ridges of `samples`.
    ///
    /// # Errors
    /// Returns the errors of reading.
    pub fn find(
        &self,
        mut samples: Samples<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        let (grid, cancel) = (self.input.grid, self.input.cancel);
        let (scale, thresholds, signal_to_noise) = self.smooth(&mut samples, notes)?;
        let survey = RidgeSurvey::measure(&samples, scale, thresholds.low, self.input)?;
        let layers = Some(survey.layers.clone());
        let mut slab = CandidateSlab::new(
            grid,
            survey.candidates,
            layers.clone(),
            CANDIDATE_HALO_LAYERS,
        )?;
        let heights = slab.with_halo("heights of ridges", survey.heights)?;
        let typical = ridges::global_typical_strength(&slab)?;
        // Two surfaces side by side form one weak ridge. If noise is stronger than that, they
        // cannot be found.
        let is_noisy = thresholds.high > typical;
        let min_clear_strength = if is_noisy { 1.0 } else { self.weak_share } * thresholds.high;
        let high = thresholds.high;
        let ambiguity = AmbiguityMask::new(&slab, scale, &heights, high, min_clear_strength)?;
        drop(heights);
        let has_sharp_normals =
            self.uses_oriented_filters && ambiguity.share() < self.max_ambiguous_share;
        let shell = survey.shell;
        let candidates = if has_sharp_normals {
            let search = OrientedSearch {
                image: &samples,
                background: survey.background,
                noise_floor: survey.noise_floor,
                ambiguity: &ambiguity,
                slab: &slab,
                min_clear_strength,
                min_strength_share: match self.input.thresholds() {
                    Some(_) => thresholds.low / typical,
                    None => (self.min_strength_share)(&thresholds),
                },
                typical_strength: typical,
                cancel,
            };
            oriented_points(&search, high, notes)?
        } else {
            let candidates = std::mem::take(&mut slab.candidates);
            slab.owned_candidates(candidates)
        };
        drop((ambiguity, slab));
        let candidates = if self.min_height_share > 0.0 {
            self.drop_flat_ridges(&samples, candidates, &survey.layers)?
        } else {
            candidates
        };
        let slab = CandidateSlab::new(
            grid,
            candidates,
            layers.clone(),
            boundary_extension::HALO_LAYERS,
        )?;
        let candidates = extend_to_sides(shell, slab, scale, high, cancel)?;
        Ok(DetectorOutput {
            signal_to_noise,
            has_sharp_normals,
            layers,
            ..DetectorOutput::new(candidates, scale, thresholds)
        })
    }

    /// Returns the candidates that are strong enough for the height of the smoothed samples there.
    /// The candidates are those of `layers`, in the order of samples.
    fn drop_flat_ridges(
        &self,
        samples: &Samples<'_, D>,
        candidates: Vec<Candidate<D>>,
        layers: &Range<usize>,
    ) -> Result<Vec<Candidate<D>>> {
        let dims = samples.dims();
        let volume = Volume::new(dims, &[]);
        let coordinates = |c: &Candidate<D>| volume.coordinates(c.voxel.index());
        let mut kept = Vec::with_capacity(candidates.len());
        let mut keep = |window: &LayerWindow<'_, D>| {
            let range = &window.interior.layers;
            let [first, end] = [range.start, range.end]
                .map(|layer| candidates.partition_point(|c| coordinates(c)[D - 1] < layer));
            kept.extend(candidates[first..end].iter().filter(|c| {
                c.strength >= self.min_height_share * window.smoothed.value_at(coordinates(c))
            }));
        };
        samples.for_each_window_in(layers, 0, None, &|_| 1, self.input.cancel, &mut keep)?;
        Ok(kept)
    }

    /// Smooths the samples at the scale of the whole image, at the given scale, or so that noise
    /// does not hide ridges. Returns the scale, the thresholds, and the signal-to-noise ratio.
    fn smooth(
        &self,
        samples: &mut Samples<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<(f64, Thresholds, Option<f32>)> {
        let cancel = self.input.cancel;
        let given_thresholds = self.input.thresholds();
        if let (Some(resolved), Some(thresholds)) = (self.input.resolved, given_thresholds) {
            samples.smooth(resolved.scale, cancel);
            return Ok((resolved.scale, thresholds, None));
        }
        let mut scale = self.scale.unwrap_or(self.min_scale);
        samples.smooth(scale, cancel);
        let mut statistics = ridges::statistics(samples, scale, self.input.live_mask, cancel)?;
        while self.scale.is_none() && statistics.is_hidden_by_noise() && scale < MAX_SCALE {
            let coarser = (1.25 * scale).min(MAX_SCALE);
            samples.smooth((coarser * coarser - scale * scale).sqrt(), cancel);
            scale = coarser;
            statistics = ridges::statistics(samples, scale, self.input.live_mask, cancel)?;
        }
        let thresholds = given_thresholds.unwrap_or_else(|| {
            let (low, high) = (self.auto_thresholds)(&statistics);
            Thresholds {
                low,
                high,
                origin: "chosen from the noise",
            }
        });
        notes.push(format!(
            "surfaces are searched for after smoothing over {scale} samples: {thresholds}; noise has the strength \
             {:.4}, a typical surface {:.4}",
            statistics.noise, statistics.typical
        ));
        let ratio = statistics.typical / statistics.noise;
        Ok((scale, thresholds, ratio.is_finite().then_some(ratio)))
    }
}

/// Returns the ridge points of oriented filters at ambiguous samples, and the candidates of the
/// slab elsewhere. Candidates of at least `strong_threshold` are strong.
fn oriented_points<const D: usize>(
    search: &OrientedSearch<'_, D>,
    strong_threshold: f32,
    notes: &mut Vec<String>,
) -> Result<Vec<Candidate<D>>> {
    let (slab, ambiguity) = (search.slab, search.ambiguity);
    let points = search.points()?;
    let (candidates, oriented_count) = merge_points(slab, ambiguity, &points, strong_threshold);
    let counts = [slab.owned.len(), candidates.len(), oriented_count];
    let [before, after, count] = slab.grid.sum("oriented points", counts)?;
    if count > 0 {
        notes.push(format!(
            "surfaces cross, branch or run close to each other around {:.1} % of the samples: filters at all \
             angles find {count} points there, in place of {}",
            100.0 * ambiguity.share(),
            before + count - after,
        ));
    }
    Ok(candidates)
}

/// Height of the noise floor, as a share of the typical ridge's. The highest samples of rows are
/// mostly ridges, if there are any.
const NOISE_FLOOR_SHARE: f32 = 0.25;
/// Number of samples in each of these rows.
const ROW_SAMPLES: usize = 64;

/// Ridges and statistics of smoothed samples, measured in one pass.
struct RidgeSurvey<const D: usize> {
    /// Layers that this rank has searched.
    layers: Range<usize>,
    /// Ridge points of these layers, in the order of samples.
    candidates: Vec<Candidate<D>>,
    /// Height of the smoothed image at each of these points above the median.
    heights: Vec<f32>,
    /// Median of the unsmoothed image.
    background: f32,
    /// Height of the smoothed image below which no features are searched for.
    noise_floor: f32,
    /// Heights of the smoothed image near the sides of the box, in these layers.
    shell: BoundaryShell<D>,
}

impl<const D: usize> RidgeSurvey<D> {
    fn measure(
        samples: &Samples<'_, D>,
        scale: f64,
        low: f32,
        &DetectorInput {
            grid,
            live_mask,
            cancel,
            ..
        }: &DetectorInput<'_, D>,
    ) -> Result<Self> {
        let (stride, shell) = (
            samples.sample_stride(),
            BoundaryShell::new(samples.dims(), scale),
        );
        let mut layers = CoveredLayers::default();
        let (mut candidates, mut heights) = (Vec::new(), Vec::new());
        let (mut near_sides, mut subsamples) = (Vec::new(), [Vec::new(), Vec::new()]);
        let mut tops = RowTops::default();
        let mut measure = |window: &LayerWindow<'_, D>| {
            let mut window_candidates = ridges(window, scale, low, cancel);
            if let Some(live) = live_mask {
                let volume = Volume::new(window.dims, &[]);
                window_candidates.retain(|c| live.is_usable(volume.coordinates(c.voxel.index())));
            }
            let interior = window.smoothed.layers(&window.interior.layers);
            let (near_side_heights, statistics) = rayon::join(
                || shell.extract_layers(interior, window.interior.layers.start),
                || WindowStatistics::measure(window, &window_candidates, stride),
            );
            layers.add(&window.interior);
            append(&mut candidates, window_candidates);
            append(&mut near_sides, near_side_heights);
            append(&mut heights, statistics.heights);
            for (collected, added) in subsamples.iter_mut().zip(statistics.subsamples) {
                append(collected, added);
            }
            tops.add(statistics.first_top, statistics.tops);
        };
        let reach = ridges::DIFFERENCE_REACH;
        samples.for_each_window(reach, None, &|_| 1, cancel, &mut measure, &mut |()| ())?;
        let [raw, smoothed] = subsamples;
        let median = |what: &str, samples: Vec<f32>| -> Result<f32> {
            let median = grid.select_nth(what, samples, |count| count / 2)?;
            Ok(median.unwrap_or(0.0) as f32)
        };
        let background = median("samples", raw)?;
        let empty_level = median("smoothed samples", smoothed)?;
        heights
            .par_iter_mut()
            .for_each(|height| *height -= empty_level);
        let tops = tops.gather(grid)?;
        let top = grid.select_nth("tops of rows", tops, |count| count * 9 / 10)?;
        Ok(Self {
            layers: layers.0,
            candidates,
            heights,
            background,
            noise_floor: top.map_or(empty_level, |top| {
                empty_level + NOISE_FLOOR_SHARE * (top as f32 - empty_level)
            }),
            shell: shell.with_heights(near_sides),
        })
    }
}

/// Statistics of the samples of a window.
struct WindowStatistics {
    /// Height of the smoothed image at each ridge point of the window.
    heights: Vec<f32>,
    /// Subsamples, unsmoothed and smoothed.
    subsamples: [Vec<f32>; 2],
    /// Highest smoothed sample of the part of a row that the previous window began, and of each
    /// later row.
    first_top: Option<f32>,
    tops: Vec<f32>,
}

impl WindowStatistics {
    fn measure<const D: usize>(
        window: &LayerWindow<'_, D>,
        candidates: &[Candidate<D>],
        stride: usize,
    ) -> Self {
        let (volume, smoothed) = (Volume::new(window.dims, &[]), window.smoothed);
        let height = |c: &Candidate<D>| smoothed.value_at(volume.coordinates(c.voxel.index()));
        let interior = smoothed.layers(&window.interior.layers);
        let passed = window.interior.layers.start * layer_len(window.dims);
        let skipped = passed.next_multiple_of(stride) - passed;
        let subsample = |stack: LayerStack<'_, D>| {
            let interior = stack.layers(&window.interior.layers);
            let count = interior.len().saturating_sub(skipped).div_ceil(stride);
            let indices = (0..count).into_par_iter();
            indices.map(|i| interior[skipped + i * stride]).collect()
        };
        let (begun_row, rows) = interior.split_at(
            interior
                .len()
                .min(passed.next_multiple_of(ROW_SAMPLES) - passed),
        );
        let highest = |row: &[f32]| row.iter().copied().fold(f32::MIN, f32::max);
        Self {
            heights: candidates.par_iter().map(height).collect(),
            subsamples: [window.raw, smoothed].map(subsample),
            first_top: (!begun_row.is_empty()).then(|| highest(begun_row)),
            tops: rows.par_chunks(ROW_SAMPLES).map(highest).collect(),
        }
    }
}

/// Highest samples of successive rows.
#[derive(Default)]
struct RowTops {
    /// Highest sample of the part of a row that began before the first one.
    first_top: Option<f32>,
    tops: Vec<f32>,
}

impl RowTops {
    fn add(&mut self, first_top: Option<f32>, tops: Vec<f32>) {
        if let Some(top) = first_top {
            match self.tops.last_mut() {
                Some(last) => *last = last.max(top),
                None => self.first_top = Some(self.first_top.map_or(top, |first| first.max(top))),
            }
        }
        append(&mut self.tops, tops);
    }

    /// Returns the highest samples of the rows that this rank began; parts of the last row come
    /// from the following ranks.
    fn gather<const D: usize>(mut self, grid: SharedGrid<'_, D>) -> Result<Vec<f32>> {
        let local = (self.first_top, self.tops.is_empty());
        let mut following = grid.following("tops of rows begun", local)?.into_iter();
        let mut continues = true;
        while let Some((first_top, has_no_row)) = following.next().filter(|_| continues) {
            self.add(first_top, Vec::new());
            continues = has_no_row;
        }
        Ok(self.tops)
    }
}

/// Appends `more` to `target`; if `target` is empty, nothing is copied.
fn append<T>(target: &mut Vec<T>, more: Vec<T>) {
    if target.is_empty() {
        *target = more;
    } else {
        target.extend(more);
    }
}

#[cfg(test)]
mod tests {
    use super::{Detector, DetectorInput, RidgeSearch, Ridges};
    use crate::feature::scenes::{
        ExactSurface, Noise, crossing_surfaces, image_of, measure_fit, plane_image, ridge_image,
        ridges_in_correlated_noise,
    };
    use crate::feature::volume::Volume;
    use crate::feature::windows::Samples;
    use crate::feature::windows::tests::LayeredImage;
    use crate::feature::{DetectionOptions, FeatureKind, Features, detect};
    use crate::image::{Geometry, Image, ImageSource};
    use crate::progress::CancelToken;

    #[test]
    #[ignore = "slow: make test-all"]
    fn noisy_crossing_curved_surfaces_are_found() {
        let (dims, surfaces) = crossing_surfaces();
        for (width, noise) in [(1.0, 0.2), (1.5, 0.0), (1.5, 0.25), (2.0, 0.25)] {
            let image = ridge_image(dims, &surfaces, width, noise);
            let features = detect(
                &image,
                &DetectionOptions::with_kind(FeatureKind::Ridges, 8.0),
            )
            .unwrap();
            let fit = measure_fit(dims, &surfaces, &features.points);
            assert!(fit.coverage > 0.99, "{width} {noise} {fit:?}");
            assert!(fit.precision > 0.995, "{width} {noise} {fit:?}");
            assert!(fit.rms < 0.15, "{width} {noise} {fit:?}");
            assert!(fit.angle < 3.5, "{width} {noise} {fit:?}");
        }
    }

    #[test]
    #[ignore = "slow: make test-all"]
    fn correlated_noise_is_distinguished_from_surfaces() {
        let (dims, surfaces) = crossing_surfaces();
        for (width, noise, coverage) in [(1.5, 0.15, 0.98), (1.5, 0.2, 0.95), (2.0, 0.25, 0.8)] {
            let image = ridges_in_correlated_noise(dims, &surfaces, width, noise, 1.0);
            let features = detect(
                &image,
                &DetectionOptions::with_kind(FeatureKind::Ridges, 8.0),
            )
            .unwrap();
            let fit = measure_fit(dims, &surfaces, &features.points);
            assert!(
                fit.coverage > coverage && fit.precision > 0.97,
                "{width} {noise} {fit:?}"
            );
        }
    }

    #[test]
    fn valleys_are_ridges_upside_down() {
        let (dims, surfaces) = (
            [40, 36, 32],
            [ExactSurface::plane([1.0, 0.3, 0.2], [20.0, 18.0, 16.0])],
        );
        let image = ridge_image(dims, &surfaces, 1.5, 0.1);
        let negated = Image::new(
            dims,
            image.as_slice().iter().map(|s| -s).collect(),
            Geometry::default(),
        );
        let ridges = detect(
            &image,
            &DetectionOptions::with_kind(FeatureKind::Ridges, 4.0),
        )
        .unwrap();
        let valleys = detect(
            &negated,
            &DetectionOptions::with_kind(FeatureKind::Valleys, 4.0),
        )
        .unwrap();
        assert!(!ridges.points.is_empty());
        assert_eq!(ridges.points, valleys.points);
        assert_eq!(ridges.potential, valleys.potential);
    }

    #[test]
    fn noise_alone_gives_hardly_any_feature() {
        let mut noise = Noise::new(11);
        let image = image_of([64, 64, 64], |_| noise.normal());
        let features = detect(
            &image,
            &DetectionOptions::with_kind(FeatureKind::Ridges, 8.0),
        )
        .unwrap();
        assert!(features.points.len() < 1000, "{:?}", features.notes);
    }

    /// Returns the share of the curve `curve(t)`, t from 0 to 1, that is within half a sample of a
    /// point, and the root mean square of `distance` at the points.
    fn curve_fit(
        features: &Features<2>,
        curve: impl Fn(f64) -> [f64; 2],
        distance: impl Fn([f64; 2]) -> f64,
    ) -> (f64, f64) {
        let covered = (0..=1000).filter(|&i| {
            let p = curve(f64::from(i) / 1000.0);
            features.points.iter().any(|point| {
                let r: [f64; 2] = std::array::from_fn(|k| f64::from(point.position[k]) - p[k]);
                let s = r[0] * f64::from(point.normal[0]) + r[1] * f64::from(point.normal[1]);
                s.abs() <= 0.5 && r[0].hypot(r[1]) <= 1.2
            })
        });
        let squares: f64 = features
            .points
            .iter()
            .map(|p| distance(p.position.map(f64::from)).powi(2))
            .sum();
        let rms = (squares / features.points.len().max(1) as f64).sqrt();
        (covered.count() as f64 / 1001.0, rms)
    }

    #[test]
    fn curves_of_a_plane_image_are_found() {
        let dims = [120, 100];
        let (centre, radius) = ([30.0, -40.0], 80.0);
        let ring = |p: [f64; 2]| (p[0] - centre[0]).hypot(p[1] - centre[1]) - radius;
        let line = |p: [f64; 2]| 0.8 * (p[0] - 60.0) - 0.6 * (p[1] - 50.0);
        let mut noise = Noise::new(21);
        let bell = |s: f64| (-0.5 * (s / 1.5).powi(2)).exp();
        let image = plane_image(dims, |p| {
            bell(ring(p)).max(bell(line(p))) + 0.15 * noise.normal()
        });
        let features =
            detect(&image, &DetectionOptions::with_kind(FeatureKind::Auto, 8.0)).unwrap();
        assert!(features.notes[0].contains("ridges"), "{:?}", features.notes);
        let nearest = |p: [f64; 2]| ring(p).abs().min(line(p).abs());
        let (arc, rms) = curve_fit(
            &features,
            |t| {
                let angle = 0.55 + 1.3 * t;
                [
                    centre[0] + radius * angle.cos(),
                    centre[1] + radius * angle.sin(),
                ]
            },
            nearest,
        );
        let (straight, _) = curve_fit(&features, |t| [30.0 + 60.0 * t, 10.0 + 80.0 * t], nearest);
        assert!(
            arc > 0.93 && straight > 0.97 && rms < 0.3,
            "{arc} {straight} {rms} {:?}",
            features.notes
        );
        assert_eq!(features.potential.dims, dims);
        let deepest = features
            .potential
            .to_dense()
            .samples
            .iter()
            .copied()
            .fold(0.0, f32::min);
        assert!((-1.0..-0.98).contains(&deepest), "{deepest}");
    }

    /// Returns the largest distance (samples) of ridge points from a straight Gaussian ridge
    /// through the middle, and the largest angle (degrees) between normals, away from the sides.
    fn straight_ridge<const D: usize>(
        dims: [usize; D],
        normal: [f64; D],
        width: f64,
    ) -> (f64, f64) {
        let middle = dims.map(|n| 0.5 * n as f64 + 0.13);
        let distance =
            |p: [f64; D]| -> f64 { (0..D).map(|k| normal[k] * (p[k] - middle[k])).sum() };
        let count = dims.iter().product();
        let empty = Volume { dims, samples: &[] };
        let at = |i: usize| empty.coordinates(i).map(|c| c as f64);
        let samples: Vec<f32> = (0..count)
            .map(|i| (-0.5 * (distance(at(i)) / width).powi(2)).exp() as f32)
            .collect();
        let image = Image::new(dims, samples, Geometry::default());
        let features = detect(
            &image,
            &DetectionOptions::with_kind(FeatureKind::Ridges, 5.0),
        )
        .unwrap();
        let (mut worst, mut max_angle, mut inner) = ([0.0f64; 2], 0.0f64, 0);
        for point in &features.points {
            let p = point.position.map(f64::from);
            if (0..D).all(|k| p[k] > 7.0 && p[k] < dims[k] as f64 - 8.0) {
                inner += 1;
                worst[0] = worst[0].max(distance(p).abs());
                let c: f64 = (0..D).map(|k| normal[k] * f64::from(point.normal[k])).sum();
                max_angle = max_angle.max(c.abs().min(1.0).acos().to_degrees());
            }
        }
        assert!(inner > dims[0] / 3, "{inner} {normal:?}");
        (worst[0], max_angle)
    }

    #[test]
    fn ridges_lie_where_they_are_at_every_dip() {
        for width in [1.0, 2.0] {
            for dip in (0..180).step_by(9) {
                let (sin, cos) = f64::from(dip).to_radians().sin_cos();
                let (distance, angle) = straight_ridge([48, 44], [cos, sin], width);
                assert!(
                    distance < 0.1 && angle < 0.5,
                    "2-D {width} {dip} {distance} {angle}"
                );
            }
            for dip in (0..=90).step_by(18) {
                for azimuth in (0..360).step_by(40) {
                    let (dip, azimuth) =
                        (f64::from(dip).to_radians(), f64::from(azimuth).to_radians());
                    let normal = [
                        dip.cos(),
                        dip.sin() * azimuth.cos(),
                        dip.sin() * azimuth.sin(),
                    ];
                    let (distance, angle) = straight_ridge([30, 29, 32], normal, width);
                    assert!(
                        distance < 0.1 && angle < 0.5,
                        "3-D {normal:?} {distance} {angle}"
                    );
                }
            }
        }
    }

    #[test]
    fn windows_find_what_the_whole_finds() {
        check_windows_match_whole([52, 48, 150]);
        // In two strips.
        check_windows_match_whole([52, 150, 48]);
    }

    fn check_windows_match_whole(dims: [usize; 3]) {
        // Two surfaces that cross at 20 degrees, so that oriented filters are used, and noise.
        let middle = dims.map(|n| 0.5 * n as f64);
        let surfaces = [[1.0, 0.1, 0.0], [0.95, 0.1, 0.34]].map(|n| ExactSurface::plane(n, middle));
        let image = ridge_image(dims, &surfaces, 1.5, 0.25);
        let options = DetectionOptions::with_kind(FeatureKind::Ridges, 8.0);
        let cancel = CancelToken::never();
        let input = DetectorInput::new(ImageSource::InMemory(&image), &options, &cancel);
        let (mut notes, mut other_notes) = (Vec::new(), Vec::new());
        let reference = Ridges(crate::feature::Brightness::Bright)
            .find(&input, &mut notes)
            .unwrap();
        assert!(
            notes.iter().any(|note| note.contains("all angles")),
            "{notes:?}"
        );
        let by_layers = LayeredImage(&image);
        let samples = Samples::from_layers(&by_layers, 1.0).with_limits([0, 1]);
        let samples = samples.with_strips(1, usize::MAX);
        let windowed = RidgeSearch::new(&input)
            .find(samples, &mut other_notes)
            .unwrap();
        assert_eq!(notes, other_notes);
        assert_eq!(reference.candidates.len(), windowed.candidates.len());
        for (a, b) in reference.candidates.iter().zip(&windowed.candidates) {
            let geometry = |c: &super::Candidate<3>| (c.voxel, c.axis, c.position, c.normal);
            assert_eq!(geometry(a), geometry(b));
            assert_eq!(a.strength, b.strength);
        }
    }
}

//! Ridges: sheets of high values; and valleys, sheets of low ones.
//!
//! Method: a Gaussian, then the points at which the derivative across the sheet passes through zero
//! (Hale 2002; Steger 1998: [`ridges`](mod@crate::feature::ridges)); where sheets cross, branch or run
//! close, at all orientations ([`lifted`](mod@crate::feature::oriented_points)); and
//! [`repair`](mod@crate::feature::boundary_extension) at the sides of the box.
//!
//! Scale: 1.5 samples at first; where noise hides what is seen there (see [`RidgeStatistics::is_drowned`]) by
//! quarters up to 3 samples. Assumptions: a sheet is a few samples wide, bends little within three times
//! the scale, and is higher than all within that distance; two that are nearer than twice the width
//! that smoothing gives them are seen as one.

use super::{Detector, DetectorInput, DetectorOutput, Thresholds};
use crate::comm::{Comm, WorldComm};
use crate::error::Result;
use crate::feature::FeatureKind;
use crate::feature::boundary_extension::{self, BoundaryShell, extend_to_sides};
use crate::feature::candidate::Candidate;
use crate::feature::candidate_slab::{CandidateSlab, select_nth};
use crate::feature::oriented::{
    AmbiguityMask, CANDIDATE_HALO_LAYERS, OrientedSearch, merge_points,
};
use crate::feature::ridges::{self, RidgeStatistics, ridges};
use crate::feature::volume::Volume;
use crate::feature::windows::{CoveredLayers, LayerStack, LayerWindow, Samples, layer_len};
use crate::image::LiveMask;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use std::ops::Range;

/// Finds sheets of high values.
pub struct Ridges;

impl<const D: usize> Detector<D> for Ridges {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Ridges
    }

    fn min_strong_share(&self) -> f64 {
        MIN_STRONG_SHARE
    }

    fn find(
        &self,
        scene: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        RidgeSearch::new(scene).find(scene.samples(1.0)?, notes)
    }

    fn is_streamable(&self) -> bool {
        true
    }
}

/// Finds sheets of low values: the ridges of the negated image.
pub struct Valleys;

impl<const D: usize> Detector<D> for Valleys {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Valleys
    }

    fn min_strong_share(&self) -> f64 {
        MIN_STRONG_SHARE
    }

    fn find(
        &self,
        scene: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        RidgeSearch::new(scene).find(scene.samples(-1.0)?, notes)
    }

    fn is_streamable(&self) -> bool {
        true
    }
}

/// The scale (samples) at which ridges are sought first.
const MIN_SCALE: f64 = 1.5;
/// Where ridges drown in noise they are sought on a smoother image, up to this scale (samples).
const MAX_SCALE: f64 = 3.0;

/// Where more than this share of an image is ambiguous (foam, pores), long filters see several sheets at
/// once and tell nothing apart.
const MAX_AMBIGUOUS_SHARE: f64 = 0.85;

/// Of a small sheet, this share is sure: of pieces of noise up to .13 are, of sheets half and more.
const MIN_STRONG_SHARE: f64 = 0.2;

/// Of two sheets side by side, which are one ridge, this share of a sure one's strength is left.
const WEAK_STRENGTH_SHARE: f32 = 0.6;

/// How ridges are sought, in the image or in what a detector makes of it.
pub struct RidgeSearch<'a, const D: usize> {
    /// The image, and what is settled on or asked for.
    pub input: &'a DetectorInput<'a, D>,
    /// The scale (samples) to begin with; from here up as smooth as noise asks.
    pub min_scale: f64,
    /// The only scale, if given.
    pub scale: Option<f64>,
    /// Whether sheets may cross at shallow angles or run close, so that all orientations are looked at.
    pub uses_oriented_filters: bool,
    /// ... unless at least this share of the image is ambiguous.
    pub max_ambiguous_share: f64,
    /// Ridges of this share of a sure one's strength tell where to look and at which angles.
    pub weak_share: f32,
    /// Where no threshold is given, points at all angles are kept down to this share of the strong ones.
    pub min_strength_share: fn(&Thresholds) -> f32,
    /// Thresholds (low, high) where none are given.
    pub auto_thresholds: fn(&RidgeStatistics) -> (f32, f32),
}

impl<'a, const D: usize> RidgeSearch<'a, D> {
    /// As ridges of the image itself are sought.
    pub fn new(input: &'a DetectorInput<'a, D>) -> Self {
        Self {
            input,
            min_scale: MIN_SCALE,
            scale: input.options.scale,
            uses_oriented_filters: true,
            max_ambiguous_share: MAX_AMBIGUOUS_SHARE,
            weak_share: WEAK_STRENGTH_SHARE,
            min_strength_share: |_| 0.46,
            auto_thresholds: RidgeStatistics::thresholds,
        }
    }

    /// Ridges of `samples`, as many as the image has.
    ///
    /// # Errors
    /// That of reading them.
    pub fn find(
        &self,
        mut samples: Samples<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        let (dims, patience) = (samples.dims(), self.input.cancel);
        let (scale, thresholds, signal_to_noise) = self.smooth(&mut samples, notes)?;
        let group = &WorldComm as &dyn Comm;
        let seen = RidgeSurvey::measure(
            &samples,
            scale,
            thresholds.low,
            (group, self.input.live_mask),
            patience,
        )?;
        let layers = Some(seen.layers.clone());
        let mut slab = CandidateSlab::new(
            dims,
            seen.candidates,
            layers.clone(),
            CANDIDATE_HALO_LAYERS,
            group,
        )?;
        let heights = slab.with_halo("heights of ridges", seen.heights)?;
        let typical = ridges::global_typical_strength(&slab)?;
        // Two sheets side by side are one weak ridge; where noise is stronger than that, none is seen.
        let noisy = thresholds.high > typical;
        let clear = if noisy { 1.0 } else { self.weak_share } * thresholds.high;
        let high = thresholds.high;
        let zone = AmbiguityMask::new(&slab, scale, &heights, high, clear)?;
        drop(heights);
        let sharp = self.uses_oriented_filters && zone.share() < self.max_ambiguous_share;
        let shell = seen.shell;
        let candidates = match sharp {
            true => {
                let search = OrientedSearch {
                    image: &samples,
                    background: seen.background,
                    noise_floor: seen.noise_floor,
                    ambiguity: &zone,
                    slab: &slab,
                    min_clear_strength: clear,
                    min_strength_share: match self.input.thresholds() {
                        Some(_) => thresholds.low / typical,
                        None => (self.min_strength_share)(&thresholds),
                    },
                    typical_strength: typical,
                    cancel: patience,
                };
                oriented_points(&search, high, notes)?
            }
            false => {
                let all = std::mem::take(&mut slab.candidates);
                slab.owned_candidates(all)
            }
        };
        drop((zone, slab));
        let slab = CandidateSlab::new(
            dims,
            candidates,
            layers.clone(),
            boundary_extension::HALO_LAYERS,
            group,
        )?;
        let candidates = extend_to_sides(shell, slab, scale, high, patience)?;
        Ok(DetectorOutput {
            signal_to_noise,
            has_sharp_normals: sharp,
            layers,
            ..DetectorOutput::new(candidates, scale, thresholds)
        })
    }

    /// Smooths samples as settled on, as asked for, or so that ridges do not drown in noise; the scale,
    /// and the thresholds there.
    fn smooth(
        &self,
        samples: &mut Samples<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<(f64, Thresholds, Option<f32>)> {
        let patience = self.input.cancel;
        let given = self.input.thresholds();
        if let (Some(settled), Some(thresholds)) = (self.input.resolved, given) {
            samples.smooth(settled.scale, patience);
            return Ok((settled.scale, thresholds, None));
        }
        let mut scale = self.scale.unwrap_or(self.min_scale);
        samples.smooth(scale, patience);
        let mut statistics = ridges::statistics(samples, scale, self.input.live_mask, patience)?;
        while self.scale.is_none() && statistics.is_drowned() && scale < MAX_SCALE {
            let coarser = (1.25 * scale).min(MAX_SCALE);
            samples.smooth((coarser * coarser - scale * scale).sqrt(), patience);
            scale = coarser;
            statistics = ridges::statistics(samples, scale, self.input.live_mask, patience)?;
        }
        let thresholds = given.unwrap_or_else(|| {
            let (low, high) = (self.auto_thresholds)(&statistics);
            Thresholds {
                low,
                high,
                origin: "chosen",
            }
        });
        notes.push(format!(
            "ridges at scale {scale}: {thresholds}, noise {:.4}, typical strength {:.4}",
            statistics.noise, statistics.typical
        ));
        let ratio = statistics.typical / statistics.noise;
        Ok((scale, thresholds, ratio.is_finite().then_some(ratio)))
    }
}

/// Ridge points at all orientations where one is not enough, the others as they are; those of at least
/// `strong` are sure.
fn oriented_points<const D: usize>(
    search: &OrientedSearch<'_, D>,
    strong: f32,
    notes: &mut Vec<String>,
) -> Result<Vec<Candidate<D>>> {
    let (slab, zone) = (search.slab, search.ambiguity);
    let points = search.points()?;
    let (candidates, lifted) = merge_points(slab, zone, &points, strong);
    let counts = [slab.owned.len(), candidates.len(), lifted].map(|n| n as u64);
    let [before, after, count] = slab.global_sums("points at all angles", counts)?;
    if count > 0 {
        notes.push(format!(
            "sheets cross, branch or run close in {:.1} % of the samples: {count} points there at all \
             angles, in place of {}",
            100.0 * zone.share(),
            before + count - after,
        ));
    }
    Ok(candidates)
}

/// Of the tops of rows of samples, which are mostly ridges if there are ridges, this share of the typical
/// one's height is where points are sought.
const NOISE_FLOOR_SHARE: f32 = 0.25;
/// Samples of these rows.
const ROW_SAMPLES: usize = 64;

/// What is seen of smoothed samples on one way through them.
struct RidgeSurvey<const D: usize> {
    /// The layers that this rank has looked at, ...
    layers: Range<usize>,
    /// ... their ridge points, in the order of samples, ...
    candidates: Vec<Candidate<D>>,
    /// ... and how much higher the smoothed image is at each than where there is nothing.
    heights: Vec<f32>,
    /// The median of the image as it is.
    background: f32,
    /// The height of the smoothed image below which there is nothing to find.
    noise_floor: f32,
    /// Its heights near the sides, in these layers.
    shell: BoundaryShell<D>,
}

impl<const D: usize> RidgeSurvey<D> {
    fn measure(
        samples: &Samples<'_, D>,
        scale: f64,
        low: f32,
        (group, live): (&dyn Comm, Option<&LiveMask<D>>),
        patience: &CancelToken<'_>,
    ) -> Result<Self> {
        let (every, shell) = (
            samples.sample_stride(),
            BoundaryShell::new(samples.dims(), scale),
        );
        let mut layers = CoveredLayers::default();
        let (mut candidates, mut heights) = (Vec::new(), Vec::new());
        let (mut near_sides, mut some) = (Vec::new(), [Vec::new(), Vec::new()]);
        let mut tops = RowTops::default();
        let mut look = |window: &LayerWindow<'_, D>| {
            let mut found = ridges(window, scale, low, patience);
            if let Some(live) = live {
                let whole = Volume::new(window.dims, &[]);
                found.retain(|c| live.is_usable(whole.coordinates(c.voxel.index())));
            }
            let own = window.smoothed.layers(&window.interior.layers);
            let (near, glance) = rayon::join(
                || shell.extract_layers(own, window.interior.layers.start),
                || WindowStatistics::measure(window, &found, every),
            );
            layers.add(&window.interior);
            append(&mut candidates, found);
            append(&mut near_sides, near);
            append(&mut heights, glance.heights);
            for (some, more) in some.iter_mut().zip(glance.subsamples) {
                append(some, more);
            }
            tops.add(glance.first_top, glance.tops);
        };
        let reach = ridges::DIFFERENCE_REACH;
        samples.for_each_window(reach, None, &|_| 1, patience, &mut look, &mut |()| ())?;
        let middle = |count: usize| count / 2;
        let [as_is, smoothed] = some;
        let level = select_nth("samples", as_is, middle, group)?.unwrap_or(0.0) as f32;
        let nothing =
            select_nth("smoothed samples", smoothed, middle, group)?.unwrap_or(0.0) as f32;
        heights.par_iter_mut().for_each(|height| *height -= nothing);
        let tops = tops.gather(group)?;
        let top = select_nth("tops of rows", tops, |count| count * 9 / 10, group)?;
        Ok(Self {
            layers: layers.0,
            candidates,
            heights,
            background: level,
            noise_floor: top.map_or(nothing, |top| {
                nothing + NOISE_FLOOR_SHARE * (top as f32 - nothing)
            }),
            shell: shell.with_heights(near_sides),
        })
    }
}

/// What is seen at a glance of a window's samples.
struct WindowStatistics {
    /// How high the smoothed image is at each of its ridge points.
    heights: Vec<f32>,
    /// Samples here and there, as they are and smoothed.
    subsamples: [Vec<f32>; 2],
    /// The highest of what belongs to a row begun before, and of each row of smoothed samples.
    first_top: Option<f32>,
    tops: Vec<f32>,
}

impl WindowStatistics {
    fn measure<const D: usize>(
        window: &LayerWindow<'_, D>,
        candidates: &[Candidate<D>],
        every: usize,
    ) -> Self {
        let (whole, smoothed) = (Volume::new(window.dims, &[]), window.smoothed);
        let height = |c: &Candidate<D>| smoothed.value_at(whole.coordinates(c.voxel.index()));
        let own = smoothed.layers(&window.interior.layers);
        let passed = window.interior.layers.start * layer_len(window.dims);
        let skipped = passed.next_multiple_of(every) - passed;
        let some_of = |stack: LayerStack<'_, D>| {
            let own = stack.layers(&window.interior.layers);
            let count = own.len().saturating_sub(skipped).div_ceil(every);
            let each = (0..count).into_par_iter();
            each.map(|i| own[skipped + i * every]).collect()
        };
        let (begun, rows) =
            own.split_at(own.len().min(passed.next_multiple_of(ROW_SAMPLES) - passed));
        let highest = |row: &[f32]| row.iter().copied().fold(f32::MIN, f32::max);
        Self {
            heights: candidates.par_iter().map(height).collect(),
            subsamples: [window.raw, smoothed].map(some_of),
            first_top: (!begun.is_empty()).then(|| highest(begun)),
            tops: rows.par_chunks(ROW_SAMPLES).map(highest).collect(),
        }
    }
}

/// The tops of rows of samples that follow one another.
#[derive(Default)]
struct RowTops {
    /// Of a row that was begun before the first.
    first_top: Option<f32>,
    tops: Vec<f32>,
}

impl RowTops {
    fn add(&mut self, begun: Option<f32>, tops: Vec<f32>) {
        if let Some(top) = begun {
            match self.tops.last_mut() {
                Some(last) => *last = last.max(top),
                None => self.first_top = Some(self.first_top.map_or(top, |begun| begun.max(top))),
            }
        }
        append(&mut self.tops, tops);
    }

    /// The tops, where others have those of the rows that follow: of a row that one has begun its own is that of all.
    fn gather(mut self, group: &dyn Comm) -> Result<Vec<f32>> {
        let own = (self.first_top, self.tops.is_empty());
        let all: Vec<(Option<f32>, bool)> = group.all_gather("tops of rows begun", own)?;
        let mut after = all[group.rank() + 1..].iter();
        let mut goes_on = true;
        while let Some((begun, no_row)) = after.next().filter(|_| goes_on) {
            self.add(*begun, Vec::new());
            goes_on = *no_row;
        }
        Ok(self.tops)
    }
}

/// Adds `more` to what there is; the first is not copied.
fn append<T>(all: &mut Vec<T>, more: Vec<T>) {
    match all.is_empty() {
        true => *all = more,
        false => all.extend(more),
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
    fn noisy_crossing_curved_sheets_are_found() {
        let (dims, sheets) = crossing_surfaces();
        for (width, noise) in [(1.0, 0.2), (1.5, 0.0), (1.5, 0.25), (2.0, 0.25)] {
            let image = ridge_image(dims, &sheets, width, noise);
            let features = detect(
                &image,
                &DetectionOptions::with_kind(FeatureKind::Ridges, 8.0),
            )
            .unwrap();
            let fit = measure_fit(dims, &sheets, &features.points);
            assert!(fit.coverage > 0.99, "{width} {noise} {fit:?}");
            assert!(fit.precision > 0.995, "{width} {noise} {fit:?}");
            assert!(fit.rms < 0.15, "{width} {noise} {fit:?}");
            assert!(fit.angle < 3.5, "{width} {noise} {fit:?}");
        }
    }

    #[test]
    #[ignore = "slow: make test-all"]
    fn correlated_noise_is_told_from_sheets() {
        let (dims, sheets) = crossing_surfaces();
        for (width, noise, coverage) in [(1.5, 0.15, 0.98), (1.5, 0.2, 0.95), (2.0, 0.25, 0.8)] {
            let image = ridges_in_correlated_noise(dims, &sheets, width, noise, 1.0);
            let features = detect(
                &image,
                &DetectionOptions::with_kind(FeatureKind::Ridges, 8.0),
            )
            .unwrap();
            let fit = measure_fit(dims, &sheets, &features.points);
            assert!(
                fit.coverage > coverage && fit.precision > 0.97,
                "{width} {noise} {fit:?}"
            );
        }
    }

    #[test]
    fn valleys_are_ridges_upside_down() {
        let (dims, sheets) = (
            [40, 36, 32],
            [ExactSurface::plane([1.0, 0.3, 0.2], [20.0, 18.0, 16.0])],
        );
        let image = ridge_image(dims, &sheets, 1.5, 0.1);
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

    /// Share of the curve `along(t)`, t from 0 to 1, within half a sample of a point, and the rms
    /// distance `off` of the points.
    fn curve_fit(
        features: &Features<2>,
        along: impl Fn(f64) -> [f64; 2],
        off: impl Fn([f64; 2]) -> f64,
    ) -> (f64, f64) {
        let covered = (0..=1000).filter(|&i| {
            let p = along(f64::from(i) / 1000.0);
            features.points.iter().any(|point| {
                let r: [f64; 2] = std::array::from_fn(|k| f64::from(point.position[k]) - p[k]);
                let s = r[0] * f64::from(point.normal[0]) + r[1] * f64::from(point.normal[1]);
                s.abs() <= 0.5 && r[0].hypot(r[1]) <= 1.2
            })
        });
        let squares: f64 = features
            .points
            .iter()
            .map(|p| off(p.position.map(f64::from)).powi(2))
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

    /// Worst distance (samples) of ridge points from a straight Gaussian ridge through the middle, and
    /// worst angle (degrees) between normals, away from the sides.
    fn straight_ridge<const D: usize>(
        dims: [usize; D],
        normal: [f64; D],
        width: f64,
    ) -> (f64, f64) {
        let middle = dims.map(|n| 0.5 * n as f64 + 0.13);
        let off = |p: [f64; D]| -> f64 { (0..D).map(|k| normal[k] * (p[k] - middle[k])).sum() };
        let count = dims.iter().product();
        let empty = Volume { dims, samples: &[] };
        let at = |i: usize| empty.coordinates(i).map(|c| c as f64);
        let samples: Vec<f32> = (0..count)
            .map(|i| (-0.5 * (off(at(i)) / width).powi(2)).exp() as f32)
            .collect();
        let image = Image::new(dims, samples, Geometry::default());
        let features = detect(
            &image,
            &DetectionOptions::with_kind(FeatureKind::Ridges, 5.0),
        )
        .unwrap();
        let (mut worst, mut turned, mut inner) = ([0.0f64; 2], 0.0f64, 0);
        for point in &features.points {
            let p = point.position.map(f64::from);
            if (0..D).all(|k| p[k] > 7.0 && p[k] < dims[k] as f64 - 8.0) {
                inner += 1;
                worst[0] = worst[0].max(off(p).abs());
                let c: f64 = (0..D).map(|k| normal[k] * f64::from(point.normal[k])).sum();
                turned = turned.max(c.abs().min(1.0).acos().to_degrees());
            }
        }
        assert!(inner > dims[0] / 3, "{inner} {normal:?}");
        (worst[0], turned)
    }

    #[test]
    fn ridges_lie_where_they_are_at_every_dip() {
        for width in [1.0, 2.0] {
            for dip in (0..180).step_by(9) {
                let (sin, cos) = f64::from(dip).to_radians().sin_cos();
                let (off, angle) = straight_ridge([48, 44], [cos, sin], width);
                assert!(off < 0.1 && angle < 0.5, "2-D {width} {dip} {off} {angle}");
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
                    let (off, angle) = straight_ridge([30, 29, 32], normal, width);
                    assert!(off < 0.1 && angle < 0.5, "3-D {normal:?} {off} {angle}");
                }
            }
        }
    }

    #[test]
    fn a_few_layers_at_a_time_show_what_all_do() {
        check_windows_match_whole([52, 48, 150]);
        // In two strips.
        check_windows_match_whole([52, 150, 48]);
    }

    fn check_windows_match_whole(dims: [usize; 3]) {
        // Two sheets that cross at 20 degrees, and noise that has them sought at all angles.
        let middle = dims.map(|n| 0.5 * n as f64);
        let sheets = [[1.0, 0.1, 0.0], [0.95, 0.1, 0.34]].map(|n| ExactSurface::plane(n, middle));
        let image = ridge_image(dims, &sheets, 1.5, 0.25);
        let asked = DetectionOptions::with_kind(FeatureKind::Ridges, 8.0);
        let patience = CancelToken::never();
        let scene = DetectorInput::new(ImageSource::InMemory(&image), &asked, &patience);
        let (mut notes, mut other_notes) = (Vec::new(), Vec::new());
        let whole = Ridges.find(&scene, &mut notes).unwrap();
        assert!(
            notes.iter().any(|note| note.contains("all angles")),
            "{notes:?}"
        );
        let by_layers = LayeredImage(&image);
        let samples = Samples::from_layers(&by_layers, 1.0).with_limits([0, 1]);
        let samples = samples.with_strips(1, usize::MAX);
        let parts = RidgeSearch::new(&scene)
            .find(samples, &mut other_notes)
            .unwrap();
        assert_eq!(notes, other_notes);
        assert_eq!(whole.candidates.len(), parts.candidates.len());
        for (a, b) in whole.candidates.iter().zip(&parts.candidates) {
            let figures = |c: &super::Candidate<3>| (c.voxel, c.axis, c.position, c.normal);
            assert_eq!(figures(a), figures(b));
            assert_eq!(a.strength, b.strength);
        }
    }
}

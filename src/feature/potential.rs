//! Computes the image potential b(x), which has a valley of depth 1 along every feature.
//!
//! b = -exp(-s^2 / (2 sigma^2)), where s is the distance to the nearest feature. Each feature point
//! stands for a disc of its surface, and s is the distance to the nearest *disc*. So, in the middle
//! of a surface, s is the distance to its tangent plane, wherever the points lie on it, and the
//! valley is smooth along the surface. Beyond the end of a surface, s is the distance to its rim,
//! so that the end of the valley is as round as its walls. Where surfaces cross, s is the distance
//! to the nearer one, so that the depth is 1 and not 2.
//!
//! The bell is cut at 3 sigma and lowered by its value there, so that b falls to exactly 0.

use super::{FeaturePoint, SharedGrid};
use crate::error::Result;
use crate::geometry::dot;
use crate::geometry::simd::dispatch_simd;
use crate::image::SparseField;
use crate::progress::CancelToken;
use std::borrow::Cow;
use std::ops::Range;

/// Distance, in units of sigma, at which the bell is cut.
const CUTOFF_SIGMAS: f64 = 3.0;

/// Radius of a point's disc, in samples: slightly more than half the diagonal of a column's cell,
/// so that the discs of neighbouring columns overlap.
const DISC_RADIUS: f32 = 0.75;

/// Safety margin (samples) for skipping samples beyond the cut of the bell, far larger than
/// rounding errors.
const CUTOFF_MARGIN: f32 = 0.01;

/// Axes along which the normal's component is at least this share of the largest one are leading
/// axes, too.
const MIN_LEADING_RATIO: f32 = 0.95;

/// The valleys of a potential on a grid of samples; the widest valleys have width `sigma`.
#[derive(Clone)]
pub struct PotentialValleys<'a, const D: usize> {
    pub grid: SharedGrid<'a, D>,
    pub step: [f64; D],
    pub sigma: f64,
    /// Feature points in the order of samples.
    pub points: Cow<'a, [FeaturePoint<D>]>,
    /// For each point, `true` if its surface ends there.
    pub is_rim: Cow<'a, [bool]>,
    /// Distance between atoms at each point; the width of the valley is a quarter of it.
    pub spacing: Option<Cow<'a, [f32]>>,
}

/// A point, `true` if its surface ends there, and the distance between atoms there.
type ValleyPoint<const D: usize> = (FeaturePoint<D>, (bool, Option<f32>));

impl<const D: usize> PotentialValleys<'_, D> {
    /// Computes the potential on the grid, each rank its part. The points are all points, or those
    /// that [`PotentialValleys::gather_for_share`] returned.
    pub fn potential(&self, cancel: &CancelToken<'_>) -> SparseField<D> {
        (self.grid).field(self.step, |layers: Range<usize>, samples: &mut Vec<f32>| {
            self.compute_layers(layers, samples, cancel);
        })
    }

    /// Returns the valleys with the points on which this rank's share of the potential depends, if
    /// each rank has some of the points.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn gather_for_share(self) -> Result<Self> {
        let spacing = |i: usize| self.spacing.as_ref().map(|d| d[i]);
        let valley_point = |i: usize| (self.points[i], (self.is_rim[i], spacing(i)));
        let points_for = |layers: Range<usize>| -> Vec<ValleyPoint<D>> {
            self.points_near(&layers).map(valley_point).collect()
        };
        let received = (self.grid).items_for_field("points near layers", points_for)?;
        let (points, marks): (Vec<_>, Vec<_>) = received.into_iter().unzip();
        let (is_rim, spacing): (Vec<_>, Vec<_>) = marks.into_iter().unzip();
        Ok(Self {
            points: points.into(),
            is_rim: is_rim.into(),
            spacing: self
                .spacing
                .and(spacing.into_iter().collect::<Option<Vec<f32>>>())
                .map(Cow::from),
            ..self
        })
    }

    /// Returns the indices of the points whose valleys may reach into some layers.
    fn points_near(&self, layers: &Range<usize>) -> Range<usize> {
        let (points, last) = (&self.points, D - 1);
        if layers.is_empty() {
            return 0..0;
        }
        // Points are sorted by their samples, so along the last axis they are sorted to within
        // slightly more than half a sample.
        let reach = CUTOFF_SIGMAS * self.sigma + 2.5 * self.step[last];
        let height = |p: &FeaturePoint<D>| f64::from(p.position[last]);
        let [low, high] = [layers.start, layers.end].map(|at| at as f64 * self.step[last]);
        let start = points.partition_point(|p| height(p) < low - reach);
        start
            ..points
                .partition_point(|p| height(p) <= high + reach)
                .max(start)
    }

    /// Computes the potential at the samples of some layers.
    fn compute_layers(
        &self,
        layers: Range<usize>,
        samples: &mut Vec<f32>,
        cancel: &CancelToken<'_>,
    ) {
        let last = D - 1;
        let mut dims = self.grid.dims;
        let layer: usize = dims[..last].iter().product();
        samples.clear();
        samples.resize(layer * layers.len(), f32::INFINITY);
        let nearby = self.points_near(&layers);
        dims[last] = layers.len();
        let mut splat = Splat {
            dims,
            step: self.step.map(|h| h as f32),
            first_layer: layers.start,
            out: samples,
            sigma: self.sigma as f32,
        };
        for i in nearby {
            if cancel.is_cancelled() {
                break;
            }
            splat.sigma = (self.spacing.as_ref()).map_or(self.sigma as f32, |d| d[i] / 4.0);
            splat.add(&self.points[i]);
            if self.is_rim[i] {
                splat.add_disc_rim(&self.points[i]);
            }
        }
        distances_to_valleys(samples);
    }
}

/// Squared distance of each sample in a slab of layers (along the last axis) to the nearest disc,
/// in units of the squared width of its valley.
struct Splat<'a, const D: usize> {
    /// Number of samples of the slab along each axis.
    dims: [usize; D],
    step: [f32; D],
    /// First layer of the slab.
    first_layer: usize,
    out: &'a mut [f32],
    /// Width of the current point's valley.
    sigma: f32,
}

impl<const D: usize> Splat<'_, D> {
    /// Converts a position from lattice units to samples.
    fn to_samples(&self, position: [f32; D]) -> [f32; D] {
        std::array::from_fn(|k| position[k] / self.step[k])
    }

    /// Returns the first sample of the slab along an axis, and the one after its last.
    fn axis_range(&self, k: usize) -> [usize; 2] {
        let first = if k == D - 1 { self.first_layer } else { 0 };
        [first, first + self.dims[k]]
    }

    /// Lowers the squared distances of samples along the point's normal to their distances from its
    /// disc.
    fn add(&mut self, point: &FeaturePoint<D>) {
        let n = point.normal;
        // Samples passed along each axis per lattice unit along the normal; the axis with the
        // largest value leads.
        let speed: [f32; D] = std::array::from_fn(|k| n[k] / self.step[k]);
        let max_speed = speed.iter().fold(0.0f32, |a, s| a.max(s.abs()));
        // Where the leading axis changes along a surface, both axes must lead, or there is a gap.
        for axis in (0..D).filter(|&k| speed[k].abs() >= MIN_LEADING_RATIO * max_speed) {
            self.add_along(axis, point, speed);
        }
    }

    /// Lowers the squared distances sample by sample along one leading axis.
    fn add_along(&mut self, axis: usize, point: &FeaturePoint<D>, speed: [f32; D]) {
        let centre = self.to_samples(point.position);
        let slope = speed.map(|s| s / speed[axis]);
        let reach = CUTOFF_SIGMAS as f32 * self.sigma * speed[axis].abs();
        let lateral = |k: usize| (axis + k) % D;
        let radius = DISC_RADIUS * (1..D).map(|k| self.step[lateral(k)]).fold(0.0, f32::max);
        for j in (centre[axis] - reach).ceil() as i32..=(centre[axis] + reach).floor() as i32 {
            let along = j as f32 - centre[axis];
            let low: [i32; D] =
                std::array::from_fn(|k| (centre[k] + along * slope[k]).floor() as i32);
            for corner in 0..1 << (D - 1) {
                let mut at = low;
                at[axis] = j;
                for k in 1..D {
                    at[lateral(k)] += corner >> (k - 1) & 1;
                }
                self.lower(at, centre, point.normal, radius);
            }
        }
    }

    /// Lowers the squared distances of all samples around the point to their distances from its
    /// disc.
    fn add_disc_rim(&mut self, point: &FeaturePoint<D>) {
        let (h, n) = (self.step, point.normal);
        let centre = self.to_samples(point.position);
        let radius = DISC_RADIUS * h.iter().fold(f32::INFINITY, |a, &b| a.min(b));
        let scale = 1.0 / (self.sigma * self.sigma);
        let (mut low, mut span) = ([0usize; D], [0usize; D]);
        for k in 0..D {
            let reach = CUTOFF_SIGMAS as f32 * self.sigma / h[k];
            let ends = self.axis_range(k).map(|end| end as i32);
            let first = ((centre[k] - reach).ceil() as i32).max(ends[0]);
            let end = ((centre[k] + reach).floor() as i32 + 1).min(ends[1]);
            if first >= end {
                return;
            }
            (low[k], span[k]) = (first as usize, (end - first) as usize);
        }
        // Beyond this distance from the point, no sample is within the cut from its disc.
        let max_distance = CUTOFF_SIGMAS as f32 * self.sigma + radius + CUTOFF_MARGIN * h[0];
        for number in 0..span[1..].iter().product() {
            let (mut remaining, mut start): (usize, usize) = (number, 0);
            let mut at = low;
            let (mut along, mut square) = (0.0, 0.0);
            for k in 1..D {
                at[k] += remaining % span[k];
                remaining /= span[k];
                let r = (at[k] as f32 - centre[k]) * h[k];
                along += r * n[k];
                square += r * r;
            }
            let half_chord_square = max_distance * max_distance - square;
            if half_chord_square <= 0.0 {
                continue;
            }
            for k in (1..D).rev() {
                start = (start + at[k] - self.axis_range(k)[0]) * self.dims[k - 1];
            }
            let half_chord = half_chord_square.sqrt() / h[0];
            let first = ((centre[0] - half_chord).ceil() as i32).max(low[0] as i32);
            let end = ((centre[0] + half_chord).floor() as i32 + 1).min((low[0] + span[0]) as i32);
            if first >= end {
                continue;
            }
            let (first, end) = (first as usize, end as usize);
            let row_start = start - self.axis_range(0)[0];
            let (first_offset, skipped) = ((low[0] as f32 - centre[0]) * h[0], first - low[0]);
            let row = &mut self.out[row_start + first..row_start + end];
            dispatch_simd(
                #[inline(always)]
                || {
                    for (x, nearest) in row.iter_mut().enumerate() {
                        let r = first_offset + (skipped + x) as f32 * h[0];
                        let s = r * n[0] + along;
                        let across = (r * r + square - s * s).max(0.0).sqrt();
                        let past = (across - radius).max(0.0);
                        *nearest = nearest.min((s * s + past * past) * scale);
                    }
                },
            );
        }
    }

    /// Lowers the squared distance of one sample to its distance from the disc around `centre`.
    #[inline]
    fn lower(&mut self, at: [i32; D], centre: [f32; D], n: [f32; D], radius: f32) {
        let mut i = 0;
        for k in (0..D).rev() {
            let [first, end] = self.axis_range(k);
            if at[k] < first as i32 || at[k] >= end as i32 {
                return;
            }
            i = i * self.dims[k] + (at[k] as usize - first);
        }
        let r: [f32; D] = std::array::from_fn(|k| (at[k] as f32 - centre[k]) * self.step[k]);
        let s = dot(r, n);
        let past = ((dot(r, r) - s * s).max(0.0).sqrt() - radius).max(0.0);
        let nearest = &mut self.out[i];
        *nearest = nearest.min((s * s + past * past) / (self.sigma * self.sigma));
    }
}

/// Converts squared distances in widths of valleys to values of the potential.
fn distances_to_valleys(samples: &mut [f32]) {
    let cut = (CUTOFF_SIGMAS * CUTOFF_SIGMAS) as f32;
    let bell_at_cutoff = (-0.5 * cut).exp();
    for s in samples {
        let u = *s;
        *s = if u < cut {
            -((-0.5 * u).exp() - bell_at_cutoff) / (1.0 - bell_at_cutoff)
        } else {
            0.0
        };
    }
}

#[cfg(test)]
mod tests {
    use crate::feature::scenes::{ExactSurface, ridge_image};
    use crate::feature::{DetectionOptions, FeatureKind, detect};

    #[test]
    fn the_valley_is_gaussian_across_and_uniform_along() {
        let dims = [48, 44, 40];
        let surfaces = [
            ExactSurface::plane([1.0, 0.45, 0.3], [22.0, 22.0, 20.0]),
            ExactSurface::plane([-0.4, 1.0, 0.2], [24.0, 24.0, 20.0]),
        ];
        let image = ridge_image(dims, &surfaces, 1.5, 0.0);
        let d_min = 8.0;
        let features = detect(
            &image,
            &DetectionOptions::with_kind(FeatureKind::Ridges, d_min),
        )
        .unwrap();
        let (sigma, bell_at_cutoff) = (features.sigma, (-4.5f64).exp());
        let potential = features.potential.to_dense();
        assert_eq!(sigma, d_min / 4.0);
        // Errors away from the crossing, and at it (where both surfaces are within three samples).
        let (mut worst, mut deepest) = ([0.0f64; 2], 0.0f32);
        for z in 5..35 {
            for y in 5..39 {
                for x in 5..43 {
                    let p = [x as f64, y as f64, z as f64];
                    let b = potential.samples[(z * 44 + y) * 48 + x];
                    deepest = deepest.min(b);
                    let s = surfaces
                        .iter()
                        .map(|s| s.distance(p).abs())
                        .fold(f64::MAX, f64::min);
                    let bell = (-0.5 * (s / sigma).powi(2)).exp().max(bell_at_cutoff);
                    let crossing = surfaces.iter().all(|s| s.distance(p).abs() < 3.0);
                    let worst = &mut worst[usize::from(crossing)];
                    *worst = worst.max(
                        (f64::from(b) + (bell - bell_at_cutoff) / (1.0 - bell_at_cutoff)).abs(),
                    );
                }
            }
        }
        assert!(worst[0] < 0.08 && worst[1] < 0.2, "{worst:?}");
        assert!((-1.0..-0.99).contains(&deepest), "{deepest}");
    }
}

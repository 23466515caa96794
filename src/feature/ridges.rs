//! Ridges of a volume at sub-sample positions.
//!
//! A ridge (Hale 2002) is a zero crossing of the derivative along the direction w in which the image
//! curves down the most. Here w is the eigenvector of the smoothed image's Hessian with the most
//! negative eigenvalue (Steger 1998, "An unbiased detector of curvilinear structures"): unlike the
//! structure tensor, whose window of several sigma mixes the two orientations of crossing sheets, it
//! sees no farther than the smoothing. Where a second eigenvalue is strongly negative too, sheets
//! cross and both directions are tried.
//!
//! A crossing is sought along the axis nearest to w, between the sample and its two neighbours with
//! w held fixed, so that every column of samples that the sheet passes gets one point: neither holes
//! nor doubles.

use super::candidate::{Candidate, dominant_axes, ridge_offset};
use super::candidate_slab::CandidateSlab;
use super::eigen::{eigenvalues, eigenvector};
use super::hessian::Curvature;
use super::windows::{LayerWindow, Samples, WindowInterior};
use crate::error::Result;
use crate::feature::volume::Volume;
use crate::image::LiveMask;
use crate::progress::CancelToken;

/// A Gaussian ridge as wide as the smoothing has, in the smoothed image, sigma^2 times its second
/// derivative lower than its height by this factor.
pub const HEIGHT_FACTOR: f64 = 2.828_427_124_746_19;

/// The second direction is tried where its eigenvalue is at least this share of the first one.
const MIN_SECOND_RATIO: f32 = 0.4;

/// How far (samples) differences look.
pub const DIFFERENCE_REACH: usize = 3;

/// Ridge points whose strength is at least `low`, in the order of samples, of the own layers of a window
/// with a halo of [`DIFFERENCE_REACH`], smoothed with a Gaussian of width `sigma` samples.
///
/// The strength is -sigma^2 times the second derivative across the ridge, scaled to be the ridge's
/// height if the ridge was a Gaussian of width `sigma` before smoothing.
pub fn ridges<const D: usize>(
    window: &LayerWindow<'_, D>,
    sigma: f64,
    low: f32,
    patience: &CancelToken<'_>,
) -> Vec<Candidate<D>> {
    window.map_rows(patience, |first, curvature: &mut Curvature, found| {
        curvature.measure(window.smoothed.volume, first);
        ridges_of_row(window, sigma, low, first, curvature, found);
    })
}

/// Standard deviation of the Laplacian of smoothed white noise over the median of [`lateral_curvature`]: its
/// Hessian's pure entries have variance 3, covariance 1, and its mixed entries variance 1.
const fn noise_per_median(dimensions: usize) -> f64 {
    if dimensions == 3 { 4.061 } else { 3.941 }
}

/// Ratio of noise to typical strength (one where there is only white noise) from which ridges drown.
const MAX_NOISE_RATIO: f32 = 0.5;

/// What the image says about ridge strengths, seen on one row in sixteen (in 2-D on all), of large volumes in
/// some of the layers.
#[derive(Debug, Clone, Copy)]
pub struct RidgeStatistics {
    /// What noise does to the Laplacian (standard deviation), in units of strength. Sheets bend the
    /// image in one direction only, so the other eigenvalues of the Hessian tell of noise even
    /// where sheets are dense.
    pub noise: f32,
    /// Typical strength of the ridges that matter: sum of cubes over sum of squares.
    pub typical: f32,
}

impl RidgeStatistics {
    /// Whether noise hides ridges at this scale.
    pub fn is_drowned(&self) -> bool {
        self.noise > MAX_NOISE_RATIO * self.typical
    }

    /// Strengths down to which a sheet is followed, and which it must reach somewhere: above the
    /// noise, and a share of the typical ridge's; but not so high that typical ridges are lost, unless
    /// they drown in noise.
    pub fn thresholds(&self) -> (f32, f32) {
        let low = (1.75 * self.noise).max(0.25 * self.typical);
        let high = (2.5 * self.noise).max(0.5 * self.typical);
        if !self.is_drowned() {
            (low.min(0.5 * self.typical), high.min(0.9 * self.typical))
        } else {
            (low, high)
        }
    }
}

/// Measures [`RidgeStatistics`] for [`ridges`], where features may lie.
///
/// # Errors
/// That of reading.
pub fn statistics<const D: usize>(
    samples: &Samples<'_, D>,
    sigma: f64,
    live: Option<&LiveMask<D>>,
    patience: &CancelToken<'_>,
) -> Result<RidgeStatistics> {
    let every = if D == 3 { 16 } else { 1 };
    let mut parts: Vec<(Vec<f32>, Vec<f32>)> = Vec::new();
    let some = |own: &WindowInterior| {
        let number = own.layers.start / own.layers.len();
        usize::from(number.is_multiple_of(samples.window_stride()))
    };
    let mut measure = |window: &LayerWindow<'_, D>| {
        window.map_rows(patience, |first, curvature: &mut Curvature, parts| {
            let place = window.smoothed.to_volume(first);
            let number: usize = (1..D).map(|k| place[k] * [1, 1, 7][k]).sum();
            if !number.is_multiple_of(every) {
                return;
            }
            curvature.measure(window.smoothed.volume, first);
            let mut found = Vec::new();
            ridges_of_row(window, sigma, 0.0, first, curvature, &mut found);
            let [lowest, next] = &curvature.lowest_eigenvalues;
            let magnitude = |x: usize| lateral_curvature::<D>(lowest[x], next[x]);
            let is_usable = |x: &usize| {
                let at = std::array::from_fn(|k| if k == 0 { *x } else { place[k] });
                live.is_none_or(|live| live.is_usable(at))
            };
            let magnitudes = (0..lowest.len()).step_by(2).filter(is_usable);
            let whole = Volume::new(window.dims, &[]);
            let found = found.iter().filter(|c| {
                live.is_none_or(|live| live.is_usable(whole.coordinates(c.voxel.index())))
            });
            parts.push((
                magnitudes.map(magnitude).collect(),
                found.map(|c| c.strength).collect(),
            ));
        })
    };
    let mut take = |found: Vec<(Vec<f32>, Vec<f32>)>| parts.extend(found);
    samples.for_each_window(
        DIFFERENCE_REACH,
        None,
        &some,
        patience,
        &mut measure,
        &mut take,
    )?;
    let mut magnitudes: Vec<f32> = parts.iter().flat_map(|p| p.0.iter().copied()).collect();
    let middle = magnitudes.len() / 2;
    let median = if middle > 0 {
        *magnitudes.select_nth_unstable_by(middle, f32::total_cmp).1
    } else {
        0.0
    };
    Ok(RidgeStatistics {
        noise: (f64::from(median) * noise_per_median(D) * sigma * sigma * HEIGHT_FACTOR) as f32,
        typical: typical_strength(parts.iter().flat_map(|p| p.1.iter().copied())),
    })
}

/// The typical strength, which the strong ones decide: sum of cubes over sum of squares.
pub fn typical_strength(strengths: impl Iterator<Item = f32>) -> f32 {
    let (mut squares, mut cubes) = (0.0f64, 0.0f64);
    for s in strengths.map(f64::from) {
        squares += s * s;
        cubes += s * s * s;
    }
    strong_mean([squares, cubes])
}

/// A mean that the strong ones decide, of the sums of their squares and cubes.
fn strong_mean([squares, cubes]: [f64; 2]) -> f32 {
    match squares > 0.0 {
        true => (cubes / squares) as f32,
        false => 0.0,
    }
}

/// The same of the candidates of all ranks.
///
/// # Errors
/// Those of other ranks.
pub fn global_typical_strength<const D: usize>(slab: &CandidateSlab<'_, D>) -> Result<f32> {
    let powers = |i: usize| {
        let s = f64::from(slab.candidates[i].strength);
        Some([s * s, s * s * s])
    };
    slab.sums_by_layer("strengths of ridges", powers)
        .map(strong_mean)
}

/// How much an image curves in directions in which a sheet does not bend it: the magnitude of the
/// Hessian's middle eigenvalue, in 2-D of the smaller one.
fn lateral_curvature<const D: usize>(lowest: f32, next: f32) -> f32 {
    if D == 3 {
        next.abs()
    } else {
        lowest.abs().min(next.abs())
    }
}

/// Ridge points of the row of x from `first`.
fn ridges_of_row<const D: usize>(
    window: &LayerWindow<'_, D>,
    sigma: f64,
    low: f32,
    first: [usize; D],
    curvature: &Curvature,
    found: &mut Vec<Candidate<D>>,
) {
    // The most negative eigenvalue carries at least a third of a negative Laplacian; across a sheet
    // it carries nearly all of it, and noise in the other two takes off less than a half.
    let scale = (HEIGHT_FACTOR * sigma * sigma) as f32;
    let (least, bound) = (-low / scale, -0.5 * low / scale);
    let smoothed = window.smoothed.volume;
    let [lowest, next] = &curvature.lowest_eigenvalues;
    let row = lowest.iter().zip(&curvature.laplacian);
    for (x, (&lowest, &laplacian)) in row.enumerate() {
        if laplacian >= bound || lowest > least {
            continue;
        }
        let mut at = first;
        at[0] = x;
        let hessian = smoothed.second_derivatives(at);
        let values = eigenvalues(&hessian);
        for (i, value) in [lowest, next[x]].into_iter().enumerate() {
            if value >= 0.0 || value > least || (i == 1 && value > MIN_SECOND_RATIO * lowest) {
                break;
            }
            let w = eigenvector(&hessian, values[i]);
            for axis in dominant_axes(w) {
                if let Some(offset) = ridge_offset(smoothed, at, w, axis) {
                    let strength = -value * scale;
                    let at = window.smoothed.to_volume(at);
                    found.push(Candidate::new(window.dims, at, axis, offset, w, strength));
                }
            }
        }
    }
}

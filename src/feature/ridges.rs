//! Finds ridges of a volume at sub-sample positions.
//!
//! A ridge (Hale 2002) is a zero crossing of the derivative along the direction w in which the
//! image curves down the most. Here w is the eigenvector of the smoothed image's Hessian with the
//! most negative eigenvalue (Steger 1998, "An unbiased detector of curvilinear structures"). The
//! structure tensor has a window of several sigma, which mixes the two orientations of crossing
//! surfaces; the Hessian looks no farther than the smoothing. Where a second eigenvalue is strongly
//! negative, too, surfaces cross, and both directions are tried.
//!
//! A zero crossing is searched for along the axis nearest to w, between the sample and its two
//! neighbours, with w held fixed. So every column of samples that the surface passes gets one
//! point, without holes and duplicates.

use super::candidate::{Candidate, dominant_axes, ridge_offset};
use super::hessian::Curvature;
use super::shared_grid::CandidateSlab;
use super::windows::{LayerWindow, Samples, WindowInterior};
use crate::error::Result;
use crate::feature::volume::Volume;
use crate::geometry::eigen::{eigenvalues, eigenvector};
use crate::geometry::statistics::upper_median;
use crate::image::LiveMask;
use crate::progress::CancelToken;

/// Ratio of the height of a Gaussian ridge to -sigma^2 times its second derivative in the smoothed
/// image, if the ridge is as wide as the smoothing.
pub const HEIGHT_FACTOR: f64 = 2.828_427_124_746_19;

/// The second direction is tried if its eigenvalue is at least this share of the first one.
const MIN_SECOND_RATIO: f32 = 0.4;

/// Distance (samples) that finite differences look.
pub const DIFFERENCE_REACH: usize = 3;

/// Returns the ridge points whose strength is at least `low`, in the order of samples, in the
/// interior of a window with a halo of [`DIFFERENCE_REACH`], smoothed by a Gaussian of width
/// `sigma` samples.
///
/// The strength is -sigma^2 times the second derivative across the ridge, scaled so that it is the
/// height of a ridge that was a Gaussian of width `sigma` before smoothing.
pub fn ridges<const D: usize>(
    window: &LayerWindow<'_, D>,
    sigma: f64,
    low: f32,
    cancel: &CancelToken<'_>,
) -> Vec<Candidate<D>> {
    window.map_rows(cancel, |first, curvature: &mut Curvature, found| {
        curvature.measure(window.smoothed.volume, first);
        ridges_of_row(window, sigma, low, first, curvature, found);
    })
}

/// Returns the standard deviation of the Laplacian of smoothed white noise, divided by the median
/// of [`lateral_curvature`]. The diagonal entries of its Hessian have variance 3 and covariance 1,
/// the other entries variance 1.
const fn noise_per_median(dimensions: usize) -> f64 {
    if dimensions == 3 { 4.061 } else { 3.941 }
}

/// Ratio of noise to typical strength (1 if there is only white noise) above which noise hides
/// ridges.
const MAX_NOISE_RATIO: f32 = 0.5;

/// Statistics of ridge strengths, measured on one row in 16 (in 2-D on all rows); in large volumes,
/// in some of the layers.
#[derive(Debug, Clone, Copy)]
pub struct RidgeStatistics {
    /// Standard deviation of the Laplacian due to noise, in units of strength. Surfaces bend the
    /// image in one direction only, so that the other eigenvalues of the Hessian measure noise even
    /// where surfaces are dense.
    pub noise: f32,
    /// Typical strength of strong ridges: sum of cubes divided by sum of squares.
    pub typical: f32,
}

impl RidgeStatistics {
    /// Returns `true` if noise hides ridges at this scale.
    pub fn is_hidden_by_noise(&self) -> bool {
        self.noise > MAX_NOISE_RATIO * self.typical
    }

    /// Returns the strength down to which a surface is followed, and the one that it must reach
    /// somewhere. Both are above the noise and at least a share of the typical strength, but not so
    /// high that typical ridges are lost, unless noise hides these.
    pub fn thresholds(&self) -> (f32, f32) {
        let low = (1.75 * self.noise).max(0.25 * self.typical);
        let high = (2.5 * self.noise).max(0.5 * self.typical);
        if !self.is_hidden_by_noise() {
            (low.min(0.5 * self.typical), high.min(0.9 * self.typical))
        } else {
            (low, high)
        }
    }
}

/// Measures [`RidgeStatistics`] for [`ridges`] at samples where features may lie.
///
/// # Errors
/// Returns the errors of reading.
pub fn statistics<const D: usize>(
    samples: &Samples<'_, D>,
    sigma: f64,
    live: Option<&LiveMask<D>>,
    cancel: &CancelToken<'_>,
) -> Result<RidgeStatistics> {
    let row_stride = if D == 3 { 16 } else { 1 };
    let mut parts: Vec<(Vec<f32>, Vec<f32>)> = Vec::new();
    let work_of = |interior: &WindowInterior| {
        let number = interior.layers.start / interior.layers.len();
        usize::from(number.is_multiple_of(samples.window_stride()))
    };
    let mut measure = |window: &LayerWindow<'_, D>| {
        window.map_rows(cancel, |first, curvature: &mut Curvature, parts| {
            let position = window.smoothed.to_volume(first);
            let number: usize = (1..D).map(|k| position[k] * [1, 1, 7][k]).sum();
            if !number.is_multiple_of(row_stride) {
                return;
            }
            curvature.measure(window.smoothed.volume, first);
            let mut found = Vec::new();
            ridges_of_row(window, sigma, 0.0, first, curvature, &mut found);
            let [lowest, next] = &curvature.lowest_eigenvalues;
            let magnitude = |x: usize| lateral_curvature::<D>(lowest[x], next[x]);
            let is_usable = |x: &usize| {
                let at = std::array::from_fn(|k| if k == 0 { *x } else { position[k] });
                live.is_none_or(|live| live.is_usable(at))
            };
            let magnitudes = (0..lowest.len()).step_by(2).filter(is_usable);
            let volume = Volume::new(window.dims, &[]);
            let found = found.iter().filter(|c| {
                live.is_none_or(|live| live.is_usable(volume.coordinates(c.voxel.index())))
            });
            parts.push((
                magnitudes.map(magnitude).collect(),
                found.map(|c| c.strength).collect(),
            ));
        })
    };
    let mut take = |rows: Vec<(Vec<f32>, Vec<f32>)>| parts.extend(rows);
    samples.for_each_window(
        DIFFERENCE_REACH,
        None,
        &work_of,
        cancel,
        &mut measure,
        &mut take,
    )?;
    let mut magnitudes: Vec<f32> = parts.iter().flat_map(|p| p.0.iter().copied()).collect();
    let median = upper_median(&mut magnitudes).filter(|_| magnitudes.len() > 1);
    Ok(RidgeStatistics {
        noise: (f64::from(median.unwrap_or(0.0))
            * noise_per_median(D)
            * sigma
            * sigma
            * HEIGHT_FACTOR) as f32,
        typical: typical_strength(parts.iter().flat_map(|p| p.1.iter().copied())),
    })
}

/// Returns the typical strength, which strong candidates dominate: sum of cubes divided by sum of
/// squares.
pub fn typical_strength(strengths: impl Iterator<Item = f32>) -> f32 {
    let (mut squares, mut cubes) = (0.0f64, 0.0f64);
    for s in strengths.map(f64::from) {
        squares += s * s;
        cubes += s * s * s;
    }
    strong_mean([squares, cubes])
}

/// Returns the mean that strong values dominate, from the sums of squares and cubes.
fn strong_mean([squares, cubes]: [f64; 2]) -> f32 {
    if squares > 0.0 {
        (cubes / squares) as f32
    } else {
        0.0
    }
}

/// Returns the typical strength of the candidates of all ranks; see [`typical_strength`].
///
/// # Errors
/// Returns the errors of other ranks.
pub fn global_typical_strength<const D: usize>(slab: &CandidateSlab<'_, D>) -> Result<f32> {
    let powers = |i: usize| {
        let s = f64::from(slab.candidates[i].strength);
        Some([s * s, s * s * s])
    };
    slab.sums_by_layer("strengths of ridges", powers)
        .map(strong_mean)
}

/// Returns how much an image curves in directions in which a surface does not bend it: the
/// magnitude of the middle eigenvalue of the Hessian; in 2-D, the smaller magnitude.
fn lateral_curvature<const D: usize>(lowest: f32, next: f32) -> f32 {
    if D == 3 {
        next.abs()
    } else {
        lowest.abs().min(next.abs())
    }
}

/// Adds the ridge points of the row of x from `first`.
fn ridges_of_row<const D: usize>(
    window: &LayerWindow<'_, D>,
    sigma: f64,
    low: f32,
    first: [usize; D],
    curvature: &Curvature,
    found: &mut Vec<Candidate<D>>,
) {
    // The most negative eigenvalue is at least a third of a negative Laplacian. Across a surface it
    // is nearly all of it, and noise in the other two takes off less than a half.
    let scale = (HEIGHT_FACTOR * sigma * sigma) as f32;
    let (max_eigenvalue, max_laplacian) = (-low / scale, -0.5 * low / scale);
    let smoothed = window.smoothed.volume;
    let [lowest, next] = &curvature.lowest_eigenvalues;
    let row = lowest.iter().zip(&curvature.laplacian);
    for (x, (&lowest, &laplacian)) in row.enumerate() {
        if laplacian >= max_laplacian || lowest > max_eigenvalue {
            continue;
        }
        let mut at = first;
        at[0] = x;
        let hessian = smoothed.second_derivatives(at);
        let values = eigenvalues(&hessian);
        for (i, value) in [lowest, next[x]].into_iter().enumerate() {
            if value >= 0.0
                || value > max_eigenvalue
                || (i == 1 && value > MIN_SECOND_RATIO * lowest)
            {
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

//! Edges as Canny (1986) and, in space too, Xu (2016) find them.
//!
//! The image is smoothed by a Gaussian; a sample is an edge's where the magnitude of the gradient is
//! largest along the gradient (non-maximum suppression), at the sub-sample position where its
//! derivative along that direction passes through zero. Two thresholds then tell edges from noise:
//! a weak edge is kept where it continues a strong one (hysteresis), which is what
//! [`sheets`](mod@super::sheets) does for every kind of feature.

use super::crossing::{Candidate, along_axis, dominant_axes};
use super::volume::Volume;
use crate::geometry::wide::wide;
use rayon::prelude::*;

/// The magnitude of the gradient by central differences, in units of the image a sample; outside,
/// samples repeat those of the sides.
pub fn steepness<const D: usize>(volume: Volume<'_, D>) -> Vec<f32> {
    let nx = volume.dims[0];
    let mut out = vec![0.0; volume.samples.len()];
    out.par_chunks_mut(nx.max(1))
        .enumerate()
        .for_each(|(row, out)| {
            wide(
                #[inline(always)]
                || steepness_of_row(volume, row * nx, out),
            );
        });
    out
}

#[inline(always)]
fn steepness_of_row<const D: usize>(volume: Volume<'_, D>, start: usize, out: &mut [f32]) {
    let nx = out.len();
    let (before, after) = volume.neighbours(volume.coordinates(start));
    let line = &volume.samples[start..start + nx];
    let last = nx - 1;
    for (x, out) in out.iter_mut().enumerate() {
        *out = (line[(x + 1).min(last)] - line[x.saturating_sub(1)]).powi(2);
    }
    for k in 1..D {
        let low = &volume.samples[start - before[k]..][..nx];
        let high = &volume.samples[start + after[k]..][..nx];
        for ((out, low), high) in out.iter_mut().zip(low).zip(high) {
            *out += (high - low).powi(2);
        }
    }
    for out in out {
        *out = 0.5 * out.sqrt();
    }
}

/// Edges whose steepness is at least `low`, and above zero, in the order of samples, of a smoothed
/// volume of which `steepness` is the [`steepness`].
pub fn edges<const D: usize>(
    smoothed: Volume<'_, D>,
    steepness: Volume<'_, D>,
    low: f32,
) -> Vec<Candidate<D>> {
    smoothed.by_rows(|first, (): &mut (), found| {
        let start = smoothed.index(first);
        let row = &steepness.samples[start..start + smoothed.dims[0]];
        for (x, &steep) in row.iter().enumerate() {
            if steep < low || steep <= 0.0 {
                continue;
            }
            let mut at = first;
            at[0] = x;
            let normal = smoothed
                .gradient(at)
                .map(|g| f64::from(g) / f64::from(steep));
            for axis in dominant_axes(normal) {
                if let Some(offset) = along_axis(steepness, at, normal, axis) {
                    let found_here = Candidate::new(smoothed.dims, at, axis, offset, normal, steep);
                    found.push(found_here);
                }
            }
        }
    })
}

/// Shares of the samples of pure noise that reach the lower and the higher threshold.
pub const FALSE_ALARMS: [f64; 2] = [1e-2, 1e-5];

/// Gradients of smoothed white noise have D independent, normally distributed components: medians of
/// their magnitude, and what it exceeds at the shares of samples of [`FALSE_ALARMS`], in units of one
/// component's standard deviation (quantiles of the chi distribution of D degrees of freedom).
const fn of_noise(dimensions: usize) -> (f32, [f32; 2]) {
    if dimensions == 3 {
        (1.5382, [3.3682, 5.0894])
    } else {
        (1.1774, [3.0349, 4.7985])
    }
}

/// Thresholds (low, high) that noise hardly reaches: half of an image or more is taken for noise on
/// even ground, so the median of the gradient's magnitude tells how strong that is.
pub fn above_noise<const D: usize>(steepness: &[f32]) -> [f32; 2] {
    // Some 10^5 samples tell the median to a per cent.
    let stride = (steepness.len() / 200_000).max(1) | 1;
    let mut some: Vec<f32> = steepness.iter().step_by(stride).copied().collect();
    let middle = some.len() / 2;
    if some.is_empty() {
        return [0.0; 2];
    }
    let median = *some.select_nth_unstable_by(middle, f32::total_cmp).1;
    let (of_median, exceeded) = of_noise(D);
    exceeded.map(|e| e / of_median * median)
}

/// Thresholds (low, high) of edges: above the noise, and at least a tenth and a quarter of the typical
/// edge's strength (sum of cubes over sum of squares, which the strong ones decide), so that faint
/// edges of an image without noise are left out; but where there is no even ground and the median is
/// not noise, at most half and nine tenths of it.
pub fn thresholds<const D: usize>(noise: [f32; 2], candidates: &[Candidate<D>]) -> [f32; 2] {
    let (mut squares, mut cubes) = (0.0f64, 0.0f64);
    for s in candidates.iter().map(|c| f64::from(c.strength)) {
        squares += s * s;
        cubes += s * s * s;
    }
    let typical = if squares > 0.0 { cubes / squares } else { 0.0 } as f32;
    let [low, high] = noise;
    [
        low.max(0.1 * typical).min(0.5 * typical),
        high.max(0.25 * typical).min(0.9 * typical),
    ]
}

#[cfg(test)]
mod tests;

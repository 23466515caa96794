//! Traces on the two sides of a fault, and the lag at which they agree.
//!
//! A trace runs down along the dip of the fault, in its tangent plane, at a distance from it. Where
//! a fault has displaced layers along its dip, the trace on one side equals that on the other side
//! after a shift by the throw. Layers may dip across the fault: several traces on a side give that
//! dip, and are averaged after each has been moved along it to the fault. The shift is the lag at
//! which the normalised cross-correlation of both averages is largest.

use crate::geometry::{add_scaled, dot};
use crate::image::Image;

/// Half the length (samples along the vertical axis) of the traces that are compared.
const HALF_WINDOW: usize = 16;

/// Largest throw that is found, in samples along the vertical axis.
pub(crate) const MAX_LAG: usize = 30;

/// Half the length of a trace, so that windows at every lag lie in it.
const HALF_TRACE: usize = HALF_WINDOW + MAX_LAG / 2 + 1;

/// Distances (samples) of the traces from the fault. Nearer ones contain the wavelets of layers
/// beyond it.
const OFFSETS: [f64; 4] = [4.5, 6.0, 7.5, 9.0];

/// Largest slope of layers relative to the fault's horizontal normal (samples along the vertical
/// axis for each sample across).
const MAX_SLOPE: f64 = 1.0;

/// Step of the slopes that are tried.
const SLOPE_STEP: f64 = 0.05;

/// Smallest share of a window that must lie in the image.
const MIN_WINDOW_SHARE: f64 = 0.9;

/// Smallest square of the horizontal component of a fault's normal; with a smaller one, the fault is too
/// flat.
const MIN_HORIZONTAL_SQUARE: f64 = 0.03;

/// The place and the directions of a pair of traces, in samples.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FaultPoint<const D: usize> {
    /// Point on the fault.
    pub position: [f64; D],
    /// Unit normal of the fault, into the hanging wall.
    pub normal: [f64; D],
}

/// The correlation of the traces on both sides of a point on a fault.
#[derive(Debug, Clone)]
pub(crate) struct Correlation {
    /// Normalised cross-correlation at the lags from `-MAX_LAG` to `MAX_LAG`; NaN where the traces
    /// leave the image.
    pub by_lag: Vec<f32>,
    /// How much better traces on one side agree than those on both sides at lag 0.
    pub contrast: f64,
}

/// Traces of one side, moved along the layers to the fault and averaged.
struct Side {
    mean: Vec<f64>,
    is_inside: Vec<bool>,
    /// Mean correlation of any two traces of the side.
    coherence: f64,
}

impl<const D: usize> FaultPoint<D> {
    /// Correlates the traces on both sides. `vertical` is the vertical axis and `mean` the mean of
    /// the image. Returns `None` if the fault is too flat, or too near to a side of the image.
    pub fn correlate(&self, image: &Image<D>, vertical: usize, mean: f64) -> Option<Correlation> {
        let rise = self.normal[vertical];
        let horizontal_square = 1.0 - rise * rise;
        if horizontal_square < MIN_HORIZONTAL_SQUARE {
            return None;
        }
        let mut axis = [0.0; D];
        axis[vertical] = 1.0;
        // Across, one sample off the fault.
        let along = self.down_dip(vertical);
        let across = add_scaled(self.normal, -rise, axis).map(|c| c / horizontal_square);
        let side = |sign: f64| self.side(image, along, across.map(|c| sign * c), mean);
        let (foot, hanging) = (side(-1.0)?, side(1.0)?);
        let lags = -(MAX_LAG as isize)..=MAX_LAG as isize;
        let unshifted = correlation_at(&foot, &hanging, 0)?;
        Some(Correlation {
            by_lag: lags
                .map(|lag| correlation_at(&foot, &hanging, lag).map_or(f32::NAN, |c| c as f32))
                .collect(),
            contrast: 0.5 * (foot.coherence + hanging.coherence) - unshifted,
        })
    }

    /// Returns the step along the dip of the fault that is one sample along the vertical axis.
    pub fn down_dip(&self, vertical: usize) -> [f64; D] {
        let rise = self.normal[vertical];
        let mut axis = [0.0; D];
        axis[vertical] = 1.0;
        let along = add_scaled(axis, -rise, self.normal);
        along.map(|c| c / (1.0 - rise * rise).max(MIN_HORIZONTAL_SQUARE))
    }

    /// Returns the traces of a side. `across` is the step away from the fault.
    fn side(&self, image: &Image<D>, along: [f64; D], across: [f64; D], mean: f64) -> Option<Side> {
        // Traces are long enough to be shifted by the largest slope.
        let reach = MAX_SLOPE * OFFSETS[OFFSETS.len() - 1];
        let half = HALF_TRACE + reach.ceil() as usize + 1;
        let dims = image.dims();
        let trace = |offset: f64| -> Vec<f64> {
            let foot = add_scaled(self.position, offset, across);
            (0..=2 * half)
                .map(|u| {
                    let x = add_scaled(foot, u as f64 - half as f64, along);
                    let is_inside = (0..D).all(|k| x[k] >= 0.0 && x[k] <= (dims[k] - 1) as f64);
                    if is_inside {
                        f64::from(image.interpolate_linear(x)) - mean
                    } else {
                        f64::NAN
                    }
                })
                .collect()
        };
        let traces = OFFSETS.map(trace);
        let shifted = |slope: f64, u: isize| -> [f64; OFFSETS.len()] {
            std::array::from_fn(|i| {
                let x = half as f64 + u as f64 + slope * OFFSETS[i];
                let low = x as usize;
                let t = x - low as f64;
                (1.0 - t) * traces[i][low] + t * traces[i][low + 1]
            })
        };
        let window = -(HALF_WINDOW as isize)..=HALF_WINDOW as isize;
        let semblance = |slope: f64| -> f64 {
            let (mut total, mut each) = (0.0, 0.0);
            for u in window.clone() {
                let values = shifted(slope, u);
                let sum: f64 = values.iter().sum();
                if !sum.is_nan() {
                    total += sum * sum;
                    each += dot(values, values);
                }
            }
            total / (OFFSETS.len() as f64 * each).max(f64::MIN_POSITIVE)
        };
        let steps = (MAX_SLOPE / SLOPE_STEP).round() as isize;
        let semblances: Vec<f64> = (-steps..=steps)
            .map(|k| semblance(k as f64 * SLOPE_STEP))
            .collect();
        let (place, best) = parabola_peak(&semblances, 0..semblances.len())?;
        if best <= 0.0 {
            return None;
        }
        let slope = (place - steps as f64) * SLOPE_STEP;
        let average = |u: isize| shifted(slope, u).iter().sum::<f64>() / OFFSETS.len() as f64;
        let mean: Vec<f64> = (-(HALF_TRACE as isize)..=HALF_TRACE as isize)
            .map(average)
            .collect();
        let count = OFFSETS.len() as f64;
        Some(Side {
            is_inside: mean.iter().map(|m| !m.is_nan()).collect(),
            mean: mean
                .iter()
                .map(|m| if m.is_nan() { 0.0 } else { *m })
                .collect(),
            coherence: (count * best - 1.0) / (count - 1.0),
        })
    }
}

/// Returns the correlation of the footwall with the hanging wall `lag` samples further along the
/// vertical axis. Returns `None` where too little of them lies in the image.
fn correlation_at(foot: &Side, hanging: &Side, lag: isize) -> Option<f64> {
    let (back, forth) = (lag.div_euclid(2), lag - lag.div_euclid(2));
    let (mut product, mut squares, mut count) = (0.0, [0.0; 2], 0);
    for u in 0..=2 * HALF_WINDOW as isize {
        let centre = u + (HALF_TRACE - HALF_WINDOW) as isize;
        let (i, j) = ((centre - back) as usize, (centre + forth) as usize);
        if foot.is_inside[i] && hanging.is_inside[j] {
            let (a, b) = (foot.mean[i], hanging.mean[j]);
            product += a * b;
            squares = [squares[0] + a * a, squares[1] + b * b];
            count += 1;
        }
    }
    if f64::from(count) < MIN_WINDOW_SHARE * (2 * HALF_WINDOW + 1) as f64 {
        return None;
    }
    let energy: f64 = squares[0] * squares[1];
    Some(product / energy.sqrt().max(f64::MIN_POSITIVE))
}

/// Returns the lag of the largest correlation between the lags `low` and `high`, and that correlation.
/// Returns `None` if fewer than `min_share` of the correlations in that range are known.
pub(crate) fn best_lag(
    by_lag: &[f32],
    low: isize,
    high: isize,
    min_share: f64,
) -> Option<(f64, f64)> {
    let max = MAX_LAG as isize;
    let index = |lag: isize| (lag.clamp(-max, max) + max) as usize;
    let range = index(low)..index(high) + 1;
    let known = by_lag[range.clone()].iter().filter(|c| !c.is_nan()).count();
    if (known as f64) < min_share * range.len() as f64 {
        return None;
    }
    let values: Vec<f64> = by_lag.iter().map(|&c| f64::from(c)).collect();
    let (place, peak) = parabola_peak(&values, range)?;
    Some((place - MAX_LAG as f64, peak))
}

/// Returns the position of the largest value in a range, to a fraction by the parabola through it and
/// its neighbours, and that value. NaN is smaller than any number.
fn parabola_peak(values: &[f64], range: std::ops::Range<usize>) -> Option<(f64, f64)> {
    let known = range.filter(|&k| !values[k].is_nan());
    let best = known.reduce(|best, k| if values[k] > values[best] { k } else { best })?;
    let peak = values[best];
    let shift = match (best.checked_sub(1), values.get(best + 1)) {
        (Some(before), Some(after)) if values[before] + after < 2.0 * peak => {
            let bend = values[before] - 2.0 * peak + after;
            (0.5 * (values[before] - after) / bend).clamp(-0.5, 0.5)
        }
        _ => 0.0,
    };
    Some((best as f64 + shift, peak))
}

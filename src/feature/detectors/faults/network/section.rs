//! Probability of faults in a section: the mean over the section and copies of it.
//!
//! Copies are mirrored with opposite sign, which must not change where faults are, and have their
//! traces twice as close, by cubic interpolation (Keys 1981). Where the copies agree, the mean is
//! high; chance agreements of noise are rare.

use super::super::semblance::balance_amplitudes;
use super::{Network, fault_network, grid_dims};
use crate::feature::volume::Volume;
use crate::progress::CancelToken;

/// Weights of the four samples around a place a quarter of a sample after the second of them: Keys' cubic
/// convolution.
const QUARTER_WEIGHTS: [f32; 4] = [-0.0703125, 0.8671875, 0.2265625, -0.0234375];

/// The networks that look at a section, and the axis along its layers.
pub struct Networks {
    network: Network,
    mirrored: Network,
    horizontal: usize,
}

impl Networks {
    pub fn new<const D: usize>(vertical: usize) -> Self {
        Self {
            network: fault_network::<D>(vertical, false),
            mirrored: fault_network::<D>(vertical, true),
            horizontal: 1 - vertical,
        }
    }

    /// Returns the mean probability at each sample of `amplitude`, whose image has the root mean
    /// square `rms`.
    pub fn probabilities<const D: usize>(
        &self,
        amplitude: Volume<'_, D>,
        rms: f32,
        cancel: &CancelToken<'_>,
    ) -> Vec<f32> {
        let mut mean = self.sum(amplitude, rms, cancel);
        let doubled = double(amplitude, self.horizontal);
        let mut doubled_dims = amplitude.dims;
        doubled_dims[self.horizontal] *= 2;
        let sums = self.sum(Volume::new(doubled_dims, &doubled), rms, cancel);
        let stride = stride(amplitude.dims, self.horizontal);
        for (i, mean) in mean.iter_mut().enumerate() {
            let first = i / stride * 2 * stride + i % stride;
            let pair = 0.5 * (sums[first] + sums[first + stride]);
            *mean = 0.25 * (*mean + pair);
        }
        mean
    }

    /// Returns the sum of the probabilities of the section and of its mirror image with opposite sign.
    fn sum<const D: usize>(
        &self,
        amplitude: Volume<'_, D>,
        rms: f32,
        cancel: &CancelToken<'_>,
    ) -> Vec<f32> {
        let dims = grid_dims(amplitude.dims);
        let mut balanced = balance_amplitudes(amplitude, rms, cancel);
        let mut sum = self.network.probabilities(dims, &balanced, cancel);
        balanced.iter_mut().for_each(|value| *value = -*value);
        let other = self.mirrored.probabilities(dims, &balanced, cancel);
        sum.iter_mut().zip(&other).for_each(|(s, o)| *s += o);
        sum
    }
}

/// Returns the distance in memory between neighbours along an axis.
fn stride<const D: usize>(dims: [usize; D], axis: usize) -> usize {
    dims[..axis].iter().product()
}

/// Returns the samples with two in place of each along `axis`, a quarter of a sample before and after it.
fn double<const D: usize>(amplitude: Volume<'_, D>, axis: usize) -> Vec<f32> {
    let (dims, samples) = (amplitude.dims, amplitude.samples);
    let (stride, count) = (stride(dims, axis), dims[axis]);
    let sample = |index: usize| {
        let (inner, at) = (index % stride, index / stride % (2 * count));
        let line = index / (stride * 2 * count) * stride * count + inner;
        let (from, side) = (at / 2, if at % 2 == 0 { -1 } else { 1 });
        let weighted = |(k, weight): (usize, &f32)| {
            let neighbour = from as isize + side * (k as isize - 1);
            let neighbour = neighbour.clamp(0, count as isize - 1) as usize;
            weight * samples[line + neighbour * stride]
        };
        QUARTER_WEIGHTS.iter().enumerate().map(weighted).sum()
    };
    (0..2 * samples.len()).map(sample).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doubling_interpolates_straight_lines_and_parabolas_exactly() {
        for axis in [0, 1] {
            let dims = [9, 7];
            let value = |along: f64, across: f64| 0.3 * along * along - along + 2.0 * across;
            let at = |i: usize, dims: [usize; 2]| [i % dims[0], i / dims[0]].map(|c| c as f64);
            let samples: Vec<f32> = (0..63)
                .map(|i| value(at(i, dims)[axis], at(i, dims)[1 - axis]) as f32)
                .collect();
            let doubled = double(Volume::new(dims, &samples), axis);
            let mut doubled_dims = dims;
            doubled_dims[axis] *= 2;
            for (i, found) in doubled.iter().enumerate() {
                let p = at(i, doubled_dims);
                let along = 0.5 * p[axis] - 0.25;
                if along > 1.0 && along < dims[axis] as f64 - 2.0 {
                    let expected = value(along, p[1 - axis]) as f32;
                    assert!((found - expected).abs() < 1e-4, "{p:?} {found} {expected}");
                }
            }
        }
    }
}

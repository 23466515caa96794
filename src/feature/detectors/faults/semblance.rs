//! Where waveforms do not continue along the layers.
//!
//! Semblance compares the energy of a mean with the mean energy. Means are taken over a patch of the
//! layer round each sample (structure-oriented semblance: Marfurt et al. 1998, Hale 2013). Where a
//! fault throws the layers, the patch joins waveforms that do not match, and semblance falls. Noise
//! lowers it too, so numerator and denominator are smoothed before they are divided, over pieces of
//! all the planes that a fault might run along: [`scan`].

use super::scan;
use crate::feature::gaussian::smooth;
use crate::feature::ridges::Statistics;
use crate::feature::tensor::Normals;
use crate::feature::volume::{Volume, root_mean_square};
use crate::observer::Patience;
use rayon::prelude::*;

/// Disc of a layer: radius and standard deviation (samples) of its weights.
const LAYER: Disc = Disc {
    radius: 3,
    width: 2.0,
};

/// Width (samples) of the Gaussian under which the rms of amplitudes is taken.
const BALANCE: f64 = 6.0;

/// Energy, as a share of the image's mean, that amplitudes are not balanced below: there is only noise.
const LOUD: f32 = 0.3;

/// Energy of balanced amplitudes that counts as alike anywhere: where it is quiet there are no faults.
const QUIET: f32 = 0.1;

/// Rows per parallel task.
const ROWS: usize = 64;

/// How likely a fault runs through each sample, in [0, 1]: see [`scan::likelihood`]. `layers` are the
/// normals of amplitudes smoothed to the scale of their derivatives; their window should be wide, as
/// a throw must not pass for a dip.
pub fn likelihood<const D: usize>(
    amplitude: Volume<'_, D>,
    layers: &Normals<D>,
    patience: &Patience<'_>,
) -> Vec<f32> {
    let dims = amplitude.dims;
    let a = &balanced(amplitude, patience)[..];
    let [mut of_mean, mut mean_of] = in_patches(dims, layers, &LAYER, patience, |i, j, t| {
        let value = a[i] + t * (a[j] - a[i]);
        [value, value * value]
    });
    of_mean.par_iter_mut().for_each(|m| *m = *m * *m + QUIET);
    mean_of.par_iter_mut().for_each(|m| *m += QUIET);
    scan::likelihood(dims, [of_mean, mean_of], layers.main_axis(), patience)
}

/// Amplitudes over their rms round each sample, so that no layer has more say than others.
fn balanced<const D: usize>(amplitude: Volume<'_, D>, patience: &Patience<'_>) -> Vec<f32> {
    let a = amplitude.samples;
    let mut energy: Vec<f32> = a.par_iter().map(|a| a * a).collect();
    smooth(amplitude.dims, &mut energy, [BALANCE; D], patience);
    let floor = LOUD * root_mean_square(a).powi(2);
    energy.par_iter_mut().zip(a).for_each(|(e, a)| {
        *e = a / (*e + floor).max(f32::MIN_POSITIVE).sqrt();
    });
    energy
}

/// Likelihood down to which a fault is followed, and which it must reach somewhere; or these
/// multiples of the noise, if they are more.
pub const LEAST: [f32; 2] = [0.035, 0.1];
const OVER_NOISE: [f32; 2] = [1.75, 2.5];

/// Thresholds for the ridges of [`likelihood`]: semblance is a share, so they are the same for all
/// images, unless there is much noise.
pub fn thresholds(statistics: &Statistics) -> (f32, f32) {
    let least = |i: usize| LEAST[i].max(OVER_NOISE[i] * statistics.noise);
    (least(0), least(1))
}

/// A disc of samples with Gaussian weights.
struct Disc {
    radius: i32,
    width: f32,
}

impl Disc {
    /// Offsets in the plane of the axes other than `axis`, and their weights.
    fn offsets<const D: usize>(&self, axis: usize) -> Vec<([i32; D], f32)> {
        let line: Vec<i32> = (-self.radius..=self.radius).collect();
        let all = (0..line.len().pow(D as u32 - 1)).map(|number| {
            let mut rest = number;
            let mut offset = [0; D];
            for k in 1..D {
                offset[(axis + k) % D] = line[rest % line.len()];
                rest /= line.len();
            }
            let square: i32 = offset.iter().map(|o| o * o).sum();
            let weight = (-0.5 * square as f32 / (self.width * self.width)).exp();
            (offset, square, weight)
        });
        // Round, but with the ends of the axes.
        all.filter(|(_, square, _)| *square <= self.radius * self.radius + 1)
            .map(|(offset, _, weight)| (offset, weight))
            .collect()
    }
}

/// Weighted means of two values over patches at right angles to the normals. `value` reads both
/// between two samples `i` and `j` of memory, at share `t` of the way.
fn in_patches<const D: usize>(
    dims: [usize; D],
    normals: &Normals<D>,
    patch: &Disc,
    patience: &Patience<'_>,
    value: impl Fn(usize, usize, f32) -> [f32; 2] + Sync,
) -> [Vec<f32>; 2] {
    let count = dims.iter().product();
    let space = Volume { dims, samples: &[] };
    let strides = space.strides();
    let offsets: [Vec<([i32; D], f32)>; D] = std::array::from_fn(|axis| patch.offsets(axis));
    let mut means = [vec![0.0f32; count], vec![0.0f32; count]];
    let [first, second] = &mut means;
    let chunk = ROWS * dims[0];
    let chunks = first
        .par_chunks_mut(chunk)
        .zip(second.par_chunks_mut(chunk));
    chunks.enumerate().for_each(|(number, (first, second))| {
        if patience.over() {
            return;
        }
        for i in 0..first.len() {
            let at = space.coordinates(number * chunk + i);
            let normal = normals.coarse(at);
            let axis = (1..D).fold(0, |a, k| {
                if normal[k].abs() > normal[a].abs() {
                    k
                } else {
                    a
                }
            });
            let slope = normal.map(|c| -c / normal[axis]);
            let last = (dims[axis] - 1) as f32;
            let (mut sums, mut total) = ([0.0f32; 2], 0.0f32);
            for (offset, weight) in &offsets[axis] {
                let mut start = 0;
                let mut along = at[axis] as f32;
                let mut inside = true;
                for k in 0..D {
                    if k != axis {
                        let to = at[k] as i32 + offset[k];
                        inside &= to >= 0 && (to as usize) < dims[k];
                        start += to.max(0) as usize * strides[k];
                        along += offset[k] as f32 * slope[k];
                    }
                }
                if !inside || !(0.0..=last).contains(&along) {
                    continue;
                }
                let low = along as usize;
                let high = (low + 1).min(dims[axis] - 1);
                let (low_at, high_at) = (start + low * strides[axis], start + high * strides[axis]);
                let values = value(low_at, high_at, along - low as f32);
                total += weight;
                for (sum, value) in sums.iter_mut().zip(values) {
                    *sum += weight * value;
                }
            }
            (first[i], second[i]) = (sums[0] / total, sums[1] / total);
        }
    });
    means
}

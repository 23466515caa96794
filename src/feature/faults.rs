//! Faults of seismic amplitude: where waveforms do not continue along the layers.
//!
//! Semblance compares the energy of a mean with the mean energy. Means are taken over a patch of the
//! layer round each sample (structure-oriented semblance: Marfurt et al. 1998, Hale 2013). Where a
//! fault throws the layers, the patch joins waveforms that do not match, and semblance falls. Noise
//! lowers it too, so numerator and denominator are smoothed before they are divided: first along the
//! layers' normal, to learn how the fault runs (structure tensor of what is missing to one), and then
//! again from the start over a patch of the fault itself. That is Hale's scan over fault orientations
//! with the one orientation that the data ask for.

use super::gaussian::smooth;
use super::tensor::Normals;
use super::volume::Volume;
use rayon::prelude::*;

/// Patch of a layer: radius and standard deviation (samples) of its weights.
const LAYER: Patch = Patch {
    radius: 3,
    stride: 1,
    width: 2.0,
};

/// Patch of a fault.
const FAULT: Patch = Patch {
    radius: 8,
    stride: 2,
    width: 4.0,
};

/// Where a fault's direction is sought, semblance is smoothed this much (samples) across layers ...
const ACROSS: f64 = 2.0;
/// ... and this much along the other axes.
const ALONG: f64 = 1.0;

/// Samples whose energy is below this share of the mean have no say.
const QUIET: f32 = 0.02;

/// Rows per parallel task.
const ROWS: usize = 64;

/// One less the semblance, in [0, 1], of amplitudes smoothed to the scale of their derivatives;
/// `layers` are their normals, `window` the width over which the faults' normals are averaged.
pub fn discontinuity<const D: usize>(
    amplitude: Volume<'_, D>,
    layers: &Normals<D>,
    window: f64,
) -> Vec<f32> {
    let (dims, a) = (amplitude.dims, amplitude.samples);
    let [mut of_mean, mean_of] = in_patches(dims, layers, &LAYER, |i, j, t| {
        let value = a[i] + t * (a[j] - a[i]);
        [value, value * value]
    });
    of_mean.par_iter_mut().for_each(|m| *m *= *m);
    let energy = super::horizons::root_mean_square(a).powi(2);
    let missing = |of_mean: &[f32], mean_of: &[f32]| -> Vec<f32> {
        let floor = (QUIET * energy).max(f32::MIN_POSITIVE);
        let pairs = of_mean.par_iter().zip(mean_of);
        pairs
            .map(|(n, d)| (1.0 - (n + floor) / (d + floor)).max(0.0))
            .collect()
    };
    let faults = {
        let mut sigma = [ALONG; D];
        sigma[layers.main_axis()] = ACROSS;
        let smoothed = |field: &[f32]| {
            let mut field = field.to_vec();
            smooth(dims, &mut field, sigma);
            field
        };
        let mut rough = missing(&smoothed(&of_mean), &smoothed(&mean_of));
        smooth(dims, &mut rough, [1.0; D]);
        let samples = &rough;
        Normals::new(Volume { dims, samples }, window)
    };
    let [of_mean, mean_of] = in_patches(dims, &faults, &FAULT, |i, j, t| {
        [&of_mean, &mean_of].map(|field| field[i] + t * (field[j] - field[i]))
    });
    missing(&of_mean, &mean_of)
}

/// A disc of samples with Gaussian weights.
struct Patch {
    radius: i32,
    stride: usize,
    width: f32,
}

impl Patch {
    /// Offsets in the plane of the axes other than `axis`, and their weights.
    fn offsets<const D: usize>(&self, axis: usize) -> Vec<([i32; D], f32)> {
        let line: Vec<i32> = (-self.radius..=self.radius).step_by(self.stride).collect();
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
    patch: &Patch,
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

//! Measures where waveforms do not continue along the layers.
//!
//! Semblance compares the energy of a mean with the mean energy (structure-oriented semblance:
//! Marfurt et al. 1998, Hale 2013). Here the two waveforms that are compared are those of the layer
//! on either side of a possible fault through the sample: means over two half discs of the layer,
//! so that noise does not lower the semblance. If a fault displaces the layers, the two waveforms
//! differ. They may also differ by chance; therefore numerator and denominator are smoothed before
//! the division, over pieces of all planes that a fault might follow: [`scan`].

use super::scan;
use crate::error::Result;
use crate::feature::gaussian::smooth;
use crate::feature::ridges::RidgeStatistics;
use crate::feature::structure_tensor::NormalField;
use crate::feature::volume::Volume;
use crate::feature::windows::{LayerStack, Samples};
use crate::geometry::simd::dispatch_simd;
use crate::geometry::{dot, norm};
use crate::image::LiveMask;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Radius (samples) of the disc of a layer around a sample.
const DISC_RADIUS: i32 = 4;
/// Standard deviation (samples) of the weights in the disc.
const DISC_SIGMA: f32 = 2.5;
/// Distance (samples) from the fault within which samples belong to neither half disc.
const FAULT_HALF_WIDTH: f64 = 0.5;

/// Share of the weights of a half disc that must be at live samples; with a smaller share, the half
/// disc is not used.
const MIN_WEIGHT_SHARE: f32 = 0.1;

/// Width (samples) of the Gaussian under which the root mean square of amplitudes is taken.
const BALANCE_SIGMA: f64 = 6.0;
/// Distance (samples) at which samples influence balanced amplitudes.
pub const BALANCE_REACH: usize = 4 * BALANCE_SIGMA as usize;

/// Energy, as a share of the image's mean, that is added before amplitudes are balanced: where the
/// energy is lower, there is only noise.
const MIN_BALANCED_ENERGY: f32 = 0.3;

/// Energy of balanced amplitudes that is added to numerator and denominator, so that quiet parts
/// have no faults.
const QUIET_ENERGY: f32 = 0.1;

/// Number of rows per parallel task.
const ROWS_PER_TASK: usize = 64;

/// Number of samples of a row that share one normal of the layers: the tensor's window is wider.
const LANES: usize = 8;

/// Number of layers of the halo: the reach of planes ([`scan::SCAN_REACH`]), plus that of the disc,
/// plus that of balancing.
pub const HALO_LAYERS: usize =
    (scan::SCAN_REACH + 3 * DISC_RADIUS as usize + BALANCE_REACH).next_multiple_of(8);

/// Computes the fault likelihood at each sample, in [0, 1]; each rank gets a share of it. See
/// [`scan::likelihood`].
///
/// `normals` are the normals of layers, from amplitudes smoothed to the scale of their derivatives,
/// and `rms` is the root mean square amplitude. The window of the normals should be wide, so that a
/// throw is not mistaken for a dip. Samples that are not `live` have no weight (normalised
/// convolution: Knutsson and Westin 1993).
///
/// # Errors
/// Returns the errors of reading layers of `amplitude`.
pub fn likelihood<'a, const D: usize>(
    amplitude: &Samples<'a, D>,
    normals: &NormalField<D>,
    rms: f32,
    live: Option<&LiveMask<D>>,
    max_slope: impl Fn([f64; D], usize) -> f64,
    cancel: &CancelToken<'_>,
) -> Result<Samples<'a, D>> {
    let vertical = normals.main_axis();
    amplitude.map_windows(HALO_LAYERS, cancel, |stack| {
        let dims = stack.volume.dims;
        let mut balanced = balance_amplitudes(stack.volume, rms, cancel);
        let weights = live.map(|live| live_weights(stack, live));
        if let Some(weights) = &weights {
            balanced.iter_mut().zip(weights).for_each(|(b, w)| *b *= w);
        }
        let balanced = stack.with_samples(&balanced);
        scan::likelihood(
            dims,
            vertical,
            cancel,
            &max_slope,
            |fault_normal, stride| {
                let weights = weights.as_deref();
                side_energies(
                    balanced,
                    weights,
                    normals,
                    fault_normal,
                    vertical,
                    stride,
                    cancel,
                )
            },
        )
    })
}

/// Returns 1 for each live sample and 0 for others.
fn live_weights<const D: usize>(stack: LayerStack<'_, D>, live: &LiveMask<D>) -> Vec<f32> {
    let count = stack.volume.samples.len();
    let is_live = |i: usize| live.is_live(stack.to_volume(stack.volume.coordinates(i)));
    (0..count)
        .into_par_iter()
        .map(|i| f32::from(is_live(i)))
        .collect()
}

/// Divides amplitudes by their root mean square around each sample, so that all layers have the
/// same influence; `rms` is that of the whole image.
pub fn balance_amplitudes<const D: usize>(
    amplitude: Volume<'_, D>,
    rms: f32,
    cancel: &CancelToken<'_>,
) -> Vec<f32> {
    let a = amplitude.samples;
    let mut energy: Vec<f32> = a.par_iter().map(|a| a * a).collect();
    smooth(amplitude.dims, &mut energy, [BALANCE_SIGMA; D], cancel);
    let floor = MIN_BALANCED_ENERGY * rms.powi(2);
    energy.par_iter_mut().zip(a).for_each(|(e, a)| {
        *e = a / (*e + floor).max(f32::MIN_POSITIVE).sqrt();
    });
    energy
}

/// Likelihood down to which a fault is followed, and the one that it must reach somewhere.
const MIN_LIKELIHOODS: [f32; 2] = [0.06, 0.14];
/// Multiples of the noise that are used for the lower and the upper threshold if they are larger.
const MIN_NOISE_RATIOS: [f32; 2] = [1.75, 2.5];

/// Returns the thresholds for the ridges of [`likelihood`]. They are the same for all images,
/// unless there is much noise, because semblance is a ratio.
pub fn thresholds(statistics: &RidgeStatistics) -> (f32, f32) {
    let min = |i: usize| MIN_LIKELIHOODS[i].max(MIN_NOISE_RATIOS[i] * statistics.noise);
    (min(0), min(1))
}

/// A sample of a disc: its offset, its side of the fault (0 or 1), and its weight.
type DiscTap<const D: usize> = ([i32; D], usize, f32);

/// Returns the samples of a disc in the plane of the axes other than `axis`, except those on a
/// fault with normal `fault_normal`.
fn half_disc_taps<const D: usize>(axis: usize, fault_normal: [f64; D]) -> Vec<DiscTap<D>> {
    let line: Vec<i32> = (-DISC_RADIUS..=DISC_RADIUS).collect();
    let length = norm(fault_normal);
    let tap = |number: usize| {
        let mut remaining = number;
        let mut offset = [0; D];
        for k in 1..D {
            offset[(axis + k) % D] = line[remaining % line.len()];
            remaining /= line.len();
        }
        let square: i32 = offset.iter().map(|o| o * o).sum();
        let distance = dot(offset.map(f64::from), fault_normal) / length;
        let weight = (-0.5 * square as f32 / (DISC_SIGMA * DISC_SIGMA)).exp();
        // The disc is slightly enlarged, so that it includes more samples near the ends of the
        // axes.
        let is_counted =
            square <= DISC_RADIUS * DISC_RADIUS + 1 && distance.abs() > FAULT_HALF_WIDTH;
        is_counted.then_some((offset, usize::from(distance > 0.0), weight))
    };
    (0..line.len().pow(D as u32 - 1)).filter_map(tap).collect()
}

/// Returns the energy of the mean and the mean energy of the waveforms on either side of faults
/// with the horizontal normal `fault_normal`, one through each sample of every `stride`-th plane
/// along `vertical`.
fn side_energies<const D: usize>(
    balanced: LayerStack<'_, D>,
    weights: Option<&[f32]>,
    normals: &NormalField<D>,
    fault_normal: [f64; D],
    vertical: usize,
    stride: usize,
    cancel: &CancelToken<'_>,
) -> [Vec<f32>; 2] {
    let amplitude = balanced.volume;
    let sides = FaultSides {
        balanced_amplitude: balanced,
        amplitude,
        weights,
        strides: amplitude.strides(),
        normals,
        taps: std::array::from_fn(|axis| half_disc_taps(axis, fault_normal)),
    };
    let mut thinned_dims = amplitude.dims;
    thinned_dims[vertical] = thinned_dims[vertical].div_ceil(stride);
    let thinned = Volume {
        dims: thinned_dims,
        samples: &[],
    };
    let mut step = [1; D];
    step[vertical] = stride;
    let count = thinned_dims.iter().product();
    let mut parts = [vec![0.0f32; count], vec![0.0f32; count]];
    let [energy_of_mean, mean_energy] = &mut parts;
    let chunk = ROWS_PER_TASK * thinned_dims[0];
    let chunks = energy_of_mean
        .par_chunks_mut(chunk)
        .zip(mean_energy.par_chunks_mut(chunk));
    chunks
        .enumerate()
        .for_each(|(number, (energy_of_mean, mean_energy))| {
            let rows = energy_of_mean
                .chunks_mut(thinned_dims[0])
                .zip(mean_energy.chunks_mut(thinned_dims[0]));
            for (row, (energy_of_mean, mean_energy)) in rows.enumerate() {
                if cancel.is_cancelled() {
                    return;
                }
                let at = thinned.coordinates(number * chunk + row * thinned_dims[0]);
                let mut at: [usize; D] = std::array::from_fn(|k| at[k] * step[k]);
                for x in (0..amplitude.dims[0]).step_by(LANES) {
                    at[0] = x;
                    let (means, shares) = sides.side_means(at);
                    for lane in (0..LANES.min(amplitude.dims[0] - x)).step_by(step[0]) {
                        let [a, b] = means.map(|side| side[lane]);
                        let index = (x + lane) / step[0];
                        energy_of_mean[index] = 0.25 * (a + b) * (a + b) + QUIET_ENERGY;
                        mean_energy[index] = 0.5 * (a * a + b * b) + QUIET_ENERGY;
                        if let Some(shares) = shares {
                            // Where little of a side is live, the energy is lowered, as in quiet parts.
                            let weight = shares[0][lane] * shares[1][lane];
                            energy_of_mean[index] =
                                weight * (energy_of_mean[index] - QUIET_ENERGY) + QUIET_ENERGY;
                            mean_energy[index] =
                                weight * (mean_energy[index] - QUIET_ENERGY) + QUIET_ENERGY;
                        }
                    }
                }
            }
        });
    parts
}

/// A value for each lane on both sides.
type SideValues = [[f32; LANES]; 2];

/// Half discs of the layers on both sides of faults of one strike.
struct FaultSides<'a, const D: usize> {
    balanced_amplitude: LayerStack<'a, D>,
    /// Samples of `balanced_amplitude`, as a separate volume.
    amplitude: Volume<'a, D>,
    /// Weights by which the samples are multiplied; all are 1 if `None`.
    weights: Option<&'a [f32]>,
    strides: [usize; D],
    normals: &'a NormalField<D>,
    /// Disc samples for each axis that the layers may lie across.
    taps: [Vec<DiscTap<D>>; D],
}

impl<const D: usize> FaultSides<'_, D> {
    /// Returns the weighted means over both half discs of the layer through each of [`LANES`]
    /// samples of a row. If one side is outside the image, its mean is that of the other side. If
    /// samples have weights, also returns the share of each side's weights.
    fn side_means(&self, at: [usize; D]) -> (SideValues, Option<SideValues>) {
        let mut middle = at;
        middle[0] = (at[0] + LANES / 2).min(self.amplitude.dims[0] - 1);
        let normal = self
            .normals
            .cell_normal(self.balanced_amplitude.to_volume(middle));
        let axis = (1..D).fold(0, |a, k| {
            if normal[k].abs() > normal[a].abs() {
                k
            } else {
                a
            }
        });
        let slope = normal.map(|c| -c / normal[axis]);
        let reach = slope.iter().map(|s| s.abs()).sum::<f32>() * DISC_RADIUS as f32;
        let margin = |k: usize| {
            if k == axis {
                reach as usize + 2
            } else {
                DISC_RADIUS as usize
            }
        };
        let is_interior = (0..D).all(|k| {
            let last = if k == 0 { at[0] + LANES } else { at[k] };
            at[k] >= margin(k) && last + margin(k) < self.amplitude.dims[k]
        });
        let (mut sums, mut totals) =
            self.sum_taps(self.amplitude.samples, at, axis, slope, is_interior);
        let shares = self.weights.map(|weights| {
            let (weight_sums, _) = self.sum_taps(weights, at, axis, slope, is_interior);
            let mut shares = [[1.0f32; LANES]; 2];
            for side in 0..2 {
                for lane in 0..LANES {
                    if totals[side][lane] > 0.0 {
                        let share = weight_sums[side][lane] / totals[side][lane];
                        let is_enough = share > MIN_WEIGHT_SHARE;
                        shares[side][lane] = if is_enough { share } else { 0.0 };
                        totals[side][lane] = if is_enough {
                            weight_sums[side][lane]
                        } else {
                            f32::INFINITY
                        };
                    }
                }
            }
            shares
        });
        for lane in 0..LANES {
            for side in 0..2 {
                sums[side][lane] /= totals[side][lane].max(f32::MIN_POSITIVE);
            }
            for side in 0..2 {
                if totals[side][lane] == 0.0 {
                    sums[side][lane] = sums[1 - side][lane];
                }
            }
        }
        (sums, shares)
    }

    /// Returns the weighted sums of samples over both half discs, and the sums of the weights.
    #[inline(always)]
    fn sum_taps(
        &self,
        samples: &[f32],
        at: [usize; D],
        axis: usize,
        slope: [f32; D],
        is_interior: bool,
    ) -> (SideValues, SideValues) {
        let mut sums = [[0.0f32; LANES]; 2];
        let mut totals = [[0.0f32; LANES]; 2];
        if is_interior {
            dispatch_simd(
                #[inline(always)]
                || self.add_interior(samples, at, axis, slope, &mut sums, &mut totals),
            );
        } else {
            for lane in 0..LANES.min(self.amplitude.dims[0] - at[0]) {
                self.add_lane(samples, at, lane, axis, slope, &mut sums, &mut totals);
            }
        }
        (sums, totals)
    }

    /// Adds up the samples of all lanes; all are inside the image.
    #[inline(always)]
    fn add_interior(
        &self,
        samples: &[f32],
        at: [usize; D],
        axis: usize,
        slope: [f32; D],
        sums: &mut [[f32; LANES]; 2],
        totals: &mut [[f32; LANES]; 2],
    ) {
        let base: usize = (0..D).map(|k| at[k] * self.strides[k]).sum();
        let mut weights = [0.0f32; 2];
        for (offset, side, weight) in &self.taps[axis] {
            let (mut position, mut shift) = (base as isize, 0.0f32);
            for k in 0..D {
                // Along the axis, the offset is 0 and its slope is -1.
                position += offset[k] as isize * self.strides[k] as isize;
                shift += offset[k] as f32 * slope[k];
            }
            let low = shift.floor();
            position += low as isize * self.strides[axis] as isize;
            let fraction = shift - low;
            let lanes_at = |start: usize| samples[start..].first_chunk::<LANES>();
            let pair = (
                lanes_at(position as usize),
                lanes_at(position as usize + self.strides[axis]),
            );
            let (Some(low), Some(high)) = pair else {
                continue;
            };
            weights[*side] += weight;
            for lane in 0..LANES {
                sums[*side][lane] += weight * (low[lane] + fraction * (high[lane] - low[lane]));
            }
        }
        *totals = weights.map(|w| [w; LANES]);
    }

    /// Adds up the samples of one lane that are inside the image.
    #[allow(clippy::too_many_arguments)]
    fn add_lane(
        &self,
        samples: &[f32],
        mut at: [usize; D],
        lane: usize,
        axis: usize,
        slope: [f32; D],
        sums: &mut [[f32; LANES]; 2],
        totals: &mut [[f32; LANES]; 2],
    ) {
        at[0] += lane;
        let dims = self.amplitude.dims;
        let last = dims[axis] as isize - 1;
        for (offset, side, weight) in &self.taps[axis] {
            let (mut start, mut shift) = (0, 0.0f32);
            let mut is_inside = true;
            for k in 0..D {
                if k != axis {
                    let coordinate = at[k] as i32 + offset[k];
                    is_inside &= coordinate >= 0 && (coordinate as usize) < dims[k];
                    start += coordinate.max(0) as usize * self.strides[k];
                    shift += offset[k] as f32 * slope[k];
                }
            }
            // The fraction is rounded alike wherever the current layers begin.
            let (below, fraction) = (shift.floor(), shift - shift.floor());
            let low = at[axis] as isize + below as isize;
            if !is_inside || low < 0 || low > last || low == last && fraction > 0.0 {
                continue;
            }
            let high = (low + 1).min(last);
            let [a, b] = [low, high].map(|i| samples[start + i as usize * self.strides[axis]]);
            sums[*side][lane] += weight * (a + fraction * (b - a));
            totals[*side][lane] += weight;
        }
    }
}

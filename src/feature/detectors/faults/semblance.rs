//! Where waveforms do not continue along the layers.
//!
//! Semblance compares the energy of a mean with the mean energy (structure-oriented semblance: Marfurt
//! et al. 1998, Hale 2013). Here the two that are compared are what is seen of the layer on either side
//! of a fault that might run through the sample: two half discs, each averaged before they are compared,
//! so that noise lowers no semblance. Where a fault throws the layers, waveforms on both sides do not
//! match. Chance mismatches remain, so numerator and denominator are smoothed before they are divided,
//! over pieces of all the planes that a fault might run along: [`scan`].

use super::scan;
use crate::error::Result;
use crate::feature::gaussian::smooth;
use crate::feature::ridges::RidgeStatistics;
use crate::feature::structure_tensor::NormalField;
use crate::feature::volume::Volume;
use crate::feature::windows::{LayerStack, Samples};
use crate::geometry::dot;
use crate::geometry::simd::dispatch_simd;
use crate::image::LiveMask;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Radius (samples) of the disc of a layer round a sample ...
const DISC_RADIUS: i32 = 4;
/// ... and the standard deviation of its weights.
const DISC_SIGMA: f32 = 2.5;
/// What is nearer than this (samples) to the fault belongs to neither half.
const FAULT_HALF_WIDTH: f64 = 0.5;

/// A half disc of which no larger share of the weights is seen tells nothing.
const MIN_WEIGHT_SHARE: f32 = 0.1;

/// Width (samples) of the Gaussian under which the rms of amplitudes is taken.
const BALANCE_SIGMA: f64 = 6.0;

/// Energy, as a share of the image's mean, that amplitudes are not balanced below: there is only noise.
const MIN_BALANCED_ENERGY: f32 = 0.3;

/// Energy of balanced amplitudes that counts as alike anywhere: where it is quiet there are no faults.
const QUIET_ENERGY: f32 = 0.1;

/// Rows per parallel task.
const ROWS_PER_TASK: usize = 64;

/// Samples of a row that share one normal of the layers: its window is wider.
const LANES: usize = 8;

/// How many layers to either side are looked at: as far as planes are followed ([`scan::MAX_DISTANCE`]), from there as far
/// as what is seen of a layer at most, and from there as far as amplitudes are balanced.
pub const HALO_LAYERS: usize =
    (scan::SCAN_REACH + 3 * DISC_RADIUS as usize + 4 * BALANCE_SIGMA as usize).next_multiple_of(8);

/// How likely a fault runs through each sample, in [0, 1], of which each rank has a share: see [`scan::likelihood`].
/// `layers` are the normals of amplitudes smoothed to the scale of their derivatives, whose root mean square is `rms`;
/// their window should be wide, as a throw must not pass for a dip. Samples that are not `live` have no weight
/// (normalised convolution: Knutsson and Westin 1993).
///
/// # Errors
/// Those of reading layers of `amplitude`.
pub fn likelihood<const D: usize>(
    amplitude: &Samples<'_, D>,
    (layers, rms): (&NormalField<D>, f32),
    live: Option<&LiveMask<D>>,
    patience: &CancelToken<'_>,
) -> Result<Samples<'static, D>> {
    let vertical = layers.main_axis();
    amplitude.map_windows(HALO_LAYERS, patience, |stack| {
        let dims = stack.volume.dims;
        let mut balanced = balance_amplitudes(stack.volume, rms, patience);
        let weights = live.map(|live| weights(stack, live));
        if let Some(weights) = &weights {
            balanced.iter_mut().zip(weights).for_each(|(b, w)| *b *= w);
        }
        let balanced = stack.with_samples(&balanced);
        scan::likelihood(dims, vertical, patience, |across, every| {
            let weights = weights.as_deref();
            side_energies(
                (balanced, weights),
                layers,
                across,
                (vertical, every),
                patience,
            )
        })
    })
}

/// Returns 1 for each live sample and 0 for others.
fn weights<const D: usize>(stack: LayerStack<'_, D>, live: &LiveMask<D>) -> Vec<f32> {
    let count = stack.volume.samples.len();
    let is_live = |i: usize| live.is_live(stack.to_volume(stack.volume.coordinates(i)));
    (0..count)
        .into_par_iter()
        .map(|i| f32::from(is_live(i)))
        .collect()
}

/// Amplitudes over their rms round each sample, so that no layer has more say than others; that of all is `rms`.
fn balance_amplitudes<const D: usize>(
    amplitude: Volume<'_, D>,
    rms: f32,
    patience: &CancelToken<'_>,
) -> Vec<f32> {
    let a = amplitude.samples;
    let mut energy: Vec<f32> = a.par_iter().map(|a| a * a).collect();
    smooth(amplitude.dims, &mut energy, [BALANCE_SIGMA; D], patience);
    let floor = MIN_BALANCED_ENERGY * rms.powi(2);
    energy.par_iter_mut().zip(a).for_each(|(e, a)| {
        *e = a / (*e + floor).max(f32::MIN_POSITIVE).sqrt();
    });
    energy
}

/// Likelihood down to which a fault is followed, and which it must reach somewhere; or these
/// multiples of the noise, if they are more.
pub const MIN_LIKELIHOODS: [f32; 2] = [0.06, 0.14];
const MIN_NOISE_RATIOS: [f32; 2] = [1.75, 2.5];

/// Thresholds for the ridges of [`likelihood`]: semblance is a share, so they are the same for all
/// images, unless there is much noise.
pub fn thresholds(statistics: &RidgeStatistics) -> (f32, f32) {
    let least = |i: usize| MIN_LIKELIHOODS[i].max(MIN_NOISE_RATIOS[i] * statistics.noise);
    (least(0), least(1))
}

/// A sample of a disc: its offset, on which side of the fault it is, and its weight.
type DiscTap<const D: usize> = ([i32; D], usize, f32);

/// Samples of a disc in the plane of the axes other than `axis`, but for those on a fault that runs square
/// to `across`.
fn half_disc_taps<const D: usize>(axis: usize, across: [f64; D]) -> Vec<DiscTap<D>> {
    let line: Vec<i32> = (-DISC_RADIUS..=DISC_RADIUS).collect();
    let length = dot(across, across).sqrt();
    let tap = |number: usize| {
        let mut rest = number;
        let mut offset = [0; D];
        for k in 1..D {
            offset[(axis + k) % D] = line[rest % line.len()];
            rest /= line.len();
        }
        let square: i32 = offset.iter().map(|o| o * o).sum();
        let off = dot(offset.map(f64::from), across) / length;
        let weight = (-0.5 * square as f32 / (DISC_SIGMA * DISC_SIGMA)).exp();
        // Round, but with the ends of the axes.
        let counts = square <= DISC_RADIUS * DISC_RADIUS + 1 && off.abs() > FAULT_HALF_WIDTH;
        counts.then_some((offset, usize::from(off > 0.0), weight))
    };
    (0..line.len().pow(D as u32 - 1)).filter_map(tap).collect()
}

/// Energy of the mean and mean energy of what the layers show on either side of faults square to the
/// horizontal direction `across`, one through each sample of every `every`-th plane along `vertical`.
fn side_energies<const D: usize>(
    (balanced, weights): (LayerStack<'_, D>, Option<&[f32]>),
    layers: &NormalField<D>,
    across: [f64; D],
    (vertical, every): (usize, usize),
    patience: &CancelToken<'_>,
) -> [Vec<f32>; 2] {
    let amplitude = balanced.volume;
    let sides = FaultSides {
        balanced_amplitude: balanced,
        amplitude,
        weights,
        strides: amplitude.strides(),
        normals: layers,
        taps: std::array::from_fn(|axis| half_disc_taps(axis, across)),
    };
    let mut thin = amplitude.dims;
    thin[vertical] = thin[vertical].div_ceil(every);
    let space = Volume {
        dims: thin,
        samples: &[],
    };
    let mut step = [1; D];
    step[vertical] = every;
    let count = thin.iter().product();
    let mut parts = [vec![0.0f32; count], vec![0.0f32; count]];
    let [of_mean, mean_of] = &mut parts;
    let chunk = ROWS_PER_TASK * thin[0];
    let chunks = of_mean
        .par_chunks_mut(chunk)
        .zip(mean_of.par_chunks_mut(chunk));
    chunks.enumerate().for_each(|(number, (of_mean, mean_of))| {
        let rows = of_mean.chunks_mut(thin[0]).zip(mean_of.chunks_mut(thin[0]));
        for (row, (of_mean, mean_of)) in rows.enumerate() {
            if patience.is_cancelled() {
                return;
            }
            let at = space.coordinates(number * chunk + row * thin[0]);
            let mut at: [usize; D] = std::array::from_fn(|k| at[k] * step[k]);
            for x in (0..amplitude.dims[0]).step_by(LANES) {
                at[0] = x;
                let (means, shares) = sides.side_means(at);
                for lane in (0..LANES.min(amplitude.dims[0] - x)).step_by(step[0]) {
                    let [a, b] = means.map(|side| side[lane]);
                    let to = (x + lane) / step[0];
                    of_mean[to] = 0.25 * (a + b) * (a + b) + QUIET_ENERGY;
                    mean_of[to] = 0.5 * (a * a + b * b) + QUIET_ENERGY;
                    if let Some(shares) = shares {
                        // Where little is seen of a side nothing is known: that is quiet.
                        let weight = shares[0][lane] * shares[1][lane];
                        of_mean[to] = weight * (of_mean[to] - QUIET_ENERGY) + QUIET_ENERGY;
                        mean_of[to] = weight * (mean_of[to] - QUIET_ENERGY) + QUIET_ENERGY;
                    }
                }
            }
        }
    });
    parts
}

/// Something of each lane on both sides.
type SideValues = [[f32; LANES]; 2];

/// What the layers show on both sides of faults of one strike.
struct FaultSides<'a, const D: usize> {
    balanced_amplitude: LayerStack<'a, D>,
    /// The same as a volume of its own.
    amplitude: Volume<'a, D>,
    /// Weights of its samples, by which they are multiplied; 1 if there are none.
    weights: Option<&'a [f32]>,
    strides: [usize; D],
    normals: &'a NormalField<D>,
    /// For each axis that the layers may lie across.
    taps: [Vec<DiscTap<D>>; D],
}

impl<const D: usize> FaultSides<'_, D> {
    /// Weighted means over both half discs of the layer through each of [`LANES`] samples of a row; the
    /// same twice where a side is outside of the image. Where samples have weights, also the share of each
    /// side's weights.
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
        let lead = slope.iter().map(|s| s.abs()).sum::<f32>() * DISC_RADIUS as f32;
        let margin = |k: usize| {
            if k == axis {
                lead as usize + 2
            } else {
                DISC_RADIUS as usize
            }
        };
        let inside = (0..D).all(|k| {
            let last = if k == 0 { at[0] + LANES } else { at[k] };
            at[k] >= margin(k) && last + margin(k) < self.amplitude.dims[k]
        });
        let (mut sums, mut totals) = self.sum_taps(self.amplitude.samples, at, axis, slope, inside);
        let shares = self.weights.map(|weights| {
            let (seen, _) = self.sum_taps(weights, at, axis, slope, inside);
            let mut shares = [[1.0f32; LANES]; 2];
            for side in 0..2 {
                for lane in 0..LANES {
                    if totals[side][lane] > 0.0 {
                        let share = seen[side][lane] / totals[side][lane];
                        let enough = share > MIN_WEIGHT_SHARE;
                        shares[side][lane] = if enough { share } else { 0.0 };
                        totals[side][lane] = if enough {
                            seen[side][lane]
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

    /// Returns weighted sums of samples over both half discs, and the sums of the weights.
    #[inline(always)]
    fn sum_taps(
        &self,
        samples: &[f32],
        at: [usize; D],
        axis: usize,
        slope: [f32; D],
        inside: bool,
    ) -> (SideValues, SideValues) {
        let mut sums = [[0.0f32; LANES]; 2];
        let mut totals = [[0.0f32; LANES]; 2];
        if inside {
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

    /// Adds up the samples of all lanes; none of them is outside.
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
            let (mut to, mut shift) = (base as isize, 0.0f32);
            for k in 0..D {
                // Along the axis the offset is zero and its slope minus one.
                to += offset[k] as isize * self.strides[k] as isize;
                shift += offset[k] as f32 * slope[k];
            }
            let low = shift.floor();
            to += low as isize * self.strides[axis] as isize;
            let share = shift - low;
            let from = |start: usize| samples[start..].first_chunk::<LANES>();
            let pair = (from(to as usize), from(to as usize + self.strides[axis]));
            let (Some(low), Some(high)) = pair else {
                continue;
            };
            weights[*side] += weight;
            for lane in 0..LANES {
                sums[*side][lane] += weight * (low[lane] + share * (high[lane] - low[lane]));
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
            let mut inside = true;
            for k in 0..D {
                if k != axis {
                    let to = at[k] as i32 + offset[k];
                    inside &= to >= 0 && (to as usize) < dims[k];
                    start += to.max(0) as usize * self.strides[k];
                    shift += offset[k] as f32 * slope[k];
                }
            }
            // The share is rounded alike wherever the layers at hand begin.
            let (below, share) = (shift.floor(), shift - shift.floor());
            let low = at[axis] as isize + below as isize;
            if !inside || low < 0 || low > last || low == last && share > 0.0 {
                continue;
            }
            let high = (low + 1).min(last);
            let [a, b] = [low, high].map(|i| samples[start + i as usize * self.strides[axis]]);
            sums[*side][lane] += weight * (a + share * (b - a));
            totals[*side][lane] += weight;
        }
    }
}

//! Computes the fault likelihood at each sample from all steep planes through it.
//!
//! Hale (2013, "Methods to compute fault images, extract fault surfaces, and estimate fault throws
//! from 3D seismic images") smooths the numerator and denominator of the semblance over a piece of
//! each plane that a fault may follow, one strike and dip after the other, before the division:
//! noise and single bad samples do not lower the semblance of a whole plane, but a fault does. Here
//! both the piece above a sample and the piece below must have a low semblance; otherwise one spot
//! where waveforms differ would give a star of planes.
//!
//! A plane is given by the horizontal axis that it crosses and its slopes along the other axes.
//! Smoothing over it is one pass of shifted rows along its strike and, for each dip, one along the
//! dip. Rows are padded by zeros ([`PaddedRows`]): beyond the box, numerator and denominator lose
//! the same weights.

use crate::feature::volume::Volume;
use crate::geometry::simd::dispatch_simd;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Standard deviation (samples) of the weights along a fault's strike.
const STRIKE_SIGMA: f64 = 6.0;
/// Standard deviation (samples) of the weights along a fault's dip.
const DIP_SIGMA: f64 = 12.0;

/// Distance, in standard deviations, at which weights are cut.
const CUTOFF_SIGMAS: f64 = 2.5;

/// Slopes of strikes against the axis that the fault does not cross; with a slope larger than one,
/// the fault crosses that axis.
const STRIKE_SLOPES: [f64; 7] = [-1.0, -0.67, -0.33, 0.0, 0.33, 0.67, 1.0];

/// Largest horizontal offset of a fault per vertical sample: from vertical to a dip of 36 degrees
/// where samples are as far apart along all axes.
pub const MAX_DIP_SLOPE: f64 = 1.4;
/// Largest difference between the slopes of dips that are tried one after the other.
const DIP_SLOPE_STEP: f64 = 0.2;

/// Distance (samples) along any axis that planes reach from a sample. It covers the vertical reach;
/// the horizontal one, along strike and then along dip, which is less than 9/8 of the vertical one;
/// and the rows between scanned planes.
pub const SCAN_REACH: usize = 36;

/// Vertical distance (samples) of the scanned planes: semblance varies slowly there.
const ROW_STRIDE: usize = 2;

/// Approximate share of the search for faults that is done after the scan.
const PROGRESS_SCANNED: f64 = 0.8;

/// Number of samples of x processed at once: the sums stay in registers.
const LANES: usize = 32;

/// Number of rows per parallel task.
const ROWS_PER_TASK: usize = 16;

/// Returns the fault likelihood of each sample: one minus the squared semblance, in [0, 1], of the
/// steep plane through the sample for which it is lowest; the harmonic mean of the upper and the
/// lower half of the plane.
///
/// `parts(fault_normal, stride)` returns numerator and denominator of the semblance, both positive,
/// between the two sides of faults with this horizontal normal, on every `stride`-th plane along
/// `vertical`, the axis that layers lie across. `max_slope(fault_normal, crossed_axis)` is the largest
/// horizontal offset per vertical sample, at most [`MAX_DIP_SLOPE`], of such faults along the axis
/// that they cross.
pub fn likelihood<const D: usize>(
    dims: [usize; D],
    vertical: usize,
    cancel: &CancelToken<'_>,
    max_slope: impl Fn([f64; D], usize) -> f64,
    parts: impl Fn([f64; D], usize) -> [Vec<f32>; 2],
) -> Vec<f32> {
    let mut thinned_dims = dims;
    thinned_dims[vertical] = dims[vertical].div_ceil(ROW_STRIDE);
    let mut max_likelihood = vec![0.0f32; thinned_dims.iter().product()];
    let horizontal = |k: &usize| *k != vertical;
    // Each strike is used once.
    let strikes = if D == 2 {
        1
    } else {
        2 * STRIKE_SLOPES.len() - 1
    } as f64;
    let mut done = 0.0;
    for crossed_axis in (0..D).filter(horizontal) {
        let dips = |max_slope: f64| -> Vec<[Vec<LineTap<D>>; 2]> {
            let count = (max_slope / DIP_SLOPE_STEP - 1e-6).ceil().max(1.0) as i32;
            let half_lines = |dip: i32| {
                let slope = max_slope * f64::from(dip) / f64::from(count);
                let line = taps(vertical, ROW_STRIDE as f64, crossed_axis, slope, DIP_SIGMA);
                let half_line = |keep: fn(i32) -> bool| {
                    let kept = line.iter().filter(|(offset, _)| keep(offset[vertical]));
                    kept.copied().collect()
                };
                [half_line(|v| v >= 0), half_line(|v| v <= 0)]
            };
            (-count..=count).map(half_lines).collect()
        };
        let Some(strike_axis) = (0..D).find(|k| horizontal(k) && *k != crossed_axis) else {
            let mut normal = [0.0; D];
            normal[crossed_axis] = 1.0;
            PaddedRows::new(thinned_dims, parts(normal, ROW_STRIDE)).raise_maxima(
                &dips(max_slope(normal, crossed_axis)),
                &mut max_likelihood,
                cancel,
            );
            continue;
        };
        // Strikes at 45 degrees cross both axes and are used only for one of them.
        let last = STRIKE_SLOPES.len() - usize::from(strike_axis < crossed_axis);
        for &slope in &STRIKE_SLOPES[usize::from(strike_axis < crossed_axis)..last] {
            let mut normal = [0.0; D];
            normal[crossed_axis] = 1.0;
            normal[strike_axis] = -slope;
            let strike = taps(strike_axis, 1.0, crossed_axis, slope, STRIKE_SIGMA);
            PaddedRows::new(thinned_dims, parts(normal, ROW_STRIDE))
                .smooth(&strike, cancel)
                .raise_maxima(
                    &dips(max_slope(normal, crossed_axis)),
                    &mut max_likelihood,
                    cancel,
                );
            done += 1.0;
            cancel.set_fraction(PROGRESS_SCANNED * done / strikes);
        }
    }
    interpolate_rows(thinned_dims, &max_likelihood, vertical, dims)
}

/// Offset of a sample (in samples) and its weight.
type LineTap<const D: usize> = ([i32; D], f32);

/// Returns Gaussian weights on a line that advances by `step` along one axis, and by `slope` times
/// that along the other.
fn taps<const D: usize>(
    axis: usize,
    step: f64,
    cross_axis: usize,
    slope: f64,
    width: f64,
) -> Vec<LineTap<D>> {
    let length = step * (1.0 + slope * slope).sqrt();
    let reach = (CUTOFF_SIGMAS * width / length) as i32;
    let mut taps = Vec::new();
    for k in -reach..=reach {
        let weight = (-0.5 * (f64::from(k) * length / width).powi(2)).exp();
        let sideways = f64::from(k) * step * slope;
        let share = sideways - sideways.floor();
        for (next, share) in [(0, 1.0 - share), (1, share)] {
            if share > 1e-6 {
                let mut offset = [0; D];
                offset[axis] = k;
                offset[cross_axis] = sideways.floor() as i32 + next;
                taps.push((offset, (weight * share) as f32));
            }
        }
    }
    taps
}

/// Two images in rows of x with zeros on either side.
struct PaddedRows<const D: usize> {
    dims: [usize; D],
    /// Distance in memory between successive rows.
    pitch: usize,
    images: [Vec<f32>; 2],
}

/// Number of zeros on either side of a row: at least the reach of any tap.
const MARGIN: usize = 32;

impl<const D: usize> PaddedRows<D> {
    fn new(dims: [usize; D], parts: [Vec<f32>; 2]) -> Self {
        let pitch = dims[0].next_multiple_of(LANES) + 2 * MARGIN;
        let images = parts.map(|part| {
            let mut padded = vec![0.0; part.len() / dims[0].max(1) * pitch];
            for (target, source) in padded.chunks_mut(pitch).zip(part.chunks(dims[0])) {
                target[MARGIN..][..dims[0]].copy_from_slice(source);
            }
            padded
        });
        Self {
            dims,
            pitch,
            images,
        }
    }

    /// Computes the positions in memory at which the taps of a row begin, and their weights; taps
    /// in rows outside the image are left out.
    fn row_taps(&self, row: usize, taps: &[LineTap<D>], starts: &mut Vec<(usize, f32)>) {
        starts.clear();
        let mut at = [0; D];
        let mut remaining = row;
        for k in 1..D {
            at[k] = (remaining % self.dims[k]) as i32;
            remaining /= self.dims[k];
        }
        for (offset, weight) in taps {
            let mut row = 0;
            let mut is_inside = true;
            for k in (1..D).rev() {
                let i = at[k] + offset[k];
                is_inside &= i >= 0 && (i as usize) < self.dims[k];
                row = row * self.dims[k] + i.max(0) as usize;
            }
            if is_inside {
                let start = row * self.pitch + MARGIN;
                starts.push((start.wrapping_add_signed(offset[0] as isize), *weight));
            }
        }
    }

    /// Returns weighted sums over the taps.
    fn smooth(&self, taps: &[LineTap<D>], cancel: &CancelToken<'_>) -> Self {
        let mut parts = [
            vec![0.0; self.images[0].len()],
            vec![0.0; self.images[0].len()],
        ];
        let [first, second] = &mut parts;
        let chunk = ROWS_PER_TASK * self.pitch;
        first
            .par_chunks_mut(chunk)
            .zip(second.par_chunks_mut(chunk))
            .enumerate()
            .for_each_init(Vec::new, |starts, (number, (first, second))| {
                let rows = first
                    .chunks_mut(self.pitch)
                    .zip(second.chunks_mut(self.pitch));
                for (row, (first, second)) in rows.enumerate() {
                    if cancel.is_cancelled() {
                        return;
                    }
                    self.row_taps(number * ROWS_PER_TASK + row, taps, starts);
                    let (first, second) = (&mut first[MARGIN..], &mut second[MARGIN..]);
                    dispatch_simd(
                        #[inline(always)]
                        || {
                            for x in (0..self.dims[0]).step_by(LANES) {
                                let [a, b] = self.sums(starts, x);
                                first[x..x + LANES].copy_from_slice(&a);
                                second[x..x + LANES].copy_from_slice(&b);
                            }
                        },
                    );
                    // Lanes beyond the end of the row are padding and must be zero.
                    first[self.dims[0]..].fill(0.0);
                    second[self.dims[0]..].fill(0.0);
                }
            });
        Self {
            dims: self.dims,
            pitch: self.pitch,
            images: parts,
        }
    }

    /// Raises `maxima` to one minus the squared ratio of the weighted sums: the harmonic mean of
    /// the two halves of each line.
    fn raise_maxima(
        &self,
        lines: &[[Vec<LineTap<D>>; 2]],
        maxima: &mut [f32],
        cancel: &CancelToken<'_>,
    ) {
        let nx = self.dims[0];
        maxima
            .par_chunks_mut(ROWS_PER_TASK * nx)
            .enumerate()
            .for_each_init(
                <[Vec<(usize, f32)>; 2]>::default,
                |starts, (number, maxima)| {
                    for line in lines {
                        if cancel.is_cancelled() {
                            return;
                        }
                        for (row, row_maxima) in maxima.chunks_mut(nx).enumerate() {
                            for (starts, half) in starts.iter_mut().zip(line) {
                                self.row_taps(number * ROWS_PER_TASK + row, half, starts);
                            }
                            dispatch_simd(
                                #[inline(always)]
                                || self.raise_row_maxima(starts, row_maxima),
                            );
                        }
                    }
                },
            );
    }

    #[inline(always)]
    fn raise_row_maxima(&self, [up, down]: &[Vec<(usize, f32)>; 2], maxima: &mut [f32]) {
        for (block, block_maxima) in maxima.chunks_mut(LANES).enumerate() {
            let up = self.complement(up, block * LANES);
            let down = self.complement(down, block * LANES);
            for (lane, max) in block_maxima.iter_mut().enumerate() {
                let (up, down) = (up[lane], down[lane]);
                *max = max.max(2.0 * up * down / (up + down + f32::MIN_POSITIVE));
            }
        }
    }

    /// Returns one minus the squared ratio of the weighted sums.
    #[inline(always)]
    fn complement(&self, starts: &[(usize, f32)], x: usize) -> [f32; LANES] {
        let [mut a, b] = self.sums(starts, x);
        for lane in 0..LANES {
            let ratio = a[lane] / b[lane];
            a[lane] = (1.0 - ratio * ratio).max(0.0);
        }
        a
    }

    /// Returns the weighted sums of both images for the lanes from `x` on.
    #[inline(always)]
    fn sums(&self, starts: &[(usize, f32)], x: usize) -> [[f32; LANES]; 2] {
        let mut sums = [[0.0f32; LANES]; 2];
        let [a, b] = &mut sums;
        for &(start, weight) in starts {
            let lanes = |part: &[f32]| -> [f32; LANES] {
                part[start + x..]
                    .first_chunk()
                    .copied()
                    .unwrap_or([0.0; LANES])
            };
            let (lanes_a, lanes_b) = (lanes(&self.images[0]), lanes(&self.images[1]));
            for lane in 0..LANES {
                a[lane] += weight * lanes_a[lane];
                b[lane] += weight * lanes_b[lane];
            }
        }
        sums
    }
}

/// Interpolates the samples of all planes linearly from those of every [`ROW_STRIDE`]-th plane.
fn interpolate_rows<const D: usize>(
    thinned_dims: [usize; D],
    samples: &[f32],
    axis: usize,
    dims: [usize; D],
) -> Vec<f32> {
    let (source, target) = (
        Volume {
            dims: thinned_dims,
            samples,
        },
        Volume { dims, samples: &[] },
    );
    (0..dims.iter().product())
        .into_par_iter()
        .map(|i| {
            let mut at = target.coordinates(i);
            let fraction = (at[axis] % ROW_STRIDE) as f32 / ROW_STRIDE as f32;
            at[axis] /= ROW_STRIDE;
            let low = samples[source.index(at)];
            at[axis] = (at[axis] + 1).min(thinned_dims[axis] - 1);
            low + fraction * (samples[source.index(at)] - low)
        })
        .collect()
}

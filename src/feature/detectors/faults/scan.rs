//! How likely a fault runs through each sample, over all steep planes through it.
//!
//! Hale (2013, "Methods to compute fault images, extract fault surfaces, and estimate fault throws
//! from 3D seismic images") smooths the semblance's numerator and denominator over a piece of each
//! plane that a fault may run along, one strike and dip after the other, before he divides them:
//! noise and the odd bad sample lower the semblance of no whole plane, but a fault does. Here the
//! piece above a sample and the piece below must both say so, as otherwise one spot where waveforms
//! differ draws a star of planes.
//!
//! A plane is described by the horizontal axis that it crosses and its slopes along the other axes.
//! Smoothing over it is one pass of shifted rows along its strike and, for each dip, one along the
//! dip. PaddedRows are padded by zeros: beyond the box numerator and denominator lose the same weights.

use crate::feature::volume::Volume;
use crate::geometry::simd::dispatch_simd;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Standard deviation (samples) of the weights along a fault's strike ...
const STRIKE_SIGMA: f64 = 6.0;
/// ... and along its dip.
const DIP_SIGMA: f64 = 12.0;

/// Weights are cut at this many standard deviations.
const CUTOFF_SIGMAS: f64 = 2.5;

/// Slopes of strikes against the axis that the fault does not cross: beyond one, it crosses it.
const STRIKE_SLOPES: [f64; 7] = [-1.0, -0.67, -0.33, 0.0, 0.33, 0.67, 1.0];

/// Samples that a fault moves sideways for one up or down: from vertical to 40 degrees.
const MAX_DIP_SLOPE: f64 = 1.2;
/// Number of dips to either side of the vertical.
const DIP_COUNT: i32 = 6;

/// How far (samples) from a sample planes are followed along any axis: up and down; sideways along a strike and then
/// along a dip it is less than that and an eighth more; and what is filled in between planes that are scanned.
pub const SCAN_REACH: usize = 36;

/// Vertical distance (samples) of the planes that are scanned: semblance is smooth there.
const ROW_STRIDE: usize = 2;

/// The share of the search for faults that is done after the scan, roughly.
const PROGRESS_SCANNED: f64 = 0.8;

/// Samples of x handled at once: the sums stay in registers.
const LANES: usize = 32;

/// PaddedRows per parallel task.
const ROWS_PER_TASK: usize = 16;

/// One less the squared semblance, in [0, 1], of the steep plane through each sample for which it is
/// lowest: of its upper and its lower half, the harmonic mean.
///
/// `parts(across, every)` are numerator and denominator of the semblance, both positive, between the two
/// sides of faults square to the horizontal direction `across`, on every so many planes along `vertical`,
/// the axis that layers lie across.
pub fn likelihood<const D: usize>(
    dims: [usize; D],
    vertical: usize,
    patience: &CancelToken<'_>,
    parts: impl Fn([f64; D], usize) -> [Vec<f32>; 2],
) -> Vec<f32> {
    let mut thin = dims;
    thin[vertical] = dims[vertical].div_ceil(ROW_STRIDE);
    let mut most = vec![0.0f32; thin.iter().product()];
    let horizontal = |k: &usize| *k != vertical;
    // Each strike once.
    let strikes = if D == 2 {
        1
    } else {
        2 * STRIKE_SLOPES.len() - 1
    } as f64;
    let mut done = 0.0;
    for across in (0..D).filter(horizontal) {
        let dips: Vec<[Vec<LineTap<D>>; 2]> = (-DIP_COUNT..=DIP_COUNT)
            .map(|dip| {
                let slope = MAX_DIP_SLOPE * f64::from(dip) / f64::from(DIP_COUNT);
                let line = taps(vertical, ROW_STRIDE as f64, across, slope, DIP_SIGMA);
                let half = |keep: fn(i32) -> bool| {
                    let kept = line.iter().filter(|(offset, _)| keep(offset[vertical]));
                    kept.copied().collect()
                };
                [half(|v| v >= 0), half(|v| v <= 0)]
            })
            .collect();
        let Some(along) = (0..D).find(|k| horizontal(k) && *k != across) else {
            let mut normal = [0.0; D];
            normal[across] = 1.0;
            PaddedRows::new(thin, parts(normal, ROW_STRIDE))
                .raise_maxima(&dips, &mut most, patience);
            continue;
        };
        // Strikes at 45 degrees cross both axes: once is enough.
        let last = STRIKE_SLOPES.len() - usize::from(along < across);
        for &slope in &STRIKE_SLOPES[usize::from(along < across)..last] {
            let mut normal = [0.0; D];
            normal[across] = 1.0;
            normal[along] = -slope;
            let strike = taps(along, 1.0, across, slope, STRIKE_SIGMA);
            PaddedRows::new(thin, parts(normal, ROW_STRIDE))
                .smooth(&strike, patience)
                .raise_maxima(&dips, &mut most, patience);
            done += 1.0;
            patience.set_fraction(PROGRESS_SCANNED * done / strikes);
        }
    }
    interpolate_rows(thin, &most, vertical, dims)
}

/// Offset of a sample (in samples) and its weight.
type LineTap<const D: usize> = ([i32; D], f32);

/// Gaussian weights on a line that advances by `step` along one axis and `slope` times that across.
fn taps<const D: usize>(
    along: usize,
    step: f64,
    across: usize,
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
        for (far, share) in [(0, 1.0 - share), (1, share)] {
            if share > 1e-6 {
                let mut offset = [0; D];
                offset[along] = k;
                offset[across] = sideways.floor() as i32 + far;
                taps.push((offset, (weight * share) as f32));
            }
        }
    }
    taps
}

/// Two images in rows of x with zeros on either side.
struct PaddedRows<const D: usize> {
    dims: [usize; D],
    /// From one row to the next.
    pitch: usize,
    images: [Vec<f32>; 2],
}

/// Zeros on either side of a row: as far as any tap reaches.
const MARGIN: usize = 32;

impl<const D: usize> PaddedRows<D> {
    fn new(dims: [usize; D], parts: [Vec<f32>; 2]) -> Self {
        let pitch = dims[0].next_multiple_of(LANES) + 2 * MARGIN;
        let images = parts.map(|part| {
            let mut padded = vec![0.0; part.len() / dims[0].max(1) * pitch];
            for (to, from) in padded.chunks_mut(pitch).zip(part.chunks(dims[0])) {
                to[MARGIN..][..dims[0]].copy_from_slice(from);
            }
            padded
        });
        Self {
            dims,
            pitch,
            images,
        }
    }

    /// Where, in memory, the taps of a row begin, and their weights; taps in rows outside are left out.
    fn row_taps(&self, row: usize, taps: &[LineTap<D>], starts: &mut Vec<(usize, f32)>) {
        starts.clear();
        let mut at = [0; D];
        let mut rest = row;
        for k in 1..D {
            at[k] = (rest % self.dims[k]) as i32;
            rest /= self.dims[k];
        }
        for (offset, weight) in taps {
            let mut row = 0;
            let mut inside = true;
            for k in (1..D).rev() {
                let i = at[k] + offset[k];
                inside &= i >= 0 && (i as usize) < self.dims[k];
                row = row * self.dims[k] + i.max(0) as usize;
            }
            if inside {
                let start = row * self.pitch + MARGIN;
                starts.push((start.wrapping_add_signed(offset[0] as isize), *weight));
            }
        }
    }

    /// Weighted sums over the taps.
    fn smooth(&self, taps: &[LineTap<D>], patience: &CancelToken<'_>) -> Self {
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
                    if patience.is_cancelled() {
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
                    // The lanes past the row's end belong to the zeros.
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

    /// Raises `most` to what is missing of the squared ratio of the weighted sums to one, the
    /// harmonic mean of the two halves of each line.
    fn raise_maxima(
        &self,
        lines: &[[Vec<LineTap<D>>; 2]],
        most: &mut [f32],
        patience: &CancelToken<'_>,
    ) {
        let nx = self.dims[0];
        most.par_chunks_mut(ROWS_PER_TASK * nx)
            .enumerate()
            .for_each_init(
                <[Vec<(usize, f32)>; 2]>::default,
                |starts, (number, most)| {
                    for line in lines {
                        if patience.is_cancelled() {
                            return;
                        }
                        for (row, most) in most.chunks_mut(nx).enumerate() {
                            for (starts, half) in starts.iter_mut().zip(line) {
                                self.row_taps(number * ROWS_PER_TASK + row, half, starts);
                            }
                            dispatch_simd(
                                #[inline(always)]
                                || self.raise_row_maxima(starts, most),
                            );
                        }
                    }
                },
            );
    }

    #[inline(always)]
    fn raise_row_maxima(&self, [up, down]: &[Vec<(usize, f32)>; 2], most: &mut [f32]) {
        for (block, most) in most.chunks_mut(LANES).enumerate() {
            let up = self.complement(up, block * LANES);
            let down = self.complement(down, block * LANES);
            for (lane, most) in most.iter_mut().enumerate() {
                let (up, down) = (up[lane], down[lane]);
                *most = most.max(2.0 * up * down / (up + down + f32::MIN_POSITIVE));
            }
        }
    }

    /// What is missing of the squared ratio to one.
    #[inline(always)]
    fn complement(&self, starts: &[(usize, f32)], x: usize) -> [f32; LANES] {
        let [mut a, b] = self.sums(starts, x);
        for lane in 0..LANES {
            let ratio = a[lane] / b[lane];
            a[lane] = (1.0 - ratio * ratio).max(0.0);
        }
        a
    }

    /// Weighted sums of both parts for the lanes from `x` on.
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
            let (from_a, from_b) = (lanes(&self.images[0]), lanes(&self.images[1]));
            for lane in 0..LANES {
                a[lane] += weight * from_a[lane];
                b[lane] += weight * from_b[lane];
            }
        }
        sums
    }
}

/// Samples of all planes from those of every [`ROW_STRIDE`]-th: linear between them.
fn interpolate_rows<const D: usize>(
    thin: [usize; D],
    samples: &[f32],
    axis: usize,
    dims: [usize; D],
) -> Vec<f32> {
    let (from, to) = (
        Volume {
            dims: thin,
            samples,
        },
        Volume { dims, samples: &[] },
    );
    (0..dims.iter().product())
        .into_par_iter()
        .map(|i| {
            let mut at = to.coordinates(i);
            let share = (at[axis] % ROW_STRIDE) as f32 / ROW_STRIDE as f32;
            at[axis] /= ROW_STRIDE;
            let low = samples[from.index(at)];
            at[axis] = (at[axis] + 1).min(thin[axis] - 1);
            low + share * (samples[from.index(at)] - low)
        })
        .collect()
}

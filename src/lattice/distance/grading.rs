//! Limits the growth of a field: |grad d| <= g, by fast sweeping.

use std::ops::Range;

use crate::parallel::prelude::*;

use crate::comm::Comm;
use crate::error::Result;
use crate::geometry::simd::dispatch_simd;
use crate::image::ScalarField;
use crate::progress::CancelToken;

/// Samples that are swept in one task, at least.
const MIN_SAMPLES_PER_TASK: usize = 1 << 12;

/// Lowers `field`, which is positive, to the largest function below it whose gradient is nowhere longer than `growth`
/// (per lattice unit); never raises a sample, so every minimum is kept.
///
/// This is the viscosity solution of |grad d| = `growth` with the field as an obstacle from above,
/// found by Gauss-Seidel sweeps in the 2^D diagonal orders with Godunov's upwind difference (Zhao,
/// "A fast sweeping method for eikonal equations", 2005), until no sample falls any more: so it makes no
/// difference in which order samples are looked at. First-order accurate in the grid step.
///
/// Rows of which neither is beside the other are swept at the same time (Zhao, "Parallel implementations of the
/// fast sweeping method", 2007).
pub fn limit_gradient<const D: usize>(
    field: &mut ScalarField<D>,
    growth: f64,
    patience: &CancelToken<'_>,
) {
    let rows = row_count(field);
    FastSweeping::new(field, 0..rows, growth).sweep_until_stable(patience);
}

/// The same of a field of which each of a group has its `layers` along the last axis; of the whole this has those from
/// `first` on, its own and those of others beside them.
///
/// # Errors
/// Those of the others.
pub(super) fn limit_gradient_in_layers<const D: usize>(
    field: &mut ScalarField<D>,
    first: usize,
    layers: &[Range<usize>],
    growth: f64,
    patience: &CancelToken<'_>,
    group: &dyn Comm,
) -> Result<()> {
    let all = row_count(field);
    let (rank, samples) = (group.rank(), field.dims[..D - 1].iter().product::<usize>());
    let of_layer = samples / field.dims[0].max(1);
    let own = layers[rank].clone();
    let held = match own.is_empty() {
        true => 0..0,
        false => (own.start - first) * of_layer..((own.end - first) * of_layer).min(all),
    };
    let mut sweeps = FastSweeping::new(field, held, growth);
    // The layers beside each one's own.
    let beside = |of: usize| match layers[of].is_empty() {
        true => [None; 2],
        false => [layers[of].start.checked_sub(1), Some(layers[of].end)],
    };
    let mut first_time = true;
    loop {
        let changed = sweeps.sweep_until_stable(patience) || std::mem::take(&mut first_time);
        let told = (0..layers.len()).map(|to| -> Vec<(usize, Vec<f32>)> {
            let wanted = beside(to).into_iter().flatten();
            let wanted = wanted.filter(|at| changed && to != rank && own.contains(at));
            let layer = |at| sweeps.field.samples[(at - first) * samples..][..samples].to_vec();
            wanted.map(|at| (at, layer(at))).collect()
        });
        let told: Vec<Vec<(usize, Vec<f32>)>> =
            group.all_to_all("layers of distances", told.collect())?;
        let mut lower = false;
        for (at, layer) in told.into_iter().flatten() {
            lower |= sweeps.lower_layer(at - first, &layer);
        }
        let all: Vec<(bool, bool)> =
            group.all_gather("distances", (lower, patience.is_cancelled()))?;
        if !all.iter().any(|(lower, _)| *lower) || all.iter().any(|(_, over)| *over) {
            return Ok(());
        }
    }
}

/// Rows along the first axis.
fn row_count<const D: usize>(field: &ScalarField<D>) -> usize {
    field.dims[1..].iter().product()
}

struct FastSweeping<'a, const D: usize> {
    field: &'a mut ScalarField<D>,
    growth: f64,
    /// Rows along the first axis that may change at all ...
    mutable_rows: Range<usize>,
    /// ... and those that a sweep may change: those that the last one changed, or beside which one has changed since.
    active_rows: Vec<bool>,
}

/// A row after a sweep that has changed it.
struct LoweredRow {
    row: usize,
    samples: Vec<f32>,
}

impl<'a, const D: usize> FastSweeping<'a, D> {
    fn new(field: &'a mut ScalarField<D>, mutable_rows: Range<usize>, growth: f64) -> Self {
        let mut active_rows = vec![false; row_count(field)];
        active_rows[mutable_rows.clone()].fill(true);
        Self {
            field,
            growth,
            mutable_rows,
            active_rows,
        }
    }

    /// Sweeps until nothing changes; whether anything has.
    fn sweep_until_stable(&mut self, patience: &CancelToken<'_>) -> bool {
        let mut any = false;
        loop {
            let sweeps = (0..1usize << D).map(|order| self.sweep(order, patience));
            let changed = sweeps.fold(false, |all, one| all | one);
            any |= changed;
            if !changed || patience.is_cancelled() {
                return any;
            }
        }
    }

    /// Lowers the samples of a layer to those of another; whether any was higher.
    fn lower_layer(&mut self, at: usize, layer: &[f32]) -> bool {
        let (count, mut any) = (self.field.dims[0], false);
        let rows = layer.len() / count;
        for (row, lower) in (at * rows..).zip(layer.chunks_exact(count)) {
            let own = &mut self.field.samples[row * count..][..count];
            let lowered = own.iter_mut().zip(lower).fold(false, |any, (own, &lower)| {
                let falls = lower < *own;
                *own = own.min(lower);
                any | falls
            });
            if lowered {
                self.activate_adjacent(row);
                any = true;
            }
        }
        any
    }

    /// Rows beside one may be lower now.
    fn activate_adjacent(&mut self, row: usize) {
        for row in self.adjacent_rows(row).into_iter().flatten().flatten() {
            self.active_rows[row] = self.mutable_rows.contains(&row);
        }
    }

    /// One pass in the direction given by the bits of `order`; returns whether anything changed.
    fn sweep(&mut self, order: usize, patience: &CancelToken<'_>) -> bool {
        let across = |k: usize| self.field.dims.get(k).copied().unwrap_or(1);
        let [wide, high] = [across(1), across(2)];
        let turned = |k: usize, count: usize, i: usize| match order >> k & 1 {
            0 => i,
            _ => count - 1 - i,
        };
        let mut changed = false;
        for diagonal in 0..wide + high - 1 {
            if patience.is_cancelled() {
                break;
            }
            let rows = (diagonal + 1).saturating_sub(wide)..high.min(diagonal + 1);
            let row = |k| turned(2, high, k) * wide + turned(1, wide, diagonal - k);
            let open: Vec<usize> = rows.map(row).filter(|&row| self.active_rows[row]).collect();
            let least = (MIN_SAMPLES_PER_TASK / self.field.dims[0].max(1)).max(1);
            let lowered: Vec<Option<LoweredRow>> = open
                .par_iter()
                .with_min_len(least)
                .map(|&row| self.lower_row(row, order & 1 == 1))
                .collect();
            open.iter().for_each(|&row| self.active_rows[row] = false);
            for LoweredRow { row, samples } in lowered.into_iter().flatten() {
                changed = true;
                self.field.samples[row * samples.len()..][..samples.len()]
                    .copy_from_slice(&samples);
                self.active_rows[row] = true;
                self.activate_adjacent(row);
            }
        }
        changed
    }

    /// The rows before and after a row along the other axes, where there are any.
    fn adjacent_rows(&self, row: usize) -> [[Option<usize>; 2]; 2] {
        let mut stride = 1;
        [1, 2].map(|k| {
            let count = self.field.dims.get(k).copied().unwrap_or(1);
            let (at, s) = (row / stride % count, stride);
            stride *= count;
            [(at > 0).then(|| row - s), (at + 1 < count).then(|| row + s)]
        })
    }

    /// A row swept, if that changes it.
    fn lower_row(&self, row: usize, backward: bool) -> Option<LoweredRow> {
        let count = self.field.dims[0];
        let samples = |row: usize| &self.field.samples[row * count..][..count];
        // Where there is none on a side, the row on the other, and on either, the row itself: none is lower than it.
        let around = self.adjacent_rows(row).map(|[before, after]| {
            [before.or(after), after.or(before)].map(|other| samples(other.unwrap_or(row)))
        });
        let slope = SlopeLimit {
            inverse_step2: self.field.step.map(|h| 1.0 / (h * h)),
            slope2: self.growth * self.growth,
        };
        let own = samples(row);
        let low = |own: &[f32], i: usize, k: usize| match k {
            0 => own[i.max(1) - 1].min(own[(i + 1).min(count - 1)]),
            _ => around[k - 1][0][i].min(around[k - 1][1][i]),
        };
        let ends = [0, count - 1].map(|i| slope.needs_lowering(own[i], |k| low(own, i, k)));
        if !ends.contains(&true) && !slope.interior_needs_lowering(own, around) {
            return None;
        }
        let mut own = own.to_vec();
        let mut changed = false;
        for i in 0..count {
            let i = if backward { count - 1 - i } else { i };
            if slope.needs_lowering(own[i], |k| low(&own, i, k)) {
                let mut lows = std::array::from_fn(|k| (low(&own, i, k), slope.inverse_step2[k]));
                let new = slope.solve_upwind(&mut lows);
                changed |= new < own[i];
                own[i] = new.min(own[i]);
            }
        }
        changed.then_some(LoweredRow { row, samples: own })
    }
}

/// How steep a field may be.
#[derive(Clone, Copy)]
struct SlopeLimit<const D: usize> {
    /// One over the squares of steps.
    inverse_step2: [f64; D],
    /// The square of the slope.
    slope2: f64,
}

impl<const D: usize> SlopeLimit<D> {
    /// Whether a sample must fall, its lower neighbours along axes being these: whether what [`upwind`](Self::solve_upwind) gives
    /// is rounded to less.
    #[inline(always)]
    fn needs_lowering(self, sample: f32, low: impl Fn(usize) -> f32) -> bool {
        // Of what is positive, the next smaller number has the bits of one less.
        let next = f32::from_bits(sample.to_bits().wrapping_sub(1));
        let less = 0.5 * (f64::from(sample) + f64::from(next));
        let square = |k: usize| (less - f64::from(low(k))).max(0.0).powi(2) * self.inverse_step2[k];
        (0..D).map(square).sum::<f64>() > self.slope2
    }

    /// Whether any sample of a row but the first and the last must fall; the rows on both sides are these.
    fn interior_needs_lowering(self, own: &[f32], around: [[&[f32]; 2]; 2]) -> bool {
        let Some(last) = own.len().checked_sub(2) else {
            return false;
        };
        let [[a, b], [c, d]] = around.map(|sides| sides.map(|row| &row[1..=last]));
        let (before, after, own) = (&own[..last], &own[2..], &own[1..=last]);
        dispatch_simd(
            #[inline(always)]
            || {
                let mut any = false;
                for i in 0..own.len() {
                    let lows = [before[i].min(after[i]), a[i].min(b[i]), c[i].min(d[i])];
                    any |= self.needs_lowering(own[i], |k| lows[k]);
                }
                any
            },
        )
    }

    /// Solves sum_k (max(d - low_k, 0) / h_k)^2 = slope^2 for d. In twice the digits of what it is made of and gives, so
    /// that lower neighbours never make it higher.
    #[inline]
    fn solve_upwind(self, lows: &mut [(f32, f64); D]) -> f32 {
        for i in 1..D {
            for j in (1..=i).rev() {
                if lows[j].0 < lows[j - 1].0 {
                    lows.swap(j, j - 1);
                }
            }
        }
        // Measured from the lowest neighbour, so that the quadratic loses no digits.
        let base = f64::from(lows[0].0);
        let (mut a, mut b, mut c) = (0.0f64, 0.0f64, -self.slope2);
        let mut d = 0.0;
        for &(low, w) in lows.iter() {
            let u = f64::from(low) - base;
            if a > 0.0 && d <= u {
                break;
            }
            a += w;
            b += u * w;
            c += u * u * w;
            d = (b + (b * b - a * c).max(0.0).sqrt()) / a;
        }
        (base + d) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cone(step: [f64; 3], dims: [usize; 3]) -> (ScalarField<3>, [f64; 3]) {
        let count = dims.iter().product();
        let mut field = ScalarField {
            dims,
            step,
            samples: vec![1e3; count],
        };
        let at = dims.map(|n| n / 2);
        field.samples[(at[2] * dims[1] + at[1]) * dims[0] + at[0]] = 3.0;
        (field, std::array::from_fn(|k| at[k] as f64 * step[k]))
    }

    #[test]
    fn a_single_minimum_becomes_a_cone() {
        let (mut field, apex) = cone([1.0, 1.5, 2.0], [41, 31, 25]);
        limit_gradient(&mut field, 0.1, &CancelToken::never());
        let mut worst = 0.0f64;
        for z in 0..25 {
            for y in 0..31 {
                for x in 0..41 {
                    let p = [x as f64, y as f64 * 1.5, z as f64 * 2.0];
                    let r = (0..3).map(|k| (p[k] - apex[k]).powi(2)).sum::<f64>().sqrt();
                    let got = f64::from(field.samples[(z * 31 + y) * 41 + x]);
                    worst = worst.max((got - 3.0 - 0.1 * r).abs() / 0.1);
                }
            }
        }
        // First-order upwind from a point source is late by h log(r / h), h <= 2, r <= 36.
        assert!(worst < 3.0, "{worst}");
    }

    /// The same, one sample after the other and none passed over.
    fn limit_naively(field: &mut ScalarField<3>, growth: f64) {
        let [nx, ny, nz] = field.dims;
        let slope = SlopeLimit {
            inverse_step2: field.step.map(|h| 1.0 / (h * h)),
            slope2: growth * growth,
        };
        let mut changed = false;
        for pass in 0.. {
            let order = pass % 8;
            if order == 0 && !std::mem::take(&mut changed) && pass > 0 {
                break;
            }
            let turned = |k: usize, count: usize, i: usize| match order >> k & 1 {
                0 => i,
                _ => count - 1 - i,
            };
            for at in 0..nx * ny * nz {
                let x = turned(0, nx, at % nx);
                let y = turned(1, ny, at / nx % ny);
                let z = turned(2, nz, at / nx / ny);
                let index = [x, y, z];
                let at = (z * ny + y) * nx + x;
                let mut lows = [0, 1, 2].map(|k| {
                    let stride = [1, nx, nx * ny][k];
                    let below = match index[k] {
                        0 => f32::INFINITY,
                        _ => field.samples[at - stride],
                    };
                    let above = match index[k] + 1 == field.dims[k] {
                        true => f32::INFINITY,
                        false => field.samples[at + stride],
                    };
                    (below.min(above), slope.inverse_step2[k])
                });
                let old = field.samples[at];
                let new = slope.solve_upwind(&mut lows);
                if new < old {
                    changed = true;
                    field.samples[at] = new;
                }
            }
        }
    }

    #[test]
    fn rows_swept_at_the_same_time_give_what_one_after_the_other_does() {
        for dims in [[23, 31, 17], [40, 1, 19], [5, 64, 1], [1, 30, 30]] {
            let count = dims.iter().product();
            let height = |i: usize| match i % 97 {
                0 => 2.0 + (i % 13) as f32,
                _ => 40.0,
            };
            let mut field = ScalarField {
                dims,
                step: [1.0, 1.5, 0.75],
                samples: (0..count).map(height).collect(),
            };
            let mut plain = field.clone();
            limit_gradient(&mut field, 0.3, &CancelToken::never());
            limit_naively(&mut plain, 0.3);
            assert!(field == plain, "{dims:?}");
        }
    }

    #[test]
    fn nothing_rises_minima_stay_and_growth_is_bounded() {
        let dims = [24, 20, 17];
        let samples: Vec<f32> = (0..24 * 20 * 17)
            .map(|i: usize| 4.0 + (i * 7919 % 1009) as f32 / 100.0)
            .collect();
        let mut field = ScalarField {
            dims,
            step: [1.0; 3],
            samples: samples.clone(),
        };
        limit_gradient(&mut field, 0.25, &CancelToken::never());
        let least = |s: &[f32]| s.iter().copied().fold(f32::INFINITY, f32::min);
        assert_eq!(least(&samples), least(&field.samples));
        assert!(field.samples.iter().zip(&samples).all(|(a, b)| a <= b));
        let mut steepest = 0.0f32;
        for z in 0..17 {
            for y in 0..20 {
                for x in 0..24 {
                    let at = (z * 20 + y) * 24 + x;
                    let here = field.samples[at];
                    let drop = |inside: bool, s: usize| {
                        if inside {
                            (here - field.samples[at - s].min(here)).max(0.0)
                        } else {
                            0.0
                        }
                    };
                    let rise = |inside: bool, s: usize| {
                        if inside {
                            (here - field.samples[at + s].min(here)).max(0.0)
                        } else {
                            0.0
                        }
                    };
                    let gx = drop(x > 0, 1).max(rise(x < 23, 1));
                    let gy = drop(y > 0, 24).max(rise(y < 19, 24));
                    let gz = drop(z > 0, 480).max(rise(z < 16, 480));
                    steepest = steepest.max((gx * gx + gy * gy + gz * gz).sqrt());
                }
            }
        }
        assert!(steepest <= 0.25 * 1.001, "{steepest}");
    }
}

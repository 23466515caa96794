//! Limits the slope of a field, |grad d| <= g, by fast sweeping.

use std::ops::Range;

use crate::parallel::prelude::*;

use crate::geometry::simd::dispatch_simd;
use crate::image::ScalarField;
use crate::progress::CancelToken;

/// Fewest samples per parallel task.
const MIN_SAMPLES_PER_TASK: usize = 1 << 12;

/// Lowers `field`, which is positive, to the largest function below it whose gradient is nowhere
/// longer than `growth` (per lattice unit). A sample is never raised, so every minimum is
/// preserved.
///
/// The result is the viscosity solution of |grad d| = `growth` with the field as an obstacle from
/// above. It is found by Gauss-Seidel sweeps in the 2^D diagonal orders with Godunov's upwind
/// difference (Zhao, "A fast sweeping method for eikonal equations", 2005). Sweeps are repeated
/// until no sample falls any more, so the order of samples does not change the result. The method
/// is of first order in the grid step.
///
/// Rows that are not adjacent to each other are swept at the same time (Zhao, "Parallel
/// implementations of the fast sweeping method", 2007).
pub fn limit_gradient<const D: usize>(
    field: &mut ScalarField<D>,
    growth: f64,
    cancel: &CancelToken<'_>,
) {
    let rows = row_count(field);
    FastSweeping::new(field, 0..rows, growth).sweep_until_stable(cancel);
}

/// Returns the count of rows along the first axis.
pub(super) fn row_count<const D: usize>(field: &ScalarField<D>) -> usize {
    field.dims[1..].iter().product()
}

/// Sweeps over a field, of which some rows may change.
pub(super) struct FastSweeping<'a, const D: usize> {
    pub field: &'a mut ScalarField<D>,
    growth: f64,
    /// Rows along the first axis that may change at all.
    mutable_rows: Range<usize>,
    /// `true` for each row that a sweep may change: a row that the last sweep changed, or that has
    /// an adjacent row that has changed since.
    active_rows: Vec<bool>,
}

/// A row that a sweep has changed.
struct LoweredRow {
    row: usize,
    samples: Vec<f32>,
}

impl<'a, const D: usize> FastSweeping<'a, D> {
    pub fn new(field: &'a mut ScalarField<D>, mutable_rows: Range<usize>, growth: f64) -> Self {
        let mut active_rows = vec![false; row_count(field)];
        active_rows[mutable_rows.clone()].fill(true);
        Self {
            field,
            growth,
            mutable_rows,
            active_rows,
        }
    }

    /// Sweeps until nothing changes. Returns `true` if any sample has changed.
    pub fn sweep_until_stable(&mut self, cancel: &CancelToken<'_>) -> bool {
        let mut has_changed = false;
        loop {
            let sweeps = (0..1usize << D).map(|order| self.sweep(order, cancel));
            let changed = sweeps.fold(false, |all, sweep| all | sweep);
            has_changed |= changed;
            if !changed || cancel.is_cancelled() {
                return has_changed;
            }
        }
    }

    /// Lowers the samples of layer `index` to those of `layer` where these are lower. Returns
    /// `true` if any sample has changed.
    pub fn lower_layer(&mut self, index: usize, layer: &[f32]) -> bool {
        let (count, mut has_lowered) = (self.field.dims[0], false);
        let rows = layer.len() / count;
        for (row, lower) in (index * rows..).zip(layer.chunks_exact(count)) {
            let samples = &mut self.field.samples[row * count..][..count];
            let lowered = samples
                .iter_mut()
                .zip(lower)
                .fold(false, |any, (own, &lower)| {
                    let is_lower = lower < *own;
                    *own = own.min(lower);
                    any | is_lower
                });
            if lowered {
                self.activate_adjacent(row);
                has_lowered = true;
            }
        }
        has_lowered
    }

    /// Marks the rows adjacent to a changed row as active.
    fn activate_adjacent(&mut self, row: usize) {
        for row in self.adjacent_rows(row).into_iter().flatten().flatten() {
            self.active_rows[row] = self.mutable_rows.contains(&row);
        }
    }

    /// Sweeps once in the direction given by the bits of `order`. Returns `true` if any sample has
    /// changed.
    fn sweep(&mut self, order: usize, cancel: &CancelToken<'_>) -> bool {
        let len_along = |k: usize| self.field.dims.get(k).copied().unwrap_or(1);
        let [row_columns, row_layers] = [len_along(1), len_along(2)];
        let directed = |k: usize, count: usize, i: usize| match order >> k & 1 {
            0 => i,
            _ => count - 1 - i,
        };
        let mut changed = false;
        for diagonal in 0..row_columns + row_layers - 1 {
            if cancel.is_cancelled() {
                break;
            }
            let rows = (diagonal + 1).saturating_sub(row_columns)..row_layers.min(diagonal + 1);
            let row_at = |k| {
                directed(2, row_layers, k) * row_columns + directed(1, row_columns, diagonal - k)
            };
            let active: Vec<usize> = rows
                .map(row_at)
                .filter(|&row| self.active_rows[row])
                .collect();
            let min_rows = (MIN_SAMPLES_PER_TASK / self.field.dims[0].max(1)).max(1);
            let lowered: Vec<Option<LoweredRow>> = active
                .par_iter()
                .with_min_len(min_rows)
                .map(|&row| self.lower_row(row, order & 1 == 1))
                .collect();
            active.iter().for_each(|&row| self.active_rows[row] = false);
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

    /// Returns the rows before and after a row along the other axes, where they exist.
    fn adjacent_rows(&self, row: usize) -> [[Option<usize>; 2]; 2] {
        let mut stride = 1;
        [1, 2].map(|k| {
            let count = self.field.dims.get(k).copied().unwrap_or(1);
            let (coordinate, s) = (row / stride % count, stride);
            stride *= count;
            [
                (coordinate > 0).then(|| row - s),
                (coordinate + 1 < count).then(|| row + s),
            ]
        })
    }

    /// Sweeps a row. Returns its new samples if any has changed.
    fn lower_row(&self, row: usize, backward: bool) -> Option<LoweredRow> {
        let count = self.field.dims[0];
        let samples = |row: usize| &self.field.samples[row * count..][..count];
        // Where a row is missing on one side, the row on the other side takes its place, and where
        // both are missing, the row itself: none of these is lower than the missing one would
        // allow.
        let adjacent = self.adjacent_rows(row).map(|[before, after]| {
            [before.or(after), after.or(before)].map(|other| samples(other.unwrap_or(row)))
        });
        let slope = SlopeLimit {
            inverse_step2: self.field.step.map(|h| 1.0 / (h * h)),
            slope2: self.growth * self.growth,
        };
        let samples = samples(row);
        let lower_neighbour = |samples: &[f32], i: usize, k: usize| match k {
            0 => samples[i.max(1) - 1].min(samples[(i + 1).min(count - 1)]),
            _ => adjacent[k - 1][0][i].min(adjacent[k - 1][1][i]),
        };
        let ends = [0, count - 1]
            .map(|i| slope.needs_lowering(samples[i], |k| lower_neighbour(samples, i, k)));
        if !ends.contains(&true) && !slope.interior_needs_lowering(samples, adjacent) {
            return None;
        }
        let mut samples = samples.to_vec();
        let mut changed = false;
        for i in 0..count {
            let i = if backward { count - 1 - i } else { i };
            if slope.needs_lowering(samples[i], |k| lower_neighbour(&samples, i, k)) {
                let mut neighbours = std::array::from_fn(|k| {
                    (lower_neighbour(&samples, i, k), slope.inverse_step2[k])
                });
                let new = slope.solve_upwind(&mut neighbours);
                changed |= new < samples[i];
                samples[i] = new.min(samples[i]);
            }
        }
        changed.then_some(LoweredRow { row, samples })
    }
}

/// The bound on the slope of a field, with the steps of its grid.
#[derive(Clone, Copy)]
struct SlopeLimit<const D: usize> {
    /// One over the square of the step along each axis.
    inverse_step2: [f64; D],
    /// Square of the largest slope.
    slope2: f64,
}

impl<const D: usize> SlopeLimit<D> {
    /// Returns `true` if a sample must fall, that is, if [`solve_upwind`](Self::solve_upwind) gives
    /// a value that is rounded to less. `low(k)` is the lower neighbour along axis k.
    #[inline(always)]
    fn needs_lowering(self, sample: f32, low: impl Fn(usize) -> f32) -> bool {
        // The next smaller number than a positive one has its bits minus one.
        let next = f32::from_bits(sample.to_bits().wrapping_sub(1));
        let threshold = 0.5 * (f64::from(sample) + f64::from(next));
        let square =
            |k: usize| (threshold - f64::from(low(k))).max(0.0).powi(2) * self.inverse_step2[k];
        (0..D).map(square).sum::<f64>() > self.slope2
    }

    /// Returns `true` if any sample of a row, except the first and the last, must fall. `adjacent`
    /// holds the rows on both sides.
    fn interior_needs_lowering(self, samples: &[f32], adjacent: [[&[f32]; 2]; 2]) -> bool {
        let Some(last) = samples.len().checked_sub(2) else {
            return false;
        };
        let [[a, b], [c, d]] = adjacent.map(|sides| sides.map(|row| &row[1..=last]));
        let (before, after, samples) = (&samples[..last], &samples[2..], &samples[1..=last]);
        dispatch_simd(
            #[inline(always)]
            || {
                let mut any = false;
                for i in 0..samples.len() {
                    let lows = [before[i].min(after[i]), a[i].min(b[i]), c[i].min(d[i])];
                    any |= self.needs_lowering(samples[i], |k| lows[k]);
                }
                any
            },
        )
    }

    /// Solves sum_k (max(d - low_k, 0) / h_k)^2 = slope^2 for d. Computed in double precision, so
    /// that lower neighbours never give a higher result.
    #[inline]
    fn solve_upwind(self, neighbours: &mut [(f32, f64); D]) -> f32 {
        for i in 1..D {
            for j in (1..=i).rev() {
                if neighbours[j].0 < neighbours[j - 1].0 {
                    neighbours.swap(j, j - 1);
                }
            }
        }
        // Values are relative to the lowest neighbour, so that the quadratic loses no digits.
        let base = f64::from(neighbours[0].0);
        let (mut a, mut b, mut c) = (0.0f64, 0.0f64, -self.slope2);
        let mut d = 0.0;
        for &(low, w) in neighbours.iter() {
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
    use crate::geometry::grid_index::{index_at, offset_of, strides};

    fn cone(step: [f64; 3], dims: [usize; 3]) -> (ScalarField<3>, [f64; 3]) {
        let count = dims.iter().product();
        let mut field = ScalarField {
            dims,
            step,
            samples: vec![1e3; count],
        };
        let centre = dims.map(|n| n / 2);
        field.samples[(centre[2] * dims[1] + centre[1]) * dims[0] + centre[0]] = 3.0;
        (field, std::array::from_fn(|k| centre[k] as f64 * step[k]))
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
                    let value = f64::from(field.samples[(z * 31 + y) * 41 + x]);
                    worst = worst.max((value - 3.0 - 0.1 * r).abs() / 0.1);
                }
            }
        }
        // First-order upwind from a point source is late by h log(r / h), h <= 2, r <= 36.
        assert!(worst < 3.0, "{worst}");
    }

    /// Limits the slope serially, one sample after the other, and skips no row.
    fn limit_naively(field: &mut ScalarField<3>, growth: f64) {
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
            let directed = |k: usize, count: usize, i: usize| match order >> k & 1 {
                0 => i,
                _ => count - 1 - i,
            };
            for n in 0..field.samples.len() {
                let forward = index_at(field.dims, n);
                let index = [0, 1, 2].map(|k| directed(k, field.dims[k], forward[k]));
                let sample = offset_of(field.dims, index);
                let mut neighbours = [0, 1, 2].map(|k| {
                    let stride = strides(field.dims)[k];
                    let below = match index[k] {
                        0 => f32::INFINITY,
                        _ => field.samples[sample - stride],
                    };
                    let above = if index[k] + 1 == field.dims[k] {
                        f32::INFINITY
                    } else {
                        field.samples[sample + stride]
                    };
                    (below.min(above), slope.inverse_step2[k])
                });
                let old = field.samples[sample];
                let new = slope.solve_upwind(&mut neighbours);
                if new < old {
                    changed = true;
                    field.samples[sample] = new;
                }
            }
        }
    }

    #[test]
    fn parallel_sweeps_equal_serial_ones() {
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
            let mut expected = field.clone();
            limit_gradient(&mut field, 0.3, &CancelToken::never());
            limit_naively(&mut expected, 0.3);
            assert!(field == expected, "{dims:?}");
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
        let min = |s: &[f32]| s.iter().copied().fold(f32::INFINITY, f32::min);
        assert_eq!(min(&samples), min(&field.samples));
        assert!(field.samples.iter().zip(&samples).all(|(a, b)| a <= b));
        let mut steepest = 0.0f32;
        for z in 0..17 {
            for y in 0..20 {
                for x in 0..24 {
                    let index = (z * 20 + y) * 24 + x;
                    let sample = field.samples[index];
                    let drop = |inside: bool, s: usize| {
                        if inside {
                            (sample - field.samples[index - s].min(sample)).max(0.0)
                        } else {
                            0.0
                        }
                    };
                    let rise = |inside: bool, s: usize| {
                        if inside {
                            (sample - field.samples[index + s].min(sample)).max(0.0)
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

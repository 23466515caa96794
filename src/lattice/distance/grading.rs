//! Limits the growth of a field: |grad d| <= g, by fast sweeping.

use rayon::prelude::*;

use crate::image::Field;
use crate::observer::Patience;

/// Sweeps are repeated until no sample falls by more than this share of its value.
const SETTLED: f32 = 1e-5;

/// Samples that are swept in one task, at least.
const TOGETHER: usize = 1 << 12;

/// Lowers `field` to the largest function below it whose gradient is nowhere longer than `growth`
/// (per lattice unit); never raises a sample, so every minimum is kept.
///
/// This is the viscosity solution of |grad d| = `growth` with the field as an obstacle from above,
/// found by Gauss-Seidel sweeps in the 2^D diagonal orders with Godunov's upwind difference (Zhao,
/// "A fast sweeping method for eikonal equations", 2005). First-order accurate in the grid step.
///
/// Rows of which neither is beside the other are swept at the same time, as the order of the sweep
/// allows (Zhao, "Parallel implementations of the fast sweeping method", 2007): the result is that of
/// one row after the other.
pub fn limit_gradient<const D: usize>(field: &mut Field<D>, growth: f64, patience: &Patience<'_>) {
    let rows = field.dims[1..].iter().product();
    let mut sweeps = Sweeps {
        field,
        growth: growth as f32,
        open: vec![true; rows],
    };
    // One round of 2^D sweeps suffices away from obstacles that bend the way; the bound is met
    // long before the last round on any field that has finite samples.
    let rounds = 8;
    for _ in 0..rounds {
        let mut settled = true;
        for order in 0..1usize << D {
            settled &= sweeps.sweep(order, patience);
        }
        if settled {
            break;
        }
    }
}

struct Sweeps<'a, const D: usize> {
    field: &'a mut Field<D>,
    growth: f32,
    /// Rows along the first axis that a sweep may change: those that the last one changed, or beside which one has
    /// changed since.
    open: Vec<bool>,
}

/// A row after a sweep that has changed it.
struct Lowered {
    row: usize,
    samples: Vec<f32>,
    settled: bool,
}

impl<const D: usize> Sweeps<'_, D> {
    /// One pass in the direction given by the bits of `order`; returns whether nothing changed.
    fn sweep(&mut self, order: usize, patience: &Patience<'_>) -> bool {
        let across = |k: usize| self.field.dims.get(k).copied().unwrap_or(1);
        let [wide, high] = [across(1), across(2)];
        let turned = |k: usize, count: usize, i: usize| match order >> k & 1 {
            0 => i,
            _ => count - 1 - i,
        };
        let mut settled = true;
        for diagonal in 0..wide + high - 1 {
            if patience.over() {
                break;
            }
            let rows = (diagonal + 1).saturating_sub(wide)..high.min(diagonal + 1);
            let row = |k| turned(2, high, k) * wide + turned(1, wide, diagonal - k);
            let open: Vec<usize> = rows.map(row).filter(|&row| self.open[row]).collect();
            let least = (TOGETHER / self.field.dims[0].max(1)).max(1);
            let lowered: Vec<Option<Lowered>> = open
                .par_iter()
                .with_min_len(least)
                .map(|&row| self.lowered(row, order & 1 == 1))
                .collect();
            open.iter().for_each(|&row| self.open[row] = false);
            for Lowered {
                row,
                samples,
                settled: row_settled,
            } in lowered.into_iter().flatten()
            {
                settled &= row_settled;
                self.field.samples[row * samples.len()..][..samples.len()]
                    .copy_from_slice(&samples);
                self.open[row] = true;
                for row in self.beside(row).into_iter().flatten().flatten() {
                    self.open[row] = true;
                }
            }
        }
        settled
    }

    /// The rows before and after a row along the other axes, where there are any.
    fn beside(&self, row: usize) -> [[Option<usize>; 2]; 2] {
        let mut stride = 1;
        [1, 2].map(|k| {
            let count = self.field.dims.get(k).copied().unwrap_or(1);
            let (at, s) = (row / stride % count, stride);
            stride *= count;
            [(at > 0).then(|| row - s), (at + 1 < count).then(|| row + s)]
        })
    }

    /// A row swept, if that changes it.
    fn lowered(&self, row: usize, backward: bool) -> Option<Lowered> {
        let count = self.field.dims[0];
        let samples = |row: usize| &self.field.samples[row * count..][..count];
        // Twice the same where there is one only.
        let around = self.beside(row).map(|[before, after]| {
            let either = before.or(after)?;
            Some([before, after].map(|row| samples(row.unwrap_or(either))))
        });
        let step: [f32; D] = self.field.step.map(|h| h as f32);
        let mut own = samples(row).to_vec();
        let (mut changed, mut settled) = (false, true);
        for i in 0..count {
            let i = if backward { count - 1 - i } else { i };
            let old = own[i];
            // The smaller neighbour along each axis; only ones below `old` can lower it.
            let mut lows = [(f32::INFINITY, 1.0f32); D];
            let before = if i > 0 { own[i - 1] } else { f32::INFINITY };
            let after = if i + 1 < count {
                own[i + 1]
            } else {
                f32::INFINITY
            };
            lows[0] = (before.min(after), step[0]);
            for k in 1..D {
                let low =
                    around[k - 1].map_or(f32::INFINITY, |[before, after]| before[i].min(after[i]));
                lows[k] = (low, step[k]);
            }
            if !lows.iter().any(|low| low.0 < old) {
                continue;
            }
            let new = upwind(&mut lows, self.growth);
            if new < old {
                settled &= old - new <= SETTLED * old.abs();
                own[i] = new;
                changed = true;
            }
        }
        changed.then_some(Lowered {
            row,
            samples: own,
            settled,
        })
    }
}

/// Solves sum_k (max(d - low_k, 0) / h_k)^2 = growth^2 for d.
#[inline]
fn upwind<const D: usize>(lows: &mut [(f32, f32); D], growth: f32) -> f32 {
    for i in 1..D {
        for j in (1..=i).rev() {
            if lows[j].0 < lows[j - 1].0 {
                lows.swap(j, j - 1);
            }
        }
    }
    // Measured from the lowest neighbour, so that the quadratic loses no digits.
    let base = lows[0].0;
    let (mut a, mut b, mut c) = (0.0f32, 0.0f32, -growth * growth);
    let mut d = 0.0;
    for &(low, h) in lows.iter() {
        let (u, w) = (low - base, 1.0 / (h * h));
        if a > 0.0 && d <= u {
            break;
        }
        a += w;
        b += u * w;
        c += u * u * w;
        d = (b + (b * b - a * c).max(0.0).sqrt()) / a;
    }
    base + d
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cone(step: [f64; 3], dims: [usize; 3]) -> (Field<3>, [f64; 3]) {
        let count = dims.iter().product();
        let mut field = Field {
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
        limit_gradient(&mut field, 0.1, &Patience::endless());
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
    fn plainly(field: &mut Field<3>, growth: f32) {
        let [nx, ny, nz] = field.dims;
        let mut settled = true;
        for pass in 0..64 {
            let order = pass % 8;
            if order == 0 && pass > 0 && std::mem::replace(&mut settled, true) {
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
                    (below.min(above), field.step[k] as f32)
                });
                let old = field.samples[at];
                let new = upwind(&mut lows, growth);
                if new < old {
                    settled &= old - new <= SETTLED * old.abs();
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
            let mut field = Field {
                dims,
                step: [1.0, 1.5, 0.75],
                samples: (0..count).map(height).collect(),
            };
            let mut plain = field.clone();
            limit_gradient(&mut field, 0.3, &Patience::endless());
            plainly(&mut plain, 0.3);
            assert!(field == plain, "{dims:?}");
        }
    }

    #[test]
    fn nothing_rises_minima_stay_and_growth_is_bounded() {
        let dims = [24, 20, 17];
        let samples: Vec<f32> = (0..24 * 20 * 17)
            .map(|i: usize| 4.0 + (i * 7919 % 1009) as f32 / 100.0)
            .collect();
        let mut field = Field {
            dims,
            step: [1.0; 3],
            samples: samples.clone(),
        };
        limit_gradient(&mut field, 0.25, &Patience::endless());
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

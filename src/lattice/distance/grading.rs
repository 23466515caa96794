//! Limits the growth of a field: |grad d| <= g, by fast sweeping.

use crate::image::Field;
use crate::observer::Patience;

/// Sweeps are repeated until no sample falls by more than this share of its value.
const SETTLED: f32 = 1e-5;

/// Lowers `field` to the largest function below it whose gradient is nowhere longer than `growth`
/// (per lattice unit); never raises a sample, so every minimum is kept.
///
/// This is the viscosity solution of |grad d| = `growth` with the field as an obstacle from above,
/// found by Gauss-Seidel sweeps in the 2^D diagonal orders with Godunov's upwind difference (Zhao,
/// "A fast sweeping method for eikonal equations", 2005). First-order accurate in the grid step.
pub fn limit_gradient<const D: usize>(field: &mut Field<D>, growth: f64, patience: &Patience<'_>) {
    let mut strides = [1; D];
    for k in 1..D {
        strides[k] = strides[k - 1] * field.dims[k - 1];
    }
    // One round of 2^D sweeps suffices away from obstacles that bend the way; the bound is met
    // long before the last round on any field that has finite samples.
    let rounds = 8;
    for _ in 0..rounds {
        let mut settled = true;
        for order in 0..1usize << D {
            settled &= sweep(field, &strides, growth as f32, order, patience);
        }
        if settled {
            break;
        }
    }
}

/// One pass in the direction given by the bits of `order`; returns whether nothing changed.
fn sweep<const D: usize>(
    field: &mut Field<D>,
    strides: &[usize; D],
    growth: f32,
    order: usize,
    patience: &Patience<'_>,
) -> bool {
    let dims = field.dims;
    let backward = |k: usize| order >> k & 1 == 1;
    let rows: usize = dims[1..].iter().product();
    let step = field.step.map(|h| h as f32);
    let mut settled = true;
    let mut index = [0usize; D];
    for row in 0..rows {
        if patience.over() {
            break;
        }
        let mut rest = row;
        for k in 1..D {
            let i = rest % dims[k];
            index[k] = if backward(k) { dims[k] - 1 - i } else { i };
            rest /= dims[k];
        }
        let start: usize = (1..D).map(|k| index[k] * strides[k]).sum();
        for i in 0..dims[0] {
            index[0] = if backward(0) { dims[0] - 1 - i } else { i };
            let at = start + index[0];
            let old = field.samples[at];
            // The smaller neighbour along each axis; only ones below `old` can lower it.
            let mut lows = [(f32::INFINITY, 1.0f32); D];
            let mut any = false;
            for k in 0..D {
                let s = strides[k];
                let below = if index[k] > 0 {
                    field.samples[at - s]
                } else {
                    f32::INFINITY
                };
                let above = if index[k] + 1 < dims[k] {
                    field.samples[at + s]
                } else {
                    f32::INFINITY
                };
                lows[k] = (below.min(above), step[k]);
                any |= lows[k].0 < old;
            }
            if !any {
                continue;
            }
            let new = upwind(&mut lows, growth);
            if new < old {
                settled &= old - new <= SETTLED * old.abs();
                field.samples[at] = new;
            }
        }
    }
    settled
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

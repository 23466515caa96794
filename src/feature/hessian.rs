//! Second differences and their eigenvalues along whole rows of x, in single precision.
//!
//! The arithmetic is that of [`Volume::hessian`], arranged so that it runs on many samples at a
//! time.

use super::volume::Volume;
use crate::geometry::eigen;
use crate::geometry::simd::dispatch_simd;

/// The rows around a row of x, without their first and last samples (beyond which samples repeat).
struct RowStencil<'a> {
    /// The row itself from its first, its second and its third sample on.
    centre: [&'a [f32]; 3],
    /// The rows before and after along the second and the third axis.
    adjacent: [[[&'a [f32]; 3]; 2]; 2],
    /// The rows before and after along the third axis, of the rows before and after along the
    /// second.
    diagonal: [[&'a [f32]; 2]; 2],
}

impl<'a> RowStencil<'a> {
    #[inline(always)]
    fn new<const D: usize>(volume: Volume<'a, D>, first: [usize; D]) -> Self {
        let count = volume.dims[0].saturating_sub(2);
        let (before, after) = volume.neighbour_offsets(first);
        let i = volume.index(first);
        let shifted = |start| [0, 1, 2].map(|s| &volume.samples[start + s..][..count]);
        let mut rows = Self {
            centre: [&volume.samples[..0]; 3],
            adjacent: [[[&volume.samples[..0]; 3]; 2]; 2],
            diagonal: [[&volume.samples[..0]; 2]; 2],
        };
        if count == 0 {
            return rows;
        }
        rows.centre = shifted(i);
        for k in 1..D {
            rows.adjacent[k - 1] = [shifted(i - before[k]), shifted(i + after[k])];
        }
        if D == 3 {
            let low = [i - before[1], i + after[1]];
            rows.diagonal = low.map(|j| [shifted(j - before[2])[1], shifted(j + after[2])[1]]);
        }
        rows
    }

    /// Returns the number of samples without the first and the last.
    #[inline(always)]
    fn count(&self) -> usize {
        self.centre[0].len()
    }

    /// Returns the second differences at the sample after the `x`-th: xx, yy, xy and in 3-D zz, xz,
    /// yz.
    #[inline(always)]
    fn hessian<const D: usize>(&self, x: usize) -> [f32; 6] {
        // There is no `map` of arrays here, because it would call code without vector instructions.
        let c = &self.centre;
        let twice = 2.0 * c[1][x];
        let [[_, south, _], [_, north, _]] = self.adjacent[0];
        let xx = c[0][x] + c[2][x] - twice;
        let yy = south[x] + north[x] - twice;
        let mixed = |k: usize| {
            let [before, after] = &self.adjacent[k];
            0.25 * ((after[2][x] - after[0][x]) - (before[2][x] - before[0][x]))
        };
        if D == 2 {
            return [xx, yy, mixed(0), 0.0, 0.0, 0.0];
        }
        let [[_, down, _], [_, up, _]] = self.adjacent[1];
        let zz = down[x] + up[x] - twice;
        let [[sd, su], [nd, nu]] = self.diagonal;
        let yz = 0.25 * ((nu[x] - nd[x]) - (su[x] - sd[x]));
        [xx, yy, mixed(0), zz, mixed(1), yz]
    }
}

/// Eigenvalues and trace of the Hessian along a row of x.
#[derive(Debug, Default)]
pub struct Curvature {
    /// Lowest eigenvalue at each sample, and the next one.
    pub lowest_eigenvalues: [Vec<f32>; 2],
    /// Trace of the Hessian at each sample.
    pub laplacian: Vec<f32>,
}

impl Curvature {
    /// Measures the row of x from `first`.
    ///
    /// The method is that of [`eigen::eigenvalues`], without branches and in single precision:
    /// errors are about 1e-6 of the largest entry.
    pub fn measure<const D: usize>(&mut self, volume: Volume<'_, D>, first: [usize; D]) {
        let nx = volume.dims[0];
        let [lowest, next] = &mut self.lowest_eigenvalues;
        let laplacian = &mut self.laplacian;
        for out in [&mut *lowest, &mut *next, &mut *laplacian] {
            out.resize(nx, 0.0);
        }
        dispatch_simd(
            #[inline(always)]
            || {
                let rows = RowStencil::new(volume, first);
                let count = rows.count();
                let (lowest, next, laplacian) = (
                    &mut lowest[1..][..count],
                    &mut next[1..][..count],
                    &mut laplacian[1..][..count],
                );
                for x in 0..count {
                    let hessian = rows.hessian::<D>(x);
                    [lowest[x], next[x]] = lowest_two::<D>(hessian);
                    laplacian[x] = hessian[0] + hessian[1] + hessian[3];
                }
            },
        );
        for x in [0, nx - 1] {
            let mut at = first;
            at[0] = x;
            let hessian = volume.hessian(at);
            let values = eigen::eigenvalues(&hessian);
            (lowest[x], next[x]) = (values[0] as f32, values[1] as f32);
            laplacian[x] = (0..D).map(|k| hessian[k][k] as f32).sum();
        }
    }
}

#[inline(always)]
fn lowest_two<const D: usize>([xx, yy, xy, zz, xz, yz]: [f32; 6]) -> [f32; 2] {
    if D == 2 {
        let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
        let radius = (half * half + xy * xy).sqrt();
        return [mean - radius, mean + radius];
    }
    let mean = (xx + yy + zz) * (1.0 / 3.0);
    let (a, b, c) = (xx - mean, yy - mean, zz - mean);
    let off_diagonal = xy * xy + xz * xz + yz * yz;
    let square = (a * a + b * b + c * c + 2.0 * off_diagonal) * (1.0 / 6.0);
    let p = square.sqrt().max(1e-18);
    let determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz);
    let ratio = 0.5 * determinant / (p * p) / p;
    let h = ratio.abs().min(1.0);
    let mut t = eigen::approx_largest_root(h);
    t -= (t * (t * t - 3.0) - 2.0 * h) / (3.0 * (t * t - 1.0));
    let half = (3.0 - 0.75 * t * t).max(0.0).sqrt();
    let (low, middle) = if ratio >= 0.0 {
        (-0.5 * t - half, half - 0.5 * t)
    } else {
        (-t, 0.5 * t - half)
    };
    [mean + p * low, mean + p * middle]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::Noise;

    fn check<const D: usize>(dims: [usize; D]) {
        let mut noise = Noise::new(3);
        let count = dims.iter().product();
        let samples: Vec<f32> = (0..count).map(|_| noise.normal() as f32).collect();
        let volume = Volume {
            dims,
            samples: &samples,
        };
        let mut row = Curvature::default();
        for number in 0..count / dims[0] {
            let first = volume.coordinates(number * dims[0]);
            row.measure(volume, first);
            for x in 0..dims[0] {
                let mut at = first;
                at[0] = x;
                let hessian = volume.hessian(at);
                let values = eigen::eigenvalues(&hessian);
                for k in 0..2 {
                    let error = (f64::from(row.lowest_eigenvalues[k][x]) - values[k]).abs();
                    assert!(error < 1e-4, "{error} {values:?}");
                }
                let trace: f64 = (0..D).map(|k| hessian[k][k]).sum();
                assert!((f64::from(row.laplacian[x]) - trace).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn rows_match_single_samples() {
        check([37, 6, 5]);
        check([37, 11]);
        check([3, 2, 4]);
        check([1, 3, 3]);
    }
}

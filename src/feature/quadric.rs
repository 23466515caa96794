//! Quadratic surface fitted to the points of a feature surface near a place.

use crate::geometry::simd::dispatch_simd;

/// Expected error of a point (samples).
const POINT_ERROR: f64 = 0.15;
/// Expected second-order coefficient of a surface (per sample): a radius of curvature of a hundred
/// samples.
const CURVATURE_PRIOR: f64 = 0.005;

/// Column of the heights in the equations.
const HEIGHT_COLUMN: usize = 6;

/// A quadratic surface (in 2-D a parabola) through points, by weighted least squares.
pub struct Quadric<const D: usize> {
    /// Normal equations, with their right-hand sides in column [`HEIGHT_COLUMN`]; rows are padded
    /// to the width of vector registers.
    equations: [[f64; 8]; 6],
    /// Width of the Gaussian weight of a point (samples).
    width: f64,
}

impl<const D: usize> Quadric<D> {
    /// Number of terms (constant, slopes and curvatures); a fit needs at least as many points.
    pub const TERM_COUNT: usize = D * (D + 1) / 2;

    /// Creates a fit without points, for points within `radius` samples.
    pub fn new(radius: i32) -> Self {
        Self {
            equations: [[0.0; 8]; 6],
            width: 0.5 * f64::from(radius),
        }
    }

    /// Adds a point at `offset`; its height is its component along `axis`.
    pub fn add(&mut self, offset: [f32; D], axis: usize) {
        let weight = self.weight(offset, axis);
        Self::add_to(&mut self.equations, offset, axis, weight);
    }

    /// Adds points; `weights` is a scratch buffer.
    pub fn add_all(&mut self, points: &[[f32; D]], axis: usize, weights: &mut Vec<f64>) {
        weights.clear();
        weights.extend(points.iter().map(|offset| self.weight(*offset, axis)));
        dispatch_simd(
            #[inline(always)]
            || {
                // A local copy stays in registers.
                let mut equations = self.equations;
                for (offset, weight) in points.iter().zip(&*weights) {
                    Self::add_to(&mut equations, *offset, axis, *weight);
                }
                self.equations = equations;
            },
        );
    }

    fn weight(&self, offset: [f32; D], axis: usize) -> f64 {
        let lateral = (1..D).map(|k| f64::from(offset[(axis + k) % D]));
        let squares: f64 = lateral.map(|x| x * x).sum();
        (-0.5 * squares / (self.width * self.width)).exp() / (POINT_ERROR * POINT_ERROR)
    }

    #[inline(always)]
    fn add_to(equations: &mut [[f64; 8]; 6], offset: [f32; D], axis: usize, weight: f64) {
        let mut row = [1.0; 8];
        let mut bend = D;
        for k in 1..D {
            row[k] = f64::from(offset[(axis + k) % D]);
        }
        for k in 1..D {
            for l in k..D {
                row[bend] = row[k] * row[l];
                bend += 1;
            }
        }
        row[HEIGHT_COLUMN] = f64::from(offset[axis]);
        // The lower half is computed as well: that costs less than skipping it.
        for (i, equation) in equations.iter_mut().enumerate().take(Self::TERM_COUNT) {
            let weighted = weight * row[i];
            for j in 0..8 {
                equation[j] += weighted * row[j];
            }
        }
    }

    /// Returns the coefficients of the terms (constant and slopes first), with the prior on
    /// curvatures, by Cholesky decomposition; `None` if the equations are singular.
    pub fn solve(mut self) -> Option<[f64; 6]> {
        let m = &mut self.equations;
        for i in D..Self::TERM_COUNT {
            m[i][i] += 1.0 / (CURVATURE_PRIOR * CURVATURE_PRIOR);
        }
        for i in 0..Self::TERM_COUNT {
            for k in 0..i {
                let f = m[k][i] / m[k][k];
                for j in (i..Self::TERM_COUNT).chain([HEIGHT_COLUMN]) {
                    m[i][j] -= f * m[k][j];
                }
            }
            if m[i][i] <= 1e-9 {
                return None;
            }
        }
        let mut c = [0.0; 6];
        for i in (0..Self::TERM_COUNT).rev() {
            let sum: f64 = (i + 1..Self::TERM_COUNT).map(|j| m[i][j] * c[j]).sum();
            c[i] = (m[i][HEIGHT_COLUMN] - sum) / m[i][i];
        }
        Some(c)
    }
}

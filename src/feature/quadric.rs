//! A sheet near a place as a quadratic surface.

use crate::geometry::simd::dispatch_simd;

/// Expected error of a point (samples) ...
const POINT_ERROR: f64 = 0.15;
/// ... and expected second-order coefficient of a sheet (per sample): radius of curvature a hundred.
const CURVATURE_PRIOR: f64 = 0.005;

/// The column of heights.
const HEIGHT_COLUMN: usize = 6;

/// A quadratic surface (in 2-D a parabola) through points, by weighted least squares.
pub struct Quadric<const D: usize> {
    /// The normal equations, their right-hand sides in column [`HEIGHT_COLUMN`]; as wide as vector registers like.
    equations: [[f64; 8]; 6],
    /// The weight of a point falls with the square of its distance over this.
    width: f64,
}

impl<const D: usize> Quadric<D> {
    /// Constant, slopes and bends: fewer points carry no fit.
    pub const TERM_COUNT: usize = D * (D + 1) / 2;

    /// No points yet; their weights fall within `radius` samples.
    pub fn new(radius: i32) -> Self {
        Self {
            equations: [[0.0; 8]; 6],
            width: 0.5 * f64::from(radius),
        }
    }

    /// Adds a point; its height is its component along `axis`.
    pub fn add(&mut self, away: [f32; D], axis: usize) {
        let weight = self.weight(away, axis);
        Self::add_to(&mut self.equations, away, axis, weight);
    }

    /// Adds points, of which `weights` has room for the weights.
    pub fn add_all(&mut self, points: &[[f32; D]], axis: usize, weights: &mut Vec<f64>) {
        weights.clear();
        weights.extend(points.iter().map(|away| self.weight(*away, axis)));
        dispatch_simd(
            #[inline(always)]
            || {
                // A copy of their own stays in registers.
                let mut equations = self.equations;
                for (away, weight) in points.iter().zip(&*weights) {
                    Self::add_to(&mut equations, *away, axis, *weight);
                }
                self.equations = equations;
            },
        );
    }

    fn weight(&self, away: [f32; D], axis: usize) -> f64 {
        let along = (1..D).map(|k| f64::from(away[(axis + k) % D]));
        let squares: f64 = along.map(|x| x * x).sum();
        (-0.5 * squares / (self.width * self.width)).exp() / (POINT_ERROR * POINT_ERROR)
    }

    #[inline(always)]
    fn add_to(equations: &mut [[f64; 8]; 6], away: [f32; D], axis: usize, weight: f64) {
        let mut row = [1.0; 8];
        let mut bend = D;
        for k in 1..D {
            row[k] = f64::from(away[(axis + k) % D]);
        }
        for k in 1..D {
            for l in k..D {
                row[bend] = row[k] * row[l];
                bend += 1;
            }
        }
        row[HEIGHT_COLUMN] = f64::from(away[axis]);
        // The lower half as well: it costs less than leaving it out.
        for (i, equation) in equations.iter_mut().enumerate().take(Self::TERM_COUNT) {
            let share = weight * row[i];
            for j in 0..8 {
                equation[j] += share * row[j];
            }
        }
    }

    /// The terms' coefficients, with the prior on bends, by Cholesky; constant and slopes first.
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

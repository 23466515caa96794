//! Algebraic multigrid by smoothed aggregation (Vanek, Mandel, Brezina 1996, Computing 56,
//! 179-196). It is a preconditioner for symmetric positive definite matrices that are similar to a
//! Laplacian: their rows sum to zero except near fixed values.
//!
//! Strongly coupled unknowns form aggregates. The prolongation is constant on each aggregate and
//! smoothed by one damped Jacobi step. The smoother is a Chebyshev polynomial of the diagonally
//! scaled matrix. Unlike Gauss-Seidel it does not depend on the order of the unknowns, so it is
//! parallel and always gives the same bits.

use super::sparse_matrix::{Matrix, dot, for_each};
use crate::geometry::NONE;

/// Smallest coupling |a_ij| / sqrt(a_ii a_jj) of two unknowns that may share an aggregate. It is
/// halved on each coarser level.
const MIN_COUPLING_STRENGTH: f64 = 0.08;
/// Largest size of a matrix that is factorised directly.
const MAX_DIRECT_SIZE: usize = 300;
/// Degree of the smoothing polynomial.
const SMOOTHER_DEGREE: usize = 3;
/// The smoother damps eigenvalues from this fraction of the largest one upwards.
const MIN_EIGENVALUE_RATIO: f64 = 0.1;

/// A hierarchy of matrices, from fine to coarse.
pub struct Multigrid {
    levels: Vec<Level>,
    coarsest: CoarsestLevel,
}

/// A matrix and the data to smooth errors of its solution.
struct Smoother {
    matrix: Matrix,
    inverse_diagonal: Vec<f64>,
    /// The largest eigenvalue of the diagonally scaled matrix.
    max_eigenvalue: f64,
    step: Vec<f64>,
}

/// A matrix and the transfer to the next coarser one.
struct Level {
    smoother: Smoother,
    prolongation: Matrix,
    restriction: Matrix,
    residual: Vec<f64>,
    coarse_residual: Vec<f64>,
    coarse_correction: Vec<f64>,
}

/// The coarsest matrix. It is factorised, or only smoothed if coarsening has stalled because few
/// unknowns are coupled.
enum CoarsestLevel {
    Factorised(Cholesky),
    Iterative(Smoother),
}

impl Multigrid {
    /// Builds the hierarchy.
    pub fn new(matrix: &Matrix) -> Self {
        let mut levels: Vec<Level> = Vec::new();
        let mut matrix = matrix.clone();
        loop {
            if matrix.height() <= MAX_DIRECT_SIZE {
                let coarsest = CoarsestLevel::Factorised(Cholesky::new(&matrix));
                return Self { levels, coarsest };
            }
            let diagonal = matrix.diagonal();
            let strength = MIN_COUPLING_STRENGTH * 0.5f64.powi(levels.len() as i32);
            let smoother = Smoother::new(matrix, &diagonal);
            let (aggregates, count) = aggregate(&smoother.matrix, &diagonal, strength);
            if count == 0 || count * 10 > 9 * diagonal.len() {
                let coarsest = CoarsestLevel::Iterative(smoother);
                return Self { levels, coarsest };
            }
            let prolongation = prolongation(&smoother, &diagonal, &aggregates, count, strength);
            let restriction = prolongation.transpose();
            matrix = restriction.product(&smoother.matrix.product(&prolongation));
            levels.push(Level {
                smoother,
                prolongation,
                restriction,
                residual: vec![0.0; diagonal.len()],
                coarse_residual: vec![0.0; count],
                coarse_correction: vec![0.0; count],
            });
        }
    }

    /// Applies one V-cycle from zero: `x` becomes an approximate solution of `A x = b`. The map
    /// from `b` to `x` is linear, symmetric and positive definite.
    pub fn apply(&mut self, b: &[f64], x: &mut [f64]) {
        cycle(&mut self.levels, &mut self.coarsest, b, x);
    }

    /// Returns the number of entries of all matrices over that of the finest one.
    #[cfg(test)]
    pub fn complexity(&self) -> f64 {
        let entry_count = |level: &Level| level.smoother.matrix.values.len() as f64;
        let total: f64 = self.levels.iter().map(entry_count).sum();
        self.levels
            .first()
            .map_or(1.0, |finest| total / entry_count(finest))
    }
}

fn cycle(levels: &mut [Level], coarsest: &mut CoarsestLevel, b: &[f64], x: &mut [f64]) {
    let Some((level, coarser)) = levels.split_first_mut() else {
        match coarsest {
            CoarsestLevel::Factorised(factor) => factor.solve(b, x),
            CoarsestLevel::Iterative(smoother) => smoother.smooth(b, x, true),
        }
        return;
    };
    level.smoother.smooth(b, x, true);
    let matrix = &level.smoother.matrix;
    for_each(&mut level.residual, |i, r| *r = b[i] - matrix.row_dot(i, x));
    level
        .restriction
        .times(&level.residual, &mut level.coarse_residual);
    cycle(
        coarser,
        coarsest,
        &level.coarse_residual,
        &mut level.coarse_correction,
    );
    for_each(x, |i, x| {
        *x += level.prolongation.row_dot(i, &level.coarse_correction)
    });
    level.smoother.smooth(b, x, false);
}

impl Smoother {
    fn new(matrix: Matrix, diagonal: &[f64]) -> Self {
        let inverse_diagonal: Vec<f64> = diagonal.iter().map(|d| 1.0 / d).collect();
        let max_eigenvalue = max_eigenvalue(&matrix, &inverse_diagonal);
        let step = vec![0.0; diagonal.len()];
        Self {
            matrix,
            inverse_diagonal,
            max_eigenvalue,
            step,
        }
    }

    /// Runs Chebyshev iterations for `A x = b`. If `from_zero`, the old values of `x` are ignored.
    fn smooth(&mut self, b: &[f64], x: &mut [f64], from_zero: bool) {
        let Self {
            matrix,
            inverse_diagonal,
            max_eigenvalue,
            step,
        } = self;
        let centre = 0.5 * *max_eigenvalue * (1.0 + MIN_EIGENVALUE_RATIO);
        let half_width = 0.5 * *max_eigenvalue * (1.0 - MIN_EIGENVALUE_RATIO);
        let (mut step_factor, mut residual_factor) = (0.0, 1.0 / centre);
        let mut ratio = half_width / centre;
        for degree in 0..SMOOTHER_DEGREE {
            if degree == 0 && from_zero {
                for_each(step, |i, d| {
                    *d = residual_factor * inverse_diagonal[i] * b[i]
                });
                x.copy_from_slice(step);
            } else {
                for_each(step, |i, d| {
                    let residual = b[i] - matrix.row_dot(i, x);
                    *d = step_factor * *d + residual_factor * inverse_diagonal[i] * residual;
                });
                for_each(x, |i, x| *x += step[i]);
            }
            let next = 1.0 / (2.0 * centre / half_width - ratio);
            (step_factor, residual_factor) = (next * ratio, 2.0 * next / half_width);
            ratio = next;
        }
    }
}

/// Returns the largest eigenvalue of `D^-1 A` by power iteration, with a margin of 10 % for its
/// error.
fn max_eigenvalue(matrix: &Matrix, inverse_diagonal: &[f64]) -> f64 {
    let n = matrix.height();
    let start = |i: usize| ((i as u32).wrapping_mul(2_654_435_761) >> 16) as f64 / 65536.0 - 0.5;
    let mut x: Vec<f64> = (0..n).map(start).collect();
    let mut y = vec![0.0; n];
    let mut eigenvalue = 1.0;
    for _ in 0..12 {
        for_each(&mut y, |i, y| {
            *y = inverse_diagonal[i] * matrix.row_dot(i, &x)
        });
        eigenvalue = (dot(&y, &y) / dot(&x, &x).max(f64::MIN_POSITIVE)).sqrt();
        let scale = 1.0 / eigenvalue.max(f64::MIN_POSITIVE);
        for_each(&mut x, |i, x| *x = scale * y[i]);
    }
    1.1 * eigenvalue.max(1.0)
}

#[inline]
fn is_strong(value: f64, d: f64, e: f64, strength: f64) -> bool {
    value * value > strength * strength * d * e
}

/// Returns the aggregate of each unknown and the number of aggregates. Aggregates are disjoint sets
/// of strongly coupled unknowns. Unknowns without strong couplings are in none.
fn aggregate(matrix: &Matrix, diagonal: &[f64], strength: f64) -> (Vec<u32>, usize) {
    let n = matrix.height();
    let neighbours = |i: usize| {
        let (columns, values) = matrix.row(i);
        let couplings = columns.iter().zip(values);
        couplings.filter_map(move |(&j, &v)| {
            let j = j as usize;
            (j != i && is_strong(v, diagonal[i], diagonal[j], strength)).then_some((j, v.abs()))
        })
    };
    let mut aggregate_of = vec![NONE; n];
    let mut count = 0;
    // First pass: unknowns whose whole neighbourhood is free form an aggregate with it.
    for i in 0..n {
        let (mut coupled, mut free) = (false, aggregate_of[i] == NONE);
        for (j, _) in neighbours(i) {
            coupled = true;
            free &= aggregate_of[j] == NONE;
        }
        if coupled && free {
            aggregate_of[i] = count;
            neighbours(i).for_each(|(j, _)| aggregate_of[j] = count);
            count += 1;
        }
    }
    // Second pass: each remaining unknown joins the aggregate of the neighbour with the strongest
    // coupling.
    let first_pass = aggregate_of.clone();
    for i in (0..n).filter(|&i| first_pass[i] == NONE) {
        let aggregated = neighbours(i).filter(|&(j, _)| first_pass[j] != NONE);
        if let Some((j, _)) = aggregated.max_by(|a, b| a.1.total_cmp(&b.1)) {
            aggregate_of[i] = first_pass[j];
        }
    }
    // Third pass: unknowns without an aggregated neighbour form aggregates with their free
    // neighbours.
    for i in 0..n {
        if aggregate_of[i] == NONE && neighbours(i).next().is_some() {
            aggregate_of[i] = count;
            for (j, _) in neighbours(i) {
                if aggregate_of[j] == NONE {
                    aggregate_of[j] = count;
                }
            }
            count += 1;
        }
    }
    (aggregate_of, count as usize)
}

/// Returns the prolongation: constants on aggregates, smoothed by a Jacobi step of the matrix
/// without its weak couplings. These are added to the diagonal, so that the row sums stay the same.
fn prolongation(
    smoother: &Smoother,
    diagonal: &[f64],
    aggregate_of: &[u32],
    count: usize,
    strength: f64,
) -> Matrix {
    let Smoother {
        matrix,
        max_eigenvalue,
        ..
    } = smoother;
    let damping = 4.0 / (3.0 * max_eigenvalue);
    Matrix::from_rows(diagonal.len(), count, |i, row| {
        if aggregate_of[i] == NONE {
            return;
        }
        let (columns, values) = matrix.row(i);
        let couplings = || {
            columns
                .iter()
                .map(|&j| j as usize)
                .zip(values.iter().copied())
        };
        let is_weak =
            |&(j, v): &(usize, f64)| j != i && !is_strong(v, diagonal[i], diagonal[j], strength);
        let lumped = diagonal[i] + couplings().filter(is_weak).map(|(_, v)| v).sum::<f64>();
        let scale = damping
            / if lumped > 0.1 * diagonal[i] {
                lumped
            } else {
                diagonal[i]
            };
        row.add(aggregate_of[i], 1.0 - scale * lumped);
        for (j, v) in couplings() {
            if j != i && aggregate_of[j] != NONE && is_strong(v, diagonal[i], diagonal[j], strength)
            {
                row.add(aggregate_of[j], -scale * v);
            }
        }
    })
}

/// Dense Cholesky factor `L` of a small matrix, row by row.
struct Cholesky {
    factor: Vec<Vec<f64>>,
}

impl Cholesky {
    fn new(matrix: &Matrix) -> Self {
        let n = matrix.height();
        let mut factor: Vec<Vec<f64>> = Vec::with_capacity(n);
        for i in 0..n {
            let mut row = vec![0.0; i + 1];
            let (columns, values) = matrix.row(i);
            for (&j, &v) in columns.iter().zip(values) {
                if j as usize <= i {
                    row[j as usize] = v;
                }
            }
            let diagonal = row[i];
            for j in 0..i {
                let known = (0..j).map(|k| row[k] * factor[j][k]).sum::<f64>();
                row[j] = (row[j] - known) / factor[j][j];
            }
            let pivot = diagonal - row[..i].iter().map(|v| v * v).sum::<f64>();
            // Rounding may make the pivot zero or negative if the matrix is nearly singular.
            row[i] = pivot.max(1e-14 * diagonal).max(f64::MIN_POSITIVE).sqrt();
            factor.push(row);
        }
        Self { factor }
    }

    fn solve(&self, b: &[f64], x: &mut [f64]) {
        for (i, row) in self.factor.iter().enumerate() {
            let known = (0..i).map(|k| row[k] * x[k]).sum::<f64>();
            x[i] = (b[i] - known) / row[i];
        }
        for (i, row) in self.factor.iter().enumerate().rev() {
            x[i] /= row[i];
            for k in 0..i {
                x[k] -= row[k] * x[i];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::grid_index::index_at;

    /// Returns the seven-point Laplacian of a grid of `n` cubed points with zero values around it;
    /// `scale` multiplies the couplings along each axis.
    fn laplacian(n: usize, scale: [f64; 3]) -> Matrix {
        Matrix::from_rows(n * n * n, n * n * n, |r, row| {
            let index = index_at([n; 3], r);
            for (axis, stride) in [1, n, n * n].into_iter().enumerate() {
                row.add(r as u32, 2.0 * scale[axis]);
                if index[axis] > 0 {
                    row.add((r - stride) as u32, -scale[axis]);
                }
                if index[axis] + 1 < n {
                    row.add((r + stride) as u32, -scale[axis]);
                }
            }
        })
    }

    fn noise(n: usize, seed: u32) -> Vec<f64> {
        let value = |i: usize| {
            let mixed = (i as u32 ^ seed).wrapping_mul(2_654_435_761);
            f64::from(mixed ^ (mixed >> 15)) / f64::from(u32::MAX) - 0.5
        };
        (0..n).map(value).collect()
    }

    #[test]
    fn a_small_matrix_is_solved_exactly() {
        let matrix = laplacian(6, [1.0, 2.0, 3.0]);
        let x = noise(216, 1);
        let (mut b, mut solution) = (vec![0.0; 216], vec![0.0; 216]);
        matrix.times(&x, &mut b);
        Multigrid::new(&matrix).apply(&b, &mut solution);
        for (computed, x) in solution.iter().zip(&x) {
            assert!((computed - x).abs() < 1e-12);
        }
    }

    #[test]
    fn a_cycle_is_linear_symmetric_and_positive() {
        let matrix = laplacian(12, [1.0, 1.0, 1.0]);
        let mut multigrid = Multigrid::new(&matrix);
        let n = matrix.height();
        let (a, b) = (noise(n, 1), noise(n, 2));
        let mut times = |v: &[f64]| {
            let mut x = noise(n, 9);
            multigrid.apply(v, &mut x);
            x
        };
        let (ma, mb) = (times(&a), times(&b));
        let sum: Vec<f64> = a.iter().zip(&b).map(|(a, b)| 2.0 * a + b).collect();
        let msum = times(&sum);
        let scale = dot(&ma, &ma).sqrt();
        for i in 0..n {
            assert!((msum[i] - 2.0 * ma[i] - mb[i]).abs() < 1e-12 * scale);
        }
        assert!((dot(&a, &mb) - dot(&b, &ma)).abs() < 1e-12 * scale);
        assert!(dot(&a, &ma) > 0.0 && dot(&b, &mb) > 0.0);
    }

    #[test]
    fn the_hierarchy_is_little_larger_than_its_matrix() {
        let multigrid = Multigrid::new(&laplacian(24, [1.0; 3]));
        assert!(multigrid.levels.len() >= 2);
        assert!(multigrid.complexity() < 2.0, "{}", multigrid.complexity());
    }
}

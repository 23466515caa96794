//! Algebraic multigrid by smoothed aggregation (Vanek, Mandel, Brezina 1996, Computing 56, 179-196),
//! as a preconditioner for symmetric positive definite matrices that act like a Laplacian: rows sum
//! to zero except near fixed values.
//!
//! Unknowns that are strongly coupled form aggregates; the prolongation is constant on each of them,
//! smoothed by one damped Jacobi step. The smoother is a Chebyshev polynomial of the diagonally
//! scaled matrix: unlike Gauss-Seidel it knows no order, so it is parallel and always gives the same
//! bits.

use super::sparse_matrix::{Matrix, dot, for_each};

/// No aggregate: the unknown is left to the smoother.
const NO_AGGREGATE: u32 = u32::MAX;
/// Couplings weaker than this, |a_ij| / sqrt(a_ii a_jj), are no reason to share an aggregate; half of
/// it on each coarser level.
const MIN_COUPLING_STRENGTH: f64 = 0.08;
/// A matrix so small is factorised.
const MAX_DIRECT_SIZE: usize = 300;
/// Degree of the smoothing polynomial.
const SMOOTHER_DEGREE: usize = 3;
/// The smoother damps eigenvalues from the largest down to this part of it.
const MIN_EIGENVALUE_RATIO: f64 = 0.1;

/// A hierarchy of ever coarser matrices.
pub struct Multigrid {
    levels: Vec<Level>,
    coarsest: CoarsestLevel,
}

/// A matrix and how to smooth errors of it.
struct Smoother {
    matrix: Matrix,
    inverse_diagonal: Vec<f64>,
    /// The largest eigenvalue of the diagonally scaled matrix.
    max_eigenvalue: f64,
    step: Vec<f64>,
}

/// A matrix and the way to the next coarser one.
struct Level {
    smoother: Smoother,
    prolongation: Matrix,
    restriction: Matrix,
    residual: Vec<f64>,
    coarse_residual: Vec<f64>,
    coarse_correction: Vec<f64>,
}

/// The coarsest matrix: factorised, or, where coarsening has stalled because little is coupled at
/// all, left to its smoother.
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
                let last = CoarsestLevel::Factorised(Cholesky::new(&matrix));
                return Self {
                    levels,
                    coarsest: last,
                };
            }
            let diagonal = matrix.diagonal();
            let strength = MIN_COUPLING_STRENGTH * 0.5f64.powi(levels.len() as i32);
            let smoother = Smoother::new(matrix, &diagonal);
            let (aggregates, count) = aggregate(&smoother.matrix, &diagonal, strength);
            if count == 0 || count * 10 > 9 * diagonal.len() {
                let last = CoarsestLevel::Iterative(smoother);
                return Self {
                    levels,
                    coarsest: last,
                };
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

    /// One V-cycle from zero: `x` becomes about the solution of `A x = b`. As a map from `b` to `x`
    /// it is linear, symmetric and positive definite.
    pub fn apply(&mut self, b: &[f64], x: &mut [f64]) {
        cycle(&mut self.levels, &mut self.coarsest, b, x);
    }

    /// Entries of all matrices over those of the finest.
    #[cfg(test)]
    pub fn complexity(&self) -> f64 {
        let entries = |level: &Level| level.smoother.matrix.values.len() as f64;
        let all: f64 = self.levels.iter().map(entries).sum();
        self.levels
            .first()
            .map_or(1.0, |finest| all / entries(finest))
    }
}

fn cycle(levels: &mut [Level], last: &mut CoarsestLevel, b: &[f64], x: &mut [f64]) {
    let Some((level, coarser)) = levels.split_first_mut() else {
        match last {
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
        last,
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

    /// Chebyshev iteration for `A x = b`; `from_zero` ignores what `x` holds.
    fn smooth(&mut self, b: &[f64], x: &mut [f64], from_zero: bool) {
        let Self {
            matrix,
            inverse_diagonal,
            max_eigenvalue: largest,
            step,
        } = self;
        let middle = 0.5 * *largest * (1.0 + MIN_EIGENVALUE_RATIO);
        let half = 0.5 * *largest * (1.0 - MIN_EIGENVALUE_RATIO);
        let (mut keep, mut add) = (0.0, 1.0 / middle);
        let mut ratio = half / middle;
        for degree in 0..SMOOTHER_DEGREE {
            if degree == 0 && from_zero {
                for_each(step, |i, d| *d = add * inverse_diagonal[i] * b[i]);
                x.copy_from_slice(step);
            } else {
                for_each(step, |i, d| {
                    let residual = b[i] - matrix.row_dot(i, x);
                    *d = keep * *d + add * inverse_diagonal[i] * residual;
                });
                for_each(x, |i, x| *x += step[i]);
            }
            let next = 1.0 / (2.0 * middle / half - ratio);
            (keep, add) = (next * ratio, 2.0 * next / half);
            ratio = next;
        }
    }
}

/// The largest eigenvalue of `D^-1 A` by power iteration, with a margin for what it misses.
fn max_eigenvalue(matrix: &Matrix, inverse_diagonal: &[f64]) -> f64 {
    let n = matrix.height();
    let start = |i: usize| ((i as u32).wrapping_mul(2_654_435_761) >> 16) as f64 / 65536.0 - 0.5;
    let mut x: Vec<f64> = (0..n).map(start).collect();
    let mut y = vec![0.0; n];
    let mut largest = 1.0;
    for _ in 0..12 {
        for_each(&mut y, |i, y| {
            *y = inverse_diagonal[i] * matrix.row_dot(i, &x)
        });
        largest = (dot(&y, &y) / dot(&x, &x).max(f64::MIN_POSITIVE)).sqrt();
        let scale = 1.0 / largest.max(f64::MIN_POSITIVE);
        for_each(&mut x, |i, x| *x = scale * y[i]);
    }
    1.1 * largest.max(1.0)
}

#[inline]
fn is_strong(value: f64, d: f64, e: f64, strength: f64) -> bool {
    value * value > strength * strength * d * e
}

/// Disjoint aggregates of strongly coupled unknowns, and how many there are. Unknowns that are
/// strongly coupled to none are in none.
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
    let mut of = vec![NO_AGGREGATE; n];
    let mut count = 0;
    // Neighbourhoods that are wholly free.
    for i in 0..n {
        let (mut coupled, mut free) = (false, of[i] == NO_AGGREGATE);
        for (j, _) in neighbours(i) {
            coupled = true;
            free &= of[j] == NO_AGGREGATE;
        }
        if coupled && free {
            of[i] = count;
            neighbours(i).for_each(|(j, _)| of[j] = count);
            count += 1;
        }
    }
    // What is left joins the neighbour it is coupled to most.
    let whole = of.clone();
    for i in (0..n).filter(|&i| whole[i] == NO_AGGREGATE) {
        let taken = neighbours(i).filter(|&(j, _)| whole[j] != NO_AGGREGATE);
        if let Some((j, _)) = taken.max_by(|a, b| a.1.total_cmp(&b.1)) {
            of[i] = whole[j];
        }
    }
    // And what has no such neighbour goes together.
    for i in 0..n {
        if of[i] == NO_AGGREGATE && neighbours(i).next().is_some() {
            of[i] = count;
            for (j, _) in neighbours(i) {
                if of[j] == NO_AGGREGATE {
                    of[j] = count;
                }
            }
            count += 1;
        }
    }
    (of, count as usize)
}

/// Constants on aggregates, smoothed by a Jacobi step of the matrix without its weak couplings
/// (which are added to the diagonal, so that rows keep their sums).
fn prolongation(
    smoother: &Smoother,
    diagonal: &[f64],
    of: &[u32],
    count: usize,
    strength: f64,
) -> Matrix {
    let Smoother {
        matrix,
        max_eigenvalue: largest,
        ..
    } = smoother;
    let damping = 4.0 / (3.0 * largest);
    Matrix::from_rows(diagonal.len(), count, |i, row| {
        if of[i] == NO_AGGREGATE {
            return;
        }
        let (columns, values) = matrix.row(i);
        let couplings = || {
            columns
                .iter()
                .map(|&j| j as usize)
                .zip(values.iter().copied())
        };
        let weak =
            |&(j, v): &(usize, f64)| j != i && !is_strong(v, diagonal[i], diagonal[j], strength);
        let lumped = diagonal[i] + couplings().filter(weak).map(|(_, v)| v).sum::<f64>();
        let scale = damping
            / if lumped > 0.1 * diagonal[i] {
                lumped
            } else {
                diagonal[i]
            };
        row.add(of[i], 1.0 - scale * lumped);
        for (j, v) in couplings() {
            if j != i && of[j] != NO_AGGREGATE && is_strong(v, diagonal[i], diagonal[j], strength) {
                row.add(of[j], -scale * v);
            }
        }
    })
}

/// A dense Cholesky factor `L` of a small matrix, by rows.
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
            let rest = diagonal - row[..i].iter().map(|v| v * v).sum::<f64>();
            // Rounding may leave nothing where the matrix is all but singular.
            row[i] = rest.max(1e-14 * diagonal).max(f64::MIN_POSITIVE).sqrt();
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

    /// The seven-point Laplacian of an `n` cubed grid with zero around it, couplings scaled per axis.
    fn laplacian(n: usize, scale: [f64; 3]) -> Matrix {
        Matrix::from_rows(n * n * n, n * n * n, |r, row| {
            let at = [r % n, r / n % n, r / (n * n)];
            for (axis, stride) in [1, n, n * n].into_iter().enumerate() {
                row.add(r as u32, 2.0 * scale[axis]);
                if at[axis] > 0 {
                    row.add((r - stride) as u32, -scale[axis]);
                }
                if at[axis] + 1 < n {
                    row.add((r + stride) as u32, -scale[axis]);
                }
            }
        })
    }

    fn noise(n: usize, seed: u32) -> Vec<f64> {
        let one = |i: usize| {
            let mixed = (i as u32 ^ seed).wrapping_mul(2_654_435_761);
            f64::from(mixed ^ (mixed >> 15)) / f64::from(u32::MAX) - 0.5
        };
        (0..n).map(one).collect()
    }

    #[test]
    fn a_small_matrix_is_solved_exactly() {
        let matrix = laplacian(6, [1.0, 2.0, 3.0]);
        let x = noise(216, 1);
        let (mut b, mut found) = (vec![0.0; 216], vec![0.0; 216]);
        matrix.times(&x, &mut b);
        Multigrid::new(&matrix).apply(&b, &mut found);
        for (found, x) in found.iter().zip(&x) {
            assert!((found - x).abs() < 1e-12);
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

//! The pressure system of all discretisations, and its solution by conjugate gradients.
//!
//! Unknowns exchange fluid in proportion to their pressure differences: `A p = q`. Here q are the
//! rates of sources, A is symmetric with rows that sum to zero, and some pressures are fixed. Sets
//! of unknowns that couplings connect are *compartments*. If no pressure of a compartment is fixed,
//! its rates must balance, and its mean pressure is zero.

use super::multigrid::Multigrid;
use super::sparse_matrix::{Matrix, dot, for_each, sum};
use crate::error::cause;
use crate::geometry::NONE;
use crate::progress::CancelToken;
use crate::{Error, Result};

/// Residual at which iterations stop, relative to that of zero pressure.
const RESIDUAL_TOLERANCE: f64 = 1e-12;
/// Largest imbalance of one unknown or of all together, relative to the throughput.
const MAX_IMBALANCE: f64 = 1e-10;
/// Largest number of iterations; some tens are usual.
const MAX_ITERATIONS: usize = 2000;

/// Pressures and the statistics of their computation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Solution {
    /// Pressure of each unknown.
    pub pressure: Vec<f64>,
    /// Rate that enters at each unknown: that of its sources, or the rate that its fixed pressure
    /// causes.
    pub inflow: Vec<f64>,
    /// Statistics of the solver.
    pub stats: SolveStats,
}

/// Statistics of a solution.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
pub struct SolveStats {
    /// Number of unknown pressures.
    pub unknowns: usize,
    /// Number of compartments, between which no fluid flows.
    pub compartments: usize,
    /// Number of unknowns in compartments without fixed pressure and without sources, if other
    /// compartments have one. Nothing flows in these pockets, and their pressure is zero.
    #[serde(skip_serializing_if = "is_zero")]
    pub undetermined: usize,
    /// Number of conjugate-gradient iterations.
    pub iterations: usize,
    /// Norm of the last residual over that of the first.
    pub residual: f64,
    /// Total rate that enters, from sources and at fixed pressures.
    pub throughput: f64,
    /// Largest imbalance of one control volume, relative to the throughput.
    pub max_imbalance: f64,
    /// Imbalance of all control volumes together, relative to the throughput.
    pub total_imbalance: f64,
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// Solves `matrix p = rates` with fixed pressures. `fixed` holds pairs of an unknown and its
/// pressure (of several for one unknown, the first one applies). `weights` are the volumes that
/// weight the mean of a compartment without fixed pressure, which is zero. A sum of rates counts as
/// zero if it is below 1e-9 times `rate_scale` or times the sum of the absolute rates.
///
/// # Errors
/// Returns [`Error::Flow`] if a compartment without fixed pressure has rates that do not balance,
/// or if the iterations do not converge; [`Error::Interrupted`] once `cancel` is cancelled.
pub fn solve(
    matrix: &Matrix,
    rates: &[f64],
    fixed: &[(u32, f64)],
    weights: &[f64],
    rate_scale: f64,
    cancel: &CancelToken<'_>,
) -> Result<Solution> {
    let n = matrix.height();
    let mut pressure = vec![f64::NAN; n];
    for &(i, p) in fixed.iter().rev() {
        pressure[i as usize] = p;
    }
    let compartments = Compartments::new(matrix);
    let is_floating = compartments.pin_pressures(rates, rate_scale, &mut pressure)?;

    // Fixed pressures are not unknowns of the reduced system.
    let mut unknown_index = vec![NONE; n];
    let free: Vec<u32> = (0..n as u32)
        .filter(|&i| pressure[i as usize].is_nan())
        .collect();
    for (k, &i) in free.iter().enumerate() {
        unknown_index[i as usize] = k as u32;
        pressure[i as usize] = 0.0;
    }
    let reduced = Matrix::from_rows(free.len(), free.len(), |k, row| {
        let (columns, values) = matrix.row(free[k] as usize);
        for (&j, &v) in columns.iter().zip(values) {
            if unknown_index[j as usize] != NONE {
                row.add(unknown_index[j as usize], v);
            }
        }
    });
    let mut b = vec![0.0; free.len()];
    for_each(&mut b, |k, b| {
        let i = free[k] as usize;
        *b = rates[i] - matrix.row_dot(i, &pressure);
    });

    let mut x = vec![0.0; free.len()];
    let mut stats = SolveStats {
        unknowns: free.len(),
        compartments: compartments.count,
        undetermined: compartments.count_undetermined(&is_floating, rates),
        ..SolveStats::default()
    };
    let diagonal = matrix.diagonal();
    let mut solver = Solver::new(&reduced);
    let mut inflow = vec![0.0; n];
    // Conjugate gradients minimise another norm than the imbalance, so the imbalance decides when
    // to stop.
    let mut tolerance = RESIDUAL_TOLERANCE;
    for _ in 0..4 {
        let (iterations, residual) = solver.improve(&b, &mut x, tolerance, cancel);
        check_cancelled(cancel)?;
        stats.iterations += iterations;
        stats.residual = residual;
        for (&i, &x) in free.iter().zip(&x) {
            pressure[i as usize] = x;
        }
        measure_balance(
            matrix,
            &diagonal,
            rates,
            &pressure,
            &unknown_index,
            &mut inflow,
            &mut stats,
        );
        if stats.max_imbalance.max(stats.total_imbalance) <= MAX_IMBALANCE {
            break;
        }
        tolerance *= 0.01;
    }
    if stats.residual.is_nan() || stats.residual > 1e-6 {
        return Err(Error::Flow(cause(
            "pressure",
            format!(
                "has not converged: after {1} iterations, the residual is {0:.0e} times the first",
                stats.residual, stats.iterations
            ),
            "look for tetrahedra with zero volume and for extreme contrasts of permeability",
        )));
    }
    compartments.remove_mean(&is_floating, weights, &mut pressure);
    Ok(Solution {
        pressure,
        inflow,
        stats,
    })
}

/// Returns [`Error::Interrupted`] once `cancel` is cancelled.
pub(super) fn check_cancelled(cancel: &CancelToken<'_>) -> Result<()> {
    if cancel.is_cancelled() {
        let (problem, remedy) = ("interrupted before it was computed", "compute it again");
        return Err(Error::Interrupted(cause("flow", problem, remedy)));
    }
    Ok(())
}

/// Computes the rate that enters at each unknown, and the imbalance of the rates and of the flow.
fn measure_balance(
    matrix: &Matrix,
    diagonal: &[f64],
    rates: &[f64],
    pressure: &[f64],
    unknown_index: &[u32],
    inflow: &mut [f64],
    stats: &mut SolveStats,
) {
    let n = matrix.height();
    for_each(inflow, |i, q| {
        *q = if unknown_index[i] == NONE {
            matrix.row_dot(i, pressure)
        } else {
            rates[i]
        };
    });
    let q = &*inflow;
    stats.throughput = sum(n, |i| q[i].max(0.0));
    let total = sum(n, |i| q[i]).abs();
    let mut imbalances = vec![0.0; n];
    for_each(&mut imbalances, |i, imbalance| {
        if unknown_index[i] != NONE {
            *imbalance = (matrix.row_dot(i, pressure) - rates[i]).abs();
        }
    });
    let max_imbalance = imbalances.iter().copied().fold(0.0, f64::max);
    // Where nothing flows, only rounding errors remain. They scale with the gross rates into and
    // out of unknowns.
    let passing_rates = || (0..n).map(|i| (diagonal[i] * pressure[i]).abs());
    let scale = |rounding: f64| stats.throughput.max(rounding).max(f64::MIN_POSITIVE);
    stats.max_imbalance = max_imbalance / scale(1e-5 * passing_rates().fold(0.0, f64::max));
    stats.total_imbalance = total / scale(1e-6 * passing_rates().sum::<f64>());
}

/// The compartments: sets of unknowns that couplings connect.
struct Compartments {
    compartment_of: Vec<u32>,
    count: usize,
}

impl Compartments {
    fn new(matrix: &Matrix) -> Self {
        let n = matrix.height();
        let mut compartment_of = vec![NONE; n];
        let mut count = 0;
        let mut reached = Vec::new();
        for seed in 0..n {
            if compartment_of[seed] != NONE {
                continue;
            }
            compartment_of[seed] = count;
            reached.push(seed);
            while let Some(i) = reached.pop() {
                let (columns, values) = matrix.row(i);
                for (&j, &v) in columns.iter().zip(values) {
                    if v != 0.0 && compartment_of[j as usize] == NONE {
                        compartment_of[j as usize] = count;
                        reached.push(j as usize);
                    }
                }
            }
            count += 1;
        }
        Self {
            compartment_of,
            count: count as usize,
        }
    }

    /// Sets the pressure of one unknown to zero in each compartment without fixed pressure. Returns
    /// for each compartment whether it has no fixed pressure.
    fn pin_pressures(
        &self,
        rates: &[f64],
        rate_scale: f64,
        pressure: &mut [f64],
    ) -> Result<Vec<bool>> {
        let mut is_floating = vec![true; self.count];
        let mut sums = vec![[0.0; 2]; self.count];
        for (i, &c) in self.compartment_of.iter().enumerate() {
            is_floating[c as usize] &= pressure[i].is_nan();
            sums[c as usize][0] += rates[i];
            sums[c as usize][1] += rates[i].abs();
        }
        for c in 0..self.count {
            let [net, total] = sums[c];
            if is_floating[c] && net.abs() > 1e-9 * total.max(rate_scale) {
                let is_single = self.count == 1;
                return Err(Error::Flow(cause(
                    "rates",
                    if is_single {
                        format!(
                            "the rates of sources and sinks do not balance (their sum is {net:.6e} m^3/s), and no pressure is given"
                        )
                    } else {
                        format!(
                            "in one of the {} parts of the mesh that closed faults separate, the rates of sources and sinks do not balance (their sum is {net:.6e} m^3/s), and no pressure is given there",
                            self.count
                        )
                    },
                    if is_single {
                        "give rates whose sum is 0, or the pressure of a side (--pressure xmin=1e7)"
                    } else {
                        "give that part rates whose sum is 0 or the pressure of one of its sides, or let flow through faults (--faults 0.01)"
                    },
                )));
            }
        }
        let mut pinned = vec![false; self.count];
        for (i, &c) in self.compartment_of.iter().enumerate() {
            if is_floating[c as usize] && !pinned[c as usize] {
                pinned[c as usize] = true;
                pressure[i] = 0.0;
            }
        }
        Ok(is_floating)
    }

    /// Returns the number of unknowns in compartments without fixed pressure and without rates; 0
    /// if all compartments are such.
    fn count_undetermined(&self, is_floating: &[bool], rates: &[f64]) -> usize {
        let mut is_idle = is_floating.to_vec();
        for (&c, &rate) in self.compartment_of.iter().zip(rates) {
            is_idle[c as usize] &= rate == 0.0;
        }
        if is_idle.iter().all(|idle| *idle) {
            return 0;
        }
        self.compartment_of
            .iter()
            .filter(|&&c| is_idle[c as usize])
            .count()
    }

    fn remove_mean(&self, is_floating: &[bool], weights: &[f64], pressure: &mut [f64]) {
        let mut sums = vec![[0.0; 2]; self.count];
        for (i, &c) in self.compartment_of.iter().enumerate() {
            sums[c as usize][0] += weights[i] * pressure[i];
            sums[c as usize][1] += weights[i];
        }
        for (i, &c) in self.compartment_of.iter().enumerate() {
            let [sum, weight] = sums[c as usize];
            if is_floating[c as usize] && weight > 0.0 {
                pressure[i] -= sum / weight;
            }
        }
    }
}

/// Conjugate gradients for systems of many unknowns, with a multigrid cycle as preconditioner. It works on all
/// threads and can be cancelled; `geometry::conjugate_gradients` is for small systems, with sums in the order of
/// the unknowns.
pub struct Solver<'a> {
    matrix: &'a Matrix,
    multigrid: Multigrid,
}

impl<'a> Solver<'a> {
    /// Prepares the solver for a symmetric positive definite matrix.
    pub fn new(matrix: &'a Matrix) -> Self {
        Self {
            matrix,
            multigrid: Multigrid::new(matrix),
        }
    }

    /// Improves `x` until the residual is at most `tolerance` times that of x = 0. Returns the
    /// number of iterations and the final residual, relative to that of x = 0. Stops early once
    /// `cancel` is cancelled.
    pub fn improve(
        &mut self,
        b: &[f64],
        x: &mut [f64],
        tolerance: f64,
        cancel: &CancelToken<'_>,
    ) -> (usize, f64) {
        let n = b.len();
        let scale = dot(b, b).sqrt();
        if scale == 0.0 {
            x.fill(0.0);
            return (0, 0.0);
        }
        let matrix = self.matrix;
        let mut residual = vec![0.0; n];
        for_each(&mut residual, |i, r| *r = b[i] - matrix.row_dot(i, x));
        let mut z = vec![0.0; n];
        let mut direction = vec![0.0; n];
        let mut image = vec![0.0; n];
        let mut slope = 0.0;
        let mut relative_residual = dot(&residual, &residual).sqrt() / scale;
        let mut iterations = 0;
        while relative_residual > tolerance && iterations < MAX_ITERATIONS && !cancel.is_cancelled()
        {
            // Each iteration reduces the residual by about the same factor.
            cancel.set_fraction(relative_residual.ln() / tolerance.ln());
            self.multigrid.apply(&residual, &mut z);
            let next = dot(&residual, &z);
            let beta = if iterations == 0 { 0.0 } else { next / slope };
            slope = next;
            for_each(&mut direction, |i, p| *p = z[i] + beta * *p);
            matrix.times(&direction, &mut image);
            let step = slope / dot(&direction, &image);
            if !step.is_finite() {
                break;
            }
            for_each(x, |i, x| *x += step * direction[i]);
            for_each(&mut residual, |i, r| *r -= step * image[i]);
            relative_residual = dot(&residual, &residual).sqrt() / scale;
            iterations += 1;
        }
        for_each(&mut residual, |i, r| *r = b[i] - matrix.row_dot(i, x));
        (iterations, dot(&residual, &residual).sqrt() / scale)
    }
}

//! The pressure system that every discretisation ends in, and its solution by conjugate gradients.
//!
//! Unknowns exchange fluid in proportion to their pressures: `A p = q`, where q is what sources
//! bring in, A is symmetric with rows that sum to zero, and some pressures are given. Unknowns that
//! no path of couplings joins are *compartments*; where no pressure of a compartment is given, its
//! rates must balance, and its pressures are those of mean zero.

use super::multigrid::Multigrid;
use super::sparse_matrix::{Matrix, dot, for_each, sum};
use crate::error::cause;
use crate::progress::CancelToken;
use crate::{Error, Result};

/// The residual at which iterations stop, over that of no flow at all.
const RESIDUAL_TOLERANCE: f64 = 1e-12;
/// The largest imbalance, of one unknown or of all, over the rate that flows through.
const MAX_IMBALANCE: f64 = 1e-10;
/// Iterations at most; tens are usual.
const MAX_ITERATIONS: usize = 2000;
/// No unknown.
const NO_UNKNOWN: u32 = u32::MAX;

/// Pressures, and how well they were found.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Solution {
    /// Pressure of each unknown.
    pub pressure: Vec<f64>,
    /// Rate that enters at each unknown: its sources', or what holds its given pressure.
    pub inflow: Vec<f64>,
    /// How it was found.
    pub stats: SolveStats,
}

/// How a solution was found.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
pub struct SolveStats {
    /// Number of unknown pressures.
    pub unknowns: usize,
    /// Number of parts that exchange no fluid.
    pub compartments: usize,
    /// Unknowns in compartments that neither a given pressure nor a source reaches, while others have
    /// one: pockets where nothing flows. They have pressure zero.
    #[serde(skip_serializing_if = "is_zero")]
    pub undetermined: usize,
    /// Iterations of conjugate gradients.
    pub iterations: usize,
    /// Length of the last residual over that of the first.
    pub residual: f64,
    /// All that flows in, from sources and where pressure is given.
    pub throughput: f64,
    /// The largest imbalance of one control volume, over the throughput.
    pub max_imbalance: f64,
    /// The imbalance of all together, over the throughput.
    pub total_imbalance: f64,
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// Solves `matrix p = rates` with the pressures in `fixed` given (the first of several for one
/// unknown holds). `weights` are the volumes by which a compartment without given pressure has mean
/// zero. Sums of rates below 1e-9 of `least` (or of the rates themselves) are taken for rounding.
///
/// # Errors
/// [`Error::Flow`] if a compartment without given pressure has rates that do not balance, or the
/// iterations do not converge; [`Error::Interrupted`] once `patience` is over.
pub fn solve(
    matrix: &Matrix,
    rates: &[f64],
    fixed: &[(u32, f64)],
    weights: &[f64],
    least: f64,
    patience: &CancelToken<'_>,
) -> Result<Solution> {
    let n = matrix.height();
    let mut pressure = vec![f64::NAN; n];
    for &(i, p) in fixed.iter().rev() {
        pressure[i as usize] = p;
    }
    let compartments = Compartments::new(matrix);
    let afloat = compartments.pin_pressures(rates, least, &mut pressure)?;

    // Given pressures leave the system.
    let mut unknown = vec![NO_UNKNOWN; n];
    let free: Vec<u32> = (0..n as u32)
        .filter(|&i| pressure[i as usize].is_nan())
        .collect();
    for (k, &i) in free.iter().enumerate() {
        unknown[i as usize] = k as u32;
        pressure[i as usize] = 0.0;
    }
    let reduced = Matrix::from_rows(free.len(), free.len(), |k, row| {
        let (columns, values) = matrix.row(free[k] as usize);
        for (&j, &v) in columns.iter().zip(values) {
            if unknown[j as usize] != NO_UNKNOWN {
                row.add(unknown[j as usize], v);
            }
        }
    });
    let mut b = vec![0.0; free.len()];
    for_each(&mut b, |k, b| {
        let i = free[k] as usize;
        *b = rates[i] - matrix.row_dot(i, &pressure);
    });

    let mut x = vec![0.0; free.len()];
    let mut figures = SolveStats {
        unknowns: free.len(),
        compartments: compartments.count,
        undetermined: compartments.count_undetermined(&afloat, rates),
        ..SolveStats::default()
    };
    let diagonal = matrix.diagonal();
    let mut solver = Solver::new(&reduced);
    let mut inflow = vec![0.0; n];
    // Conjugate gradients minimise another norm than the balance, so the balance has the last word.
    let mut tolerance = RESIDUAL_TOLERANCE;
    for _ in 0..4 {
        let (iterations, residual) = solver.improve(&b, &mut x, tolerance, patience);
        check_cancelled(patience)?;
        figures.iterations += iterations;
        figures.residual = residual;
        for (&i, &x) in free.iter().zip(&x) {
            pressure[i as usize] = x;
        }
        measure_balance(
            matrix,
            &diagonal,
            rates,
            &pressure,
            &unknown,
            &mut inflow,
            &mut figures,
        );
        if figures.max_imbalance.max(figures.total_imbalance) <= MAX_IMBALANCE {
            break;
        }
        tolerance *= 0.01;
    }
    if figures.residual.is_nan() || figures.residual > 1e-6 {
        return Err(Error::Flow(cause(
            "pressure",
            format!(
                "not converged: a residual of {:.0e} of the first after {} iterations",
                figures.residual, figures.iterations
            ),
            "look for tetrahedra with zero volume and for extreme contrasts of permeability",
        )));
    }
    compartments.remove_mean(&afloat, weights, &mut pressure);
    Ok(Solution {
        pressure,
        inflow,
        stats: figures,
    })
}

/// Refuses to go on once `patience` is over.
pub(super) fn check_cancelled(patience: &CancelToken<'_>) -> Result<()> {
    if patience.is_cancelled() {
        let (problem, remedy) = ("interrupted before it was computed", "compute it again");
        return Err(Error::Interrupted(cause("flow", problem, remedy)));
    }
    Ok(())
}

/// What enters at each unknown, and how far rates and flow are from balance.
fn measure_balance(
    matrix: &Matrix,
    diagonal: &[f64],
    rates: &[f64],
    pressure: &[f64],
    unknown: &[u32],
    inflow: &mut [f64],
    figures: &mut SolveStats,
) {
    let n = matrix.height();
    for_each(inflow, |i, q| {
        *q = if unknown[i] == NO_UNKNOWN {
            matrix.row_dot(i, pressure)
        } else {
            rates[i]
        };
    });
    let q = &*inflow;
    figures.throughput = sum(n, |i| q[i].max(0.0));
    let total = sum(n, |i| q[i]).abs();
    let mut off = vec![0.0; n];
    for_each(&mut off, |i, off| {
        if unknown[i] != NO_UNKNOWN {
            *off = (matrix.row_dot(i, pressure) - rates[i]).abs();
        }
    });
    let worst = off.iter().copied().fold(0.0, f64::max);
    // Where nothing flows only rounding is left to see: of the rates into and out of unknowns.
    let passing = || (0..n).map(|i| (diagonal[i] * pressure[i]).abs());
    let over = |rounding: f64| figures.throughput.max(rounding).max(f64::MIN_POSITIVE);
    figures.max_imbalance = worst / over(1e-5 * passing().fold(0.0, f64::max));
    figures.total_imbalance = total / over(1e-6 * passing().sum::<f64>());
}

/// Which unknowns are joined by couplings.
struct Compartments {
    compartment_of: Vec<u32>,
    count: usize,
}

impl Compartments {
    fn new(matrix: &Matrix) -> Self {
        let n = matrix.height();
        let mut compartment_of = vec![NO_UNKNOWN; n];
        let mut count = 0;
        let mut reached = Vec::new();
        for seed in 0..n {
            if compartment_of[seed] != NO_UNKNOWN {
                continue;
            }
            compartment_of[seed] = count;
            reached.push(seed);
            while let Some(i) = reached.pop() {
                let (columns, values) = matrix.row(i);
                for (&j, &v) in columns.iter().zip(values) {
                    if v != 0.0 && compartment_of[j as usize] == NO_UNKNOWN {
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

    /// Gives pressure zero to one unknown of each compartment that has none given, and says which
    /// compartments these are.
    fn pin_pressures(&self, rates: &[f64], least: f64, pressure: &mut [f64]) -> Result<Vec<bool>> {
        let mut afloat = vec![true; self.count];
        let mut sums = vec![[0.0; 2]; self.count];
        for (i, &c) in self.compartment_of.iter().enumerate() {
            afloat[c as usize] &= pressure[i].is_nan();
            sums[c as usize][0] += rates[i];
            sums[c as usize][1] += rates[i].abs();
        }
        for c in 0..self.count {
            let [net, all] = sums[c];
            if afloat[c] && net.abs() > 1e-9 * all.max(least) {
                let whole = self.count == 1;
                return Err(Error::Flow(cause(
                    "rates",
                    if whole {
                        format!(
                            "sources and sinks do not balance by {net:.6e}, and no pressure is given"
                        )
                    } else {
                        format!(
                            "in one of the {} parts that closed faults separate, sources and sinks do not balance by {net:.6e}, and no pressure is given there",
                            self.count
                        )
                    },
                    if whole {
                        "balance them, or give the pressure of a side"
                    } else {
                        "balance them, open the faults, or give the pressure of a side of that part"
                    },
                )));
            }
        }
        let mut pinned = vec![false; self.count];
        for (i, &c) in self.compartment_of.iter().enumerate() {
            if afloat[c as usize] && !pinned[c as usize] {
                pinned[c as usize] = true;
                pressure[i] = 0.0;
            }
        }
        Ok(afloat)
    }

    /// How many unknowns are in compartments without given pressure and without rates; none if that is
    /// so of all of them.
    fn count_undetermined(&self, afloat: &[bool], rates: &[f64]) -> usize {
        let mut idle = afloat.to_vec();
        for (&c, &rate) in self.compartment_of.iter().zip(rates) {
            idle[c as usize] &= rate == 0.0;
        }
        match idle.iter().all(|idle| *idle) {
            true => 0,
            false => self
                .compartment_of
                .iter()
                .filter(|&&c| idle[c as usize])
                .count(),
        }
    }

    fn remove_mean(&self, afloat: &[bool], weights: &[f64], pressure: &mut [f64]) {
        let mut sums = vec![[0.0; 2]; self.count];
        for (i, &c) in self.compartment_of.iter().enumerate() {
            sums[c as usize][0] += weights[i] * pressure[i];
            sums[c as usize][1] += weights[i];
        }
        for (i, &c) in self.compartment_of.iter().enumerate() {
            let [sum, weight] = sums[c as usize];
            if afloat[c as usize] && weight > 0.0 {
                pressure[i] -= sum / weight;
            }
        }
    }
}

/// Conjugate gradients with a multigrid cycle as preconditioner.
pub struct Solver<'a> {
    matrix: &'a Matrix,
    multigrid: Multigrid,
}

impl<'a> Solver<'a> {
    /// Prepares for a symmetric positive definite matrix.
    pub fn new(matrix: &'a Matrix) -> Self {
        Self {
            matrix,
            multigrid: Multigrid::new(matrix),
        }
    }

    /// Improves `x` until the residual is `tolerance` of that of x = 0. Gives the number of
    /// iterations and the residual that was reached, in the same measure. Ends where it is once
    /// `patience` is over.
    pub fn improve(
        &mut self,
        b: &[f64],
        x: &mut [f64],
        tolerance: f64,
        patience: &CancelToken<'_>,
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
        let mut along = vec![0.0; n];
        let mut image = vec![0.0; n];
        let mut slope = 0.0;
        let mut left = dot(&residual, &residual).sqrt() / scale;
        let mut iterations = 0;
        while left > tolerance && iterations < MAX_ITERATIONS && !patience.is_cancelled() {
            // Each iteration gains about as many digits as another.
            patience.set_fraction(left.ln() / tolerance.ln());
            self.multigrid.apply(&residual, &mut z);
            let next = dot(&residual, &z);
            let keep = if iterations == 0 { 0.0 } else { next / slope };
            slope = next;
            for_each(&mut along, |i, p| *p = z[i] + keep * *p);
            matrix.times(&along, &mut image);
            let step = slope / dot(&along, &image);
            if !step.is_finite() {
                break;
            }
            for_each(x, |i, x| *x += step * along[i]);
            for_each(&mut residual, |i, r| *r -= step * image[i]);
            left = dot(&residual, &residual).sqrt() / scale;
            iterations += 1;
        }
        for_each(&mut residual, |i, r| *r = b[i] - matrix.row_dot(i, x));
        (iterations, dot(&residual, &residual).sqrt() / scale)
    }
}

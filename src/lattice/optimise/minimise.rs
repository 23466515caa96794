//! One minimisation: L-BFGS directions, or plain steepest descent, and a line search that mostly
//! needs one evaluation a step.

use crate::parallel::prelude::*;

use super::StopReason;
use super::bounds::MoveBounds;
use super::lbfgs::{CHUNK_COORDINATES, Lbfgs, dot};
use crate::error::{Error, Result, cause};
use crate::geometry::distance2;
use crate::lattice::energy::{self, Energy, EnergyParts};
use crate::lattice::halo::OwnedAndGhosts;
use crate::progress::{OptimiseStatus, Progress};

/// Largest move of an atom in a step, in units of d.
const MAX_STEP_LENGTH: f32 = 0.25;
/// Sufficient decrease (Armijo), as a fraction of what the slope predicts.
const ARMIJO_RATIO: f64 = 1e-4;
/// Inverse curvature of the energy in scaled units, before any is measured: 1 / (twelve neighbours
/// of curvature (1 - beta) / 3), twice that for neighbours that move against each other.
pub const INITIAL_INVERSE_CURVATURE: f64 = 1.0 / 4.0;
/// Shortenings of a step before the memory is dropped.
const MAX_SHORTENINGS: usize = 6;
/// The decrease that ends a minimisation is the mean over this many steps, so that one short step
/// does not end it.
const CONVERGENCE_WINDOW: usize = 3;

/// Counts of evaluations and steps over all minimisations of an optimisation, with their limit.
pub struct Budget {
    /// Evaluations so far.
    pub evaluations: usize,
    /// Steps accepted so far.
    pub iterations: usize,
    /// Largest count of evaluations.
    pub max_evaluations: usize,
}

impl Budget {
    /// Returns `true` if no evaluation is left.
    pub fn is_spent(&self) -> bool {
        self.evaluations >= self.max_evaluations
    }
}

/// Outcome of a line search.
enum SearchOutcome {
    /// A lower energy was found.
    Improved(f64, EnergyParts),
    /// No lower energy was found.
    NotImproved,
    /// The progress callback asked to stop.
    Stopped,
}

/// Positions, bounds and scales of the local atoms of a lattice during a minimisation.
pub struct Minimiser<'a, const D: usize> {
    halo: &'a OwnedAndGhosts<'a>,
    bounds: MoveBounds<D>,
    /// Positions of the owned atoms when the ghosts were chosen; empty if all atoms are local.
    start_positions: Vec<[f64; D]>,
    max_displacement2: f64,
    /// `true` to go straight down the gradient, without memory.
    is_steepest_descent: bool,
    /// Lattice units per scaled unit of each coordinate: smaller where an atom is held stiffly, so
    /// that in scaled units all curvatures are alike.
    scale: Vec<[f32; D]>,
    positions: Vec<[f64; D]>,
    trial: Vec<[f64; D]>,
    /// Valid for owned atoms at least.
    gradient: Vec<[f64; D]>,
    energy: f64,
    parts: EnergyParts,
}

impl<'a, const D: usize> Minimiser<'a, D> {
    /// `true` if the atoms may be distributed over ranks. That holds in space, where chunks of
    /// atoms are chunks of coordinates. In the plane lattices are small, so distribution would save
    /// little.
    pub const CAN_PARTITION: bool = D * energy::CHUNK_ATOMS == CHUNK_COORDINATES;

    /// Creates a minimiser for the local atoms of a lattice, at `x`, within bounds. With
    /// `is_steepest_descent` it goes straight down the gradient and stores no steps.
    pub fn new(
        halo: &'a OwnedAndGhosts<'a>,
        x: &[[f64; D]],
        bounds: MoveBounds<D>,
        is_steepest_descent: bool,
    ) -> Self {
        let move_scale = bounds.move_scale();
        let start_positions = if halo.is_partitioned() {
            x[halo.owned()].to_vec()
        } else {
            Vec::new()
        };
        Self {
            halo,
            start_positions,
            max_displacement2: 0.0,
            scale: move_scale.to_vec(),
            trial: vec![[0.0; D]; move_scale.len()],
            gradient: vec![[0.0; D]; move_scale.len()],
            bounds,
            is_steepest_descent,
            positions: Vec::new(),
            energy: f64::INFINITY,
            parts: EnergyParts::default(),
        }
    }

    /// Returns the lowest energy of the last run.
    pub fn energy(&self) -> f64 {
        self.energy
    }

    /// Returns the parts of the lowest energy.
    pub fn parts(&self) -> EnergyParts {
        self.parts
    }

    /// Returns the positions of lowest energy.
    pub fn positions(&self) -> &[[f64; D]] {
        &self.positions
    }

    /// Returns the largest distance of an owned atom from its start, or 0 if all atoms are local.
    pub fn max_displacement(&self) -> f64 {
        self.max_displacement2.sqrt()
    }

    /// Returns the bounds on the moves of atoms.
    pub fn bounds(&self) -> &MoveBounds<D> {
        &self.bounds
    }

    /// Sets the result of the last run to one that another method has found.
    pub fn set_result(&mut self, positions: Vec<[f64; D]>, energy: f64, parts: EnergyParts) {
        self.positions = positions;
        (self.energy, self.parts) = (energy, parts);
    }

    /// Evaluates the energy, and the gradient of owned atoms in the minimiser's own array.
    pub fn evaluate(
        &mut self,
        x: &[[f64; D]],
        energy: &mut dyn Energy<D>,
        budget: &mut Budget,
    ) -> Result<(f64, EnergyParts)> {
        let pairs = x[self.halo.owned()].par_iter().zip(&self.start_positions);
        let displacement2 = pairs.map(|(x, start)| distance2(x, start));
        self.max_displacement2 = displacement2.reduce(|| self.max_displacement2, f64::max);
        let value = energy.evaluate_partition(x, self.halo, &mut self.gradient)?;
        budget.evaluations += 1;
        Ok((check_finite(value)?, energy.parts()))
    }

    /// Minimises from `start` until the mean relative decrease of P over a few steps is below
    /// `tolerance`. Afterwards [`Minimiser::positions`] returns the positions of lowest energy.
    pub fn run(
        &mut self,
        start: Vec<[f64; D]>,
        energy: &mut dyn Energy<D>,
        tolerance: f64,
        round: usize,
        budget: &mut Budget,
        progress: &mut dyn Progress,
    ) -> Result<StopReason> {
        let owned = self.halo.owned();
        let mut stiffness = vec![1.0; start.len()];
        stiffness[owned.clone()].copy_from_slice(&energy.stiffness(&start[owned]));
        self.scale = self.bounds.scale(&stiffness);
        (self.energy, self.parts) = self.evaluate(&start, energy, budget)?;
        self.positions = start;
        let mut memory = Lbfgs::new(self.scaled_gradient(), INITIAL_INVERSE_CURVATURE, self.halo)?;
        let mut direction = vec![0.0f32; D * self.halo.owned().len()];
        let mut history = vec![self.energy];
        loop {
            if !progress.keep_going() {
                return Ok(StopReason::Interrupted);
            }
            if budget.is_spent() {
                return Ok(StopReason::MaxIterations);
            }
            let mut slope = memory.direction::<D>(MAX_STEP_LENGTH, &mut direction)?;
            if slope >= 0.0 && !memory.is_empty() {
                memory.reset()?;
                slope = memory.direction::<D>(MAX_STEP_LENGTH, &mut direction)?;
            }
            if slope >= 0.0 {
                return Ok(StopReason::Converged);
            }
            match self.line_search(&direction, slope, energy, budget, progress)? {
                SearchOutcome::Improved(value, parts) => {
                    self.accept(&mut memory)?;
                    if self.is_steepest_descent {
                        memory.reset()?;
                    }
                    (self.energy, self.parts) = (value, parts);
                }
                SearchOutcome::Stopped => return Ok(StopReason::Interrupted),
                SearchOutcome::NotImproved if memory.is_empty() => {
                    return Ok(StopReason::Converged);
                }
                SearchOutcome::NotImproved => {
                    memory.reset()?;
                    continue;
                }
            }
            budget.iterations += 1;
            progress.optimise_step(&OptimiseStatus {
                round,
                iterations: budget.iterations,
                evaluations: budget.evaluations,
                max_evaluations: budget.max_evaluations,
                energy: self.energy,
                lattice_energy: self.parts.lattice,
                image_energy: self.parts.image,
            });
            history.push(self.energy);
            if let Some(n) = history.len().checked_sub(CONVERGENCE_WINDOW + 1) {
                let decrease = history[n] - self.energy;
                if decrease <= CONVERGENCE_WINDOW as f64 * tolerance * self.energy.abs() {
                    return Ok(StopReason::Converged);
                }
            }
        }
    }

    /// Searches along `direction`, of owned atoms, for a lower energy, first at its end, then at
    /// shorter lengths by cubic interpolation. The result is in `trial`, its gradient in
    /// `gradient`.
    fn line_search(
        &mut self,
        direction: &[f32],
        slope: f64,
        energy: &mut dyn Energy<D>,
        budget: &mut Budget,
        progress: &mut dyn Progress,
    ) -> Result<SearchOutcome> {
        let owned = self.halo.owned();
        let mut length = 1.0;
        for shortening in 0..MAX_SHORTENINGS {
            // Evaluations take long, so check for a stop before each.
            if shortening > 0 && !progress.keep_going() {
                return Ok(SearchOutcome::Stopped);
            }
            let mut trial = std::mem::take(&mut self.trial);
            trial[owned.clone()]
                .par_iter_mut()
                .zip(direction.par_chunks(D))
                .with_min_len(CHUNK_COORDINATES)
                .enumerate()
                .for_each(|(n, (x, direction))| {
                    let n = owned.start + n;
                    let step: [f64; D] = std::array::from_fn(|k| {
                        length * f64::from(direction[k] * self.scale[n][k])
                    });
                    *x = self.bounds.apply_step(n, &self.positions[n], step);
                });
            self.halo.update_ghosts(&mut trial)?;
            self.trial = trial;
            let trial = std::mem::take(&mut self.trial);
            let result = self.evaluate(&trial, energy, budget);
            self.trial = trial;
            let (value, parts) = result?;
            if value <= self.energy + ARMIJO_RATIO * length * slope {
                return Ok(SearchOutcome::Improved(value, parts));
            }
            if budget.is_spent() {
                break;
            }
            let end_slope = self.slope_along(direction)?;
            length *= cubic_minimum(self.energy, slope * length, value, end_slope * length);
        }
        Ok(SearchOutcome::NotImproved)
    }

    /// Goes to the trial point and stores the step.
    fn accept(&mut self, memory: &mut Lbfgs<'_>) -> Result<()> {
        let owned = self.halo.owned();
        let (old, new, scale) = (&self.positions, &self.trial, &self.scale);
        let gradient = &self.gradient;
        memory.advance(|chunk, s, g| {
            let first = owned.start + chunk * CHUNK_COORDINATES / D;
            for (n, (s, g)) in s.chunks_exact_mut(D).zip(g.chunks_exact_mut(D)).enumerate() {
                let n = first + n;
                for k in 0..D {
                    let scale = scale[n][k];
                    let step = (new[n][k] - old[n][k]) as f32;
                    s[k] = if scale > 0.0 { step / scale } else { 0.0 };
                    g[k] = scale * gradient[n][k] as f32;
                }
            }
        })?;
        std::mem::swap(&mut self.positions, &mut self.trial);
        Ok(())
    }

    /// Returns the gradient of owned atoms with respect to scaled coordinates.
    fn scaled_gradient(&self) -> Vec<f32> {
        let owned = self.halo.owned();
        let pairs = self.gradient[owned.clone()].iter().zip(&self.scale[owned]);
        pairs
            .flat_map(|(g, s)| std::array::from_fn::<f32, D, _>(|k| g[k] as f32 * s[k]))
            .collect()
    }

    /// Returns the derivative of the energy along a direction at the last point evaluated.
    fn slope_along(&self, direction: &[f32]) -> Result<f64> {
        let gradient = self.scaled_gradient();
        let chunks = gradient
            .par_chunks(CHUNK_COORDINATES)
            .zip(direction.par_chunks(CHUNK_COORDINATES));
        let partial = chunks.map(|(g, p)| [dot(g, p)]).collect();
        let [slope] = self.halo.all_reduce_sum(partial)?;
        Ok(slope)
    }
}

/// Returns the energy, or an error if it is not finite.
pub fn check_finite(energy: f64) -> Result<f64> {
    if energy.is_finite() {
        return Ok(energy);
    }
    Err(Error::Optimise(cause(
        "lattice energy",
        format!("is {energy}"),
        "check the image potential and the distance for NaN and infinite values",
    )))
}

/// Returns where the cubic with the given values and slopes at 0 and 1 is smallest, limited to 0.1
/// to 0.6.
fn cubic_minimum(start: f64, start_slope: f64, end: f64, end_slope: f64) -> f64 {
    let sum = start_slope + end_slope - 3.0 * (end - start);
    let root = (sum * sum - start_slope * end_slope).sqrt();
    let position = 1.0 - (end_slope + root - sum) / (end_slope - start_slope + 2.0 * root);
    // The minimum is outside, or there is none (NaN): halve the step.
    if position.is_finite() {
        position.clamp(0.1, 0.6)
    } else {
        0.5
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubic_interpolation_finds_the_minimum_of_a_cubic() {
        // f = (t - 0.4)^2 (1 + t): f' = 2 (t - 0.4)(1 + t) + (t - 0.4)^2.
        let f = |t: f64| (t - 0.4).powi(2) * (1.0 + t);
        let slope = |t: f64| 2.0 * (t - 0.4) * (1.0 + t) + (t - 0.4).powi(2);
        let position = cubic_minimum(f(0.0), slope(0.0), f(1.0), slope(1.0));
        assert!((position - 0.4).abs() < 1e-12, "{position}");
        assert!((0.1..=0.6).contains(&cubic_minimum(0.0, -1.0, 1e9, 1e9)));
    }
}

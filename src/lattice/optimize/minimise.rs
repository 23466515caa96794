//! One minimisation: L-BFGS directions, or plain steepest descent, and a line search that mostly needs
//! one evaluation a step.

use crate::parallel::prelude::*;

use super::Stop;
use super::bounds::Bounds;
use super::lbfgs::{CHUNK, Lbfgs, dot};
use crate::error::{Error, Result, cause};
use crate::geometry::distance2;
use crate::lattice::energy::{self, Energy, Parts};
use crate::lattice::held::Held;
use crate::observer::{Observer, Progress};

/// Farthest an atom may move in a step, in units of d.
const LONGEST_MOVE: f32 = 0.25;
/// Sufficient decrease (Armijo), as a share of what the slope promises.
const SUFFICIENT: f64 = 1e-4;
/// Inverse curvature of the energy in scaled units, before any is measured: 1 / (twelve neighbours
/// of curvature (1 - beta) / 3), twice that for neighbours that move against each other.
pub const FIRST_CURVATURE: f64 = 1.0 / 4.0;
/// Shortenings of a step before the memory is dropped.
const SHORTENINGS: usize = 6;
/// The decrease that ends a minimisation is the mean over this many steps, so that one short step
/// does not.
const WINDOW: usize = 3;

/// What may be spent, over all minimisations of an optimisation.
pub struct Budget {
    /// Evaluations so far.
    pub evaluations: usize,
    /// Steps accepted so far.
    pub iterations: usize,
    /// Most evaluations.
    pub limit: usize,
}

impl Budget {
    /// Whether nothing is left.
    pub fn spent(&self) -> bool {
        self.evaluations >= self.limit
    }
}

/// How a line search ends.
enum Search {
    /// With a lower energy.
    Lower(f64, Parts),
    /// With none.
    Higher,
    /// As the observer said no.
    Stopped,
}

/// Positions, bounds and scales of the atoms held of a lattice under minimisation.
pub struct Minimiser<'a, const D: usize> {
    held: &'a Held<'a>,
    bounds: Bounds<D>,
    /// Where own atoms were when it became known which others are to be held, where not all are; and the square of how
    /// far one of them has been from there.
    begun: Vec<[f64; D]>,
    strayed2: f64,
    /// Whether to go straight down the gradient, remembering nothing.
    steepest: bool,
    /// Lattice units per scaled unit of each coordinate: less where an atom is held stiffly, so that
    /// in scaled units all curvatures are alike.
    scale: Vec<[f32; D]>,
    positions: Vec<[f64; D]>,
    trial: Vec<[f64; D]>,
    /// Of own atoms at least.
    gradient: Vec<[f64; D]>,
    energy: f64,
    parts: Parts,
}

impl<'a, const D: usize> Minimiser<'a, D> {
    /// Whether ranks may each hold a part of the atoms: in space, where chunks of atoms are chunks of
    /// coordinates. In the plane there is little to keep.
    pub const PARTED: bool = D * energy::CHUNK == CHUNK;

    /// For the atoms held of a lattice, at `x`, within bounds. `steepest`: straight down the gradient, remembering no
    /// steps.
    pub fn new(held: &'a Held<'a>, x: &[[f64; D]], bounds: Bounds<D>, steepest: bool) -> Self {
        let reach = bounds.reach();
        let begun = match held.is_part() {
            true => x[held.own()].to_vec(),
            false => Vec::new(),
        };
        Self {
            held,
            begun,
            strayed2: 0.0,
            scale: reach.to_vec(),
            trial: vec![[0.0; D]; reach.len()],
            gradient: vec![[0.0; D]; reach.len()],
            bounds,
            steepest,
            positions: Vec::new(),
            energy: f64::INFINITY,
            parts: Parts::default(),
        }
    }

    /// The lowest energy of the last run.
    pub fn energy(&self) -> f64 {
        self.energy
    }

    /// Its parts.
    pub fn parts(&self) -> Parts {
        self.parts
    }

    /// The positions that have it.
    pub fn positions(&self) -> &[[f64; D]] {
        &self.positions
    }

    /// The farthest that an own atom has been from where it was, where not all atoms are held.
    pub fn strayed(&self) -> f64 {
        self.strayed2.sqrt()
    }

    /// How far atoms may move.
    pub fn bounds(&self) -> &Bounds<D> {
        &self.bounds
    }

    /// Takes what another way has found for the result of the last run.
    pub fn take(&mut self, positions: Vec<[f64; D]>, energy: f64, parts: Parts) {
        self.positions = positions;
        (self.energy, self.parts) = (energy, parts);
    }

    /// Evaluates the energy, and the gradient of own atoms in the minimiser's own array.
    pub fn measure(
        &mut self,
        x: &[[f64; D]],
        energy: &mut dyn Energy<D>,
        budget: &mut Budget,
    ) -> Result<(f64, Parts)> {
        let own = x[self.held.own()].par_iter().zip(&self.begun);
        let strayed2 = own.map(|(x, from)| distance2(x, from));
        self.strayed2 = strayed2.reduce(|| self.strayed2, f64::max);
        let value = energy.evaluate_held(x, self.held, &mut self.gradient)?;
        budget.evaluations += 1;
        Ok((finite(value)?, energy.parts()))
    }

    /// Minimises from `start` until the mean relative decrease of P over a few steps is below
    /// `tolerance`. Afterwards [`Minimiser::positions`] are the lowest found.
    pub fn run(
        &mut self,
        start: Vec<[f64; D]>,
        energy: &mut dyn Energy<D>,
        tolerance: f64,
        round: usize,
        budget: &mut Budget,
        observer: &mut dyn Observer,
    ) -> Result<Stop> {
        let own = self.held.own();
        let mut stiffness = vec![1.0; start.len()];
        stiffness[own.clone()].copy_from_slice(&energy.stiffness(&start[own]));
        self.scale = self.bounds.scale(&stiffness);
        (self.energy, self.parts) = self.measure(&start, energy, budget)?;
        self.positions = start;
        let mut memory = Lbfgs::new(self.scaled_gradient(), FIRST_CURVATURE, self.held)?;
        let mut direction = vec![0.0f32; D * self.held.own().len()];
        let mut history = vec![self.energy];
        loop {
            if !observer.keep_going() {
                return Ok(Stop::Interrupted);
            }
            if budget.spent() {
                return Ok(Stop::MaxIterations);
            }
            let mut slope = memory.direction::<D>(LONGEST_MOVE, &mut direction)?;
            if slope >= 0.0 && !memory.is_empty() {
                memory.forget()?;
                slope = memory.direction::<D>(LONGEST_MOVE, &mut direction)?;
            }
            if slope >= 0.0 {
                return Ok(Stop::Converged);
            }
            match self.search(&direction, slope, energy, budget, observer)? {
                Search::Lower(value, parts) => {
                    self.accept(&mut memory)?;
                    if self.steepest {
                        memory.forget()?;
                    }
                    (self.energy, self.parts) = (value, parts);
                }
                Search::Stopped => return Ok(Stop::Interrupted),
                Search::Higher if memory.is_empty() => return Ok(Stop::Converged),
                Search::Higher => {
                    memory.forget()?;
                    continue;
                }
            }
            budget.iterations += 1;
            observer.progress(&Progress {
                round,
                iterations: budget.iterations,
                evaluations: budget.evaluations,
                energy: self.energy,
                lattice: self.parts.lattice,
                image: self.parts.image,
            });
            history.push(self.energy);
            if let Some(n) = history.len().checked_sub(WINDOW + 1) {
                let decrease = history[n] - self.energy;
                if decrease <= WINDOW as f64 * tolerance * self.energy.abs() {
                    return Ok(Stop::Converged);
                }
            }
        }
    }

    /// Looks along `direction`, of own atoms, for a lower energy, first at its end, then by cubic
    /// interpolation ever nearer. The point found is in `trial`, its gradient in `gradient`.
    fn search(
        &mut self,
        direction: &[f32],
        slope: f64,
        energy: &mut dyn Energy<D>,
        budget: &mut Budget,
        observer: &mut dyn Observer,
    ) -> Result<Search> {
        let own = self.held.own();
        let mut length = 1.0;
        for shortening in 0..SHORTENINGS {
            // Evaluations take long.
            if shortening > 0 && !observer.keep_going() {
                return Ok(Search::Stopped);
            }
            let mut trial = std::mem::take(&mut self.trial);
            trial[own.clone()]
                .par_iter_mut()
                .zip(direction.par_chunks(D))
                .with_min_len(CHUNK)
                .enumerate()
                .for_each(|(n, (x, direction))| {
                    let n = own.start + n;
                    let step: [f64; D] = std::array::from_fn(|k| {
                        length * f64::from(direction[k] * self.scale[n][k])
                    });
                    *x = self.bounds.step(n, &self.positions[n], step);
                });
            self.held.refresh(&mut trial)?;
            self.trial = trial;
            let trial = std::mem::take(&mut self.trial);
            let found = self.measure(&trial, energy, budget);
            self.trial = trial;
            let (value, parts) = found?;
            if value <= self.energy + SUFFICIENT * length * slope {
                return Ok(Search::Lower(value, parts));
            }
            if budget.spent() {
                break;
            }
            let end_slope = self.slope_along(direction)?;
            length *= cubic_minimum(self.energy, slope * length, value, end_slope * length);
        }
        Ok(Search::Higher)
    }

    /// Goes to the trial point and remembers the step.
    fn accept(&mut self, memory: &mut Lbfgs<'_>) -> Result<()> {
        let own = self.held.own();
        let (old, new, scale) = (&self.positions, &self.trial, &self.scale);
        let gradient = &self.gradient;
        memory.advance(|chunk, s, g| {
            let first = own.start + chunk * CHUNK / D;
            for (n, (s, g)) in s.chunks_exact_mut(D).zip(g.chunks_exact_mut(D)).enumerate() {
                let n = first + n;
                for k in 0..D {
                    let scale = scale[n][k];
                    let moved = (new[n][k] - old[n][k]) as f32;
                    s[k] = if scale > 0.0 { moved / scale } else { 0.0 };
                    g[k] = scale * gradient[n][k] as f32;
                }
            }
        })?;
        std::mem::swap(&mut self.positions, &mut self.trial);
        Ok(())
    }

    /// The gradient of own atoms with respect to scaled coordinates.
    fn scaled_gradient(&self) -> Vec<f32> {
        let own = self.held.own();
        let pairs = self.gradient[own.clone()].iter().zip(&self.scale[own]);
        pairs
            .flat_map(|(g, s)| std::array::from_fn::<f32, D, _>(|k| g[k] as f32 * s[k]))
            .collect()
    }

    /// The derivative of the energy along a direction at the last point measured.
    fn slope_along(&self, direction: &[f32]) -> Result<f64> {
        let gradient = self.scaled_gradient();
        let chunks = gradient.par_chunks(CHUNK).zip(direction.par_chunks(CHUNK));
        let partial = chunks.map(|(g, p)| [dot(g, p)]).collect();
        let [slope] = self.held.total(partial)?;
        Ok(slope)
    }
}

/// An energy, if it is a number.
pub fn finite(energy: f64) -> Result<f64> {
    if energy.is_finite() {
        return Ok(energy);
    }
    Err(Error::Optimize(cause(
        "lattice energy",
        format!("is {energy}"),
        "check the image potential and the distance for NaN and infinite values",
    )))
}

/// Where between 0.1 and 0.6 of the way the cubic with the given values and slopes at 0 and 1 is
/// least.
fn cubic_minimum(start: f64, start_slope: f64, end: f64, end_slope: f64) -> f64 {
    let sum = start_slope + end_slope - 3.0 * (end - start);
    let root = (sum * sum - start_slope * end_slope).sqrt();
    let place = 1.0 - (end_slope + root - sum) / (end_slope - start_slope + 2.0 * root);
    // Outside, or no minimum at all (NaN): halve.
    if place.is_finite() {
        place.clamp(0.1, 0.6)
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
        let place = cubic_minimum(f(0.0), slope(0.0), f(1.0), slope(1.0));
        assert!((place - 0.4).abs() < 1e-12, "{place}");
        assert!((0.1..=0.6).contains(&cubic_minimum(0.0, -1.0, 1e9, 1e9)));
    }
}

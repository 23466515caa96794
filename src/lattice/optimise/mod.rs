//! Moves the atoms of a lattice to lower its energy (Hale 2001, Algorithm 3).
//!
//! Each round perturbs every atom a little and then minimises the energy with L-BFGS until it no
//! longer falls. The optimisation stops when a whole round no longer pays, and keeps the best
//! lattice.
//!
//! Atoms keep to their place in the box: corners and fixed atoms do not move, edge atoms slide
//! along their edge, side atoms in their side, and no free coordinate comes nearer to a side than a
//! fifth of d. Coordinates are scaled by d(x) (and the square root of an atom's temperature), so
//! that fine and coarse parts of a lattice converge alike.
//!
//! - `bounds`: bounds on moves, and random moves
//! - `lbfgs`: the descent direction
//! - `minimise`: one minimisation: line search, stopping
//! - `temperature`: which atoms a local edit may move

pub(crate) mod bounds;
mod lbfgs;
pub(crate) mod minimise;
pub(crate) mod temperature;

pub use crate::progress::{LatticeSnapshot, NoProgress, OptimiseStatus, Progress};

use std::fmt::{self, Display, Formatter};

use serde::{Serialize, Serializer};

use crate::error::{Error, Result, cause};
use crate::geometry::to_3d;
use crate::lattice::distance::Distance;
use crate::lattice::energy::{Energy, EnergyTerms};
use crate::lattice::halo::{self, OwnedAndGhosts, SharedLattice};
use crate::lattice::seeding::Atoms;
use bounds::MoveBounds;
use minimise::{Budget, Minimiser};

/// The reason why an optimisation ended. Every one leaves a usable lattice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopReason {
    /// The energy no longer falls by more than the tolerance.
    Converged,
    /// The allowed rounds or evaluations are used up.
    MaxIterations,
    /// The progress callback asked to stop.
    Interrupted,
}

impl Display for StopReason {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Converged => "converged",
            Self::MaxIterations => "as many rounds as allowed",
            Self::Interrupted => "interrupted",
        })
    }
}

impl Serialize for StopReason {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// A round by another method: lowers the energy from the given positions, and stores the result in
/// the minimiser. The integer is the number of the round.
pub type Round<const D: usize> = fn(
    &mut Minimiser<'_, D>,
    &[[f64; D]],
    &mut dyn Energy<D>,
    &OptimiseOptions<D>,
    usize,
    &mut Budget,
    &mut dyn Progress,
) -> Result<StopReason>;

/// The method that lowers the energy in a round.
#[derive(Debug, Clone, Copy, Default)]
pub enum Method<const D: usize> {
    /// Limited-memory BFGS.
    #[default]
    Lbfgs,
    /// Steepest descent, in coordinates scaled as for L-BFGS.
    Descent,
    /// Another method for whole lattices, which sends its own snapshots.
    Other {
        /// One round.
        run: Round<D>,
        /// Evaluations that it needs, as a multiple of those of L-BFGS.
        effort: usize,
    },
}

/// Options of an optimisation.
#[derive(Debug, Clone)]
pub struct OptimiseOptions<const D: usize> {
    /// The method of each round.
    pub method: Method<D>,
    /// Relative decrease of P, a step and a round, below which steps and rounds end (Hale: 1e-3).
    pub tolerance: f64,
    /// Most rounds of perturbation and minimisation.
    pub max_rounds: usize,
    /// Most evaluations of the energy over all rounds.
    pub max_evaluations: usize,
    /// Largest perturbation of an atom, in units of d (Hale: 0.1).
    pub perturbation: f64,
    /// Seed of the perturbations; the same seed gives the same bytes.
    pub seed: u64,
    /// Temperature of each atom in [0, 1], which scales its force; empty for 1 everywhere.
    pub temperature: Vec<f64>,
}

impl<const D: usize> Default for OptimiseOptions<D> {
    fn default() -> Self {
        Self {
            method: Method::Lbfgs,
            tolerance: 3e-4,
            max_rounds: 2,
            max_evaluations: 60,
            perturbation: 0.1,
            seed: 1,
            temperature: Vec::new(),
        }
    }
}

impl<const D: usize> OptimiseOptions<D> {
    /// Sets the method and scales the limits to it: other methods need more evaluations than L-BFGS.
    /// Three times as many rounds are allowed if `is_regularised`, that is, if the energy changes
    /// from round to round.
    pub fn with_method(self, method: Method<D>, is_regularised: bool) -> Self {
        let effort = match method {
            Method::Lbfgs => 1,
            Method::Descent => 5,
            Method::Other { effort, .. } => effort,
        };
        let rounds = if is_regularised { 3 } else { 1 };
        Self {
            method,
            max_rounds: self.max_rounds * rounds,
            max_evaluations: self.max_evaluations * effort * rounds,
            ..self
        }
    }
}

/// Result of an optimisation: why it stopped, its cost and the energies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OptimiseResult {
    /// Why it ended.
    pub stop: StopReason,
    /// Rounds begun.
    pub rounds: usize,
    /// Steps accepted.
    pub iterations: usize,
    /// Evaluations of the energy.
    pub evaluations: usize,
    /// The minimised energy of the initial lattice.
    pub energy_before: f64,
    /// The minimised energy of the final lattice.
    pub energy_after: f64,
    /// The terms of the energy of the final lattice.
    pub terms: EnergyTerms,
}

/// Largest distance, in units of d, of atoms that are listed as neighbours.
const NEIGHBOUR_RADIUS: f64 = 1.75;
/// Largest expected move of an atom, in units of the largest d, where d is constant.
const EXPECTED_MOVE: f64 = 0.75;
/// Largest expected move of an atom, in units of the largest d, where d varies. It is larger
/// because a grown lattice is less even.
const VARYING_D_FACTOR: f64 = 1.5;

/// Returns the largest expected move of an atom.
fn expected_move<const D: usize>(distance: &Distance<D>) -> f64 {
    let factor = if distance.max_slope() > 0.0 {
        VARYING_D_FACTOR
    } else {
        EXPECTED_MOVE
    };
    factor * distance.max()
}

/// Returns the largest distance, along each axis, of a rank's ghosts from its owned atoms.
pub(crate) fn halo_width<const D: usize>(distance: &Distance<D>) -> f64 {
    halo::halo_extent(NEIGHBOUR_RADIUS * distance.max() + 2.0 * expected_move(distance))
}

/// Lowers the energy of a lattice in the box `[0, extent]`.
///
/// # Errors
/// Returns [`Error::Optimise`] if an option is impossible or the energy is not a number.
pub fn optimise<const D: usize>(
    atoms: &mut Atoms<D>,
    energy: &mut dyn Energy<D>,
    distance: &Distance<D>,
    extent: [f64; D],
    options: &OptimiseOptions<D>,
    progress: &mut dyn Progress,
) -> Result<OptimiseResult> {
    check_options(options, atoms.len())?;
    let halo = &OwnedAndGhosts::all(atoms.len());
    lower_energy(atoms, halo, energy, distance, extent, options, progress).map(|(result, _)| result)
}

/// Lowers the energy of a lattice that is distributed over ranks. If the energy [supports
/// it](Energy::supports_partition), each rank moves its owned atoms and keeps ghosts; otherwise all
/// ranks have the whole lattice. The result is the same as that of one process.
///
/// # Errors
/// Returns an error as [`optimise`] does, or if another rank fails.
pub(crate) fn optimise_partition<const D: usize>(
    lattice: SharedLattice<'_, D>,
    energy: &mut dyn Energy<D>,
    distance: &Distance<D>,
    extent: [f64; D],
    options: &OptimiseOptions<D>,
    progress: &mut dyn Progress,
) -> Result<OptimiseResult> {
    let can_partition = energy.supports_partition()
        && Minimiser::<D>::CAN_PARTITION
        && options.temperature.is_empty();
    if lattice.is_shared() && can_partition && !matches!(options.method, Method::Other { .. }) {
        let max_move = expected_move(distance);
        return optimise_with_halo(
            lattice, energy, distance, extent, options, max_move, progress,
        );
    }
    lattice.change_all(|atoms| optimise(atoms, energy, distance, extent, options, progress))?
}

/// Lowers the energy of a distributed lattice with ghosts. `max_move` is the expected largest move of
/// an atom.
fn optimise_with_halo<const D: usize>(
    lattice: SharedLattice<'_, D>,
    energy: &mut dyn Energy<D>,
    distance: &Distance<D>,
    extent: [f64; D],
    options: &OptimiseOptions<D>,
    mut max_move: f64,
    progress: &mut dyn Progress,
) -> Result<OptimiseResult> {
    check_options(options, lattice.owned.global_count)?;
    loop {
        let halo_width = NEIGHBOUR_RADIUS * distance.max() + 2.0 * max_move;
        let (halo, mut atoms) = lattice.with_halo(halo_width)?;
        let energy = &mut *energy.duplicate();
        let (result, displacement) = lower_energy(
            &mut atoms, &halo, energy, distance, extent, options, progress,
        )?;
        if !halo.any("farthest move", displacement > max_move)? {
            let positions = &atoms.positions[halo.owned()];
            lattice.owned.atoms.positions.copy_from_slice(positions);
            return Ok(result);
        }
        // Some atoms may have met others that are not local: repeat with a wider halo.
        max_move *= 2.0;
    }
}

/// Lowers the energy of a lattice of which the atoms in `halo` are local. Returns also the largest
/// distance of an owned atom from its start, or 0 if all atoms are local.
fn lower_energy<const D: usize>(
    atoms: &mut Atoms<D>,
    halo: &OwnedAndGhosts<'_>,
    energy: &mut dyn Energy<D>,
    distance: &Distance<D>,
    extent: [f64; D],
    options: &OptimiseOptions<D>,
    progress: &mut dyn Progress,
) -> Result<(OptimiseResult, f64)> {
    let mobility = mobility(atoms, extent, &options.temperature);
    let bounds = MoveBounds::new(atoms, distance, extent, &mobility);
    drop(mobility);
    let is_steepest_descent = matches!(options.method, Method::Descent);
    let mut minimiser = Minimiser::new(halo, &atoms.positions, bounds, is_steepest_descent);
    let mut budget = Budget {
        evaluations: 0,
        iterations: 0,
        max_evaluations: options.max_evaluations,
    };
    energy.refresh(&atoms.positions)?;
    let (energy_before, _) = minimiser.evaluate(&atoms.positions, energy, &mut budget)?;
    let mut best = energy_before;
    let mut scratch = vec![[0.0; D]; atoms.len()];
    let x = &atoms.positions;
    send_snapshot(x, halo, best, 0, energy, &mut scratch, progress)?;
    let mut rounds = 0;
    let stop = loop {
        if rounds == options.max_rounds || budget.is_spent() {
            break StopReason::MaxIterations;
        }
        // Starting a round takes several evaluations, so check for a stop first.
        if !progress.keep_going() {
            break StopReason::Interrupted;
        }
        if rounds > 0 && energy.refresh(&atoms.positions)? {
            (best, _) = minimiser.evaluate(&atoms.positions, energy, &mut budget)?;
        }
        rounds += 1;
        let key = options.seed.wrapping_add(rounds as u64);
        let stop = match options.method {
            Method::Other { run, .. } => run(
                &mut minimiser,
                &atoms.positions,
                energy,
                options,
                rounds,
                &mut budget,
                progress,
            )?,
            Method::Lbfgs | Method::Descent => {
                let bounds = minimiser.bounds();
                let start = bounds.perturb(&atoms.positions, halo, options.perturbation, key);
                minimiser.run(
                    start,
                    energy,
                    options.tolerance,
                    rounds,
                    &mut budget,
                    progress,
                )?
            }
        };
        let previous_best = best;
        let is_first_round = rounds == 1;
        if minimiser.energy() < best {
            best = minimiser.energy();
            atoms.positions.copy_from_slice(minimiser.positions());
        }
        if !matches!(options.method, Method::Other { .. }) {
            let x = &atoms.positions;
            send_snapshot(x, halo, best, rounds, energy, &mut scratch, progress)?;
        }
        if stop == StopReason::Interrupted {
            break stop;
        }
        if !is_first_round && previous_best - best <= options.tolerance * previous_best.abs() {
            break StopReason::Converged;
        }
    };
    let result = OptimiseResult {
        stop,
        rounds,
        iterations: budget.iterations,
        evaluations: budget.evaluations,
        energy_before,
        energy_after: best,
        terms: energy.terms(&atoms.positions, halo, best, &mut scratch)?,
    };
    Ok((result, minimiser.max_displacement()))
}

/// Passes a lattice, whose minimised energy is `minimised`, to the progress callback if it wants
/// lattices.
pub(crate) fn send_snapshot<const D: usize>(
    x: &[[f64; D]],
    halo: &OwnedAndGhosts<'_>,
    minimised: f64,
    round: usize,
    energy: &mut (impl Energy<D> + ?Sized),
    scratch: &mut [[f64; D]],
    progress: &mut dyn Progress,
) -> Result<()> {
    if !progress.wants_lattices() {
        return Ok(());
    }
    let terms = energy.terms(x, halo, minimised, scratch)?;
    let positions: Vec<[f64; 3]> = x.iter().map(|&x| to_3d(x)).collect();
    progress.lattice(&LatticeSnapshot {
        round,
        positions: &positions,
        energy: terms.energy,
        lattice_energy: terms.published.lattice,
        image_energy: terms.published.image,
    });
    Ok(())
}

fn check_options<const D: usize>(options: &OptimiseOptions<D>, atom_count: usize) -> Result<()> {
    let fail = |place: &str, problem: String, remedy: &str| {
        Err(Error::Optimise(cause(place, problem, remedy)))
    };
    if !(options.tolerance > 0.0 && options.tolerance < 1.0) {
        let problem = format!("{} is not between 0 and 1", options.tolerance);
        return fail("tolerance", problem, "give for example 1e-3");
    }
    if !(0.0..=0.5).contains(&options.perturbation) {
        let problem = format!("{} d is not between 0 and 0.5 d", options.perturbation);
        return fail("perturbation", problem, "give for example 0.1");
    }
    let temperature = &options.temperature;
    if !(temperature.is_empty() || temperature.len() == atom_count) {
        let problem = format!("{} values for {atom_count} atoms", temperature.len());
        return fail(
            "temperature",
            problem,
            "give one value for each atom, or none",
        );
    }
    if !temperature.iter().all(|t| (0.0..=1.0).contains(t)) {
        let problem = "some are outside [0, 1]".to_string();
        return fail(
            "temperature",
            problem,
            "give values from 0 (frozen) to 1 (free)",
        );
    }
    Ok(())
}

/// Returns how far each coordinate of each atom may follow its force: mobility in the box, times
/// the square root of temperature (the gradient is scaled by it once, and so is the step).
fn mobility<const D: usize>(
    atoms: &Atoms<D>,
    extent: [f64; D],
    temperature: &[f64],
) -> Vec<[f64; D]> {
    let mut mobility = atoms.mobility(extent);
    for (mobility, t) in mobility.iter_mut().zip(temperature) {
        *mobility = mobility.map(|m| m * t.sqrt());
    }
    mobility
}

#[cfg(test)]
mod tests;

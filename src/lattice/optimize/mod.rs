//! Moves the atoms of a lattice to lower its energy (Hale 2001, Algorithm 3).
//!
//! Repeat: perturb every atom a little, then minimise the energy with L-BFGS until it no longer
//! falls; stop when a whole round no longer pays, and keep the best.
//!
//! Atoms keep to their place in the box: corners and fixed atoms stay, edge atoms slide along their
//! edge, side atoms in their side, and no free coordinate comes nearer to a side than a fifth of d.
//! Coordinates are scaled by d(x) (and the square root of an atom's temperature), so that fine and
//! coarse parts of a lattice converge alike.
//!
//! - `bounds`: how far atoms may move, and chance moves
//! - `lbfgs`: the descent direction
//! - `minimise`: one minimisation: line search, stopping
//! - `genetic`: a population of lattices instead, of which the best have descendants
//! - `temperature`: which atoms a local edit may move

pub(crate) mod bounds;
pub mod genetic;
mod lbfgs;
pub(crate) mod minimise;
pub(crate) mod temperature;

pub use crate::progress::{LatticeSnapshot, NoProgress, OptimizeStatus, Progress};

use serde::{Deserialize, Serialize};

use crate::comm::Comm;
use crate::error::{Error, Result, cause};
use crate::geometry::to_3d;
use crate::lattice::distance::Distance;
use crate::lattice::energy::{Energy, EnergyTerms};
use crate::lattice::halo::{self, OwnedAndGhosts};
use crate::lattice::partition::OwnedAtoms;
use crate::lattice::seeding::Atoms;
use bounds::MoveBounds;
use minimise::{Budget, Minimiser};

/// Why an optimisation ended. Every one leaves a usable lattice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopReason {
    /// The energy no longer falls by more than the tolerance.
    Converged,
    /// The allowed rounds or evaluations are used up.
    MaxIterations,
    /// The observer asked to stop.
    Interrupted,
}

/// How the energy is lowered in a round.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Limited-memory BFGS (fast)
    #[default]
    Lbfgs,
    /// Steepest descent, in coordinates scaled as for L-BFGS
    Descent,
    /// A genetic algorithm: a population of ten lattices (slow)
    Genetic,
}

/// How, and how hard, to optimise.
#[derive(Debug, Clone, PartialEq)]
pub struct OptimizeOptions {
    /// How each round goes.
    pub method: Method,
    /// Relative decrease of P, a step and a round, below which steps and rounds end (Hale: 1e-3).
    pub tolerance: f64,
    /// Most rounds of perturbation and minimisation.
    pub max_rounds: usize,
    /// Most evaluations of the energy over all rounds.
    pub max_evaluations: usize,
    /// Largest perturbation of an atom, in units of d (Hale: 0.1).
    pub perturbation: f64,
    /// Decides the perturbations; the same seed gives the same bytes.
    pub seed: u64,
    /// Temperature of each atom in [0, 1], which scales its force; empty for 1 everywhere.
    pub temperature: Vec<f64>,
}

impl Default for OptimizeOptions {
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

impl OptimizeOptions {
    /// With another method and the effort that suits it: steepest descent takes more evaluations, and a
    /// genetic algorithm many, but of these as many at once as there are threads. Where energies change
    /// from round to round (`regular`, by Laplacian coordinates) there are three.
    pub fn with_method(self, method: Method, regular: bool) -> Self {
        let effort = match method {
            Method::Lbfgs => 1,
            Method::Descent => 5,
            Method::Genetic => 25,
        };
        let rounds = if regular { 3 } else { 1 };
        Self {
            method,
            max_rounds: self.max_rounds * rounds,
            max_evaluations: self.max_evaluations * effort * rounds,
            ..self
        }
    }
}

/// How a lattice came to rest, and what that took.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OptimizeResult {
    /// Why it ended.
    pub stop: StopReason,
    /// Rounds begun.
    pub rounds: usize,
    /// Steps accepted.
    pub iterations: usize,
    /// Evaluations of the energy.
    pub evaluations: usize,
    /// What is minimised, of the lattice as given.
    pub energy_before: f64,
    /// The same of the lattice as left.
    pub energy_after: f64,
    /// What the latter consists of.
    pub terms: EnergyTerms,
}

/// How far apart, in units of d, atoms that are listed as neighbours may be.
const NEIGHBOUR_RADIUS: f64 = 1.75;
/// How far, in units of the largest d, atoms are expected to move at most ...
const EXPECTED_MOVE: f64 = 0.75;
/// ... and where d varies, as a grown lattice is less even.
const VARYING_D_FACTOR: f64 = 1.5;

/// How far atoms are expected to move at most.
fn expected_move<const D: usize>(distance: &Distance<D>) -> f64 {
    let moves = match distance.max_slope() > 0.0 {
        true => VARYING_D_FACTOR,
        false => EXPECTED_MOVE,
    };
    moves * distance.max()
}

/// How far, along each axis, atoms that one of a group holds may be from its own.
pub(crate) fn halo_width<const D: usize>(distance: &Distance<D>) -> f64 {
    halo::halo_extent(NEIGHBOUR_RADIUS * distance.max() + 2.0 * expected_move(distance))
}

/// Lowers the energy of a lattice in the box `[0, extent]`.
///
/// # Errors
/// [`Error::Optimize`] if an option is impossible or the energy is not a number.
pub fn optimize<const D: usize>(
    atoms: &mut Atoms<D>,
    energy: &mut dyn Energy<D>,
    distance: &Distance<D>,
    extent: [f64; D],
    options: &OptimizeOptions,
    observer: &mut dyn Progress,
) -> Result<OptimizeResult> {
    check_options(options, atoms.len())?;
    let held = &OwnedAndGhosts::all(atoms.len());
    lower_energy(atoms, held, energy, distance, extent, options, observer).map(|(rest, _)| rest)
}

/// The same by a group, each of which has a share of the lattice: if the energy [takes parts](Energy::supports_partition), each
/// moves its own atoms and holds those near them. The lattice comes to rest as one would bring it.
///
/// # Errors
/// As [`optimize`], and those of others.
pub(crate) fn optimize_partition<const D: usize>(
    share: &mut OwnedAtoms<D>,
    energy: &mut dyn Energy<D>,
    distance: &Distance<D>,
    extent: [f64; D],
    options: &OptimizeOptions,
    group: &dyn Comm,
    observer: &mut dyn Progress,
) -> Result<OptimizeResult> {
    let parted = energy.supports_partition()
        && Minimiser::<D>::CAN_PARTITION
        && options.temperature.is_empty();
    if group.size() > 1 && parted && options.method != Method::Genetic {
        let room = expected_move(distance);
        return optimize_with_halo(
            share, energy, distance, extent, options, room, group, observer,
        );
    }
    let mut atoms = std::mem::take(share).all_gather(group)?;
    let rest = optimize(&mut atoms, energy, distance, extent, options, observer);
    *share = OwnedAtoms::from_global(atoms, group);
    rest
}

/// The same where none is expected to move farther than `room`.
fn optimize_with_halo<const D: usize>(
    share: &mut OwnedAtoms<D>,
    energy: &mut dyn Energy<D>,
    distance: &Distance<D>,
    extent: [f64; D],
    options: &OptimizeOptions,
    mut room: f64,
    group: &dyn Comm,
    observer: &mut dyn Progress,
) -> Result<OptimizeResult> {
    check_options(options, share.global_count)?;
    loop {
        let reach = NEIGHBOUR_RADIUS * distance.max() + 2.0 * room;
        let (held, mut atoms) = OwnedAndGhosts::with_halo(share, reach, group)?;
        let energy = &mut *energy.duplicate();
        let (rest, strayed) = lower_energy(
            &mut atoms, &held, energy, distance, extent, options, observer,
        )?;
        let strayed = held.all_gather("farthest move", strayed)?;
        if strayed.iter().all(|&strayed| strayed <= room) {
            let own = &atoms.positions[held.owned()];
            share.atoms.positions.copy_from_slice(own);
            return Ok(rest);
        }
        // Some may have met others that are not held: once more, with more of them.
        room *= 2.0;
    }
}

/// Lowers the energy of a lattice, of which these atoms are held. Says also how far an own one has been from where it
/// was, where not all are held.
fn lower_energy<const D: usize>(
    atoms: &mut Atoms<D>,
    held: &OwnedAndGhosts<'_>,
    energy: &mut dyn Energy<D>,
    distance: &Distance<D>,
    extent: [f64; D],
    options: &OptimizeOptions,
    observer: &mut dyn Progress,
) -> Result<(OptimizeResult, f64)> {
    let mobility = mobility(atoms, extent, &options.temperature);
    let bounds = MoveBounds::new(atoms, distance, extent, &mobility);
    drop(mobility);
    let steepest = options.method == Method::Descent;
    let mut minimiser = Minimiser::new(held, &atoms.positions, bounds, steepest);
    let mut budget = Budget {
        evaluations: 0,
        iterations: 0,
        max_evaluations: options.max_evaluations,
    };
    energy.refresh(&atoms.positions)?;
    let (energy_before, _) = minimiser.evaluate(&atoms.positions, energy, &mut budget)?;
    let mut best = energy_before;
    let mut spare = vec![[0.0; D]; atoms.len()];
    let x = &atoms.positions;
    send_snapshot(x, held, best, 0, energy, &mut spare, observer)?;
    let mut rounds = 0;
    let stop = loop {
        if rounds == options.max_rounds || budget.is_spent() {
            break StopReason::MaxIterations;
        }
        // To begin a round takes several evaluations.
        if !observer.keep_going() {
            break StopReason::Interrupted;
        }
        if rounds > 0 && energy.refresh(&atoms.positions)? {
            (best, _) = minimiser.evaluate(&atoms.positions, energy, &mut budget)?;
        }
        rounds += 1;
        let key = options.seed.wrapping_add(rounds as u64);
        let stop = match options.method {
            Method::Genetic => genetic::evolve(
                &mut minimiser,
                &atoms.positions,
                energy,
                options,
                rounds,
                &mut budget,
                observer,
            )?,
            Method::Lbfgs | Method::Descent => {
                let bounds = minimiser.bounds();
                let start = bounds.perturb(&atoms.positions, held, options.perturbation, key);
                minimiser.run(
                    start,
                    energy,
                    options.tolerance,
                    rounds,
                    &mut budget,
                    observer,
                )?
            }
        };
        let before = best;
        let first = rounds == 1;
        if minimiser.energy() < best {
            best = minimiser.energy();
            atoms.positions.copy_from_slice(minimiser.positions());
        }
        if options.method != Method::Genetic {
            let x = &atoms.positions;
            send_snapshot(x, held, best, rounds, energy, &mut spare, observer)?;
        }
        if stop == StopReason::Interrupted {
            break stop;
        }
        if !first && before - best <= options.tolerance * before.abs() {
            break StopReason::Converged;
        }
    };
    let rest = OptimizeResult {
        stop,
        rounds,
        iterations: budget.iterations,
        evaluations: budget.evaluations,
        energy_before,
        energy_after: best,
        terms: energy.terms(&atoms.positions, held, best, &mut spare)?,
    };
    Ok((rest, minimiser.max_displacement()))
}

/// Shows an observer who wants to see it a lattice, of which so much is minimised.
fn send_snapshot<const D: usize>(
    x: &[[f64; D]],
    held: &OwnedAndGhosts<'_>,
    minimised: f64,
    round: usize,
    energy: &mut (impl Energy<D> + ?Sized),
    spare: &mut [[f64; D]],
    observer: &mut dyn Progress,
) -> Result<()> {
    if !observer.wants_lattices() {
        return Ok(());
    }
    let terms = energy.terms(x, held, minimised, spare)?;
    let positions: Vec<[f64; 3]> = x.iter().map(|&x| to_3d(x)).collect();
    observer.lattice(&LatticeSnapshot {
        round,
        positions: &positions,
        energy: terms.energy,
        lattice_energy: terms.published.lattice,
        image_energy: terms.published.image,
    });
    Ok(())
}

fn check_options(options: &OptimizeOptions, atoms: usize) -> Result<()> {
    let fail = |place: &str, problem: String, remedy: &str| {
        Err(Error::Optimize(cause(place, problem, remedy)))
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
    if !(temperature.is_empty() || temperature.len() == atoms) {
        let problem = format!("{} values for {atoms} atoms", temperature.len());
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

/// How far each coordinate of each atom may follow its force: mobility in the box, times the square
/// root of temperature (the gradient is scaled by it once, and so is the step).
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

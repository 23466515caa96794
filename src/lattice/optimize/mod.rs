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
//! - [`bounds`]: how far atoms may move, and chance moves
//! - [`lbfgs`]: the descent direction
//! - [`minimise`]: one minimisation: line search, stopping
//! - [`genetic`]: a population of lattices instead, of which the best have descendants
//! - [`temperature`]: which atoms a local edit may move

pub mod bounds;
pub mod genetic;
pub mod lbfgs;
pub mod minimise;
pub mod temperature;

pub use crate::observer::{Observer, Progress, Unobserved};

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, cause};
use crate::lattice::distance::Distance;
use crate::lattice::energy::{Energy, Parts};
use crate::lattice::seeding::Atoms;
use bounds::Bounds;
use minimise::{Budget, Minimiser};

/// Why an optimisation ended. Every one leaves a usable lattice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
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

/// How to optimise.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
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

impl Default for Options {
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

impl Options {
    /// With another method and the effort that suits it: steepest descent takes more evaluations, and a
    /// genetic algorithm many, but of these as many at once as there are threads. Where energies change
    /// from round to round (`regular`, by Laplacian coordinates) there are three.
    pub fn with(self, method: Method, regular: bool) -> Self {
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

/// What an optimisation did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// Why it ended.
    pub stop: Stop,
    /// Rounds begun.
    pub rounds: usize,
    /// Steps accepted.
    pub iterations: usize,
    /// Evaluations of the energy.
    pub evaluations: usize,
    /// P of the lattice as given.
    pub energy_before: f64,
    /// P of the lattice as left.
    pub energy_after: f64,
    /// A and B of the lattice as left.
    pub parts: Parts,
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
    options: &Options,
    observer: &mut dyn Observer,
) -> Result<Outcome> {
    check(options, atoms.len())?;
    let mobility = mobility(atoms, extent, &options.temperature);
    let bounds = Bounds::new(atoms, distance, extent, &mobility);
    let mut minimiser = Minimiser::new(bounds, options.method == Method::Descent);
    let mut budget = Budget {
        evaluations: 0,
        iterations: 0,
        limit: options.max_evaluations,
    };
    energy.refresh(&atoms.positions)?;
    let (energy_before, parts) = minimiser.measure(&atoms.positions, energy, &mut budget)?;
    let mut best = (energy_before, parts);
    let mut rounds = 0;
    let stop = loop {
        if rounds == options.max_rounds || budget.spent() {
            break Stop::MaxIterations;
        }
        if rounds > 0 && energy.refresh(&atoms.positions)? {
            best = minimiser.measure(&atoms.positions, energy, &mut budget)?;
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
                let start = bounds.perturbed(&atoms.positions, options.perturbation, key);
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
        let before = best.0;
        let first = rounds == 1;
        if minimiser.energy() < best.0 {
            best = (minimiser.energy(), minimiser.parts());
            atoms.positions.copy_from_slice(minimiser.positions());
        }
        observer.round(rounds, &three(&atoms.positions));
        if stop == Stop::Interrupted {
            break stop;
        }
        if !first && before - best.0 <= options.tolerance * before.abs() {
            break Stop::Converged;
        }
    };
    Ok(Outcome {
        stop,
        rounds,
        iterations: budget.iterations,
        evaluations: budget.evaluations,
        energy_before,
        energy_after: best.0,
        parts: best.1,
    })
}

fn check(options: &Options, atoms: usize) -> Result<()> {
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

/// Positions in three dimensions, whatever `D`.
pub(crate) fn three<const D: usize>(positions: &[[f64; D]]) -> Vec<[f64; 3]> {
    let three = |x: &[f64; D]| std::array::from_fn(|k| x.get(k).copied().unwrap_or(0.0));
    positions.iter().map(three).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Field;
    use crate::lattice::AtomKind;
    use crate::lattice::energy::{Beta, Pairwise};
    use crate::lattice::seeding::{self, Alignment};

    const D: f64 = 4.0;
    const EXTENT: [f64; 3] = [47.0, 43.0, 51.0];

    /// Signed distance, nearly, to a gently curved surface across the box.
    fn surface(x: [f64; 3]) -> f64 {
        (x[0] + 0.25 * x[1] - 30.0 + 2.0 * (x[2] / 9.0).sin()) / 1.05
    }

    fn valley() -> Field<3> {
        let dims = EXTENT.map(|l| l as usize + 1);
        Field::from_fn(dims, [1.0; 3], |x| {
            let u = surface(x) / (0.25 * D);
            if u.abs() < 4.0 {
                -(-0.5 * u * u).exp()
            } else {
                0.0
            }
        })
    }

    fn evaluator<'a>(distance: &'a Distance<3>, valley: &'a Field<3>) -> Pairwise<'a, 3> {
        let energy = Pairwise::new(EXTENT, distance, Some(valley), Beta::Constant(0.6)).unwrap();
        energy.uncrowded()
    }

    #[derive(Default)]
    struct Recorder {
        energies: Vec<f64>,
        rounds: usize,
        stop_after: Option<usize>,
    }

    impl Observer for Recorder {
        fn progress(&mut self, progress: &Progress) {
            self.energies.push(progress.energy);
            let energy = 0.4 * progress.lattice + 0.6 * progress.image;
            assert!((energy - progress.energy).abs() < 1e-6);
        }
        fn round(&mut self, round: usize, positions: &[[f64; 3]]) {
            self.rounds += 1;
            assert_eq!(self.rounds, round);
            assert!(positions.len() > 100);
        }
        fn keep_going(&mut self) -> bool {
            self.stop_after.is_none_or(|n| self.energies.len() < n)
        }
    }

    #[test]
    fn atoms_settle_on_the_surface_and_the_box_stays_exact() {
        let (distance, valley) = (Distance::Constant(D), valley());
        let mut atoms =
            seeding::regular(EXTENT, &distance, &[[10.0, 20.0, 20.0]], Alignment::On).unwrap();
        let before = atoms.clone();
        let mut energy = evaluator(&distance, &valley);
        let mut recorder = Recorder::default();
        let options = Options::default();
        let outcome = optimize(
            &mut atoms,
            &mut energy,
            &distance,
            EXTENT,
            &options,
            &mut recorder,
        )
        .unwrap();
        println!("{outcome:?}");
        assert!(outcome.energy_after < outcome.energy_before);
        assert!(outcome.evaluations <= options.max_evaluations);
        assert!(
            outcome.iterations * 4 > outcome.evaluations * 3,
            "line search is wasteful"
        );
        assert_eq!(
            (outcome.rounds, outcome.iterations),
            (recorder.rounds, recorder.energies.len())
        );

        // The box: every atom still on its sides, none outside, none freed or fixed.
        assert_eq!(atoms.kinds, before.kinds);
        for ((x, old), kind) in atoms
            .positions
            .iter()
            .zip(&before.positions)
            .zip(&atoms.kinds)
        {
            let mut held = 0;
            for k in 0..3 {
                let on_side = old[k] == 0.0 || old[k] == EXTENT[k];
                assert!(if on_side {
                    x[k] == old[k]
                } else {
                    x[k] > 0.0 && x[k] < EXTENT[k]
                });
                held += usize::from(on_side);
            }
            match kind {
                AtomKind::Corner | AtomKind::Fixed => assert_eq!(x, old),
                AtomKind::Edge => assert_eq!(held, 2),
                AtomKind::Side => assert_eq!(held, 1),
                AtomKind::Interior => assert_eq!(held, 0),
            }
        }

        // Alignment: few atoms between the surface and the layers beside it, none too close.
        let far = |x: &&[f64; 3]| (0..3).all(|k| x[k] > D && x[k] < EXTENT[k] - D);
        let inner: Vec<f64> = atoms
            .positions
            .iter()
            .filter(far)
            .map(|x| surface(*x).abs() / D)
            .collect();
        let within = |low, high| inner.iter().filter(|&&s| s >= low && s < high).count();
        println!("on {}, between {}", within(0.0, 0.15), within(0.15, 0.5));
        assert!(within(0.0, 0.15) > 100);
        assert!(within(0.15, 0.5) * 8 < within(0.0, 0.15));
        let nearest = |n: usize| {
            let others = atoms.positions.iter().enumerate().filter(|&(m, _)| m != n);
            let r2 = |y: &[f64; 3]| (0..3).map(|k| (atoms.positions[n][k] - y[k]).powi(2)).sum();
            others
                .map(|(_, y)| r2(y))
                .fold(f64::INFINITY, f64::min)
                .sqrt()
                / D
        };
        let least = (0..atoms.len()).map(nearest).fold(f64::INFINITY, f64::min);
        println!("nearest neighbours {least:.3} d");
        assert!(least > 0.6, "{least}");
    }

    #[test]
    fn energy_never_rises_within_a_round_and_the_best_is_kept() {
        let (distance, valley) = (Distance::Constant(D), valley());
        let mut atoms = seeding::regular(EXTENT, &distance, &[], Alignment::On).unwrap();
        let mut energy = evaluator(&distance, &valley);
        let mut recorder = Recorder::default();
        let options = Options {
            max_rounds: 1,
            ..Options::default()
        };
        let outcome = optimize(
            &mut atoms,
            &mut energy,
            &distance,
            EXTENT,
            &options,
            &mut recorder,
        )
        .unwrap();
        assert!(recorder.energies.is_sorted_by(|a, b| a >= b));
        assert_eq!(recorder.energies.last(), Some(&outcome.energy_after));
        let mut gradient = vec![[0.0; 3]; atoms.len()];
        let again = evaluator(&distance, &valley).evaluate(&atoms.positions, &mut gradient);
        assert!((again - outcome.energy_after).abs() < 1e-6 * again.abs());
    }

    #[test]
    fn an_interrupt_keeps_what_has_been_gained() {
        let (distance, valley) = (Distance::Constant(D), valley());
        let mut atoms = seeding::regular(EXTENT, &distance, &[], Alignment::On).unwrap();
        let mut energy = evaluator(&distance, &valley);
        let mut recorder = Recorder {
            stop_after: Some(7),
            ..Recorder::default()
        };
        let options = Options::default();
        let outcome = optimize(
            &mut atoms,
            &mut energy,
            &distance,
            EXTENT,
            &options,
            &mut recorder,
        )
        .unwrap();
        assert_eq!((outcome.stop, outcome.iterations), (Stop::Interrupted, 7));
        assert_eq!(outcome.energy_after, recorder.energies[6]);
        let limited = Options {
            max_evaluations: 9,
            ..options
        };
        let outcome = optimize(
            &mut atoms,
            &mut energy,
            &distance,
            EXTENT,
            &limited,
            &mut Unobserved,
        )
        .unwrap();
        assert_eq!(
            (outcome.stop, outcome.evaluations),
            (Stop::MaxIterations, 9)
        );
    }

    #[test]
    fn any_number_of_threads_and_any_run_give_the_same_bytes() {
        let run = |threads: usize, seed: u64| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| {
                let (distance, valley) = (Distance::Constant(D), valley());
                let mut atoms = seeding::regular(EXTENT, &distance, &[], Alignment::On).unwrap();
                let mut energy = evaluator(&distance, &valley);
                let options = Options {
                    seed,
                    max_rounds: 2,
                    ..Options::default()
                };
                let stop = &mut Unobserved;
                optimize(&mut atoms, &mut energy, &distance, EXTENT, &options, stop).unwrap();
                atoms.positions
            })
        };
        let one = run(1, 1);
        assert_eq!(one, run(3, 1));
        assert_ne!(one, run(1, 2));
    }

    #[test]
    fn frozen_atoms_stay() {
        let (distance, valley) = (Distance::Constant(D), valley());
        let mut atoms = seeding::regular(EXTENT, &distance, &[], Alignment::On).unwrap();
        let before = atoms.positions.clone();
        let warm = |x: &[f64; 3]| f64::from(u8::from((x[0] - 25.0).abs() < 8.0));
        let options = Options {
            temperature: before.iter().map(warm).collect(),
            max_rounds: 1,
            ..Options::default()
        };
        let mut energy = evaluator(&distance, &valley);
        optimize(
            &mut atoms,
            &mut energy,
            &distance,
            EXTENT,
            &options,
            &mut Unobserved,
        )
        .unwrap();
        let mut moved = 0;
        for (x, old) in atoms.positions.iter().zip(&before) {
            assert!(warm(old) > 0.0 || x == old);
            moved += usize::from(x != old);
        }
        assert!(moved > 200);
    }

    #[test]
    fn an_edit_changes_its_neighbourhood_only() {
        let distance = Distance::Constant(D);
        let mut atoms = seeding::regular(EXTENT, &distance, &[], Alignment::On).unwrap();
        let centre = EXTENT.map(|l| 0.4 * l);
        let r = |x: &[f64; 3]| {
            (0..3)
                .map(|k| (x[k] - centre[k]).powi(2))
                .sum::<f64>()
                .sqrt()
        };
        // The nearest atom becomes a fixed one at the centre.
        let nearest = (0..atoms.len())
            .min_by(|&a, &b| r(&atoms.positions[a]).total_cmp(&r(&atoms.positions[b])))
            .unwrap();
        atoms.positions[nearest] = centre;
        atoms.kinds[nearest] = AtomKind::Fixed;
        let before = atoms.positions.clone();
        let run = |warmth: f64| {
            let mut atoms = atoms.clone();
            let around = temperature::around(&before, &[(centre, distance.at(centre))]);
            let options = Options {
                temperature: around.iter().map(|t| warmth * t).collect(),
                max_rounds: 1,
                // As given, at the start, and after one step, which is along the force.
                max_evaluations: 3,
                perturbation: 0.0,
                ..Options::default()
            };
            let mut energy = Pairwise::new(EXTENT, &distance, None, Beta::Constant(0.0)).unwrap();
            optimize(
                &mut atoms,
                &mut energy,
                &distance,
                EXTENT,
                &options,
                &mut Unobserved,
            )
            .unwrap();
            let moved = |(x, old): (&[f64; 3], &[f64; 3])| {
                assert!(r(old) < 5.0 * D || x == old);
                (0..3).map(|k| (x[k] - old[k]).powi(2)).sum::<f64>().sqrt()
            };
            atoms.positions.iter().zip(&before).map(moved).sum::<f64>()
        };
        let (warm, cool) = (run(1.0), run(0.05));
        println!("moved {warm:.2} warm, {cool:.2} cool");
        assert!(
            warm > 0.2 * D && cool > 0.0 && cool < 0.2 * warm,
            "{warm} {cool}"
        );
    }

    /// The same energy as a problem for argmin, over flat coordinates, the held ones left out.
    struct Problem<'a> {
        energy: std::cell::RefCell<Pairwise<'a, 3>>,
        start: Vec<[f64; 3]>,
        free: Vec<(usize, usize)>,
    }

    impl Problem<'_> {
        fn evaluate(&self, x: &[f64]) -> (f64, Vec<f64>) {
            let mut positions = self.start.clone();
            for (&(n, k), &value) in self.free.iter().zip(x) {
                positions[n][k] = value;
            }
            let mut gradient = vec![[0.0; 3]; positions.len()];
            let value = self.energy.borrow_mut().evaluate(&positions, &mut gradient);
            (
                value,
                self.free.iter().map(|&(n, k)| gradient[n][k]).collect(),
            )
        }
    }

    impl argmin::core::CostFunction for Problem<'_> {
        type Param = Vec<f64>;
        type Output = f64;
        fn cost(&self, x: &Vec<f64>) -> std::result::Result<f64, argmin::core::Error> {
            Ok(self.evaluate(x).0)
        }
    }

    impl argmin::core::Gradient for Problem<'_> {
        type Param = Vec<f64>;
        type Gradient = Vec<f64>;
        fn gradient(&self, x: &Vec<f64>) -> std::result::Result<Vec<f64>, argmin::core::Error> {
            Ok(self.evaluate(x).1)
        }
    }

    #[test]
    fn argmin_finds_no_lower_energy() {
        use argmin::core::Executor;
        use argmin::solver::linesearch::MoreThuenteLineSearch;
        use argmin::solver::quasinewton::LBFGS;

        let (distance, valley) = (Distance::Constant(D), valley());
        let mut atoms = seeding::regular(EXTENT, &distance, &[], Alignment::On).unwrap();
        let mobility = atoms.mobility(EXTENT);
        let free: Vec<(usize, usize)> = (0..atoms.len())
            .flat_map(|n| (0..3).map(move |k| (n, k)))
            .filter(|&(n, k)| mobility[n][k] > 0.0)
            .collect();
        let start = atoms.positions.clone();
        let problem = Problem {
            energy: std::cell::RefCell::new(evaluator(&distance, &valley)),
            start: start.clone(),
            free: free.clone(),
        };
        let x = free.iter().map(|&(n, k)| start[n][k]).collect();
        let solver = LBFGS::new(MoreThuenteLineSearch::new(), 5);
        let state = Executor::new(problem, solver)
            .configure(|state| state.param(x).max_iters(40))
            .run()
            .unwrap();
        let theirs = state.state().get_best_cost();

        let mut energy = evaluator(&distance, &valley);
        let options = Options {
            perturbation: 0.0,
            max_rounds: 1,
            max_evaluations: 42,
            tolerance: 1e-9,
            ..Options::default()
        };
        let outcome = optimize(
            &mut atoms,
            &mut energy,
            &distance,
            EXTENT,
            &options,
            &mut Unobserved,
        )
        .unwrap();
        println!("ours {} theirs {theirs}", outcome.energy_after);
        let gain = outcome.energy_before - theirs;
        assert!(gain > 0.0);
        assert!(outcome.energy_after - theirs < 0.03 * gain);
    }

    #[test]
    fn impossible_options_are_refused() {
        let (distance, valley) = (Distance::Constant(D), valley());
        let mut atoms = seeding::regular(EXTENT, &distance, &[], Alignment::On).unwrap();
        let good = Options::default();
        for options in [
            Options {
                tolerance: 0.0,
                ..good.clone()
            },
            Options {
                tolerance: f64::NAN,
                ..good.clone()
            },
            Options {
                perturbation: 0.7,
                ..good.clone()
            },
            Options {
                temperature: vec![1.0],
                ..good.clone()
            },
            Options {
                temperature: vec![1.5; atoms.len()],
                ..good
            },
        ] {
            let mut energy = evaluator(&distance, &valley);
            let result = optimize(
                &mut atoms,
                &mut energy,
                &distance,
                EXTENT,
                &options,
                &mut Unobserved,
            );
            assert!(matches!(result, Err(Error::Optimize(_))));
        }
    }
}

//! A genetic algorithm for lattices (Fernandes & Gattass 2009).
//!
//! An individual is the positions of all atoms. In a population of ten, the individual of lowest
//! energy is preserved, and is a parent of the nine others of the next generation:
//!
//! - *crossover*: the child has the positions of one parent up to a random atom, and of the other
//!   parent from there on (single point). Atoms are in the order of a space-filling curve, so that
//!   each part is mostly one region of the box.
//! - *mutation*: each atom of the child moves or not. One that moves goes, with equal probability,
//!   in a random direction or down the gradient of the energy, by at most 0.1 d
//!   ([`OptimiseOptions::perturbation`]).
//!
//! For each child, the fraction of atoms that move and the size of the random moves are themselves
//! random: large changes pay while the lattice is far from its minimum, and small ones later. A
//! move down the gradient is the step of steepest descent times a random number up to 2.
//!
//! Individuals are created and evaluated in parallel. All random numbers depend only on seed,
//! round, generation, individual and atom, so that the result is the same for any number of
//! threads.

use crate::parallel::prelude::*;

use crate::error::Result;
use crate::geometry::random::uniform;
use crate::lattice::energy::{Energy, EnergyParts};
use crate::lattice::halo::OwnedAndGhosts;
use crate::lattice::optimise::bounds::MoveBounds;
use crate::lattice::optimise::minimise::{
    Budget, INITIAL_INVERSE_CURVATURE, Minimiser, check_finite,
};
use crate::lattice::optimise::{Method, OptimiseOptions, StopReason, send_snapshot};
use crate::progress::{CancelToken, OptimiseStatus, Progress};

/// Individuals in a generation (Fernandes & Gattass 2009).
pub const POPULATION_SIZE: usize = 10;
/// An evolution ends when the decrease of the energy over this many generations is small.
const CONVERGENCE_WINDOW: usize = 10;

/// A lattice with its energy and gradient.
#[derive(Clone)]
struct Individual<const D: usize> {
    positions: Vec<[f64; D]>,
    gradient: Vec<[f64; D]>,
    energy: f64,
    parts: EnergyParts,
}

/// Evaluations that the algorithm needs, as a multiple of those of L-BFGS. As many run at once as
/// there are threads.
const EFFORT: usize = 25;

/// Returns the method for [`OptimiseOptions::method`].
pub fn method<const D: usize>() -> Method<D> {
    Method::Other {
        run: evolve,
        effort: EFFORT,
    }
}

/// Lets a population evolve from `start` until the energy of its best individual has fallen by less
/// than the tolerance, relatively, in ten generations, or until the budget is spent. The result is
/// stored in the minimiser.
fn evolve<const D: usize>(
    minimiser: &mut Minimiser<'_, D>,
    start: &[[f64; D]],
    energy: &mut dyn Energy<D>,
    options: &OptimiseOptions<D>,
    round: usize,
    budget: &mut Budget,
    progress: &mut dyn Progress,
) -> Result<StopReason> {
    let halo = OwnedAndGhosts::all(start.len());
    let bounds = minimiser.bounds();
    let scale = bounds.scale(&energy.stiffness(start));
    let mut first = Individual {
        positions: start.to_vec(),
        gradient: vec![[0.0; D]; start.len()],
        energy: 0.0,
        parts: EnergyParts::default(),
    };
    first.energy = check_finite(energy.evaluate(start, &mut first.gradient)?)?;
    first.parts = energy.parts();
    budget.evaluations += 1;
    let mut history = vec![first.energy];
    let mut population = Population::new(first, &*energy);
    let stop = loop {
        if !progress.keep_going() {
            break StopReason::Interrupted;
        }
        if budget.is_spent() {
            break StopReason::MaxIterations;
        }
        let generation = history.len() as u64;
        let round_key = [options.seed, round as u64, generation]
            .into_iter()
            .fold(0, hash_key);
        let reproduction = |n: usize| Reproduction {
            bounds,
            scale: &scale,
            max_move: options.perturbation,
            key: hash_key(round_key, n as u64),
        };
        let evolve = |cancel: &CancelToken<'_>| population.reproduce(reproduction, cancel);
        if CancelToken::run(&mut || progress.keep_going(), evolve)? {
            break StopReason::Interrupted;
        }
        budget.evaluations += population.children.len();
        let is_better = population.select()?;
        let Individual {
            energy: min_energy,
            parts,
            ..
        } = population.parents[0];
        if is_better {
            budget.iterations += 1;
            progress.optimise_step(&OptimiseStatus {
                round,
                iterations: budget.iterations,
                evaluations: budget.evaluations,
                max_evaluations: budget.max_evaluations,
                energy: min_energy,
                lattice_energy: parts.lattice,
                image_energy: parts.image,
            });
        }
        history.push(min_energy);
        let scratch = &mut population.children[0].gradient;
        send_snapshot(
            &population.parents[0].positions,
            &halo,
            min_energy,
            generation as usize,
            &mut *population.evaluators[0],
            scratch,
            progress,
        )?;
        if let Some(n) = history.len().checked_sub(CONVERGENCE_WINDOW + 1)
            && history[n] - min_energy <= options.tolerance * min_energy.abs()
        {
            break StopReason::Converged;
        }
    };
    let best = population.parents.swap_remove(0);
    minimiser.set_result(best.positions, best.energy, best.parts);
    Ok(stop)
}

/// A generation.
struct Population<'a, const D: usize> {
    /// The best individual, and the other parent of each child.
    parents: Vec<Individual<D>>,
    children: Vec<Individual<D>>,
    /// The energy, once for each child.
    evaluators: Vec<Box<dyn Energy<D> + Send + 'a>>,
}

impl<'a, const D: usize> Population<'a, D> {
    /// Creates a population of individuals that are alike.
    fn new(first: Individual<D>, energy: &'a dyn Energy<D>) -> Self {
        let parents = vec![first; POPULATION_SIZE];
        Self {
            children: parents[1..].to_vec(),
            evaluators: (1..POPULATION_SIZE).map(|_| energy.duplicate()).collect(),
            parents,
        }
    }

    /// Creates and evaluates the children; `reproduction` returns the rules for a child. Returns
    /// `true` if `cancel` is cancelled.
    fn reproduce<'r>(
        &mut self,
        reproduction: impl Fn(usize) -> Reproduction<'r, D> + Sync,
        cancel: &CancelToken<'_>,
    ) -> Result<bool> {
        let parents = &self.parents;
        let children = self.children.par_iter_mut();
        let tasks = children.zip(&mut self.evaluators).enumerate();
        tasks.try_for_each(|(n, (child, evaluator))| {
            if cancel.is_cancelled() {
                return Ok(());
            }
            let reproduction = reproduction(n);
            reproduction.cross_over(&parents[0], &parents[n + 1], child);
            reproduction.mutate(child);
            child.energy = evaluator.evaluate(&child.positions, &mut child.gradient)?;
            child.parts = evaluator.parts();
            Ok(())
        })?;
        Ok(cancel.is_cancelled())
    }

    /// Makes the children parents, and the best individual the first of them. Returns `true` if
    /// this is a child.
    fn select(&mut self) -> Result<bool> {
        for child in &self.children {
            check_finite(child.energy)?;
        }
        for (parent, child) in self.parents[1..].iter_mut().zip(&mut self.children) {
            std::mem::swap(parent, child);
        }
        // The first of the lowest: a child as good as its parent does not take its place.
        let best = (1..POPULATION_SIZE).fold(0, |best, n| {
            if self.parents[n].energy < self.parents[best].energy {
                n
            } else {
                best
            }
        });
        self.parents.swap(0, best);
        Ok(best != 0)
    }
}

/// Adds a number to the key of a sequence of random numbers.
fn hash_key(key: u64, part: u64) -> u64 {
    (key ^ part).wrapping_mul(0x9E37_79B9_7F4A_7C15)
}

/// The rules by which a child is created.
struct Reproduction<'a, const D: usize> {
    bounds: &'a MoveBounds<D>,
    scale: &'a [[f32; D]],
    /// Largest move, in units of d.
    max_move: f64,
    key: u64,
}

impl<const D: usize> Reproduction<'_, D> {
    /// Returns a random number in [0, 1) for this child.
    fn uniform(&self, counter: u64) -> f64 {
        uniform(self.key, counter)
    }

    /// Gives the child the positions (and the gradients there) of one parent up to some atom, and
    /// of the other parent from there on.
    fn cross_over(&self, a: &Individual<D>, b: &Individual<D>, child: &mut Individual<D>) {
        let [first, second] = if self.uniform(0) < 0.5 {
            [a, b]
        } else {
            [b, a]
        };
        let count = a.positions.len();
        let cut = (self.uniform(1) * (count + 1) as f64) as usize;
        let combine = |field: fn(&Individual<D>) -> &Vec<[f64; D]>, target: &mut [[f64; D]]| {
            target[..cut].copy_from_slice(&field(first)[..cut]);
            target[cut..].copy_from_slice(&field(second)[cut..]);
        };
        combine(|parent| &parent.positions, &mut child.positions);
        combine(|parent| &parent.gradient, &mut child.gradient);
    }

    /// Moves some of the child's atoms, randomly or down the gradient.
    fn mutate(&self, child: &mut Individual<D>) {
        let (rate, size) = (self.uniform(2), self.max_move * self.uniform(3));
        // Random numbers of the choices, independent of those of the moves.
        let mutation_key = self.key ^ 0x5851_F42D_4C95_7F2D;
        for (n, (x, gradient)) in child.positions.iter_mut().zip(&child.gradient).enumerate() {
            // One number decides whether an atom moves and which way, another how far.
            let draw = uniform(mutation_key, 2 * n as u64);
            if draw >= rate {
                continue;
            }
            if draw < 0.5 * rate {
                *x = self.bounds.perturb_atom(n, n, x, size, self.key);
                continue;
            }
            let length = INITIAL_INVERSE_CURVATURE * 2.0 * uniform(mutation_key, 2 * n as u64 + 1);
            let scale = self.scale[n].map(f64::from);
            let mut step: [f64; D] =
                std::array::from_fn(|k| -length * scale[k] * scale[k] * gradient[k]);
            // Limit the step, in units of d.
            let move_scale = self.bounds.move_scale()[n].map(f64::from);
            let length2: f64 = (0..D)
                .filter(|&k| move_scale[k] > 0.0)
                .map(|k| (step[k] / move_scale[k]).powi(2))
                .sum();
            if length2 > self.max_move * self.max_move {
                let shrink = self.max_move / length2.sqrt();
                step = step.map(|s| s * shrink);
            }
            *x = self.bounds.apply_step(n, x, step);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{ScalarField, SparseField};
    use crate::lattice::distance::Distance;
    use crate::lattice::energy::{Beta, PairwiseEnergy};
    use crate::lattice::optimise::{NoProgress, OptimiseResult, optimise};
    use crate::lattice::seeding::{Alignment, Atoms};
    use crate::published::RegularisedEnergy;
    use crate::published::guide::{GuideOptions, tests::seed_guided};

    const D: f64 = 5.0;
    const EXTENT: [f64; 2] = [90.0, 70.0];
    const DISTANCE: Distance<2> = Distance::Constant(D);

    fn valley() -> SparseField<2> {
        let depth = |x: [f64; 2]| {
            let u = (x[0] + 0.3 * x[1] - 50.0) / (0.25 * D);
            if u.abs() < 4.0 {
                -(-0.5 * u * u).exp()
            } else {
                0.0
            }
        };
        SparseField::from_field(&ScalarField::from_fn([91, 71], [1.0; 2], depth))
    }

    fn random_lattice(valley: &SparseField<2>) -> Atoms<2> {
        let options = GuideOptions {
            alignment: Alignment::OnFeatures,
            seed: 1,
            max_atoms: usize::MAX,
        };
        seed_guided(EXTENT, &DISTANCE, &valley.to_dense(), options).unwrap()
    }

    fn evaluator(valley: &SparseField<2>) -> PairwiseEnergy<'_, 2> {
        PairwiseEnergy::new(EXTENT, &DISTANCE, Some(valley), Beta::Constant(0.5)).unwrap()
    }

    fn run(
        method: Method<2>,
        evaluations: usize,
        progress: &mut dyn Progress,
    ) -> (Atoms<2>, OptimiseResult) {
        let valley = valley();
        let mut atoms = random_lattice(&valley);
        let options = OptimiseOptions {
            method,
            max_rounds: 1,
            max_evaluations: evaluations,
            tolerance: 1e-5,
            ..OptimiseOptions::default()
        };
        let energy = &mut evaluator(&valley);
        let outcome = optimise(&mut atoms, energy, &DISTANCE, EXTENT, &options, progress).unwrap();
        // The reported energy is the energy of the lattice.
        let mut gradient = vec![[0.0; 2]; atoms.len()];
        let recomputed = evaluator(&valley)
            .evaluate(&atoms.positions, &mut gradient)
            .unwrap();
        assert!((recomputed - outcome.energy_after).abs() < 1e-6 * recomputed.abs());
        (atoms, outcome)
    }

    #[test]
    fn the_energy_falls_and_the_box_stays_exact() {
        #[derive(Default)]
        struct Energies(Vec<f64>);
        impl Progress for Energies {
            fn optimise_step(&mut self, status: &OptimiseStatus) {
                self.0.push(status.energy);
            }
        }
        let mut energies = Energies::default();
        let (atoms, outcome) = run(method(), 900, &mut energies);
        println!("{outcome:?}");
        assert!(energies.0.len() > 20 && energies.0.is_sorted_by(|a, b| a > b));
        assert_eq!(energies.0.last(), Some(&outcome.energy_after));
        assert_eq!(outcome.iterations, energies.0.len());
        assert!(outcome.evaluations < 900 + POPULATION_SIZE);
        let initial = random_lattice(&valley());
        let mobility = initial.mobility(EXTENT);
        for (n, (x, old)) in atoms.positions.iter().zip(&initial.positions).enumerate() {
            for k in 0..2 {
                assert!(if mobility[n][k] == 0.0 {
                    x[k] == old[k]
                } else {
                    x[k] > 0.0 && x[k] < EXTENT[k]
                });
            }
        }
    }

    #[test]
    fn gradient_methods_find_lower_energies_with_fewer_evaluations() {
        let gain = |method, evaluations| {
            let (_, outcome) = run(method, evaluations, &mut NoProgress);
            outcome.energy_before - outcome.energy_after
        };
        let [lbfgs, descent, genetic] = [
            gain(Method::Lbfgs, 60),
            gain(Method::Descent, 200),
            gain(method(), 1000),
        ];
        println!("gained: L-BFGS {lbfgs:.2}, descent {descent:.2}, genetic {genetic:.2}");
        assert!(genetic > 0.2 * lbfgs && descent > 0.5 * lbfgs);
        assert!(lbfgs > genetic && gain(Method::Lbfgs, 60) >= gain(Method::Descent, 60));
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bytes() {
        let run_with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new();
            let pool = pool.num_threads(threads).build().unwrap();
            pool.install(|| run(method(), 100, &mut NoProgress).0)
        };
        assert_eq!(run_with(1), run_with(3));
    }

    #[test]
    fn an_interrupt_keeps_the_best_so_far() {
        /// Stops after a given count of evaluations.
        struct Stopper(usize);
        impl Progress for Stopper {
            fn optimise_step(&mut self, status: &OptimiseStatus) {
                self.0 = status.evaluations;
            }
            fn keep_going(&mut self) -> bool {
                self.0 < 2 + 5 * (POPULATION_SIZE - 1)
            }
        }
        let mut stopper = Stopper(0);
        let (_, outcome) = run(method(), 1000, &mut stopper);
        assert_eq!(outcome.stop, StopReason::Interrupted);
        // The start is evaluated twice (as given, and as the first individual), then whole
        // generations follow.
        assert_eq!(outcome.evaluations, stopper.0);
        assert_eq!((outcome.evaluations - 2) % (POPULATION_SIZE - 1), 0);
        assert!(outcome.energy_after < outcome.energy_before);
    }

    #[test]
    fn laplacian_coordinates_make_lattices_more_regular() {
        let valley = valley();
        let length = |kappa: f64, method| {
            let mut atoms = random_lattice(&valley);
            let energy = |kappa| {
                let mobility = random_lattice(&valley).mobility(EXTENT);
                let beta = Beta::Constant(0.5);
                RegularisedEnergy::new(evaluator(&valley), &DISTANCE, beta, kappa, mobility)
                    .unwrap()
            };
            let options = OptimiseOptions {
                max_rounds: 3,
                ..OptimiseOptions::default().with_method(method, true)
            };
            let regularised = &mut energy(kappa);
            optimise(
                &mut atoms,
                regularised,
                &DISTANCE,
                EXTENT,
                &options,
                &mut NoProgress,
            )
            .unwrap();
            let mut laplacian_only = energy(0.0);
            laplacian_only.refresh(&atoms.positions).unwrap();
            let mut gradient = vec![[0.0; 2]; atoms.len()];
            laplacian_only
                .evaluate(&atoms.positions, &mut gradient)
                .unwrap();
            laplacian_only.parts().lattice / atoms.len() as f64
        };
        for method in [Method::Lbfgs, method()] {
            let (regularised, plain) = (length(0.7, method), length(1.0, method));
            println!("{method:?}: mean |L| / d {regularised:.4} with, {plain:.4} without");
            assert!(regularised < plain);
        }
    }

    #[test]
    fn children_have_the_atoms_of_their_parents_and_few_move_far() {
        let valley = valley();
        let atoms = random_lattice(&valley);
        let mobility = atoms.mobility(EXTENT);
        let bounds = MoveBounds::new(&atoms, &DISTANCE, EXTENT, &mobility);
        let scale = bounds.scale(&vec![1.0; atoms.len()]);
        let individual = |offset: f64| Individual {
            positions: atoms
                .positions
                .iter()
                .map(|x| x.map(|c| c + offset))
                .collect(),
            gradient: vec![[offset; 2]; atoms.len()],
            energy: 0.0,
            parts: EnergyParts::default(),
        };
        let [a, b] = [individual(0.0), individual(1.0)];
        let (mut cuts, mut by_chance, mut down) = (Vec::new(), 0, 0);
        for key in 0..200 {
            let reproduction = Reproduction {
                bounds: &bounds,
                scale: &scale,
                max_move: 0.1,
                key: key * 977,
            };
            let mut child = a.clone();
            reproduction.cross_over(&a, &b, &mut child);
            let is_from_b: Vec<bool> = child.gradient.iter().map(|g| g[0] == 1.0).collect();
            assert!(is_from_b.windows(2).filter(|w| w[0] != w[1]).count() <= 1);
            for n in 0..atoms.len() {
                assert_eq!(
                    child.positions[n],
                    if is_from_b[n] {
                        b.positions[n]
                    } else {
                        a.positions[n]
                    }
                );
            }
            cuts.push(is_from_b.iter().filter(|is_from_b| **is_from_b).count());

            // The gradient is so long that every move down it is 0.1 d along the diagonal.
            let mut child = a.clone();
            child.gradient.fill([1e3; 2]);
            reproduction.mutate(&mut child);
            for n in (0..atoms.len()).filter(|&n| mobility[n] == [1.0; 2]) {
                let step: [f64; 2] =
                    std::array::from_fn(|k| child.positions[n][k] - a.positions[n][k]);
                assert!(step[0].hypot(step[1]) < 0.1 * D + 1e-9);
                let is_down = step
                    .iter()
                    .all(|s| (s + 0.1 * D * 0.5f64.sqrt()).abs() < 1e-6);
                down += usize::from(is_down);
                by_chance += usize::from(!is_down && step != [0.0; 2]);
            }
        }
        // Cuts are everywhere, and both mutations are equally likely.
        cuts.sort_unstable();
        let share = |n: usize| cuts[n] as f64 / atoms.len() as f64;
        assert!(share(20) < 0.25 && share(180) > 0.75 && (share(100) - 0.5).abs() < 0.15);
        let chance_share = f64::from(by_chance as u32) / f64::from((by_chance + down) as u32);
        println!("{by_chance} moves by chance, {down} down the gradient");
        assert!((chance_share - 0.5).abs() < 0.02, "{chance_share}");
    }
}

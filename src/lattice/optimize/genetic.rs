//! A genetic algorithm for lattices (Fernandes & Gattass 2009).
//!
//! An individual is the positions of all atoms. Of a population of ten the one of least energy is kept
//! as it is, and is a parent of the nine others of the next generation:
//!
//! - *crossover*: the child has the positions of one parent up to an atom chosen by chance, and of the
//!   other from there on (single point). Atoms come in the order of a space-filling curve, so that each
//!   part is mostly one region of the box.
//! - *mutation*: each atom of the child moves or not. One that moves goes, as likely, in a direction by
//!   chance or down the gradient of the energy; not farther than 0.1 d
//!   ([`OptimizeOptions::perturbation`]).
//!
//! How many atoms of a child move (up to all) and how far those by chance (up to all the way) is by
//! chance itself, for each child: where the lattice is far from rest large changes pay, and later small
//! ones. Down the gradient, a move is what steepest descent would take, times a number by chance up
//! to 2.
//!
//! Individuals are made and evaluated in parallel. All chance depends on nothing but seed, generation,
//! individual and atom, so that the result is the same for any number of threads.

use crate::parallel::prelude::*;

use super::bounds::MoveBounds;
use super::minimise::{Budget, INITIAL_INVERSE_CURVATURE, Minimiser, check_finite};
use super::{OptimizeOptions, StopReason, send_snapshot};
use crate::error::Result;
use crate::geometry::random::uniform;
use crate::lattice::energy::{Energy, EnergyParts};
use crate::lattice::halo::OwnedAndGhosts;
use crate::progress::{CancelToken, OptimizeStatus, Progress};

/// Individuals in a generation (Fernandes & Gattass 2009).
pub const POPULATION_SIZE: usize = 10;
/// The decrease that ends an evolution is that over this many generations.
const CONVERGENCE_WINDOW: usize = 10;

/// A lattice, and what is known of it.
#[derive(Clone)]
struct Individual<const D: usize> {
    positions: Vec<[f64; D]>,
    gradient: Vec<[f64; D]>,
    energy: f64,
    parts: EnergyParts,
}

/// Lets a population evolve from `start` until the energy of its best has fallen by less than the
/// tolerance, relatively, in ten generations, or the budget is spent. What is found is the
/// minimiser's.
pub fn evolve<const D: usize>(
    minimiser: &mut Minimiser<'_, D>,
    start: &[[f64; D]],
    energy: &mut dyn Energy<D>,
    options: &OptimizeOptions,
    round: usize,
    budget: &mut Budget,
    observer: &mut dyn Progress,
) -> Result<StopReason> {
    let held = OwnedAndGhosts::all(start.len());
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
    let mut twins: Vec<_> = (1..POPULATION_SIZE).map(|_| energy.duplicate()).collect();
    let mut history = vec![first.energy];
    // All alike at first: the best, and those that will be its children's other parents.
    let mut parents = vec![first; POPULATION_SIZE];
    let mut children = parents[1..].to_vec();
    let stop = loop {
        if !observer.keep_going() {
            break StopReason::Interrupted;
        }
        if budget.is_spent() {
            break StopReason::MaxIterations;
        }
        let generation = history.len() as u64;
        let others = children.par_iter_mut().zip(&mut twins).enumerate();
        let evolve = |patience: &CancelToken<'_>| -> Result<bool> {
            others.try_for_each(|(n, (child, twin))| {
                if patience.is_cancelled() {
                    return Ok(());
                }
                let key = [options.seed, round as u64, generation, n as u64]
                    .into_iter()
                    .fold(0, |key: u64, part| {
                        (key ^ part).wrapping_mul(0x9E37_79B9_7F4A_7C15)
                    });
                let birth = Reproduction {
                    bounds,
                    scale: &scale,
                    max_move: options.perturbation,
                    key,
                };
                birth.cross_over(&parents[0], &parents[n + 1], child);
                birth.mutate(child);
                child.energy = twin.evaluate(&child.positions, &mut child.gradient)?;
                child.parts = twin.parts();
                Ok(())
            })?;
            Ok(patience.is_cancelled())
        };
        if CancelToken::run(&mut || observer.keep_going(), evolve)? {
            break StopReason::Interrupted;
        }
        budget.evaluations += children.len();
        for child in &children {
            check_finite(child.energy)?;
        }
        for (parent, child) in parents[1..].iter_mut().zip(&mut children) {
            std::mem::swap(parent, child);
        }
        // The first of the least: a child as good as its parent does not take its place.
        let best = (1..POPULATION_SIZE).fold(0, |best, n| {
            if parents[n].energy < parents[best].energy {
                n
            } else {
                best
            }
        });
        parents.swap(0, best);
        let Individual {
            energy: least,
            parts,
            ..
        } = parents[0];
        if best != 0 {
            budget.iterations += 1;
            observer.optimize_step(&OptimizeStatus {
                round,
                iterations: budget.iterations,
                evaluations: budget.evaluations,
                energy: least,
                lattice_energy: parts.lattice,
                image_energy: parts.image,
            });
        }
        history.push(least);
        let spare = &mut children[0].gradient;
        send_snapshot(
            &parents[0].positions,
            &held,
            least,
            generation as usize,
            &mut *twins[0],
            spare,
            observer,
        )?;
        if let Some(n) = history.len().checked_sub(CONVERGENCE_WINDOW + 1)
            && history[n] - least <= options.tolerance * least.abs()
        {
            break StopReason::Converged;
        }
    };
    drop(twins);
    let best = parents.swap_remove(0);
    minimiser.set_result(best.positions, best.energy, best.parts);
    Ok(stop)
}

/// How a child comes to be.
struct Reproduction<'a, const D: usize> {
    bounds: &'a MoveBounds<D>,
    scale: &'a [[f32; D]],
    /// Farthest move, in units of d.
    max_move: f64,
    key: u64,
}

impl<const D: usize> Reproduction<'_, D> {
    /// A number in [0, 1) for this child.
    fn uniform(&self, counter: u64) -> f64 {
        uniform(self.key, counter)
    }

    /// The child has the positions (and the gradient there) of one parent up to some atom and of the
    /// other from it on.
    fn cross_over(&self, a: &Individual<D>, b: &Individual<D>, child: &mut Individual<D>) {
        let [first, second] = if self.uniform(0) < 0.5 {
            [a, b]
        } else {
            [b, a]
        };
        let count = a.positions.len();
        let cut = (self.uniform(1) * (count + 1) as f64) as usize;
        let both = |from: fn(&Individual<D>) -> &Vec<[f64; D]>, to: &mut [[f64; D]]| {
            to[..cut].copy_from_slice(&from(first)[..cut]);
            to[cut..].copy_from_slice(&from(second)[cut..]);
        };
        both(|parent| &parent.positions, &mut child.positions);
        both(|parent| &parent.gradient, &mut child.gradient);
    }

    /// Moves some of the child's atoms, by chance or down the gradient.
    fn mutate(&self, child: &mut Individual<D>) {
        let (rate, size) = (self.uniform(2), self.max_move * self.uniform(3));
        // Numbers of the atoms, apart from those of their jumps.
        let own = self.key ^ 0x5851_F42D_4C95_7F2D;
        for (n, (x, gradient)) in child.positions.iter_mut().zip(&child.gradient).enumerate() {
            // One number says whether an atom moves and which way, another how far.
            let draw = uniform(own, 2 * n as u64);
            if draw >= rate {
                continue;
            }
            if draw < 0.5 * rate {
                *x = self.bounds.perturb_atom(n, n, x, size, self.key);
                continue;
            }
            let length = INITIAL_INVERSE_CURVATURE * 2.0 * uniform(own, 2 * n as u64 + 1);
            let scale = self.scale[n].map(f64::from);
            let mut step: [f64; D] =
                std::array::from_fn(|k| -length * scale[k] * scale[k] * gradient[k]);
            // No farther than allowed, in units of d.
            let reach = self.bounds.move_scale()[n].map(f64::from);
            let far2: f64 = (0..D)
                .filter(|&k| reach[k] > 0.0)
                .map(|k| (step[k] / reach[k]).powi(2))
                .sum();
            if far2 > self.max_move * self.max_move {
                let shrink = self.max_move / far2.sqrt();
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
    use crate::lattice::energy::{Beta, PairwiseEnergy, RegularisedEnergy};
    use crate::lattice::optimize::{Method, NoProgress, OptimizeResult, optimize};
    use crate::lattice::seeding::{Alignment, Atoms, Seeding, seed};

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
        let how = Seeding::Guide {
            seed: 1,
            max_atoms: usize::MAX,
        };
        seed(
            how,
            EXTENT,
            &DISTANCE,
            &[],
            Alignment::OnFeatures,
            Some(valley),
            &CancelToken::never(),
        )
        .unwrap()
    }

    fn evaluator(valley: &SparseField<2>) -> PairwiseEnergy<'_, 2> {
        PairwiseEnergy::new(EXTENT, &DISTANCE, Some(valley), Beta::Constant(0.5)).unwrap()
    }

    fn run(
        method: Method,
        evaluations: usize,
        observer: &mut dyn Progress,
    ) -> (Atoms<2>, OptimizeResult) {
        let valley = valley();
        let mut atoms = random_lattice(&valley);
        let options = OptimizeOptions {
            method,
            max_rounds: 1,
            max_evaluations: evaluations,
            tolerance: 1e-5,
            ..OptimizeOptions::default()
        };
        let energy = &mut evaluator(&valley);
        let outcome = optimize(&mut atoms, energy, &DISTANCE, EXTENT, &options, observer).unwrap();
        // What is said of the lattice is true of it.
        let mut gradient = vec![[0.0; 2]; atoms.len()];
        let again = evaluator(&valley)
            .evaluate(&atoms.positions, &mut gradient)
            .unwrap();
        assert!((again - outcome.energy_after).abs() < 1e-6 * again.abs());
        (atoms, outcome)
    }

    #[test]
    fn the_energy_falls_and_the_box_stays_exact() {
        #[derive(Default)]
        struct Energies(Vec<f64>);
        impl Progress for Energies {
            fn optimize_step(&mut self, progress: &OptimizeStatus) {
                self.0.push(progress.energy);
            }
        }
        let mut energies = Energies::default();
        let (atoms, outcome) = run(Method::Genetic, 900, &mut energies);
        println!("{outcome:?}");
        assert!(energies.0.len() > 20 && energies.0.is_sorted_by(|a, b| a > b));
        assert_eq!(energies.0.last(), Some(&outcome.energy_after));
        assert_eq!(outcome.iterations, energies.0.len());
        assert!(outcome.evaluations < 900 + POPULATION_SIZE);
        let before = random_lattice(&valley());
        let free = before.mobility(EXTENT);
        for (n, (x, old)) in atoms.positions.iter().zip(&before.positions).enumerate() {
            for k in 0..2 {
                assert!(if free[n][k] == 0.0 {
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
            gain(Method::Genetic, 1000),
        ];
        println!("gained: L-BFGS {lbfgs:.2}, descent {descent:.2}, genetic {genetic:.2}");
        assert!(genetic > 0.2 * lbfgs && descent > 0.5 * lbfgs);
        assert!(lbfgs > genetic && gain(Method::Lbfgs, 60) >= gain(Method::Descent, 60));
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bytes() {
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new();
            let pool = pool.num_threads(threads).build().unwrap();
            pool.install(|| run(Method::Genetic, 100, &mut NoProgress).0)
        };
        assert_eq!(with(1), with(3));
    }

    #[test]
    fn an_interrupt_keeps_the_best_so_far() {
        /// Says no once there were so many evaluations; remembers how many.
        struct Stopper(usize);
        impl Progress for Stopper {
            fn optimize_step(&mut self, progress: &OptimizeStatus) {
                self.0 = progress.evaluations;
            }
            fn keep_going(&mut self) -> bool {
                self.0 < 2 + 5 * (POPULATION_SIZE - 1)
            }
        }
        let mut stopper = Stopper(0);
        let (_, outcome) = run(Method::Genetic, 1000, &mut stopper);
        assert_eq!(outcome.stop, StopReason::Interrupted);
        // At the start twice (as given, and as the first of its kind), then whole generations.
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
                let free = random_lattice(&valley).mobility(EXTENT);
                let beta = Beta::Constant(0.5);
                RegularisedEnergy::new(evaluator(&valley), &DISTANCE, beta, kappa, free).unwrap()
            };
            let options = OptimizeOptions {
                max_rounds: 3,
                ..OptimizeOptions::default().with_method(method, true)
            };
            let used = &mut energy(kappa);
            optimize(
                &mut atoms,
                used,
                &DISTANCE,
                EXTENT,
                &options,
                &mut NoProgress,
            )
            .unwrap();
            let mut all = energy(0.0);
            all.refresh(&atoms.positions).unwrap();
            let mut gradient = vec![[0.0; 2]; atoms.len()];
            all.evaluate(&atoms.positions, &mut gradient).unwrap();
            all.parts().lattice / atoms.len() as f64
        };
        for method in [Method::Lbfgs, Method::Genetic] {
            let (with, without) = (length(0.7, method), length(1.0, method));
            println!("{method:?}: mean |L| / d {with:.4} with, {without:.4} without");
            assert!(with < without);
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
            let birth = Reproduction {
                bounds: &bounds,
                scale: &scale,
                max_move: 0.1,
                key: key * 977,
            };
            let mut child = a.clone();
            birth.cross_over(&a, &b, &mut child);
            let of_b: Vec<bool> = child.gradient.iter().map(|g| g[0] == 1.0).collect();
            assert!(of_b.windows(2).filter(|w| w[0] != w[1]).count() <= 1);
            for n in 0..atoms.len() {
                assert_eq!(
                    child.positions[n],
                    if of_b[n] {
                        b.positions[n]
                    } else {
                        a.positions[n]
                    }
                );
            }
            cuts.push(of_b.iter().filter(|of_b| **of_b).count());

            // A gradient so long that every move down it is 0.1 d along the diagonal.
            let mut child = a.clone();
            child.gradient.fill([1e3; 2]);
            birth.mutate(&mut child);
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
        // Cuts everywhere; both mutations as likely as each other.
        cuts.sort_unstable();
        let share = |n: usize| cuts[n] as f64 / atoms.len() as f64;
        assert!(share(20) < 0.25 && share(180) > 0.75 && (share(100) - 0.5).abs() < 0.15);
        let even = f64::from(by_chance as u32) / f64::from((by_chance + down) as u32);
        println!("{by_chance} moves by chance, {down} down the gradient");
        assert!((even - 0.5).abs() < 0.02, "{even}");
    }
}

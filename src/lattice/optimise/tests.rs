//! Tests of the optimisation: the gain in energy, and what must not change.

use super::*;
use crate::image::{ScalarField, SparseField};
use crate::lattice::AtomKind;
use crate::lattice::energy::{Beta, PairwiseEnergy};
use crate::lattice::owned_atoms::OwnedAtoms;
use crate::lattice::seeding::{self, Alignment};

const D: f64 = 4.0;
const EXTENT: [f64; 3] = [47.0, 43.0, 51.0];

/// The approximate signed distance to a gently curved surface across the box.
fn surface(x: [f64; 3]) -> f64 {
    (x[0] + 0.25 * x[1] - 30.0 + 2.0 * (x[2] / 9.0).sin()) / 1.05
}

fn valley() -> SparseField<3> {
    let dims = EXTENT.map(|l| l as usize + 1);
    let depth = |x| {
        let u = surface(x) / (0.25 * D);
        if u.abs() < 4.0 {
            -(-0.5 * u * u).exp()
        } else {
            0.0
        }
    };
    SparseField::from_field(&ScalarField::from_fn(dims, [1.0; 3], depth))
}

fn evaluator<'a>(distance: &'a Distance<3>, valley: &'a SparseField<3>) -> PairwiseEnergy<'a, 3> {
    let energy = PairwiseEnergy::new(EXTENT, distance, Some(valley), Beta::Constant(0.6)).unwrap();
    energy.with_auto_stiffness()
}

fn optimise_box(
    atoms: &mut Atoms<3>,
    energy: &mut dyn Energy<3>,
    options: &OptimiseOptions<3>,
    progress: &mut dyn Progress,
) -> Result<OptimiseResult> {
    let distance = Distance::Constant(D);
    optimise(atoms, energy, &distance, EXTENT, options, progress)
}

#[derive(Default)]
struct Recorder {
    energies: Vec<f64>,
    snapshots: usize,
    stop_after: Option<usize>,
}

impl Progress for Recorder {
    fn optimise_step(&mut self, status: &OptimiseStatus) {
        self.energies.push(status.energy);
        let energy = 0.4 * status.lattice_energy + 0.6 * status.image_energy;
        assert!((energy - status.energy).abs() < 1e-6);
    }
    fn lattice(&mut self, snapshot: &LatticeSnapshot<'_>) {
        assert_eq!(self.snapshots, snapshot.round);
        self.snapshots += 1;
        assert!(snapshot.positions.len() > 100);
        let energy = 0.4 * snapshot.lattice_energy + 0.6 * snapshot.image_energy;
        assert!((energy - snapshot.energy).abs() < 1e-6);
    }
    fn wants_lattices(&self) -> bool {
        true
    }
    fn keep_going(&mut self) -> bool {
        self.stop_after.is_none_or(|n| self.energies.len() < n)
    }
}

#[test]
fn atoms_settle_on_the_surface_and_the_box_stays_exact() {
    let (distance, valley) = (Distance::Constant(D), valley());
    let mut atoms = seeding::fcc(
        EXTENT,
        &distance,
        &[[10.0, 20.0, 20.0]],
        Alignment::OnFeatures,
    )
    .unwrap();
    let initial = atoms.clone();
    let mut energy = evaluator(&distance, &valley);
    let mut recorder = Recorder::default();
    let options = OptimiseOptions::default();
    let outcome = optimise_box(&mut atoms, &mut energy, &options, &mut recorder).unwrap();
    println!("{outcome:?}");
    assert!(outcome.energy_after < outcome.energy_before);
    assert!(outcome.evaluations <= options.max_evaluations);
    assert!(
        outcome.iterations * 4 > outcome.evaluations * 3,
        "line search is wasteful"
    );
    assert_eq!(
        (outcome.rounds, outcome.iterations),
        (recorder.snapshots - 1, recorder.energies.len())
    );

    // The box: every atom is still on its sides, none is outside, none freed or fixed.
    assert_eq!(atoms.kinds, initial.kinds);
    for ((x, old), kind) in atoms
        .positions
        .iter()
        .zip(&initial.positions)
        .zip(&atoms.kinds)
    {
        let mut side_count = 0;
        for k in 0..3 {
            let on_side = old[k] == 0.0 || old[k] == EXTENT[k];
            assert!(if on_side {
                x[k] == old[k]
            } else {
                x[k] > 0.0 && x[k] < EXTENT[k]
            });
            side_count += usize::from(on_side);
        }
        match kind {
            AtomKind::Corner | AtomKind::Fixed => assert_eq!(x, old),
            AtomKind::Edge => assert_eq!(side_count, 2),
            AtomKind::Side => assert_eq!(side_count, 1),
            AtomKind::Interior => assert_eq!(side_count, 0),
        }
    }

    // Alignment: few atoms lie between the surface and the layers beside it, and none are too
    // close.
    let is_inner = |x: &&[f64; 3]| (0..3).all(|k| x[k] > D && x[k] < EXTENT[k] - D);
    let inner: Vec<f64> = atoms
        .positions
        .iter()
        .filter(is_inner)
        .map(|x| surface(*x).abs() / D)
        .collect();
    let count_between = |low, high| inner.iter().filter(|&&s| s >= low && s < high).count();
    println!(
        "on {}, between {}",
        count_between(0.0, 0.15),
        count_between(0.15, 0.5)
    );
    assert!(count_between(0.0, 0.15) > 100);
    assert!(count_between(0.15, 0.5) * 8 < count_between(0.0, 0.15));
    let nearest = |n: usize| {
        let others = atoms.positions.iter().enumerate().filter(|&(m, _)| m != n);
        let r2 = |y: &[f64; 3]| (0..3).map(|k| (atoms.positions[n][k] - y[k]).powi(2)).sum();
        others
            .map(|(_, y)| r2(y))
            .fold(f64::INFINITY, f64::min)
            .sqrt()
            / D
    };
    let min_distance = (0..atoms.len()).map(nearest).fold(f64::INFINITY, f64::min);
    println!("nearest neighbours {min_distance:.3} d");
    assert!(min_distance > 0.6, "{min_distance}");
}

#[test]
fn energy_never_rises_within_a_round_and_the_best_is_kept() {
    let (distance, valley) = (Distance::Constant(D), valley());
    let mut atoms = seeding::fcc(EXTENT, &distance, &[], Alignment::OnFeatures).unwrap();
    let mut energy = evaluator(&distance, &valley);
    let mut recorder = Recorder::default();
    let options = OptimiseOptions {
        max_rounds: 1,
        ..OptimiseOptions::default()
    };
    let outcome = optimise_box(&mut atoms, &mut energy, &options, &mut recorder).unwrap();
    assert!(recorder.energies.is_sorted_by(|a, b| a >= b));
    assert_eq!(recorder.energies.last(), Some(&outcome.energy_after));
    let mut gradient = vec![[0.0; 3]; atoms.len()];
    let recomputed = evaluator(&distance, &valley)
        .evaluate(&atoms.positions, &mut gradient)
        .unwrap();
    assert!((recomputed - outcome.energy_after).abs() < 1e-6 * recomputed.abs());
}

#[test]
fn an_interrupt_keeps_what_has_been_gained() {
    let (distance, valley) = (Distance::Constant(D), valley());
    let mut atoms = seeding::fcc(EXTENT, &distance, &[], Alignment::OnFeatures).unwrap();
    let mut energy = evaluator(&distance, &valley);
    let mut recorder = Recorder {
        stop_after: Some(7),
        ..Recorder::default()
    };
    let options = OptimiseOptions::default();
    let outcome = optimise_box(&mut atoms, &mut energy, &options, &mut recorder).unwrap();
    assert_eq!(
        (outcome.stop, outcome.iterations),
        (StopReason::Interrupted, 7)
    );
    assert_eq!(outcome.energy_after, recorder.energies[6]);
    let limited = OptimiseOptions {
        max_evaluations: 9,
        ..options
    };
    let outcome = optimise_box(&mut atoms, &mut energy, &limited, &mut NoProgress).unwrap();
    assert_eq!(
        (outcome.stop, outcome.evaluations),
        (StopReason::MaxIterations, 9)
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
            let mut atoms = seeding::fcc(EXTENT, &distance, &[], Alignment::OnFeatures).unwrap();
            let mut energy = evaluator(&distance, &valley);
            let options = OptimiseOptions {
                seed,
                max_rounds: 2,
                ..OptimiseOptions::default()
            };
            let progress = &mut NoProgress;
            optimise_box(&mut atoms, &mut energy, &options, progress).unwrap();
            atoms.positions
        })
    };
    let reference = run(1, 1);
    assert_eq!(reference, run(3, 1));
    assert_ne!(reference, run(1, 2));
}

#[test]
fn frozen_atoms_stay() {
    let (distance, valley) = (Distance::Constant(D), valley());
    let mut atoms = seeding::fcc(EXTENT, &distance, &[], Alignment::OnFeatures).unwrap();
    let initial = atoms.positions.clone();
    let temperature_at = |x: &[f64; 3]| f64::from(u8::from((x[0] - 25.0).abs() < 8.0));
    let options = OptimiseOptions {
        temperature: initial.iter().map(temperature_at).collect(),
        max_rounds: 1,
        ..OptimiseOptions::default()
    };
    let mut energy = evaluator(&distance, &valley);
    optimise_box(&mut atoms, &mut energy, &options, &mut NoProgress).unwrap();
    let mut moved = 0;
    for (x, old) in atoms.positions.iter().zip(&initial) {
        assert!(temperature_at(old) > 0.0 || x == old);
        moved += usize::from(x != old);
    }
    assert!(moved > 200);
}

#[test]
fn an_edit_changes_its_neighbourhood_only() {
    let distance = Distance::Constant(D);
    let mut atoms = seeding::fcc(EXTENT, &distance, &[], Alignment::OnFeatures).unwrap();
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
    let initial = atoms.positions.clone();
    let run = |warmth: f64| {
        let mut atoms = atoms.clone();
        let temperatures =
            temperature::temperatures(&initial, &[(centre, distance.value_at(centre))]);
        let options = OptimiseOptions {
            temperature: temperatures.iter().map(|t| warmth * t).collect(),
            max_rounds: 1,
            // Evaluations: as given, at the start, and after one step, which is along the force.
            max_evaluations: 3,
            perturbation: 0.0,
            ..OptimiseOptions::default()
        };
        let mut energy = PairwiseEnergy::new(EXTENT, &distance, None, Beta::Constant(0.0)).unwrap();
        optimise_box(&mut atoms, &mut energy, &options, &mut NoProgress).unwrap();
        let moved = |(x, old): (&[f64; 3], &[f64; 3])| {
            assert!(r(old) < 5.0 * D || x == old);
            (0..3).map(|k| (x[k] - old[k]).powi(2)).sum::<f64>().sqrt()
        };
        atoms.positions.iter().zip(&initial).map(moved).sum::<f64>()
    };
    let (warm, cool) = (run(1.0), run(0.05));
    println!("moved {warm:.2} warm, {cool:.2} cool");
    assert!(
        warm > 0.2 * D && cool > 0.0 && cool < 0.2 * warm,
        "{warm} {cool}"
    );
}

/// The pairwise energy as a problem for argmin, over flat coordinates without the fixed ones.
struct ArgminProblem<'a> {
    energy: std::cell::RefCell<PairwiseEnergy<'a, 3>>,
    start: Vec<[f64; 3]>,
    free: Vec<(usize, usize)>,
}

impl ArgminProblem<'_> {
    fn evaluate(&self, x: &[f64]) -> (f64, Vec<f64>) {
        let mut positions = self.start.clone();
        for (&(n, k), &value) in self.free.iter().zip(x) {
            positions[n][k] = value;
        }
        let mut gradient = vec![[0.0; 3]; positions.len()];
        let value = self
            .energy
            .borrow_mut()
            .evaluate(&positions, &mut gradient)
            .unwrap();
        (
            value,
            self.free.iter().map(|&(n, k)| gradient[n][k]).collect(),
        )
    }
}

impl argmin::core::CostFunction for ArgminProblem<'_> {
    type Param = Vec<f64>;
    type Output = f64;
    fn cost(&self, x: &Vec<f64>) -> std::result::Result<f64, argmin::core::Error> {
        Ok(self.evaluate(x).0)
    }
}

impl argmin::core::Gradient for ArgminProblem<'_> {
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
    let mut atoms = seeding::fcc(EXTENT, &distance, &[], Alignment::OnFeatures).unwrap();
    let mobility = atoms.mobility(EXTENT);
    let free: Vec<(usize, usize)> = (0..atoms.len())
        .flat_map(|n| (0..3).map(move |k| (n, k)))
        .filter(|&(n, k)| mobility[n][k] > 0.0)
        .collect();
    let start = atoms.positions.clone();
    let problem = ArgminProblem {
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
    let options = OptimiseOptions {
        perturbation: 0.0,
        max_rounds: 1,
        max_evaluations: 42,
        tolerance: 1e-9,
        ..OptimiseOptions::default()
    };
    let outcome = optimise_box(&mut atoms, &mut energy, &options, &mut NoProgress).unwrap();
    println!("ours {} theirs {theirs}", outcome.energy_after);
    let gain = outcome.energy_before - theirs;
    assert!(gain > 0.0);
    assert!(outcome.energy_after - theirs < 0.03 * gain);
}

#[test]
fn impossible_options_are_refused() {
    let (distance, valley) = (Distance::Constant(D), valley());
    let mut atoms = seeding::fcc(EXTENT, &distance, &[], Alignment::OnFeatures).unwrap();
    let good = OptimiseOptions::default();
    for options in [
        OptimiseOptions {
            tolerance: 0.0,
            ..good.clone()
        },
        OptimiseOptions {
            tolerance: f64::NAN,
            ..good.clone()
        },
        OptimiseOptions {
            perturbation: 0.7,
            ..good.clone()
        },
        OptimiseOptions {
            temperature: vec![1.0],
            ..good.clone()
        },
        OptimiseOptions {
            temperature: vec![1.5; atoms.len()],
            ..good
        },
    ] {
        let mut energy = evaluator(&distance, &valley);
        let result = optimise_box(&mut atoms, &mut energy, &options, &mut NoProgress);
        assert!(matches!(result, Err(Error::Optimise(_))));
    }
}

#[test]
#[ignore = "slow: make test-all"]
fn partitioned_optimisation_equals_the_single_process_one() {
    use crate::comm::run_threads;

    let extent = [74.0, 43.0, 51.0];
    let valley = valley();
    let varying = ScalarField::from_fn([75, 44, 52], [1.0; 3], |x| 2.6 + 0.015 * x[0]);
    // Cases: on and alongside features, constant and varying distance, and an expected move that is
    // too small at first.
    for (alignment, distance, max_moves) in [
        (
            Alignment::OnFeatures,
            Distance::Constant(2.6),
            &[0.75, 0.02][..],
        ),
        (
            Alignment::OnFeatures,
            Distance::Field(varying.clone()),
            &[0.75],
        ),
        (
            Alignment::AlongsideFeatures,
            Distance::Constant(2.8),
            &[0.75],
        ),
        (
            Alignment::AlongsideFeatures,
            Distance::Field(varying),
            &[0.3],
        ),
    ] {
        let seeded = seeding::fcc(extent, &distance, &[], alignment).unwrap();
        assert!(seeded.len() > 5 * crate::lattice::energy::CHUNK_ATOMS);
        let options = OptimiseOptions {
            tolerance: 3e-3,
            ..OptimiseOptions::default()
        };
        let energy = || {
            let energy = PairwiseEnergy::new(extent, &distance, Some(&valley), Beta::Constant(0.6));
            energy
                .unwrap()
                .with_auto_stiffness()
                .with_alignment(alignment)
        };
        let mut expected = seeded.clone();
        let progress = &mut NoProgress;
        let result = optimise(
            &mut expected,
            &mut energy(),
            &distance,
            extent,
            &options,
            progress,
        );
        let result = result.unwrap();
        assert!(result.energy_after < result.energy_before && result.rounds == 2);
        for (count, max_move) in [2, 7]
            .into_iter()
            .flat_map(|n| max_moves.iter().map(move |r| (n, r)))
        {
            let max_move = max_move * distance.max();
            let outcomes = run_threads(count, |comm| {
                let mut owned = OwnedAtoms::from_global(seeded.clone(), comm);
                let (energy, progress, distance) = (&mut energy(), &mut NoProgress, &distance);
                let lattice = SharedLattice::new(&mut owned, comm);
                let result = optimise_with_halo(
                    lattice, energy, distance, extent, &options, max_move, progress,
                );
                (owned.all_gather(comm).unwrap(), result.unwrap())
            });
            for (atoms, outcome) in outcomes {
                assert!(
                    atoms == expected,
                    "{alignment:?}, {count} of them, {max_move}"
                );
                assert_eq!(outcome, result);
            }
        }
    }
}

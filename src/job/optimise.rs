//! How the atoms of a lattice move.

use super::frame::JobDomain;
use super::{Evaluator, Params};
use crate::Result;
use crate::comm::{Comm, WorldComm};
use crate::feature::{Features, gaussian};
use crate::image::SparseField;
use crate::lattice::distance::{Distance, DistributedDistance};
use crate::lattice::energy::{Energy, PairwiseEnergy, RegularisedEnergy, SampledEnergy};
use crate::lattice::optimize::{self, StopReason};
use crate::lattice::partition::OwnedAtoms;
use crate::progress::{CancelToken, Progress};
use crate::report::Optimisation;

/// From how far around its atoms a rank has the potential, in units of d; they move less.
const HALO_RADIUS: f64 = 1.0;

/// The energy that a job's `atoms` shall have least of: the same for both evaluators, up to sampling.
fn job_energy<'a, const D: usize>(
    params: &Params<D>,
    atoms: &OwnedAtoms<D>,
    potential: &'a SparseField<D>,
    distance: &'a Distance<D>,
    frame: &JobDomain<D>,
) -> Result<Box<dyn Energy<D> + 'a>> {
    let (beta, extent) = (frame.beta.clone(), frame.extent);
    let pairs = |beta| -> Result<PairwiseEnergy<'a, D>> {
        Ok(PairwiseEnergy::new(extent, distance, Some(potential), beta)?.with_auto_stiffness())
    };
    Ok(match params.spec.evaluator {
        Evaluator::Pairwise if params.spec.kappa != 1.0 => {
            let pairs = pairs(beta.clone())?;
            let mobility = atoms.clone().all_gather(&WorldComm)?.mobility(extent);
            let energy = RegularisedEnergy::new(pairs, distance, beta, params.spec.kappa, mobility);
            Box::new(energy?)
        }
        Evaluator::Pairwise => Box::new(pairs(beta)?),
        Evaluator::Sampled => {
            Box::new(SampledEnergy::new(distance, potential.to_dense(), beta).with_auto_stiffness())
        }
    })
}

/// Moves the atoms, each rank its share: passes on smoother and smoother potentials first, if asked for.
pub(super) fn optimise<const D: usize>(
    atoms: &mut OwnedAtoms<D>,
    params: &Params<D>,
    features: &Features<D>,
    distance: &DistributedDistance<D>,
    frame: &JobDomain<D>,
    observer: &mut dyn Progress,
) -> Result<optimize::OptimizeResult> {
    let (options, extent, group) = (
        optimize_options(params),
        frame.extent,
        &WorldComm as &dyn Comm,
    );
    let moved = |atoms: &mut OwnedAtoms<D>,
                 potential: &SparseField<D>,
                 distance: &Distance<D>,
                 observer: &mut dyn Progress| {
        let energy = &mut *job_energy(params, atoms, potential, distance, frame)?;
        optimize::optimize_partition(atoms, energy, distance, extent, &options, group, observer)
    };
    let potential = &features.potential;
    if potential.is_distributed {
        let before = atoms.clone();
        let outcome = {
            let (positions, room) = (&atoms.atoms.positions, HALO_RADIUS * distance.max());
            let near = potential.gather_neighbourhood(positions, room, group)?;
            // Of atoms of others that are in reach of its own it asks for d, too.
            let reach = room + optimize::halo_width(&distance.outline());
            let distance = distance.fetch_near(positions, reach, group)?;
            let outcome = moved(atoms, &near, &distance, observer)?;
            let missed = near.has_missed() || distance.has_misses();
            let missed: Vec<bool> = group.all_gather("potential", missed)?;
            (!missed.contains(&true)).then_some(outcome)
        };
        if let Some(outcome) = outcome {
            return Ok(outcome);
        }
        // An atom has been where its rank does not know the image, or d.
        *atoms = before;
        let (potential, distance) = (potential.all_gather(group)?, distance.global(group)?);
        return moved(atoms, &potential, &distance, observer);
    }
    let distance = &*distance.global(group)?;
    let pass =
        |atoms: &mut OwnedAtoms<D>, potential: &SparseField<D>, observer: &mut dyn Progress| {
            moved(atoms, potential, distance, observer)
        };
    for coarse in (1..=params.spec.coarse_to_fine).rev() {
        let factor = f64::from(1 << coarse);
        // Stopped half way it is rough: the pass over it ends at its first question.
        let smoother = CancelToken::run(&mut || observer.keep_going(), |patience| {
            smoothed_potential(potential, features.sigma, factor, patience)
        });
        let outcome = pass(atoms, &smoother, observer)?;
        if outcome.stop == StopReason::Interrupted {
            return Ok(outcome);
        }
    }
    pass(atoms, potential, observer)
}

/// Whether moving the atoms of a job takes no more of the potential than what is near to each.
pub(super) fn needs_only_local_potential<const D: usize>(params: &Params<D>) -> bool {
    D == 3
        && params.spec.evaluator == Evaluator::Pairwise
        && params.spec.kappa == 1.0
        && params.spec.coarse_to_fine == 0
        && params.spec.optimizer != optimize::Method::Genetic
}

/// How the atoms of a job are moved.
pub(crate) fn optimize_options<const D: usize>(params: &Params<D>) -> optimize::OptimizeOptions {
    let effort = default_optimize_options(params.spec.rng_seed)
        .with_method(params.spec.optimizer, params.spec.kappa != 1.0);
    match params.spec.rounds {
        None => effort,
        Some(rounds) => optimize::OptimizeOptions {
            max_evaluations: effort.max_evaluations / effort.max_rounds * rounds,
            max_rounds: rounds,
            ..effort
        },
    }
}

/// How atoms are moved by default.
pub(crate) fn default_optimize_options(seed: u64) -> optimize::OptimizeOptions {
    optimize::OptimizeOptions {
        seed,
        tolerance: 1e-3,
        // Improvement takes over from here: a second round, unless asked for, changes neither quality
        // nor fidelity.
        max_rounds: 1,
        max_evaluations: 40,
        ..optimize::OptimizeOptions::default()
    }
}

/// A potential whose valleys, of width `sigma`, are `factor` times as wide and as deep as before.
fn smoothed_potential<const D: usize>(
    potential: &SparseField<D>,
    sigma: f64,
    factor: f64,
    patience: &CancelToken<'_>,
) -> SparseField<D> {
    let mut wide = potential.to_dense();
    // Widths add in quadrature; the depth of a straight valley falls as its width grows.
    let added = sigma * (factor * factor - 1.0).sqrt();
    gaussian::smooth(
        wide.dims,
        &mut wide.samples,
        wide.step.map(|step| added / step),
        patience,
    );
    for b in &mut wide.samples {
        *b = (*b * factor as f32).clamp(-1.0, 0.0);
    }
    SparseField::from_field(&wide)
}

/// The report's lines on the optimiser.
pub(super) fn optimisation_report(
    outcome: &optimize::OptimizeResult,
    atoms: usize,
) -> Optimisation {
    let per_atom = 1.0 / atoms as f64;
    let terms = outcome.terms;
    Optimisation {
        energy_lattice: terms.published.lattice * per_atom,
        energy_image: terms.published.image * per_atom,
        energy: terms.energy * per_atom,
        added_by_stiffening: terms.stiffening * per_atom,
        added_by_laplacian: terms.smoothing * per_atom,
        minimised: outcome.energy_after * per_atom,
        evaluations: outcome.evaluations,
        stop: match outcome.stop {
            StopReason::Converged => "converged",
            StopReason::MaxIterations => "as many rounds as allowed",
            StopReason::Interrupted => "interrupted",
        }
        .into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::DetectionOptions;
    use crate::geometry::distance2;
    use crate::image::ScalarField;
    use crate::job::spec::MeshSpec;
    use crate::lattice::energy::Beta;
    use crate::lattice::seeding::{self, Alignment, Atoms};
    use crate::progress::NoProgress;

    /// The share of atoms, farther than 1.5 d from all sides, that have so many others within 1.25 d.
    fn regular_share<const D: usize>(
        atoms: &[[f64; D]],
        d: f64,
        extent: [f64; D],
        count: usize,
    ) -> f64 {
        let inside = |x: &&[f64; D]| {
            (0..D).all(|k| (x[k] - 0.5 * extent[k]).abs() < 0.5 * extent[k] - 1.5 * d)
        };
        let near = |x: &[f64; D]| {
            let within = |y: &&[f64; D]| distance2(x, y) < (1.25 * d).powi(2);
            atoms.iter().filter(within).count() - 1
        };
        let inside: Vec<usize> = atoms.iter().filter(inside).map(near).collect();
        assert!(inside.len() > 150, "{}", inside.len());
        inside.iter().filter(|&&n| n == count).count() as f64 / inside.len() as f64
    }

    /// A lattice of an image without features at rest.
    fn relaxed_lattice<const D: usize>(
        extent: [f64; D],
        d: f64,
        beta: f64,
        params: &Params<D>,
    ) -> (Atoms<D>, optimize::OptimizeResult) {
        let distance = Distance::Constant(d);
        let atoms = seeding::fcc(extent, &distance, &[], Alignment::OnFeatures).unwrap();
        let distance = DistributedDistance::Global(distance);
        let mut atoms = OwnedAtoms::from_global(atoms, &WorldComm);
        let dims = extent.map(|l| l as usize + 1);
        let features = Features::empty(dims, &DetectionOptions::default());
        let frame = JobDomain {
            step: [1.0; D],
            extent,
            beta: Beta::Constant(beta),
            fixed_atoms: Vec::new(),
            well_paths: Vec::new(),
        };
        let observer = &mut NoProgress;
        let rest = optimise(&mut atoms, params, &features, &distance, &frame, observer).unwrap();
        (atoms.atoms, rest)
    }

    #[test]
    fn without_an_image_the_lattice_stays_regular_whatever_beta() {
        for extent in [[63.0; 3], [89.0, 79.0, 69.0], [75.0, 61.0, 83.0]] {
            for (beta, seed) in [(0.0, 1), (0.0, 2), (0.0, 3), (0.3, 1), (0.5, 2), (0.8, 3)] {
                let params = Params::new(MeshSpec {
                    rng_seed: seed,
                    ..MeshSpec::default()
                })
                .unwrap();
                let (atoms, _) = relaxed_lattice(extent, 6.0, beta, &params);
                let share = regular_share(&atoms.positions, 6.0, extent, 12);
                assert!(
                    share >= 0.99,
                    "{extent:?}, beta {beta}, seed {seed}: {share}"
                );
            }
        }
    }

    #[test]
    fn the_report_has_the_published_energy_and_what_is_added() {
        // phi as printed, and the sums of Hale's equations 1, 3 and 6.
        let phi = |u: f64| match u < 1.5 {
            true => {
                153.0 / 256.0 - 9.0 / 8.0 * u + 19.0 / 24.0 * u.powi(3) - 5.0 / 16.0 * u.powi(4)
            }
            false => 0.0,
        };
        let (extent, d, beta) = ([80.0, 60.0], 6.0, 0.6);
        let b = |x: [f64; 2]| -0.01 * x[0];
        let potential = SparseField::from_field(&ScalarField::from_fn([81, 61], [1.0; 2], b));
        let distance = Distance::Constant(d);
        let shared = DistributedDistance::Global(distance.clone());
        let frame = JobDomain {
            step: [1.0; 2],
            extent,
            beta: Beta::Constant(beta),
            fixed_atoms: Vec::new(),
            well_paths: Vec::new(),
        };
        for (evaluator, kappa, exact) in [
            (Evaluator::Pairwise, 1.0, 1e-4),
            (Evaluator::Pairwise, 0.7, 1e-4),
            (Evaluator::Sampled, 1.0, 0.1),
        ] {
            let params = Params::new(MeshSpec {
                evaluator,
                kappa,
                ..MeshSpec::default()
            })
            .unwrap();
            let atoms = seeding::fcc(extent, &distance, &[], Alignment::OnFeatures).unwrap();
            let mut atoms = OwnedAtoms::from_global(atoms, &WorldComm);
            let features = Features {
                potential: potential.clone(),
                ..Features::empty([81, 61], &DetectionOptions::default())
            };
            let observer = &mut NoProgress;
            let rest = optimise(&mut atoms, &params, &features, &shared, &frame, observer);
            let found = optimisation_report(&rest.unwrap(), atoms.global_count);
            let x = &atoms.atoms.positions;
            let per_atom = 1.0 / x.len() as f64;
            let pairs = |of: &dyn Fn(f64) -> f64| {
                let of = |(i, j): (usize, usize)| of(distance2(&x[i], &x[j]).sqrt() / d);
                let all = (0..x.len()).flat_map(|i| (0..x.len()).map(move |j| (i, j)));
                0.5 * per_atom * all.filter(|(i, j)| i != j).map(of).sum::<f64>()
            };
            let a = pairs(&phi);
            let image = per_atom * x.iter().map(|&x| b(x)).sum::<f64>();
            let p = (1.0 - beta) * a + beta * image;
            let k = 20.0 * beta / (1.0 - beta);
            let stiffening = (1.0 - beta) * pairs(&|u| k / 3.0 * (1.0 - u).max(0.0).powi(3));
            let near = |value: f64, want: f64| {
                assert!(
                    (value - want).abs() < exact * p.abs(),
                    "{value} {want}: {found:?}"
                );
            };
            near(found.energy_lattice, a);
            near(found.energy_image, image);
            near(found.energy, p);
            near(found.added_by_stiffening, stiffening);
            assert!(stiffening > 0.001 * p.abs(), "{stiffening}");
            let sum = found.energy + found.added_by_stiffening + found.added_by_laplacian;
            assert!((sum - found.minimised).abs() < 1e-9, "{found:?}");
            assert_eq!(found.added_by_laplacian == 0.0, kappa == 1.0);
        }
    }

    #[test]
    fn both_evaluators_have_the_energy_of_crowded_atoms() {
        // Rows of atoms 0.6 d apart: what keeps them from crowding is most of their energy.
        let (d, extent) = (10.0, [60.0, 60.0]);
        let atoms: Vec<[f64; 2]> = (0..49)
            .map(|i| [6.0 * f64::from(i % 7) + 12.0, 6.0 * f64::from(i / 7) + 12.0])
            .collect();
        let atoms = OwnedAtoms::from_global(Atoms::from_positions(atoms, extent), &WorldComm);
        let potential = ScalarField::from_fn([61, 61], [1.0; 2], |x| -0.01 * x[0]);
        let potential = SparseField::from_field(&potential);
        let distance = Distance::Constant(d);
        let frame = JobDomain {
            step: [1.0; 2],
            extent,
            beta: Beta::Constant(0.6),
            fixed_atoms: Vec::new(),
            well_paths: Vec::new(),
        };
        let [pairwise, sampled] = [Evaluator::Pairwise, Evaluator::Sampled].map(|evaluator| {
            let params = Params::new(MeshSpec {
                evaluator,
                ..MeshSpec::default()
            })
            .unwrap();
            let energy = job_energy(&params, &atoms, &potential, &distance, &frame);
            let mut gradient = vec![[0.0; 2]; atoms.global_count];
            let x = &atoms.atoms.positions;
            energy.unwrap().evaluate(x, &mut gradient).unwrap()
        });
        // On samples both are exact.
        assert!(pairwise > 1.0, "{pairwise}");
        let off = (pairwise - sampled).abs();
        assert!(off < 1e-4 * pairwise, "{pairwise} {sampled}");
    }
}

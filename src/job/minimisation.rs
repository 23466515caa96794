//! Moves the atoms of a lattice to a minimum of the energy.

use super::job_domain::JobDomain;
use super::spec::SeedingKind;
use super::{CellKind, Evaluator, LatticeParams, Optimizer, periodic};
use crate::Result;
use crate::comm::Comm;
use crate::feature::Features;
use crate::image::SparseField;
use crate::improve::Effort;
use crate::lattice::distance::{Distance, DistributedDistance};
use crate::lattice::energy::tied::TiedEnergy;
use crate::lattice::energy::{Beta, Energy, PairwiseEnergy};
use crate::lattice::halo::SharedLattice;
use crate::lattice::optimise::{self, StopReason};
use crate::lattice::owned_atoms::OwnedAtoms;
use crate::mesh::delaunay::{DelaunayKernel, distributed_delaunay};
use crate::progress::{CancelToken, Progress};
use crate::published::coarse_to_fine::smoothed_potential;
use crate::published::{RegularisedEnergy, SampledEnergy};
use crate::report::Optimisation;

/// Distance around its atoms to which a rank has the potential, in units of d. Atoms move less than
/// that.
const HALO_RADIUS: f64 = 1.0;

/// Returns the energy of a job's atoms in the box `[0, extent]`, of which each rank of `comm`, if
/// there are several, has a share. `mobility` returns [which coordinates of all atoms](crate::lattice::seeding::Atoms::mobility)
/// may change. Both evaluators compute the same energy, except for sampling errors.
///
/// # Errors
/// Returns the errors of the energies and of `mobility`.
pub(crate) fn job_energy<'a, const D: usize>(
    params: &LatticeParams<'_, D>,
    potential: &'a SparseField<D>,
    distance: &'a Distance<D>,
    beta: Beta<D>,
    extent: [f64; D],
    mobility: impl FnOnce() -> Result<Vec<[f64; D]>>,
    comm: Option<&'a dyn Comm>,
) -> Result<Box<dyn Energy<D> + 'a>> {
    let pairs = |beta| -> Result<PairwiseEnergy<'a, D>> {
        Ok(PairwiseEnergy::new(extent, distance, Some(potential), beta)?.with_auto_stiffness())
    };
    Ok(match params.spec().evaluator {
        Evaluator::Pairwise if params.spec().kappa != 1.0 => {
            let pairs = pairs(beta.clone())?;
            let kappa = params.spec().kappa;
            let energy = RegularisedEnergy::new(pairs, distance, beta, kappa, mobility()?)?;
            match comm {
                Some(comm) => Box::new(energy.with_triangulation(move |x| {
                    distributed_delaunay(x, DelaunayKernel::Auto, comm)
                })),
                None => Box::new(energy),
            }
        }
        Evaluator::Pairwise => Box::new(pairs(beta)?),
        Evaluator::Sampled => {
            Box::new(SampledEnergy::new(distance, potential.to_dense(), beta).with_auto_stiffness())
        }
    })
}

/// Moves the atoms, each rank its share. If requested, the first passes use smoother potentials.
pub(super) fn optimise<const D: usize>(
    atoms: &mut OwnedAtoms<D>,
    params: &LatticeParams<'_, D>,
    features: &Features<D>,
    distance: &DistributedDistance<D>,
    frame: &JobDomain<D>,
    comm: &dyn Comm,
    progress: &mut dyn Progress,
) -> Result<optimise::OptimiseResult> {
    let extent = frame.extent;
    let options = optimise_options(params, &distance.outline());
    let move_atoms = |atoms: &mut OwnedAtoms<D>,
                      potential: &SparseField<D>,
                      distance: &Distance<D>,
                      progress: &mut dyn Progress| {
        let mobility = || Ok(atoms.clone().all_gather(comm)?.mobility(extent));
        let beta = frame.beta.clone();
        let group = Some(comm);
        let positions = &atoms.atoms.positions;
        let tied = (params.periodic_axes())
            .map(|axes| periodic::tied_nodes(positions, extent, axes))
            .transpose()?;
        let mut energy = job_energy(params, potential, distance, beta, extent, mobility, group)?;
        if let Some(nodes) = &tied {
            energy = Box::new(TiedEnergy::new(energy, nodes, extent));
        }
        let lattice = SharedLattice::new(atoms, comm);
        let energy = &mut *energy;
        let result =
            optimise::optimise_partition(lattice, energy, distance, extent, &options, progress)?;
        if let Some(nodes) = &tied {
            nodes.follow_bases(&mut atoms.atoms.positions, extent);
        }
        Ok(result)
    };
    let potential = &features.potential;
    if potential.is_distributed {
        let initial = atoms.clone();
        let outcome = {
            let (positions, margin) = (&atoms.atoms.positions, HALO_RADIUS * distance.max());
            let local_potential = potential.gather_neighbourhood(positions, margin, comm)?;
            // The nominal distance is also needed at the atoms of other ranks that interact with
            // this rank's atoms.
            let range = margin + optimise::halo_width(&distance.outline());
            let distance = distance.fetch_near(positions, range, comm)?;
            let outcome = move_atoms(atoms, &local_potential, &distance, progress)?;
            let has_misses = local_potential.has_missed() || distance.has_misses();
            let has_misses: Vec<bool> = comm.all_gather("potential", has_misses)?;
            (!has_misses.contains(&true)).then_some(outcome)
        };
        if let Some(outcome) = outcome {
            return Ok(outcome);
        }
        // An atom moved to a place where its rank does not know the image or the nominal distance,
        // so that the pass is repeated with global data.
        *atoms = initial;
        let (potential, distance) = (potential.all_gather(comm)?, distance.global(comm)?);
        return move_atoms(atoms, &potential, &distance, progress);
    }
    let distance = &*distance.global(comm)?;
    let pass =
        |atoms: &mut OwnedAtoms<D>, potential: &SparseField<D>, progress: &mut dyn Progress| {
            move_atoms(atoms, potential, distance, progress)
        };
    for level in (1..=params.spec().coarse_to_fine).rev() {
        let factor = f64::from(1 << level);
        // If smoothing is cancelled, its result is unusable, but the pass that follows stops at its
        // first poll.
        let smoother = CancelToken::run(&mut || progress.keep_going(), |cancel| {
            smoothed_potential(potential, features.sigma, factor, cancel)
        });
        let outcome = pass(atoms, &smoother, progress)?;
        if outcome.stop == StopReason::Interrupted {
            return Ok(outcome);
        }
    }
    pass(atoms, potential, progress)
}

/// Returns `true` if moving the atoms of a job needs the potential only near each atom.
pub(super) fn needs_only_local_potential<const D: usize>(params: &LatticeParams<'_, D>) -> bool {
    D == 3
        && params.spec().evaluator == Evaluator::Pairwise
        && params.spec().kappa == 1.0
        && params.spec().coarse_to_fine == 0
        && params.spec().optimizer != Optimizer::Genetic
}

/// Most evaluations of the energy for L-BFGS.
const MAX_EVALUATIONS: usize = 40;
/// Most evaluations for tetrahedra that are improved later if d varies. It does so where features are
/// close to each other, and there further steps only crowd the atoms: features lose coverage and
/// slivers take longer to remove.
const VARYING_TET_EVALUATIONS: usize = 12;
/// Most evaluations in a draft.
const DRAFT_EVALUATIONS: usize = 7;
/// Factor of the number of rounds, and of evaluations, at the best effort.
const BEST_ROUND_FACTOR: usize = 3;

/// Returns the optimiser's options for a job.
pub(crate) fn optimise_options<const D: usize>(
    params: &LatticeParams<'_, D>,
    distance: &Distance<D>,
) -> optimise::OptimiseOptions<D> {
    let (spec, effort) = (params.spec(), params.spec().effort());
    let is_improved_later = D == 3
        && spec.cell_kind() == CellKind::Simplices
        && spec.target().is_some()
        && spec.seeding == SeedingKind::Fcc;
    let evaluations = match effort {
        Effort::Draft => DRAFT_EVALUATIONS,
        _ if is_improved_later && distance.max_slope() > 0.0 => VARYING_TET_EVALUATIONS,
        _ => MAX_EVALUATIONS,
    };
    let mut options = default_optimise_options(spec.rng_seed, evaluations)
        .with_method(spec.optimizer.method(), spec.kappa != 1.0);
    if effort == Effort::Best && !is_improved_later {
        options.max_rounds *= BEST_ROUND_FACTOR;
        options.max_evaluations *= BEST_ROUND_FACTOR;
    }
    if let Some(rounds) = spec.rounds {
        options.max_evaluations = options.max_evaluations / options.max_rounds * rounds;
        options.max_rounds = rounds;
    }
    if let Some(evaluations) = spec.max_evaluations {
        options.max_evaluations = evaluations.get();
    }
    options
}

/// Returns the default options of the optimiser, with L-BFGS and at most `max_evaluations`.
pub(crate) fn default_optimise_options<const D: usize>(
    seed: u64,
    max_evaluations: usize,
) -> optimise::OptimiseOptions<D> {
    optimise::OptimiseOptions {
        seed,
        tolerance: 1e-3,
        // A second round would improve neither quality nor fidelity, as improvement of the mesh
        // follows.
        max_rounds: 1,
        max_evaluations,
        ..optimise::OptimiseOptions::default()
    }
}

/// Returns the report on the optimiser; energies are per atom.
pub(super) fn optimisation_report(
    outcome: &optimise::OptimiseResult,
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
        stop: outcome.stop,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::SelfComm;
    use crate::feature::DetectionOptions;
    use crate::geometry::distance2;
    use crate::image::ScalarField;
    use crate::job::Params;
    use crate::job::spec::MeshSpec;
    use crate::lattice::energy::Beta;
    use crate::lattice::seeding::{self, Alignment, Atoms};
    use crate::progress::NoProgress;

    /// Returns the fraction of atoms, further than 1.5 d from all sides, that have `count` other
    /// atoms within 1.25 d.
    fn regular_share<const D: usize>(
        atoms: &[[f64; D]],
        d: f64,
        extent: [f64; D],
        count: usize,
    ) -> f64 {
        let is_inside = |x: &&[f64; D]| {
            (0..D).all(|k| (x[k] - 0.5 * extent[k]).abs() < 0.5 * extent[k] - 1.5 * d)
        };
        let neighbour_count = |x: &[f64; D]| {
            let within = |y: &&[f64; D]| distance2(x, y) < (1.25 * d).powi(2);
            atoms.iter().filter(within).count() - 1
        };
        let counts: Vec<usize> = atoms
            .iter()
            .filter(is_inside)
            .map(neighbour_count)
            .collect();
        assert!(counts.len() > 150, "{}", counts.len());
        counts.iter().filter(|&&n| n == count).count() as f64 / counts.len() as f64
    }

    /// Returns the lattice at rest of an image without features.
    fn relaxed_lattice<const D: usize>(
        extent: [f64; D],
        d: f64,
        beta: f64,
        params: &Params<D>,
    ) -> (Atoms<D>, optimise::OptimiseResult) {
        let distance = Distance::Constant(d);
        let atoms = seeding::fcc(extent, &distance, &[], Alignment::OnFeatures).unwrap();
        let distance = DistributedDistance::Global(distance);
        let mut atoms = OwnedAtoms::from_global(atoms, &SelfComm);
        let dims = extent.map(|l| l as usize + 1);
        let features = Features::empty(dims, &DetectionOptions::default());
        let frame = JobDomain {
            step: [1.0; D],
            extent,
            beta: Beta::Constant(beta),
            fixed_atoms: Vec::new(),
            well_paths: Vec::new(),
        };
        let params = &LatticeParams::new(params, 1.0);
        let progress = &mut NoProgress;
        let result = optimise(
            &mut atoms, params, &features, &distance, &frame, &SelfComm, progress,
        );
        (atoms.atoms, result.unwrap())
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
        // phi as published, and the sums of Hale's equations 1, 3 and 6.
        let phi = |u: f64| {
            if u < 1.5 {
                153.0 / 256.0 - 9.0 / 8.0 * u + 19.0 / 24.0 * u.powi(3) - 5.0 / 16.0 * u.powi(4)
            } else {
                0.0
            }
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
        for (evaluator, kappa, tolerance) in [
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
            let params = &LatticeParams::new(&params, 1.0);
            let atoms = seeding::fcc(extent, &distance, &[], Alignment::OnFeatures).unwrap();
            let mut atoms = OwnedAtoms::from_global(atoms, &SelfComm);
            let features = Features {
                potential: potential.clone(),
                ..Features::empty([81, 61], &DetectionOptions::default())
            };
            let progress = &mut NoProgress;
            let result = optimise(
                &mut atoms, params, &features, &shared, &frame, &SelfComm, progress,
            );
            let report = optimisation_report(&result.unwrap(), atoms.global_count);
            let x = &atoms.atoms.positions;
            let per_atom = 1.0 / x.len() as f64;
            let pairs = |pair_energy: &dyn Fn(f64) -> f64| {
                let energy =
                    |(i, j): (usize, usize)| pair_energy(distance2(&x[i], &x[j]).sqrt() / d);
                let all = (0..x.len()).flat_map(|i| (0..x.len()).map(move |j| (i, j)));
                0.5 * per_atom * all.filter(|(i, j)| i != j).map(energy).sum::<f64>()
            };
            let a = pairs(&phi);
            let image = per_atom * x.iter().map(|&x| b(x)).sum::<f64>();
            let p = (1.0 - beta) * a + beta * image;
            let k = 20.0 * beta / (1.0 - beta);
            let stiffening = (1.0 - beta) * pairs(&|u| k / 3.0 * (1.0 - u).max(0.0).powi(3));
            let assert_near = |value: f64, expected: f64| {
                assert!(
                    (value - expected).abs() < tolerance * p.abs(),
                    "{value} {expected}: {report:?}"
                );
            };
            assert_near(report.energy_lattice, a);
            assert_near(report.energy_image, image);
            assert_near(report.energy, p);
            assert_near(report.added_by_stiffening, stiffening);
            assert!(stiffening > 0.001 * p.abs(), "{stiffening}");
            let sum = report.energy + report.added_by_stiffening + report.added_by_laplacian;
            assert!((sum - report.minimised).abs() < 1e-9, "{report:?}");
            assert_eq!(report.added_by_laplacian == 0.0, kappa == 1.0);
        }
    }
}

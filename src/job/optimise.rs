//! How the atoms of a lattice move.

use super::frame::Frame;
use super::{Evaluator, Params};
use crate::Result;
use crate::feature::{Features, gaussian};
use crate::image::Sparse;
use crate::lattice::distance::{Distance, Shared};
use crate::lattice::energy::{Energy, Pairwise, Regularised, Sampled};
use crate::lattice::optimize::{self, Stop};
use crate::lattice::share::OwnAtoms;
use crate::observer::{Observer, Patience};
use crate::ranks::{Group, Ranks};
use crate::report::Optimisation;

/// From how far around its atoms a rank has the potential, in units of d; they move less.
const ROOM: f64 = 1.0;

/// The energy that a job's `atoms` shall have least of: the same for both evaluators, up to sampling.
fn energy<'a, const D: usize>(
    params: &Params<D>,
    atoms: &OwnAtoms<D>,
    potential: &'a Sparse<D>,
    distance: &'a Distance<D>,
    frame: &Frame<D>,
) -> Result<Box<dyn Energy<D> + 'a>> {
    let (beta, extent) = (frame.beta.clone(), frame.extent);
    let pairs = |beta| -> Result<Pairwise<'a, D>> {
        Ok(Pairwise::new(extent, distance, Some(potential), beta)?.uncrowded())
    };
    Ok(match params.evaluator {
        Evaluator::Pairwise if params.kappa != 1.0 => {
            let pairs = pairs(beta.clone())?;
            let mobility = atoms.clone().gathered(&Ranks)?.mobility(extent);
            let energy = Regularised::new(pairs, distance, beta, params.kappa, mobility);
            Box::new(energy?)
        }
        Evaluator::Pairwise => Box::new(pairs(beta)?),
        Evaluator::Sampled => Box::new(Sampled::new(distance, potential.dense(), beta).uncrowded()),
    })
}

/// Moves the atoms, each rank its share: passes on smoother and smoother potentials first, if asked for.
pub(super) fn optimise<const D: usize>(
    atoms: &mut OwnAtoms<D>,
    params: &Params<D>,
    features: &Features<D>,
    distance: &Shared<D>,
    frame: &Frame<D>,
    observer: &mut dyn Observer,
) -> Result<optimize::Rest> {
    let (options, extent, group) = (moving(params), frame.extent, &Ranks as &dyn Group);
    let moved = |atoms: &mut OwnAtoms<D>,
                 potential: &Sparse<D>,
                 distance: &Distance<D>,
                 observer: &mut dyn Observer| {
        let energy = &mut *energy(params, atoms, potential, distance, frame)?;
        optimize::optimize_together(atoms, energy, distance, extent, &options, group, observer)
    };
    let potential = &features.potential;
    if potential.in_shares {
        let before = atoms.clone();
        let outcome = {
            let (positions, room) = (&atoms.atoms.positions, ROOM * distance.max());
            let near = potential.near(positions, room, group)?;
            // Of atoms of others that are in reach of its own it asks for d, too.
            let reach = room + optimize::held_within(&distance.outline());
            let distance = distance.near(positions, reach, group)?;
            let outcome = moved(atoms, &near, &distance, observer)?;
            let missed = near.missed() || distance.missed();
            let missed: Vec<bool> = group.all("potential", missed)?;
            (!missed.contains(&true)).then_some(outcome)
        };
        if let Some(outcome) = outcome {
            return Ok(outcome);
        }
        // An atom has been where its rank does not know the image, or d.
        *atoms = before;
        let (potential, distance) = (potential.gathered(group)?, distance.whole(group)?);
        return moved(atoms, &potential, &distance, observer);
    }
    let distance = &*distance.whole(group)?;
    let pass = |atoms: &mut OwnAtoms<D>, potential: &Sparse<D>, observer: &mut dyn Observer| {
        moved(atoms, potential, distance, observer)
    };
    for coarse in (1..=params.coarse_passes).rev() {
        let factor = f64::from(1 << coarse);
        // Stopped half way it is rough: the pass over it ends at its first question.
        let smoother = Patience::of(&mut || observer.keep_going(), |patience| {
            smoother(potential, features.sigma, factor, patience)
        });
        let outcome = pass(atoms, &smoother, observer)?;
        if outcome.stop == Stop::Interrupted {
            return Ok(outcome);
        }
    }
    pass(atoms, potential, observer)
}

/// Whether moving the atoms of a job takes no more of the potential than what is near to each.
pub(super) fn looks_near<const D: usize>(params: &Params<D>) -> bool {
    D == 3
        && params.evaluator == Evaluator::Pairwise
        && params.kappa == 1.0
        && params.coarse_passes == 0
        && params.optimizer != optimize::Method::Genetic
}

/// How the atoms of a job are moved.
pub(crate) fn moving<const D: usize>(params: &Params<D>) -> optimize::Effort {
    let effort = optimiser(params.seed).with(params.optimizer, params.kappa != 1.0);
    match params.rounds {
        None => effort,
        Some(rounds) => optimize::Effort {
            max_evaluations: effort.max_evaluations / effort.max_rounds * rounds,
            max_rounds: rounds,
            ..effort
        },
    }
}

/// How atoms are moved by default.
pub(crate) fn optimiser(seed: u64) -> optimize::Effort {
    optimize::Effort {
        seed,
        tolerance: 1e-3,
        // Improvement takes over from here: a second round, unless asked for, changes neither quality
        // nor fidelity.
        max_rounds: 1,
        max_evaluations: 40,
        ..optimize::Effort::default()
    }
}

/// A potential whose valleys, of width `sigma`, are `factor` times as wide and as deep as before.
fn smoother<const D: usize>(
    potential: &Sparse<D>,
    sigma: f64,
    factor: f64,
    patience: &Patience<'_>,
) -> Sparse<D> {
    let mut wide = potential.dense();
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
    Sparse::of(&wide)
}

/// The report's lines on the optimiser.
pub(super) fn optimisation(outcome: &optimize::Rest, atoms: usize) -> Optimisation {
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
            Stop::Converged => "converged",
            Stop::MaxIterations => "as many rounds as allowed",
            Stop::Interrupted => "interrupted",
        }
        .into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::Detection;
    use crate::geometry::distance2;
    use crate::image::Field;
    use crate::lattice::energy::Beta;
    use crate::lattice::seeding::{self, Alignment, Atoms};
    use crate::observer::Unobserved;

    /// The share of atoms, farther than 1.5 d from all sides, that have so many others within 1.25 d.
    fn regular<const D: usize>(atoms: &[[f64; D]], d: f64, extent: [f64; D], count: usize) -> f64 {
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
    fn at_rest<const D: usize>(
        extent: [f64; D],
        d: f64,
        beta: f64,
        params: &Params<D>,
    ) -> (Atoms<D>, optimize::Rest) {
        let distance = Distance::Constant(d);
        let atoms = seeding::fcc(extent, &distance, &[], Alignment::On).unwrap();
        let distance = Shared::All(distance);
        let mut atoms = OwnAtoms::of(atoms, &Ranks);
        let dims = extent.map(|l| l as usize + 1);
        let features = Features::none(dims, &Detection::default());
        let frame = Frame {
            step: [1.0; D],
            extent,
            beta: Beta::Constant(beta),
            fixed: Vec::new(),
            ways: Vec::new(),
        };
        let observer = &mut Unobserved;
        let rest = optimise(&mut atoms, params, &features, &distance, &frame, observer).unwrap();
        (atoms.atoms, rest)
    }

    #[test]
    fn without_an_image_the_lattice_stays_regular_whatever_beta() {
        for extent in [[63.0; 3], [89.0, 79.0, 69.0], [75.0, 61.0, 83.0]] {
            for (beta, seed) in [(0.0, 1), (0.0, 2), (0.0, 3), (0.3, 1), (0.5, 2), (0.8, 3)] {
                let params = Params {
                    seed,
                    ..Params::default()
                };
                let (atoms, _) = at_rest(extent, 6.0, beta, &params);
                let share = regular(&atoms.positions, 6.0, extent, 12);
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
        let potential = Sparse::of(&Field::from_fn([81, 61], [1.0; 2], b));
        let distance = Distance::Constant(d);
        let shared = Shared::All(distance.clone());
        let frame = Frame {
            step: [1.0; 2],
            extent,
            beta: Beta::Constant(beta),
            fixed: Vec::new(),
            ways: Vec::new(),
        };
        for (evaluator, kappa, exact) in [
            (Evaluator::Pairwise, 1.0, 1e-4),
            (Evaluator::Pairwise, 0.7, 1e-4),
            (Evaluator::Sampled, 1.0, 0.1),
        ] {
            let params = Params {
                evaluator,
                kappa,
                ..Params::default()
            };
            let atoms = seeding::fcc(extent, &distance, &[], Alignment::On).unwrap();
            let mut atoms = OwnAtoms::of(atoms, &Ranks);
            let features = Features {
                potential: potential.clone(),
                ..Features::none([81, 61], &Detection::default())
            };
            let observer = &mut Unobserved;
            let rest = optimise(&mut atoms, &params, &features, &shared, &frame, observer);
            let found = optimisation(&rest.unwrap(), atoms.whole);
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
        let atoms = OwnAtoms::of(Atoms::in_box(atoms, extent), &Ranks);
        let potential = Field::from_fn([61, 61], [1.0; 2], |x| -0.01 * x[0]);
        let potential = Sparse::of(&potential);
        let distance = Distance::Constant(d);
        let frame = Frame {
            step: [1.0; 2],
            extent,
            beta: Beta::Constant(0.6),
            fixed: Vec::new(),
            ways: Vec::new(),
        };
        let [pairwise, sampled] = [Evaluator::Pairwise, Evaluator::Sampled].map(|evaluator| {
            let params = Params {
                evaluator,
                ..Params::default()
            };
            let energy = energy(&params, &atoms, &potential, &distance, &frame);
            let mut gradient = vec![[0.0; 2]; atoms.whole];
            let x = &atoms.atoms.positions;
            energy.unwrap().evaluate(x, &mut gradient).unwrap()
        });
        // On samples both are exact.
        assert!(pairwise > 1.0, "{pairwise}");
        let off = (pairwise - sampled).abs();
        assert!(off < 1e-4 * pairwise, "{pairwise} {sampled}");
    }
}

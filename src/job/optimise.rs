//! How the atoms of a lattice move.

use super::frame::Frame;
use super::{Evaluator, Params};
use crate::Result;
use crate::feature::{Features, gaussian};
use crate::image::Field;
use crate::lattice::distance::Distance;
use crate::lattice::energy::{Energy, Pairwise, Regularised, Sampled};
use crate::lattice::optimize::{self, Stop};
use crate::lattice::seeding::Atoms;
use crate::observer::{Observer, Patience};
use crate::report::Optimisation;

/// The energy that a job's atoms shall have least of: the same for both evaluators, up to sampling.
fn energy<'a, const D: usize>(
    params: &Params<D>,
    mobility: Vec<[f64; D]>,
    potential: &'a Field<D>,
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
            let energy = Regularised::new(pairs, distance, beta, params.kappa, mobility);
            Box::new(energy?)
        }
        Evaluator::Pairwise => Box::new(pairs(beta)?),
        Evaluator::Sampled => Box::new(Sampled::new(distance, potential, beta).uncrowded()),
    })
}

/// Moves the atoms: passes on smoother and smoother potentials first, if asked for.
pub(super) fn optimise<const D: usize>(
    atoms: &mut Atoms<D>,
    params: &Params<D>,
    features: &Features<D>,
    distance: &Distance<D>,
    frame: &Frame<D>,
    observer: &mut dyn Observer,
) -> Result<optimize::Rest> {
    let options = moving(params);
    let mut pass = |potential: &Field<D>, observer: &mut dyn Observer| {
        let extent = frame.extent;
        let mobility = atoms.mobility(extent);
        let mut energy = energy(params, mobility, potential, distance, frame)?;
        optimize::optimize(atoms, &mut *energy, distance, extent, &options, observer)
    };
    for coarse in (1..=params.coarse_passes).rev() {
        let factor = f64::from(1 << coarse);
        // Stopped half way it is rough: the pass over it ends at its first question.
        let smoother = Patience::of(&mut || observer.keep_going(), |patience| {
            smoother(&features.potential, features.sigma, factor, patience)
        });
        let outcome = pass(&smoother, observer)?;
        if outcome.stop == Stop::Interrupted {
            return Ok(outcome);
        }
    }
    pass(&features.potential, observer)
}

/// How the atoms of a job are moved.
pub(crate) fn moving<const D: usize>(params: &Params<D>) -> optimize::Effort {
    optimiser(params.seed).with(params.optimizer, params.kappa != 1.0)
}

/// How atoms are moved by default.
pub(crate) fn optimiser(seed: u64) -> optimize::Effort {
    optimize::Effort {
        seed,
        tolerance: 1e-3,
        // Improvement takes over from here: a second round changes neither quality nor fidelity.
        max_rounds: 1,
        max_evaluations: 40,
        ..optimize::Effort::default()
    }
}

/// A potential whose valleys, of width `sigma`, are `factor` times as wide and as deep as before.
fn smoother<const D: usize>(
    potential: &Field<D>,
    sigma: f64,
    factor: f64,
    patience: &Patience<'_>,
) -> Field<D> {
    let mut wide = potential.clone();
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
    wide
}

/// The report's lines on the optimiser.
pub(super) fn optimisation(outcome: &optimize::Rest, atoms: usize) -> Optimisation {
    let per_atom = 1.0 / atoms as f64;
    Optimisation {
        energy_lattice: outcome.parts.lattice * per_atom,
        energy_image: outcome.parts.image * per_atom,
        energy: outcome.energy_after * per_atom,
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
    use crate::lattice::energy::Beta;

    #[test]
    fn both_evaluators_have_the_energy_of_crowded_atoms() {
        // Rows of atoms 0.6 d apart: what keeps them from crowding is most of their energy.
        let (d, extent) = (10.0, [60.0, 60.0]);
        let atoms: Vec<[f64; 2]> = (0..49)
            .map(|i| [6.0 * f64::from(i % 7) + 12.0, 6.0 * f64::from(i / 7) + 12.0])
            .collect();
        let potential = Field::from_fn([61, 61], [1.0; 2], |x| -0.01 * x[0]);
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
            let mobility = vec![[1.0; 2]; atoms.len()];
            let energy = energy(&params, mobility, &potential, &distance, &frame);
            let mut gradient = vec![[0.0; 2]; atoms.len()];
            energy.unwrap().evaluate(&atoms, &mut gradient)
        });
        // On samples both are exact.
        assert!(pairwise > 1.0, "{pairwise}");
        let off = (pairwise - sampled).abs();
        assert!(off < 1e-4 * pairwise, "{pairwise} {sampled}");
    }
}

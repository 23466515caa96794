//! The energy of a lattice on whose periodic sides atoms are images of others.
//!
//! An image moves with its base. So the energy is a function of the bases alone, and its derivative
//! with respect to a base is the sum of the derivatives with respect to the base and its images. Atoms
//! on a near side thus feel those within reach of both sides.

use super::{Energy, EnergyParts, EnergyTerms};
use crate::error::Result;
use crate::lattice::halo::OwnedAndGhosts;
use crate::mesh::periodic::PeriodicNodes;

/// An energy of which images follow their bases, wherever the minimiser has them.
pub(crate) struct TiedEnergy<'a, const D: usize, E: Energy<D> + ?Sized> {
    energy: Box<E>,
    nodes: &'a PeriodicNodes,
    extent: [f64; D],
}

impl<'a, const D: usize, E: Energy<D> + ?Sized> TiedEnergy<'a, D, E> {
    /// Creates the energy of a lattice in the box `[0, extent]` with these images.
    pub(crate) fn new(energy: Box<E>, nodes: &'a PeriodicNodes, extent: [f64; D]) -> Self {
        Self {
            energy,
            nodes,
            extent,
        }
    }

    /// Returns the positions with images where their bases are.
    fn tied(&self, x: &[[f64; D]]) -> Vec<[f64; D]> {
        let mut tied = x.to_vec();
        self.nodes.follow_bases(&mut tied, self.extent);
        tied
    }

    /// Adds the derivatives of images to those of their bases.
    fn tie_gradient(&self, gradient: &mut [[f64; D]]) {
        for (n, base) in self.nodes.pairs() {
            let derivative = std::mem::replace(&mut gradient[n as usize], [0.0; D]);
            for (sum, g) in gradient[base as usize].iter_mut().zip(derivative) {
                *sum += g;
            }
        }
    }
}

impl<const D: usize, E: Energy<D> + ?Sized> Energy<D> for TiedEnergy<'_, D, E> {
    fn evaluate(&mut self, x: &[[f64; D]], gradient: &mut [[f64; D]]) -> Result<f64> {
        let value = self.energy.evaluate(&self.tied(x), gradient)?;
        self.tie_gradient(gradient);
        Ok(value)
    }

    fn stiffness(&self, x: &[[f64; D]]) -> Vec<f32> {
        let mut stiffness = self.energy.stiffness(&self.tied(x));
        for (n, base) in self.nodes.pairs() {
            stiffness[base as usize] += stiffness[n as usize];
        }
        stiffness
    }

    fn terms(
        &mut self,
        x: &[[f64; D]],
        halo: &OwnedAndGhosts<'_>,
        minimised: f64,
        gradient: &mut [[f64; D]],
    ) -> Result<EnergyTerms> {
        let tied = self.tied(x);
        self.energy.terms(&tied, halo, minimised, gradient)
    }

    fn refresh(&mut self, x: &[[f64; D]]) -> Result<bool> {
        let tied = self.tied(x);
        self.energy.refresh(&tied)
    }

    fn duplicate(&self) -> Box<dyn Energy<D> + Send + '_> {
        Box::new(TiedEnergy::new(
            self.energy.duplicate(),
            self.nodes,
            self.extent,
        ))
    }

    fn parts(&self) -> EnergyParts {
        self.energy.parts()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::distance::Distance;
    use crate::lattice::energy::{Beta, PairwiseEnergy};

    /// Returns a jittered grid in the box `[0, 4]^2` whose opposite sides match.
    fn atoms() -> Vec<[f64; 2]> {
        let jitter = |i: usize, j: usize| 0.2 * ((7 * i + 13 * j) as f64).sin();
        let index = (0..25).map(|n| [n % 5, n / 5]);
        let at = index.map(|[i, j]| {
            let (u, v) = (i % 4, j % 4);
            let x = if u == 0 {
                i as f64
            } else {
                i as f64 + jitter(u, v)
            };
            let y = if v == 0 {
                j as f64
            } else {
                j as f64 + jitter(v, u + 3)
            };
            [x, y]
        });
        at.collect()
    }

    #[test]
    fn the_gradient_is_the_derivative_with_respect_to_bases() {
        let (mut x, extent) = (atoms(), [4.0; 2]);
        let nodes = PeriodicNodes::new(&x, extent, [true; 2]);
        assert_eq!((nodes.unmatched, nodes.pairs().count()), (0, 9));
        let distance = Distance::Constant(1.1);
        let pairs = PairwiseEnergy::new(extent, &distance, None, Beta::Constant(0.0)).unwrap();
        let mut energy = TiedEnergy::new(Box::new(pairs), &nodes, extent);
        let mut gradient = vec![[0.0; 2]; x.len()];
        energy.evaluate(&x, &mut gradient).unwrap();
        let (step, scratch) = (4e-3, &mut vec![[0.0; 2]; x.len()]);
        let (derivatives, start) = (gradient.clone(), x.clone());
        for n in 0..x.len() {
            for k in (0..2).filter(|&k| start[n][k] > 0.0 && start[n][k] < extent[k]) {
                let old = x[n][k];
                let mut value = |offset: f64| {
                    x[n][k] = old + offset;
                    energy.evaluate(&x, scratch).unwrap()
                };
                let expected = (value(step) - value(-step)) / (2.0 * step);
                x[n][k] = old;
                let is_image = nodes.base[n] != n as u32;
                let found = derivatives[n][k];
                assert!(
                    (found - expected).abs() < 5e-3,
                    "{n} {k}: {found} {expected}"
                );
                assert!(!is_image || found == 0.0 && expected == 0.0);
            }
        }
    }
}

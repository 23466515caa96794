//! The potential energy of a lattice of atoms in an image (Hale 2001, 2002), and its gradient.
//!
//! With atoms at x_i, nominal distance d(x), image potential b(x) in [-1, 0] and weight beta:
//!
//! - A = 1/2 sum over i != j of phi(|x_i - x_j| / d(x_j)), the energy between atoms
//! - B = sum over i of b(x_i), the energy of the atoms in the image
//! - P = (1 - beta) A + beta B; where beta is a field, atom i counts with beta(x_i)
//!
//! b aligns atoms *on* features. To align them *alongside* features
//! ([`Alignment`](crate::lattice::seeding::Alignment)), -b takes its place, and mirror images of
//! the atoms stand beyond the sides.
//!
//! - [`pair`]: phi and the force
//! - `neighbours`: the Verlet list
//! - `mirror_images`: mirror images of atoms beyond the sides
//! - `tied`: atoms on periodic sides
//! - [`pairwise`]: the exact energy and gradient from pairs of atoms, the default

pub(crate) mod mirror_images;
pub(crate) mod neighbours;
pub mod pair;
pub mod pairwise;
pub(crate) mod tied;

pub(crate) use neighbours::CHUNK_ATOMS;
pub use pairwise::PairwiseEnergy;

use crate::error::Result;
use crate::image::ScalarField;
use crate::lattice::halo::OwnedAndGhosts;

/// The weight of the image against the lattice: 0 is lattice only, 1 image only.
#[derive(Debug, Clone, PartialEq)]
pub enum Beta<const D: usize> {
    /// One weight everywhere.
    Constant(f64),
    /// A smooth function of position in lattice space.
    Field(ScalarField<D>),
}

impl<const D: usize> Beta<D> {
    /// Returns the [stiffening](pair) that suits beta, or its largest value where beta is a field.
    pub(crate) fn stiffness(&self) -> f32 {
        pair::stiffness(match self {
            Self::Constant(beta) => *beta,
            Self::Field(field) => f64::from(field.samples.iter().copied().fold(0.0, f32::max)),
        })
    }
}

/// The two parts of an energy, unweighted.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EnergyParts {
    /// A, the energy between atoms; A' if it is regularised.
    pub lattice: f64,
    /// B, the energy of atoms in the image; that of -b for alignment alongside features.
    pub image: f64,
}

/// The terms of the energy of a lattice. The optimiser minimises the sum P + stiffening +
/// smoothing.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EnergyTerms {
    /// A between atoms and B in the image, both as published and unweighted.
    pub published: EnergyParts,
    /// P = (1 - beta) A + beta B of the published parts.
    pub energy: f64,
    /// The part of the minimised energy that comes from the [stiffening](pair) of the force between
    /// atoms.
    pub stiffening: f64,
    /// The part of the minimised energy that comes from a regularised energy A' in the place of A.
    pub smoothing: f64,
}

impl EnergyTerms {
    /// Returns the terms without Laplacian coordinates: the part of `minimised` that is not P is
    /// stiffening.
    pub(crate) fn from_pairs(published: EnergyParts, energy: f64, minimised: f64) -> Self {
        Self {
            published,
            energy,
            stiffening: minimised - energy,
            smoothing: 0.0,
        }
    }
}

/// An evaluator of the energy of a lattice.
pub trait Energy<const D: usize> {
    /// Computes P at the positions `x` and, in `gradient`, its derivative with respect to every
    /// coordinate. The two slices have the same length.
    ///
    /// # Errors
    /// Returns an error if the energy cannot be computed.
    fn evaluate(&mut self, x: &[[f64; D]], gradient: &mut [[f64; D]]) -> Result<f64>;

    /// Computes P of a distributed lattice, of which the local atoms are at `x`, and its
    /// derivatives with respect to the coordinates of owned atoms. The derivatives of ghosts are
    /// meaningless. All ranks must call this for the same lattice at the same time.
    ///
    /// # Errors
    /// Returns an error as [`evaluate`](Self::evaluate) does.
    fn evaluate_partition(
        &mut self,
        x: &[[f64; D]],
        halo: &OwnedAndGhosts<'_>,
        gradient: &mut [[f64; D]],
    ) -> Result<f64> {
        debug_assert!(!halo.is_partitioned());
        self.evaluate(x, gradient)
    }

    /// Returns `true` if [`Energy::evaluate_partition`] needs local atoms only, provided that all
    /// atoms within 1.7 d of owned ones are local.
    fn supports_partition(&self) -> bool {
        false
    }

    /// Returns the stiffness with which each atom is held, as a multiple of that of the lattice
    /// alone: a rough estimate by which minimisers scale their steps.
    fn stiffness(&self, x: &[[f64; D]]) -> Vec<f32> {
        vec![1.0; x.len()]
    }

    /// Returns the terms of the energy of the local atoms at `x`, whose value by
    /// [`Energy::evaluate`] is `minimised`. `gradient` has the same length and is scratch memory.
    /// Neither the parts of the last evaluation nor the data frozen in a round change.
    ///
    /// # Errors
    /// Returns an error as [`Energy::evaluate`] does.
    fn terms(
        &mut self,
        x: &[[f64; D]],
        halo: &OwnedAndGhosts<'_>,
        minimised: f64,
        gradient: &mut [[f64; D]],
    ) -> Result<EnergyTerms>;

    /// Updates data that is frozen during a round of an optimisation. It is called with the lattice
    /// at the start of every round. Returns `true` if the energy has changed, so that energies from
    /// before can no longer be compared with it.
    ///
    /// # Errors
    /// Returns an error if the energy of this lattice cannot be computed.
    fn refresh(&mut self, _x: &[[f64; D]]) -> Result<bool> {
        Ok(false)
    }

    /// Returns another evaluator of the same energy, for another thread.
    fn duplicate(&self) -> Box<dyn Energy<D> + Send + '_>;

    /// Returns the parts of the energy of the last call of [`Energy::evaluate`].
    fn parts(&self) -> EnergyParts;
}

//! The potential energy of a lattice of atoms in an image (Hale 2001, 2002), and its gradient.
//!
//! With atoms at x_i, nominal distance d(x), image potential b(x) in [-1, 0] and weight beta:
//!
//! - A = 1/2 sum over i != j of phi(|x_i - x_j| / d(x_j)), the lattice's own energy
//! - B = sum over i of b(x_i), the energy of the atoms in the image
//! - P = (1 - beta) A + beta B; where beta is a field, atom i counts with beta(x_i)
//!
//! b aligns atoms *on* features. To align them *alongside* ([`Alignment`](crate::lattice::seeding::Alignment)),
//! -b takes its place, and mirror images of the atoms stand beyond the sides.
//!
//! - [`pair`]: phi and the force
//! - `neighbours`: the Verlet list
//! - `images`: mirror images of atoms beyond the sides
//! - [`pairwise`]: the exact energy and gradient from pairs of atoms, the default
//! - [`laplacian`]: A joined with how far each atom is from the middle of its Delaunay neighbours
//! - `sampled`: the energy from a field sampled like the image, as first published

pub mod laplacian;
pub(crate) mod mirror_images;
pub(crate) mod neighbours;
pub mod pair;
pub mod pairwise;
pub(crate) mod sampled;

pub use laplacian::RegularisedEnergy;
pub use neighbours::CHUNK_ATOMS;
pub use pairwise::PairwiseEnergy;
pub use sampled::SampledEnergy;

use crate::error::Result;
use crate::image::ScalarField;
use crate::lattice::halo::OwnedAndGhosts;

/// The weight of the image against the lattice: 0 is lattice only, 1 image only.
#[derive(Debug, Clone, PartialEq)]
pub enum Beta<const D: usize> {
    /// The same everywhere.
    Constant(f64),
    /// A smooth function of position in lattice space.
    Field(ScalarField<D>),
}

impl<const D: usize> Beta<D> {
    /// The [stiffening](pair) that suits beta: its largest value where it is a field.
    fn stiffness(&self) -> f32 {
        pair::stiffness(match self {
            Self::Constant(beta) => *beta,
            Self::Field(field) => f64::from(field.samples.iter().copied().fold(0.0, f32::max)),
        })
    }
}

/// The two parts of an energy, unweighted.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EnergyParts {
    /// A, the energy between atoms; A' where it is regularised.
    pub lattice: f64,
    /// B, the energy of atoms in the image; of -b alongside.
    pub image: f64,
}

/// What the energy of a lattice consists of. What is minimised is the sum P + stiffening + smoothing.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EnergyTerms {
    /// A between atoms and B in the image, both as published and unweighted.
    pub published: EnergyParts,
    /// P = (1 - beta) A + beta B of these.
    pub energy: f64,
    /// What the [stiffening](pair) of the force between atoms adds to P.
    pub stiffening: f64,
    /// What A' in the place of A adds to that ([`laplacian`]).
    pub smoothing: f64,
}

impl EnergyTerms {
    /// Without Laplacian coordinates: what of the `minimised` is not P is stiffening.
    fn from_pairs(published: EnergyParts, energy: f64, minimised: f64) -> Self {
        Self {
            published,
            energy,
            stiffening: minimised - energy,
            smoothing: 0.0,
        }
    }
}

/// Something that knows the energy of a lattice.
pub trait Energy<const D: usize> {
    /// Computes P at the positions `x` and, in `gradient`, its derivative with respect to every
    /// coordinate. The two slices have the same length.
    ///
    /// # Errors
    /// If the energy cannot be told.
    fn evaluate(&mut self, x: &[[f64; D]], gradient: &mut [[f64; D]]) -> Result<f64>;

    /// P of a lattice of which some atoms are held here, at `x`, and its derivatives with respect to the coordinates of
    /// own ones; the others' are of no use. All ranks ask for the same lattice at the same time.
    ///
    /// # Errors
    /// As [`evaluate`](Self::evaluate).
    fn evaluate_partition(
        &mut self,
        x: &[[f64; D]],
        held: &OwnedAndGhosts<'_>,
        gradient: &mut [[f64; D]],
    ) -> Result<f64> {
        debug_assert!(!held.is_partitioned());
        self.evaluate(x, gradient)
    }

    /// Whether some of the atoms are enough for that, if all within 1.7 d of own ones are held.
    fn supports_partition(&self) -> bool {
        false
    }

    /// About how many times as stiffly as by the lattice alone each atom is held: a hint by which
    /// minimisers scale their steps.
    fn stiffness(&self, x: &[[f64; D]]) -> Vec<f32> {
        vec![1.0; x.len()]
    }

    /// What the energy of the lattice at `x`, of which these atoms are held and which is `minimised` by
    /// [`Energy::evaluate`], consists of.
    /// What it writes to `gradient`, which is as long, is of no use. Neither the parts of the last
    /// evaluation nor what a round has frozen changes.
    ///
    /// # Errors
    /// As [`Energy::evaluate`].
    fn terms(
        &mut self,
        x: &[[f64; D]],
        held: &OwnedAndGhosts<'_>,
        minimised: f64,
        gradient: &mut [[f64; D]],
    ) -> Result<EnergyTerms>;

    /// Called with the lattice at the start of every round of an optimisation: what is frozen in a
    /// round may change here. Says whether it has, so that energies of before are no longer to be
    /// compared with.
    ///
    /// # Errors
    /// If the lattice is one for which the energy cannot be told.
    fn refresh(&mut self, _x: &[[f64; D]]) -> Result<bool> {
        Ok(false)
    }

    /// Another evaluator of the same energy, for another thread.
    fn duplicate(&self) -> Box<dyn Energy<D> + Send + '_>;

    /// The parts of the energy of the last call of [`Energy::evaluate`].
    fn parts(&self) -> EnergyParts;
}

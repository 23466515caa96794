//! Bounds on the moves of atoms, and random moves within them.

use crate::parallel::prelude::*;

use crate::geometry::random::uniform_signed;
use crate::lattice::distance::Distance;
use crate::lattice::halo::OwnedAndGhosts;
use crate::lattice::seeding::Atoms;

/// Smallest distance of a free coordinate from a side of the box, in units of d.
const MIN_SIDE_DISTANCE: f64 = 0.2;

/// The bounds of a lattice in a box.
pub struct MoveBounds<const D: usize> {
    /// d times mobility of each coordinate, 0 where it is fixed.
    move_scale: Vec<[f32; D]>,
    /// Smallest allowed distance to the sides.
    margin: Vec<f32>,
    extent: [f64; D],
}

impl<const D: usize> MoveBounds<D> {
    /// Computes the bounds for the atoms of a lattice; each coordinate follows its force by its
    /// `mobility`.
    pub fn new(
        atoms: &Atoms<D>,
        distance: &Distance<D>,
        extent: [f64; D],
        mobility: &[[f64; D]],
    ) -> Self {
        let spacing: Vec<f64> = atoms
            .positions
            .par_iter()
            .map(|x| distance.value_at(*x))
            .collect();
        let pairs = mobility.iter().zip(&spacing);
        Self {
            move_scale: pairs.map(|(m, d)| m.map(|m| (m * d) as f32)).collect(),
            margin: spacing
                .iter()
                .map(|d| (MIN_SIDE_DISTANCE * d) as f32)
                .collect(),
            extent,
        }
    }

    /// Returns d times mobility of each coordinate, 0 where it is fixed.
    pub fn move_scale(&self) -> &[[f32; D]] {
        &self.move_scale
    }

    /// Returns the lattice units per scaled unit of each coordinate. They are smaller where an atom
    /// is held stiffly, so that in scaled units all curvatures are alike.
    pub fn scale(&self, stiffness: &[f32]) -> Vec<[f32; D]> {
        let atoms = self.move_scale.iter().zip(stiffness);
        atoms
            .map(|(scale, s)| scale.map(|r| r / s.sqrt()))
            .collect()
    }

    /// Returns the position of atom `n` after a step from `x`, kept in the box. Fixed coordinates
    /// do not change.
    #[inline(always)]
    pub fn apply_step(&self, n: usize, x: &[f64; D], step: [f64; D]) -> [f64; D] {
        let margin = f64::from(self.margin[n]);
        std::array::from_fn(|k| {
            if self.move_scale[n][k] == 0.0 {
                return x[k];
            }
            // An atom that starts nearer to a side may stay, but may not go farther.
            let (low, high) = (margin.min(x[k]), (self.extent[k] - margin).max(x[k]));
            (x[k] + step[k]).clamp(low, high)
        })
    }

    /// Returns the position of atom `n` after a random move of at most `size` d in its free
    /// coordinates. `index` is the atom's index in the lattice.
    #[inline(always)]
    pub fn perturb_atom(
        &self,
        n: usize,
        index: usize,
        x: &[f64; D],
        size: f64,
        key: u64,
    ) -> [f64; D] {
        let axis_size = size / (D as f64).sqrt();
        let step = std::array::from_fn(|k| {
            axis_size
                * uniform_signed(key, (index * D + k) as u64)
                * f64::from(self.move_scale[n][k])
        });
        self.apply_step(n, x, step)
    }

    /// Returns the positions of all local atoms after random moves of at most `size` d.
    pub fn perturb(
        &self,
        x: &[[f64; D]],
        halo: &OwnedAndGhosts<'_>,
        size: f64,
        key: u64,
    ) -> Vec<[f64; D]> {
        let atoms = x.par_iter().enumerate();
        atoms
            .map(|(n, x)| self.perturb_atom(n, halo.global_index(n), x, size, key))
            .collect()
    }
}

//! How far each atom may move, and chance moves within that.

use crate::parallel::prelude::*;

use crate::geometry::random::uniform_signed;
use crate::lattice::distance::Distance;
use crate::lattice::halo::OwnedAndGhosts;
use crate::lattice::seeding::Atoms;

/// Nearest a free coordinate may come to a side of the box, in units of d.
const MIN_SIDE_DISTANCE: f64 = 0.2;

/// The bounds of a lattice in a box.
pub struct MoveBounds<const D: usize> {
    /// d times mobility of each coordinate, 0 where it is held.
    move_scale: Vec<[f32; D]>,
    /// Nearest allowed distance to the sides.
    margin: Vec<f32>,
    extent: [f64; D],
}

impl<const D: usize> MoveBounds<D> {
    /// For the atoms of a lattice, each coordinate of which follows its force by its `mobility`.
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
        let reach = mobility.iter().zip(&spacing);
        Self {
            move_scale: reach.map(|(m, d)| m.map(|m| (m * d) as f32)).collect(),
            margin: spacing
                .iter()
                .map(|d| (MIN_SIDE_DISTANCE * d) as f32)
                .collect(),
            extent,
        }
    }

    /// d times mobility of each coordinate, 0 where it is held.
    pub fn move_scale(&self) -> &[[f32; D]] {
        &self.move_scale
    }

    /// Lattice units per scaled unit of each coordinate: less where an atom is held stiffly, so that
    /// in scaled units all curvatures are alike.
    pub fn scale(&self, stiffness: &[f32]) -> Vec<[f32; D]> {
        let atoms = self.move_scale.iter().zip(stiffness);
        atoms
            .map(|(reach, s)| reach.map(|r| r / s.sqrt()))
            .collect()
    }

    /// The position of atom `n` after a step from `x`, kept in the box; held coordinates stay.
    #[inline(always)]
    pub fn apply_step(&self, n: usize, x: &[f64; D], step: [f64; D]) -> [f64; D] {
        let margin = f64::from(self.margin[n]);
        std::array::from_fn(|k| {
            if self.move_scale[n][k] == 0.0 {
                return x[k];
            }
            // An atom that starts nearer to a side may stay, but not go farther.
            let (low, high) = (margin.min(x[k]), (self.extent[k] - margin).max(x[k]));
            (x[k] + step[k]).clamp(low, high)
        })
    }

    /// Every free coordinate of atom `n`, which has this number in the lattice, moved by chance, the atom by no more
    /// than `size` d.
    #[inline(always)]
    pub fn perturb_atom(
        &self,
        n: usize,
        number: usize,
        x: &[f64; D],
        size: f64,
        key: u64,
    ) -> [f64; D] {
        let share = size / (D as f64).sqrt();
        let moved = std::array::from_fn(|k| {
            share * uniform_signed(key, (number * D + k) as u64) * f64::from(self.move_scale[n][k])
        });
        self.apply_step(n, x, moved)
    }

    /// All atoms held moved by chance, none by more than `size` d.
    pub fn perturb(
        &self,
        x: &[[f64; D]],
        held: &OwnedAndGhosts<'_>,
        size: f64,
        key: u64,
    ) -> Vec<[f64; D]> {
        let atoms = x.par_iter().enumerate();
        atoms
            .map(|(n, x)| self.perturb_atom(n, held.global_index(n), x, size, key))
            .collect()
    }
}

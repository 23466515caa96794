//! The inner loops: pairs of a chunk of atoms and their neighbours, a group at a time.

use std::cell::RefCell;

use pulp::{Simd, WithSimd};

use crate::lattice::energy::neighbours::{
    IntPoint, LANES, MAX_CHUNK_MEMBERS, NeighbourRows, UNREACHABLE_POINT,
};
use crate::lattice::energy::pair::{CUTOFF_RATIO, force, potential};

/// Data of an atom that the general kernel needs in addition to its position.
#[derive(Clone, Copy, Default)]
pub struct AtomParams {
    /// 1 / d(x_i) per fixed-point unit.
    pub inverse_d: f32,
    /// kappa (1 - beta(x_i)).
    pub weight: f32,
}

/// Parameters that fill up groups of neighbours.
pub const FILLER_PARAMS: AtomParams = AtomParams {
    inverse_d: 1.0,
    weight: 0.0,
};

/// Sums over the neighbours of one atom.
#[derive(Clone, Copy, Default)]
pub struct NeighbourSums {
    /// Sum of phi(r / d_j).
    pub potential: f32,
    /// Derivative of the energy with respect to the atom's position at fixed d, per unit length.
    pub position_derivative: [f32; 3],
    /// Derivative with respect to ln d_i.
    pub log_d_derivative: f32,
}

/// Working memory of a thread: data of the members of a chunk that the kernels need.
pub struct ChunkScratch {
    pub points: Vec<IntPoint>,
    pub params: Vec<AtomParams>,
    pub sums: Vec<NeighbourSums>,
}

thread_local! {
    pub static CHUNK_SCRATCH: RefCell<ChunkScratch> = RefCell::new(ChunkScratch {
        points: vec![UNREACHABLE_POINT; MAX_CHUNK_MEMBERS],
        params: Vec::new(),
        sums: Vec::new(),
    });
}

impl ChunkScratch {
    /// Copies the points and parameters of a chunk's members together.
    pub fn load_chunk(&mut self, rows: &NeighbourRows, points: &[IntPoint], params: &[AtomParams]) {
        for (local, &member) in self.points.iter_mut().zip(&rows.members) {
            *local = points[member as usize];
        }
        if !params.is_empty() {
            self.params.resize(MAX_CHUNK_MEMBERS, FILLER_PARAMS);
            for (local, &member) in self.params.iter_mut().zip(&rows.members) {
                *local = params[member as usize];
            }
        }
    }
}

/// Returns `x` clamped to `[low, high]` as [`f32::clamp`] does, in two instructions.
#[inline(always)]
fn fast_clamp(x: f32, low: f32, high: f32) -> f32 {
    let x = if x > low { x } else { low };
    if x < high { x } else { high }
}

/// Returns the sum of a group.
#[inline(always)]
fn sum_lanes(lanes: &[f32; LANES]) -> f32 {
    let pair_sums: [f32; 4] = std::array::from_fn(|l| lanes[l] + lanes[l + 4]);
    (pair_sums[0] + pair_sums[2]) + (pair_sums[1] + pair_sums[3])
}

/// Returns the differences x_j - x_i of a group of neighbours, one array an axis.
#[inline(always)]
fn differences(points: &[IntPoint], centre: &IntPoint, group: &[u16; LANES]) -> [[f32; LANES]; 3] {
    let p = group.map(|j| points[j as usize]);
    std::array::from_fn(|k| std::array::from_fn(|l| p[l][k].wrapping_sub(centre[k]) as f32))
}

/// The pairs of a chunk where every atom has the same d; the result is A.
pub struct ConstantDistanceKernel<'a, const D: usize> {
    pub points: &'a [IntPoint],
    pub rows: &'a NeighbourRows,
    /// 1 / d per fixed-point unit.
    pub inverse_d: f32,
    pub stiffness: f32,
    /// kappa (1 - beta) / d.
    pub weight: f64,
    pub gradient: &'a mut [[f64; D]],
}

impl<const D: usize> WithSimd for ConstantDistanceKernel<'_, D> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        // The compiler knows this length, so that no index needs a check.
        let points = &self.points[..MAX_CHUNK_MEMBERS];
        let (inverse, stiffness) = (self.inverse_d, self.stiffness);
        let mut total = 0.0;
        for ((row, gradient), centre) in self.rows.iter().zip(self.gradient).zip(points) {
            let mut energy = [0.0f32; LANES];
            let mut derivative = [[0.0f32; LANES]; 3];
            for group in row {
                let step = differences(points, centre, group);
                for l in 0..LANES {
                    let v: [f32; 3] = std::array::from_fn(|k| step[k][l] * inverse);
                    let u2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
                    // The lower limit avoids an infinite force between atoms at one place; they do
                    // not push each other.
                    let u = fast_clamp(u2, 1e-12, CUTOFF_RATIO * CUTOFF_RATIO).sqrt();
                    energy[l] += potential(u, stiffness);
                    let f = force(u, stiffness) / u;
                    for k in 0..3 {
                        derivative[k][l] += f * v[k];
                    }
                }
            }
            total += f64::from(sum_lanes(&energy));
            *gradient = std::array::from_fn(|k| self.weight * f64::from(sum_lanes(&derivative[k])));
        }
        0.5 * total
    }
}

/// The pairs of a chunk where d and beta may differ from atom to atom.
pub struct VariableDistanceKernel<'a> {
    pub points: &'a [IntPoint],
    pub params: &'a [AtomParams],
    pub rows: &'a NeighbourRows,
    pub stiffness: f32,
    pub sums: &'a mut [NeighbourSums],
}

impl WithSimd for VariableDistanceKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let (points, params) = (
            &self.points[..MAX_CHUNK_MEMBERS],
            &self.params[..MAX_CHUNK_MEMBERS],
        );
        let stiffness = self.stiffness;
        let atoms = self
            .rows
            .iter()
            .zip(self.sums)
            .zip(points.iter().zip(params));
        for ((row, sums), (centre, centre_params)) in atoms {
            let mut energy = [0.0f32; LANES];
            let mut log_d_derivative = [0.0f32; LANES];
            let mut derivative = [[0.0f32; LANES]; 3];
            for group in row {
                let step = differences(points, centre, group);
                let neighbour_params = group.map(|j| params[j as usize]);
                for l in 0..LANES {
                    let v: [f32; 3] = std::array::from_fn(|k| step[k][l] * centre_params.inverse_d);
                    let r2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
                    let r = fast_clamp(r2, 1e-12, f32::MAX).sqrt();
                    // r is in units of the atom's own d; the neighbour's d differs.
                    let ratio = neighbour_params[l].inverse_d / centre_params.inverse_d;
                    energy[l] += potential(r * ratio, stiffness);
                    let centre_force = neighbour_params[l].weight * force(r, stiffness);
                    let neighbour_force =
                        centre_params.weight * force(r * ratio, stiffness) * ratio;
                    log_d_derivative[l] += centre_force * fast_clamp(r, 0.0, CUTOFF_RATIO);
                    let f = (centre_force + neighbour_force) / r * centre_params.inverse_d;
                    for k in 0..3 {
                        derivative[k][l] += f * v[k];
                    }
                }
            }
            *sums = NeighbourSums {
                potential: sum_lanes(&energy),
                position_derivative: derivative.map(|lanes| sum_lanes(&lanes)),
                log_d_derivative: sum_lanes(&log_d_derivative),
            };
        }
    }
}

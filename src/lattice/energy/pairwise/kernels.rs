//! The inner loops: pairs of a chunk of atoms and their neighbours, a group at a time.

use std::cell::RefCell;

use pulp::{Simd, WithSimd};

use crate::lattice::energy::neighbours::{LANES, MEMBERS, NOWHERE, Point, Rows};
use crate::lattice::energy::pair::{CUTOFF, force, potential};

/// What the general kernel must know of each atom besides its position.
#[derive(Clone, Copy, Default)]
pub struct Site {
    /// 1 / d(x_i) per fixed-point unit.
    pub inverse: f32,
    /// kappa (1 - beta(x_i)).
    pub weight: f32,
}

/// What fills up groups of neighbours.
pub const NO_SITE: Site = Site {
    inverse: 1.0,
    weight: 0.0,
};

/// Sums over the neighbours of one atom.
#[derive(Clone, Copy, Default)]
pub struct Sums {
    /// Sum of phi(r / d_j).
    pub potential: f32,
    /// Derivative of the energy with respect to the atom's position at fixed d, per unit length.
    pub pull: [f32; 3],
    /// Derivative with respect to ln d_i.
    pub swell: f32,
}

/// Working memory of a thread: what the kernels must know of the members of a chunk.
pub struct Local {
    pub points: Vec<Point>,
    pub sites: Vec<Site>,
    pub sums: Vec<Sums>,
}

thread_local! {
    pub static LOCAL: RefCell<Local> = RefCell::new(Local {
        points: vec![NOWHERE; MEMBERS],
        sites: Vec::new(),
        sums: Vec::new(),
    });
}

impl Local {
    /// Copies together what belongs to a chunk.
    pub fn take(&mut self, rows: &Rows, points: &[Point], sites: &[Site]) {
        for (local, &member) in self.points.iter_mut().zip(&rows.members) {
            *local = points[member as usize];
        }
        if !sites.is_empty() {
            self.sites.resize(MEMBERS, NO_SITE);
            for (local, &member) in self.sites.iter_mut().zip(&rows.members) {
                *local = sites[member as usize];
            }
        }
    }
}

/// `x` within `[low, high]`: what [`f32::clamp`] gives, in two instructions.
#[inline(always)]
fn clamp(x: f32, low: f32, high: f32) -> f32 {
    let x = if x > low { x } else { low };
    if x < high { x } else { high }
}

/// The sum of a group.
#[inline(always)]
fn sum(lanes: &[f32; LANES]) -> f32 {
    let four: [f32; 4] = std::array::from_fn(|l| lanes[l] + lanes[l + 4]);
    (four[0] + four[2]) + (four[1] + four[3])
}

/// The differences x_j - x_i of a group of neighbours, one array an axis.
#[inline(always)]
fn differences(points: &[Point], centre: &Point, group: &[u16; LANES]) -> [[f32; LANES]; 3] {
    let p = group.map(|j| points[j as usize]);
    std::array::from_fn(|k| std::array::from_fn(|l| p[l][k].wrapping_sub(centre[k]) as f32))
}

/// The pairs of a chunk where every atom has the same d; the result is A.
pub struct SameDistance<'a, const D: usize> {
    pub points: &'a [Point],
    pub rows: &'a Rows,
    /// 1 / d per fixed-point unit.
    pub inverse: f32,
    pub stiffness: f32,
    /// kappa (1 - beta) / d.
    pub weight: f64,
    pub gradient: &'a mut [[f64; D]],
}

impl<const D: usize> WithSimd for SameDistance<'_, D> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        // A length that the compiler knows, so that no index needs a check.
        let points = &self.points[..MEMBERS];
        let (inverse, stiffness) = (self.inverse, self.stiffness);
        let mut total = 0.0;
        for ((row, gradient), centre) in self.rows.iter().zip(self.gradient).zip(points) {
            let mut energy = [0.0f32; LANES];
            let mut pull = [[0.0f32; LANES]; 3];
            for group in row {
                let step = differences(points, centre, group);
                for l in 0..LANES {
                    let v: [f32; 3] = std::array::from_fn(|k| step[k][l] * inverse);
                    let u2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
                    // Atoms at one place push each other nowhere rather than to infinity.
                    let u = clamp(u2, 1e-12, CUTOFF * CUTOFF).sqrt();
                    energy[l] += potential(u, stiffness);
                    let f = force(u, stiffness) / u;
                    for k in 0..3 {
                        pull[k][l] += f * v[k];
                    }
                }
            }
            total += f64::from(sum(&energy));
            *gradient = std::array::from_fn(|k| self.weight * f64::from(sum(&pull[k])));
        }
        0.5 * total
    }
}

/// The pairs of a chunk where d and beta may differ from atom to atom.
pub struct AnyDistance<'a> {
    pub points: &'a [Point],
    pub sites: &'a [Site],
    pub rows: &'a Rows,
    pub stiffness: f32,
    pub sums: &'a mut [Sums],
}

impl WithSimd for AnyDistance<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let (points, sites) = (&self.points[..MEMBERS], &self.sites[..MEMBERS]);
        let stiffness = self.stiffness;
        let atoms = self
            .rows
            .iter()
            .zip(self.sums)
            .zip(points.iter().zip(sites));
        for ((row, sums), (centre, own)) in atoms {
            let mut energy = [0.0f32; LANES];
            let mut swell = [0.0f32; LANES];
            let mut pull = [[0.0f32; LANES]; 3];
            for group in row {
                let step = differences(points, centre, group);
                let other = group.map(|j| sites[j as usize]);
                for l in 0..LANES {
                    let v: [f32; 3] = std::array::from_fn(|k| step[k][l] * own.inverse);
                    let r2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
                    let r = clamp(r2, 1e-12, f32::MAX).sqrt();
                    // r is in units of the own d; the other's units differ.
                    let ratio = other[l].inverse / own.inverse;
                    energy[l] += potential(r * ratio, stiffness);
                    let own_force = other[l].weight * force(r, stiffness);
                    let other_force = own.weight * force(r * ratio, stiffness) * ratio;
                    swell[l] += own_force * clamp(r, 0.0, CUTOFF);
                    let f = (own_force + other_force) / r * own.inverse;
                    for k in 0..3 {
                        pull[k][l] += f * v[k];
                    }
                }
            }
            *sums = Sums {
                potential: sum(&energy),
                pull: pull.map(|lanes| sum(&lanes)),
                swell: sum(&swell),
            };
        }
    }
}

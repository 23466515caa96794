//! The exact energy and gradient, from pairs of atoms.
//!
//! Cost is about 20 pairs an atom, whatever d is in samples. The gradient is the exact derivative of
//! the energy, with the derivatives of b(x), of a variable d(x) and of a variable beta(x) in it: with
//! d_j = d(x_j), w_i = 1 - beta(x_i) and A_i = 1/2 sum over j of phi(r_ij / d_j),
//!
//! ```text
//! P         = sum_i w_i A_i + beta(x_i) b(x_i)
//! dP / dx_k = 1/2 sum_j (w_k f(r/d_j) / d_j + w_j f(r/d_k) / d_k) (x_j - x_k) / r     moving x_k
//!           + 1/2 sum_j w_j f(r/d_k) r / d_k^2  grad d(x_k)                           changing d_k
//!           + (b(x_k) - A_k) grad beta(x_k) + beta(x_k) grad b(x_k)
//! ```
//!
//! Alongside, j runs over mirror images as well ([`Images`]), which by symmetry leaves the formulas as
//! they are, and -b takes the place of b.
//!
//! Distances are computed in `f32` from fixed-point positions ([`FixedPoint`]) and summed in a fixed
//! order, so the result is the same for any number of threads and on any machine.

use std::cell::RefCell;

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::image_term::ImageTerm;
use super::images::Images;
use super::neighbours::{CHUNK, FixedPoint, LANES, MEMBERS, NOWHERE, Neighbours, Point, Rows};
use super::pair::{CUTOFF, force, potential};
use super::{Beta, Energy, Parts};
use crate::error::{Error, Result, cause};
use crate::image::Field;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::Alignment;

/// Width of the Verlet list beyond the cut-off, in units of d. The third shell of an FCC lattice is
/// at 1.73 d, so a regular lattice gets no more pairs from it.
const SKIN: f32 = 0.2;

/// The neighbour list is repaired if at most one atom in this many has moved far, else built anew.
const FEW: usize = 4;

/// What the general kernel must know of each atom besides its position.
#[derive(Clone, Copy, Default)]
struct Site {
    /// 1 / d(x_i) per fixed-point unit.
    inverse: f32,
    /// kappa (1 - beta(x_i)).
    weight: f32,
}

/// What fills up groups of neighbours.
const NO_SITE: Site = Site {
    inverse: 1.0,
    weight: 0.0,
};

/// Sums over the neighbours of one atom.
#[derive(Clone, Copy, Default)]
struct Sums {
    /// Sum of phi(r / d_j).
    potential: f32,
    /// Derivative of the energy with respect to the atom's position at fixed d, per unit length.
    pull: [f32; 3],
    /// Derivative with respect to ln d_i.
    swell: f32,
}

/// The exact evaluator of the lattice energy.
#[derive(Clone)]
pub struct Pairwise<'a, const D: usize> {
    distance: &'a Distance<D>,
    image: Option<ImageTerm<'a, D>>,
    beta: Beta<D>,
    alignment: Alignment,
    fixed: FixedPoint,
    /// Largest |grad d|.
    slope: f64,
    neighbours: Neighbours,
    images: Images,
    /// Positions at the last evaluation: of atoms, then of images.
    points: Vec<Point>,
    /// Positions and reaches for which the neighbours are listed.
    listed: Vec<Point>,
    reach: Vec<f32>,
    /// For the general kernel only.
    sites: Vec<Site>,
    parts: Parts,
    relisted: usize,
    stiffness: f32,
    /// What A counts for.
    kappa: f64,
}

impl<'a, const D: usize> Pairwise<'a, D> {
    /// An evaluator for atoms in the box `[0, extent]`, for `D` of 2 or 3. Without a `potential` the
    /// image has no part in the energy (b = 0).
    ///
    /// # Errors
    /// [`Error::Optimize`] if beta leaves [0, 1].
    pub fn new(
        extent: [f64; D],
        distance: &'a Distance<D>,
        potential: Option<&'a Field<D>>,
        beta: Beta<D>,
    ) -> Result<Self> {
        let range = match &beta {
            Beta::Constant(beta) => (*beta, *beta),
            Beta::Field(field) => field.samples.iter().fold((0.0, 1.0), |(low, high), &b| {
                (f64::from(b).min(low), f64::from(b).max(high))
            }),
        };
        let finite = match &beta {
            Beta::Constant(beta) => beta.is_finite(),
            Beta::Field(field) => field.samples.iter().all(|b| b.is_finite()),
        };
        if !(finite && range.0 >= 0.0 && range.1 <= 1.0) {
            return Err(Error::Optimize(cause(
                "beta",
                format!("ranges from {} to {}", range.0, range.1),
                "give a weight between 0 (lattice only) and 1 (image only)",
            )));
        }
        let fixed = FixedPoint::new(&extent);
        Ok(Self {
            distance,
            image: potential.map(ImageTerm::new),
            beta,
            alignment: Alignment::On,
            fixed,
            slope: largest_slope(distance),
            neighbours: Neighbours::default(),
            images: Images::new(fixed.of(&extent), D),
            points: Vec::new(),
            listed: Vec::new(),
            reach: Vec::new(),
            sites: Vec::new(),
            parts: Parts::default(),
            relisted: 0,
            stiffness: 0.0,
            kappa: 1.0,
        })
    }

    /// Where atoms shall end up, [`Alignment::On`] at first. [`Alignment::Alongside`], -b takes the
    /// place of b, and mirror images of the atoms beyond the sides act on those inside.
    pub fn aligned(mut self, alignment: Alignment) -> Self {
        self.alignment = alignment;
        self
    }

    /// Keeps atoms from crowding on features, by the stiffening that suits beta (its largest value
    /// where it is a field); see [`pair`](super::pair). Recommended for any but the shortest
    /// minimisation.
    pub fn uncrowded(self) -> Self {
        let stiffness = self.beta.stiffness();
        self.stiffened(stiffness)
    }

    /// Makes atoms nearer than d push each other apart harder than the potential as published does;
    /// 0, as at first, for the potential as published.
    pub fn stiffened(mut self, stiffness: f32) -> Self {
        self.stiffness = stiffness.max(0.0);
        self
    }

    /// Makes A count for `kappa` of what it is, so that P = (1 - beta) kappa A + beta B.
    pub(super) fn counting(mut self, kappa: f64) -> Self {
        self.kappa = kappa;
        self
    }

    /// How many points' neighbours have been listed anew because the point had moved, in all.
    pub fn relisted(&self) -> usize {
        self.relisted
    }

    /// d in fixed-point units, if it is the same everywhere.
    fn constant(&self) -> Option<f32> {
        match self.distance {
            Distance::Constant(d) => Some((*d * self.fixed.scale) as f32),
            Distance::Field(_) => None,
        }
    }

    /// d of a point in fixed-point units.
    fn d(&self, point: usize) -> f32 {
        let constant = self.constant();
        constant.unwrap_or_else(|| 1.0 / self.sites[point].inverse)
    }

    /// How far a pair may be apart so that one of the two, of reach `reach`, is listed.
    fn widest(&self, reach: f32) -> f32 {
        let slope = f64::from(CUTOFF + SKIN) * self.slope;
        reach / (1.0 - slope as f32).max(1e-3)
    }

    /// Takes over new positions and brings the neighbour list up to date.
    ///
    /// The list holds all pairs nearer than 1.5 d + skin (of either atom) at the positions `listed`.
    /// An atom that has moved, or whose d has grown, by more than half its skin in all gets a new
    /// listed position. So a pair left out is never nearer than 1.5 d: both together have used up at
    /// most the larger skin.
    fn update(&mut self, x: &[[f64; D]]) {
        let count = x.len();
        if self.points.len() != count + self.images.len() {
            // Other atoms than before.
            self.images.rebuild(&[], |_| 0.0);
            self.points = vec![NOWHERE; count];
            self.listed.clear();
        }
        let fixed = self.fixed;
        let (atoms, images) = self.points.split_at_mut(count);
        let chunks = atoms.par_chunks_mut(CHUNK).zip(x.par_chunks(CHUNK));
        chunks.for_each(|(points, x)| {
            for (point, x) in points.iter_mut().zip(x) {
                *point = fixed.of(x);
            }
        });
        self.images.place(atoms, images);
        if self.constant().is_none() || matches!(self.beta, Beta::Field(_)) {
            self.update_sites(x);
        }
        if self.listed.is_empty() {
            return self.list_all(count);
        }
        let far = |&n: &u32| {
            let n = n as usize;
            let old_d = self.reach[n] / (CUTOFF + SKIN);
            let step = |k: usize| (self.points[n][k] - self.listed[n][k]) as f32;
            let distance = (step(0) * step(0) + step(1) * step(1) + step(2) * step(2)).sqrt();
            distance + CUTOFF * (self.d(n) - old_d).max(0.0) > 0.5 * SKIN * old_d
        };
        let moved: Vec<u32> = (0..self.points.len() as u32)
            .into_par_iter()
            .with_min_len(CHUNK)
            .filter(far)
            .collect();
        if moved.is_empty() {
            return;
        }
        let has_images = |&&n: &&u32| {
            let n = n as usize;
            let reach = self.widest((CUTOFF + SKIN) * self.d(n));
            n >= count || self.images.suffice(n, &self.points[n], reach)
        };
        let alongside = self.alignment == Alignment::Alongside;
        if moved.len() > self.points.len() / FEW
            || alongside && !moved.iter().all(|n| has_images(&n))
        {
            return self.list_all(count);
        }
        self.relisted += moved.len();
        for &n in &moved {
            self.listed[n as usize] = self.points[n as usize];
            self.reach[n as usize] = (CUTOFF + SKIN) * self.d(n as usize);
        }
        let slope = (f64::from(CUTOFF + SKIN) * self.slope) as f32;
        let images = &self.images;
        let partner = |i, j| images.partner(count, i, j);
        self.neighbours
            .repair(&self.listed, count, &self.reach, slope, &moved, partner);
    }

    /// Lists the neighbours of all atoms anew, and finds the images that they need.
    fn list_all(&mut self, count: usize) {
        if self.alignment == Alignment::Alongside {
            let mut images = std::mem::take(&mut self.images);
            let reach = |n: usize| self.widest((CUTOFF + SKIN) * self.d(n));
            images.rebuild(&self.points[..count], reach);
            self.points.resize(count + images.len(), NOWHERE);
            let (atoms, mirrored) = self.points.split_at_mut(count);
            images.place(atoms, mirrored);
            self.images = images;
            self.copy_sites(count);
        }
        self.listed.clone_from(&self.points);
        let reach = |n| (CUTOFF + SKIN) * self.d(n);
        self.reach = (0..self.points.len()).map(reach).collect();
        let slope = (f64::from(CUTOFF + SKIN) * self.slope) as f32;
        self.neighbours
            .build(&self.listed, count, &self.reach, slope);
        self.relisted += self.points.len();
    }

    /// d and beta of every atom, for the general kernel.
    fn update_sites(&mut self, x: &[[f64; D]]) {
        let (distance, beta, scale) = (self.distance, &self.beta, self.fixed.scale);
        let kappa = self.kappa;
        self.sites.resize(x.len(), NO_SITE);
        let sites = self.sites.par_iter_mut().zip(x).with_min_len(CHUNK);
        sites.for_each(|(site, x)| {
            let beta = match beta {
                Beta::Constant(beta) => *beta,
                Beta::Field(field) => field.value(*x),
            };
            let inverse = 1.0 / (distance.at(*x) * scale);
            *site = Site {
                inverse: inverse as f32,
                weight: (kappa * (1.0 - beta)) as f32,
            };
        });
        self.copy_sites(x.len());
    }

    /// Images have the d and beta of their atoms.
    fn copy_sites(&mut self, count: usize) {
        if !self.sites.is_empty() {
            self.sites.truncate(count);
            for atom in self.images.atoms() {
                self.sites.push(self.sites[atom]);
            }
        }
    }

    /// A, B and P of a chunk of atoms at `x`, and their gradient.
    fn evaluate_chunk(
        &self,
        rows: &Rows,
        x: &[[f64; D]],
        gradient: &mut [[f64; D]],
        local: &mut Local,
    ) -> [f64; 3] {
        local.take(rows, &self.points, &self.sites);
        let sign = match self.alignment {
            Alignment::On => 1.0,
            Alignment::Alongside => -1.0,
        };
        let image_at = |x: &[f64; D]| self.image.as_ref().and_then(|image| image.at(*x));
        let (scale, stiffness, kappa) = (self.fixed.scale, self.stiffness, self.kappa);
        let mut total = [0.0f64; 3];
        if let (Distance::Constant(d), Beta::Constant(beta)) = (self.distance, &self.beta) {
            total[0] = Arch::new().dispatch(SameDistance {
                points: &local.points,
                rows,
                inverse: (1.0 / (d * scale)) as f32,
                stiffness,
                weight: kappa * (1.0 - beta) / d,
                gradient: &mut *gradient,
            });
            for (x, gradient) in x.iter().zip(gradient) {
                if let Some((b, slope)) = image_at(x) {
                    total[1] += sign * b;
                    for k in 0..D {
                        gradient[k] += sign * beta * slope[k];
                    }
                }
            }
            total[2] = kappa * (1.0 - beta) * total[0] + beta * total[1];
            return total;
        }
        local.sums.resize(x.len(), Sums::default());
        Arch::new().dispatch(AnyDistance {
            points: &local.points,
            sites: &local.sites,
            rows,
            stiffness,
            sums: &mut local.sums,
        });
        for ((sums, x), gradient) in local.sums.iter().zip(x).zip(gradient) {
            let (d, d_slope) = self.distance.at_with_gradient(*x);
            let (beta, beta_slope) = match &self.beta {
                Beta::Constant(beta) => (*beta, [0.0; D]),
                Beta::Field(field) => field.value_and_gradient(*x),
            };
            let (b, b_slope) = image_at(x).unwrap_or((0.0, [0.0; D]));
            let (a, b) = (0.5 * f64::from(sums.potential), sign * b);
            total[0] += a;
            total[1] += b;
            total[2] += kappa * (1.0 - beta) * a + beta * b;
            *gradient = std::array::from_fn(|k| {
                0.5 * f64::from(sums.pull[k]) * scale
                    + 0.5 * f64::from(sums.swell) / d * d_slope[k]
                    + (b - kappa * a) * beta_slope[k]
                    + sign * beta * b_slope[k]
            });
        }
        total
    }
}

impl<const D: usize> Energy<D> for Pairwise<'_, D> {
    fn evaluate(&mut self, x: &[[f64; D]], gradient: &mut [[f64; D]]) -> f64 {
        self.update(x);
        let chunks = self.neighbours.chunks.par_iter();
        let sums: Vec<[f64; 3]> = chunks
            .zip(gradient.par_chunks_mut(CHUNK))
            .zip(x.par_chunks(CHUNK))
            .map(|((rows, gradient), x)| {
                LOCAL.with_borrow_mut(|local| self.evaluate_chunk(rows, x, gradient, local))
            })
            .collect();
        let total = sums
            .iter()
            .fold([0.0; 3], |t, s| [t[0] + s[0], t[1] + s[1], t[2] + s[2]]);
        self.parts = Parts {
            lattice: total[0],
            image: total[1],
        };
        // Only where d varies without any measure: some pairs are missing.
        if self.neighbours.chunks.iter().any(|rows| rows.overflowed) {
            return f64::NAN;
        }
        total[2]
    }

    fn stiffness(&self, x: &[[f64; D]]) -> Vec<f32> {
        // In units of d the curvature of the lattice is 4 (1 - beta) and that of a valley of depth 1
        // and width d / 4 is 16 beta.
        let Some(image) = &self.image else {
            return vec![1.0; x.len()];
        };
        let at = |x: &[f64; D]| {
            let beta = match &self.beta {
                Beta::Constant(beta) => *beta,
                Beta::Field(field) => field.value(*x),
            };
            let depth = image.at(*x).map_or(0.0, |(b, _)| b.abs());
            (1.0 + 4.0 * beta / (1.0 - beta).max(0.05) * depth) as f32
        };
        x.par_iter().with_min_len(CHUNK).map(at).collect()
    }

    fn twin(&self) -> Box<dyn Energy<D> + Send + '_> {
        Box::new(self.clone())
    }

    fn parts(&self) -> Parts {
        self.parts
    }
}

/// Working memory of a thread: what the kernels must know of the members of a chunk.
struct Local {
    points: Vec<Point>,
    sites: Vec<Site>,
    sums: Vec<Sums>,
}

thread_local! {
    static LOCAL: RefCell<Local> = RefCell::new(Local {
        points: vec![NOWHERE; MEMBERS],
        sites: Vec::new(),
        sums: Vec::new(),
    });
}

impl Local {
    /// Copies together what belongs to a chunk.
    fn take(&mut self, rows: &Rows, points: &[Point], sites: &[Site]) {
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
struct SameDistance<'a, const D: usize> {
    points: &'a [Point],
    rows: &'a Rows,
    /// 1 / d per fixed-point unit.
    inverse: f32,
    stiffness: f32,
    /// kappa (1 - beta) / d.
    weight: f64,
    gradient: &'a mut [[f64; D]],
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
struct AnyDistance<'a> {
    points: &'a [Point],
    sites: &'a [Site],
    rows: &'a Rows,
    stiffness: f32,
    sums: &'a mut [Sums],
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

/// A bound on |grad d|, from the largest difference between neighbouring samples along each axis: d
/// is interpolated linearly between them.
fn largest_slope<const D: usize>(distance: &Distance<D>) -> f64 {
    let Distance::Field(field) = distance else {
        return 0.0;
    };
    let mut total = 0.0;
    let mut stride = 1;
    for k in 0..D {
        let steepest = field
            .samples
            .par_iter()
            .zip(field.samples.par_iter().skip(stride))
            .enumerate()
            .filter(|(n, _)| n / stride % field.dims[k] + 1 < field.dims[k])
            .map(|(_, (a, b))| (b - a).abs())
            .reduce(|| 0.0, f32::max);
        total += (f64::from(steepest) / field.step[k]).powi(2);
        stride *= field.dims[k];
    }
    total.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cubic convolution from its definition, in `f64` and one axis after the other.
    fn interpolate<const D: usize>(field: &Field<D>, x: &[f64; D]) -> f64 {
        let keys = |s: f64| match s.abs() {
            s if s < 1.0 => 1.5 * s.powi(3) - 2.5 * s * s + 1.0,
            s if s < 2.0 => -0.5 * s.powi(3) + 2.5 * s * s - 4.0 * s + 2.0,
            _ => 0.0,
        };
        let mut sum = 0.0;
        for tap in 0..6usize.pow(D as u32) {
            let (mut flat, mut stride, mut rest, mut weight) = (0, 1, tap, 1.0);
            for k in 0..D {
                let index = x[k] / field.step[k];
                let at = index.floor() + (rest % 6) as f64 - 2.0;
                rest /= 6;
                weight *= keys(index - at);
                flat += stride * at.clamp(0.0, (field.dims[k] - 1) as f64) as usize;
                stride *= field.dims[k];
            }
            sum += weight * f64::from(field.samples[flat]);
        }
        sum
    }

    /// What the tests evaluate.
    struct Case<'a, const D: usize> {
        extent: [f64; D],
        distance: &'a Distance<D>,
        potential: &'a Field<D>,
        beta: Beta<D>,
        stiffness: f32,
        alignment: Alignment,
    }

    impl<const D: usize> Case<'_, D> {
        /// The terms of the energy that atom `n` has a part in, straight from the definition: those
        /// it shares with other atoms, and its own.
        fn terms(&self, x: &[[f64; D]], n: usize) -> (f64, f64) {
            let phi = |u: f64| {
                let u = u.min(1.5);
                153.0 / 256.0 - 9.0 / 8.0 * u + 19.0 / 24.0 * u.powi(3) - 5.0 / 16.0 * u.powi(4)
                    + f64::from(self.stiffness) / 3.0 * (1.0 - u).max(0.0).powi(3)
            };
            let beta = |x: &[f64; D]| match &self.beta {
                Beta::Constant(beta) => *beta,
                Beta::Field(field) => interpolate(field, x),
            };
            let (own_d, own_beta) = (self.distance.at(x[n]), beta(&x[n]));
            let (images, sign) = match self.alignment {
                Alignment::On => (1, 1.0),
                Alignment::Alongside => (3usize.pow(D as u32), -1.0),
            };
            let (mut shared, mut own) = (0.0, sign * own_beta * interpolate(self.potential, &x[n]));
            let reach = 1.6 * self.distance.max();
            for (j, other) in x.iter().enumerate() {
                // The atom itself first, then mirrored in near (1) and far (2) sides.
                for image in 0..images {
                    let mirrored = |k: usize| match image / 3usize.pow(k as u32) % 3 {
                        0 => other[k],
                        1 => -other[k],
                        _ => 2.0 * self.extent[k] - other[k],
                    };
                    let r2: f64 = (0..D).map(|k| (x[n][k] - mirrored(k)).powi(2)).sum();
                    let r = r2.sqrt();
                    if r > reach {
                        continue;
                    }
                    let with_other = 0.5 * (1.0 - own_beta) * phi(r / self.distance.at(*other));
                    if j != n {
                        shared += with_other + 0.5 * (1.0 - beta(other)) * phi(r / own_d);
                    } else if image > 0 {
                        own += with_other;
                    }
                }
            }
            (shared, own)
        }

        /// Relative errors of the evaluator: of its gradient against differences of the definition
        /// (of some atoms, in the Euclidean norm), and of its energy.
        fn errors(&self, x: &[[f64; D]]) -> (f64, f64) {
            let potential = Some(self.potential);
            let mut evaluator =
                Pairwise::new(self.extent, self.distance, potential, self.beta.clone()).unwrap();
            evaluator = evaluator.stiffened(self.stiffness).aligned(self.alignment);
            let mut gradient = vec![[0.0; D]; x.len()];
            let energy = evaluator.evaluate(x, &mut gradient);
            let mut truth = 0.0;
            for n in 0..x.len() {
                let (shared, own) = self.terms(x, n);
                truth += 0.5 * shared + own;
            }
            let (mut error2, mut size2) = (0.0, 0.0);
            let mut y = x.to_vec();
            for n in (0..x.len()).step_by(x.len() / 40) {
                for k in 0..D {
                    let h = 1e-5;
                    y[n][k] = x[n][k] + h;
                    let up = self.terms(&y, n);
                    y[n][k] = x[n][k] - h;
                    let down = self.terms(&y, n);
                    let slope = (up.0 - down.0 + up.1 - down.1) / (2.0 * h);
                    y[n][k] = x[n][k];
                    error2 += (slope - gradient[n][k]).powi(2);
                    size2 += slope * slope;
                }
            }
            (
                (error2 / size2).sqrt(),
                (energy - truth).abs() / truth.abs(),
            )
        }
    }

    fn random(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695);
            (state >> 33) as f64 / (1u64 << 31) as f64
        }
    }

    /// Random atoms at least `apart` apart.
    fn lattice<const D: usize>(extent: [f64; D], apart: f64, seed: u64) -> Vec<[f64; D]> {
        let mut random = random(seed);
        let mut atoms: Vec<[f64; D]> = Vec::new();
        for _ in 0..6_000 {
            let x: [f64; D] = std::array::from_fn(|k| random() * extent[k]);
            let near =
                |a: &[f64; D]| (0..D).map(|k| (a[k] - x[k]).powi(2)).sum::<f64>() < apart * apart;
            if !atoms.iter().any(near) {
                atoms.push(x);
            }
        }
        atoms
    }

    /// A slowly waving field between two values.
    fn smooth<const D: usize>(extent: [f64; D], low: f64, high: f64) -> Field<D> {
        let dims = extent.map(|l| l as usize + 1);
        Field::from_fn(dims, [1.0; D], |x| {
            let wave: f64 = (0..D).map(|k| (0.11 * x[k] + k as f64).sin()).sum::<f64>() / D as f64;
            low + (high - low) * 0.5 * (1.0 + wave)
        })
    }

    #[test]
    fn lattice_gradient_is_exact_for_constant_distance() {
        let extent = [21.0, 18.0, 24.0];
        let x = lattice(extent, 1.8, 3);
        let nothing = Field {
            dims: [2; 3],
            step: [30.0; 3],
            samples: vec![0.0; 8],
        };
        let distance = Distance::Constant(3.0);
        let (gradient, energy) = Case {
            extent,
            distance: &distance,
            potential: &nothing,
            beta: Beta::Constant(0.5),
            stiffness: 0.0,
            alignment: Alignment::On,
        }
        .errors(&x);
        println!("constant d: gradient {gradient:.1e}, energy {energy:.1e}");
        assert!(gradient < 1e-6 && energy < 1e-6, "{gradient:e} {energy:e}");
    }

    #[test]
    fn lattice_gradient_is_exact_far_from_the_origin() {
        let extent = [900.0, 900.0, 900.0];
        let mut x = lattice([21.0; 3], 1.8, 5);
        for atom in &mut x {
            *atom = atom.map(|c| c + 870.0);
        }
        let nothing = Field {
            dims: [2; 3],
            step: [900.0; 3],
            samples: vec![0.0; 8],
        };
        let distance = Distance::Constant(3.0);
        let (gradient, _) = Case {
            extent,
            distance: &distance,
            potential: &nothing,
            beta: Beta::Constant(0.5),
            stiffness: 0.0,
            alignment: Alignment::On,
        }
        .errors(&x);
        // Positions are resolved to 2^-20 of a sample here, 3e-7 of d.
        assert!(gradient < 3e-6, "{gradient:e}");
    }

    #[test]
    fn gradient_includes_the_derivatives_of_distance_image_and_beta() {
        let extent = [24.0, 20.0, 22.0];
        let x = lattice(extent, 1.8, 4);
        let distance = Distance::Field(smooth(extent, 2.0, 4.5));
        let potential = smooth(extent, -1.0, 0.0);
        for beta in [Beta::Constant(0.4), Beta::Field(smooth(extent, 0.2, 0.8))] {
            let (gradient, energy) = Case {
                extent,
                distance: &distance,
                potential: &potential,
                beta,
                stiffness: 40.0,
                alignment: Alignment::On,
            }
            .errors(&x);
            println!("variable d: gradient {gradient:.1e}, energy {energy:.1e}");
            assert!(gradient < 1e-6 && energy < 1e-6, "{gradient:e} {energy:e}");
        }
        let constant = Distance::Constant(3.0);
        let (gradient, _) = Case {
            extent,
            distance: &constant,
            potential: &potential,
            beta: Beta::Constant(0.4),
            stiffness: 40.0,
            alignment: Alignment::On,
        }
        .errors(&x);
        assert!(gradient < 1e-6, "{gradient:e}");
    }

    #[test]
    fn gradient_is_exact_in_two_dimensions() {
        let extent = [30.0, 40.0];
        let x = lattice(extent, 1.8, 6);
        let distance = Distance::Field(smooth(extent, 2.0, 4.0));
        let potential = smooth(extent, -1.0, 0.0);
        let (gradient, energy) = Case {
            extent,
            distance: &distance,
            potential: &potential,
            beta: Beta::Constant(0.5),
            stiffness: 0.0,
            alignment: Alignment::On,
        }
        .errors(&x);
        assert!(gradient < 1e-6 && energy < 1e-6, "{gradient:e} {energy:e}");
    }

    #[test]
    fn gradient_is_exact_with_mirror_images() {
        fn check<const D: usize>(extent: [f64; D], seed: u64) {
            let inside = |x: [f64; D]| x.map(|c| 0.4 + c);
            let x = lattice(extent.map(|l| l - 0.8), 1.8, seed);
            let x: Vec<[f64; D]> = x.into_iter().map(inside).collect();
            let potential = smooth(extent, -1.0, 0.0);
            let vary = Distance::Field(smooth(extent, 2.0, 4.0));
            for distance in [Distance::Constant(3.0), vary] {
                for beta in [Beta::Constant(0.4), Beta::Field(smooth(extent, 0.2, 0.8))] {
                    let (gradient, energy) = Case {
                        extent,
                        distance: &distance,
                        potential: &potential,
                        beta,
                        stiffness: 15.0,
                        alignment: Alignment::Alongside,
                    }
                    .errors(&x);
                    println!("{D}-D: gradient {gradient:.1e}, energy {energy:.1e}");
                    assert!(gradient < 1e-6 && energy < 1e-6, "{gradient:e} {energy:e}");
                }
            }
        }
        check([30.0, 40.0], 6);
        // So thin that atoms feel images in both sides.
        check([9.0, 22.0, 24.0], 7);
    }

    #[test]
    fn the_perfect_lattice_of_the_plane_is_a_minimum() {
        // Inside, where all six neighbours are there, no force; and any change costs energy.
        let (d, extent) = (2.0, [20.0, 16.0 * 0.75f64.sqrt()]);
        let x = crate::lattice::seeding::lattice::fitted(extent, d, Alignment::On);
        let distance = Distance::Constant(d);
        let mut energy = Pairwise::new(extent, &distance, None, Beta::Constant(0.0)).unwrap();
        let mut gradient = vec![[0.0; 2]; x.len()];
        let lowest = energy.evaluate(&x, &mut gradient);
        let inner = |x: &[f64; 2]| (0..2).all(|k| x[k] > 1.6 * d && x[k] < extent[k] - 1.6 * d);
        let at_rest = x.iter().zip(&gradient).filter(|(x, _)| inner(x));
        assert!(at_rest.clone().count() > 20);
        for (_, g) in at_rest {
            assert!(g.iter().all(|g| g.abs() < 1e-6), "{g:?}");
        }
        let mut random = random(11);
        for _ in 0..20 {
            let jump = |x: &[f64; 2]| match inner(x) {
                true => x.map(|c| c + 0.05 * d * (random() - 0.5)),
                false => *x,
            };
            let moved: Vec<[f64; 2]> = x.iter().map(jump).collect();
            assert!(energy.evaluate(&moved, &mut gradient) > lowest);
        }
    }

    #[test]
    fn a_kept_list_gives_what_a_new_one_gives() {
        kept_and_new(Alignment::On);
        kept_and_new(Alignment::Alongside);
    }

    fn kept_and_new(alignment: Alignment) {
        let extent = [24.0, 20.0, 22.0];
        let mut x = lattice(extent, 1.8, 8);
        let distance = Distance::Field(smooth(extent, 2.0, 4.5));
        let mut random = random(9);
        let new = || {
            let new = Pairwise::new(extent, &distance, None, Beta::Constant(0.0));
            new.unwrap().aligned(alignment)
        };
        let mut kept = new();
        let mut gradient = vec![[0.0; 3]; x.len()];
        for pass in 0..40 {
            // Now all atoms a little, now a few of them far.
            let (share, size) = if pass % 2 == 0 {
                (1.0, 0.12)
            } else {
                (0.02, 1.5)
            };
            for atom in &mut x {
                if random() < share {
                    *atom = std::array::from_fn(|k| {
                        (atom[k] + size * (random() - 0.5)).clamp(0.0, extent[k])
                    });
                }
            }
            let energy = kept.evaluate(&x, &mut gradient);
            let mut truth = vec![[0.0; 3]; x.len()];
            let expected = new().evaluate(&x, &mut truth);
            assert!((energy - expected).abs() < 1e-6 * expected.abs());
            for (a, b) in gradient.iter().flatten().zip(truth.iter().flatten()) {
                assert!((a - b).abs() < 1e-5, "{a} {b}");
            }
        }
        let listings = kept.relisted() as f64 / x.len() as f64;
        println!("{listings:.1} listings an atom");
        assert!(listings > 1.0 && listings < 50.0, "{listings}");
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bytes() {
        let extent = [60.0; 3];
        let d = 3.0;
        let x = crate::lattice::seeding::lattice::fitted(
            extent,
            d,
            crate::lattice::seeding::Alignment::On,
        );
        let distance = Distance::Constant(d);
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| {
                let mut evaluator =
                    Pairwise::new(extent, &distance, None, Beta::Constant(0.5)).unwrap();
                let mut gradient = vec![[0.0; 3]; x.len()];
                (evaluator.evaluate(&x, &mut gradient).to_bits(), gradient)
            })
        };
        assert!(x.len() > 3 * CHUNK);
        assert_eq!(run(1), run(3));
    }

    #[test]
    fn beta_outside_its_range_is_refused() {
        let distance = Distance::Constant(2.0);
        for beta in [-0.1, 1.1, f64::NAN] {
            assert!(Pairwise::new([9.0; 3], &distance, None, Beta::Constant(beta)).is_err());
        }
    }
}

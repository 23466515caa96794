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
//! Alongside, j runs over mirror images as well (`Images`), which by symmetry leaves the formulas as
//! they are, and -b takes the place of b.
//!
//! Distances are computed in `f32` from fixed-point positions (`FixedPoint`) and summed in a fixed
//! order, so the result is the same for any number of threads and on any machine.

use crate::parallel::prelude::*;
use pulp::Arch;

mod kernels;

use kernels::{AnyDistance, LOCAL, Local, NO_SITE, SameDistance, Site, Sums};

use super::images::Images;
use super::neighbours::{Among, CHUNK, FixedPoint, NOWHERE, Neighbours, Point, Rows};
use super::pair::CUTOFF;
use super::{Beta, Energy, Parts, Terms};
use crate::error::{Error, Result, cause};
use crate::image::Sparse;
use crate::lattice::distance::Distance;
use crate::lattice::held::Held;
use crate::lattice::seeding::Alignment;

/// Width of the Verlet list beyond the cut-off, in units of d. The third shell of an FCC lattice is
/// at 1.73 d, so a regular lattice gets no more pairs from it.
const SKIN: f32 = 0.2;

/// The neighbour list is repaired if at most one atom in this many has moved far, else built anew.
const FEW: usize = 4;

/// The exact evaluator of the lattice energy.
#[derive(Clone)]
pub struct Pairwise<'a, const D: usize> {
    distance: &'a Distance<D>,
    image: Option<&'a Sparse<D>>,
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
    /// Whether none are listed yet.
    unlisted: bool,
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
        potential: Option<&'a Sparse<D>>,
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
            image: potential,
            beta,
            alignment: Alignment::On,
            fixed,
            slope: distance.largest_slope(),
            neighbours: Neighbours::default(),
            images: Images::new(fixed.of(&extent), D),
            points: Vec::new(),
            listed: Vec::new(),
            reach: Vec::new(),
            unlisted: true,
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
            Distance::Field(_) | Distance::Near(_) => None,
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
    ///
    /// # Errors
    /// Those of other ranks.
    fn update(&mut self, x: &[[f64; D]], held: &Held<'_>) -> Result<()> {
        let count = x.len();
        if self.points.len() != count + self.images.len() {
            // Other atoms than before, or more of the same.
            self.images.rebuild(&[], |_| 0.0);
            self.points = vec![NOWHERE; count];
            self.unlisted = true;
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
        if self.unlisted {
            return self.list_all(held);
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
        let own = held.own();
        let own_moved = moved.iter().map(|&n| n as usize).filter(|&n| {
            let image = n.checked_sub(count);
            own.contains(&image.map_or(n, |image| self.images.of_image(image).0 as usize))
        });
        let alongside = self.alignment == Alignment::Alongside;
        let lacks_images = |n: usize| {
            let reach = self.widest((CUTOFF + SKIN) * self.d(n));
            n < count && !self.images.suffice(n, &self.points[n], reach)
        };
        // Of own atoms and their images; so that all ranks do the same.
        let counts = [
            own_moved.clone().count(),
            self.images.own_points(held),
            usize::from(alongside && own_moved.clone().any(lacks_images)),
        ];
        let all = held.told("atoms that have moved", counts)?;
        let sum = |k: usize| all.iter().map(|counts| counts[k]).sum::<usize>();
        if sum(0) == 0 {
            return Ok(());
        }
        if sum(0) > sum(1) / FEW || sum(2) > 0 {
            return self.list_all(held);
        }
        self.relisted += moved.len();
        for &n in &moved {
            self.listed[n as usize] = self.points[n as usize];
            self.reach[n as usize] = (CUTOFF + SKIN) * self.d(n as usize);
        }
        let mut neighbours = std::mem::take(&mut self.neighbours);
        let repaired = neighbours.repair(self.among(held), &moved);
        self.neighbours = neighbours;
        repaired
    }

    /// The points among which neighbours are listed.
    fn among<'s>(&'s self, held: &'s Held<'s>) -> Among<'s> {
        Among {
            points: &self.listed,
            held,
            images: &self.images,
            reach: &self.reach,
            slope: (f64::from(CUTOFF + SKIN) * self.slope) as f32,
        }
    }

    /// Lists the neighbours of all atoms anew, and finds the images that they need.
    ///
    /// # Errors
    /// Those of other ranks.
    fn list_all(&mut self, held: &Held<'_>) -> Result<()> {
        let count = self.points.len() - self.images.len();
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
        let mut neighbours = std::mem::take(&mut self.neighbours);
        let built = neighbours.build(self.among(held));
        self.neighbours = neighbours;
        built?;
        self.unlisted = false;
        self.relisted += self.points.len();
        Ok(())
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
        // Only where d varies without any measure: some pairs are missing.
        if rows.overflowed {
            return [f64::NAN; 3];
        }
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
    fn evaluate(&mut self, x: &[[f64; D]], gradient: &mut [[f64; D]]) -> Result<f64> {
        self.evaluate_held(x, &Held::all(x.len()), gradient)
    }

    fn takes_parts(&self) -> bool {
        true
    }

    fn evaluate_held(
        &mut self,
        x: &[[f64; D]],
        held: &Held<'_>,
        gradient: &mut [[f64; D]],
    ) -> Result<f64> {
        self.update(x, held)?;
        let chunks = &self.neighbours.chunks;
        let own = held.own();
        let mut sums = vec![[0.0; 3]; chunks.len()];
        sums.par_iter_mut()
            .zip(chunks)
            .zip(gradient[own.clone()].par_chunks_mut(CHUNK))
            .zip(x[own].par_chunks(CHUNK))
            .for_each(|(((sums, rows), gradient), x)| {
                *sums =
                    LOCAL.with_borrow_mut(|local| self.evaluate_chunk(rows, x, gradient, local));
            });
        let total = held.total(sums)?;
        self.parts = Parts {
            lattice: total[0],
            image: total[1],
        };
        Ok(total[2])
    }

    fn terms(
        &mut self,
        x: &[[f64; D]],
        held: &Held<'_>,
        minimised: f64,
        gradient: &mut [[f64; D]],
    ) -> Result<Terms> {
        let (parts, kappa, stiffness) = (self.parts, self.kappa, self.stiffness);
        (self.kappa, self.stiffness) = (1.0, 0.0);
        let energy = self.evaluate_held(x, held, gradient);
        let found = std::mem::replace(&mut self.parts, parts);
        (self.kappa, self.stiffness) = (kappa, stiffness);
        Ok(Terms::of_pairs(found, energy?, minimised))
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

#[cfg(test)]
mod tests;

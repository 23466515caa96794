//! The exact energy and gradient, from pairs of atoms.
//!
//! The cost is about 20 pairs an atom, whatever d is in samples. The gradient is the exact
//! derivative of the energy, including the derivatives of b(x), of a variable d(x) and of a
//! variable beta(x). With d_j = d(x_j), w_i = 1 - beta(x_i) and A_i = 1/2 sum over j of phi(r_ij /
//! d_j):
//!
//! ```text
//! P         = sum_i w_i A_i + beta(x_i) b(x_i)
//! dP / dx_k = 1/2 sum_j (w_k f(r/d_j) / d_j + w_j f(r/d_k) / d_k) (x_j - x_k) / r     moving x_k
//!           + 1/2 sum_j w_j f(r/d_k) r / d_k^2  grad d(x_k)                           changing d_k
//!           + (b(x_k) - A_k) grad beta(x_k) + beta(x_k) grad b(x_k)
//! ```
//!
//! For alignment alongside features, j runs over mirror images as well (`MirrorImages`), which by
//! symmetry does not change the formulas, and -b takes the place of b.
//!
//! Distances are computed in `f32` from fixed-point positions (`FixedPointMap`) and summed in a
//! fixed order, so the result is the same for any number of threads and on any machine.

use crate::parallel::prelude::*;
use pulp::Arch;

mod kernels;

use kernels::{
    AtomParams, CHUNK_SCRATCH, ChunkScratch, ConstantDistanceKernel, FILLER_PARAMS, NeighbourSums,
    VariableDistanceKernel,
};

use super::mirror_images::MirrorImages;
use super::neighbours::{
    CHUNK_ATOMS, FixedPointMap, IntPoint, NeighbourRows, Neighbours, PointSet, UNREACHABLE_POINT,
};
use super::pair::CUTOFF_RATIO;
use super::{Beta, Energy, EnergyParts, EnergyTerms};
use crate::error::{Error, Result, cause};
use crate::image::SparseField;
use crate::lattice::distance::Distance;
use crate::lattice::halo::OwnedAndGhosts;
use crate::lattice::seeding::Alignment;

/// Width of the Verlet list beyond the cut-off, in units of d. The third shell of an FCC lattice is
/// at 1.73 d, so a regular lattice gets no more pairs from it.
const SKIN_RATIO: f32 = 0.2;

/// The neighbour list is repaired if at most one point in this many has moved far, else built
/// again.
const REPAIR_DIVISOR: usize = 4;

/// The exact evaluator of the lattice energy.
#[derive(Clone)]
pub struct PairwiseEnergy<'a, const D: usize> {
    distance: &'a Distance<D>,
    image: Option<&'a SparseField<D>>,
    beta: Beta<D>,
    alignment: Alignment,
    fixed_point: FixedPointMap,
    /// Largest |grad d|.
    max_slope: f64,
    neighbours: Neighbours,
    images: MirrorImages,
    /// Positions at the last evaluation: of atoms, then of images.
    points: Vec<IntPoint>,
    /// Positions and reaches for which the neighbours are listed.
    listed_points: Vec<IntPoint>,
    listed_reach: Vec<f32>,
    /// `true` until neighbours have been listed.
    needs_listing: bool,
    /// For the general kernel only.
    params: Vec<AtomParams>,
    parts: EnergyParts,
    relisted_count: usize,
    stiffness: f32,
    /// The weight of A.
    kappa: f64,
}

impl<'a, const D: usize> PairwiseEnergy<'a, D> {
    /// Creates an evaluator for atoms in the box `[0, extent]`, for `D` of 2 or 3. Without an
    /// `image` potential the image has no part in the energy (b = 0).
    ///
    /// # Errors
    /// Returns [`Error::Optimise`] if beta leaves [0, 1].
    pub fn new(
        extent: [f64; D],
        distance: &'a Distance<D>,
        image: Option<&'a SparseField<D>>,
        beta: Beta<D>,
    ) -> Result<Self> {
        let range = match &beta {
            Beta::Constant(beta) => (*beta, *beta),
            Beta::Field(field) => field.samples.iter().fold((0.0, 1.0), |(low, high), &b| {
                (f64::from(b).min(low), f64::from(b).max(high))
            }),
        };
        let is_finite = match &beta {
            Beta::Constant(beta) => beta.is_finite(),
            Beta::Field(field) => field.samples.iter().all(|b| b.is_finite()),
        };
        if !(is_finite && range.0 >= 0.0 && range.1 <= 1.0) {
            return Err(Error::Optimise(cause(
                "beta",
                format!("ranges from {} to {}", range.0, range.1),
                "give a weight between 0 (lattice only) and 1 (image only)",
            )));
        }
        let fixed = FixedPointMap::new(&extent);
        Ok(Self {
            distance,
            image,
            beta,
            alignment: Alignment::OnFeatures,
            fixed_point: fixed,
            max_slope: distance.max_slope(),
            neighbours: Neighbours::default(),
            images: MirrorImages::new(fixed.to_point(&extent), D),
            points: Vec::new(),
            listed_points: Vec::new(),
            listed_reach: Vec::new(),
            needs_listing: true,
            params: Vec::new(),
            parts: EnergyParts::default(),
            relisted_count: 0,
            stiffness: 0.0,
            kappa: 1.0,
        })
    }

    /// Sets where atoms end up; the default is [`Alignment::OnFeatures`]. With
    /// [`Alignment::AlongsideFeatures`], -b takes the place of b, and mirror images of the atoms
    /// beyond the sides act on those inside.
    pub fn with_alignment(mut self, alignment: Alignment) -> Self {
        self.alignment = alignment;
        self
    }

    /// Keeps atoms from crowding on features, by the stiffening that suits beta (its largest value
    /// where it is a field); see [`pair`](super::pair). Recommended for all but the shortest
    /// minimisations.
    pub fn with_auto_stiffness(self) -> Self {
        let stiffness = self.beta.stiffness();
        self.with_stiffness(stiffness)
    }

    /// Makes atoms nearer than d push each other apart harder than the published potential does.
    /// The default, 0, is the published potential.
    pub fn with_stiffness(mut self, stiffness: f32) -> Self {
        self.stiffness = stiffness.max(0.0);
        self
    }

    /// Sets the weight of A, so that P = (1 - beta) kappa A + beta B.
    pub(crate) fn with_kappa(mut self, kappa: f64) -> Self {
        self.kappa = kappa;
        self
    }

    /// Returns how often a point's neighbours have been listed because the point had moved, in
    /// total.
    pub fn relisted_count(&self) -> usize {
        self.relisted_count
    }

    /// Returns d in fixed-point units, if it is the same everywhere.
    fn constant_d(&self) -> Option<f32> {
        match self.distance {
            Distance::Constant(d) => Some((*d * self.fixed_point.scale) as f32),
            Distance::Field(_) | Distance::Bricks(_) => None,
        }
    }

    /// Returns d of a point in fixed-point units.
    fn point_d(&self, point: usize) -> f32 {
        let constant = self.constant_d();
        constant.unwrap_or_else(|| 1.0 / self.params[point].inverse_d)
    }

    /// Returns the largest distance of a pair that is listed because one of its points has the
    /// reach `reach`.
    fn max_listed_distance(&self, reach: f32) -> f32 {
        let slope = f64::from(CUTOFF_RATIO + SKIN_RATIO) * self.max_slope;
        reach / (1.0 - slope as f32).max(1e-3)
    }

    /// Takes over new positions and updates the neighbour list.
    ///
    /// The list contains all pairs nearer than 1.5 d + skin (of either atom) at the listed
    /// positions. An atom that has moved, or whose d has grown, by more than half its skin in total
    /// gets a new listed position. So a pair that is not listed is never nearer than 1.5 d: both
    /// together have used up at most the larger skin.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    fn update(&mut self, x: &[[f64; D]], halo: &OwnedAndGhosts<'_>) -> Result<()> {
        let count = x.len();
        if self.points.len() != count + self.images.len() {
            // The atoms are others than before, or their count has changed.
            self.images.rebuild(&[], |_| 0.0);
            self.points = vec![UNREACHABLE_POINT; count];
            self.needs_listing = true;
        }
        let fixed = self.fixed_point;
        let (atoms, images) = self.points.split_at_mut(count);
        let chunks = atoms
            .par_chunks_mut(CHUNK_ATOMS)
            .zip(x.par_chunks(CHUNK_ATOMS));
        chunks.for_each(|(points, x)| {
            for (point, x) in points.iter_mut().zip(x) {
                *point = fixed.to_point(x);
            }
        });
        self.images.update_positions(atoms, images);
        if self.constant_d().is_none() || matches!(self.beta, Beta::Field(_)) {
            self.update_params(x);
        }
        if self.needs_listing {
            return self.list_all(halo);
        }
        let has_moved_far = |&n: &u32| {
            let n = n as usize;
            let old_d = self.listed_reach[n] / (CUTOFF_RATIO + SKIN_RATIO);
            let step = |k: usize| (self.points[n][k] - self.listed_points[n][k]) as f32;
            let distance = (step(0) * step(0) + step(1) * step(1) + step(2) * step(2)).sqrt();
            distance + CUTOFF_RATIO * (self.point_d(n) - old_d).max(0.0) > 0.5 * SKIN_RATIO * old_d
        };
        let moved: Vec<u32> = (0..self.points.len() as u32)
            .into_par_iter()
            .with_min_len(CHUNK_ATOMS)
            .filter(has_moved_far)
            .collect();
        let owned = halo.owned();
        let owned_moved = moved.iter().map(|&n| n as usize).filter(|&n| {
            let image = n.checked_sub(count);
            owned.contains(&image.map_or(n, |image| self.images.source(image).0 as usize))
        });
        let alongside = self.alignment == Alignment::AlongsideFeatures;
        let lacks_images = |n: usize| {
            let reach = self.max_listed_distance((CUTOFF_RATIO + SKIN_RATIO) * self.point_d(n));
            n < count && !self.images.are_sufficient(n, &self.points[n], reach)
        };
        // Counted for owned atoms and their images and then summed, so that all ranks decide alike.
        let counts = [
            owned_moved.clone().count(),
            self.images.owned_point_count(halo),
            usize::from(alongside && owned_moved.clone().any(lacks_images)),
        ];
        let add = |a: [usize; 3], b: [usize; 3]| std::array::from_fn(|k| a[k] + b[k]);
        let [moved_count, point_count, lacking_count] =
            halo.fold("atoms that have moved", counts, [0; 3], add)?;
        if moved_count == 0 {
            return Ok(());
        }
        if moved_count > point_count / REPAIR_DIVISOR || lacking_count > 0 {
            return self.list_all(halo);
        }
        self.relisted_count += moved.len();
        for &n in &moved {
            self.listed_points[n as usize] = self.points[n as usize];
            self.listed_reach[n as usize] = (CUTOFF_RATIO + SKIN_RATIO) * self.point_d(n as usize);
        }
        let mut neighbours = std::mem::take(&mut self.neighbours);
        let result = neighbours.repair(self.point_set(halo), &moved);
        self.neighbours = neighbours;
        result
    }

    /// Returns the points among which neighbours are listed.
    fn point_set<'s>(&'s self, halo: &'s OwnedAndGhosts<'s>) -> PointSet<'s> {
        PointSet {
            points: &self.listed_points,
            halo,
            images: &self.images,
            reach: &self.listed_reach,
            slope: (f64::from(CUTOFF_RATIO + SKIN_RATIO) * self.max_slope) as f32,
        }
    }

    /// Lists the neighbours of all atoms from scratch, and finds the images that they need.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    fn list_all(&mut self, halo: &OwnedAndGhosts<'_>) -> Result<()> {
        let count = self.points.len() - self.images.len();
        if self.alignment == Alignment::AlongsideFeatures {
            let mut images = std::mem::take(&mut self.images);
            let reach =
                |n: usize| self.max_listed_distance((CUTOFF_RATIO + SKIN_RATIO) * self.point_d(n));
            images.rebuild(&self.points[..count], reach);
            self.points.resize(count + images.len(), UNREACHABLE_POINT);
            let (atoms, image_points) = self.points.split_at_mut(count);
            images.update_positions(atoms, image_points);
            self.images = images;
            self.copy_image_params(count);
        }
        self.listed_points.clone_from(&self.points);
        let reach = |n| (CUTOFF_RATIO + SKIN_RATIO) * self.point_d(n);
        self.listed_reach = (0..self.points.len()).map(reach).collect();
        let mut neighbours = std::mem::take(&mut self.neighbours);
        let result = neighbours.build(self.point_set(halo));
        self.neighbours = neighbours;
        result?;
        self.needs_listing = false;
        self.relisted_count += self.points.len();
        Ok(())
    }

    /// Computes d and beta of every atom, for the general kernel.
    fn update_params(&mut self, x: &[[f64; D]]) {
        let (distance, beta, scale) = (self.distance, &self.beta, self.fixed_point.scale);
        let kappa = self.kappa;
        self.params.resize(x.len(), FILLER_PARAMS);
        let params = self.params.par_iter_mut().zip(x).with_min_len(CHUNK_ATOMS);
        params.for_each(|(params, x)| {
            let beta = match beta {
                Beta::Constant(beta) => *beta,
                Beta::Field(field) => field.value(*x),
            };
            let inverse = 1.0 / (distance.value_at(*x) * scale);
            *params = AtomParams {
                inverse_d: inverse as f32,
                weight: (kappa * (1.0 - beta)) as f32,
            };
        });
        self.copy_image_params(x.len());
    }

    /// Copies the parameters of atoms to their images.
    fn copy_image_params(&mut self, count: usize) {
        if !self.params.is_empty() {
            self.params.truncate(count);
            for atom in self.images.atoms() {
                self.params.push(self.params[atom]);
            }
        }
    }

    /// Returns A, B and P of a chunk of atoms at `x`, and writes their gradient.
    fn evaluate_chunk(
        &self,
        rows: &NeighbourRows,
        x: &[[f64; D]],
        gradient: &mut [[f64; D]],
        scratch: &mut ChunkScratch,
    ) -> [f64; 3] {
        // This happens only where d varies extremely: some pairs are missing.
        if rows.has_overflowed {
            return [f64::NAN; 3];
        }
        scratch.load_chunk(rows, &self.points, &self.params);
        let sign = match self.alignment {
            Alignment::OnFeatures => 1.0,
            Alignment::AlongsideFeatures => -1.0,
        };
        let image_at = |x: &[f64; D]| {
            self.image
                .as_ref()
                .and_then(|image| image.nonzero_value_and_gradient(*x))
        };
        let (scale, stiffness, kappa) = (self.fixed_point.scale, self.stiffness, self.kappa);
        let mut total = [0.0f64; 3];
        if let (Distance::Constant(d), Beta::Constant(beta)) = (self.distance, &self.beta) {
            total[0] = Arch::new().dispatch(ConstantDistanceKernel {
                points: &scratch.points,
                rows,
                inverse_d: (1.0 / (d * scale)) as f32,
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
        scratch.sums.resize(x.len(), NeighbourSums::default());
        Arch::new().dispatch(VariableDistanceKernel {
            points: &scratch.points,
            params: &scratch.params,
            rows,
            stiffness,
            sums: &mut scratch.sums,
        });
        for ((sums, x), gradient) in scratch.sums.iter().zip(x).zip(gradient) {
            let (d, d_slope) = self.distance.value_and_gradient_at(*x);
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
                0.5 * f64::from(sums.position_derivative[k]) * scale
                    + 0.5 * f64::from(sums.log_d_derivative) / d * d_slope[k]
                    + (b - kappa * a) * beta_slope[k]
                    + sign * beta * b_slope[k]
            });
        }
        total
    }
}

impl<const D: usize> Energy<D> for PairwiseEnergy<'_, D> {
    fn evaluate(&mut self, x: &[[f64; D]], gradient: &mut [[f64; D]]) -> Result<f64> {
        self.evaluate_partition(x, &OwnedAndGhosts::all(x.len()), gradient)
    }

    fn supports_partition(&self) -> bool {
        true
    }

    fn evaluate_partition(
        &mut self,
        x: &[[f64; D]],
        halo: &OwnedAndGhosts<'_>,
        gradient: &mut [[f64; D]],
    ) -> Result<f64> {
        self.update(x, halo)?;
        let chunks = &self.neighbours.chunks;
        let owned = halo.owned();
        let mut sums = vec![[0.0; 3]; chunks.len()];
        sums.par_iter_mut()
            .zip(chunks)
            .zip(gradient[owned.clone()].par_chunks_mut(CHUNK_ATOMS))
            .zip(x[owned].par_chunks(CHUNK_ATOMS))
            .for_each(|(((sums, rows), gradient), x)| {
                *sums = CHUNK_SCRATCH
                    .with_borrow_mut(|scratch| self.evaluate_chunk(rows, x, gradient, scratch));
            });
        let total = halo.all_reduce_sum(sums)?;
        self.parts = EnergyParts {
            lattice: total[0],
            image: total[1],
        };
        Ok(total[2])
    }

    fn terms(
        &mut self,
        x: &[[f64; D]],
        halo: &OwnedAndGhosts<'_>,
        minimised: f64,
        gradient: &mut [[f64; D]],
    ) -> Result<EnergyTerms> {
        let (parts, kappa, stiffness) = (self.parts, self.kappa, self.stiffness);
        (self.kappa, self.stiffness) = (1.0, 0.0);
        let energy = self.evaluate_partition(x, halo, gradient);
        let published = std::mem::replace(&mut self.parts, parts);
        (self.kappa, self.stiffness) = (kappa, stiffness);
        Ok(EnergyTerms::from_pairs(published, energy?, minimised))
    }

    fn stiffness(&self, x: &[[f64; D]]) -> Vec<f32> {
        // In units of d the curvature of the lattice is 4 (1 - beta), and that of a valley of depth
        // 1 and width d / 4 is 16 beta.
        let Some(image) = &self.image else {
            return vec![1.0; x.len()];
        };
        let stiffness_at = |x: &[f64; D]| {
            let beta = match &self.beta {
                Beta::Constant(beta) => *beta,
                Beta::Field(field) => field.value(*x),
            };
            let depth = image
                .nonzero_value_and_gradient(*x)
                .map_or(0.0, |(b, _)| b.abs());
            (1.0 + 4.0 * beta / (1.0 - beta).max(0.05) * depth) as f32
        };
        x.par_iter()
            .with_min_len(CHUNK_ATOMS)
            .map(stiffness_at)
            .collect()
    }

    fn duplicate(&self) -> Box<dyn Energy<D> + Send + '_> {
        Box::new(self.clone())
    }

    fn parts(&self) -> EnergyParts {
        self.parts
    }
}

#[cfg(test)]
pub(crate) mod tests;

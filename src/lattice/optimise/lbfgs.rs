//! Limited-memory BFGS (Nocedal 1980): the descent direction from the last few steps.
//!
//! The two-loop recursion runs on the *coefficients* of the direction in the basis of stored steps
//! s, gradient changes y and the gradient g, with all inner products kept in a small Gram matrix
//! (Chen, Wang & Zhou 2014). So one pass over memory adds a step and takes its inner products with
//! all other vectors, and one more pass computes the direction. Vectors are `f32`; sums are taken
//! in chunks of fixed size and added up in `f64` in a fixed order, so the bytes are the same for
//! any number of threads.

use crate::parallel::prelude::*;
use pulp::{Arch, Simd, WithSimd};

use crate::Result;
use crate::lattice::halo::OwnedAndGhosts;

/// Count of steps in memory.
const MEMORY_STEPS: usize = 5;
/// Index of the gradient in the basis s_0.., y_0.., g.
const GRADIENT_INDEX: usize = 2 * MEMORY_STEPS;
const BASIS_SIZE: usize = 2 * MEMORY_STEPS + 1;

/// Coordinates per unit of parallel work: a multiple of 2, 3 and 8, and small enough that a chunk
/// of every vector stays in the cache.
pub const CHUNK_COORDINATES: usize = 3072;

/// The memory of a minimisation over scaled coordinates, of the owned atoms of this rank.
pub struct Lbfgs<'a> {
    /// s in slots `0..MEMORY_STEPS`, y in `MEMORY_STEPS..2 * MEMORY_STEPS`, the gradient last.
    basis: [Vec<f32>; BASIS_SIZE],
    /// Inner products of the basis; valid for the live slots and the gradient.
    gram: [[f64; BASIS_SIZE]; BASIS_SIZE],
    /// Live slots, oldest first.
    live_slots: Vec<usize>,
    /// Inverse curvature to assume while no steps are stored.
    initial_inverse_curvature: f64,
    halo: &'a OwnedAndGhosts<'a>,
}

impl<'a> Lbfgs<'a> {
    /// Creates an empty memory at a point whose gradient is `gradient`. `initial_inverse_curvature`
    /// is the step length of steepest descent. The coordinates are those of the owned atoms in
    /// `halo`, from the beginning of a chunk on.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn new(
        gradient: Vec<f32>,
        initial_inverse_curvature: f64,
        halo: &'a OwnedAndGhosts<'a>,
    ) -> Result<Self> {
        let n = gradient.len();
        let mut basis: [Vec<f32>; BASIS_SIZE] = std::array::from_fn(|_| vec![0.0; n]);
        basis[GRADIENT_INDEX] = gradient;
        let mut memory = Self {
            basis,
            gram: [[0.0; BASIS_SIZE]; BASIS_SIZE],
            live_slots: Vec::new(),
            initial_inverse_curvature,
            halo,
        };
        memory.reset()?;
        Ok(memory)
    }

    /// Drops all steps; the next direction is steepest descent.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn reset(&mut self) -> Result<()> {
        self.live_slots.clear();
        let gradient = &self.basis[GRADIENT_INDEX];
        let partial = gradient
            .par_chunks(CHUNK_COORDINATES)
            .map(|g| [dot(g, g)])
            .collect();
        [self.gram[GRADIENT_INDEX][GRADIENT_INDEX]] = self.halo.all_reduce_sum(partial)?;
        Ok(())
    }

    /// Returns `true` if the next direction is plain steepest descent.
    pub fn is_empty(&self) -> bool {
        self.live_slots.is_empty()
    }

    /// Goes to a new point: `advance(chunk, s, g)` writes the step taken and the new gradient of
    /// the coordinates from `chunk * CHUNK_COORDINATES` on. The step is stored if the curvature
    /// along it is positive.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn advance(
        &mut self,
        advance: impl Fn(usize, &mut [f32], &mut [f32]) + Sync,
    ) -> Result<()> {
        let slot = if self.live_slots.len() == MEMORY_STEPS {
            self.live_slots.remove(0)
        } else {
            (0..MEMORY_STEPS)
                .find(|s| !self.live_slots.contains(s))
                .unwrap_or(0)
        };
        let mut s = std::mem::take(&mut self.basis[slot]);
        let mut y = std::mem::take(&mut self.basis[MEMORY_STEPS + slot]);
        let mut g = std::mem::take(&mut self.basis[GRADIENT_INDEX]);
        let others: Vec<usize> = self
            .live_slots
            .iter()
            .flat_map(|&k| [k, MEMORY_STEPS + k])
            .collect();
        let basis = &self.basis;
        // For each chunk: inner products of s, y, g with the other vectors, then among themselves.
        const SUM_COUNT: usize = 3 * (BASIS_SIZE + 2);
        let partial: Vec<[f64; SUM_COUNT]> = s
            .par_chunks_mut(CHUNK_COORDINATES)
            .zip(y.par_chunks_mut(CHUNK_COORDINATES))
            .zip(g.par_chunks_mut(CHUNK_COORDINATES))
            .enumerate()
            .map(|(chunk, ((s, y), g))| {
                y.copy_from_slice(g);
                advance(chunk, s, g);
                for (y, g) in y.iter_mut().zip(g.iter()) {
                    *y = g - *y;
                }
                let mut sums = [[0.0; 3]; BASIS_SIZE + 2];
                for (sum, &other) in sums.iter_mut().zip(&others) {
                    *sum = dot_three(
                        &basis[other][chunk * CHUNK_COORDINATES..][..s.len()],
                        s,
                        y,
                        g,
                    );
                }
                sums[BASIS_SIZE - 1] = dot_three(s, s, y, g);
                sums[BASIS_SIZE] = dot_three(y, s, y, g);
                sums[BASIS_SIZE + 1] = dot_three(g, s, y, g);
                std::array::from_fn(|k| sums[k / 3][k % 3])
            })
            .collect();
        let total = self.halo.all_reduce_sum(partial)?;
        let (total, _) = total.as_chunks::<3>();
        let new_indices = [slot, MEMORY_STEPS + slot, GRADIENT_INDEX];
        for (sum, &other) in total.iter().zip(&others) {
            for k in 0..3 {
                self.gram[new_indices[k]][other] = sum[k];
                self.gram[other][new_indices[k]] = sum[k];
            }
        }
        for (k, sum) in total[BASIS_SIZE - 1..].iter().enumerate() {
            for (l, &value) in sum.iter().enumerate() {
                self.gram[new_indices[k]][new_indices[l]] = value;
            }
        }
        self.basis[slot] = s;
        self.basis[MEMORY_STEPS + slot] = y;
        self.basis[GRADIENT_INDEX] = g;
        let (ss, sy, yy) = (
            total[BASIS_SIZE - 1][0],
            total[BASIS_SIZE - 1][1],
            total[BASIS_SIZE][1],
        );
        if sy > 1e-6 * (ss * yy).sqrt() {
            self.live_slots.push(slot);
        }
        Ok(())
    }

    /// Writes the descent direction, in which no block of `D` coordinates (an atom) is longer than
    /// `max_length`. Returns its slope: the inner product with the gradient.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn direction<const D: usize>(&self, max_length: f32, direction: &mut [f32]) -> Result<f64> {
        let weights = self.coefficients();
        let terms: Vec<(f32, &[f32])> = (0..BASIS_SIZE)
            .filter(|&k| weights[k] != 0.0)
            .map(|k| (weights[k] as f32, self.basis[k].as_slice()))
            .collect();
        let gradient = &self.basis[GRADIENT_INDEX];
        let partial = direction
            .par_chunks_mut(CHUNK_COORDINATES)
            .enumerate()
            .map(|(chunk, direction)| {
                let range = chunk * CHUNK_COORDINATES..chunk * CHUNK_COORDINATES + direction.len();
                direction.fill(0.0);
                for (weight, vector) in &terms {
                    let (weight, vector) = (*weight, &vector[range.clone()]);
                    Arch::new().dispatch(AddScaledKernel {
                        weight,
                        vector,
                        target: direction,
                    });
                }
                for atom in direction.chunks_exact_mut(D) {
                    let length2: f32 = atom.iter().map(|c| c * c).sum();
                    if length2 > max_length * max_length {
                        let shrink = max_length / length2.sqrt();
                        atom.iter_mut().for_each(|c| *c *= shrink);
                    }
                }
                [dot(direction, &gradient[range])]
            })
            .collect();
        let [slope] = self.halo.all_reduce_sum(partial)?;
        Ok(slope)
    }

    /// Runs the two-loop recursion in the space of coefficients.
    fn coefficients(&self) -> [f64; BASIS_SIZE] {
        let gram = &self.gram;
        let product = |weights: &[f64; BASIS_SIZE], k: usize| -> f64 {
            let indices = self
                .live_slots
                .iter()
                .flat_map(|&j| [j, MEMORY_STEPS + j])
                .chain([GRADIENT_INDEX]);
            indices.map(|j| weights[j] * gram[j][k]).sum()
        };
        let mut weights = [0.0; BASIS_SIZE];
        weights[GRADIENT_INDEX] = -1.0;
        let mut alpha = [0.0; MEMORY_STEPS];
        for &k in self.live_slots.iter().rev() {
            alpha[k] = product(&weights, k) / gram[k][MEMORY_STEPS + k];
            weights[MEMORY_STEPS + k] -= alpha[k];
        }
        let scale = match self.live_slots.last() {
            Some(&k) => gram[k][MEMORY_STEPS + k] / gram[MEMORY_STEPS + k][MEMORY_STEPS + k],
            None => self.initial_inverse_curvature,
        };
        weights.iter_mut().for_each(|w| *w *= scale);
        for &k in &self.live_slots {
            let beta = product(&weights, MEMORY_STEPS + k) / gram[k][MEMORY_STEPS + k];
            weights[k] += alpha[k] - beta;
        }
        weights
    }
}

/// Returns the inner product of two chunks.
pub fn dot(a: &[f32], b: &[f32]) -> f64 {
    Arch::new().dispatch(DotKernel { a, others: [b] })[0]
}

/// Returns the inner products of `a` with three other chunks in one pass.
fn dot_three(a: &[f32], s: &[f32], y: &[f32], g: &[f32]) -> [f64; 3] {
    Arch::new().dispatch(DotKernel {
        a,
        others: [s, y, g],
    })
}

/// Inner products of one chunk with `N` others.
struct DotKernel<'a, const N: usize> {
    a: &'a [f32],
    others: [&'a [f32]; N],
}

impl<const N: usize> WithSimd for DotKernel<'_, N> {
    type Output = [f64; N];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> [f64; N] {
        self.others.map(
            #[inline(always)]
            |other| dot_in_lanes(self.a, other),
        )
    }
}

/// Returns the inner product in sixteen running sums, which the compiler keeps in vector registers.
#[inline(always)]
fn dot_in_lanes(a: &[f32], b: &[f32]) -> f64 {
    const LANE_COUNT: usize = 16;
    let mut sums = [0.0f32; LANE_COUNT];
    let (blocks_a, blocks_b) = (a.chunks_exact(LANE_COUNT), b.chunks_exact(LANE_COUNT));
    let rest = blocks_a.remainder().iter().zip(blocks_b.remainder());
    let rest: f32 = rest.map(|(a, b)| a * b).sum();
    for (a, b) in blocks_a.zip(blocks_b) {
        for l in 0..LANE_COUNT {
            sums[l] += a[l] * b[l];
        }
    }
    sums.iter().map(|&s| f64::from(s)).sum::<f64>() + f64::from(rest)
}

/// Adds a multiple of a chunk to another.
struct AddScaledKernel<'a> {
    weight: f32,
    vector: &'a [f32],
    target: &'a mut [f32],
}

impl WithSimd for AddScaledKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (sum, v) in self.target.iter_mut().zip(self.vector) {
            *sum += self.weight * v;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Minimises with unit steps and plain halving. Returns the count of evaluations.
    fn minimise(f: impl Fn(&[f64]) -> (f64, Vec<f32>), x: &mut Vec<f64>, tolerance: f64) -> usize {
        let (mut value, gradient) = f(x);
        let halo = OwnedAndGhosts::all(x.len());
        let mut memory = Lbfgs::new(gradient, 1e-3, &halo).unwrap();
        let mut direction = vec![0.0f32; x.len()];
        for evaluations in 1..2000 {
            let slope = memory.direction::<1>(10.0, &mut direction).unwrap();
            assert!(slope <= 0.0);
            let mut alpha = 1.0;
            let (next, evaluated) = loop {
                let next: Vec<f64> = x
                    .iter()
                    .zip(&direction)
                    .map(|(x, p)| x + alpha * f64::from(*p))
                    .collect();
                let evaluated = f(&next);
                if evaluated.0 <= value + 1e-4 * alpha * slope || alpha < 1e-12 {
                    break (next, evaluated);
                }
                alpha *= 0.5;
            };
            let old = x.clone();
            *x = next;
            value = evaluated.0;
            memory
                .advance(|chunk, s, g| {
                    let first = chunk * CHUNK_COORDINATES;
                    for n in 0..s.len() {
                        s[n] = (x[first + n] - old[first + n]) as f32;
                        g[n] = evaluated.1[first + n];
                    }
                })
                .unwrap();
            if value < tolerance {
                return evaluations;
            }
        }
        usize::MAX
    }

    fn rosenbrock(x: &[f64]) -> (f64, Vec<f32>) {
        let (mut value, mut gradient) = (0.0, vec![0.0f64; x.len()]);
        for n in 0..x.len() - 1 {
            let (a, b) = (1.0 - x[n], x[n + 1] - x[n] * x[n]);
            value += a * a + 100.0 * b * b;
            gradient[n] += -2.0 * a - 400.0 * x[n] * b;
            gradient[n + 1] += 200.0 * b;
        }
        (value, gradient.iter().map(|&g| g as f32).collect())
    }

    #[test]
    fn finds_the_minimum_of_rosenbrock() {
        let mut x = vec![-1.2, 1.0];
        let steps = minimise(rosenbrock, &mut x, 1e-9);
        assert!(steps < 80, "{steps}");
        assert!((x[0] - 1.0).abs() < 1e-4 && (x[1] - 1.0).abs() < 1e-4);
        let mut x = vec![-1.0; 20];
        let steps = minimise(rosenbrock, &mut x, 1e-8);
        assert!(steps < 400, "{steps}");
    }

    #[test]
    fn is_newton_like_on_quadratics_larger_than_a_chunk() {
        let n = 2 * CHUNK_COORDINATES + 17;
        let curvature = |k: usize| 1.0 + (k % 4) as f64;
        let quadratic = |x: &[f64]| {
            let value = x
                .iter()
                .enumerate()
                .map(|(k, x)| 0.5 * curvature(k) * x * x)
                .sum();
            (
                value,
                x.iter()
                    .enumerate()
                    .map(|(k, x)| (curvature(k) * x) as f32)
                    .collect(),
            )
        };
        let mut x: Vec<f64> = (0..n).map(|k| (k as f64).sin()).collect();
        let steps = minimise(quadratic, &mut x, 1e-7 * n as f64);
        assert!(steps < 15, "{steps}");
    }

    #[test]
    fn no_atom_moves_farther_than_allowed() {
        let gradient = vec![3.0, 4.0, 0.0, 0.1, 0.0, 0.0];
        let mut direction = vec![0.0; 6];
        let halo = OwnedAndGhosts::all(2);
        let memory = Lbfgs::new(gradient, 1.0, &halo).unwrap();
        let slope = memory.direction::<3>(0.25, &mut direction).unwrap();
        assert!((direction[0] + 0.15).abs() < 1e-7 && (direction[1] + 0.2).abs() < 1e-7);
        assert_eq!(direction[3], -0.1);
        assert!((slope + 1.25 + 0.01).abs() < 1e-6);
    }
}

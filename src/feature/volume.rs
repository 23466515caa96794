//! Finite differences of an image in memory; outside, samples repeat those of the sides.

use super::symmetric::Matrix;
use rayon::prelude::*;

/// Rows per parallel task: fixed, so that results do not depend on the threads.
const ROWS: usize = 128;

/// The samples of an image, borrowed, x fastest.
#[derive(Debug, Clone, Copy)]
pub struct Volume<'a, const D: usize> {
    /// Number of samples along each axis, x first.
    pub dims: [usize; D],
    /// The samples.
    pub samples: &'a [f32],
}

impl<const D: usize> Volume<'_, D> {
    /// Index of a sample in memory.
    #[inline]
    pub fn index(&self, at: [usize; D]) -> usize {
        (0..D).rev().fold(0, |i, k| i * self.dims[k] + at[k])
    }

    /// Coordinates of a sample in memory.
    #[inline]
    pub fn coordinates(&self, index: usize) -> [usize; D] {
        let mut rest = index;
        std::array::from_fn(|k| {
            let i = rest % self.dims[k];
            rest /= self.dims[k];
            i
        })
    }

    /// How far apart in memory neighbours along each axis are.
    #[inline]
    pub fn strides(&self) -> [usize; D] {
        let mut stride = 1;
        std::array::from_fn(|k| {
            let this = stride;
            stride *= self.dims[k];
            this
        })
    }

    /// What `visit` finds in each row of x, given its first sample, in the order of rows. The scratch
    /// that it may use holds anything.
    pub fn by_rows<T: Send>(
        &self,
        visit: impl Fn([usize; D], &mut Vec<f32>, &mut Vec<T>) + Sync,
    ) -> Vec<T> {
        let rows = self.samples.len() / self.dims[0].max(1);
        let parts: Vec<Vec<T>> = (0..rows.div_ceil(ROWS))
            .into_par_iter()
            .map(|part| {
                let (mut scratch, mut found) = (Vec::new(), Vec::new());
                for row in part * ROWS..((part + 1) * ROWS).min(rows) {
                    let first = self.coordinates(row * self.dims[0]);
                    visit(first, &mut scratch, &mut found);
                }
                found
            })
            .collect();
        let mut all = Vec::with_capacity(parts.iter().map(Vec::len).sum());
        for part in parts {
            all.extend(part);
        }
        all
    }

    /// For each axis, how far in memory the neighbours before and after `at` are.
    #[inline]
    fn neighbours(&self, at: [usize; D]) -> ([usize; D], [usize; D]) {
        let strides = self.strides();
        (
            std::array::from_fn(|k| if at[k] > 0 { strides[k] } else { 0 }),
            std::array::from_fn(|k| {
                if at[k] + 1 < self.dims[k] {
                    strides[k]
                } else {
                    0
                }
            }),
        )
    }

    /// Central differences.
    #[inline]
    pub fn gradient(&self, at: [usize; D]) -> [f32; D] {
        let (before, after) = self.neighbours(at);
        let i = self.index(at);
        std::array::from_fn(|k| 0.5 * (self.samples[i + after[k]] - self.samples[i - before[k]]))
    }

    /// Second differences.
    #[inline]
    pub fn hessian(&self, at: [usize; D]) -> Matrix<D> {
        let (before, after) = self.neighbours(at);
        let (s, i) = (self.samples, self.index(at));
        let twice = 2.0 * s[i];
        let mut hessian = [[0.0; D]; D];
        for k in 0..D {
            hessian[k][k] = f64::from(s[i + after[k]] + s[i - before[k]] - twice);
            for l in k + 1..D {
                let mixed = 0.25
                    * (s[i + after[k] + after[l]]
                        - s[i + after[k] - before[l]]
                        - s[i + after[l] - before[k]]
                        + s[i - before[k] - before[l]]);
                hessian[k][l] = f64::from(mixed);
                hessian[l][k] = hessian[k][l];
            }
        }
        hessian
    }

    /// The sum of the pure second differences along the row of x from `first`.
    pub fn laplacian(&self, first: [usize; D], out: &mut Vec<f32>) {
        let nx = self.dims[0];
        let (before, after) = self.neighbours(first);
        let i = self.index(first);
        let row = |start: usize| &self.samples[start..start + nx];
        let c = row(i);
        out.clear();
        out.resize(nx, 0.0);
        let last = nx - 1;
        for x in 1..last.max(1) {
            out[x] = c[x - 1] + c[x + 1];
        }
        for x in [0, last] {
            out[x] = c[x.saturating_sub(1)] + c[(x + 1).min(last)];
        }
        for k in 1..D {
            let (a, b) = (row(i + after[k]), row(i - before[k]));
            for (out, (a, b)) in out.iter_mut().zip(a.iter().zip(b)) {
                *out += a + b;
            }
        }
        let centre = 2.0 * D as f32;
        for (out, c) in out.iter_mut().zip(c) {
            *out -= centre * c;
        }
    }

    /// Length of the gradient at every sample.
    pub fn gradient_magnitude(&self) -> Vec<f32> {
        self.by_rows(|first, _, out| {
            out.extend((0..self.dims[0]).map(|x| {
                let mut at = first;
                at[0] = x;
                self.gradient(at).iter().map(|g| g * g).sum::<f32>().sqrt()
            }));
        })
    }
}

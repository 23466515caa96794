//! Finite differences of an image in memory. Beyond the sides, samples repeat those on the sides.

use crate::geometry::eigen::SymmetricMatrix;
use crate::geometry::grid_index::{index_at, offset_of, strides};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use std::ops::Range;

/// Number of rows per parallel task: fixed, so that results do not depend on the number of threads.
const ROWS_PER_TASK: usize = 128;

/// The samples of an image, borrowed, x fastest.
#[derive(Debug, Clone, Copy)]
pub struct Volume<'a, const D: usize> {
    /// Number of samples along each axis, x first.
    pub dims: [usize; D],
    /// The samples.
    pub samples: &'a [f32],
}

impl<'a, const D: usize> Volume<'a, D> {
    /// Wraps the samples of an image; `samples` may be empty if only the shape matters.
    pub fn new(dims: [usize; D], samples: &'a [f32]) -> Self {
        Self { dims, samples }
    }

    /// Returns the index in memory of a sample.
    #[inline]
    pub fn index(&self, at: [usize; D]) -> usize {
        offset_of(self.dims, at)
    }

    /// Returns the coordinates of a sample.
    #[inline]
    pub fn coordinates(&self, index: usize) -> [usize; D] {
        index_at(self.dims, index)
    }

    /// Returns the distance in memory between neighbours along each axis.
    #[inline]
    pub fn strides(&self) -> [usize; D] {
        strides(self.dims)
    }

    /// Collects what `visit` finds in each row of x, given its first sample, in the order of rows.
    /// `visit` may use its scratch value, whose contents are arbitrary.
    pub fn map_rows<S: Default, T: Send>(
        &self,
        cancel: &CancelToken<'_>,
        visit: impl Fn([usize; D], &mut S, &mut Vec<T>) + Sync,
    ) -> Vec<T> {
        let rows = self.samples.len() / self.dims[0].max(1);
        self.map_selected_rows(0..rows, cancel, visit)
    }

    /// Collects what `visit` finds in some of the rows; see [`Volume::map_rows`].
    pub fn map_selected_rows<S: Default, T: Send>(
        &self,
        rows: Range<usize>,
        cancel: &CancelToken<'_>,
        visit: impl Fn([usize; D], &mut S, &mut Vec<T>) + Sync,
    ) -> Vec<T> {
        let parts: Vec<Vec<T>> = (0..rows.len().div_ceil(ROWS_PER_TASK))
            .into_par_iter()
            .map(|part| {
                let (mut scratch, mut found) = (S::default(), Vec::new());
                let first = rows.start + part * ROWS_PER_TASK;
                for row in first..(first + ROWS_PER_TASK).min(rows.end) {
                    if cancel.is_cancelled() {
                        break;
                    }
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

    /// Returns the distances in memory to the neighbours before and after `at` along each axis; 0
    /// on a side.
    #[inline]
    pub fn neighbour_offsets(&self, at: [usize; D]) -> ([usize; D], [usize; D]) {
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

    /// Returns the gradient by central differences.
    #[inline]
    pub fn gradient(&self, at: [usize; D]) -> [f32; D] {
        let (before, after) = self.neighbour_offsets(at);
        let i = self.index(at);
        std::array::from_fn(|k| 0.5 * (self.samples[i + after[k]] - self.samples[i - before[k]]))
    }

    /// Returns the second derivatives: fourth-order differences if two samples to either side are
    /// inside, else [`Volume::hessian`]. Second-order differences turn the eigenvectors of narrow
    /// ridges, fourth-order ones do not.
    pub fn second_derivatives(&self, at: [usize; D]) -> SymmetricMatrix<D> {
        if (0..D).any(|k| at[k] < 2 || at[k] + 2 >= self.dims[k]) {
            return self.hessian(at);
        }
        // Weights of fourth-order central differences, by offset along the axis.
        const FIRST_WEIGHTS: [(isize, f32); 4] = [(-2, 1.0), (-1, -8.0), (1, 8.0), (2, -1.0)];
        const SECOND_WEIGHTS: [(isize, f32); 4] = [(-2, -1.0), (-1, 16.0), (1, 16.0), (2, -1.0)];
        let (strides, i) = (self.strides().map(|s| s as isize), self.index(at));
        let sample = |offset: isize| self.samples[i.wrapping_add_signed(offset)];
        let mut matrix = [[0.0; D]; D];
        for k in 0..D {
            let mut pure = -30.0 * sample(0);
            for (a, weight) in SECOND_WEIGHTS {
                pure += weight * sample(a * strides[k]);
            }
            matrix[k][k] = f64::from(pure) / 12.0;
            for l in k + 1..D {
                let mut mixed = 0.0;
                for (a, first) in FIRST_WEIGHTS {
                    for (b, second) in FIRST_WEIGHTS {
                        mixed += first * second * sample(a * strides[k] + b * strides[l]);
                    }
                }
                matrix[k][l] = f64::from(mixed) / 144.0;
                matrix[l][k] = matrix[k][l];
            }
        }
        matrix
    }

    /// Returns the sum of second differences along the axes.
    #[inline]
    pub fn laplacian(&self, at: [usize; D]) -> f32 {
        let (before, after) = self.neighbour_offsets(at);
        let (s, i) = (self.samples, self.index(at));
        (0..D)
            .map(|k| s[i + after[k]] + s[i - before[k]] - 2.0 * s[i])
            .sum()
    }

    /// Returns the matrix of second differences.
    #[inline]
    pub fn hessian(&self, at: [usize; D]) -> SymmetricMatrix<D> {
        let (before, after) = self.neighbour_offsets(at);
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
}

//! Finite differences of a volume; outside, samples repeat those of the sides.

use rayon::prelude::*;

/// A borrowed volume, x fastest.
#[derive(Debug, Clone, Copy)]
pub struct Volume<'a> {
    /// Number of samples along each axis, x first.
    pub dims: [usize; 3],
    /// The samples.
    pub samples: &'a [f32],
}

impl Volume<'_> {
    /// Index of a sample in memory.
    #[inline]
    pub fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.dims[1] + y) * self.dims[0] + x
    }

    /// For each axis, how far in memory the neighbours before and after `at` are.
    #[inline]
    fn neighbours(&self, at: [usize; 3]) -> ([usize; 3], [usize; 3]) {
        let strides = [1, self.dims[0], self.dims[0] * self.dims[1]];
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
    pub fn gradient(&self, at: [usize; 3]) -> [f32; 3] {
        let (before, after) = self.neighbours(at);
        let i = self.index(at);
        std::array::from_fn(|k| 0.5 * (self.samples[i + after[k]] - self.samples[i - before[k]]))
    }

    /// Second differences `[xx, yy, zz, xy, xz, yz]`.
    #[inline]
    pub fn hessian(&self, at: [usize; 3]) -> [f32; 6] {
        let (before, after) = self.neighbours(at);
        let (s, i) = (self.samples, self.index(at));
        let twice = 2.0 * s[i];
        let pure = |k: usize| s[i + after[k]] + s[i - before[k]] - twice;
        let mixed = |k: usize, l: usize| {
            0.25 * (s[i + after[k] + after[l]]
                - s[i + after[k] - before[l]]
                - s[i + after[l] - before[k]]
                + s[i - before[k] - before[l]])
        };
        [
            pure(0),
            pure(1),
            pure(2),
            mixed(0, 1),
            mixed(0, 2),
            mixed(1, 2),
        ]
    }

    /// Length of the gradient at every sample.
    pub fn gradient_magnitude(&self) -> Vec<f32> {
        let [nx, ny, _] = self.dims;
        let mut out = vec![0.0; self.samples.len()];
        out.par_chunks_mut((nx * ny).max(1))
            .enumerate()
            .for_each(|(z, plane)| {
                for (i, out) in plane.iter_mut().enumerate() {
                    let [a, b, c] = self.gradient([i % nx, i / nx, z]);
                    *out = (a * a + b * b + c * c).sqrt();
                }
            });
        out
    }

    /// The sum of the three pure second differences along the row `[y, z]`.
    pub fn laplacian(&self, [y, z]: [usize; 2], out: &mut Vec<f32>) {
        let nx = self.dims[0];
        let (before, after) = self.neighbours([0, y, z]);
        let i = self.index([0, y, z]);
        let row = |start: usize| &self.samples[start..start + nx];
        let (c, n, s) = (row(i), row(i + after[1]), row(i - before[1]));
        let (u, d) = (row(i + after[2]), row(i - before[2]));
        out.clear();
        out.resize(nx, 0.0);
        let last = nx - 1;
        for x in 1..last.max(1) {
            out[x] = c[x - 1] + c[x + 1] + n[x] + s[x] + u[x] + d[x] - 6.0 * c[x];
        }
        for x in [0, last] {
            let ends = c[x.saturating_sub(1)] + c[(x + 1).min(last)];
            out[x] = ends + n[x] + s[x] + u[x] + d[x] - 6.0 * c[x];
        }
    }
}

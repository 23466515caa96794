//! Sparse matrices by rows and the few vector operations that iterative solvers need. Every sum is
//! taken in chunks of fixed size and fixed order, so results do not depend on the number of threads.

use crate::parallel::prelude::*;

/// Rows (or vector elements) that one task handles.
const CHUNK_ROWS: usize = 4096;

/// A matrix by compressed rows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Matrix {
    /// Row r is `start[r]..start[r + 1]` in `columns` and `values`.
    pub start: Vec<u32>,
    /// Column numbers; in no particular order within a row, none twice.
    pub columns: Vec<u32>,
    /// The entries.
    pub values: Vec<f64>,
    /// Number of columns.
    pub width: usize,
}

/// A row in the making: entries of the same column are summed.
pub struct RowBuilder<'a> {
    columns: &'a mut Vec<u32>,
    values: &'a mut Vec<f64>,
    /// Where a column stands in the row, if it does; stale for others.
    entry_index: &'a mut [u32],
    row_start: usize,
}

impl RowBuilder<'_> {
    /// Adds `value` to the entry of `column`.
    #[inline]
    pub fn add(&mut self, column: u32, value: f64) {
        let at = self.entry_index[column as usize] as usize;
        if at >= self.row_start && self.columns.get(at) == Some(&column) {
            self.values[at] += value;
        } else {
            self.entry_index[column as usize] = self.columns.len() as u32;
            self.columns.push(column);
            self.values.push(value);
        }
    }
}

impl Matrix {
    /// Builds a matrix row by row, in parallel: `fill(r, row)` adds the entries of row `r`.
    pub fn from_rows(
        height: usize,
        width: usize,
        fill: impl Fn(usize, &mut RowBuilder) + Sync,
    ) -> Self {
        type RowChunk = (Vec<u32>, Vec<u32>, Vec<f64>);
        let parts: Vec<RowChunk> = (0..height.div_ceil(CHUNK_ROWS))
            .into_par_iter()
            .map_init(
                || vec![0; width],
                |place, chunk| {
                    let rows = chunk * CHUNK_ROWS..height.min((chunk + 1) * CHUNK_ROWS);
                    let mut ends = Vec::with_capacity(rows.len());
                    let (mut columns, mut values) = (Vec::new(), Vec::new());
                    for r in rows {
                        let begin = columns.len();
                        let mut row = RowBuilder {
                            columns: &mut columns,
                            values: &mut values,
                            entry_index: place,
                            row_start: begin,
                        };
                        fill(r, &mut row);
                        ends.push(columns.len() as u32);
                    }
                    (ends, columns, values)
                },
            )
            .collect();
        let entries = parts.iter().map(|part| part.1.len()).sum();
        let mut matrix = Self {
            start: Vec::with_capacity(height + 1),
            columns: Vec::with_capacity(entries),
            values: Vec::with_capacity(entries),
            width,
        };
        matrix.start.push(0);
        for (ends, columns, values) in parts {
            let base = matrix.columns.len() as u32;
            matrix.start.extend(ends.into_iter().map(|end| base + end));
            matrix.columns.extend_from_slice(&columns);
            matrix.values.extend_from_slice(&values);
        }
        matrix
    }

    /// Number of rows.
    #[inline]
    pub fn height(&self) -> usize {
        self.start.len() - 1
    }

    /// The entries of row `r`: columns and values.
    #[inline]
    pub fn row(&self, r: usize) -> (&[u32], &[f64]) {
        let range = self.start[r] as usize..self.start[r + 1] as usize;
        (&self.columns[range.clone()], &self.values[range])
    }

    /// Row `r` times `x`.
    #[inline]
    pub fn row_dot(&self, r: usize, x: &[f64]) -> f64 {
        let (columns, values) = self.row(r);
        columns
            .iter()
            .zip(values)
            .map(|(&c, v)| v * x[c as usize])
            .sum()
    }

    /// `y = A x`.
    pub fn times(&self, x: &[f64], y: &mut [f64]) {
        for_each(y, |r, y| *y = self.row_dot(r, x));
    }

    /// The diagonal, 0 where there is none.
    pub fn diagonal(&self) -> Vec<f64> {
        let entry = |r: usize| {
            let (columns, values) = self.row(r);
            let at = columns.iter().position(|&c| c as usize == r);
            at.map_or(0.0, |at| values[at])
        };
        (0..self.height()).into_par_iter().map(entry).collect()
    }

    /// The matrix product `A B`.
    pub fn product(&self, other: &Self) -> Self {
        Self::from_rows(self.height(), other.width, |r, row| {
            let (columns, values) = self.row(r);
            for (&k, &a) in columns.iter().zip(values) {
                let (columns, values) = other.row(k as usize);
                for (&c, &b) in columns.iter().zip(values) {
                    row.add(c, a * b);
                }
            }
        })
    }

    /// The transposed matrix.
    pub fn transpose(&self) -> Self {
        let mut start = vec![0u32; self.width + 1];
        for &c in &self.columns {
            start[c as usize + 1] += 1;
        }
        for c in 0..self.width {
            start[c + 1] += start[c];
        }
        let mut next = start.clone();
        let mut columns = vec![0; self.columns.len()];
        let mut values = vec![0.0; self.columns.len()];
        for r in 0..self.height() {
            let (row_columns, row_values) = self.row(r);
            for (&c, &v) in row_columns.iter().zip(row_values) {
                let at = &mut next[c as usize];
                columns[*at as usize] = r as u32;
                values[*at as usize] = v;
                *at += 1;
            }
        }
        Self {
            start,
            columns,
            values,
            width: self.height(),
        }
    }
}

/// `f(i, &mut y[i])` for all i, in parallel.
#[inline]
pub fn for_each(y: &mut [f64], f: impl Fn(usize, &mut f64) + Sync) {
    y.par_chunks_mut(CHUNK_ROWS)
        .enumerate()
        .for_each(|(k, part)| {
            for (i, y) in part.iter_mut().enumerate() {
                f(k * CHUNK_ROWS + i, y);
            }
        });
}

/// The sum of `f(i)` for i below `count`, the same for any number of threads.
#[inline]
pub fn sum(count: usize, f: impl Fn(usize) -> f64 + Sync) -> f64 {
    let part = |k: usize| {
        (k * CHUNK_ROWS..count.min((k + 1) * CHUNK_ROWS))
            .map(&f)
            .sum::<f64>()
    };
    let parts: Vec<f64> = (0..count.div_ceil(CHUNK_ROWS))
        .into_par_iter()
        .map(part)
        .collect();
    parts.into_iter().sum()
}

/// Scalar product.
#[inline]
pub fn dot(x: &[f64], y: &[f64]) -> f64 {
    sum(x.len(), |i| x[i] * y[i])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dense(matrix: &Matrix) -> Vec<Vec<f64>> {
        let mut all = vec![vec![0.0; matrix.width]; matrix.height()];
        for r in 0..matrix.height() {
            let (columns, values) = matrix.row(r);
            for (&c, &v) in columns.iter().zip(values) {
                assert_eq!(all[r][c as usize], 0.0, "column {c} twice in row {r}");
                all[r][c as usize] = v;
            }
        }
        all
    }

    /// A matrix of pseudo-random small whole numbers, longer than a chunk.
    fn random_matrix(height: usize, width: usize, seed: usize) -> Matrix {
        Matrix::from_rows(height, width, |r, row| {
            for k in 0..5 {
                let mixed = (r * 31 + k * 17 + seed).wrapping_mul(2_654_435_761) >> 7;
                row.add((mixed % width) as u32, ((mixed >> 8) % 7) as f64 + 1.0);
            }
        })
    }

    #[test]
    fn product_transposition_and_vectors_agree_with_dense_arithmetic() {
        let (a, b) = (
            random_matrix(CHUNK_ROWS + 37, 23, 1),
            random_matrix(23, 11, 2),
        );
        let (full_a, full_b) = (dense(&a), dense(&b));
        let product = dense(&a.product(&b));
        let turned = dense(&a.transpose());
        let x: Vec<f64> = (0..23).map(|i| i as f64 - 9.0).collect();
        let mut y = vec![0.0; a.height()];
        a.times(&x, &mut y);
        for r in 0..a.height() {
            for c in 0..11 {
                let want: f64 = (0..23).map(|k| full_a[r][k] * full_b[k][c]).sum();
                assert_eq!(product[r][c], want);
            }
            for c in 0..23 {
                assert_eq!(turned[c][r], full_a[r][c]);
            }
            let want: f64 = (0..23).map(|k| full_a[r][k] * x[k]).sum();
            assert_eq!(y[r], want);
        }
        let square: f64 = y.iter().map(|v| v * v).sum();
        assert_eq!(dot(&y, &y), square);
        let diagonal = a.diagonal();
        assert!((0..23).all(|i| diagonal[i] == full_a[i][i]));
    }
}

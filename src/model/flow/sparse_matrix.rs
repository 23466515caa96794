//! Sparse matrices in compressed rows, and the vector operations that iterative solvers need. Every
//! sum is taken in chunks of fixed size and order, so that results do not depend on the number of
//! threads.

use crate::parallel::prelude::*;

/// Number of rows (or vector elements) that one task handles.
const CHUNK_ROWS: usize = 4096;

/// A matrix in compressed rows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Matrix {
    /// The range `start[r]..start[r + 1]` of `columns` and `values` holds row r.
    pub start: Vec<u32>,
    /// Column numbers. They are in no particular order within a row, and none occurs twice.
    pub columns: Vec<u32>,
    /// The entries.
    pub values: Vec<f64>,
    /// Number of columns.
    pub width: usize,
}

/// Builds a row: sums entries of the same column.
pub struct RowBuilder<'a> {
    columns: &'a mut Vec<u32>,
    values: &'a mut Vec<f64>,
    /// The index of each column's entry, if the row has one; outdated for other columns.
    entry_index: &'a mut [u32],
    row_start: usize,
}

impl RowBuilder<'_> {
    /// Adds `value` to the entry of `column`.
    #[inline]
    pub fn add(&mut self, column: u32, value: f64) {
        let index = self.entry_index[column as usize] as usize;
        if index >= self.row_start && self.columns.get(index) == Some(&column) {
            self.values[index] += value;
        } else {
            self.entry_index[column as usize] = self.columns.len() as u32;
            self.columns.push(column);
            self.values.push(value);
        }
    }
}

impl Matrix {
    /// Builds a matrix row by row, in parallel. `fill(r, row)` adds the entries of row `r`.
    pub fn from_rows(
        height: usize,
        width: usize,
        fill: impl Fn(usize, &mut RowBuilder) + Sync,
    ) -> Self {
        type RowChunk = (Vec<u32>, Vec<u32>, Vec<f64>);
        let chunks: Vec<RowChunk> = (0..height.div_ceil(CHUNK_ROWS))
            .into_par_iter()
            .map_init(
                || vec![0; width],
                |entry_index, chunk| {
                    let rows = chunk * CHUNK_ROWS..height.min((chunk + 1) * CHUNK_ROWS);
                    let mut ends = Vec::with_capacity(rows.len());
                    let (mut columns, mut values) = (Vec::new(), Vec::new());
                    for r in rows {
                        let begin = columns.len();
                        let mut row = RowBuilder {
                            columns: &mut columns,
                            values: &mut values,
                            entry_index,
                            row_start: begin,
                        };
                        fill(r, &mut row);
                        ends.push(columns.len() as u32);
                    }
                    (ends, columns, values)
                },
            )
            .collect();
        let entries = chunks.iter().map(|chunk| chunk.1.len()).sum();
        let mut matrix = Self {
            start: Vec::with_capacity(height + 1),
            columns: Vec::with_capacity(entries),
            values: Vec::with_capacity(entries),
            width,
        };
        matrix.start.push(0);
        for (ends, columns, values) in chunks {
            let base = matrix.columns.len() as u32;
            matrix.start.extend(ends.into_iter().map(|end| base + end));
            matrix.columns.extend_from_slice(&columns);
            matrix.values.extend_from_slice(&values);
        }
        matrix
    }

    /// Returns the number of rows.
    #[inline]
    pub fn height(&self) -> usize {
        self.start.len() - 1
    }

    /// Returns the columns and values of row `r`.
    #[inline]
    pub fn row(&self, r: usize) -> (&[u32], &[f64]) {
        let range = self.start[r] as usize..self.start[r + 1] as usize;
        (&self.columns[range.clone()], &self.values[range])
    }

    /// Returns the scalar product of row `r` and `x`.
    #[inline]
    pub fn row_dot(&self, r: usize, x: &[f64]) -> f64 {
        let (columns, values) = self.row(r);
        columns
            .iter()
            .zip(values)
            .map(|(&c, v)| v * x[c as usize])
            .sum()
    }

    /// Computes `y = A x`.
    pub fn times(&self, x: &[f64], y: &mut [f64]) {
        for_each(y, |r, y| *y = self.row_dot(r, x));
    }

    /// Returns the diagonal, with 0 where there is no entry.
    pub fn diagonal(&self) -> Vec<f64> {
        let entry = |r: usize| {
            let (columns, values) = self.row(r);
            let index = columns.iter().position(|&c| c as usize == r);
            index.map_or(0.0, |index| values[index])
        };
        (0..self.height()).into_par_iter().map(entry).collect()
    }

    /// Returns the matrix product `A B`.
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

    /// Returns the transposed matrix.
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
                let position = &mut next[c as usize];
                columns[*position as usize] = r as u32;
                values[*position as usize] = v;
                *position += 1;
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

/// Calls `f(i, &mut y[i])` for all i, in parallel.
#[inline]
pub fn for_each(y: &mut [f64], f: impl Fn(usize, &mut f64) + Sync) {
    y.par_chunks_mut(CHUNK_ROWS)
        .enumerate()
        .for_each(|(k, chunk)| {
            for (i, y) in chunk.iter_mut().enumerate() {
                f(k * CHUNK_ROWS + i, y);
            }
        });
}

/// Returns the sum of `f(i)` for all i below `count`. The result is the same for any number of
/// threads.
#[inline]
pub fn sum(count: usize, f: impl Fn(usize) -> f64 + Sync) -> f64 {
    let chunk_sum = |k: usize| {
        (k * CHUNK_ROWS..count.min((k + 1) * CHUNK_ROWS))
            .map(&f)
            .sum::<f64>()
    };
    let chunk_sums: Vec<f64> = (0..count.div_ceil(CHUNK_ROWS))
        .into_par_iter()
        .map(chunk_sum)
        .collect();
    chunk_sums.into_iter().sum()
}

/// Returns the scalar product.
#[inline]
pub fn dot(x: &[f64], y: &[f64]) -> f64 {
    sum(x.len(), |i| x[i] * y[i])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dense(matrix: &Matrix) -> Vec<Vec<f64>> {
        let mut rows = vec![vec![0.0; matrix.width]; matrix.height()];
        for r in 0..matrix.height() {
            let (columns, values) = matrix.row(r);
            for (&c, &v) in columns.iter().zip(values) {
                assert_eq!(rows[r][c as usize], 0.0, "column {c} twice in row {r}");
                rows[r][c as usize] = v;
            }
        }
        rows
    }

    /// Returns a matrix of small pseudo-random integers.
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
        let transposed = dense(&a.transpose());
        let x: Vec<f64> = (0..23).map(|i| i as f64 - 9.0).collect();
        let mut y = vec![0.0; a.height()];
        a.times(&x, &mut y);
        for r in 0..a.height() {
            for c in 0..11 {
                let expected: f64 = (0..23).map(|k| full_a[r][k] * full_b[k][c]).sum();
                assert_eq!(product[r][c], expected);
            }
            for c in 0..23 {
                assert_eq!(transposed[c][r], full_a[r][c]);
            }
            let expected: f64 = (0..23).map(|k| full_a[r][k] * x[k]).sum();
            assert_eq!(y[r], expected);
        }
        let square: f64 = y.iter().map(|v| v * v).sum();
        assert_eq!(dot(&y, &y), square);
        let diagonal = a.diagonal();
        assert!((0..23).all(|i| diagonal[i] == full_a[i][i]));
    }
}

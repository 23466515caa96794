//! The needed samples of each row of a block and its margins.

use super::stencil::StencilTap;
use crate::geometry::simd::dispatch_simd;
use std::ops::Range;

/// Range of needed samples of each row of x in a square or cube.
pub struct RowRanges {
    /// Number of rows along each of the other axes.
    edge: usize,
    starts: Vec<i8>,
    ends: Vec<i8>,
}

/// Offset of a row, and the smallest and largest offset along it.
type RowShift = (isize, [i8; 2]);

impl RowRanges {
    /// Creates empty ranges. They stay empty when they are shifted along x by up to 39 samples.
    pub fn empty<const D: usize>(edge: usize) -> Self {
        let rows = edge.pow(D as u32 - 1);
        Self {
            edge,
            starts: vec![80; rows],
            ends: vec![-80; rows],
        }
    }

    /// Returns the number of rows.
    pub fn row_count(&self) -> usize {
        self.starts.len()
    }

    /// Extends the range of a row to include sample `x`.
    pub fn add(&mut self, row: usize, x: i8) {
        self.starts[row] = self.starts[row].min(x);
        self.ends[row] = self.ends[row].max(x + 1);
    }

    /// Extends the ranges to include all samples that `taps` read around the samples of `inner`,
    /// which lies in the middle and begins `margin_x` samples after the start of these rows.
    pub fn add_around<'a, const D: usize>(
        &mut self,
        inner: &Self,
        margin_x: usize,
        taps: impl Iterator<Item = &'a StencilTap<D>>,
    ) {
        let margin = (self.edge - inner.edge) / 2;
        let shifts = row_shifts(taps, self.edge);
        dispatch_simd(
            #[inline(always)]
            || {
                // Rows that are successive along the second axis are processed together.
                for line in 0..inner.row_count() / inner.edge {
                    let line_rows = line * inner.edge..(line + 1) * inner.edge;
                    let starts = &inner.starts[line_rows.clone()];
                    let ends = &inner.ends[line_rows];
                    if starts.iter().zip(ends).all(|(start, end)| start >= end) {
                        continue;
                    }
                    let (mut remaining, mut first, mut stride) = (line, margin, self.edge);
                    for _ in 2..D {
                        first += (margin + remaining % inner.edge) * stride;
                        remaining /= inner.edge;
                        stride *= self.edge;
                    }
                    for &(offset, shift) in &shifts {
                        let row = first.wrapping_add_signed(offset);
                        let [low, high] = shift.map(|shift| shift + margin_x as i8);
                        for (start, inner) in self.starts[row..].iter_mut().zip(starts) {
                            *start = (*start).min(inner + low);
                        }
                        for (end, inner) in self.ends[row..].iter_mut().zip(ends) {
                            *end = (*end).max(inner + high);
                        }
                    }
                }
            },
        );
    }

    /// Returns the range of a row.
    pub fn range(&self, row: usize) -> Range<usize> {
        if self.starts[row] < self.ends[row] {
            self.starts[row] as usize..self.ends[row] as usize
        } else {
            0..0
        }
    }
}

/// Returns the rows that taps read, each once, in a square or cube with this number of rows along an
/// axis.
fn row_shifts<'a, const D: usize>(
    taps: impl Iterator<Item = &'a StencilTap<D>>,
    edge: usize,
) -> Vec<RowShift> {
    let shift = |tap: &StencilTap<D>| -> RowShift {
        let row = (1..D)
            .rev()
            .fold(0, |row, k| row * edge as isize + tap.offset[k]);
        (row, [tap.offset[0] as i8; 2])
    };
    let mut shifts: Vec<RowShift> = taps.map(shift).collect();
    shifts.sort_unstable_by_key(|shift| shift.0);
    shifts.dedup_by(|next, kept| {
        let is_same = next.0 == kept.0;
        if is_same {
            kept.1 = [kept.1[0].min(next.1[0]), kept.1[1].max(next.1[1])];
        }
        is_same
    });
    shifts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_include_what_taps_read_and_nothing_in_other_rows() {
        let mut inner = RowRanges::empty::<3>(4);
        for x in [1, 2] {
            inner.add(4 * 2 + 3, x);
        }
        let tap = |offset| StencilTap {
            offset,
            weight: 1.0,
        };
        let taps = [tap([-1, 1, -2]), tap([3, 1, -2]), tap([0, 0, 0])];
        let mut outer = RowRanges::empty::<3>(8);
        outer.add_around(&inner, 5, taps.iter());
        for row in 0..64 {
            let expected = match (row % 8, row / 8) {
                (5, 4) => 6..8,
                (6, 2) => 5..11,
                _ => 0..0,
            };
            assert_eq!(outer.range(row), expected, "{row}");
        }
    }
}

//! Index of candidates by the sample that they belong to.

use super::candidate::Candidate;
use crate::geometry::grid_index::index_at;
use crate::parallel::prelude::*;

/// Number of samples per entry of the index, as a power of two. Candidates are sparse, so that a
/// short walk through a segment costs less than an entry for every sample.
const MIN_SEGMENT_BITS: u32 = 3;
/// Largest number of entries; larger volumes have more samples per entry.
const MAX_ENTRIES: usize = 1 << 24;
/// Number of entries that one thread computes at a time.
const ENTRIES_PER_TASK: usize = 1 << 16;

/// Returns the number of samples per entry of the index of a volume, as a power of two.
pub(super) fn segment_bits<const D: usize>(dims: [usize; D]) -> u32 {
    let count: usize = dims.iter().product();
    let mut shift = MIN_SEGMENT_BITS;
    while count >> shift > MAX_ENTRIES {
        shift += 1;
    }
    shift
}

/// Candidates, indexed by the sample that they belong to.
pub struct CandidateIndex<'a, const D: usize> {
    /// Number of samples along each axis.
    pub dims: [usize; D],
    /// Candidates in the order of samples.
    pub candidates: &'a [Candidate<D>],
    /// Lowest 32 bits of the index of each candidate's sample: within a row they are unique.
    voxels: Vec<u32>,
    /// Number of samples per segment, as a power of two.
    shift: u32,
    /// Index of the first candidate at or after the first sample of each segment.
    segment_starts: Vec<u32>,
}

impl<'a, const D: usize> CandidateIndex<'a, D> {
    /// Creates the index. `candidates` must be in the order of samples.
    pub fn new(dims: [usize; D], candidates: &'a [Candidate<D>]) -> Self {
        let shift = segment_bits(dims);
        let segments = (dims.iter().product::<usize>() >> shift) + 1;
        let voxels: Vec<u32> = candidates
            .par_iter()
            .map(|c| c.voxel.index() as u32)
            .collect();
        let mut segment_starts = vec![0u32; segments + 1];
        let parts = segment_starts.par_chunks_mut(ENTRIES_PER_TASK).enumerate();
        parts.for_each(|(part, start)| {
            let first = part * ENTRIES_PER_TASK;
            let before = |c: &Candidate<D>, segment| c.voxel.index() >> shift < segment;
            let mut next = candidates.partition_point(|c| before(c, first));
            for (segment, start) in (first..).zip(start) {
                while candidates.get(next).is_some_and(|c| before(c, segment)) {
                    next += 1;
                }
                *start = next as u32;
            }
        });
        Self {
            dims,
            candidates,
            voxels,
            shift,
            segment_starts,
        }
    }

    /// Returns the sample coordinates of a candidate.
    #[inline]
    pub fn coordinates(&self, c: &Candidate<D>) -> [i32; D] {
        index_at(self.dims, c.voxel.index()).map(|i| i as i32)
    }

    /// Calls `visit` for each candidate of the samples from `at` to `at + (length - 1)` along x
    /// that are inside the image.
    #[inline]
    pub fn for_each_in_row(&self, at: [i32; D], length: i32, mut visit: impl FnMut(usize)) {
        let mut row = 0usize;
        for k in (1..D).rev() {
            if at[k] < 0 || at[k] as usize >= self.dims[k] {
                return;
            }
            row = (row + at[k] as usize) * self.dims[k - 1];
        }
        let (low, high) = (at[0].max(0), (at[0] + length).min(self.dims[0] as i32));
        if low >= high {
            return;
        }
        let (low, length) = (row + low as usize, (high - low) as u32);
        let first = self.segment_starts[low >> self.shift] as usize;
        let end = self.segment_starts[((low + length as usize - 1) >> self.shift) + 1] as usize;
        for (i, voxel) in self.voxels[first..end].iter().enumerate() {
            if voxel.wrapping_sub(low as u32) < length {
                visit(first + i);
            }
        }
    }

    /// Calls `visit` for each candidate of the samples from `at` to `at + (length - 1)` along `axis`
    /// that are inside the image.
    #[inline]
    pub fn for_each_in_column(
        &self,
        at: [i32; D],
        axis: usize,
        length: i32,
        mut visit: impl FnMut(usize),
    ) {
        if axis == 0 {
            return self.for_each_in_row(at, length, visit);
        }
        let (mut stride, mut voxel) = (1, 0);
        for k in 0..D {
            if k != axis && (at[k] < 0 || at[k] as usize >= self.dims[k]) {
                return;
            }
            if k < axis {
                stride *= self.dims[k];
            }
        }
        let (low, high) = (
            at[axis].max(0),
            (at[axis] + length).min(self.dims[axis] as i32),
        );
        for k in (0..D).rev() {
            let i = if k == axis { low } else { at[k] };
            voxel = voxel * self.dims[k] + i.max(0) as usize;
        }
        for _ in low..high {
            let segment = voxel >> self.shift;
            let (first, end) = (
                self.segment_starts[segment] as usize,
                self.segment_starts[segment + 1] as usize,
            );
            for (i, v) in self.voxels[first..end].iter().enumerate() {
                if *v == voxel as u32 {
                    visit(first + i);
                }
            }
            voxel += stride;
        }
    }

    /// Calls `visit` for each candidate of the sample at these coordinates, if it is inside the
    /// image.
    #[inline]
    pub fn for_each_at(&self, at: [i32; D], visit: impl FnMut(usize)) {
        self.for_each_in_row(at, 1, visit);
    }

    /// Calls `visit` for each candidate of the samples at most `reach` away along each axis.
    #[inline]
    pub fn for_each_around(&self, at: [i32; D], reach: i32, mut visit: impl FnMut(usize)) {
        let side = 2 * reach + 1;
        let mut row = at;
        row[0] -= reach;
        for number in 0..side.pow(D as u32 - 1) {
            let mut remaining = number;
            for k in 1..D {
                row[k] = at[k] - reach + remaining % side;
                remaining /= side;
            }
            self.for_each_in_row(row, side, &mut visit);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::volume::Volume;

    #[test]
    fn visits_match_an_exhaustive_search() {
        let dims = [13, 7, 5];
        let candidates: Vec<Candidate<3>> = (0..13 * 7 * 5)
            .flat_map(|v| std::iter::repeat_n(v, [0, 0, 1, 0, 2, 0, 1][v * 31 % 7]))
            .map(|v| {
                let at = [v % 13, v / 13 % 7, v / 91];
                Candidate::new(dims, at, 0, 0.0, [1.0, 0.0, 0.0], 1.0)
            })
            .collect();
        let grid = CandidateIndex::new(dims, &candidates);
        for z in -2..7 {
            for y in -2..9 {
                for x in -2..15 {
                    for reach in 0..3 {
                        let mut found = Vec::new();
                        grid.for_each_around([x, y, z], reach, |i| found.push(i));
                        let is_near = |c: &Candidate<3>| {
                            let at = grid.coordinates(c);
                            (0..3).all(|k| (at[k] - [x, y, z][k]).abs() <= reach)
                        };
                        let expected: Vec<usize> = (0..candidates.len())
                            .filter(|&i| is_near(&candidates[i]))
                            .collect();
                        assert_eq!(found, expected);
                    }
                    for axis in 0..3 {
                        let mut found = Vec::new();
                        grid.for_each_in_column([x, y, z], axis, 4, |i| found.push(i));
                        let is_in_column = |c: &Candidate<3>| {
                            let at = grid.coordinates(c);
                            (0..3).all(|k| {
                                let length = if k == axis { 4 } else { 1 };
                                (0..length).contains(&(at[k] - [x, y, z][k]))
                            })
                        };
                        let expected: Vec<usize> = (0..candidates.len())
                            .filter(|&i| is_in_column(&candidates[i]))
                            .collect();
                        assert_eq!(found, expected);
                    }
                }
            }
        }
    }

    #[test]
    fn samples_beyond_32_bits_are_distinguished() {
        // In some of the last rows, and at samples whose lowest 32 bits are the same.
        let dims = [3000, 2000, 1000];
        let last = [2999, 1999, 999];
        let mut voxels: Vec<[usize; 3]> = vec![last, [0, 1999, 999], [17, 1998, 999]];
        let volume = Volume::new(dims, &[]);
        for at in voxels.clone() {
            voxels.push(volume.coordinates(volume.index(at) - (1 << 32)));
        }
        voxels.sort_by_key(|&at| volume.index(at));
        let candidates: Vec<Candidate<3>> = voxels
            .iter()
            .map(|&at| Candidate::new(dims, at, 0, 0.0, [1.0, 0.0, 0.0], 1.0))
            .collect();
        let grid = CandidateIndex::new(dims, &candidates);
        for (i, &at) in voxels.iter().enumerate() {
            let at = at.map(|x| x as i32);
            assert_eq!(grid.coordinates(&candidates[i]), at);
            let mut found = Vec::new();
            grid.for_each_at(at, |j| found.push(j));
            grid.for_each_in_column(at, 1, 1, |j| found.push(j));
            assert_eq!(found, [i, i]);
        }
        let mut found = Vec::new();
        grid.for_each_in_row([0, 1999, 999], 3000, |i| found.push(i));
        assert_eq!(found, [4, 5]);
        found.clear();
        grid.for_each_around([18, 1998, 998], 1, |i| found.push(i));
        assert_eq!(found, [3]);
    }
}

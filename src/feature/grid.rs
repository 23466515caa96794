//! Candidates by the sample they belong to.

use super::crossing::Candidate;

/// No candidate.
pub const NONE: u32 = u32::MAX;

/// Candidates by the sample they belong to.
pub struct Grid<'a> {
    /// Samples along each axis.
    pub dims: [usize; 3],
    /// In the order of samples.
    pub candidates: &'a [Candidate],
    /// First candidate of each sample, `NONE` if none; more follow it in the list.
    first: Vec<u32>,
}

impl<'a> Grid<'a> {
    /// `candidates` must be in the order of samples.
    pub fn new(dims: [usize; 3], candidates: &'a [Candidate]) -> Self {
        let mut first = vec![NONE; dims.iter().product()];
        for (i, c) in candidates.iter().enumerate().rev() {
            first[c.voxel as usize] = i as u32;
        }
        Self {
            dims,
            candidates,
            first,
        }
    }

    /// Sample coordinates of a candidate.
    pub fn coordinates(&self, c: &Candidate) -> [i32; 3] {
        let v = c.voxel as usize;
        let [nx, ny, _] = self.dims;
        [(v % nx) as i32, (v / nx % ny) as i32, (v / nx / ny) as i32]
    }

    /// Calls `visit` for each candidate of the sample at these coordinates, if it is inside.
    #[inline]
    pub fn each(&self, at: [i32; 3], mut visit: impl FnMut(usize)) {
        if (0..3).any(|k| at[k] < 0 || at[k] as usize >= self.dims[k]) {
            return;
        }
        let voxel =
            (at[2] as usize * self.dims[1] + at[1] as usize) * self.dims[0] + at[0] as usize;
        let mut i = self.first[voxel] as usize;
        while i < self.candidates.len() && self.candidates[i].voxel as usize == voxel {
            visit(i);
            i += 1;
        }
    }
}

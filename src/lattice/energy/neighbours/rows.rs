//! The rows of neighbours of a chunk of atoms.

use std::ops::Range;

use super::{FILLER, LANES};

/// The neighbours of up to [`CHUNK_ATOMS`](super::CHUNK_ATOMS) successive atoms.
#[derive(Clone, Default)]
pub struct NeighbourRows {
    /// Index of each member among all points: first the chunk's own atoms, then their neighbours.
    pub members: Vec<u32>,
    /// Where each atom's row starts and ends in `list`.
    pub(super) spans: Vec<[u32; 2]>,
    /// Members, in rows filled up to whole groups.
    pub(super) list: Vec<[u16; LANES]>,
    /// `true` if there are more members than can be numbered.
    pub has_overflowed: bool,
}

impl NeighbourRows {
    /// Returns the count of the chunk's own atoms.
    pub fn len(&self) -> usize {
        self.spans.len()
    }

    /// Returns the groups of neighbours of each atom of the chunk.
    #[inline(always)]
    pub fn iter(&self) -> impl Iterator<Item = &[[u16; LANES]]> {
        let spans = self.spans.iter();
        spans.map(|&[start, end]| &self.list[start as usize..end as usize])
    }

    /// Returns the neighbours of atom `n` of the chunk, as members.
    pub(super) fn row(&self, n: usize) -> impl Iterator<Item = u16> {
        let [start, end] = self.spans[n].map(|bound| bound as usize);
        let row = self.list[start..end].as_flattened().iter();
        row.copied().filter(|&m| m != FILLER)
    }

    /// Resets to the given atoms without neighbours.
    pub(super) fn reset(&mut self, atoms: Range<usize>) {
        self.members.clear();
        self.members.extend(atoms.start as u32..atoms.end as u32);
        self.list.clear();
        self.spans.clear();
        self.spans.resize(atoms.len(), [0; 2]);
        self.has_overflowed = false;
    }

    /// Replaces the row of atom `n` of the chunk, in its place if it fits.
    pub(super) fn replace(&mut self, n: usize, row: &[u16]) {
        let groups = row.len().div_ceil(LANES);
        let [start, end] = self.spans[n].map(|bound| bound as usize);
        let start = if groups <= end - start {
            start
        } else {
            self.list.len()
        };
        if start + groups > self.list.len() {
            self.list.resize(start + groups, [FILLER; LANES]);
        }
        for (group, row) in self.list[start..].iter_mut().zip(row.chunks(LANES)) {
            *group = [FILLER; LANES];
            group[..row.len()].copy_from_slice(row);
        }
        self.spans[n] = [start as u32, (start + groups) as u32];
    }

    /// Adds a member to the row of atom `n` of the chunk, unless it is there already.
    pub(super) fn insert(&mut self, n: usize, member: u16) {
        let [start, end] = self.spans[n].map(|bound| bound as usize);
        let row = self.list[start..end].as_flattened_mut();
        if row.contains(&member) {
            return;
        }
        if let Some(slot) = row.iter_mut().rev().take(LANES).find(|m| **m == FILLER) {
            *slot = member;
            return;
        }
        // The row has no free slot, so it moves to the end of the list.
        if end < self.list.len() {
            self.spans[n][0] = self.list.len() as u32;
            self.list.extend_from_within(start..end);
        }
        let mut group = [FILLER; LANES];
        group[0] = member;
        self.list.push(group);
        self.spans[n][1] = self.list.len() as u32;
    }

    /// Removes a member from the row of atom `n` of the chunk, if it is there.
    pub(super) fn remove(&mut self, n: usize, member: u16) {
        let [start, end] = self.spans[n].map(|bound| bound as usize);
        let row = self.list[start..end].as_flattened_mut();
        let Some(position) = row.iter().position(|&m| m == member) else {
            return;
        };
        // The last neighbour takes its place.
        let last = row.iter().rposition(|&m| m != FILLER).unwrap_or(position);
        row[position] = row[last];
        row[last] = FILLER;
        if last % LANES == 0 {
            self.spans[n][1] -= 1;
        }
    }

    /// Returns the count of groups that are in use.
    pub(super) fn live_group_count(&self) -> usize {
        let spans = self.spans.iter();
        spans.map(|[start, end]| (end - start) as usize).sum()
    }
}

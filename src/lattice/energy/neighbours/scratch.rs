//! Working memory for building rows of neighbours.

use pulp::Arch;

use super::rows::NeighbourRows;
use super::{FILLER, MAX_CHUNK_MEMBERS};

/// Working memory of one thread.
pub struct RowScratch {
    pub arch: Arch,
    /// For each point a candidate for its index among the members of the current chunk; valid if
    /// that member is the point.
    member_index: Vec<u16>,
    /// Points found near an atom.
    pub nearby_points: Vec<u32>,
    /// The row of an atom.
    pub row: Vec<u16>,
    pub old_row: Vec<u16>,
    /// `true` for each member that is in the old row.
    was_in_old_row: Vec<bool>,
}

impl RowScratch {
    pub fn new(points: usize) -> Self {
        Self {
            arch: Arch::new(),
            member_index: vec![0; points],
            nearby_points: Vec::new(),
            row: Vec::new(),
            old_row: Vec::new(),
            was_in_old_row: Vec::new(),
        }
    }

    /// Compares the new row with the old one. Calls `report(member, true)` for each member that is
    /// only in the new row, and `report(member, false)` for each that is only in the old one.
    pub fn compare(&mut self, mut report: impl FnMut(u16, bool)) {
        self.was_in_old_row.resize(MAX_CHUNK_MEMBERS, false);
        for &member in &self.old_row {
            self.was_in_old_row[member as usize] = true;
        }
        for &member in &self.row {
            if !std::mem::take(&mut self.was_in_old_row[member as usize]) {
                report(member, true);
            }
        }
        for &member in &self.old_row {
            if std::mem::take(&mut self.was_in_old_row[member as usize]) {
                report(member, false);
            }
        }
    }

    /// Makes a chunk the current one.
    pub fn load_chunk(&mut self, rows: &NeighbourRows) {
        for (index, &point) in rows.members.iter().enumerate() {
            self.member_index[point as usize] = index as u16;
        }
    }

    /// Returns the index of a point among the members of the current chunk, and adds it if it is
    /// not a member.
    #[inline(always)]
    pub fn find_or_add_member(&mut self, point: u32, rows: &mut NeighbourRows) -> u16 {
        let index = self.member_index[point as usize];
        if rows.members.get(index as usize) == Some(&point) {
            return index;
        }
        if rows.members.len() >= FILLER as usize {
            rows.has_overflowed = true;
            return FILLER;
        }
        let index = rows.members.len() as u16;
        self.member_index[point as usize] = index;
        rows.members.push(point);
        index
    }

    /// Removes members and groups that no row of a chunk uses.
    pub fn compact(&mut self, rows: &mut NeighbourRows) {
        let (members, list) = (
            std::mem::take(&mut rows.members),
            std::mem::take(&mut rows.list),
        );
        rows.members.extend_from_slice(&members[..rows.spans.len()]);
        for n in 0..rows.spans.len() {
            let [start, end] = rows.spans[n].map(|bound| bound as usize);
            rows.spans[n][0] = rows.list.len() as u32;
            for group in &list[start..end] {
                let group = group.map(|m| match members.get(m as usize) {
                    Some(&point) => self.find_or_add_member(point, rows),
                    None => FILLER,
                });
                rows.list.push(group);
            }
            rows.spans[n][1] = rows.list.len() as u32;
        }
    }
}

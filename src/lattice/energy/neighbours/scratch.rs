//! Working memory with which rows are made.

use pulp::Arch;

use super::rows::NeighbourRows;
use super::{FILLER, MAX_CHUNK_MEMBERS};

/// Working memory of one thread.
pub struct RowScratch {
    pub arch: Arch,
    /// For each point, its number among the members of the chunk at hand, if that member is it.
    member_index: Vec<u16>,
    /// Points found near an atom.
    pub found: Vec<u32>,
    /// The row made of them, and that before.
    pub row: Vec<u16>,
    pub old_row: Vec<u16>,
    /// Whether a member is in the old row.
    was_in_old_row: Vec<bool>,
}

impl RowScratch {
    pub fn new(points: usize) -> Self {
        Self {
            arch: Arch::new(),
            member_index: vec![0; points],
            found: Vec::new(),
            row: Vec::new(),
            old_row: Vec::new(),
            was_in_old_row: Vec::new(),
        }
    }

    /// Tells which members the new row has (`true`) and the old one had not, and the reverse.
    pub fn compare(&mut self, mut tell: impl FnMut(u16, bool)) {
        self.was_in_old_row.resize(MAX_CHUNK_MEMBERS, false);
        for &member in &self.old_row {
            self.was_in_old_row[member as usize] = true;
        }
        for &member in &self.row {
            if !std::mem::take(&mut self.was_in_old_row[member as usize]) {
                tell(member, true);
            }
        }
        for &member in &self.old_row {
            if std::mem::take(&mut self.was_in_old_row[member as usize]) {
                tell(member, false);
            }
        }
    }

    /// Turns to another chunk.
    pub fn load_chunk(&mut self, rows: &NeighbourRows) {
        for (number, &point) in rows.members.iter().enumerate() {
            self.member_index[point as usize] = number as u16;
        }
    }

    /// The number of a point among the members of the chunk at hand, which it becomes if it is none.
    #[inline(always)]
    pub fn find_or_add_member(&mut self, point: u32, rows: &mut NeighbourRows) -> u16 {
        let number = self.member_index[point as usize];
        if rows.members.get(number as usize) == Some(&point) {
            return number;
        }
        if rows.members.len() >= FILLER as usize {
            rows.has_overflowed = true;
            return FILLER;
        }
        let number = rows.members.len() as u16;
        self.member_index[point as usize] = number;
        rows.members.push(point);
        number
    }

    /// Drops from the rows of a chunk what none of them uses.
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
                let renumbered = group.map(|m| match members.get(m as usize) {
                    Some(&point) => self.find_or_add_member(point, rows),
                    None => FILLER,
                });
                rows.list.push(renumbered);
            }
            rows.spans[n][1] = rows.list.len() as u32;
        }
    }
}

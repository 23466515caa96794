//! The Verlet list: for every atom the atoms within reach, kept while atoms move a little.
//!
//! Positions are fixed-point numbers (see [`FixedPoint`]): differences of neighbours are exact and
//! become `f32` without loss, wherever in the box they are.
//!
//! Atoms are worked on in chunks of successive ones, which lie together in space. A chunk has a table
//! of its *members*: its own atoms, then all others that are neighbours of any. Rows of neighbours
//! are indices into that table, which are short, and the positions of a chunk's members, copied
//! together, fit the nearest cache.
//!
//! - `fixed`: positions as integers
//! - `rows`: the rows of a chunk
//! - `scratch`: working memory with which rows are made
//! - `search`: finding the points near an atom

pub(crate) mod fixed;
pub(crate) mod rows;
mod scratch;
mod search;

pub use fixed::{FixedPoint, NOWHERE, Point};
pub use rows::Rows;

use std::ops::Range;

use rayon::prelude::*;

use crate::error::Result;
use crate::files::kept::fields;
use crate::ranks;
use scratch::Scratch;
use search::{AtomCells, Search};

/// Atoms per unit of parallel work. Fixed, so that sums do not depend on the number of threads.
pub const CHUNK: usize = 1024;

/// Neighbours are listed, and worked on, in groups of this size.
pub const LANES: usize = 8;

/// Most members of a chunk; that of index [`FILLER`] is nowhere.
pub const MEMBERS: usize = 1 << 16;

/// Fills up groups of neighbours.
pub const FILLER: u16 = u16::MAX;

/// For every atom, all points nearer than the larger of the two reaches (each pair of atoms is
/// listed twice, so no atom writes to another's sums).
#[derive(Clone, Default)]
pub struct Neighbours {
    /// One for each chunk of atoms; only [own](Self::own) ones are made.
    pub chunks: Vec<Rows>,
    /// Whether each rank makes its share of the chunks only.
    pub shared: bool,
    cells: AtomCells,
}

impl Neighbours {
    /// The chunks that are made.
    pub fn own(&self) -> Range<usize> {
        match self.shared {
            true => ranks::own(self.chunks.len()),
            false => 0..self.chunks.len(),
        }
    }

    /// Lists the neighbours of the first `atoms` of `points` anew.
    ///
    /// `reach` is each point's own reach in fixed-point units, `slope` a bound on how fast it changes
    /// over space (0 where it is the same for all), so that an atom finds also those that reach
    /// farther than itself.
    pub fn build(&mut self, points: &[Point], atoms: usize, reach: &[f32], slope: f32) {
        self.chunks
            .resize_with(atoms.div_ceil(CHUNK), Rows::default);
        let own = self.own();
        let search = Search::new(points, reach, slope, &mut self.cells);
        let chunks = own.clone().into_par_iter().zip(&mut self.chunks[own]);
        chunks.for_each_init(
            || Scratch::new(points.len()),
            |scratch, (n, rows)| {
                rows.reset(n * CHUNK..(n * CHUNK + CHUNK).min(atoms));
                scratch.take(rows);
                for n in 0..rows.len() {
                    search.list(n, rows, scratch);
                }
            },
        );
    }

    /// Brings the lists up to date after a few points, `moved` in rising order, have got new
    /// positions or reaches: lists the neighbours of the `atoms` among them anew, and tells those
    /// atoms whose neighbours they have become or ceased to be. The result has the same pairs as a
    /// new build.
    ///
    /// `partner(i, j)` is the pair by which the other atom knows of a pair of atom `i` and point `j`.
    ///
    /// # Errors
    /// Those of [`ranks::share`].
    pub fn repair(
        &mut self,
        points: &[Point],
        atoms: usize,
        reach: &[f32],
        slope: f32,
        moved: &[u32],
        partner: impl Fn(u32, u32) -> (u32, u32) + Sync,
    ) -> Result<()> {
        let own = self.own();
        let search = Search::new(points, reach, slope, &mut self.cells);
        let moved = &moved[..moved.partition_point(|&i| (i as usize) < atoms)];
        let chunks = own
            .clone()
            .into_par_iter()
            .zip(&mut self.chunks[own.clone()]);
        let changes: Vec<Vec<Change>> = chunks
            .map_init(
                || Scratch::new(points.len()),
                |scratch, (n, rows)| {
                    let first = n * CHUNK;
                    let from = moved.partition_point(|&i| (i as usize) < first);
                    let to = moved.partition_point(|&i| (i as usize) < first + CHUNK);
                    let mut changes = Vec::new();
                    if from == to {
                        return changes;
                    }
                    scratch.take(rows);
                    if rows.list.len() > 2 * rows.live() || rows.members.len() > 4 * CHUNK {
                        scratch.compact(rows);
                    }
                    for &i in &moved[from..to] {
                        let n = i as usize - first;
                        scratch.old.clear();
                        scratch.old.extend(rows.row(n));
                        search.list(n, rows, scratch);
                        scratch.compare(|member, is_new| {
                            let (atom, point) = partner(i, rows.members[member as usize]);
                            changes.push(Change {
                                atom,
                                point,
                                is_new,
                            });
                        });
                    }
                    changes
                },
            )
            .collect();
        let changes = changes.into_iter().flatten().collect();
        let changes = match self.shared {
            true => told(changes, &own)?,
            false => vec![changes],
        };
        // By chunk of the atom that must know, in the same order always.
        let mut by_chunk: Vec<Vec<Change>> = vec![Vec::new(); own.len()];
        for change in changes.into_iter().flatten() {
            by_chunk[change.atom as usize / CHUNK - own.start].push(change);
        }
        let chunks = self.chunks[own].par_iter_mut().zip(&by_chunk);
        chunks.for_each_init(
            || Scratch::new(points.len()),
            |scratch, (rows, changes)| {
                if !changes.is_empty() {
                    scratch.take(rows);
                }
                for change in changes {
                    let (n, member) = (
                        change.atom as usize % CHUNK,
                        scratch.member(change.point, rows),
                    );
                    if change.is_new {
                        rows.insert(n, member);
                    } else {
                        rows.remove(n, member);
                    }
                }
            },
        );
        Ok(())
    }
}

/// A point has become a neighbour of an atom, or has ceased to be one.
#[derive(Clone, Copy)]
struct Change {
    atom: u32,
    point: u32,
    is_new: bool,
}

fields! { Change as Change { atom, point, is_new } }

/// Of the changes that each rank has found, those in the chunks that are this rank's `own`.
fn told(found: Vec<Change>, own: &Range<usize>) -> Result<Vec<Vec<Change>>> {
    let is_own = |change: &Change| own.contains(&(change.atom as usize / CHUNK));
    let (kept, others): (Vec<Change>, Vec<Change>) = found.into_iter().partition(is_own);
    let mut all = Vec::new();
    let tell = |_, give: &mut dyn FnMut(Vec<Change>)| {
        give(others);
        Ok(())
    };
    let mut hear = |of_rank: Vec<Change>| all.push(of_rank.into_iter().filter(is_own).collect());
    ranks::share("changes of neighbours", ranks::count(), tell, &mut hear)?;
    if let Some(of_own) = all.get_mut(ranks::rank()) {
        *of_own = kept;
    }
    Ok(all)
}

#[cfg(test)]
mod tests;

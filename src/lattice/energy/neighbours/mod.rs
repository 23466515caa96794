//! The Verlet list: for every atom the atoms within reach, kept while atoms move a little.
//!
//! Positions are fixed-point numbers (see [`FixedPointMap`]): differences of neighbours are exact and
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

pub(crate) mod fixed_point;
pub(crate) mod rows;
mod scratch;
mod search;

pub use fixed_point::{FixedPointMap, IntPoint, UNREACHABLE_POINT};
pub use rows::NeighbourRows;

use crate::parallel::prelude::*;

use super::mirror_images::MirrorImages;
use crate::error::Result;
use crate::files::codec::codec_fields;
use crate::lattice::halo::OwnedAndGhosts;
use scratch::RowScratch;
use search::{AtomCells, NeighbourSearch};

/// Atoms per unit of parallel work. Fixed, so that sums do not depend on the number of threads.
pub const CHUNK_ATOMS: usize = 1024;

/// Neighbours are listed, and worked on, in groups of this size.
pub const LANES: usize = 8;

/// Most members of a chunk; that of index [`FILLER`] is nowhere.
pub const MAX_CHUNK_MEMBERS: usize = 1 << 16;

/// Fills up groups of neighbours.
pub const FILLER: u16 = u16::MAX;

/// The points among which neighbours are listed.
#[derive(Clone, Copy)]
pub struct PointSet<'a> {
    /// The atoms held, and then their images.
    pub points: &'a [IntPoint],
    /// Which atoms are held.
    pub halo: &'a OwnedAndGhosts<'a>,
    /// Their images.
    pub images: &'a MirrorImages,
    /// Each point's own reach in fixed-point units.
    pub reach: &'a [f32],
    /// A bound on how fast that changes over space (0 where it is the same for all), so that an atom finds also those
    /// that reach farther than itself.
    pub slope: f32,
}

/// For every atom, all points nearer than the larger of the two reaches (each pair of atoms is
/// listed twice, so no atom writes to another's sums).
#[derive(Clone, Default)]
pub struct Neighbours {
    /// One for each chunk of own atoms.
    pub chunks: Vec<NeighbourRows>,
    cells: AtomCells,
}

impl Neighbours {
    /// Lists the neighbours of own atoms anew.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn build(&mut self, among: PointSet<'_>) -> Result<()> {
        let own = among.halo.owned();
        self.chunks
            .resize_with(own.len().div_ceil(CHUNK_ATOMS), NeighbourRows::default);
        let search = NeighbourSearch::new(among, &mut self.cells)?;
        let chunks = self.chunks.par_iter_mut().enumerate();
        chunks.for_each_init(
            || RowScratch::new(among.points.len()),
            |scratch, (n, rows)| {
                let first = own.start + n * CHUNK_ATOMS;
                rows.reset(first..(first + CHUNK_ATOMS).min(own.end));
                scratch.load_chunk(rows);
                for n in 0..rows.len() {
                    search.list(n, rows, scratch);
                }
            },
        );
        Ok(())
    }

    /// Brings the lists up to date after a few points, `moved` in rising order, have got new
    /// positions or reaches: lists the neighbours of the own atoms among them anew, and tells those
    /// atoms whose neighbours they have become or ceased to be. The result has the same pairs as a
    /// new build.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn repair(&mut self, among: PointSet<'_>, moved: &[u32]) -> Result<()> {
        let PointSet {
            points,
            halo: held,
            images,
            ..
        } = among;
        let own = held.owned();
        let atoms = points.len() - images.len();
        let search = NeighbourSearch::new(among, &mut self.cells)?;
        let chunks = self.chunks.par_iter_mut().enumerate();
        let changes: Vec<Vec<NeighbourChange>> = chunks
            .map_init(
                || RowScratch::new(points.len()),
                |scratch, (n, rows)| {
                    let first = own.start + n * CHUNK_ATOMS;
                    let from = moved.partition_point(|&i| (i as usize) < first);
                    let to = moved.partition_point(|&i| (i as usize) < first + rows.len());
                    let mut changes = Vec::new();
                    if from == to {
                        return changes;
                    }
                    scratch.load_chunk(rows);
                    if rows.list.len() > 2 * rows.live_group_count()
                        || rows.members.len() > 4 * CHUNK_ATOMS
                    {
                        scratch.compact(rows);
                    }
                    for &i in &moved[from..to] {
                        let n = i as usize - first;
                        scratch.old_row.clear();
                        scratch.old_row.extend(rows.row(n));
                        search.list(n, rows, scratch);
                        scratch.compare(|member, is_new| {
                            let point = rows.members[member as usize];
                            // The pair by which the other atom knows of this one.
                            let (atom, point) = images.mirror_pair(atoms, i, point);
                            changes.push(NeighbourChange {
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
        let mut changes: Vec<NeighbourChange> = changes.into_iter().flatten().collect();
        if held.is_partitioned() {
            changes = exchange_changes(&changes, held, images, atoms)?;
        }
        // By chunk of the atom that must know, in the same order always.
        let mut by_chunk: Vec<Vec<NeighbourChange>> = vec![Vec::new(); self.chunks.len()];
        for change in changes {
            by_chunk[(change.atom as usize - own.start) / CHUNK_ATOMS].push(change);
        }
        let chunks = self.chunks.par_iter_mut().zip(&by_chunk);
        chunks.for_each_init(
            || RowScratch::new(points.len()),
            |scratch, (rows, changes)| {
                if !changes.is_empty() {
                    scratch.load_chunk(rows);
                }
                for change in changes {
                    let (n, member) = (
                        (change.atom as usize - own.start) % CHUNK_ATOMS,
                        scratch.find_or_add_member(change.point, rows),
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
struct NeighbourChange {
    atom: u32,
    point: u32,
    is_new: bool,
}

/// The same as ranks tell one another: both by their numbers in the lattice, the point as an atom or its image in
/// these sides.
struct ChangeMessage {
    atom: u32,
    neighbour: u32,
    sides: u8,
    is_new: bool,
}

codec_fields! { ChangeMessage as ChangeMessage { atom, neighbour, sides, is_new } }

/// Of the changes that each rank has found, those of this rank's own atoms.
fn exchange_changes(
    found: &[NeighbourChange],
    held: &OwnedAndGhosts<'_>,
    images: &MirrorImages,
    atoms: usize,
) -> Result<Vec<NeighbourChange>> {
    let mut for_ranks: Vec<Vec<ChangeMessage>> = Vec::new();
    for change in found {
        let (of, sides) = match (change.point as usize).checked_sub(atoms) {
            Some(image) => images.source(image),
            None => (change.point, 0),
        };
        let owner = held.owner_rank(change.atom as usize);
        if for_ranks.len() <= owner {
            for_ranks.resize_with(owner + 1, Vec::new);
        }
        for_ranks[owner].push(ChangeMessage {
            atom: held.global_index(change.atom as usize) as u32,
            neighbour: held.global_index(of as usize) as u32,
            sides,
            is_new: change.is_new,
        });
    }
    let heard = held.all_to_all("changes of neighbours", for_ranks)?;
    // Who is farther than the halo is wide has no neighbour here.
    let known = |told: ChangeMessage| {
        let atom = held.local_index(told.atom as usize)?;
        let of = held.local_index(told.neighbour as usize)?;
        let image = match told.sides {
            0 => None,
            sides => images.find(of, sides),
        };
        Some(NeighbourChange {
            atom: atom as u32,
            point: image.map_or(of, |image| atoms + image) as u32,
            is_new: told.is_new,
        })
    };
    Ok(heard.into_iter().flatten().filter_map(known).collect())
}

#[cfg(test)]
mod tests;

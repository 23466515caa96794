//! The Verlet list: for every atom the points within its reach, kept while atoms move a little.
//!
//! Positions are fixed-point numbers (see [`FixedPointMap`]): differences of neighbours are exact
//! and become `f32` without loss, wherever in the box they are.
//!
//! Atoms are processed in chunks of successive atoms, which lie together in space. A chunk has a
//! table of its *members*: its own atoms, then all other points that are neighbours of any. Rows of
//! neighbours are indices into that table, which are short, and the positions of a chunk's members,
//! copied together, fit the nearest cache.
//!
//! - `fixed_point`: positions as integers
//! - `rows`: the rows of a chunk
//! - `scratch`: working memory for building rows
//! - `search`: finds the points near an atom

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
pub(crate) const CHUNK_ATOMS: usize = 1024;

/// Neighbours are listed and processed in groups of this size.
pub const LANES: usize = 8;

/// Most members of a chunk. The member of index [`FILLER`] is a point out of reach.
pub const MAX_CHUNK_MEMBERS: usize = 1 << 16;

/// Index that fills up groups of neighbours.
pub const FILLER: u16 = u16::MAX;

/// The points among which neighbours are listed.
#[derive(Clone, Copy)]
pub struct PointSet<'a> {
    /// The local atoms, and then their images.
    pub points: &'a [IntPoint],
    /// The local atoms of this rank.
    pub halo: &'a OwnedAndGhosts<'a>,
    /// The mirror images of the local atoms.
    pub images: &'a MirrorImages,
    /// Reach of each point in fixed-point units: the distance within which it has neighbours.
    pub reach: &'a [f32],
    /// A bound on the slope of the reach over space (0 if it is the same for all points), so that a
    /// search also finds points that have a larger reach than the atom.
    pub slope: f32,
}

/// For every atom, all points nearer than the larger of the two reaches. Each pair of atoms is
/// listed twice, so no atom writes to another's sums.
#[derive(Clone, Default)]
pub struct Neighbours {
    /// One for each chunk of owned atoms.
    pub chunks: Vec<NeighbourRows>,
    cells: AtomCells,
}

impl Neighbours {
    /// Lists the neighbours of owned atoms from scratch.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn build(&mut self, point_set: PointSet<'_>) -> Result<()> {
        let owned = point_set.halo.owned();
        self.chunks
            .resize_with(owned.len().div_ceil(CHUNK_ATOMS), NeighbourRows::default);
        let search = NeighbourSearch::new(point_set, &mut self.cells)?;
        let chunks = self.chunks.par_iter_mut().enumerate();
        chunks.for_each_init(
            || RowScratch::new(point_set.points.len()),
            |scratch, (n, rows)| {
                let first = owned.start + n * CHUNK_ATOMS;
                rows.reset(first..(first + CHUNK_ATOMS).min(owned.end));
                scratch.load_chunk(rows);
                for n in 0..rows.len() {
                    search.list(n, rows, scratch);
                }
            },
        );
        Ok(())
    }

    /// Updates the lists after a few points, `moved` in ascending order, have got new positions or
    /// reaches: lists the neighbours of the owned atoms among them again, and inserts or removes
    /// these points in the lists of other atoms. The result has the same pairs as a new build.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn repair(&mut self, point_set: PointSet<'_>, moved: &[u32]) -> Result<()> {
        let PointSet {
            points,
            halo,
            images,
            ..
        } = point_set;
        let owned = halo.owned();
        let atoms = points.len() - images.len();
        let search = NeighbourSearch::new(point_set, &mut self.cells)?;
        let chunks = self.chunks.par_iter_mut().enumerate();
        let changes: Vec<Vec<NeighbourChange>> = chunks
            .map_init(
                || RowScratch::new(points.len()),
                |scratch, (n, rows)| {
                    let first = owned.start + n * CHUNK_ATOMS;
                    let start = moved.partition_point(|&i| (i as usize) < first);
                    let end = moved.partition_point(|&i| (i as usize) < first + rows.len());
                    let mut changes = Vec::new();
                    if start == end {
                        return changes;
                    }
                    scratch.load_chunk(rows);
                    if rows.list.len() > 2 * rows.live_group_count()
                        || rows.members.len() > 4 * CHUNK_ATOMS
                    {
                        scratch.compact(rows);
                    }
                    for &i in &moved[start..end] {
                        let n = i as usize - first;
                        scratch.old_row.clear();
                        scratch.old_row.extend(rows.row(n));
                        search.list(n, rows, scratch);
                        scratch.compare(|member, is_new| {
                            let point = rows.members[member as usize];
                            // The same pair as seen from the other atom.
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
        if halo.is_partitioned() {
            changes = exchange_changes(&changes, halo, images, atoms)?;
        }
        // Grouped by the chunk of the atom whose list changes, always in the same order.
        let mut by_chunk: Vec<Vec<NeighbourChange>> = vec![Vec::new(); self.chunks.len()];
        for change in changes {
            by_chunk[(change.atom as usize - owned.start) / CHUNK_ATOMS].push(change);
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
                        (change.atom as usize - owned.start) % CHUNK_ATOMS,
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

/// A change in the list of an atom: a point has become a neighbour, or is no longer one.
#[derive(Clone, Copy)]
struct NeighbourChange {
    atom: u32,
    point: u32,
    is_new: bool,
}

/// A [`NeighbourChange`] as ranks exchange it: both the atom and the neighbour by their indices in
/// the lattice, the neighbour as an atom or as its image in the given sides.
struct ChangeMessage {
    atom: u32,
    neighbour: u32,
    sides: u8,
    is_new: bool,
}

codec_fields! { ChangeMessage as ChangeMessage { atom, neighbour, sides, is_new } }

/// Sends each change to the rank that owns its atom. Returns the changes of this rank's owned
/// atoms.
fn exchange_changes(
    changes: &[NeighbourChange],
    halo: &OwnedAndGhosts<'_>,
    images: &MirrorImages,
    atoms: usize,
) -> Result<Vec<NeighbourChange>> {
    let messages = changes.iter().map(|change| {
        let (neighbour, sides) = match (change.point as usize).checked_sub(atoms) {
            Some(image) => images.source(image),
            None => (change.point, 0),
        };
        let atom = change.atom as usize;
        let message = ChangeMessage {
            atom: halo.global_index(atom) as u32,
            neighbour: halo.global_index(neighbour as usize) as u32,
            sides,
            is_new: change.is_new,
        };
        (atom, message)
    });
    let received = halo.send_to_owners("changes of neighbours", messages)?;
    // An atom that is not local is farther away than the halo is wide, so it has no neighbour here.
    let to_change = |message: ChangeMessage| {
        let atom = halo.local_index(message.atom as usize)?;
        let neighbour = halo.local_index(message.neighbour as usize)?;
        let image = match message.sides {
            0 => None,
            sides => images.find(neighbour, sides),
        };
        Some(NeighbourChange {
            atom: atom as u32,
            point: image.map_or(neighbour, |image| atoms + image) as u32,
            is_new: message.is_new,
        })
    };
    Ok(received.into_iter().filter_map(to_change).collect())
}

#[cfg(test)]
mod tests;

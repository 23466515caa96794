//! Owned atoms and ghosts of a rank while the atoms of a lattice move.
//!
//! The owned atoms of a rank are whole chunks of successive atoms of the lattice, which lie
//! together in space. Around them the rank keeps ghosts: copies of other ranks' atoms within a
//! given distance, whose positions are updated whenever atoms have moved. Local atoms are in the
//! order of the lattice, so that every computation in that order gives the same result as in one
//! process that has all atoms.

use std::ops::Range;

use crate::comm::{Comm, SelfComm, concatenate};
use crate::error::Result;
use crate::files::codec::{Codec, codec_fields};
use crate::geometry::bounding_box;
use crate::lattice::owned_atoms::{IndexedAtoms, OwnedAtoms};
use crate::lattice::seeding::Atoms;

/// The local atoms of a rank (owned atoms and ghosts), and the ranks that keep copies of its owned
/// atoms.
pub struct OwnedAndGhosts<'a> {
    comm: &'a dyn Comm,
    /// Index in the lattice of each local atom, ascending. `None` if all atoms are local.
    global_indices: Option<Vec<u32>>,
    /// Range of the owned atoms among the local ones.
    owned: Range<usize>,
    /// Range of each rank's atoms among the local ones.
    rank_ranges: Vec<Range<usize>>,
    /// For each other rank the owned atoms of which it keeps copies, by local index.
    send_lists: Vec<Vec<u32>>,
}

impl OwnedAndGhosts<'static> {
    /// Creates the lists for one process that has all of `atom_count` atoms.
    pub fn all(atom_count: usize) -> Self {
        Self {
            comm: &SelfComm,
            global_indices: None,
            owned: 0..atom_count,
            rank_ranges: Vec::new(),
            send_lists: Vec::new(),
        }
    }
}

impl<'a> OwnedAndGhosts<'a> {
    /// Adds ghosts to a rank's owned atoms: all other atoms within `halo_width` of them, and some
    /// that are farther away. Returns also the local atoms.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn with_halo<const D: usize>(
        owned: &OwnedAtoms<D>,
        halo_width: f64,
        comm: &'a dyn Comm,
    ) -> Result<(Self, Atoms<D>)> {
        let (rank, count) = (comm.rank(), comm.size());
        if count == 1 {
            return Ok((OwnedAndGhosts::all(owned.global_count), owned.atoms.clone()));
        }
        let x = &owned.atoms.positions;
        let nearby = NearbyCubes::around(x, halo_width);
        // The cubes are sent only to ranks whose bounding boxes they meet.
        let boxes: Vec<[[f64; D]; 2]> =
            comm.all_gather("bounding boxes of atoms", bounding_box(x))?;
        let queries = boxes.iter().enumerate().map(|(other_rank, bounds)| {
            let is_nearby = other_rank != rank && nearby.intersects(bounds);
            if is_nearby {
                nearby.clone()
            } else {
                NearbyCubes::empty()
            }
        });
        let requests: Vec<NearbyCubes<D>> =
            comm.all_to_all("regions near atoms", queries.collect())?;
        let is_wanted = |rank: usize, n: usize| requests[rank].contains(&x[n]);
        let mut send_lists: Vec<Vec<u32>> = (0..count)
            .map(|rank| {
                (0..x.len())
                    .filter(|&n| is_wanted(rank, n))
                    .map(|n| n as u32)
                    .collect()
            })
            .collect();
        drop(nearby);
        let ghosts = owned.exchange_wanted("ghost atoms", is_wanted, comm)?;
        drop(requests);
        // The atoms of a rank follow one another, in the order of ranks, and so do their indices.
        let ghosts_before = ghosts
            .indices
            .partition_point(|&n| (n as usize) < owned.first_index);
        let owned_range = ghosts_before..ghosts_before + x.len();
        for n in send_lists.iter_mut().flatten() {
            *n += ghosts_before as u32;
        }
        let IndexedAtoms {
            indices: global_indices,
            atoms,
        } = ghosts.insert_owned(owned, ghosts_before);
        let first_indices: Vec<usize> = comm.all_gather("first atoms", owned.first_index)?;
        let local_index = |index: usize| global_indices.partition_point(|&n| (n as usize) < index);
        let end = |rank: usize| {
            first_indices
                .get(rank + 1)
                .map_or(global_indices.len(), |&n| local_index(n))
        };
        let rank_ranges = (0..count)
            .map(|rank| local_index(first_indices[rank])..end(rank))
            .collect();
        let halo = Self {
            comm,
            owned: owned_range,
            global_indices: Some(global_indices),
            rank_ranges,
            send_lists,
        };
        Ok((halo, atoms))
    }

    /// Returns the range of the owned atoms among the local ones.
    pub fn owned(&self) -> Range<usize> {
        self.owned.clone()
    }

    /// Returns `true` if the atoms are distributed over several ranks.
    pub fn is_partitioned(&self) -> bool {
        self.global_indices.is_some()
    }

    /// Returns the index in the lattice of the local atom `n`.
    #[inline(always)]
    pub fn global_index(&self, n: usize) -> usize {
        self.global_indices
            .as_ref()
            .map_or(n, |all| all[n] as usize)
    }

    /// Returns the local index of an atom from its index in the lattice, or `None` if the atom is
    /// not local.
    pub fn local_index(&self, index: usize) -> Option<usize> {
        match &self.global_indices {
            None => Some(index),
            Some(all) => all.binary_search(&(index as u32)).ok(),
        }
    }

    /// Returns the rank that owns the local atom `n`.
    fn owner_rank(&self, n: usize) -> usize {
        self.rank_ranges.partition_point(|range| range.end <= n)
    }

    /// Updates the positions of ghosts in `x` from the ranks that own them.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn update_ghosts<const D: usize>(&self, x: &mut [[f64; D]]) -> Result<()> {
        if !self.is_partitioned() {
            return Ok(());
        }
        let positions =
            |list: &Vec<u32>| -> Vec<f64> { list.iter().flat_map(|&n| x[n as usize]).collect() };
        let sent = self.send_lists.iter().map(positions).collect();
        let received: Vec<Vec<f64>> = self.comm.all_to_all("positions of atoms", sent)?;
        for (rank, (received, range)) in received.iter().zip(&self.rank_ranges).enumerate() {
            if rank != self.comm.rank() {
                x[range.clone()]
                    .as_flattened_mut()
                    .copy_from_slice(received);
            }
        }
        Ok(())
    }

    /// Adds up the sums of the chunks of all ranks, in the order of the chunks.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn all_reduce_sum<const N: usize>(&self, sums: Vec<[f64; N]>) -> Result<[f64; N]> {
        let gathered = self.comm.all_gather("sums over atoms", sums)?;
        Ok(gathered.iter().flatten().fold([0.0; N], |mut total, sums| {
            total
                .iter_mut()
                .zip(sums)
                .for_each(|(total, sum)| *total += sum);
            total
        }))
    }

    /// Folds the values of all ranks, in their order.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn fold<T: Codec, S>(
        &self,
        label: &str,
        value: T,
        start: S,
        combine: impl Fn(S, T) -> S,
    ) -> Result<S> {
        let values = self.comm.all_gather(label, value)?;
        Ok(values.into_iter().fold(start, combine))
    }

    /// Returns `true` if a condition is met on any rank.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn any(&self, label: &str, condition: bool) -> Result<bool> {
        self.fold(label, condition, false, |any, other| any | other)
    }

    /// Sends values for local atoms to the ranks that own the atoms. Returns the values that this
    /// rank receives.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn send_to_owners<T: Codec>(
        &self,
        label: &str,
        values: impl Iterator<Item = (usize, T)>,
    ) -> Result<Vec<T>> {
        let mut sent: Vec<Vec<T>> = Vec::new();
        sent.resize_with(self.comm.size(), Vec::new);
        values.for_each(|(n, value)| sent[self.owner_rank(n)].push(value));
        Ok(concatenate(self.comm.all_to_all(label, sent)?))
    }
}

/// A lattice of which each rank owns a part of the atoms.
pub struct SharedLattice<'a, const D: usize> {
    /// The atoms that this rank owns.
    pub owned: &'a mut OwnedAtoms<D>,
    comm: &'a dyn Comm,
}

impl<'a, const D: usize> SharedLattice<'a, D> {
    /// Creates the lattice whose atoms the ranks of `comm` own.
    pub fn new(owned: &'a mut OwnedAtoms<D>, comm: &'a dyn Comm) -> Self {
        Self { owned, comm }
    }

    /// Returns `true` if there are several ranks.
    pub fn is_shared(&self) -> bool {
        self.comm.size() > 1
    }

    /// Adds ghosts to the owned atoms; see [`OwnedAndGhosts::with_halo`].
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn with_halo(&self, halo_width: f64) -> Result<(OwnedAndGhosts<'a>, Atoms<D>)> {
        OwnedAndGhosts::with_halo(self.owned, halo_width, self.comm)
    }

    /// Gathers all atoms on every rank and changes them, in the same way on all.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn change_all<T>(self, change: impl FnOnce(&mut Atoms<D>) -> T) -> Result<T> {
        let mut atoms = std::mem::take(self.owned).all_gather(self.comm)?;
        let result = change(&mut atoms);
        *self.owned = OwnedAtoms::from_global(atoms, self.comm);
        Ok(result)
    }
}

/// Edges of the grid's cubes per width of the halo.
const CUBES_PER_HALO_WIDTH: f64 = 2.0;

/// Returns the largest distance, along each axis, of a ghost from the owned atoms for a halo of
/// width `halo_width`.
pub fn halo_extent(halo_width: f64) -> f64 {
    (1.0 + 1.0 / CUBES_PER_HALO_WIDTH) * halo_width
}

/// The region near some positions: the cubes of a grid that contain a position, and two cubes
/// around each.
#[derive(Clone)]
struct NearbyCubes<const D: usize> {
    low: [f64; D],
    edge: f64,
    dims: [usize; D],
    /// One bit per cube: 1 if the cube belongs to the region.
    cubes: Vec<u64>,
}

codec_fields! {
    @(const D: usize) NearbyCubes<D> as NearbyCubes { low, edge, dims, cubes }
}

impl<const D: usize> NearbyCubes<D> {
    /// Returns an empty region.
    fn empty() -> Self {
        Self {
            low: [0.0; D],
            edge: 1.0,
            dims: [0; D],
            cubes: Vec::new(),
        }
    }

    /// Returns a region that contains all points within `radius` of a position.
    fn around(x: &[[f64; D]], radius: f64) -> Self {
        if x.is_empty() {
            return Self::empty();
        }
        let edge = radius / CUBES_PER_HALO_WIDTH;
        let [low, high] = bounding_box(x);
        let low = low.map(|low| low - 2.5 * edge);
        let dims: [usize; D] =
            std::array::from_fn(|k| ((high[k] - low[k]).max(0.0) / edge) as usize + 4);
        let mut nearby = Self {
            low,
            edge,
            dims,
            cubes: Vec::new(),
        };
        let mut cubes = vec![false; dims.iter().product()];
        for x in x {
            if let Some(cube) = nearby.cube_index(x) {
                cubes[cube] = true;
            }
        }
        let mut stride = 1;
        for n in dims {
            let previous = cubes.clone();
            for (cube, is_marked) in cubes.iter_mut().enumerate() {
                let coordinate = cube / stride % n;
                *is_marked = (coordinate.saturating_sub(2)..(coordinate + 3).min(n))
                    .any(|other| previous[cube + other * stride - coordinate * stride]);
            }
            stride *= n;
        }
        let bits = |marks: &[bool]| {
            let bits = marks.iter().enumerate();
            bits.fold(0, |bits, (i, is_marked)| bits | u64::from(*is_marked) << i)
        };
        nearby.cubes = cubes.chunks(u64::BITS as usize).map(bits).collect();
        nearby
    }

    /// Returns `true` if the box between two corners may meet the region.
    fn intersects(&self, [low, high]: &[[f64; D]; 2]) -> bool {
        let end = |k: usize| self.low[k] + self.edge * self.dims[k] as f64;
        !self.cubes.is_empty() && (0..D).all(|k| low[k] <= end(k) && self.low[k] <= high[k])
    }

    fn cube_index(&self, x: &[f64; D]) -> Option<usize> {
        (0..D).rev().try_fold(0, |cube, k| {
            let coordinate = ((x[k] - self.low[k]) / self.edge).floor();
            (coordinate >= 0.0 && coordinate < self.dims[k] as f64)
                .then(|| cube * self.dims[k] + coordinate as usize)
        })
    }

    fn contains(&self, x: &[f64; D]) -> bool {
        let is_near = |cube: usize| self.cubes[cube / 64] >> (cube % 64) & 1 == 1;
        !self.cubes.is_empty() && self.cube_index(x).is_some_and(is_near)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::run_threads;
    use crate::geometry::distance2;
    use crate::lattice::distance::Distance;
    use crate::lattice::energy::CHUNK_ATOMS;
    use crate::lattice::seeding::{self, Alignment};

    #[test]
    fn ranks_hold_owned_and_nearby_atoms_and_receive_ghost_positions() {
        let extent = [90.0, 50.0, 60.0];
        let distance = Distance::Constant(4.0);
        let atoms = seeding::fcc(extent, &distance, &[], Alignment::OnFeatures).unwrap();
        let (x, halo_width) = (&atoms.positions, 7.0);
        assert!(x.len() > 5 * CHUNK_ATOMS);
        let moved = |n: usize| x[n].map(|c| c + 0.01 * n as f64);
        for count in [1, 2, 3, 5, 9] {
            let owned = run_threads(count, |comm| {
                let owned = OwnedAtoms::from_global(atoms.clone(), comm);
                let (halo, local_atoms) =
                    OwnedAndGhosts::with_halo(&owned, halo_width, comm).unwrap();
                let owned_range = halo.owned();
                let global_indices: Vec<usize> = (0..local_atoms.len())
                    .map(|n| halo.global_index(n))
                    .collect();
                assert!(
                    (local_atoms
                        .positions
                        .iter()
                        .zip(&local_atoms.kinds)
                        .zip(&global_indices))
                    .all(|((y, kind), &n)| *y == x[n] && *kind == atoms.kinds[n])
                );
                assert!(global_indices.is_sorted());
                for (n, &index) in global_indices.iter().enumerate() {
                    assert_eq!(halo.local_index(index), Some(n));
                    assert_eq!(
                        halo.is_partitioned() && halo.owner_rank(n) == comm.rank(),
                        { halo.is_partitioned() && owned_range.contains(&n) }
                    );
                }
                // All nearby atoms are local, but not all atoms.
                let is_owned = |n: usize| owned_range.contains(&n);
                for (index, y) in x.iter().enumerate().step_by(7) {
                    let is_near = (owned_range.clone())
                        .any(|n| distance2(&x[global_indices[n]], y) < halo_width * halo_width);
                    assert!(!is_near || halo.local_index(index).is_some());
                }
                assert!(count == 1 || count > 4 || global_indices.len() < x.len());
                // Each rank moves its owned atoms only.
                let position = |n: usize| {
                    if is_owned(n) {
                        moved(global_indices[n])
                    } else {
                        x[global_indices[n]]
                    }
                };
                let mut positions: Vec<[f64; 3]> =
                    (0..global_indices.len()).map(position).collect();
                halo.update_ghosts(&mut positions).unwrap();
                assert!(
                    positions
                        .iter()
                        .zip(&global_indices)
                        .all(|(y, &n)| *y == moved(n))
                );
                owned_range.len()
            });
            assert_eq!(owned.iter().sum::<usize>(), x.len(), "{count}");
        }
    }
}

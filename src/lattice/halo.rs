//! Which atoms of a lattice a rank holds while they move: its own, and those of others that these may feel.
//!
//! A rank's own atoms are whole chunks of successive ones, which lie together in space. Around them it holds a halo of
//! others' atoms, whose positions it is told whenever they have moved. Atoms are held in the order of the lattice, so
//! that whatever is done with them in that order is done as by one process that holds all.

use std::ops::Range;

use crate::comm::{Comm, SelfComm};
use crate::error::Result;
use crate::files::codec::{Codec, codec_fields};
use crate::geometry::bounding_box;
use crate::lattice::partition::{IndexedAtoms, OwnedAtoms};
use crate::lattice::seeding::Atoms;

/// The atoms that are held here, and who holds them besides.
pub struct OwnedAndGhosts<'a> {
    comm: &'a dyn Comm,
    /// The number of each in the lattice, rising. None where all are held.
    global_indices: Option<Vec<u32>>,
    /// Where this rank's own are among them.
    owned: Range<usize>,
    /// Where those of each rank are among them.
    rank_ranges: Vec<Range<usize>>,
    /// The own atoms that each other rank holds, by their place among those held.
    send_lists: Vec<Vec<u32>>,
}

impl OwnedAndGhosts<'static> {
    /// All of so many atoms, by whoever asks.
    pub fn all(atoms: usize) -> Self {
        Self {
            comm: &SelfComm,
            global_indices: None,
            owned: 0..atoms,
            rank_ranges: Vec::new(),
            send_lists: Vec::new(),
        }
    }
}

impl<'a> OwnedAndGhosts<'a> {
    /// A rank's share of atoms, and all others that are no farther than `room` from it (and some that are).
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn with_halo<const D: usize>(
        share: &OwnedAtoms<D>,
        room: f64,
        group: &'a dyn Comm,
    ) -> Result<(Self, Atoms<D>)> {
        let (rank, count) = (group.rank(), group.size());
        if count == 1 {
            return Ok((OwnedAndGhosts::all(share.global_count), share.atoms.clone()));
        }
        let x = &share.atoms.positions;
        let near = NearbyCubes::around(x, room);
        // Only those whose atoms may be near are told what is.
        let boxes: Vec<[[f64; D]; 2]> = group.all_gather("where atoms are", bounding_box(x))?;
        let to = boxes.iter().enumerate().map(|(of, spread)| {
            let asked = of != rank && near.intersects(spread);
            if asked {
                near.clone()
            } else {
                NearbyCubes::empty()
            }
        });
        let asked: Vec<NearbyCubes<D>> = group.all_to_all("what is near", to.collect())?;
        let wants = |rank: usize, n: usize| asked[rank].contains(&x[n]);
        let mut wanted: Vec<Vec<u32>> = (0..count)
            .map(|rank| {
                (0..x.len())
                    .filter(|&n| wants(rank, n))
                    .map(|n| n as u32)
                    .collect()
            })
            .collect();
        drop(near);
        let others = share.exchange_wanted("atoms that are held", wants, group)?;
        drop(asked);
        // Those of a rank follow one another, in the order of ranks, and so do their numbers.
        let before = others
            .indices
            .partition_point(|&n| (n as usize) < share.first_index);
        let own = before..before + x.len();
        for n in wanted.iter_mut().flatten() {
            *n += before as u32;
        }
        let IndexedAtoms {
            indices: numbers,
            atoms,
        } = others.insert_owned(share, before);
        let firsts: Vec<usize> = group.all_gather("first atoms", share.first_index)?;
        let place = |number: usize| numbers.partition_point(|&n| (n as usize) < number);
        let end = |rank: usize| firsts.get(rank + 1).map_or(numbers.len(), |&n| place(n));
        let of_rank = (0..count)
            .map(|rank| place(firsts[rank])..end(rank))
            .collect();
        let held = Self {
            comm: group,
            owned: own,
            global_indices: Some(numbers),
            rank_ranges: of_rank,
            send_lists: wanted,
        };
        Ok((held, atoms))
    }

    /// Where this rank's own atoms are among those held.
    pub fn owned(&self) -> Range<usize> {
        self.owned.clone()
    }

    /// Whether other ranks hold others.
    pub fn is_partitioned(&self) -> bool {
        self.global_indices.is_some()
    }

    /// The number in the lattice of the `n`th atom held.
    #[inline(always)]
    pub fn global_index(&self, n: usize) -> usize {
        self.global_indices
            .as_ref()
            .map_or(n, |all| all[n] as usize)
    }

    /// Which of the atoms held has that number in the lattice.
    pub fn local_index(&self, number: usize) -> Option<usize> {
        match &self.global_indices {
            None => Some(number),
            Some(all) => all.binary_search(&(number as u32)).ok(),
        }
    }

    /// Whose own the `n`th atom held is.
    pub fn owner_rank(&self, n: usize) -> usize {
        self.rank_ranges.partition_point(|of_rank| of_rank.end <= n)
    }

    /// Takes the positions of others' atoms that are held from these.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn update_ghosts<const D: usize>(&self, x: &mut [[f64; D]]) -> Result<()> {
        if !self.is_partitioned() {
            return Ok(());
        }
        let of = |wanted: &Vec<u32>| -> Vec<f64> {
            wanted.iter().flat_map(|&n| x[n as usize]).collect()
        };
        let told = self.send_lists.iter().map(of).collect();
        let heard: Vec<Vec<f64>> = self.comm.all_to_all("positions of atoms", told)?;
        for (rank, (heard, place)) in heard.iter().zip(&self.rank_ranges).enumerate() {
            if rank != self.comm.rank() {
                x[place.clone()].as_flattened_mut().copy_from_slice(heard);
            }
        }
        Ok(())
    }

    /// Adds up sums of chunks of own atoms and those of other ranks, in the order of the chunks.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn all_reduce_sum<const N: usize>(&self, sums: Vec<[f64; N]>) -> Result<[f64; N]> {
        let all = self.comm.all_gather("sums over atoms", sums)?;
        Ok(all.iter().flatten().fold([0.0; N], |mut total, sums| {
            total
                .iter_mut()
                .zip(sums)
                .for_each(|(total, sum)| *total += sum);
            total
        }))
    }

    /// What each rank has, on all that share the lattice.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn all_gather<T: Codec>(&self, what: &str, own: T) -> Result<Vec<T>> {
        self.comm.all_gather(what, own)
    }

    /// What each rank has for this one, in their order; `to` has something for each, or for the first of them.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn all_to_all<T: Codec>(&self, what: &str, mut to: Vec<Vec<T>>) -> Result<Vec<Vec<T>>> {
        to.resize_with(self.comm.size(), Vec::new);
        self.comm.all_to_all(what, to)
    }
}

/// Cubes of a grid in the room that atoms are held within.
const CUBES_PER_HALO_WIDTH: f64 = 2.0;

/// How far from one's own, along each axis, atoms may be that are held as no farther than `room`.
pub fn halo_extent(room: f64) -> f64 {
    (1.0 + 1.0 / CUBES_PER_HALO_WIDTH) * room
}

/// What is near to some positions: the cubes of a grid that hold one of them, and two cubes around.
#[derive(Clone)]
struct NearbyCubes<const D: usize> {
    low: [f64; D],
    edge: f64,
    dims: [usize; D],
    /// A bit for each cube.
    cubes: Vec<u64>,
}

codec_fields! {
    @(const D: usize) NearbyCubes<D> as NearbyCubes { low, edge, dims, cubes }
}

impl<const D: usize> NearbyCubes<D> {
    /// Nothing.
    fn empty() -> Self {
        Self {
            low: [0.0; D],
            edge: 1.0,
            dims: [0; D],
            cubes: Vec::new(),
        }
    }

    /// What may be as near as `room`.
    fn around(x: &[[f64; D]], room: f64) -> Self {
        if x.is_empty() {
            return Self::empty();
        }
        let edge = room / CUBES_PER_HALO_WIDTH;
        let [low, high] = bounding_box(x);
        let low = low.map(|low| low - 2.5 * edge);
        let dims: [usize; D] =
            std::array::from_fn(|k| ((high[k] - low[k]).max(0.0) / edge) as usize + 4);
        let mut near = Self {
            low,
            edge,
            dims,
            cubes: Vec::new(),
        };
        let mut cubes = vec![false; dims.iter().product()];
        for x in x {
            if let Some(cube) = near.cube_index(x) {
                cubes[cube] = true;
            }
        }
        let mut stride = 1;
        for n in dims {
            let before = cubes.clone();
            for (cube, is) in cubes.iter_mut().enumerate() {
                let at = cube / stride % n;
                *is = (at.saturating_sub(2)..(at + 3).min(n))
                    .any(|other| before[cube + other * stride - at * stride]);
            }
            stride *= n;
        }
        let bits = |some: &[bool]| {
            let bits = some.iter().enumerate();
            bits.fold(0, |bits, (i, is)| bits | u64::from(*is) << i)
        };
        near.cubes = cubes.chunks(u64::BITS as usize).map(bits).collect();
        near
    }

    /// Whether something between these corners may be near.
    fn intersects(&self, [low, high]: &[[f64; D]; 2]) -> bool {
        let end = |k: usize| self.low[k] + self.edge * self.dims[k] as f64;
        !self.cubes.is_empty() && (0..D).all(|k| low[k] <= end(k) && self.low[k] <= high[k])
    }

    fn cube_index(&self, x: &[f64; D]) -> Option<usize> {
        (0..D).rev().try_fold(0, |cube, k| {
            let at = ((x[k] - self.low[k]) / self.edge).floor();
            (at >= 0.0 && at < self.dims[k] as f64).then(|| cube * self.dims[k] + at as usize)
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
    fn each_holds_its_own_and_all_near_them_and_hears_where_these_are() {
        let extent = [90.0, 50.0, 60.0];
        let distance = Distance::Constant(4.0);
        let atoms = seeding::fcc(extent, &distance, &[], Alignment::OnFeatures).unwrap();
        let (x, room) = (&atoms.positions, 7.0);
        assert!(x.len() > 5 * CHUNK_ATOMS);
        let moved = |n: usize| x[n].map(|c| c + 0.01 * n as f64);
        for count in [1, 2, 3, 5, 9] {
            let owned = run_threads(count, |group| {
                let share = OwnedAtoms::from_global(atoms.clone(), group);
                let (held, near) = OwnedAndGhosts::with_halo(&share, room, group).unwrap();
                let own = held.owned();
                let numbers: Vec<usize> = (0..near.len()).map(|n| held.global_index(n)).collect();
                assert!(
                    (near.positions.iter().zip(&near.kinds).zip(&numbers))
                        .all(|((y, kind), &n)| *y == x[n] && *kind == atoms.kinds[n])
                );
                assert!(numbers.is_sorted());
                for (n, &number) in numbers.iter().enumerate() {
                    assert_eq!(held.local_index(number), Some(n));
                    assert_eq!(
                        held.is_partitioned() && held.owner_rank(n) == group.rank(),
                        { held.is_partitioned() && own.contains(&n) }
                    );
                }
                // All that are near, and not all.
                let is_own = |n: usize| own.contains(&n);
                for (number, y) in x.iter().enumerate().step_by(7) {
                    let near = (own.clone()).any(|n| distance2(&x[numbers[n]], y) < room * room);
                    assert!(!near || held.local_index(number).is_some());
                }
                assert!(count == 1 || count > 4 || numbers.len() < x.len());
                // Each moves its own only.
                let place = |n: usize| match is_own(n) {
                    true => moved(numbers[n]),
                    false => x[numbers[n]],
                };
                let mut own_moved: Vec<[f64; 3]> = (0..numbers.len()).map(place).collect();
                held.update_ghosts(&mut own_moved).unwrap();
                assert!(own_moved.iter().zip(&numbers).all(|(y, &n)| *y == moved(n)));
                own.len()
            });
            assert_eq!(owned.iter().sum::<usize>(), x.len(), "{count}");
        }
    }
}

//! Which atoms of a lattice a rank holds while they move: its own, and those of others that these may feel.
//!
//! A rank's own atoms are whole chunks of successive ones, which lie together in space. Around them it holds a halo of
//! others' atoms, whose positions it is told whenever they have moved. Atoms are held in the order of the lattice, so
//! that whatever is done with them in that order is done as by one process that holds all.

use std::ops::Range;

use crate::error::Result;
use crate::files::kept::Kept;
use crate::lattice::energy::CHUNK;
use crate::ranks::{Alone, Group, share_of};

/// Ranks tell one another where all their atoms are in so many parts.
const ROUNDS: usize = 8;

/// Which of so many atoms are the own ones of a rank of `count`.
fn own_of(atoms: usize, rank: usize, count: usize) -> Range<usize> {
    let chunks = share_of(atoms.div_ceil(CHUNK), rank, count);
    (chunks.start * CHUNK).min(atoms)..(chunks.end * CHUNK).min(atoms)
}

/// The atoms that are held here, and who holds them besides.
pub struct Held<'a> {
    group: &'a dyn Group,
    /// The number of each in the lattice, rising. None where all are held.
    numbers: Option<Vec<u32>>,
    /// Where this rank's own are among them.
    own: Range<usize>,
    /// Where those of each rank are among them.
    of_rank: Vec<Range<usize>>,
    /// The own atoms that each other rank holds, by their place among those held.
    wanted: Vec<Vec<u32>>,
}

impl Held<'static> {
    /// All of so many atoms, by whoever asks.
    pub fn all(atoms: usize) -> Self {
        Self {
            group: &Alone,
            numbers: None,
            own: 0..atoms,
            of_rank: Vec::new(),
            wanted: Vec::new(),
        }
    }
}

impl<'a> Held<'a> {
    /// This rank's share of atoms at `x`, which all ranks know, and all others that are no farther than `room` from it
    /// (and some that are).
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn share<const D: usize>(x: &[[f64; D]], room: f64, group: &'a dyn Group) -> Result<Self> {
        let (rank, count) = (group.rank(), group.count());
        if count == 1 {
            return Ok(Held::all(x.len()));
        }
        let own = own_of(x.len(), rank, count);
        let near = Near::to(&x[own.clone()], room);
        let held = |n: &u32| own.contains(&(*n as usize)) || near.has(&x[*n as usize]);
        let numbers: Vec<u32> = (0..x.len() as u32).filter(held).collect();
        let place = |number| numbers.partition_point(|&n| (n as usize) < number);
        let of_rank = |rank| own_of(x.len(), rank, count);
        let of_rank: Vec<Range<usize>> = (0..count)
            .map(|rank| place(of_rank(rank).start)..place(of_rank(rank).end))
            .collect();
        let asked = of_rank
            .iter()
            .enumerate()
            .map(|(of, held)| match of == rank {
                true => Vec::new(),
                false => numbers[held.clone()].to_vec(),
            });
        let mut wanted: Vec<Vec<u32>> = group.pass("atoms that are held", asked.collect())?;
        let first = of_rank[rank].start;
        for n in wanted.iter_mut().flatten() {
            *n = (*n as usize - own.start + first) as u32;
        }
        Ok(Self {
            group,
            own: of_rank[rank].clone(),
            numbers: Some(numbers),
            of_rank,
            wanted,
        })
    }

    /// Where this rank's own atoms are among those held.
    pub fn own(&self) -> Range<usize> {
        self.own.clone()
    }

    /// Whether other ranks hold others.
    pub fn is_part(&self) -> bool {
        self.numbers.is_some()
    }

    /// The number in the lattice of the `n`th atom held.
    #[inline(always)]
    pub fn number(&self, n: usize) -> usize {
        self.numbers.as_ref().map_or(n, |all| all[n] as usize)
    }

    /// Which of the atoms held has that number in the lattice.
    pub fn place(&self, number: usize) -> Option<usize> {
        match &self.numbers {
            None => Some(number),
            Some(all) => all.binary_search(&(number as u32)).ok(),
        }
    }

    /// Whose own the `n`th atom held is.
    pub fn owner(&self, n: usize) -> usize {
        self.of_rank.partition_point(|of_rank| of_rank.end <= n)
    }

    /// What the atoms held have of an array that all have.
    pub fn of<T: Copy>(&self, all: &[T]) -> Vec<T> {
        match &self.numbers {
            None => all.to_vec(),
            Some(numbers) => numbers.iter().map(|&n| all[n as usize]).collect(),
        }
    }

    /// Takes the positions of others' atoms that are held from these.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn refresh<const D: usize>(&self, x: &mut [[f64; D]]) -> Result<()> {
        if !self.is_part() {
            return Ok(());
        }
        let of = |wanted: &Vec<u32>| -> Vec<f64> {
            wanted.iter().flat_map(|&n| x[n as usize]).collect()
        };
        let told = self.wanted.iter().map(of).collect();
        let heard: Vec<Vec<f64>> = self.group.pass("positions of atoms", told)?;
        for (rank, (heard, place)) in heard.iter().zip(&self.of_rank).enumerate() {
            if rank != self.group.rank() {
                x[place.clone()].as_flattened_mut().copy_from_slice(heard);
            }
        }
        Ok(())
    }

    /// Writes the positions of all atoms of the lattice, each from the rank whose own it is.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn gather<const D: usize>(&self, x: &[[f64; D]], all: &mut [[f64; D]]) -> Result<()> {
        // Bit by bit, so that not all is in memory three times.
        for round in 0..ROUNDS {
            let some = |own: Range<usize>| {
                let part = share_of(own.len(), round, ROUNDS);
                own.start + part.start..own.start + part.end
            };
            let own = x[some(self.own())].as_flattened().to_vec();
            let of_ranks: Vec<Vec<f64>> = self.group.all("positions of all atoms", own)?;
            for (rank, of_rank) in of_ranks.iter().enumerate() {
                let place = some(own_of(all.len(), rank, self.group.count()));
                all[place].as_flattened_mut().copy_from_slice(of_rank);
            }
        }
        Ok(())
    }

    /// Adds up sums of chunks of own atoms and those of other ranks, in the order of the chunks.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn total<const N: usize>(&self, sums: Vec<[f64; N]>) -> Result<[f64; N]> {
        let all = self.group.all("sums over atoms", sums)?;
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
    pub fn told<T: Kept>(&self, what: &str, own: T) -> Result<Vec<T>> {
        self.group.all(what, own)
    }

    /// What each rank has for this one, in their order; `to` has something for each, or for the first of them.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn passed<T: Kept>(&self, what: &str, mut to: Vec<Vec<T>>) -> Result<Vec<Vec<T>>> {
        to.resize_with(self.group.count(), Vec::new);
        self.group.pass(what, to)
    }
}

/// What is near to some positions: the cubes of a grid that hold one of them, and two cubes around.
struct Near<const D: usize> {
    low: [f64; D],
    edge: f64,
    dims: [usize; D],
    cubes: Vec<bool>,
}

impl<const D: usize> Near<D> {
    /// What may be as near as `room`.
    fn to(x: &[[f64; D]], room: f64) -> Self {
        let edge = 0.5 * room;
        let over = |fold: fn(f64, f64) -> f64, from: f64| -> [f64; D] {
            std::array::from_fn(|k| x.iter().map(|x| x[k]).fold(from, fold))
        };
        let low = over(f64::min, f64::INFINITY).map(|low| low - 2.5 * edge);
        let high = over(f64::max, f64::NEG_INFINITY);
        let dims = std::array::from_fn(|k| ((high[k] - low[k]).max(0.0) / edge) as usize + 4);
        let mut near = Self {
            low,
            edge,
            dims,
            cubes: Vec::new(),
        };
        if x.is_empty() {
            return near;
        }
        near.cubes = vec![false; dims.iter().product()];
        for x in x {
            if let Some(cube) = near.cube(x) {
                near.cubes[cube] = true;
            }
        }
        let mut stride = 1;
        for n in dims {
            let before = near.cubes.clone();
            for (cube, is) in near.cubes.iter_mut().enumerate() {
                let at = cube / stride % n;
                *is = (at.saturating_sub(2)..(at + 3).min(n))
                    .any(|other| before[cube + other * stride - at * stride]);
            }
            stride *= n;
        }
        near
    }

    fn cube(&self, x: &[f64; D]) -> Option<usize> {
        (0..D).rev().try_fold(0, |cube, k| {
            let at = ((x[k] - self.low[k]) / self.edge).floor();
            (at >= 0.0 && at < self.dims[k] as f64).then(|| cube * self.dims[k] + at as usize)
        })
    }

    fn has(&self, x: &[f64; D]) -> bool {
        !self.cubes.is_empty() && self.cube(x).is_some_and(|cube| self.cubes[cube])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::distance2;
    use crate::lattice::distance::Distance;
    use crate::lattice::seeding::{self, Alignment};
    use crate::ranks::shared;

    #[test]
    fn each_holds_its_own_and_all_near_them_and_hears_where_these_are() {
        let extent = [90.0, 50.0, 60.0];
        let distance = Distance::Constant(4.0);
        let atoms = seeding::fcc(extent, &distance, &[], Alignment::On).unwrap();
        let (x, room) = (&atoms.positions, 7.0);
        assert!(x.len() > 5 * CHUNK);
        let moved = |n: usize| x[n].map(|c| c + 0.01 * n as f64);
        for count in [1, 2, 3, 5, 9] {
            let gathered = shared(count, |group| {
                let held = Held::share(x, room, group).unwrap();
                let own = held.own();
                let numbers: Vec<usize> = (0..held.of(x).len()).map(|n| held.number(n)).collect();
                assert!(numbers.is_sorted());
                for (n, &number) in numbers.iter().enumerate() {
                    assert_eq!(held.place(number), Some(n));
                    assert_eq!(held.is_part() && held.owner(n) == group.rank(), {
                        held.is_part() && own.contains(&n)
                    });
                }
                // All that are near, and not all.
                let is_own = |n: usize| own.contains(&n);
                for (number, y) in x.iter().enumerate().step_by(7) {
                    let near = (own.clone()).any(|n| distance2(&x[numbers[n]], y) < room * room);
                    assert!(!near || held.place(number).is_some());
                }
                assert!(count == 1 || count > 4 || numbers.len() < x.len());
                // Each moves its own only.
                let place = |n: usize| match is_own(n) {
                    true => moved(numbers[n]),
                    false => x[numbers[n]],
                };
                let mut own_moved: Vec<[f64; 3]> = (0..numbers.len()).map(place).collect();
                held.refresh(&mut own_moved).unwrap();
                assert!(own_moved.iter().zip(&numbers).all(|(y, &n)| *y == moved(n)));
                let mut all = vec![[0.0; 3]; x.len()];
                held.gather(&own_moved, &mut all).unwrap();
                (all, own.len())
            });
            let own: usize = gathered.iter().map(|(_, own)| own).sum();
            assert_eq!(own, x.len());
            for (all, _) in gathered {
                assert!(
                    all.iter().enumerate().all(|(n, y)| *y == moved(n)),
                    "{count}"
                );
            }
        }
    }
}

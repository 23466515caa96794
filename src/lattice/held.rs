//! Which atoms of a lattice a rank holds while they move: its own, and those of others that these may feel.
//!
//! A rank's own atoms are whole chunks of successive ones, which lie together in space. Around them it holds a halo of
//! others' atoms, whose positions it is told whenever they have moved. Atoms are held in the order of the lattice, so
//! that whatever is done with them in that order is done as by one process that holds all.

use std::ops::Range;

use crate::error::Result;
use crate::files::kept::{Kept, fields};
use crate::geometry::spread;
use crate::lattice::seeding::Atoms;
use crate::lattice::share::{Numbered, OwnAtoms};
use crate::ranks::{Alone, Group};

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
    /// A rank's share of atoms, and all others that are no farther than `room` from it (and some that are).
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn share<const D: usize>(
        share: &OwnAtoms<D>,
        room: f64,
        group: &'a dyn Group,
    ) -> Result<(Self, Atoms<D>)> {
        let (rank, count) = (group.rank(), group.count());
        if count == 1 {
            return Ok((Held::all(share.whole), share.atoms.clone()));
        }
        let x = &share.atoms.positions;
        let near = Near::to(x, room);
        // Only those whose atoms may be near are told what is.
        let boxes: Vec<[[f64; D]; 2]> = group.all("where atoms are", spread(x))?;
        let to = boxes.iter().enumerate().map(|(of, spread)| {
            let asked = of != rank && near.meets(spread);
            if asked { near.clone() } else { Near::nothing() }
        });
        let asked: Vec<Near<D>> = group.pass("what is near", to.collect())?;
        let wants = |rank: usize, n: usize| asked[rank].has(&x[n]);
        let mut wanted: Vec<Vec<u32>> = (0..count)
            .map(|rank| {
                (0..x.len())
                    .filter(|&n| wants(rank, n))
                    .map(|n| n as u32)
                    .collect()
            })
            .collect();
        drop(near);
        let others = share.passed("atoms that are held", wants, group)?;
        drop(asked);
        // Those of a rank follow one another, in the order of ranks, and so do their numbers.
        let before = others
            .numbers
            .partition_point(|&n| (n as usize) < share.first);
        let own = before..before + x.len();
        for n in wanted.iter_mut().flatten() {
            *n += before as u32;
        }
        let Numbered { numbers, atoms } = others.with(share, before);
        let firsts: Vec<usize> = group.all("first atoms", share.first)?;
        let place = |number: usize| numbers.partition_point(|&n| (n as usize) < number);
        let end = |rank: usize| firsts.get(rank + 1).map_or(numbers.len(), |&n| place(n));
        let of_rank = (0..count)
            .map(|rank| place(firsts[rank])..end(rank))
            .collect();
        let held = Self {
            group,
            own,
            numbers: Some(numbers),
            of_rank,
            wanted,
        };
        Ok((held, atoms))
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

/// Cubes of a grid in the room that atoms are held within.
const CUBES: f64 = 2.0;

/// How far from one's own, along each axis, atoms may be that are held as no farther than `room`.
pub fn within(room: f64) -> f64 {
    (1.0 + 1.0 / CUBES) * room
}

/// What is near to some positions: the cubes of a grid that hold one of them, and two cubes around.
#[derive(Clone)]
struct Near<const D: usize> {
    low: [f64; D],
    edge: f64,
    dims: [usize; D],
    /// A bit for each cube.
    cubes: Vec<u64>,
}

fields! {
    @(const D: usize) Near<D> as Near { low, edge, dims, cubes }
}

impl<const D: usize> Near<D> {
    /// Nothing.
    fn nothing() -> Self {
        Self {
            low: [0.0; D],
            edge: 1.0,
            dims: [0; D],
            cubes: Vec::new(),
        }
    }

    /// What may be as near as `room`.
    fn to(x: &[[f64; D]], room: f64) -> Self {
        if x.is_empty() {
            return Self::nothing();
        }
        let edge = room / CUBES;
        let [low, high] = spread(x);
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
            if let Some(cube) = near.cube(x) {
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
    fn meets(&self, [low, high]: &[[f64; D]; 2]) -> bool {
        let end = |k: usize| self.low[k] + self.edge * self.dims[k] as f64;
        !self.cubes.is_empty() && (0..D).all(|k| low[k] <= end(k) && self.low[k] <= high[k])
    }

    fn cube(&self, x: &[f64; D]) -> Option<usize> {
        (0..D).rev().try_fold(0, |cube, k| {
            let at = ((x[k] - self.low[k]) / self.edge).floor();
            (at >= 0.0 && at < self.dims[k] as f64).then(|| cube * self.dims[k] + at as usize)
        })
    }

    fn has(&self, x: &[f64; D]) -> bool {
        let is_near = |cube: usize| self.cubes[cube / 64] >> (cube % 64) & 1 == 1;
        !self.cubes.is_empty() && self.cube(x).is_some_and(is_near)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::distance2;
    use crate::lattice::distance::Distance;
    use crate::lattice::energy::CHUNK;
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
            let owned = shared(count, |group| {
                let share = OwnAtoms::of(atoms.clone(), group);
                let (held, near) = Held::share(&share, room, group).unwrap();
                let own = held.own();
                let numbers: Vec<usize> = (0..near.len()).map(|n| held.number(n)).collect();
                assert!(
                    (near.positions.iter().zip(&near.kinds).zip(&numbers))
                        .all(|((y, kind), &n)| *y == x[n] && *kind == atoms.kinds[n])
                );
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
                own.len()
            });
            assert_eq!(owned.iter().sum::<usize>(), x.len(), "{count}");
        }
    }
}

//! The atoms of a lattice that one of a group has where none has all.

use std::ops::Range;

use crate::error::Result;
use crate::files::kept::fields;
use crate::lattice::energy::CHUNK;
use crate::lattice::seeding::Atoms;
use crate::ranks::{Group, share_of};

/// Some atoms that follow one another in a lattice, whole chunks of [`CHUNK`]: those of one of a group.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OwnAtoms<const D: usize> {
    /// The atoms.
    pub atoms: Atoms<D>,
    /// The number in the lattice of the first.
    pub first: usize,
    /// Atoms of the lattice.
    pub whole: usize,
}

/// Atoms of a lattice that someone else has, by their numbers in it, rising.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Numbered<const D: usize> {
    /// The number of each.
    pub numbers: Vec<u32>,
    /// The atoms.
    pub atoms: Atoms<D>,
}

fields! {
    @(const D: usize) Numbered<D> as Numbered { numbers, atoms }
}

/// Atoms that are told at once, at most.
const MESSAGE: usize = 1 << 20;

/// Which of so many atoms are those of one of `count`.
pub fn own_of(atoms: usize, rank: usize, count: usize) -> Range<usize> {
    let chunks = share_of(atoms.div_ceil(CHUNK), rank, count);
    (chunks.start * CHUNK).min(atoms)..(chunks.end * CHUNK).min(atoms)
}

impl<const D: usize> OwnAtoms<D> {
    /// Of atoms that all of the group have.
    pub fn of(atoms: Atoms<D>, group: &dyn Group) -> Self {
        let whole = atoms.len();
        if group.count() == 1 {
            return Self {
                atoms,
                first: 0,
                whole,
            };
        }
        let own = own_of(whole, group.rank(), group.count());
        Self {
            first: own.start,
            whole,
            atoms: atoms.some(own),
        }
    }

    /// The numbers in the lattice of these.
    pub fn own(&self) -> Range<usize> {
        self.first..self.first + self.atoms.len()
    }

    /// All atoms, on all of the group.
    ///
    /// # Errors
    /// Those of the others.
    pub fn gathered(self, group: &dyn Group) -> Result<Atoms<D>> {
        self.bit_by_bit(group, &|part| group.all("all atoms", part))
    }

    /// All atoms, on the first of the group; none elsewhere.
    ///
    /// # Errors
    /// Those of the others.
    pub fn gathered_by_first(self, group: &dyn Group) -> Result<Atoms<D>> {
        self.bit_by_bit(group, &|part| {
            let mut to = vec![Atoms::default(); group.count()];
            to[0] = part;
            group.pass("all atoms", to)
        })
    }

    /// What `told` gives of the atoms here, in messages that are not large, so that nothing is in memory twice.
    fn bit_by_bit(
        self,
        group: &dyn Group,
        told: &dyn Fn(Atoms<D>) -> Result<Vec<Atoms<D>>>,
    ) -> Result<Atoms<D>> {
        let (count, whole) = (group.count(), self.whole);
        if count == 1 {
            return Ok(self.atoms);
        }
        let mut all = Atoms::default();
        for rank in 0..count {
            let of_rank = own_of(whole, rank, count);
            for from in of_rank.clone().step_by(MESSAGE) {
                let part = from..(from + MESSAGE).min(of_rank.end);
                let own = match rank == group.rank() {
                    true => (self.atoms).some(part.start - self.first..part.end - self.first),
                    false => Atoms::default(),
                };
                for part in told(own)? {
                    if all.is_empty() && !part.is_empty() {
                        all.positions.reserve_exact(whole);
                        all.kinds.reserve_exact(whole);
                    }
                    all.append(part);
                }
            }
        }
        Ok(all)
    }

    /// Of atoms that only the first of the group has: the others' are of no interest.
    ///
    /// # Errors
    /// Those of the others.
    pub fn dealt(by_first: Atoms<D>, group: &dyn Group) -> Result<Self> {
        let whole = group.all("atoms dealt", by_first.len())?[0];
        if group.count() == 1 {
            return Ok(Self::of(by_first, group));
        }
        let mut own = Self {
            atoms: Atoms::default(),
            first: own_of(whole, group.rank(), group.count()).start,
            whole,
        };
        for rank in 0..group.count() {
            let to = |to: usize| match to == rank && group.rank() == 0 {
                true => by_first.some(own_of(whole, to, group.count())),
                false => Atoms::default(),
            };
            let told = group.pass("atoms dealt", (0..group.count()).map(to).collect())?;
            for part in told {
                own.atoms.append(part);
            }
        }
        Ok(own)
    }

    /// What each of the group wants of the lattice: `wants` says of each atom here, by its place, whether one of them
    /// does.
    ///
    /// # Errors
    /// Those of the others.
    pub fn passed(
        &self,
        what: &str,
        wants: impl Fn(usize, usize) -> bool,
        group: &dyn Group,
    ) -> Result<Numbered<D>> {
        let of = |rank: usize| {
            let wanted = (0..self.atoms.len()).filter(|&n| wants(rank, n));
            let wanted: Vec<u32> = wanted.map(|n| n as u32).collect();
            let Atoms { positions, kinds } = &self.atoms;
            Numbered {
                atoms: Atoms {
                    positions: wanted.iter().map(|&n| positions[n as usize]).collect(),
                    kinds: wanted.iter().map(|&n| kinds[n as usize]).collect(),
                },
                numbers: wanted.iter().map(|n| n + self.first as u32).collect(),
            }
        };
        let others = |rank| match rank == group.rank() {
            true => Numbered::default(),
            false => of(rank),
        };
        let told = group.pass(what, (0..group.count()).map(others).collect())?;
        let mut all = Numbered::default();
        for (rank, some) in told.into_iter().enumerate() {
            // What is here need not be passed on.
            let mut some = match rank == group.rank() {
                true => of(rank),
                false => some,
            };
            all.numbers.append(&mut some.numbers);
            all.atoms.append(some.atoms);
        }
        Ok(all)
    }
}

impl<const D: usize> Numbered<D> {
    /// With those of a share, whose numbers are between the first `before` and the others.
    pub fn with(mut self, share: &OwnAtoms<D>, before: usize) -> Self {
        let own = share.own().map(|n| n as u32);
        let Atoms { positions, kinds } = &mut self.atoms;
        self.numbers.splice(before..before, own);
        positions.splice(before..before, share.atoms.positions.iter().copied());
        kinds.splice(before..before, share.atoms.kinds.iter().copied());
        self
    }
}

impl<const D: usize> Atoms<D> {
    /// Some that follow one another.
    pub fn some(&self, range: Range<usize>) -> Self {
        Self {
            positions: self.positions[range.clone()].to_vec(),
            kinds: self.kinds[range].to_vec(),
        }
    }

    /// Takes others behind these.
    pub fn append(&mut self, mut others: Self) {
        self.positions.append(&mut others.positions);
        self.kinds.append(&mut others.kinds);
    }
}

impl<const D: usize> Default for Atoms<D> {
    fn default() -> Self {
        Self {
            positions: Vec::new(),
            kinds: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::AtomKind;
    use crate::ranks::shared;

    fn atoms(count: usize) -> Atoms<3> {
        Atoms {
            positions: (0..count)
                .map(|n| [n as f64, 0.5 * n as f64, 7.0])
                .collect(),
            kinds: (0..count)
                .map(|n| match n % 5 {
                    0 => AtomKind::Fixed,
                    _ => AtomKind::Interior,
                })
                .collect(),
        }
    }

    #[test]
    fn shares_are_the_lattice_in_turn_and_go_to_all_or_to_the_first() {
        for (count, atoms) in [
            (1, atoms(3000)),
            (3, atoms(7 * CHUNK + 5)),
            (4, atoms(2 * CHUNK)),
        ] {
            let shares = shared(count, |group| {
                let share = OwnAtoms::of(atoms.clone(), group);
                let first = share.clone().gathered_by_first(group).unwrap();
                assert!(share.clone().gathered(group).unwrap() == atoms);
                assert!(
                    first
                        == if group.rank() == 0 {
                            atoms.clone()
                        } else {
                            Atoms::default()
                        }
                );
                assert!(OwnAtoms::dealt(first, group).unwrap() == share);
                share
            });
            let mut all = Atoms::default();
            for share in shares {
                assert_eq!((share.first, share.whole), (all.len(), atoms.len()));
                all.append(share.atoms);
            }
            assert!(all == atoms, "{count}");
        }
    }

    #[test]
    fn each_gets_the_atoms_that_it_wants() {
        let atoms = atoms(5 * CHUNK);
        for count in [1, 2, 5] {
            shared(count, |group| {
                let share = OwnAtoms::of(atoms.clone(), group);
                let wants = |rank: usize, n: usize| {
                    let number = share.first + n;
                    number.is_multiple_of(rank + 2)
                };
                let got = share.passed("atoms", wants, group).unwrap();
                let every = (group.rank() + 2) as u32;
                let numbers = (0..atoms.len() as u32).filter(|n| n % every == 0);
                assert!(got.numbers.iter().copied().eq(numbers));
                for (&n, x) in got.numbers.iter().zip(&got.atoms.positions) {
                    assert_eq!(*x, atoms.positions[n as usize]);
                }
            });
        }
    }
}

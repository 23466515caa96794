//! The atoms of a lattice that one of a group has where none has all.

use std::ops::Range;

use crate::comm::{Comm, partition_range};
use crate::error::Result;
use crate::files::codec::codec_fields;
use crate::lattice::energy::CHUNK_ATOMS;
use crate::lattice::seeding::Atoms;

/// Some atoms that follow one another in a lattice, whole chunks of [`CHUNK_ATOMS`]: those of one of a group.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OwnedAtoms<const D: usize> {
    /// The atoms.
    pub atoms: Atoms<D>,
    /// The number in the lattice of the first.
    pub first_index: usize,
    /// Atoms of the lattice.
    pub global_count: usize,
}

/// Atoms of a lattice that someone else has, by their numbers in it, rising.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct IndexedAtoms<const D: usize> {
    /// The number of each.
    pub indices: Vec<u32>,
    /// The atoms.
    pub atoms: Atoms<D>,
}

codec_fields! {
    @(const D: usize) IndexedAtoms<D> as IndexedAtoms { indices, atoms }
}

/// Atoms that are told at once, at most.
const MAX_ATOMS_PER_MESSAGE: usize = 1 << 20;

/// Which of so many atoms are those of one of `count`.
pub fn owned_range(atoms: usize, rank: usize, count: usize) -> Range<usize> {
    let chunks = partition_range(atoms.div_ceil(CHUNK_ATOMS), rank, count);
    (chunks.start * CHUNK_ATOMS).min(atoms)..(chunks.end * CHUNK_ATOMS).min(atoms)
}

impl<const D: usize> OwnedAtoms<D> {
    /// Of atoms that all of the group have.
    pub fn from_global(atoms: Atoms<D>, group: &dyn Comm) -> Self {
        let global_count = atoms.len();
        if group.size() == 1 {
            return Self {
                atoms,
                first_index: 0,
                global_count,
            };
        }
        let own = owned_range(global_count, group.rank(), group.size());
        Self {
            first_index: own.start,
            global_count,
            atoms: atoms.slice(own),
        }
    }

    /// The numbers in the lattice of these.
    pub fn index_range(&self) -> Range<usize> {
        self.first_index..self.first_index + self.atoms.len()
    }

    /// All atoms, on all of the group.
    ///
    /// # Errors
    /// Those of the others.
    pub fn all_gather(self, group: &dyn Comm) -> Result<Atoms<D>> {
        self.gather_in_messages(group, &|part| group.all_gather("all atoms", part))
    }

    /// All atoms, on the first of the group; none elsewhere.
    ///
    /// # Errors
    /// Those of the others.
    pub fn gather_to_root(self, group: &dyn Comm) -> Result<Atoms<D>> {
        self.gather_in_messages(group, &|part| {
            let mut to = vec![Atoms::default(); group.size()];
            to[0] = part;
            group.all_to_all("all atoms", to)
        })
    }

    /// What `told` gives of the atoms here, in messages that are not large, so that nothing is in memory twice.
    fn gather_in_messages(
        self,
        group: &dyn Comm,
        told: &dyn Fn(Atoms<D>) -> Result<Vec<Atoms<D>>>,
    ) -> Result<Atoms<D>> {
        let (count, whole) = (group.size(), self.global_count);
        if count == 1 {
            return Ok(self.atoms);
        }
        let mut all = Atoms::default();
        for rank in 0..count {
            let of_rank = owned_range(whole, rank, count);
            for from in of_rank.clone().step_by(MAX_ATOMS_PER_MESSAGE) {
                let part = from..(from + MAX_ATOMS_PER_MESSAGE).min(of_rank.end);
                let own = match rank == group.rank() {
                    true => (self.atoms)
                        .slice(part.start - self.first_index..part.end - self.first_index),
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
    pub fn scatter_from_root(by_first: Atoms<D>, group: &dyn Comm) -> Result<Self> {
        let whole = group.all_gather("atoms dealt", by_first.len())?[0];
        if group.size() == 1 {
            return Ok(Self::from_global(by_first, group));
        }
        let mut own = Self {
            atoms: Atoms::default(),
            first_index: owned_range(whole, group.rank(), group.size()).start,
            global_count: whole,
        };
        for rank in 0..group.size() {
            let to = |to: usize| match to == rank && group.rank() == 0 {
                true => by_first.slice(owned_range(whole, to, group.size())),
                false => Atoms::default(),
            };
            let told = group.all_to_all("atoms dealt", (0..group.size()).map(to).collect())?;
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
    pub fn exchange_wanted(
        &self,
        what: &str,
        wants: impl Fn(usize, usize) -> bool,
        group: &dyn Comm,
    ) -> Result<IndexedAtoms<D>> {
        let of = |rank: usize| {
            let wanted = (0..self.atoms.len()).filter(|&n| wants(rank, n));
            let wanted: Vec<u32> = wanted.map(|n| n as u32).collect();
            let Atoms { positions, kinds } = &self.atoms;
            IndexedAtoms {
                atoms: Atoms {
                    positions: wanted.iter().map(|&n| positions[n as usize]).collect(),
                    kinds: wanted.iter().map(|&n| kinds[n as usize]).collect(),
                },
                indices: wanted.iter().map(|n| n + self.first_index as u32).collect(),
            }
        };
        let others = |rank| match rank == group.rank() {
            true => IndexedAtoms::default(),
            false => of(rank),
        };
        let told = group.all_to_all(what, (0..group.size()).map(others).collect())?;
        let mut all = IndexedAtoms::default();
        for (rank, some) in told.into_iter().enumerate() {
            // What is here need not be passed on.
            let mut some = match rank == group.rank() {
                true => of(rank),
                false => some,
            };
            all.indices.append(&mut some.indices);
            all.atoms.append(some.atoms);
        }
        Ok(all)
    }
}

impl<const D: usize> IndexedAtoms<D> {
    /// With those of a share, whose numbers are between the first `before` and the others.
    pub fn insert_owned(mut self, share: &OwnedAtoms<D>, before: usize) -> Self {
        let own = share.index_range().map(|n| n as u32);
        let Atoms { positions, kinds } = &mut self.atoms;
        self.indices.splice(before..before, own);
        positions.splice(before..before, share.atoms.positions.iter().copied());
        kinds.splice(before..before, share.atoms.kinds.iter().copied());
        self
    }
}

impl<const D: usize> Atoms<D> {
    /// Some that follow one another.
    pub fn slice(&self, range: Range<usize>) -> Self {
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
    use crate::comm::run_threads;
    use crate::lattice::AtomKind;

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
            (3, atoms(7 * CHUNK_ATOMS + 5)),
            (4, atoms(2 * CHUNK_ATOMS)),
        ] {
            let shares = run_threads(count, |group| {
                let share = OwnedAtoms::from_global(atoms.clone(), group);
                let first = share.clone().gather_to_root(group).unwrap();
                assert!(share.clone().all_gather(group).unwrap() == atoms);
                assert!(
                    first
                        == if group.rank() == 0 {
                            atoms.clone()
                        } else {
                            Atoms::default()
                        }
                );
                assert!(OwnedAtoms::scatter_from_root(first, group).unwrap() == share);
                share
            });
            let mut all = Atoms::default();
            for share in shares {
                assert_eq!(
                    (share.first_index, share.global_count),
                    (all.len(), atoms.len())
                );
                all.append(share.atoms);
            }
            assert!(all == atoms, "{count}");
        }
    }

    #[test]
    fn each_gets_the_atoms_that_it_wants() {
        let atoms = atoms(5 * CHUNK_ATOMS);
        for count in [1, 2, 5] {
            run_threads(count, |group| {
                let share = OwnedAtoms::from_global(atoms.clone(), group);
                let wants = |rank: usize, n: usize| {
                    let number = share.first_index + n;
                    number.is_multiple_of(rank + 2)
                };
                let got = share.exchange_wanted("atoms", wants, group).unwrap();
                let every = (group.rank() + 2) as u32;
                let numbers = (0..atoms.len() as u32).filter(|n| n % every == 0);
                assert!(got.indices.iter().copied().eq(numbers));
                for (&n, x) in got.indices.iter().zip(&got.atoms.positions) {
                    assert_eq!(*x, atoms.positions[n as usize]);
                }
            });
        }
    }
}

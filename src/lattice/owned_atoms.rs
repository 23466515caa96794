//! Distribution of the atoms of a lattice over ranks, none of which has all atoms.

use std::ops::Range;

use crate::comm::{Comm, partition_range};
use crate::error::Result;
use crate::files::codec::codec_fields;
use crate::lattice::energy::CHUNK_ATOMS;
use crate::lattice::seeding::Atoms;

/// The atoms that one rank owns: successive atoms of a lattice, whole chunks of [`CHUNK_ATOMS`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OwnedAtoms<const D: usize> {
    /// The atoms.
    pub atoms: Atoms<D>,
    /// Index in the lattice of the first atom.
    pub first_index: usize,
    /// Count of atoms in the lattice.
    pub global_count: usize,
}

/// Atoms from other ranks with their indices in the lattice, ascending.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct IndexedAtoms<const D: usize> {
    /// The index of each atom.
    pub indices: Vec<u32>,
    /// The atoms.
    pub atoms: Atoms<D>,
}

codec_fields! {
    @(const D: usize) IndexedAtoms<D> as IndexedAtoms { indices, atoms }
}

/// Most atoms per message.
const MAX_ATOMS_PER_MESSAGE: usize = 1 << 20;

/// Returns the range of the atoms that one of `rank_count` ranks owns.
pub fn owned_range(atom_count: usize, rank: usize, rank_count: usize) -> Range<usize> {
    let chunks = partition_range(atom_count.div_ceil(CHUNK_ATOMS), rank, rank_count);
    (chunks.start * CHUNK_ATOMS).min(atom_count)..(chunks.end * CHUNK_ATOMS).min(atom_count)
}

impl<const D: usize> OwnedAtoms<D> {
    /// Takes the owned atoms of this rank from a lattice that all ranks have.
    pub fn from_global(atoms: Atoms<D>, comm: &dyn Comm) -> Self {
        let global_count = atoms.len();
        if comm.size() == 1 {
            return Self {
                atoms,
                first_index: 0,
                global_count,
            };
        }
        let range = owned_range(global_count, comm.rank(), comm.size());
        Self {
            first_index: range.start,
            global_count,
            atoms: atoms.slice(range),
        }
    }

    /// Returns the indices in the lattice of the owned atoms.
    pub fn index_range(&self) -> Range<usize> {
        self.first_index..self.first_index + self.atoms.len()
    }

    /// Returns all atoms, on every rank.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn all_gather(self, comm: &dyn Comm) -> Result<Atoms<D>> {
        self.gather_in_messages(comm, &|part| comm.all_gather("all atoms", part))
    }

    /// Returns all atoms on the first rank, and no atoms on the others.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn gather_to_root(self, comm: &dyn Comm) -> Result<Atoms<D>> {
        self.gather_in_messages(comm, &|part| {
            let mut messages = vec![Atoms::default(); comm.size()];
            messages[0] = part;
            comm.all_to_all("all atoms", messages)
        })
    }

    /// Concatenates the atoms that `exchange` returns for parts of the owned atoms. The parts are
    /// small, so that the lattice is never in memory twice.
    fn gather_in_messages(
        self,
        comm: &dyn Comm,
        exchange: &dyn Fn(Atoms<D>) -> Result<Vec<Atoms<D>>>,
    ) -> Result<Atoms<D>> {
        let (rank_count, global_count) = (comm.size(), self.global_count);
        if rank_count == 1 {
            return Ok(self.atoms);
        }
        let mut gathered = Atoms::default();
        for rank in 0..rank_count {
            let rank_range = owned_range(global_count, rank, rank_count);
            for start in rank_range.clone().step_by(MAX_ATOMS_PER_MESSAGE) {
                let part = start..(start + MAX_ATOMS_PER_MESSAGE).min(rank_range.end);
                let owned = if rank == comm.rank() {
                    (self.atoms).slice(part.start - self.first_index..part.end - self.first_index)
                } else {
                    Atoms::default()
                };
                for part in exchange(owned)? {
                    if gathered.is_empty() && !part.is_empty() {
                        gathered.positions.reserve_exact(global_count);
                        gathered.kinds.reserve_exact(global_count);
                    }
                    gathered.append(part);
                }
            }
        }
        Ok(gathered)
    }

    /// Distributes atoms that the first rank has. `root_atoms` is ignored on the other ranks.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn scatter_from_root(root_atoms: Atoms<D>, comm: &dyn Comm) -> Result<Self> {
        let global_count = comm.all_gather("scattered atoms", root_atoms.len())?[0];
        if comm.size() == 1 {
            return Ok(Self::from_global(root_atoms, comm));
        }
        let mut owned = Self {
            atoms: Atoms::default(),
            first_index: owned_range(global_count, comm.rank(), comm.size()).start,
            global_count,
        };
        for rank in 0..comm.size() {
            let message = |to: usize| {
                if to == rank && comm.rank() == 0 {
                    root_atoms.slice(owned_range(global_count, to, comm.size()))
                } else {
                    Atoms::default()
                }
            };
            let received =
                comm.all_to_all("scattered atoms", (0..comm.size()).map(message).collect())?;
            for part in received {
                owned.atoms.append(part);
            }
        }
        Ok(owned)
    }

    /// Returns the atoms of the lattice that this rank wants. `is_wanted(rank, n)` says for each
    /// rank whether it wants the owned atom `n` of this rank.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn exchange_wanted(
        &self,
        label: &str,
        is_wanted: impl Fn(usize, usize) -> bool,
        comm: &dyn Comm,
    ) -> Result<IndexedAtoms<D>> {
        let wanted_by = |rank: usize| {
            let indices = (0..self.atoms.len()).filter(|&n| is_wanted(rank, n));
            let indices: Vec<u32> = indices.map(|n| n as u32).collect();
            let Atoms { positions, kinds } = &self.atoms;
            IndexedAtoms {
                atoms: Atoms {
                    positions: indices.iter().map(|&n| positions[n as usize]).collect(),
                    kinds: indices.iter().map(|&n| kinds[n as usize]).collect(),
                },
                indices: indices
                    .iter()
                    .map(|n| n + self.first_index as u32)
                    .collect(),
            }
        };
        let message = |rank| {
            if rank == comm.rank() {
                IndexedAtoms::default()
            } else {
                wanted_by(rank)
            }
        };
        let received = comm.all_to_all(label, (0..comm.size()).map(message).collect())?;
        let mut gathered = IndexedAtoms::default();
        for (rank, atoms) in received.into_iter().enumerate() {
            // The atoms of this rank need not be sent.
            let mut atoms = if rank == comm.rank() {
                wanted_by(rank)
            } else {
                atoms
            };
            gathered.indices.append(&mut atoms.indices);
            gathered.atoms.append(atoms.atoms);
        }
        Ok(gathered)
    }
}

impl<const D: usize> IndexedAtoms<D> {
    /// Inserts owned atoms at `position`. Their indices must lie between those of the atoms before
    /// and after.
    pub fn insert_owned(mut self, owned: &OwnedAtoms<D>, position: usize) -> Self {
        let indices = owned.index_range().map(|n| n as u32);
        let Atoms { positions, kinds } = &mut self.atoms;
        self.indices.splice(position..position, indices);
        positions.splice(position..position, owned.atoms.positions.iter().copied());
        kinds.splice(position..position, owned.atoms.kinds.iter().copied());
        self
    }
}

impl<const D: usize> Atoms<D> {
    /// Returns a copy of successive atoms.
    pub fn slice(&self, range: Range<usize>) -> Self {
        Self {
            positions: self.positions[range.clone()].to_vec(),
            kinds: self.kinds[range].to_vec(),
        }
    }

    /// Appends other atoms to these.
    pub fn append(&mut self, mut other: Self) {
        self.positions.append(&mut other.positions);
        self.kinds.append(&mut other.kinds);
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
    fn ranks_own_successive_atoms_that_can_be_gathered_and_scattered() {
        for (count, atoms) in [
            (1, atoms(3000)),
            (3, atoms(7 * CHUNK_ATOMS + 5)),
            (4, atoms(2 * CHUNK_ATOMS)),
        ] {
            let shares = run_threads(count, |comm| {
                let owned = OwnedAtoms::from_global(atoms.clone(), comm);
                let on_root = owned.clone().gather_to_root(comm).unwrap();
                assert!(owned.clone().all_gather(comm).unwrap() == atoms);
                assert!(
                    on_root
                        == if comm.rank() == 0 {
                            atoms.clone()
                        } else {
                            Atoms::default()
                        }
                );
                assert!(OwnedAtoms::scatter_from_root(on_root, comm).unwrap() == owned);
                owned
            });
            let mut gathered = Atoms::default();
            for owned in shares {
                assert_eq!(
                    (owned.first_index, owned.global_count),
                    (gathered.len(), atoms.len())
                );
                gathered.append(owned.atoms);
            }
            assert!(gathered == atoms, "{count}");
        }
    }

    #[test]
    fn ranks_receive_the_atoms_that_they_want() {
        let atoms = atoms(5 * CHUNK_ATOMS);
        for count in [1, 2, 5] {
            run_threads(count, |comm| {
                let owned = OwnedAtoms::from_global(atoms.clone(), comm);
                let is_wanted = |rank: usize, n: usize| {
                    let index = owned.first_index + n;
                    index.is_multiple_of(rank + 2)
                };
                let received = owned.exchange_wanted("atoms", is_wanted, comm).unwrap();
                let divisor = (comm.rank() + 2) as u32;
                let expected = (0..atoms.len() as u32).filter(|n| n % divisor == 0);
                assert!(received.indices.iter().copied().eq(expected));
                for (&n, x) in received.indices.iter().zip(&received.atoms.positions) {
                    assert_eq!(*x, atoms.positions[n as usize]);
                }
            });
        }
    }
}

//! Those who hold parts of a thing: a group, or one alone, who cannot fail.

use std::convert::Infallible;
use std::ops::Range;

use super::{Comm, SelfComm, partition_range};
use crate::files::codec::Codec;

/// Those who hold the parts of a mesh: a group, or one that holds all of it, which cannot fail. All ask the same
/// things in the same order.
pub trait LocalOrComm: Sync {
    /// How telling one another may fail.
    type Error;

    /// Which of them this is, from 0.
    fn rank(&self) -> usize;

    /// How many they are.
    fn size(&self) -> usize;

    /// What each of them has, in their order, on all of them.
    ///
    /// # Errors
    /// Those of the others.
    fn try_all_gather<T: Codec>(&self, what: &str, own: T) -> Result<Vec<T>, Self::Error>;

    /// What each of them has for this one, in their order; `to` has something for each.
    ///
    /// # Errors
    /// Those of the others.
    fn try_all_to_all<T: Codec>(&self, what: &str, to: Vec<T>) -> Result<Vec<T>, Self::Error>;

    /// Counts of which all have as many, summed up. Each sums up a share of them: nobody gets all that the others
    /// have.
    ///
    /// # Errors
    /// Those of the others.
    fn all_reduce_sum(&self, what: &str, own: Vec<u64>) -> Result<Vec<u64>, Self::Error> {
        let count = self.size();
        let share = |to: usize| own[self.range_of_rank(own.len(), to)].to_vec();
        let mut from = self.try_all_to_all(what, (0..count).map(share).collect())?;
        let mut sums = from.pop().unwrap_or_default();
        for other in from {
            sums.iter_mut().zip(other).for_each(|(sum, n)| *sum += n);
        }
        Ok(self.try_all_gather(what, sums)?.concat())
    }

    /// Which of so many things one of them has to do.
    fn range_of_rank(&self, things: usize, of: usize) -> Range<usize> {
        partition_range(things, of, self.size())
    }

    /// Which of them answers for a node, of so many in the whole.
    fn owner_rank(&self, node: u32, nodes: usize) -> usize {
        (node as usize * self.size() / nodes.max(1)).min(self.size() - 1)
    }
}

impl LocalOrComm for SelfComm {
    type Error = Infallible;

    fn rank(&self) -> usize {
        0
    }

    fn size(&self) -> usize {
        1
    }

    fn try_all_gather<T: Codec>(&self, _: &str, own: T) -> Result<Vec<T>, Infallible> {
        Ok(vec![own])
    }

    fn try_all_to_all<T: Codec>(&self, _: &str, to: Vec<T>) -> Result<Vec<T>, Infallible> {
        Ok(to)
    }
}

impl LocalOrComm for dyn Comm + '_ {
    type Error = crate::Error;

    fn rank(&self) -> usize {
        Comm::rank(self)
    }

    fn size(&self) -> usize {
        Comm::size(self)
    }

    fn try_all_gather<T: Codec>(&self, what: &str, own: T) -> crate::Result<Vec<T>> {
        self.all_gather(what, own)
    }

    fn try_all_to_all<T: Codec>(&self, what: &str, to: Vec<T>) -> crate::Result<Vec<T>> {
        self.all_to_all(what, to)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::run_threads;

    #[test]
    fn counts_are_summed_up_by_all() {
        for count in [1, 2, 3, 7] {
            for length in [0, 1, 5, 100] {
                let own = |rank: usize| (0..length).map(move |i| (i * (rank + 1)) as u64);
                let sums = run_threads(count, |group| {
                    group
                        .all_reduce_sum("counts", own(Comm::rank(group)).collect())
                        .unwrap()
                });
                let all = (1..=count).sum::<usize>();
                let wanted: Vec<u64> = (0..length).map(|i| (i * all) as u64).collect();
                assert!(sums.iter().all(|sums| *sums == wanted));
            }
        }
        assert_eq!(
            SelfComm.all_reduce_sum("counts", vec![3, 4]),
            Ok(vec![3, 4])
        );
    }
}

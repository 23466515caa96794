//! Group of ranks, or one process alone, for measurements that are written once for both. Exchange in a group may fail;
//! a process alone cannot fail, so that functions which measure a mesh in one process need not return an error.

use std::convert::Infallible;
use std::ops::Range;

use super::{Comm, SelfComm, partition_range};
use crate::files::codec::Codec;

/// A [`Comm`], whose exchange may fail, or [`SelfComm`], whose exchange cannot. All ranks make the same calls in the
/// same order.
pub trait LocalOrComm: Sync {
    /// Error of the exchange.
    type Error;

    /// Returns the number of this rank, from 0.
    fn rank(&self) -> usize;

    /// Returns the number of ranks.
    fn size(&self) -> usize;

    /// Returns the value of each rank, in the order of ranks, on all ranks.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    fn try_all_gather<T: Codec>(&self, place: &str, own: T) -> Result<Vec<T>, Self::Error>;

    /// Sends `to[k]` to rank `k`, and returns what this rank receives of each, in the order of ranks.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    fn try_all_to_all<T: Codec>(&self, place: &str, to: Vec<T>) -> Result<Vec<T>, Self::Error>;

    /// Returns the elementwise sum of the counts of all ranks, which have equally many. Each rank sums a part of them,
    /// so that no rank receives all counts of all ranks.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    fn all_reduce_sum(&self, place: &str, own: Vec<u64>) -> Result<Vec<u64>, Self::Error> {
        let part = |to: usize| own[self.range_of_rank(own.len(), to)].to_vec();
        let mut received = self.try_all_to_all(place, (0..self.size()).map(part).collect())?;
        let mut sums = received.pop().unwrap_or_default();
        for other in received {
            sums.iter_mut().zip(other).for_each(|(sum, n)| *sum += n);
        }
        Ok(self.try_all_gather(place, sums)?.concat())
    }

    /// Returns the parts of one rank, if all ranks divide `parts` parts evenly.
    fn range_of_rank(&self, parts: usize, rank: usize) -> Range<usize> {
        partition_range(parts, rank, self.size())
    }

    /// Returns the rank that owns a node of a global mesh of `nodes` nodes.
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

    fn try_all_gather<T: Codec>(&self, place: &str, own: T) -> crate::Result<Vec<T>> {
        self.all_gather(place, own)
    }

    fn try_all_to_all<T: Codec>(&self, place: &str, to: Vec<T>) -> crate::Result<Vec<T>> {
        self.all_to_all(place, to)
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

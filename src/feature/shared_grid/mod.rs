//! The grid of an image's samples, whose layers are distributed over ranks.
//!
//! Detectors, surfaces and distances ask the grid, or what it distributes, for what they need of other ranks,
//! and know no ranks themselves:
//!
//! - `candidate_slab`: candidates of some layers and of a halo
//! - `distributed_points`: feature points of some layers, also with a halo
//! - [`Samples`](super::windows::Samples), outside: samples, some layers at a time

mod candidate_slab;
mod distributed_points;

use crate::comm::selection::{RadixKey, order_statistics};
use crate::comm::{Comm, SelfComm, concatenate};
use crate::error::Result;
use crate::files::codec::Codec;
use crate::image::SparseField;
use std::iter::Sum;
use std::ops::Range;

pub use candidate_slab::CandidateSlab;
pub(super) use distributed_points::PointsWithHalo;
pub use distributed_points::{PointCounts, PointSubset};

/// The grid of an image's samples. Ranks share its layers along the last axis: those of lower ranks come first. All
/// ranks call the same methods in the same order; `what` names a call, and must be the same on all ranks. Methods
/// return the errors of other ranks.
#[derive(Debug, Clone, Copy)]
pub struct SharedGrid<'g, const D: usize> {
    /// Number of samples along each axis.
    pub dims: [usize; D],
    comm: &'g dyn Comm,
}

impl<const D: usize> SharedGrid<'static, D> {
    /// Creates the grid of one process, which has all layers.
    pub fn of_one_process(dims: [usize; D]) -> Self {
        Self {
            dims,
            comm: &SelfComm,
        }
    }
}

impl<'g, const D: usize> SharedGrid<'g, D> {
    /// Creates a grid whose layers the ranks of `comm` share.
    pub fn new(dims: [usize; D], comm: &'g dyn Comm) -> Self {
        Self { dims, comm }
    }

    /// Returns another grid that the same ranks share.
    pub fn with_dims(self, dims: [usize; D]) -> Self {
        Self { dims, ..self }
    }

    /// Returns `true` if several ranks share the layers.
    pub fn is_shared(&self) -> bool {
        self.comm.size() > 1
    }

    /// Returns about how many samples each rank has a share of.
    pub fn samples_per_rank(&self) -> usize {
        self.dims.iter().product::<usize>() / self.comm.size()
    }

    /// Passes the result of each window of layers to `take`, in their order, on every rank; each rank works on some.
    /// Ranks have about the same total weight of windows. `work` computes the results of a range of windows, one
    /// after the other.
    ///
    /// # Errors
    /// Returns the errors of the work, on whichever rank.
    pub fn visit_shares<T: Codec>(
        &self,
        weights: &[usize],
        work: impl FnOnce(Range<usize>, &mut dyn FnMut(T)) -> Result<()>,
        take: &mut dyn FnMut(T),
    ) -> Result<()> {
        (self.comm).distribute_weighted("layers", weights, work, take)
    }

    /// Calls `work` with this rank's share of `count` windows of layers, whose results stay on the rank.
    ///
    /// # Errors
    /// Returns the errors of the work, on whichever rank.
    pub fn compute_share(
        &self,
        count: usize,
        work: impl FnOnce(Range<usize>) -> Result<()>,
    ) -> Result<()> {
        let work = |windows: Range<usize>, _: &mut dyn FnMut(())| work(windows);
        (self.comm).distribute("layers changed", count, work, &mut |()| ())
    }

    /// Returns the samples of the layers `requested`, of which this rank stores those in `stored`. `rows_of` returns
    /// the rows that are wanted of some stored layers.
    pub fn fetch_layers<'s, R: Iterator<Item = &'s [f32]>>(
        &self,
        stored: &Range<usize>,
        requested: &Range<usize>,
        rows_of: impl Fn(Range<usize>) -> R,
    ) -> Result<Vec<f32>> {
        let comm = self.comm;
        let requests: Vec<[usize; 2]> =
            comm.all_gather("layers wanted", [requested.start, requested.end])?;
        let rows_for = |rank: usize| {
            let [start, end] = requests[rank].map(|at| at.clamp(stored.start, stored.end));
            rows_of(start..end)
        };
        // A rank does not send layers to itself.
        let sent = (0..comm.size()).map(|rank| {
            if rank == comm.rank() {
                Vec::new()
            } else {
                rows_for(rank).flatten().copied().collect()
            }
        });
        let received: Vec<Vec<f32>> = comm.all_to_all("layers", sent.collect())?;
        let own_rows = || rows_for(comm.rank());
        let lengths = received
            .iter()
            .map(Vec::len)
            .chain(own_rows().map(<[f32]>::len));
        // Ranks have shares in the order of ranks.
        let mut samples = Vec::with_capacity(lengths.sum());
        for (rank, rows) in received.iter().enumerate() {
            if rank == comm.rank() {
                own_rows().for_each(|rows| samples.extend_from_slice(rows));
            } else {
                samples.extend_from_slice(rows);
            }
        }
        Ok(samples)
    }

    /// Returns what the first rank chooses, on every rank.
    pub fn chosen<T: Codec>(&self, what: &str, choose: impl FnOnce() -> T) -> Result<T> {
        self.comm.broadcast_from_root(what, || Ok(choose()))
    }

    /// Computes a field over the grid from samples that are zero nearly everywhere; each rank stores a part. See
    /// [`SparseField::from_layers`].
    pub fn field(
        &self,
        step: [f64; D],
        fill_layers: impl Fn(Range<usize>, &mut Vec<f32>) + Sync,
    ) -> SparseField<D> {
        SparseField::from_layers(self.dims, step, self.comm, fill_layers)
    }

    /// Returns the items of all ranks for the layers whose samples this rank computes in
    /// [`SharedGrid::field`]; `items_for` returns those of this rank for some layers.
    pub fn items_for_field<T: Codec>(
        &self,
        what: &str,
        items_for: impl Fn(Range<usize>) -> Vec<T>,
    ) -> Result<Vec<T>> {
        let count = self.comm.size();
        let layers = (0..count).map(|rank| SparseField::rank_layers(self.dims, rank, count));
        let sent = layers.map(items_for).collect();
        Ok(concatenate(self.comm.all_to_all(what, sent)?))
    }

    /// Returns the items of all layers, from those of this rank's layers.
    pub fn concatenated<T: Codec>(&self, what: &str, items: Vec<T>) -> Result<Vec<T>> {
        Ok(concatenate(self.comm.all_gather(what, items)?))
    }

    /// Returns the items of the ranks whose layers follow, the next rank first.
    pub fn following<T: Codec>(&self, what: &str, item: T) -> Result<Vec<T>> {
        let mut items = self.comm.all_gather(what, item)?;
        Ok(items.split_off(self.comm.rank() + 1))
    }

    /// Returns the smallest key of all ranks with its item, and `true` if it is this rank's. Of equal keys the one
    /// of the lowest layers counts.
    pub fn first<T: Codec>(&self, what: &str, key: u64, item: T) -> Result<Option<(u64, T, bool)>> {
        let items: Vec<(u64, T)> = self.comm.all_gather(what, (key, item))?;
        let first = (0..).zip(items).min_by_key(|(_, (key, _))| *key);
        Ok(first.map(|(rank, (key, item))| (key, item, rank == self.comm.rank())))
    }

    /// Returns a number that differs for each `n` and each rank.
    pub fn unique_number(&self, n: usize) -> usize {
        n * self.comm.size() + self.comm.rank()
    }

    /// Sums counts over all ranks.
    pub fn sum<T: Codec + Copy + Sum, const N: usize>(
        &self,
        what: &str,
        counts: [T; N],
    ) -> Result<[T; N]> {
        let all: Vec<[T; N]> = self.comm.all_gather(what, counts)?;
        Ok(std::array::from_fn(|k| {
            all.iter().map(|counts| counts[k]).sum()
        }))
    }

    /// Returns the largest of the values of all ranks.
    pub fn max<T: Codec + Copy + Ord>(&self, what: &str, value: T) -> Result<T> {
        Ok((self.comm.all_gather(what, value)?.into_iter()).fold(value, T::max))
    }

    /// Returns `true` if a condition is met on any rank.
    pub fn any(&self, what: &str, condition: bool) -> Result<bool> {
        self.max(what, condition)
    }

    /// Returns the value with index `index_of(n)` of the `n` values of all ranks in ascending total
    /// order (0 is the smallest), or `None` if there are no values.
    pub fn select_nth<V: RadixKey + Send + Sync>(
        &self,
        what: &str,
        mut values: Vec<V>,
        index_of: impl Fn(usize) -> usize,
    ) -> Result<Option<f64>> {
        let [count] = self.sum(what, [values.len()])?;
        if count == 0 {
            return Ok(None);
        }
        let index = index_of(count).min(count - 1);
        if !self.is_shared() {
            let selected = values
                .select_nth_unstable_by_key(index, |value| value.to_key())
                .1;
            return Ok(Some(V::from_key(selected.to_key())));
        }
        let selected = order_statistics(&[values.iter().copied()], &[|_| [index]], self.comm)?;
        Ok(selected.into_iter().flatten().next())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::{partition_range, run_threads};

    #[test]
    fn select_nth_finds_the_value_among_all_ranks() {
        let mut all = vec![
            3.5,
            -1.0,
            0.0,
            -0.0,
            7.25,
            f64::MIN_POSITIVE,
            3.5,
            -8.5,
            1e300,
        ];
        for count in [1, 2, 4, 11] {
            for rank in 0..=all.len() {
                let found = run_threads(count, |comm| {
                    let owned = partition_range(all.len(), comm.rank(), count);
                    let index_of = |number: usize| {
                        assert_eq!(number, all.len());
                        rank
                    };
                    SharedGrid::new([1; 3], comm)
                        .select_nth("values", all[owned].to_vec(), index_of)
                        .unwrap()
                });
                let mut sorted = all.clone();
                sorted.sort_by(f64::total_cmp);
                let expected = sorted[rank.min(all.len() - 1)];
                let is_expected =
                    |found: Option<f64>| found.is_some_and(|f| f.to_bits() == expected.to_bits());
                assert!(found.into_iter().all(is_expected), "{count} {rank}");
            }
        }
        all.clear();
        let none = run_threads(2, |comm| {
            SharedGrid::new([1; 3], comm)
                .select_nth("values", Vec::<f64>::new(), |n| n)
                .unwrap()
        });
        assert_eq!(none, [None, None]);
    }
}

//! Sorting on all threads.

/// Methods that sort a slice on all threads, by rayon.
pub trait ParallelSort<T: Send> {
    /// Sorts the slice; equal items may change places.
    fn par_sort_unstable(&mut self)
    where
        T: Ord;

    /// Sorts the slice by a comparison; equal items may change places.
    fn par_sort_unstable_by(&mut self, compare: impl Fn(&T, &T) -> std::cmp::Ordering + Sync);

    /// Sorts the slice by a key; equal items keep their order.
    fn par_sort_by_key<K: Ord>(&mut self, key: impl Fn(&T) -> K + Sync);
}

impl<T: Send> ParallelSort<T> for [T] {
    fn par_sort_unstable(&mut self)
    where
        T: Ord,
    {
        rayon::slice::ParallelSliceMut::par_sort_unstable(self);
    }

    fn par_sort_unstable_by(&mut self, compare: impl Fn(&T, &T) -> std::cmp::Ordering + Sync) {
        rayon::slice::ParallelSliceMut::par_sort_unstable_by(self, compare);
    }

    fn par_sort_by_key<K: Ord>(&mut self, key: impl Fn(&T) -> K + Sync) {
        rayon::slice::ParallelSliceMut::par_sort_by_key(self, key);
    }
}

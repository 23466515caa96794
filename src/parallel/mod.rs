//! Loops on all threads, with the methods of rayon's parallel iterators.
//!
//! Rayon compiles its scheduler once more for each loop: some 6,000 lines of LLVM IR, which made up a
//! quarter of this crate. Here a loop is cut into pieces, each of which is an ordinary iterator.
//! One function, which is compiled once, distributes the numbers of the pieces to rayon's threads.
//! The price is one call through a pointer for each piece, and none for each item.
//!
//! Import the traits with `use crate::parallel::prelude::*` in place of rayon's. There are two
//! differences:
//!
//! - Items are collected piece by piece and then concatenated in their order, so a large array
//!   exists twice for a moment. Where that matters, write into an existing array:
//!   `out.par_chunks_mut(n)`.
//! - `map_init` and similar methods create their state once for each piece. There are some
//!   [`PIECES_PER_THREAD`] pieces for each thread.

mod adaptors;
mod sort;
mod sources;
#[cfg(test)]
mod tests;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use adaptors::{Enumerate, Filter, FilterMap, FlatMap, Map, MapInit, MinMaxLen, TakeAnyWhile, Zip};
use rayon::iter::{IndexedParallelIterator as _, ParallelIterator as _};
use sources::VecItems;

/// The traits, to be imported with `use crate::parallel::prelude::*`.
pub mod prelude {
    pub use super::sort::ParallelSort as _;
    pub use super::sources::{ParallelSlice as _, ParallelSliceMut as _};
    pub use super::{Indexed, IntoParallel as _, Parallel, ParallelExtend as _};
}

/// Number of pieces for each thread. It is large enough that threads end at about the same time
/// although items take different times, and small enough that creating scratch space for each piece
/// pays off.
const PIECES_PER_THREAD: usize = 32;

/// Calls `work` with each number below `count`, on all threads. This is the only function that uses
/// rayon's scheduler.
fn for_each_index(count: usize, work: &(dyn Fn(usize) + Sync)) {
    if count <= 1 || rayon::current_num_threads() == 1 {
        (0..count).for_each(work);
    } else {
        rayon::iter::IntoParallelIterator::into_par_iter(0..count)
            .with_max_len(1)
            .for_each(work);
    }
}

/// Returns the result of `work` for each piece, in the order of the pieces.
fn map_pieces<P: Send, R: Send>(pieces: Vec<P>, work: &(dyn Fn(P) -> R + Sync)) -> Vec<R> {
    let slots: Vec<Mutex<(Option<P>, Option<R>)>> = pieces
        .into_iter()
        .map(|piece| Mutex::new((Some(piece), None)))
        .collect();
    for_each_index(slots.len(), &|index| {
        let lock = || slots[index].lock().unwrap_or_else(PoisonError::into_inner);
        let piece = lock().0.take();
        // The lock is released during the work.
        let result = piece.map(work);
        lock().1 = result;
    });
    slots
        .into_iter()
        .filter_map(|slot| slot.into_inner().unwrap_or_else(PoisonError::into_inner).1)
        .collect()
}

/// Limits of the number of items in a piece.
#[derive(Debug, Clone, Copy)]
pub struct PieceLimits {
    min_len: usize,
    max_len: usize,
}

impl PieceLimits {
    /// Returns how many of `len` items one piece has.
    fn piece_len(self, len: usize) -> usize {
        let pieces = PIECES_PER_THREAD * rayon::current_num_threads();
        len.div_ceil(pieces)
            .max(self.min_len)
            .min(self.max_len)
            .max(1)
    }
}

/// A loop over items that several threads can share.
///
/// Its data are cut into pieces, and one thread runs through each piece. Whatever all pieces share,
/// such as closures, stays in `self`.
pub trait Parallel: Sized + Sync {
    /// Type of the items.
    type Item: Send;
    /// Data of one piece.
    type Piece: Send;

    /// Returns the number of items that the loop starts from, before any are filtered out.
    fn len(&self) -> usize;

    /// Returns the limits of the number of items in a piece.
    fn limits(&self) -> PieceLimits {
        PieceLimits {
            min_len: 1,
            max_len: usize::MAX,
        }
    }

    /// Cuts the data into pieces of `size` items, the last of which may be shorter.
    fn pieces(&mut self, size: usize) -> Vec<Self::Piece>;

    /// Returns the items of a piece, in their order.
    fn items(&self, piece: Self::Piece) -> impl Iterator<Item = Self::Item>;

    /// Replaces each item by the result of `f`.
    fn map<R: Send, F: Fn(Self::Item) -> R + Sync>(self, f: F) -> Map<Self, F> {
        Map { base: self, f }
    }

    /// Replaces each item by the result of `f`, which also receives a state that `init` creates for
    /// each piece.
    fn map_init<S, R, I, F>(self, init: I, f: F) -> MapInit<Self, I, F>
    where
        R: Send,
        I: Fn() -> S + Sync,
        F: Fn(&mut S, Self::Item) -> R + Sync,
    {
        MapInit {
            base: self,
            init,
            f,
        }
    }

    /// Keeps the items for which `f` returns `true`.
    fn filter<F: Fn(&Self::Item) -> bool + Sync>(self, f: F) -> Filter<Self, F> {
        Filter { base: self, f }
    }

    /// Replaces each item by the result of `f`, and drops the items for which that is `None`.
    fn filter_map<R: Send, F: Fn(Self::Item) -> Option<R> + Sync>(
        self,
        f: F,
    ) -> FilterMap<Self, F> {
        FilterMap { base: self, f }
    }

    /// Replaces each item by the items that `f` returns, in order.
    fn flat_map_iter<R, F>(self, f: F) -> FlatMap<Self, F>
    where
        R: IntoIterator,
        R::Item: Send,
        F: Fn(Self::Item) -> R + Sync,
    {
        FlatMap { base: self, f }
    }

    /// Ends the loop soon after `f` has returned `false` for an item.
    fn take_any_while<F: Fn(&Self::Item) -> bool + Sync>(self, f: F) -> TakeAnyWhile<Self, F> {
        TakeAnyWhile {
            base: self,
            f,
            is_done: AtomicBool::new(false),
        }
    }

    /// Copies the items.
    fn copied<'a, T>(self) -> Map<Self, fn(&'a T) -> T>
    where
        T: Copy + Send + Sync + 'a,
        Self: Parallel<Item = &'a T>,
    {
        self.map(|item| *item)
    }

    /// Returns the result of `work` for each piece, in the order of the pieces.
    fn map_pieces<R: Send>(mut self, work: impl Fn(&Self, Self::Piece) -> R + Sync) -> Vec<R> {
        let size = self.limits().piece_len(self.len());
        let pieces = self.pieces(size);
        map_pieces(pieces, &|piece| work(&self, piece))
    }

    /// Calls `f` with each item.
    fn for_each<F: Fn(Self::Item) + Sync>(self, f: F) {
        self.map_pieces(|source, piece| source.items(piece).for_each(&f));
    }

    /// Calls `f` with each item and a state that `init` creates for each piece.
    fn for_each_init<S>(self, init: impl Fn() -> S + Sync, f: impl Fn(&mut S, Self::Item) + Sync) {
        self.map_pieces(|source, piece| {
            let mut state = init();
            source.items(piece).for_each(|item| f(&mut state, item));
        });
    }

    /// Calls `f` with each item.
    ///
    /// # Errors
    /// Returns the error of the first item for which `f` fails, among the items that were reached.
    fn try_for_each<E: Send>(
        self,
        f: impl Fn(Self::Item) -> Result<(), E> + Sync,
    ) -> Result<(), E> {
        self.try_for_each_init(|| (), |(), item| f(item))
    }

    /// Calls `f` with each item and a state that `init` creates for each piece.
    ///
    /// # Errors
    /// Returns the error of the first item for which `f` fails, among the items that were reached.
    fn try_for_each_init<S, E: Send>(
        self,
        init: impl Fn() -> S + Sync,
        f: impl Fn(&mut S, Self::Item) -> Result<(), E> + Sync,
    ) -> Result<(), E> {
        let failed = AtomicBool::new(false);
        let results = self.map_pieces(|source, piece| {
            if failed.load(Ordering::Relaxed) {
                return Ok(());
            }
            let mut state = init();
            let result = source.items(piece).try_for_each(|item| f(&mut state, item));
            failed.fetch_or(result.is_err(), Ordering::Relaxed);
            result
        });
        results.into_iter().collect()
    }

    /// Collects the items in their order.
    fn collect<C: Collect<Self::Item>>(self) -> C {
        C::from_pieces(self.map_pieces(|source, piece| C::collect_piece(source.items(piece))))
    }

    /// Collects items that are pairs into two arrays.
    fn unzip<A: Send, B: Send>(self) -> (Vec<A>, Vec<B>)
    where
        Self: Parallel<Item = (A, B)>,
    {
        let pieces = self.map_pieces(|source, piece| source.items(piece).unzip());
        let (a, b): (Vec<Vec<A>>, Vec<Vec<B>>) = pieces.into_iter().unzip();
        (Vec::from_pieces(a), Vec::from_pieces(b))
    }

    /// Sums the items of each piece, and then these sums. Use it only for numbers whose order makes
    /// no difference, such as integers.
    fn sum<S: std::iter::Sum<Self::Item> + std::iter::Sum<S> + Send>(self) -> S {
        let sums = self.map_pieces(|source, piece| source.items(piece).sum::<S>());
        sums.into_iter().sum()
    }

    /// Returns the number of items.
    fn count(self) -> usize {
        let counts = self.map_pieces(|source, piece| source.items(piece).count());
        counts.into_iter().sum()
    }

    /// Returns the smallest item, and the first one if several are equal.
    fn min(self) -> Option<Self::Item>
    where
        Self::Item: Ord,
    {
        let minima = self.map_pieces(|source, piece| source.items(piece).min());
        minima.into_iter().flatten().min()
    }

    /// Returns the largest item, and the last one if several are equal.
    fn max(self) -> Option<Self::Item>
    where
        Self::Item: Ord,
    {
        let maxima = self.map_pieces(|source, piece| source.items(piece).max());
        maxima.into_iter().flatten().max()
    }

    /// Combines all items into one, starting from `identity`. The order depends on the number of
    /// threads.
    fn reduce(
        self,
        identity: impl Fn() -> Self::Item + Sync,
        f: impl Fn(Self::Item, Self::Item) -> Self::Item + Sync,
    ) -> Self::Item {
        let reduced = self.map_pieces(|source, piece| source.items(piece).fold(identity(), &f));
        reduced.into_iter().fold(identity(), &f)
    }

    /// Folds the items of each piece into one, and returns a loop over the results.
    fn fold<T: Send>(
        self,
        identity: impl Fn() -> T + Sync,
        f: impl Fn(T, Self::Item) -> T + Sync,
    ) -> VecItems<T> {
        let folded = self.map_pieces(|source, piece| source.items(piece).fold(identity(), &f));
        folded.into_par_iter()
    }

    /// Returns `true` if `f` returns `true` for all items.
    fn all(self, f: impl Fn(Self::Item) -> bool + Sync) -> bool {
        !self.any(|item| !f(item))
    }

    /// Returns `true` if `f` returns `true` for at least one item.
    fn any(self, f: impl Fn(Self::Item) -> bool + Sync) -> bool {
        let found = AtomicBool::new(false);
        self.map_pieces(|source, piece| {
            if !found.load(Ordering::Relaxed) && source.items(piece).any(&f) {
                found.store(true, Ordering::Relaxed);
            }
        });
        found.into_inner()
    }
}

/// A loop that filters out no items, so that each item has an index.
pub trait Indexed: Parallel {
    /// Pairs each item with its index.
    fn enumerate(self) -> Enumerate<Self> {
        Enumerate { base: self }
    }

    /// Pairs each item with the item of the same index of another loop; ends with the shorter loop.
    fn zip<O: IntoParallel>(self, other: O) -> Zip<Self, O::Loop> {
        Zip {
            a: self,
            b: other.into_par_iter(),
        }
    }

    /// Requests pieces of at least `min_len` items.
    fn with_min_len(self, min_len: usize) -> MinMaxLen<Self> {
        let limits = PieceLimits {
            min_len,
            ..self.limits()
        };
        MinMaxLen { base: self, limits }
    }

    /// Requests pieces of at most `max_len` items.
    fn with_max_len(self, max_len: usize) -> MinMaxLen<Self> {
        let limits = PieceLimits {
            max_len,
            ..self.limits()
        };
        MinMaxLen { base: self, limits }
    }

    /// Returns the index of the first item for which `f` returns `true`.
    fn position_first(self, f: impl Fn(Self::Item) -> bool + Sync) -> Option<usize> {
        let positions = self
            .enumerate()
            .filter_map(|(index, item)| f(item).then_some(index));
        positions.min()
    }

    /// Replaces the content of an array by the items.
    fn collect_into_vec(self, out: &mut Vec<Self::Item>) {
        *out = self.collect();
    }
}

/// A collection that can be collected in pieces.
pub trait Collect<T>: Sized {
    /// Collected items of one piece.
    type Piece: Send;

    /// Collects the items of a piece.
    fn collect_piece(items: impl Iterator<Item = T>) -> Self::Piece;

    /// Concatenates the pieces.
    fn from_pieces(pieces: Vec<Self::Piece>) -> Self;
}

impl<T: Send> Collect<T> for Vec<T> {
    type Piece = Self;

    fn collect_piece(items: impl Iterator<Item = T>) -> Self {
        items.collect()
    }

    fn from_pieces(mut pieces: Vec<Self>) -> Self {
        if pieces.len() == 1 {
            return pieces.pop().unwrap_or_default();
        }
        let mut joined = Self::with_capacity(pieces.iter().map(Self::len).sum());
        // Each piece is freed as soon as it has been copied.
        pieces.into_iter().for_each(|piece| joined.extend(piece));
        joined
    }
}

impl<T: Send, E: Send> Collect<Result<T, E>> for Result<Vec<T>, E> {
    type Piece = Self;

    fn collect_piece(items: impl Iterator<Item = Result<T, E>>) -> Self {
        items.collect()
    }

    fn from_pieces(pieces: Vec<Self>) -> Self {
        let pieces: Result<Vec<Vec<T>>, E> = pieces.into_iter().collect();
        pieces.map(Vec::from_pieces)
    }
}

impl<E: Send> Collect<Result<(), E>> for Result<(), E> {
    type Piece = Self;

    fn collect_piece(mut items: impl Iterator<Item = Self>) -> Self {
        items.try_for_each(|item| item)
    }

    fn from_pieces(pieces: Vec<Self>) -> Self {
        pieces.into_iter().collect()
    }
}

impl<T: Send> Collect<Option<T>> for Option<Vec<T>> {
    type Piece = Self;

    fn collect_piece(items: impl Iterator<Item = Option<T>>) -> Self {
        items.collect()
    }

    fn from_pieces(pieces: Vec<Self>) -> Self {
        let pieces: Option<Vec<Vec<T>>> = pieces.into_iter().collect();
        pieces.map(Vec::from_pieces)
    }
}

/// Conversion into a loop that threads can share.
pub trait IntoParallel {
    /// Type of the items.
    type Item: Send;
    /// Type of the loop.
    type Loop: Indexed<Item = Self::Item>;

    /// Converts the value into a loop.
    fn into_par_iter(self) -> Self::Loop;
}

impl<P: Indexed> IntoParallel for P {
    type Item = P::Item;
    type Loop = Self;

    fn into_par_iter(self) -> Self {
        self
    }
}

/// Extension of a collection by the items of a loop.
pub trait ParallelExtend<T> {
    /// Appends the items in their order.
    fn par_extend(&mut self, items: impl Parallel<Item = T>);
}

impl<T: Send> ParallelExtend<T> for Vec<T> {
    fn par_extend(&mut self, items: impl Parallel<Item = T>) {
        let pieces = items.map_pieces(|source, piece| source.items(piece).collect::<Self>());
        self.reserve(pieces.iter().map(Self::len).sum());
        pieces.into_iter().for_each(|piece| self.extend(piece));
    }
}

//! Loops on all threads, with the methods of rayon's parallel iterators.
//!
//! Rayon compiles its scheduler anew for each loop: some 6,000 lines of LLVM IR, which made a quarter of this
//! crate. Here a loop is cut into pieces, each of which is an ordinary iterator, and one function, which is
//! compiled once, hands out their numbers to rayon's threads. A call through a pointer for each piece, and none
//! for each item, is the price.
//!
//! Import the traits, `use crate::parallel::prelude::*`, in place of rayon's. What differs:
//!
//! - Items are collected piece by piece and then joined, in their order, so a large array exists twice for a
//!   moment. Where that matters, write into an array that is there: `out.par_chunks_mut(n)`.
//! - `map_init` and its like make their state once for each piece, of which there are some [`PIECES_PER_THREAD`] for
//!   each thread.

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

/// The traits, for `use crate::parallel::prelude::*`.
pub mod prelude {
    pub use super::sort::ParallelSort as _;
    pub use super::sources::{ParallelSlice as _, ParallelSliceMut as _};
    pub use super::{Indexed, IntoParallel as _, Parallel, ParallelExtend as _};
}

/// Pieces for each thread: enough that threads end at about the same time though items take unequally long, and
/// few enough that scratch space made for each piece pays.
const PIECES_PER_THREAD: usize = 32;

/// Calls `work` with each number below `count`, on all threads. The only place where loops meet rayon's scheduler.
fn for_each_index(count: usize, work: &(dyn Fn(usize) + Sync)) {
    if count <= 1 || rayon::current_num_threads() == 1 {
        (0..count).for_each(work);
    } else {
        rayon::iter::IntoParallelIterator::into_par_iter(0..count)
            .with_max_len(1)
            .for_each(work);
    }
}

/// Returns what `work` makes of each piece, in the order of the pieces.
fn map_pieces<P: Send, R: Send>(pieces: Vec<P>, work: &(dyn Fn(P) -> R + Sync)) -> Vec<R> {
    let slots: Vec<Mutex<(Option<P>, Option<R>)>> = pieces
        .into_iter()
        .map(|piece| Mutex::new((Some(piece), None)))
        .collect();
    for_each_index(slots.len(), &|number| {
        let lock = || slots[number].lock().unwrap_or_else(PoisonError::into_inner);
        let piece = lock().0.take();
        // The lock is not held meanwhile.
        let done = piece.map(work);
        lock().1 = done;
    });
    slots
        .into_iter()
        .filter_map(|slot| slot.into_inner().unwrap_or_else(PoisonError::into_inner).1)
        .collect()
}

/// How many items a piece may have.
#[derive(Debug, Clone, Copy)]
pub struct PieceLimits {
    min_len: usize,
    max_len: usize,
}

impl PieceLimits {
    /// Returns how many of `len` items a piece has.
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
/// Its data are cut into pieces, each of which one thread runs through; what all pieces share, such as
/// closures, stays in `self`.
pub trait Parallel: Sized + Sync {
    /// What the loop is over.
    type Item: Send;
    /// The data of a piece.
    type Piece: Send;

    /// Returns the number of items that the loop starts from, before any are left out.
    fn len(&self) -> usize;

    /// Returns how many items a piece may have.
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

    /// Replaces each item by what `f` makes of it.
    fn map<R: Send, F: Fn(Self::Item) -> R + Sync>(self, f: F) -> Map<Self, F> {
        Map { base: self, f }
    }

    /// Replaces each item by what `f` makes of it with a state that `init` makes for each piece.
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

    /// Keeps the items of which `f` is true.
    fn filter<F: Fn(&Self::Item) -> bool + Sync>(self, f: F) -> Filter<Self, F> {
        Filter { base: self, f }
    }

    /// Keeps what `f` makes of items where it is something.
    fn filter_map<R: Send, F: Fn(Self::Item) -> Option<R> + Sync>(
        self,
        f: F,
    ) -> FilterMap<Self, F> {
        FilterMap { base: self, f }
    }

    /// Replaces each item by several, one after the other.
    fn flat_map_iter<R, F>(self, f: F) -> FlatMap<Self, F>
    where
        R: IntoIterator,
        R::Item: Send,
        F: Fn(Self::Item) -> R + Sync,
    {
        FlatMap { base: self, f }
    }

    /// Ends the loop soon after `f` has been false of an item.
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

    /// Returns what `work` makes of each piece, in the order of the pieces.
    fn map_pieces<R: Send>(mut self, work: impl Fn(&Self, Self::Piece) -> R + Sync) -> Vec<R> {
        let size = self.limits().piece_len(self.len());
        let pieces = self.pieces(size);
        map_pieces(pieces, &|piece| work(&self, piece))
    }

    /// Calls `f` with each item.
    fn for_each<F: Fn(Self::Item) + Sync>(self, f: F) {
        self.map_pieces(|all, piece| all.items(piece).for_each(&f));
    }

    /// Calls `f` with each item and a state that `init` makes for each piece.
    fn for_each_init<S>(self, init: impl Fn() -> S + Sync, f: impl Fn(&mut S, Self::Item) + Sync) {
        self.map_pieces(|all, piece| {
            let mut state = init();
            all.items(piece).for_each(|item| f(&mut state, item));
        });
    }

    /// Calls `f` with each item.
    ///
    /// # Errors
    /// The error of the first item that has one, among those that were reached.
    fn try_for_each<E: Send>(
        self,
        f: impl Fn(Self::Item) -> Result<(), E> + Sync,
    ) -> Result<(), E> {
        self.try_for_each_init(|| (), |(), item| f(item))
    }

    /// Calls `f` with each item and a state that `init` makes for each piece.
    ///
    /// # Errors
    /// The error of the first item that has one, among those that were reached.
    fn try_for_each_init<S, E: Send>(
        self,
        init: impl Fn() -> S + Sync,
        f: impl Fn(&mut S, Self::Item) -> Result<(), E> + Sync,
    ) -> Result<(), E> {
        let failed = AtomicBool::new(false);
        let ended = self.map_pieces(|all, piece| {
            if failed.load(Ordering::Relaxed) {
                return Ok(());
            }
            let mut state = init();
            let ended = all.items(piece).try_for_each(|item| f(&mut state, item));
            failed.fetch_or(ended.is_err(), Ordering::Relaxed);
            ended
        });
        ended.into_iter().collect()
    }

    /// Collects the items in their order.
    fn collect<C: Collect<Self::Item>>(self) -> C {
        C::from_pieces(self.map_pieces(|all, piece| C::collect_piece(all.items(piece))))
    }

    /// Collects the two halves of the items, which are pairs.
    fn unzip<A: Send, B: Send>(self) -> (Vec<A>, Vec<B>)
    where
        Self: Parallel<Item = (A, B)>,
    {
        let pieces = self.map_pieces(|all, piece| all.items(piece).unzip());
        let (a, b): (Vec<Vec<A>>, Vec<Vec<B>>) = pieces.into_iter().unzip();
        (Vec::from_pieces(a), Vec::from_pieces(b))
    }

    /// Sums the items of each piece, and then these sums: for numbers of which the order makes no difference.
    fn sum<S: std::iter::Sum<Self::Item> + std::iter::Sum<S> + Send>(self) -> S {
        let sums = self.map_pieces(|all, piece| all.items(piece).sum::<S>());
        sums.into_iter().sum()
    }

    /// Returns the number of items.
    fn count(self) -> usize {
        let counts = self.map_pieces(|all, piece| all.items(piece).count());
        counts.into_iter().sum()
    }

    /// Returns the least item, the first of several.
    fn min(self) -> Option<Self::Item>
    where
        Self::Item: Ord,
    {
        let least = self.map_pieces(|all, piece| all.items(piece).min());
        least.into_iter().flatten().min()
    }

    /// Returns the greatest item, the last of several.
    fn max(self) -> Option<Self::Item>
    where
        Self::Item: Ord,
    {
        let greatest = self.map_pieces(|all, piece| all.items(piece).max());
        greatest.into_iter().flatten().max()
    }

    /// Combines all items into one, from `identity` on, in an order that depends on the number of threads.
    fn reduce(
        self,
        identity: impl Fn() -> Self::Item + Sync,
        f: impl Fn(Self::Item, Self::Item) -> Self::Item + Sync,
    ) -> Self::Item {
        let reduced = self.map_pieces(|all, piece| all.items(piece).fold(identity(), &f));
        reduced.into_iter().fold(identity(), &f)
    }

    /// Folds the items of each piece into one.
    fn fold<T: Send>(
        self,
        identity: impl Fn() -> T + Sync,
        f: impl Fn(T, Self::Item) -> T + Sync,
    ) -> VecItems<T> {
        let folded = self.map_pieces(|all, piece| all.items(piece).fold(identity(), &f));
        folded.into_par_iter()
    }

    /// Returns whether `f` is true of all items.
    fn all(self, f: impl Fn(Self::Item) -> bool + Sync) -> bool {
        !self.any(|item| !f(item))
    }

    /// Returns whether `f` is true of any item.
    fn any(self, f: impl Fn(Self::Item) -> bool + Sync) -> bool {
        let found = AtomicBool::new(false);
        self.map_pieces(|all, piece| {
            if !found.load(Ordering::Relaxed) && all.items(piece).any(&f) {
                found.store(true, Ordering::Relaxed);
            }
        });
        found.into_inner()
    }
}

/// A loop none of whose items are left out, so that each has a number.
pub trait Indexed: Parallel {
    /// Gives each item with its number.
    fn enumerate(self) -> Enumerate<Self> {
        Enumerate { base: self }
    }

    /// Gives each item with that of the same number of another loop; the shorter one says how many there are.
    fn zip<O: IntoParallel>(self, other: O) -> Zip<Self, O::Loop> {
        Zip {
            a: self,
            b: other.into_par_iter(),
        }
    }

    /// Asks for pieces of at least so many items.
    fn with_min_len(self, least: usize) -> MinMaxLen<Self> {
        let limits = PieceLimits {
            min_len: least,
            ..self.limits()
        };
        MinMaxLen { base: self, limits }
    }

    /// Asks for pieces of at most so many items.
    fn with_max_len(self, most: usize) -> MinMaxLen<Self> {
        let limits = PieceLimits {
            max_len: most,
            ..self.limits()
        };
        MinMaxLen { base: self, limits }
    }

    /// Returns the number of the first item of which `f` is true.
    fn position_first(self, f: impl Fn(Self::Item) -> bool + Sync) -> Option<usize> {
        let found = self
            .enumerate()
            .filter_map(|(number, item)| f(item).then_some(number));
        found.min()
    }

    /// Replaces what an array holds by the items.
    fn collect_into_vec(self, out: &mut Vec<Self::Item>) {
        *out = self.collect();
    }
}

/// What can be collected in pieces.
pub trait Collect<T>: Sized {
    /// What is collected of a piece.
    type Piece: Send;

    /// Collects a piece.
    fn collect_piece(items: impl Iterator<Item = T>) -> Self::Piece;

    /// Joins the pieces.
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
        let mut all = Self::with_capacity(pieces.iter().map(Self::len).sum());
        // Each goes as soon as it has been copied.
        pieces.into_iter().for_each(|piece| all.extend(piece));
        all
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

/// What becomes a loop that threads share.
pub trait IntoParallel {
    /// What the loop is over.
    type Item: Send;
    /// The loop.
    type Loop: Indexed<Item = Self::Item>;

    /// Makes a loop of it.
    fn into_par_iter(self) -> Self::Loop;
}

impl<P: Indexed> IntoParallel for P {
    type Item = P::Item;
    type Loop = Self;

    fn into_par_iter(self) -> Self {
        self
    }
}

/// Appending what a loop gives.
pub trait ParallelExtend<T> {
    /// Appends the items in their order.
    fn par_extend(&mut self, items: impl Parallel<Item = T>);
}

impl<T: Send> ParallelExtend<T> for Vec<T> {
    fn par_extend(&mut self, items: impl Parallel<Item = T>) {
        let pieces = items.map_pieces(|all, piece| all.items(piece).collect::<Self>());
        self.reserve(pieces.iter().map(Self::len).sum());
        pieces.into_iter().for_each(|piece| self.extend(piece));
    }
}

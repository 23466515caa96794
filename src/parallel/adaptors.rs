//! Loops that are made from other loops.

use std::sync::atomic::{AtomicBool, Ordering};

use super::{Indexed, Parallel, PieceLimits};

/// Implements the methods of [`Parallel`] that divide a loop into pieces for a loop over `P` that has
/// the pieces of its `base`.
macro_rules! divide_as_base {
    () => {
        fn len(&self) -> usize {
            self.base.len()
        }

        fn limits(&self) -> PieceLimits {
            self.base.limits()
        }

        fn pieces(&mut self, size: usize) -> Vec<P::Piece> {
            self.base.pieces(size)
        }
    };
}

/// The loop of [`Parallel::map`].
pub struct Map<P, F> {
    pub(super) base: P,
    pub(super) f: F,
}

impl<P: Parallel, R: Send, F: Fn(P::Item) -> R + Sync> Parallel for Map<P, F> {
    type Item = R;
    type Piece = P::Piece;

    divide_as_base!();

    fn items(&self, piece: P::Piece) -> impl Iterator<Item = R> {
        self.base.items(piece).map(&self.f)
    }
}

impl<P: Indexed, R: Send, F: Fn(P::Item) -> R + Sync> Indexed for Map<P, F> {}

/// The loop of [`Parallel::map_init`].
pub struct MapInit<P, I, F> {
    pub(super) base: P,
    pub(super) init: I,
    pub(super) f: F,
}

impl<P, S, R, I, F> Parallel for MapInit<P, I, F>
where
    P: Parallel,
    R: Send,
    I: Fn() -> S + Sync,
    F: Fn(&mut S, P::Item) -> R + Sync,
{
    type Item = R;
    type Piece = P::Piece;

    divide_as_base!();

    fn items(&self, piece: P::Piece) -> impl Iterator<Item = R> {
        let mut state = (self.init)();
        let items = self.base.items(piece);
        items.map(move |item| (self.f)(&mut state, item))
    }
}

impl<P, S, R, I, F> Indexed for MapInit<P, I, F>
where
    P: Indexed,
    R: Send,
    I: Fn() -> S + Sync,
    F: Fn(&mut S, P::Item) -> R + Sync,
{
}

/// The loop of [`Parallel::filter`].
pub struct Filter<P, F> {
    pub(super) base: P,
    pub(super) f: F,
}

impl<P: Parallel, F: Fn(&P::Item) -> bool + Sync> Parallel for Filter<P, F> {
    type Item = P::Item;
    type Piece = P::Piece;

    divide_as_base!();

    fn items(&self, piece: P::Piece) -> impl Iterator<Item = P::Item> {
        self.base.items(piece).filter(&self.f)
    }
}

/// The loop of [`Parallel::filter_map`].
pub struct FilterMap<P, F> {
    pub(super) base: P,
    pub(super) f: F,
}

impl<P: Parallel, R: Send, F: Fn(P::Item) -> Option<R> + Sync> Parallel for FilterMap<P, F> {
    type Item = R;
    type Piece = P::Piece;

    divide_as_base!();

    fn items(&self, piece: P::Piece) -> impl Iterator<Item = R> {
        self.base.items(piece).filter_map(&self.f)
    }
}

/// The loop of [`Parallel::flat_map_iter`].
pub struct FlatMap<P, F> {
    pub(super) base: P,
    pub(super) f: F,
}

impl<P, R, F> Parallel for FlatMap<P, F>
where
    P: Parallel,
    R: IntoIterator,
    R::Item: Send,
    F: Fn(P::Item) -> R + Sync,
{
    type Item = R::Item;
    type Piece = P::Piece;

    divide_as_base!();

    fn items(&self, piece: P::Piece) -> impl Iterator<Item = R::Item> {
        self.base.items(piece).flat_map(&self.f)
    }
}

/// The loop of [`Parallel::take_any_while`].
pub struct TakeAnyWhile<P, F> {
    pub(super) base: P,
    pub(super) f: F,
    pub(super) is_done: AtomicBool,
}

impl<P: Parallel, F: Fn(&P::Item) -> bool + Sync> Parallel for TakeAnyWhile<P, F> {
    type Item = P::Item;
    type Piece = P::Piece;

    divide_as_base!();

    fn items(&self, piece: P::Piece) -> impl Iterator<Item = P::Item> {
        self.base.items(piece).take_while(|item| {
            let continues = !self.is_done.load(Ordering::Relaxed) && (self.f)(item);
            if !continues {
                self.is_done.store(true, Ordering::Relaxed);
            }
            continues
        })
    }
}

/// The loop of [`Indexed::enumerate`].
pub struct Enumerate<P> {
    pub(super) base: P,
}

impl<P: Indexed> Parallel for Enumerate<P> {
    type Item = (usize, P::Item);
    type Piece = (usize, P::Piece);

    fn len(&self) -> usize {
        self.base.len()
    }

    fn limits(&self) -> PieceLimits {
        self.base.limits()
    }

    fn pieces(&mut self, size: usize) -> Vec<(usize, P::Piece)> {
        let pieces = self.base.pieces(size).into_iter();
        pieces
            .enumerate()
            .map(|(index, piece)| (index * size, piece))
            .collect()
    }

    fn items(&self, (first, piece): (usize, P::Piece)) -> impl Iterator<Item = (usize, P::Item)> {
        let items = self.base.items(piece).enumerate();
        items.map(move |(index, item)| (first + index, item))
    }
}

impl<P: Indexed> Indexed for Enumerate<P> {}

/// The loop of [`Indexed::zip`].
pub struct Zip<A, B> {
    pub(super) a: A,
    pub(super) b: B,
}

impl<A: Indexed, B: Indexed> Parallel for Zip<A, B> {
    type Item = (A::Item, B::Item);
    type Piece = (A::Piece, B::Piece);

    fn len(&self) -> usize {
        self.a.len().min(self.b.len())
    }

    fn limits(&self) -> PieceLimits {
        let (a, b) = (self.a.limits(), self.b.limits());
        PieceLimits {
            min_len: a.min_len.max(b.min_len),
            max_len: a.max_len.min(b.max_len),
        }
    }

    fn pieces(&mut self, size: usize) -> Vec<(A::Piece, B::Piece)> {
        let (a, b) = (self.a.pieces(size), self.b.pieces(size));
        a.into_iter().zip(b).collect()
    }

    fn items(&self, (a, b): (A::Piece, B::Piece)) -> impl Iterator<Item = (A::Item, B::Item)> {
        self.a.items(a).zip(self.b.items(b))
    }
}

impl<A: Indexed, B: Indexed> Indexed for Zip<A, B> {}

/// The loop of [`Indexed::with_min_len`] and [`Indexed::with_max_len`].
pub struct MinMaxLen<P> {
    pub(super) base: P,
    pub(super) limits: PieceLimits,
}

impl<P: Indexed> Parallel for MinMaxLen<P> {
    type Item = P::Item;
    type Piece = P::Piece;

    fn len(&self) -> usize {
        self.base.len()
    }

    fn limits(&self) -> PieceLimits {
        self.limits
    }

    fn pieces(&mut self, size: usize) -> Vec<P::Piece> {
        self.base.pieces(size)
    }

    fn items(&self, piece: P::Piece) -> impl Iterator<Item = P::Item> {
        self.base.items(piece)
    }
}

impl<P: Indexed> Indexed for MinMaxLen<P> {}

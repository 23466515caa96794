//! Loops over numbers, slices, chunks of slices and owned items.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use super::{Indexed, IntoParallel, Parallel};

/// Returns the ranges of `size` numbers that make up `0..len`.
fn ranges(len: usize, size: usize) -> impl Iterator<Item = Range<usize>> {
    (0..len)
        .step_by(size)
        .map(move |first| first..(first + size).min(len))
}

/// A loop over whole numbers.
pub struct RangeItems<T>(Range<T>);

macro_rules! impl_range_items {
    ($number:ty) => {
        impl Parallel for RangeItems<$number> {
            type Item = $number;
            type Piece = Range<$number>;

            fn len(&self) -> usize {
                self.0.end.saturating_sub(self.0.start) as usize
            }

            fn pieces(&mut self, size: usize) -> Vec<Range<$number>> {
                let number_at = |i: usize| self.0.start + i as $number;
                let pieces = ranges(self.len(), size);
                pieces
                    .map(|range| number_at(range.start)..number_at(range.end))
                    .collect()
            }

            fn items(&self, piece: Range<$number>) -> impl Iterator<Item = $number> {
                piece
            }
        }

        impl Indexed for RangeItems<$number> {}

        impl IntoParallel for Range<$number> {
            type Item = $number;
            type Loop = RangeItems<$number>;

            fn into_par_iter(self) -> RangeItems<$number> {
                RangeItems(self)
            }
        }
    };
}

impl_range_items!(usize);
impl_range_items!(u32);
impl_range_items!(u64);

/// A loop over references to the items of a slice.
pub struct Items<'a, T>(&'a [T]);

impl<'a, T: Sync> Parallel for Items<'a, T> {
    type Item = &'a T;
    type Piece = &'a [T];

    fn len(&self) -> usize {
        self.0.len()
    }

    fn pieces(&mut self, size: usize) -> Vec<&'a [T]> {
        self.0.chunks(size).collect()
    }

    fn items(&self, piece: &'a [T]) -> impl Iterator<Item = &'a T> {
        piece.iter()
    }
}

impl<T: Sync> Indexed for Items<'_, T> {}

/// A loop over mutable references to the items of a slice.
pub struct ItemsMut<'a, T> {
    len: usize,
    slice: Mutex<&'a mut [T]>,
}

impl<'a, T> ItemsMut<'a, T> {
    fn new(slice: &'a mut [T]) -> Self {
        Self {
            len: slice.len(),
            slice: Mutex::new(slice),
        }
    }
}

impl<'a, T: Send> Parallel for ItemsMut<'a, T> {
    type Item = &'a mut T;
    type Piece = &'a mut [T];

    fn len(&self) -> usize {
        self.len
    }

    fn pieces(&mut self, size: usize) -> Vec<&'a mut [T]> {
        take_inner(&mut self.slice).chunks_mut(size).collect()
    }

    fn items(&self, piece: &'a mut [T]) -> impl Iterator<Item = &'a mut T> {
        piece.iter_mut()
    }
}

impl<T: Send> Indexed for ItemsMut<'_, T> {}

/// A loop over chunks of a slice.
pub struct Chunks<'a, T>(&'a [T], usize);

impl<'a, T: Sync> Parallel for Chunks<'a, T> {
    type Item = &'a [T];
    type Piece = &'a [T];

    fn len(&self) -> usize {
        self.0.len().div_ceil(self.1)
    }

    fn pieces(&mut self, size: usize) -> Vec<&'a [T]> {
        self.0.chunks(size * self.1).collect()
    }

    fn items(&self, piece: &'a [T]) -> impl Iterator<Item = &'a [T]> {
        piece.chunks(self.1)
    }
}

impl<T: Sync> Indexed for Chunks<'_, T> {}

/// A loop over mutable chunks of a slice.
pub struct ChunksMut<'a, T> {
    chunk_len: usize,
    items: ItemsMut<'a, T>,
}

impl<'a, T: Send> Parallel for ChunksMut<'a, T> {
    type Item = &'a mut [T];
    type Piece = &'a mut [T];

    fn len(&self) -> usize {
        self.items.len.div_ceil(self.chunk_len)
    }

    fn pieces(&mut self, size: usize) -> Vec<&'a mut [T]> {
        self.items.pieces(size * self.chunk_len)
    }

    fn items(&self, piece: &'a mut [T]) -> impl Iterator<Item = &'a mut [T]> {
        piece.chunks_mut(self.chunk_len)
    }
}

impl<T: Send> Indexed for ChunksMut<'_, T> {}

/// A loop over items that it owns.
pub struct VecItems<T> {
    len: usize,
    items: Mutex<Vec<T>>,
}

impl<T: Send> Parallel for VecItems<T> {
    type Item = T;
    type Piece = Vec<T>;

    fn len(&self) -> usize {
        self.len
    }

    fn pieces(&mut self, size: usize) -> Vec<Vec<T>> {
        let mut rest = take_inner(&mut self.items).into_iter();
        let count = self.len.div_ceil(size);
        (0..count)
            .map(|_| rest.by_ref().take(size).collect())
            .collect()
    }

    fn items(&self, piece: Vec<T>) -> impl Iterator<Item = T> {
        piece.into_iter()
    }
}

impl<T: Send> Indexed for VecItems<T> {}

impl<T: Send> IntoParallel for Vec<T> {
    type Item = T;
    type Loop = VecItems<T>;

    fn into_par_iter(self) -> VecItems<T> {
        VecItems {
            len: self.len(),
            items: Mutex::new(self),
        }
    }
}

/// Takes the value out of a lock that no other thread uses any more.
fn take_inner<T: Default>(lock: &mut Mutex<T>) -> T {
    std::mem::take(lock.get_mut().unwrap_or_else(PoisonError::into_inner))
}

impl<'a, T: Sync> IntoParallel for &'a [T] {
    type Item = &'a T;
    type Loop = Items<'a, T>;

    fn into_par_iter(self) -> Items<'a, T> {
        Items(self)
    }
}

impl<'a, T: Sync> IntoParallel for &'a Vec<T> {
    type Item = &'a T;
    type Loop = Items<'a, T>;

    fn into_par_iter(self) -> Items<'a, T> {
        Items(self)
    }
}

impl<'a, T: Send> IntoParallel for &'a mut [T] {
    type Item = &'a mut T;
    type Loop = ItemsMut<'a, T>;

    fn into_par_iter(self) -> ItemsMut<'a, T> {
        ItemsMut::new(self)
    }
}

impl<'a, T: Send> IntoParallel for &'a mut Vec<T> {
    type Item = &'a mut T;
    type Loop = ItemsMut<'a, T>;

    fn into_par_iter(self) -> ItemsMut<'a, T> {
        ItemsMut::new(self)
    }
}

/// Loops over a shared slice.
pub trait ParallelSlice<T> {
    /// Returns a loop over the items.
    fn par_iter(&self) -> Items<'_, T>;

    /// Returns a loop over chunks of `size` items, the last of which may be shorter.
    fn par_chunks(&self, size: usize) -> Chunks<'_, T>;
}

impl<T> ParallelSlice<T> for [T] {
    fn par_iter(&self) -> Items<'_, T> {
        Items(self)
    }

    fn par_chunks(&self, size: usize) -> Chunks<'_, T> {
        Chunks(self, size)
    }
}

/// Loops over a mutable slice.
pub trait ParallelSliceMut<T> {
    /// Returns a loop over the items.
    fn par_iter_mut(&mut self) -> ItemsMut<'_, T>;

    /// Returns a loop over chunks of `size` items, the last of which may be shorter.
    fn par_chunks_mut(&mut self, size: usize) -> ChunksMut<'_, T>;
}

impl<T> ParallelSliceMut<T> for [T] {
    fn par_iter_mut(&mut self) -> ItemsMut<'_, T> {
        ItemsMut::new(self)
    }

    fn par_chunks_mut(&mut self, size: usize) -> ChunksMut<'_, T> {
        ChunksMut {
            chunk_len: size,
            items: ItemsMut::new(self),
        }
    }
}

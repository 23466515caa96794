//! Numbers as bytes: filled by all threads, written in order. For the containers that are put together
//! here: [`mat`](super::mat), [`hdf5`](super::hdf5), [`netcdf`](super::netcdf).

use std::io::{self, Write};
use std::ops::Range;

use crate::parallel::prelude::*;

use crate::files::vtk::VtkScalar;

/// Numbers in one task.
const NUMBERS_PER_TASK: usize = 1 << 15;
/// Tasks whose bytes are in memory at once.
const TASKS_IN_MEMORY: usize = 16;

/// Appends the bytes of a range of an array's numbers.
type FillFn<'a> = Box<dyn Fn(Range<usize>, &mut Vec<u8>) + Sync + 'a>;

/// Numbers that are made when they are written.
pub struct LazyArray<'a> {
    /// VTK's name of their type.
    pub vtk_type: &'static str,
    /// How many there are.
    pub len: usize,
    element_size: usize,
    fill: FillFn<'a>,
}

impl<'a> LazyArray<'a> {
    /// `len` numbers, number `i` by `value(i)`.
    pub fn from_fn<T: VtkScalar>(len: usize, value: impl Fn(usize) -> T + Sync + 'a) -> Self {
        Self::from_fill::<T>(len, move |range, bytes| {
            range.for_each(|i| value(i).append_bytes(bytes));
        })
    }

    /// `len` numbers, any range of them by `fill`.
    pub fn from_fill<T: VtkScalar>(
        len: usize,
        fill: impl Fn(Range<usize>, &mut Vec<u8>) + Sync + 'a,
    ) -> Self {
        Self {
            vtk_type: T::TYPE_NAME,
            len,
            element_size: T::SIZE,
            fill: Box::new(fill),
        }
    }

    /// Numbers that are in memory.
    pub fn from_slice<T: VtkScalar>(values: &'a [T]) -> Self {
        Self::from_fn(values.len(), |i| values[i])
    }

    /// How many bytes they take.
    pub fn byte_len(&self) -> u64 {
        (self.len * self.element_size) as u64
    }

    /// Writes them, little endian.
    ///
    /// # Errors
    /// If `out` cannot be written.
    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        self.write_parts(out, |_| ())
    }

    /// Writes them, big endian.
    ///
    /// # Errors
    /// If `out` cannot be written.
    pub fn write_big_endian(&self, out: &mut impl Write) -> io::Result<()> {
        let turn = |part: &mut [u8]| {
            part.chunks_exact_mut(self.element_size)
                .for_each(<[u8]>::reverse)
        };
        self.write_parts(out, turn)
    }

    fn write_parts(&self, out: &mut impl Write, last: impl Fn(&mut [u8]) + Sync) -> io::Result<()> {
        let tasks = TASKS_IN_MEMORY.min(self.len.div_ceil(NUMBERS_PER_TASK));
        let mut parts: Vec<Vec<u8>> = vec![Vec::new(); tasks];
        for start in (0..self.len).step_by(TASKS_IN_MEMORY * NUMBERS_PER_TASK) {
            parts.par_iter_mut().enumerate().for_each(|(task, part)| {
                part.clear();
                let first = (start + task * NUMBERS_PER_TASK).min(self.len);
                (self.fill)(first..self.len.min(first + NUMBERS_PER_TASK), part);
                last(part);
            });
            parts.iter().try_for_each(|part| out.write_all(part))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_in_order() {
        for len in [
            0,
            1,
            NUMBERS_PER_TASK,
            TASKS_IN_MEMORY * NUMBERS_PER_TASK + 5,
        ] {
            let numbers = LazyArray::from_fn(len, |i| 3 * i as u32);
            let mut bytes = Vec::new();
            numbers.write(&mut bytes).unwrap();
            assert_eq!(bytes.len() as u64, numbers.byte_len());
            let (numbers, _) = bytes.as_chunks();
            let at = |i: usize| u32::from_le_bytes(numbers[i]);
            assert!((0..len).all(|i| at(i) == 3 * i as u32));
        }
    }
}

//! Arrays of numbers as bytes, computed by all threads and written in order. The containers
//! [`mat`](super::mat), [`hdf5`](super::hdf5) and [`netcdf`](super::netcdf) are built on them.

use std::io::{self, Write};
use std::ops::Range;

use crate::parallel::prelude::*;

use crate::files::vtk::VtkScalar;

/// Number of values in one task.
const NUMBERS_PER_TASK: usize = 1 << 15;
/// Number of tasks whose bytes are in memory at once.
const TASKS_IN_MEMORY: usize = 16;

/// Function that appends the bytes of a range of an array.
type FillFn<'a> = Box<dyn Fn(Range<usize>, &mut Vec<u8>) + Sync + 'a>;

/// Array whose values are computed when they are written.
pub struct LazyArray<'a> {
    /// Name of the value type in VTK.
    pub vtk_type: &'static str,
    /// Number of values.
    pub len: usize,
    element_size: usize,
    fill: FillFn<'a>,
}

impl<'a> LazyArray<'a> {
    /// Creates an array of `len` values. Value `i` is `value(i)`.
    pub fn from_fn<T: VtkScalar>(len: usize, value: impl Fn(usize) -> T + Sync + 'a) -> Self {
        Self::from_fill::<T>(len, move |range, bytes| {
            range.for_each(|i| value(i).append_bytes(bytes));
        })
    }

    /// Creates an array of `len` values. `fill` appends the bytes of any range of them.
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

    /// Creates an array from values in memory.
    pub fn from_slice<T: VtkScalar>(values: &'a [T]) -> Self {
        Self::from_fn(values.len(), |i| values[i])
    }

    /// Returns the size of the array in bytes.
    pub fn byte_len(&self) -> u64 {
        (self.len * self.element_size) as u64
    }

    /// Writes the values in little-endian order.
    ///
    /// # Errors
    /// Returns an error if `out` cannot be written.
    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        self.write_parts(out, |_| ())
    }

    /// Writes the values in big-endian order.
    ///
    /// # Errors
    /// Returns an error if `out` cannot be written.
    pub fn write_big_endian(&self, out: &mut impl Write) -> io::Result<()> {
        let reverse_bytes = |chunk: &mut [u8]| {
            chunk
                .chunks_exact_mut(self.element_size)
                .for_each(<[u8]>::reverse)
        };
        self.write_parts(out, reverse_bytes)
    }

    fn write_parts(
        &self,
        out: &mut impl Write,
        transform: impl Fn(&mut [u8]) + Sync,
    ) -> io::Result<()> {
        let tasks = TASKS_IN_MEMORY.min(self.len.div_ceil(NUMBERS_PER_TASK));
        let mut chunks: Vec<Vec<u8>> = vec![Vec::new(); tasks];
        for start in (0..self.len).step_by(TASKS_IN_MEMORY * NUMBERS_PER_TASK) {
            chunks.par_iter_mut().enumerate().for_each(|(task, chunk)| {
                chunk.clear();
                let first = (start + task * NUMBERS_PER_TASK).min(self.len);
                (self.fill)(first..self.len.min(first + NUMBERS_PER_TASK), chunk);
                transform(chunk);
            });
            chunks.iter().try_for_each(|chunk| out.write_all(chunk))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_in_order() {
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
            let number = |i: usize| u32::from_le_bytes(numbers[i]);
            assert!((0..len).all(|i| number(i) == 3 * i as u32));
        }
    }
}

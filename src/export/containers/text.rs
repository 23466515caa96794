//! Numbers as text, fast: no allocation a number, lines formatted by all threads and written in
//! order.

use std::io::{self, Write};
use std::ops::Range;

use crate::parallel::prelude::*;

/// Lines in one task.
const LINES_PER_TASK: usize = 4096;
/// Tasks whose text is in memory at once.
const TASKS_IN_MEMORY: usize = 32;

/// Text that is being put together.
#[derive(Debug, Default)]
pub struct TextBuilder {
    bytes: Vec<u8>,
}

impl TextBuilder {
    /// Adds words as they are.
    #[inline]
    pub fn word(&mut self, word: &str) -> &mut Self {
        self.bytes.extend_from_slice(word.as_bytes());
        self
    }

    /// Adds a whole number.
    #[inline]
    pub fn int(&mut self, number: impl itoa::Integer) -> &mut Self {
        self.word(itoa::Buffer::new().format(number))
    }

    /// Adds a number with as few digits as bring it back exactly; infinities and NaN as `inf`, `NaN`.
    #[inline]
    pub fn real(&mut self, number: f64) -> &mut Self {
        self.word(zmij::Buffer::new().format(number))
    }

    /// Adds a number in at most `width` characters (12 or more): as [`real`](Self::real) does if that
    /// fits, else with as many digits as do.
    pub fn real_in_width(&mut self, number: f64, width: usize) -> &mut Self {
        let start = self.bytes.len();
        self.real(number);
        for decimals in (0..width).rev() {
            if self.bytes.len() - start <= width {
                break;
            }
            self.bytes.truncate(start);
            // Memory takes all that is written to it.
            let _ = write!(self.bytes, "{number:.decimals$e}");
        }
        self
    }

    /// Adds a number, a space before it.
    #[inline]
    pub fn spaced_int(&mut self, number: impl itoa::Integer) -> &mut Self {
        self.word(" ").int(number)
    }

    /// Adds a number as [`real`](Self::real) does, a space before it.
    #[inline]
    pub fn spaced_real(&mut self, number: f64) -> &mut Self {
        self.word(" ").real(number)
    }

    /// Adds coordinates, a space before each.
    #[inline]
    pub fn point(&mut self, point: [f64; 3]) -> &mut Self {
        point.iter().for_each(|&x| {
            self.spaced_real(x);
        });
        self
    }

    /// Ends the line.
    #[inline]
    pub fn end_line(&mut self) {
        self.bytes.push(b'\n');
    }
}

/// Writes `count` items, `put` adding the text of each; in order, however many threads there are.
///
/// # Errors
/// If `out` cannot be written.
pub fn write_items(
    out: &mut impl Write,
    count: usize,
    put: impl Fn(&mut TextBuilder, usize) + Sync,
) -> io::Result<()> {
    write_ranges(out, count, &|text, items| {
        items.for_each(|item| put(text, item))
    })
}

/// Writes ranges of items, in their order: `put` is given a range at a time.
fn write_ranges(
    out: &mut dyn Write,
    count: usize,
    put: &(dyn Fn(&mut TextBuilder, Range<usize>) + Sync),
) -> io::Result<()> {
    let mut texts: Vec<TextBuilder> = Vec::new();
    texts.resize_with(
        TASKS_IN_MEMORY.min(count.div_ceil(LINES_PER_TASK)),
        TextBuilder::default,
    );
    let mut start = 0;
    while start < count {
        texts.par_iter_mut().enumerate().for_each(|(task, text)| {
            text.bytes.clear();
            let first = start + task * LINES_PER_TASK;
            put(text, first..count.min(first + LINES_PER_TASK));
        });
        texts.iter().try_for_each(|t| out.write_all(&t.bytes))?;
        start += TASKS_IN_MEMORY * LINES_PER_TASK;
    }
    Ok(())
}

/// Writes numbers, several a line.
///
/// # Errors
/// If `out` cannot be written.
pub fn write_numbers(
    out: &mut impl Write,
    count: usize,
    value: impl Fn(usize) -> f64 + Sync,
) -> io::Result<()> {
    const NUMBERS_PER_LINE: usize = 5;
    write_items(out, count, |text, i| {
        text.spaced_real(value(i));
        if i % NUMBERS_PER_LINE == NUMBERS_PER_LINE - 1 || i + 1 == count {
            text.end_line();
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_numbers_are_shortened_to_the_width() {
        for number in [
            0.1,
            -5.253_295_402_101_371e-6,
            -123_456_789.123_456_78,
            -1.234_567_890_123_456_7e-123,
            612_345.678,
            -1.234_567_890_123_456_7e300,
        ] {
            let mut text = TextBuilder::default();
            text.real_in_width(number, 20);
            let text = String::from_utf8(text.bytes).unwrap();
            let read: f64 = text.parse().unwrap();
            assert!(text.len() <= 20, "{text}");
            assert!((read - number).abs() <= 1e-11 * number.abs(), "{text}");
        }
    }

    #[test]
    fn items_come_in_order_and_numbers_come_back() {
        let count = TASKS_IN_MEMORY * LINES_PER_TASK + 5;
        let value = |i: usize| (i as f64 - 1e4) / 3.0 * 1e-7;
        let mut bytes = Vec::new();
        write_items(&mut bytes, count, |text, i| {
            text.int(i).spaced_real(value(i)).end_line();
        })
        .unwrap();
        let text = String::from_utf8(bytes).unwrap();
        let mut lines = 0;
        for (i, line) in text.lines().enumerate() {
            let (at, number) = line.split_once(' ').unwrap();
            assert_eq!(at.parse(), Ok(i));
            assert_eq!(number.parse(), Ok(value(i)));
            lines += 1;
        }
        assert_eq!(lines, count);
        let mut bytes = Vec::new();
        write_numbers(&mut bytes, 7, |i| i as f64).unwrap();
        let text = String::from_utf8(bytes).unwrap();
        assert_eq!(text.lines().count(), 2);
        assert_eq!(text.split_whitespace().count(), 7);
    }
}

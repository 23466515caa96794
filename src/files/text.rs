//! Writes numbers as text, fast: without an allocation per number. All threads format lines, which
//! are written in order.

use std::io::{self, Write};
use std::ops::Range;

use crate::parallel::prelude::*;

/// Number of lines in one task.
const LINES_PER_TASK: usize = 4096;
/// Number of tasks whose text is in memory at once.
const TASKS_IN_MEMORY: usize = 32;

/// Writer of an export file.
pub(crate) type FileWriter<'a> = &'a mut io::BufWriter<std::fs::File>;
/// Result of writing a part of an export file.
pub(crate) type WriteResult = io::Result<()>;

/// Builder of text.
#[derive(Debug, Default)]
pub struct TextBuilder {
    bytes: Vec<u8>,
}

impl TextBuilder {
    /// Adds text as it is.
    #[inline]
    pub fn word(&mut self, word: &str) -> &mut Self {
        self.bytes.extend_from_slice(word.as_bytes());
        self
    }

    /// Adds an integer.
    #[inline]
    pub fn int(&mut self, number: impl itoa::Integer) -> &mut Self {
        self.word(itoa::Buffer::new().format(number))
    }

    /// Adds a number with the fewest digits that identify it exactly. Infinities and NaN are `inf`
    /// and `NaN`.
    #[inline]
    pub fn real(&mut self, number: f64) -> &mut Self {
        self.word(zmij::Buffer::new().format(number))
    }

    /// Adds a number in at most `width` characters (12 or more). It is written as by
    /// [`real`](Self::real) if that fits, otherwise with as many digits as fit.
    pub fn real_in_width(&mut self, number: f64, width: usize) -> &mut Self {
        let start = self.bytes.len();
        self.real(number);
        for decimals in (0..width).rev() {
            if self.bytes.len() - start <= width {
                break;
            }
            self.bytes.truncate(start);
            // Writing to memory does not fail.
            let _ = write!(self.bytes, "{number:.decimals$e}");
        }
        self
    }

    /// Adds a space and an integer.
    #[inline]
    pub fn spaced_int(&mut self, number: impl itoa::Integer) -> &mut Self {
        self.word(" ").int(number)
    }

    /// Adds a space and a number as [`real`](Self::real) does.
    #[inline]
    pub fn spaced_real(&mut self, number: f64) -> &mut Self {
        self.word(" ").real(number)
    }

    /// Adds coordinates, with a space before each.
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

/// Writes `count` items in order. `format_item` adds the text of an item, given its index. The
/// result does not depend on the number of threads.
///
/// # Errors
/// Returns an error if `out` cannot be written.
pub fn write_items(
    out: &mut impl Write,
    count: usize,
    format_item: impl Fn(&mut TextBuilder, usize) + Sync,
) -> io::Result<()> {
    write_ranges(out, count, &|text, items| {
        items.for_each(|item| format_item(text, item))
    })
}

/// Writes ranges of items in order. `format_range` adds the text of a range.
fn write_ranges(
    out: &mut dyn Write,
    count: usize,
    format_range: &(dyn Fn(&mut TextBuilder, Range<usize>) + Sync),
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
            format_range(text, first..count.min(first + LINES_PER_TASK));
        });
        texts.iter().try_for_each(|t| out.write_all(&t.bytes))?;
        start += TASKS_IN_MEMORY * LINES_PER_TASK;
    }
    Ok(())
}

/// Writes numbers, five per line.
///
/// # Errors
/// Returns an error if `out` cannot be written.
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
            let parsed: f64 = text.parse().unwrap();
            assert!(text.len() <= 20, "{text}");
            assert!((parsed - number).abs() <= 1e-11 * number.abs(), "{text}");
        }
    }

    #[test]
    fn items_keep_their_order_and_numbers_their_value() {
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
            let (index, number) = line.split_once(' ').unwrap();
            assert_eq!(index.parse(), Ok(i));
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

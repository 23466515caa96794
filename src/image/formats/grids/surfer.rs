//! Parsers of the grids of Surfer: text (`DSAA`), binary of version 6 (`DSBB`) and of version 7
//! (`DSRB`).
//!
//! The limits are the positions of the first and the last node. Rows go from the first y to the last,
//! each from the first x to the last. Source: "Surfer grid file formats", Golden Software.

use super::{
    HeightGrid, HeightOrder, Parsed, decimal_points, make_grid, parse_count, parse_number,
    parse_numbers,
};
use crate::image::Geometry;

/// First bytes of the grids: text, version 6, version 7.
pub(super) const MAGIC: [&[u8]; 3] = [TEXT_MAGIC, VERSION_6_MAGIC, VERSION_7_MAGIC];
pub(super) const TEXT_MAGIC: &[u8] = b"DSAA";
const VERSION_6_MAGIC: &[u8] = b"DSBB";
const VERSION_7_MAGIC: &[u8] = b"DSRB";

/// Smallest value that stands for an unknown height in text and in version 6. Files may have it
/// rounded.
const NULL: f64 = 1.70141e38 * (1.0 - 1e-6);

/// Text of the null value in files that are written.
pub(super) const NULL_TEXT: &str = "1.70141e+38";

/// Parses a grid of any of the three kinds.
pub(super) fn parse(bytes: &[u8]) -> Parsed<HeightGrid> {
    if bytes.starts_with(VERSION_7_MAGIC) {
        parse_version_7(bytes)
    } else if bytes.starts_with(VERSION_6_MAGIC) {
        parse_version_6(bytes)
    } else {
        parse_text(&String::from_utf8_lossy(bytes))
    }
}

/// Returns the heights with NaN where they are at least `null_value`.
fn without_nulls(heights: impl IntoIterator<Item = f64>, null_value: f64) -> Vec<f64> {
    let height = |z: f64| if z >= null_value { f64::NAN } else { z };
    heights.into_iter().map(height).collect()
}

fn parse_text(text: &str) -> Parsed<HeightGrid> {
    let text = decimal_points(text);
    let mut words = text.split_whitespace().skip(1);
    let dims = [
        parse_count(words.next(), "the number of columns")?,
        parse_count(words.next(), "the number of rows")?,
    ];
    let mut limits = [0.0; 4];
    for (limit, name) in limits.iter_mut().zip(["xlo", "xhi", "ylo", "yhi"]) {
        *limit = parse_number(words.next(), name)?;
    }
    // The range of the heights is not needed, and some programs write it wrong.
    for name in ["zlo", "zhi"] {
        words.next().ok_or_else(|| format!("{name} is missing"))?;
    }
    let heights = without_nulls(parse_numbers(words)?, NULL);
    make_grid(dims, limits, heights, HeightOrder::RowsUp)
}

/// A reader of little-endian numbers.
struct Fields<'a> {
    rest: &'a [u8],
}

impl<'a> Fields<'a> {
    fn bytes<const N: usize>(&mut self) -> Parsed<[u8; N]> {
        let (bytes, rest) = self
            .rest
            .split_first_chunk()
            .ok_or("its header is cut off")?;
        self.rest = rest;
        Ok(*bytes)
    }

    fn i16(&mut self) -> Parsed<i16> {
        self.bytes().map(i16::from_le_bytes)
    }

    fn i32(&mut self) -> Parsed<i32> {
        self.bytes().map(i32::from_le_bytes)
    }

    /// Returns a finite number.
    fn f64(&mut self) -> Parsed<f64> {
        let number = f64::from_le_bytes(self.bytes()?);
        if number.is_finite() {
            Ok(number)
        } else {
            Err(format!("a number of its header is {number}"))
        }
    }

    /// Returns the next `length` bytes, or all that are left.
    fn part(&mut self, length: usize) -> &'a [u8] {
        let (part, rest) = self.rest.split_at(length.min(self.rest.len()));
        self.rest = rest;
        part
    }
}

fn count(number: i64, name: &str) -> Parsed<usize> {
    let count = usize::try_from(number).ok().filter(|&count| count > 0);
    count.ok_or_else(|| format!("{name} is {number}"))
}

fn parse_version_6(bytes: &[u8]) -> Parsed<HeightGrid> {
    let mut fields = Fields { rest: &bytes[4..] };
    let columns = count(fields.i16()?.into(), "the number of columns")?;
    let rows = count(fields.i16()?.into(), "the number of rows")?;
    let mut limits = [0.0; 4];
    for limit in &mut limits {
        *limit = fields.f64()?;
    }
    // The range of the heights.
    fields.bytes::<16>()?;
    let heights = fields.rest.as_chunks().0.iter();
    let heights = heights.map(|bytes| f64::from(f32::from_le_bytes(*bytes)));
    let heights = without_nulls(heights.take(columns * rows), NULL);
    make_grid([columns, rows], limits, heights, HeightOrder::RowsUp)
}

/// Parses a grid of sections, each with an identifier of four letters and a length. Grids that are
/// broken by faults have the section `FLTI`, whose lines are left out.
fn parse_version_7(bytes: &[u8]) -> Parsed<HeightGrid> {
    let mut fields = Fields { rest: bytes };
    let mut header = None;
    loop {
        let name: [u8; 4] = fields.bytes().map_err(|_| "it has no section DATA")?;
        let length = count(fields.i32()?.max(0).into(), "a length").unwrap_or(0);
        let mut section = Fields {
            rest: fields.part(length),
        };
        match &name {
            b"GRID" => {
                let rows = count(section.i32()?.into(), "the number of rows")?;
                let columns = count(section.i32()?.into(), "the number of columns")?;
                let mut values = [0.0; 8];
                for value in &mut values {
                    *value = section.f64()?;
                }
                header = Some(([columns, rows], values));
            }
            b"DATA" => {
                let (dims, [x, y, dx, dy, _, _, _, null_value]) =
                    header.ok_or("it has no section GRID")?;
                if !(dx > 0.0 && dy > 0.0) {
                    return Err(format!("its nodes are {dx} and {dy} apart"));
                }
                let heights = section.rest.as_chunks().0.iter();
                let heights = heights.map(|bytes| f64::from_le_bytes(*bytes));
                return Ok(HeightGrid {
                    dims,
                    geometry: Geometry::with_spacing([x, y], [dx, dy]),
                    heights: without_nulls(heights, null_value),
                    order: HeightOrder::RowsUp,
                    notes: Vec::new(),
                });
            }
            _ => {}
        }
    }
}

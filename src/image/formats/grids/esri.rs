//! Parser of ESRI ASCII grids: lines `key value` in any order and case, and rows of heights from the
//! north.
//!
//! `xllcorner` and `yllcorner` are the corner of a cell whose middle is the first node; `xllcenter` and
//! `yllcenter` are this middle. GDAL writes `dx` and `dy` in place of `cellsize` for cells that are not
//! square.

use super::{
    HeightGrid, HeightOrder, Parsed, decimal_points, parse_count, parse_number, parse_word,
};
use crate::image::Geometry;

/// Keys of the header, in lower case.
const KEYS: [&str; 12] = [
    "ncols",
    "nrows",
    "xllcorner",
    "yllcorner",
    "xllcenter",
    "yllcenter",
    "cellsize",
    "dx",
    "dy",
    "nodata_value",
    "nodata",
    "nodatavalue",
];

/// Null value of a grid whose header has none.
const DEFAULT_NULL: f64 = -9999.0;

/// Largest number of lines in which the header's sizes are looked for.
const MAX_HEADER_LINES: usize = 12;

/// Returns `true` if a text begins with the header of an ESRI ASCII grid.
pub(super) fn looks_like(text: &str) -> bool {
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
    let mut keys = Vec::new();
    for line in lines.take(MAX_HEADER_LINES) {
        let mut words = line.split_whitespace();
        let key = words.next().map(str::to_ascii_lowercase);
        let Some(key) = key.filter(|key| KEYS.contains(&key.as_str())) else {
            break;
        };
        if words.next().is_none() || words.next().is_some() {
            break;
        }
        keys.push(key);
    }
    ["ncols", "nrows"]
        .iter()
        .all(|key| keys.iter().any(|found| found == key))
}

/// Parses an ESRI ASCII grid.
pub(super) fn parse(text: &str) -> Parsed<HeightGrid> {
    let text = decimal_points(text);
    let mut fields: Vec<(String, &str)> = Vec::new();
    let mut heights = Vec::new();
    for line in text.lines() {
        let mut words = line.split_whitespace().peekable();
        let is_key = |word: &&str| {
            word.starts_with(|c: char| c.is_ascii_alphabetic()) && parse_height(word).is_err()
        };
        if let Some(key) = words.next_if(is_key) {
            if !heights.is_empty() {
                return Err(format!("'{key}' stands between its heights"));
            }
            fields.push((key.to_ascii_lowercase(), words.next().unwrap_or("")));
        } else {
            for word in words {
                heights.push(parse_height(word)?);
            }
        }
    }
    let value = |keys: &[&str]| {
        let field = fields.iter().find(|(key, _)| keys.contains(&key.as_str()));
        field.map(|(_, value)| *value)
    };
    let dims = [
        parse_count(value(&["ncols"]), "ncols")?,
        parse_count(value(&["nrows"]), "nrows")?,
    ];
    let (mut origin, mut step) = ([0.0; 2], [0.0; 2]);
    for (k, [size, centre, corner]) in [
        ["dx", "xllcenter", "xllcorner"],
        ["dy", "yllcenter", "yllcorner"],
    ]
    .into_iter()
    .enumerate()
    {
        step[k] = parse_number(value(&[size]).or(value(&["cellsize"])), "cellsize")?;
        if step[k] <= 0.0 {
            return Err(format!("its cells have the size {}", step[k]));
        }
        origin[k] = match value(&[centre]) {
            Some(word) => parse_number(Some(word), centre)?,
            None => parse_number(value(&[corner]), corner)? + 0.5 * step[k],
        };
    }
    let null_value = match value(&["nodata_value", "nodata", "nodatavalue"]) {
        Some(word) => parse_height(word)?,
        None => DEFAULT_NULL,
    };
    for z in &mut heights {
        // The value is exact but for single precision.
        if *z as f32 == null_value as f32 {
            *z = f64::NAN;
        }
    }
    Ok(HeightGrid {
        dims,
        geometry: Geometry::with_spacing(origin, step),
        heights,
        order: HeightOrder::RowsDown,
        notes: Vec::new(),
    })
}

/// Parses a height, which may be `nan`, as C writes it, too.
fn parse_height(word: &str) -> Parsed<f64> {
    let digits = word.trim_start_matches(['-', '+']);
    if digits.eq_ignore_ascii_case("nan") || digits.starts_with("1.#") {
        return Ok(f64::NAN);
    }
    parse_word(word).ok_or_else(|| format!("a height is '{word}'"))
}

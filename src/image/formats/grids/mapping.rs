//! Parsers of the text grids of mapping programs: IRAP classic (ASCII), ZMAP+ and CPS-3.
//!
//! IRAP has rows of increasing x, from the lowest y upwards, and may be rotated. ZMAP+ and CPS-3 have
//! columns from the last y to the first, from the first x on.

use super::{
    CPS3_NULL, HeightGrid, HeightOrder, IRAP_NULL, Parsed, make_grid, parse_count, parse_number,
    parse_numbers,
};
use crate::image::Geometry;

/// Heights that are unknown, with NaN in place of the null value, which may be rounded.
fn without_null(mut heights: Vec<f64>, null_value: f64) -> Vec<f64> {
    for z in &mut heights {
        if (*z - null_value).abs() <= 1e-6 * null_value.abs() {
            *z = f64::NAN;
        }
    }
    heights
}

/// Parses an IRAP classic grid.
pub(super) fn parse_irap(text: &str) -> Parsed<HeightGrid> {
    let mut words = text.split_whitespace().skip(1);
    let ny = parse_count(words.next(), "the number of rows")?;
    let mut numbers = |name: &str| parse_number(words.next(), name);
    let step = [numbers("the step along x")?, numbers("the step along y")?];
    for name in [
        "the smallest x",
        "the largest x",
        "the smallest y",
        "the largest y",
    ] {
        numbers(name)?;
    }
    let nx = parse_count(words.next(), "the number of columns")?;
    let mut numbers = |name: &str| parse_number(words.next(), name);
    let rotation = numbers("the rotation")?.to_radians();
    let origin = [
        numbers("the x of the origin")?,
        numbers("the y of the origin")?,
    ];
    for _ in 0..7 {
        numbers("a number of the fourth line")?;
    }
    let mut geometry = Geometry::<2> {
        origin,
        ..Geometry::default()
    };
    let (sin, cos) = rotation.sin_cos();
    geometry.axes = if rotation == 0.0 {
        [[step[0], 0.0], [0.0, step[1]]]
    } else {
        [
            [step[0] * cos, step[0] * sin],
            [-step[1] * sin, step[1] * cos],
        ]
    };
    let null_value = parse_number(Some(IRAP_NULL), "the null value")?;
    Ok(HeightGrid {
        dims: [nx, ny],
        geometry,
        heights: without_null(parse_numbers(words)?, null_value),
        order: HeightOrder::RowsUp,
        notes: Vec::new(),
    })
}

/// Parses a ZMAP+ grid.
pub(super) fn parse_zmap(text: &str) -> Parsed<HeightGrid> {
    let is_content = |line: &&str| !line.is_empty() && !line.starts_with('!');
    let mut lines = text.lines().map(str::trim).filter(is_content).skip(1);
    let mut fields = || -> Parsed<Vec<String>> {
        let line = lines.next().ok_or("its header is cut off")?;
        Ok(line
            .split(',')
            .map(|field| field.trim().to_string())
            .collect())
    };
    let [widths, extent] = [fields()?, fields()?];
    let field = |k: usize| extent.get(k).map(String::as_str);
    // The null value may also stand in the third field instead of the second.
    let null_value = match widths.get(1).map(String::as_str) {
        Some("") | None => parse_number(widths.get(2).map(String::as_str), "the null value")?,
        word => parse_number(word, "the null value")?,
    };
    let (ny, nx) = (
        parse_count(field(0), "the number of rows")?,
        parse_count(field(1), "the number of columns")?,
    );
    let mut limits = [0.0; 4];
    for (k, limit) in limits.iter_mut().enumerate() {
        *limit = parse_number(field(2 + k), ["xmin", "xmax", "ymin", "ymax"][k])?;
    }
    if !lines.by_ref().any(|line| line.starts_with('@')) {
        return Err("no @ ends its header".into());
    }
    let heights = parse_numbers(lines.flat_map(str::split_whitespace))?;
    make_grid(
        [nx, ny],
        limits,
        without_null(heights, null_value),
        HeightOrder::ColumnsDown,
    )
}

/// Parses a CPS-3 grid.
pub(super) fn parse_cps3(text: &str) -> Parsed<HeightGrid> {
    let mut null_value = parse_number(Some(CPS3_NULL), "the null value")?;
    let (mut limits, mut dims) = (None, None);
    let mut heights = Vec::new();
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[0] {
            "FSASCI" => null_value = parse_number(words.last().copied(), "the null value")?,
            "FSLIMI" => {
                let mut values = [0.0; 4];
                for (k, limit) in values.iter_mut().enumerate() {
                    *limit = parse_number(words.get(k + 1).copied(), "a limit")?;
                }
                limits = Some(values);
            }
            "FSNROW" => {
                let count = |k: usize, name| parse_count(words.get(k).copied(), name);
                dims = Some([
                    count(2, "the number of columns")?,
                    count(1, "the number of rows")?,
                ]);
            }
            first
                if first.starts_with("FS") || first.starts_with("->") || first.starts_with('!') => {
            }
            _ => heights.extend(parse_numbers(words.into_iter())?),
        }
    }
    let limits = limits.ok_or("FSLIMI is missing")?;
    let dims = dims.ok_or("FSNROW is missing")?;
    make_grid(
        dims,
        limits,
        without_null(heights, null_value),
        HeightOrder::ColumnsDown,
    )
}

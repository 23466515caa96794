//! Grids of heights in the formats of mapping programs: IRAP classic (ASCII), ZMAP+ and CPS-3. They
//! are read and written as 2-D images of z; samples are NaN where z is unknown.
//!
//! All three are text: a header, then one height per node. IRAP has rows of increasing x, from the
//! lowest y upwards, and may be rotated. ZMAP+ and CPS-3 have columns of decreasing y, from the
//! lowest x on.

use std::fmt::Write as _;
use std::io::{Read, Write};
use std::path::Path;

use super::{ImageFormat, LoadedImage, samples};
use crate::error::{Error, Result, cause, io_error};
use crate::files;
use crate::files::atomic_write;
use crate::geometry::{dot, norm};
use crate::image::{Geometry, Image};

/// Null values: text that stands for an unknown height, in IRAP files, and in the ZMAP+ and CPS-3
/// files that are written here. Readers of ZMAP+ compare in single precision, which cannot
/// represent 1e30 exactly.
const IRAP_NULL: &str = "9999900.0";
const ZMAP_NULL: &str = "-99999.0";
const CPS3_NULL: &str = "1.0E+30";

/// Numbers per line in written files.
const NUMBERS_PER_LINE: usize = 5;

/// Returns the grid format of a text that begins with `head`, or `None` if it is not a grid.
pub(super) fn recognise(head: &[u8]) -> Option<ImageFormat> {
    let text = std::str::from_utf8(&head[..head.len().min(2000)]).ok()?;
    let first = text.split_whitespace().next()?;
    if first == "-996" {
        return Some(ImageFormat::Irap);
    }
    if first == "FSASCI" {
        return Some(ImageFormat::Cps3);
    }
    let mut lines = text.lines().map(str::trim);
    let header = lines.find(|line| !line.is_empty() && !line.starts_with('!'))?;
    let is_grid = header.starts_with('@') && header.to_uppercase().contains("GRID");
    is_grid.then_some(ImageFormat::Zmap)
}

/// A grid as stored in its file.
struct HeightGrid {
    /// Number of nodes along both axes.
    dims: [usize; 2],
    geometry: Geometry<2>,
    /// Value that stands for an unknown height.
    null_value: f64,
    /// Numbers after the header.
    heights: Vec<f64>,
    /// `true` if the heights are stored in columns from the highest y down, `false` if in rows from
    /// the lowest y up.
    is_column_major: bool,
}

/// Reads a grid.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be read or is damaged.
pub(super) fn read(path: &Path, format: ImageFormat) -> Result<LoadedImage<2>> {
    let mut bytes = Vec::new();
    let mut file = files::open(path, "give the file of a grid")?;
    file.read_to_end(&mut bytes)
        .map_err(|e| io_error(path, "read", e))?;
    let text = String::from_utf8_lossy(&bytes);
    let refuse = |problem: String| {
        Error::Io(cause(
            path.display(),
            format!("is a damaged {format} grid: {problem}"),
            crate::files::REWRITE_DAMAGED,
        ))
    };
    let grid = match format {
        ImageFormat::Irap => parse_irap(&text),
        ImageFormat::Zmap => parse_zmap(&text),
        _ => parse_cps3(&text),
    };
    let grid = grid.map_err(refuse)?;
    let [nx, ny] = grid.dims;
    let count = nx.checked_mul(ny).filter(|&count| count > 0);
    if count != Some(grid.heights.len()) {
        let height_count = grid.heights.len();
        return Err(refuse(format!(
            "it has {height_count} heights, but {nx} x {ny} nodes"
        )));
    }
    let mut samples = samples::allocate(path, nx * ny)?;
    for (i, &z) in grid.heights.iter().enumerate() {
        let index = if grid.is_column_major {
            (ny - 1 - i % ny) * nx + i / ny
        } else {
            i
        };
        let missing = (z - grid.null_value).abs() <= 1e-6 * grid.null_value.abs();
        samples[index] = if missing { f32::NAN } else { z as f32 };
    }
    Ok(LoadedImage {
        image: Image::new(grid.dims, samples, grid.geometry),
        format,
        encoding: "text".into(),
        notes: Vec::new(),
        survey: None,
        line_numbers: None,
    })
}

/// Parses a number. The error names the field if it is missing or not a finite number.
fn parse_number(word: Option<&str>, name: &str) -> std::result::Result<f64, String> {
    let word = word.ok_or_else(|| format!("{name} is missing"))?;
    let number = word.parse::<f64>().ok().filter(|number| number.is_finite());
    number.ok_or_else(|| format!("{name} is '{word}'"))
}

/// Parses a number of nodes.
fn parse_count(word: Option<&str>, name: &str) -> std::result::Result<usize, String> {
    let number = parse_number(word, name)?;
    if number.fract() == 0.0 && (1.0..1e9).contains(&number) {
        Ok(number as usize)
    } else {
        Err(format!("{name} is {number}"))
    }
}

/// Parses all remaining words as heights.
fn parse_numbers<'a>(
    words: impl Iterator<Item = &'a str>,
) -> std::result::Result<Vec<f64>, String> {
    words
        .map(|word| parse_number(Some(word), "a height"))
        .collect()
}

fn parse_irap(text: &str) -> std::result::Result<HeightGrid, String> {
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
    Ok(HeightGrid {
        dims: [nx, ny],
        geometry,
        null_value: parse_number(Some(IRAP_NULL), "the null value")?,
        heights: parse_numbers(words)?,
        is_column_major: false,
    })
}

/// Returns a grid whose nodes are evenly spaced between these limits.
fn make_grid(
    [nx, ny]: [usize; 2],
    [x0, x1, y0, y1]: [f64; 4],
    null_value: f64,
    heights: Vec<f64>,
) -> std::result::Result<HeightGrid, String> {
    let step = |first: f64, last: f64, count: usize| match count {
        1 => 1.0,
        _ => (last - first) / (count - 1) as f64,
    };
    let spacing = [step(x0, x1, nx), step(y0, y1, ny)];
    if !spacing.iter().all(|step| *step > 0.0) {
        return Err(format!("x from {x0} to {x1}, y from {y0} to {y1}"));
    }
    Ok(HeightGrid {
        dims: [nx, ny],
        geometry: Geometry::with_spacing([x0, y0], spacing),
        null_value,
        heights,
        is_column_major: true,
    })
}

fn parse_zmap(text: &str) -> std::result::Result<HeightGrid, String> {
    let is_content = |line: &&str| !line.is_empty() && !line.starts_with('!');
    let mut lines = text.lines().map(str::trim).filter(is_content).skip(1);
    let mut fields = || -> std::result::Result<Vec<String>, String> {
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
    make_grid([nx, ny], limits, null_value, heights)
}

fn parse_cps3(text: &str) -> std::result::Result<HeightGrid, String> {
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
    make_grid(dims, limits, null_value, heights)
}

/// Writes heights as a grid.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be written, or if grids of the format cannot have
/// the geometry of the image.
pub(super) fn write<const D: usize>(
    path: &Path,
    image: &Image<D>,
    format: ImageFormat,
) -> Result<()> {
    let (dims, geometry) = (image.dims(), &image.geometry);
    let [a, b] = [0, 1].map(|k| std::array::from_fn::<f64, 2, _>(|c| geometry.axes[k][c]));
    let step = [norm(a), norm(b)];
    let is_orthogonal = dot(a, b).abs() <= 1e-9 * step[0] * step[1] && a[0] * b[1] > a[1] * b[0];
    let rotation = a[1].atan2(a[0]).to_degrees();
    let is_rotated = rotation.abs() > 1e-9;
    if !is_orthogonal || (is_rotated && format != ImageFormat::Irap) {
        let problem = if is_orthogonal {
            format!(
                "a {format} grid cannot be rotated, but this image is rotated by {rotation:.2} degrees"
            )
        } else {
            "its axes are not perpendicular and right-handed, as those of a grid must be"
                .to_string()
        };
        let remedy = if is_orthogonal {
            "write it as .irap"
        } else {
            "write it as .vti or .npy"
        };
        return Err(Error::Io(cause(path.display(), problem, remedy)));
    }
    let (nx, ny) = (dims[0], dims[1]);
    let [x0, y0] = [0, 1].map(|c| geometry.origin[c]);
    let last = |n: usize, step: f64| (n - 1) as f64 * step;
    let (x1, y1) = (x0 + last(nx, step[0]), y0 + last(ny, step[1]));
    let samples = image.as_slice();
    let mut header = String::new();
    // Writing to a String cannot fail.
    let null_text = match format {
        ImageFormat::Irap => {
            let _ = write!(
                header,
                "-996 {ny} {} {}\n{x0} {x1} {y0} {y1}\n{nx} {rotation} {x0} {y0}\n0 0 0 0 0 0 0\n",
                step[0], step[1]
            );
            IRAP_NULL
        }
        ImageFormat::Zmap => {
            let _ = write!(
                header,
                "! written by atomesh\n@GRID HEADER, GRID, {NUMBERS_PER_LINE}\n20, {ZMAP_NULL}, , 4, 1\n\
                 {ny}, {nx}, {x0}, {x1}, {y0}, {y1}\n0.0, 0.0, 0.0\n@\n"
            );
            ZMAP_NULL
        }
        _ => {
            let stats = image.stats();
            let _ = write!(
                header,
                "FSASCI 0 1 \"Computed\" 0 {CPS3_NULL}\nFSATTR 0 0\n\
                 FSLIMI {x0} {x1} {y0} {y1} {} {}\nFSNROW {ny} {nx}\nFSXINC {} {}\n",
                stats.min, stats.max, step[0], step[1]
            );
            CPS3_NULL
        }
    };
    let line = if format == ImageFormat::Irap { nx } else { ny };
    atomic_write(path, |out| {
        out.write_all(header.as_bytes())?;
        for i in 0..nx * ny {
            let index = match format {
                ImageFormat::Irap => i,
                _ => (ny - 1 - i % ny) * nx + i / ny,
            };
            let is_line_end = (i % line + 1) % NUMBERS_PER_LINE == 0 || i % line + 1 == line;
            let separator = if is_line_end { "\n" } else { " " };
            match samples[index] {
                z if z.is_finite() => write!(out, "{z}{separator}")?,
                _ => write!(out, "{null_text}{separator}")?,
            }
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::formats::{self, AnyImage, ReadOptions};

    fn height_image(dims: [usize; 2], geometry: Geometry<2>) -> Image<2> {
        let value = |i: usize| match i {
            7 => f32::NAN,
            i => -2500.25 + 0.125 * i as f32,
        };
        Image::new(dims, (0..dims[0] * dims[1]).map(value).collect(), geometry)
    }

    fn read_back(path: &Path) -> Image<2> {
        match formats::read_any(path, &ReadOptions::default()).unwrap() {
            AnyImage::Plane(loaded) => loaded.image,
            AnyImage::Space(_) => panic!("a grid is no volume"),
        }
    }

    #[test]
    fn grids_are_read_back_as_written() {
        let folder = tempfile::tempdir().unwrap();
        let straight = Geometry::with_spacing([605_000.5, 6_070_000.0], [25.0, 12.5]);
        let image = height_image([7, 4], straight.clone());
        for ending in ["irap", "zmap", "cps3"] {
            let path = folder.path().join(format!("top.{ending}"));
            formats::write(&path, &image).unwrap();
            let restored = read_back(&path);
            assert_eq!(restored.geometry, straight, "{ending}");
            let pairs = restored.as_slice().iter().zip(image.as_slice());
            for (value, expected) in pairs {
                assert!(
                    value == expected || value.is_nan() && expected.is_nan(),
                    "{ending}"
                );
            }
            assert_eq!(restored.as_slice().iter().filter(|z| z.is_nan()).count(), 1);
        }
        // Only IRAP supports rotated grids.
        let (s, c) = 30f64.to_radians().sin_cos();
        let mut turned = straight;
        turned.axes = [[25.0 * c, 25.0 * s], [-12.5 * s, 12.5 * c]];
        let image = height_image([7, 4], turned.clone());
        let path = folder.path().join("turned.irap");
        formats::write(&path, &image).unwrap();
        for (axis, expected) in read_back(&path).geometry.axes.iter().zip(turned.axes) {
            assert!((axis[0] - expected[0]).abs() < 1e-9 && (axis[1] - expected[1]).abs() < 1e-9);
        }
        let error = formats::write(&folder.path().join("turned.zmap"), &image).unwrap_err();
        assert!(error.to_string().contains("cannot be rotated"), "{error}");
    }

    #[test]
    fn grids_of_other_programs_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("grid");
        let texts = [
            // Two rows of three nodes; the null value is given in the header.
            "!  made by hand\n!\n@top HEADER, GRID, 5\n15, -99999.0, , 4, 1\n2, 3, 100, 120, 50, 55,\n\
             0.0, 0.0, 0.0\n@\n 4.0 1.0 5.0 2.0 -99999.0\n 3.0\n",
            "FSASCI 0 1 \"Computed\" 0 1E+030\r\nFSATTR 0 0\r\nFSLIMI 100 120 50 55 1 6\r\nFSNROW 2 3\r\n\
             FSXINC 10 5\r\n->MSMODL: Top\r\n4.0 1.0 5.0 2.0 1E+030\r\n3.0\r\n",
            "-996 2 10.0 5.0\n100 120 50 55\n3 0.0 100 50\n0 0 0 0 0 0 0\n1 2 3 4 5 9999900.0000\n",
        ];
        for text in texts {
            std::fs::write(&path, text).unwrap();
            let image = read_back(&path);
            assert_eq!(image.dims(), [3, 2]);
            assert_eq!(image.as_slice()[..5], [1.0, 2.0, 3.0, 4.0, 5.0]);
            assert!(image.as_slice()[5].is_nan());
            assert_eq!(
                image.geometry,
                Geometry::with_spacing([100.0, 50.0], [10.0, 5.0])
            );
            for cut in [text.len() - 16, text.len() / 2, 30] {
                std::fs::write(&path, &text[..cut]).unwrap();
                let error = formats::read_any(&path, &ReadOptions::default()).unwrap_err();
                assert!(!error.to_string().is_empty());
            }
        }
    }
}

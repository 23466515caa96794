//! Grids of heights in the formats of mapping programs. They are read and written as 2-D images of z;
//! samples are NaN where z is unknown.
//!
//! - `mapping`: IRAP classic (ASCII), ZMAP+ and CPS-3
//! - `esri`: ESRI ASCII grids
//! - `surfer`: grids of Surfer, as text and binary
//! - `write`: writes the text formats

mod esri;
mod mapping;
mod surfer;
mod write;

use std::borrow::Cow;
use std::io::Read;
use std::path::Path;

use super::{ImageFormat, LoadedImage, samples};
use crate::error::{Error, Result, cause, io_error};
use crate::files;
use crate::image::{Geometry, Image};

pub(crate) use write::{GRID_EXTENSIONS, displacement_note};
pub(super) use write::{GridFormat, write};

/// Null values: text that stands for an unknown height, in IRAP files, and in CPS-3 files without a
/// value of their own.
const IRAP_NULL: &str = "9999900.0";
const CPS3_NULL: &str = "1.0E+30";

/// Result of a parser. The error is the problem with the file.
type Parsed<T> = std::result::Result<T, String>;

/// Returns the grid format of a file that begins with `head`, or `None` if it is not a grid.
pub(super) fn recognise(head: &[u8]) -> Option<ImageFormat> {
    if surfer::MAGIC.iter().any(|magic| head.starts_with(magic)) {
        return Some(ImageFormat::Surfer);
    }
    let head = head.strip_prefix(UTF8_MARK).unwrap_or(head);
    // The cut may lie within a character.
    let text = match std::str::from_utf8(&head[..head.len().min(2000)]) {
        Ok(text) => text,
        Err(error) => std::str::from_utf8(&head[..error.valid_up_to()]).ok()?,
    };
    let first = text.split_whitespace().next()?;
    if first == "-996" {
        return Some(ImageFormat::Irap);
    }
    if first == "FSASCI" {
        return Some(ImageFormat::Cps3);
    }
    if esri::looks_like(text) {
        return Some(ImageFormat::Esri);
    }
    if first.as_bytes() == surfer::TEXT_MAGIC {
        return Some(ImageFormat::Surfer);
    }
    let mut lines = text.lines().map(str::trim);
    let header = lines.find(|line| !line.is_empty() && !line.starts_with('!'))?;
    let is_grid = header.starts_with('@') && header.to_uppercase().contains("GRID");
    is_grid.then_some(ImageFormat::Zmap)
}

/// First bytes of a text in UTF-8 that has a byte order mark.
const UTF8_MARK: &[u8] = b"\xef\xbb\xbf";

/// Order of the heights in a file. `Up` is from the first y of the header to the last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum HeightOrder {
    /// Rows of increasing x, from the first y on.
    RowsUp,
    /// Rows of increasing x, from the last y on.
    RowsDown,
    /// Columns, each from the last y to the first.
    ColumnsDown,
}

impl HeightOrder {
    /// Returns the column and the row of the height at `index` in the file.
    fn node(self, index: usize, [nx, ny]: [usize; 2]) -> [usize; 2] {
        match self {
            Self::RowsUp => [index % nx, index / nx],
            Self::RowsDown => [index % nx, ny - 1 - index / nx],
            Self::ColumnsDown => [index / ny, ny - 1 - index % ny],
        }
    }
}

/// A grid as stored in its file.
struct HeightGrid {
    /// Number of nodes along both axes.
    dims: [usize; 2],
    geometry: Geometry<2>,
    /// Numbers after the header; NaN if unknown.
    heights: Vec<f64>,
    order: HeightOrder,
    /// Assumptions.
    notes: Vec<String>,
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
    let bytes = bytes.strip_prefix(UTF8_MARK).unwrap_or(&bytes);
    let text = || String::from_utf8_lossy(bytes);
    let refuse = |problem: String| {
        Error::Io(cause(
            path.display(),
            format!("is a damaged {format} grid: {problem}"),
            crate::files::REWRITE_DAMAGED,
        ))
    };
    let grid = match format {
        ImageFormat::Irap => mapping::parse_irap(&text()),
        ImageFormat::Zmap => mapping::parse_zmap(&text()),
        ImageFormat::Esri => esri::parse(&text()),
        ImageFormat::Surfer => surfer::parse(bytes.trim_ascii_start()),
        _ => mapping::parse_cps3(&text()),
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
    for (index, &z) in grid.heights.iter().enumerate() {
        let [i, j] = grid.order.node(index, grid.dims);
        samples[j * nx + i] = z as f32;
    }
    Ok(LoadedImage {
        image: Image::new(grid.dims, samples, grid.geometry),
        format,
        encoding: if bytes.is_ascii() { "text" } else { "binary" }.into(),
        notes: grid.notes,
        survey: None,
        line_numbers: None,
    })
}

/// Parses a finite number, with the letter of an exponent of Fortran, too.
fn parse_word(word: &str) -> Option<f64> {
    let number = word.parse::<f64>().ok();
    let number = number.or_else(|| word.replace(['d', 'D'], "e").parse().ok());
    number.filter(|number| number.is_finite())
}

/// Parses a number. The error names the field if it is missing or not a finite number.
fn parse_number(word: Option<&str>, name: &str) -> Parsed<f64> {
    let word = word.ok_or_else(|| format!("{name} is missing"))?;
    parse_word(word).ok_or_else(|| format!("{name} is '{word}'"))
}

/// Parses a number of nodes.
fn parse_count(word: Option<&str>, name: &str) -> Parsed<usize> {
    let number = parse_number(word, name)?;
    if number.fract() == 0.0 && (1.0..1e9).contains(&number) {
        Ok(number as usize)
    } else {
        Err(format!("{name} is {number}"))
    }
}

/// Parses all remaining words as heights.
fn parse_numbers<'a>(words: impl Iterator<Item = &'a str>) -> Parsed<Vec<f64>> {
    words
        .map(|word| parse_number(Some(word), "a height"))
        .collect()
}

/// Returns a text in which blanks separate numbers, with decimal points in place of commas. Programs
/// of some countries write commas.
fn decimal_points(text: &str) -> Cow<'_, str> {
    if text.contains(',') && !text.contains('.') {
        text.replace(',', ".").into()
    } else {
        text.into()
    }
}

/// Returns a grid whose nodes are evenly spaced between these limits: the first and the last x, the
/// first and the last y.
fn make_grid(
    [nx, ny]: [usize; 2],
    [x0, x1, y0, y1]: [f64; 4],
    mut heights: Vec<f64>,
    order: HeightOrder,
) -> Parsed<HeightGrid> {
    let limits = [[x0, x1], [y0, y1]];
    let (mut origin, mut spacing) = ([0.0; 2], [1.0; 2]);
    let mut notes = Vec::new();
    for (k, count) in [nx, ny].into_iter().enumerate() {
        let [first, last] = limits[k];
        origin[k] = first.min(last);
        if count > 1 {
            spacing[k] = (last - first).abs() / (count - 1) as f64;
        }
        if spacing[k] == 0.0 || !spacing[k].is_finite() {
            return Err(format!("x from {x0} to {x1}, y from {y0} to {y1}"));
        }
        if first > last && count > 1 {
            let axis = ["x", "y"][k];
            notes.push(format!(
                "the header has {axis} from {first} to {last}: the heights are read in this direction"
            ));
        }
    }
    if heights.len() == nx.saturating_mul(ny) && (x0 > x1 || y0 > y1) {
        let stored = heights.clone();
        for (index, z) in stored.into_iter().enumerate() {
            let [i, j] = order.node(index, [nx, ny]);
            let i = if x0 > x1 { nx - 1 - i } else { i };
            let j = if y0 > y1 { ny - 1 - j } else { j };
            heights[j * nx + i] = z;
        }
        return Ok(HeightGrid {
            dims: [nx, ny],
            geometry: Geometry::with_spacing(origin, spacing),
            heights,
            order: HeightOrder::RowsUp,
            notes,
        });
    }
    Ok(HeightGrid {
        dims: [nx, ny],
        geometry: Geometry::with_spacing(origin, spacing),
        heights,
        order,
        notes,
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
        for ending in GRID_EXTENSIONS {
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
        for ending in ["zmap", "cps3", "grd", "asc"] {
            let path = folder.path().join(format!("turned.{ending}"));
            let error = formats::write(&path, &image).unwrap_err().to_string();
            assert!(error.contains("cannot be rotated"), "{error}");
            assert!(error.contains("write it as .irap"), "{error}");
        }
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
            "DSAA\n3 2\n100 120\n50 55\n1 6\n1.0 2.0\n3.0\n\n4.0 5.0 1.70141e+038\n",
            // The corner of a cell; its middle; keys in any order and case, a byte order mark.
            "ncols 3\nnrows 2\nxllcorner 95\nyllcorner 47.5\ndx 10\ndy 5\nNODATA_value -9999\n4 5 -9999\n1 2 3\n",
            "\u{feff}YLLCENTER 50\r\nNROWS 2\r\nNODATA_VALUE nan\r\nDX 10\r\nDY 5\r\nXLLCENTER 100\r\nNCOLS 3\r\n4 5 NaN\r\n1 2 3\r\n",
            // Decimal commas, and the null value that counts if the header has none.
            "ncols 3\nnrows 2\nxllcorner 95,0\nyllcenter 50\ndx 10\ndy 5,0\n4 5,0 -9999\n1 2\n3,0\n",
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

    #[test]
    fn binary_grids_of_surfer_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("grid.grd");
        let numbers =
            |numbers: &[f64]| -> Vec<u8> { numbers.iter().flat_map(|x| x.to_le_bytes()).collect() };
        let heights = [1.0, 2.0, 3.0, 4.0, 5.0, 1.70141e38];
        let single: Vec<u8> = heights
            .iter()
            .flat_map(|&z| (z as f32).to_le_bytes())
            .collect();
        let limits = numbers(&[100.0, 120.0, 50.0, 55.0, 1.0, 6.0]);
        let version_6 = [b"DSBB\x03\0\x02\0", &limits[..], &single].concat();
        let grid = numbers(&[100.0, 50.0, 10.0, 5.0, 1.0, 6.0, 0.0, 1.70141e38]);
        let version_7 = [
            b"DSRB\x04\0\0\0\x01\0\0\0GRID\x48\0\0\0\x02\0\0\0\x03\0\0\0",
            &grid[..],
            b"DATA\x30\0\0\0",
            &numbers(&heights),
        ];
        let version_7 = version_7.concat();
        for bytes in [version_6, version_7] {
            std::fs::write(&path, &bytes).unwrap();
            let image = read_back(&path);
            assert_eq!(image.dims(), [3, 2]);
            assert_eq!(image.as_slice()[..5], [1.0, 2.0, 3.0, 4.0, 5.0]);
            assert!(image.as_slice()[5].is_nan());
            let expected = Geometry::with_spacing([100.0, 50.0], [10.0, 5.0]);
            assert_eq!(image.geometry, expected);
            for cut in (4..bytes.len()).step_by(7) {
                std::fs::write(&path, &bytes[..cut]).unwrap();
                let error = formats::read_any(&path, &ReadOptions::default()).unwrap_err();
                assert!(
                    error
                        .to_string()
                        .contains("grid.grd: is a damaged Surfer grid"),
                    "{error}"
                );
            }
        }
    }

    #[test]
    fn a_header_with_the_minimum_above_the_maximum_gives_the_direction_of_the_heights() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("grid");
        for text in [
            "DSAA\n3 2\n120 100\n55 50\n1 6\n6 5 4\n3 2 1\n",
            "! xtgeo\n@ GRIDFILE, GRID, 5\n20, -99999.0, , 8, 1\n2, 3, 120, 100, 55, 50\n0, 0, 0\n@\n3 6 2 5 1 4\n",
        ] {
            std::fs::write(&path, text).unwrap();
            let AnyImage::Plane(loaded) =
                formats::read_any(&path, &ReadOptions::default()).unwrap()
            else {
                panic!("a grid is no volume");
            };
            assert_eq!(
                loaded.image.as_slice(),
                [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
                "{text}"
            );
            let expected = Geometry::with_spacing([100.0, 50.0], [10.0, 5.0]);
            assert_eq!(loaded.image.geometry, expected);
            assert!(
                loaded.notes[0].contains("x from 120 to 100"),
                "{:?}",
                loaded.notes
            );
        }
    }

    /// Returns the position and the height of each node with a height, sorted.
    fn sorted_nodes(image: &Image<2>) -> Vec<[f64; 3]> {
        let nx = image.dims()[0];
        let node = |(i, &z): (usize, &f32)| {
            let [x, y] = image
                .geometry
                .to_physical([(i % nx) as f64, (i / nx) as f64]);
            [x, y, f64::from(z)]
        };
        let mut nodes: Vec<[f64; 3]> = image.as_slice().iter().enumerate().map(node).collect();
        nodes.retain(|node| node[2].is_finite());
        nodes.sort_by(|a, b| a[2].total_cmp(&b[2]));
        nodes
    }

    #[test]
    fn nodes_of_a_map_stay_within_a_centimetre_whatever_its_handedness() {
        let folder = tempfile::tempdir().unwrap();
        for (rotation, skew) in [
            (0.0, 0.0),
            (0.0, 4e-6),
            (35.0, 0.0),
            (35.0, 4e-6),
            (130.0, -4e-6),
        ] {
            for flips in [[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]] {
                for is_transposed in [false, true] {
                    let axis = |length: f64, degrees: f64| {
                        let (sin, cos) = degrees.to_radians().sin_cos();
                        [length * cos, length * sin]
                    };
                    let mut geometry = Geometry::with_spacing([450_000.0, 6_780_000.0], [1.0; 2]);
                    geometry.axes = [
                        axis(25.0 * flips[0], rotation),
                        axis(12.5 * flips[1], rotation + 90.0 + skew),
                    ];
                    if is_transposed {
                        geometry.axes.swap(0, 1);
                    }
                    let image = height_image([70, 40], geometry);
                    for ending in GRID_EXTENSIONS {
                        let path = folder.path().join(format!("a.{ending}"));
                        let case = format!("{ending} {rotation} {skew} {flips:?} {is_transposed}");
                        let written = formats::write(&path, &image);
                        if rotation != 0.0 && ending != "irap" {
                            assert!(written.is_err(), "{case}");
                            continue;
                        }
                        written.unwrap();
                        let restored = sorted_nodes(&read_back(&path));
                        let expected = sorted_nodes(&image);
                        assert_eq!(restored.len(), expected.len(), "{case}");
                        for (node, expected) in restored.iter().zip(&expected) {
                            let [dx, dy, dz] = [0, 1, 2].map(|k| node[k] - expected[k]);
                            assert!(dx.hypot(dy) < 0.01 && dz == 0.0, "{case} {dx} {dy} {dz}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn a_map_with_skewed_axes_is_refused_and_a_slight_skew_is_noted() {
        let folder = tempfile::tempdir().unwrap();
        let skewed = |angle: f64| {
            let mut geometry = Geometry::with_spacing([0.0; 2], [10.0; 2]);
            geometry.axes[1] = [10.0 * angle.sin(), 10.0 * angle.cos()];
            geometry.units = ["m", "m"].map(String::from);
            geometry
        };
        let image = height_image([100, 100], skewed(2e-4));
        for ending in GRID_EXTENSIONS {
            let path = folder.path().join(format!("a.{ending}"));
            let error = formats::write(&path, &image).unwrap_err().to_string();
            assert!(error.contains("not perpendicular"), "{ending}: {error}");
            let note = displacement_note(&path, [100, 100], &skewed(9e-5)).unwrap();
            assert!(note.contains("nodes are moved by up to 0.0"), "{note}");
            assert_eq!(displacement_note(&path, [100, 100], &skewed(1e-7)), None);
        }
        assert_eq!(
            displacement_note(&folder.path().join("a.vti"), [100, 100], &skewed(9e-5)),
            None
        );
    }

    #[test]
    fn a_height_that_equals_the_usual_null_value_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let heights = vec![-9999.0, -99_999.0, 1e30, f32::NAN];
        let geometry = Geometry::with_spacing([0.0; 2], [1.0; 2]);
        let image = Image::new([2, 2], heights.clone(), geometry);
        for ending in GRID_EXTENSIONS {
            let path = folder.path().join(format!("a.{ending}"));
            formats::write(&path, &image).unwrap();
            let restored = read_back(&path);
            assert_eq!(restored.as_slice()[..3], heights[..3], "{ending}");
            assert!(restored.as_slice()[3].is_nan(), "{ending}");
        }
    }
}

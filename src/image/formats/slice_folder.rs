//! Folders of PNG or TIFF files, each of which is a slice of a volume.
//!
//! Slices are in the order of the numbers in their names: `slice2` comes before `slice10`. The files say
//! nothing of the distance between slices.

use std::cmp::Ordering;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::packed::file_error;
use super::placement::NO_GEOMETRY_NOTE;
use super::samples::{Encoding, Endian, SampleType};
use super::stream::{ImageHeader, ImageStream, PlaneReader};
use super::{AnyImage, ImageFormat, extension, into_any_image, png, tiff};
use crate::error::{Error, Result, cause, io_error};
use crate::geometry::norm;
use crate::image::labels::{ExactSample, LabelCollector};
use crate::image::{ExactLabels, Geometry};
use crate::parallel::prelude::*;

/// Endings of slices that are read.
const SLICE_EXTENSIONS: [&str; 3] = ["png", "tif", "tiff"];

/// Endings of pictures that are not read as slices.
const OTHER_PICTURES: [&str; 8] = ["jpg", "jpeg", "bmp", "gif", "jp2", "webp", "pgm", "ppm"];

/// Remedy for a folder of pictures that are no slices of one volume.
const ONE_STACK_REMEDY: &str = "give a folder with the slices of one volume alone";

/// Returns the files of a folder with one of these endings.
fn files_with(folder: &Path, endings: &[&str]) -> Result<Vec<PathBuf>> {
    let failed = |e| io_error(folder, "read", e);
    let entries = std::fs::read_dir(folder).map_err(failed)?;
    let mut paths: Vec<PathBuf> = entries
        .map(|entry| Ok(entry.map_err(failed)?.path()))
        .collect::<Result<_>>()?;
    let is_hidden = |path: &Path| {
        let name = path.file_name().unwrap_or_default();
        name.as_encoded_bytes().starts_with(b".")
    };
    paths.retain(|path| {
        path.is_file() && !is_hidden(path) && endings.contains(&extension(path).as_str())
    });
    paths.sort();
    Ok(paths)
}

/// Returns `true` for a folder that has pictures of slices, also of endings that are not read.
pub fn has_slices(folder: &Path) -> bool {
    let has = |endings: &[&str]| files_with(folder, endings).is_ok_and(|files| !files.is_empty());
    has(&SLICE_EXTENSIONS) || has(&OTHER_PICTURES)
}

/// A part of a name: digits, or other characters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum NamePart<'a> {
    /// A number, without leading zeros.
    Digits(&'a str),
    /// A text.
    Text(&'a str),
}

/// Splits a name into numbers and the texts between them.
fn name_parts(name: &str) -> Vec<NamePart<'_>> {
    let mut parts = Vec::new();
    let mut rest = name;
    while let Some(first) = rest.chars().next() {
        let is_digit = first.is_ascii_digit();
        let end = rest
            .find(|c: char| c.is_ascii_digit() != is_digit)
            .unwrap_or(rest.len());
        let (part, tail) = rest.split_at(end);
        parts.push(if is_digit {
            NamePart::Digits(part.trim_start_matches('0'))
        } else {
            NamePart::Text(part)
        });
        rest = tail;
    }
    parts
}

/// Compares names by their numbers, and else by their letters.
fn natural_order(a: &str, b: &str) -> Ordering {
    let (parts_a, parts_b) = (name_parts(a), name_parts(b));
    for pair in parts_a.iter().zip(&parts_b) {
        let order = match pair {
            (NamePart::Digits(a), NamePart::Digits(b)) => a.len().cmp(&b.len()).then(a.cmp(b)),
            (NamePart::Text(a), NamePart::Text(b)) => a.cmp(b),
            (NamePart::Digits(_), NamePart::Text(_)) => Ordering::Less,
            (NamePart::Text(_), NamePart::Digits(_)) => Ordering::Greater,
        };
        if order != Ordering::Equal {
            return order;
        }
    }
    parts_a.len().cmp(&parts_b.len()).then(a.cmp(b))
}

/// Checks that names, in their natural order, differ by numbers alone, and that no number is missing or
/// occurs twice. The error has the numbers of two names and the problem.
fn check_names(names: &[String]) -> std::result::Result<(), (usize, usize, &'static str)> {
    let parts: Vec<Vec<NamePart<'_>>> = names.iter().map(|name| name_parts(name)).collect();
    let Some(first) = parts.first() else {
        return Ok(());
    };
    let is_alike = |a: &NamePart<'_>, b: &NamePart<'_>| match (a, b) {
        (NamePart::Digits(_), NamePart::Digits(_)) => true,
        (a, b) => a == b,
    };
    for (k, other) in parts.iter().enumerate() {
        let are_alike =
            other.len() == first.len() && first.iter().zip(other).all(|(a, b)| is_alike(a, b));
        if !are_alike {
            return Err((0, k, "names that differ by more than numbers"));
        }
    }
    let varies = |place: &usize| parts.iter().any(|other| other[*place] != first[*place]);
    let varying: Vec<usize> = (0..first.len()).filter(varies).collect();
    let number = |k: usize, place: usize| match parts[k][place] {
        NamePart::Digits("") => Some(0),
        NamePart::Digits(digits) => digits.parse::<i64>().ok(),
        NamePart::Text(_) => None,
    };
    let [place] = varying[..] else {
        return match varying.first() {
            None if names.len() > 1 => Err((0, 1, "the same number twice")),
            _ => Ok(()),
        };
    };
    let Some(numbers) = (0..names.len())
        .map(|k| number(k, place))
        .collect::<Option<Vec<i64>>>()
    else {
        return Ok(());
    };
    let gaps: Vec<i64> = numbers
        .windows(2)
        .map(|pair| pair[1].saturating_sub(pair[0]))
        .collect();
    if let Some(k) = gaps.iter().position(|&gap| gap == 0) {
        return Err((k, k + 1, "the same number twice"));
    }
    let smallest = gaps.iter().copied().min().unwrap_or(1);
    match gaps.iter().position(|&gap| gap != smallest) {
        Some(k) => Err((k, k + 1, "numbers missing")),
        None => Ok(()),
    }
}

/// Opens a folder of slices. They are read from their files when they are needed.
///
/// # Errors
/// Returns an [`Error::Io`] if the folder has pictures of several kinds, if slices are missing among their
/// numbers, or if the first slice cannot be read.
pub fn open(folder: &Path) -> Result<ImageStream> {
    let mut files = files_with(folder, &SLICE_EXTENSIONS)?;
    let name_of = |path: &Path| {
        let name = path.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    };
    let others = files_with(folder, &OTHER_PICTURES)?;
    let is_png = |path: &&PathBuf| extension(path) == "png";
    let other_kind = files.iter().find(|path| is_png(path) != is_png(&&files[0]));
    match (files.first(), other_kind.or_else(|| others.first())) {
        (None, _) => {
            let problem = "holds pictures that are not read as slices";
            let remedy = "convert them to .png without losses, or better, save the slices as .tif";
            return Err(file_error(folder, problem, remedy));
        }
        (Some(first), Some(other)) => {
            let problem = format!(
                "holds pictures of several kinds: {} and {}",
                name_of(first),
                name_of(other)
            );
            return Err(file_error(folder, problem, ONE_STACK_REMEDY));
        }
        _ => {}
    }
    files.sort_by(|a, b| natural_order(&name_of(a), &name_of(b)));
    let names: Vec<String> = files.iter().map(|path| name_of(path)).collect();
    check_names(&names).map_err(|(a, b, problem)| {
        let problem = format!("has slices with {problem}: {} and {}", names[a], names[b]);
        let remedy =
            "give a folder with all slices of one volume and nothing else, numbered evenly";
        file_error(folder, problem, remedy)
    })?;
    let first = Slice::read(&files[0])?;
    let mut notes = vec![format!(
        "{} slices, from {} to {}",
        files.len(),
        names[0],
        names[names.len() - 1]
    )];
    let mut geometry = Geometry::default();
    if first.geometry.units[0].is_empty() && first.geometry.spacing() == [1.0; 3] {
        notes.push(format!("a folder of slices {NO_GEOMETRY_NOTE}"));
    } else {
        let [x, y, _] = first.geometry.axes;
        geometry.axes = [x, y, [0.0, 0.0, norm(y)]];
        geometry.units.clone_from(&first.geometry.units);
        notes.push(
            "slices do not say how far apart they are: taken as rows are (--spacing sets it)"
                .into(),
        );
    }
    notes.extend(
        first
            .notes
            .iter()
            .filter(|note| !note.contains(NO_GEOMETRY_NOTE))
            .cloned(),
    );
    let dims = [first.dims[0], first.dims[1], files.len()];
    // Floats and wide integers: the reader rounds them, and collects labels exactly.
    let is_wide = first.encoding.contains("32") || first.encoding.contains("64");
    let encoding = Encoding {
        sample_type: if is_wide {
            SampleType::F64
        } else {
            SampleType::U16
        },
        endian: Endian::Little,
    };
    Ok(ImageStream {
        header: ImageHeader {
            dims,
            geometry,
            missing: Vec::new(),
            label_names: Vec::new(),
            format: ImageFormat::SliceFolder,
            encoding: first.encoding.clone(),
            notes,
            survey: None,
            line_numbers: None,
        },
        encoding,
        reader: Box::new(SlicePlanes { files, first }),
        max_magnitude_bits: Default::default(),
    })
}

/// The content of one file of a slice.
struct Slice {
    dims: [usize; 2],
    geometry: Geometry<3>,
    encoding: String,
    /// The colours that indices stand for.
    palette: Option<Vec<u8>>,
    notes: Vec<String>,
    samples: Vec<f32>,
    labels: Option<Arc<ExactLabels>>,
}

impl Slice {
    /// Reads a file.
    fn read(path: &Path) -> Result<Self> {
        let is_png = extension(path) == "png";
        let loaded = if is_png {
            png::read(path)?
        } else {
            let loaded = tiff::read(path)?;
            let geometry = loaded.image.geometry.clone();
            let AnyImage::Plane(mut plane) = into_any_image(loaded) else {
                let problem = "has several pages, where a slice has one";
                return Err(file_error(
                    path,
                    problem,
                    "give the stack itself, or a folder of single slices",
                ));
            };
            plane.image.geometry = geometry.flatten();
            plane
        };
        Ok(Self {
            dims: loaded.image.dims(),
            geometry: loaded.image.geometry.to_3d(),
            palette: if is_png && loaded.encoding.contains("palette") {
                palette(path)
            } else {
                None
            },
            encoding: loaded.encoding,
            notes: loaded.notes,
            labels: loaded.image.labels.clone(),
            samples: loaded.image.as_slice().to_vec(),
        })
    }
}

/// Returns the palette of a PNG file.
fn palette(path: &Path) -> Option<Vec<u8>> {
    let bytes = std::fs::read(path).ok()?;
    let mut rest = bytes.get(png::MAGIC.len()..)?;
    loop {
        let length = u32::from_be_bytes(*rest.first_chunk()?) as usize;
        let kind = rest.get(4..8)?;
        if kind == b"PLTE" {
            return rest.get(8..8 + length).map(<[u8]>::to_vec);
        }
        // Length, kind and checksum take four bytes each.
        rest = rest.get(length.checked_add(12)?..)?;
    }
}

/// Reader of slices.
struct SlicePlanes {
    files: Vec<PathBuf>,
    first: Slice,
}

impl SlicePlanes {
    /// Reads a slice, which must be as the first one is.
    fn slice(&self, plane: usize) -> Result<Slice> {
        let path = &self.files[plane];
        let slice = Slice::read(path)?;
        let describe = |slice: &Slice| {
            let [width, height] = slice.dims;
            format!("{width} x {height}, {}", slice.encoding)
        };
        let (own, first) = (describe(&slice), describe(&self.first));
        let problem = if own != first {
            format!("is {own}, the first slice {first}")
        } else if slice.palette != self.first.palette {
            "has another palette than the first slice, so that equal indices are other labels"
                .into()
        } else {
            return Ok(slice);
        };
        Err(Error::Io(cause(
            path.display(),
            problem,
            "give slices of one size and kind",
        )))
    }
}

impl PlaneReader for SlicePlanes {
    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        let width = self.first.dims[0];
        let part = (rows.len() * width).max(1);
        out.par_chunks_mut(part)
            .enumerate()
            .try_for_each(|(k, out)| {
                let slice = self.slice(first + k)?;
                out.copy_from_slice(&slice.samples[rows.start * width..rows.end * width]);
                Ok(())
            })
    }

    fn read_exact_labels(&self, dims: [usize; 3]) -> Result<Option<Arc<ExactLabels>>> {
        let mut collector = LabelCollector::default();
        for plane in 0..dims[2] {
            let slice = self.slice(plane)?;
            match &slice.labels {
                Some(labels) => {
                    let numbers = labels.indices.iter().map(|&i| labels.values[i as usize]);
                    collector.extend(numbers);
                }
                None => {
                    let samples = slice
                        .samples
                        .iter()
                        .map(|&s| ExactSample::from(f64::from(s)));
                    if !collector.extend_exact(samples) {
                        return Ok(None);
                    }
                }
            }
        }
        Ok(collector.finish_exact())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Image;
    use crate::image::formats::{ReadOptions, read_any, write};

    fn sorted(names: &[&str]) -> Vec<String> {
        let mut names: Vec<String> = names.iter().map(|name| (*name).to_string()).collect();
        names.sort_by(|a, b| natural_order(a, b));
        names
    }

    #[test]
    fn names_are_sorted_by_their_numbers() {
        let names = sorted(&["slice10.png", "slice2.png", "slice1.png", "slice003.png"]);
        assert_eq!(
            names,
            ["slice1.png", "slice2.png", "slice003.png", "slice10.png"]
        );
        let long = sorted(&[
            "a99999999999999999999999.tif",
            "a100000000000000000000000.tif",
        ]);
        assert_eq!(long[0], "a99999999999999999999999.tif");
    }

    #[test]
    fn missing_repeated_and_foreign_names_are_found() {
        let check = |names: &[&str]| {
            check_names(&sorted(names))
                .map_err(|(a, b, problem)| (a, b, problem.contains("missing")))
        };
        assert_eq!(check(&["s1.png", "s2.png", "s3.png"]), Ok(()));
        assert_eq!(check(&["s8.png", "s10.png", "s12.png"]), Ok(()));
        assert_eq!(check(&["s1.png", "s2.png", "s4.png"]), Err((1, 2, true)));
        assert_eq!(check(&["s1.png", "s01.png", "s2.png"]), Err((0, 1, false)));
        assert_eq!(check(&["s1.png", "s2.png", "mask.png"]), Err((0, 1, false)));
        assert_eq!(check(&["x1y1.png", "x2y7.png"]), Ok(()));
        assert_eq!(check(&["only.png"]), Ok(()));
    }

    #[test]
    fn slices_of_a_folder_are_one_volume() {
        let folder = tempfile::tempdir().unwrap();
        let slice = |value: f32, dims: [usize; 2]| {
            let samples = (0..dims[0] * dims[1]).map(|i| value + i as f32).collect();
            Image::new(dims, samples, Geometry::default())
        };
        for k in 0..12 {
            let path = folder.path().join(format!("s{k}.png"));
            write(&path, &slice(10.0 * k as f32, [3, 2])).unwrap();
        }
        std::fs::write(folder.path().join("notes.txt"), "not a slice").unwrap();
        let read = || read_any(folder.path(), &ReadOptions::default());
        let AnyImage::Space(loaded) = read().unwrap() else {
            panic!("slices are read as a plane");
        };
        assert_eq!(loaded.image.dims(), [3, 2, 12]);
        let expected: Vec<f32> = (0..12)
            .flat_map(|k| (0..6).map(move |i| (10 * k + i) as f32))
            .collect();
        assert_eq!(loaded.image.as_slice(), expected);

        write(&folder.path().join("s12.png"), &slice(1.0, [4, 2])).unwrap();
        let error = read().unwrap_err().to_string();
        assert!(
            error.contains("s12.png") && error.contains("is 4 x 2"),
            "{error}"
        );
        std::fs::remove_file(folder.path().join("s12.png")).unwrap();
        std::fs::write(folder.path().join("s12.jpg"), [0xff, 0xd8]).unwrap();
        let error = read().unwrap_err().to_string();
        assert!(
            error.contains("several kinds: s0.png and s12.jpg"),
            "{error}"
        );
    }
}

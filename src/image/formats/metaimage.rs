//! MetaImage (`.mha`, or `.mhd` with a separate file of samples), the format of ITK: lines `Key =
//! value`. The last line, `ElementDataFile`, names the file of samples, or is `LOCAL` if the
//! samples follow it.
//!
//! Row k of `TransformMatrix` is the direction of axis k. Samples may be compressed (zlib) or text.

use std::io::Write;
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::packed::{
    self, DAMAGED_REMEDY, PackedSamples, SamplePacking, SampleStart, dims_from_sizes, file_error,
};
use super::samples::{self, Encoding, Endian, SampleType};
use super::{ImageFormat, LoadedImage};
use crate::error::{Result, io_error};
use crate::files::atomic_write;
use crate::image::{Geometry, Image};

/// Longest header that is read, in bytes.
const MAX_HEADER_BYTES: u64 = 1 << 16;

/// Returns `true` if these are the first bytes of a MetaImage header.
pub fn looks_like(head: &[u8]) -> bool {
    head.starts_with(b"ObjectType") || head.starts_with(b"NDims")
}

/// The lines of a header as pairs of key and value.
struct Header<'a> {
    path: &'a Path,
    lines: Vec<(&'a str, &'a str)>,
}

impl<'a> Header<'a> {
    fn parse(path: &'a Path, text: &'a str) -> Result<(Self, u64)> {
        let mut lines = Vec::new();
        let mut end = 0;
        for line in text.split_inclusive('\n') {
            end += line.len();
            let Some((key, value)) = line.split_once('=') else {
                break;
            };
            let (key, value) = (key.trim(), value.trim());
            if let Some((_, other)) = lines
                .iter()
                .find(|(name, other)| *name == key && *other != value)
            {
                let shown: String = format!("{other} and {value}").chars().take(60).collect();
                let problem = format!("its header gives {key} twice: {shown}");
                return Err(file_error(path, problem, DAMAGED_REMEDY));
            }
            lines.push((key, value));
            if key == "ElementDataFile" {
                return Ok((Self { path, lines }, end as u64));
            }
        }
        let problem = "its header does not end in a line ElementDataFile = ...";
        Err(file_error(path, problem, DAMAGED_REMEDY))
    }

    /// Returns the value of the first of these keys that is present.
    fn value(&self, keys: &[&str]) -> Option<&'a str> {
        let entry = |key: &&str| self.lines.iter().find(|(name, _)| name == key);
        keys.iter().find_map(entry).map(|(_, value)| *value)
    }

    fn required_value(&self, key: &str) -> Result<&'a str> {
        self.value(&[key]).ok_or_else(|| {
            let problem = format!("its header has no {key}");
            file_error(self.path, problem, DAMAGED_REMEDY)
        })
    }

    /// Returns `true` if the value of a key is true in MetaIO: it begins with `T`, `t` or `1`.
    fn is_true(&self, keys: &[&str]) -> bool {
        self.value(keys)
            .is_some_and(|v| v.starts_with(['T', 't', '1']))
    }

    /// Returns `n` finite numbers, or `None` if none of these keys is present.
    fn numbers(&self, keys: &[&str], n: usize) -> Result<Option<Vec<f64>>> {
        let Some(text) = self.value(keys) else {
            return Ok(None);
        };
        let numbers: Vec<f64> = text
            .split_whitespace()
            .filter_map(|word| word.parse().ok())
            .filter(|v: &f64| v.is_finite())
            .collect();
        if numbers.len() == n && text.split_whitespace().count() == n {
            Ok(Some(numbers))
        } else {
            Err(self.value_error(keys[0], text))
        }
    }

    /// Returns the number of samples along each axis.
    fn sample_counts(&self) -> Result<Vec<usize>> {
        let rank = self.required_value("NDims")?;
        let n = match rank.parse::<usize>() {
            Ok(n) if (1..=10).contains(&n) => n,
            _ => return Err(self.value_error("NDims", rank)),
        };
        let sizes = self.required_value("DimSize")?;
        let counts: Vec<usize> = sizes
            .split_whitespace()
            .filter_map(|w| w.parse().ok())
            .collect();
        if counts.len() != n || sizes.split_whitespace().count() != n {
            return Err(self.value_error("DimSize", sizes));
        }
        Ok(counts)
    }

    /// Returns the file of the samples, and where in it they begin. The header ends at byte `end`.
    fn sample_location(&self, end: u64) -> Result<(PathBuf, u64, SampleStart)> {
        match self.value(&["ElementDataFile"]).unwrap_or_default() {
            "LOCAL" | "Local" | "local" => {
                Ok((self.path.to_path_buf(), end, SampleStart::Offset(0)))
            }
            data if data == "LIST" || data.starts_with("LIST ") || data.contains('%') => {
                let problem = "its samples lie in a file for each slice";
                let remedy = "write it as one file, e.g. in Python with SimpleITK";
                Err(file_error(self.path, problem, remedy))
            }
            "" => {
                let problem = "its header has no ElementDataFile";
                Err(file_error(self.path, problem, DAMAGED_REMEDY))
            }
            name => {
                let sample_start = match self.value(&["HeaderSize"]).map(str::parse::<i64>) {
                    None => SampleStart::Offset(0),
                    Some(Ok(-1)) => SampleStart::FromEnd,
                    Some(Ok(n)) if n >= 0 => SampleStart::Offset(n as u64),
                    _ => {
                        return Err(
                            self.value_error("HeaderSize", "which is not a number of bytes")
                        );
                    }
                };
                Ok((sibling(self.path, name), 0, sample_start))
            }
        }
    }

    fn value_error(&self, key: &str, text: &str) -> crate::Error {
        let shown: String = text.chars().take(60).collect();
        file_error(
            self.path,
            format!("its header says {key} = {shown}"),
            DAMAGED_REMEDY,
        )
    }
}

/// Reads a volume. A plane is read as a volume with a single sample along z.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if the file, or the file of its samples, cannot be
/// read, is truncated or damaged, or has more than one value per sample.
pub fn read(path: &Path) -> Result<LoadedImage> {
    let text = packed::read_head_text(path, MAX_HEADER_BYTES)?;
    let (header, end) = Header::parse(path, &text)?;
    if let Some(kind) = header
        .value(&["ObjectType"])
        .filter(|kind| *kind != "Image")
    {
        return Err(file_error(
            path,
            format!("holds a MetaIO {kind}"),
            "give the file of an image",
        ));
    }
    if let Some(channels) = header
        .value(&["ElementNumberOfChannels"])
        .filter(|n| *n != "1")
    {
        let problem = format!("has {channels} values per sample");
        return Err(file_error(
            path,
            problem,
            "give one component, or the magnitude",
        ));
    }
    let counts = header.sample_counts()?;
    let dims = dims_from_sizes(&counts)
        .map_err(|problem| file_error(path, problem, "give one volume of the series"))?;

    let element = header.required_value("ElementType")?;
    let sample = sample_type(element).ok_or_else(|| header.value_error("ElementType", element))?;
    let is_big_endian = header.is_true(&["BinaryDataByteOrderMSB", "ElementByteOrderMSB"]);
    let endian = if is_big_endian {
        Endian::Big
    } else {
        Endian::Little
    };
    let is_text = header.value(&["BinaryData"]).is_some() && !header.is_true(&["BinaryData"]);
    let packing = match (header.is_true(&["CompressedData"]), is_text) {
        (true, _) => SamplePacking::Deflated,
        (false, true) => SamplePacking::Text,
        (false, false) => SamplePacking::Uncompressed,
    };
    let (file, offset, sample_start) = header.sample_location(end)?;
    let geometry = geometry(&header, counts.len())?;
    let packed = PackedSamples {
        path: file,
        offset,
        packing,
        sample_start,
        encoding: Encoding {
            sample_type: sample,
            endian,
        },
        dims,
    };
    packed.load(ImageFormat::MetaImage, geometry, None, Vec::new())
}

/// Returns the path of a file that a header names, relative to the folder of the header.
pub fn sibling(header: &Path, name: &str) -> PathBuf {
    header.parent().unwrap_or(Path::new("")).join(name)
}

fn sample_type(name: &str) -> Option<SampleType> {
    Some(match name {
        "MET_CHAR" => SampleType::I8,
        "MET_UCHAR" => SampleType::U8,
        "MET_SHORT" => SampleType::I16,
        "MET_USHORT" => SampleType::U16,
        "MET_INT" | "MET_LONG" => SampleType::I32,
        "MET_UINT" | "MET_ULONG" => SampleType::U32,
        "MET_LONG_LONG" => SampleType::I64,
        "MET_ULONG_LONG" => SampleType::U64,
        "MET_FLOAT" => SampleType::F32,
        "MET_DOUBLE" => SampleType::F64,
        _ => return None,
    })
}

/// Returns the geometry of the first three of `n` axes.
fn geometry(header: &Header<'_>, n: usize) -> Result<Geometry<3>> {
    let spacing = header.numbers(&["ElementSpacing", "ElementSize"], n)?;
    let origin = header.numbers(&["Offset", "Position", "Origin"], n)?;
    let matrix = header.numbers(&["TransformMatrix", "Rotation", "Orientation"], n * n)?;
    let mut geometry = Geometry::default();
    for k in 0..n.min(3) {
        if let Some(origin) = &origin {
            geometry.origin[k] = origin[k];
        }
        for c in 0..n.min(3) {
            if let Some(matrix) = &matrix {
                geometry.axes[k][c] = matrix[k * n + c];
            }
            if let Some(spacing) = &spacing {
                geometry.axes[k][c] *= spacing[k];
            }
        }
    }
    if geometry.determinant() == 0.0 {
        let problem = "its axes are linearly dependent";
        let remedy = "set ElementSpacing and TransformMatrix";
        return Err(file_error(header.path, problem, remedy));
    }
    Ok(geometry)
}

/// Writes compressed 32-bit floats, and the geometry in double precision.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write<const D: usize>(path: &Path, image: &Image<D>) -> Result<()> {
    let spacing = image.geometry.spacing();
    let list = |values: &mut dyn Iterator<Item = f64>| {
        values
            .map(|v| format!("{v:?}"))
            .collect::<Vec<_>>()
            .join(" ")
    };
    let directions = |i: usize| match spacing[i / D] {
        0.0 => f64::from(u8::from(i / D == i % D)),
        s => image.geometry.axes[i / D][i % D] / s,
    };
    let dims = image.dims().map(|n| n.to_string()).join(" ");
    let mut packed = ZlibEncoder::new(Vec::new(), Compression::fast());
    // Writing to memory cannot fail.
    samples::write(&mut packed, image.as_slice()).map_err(|e| io_error(path, "write", e))?;
    let packed = packed.finish().map_err(|e| io_error(path, "write", e))?;
    // MetaIO reads garbage if the compressed size is missing.
    let size = packed.len();
    let header = format!(
        "ObjectType = Image\nNDims = {D}\nBinaryData = True\nBinaryDataByteOrderMSB = False\n\
         CompressedData = True\nCompressedDataSize = {size}\nTransformMatrix = {}\nOffset = {}\nElementSpacing = {}\n\
         DimSize = {dims}\nElementType = MET_FLOAT\nElementDataFile = LOCAL\n",
        list(&mut (0..D * D).map(directions)),
        list(&mut image.geometry.origin.iter().copied()),
        list(&mut spacing.iter().copied()),
    );
    atomic_write(path, |out| {
        out.write_all(header.as_bytes())?;
        out.write_all(&packed)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn true_is_spelled_as_metaio_reads_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mha");
        for (word, expected) in [("True", 256.0), ("1", 256.0), ("t", 256.0), ("False", 1.0)] {
            let header = format!(
                "ObjectType = Image\nNDims = 2\nBinaryData = 1\nBinaryDataByteOrderMSB = {word}\n\
                 DimSize = 2 1\nElementType = MET_USHORT\nElementDataFile = LOCAL\n"
            );
            std::fs::write(&path, [header.as_bytes(), &[1, 0, 1, 0]].concat()).unwrap();
            assert_eq!(
                read(&path).unwrap().image.as_slice(),
                [expected; 2],
                "{word}"
            );
        }
    }

    #[test]
    fn the_header_says_how_long_the_compressed_samples_are() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mha");
        let image = Image::new([3, 2], vec![1.5; 6], Geometry::default());
        write(&path, &image).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let text: String = bytes.iter().map(|&b| b as char).collect();
        let size = text.split("CompressedDataSize = ").nth(1).unwrap();
        let size: usize = size.lines().next().unwrap().parse().unwrap();
        let begin = text.find("LOCAL\n").unwrap() + "LOCAL\n".len();
        assert_eq!(size, bytes.len() - begin);
        assert_eq!(read(&path).unwrap().image.flatten(), image);
    }
}

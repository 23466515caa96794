//! NumPy `.npy` files: versions 1 to 3, every real numeric type, both byte orders, both memory
//! orders.
//!
//! An array of shape `(nz, ny, nx)` becomes an image of dimensions `[nx, ny, nz]`, one of shape
//! `(ny, nx)` a 2-D image. The format has no geometry.

use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use crate::parallel::prelude::*;
use ndarray::{ArrayD, IxDyn, ShapeBuilder};

use super::packed::open_with_length;
use super::samples::{self, Encoding, Endian, SampleType};
use super::stream::{ImageHeader, ImageStream, OpenedImage, RawPlanes, SlabSource};
use super::{ImageFormat, into_any_image};
use crate::error::{Error, Result, cause, io_error};
use crate::files::{atomic_write, read_exact_at};
use crate::image::ExactLabels;

/// First bytes of every `.npy` file.
pub const MAGIC: &[u8] = b"\x93NUMPY";

/// Opens a 3-D array. A 2-D array is opened as a volume with a single sample along z. An array in
/// Fortran order is loaded into memory.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be read, is truncated, is not 2-D or 3-D, or does
/// not hold real numbers.
pub fn open(path: &Path) -> Result<OpenedImage> {
    let NpyFile {
        file,
        data_offset: start,
        trailing_bytes: trailing,
        header,
    } = NpyFile::new(path)?;
    let [nz, ny, nx] = three_dims(&header.shape).map_err(|problem| {
        let remedy =
            "reshape the array to (nz, ny, nx), or (ny, nx) in 2-D, in NumPy and save it again";
        Error::Io(cause(path.display(), problem, remedy))
    })?;
    let encoding = header.encoding;
    let mut head = ImageHeader::without_geometry(ImageFormat::Npy, [nx, ny, nz], encoding, ".npy");
    if trailing > 0 {
        let note = format!("{trailing} bytes after the array are ignored");
        head.notes.push(note);
    }
    if !header.fortran_order {
        return Ok(OpenedImage::Stream(ImageStream {
            header: head,
            encoding,
            reader: Box::new(RawPlanes {
                path: path.to_path_buf(),
                file,
                data_offset: start,
                encoding,
                plane_dims: [nx, ny],
            }),
            max_magnitude_bits: Default::default(),
        }));
    }
    let mut samples = samples::allocate(path, nx * ny * nz)?;
    encoding
        .read(&file, start, &mut samples)
        .map_err(|e| io_error(path, "read", e))?;
    samples = to_c_order(&samples, [nz, ny, nx]);
    head.notes.extend(encoding.rounding_note(&samples));
    let exact = if encoding.may_need_exact_labels(&samples) {
        (encoding.read_exact_labels(&file, start, samples.len()))
            .map_err(|e| io_error(path, "read", e))?
            .map(|exact| labels_to_c_order(&exact, [nz, ny, nx]))
    } else {
        None
    };
    let mut loaded = head.with_samples(samples);
    loaded.image.labels = exact;
    Ok(OpenedImage::InMemory(into_any_image(loaded)))
}

/// Reads an array of any shape as `f32`, for arrays that are not images.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be read, is truncated, or does not hold real
/// numbers.
pub fn read_array(path: &Path) -> Result<ArrayD<f32>> {
    let NpyFile {
        file,
        data_offset: start,
        header,
        ..
    } = NpyFile::new(path)?;
    let mut samples = samples::allocate(path, header.shape.iter().product())?;
    header
        .encoding
        .read(&file, start, &mut samples)
        .map_err(|e| io_error(path, "read", e))?;
    let shape = IxDyn(&header.shape).set_f(header.fortran_order);
    let array = ArrayD::from_shape_vec(shape, samples).map_err(|e| {
        let problem = format!("has the shape {:?}: {e}", header.shape);
        Error::Io(cause(path.display(), problem, crate::files::REWRITE_DAMAGED).with_source(e))
    })?;
    Ok(array.as_standard_layout().into_owned())
}

/// A file with a valid header and complete samples.
struct NpyFile {
    file: File,
    /// Offset of the first sample in the file.
    data_offset: u64,
    /// Number of bytes after the samples.
    trailing_bytes: u64,
    header: Header,
}

impl NpyFile {
    fn new(path: &Path) -> Result<Self> {
        let (file, length) = open_with_length(path)?;
        let refuse =
            |problem: String, remedy: &str| Error::Io(cause(path.display(), problem, remedy));

        let (text, start) = read_header_text(&file, length)
            .map_err(|e| io_error(path, "read", e))?
            .ok_or_else(|| {
                refuse(
                    "is not a complete .npy file: its header is cut off or of an unknown version"
                        .into(),
                    "write it again with numpy.save",
                )
            })?;
        let header = Header::parse(&text).map_err(|problem| {
            refuse(problem, "save it with numpy.save(file, array.astype('f4'))")
        })?;
        let size = header.encoding.size() as u64;
        let needed = header
            .shape
            .iter()
            .try_fold(size, |bytes, &n| bytes.checked_mul(n as u64))
            .and_then(|bytes| bytes.checked_add(start))
            .ok_or_else(|| {
                let problem = format!(
                    "claims the shape {:?}, more than any file holds",
                    header.shape
                );
                refuse(problem, "the file is damaged: write it again")
            })?;
        if needed > length {
            let shape = &header.shape;
            let problem =
                format!("is cut off: shape {shape:?} needs {needed} bytes, it has {length}");
            return Err(refuse(problem, "copy or write it again"));
        }
        Ok(Self {
            file,
            data_offset: start,
            trailing_bytes: length - needed,
            header,
        })
    }
}

/// Writes samples as little-endian `f32` in C order, shape `(nz, ny, nx)`. `dims` are the numbers
/// of samples along each axis, x first.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be written.
pub fn write(path: &Path, dims: &[usize], slabs: &dyn SlabSource) -> Result<()> {
    let shape: Vec<usize> = dims.iter().rev().copied().collect();
    atomic_write(path, |writer| {
        writer.write_all(&encode_header(&shape))?;
        samples::write_slabs(writer, slabs)
    })
}

/// Writes an array of any shape as little-endian `f32` in C order.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be written.
pub fn write_array(path: &Path, array: &ArrayD<f32>) -> Result<()> {
    let array = array.as_standard_layout();
    atomic_write(path, |writer| {
        writer.write_all(&encode_header(array.shape()))?;
        samples::write(writer, array.as_slice().unwrap_or_default())
    })
}

/// Returns all bytes before the samples.
fn encode_header(shape: &[usize]) -> Vec<u8> {
    let words: Vec<String> = shape.iter().map(usize::to_string).collect();
    let comma = if shape.len() == 1 { "," } else { "" };
    let mut text = format!(
        "{{'descr': '<f4', 'fortran_order': False, 'shape': ({}{comma}), }}",
        words.join(", ")
    );
    // Magic, version and length take 10 bytes; the data starts at a multiple of 64.
    let padded = (10 + text.len() + 1).next_multiple_of(64) - 10;
    text.push_str(&" ".repeat(padded - 1 - text.len()));
    text.push('\n');
    let mut header = MAGIC.to_vec();
    header.extend([1, 0]);
    header.extend((padded as u16).to_le_bytes());
    header.extend(text.as_bytes());
    header
}

/// Returns the text of the header and the offset of the data, or `None` if the header is incomplete
/// or of an unknown version.
fn read_header_text(file: &File, length: u64) -> std::io::Result<Option<(String, u64)>> {
    let mut fixed = [0; 12];
    let available = (length as usize).min(fixed.len());
    read_exact_at(file, &mut fixed[..available], 0)?;
    let (text_start, text_length) = match fixed[6] {
        1 => (10, u64::from(u16::from_le_bytes([fixed[8], fixed[9]]))),
        2 | 3 => {
            let length = u32::from_le_bytes([fixed[8], fixed[9], fixed[10], fixed[11]]);
            (12, u64::from(length))
        }
        _ => return Ok(None),
    };
    let start = text_start + text_length;
    if !fixed.starts_with(MAGIC) || start > length {
        return Ok(None);
    }
    let mut text = vec![0; text_length as usize];
    read_exact_at(file, &mut text, text_start)?;
    Ok(Some((String::from_utf8_lossy(&text).into_owned(), start)))
}

fn three_dims(shape: &[usize]) -> std::result::Result<[usize; 3], String> {
    match *shape {
        [nz, ny, nx] if nz > 0 && ny > 0 && nx > 0 => Ok([nz, ny, nx]),
        [ny, nx] if ny > 0 && nx > 0 => Ok([1, ny, nx]),
        [_, _] | [_, _, _] => Err(format!("has the shape {shape:?}, without a sample")),
        _ => Err(format!(
            "has {} dimension(s), shape {shape:?}, where 2 or 3 are needed",
            shape.len()
        )),
    }
}

/// Converts labels from Fortran order to C order.
fn labels_to_c_order(fortran: &ExactLabels, dims: [usize; 3]) -> Arc<ExactLabels> {
    Arc::new(ExactLabels {
        values: fortran.values.clone(),
        indices: to_c_order(&fortran.indices, dims),
    })
}

/// Copies Fortran order (first axis fastest) to C order (last axis fastest).
fn to_c_order<T: Copy + Default + Send + Sync>(fortran: &[T], [nz, ny, nx]: [usize; 3]) -> Vec<T> {
    // Blocks along z use all samples of each cache line that is read.
    const BLOCK_EDGE: usize = 16;
    let mut out = vec![T::default(); fortran.len()];
    out.par_chunks_mut(BLOCK_EDGE * ny * nx)
        .enumerate()
        .for_each(|(block, out)| {
            let z0 = block * BLOCK_EDGE;
            let depth = BLOCK_EDGE.min(nz - z0);
            for y in 0..ny {
                for x in 0..nx {
                    let column = nz * (y + ny * x) + z0;
                    for z in 0..depth {
                        out[(z * ny + y) * nx + x] = fortran[column + z];
                    }
                }
            }
        });
    out
}

#[derive(Debug)]
struct Header {
    encoding: Encoding,
    fortran_order: bool,
    shape: Vec<usize>,
}

impl Header {
    /// Parses `{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4, 5), }`, keys in any order.
    fn parse(text: &str) -> std::result::Result<Self, String> {
        let damaged = || "its .npy header is damaged".to_string();
        let mut cursor = HeaderCursor(text);
        let (mut descr, mut fortran_order, mut shape) = (None, None, None);
        cursor.expect('{').ok_or_else(damaged)?;
        while cursor.expect('}').is_none() {
            let key = cursor.quoted().ok_or_else(damaged)?;
            cursor.expect(':').ok_or_else(damaged)?;
            match key {
                "descr" => {
                    let name = cursor.quoted().ok_or("holds records, not plain numbers")?;
                    descr = Some(parse_encoding(name)?);
                }
                "fortran_order" => fortran_order = Some(cursor.boolean().ok_or_else(damaged)?),
                "shape" => shape = Some(cursor.tuple().ok_or_else(damaged)?),
                _ => return Err(damaged()),
            }
            // The comma after the last entry may be missing.
            let _ = cursor.expect(',');
        }
        match (descr, fortran_order, shape) {
            (Some(encoding), Some(fortran_order), Some(shape)) => Ok(Self {
                encoding,
                fortran_order,
                shape,
            }),
            _ => Err(damaged()),
        }
    }
}

/// Returns the encoding of a NumPy type string such as `<f4`.
fn parse_encoding(descr: &str) -> std::result::Result<Encoding, String> {
    let (order, name) = match descr.chars().next() {
        Some(c @ ('<' | '>' | '=' | '|')) => (c, &descr[1..]),
        _ => ('=', descr),
    };
    let endian = match order {
        '>' => Endian::Big,
        '=' if cfg!(target_endian = "big") => Endian::Big,
        _ => Endian::Little,
    };
    let sample = match name {
        "b1" | "?" => SampleType::Bool,
        "i1" => SampleType::I8,
        "u1" => SampleType::U8,
        "i2" => SampleType::I16,
        "u2" => SampleType::U16,
        "i4" => SampleType::I32,
        "u4" => SampleType::U32,
        "i8" => SampleType::I64,
        "u8" => SampleType::U64,
        "f2" => SampleType::F16,
        "f4" => SampleType::F32,
        "f8" => SampleType::F64,
        _ => {
            return Err(format!(
                "holds samples of NumPy type '{descr}', not real numbers"
            ));
        }
    };
    Ok(Encoding {
        sample_type: sample,
        endian,
    })
}

/// Remaining text of the header. Each method removes one token if it is next.
struct HeaderCursor<'a>(&'a str);

impl<'a> HeaderCursor<'a> {
    fn expect(&mut self, token: char) -> Option<()> {
        self.0 = self.0.trim_start().strip_prefix(token)?;
        Some(())
    }

    fn quoted(&mut self) -> Option<&'a str> {
        let text = self.0.trim_start();
        let quote = text.chars().next().filter(|c| matches!(c, '\'' | '"'))?;
        let (content, rest) = text[1..].split_once(quote)?;
        self.0 = rest;
        Some(content)
    }

    fn boolean(&mut self) -> Option<bool> {
        let text = self.0.trim_start();
        let (value, rest) = match text.strip_prefix("True") {
            Some(rest) => (true, rest),
            None => (false, text.strip_prefix("False")?),
        };
        self.0 = rest;
        Some(value)
    }

    fn tuple(&mut self) -> Option<Vec<usize>> {
        let (content, rest) = self.0.trim_start().strip_prefix('(')?.split_once(')')?;
        self.0 = rest;
        content
            .split(',')
            // Python 2 wrote long integers with a suffix, as in 3L.
            .map(|n| n.trim().trim_end_matches('L'))
            .filter(|n| !n.is_empty())
            .map(|n| n.parse().ok())
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::formats::{AnyImage, LoadedImage};
    use crate::image::{Geometry, Image};
    use proptest::prelude::*;

    fn into_space(read: AnyImage) -> LoadedImage {
        match read {
            AnyImage::Space(loaded) => loaded,
            AnyImage::Plane(loaded) => panic!("2-D: {:?}", loaded.image.dims()),
        }
    }

    fn file_bytes(version: u8, dict: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([version, 0]);
        match version {
            1 => bytes.extend((dict.len() as u16).to_le_bytes()),
            _ => bytes.extend((dict.len() as u32).to_le_bytes()),
        }
        bytes.extend(dict.as_bytes());
        bytes.extend(data);
        bytes
    }

    fn read_any_bytes(bytes: &[u8]) -> Result<AnyImage> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        std::fs::write(&path, bytes).unwrap();
        open(&path)?.load(&path)
    }

    fn read_bytes(bytes: &[u8]) -> Result<LoadedImage> {
        read_any_bytes(bytes).map(into_space)
    }

    #[test]
    fn round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let samples: Vec<f32> = (0..5 * 4 * 3).map(|i| i as f32 * 0.25 - 3.0).collect();
        let image = Image::new([5, 4, 3], samples, Geometry::default());
        write(&path, &image.dims(), &image).unwrap();
        let restored = open(&path).unwrap().load(&path).unwrap();
        assert_eq!(into_space(restored).image, image);
        // NumPy requires that the data start at a multiple of 64 bytes.
        assert_eq!(
            std::fs::metadata(&path).unwrap().len() % 64,
            (5 * 4 * 3 * 4) % 64
        );
    }

    #[test]
    fn arrays_of_any_shape_keep_their_order() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let data: Vec<u8> = (0..24i16).flat_map(i16::to_le_bytes).collect();
        for (fortran, text) in [(false, "False"), (true, "True")] {
            let dict =
                format!("{{'descr': '<i2', 'fortran_order': {text}, 'shape': (2, 3, 4, 1), }}");
            std::fs::write(&path, file_bytes(1, &dict, &data)).unwrap();
            let array = read_array(&path).unwrap();
            assert_eq!(array.shape(), [2, 3, 4, 1]);
            assert!(array.is_standard_layout());
            let at = if fortran { 1 + 2 * 3 * 2 } else { 3 * 4 + 2 };
            assert_eq!(array[[1, 0, 2, 0]], at as f32);
        }
        let huge = 1u64 << 62;
        let dict =
            format!("{{'descr': '<i2', 'fortran_order': False, 'shape': (0, {huge}, {huge}), }}");
        std::fs::write(&path, file_bytes(1, &dict, &data)).unwrap();
        assert!(read_array(&path).is_err());
        std::fs::write(&path, file_bytes(1, "{'descr': '<i2'}", &data)).unwrap();
        assert!(read_array(&path).is_err());
    }

    #[test]
    fn byte_orders_memory_orders_and_versions() {
        let dict = |descr: &str, order: &str| {
            format!("{{'shape': (2, 3L, 4), \"fortran_order\": {order}, 'descr': '{descr}'}}  \n")
        };
        let c: Vec<i16> = (0..24).collect();
        let little: Vec<u8> = c.iter().flat_map(|v| v.to_le_bytes()).collect();
        let big: Vec<u8> = c.iter().flat_map(|v| v.to_be_bytes()).collect();
        let expected: Vec<f32> = (0..24).map(|v| v as f32).collect();
        for version in [1, 2, 3] {
            for (descr, data) in [("<i2", &little), (">i2", &big)] {
                let loaded = read_bytes(&file_bytes(version, &dict(descr, "False"), data)).unwrap();
                assert_eq!(loaded.image.dims(), [4, 3, 2]);
                assert_eq!(loaded.image.as_slice(), expected);
            }
        }
        // Fortran order: the value at (z, y, x) encodes its indices.
        let mut data = Vec::new();
        for x in 0..4u8 {
            for y in 0..3u8 {
                for z in 0..2u8 {
                    data.push(100 * z + 10 * y + x);
                }
            }
        }
        let image = read_bytes(&file_bytes(1, &dict("|u1", "True"), &data))
            .unwrap()
            .image;
        for ((z, y, x), v) in ndarray::indices((2, 3, 4))
            .into_iter()
            .zip(image.as_slice())
        {
            assert_eq!(*v, (100 * z + 10 * y + x) as f32);
        }
    }

    #[test]
    fn large_fortran_arrays_cross_blocks() {
        let [nz, ny, nx] = [37, 5, 7];
        let value = |z: usize, y: usize, x: usize| (z * 100 + y * 10 + x) as f32;
        let mut fortran = Vec::new();
        for x in 0..nx {
            for y in 0..ny {
                fortran.extend((0..nz).map(|z| value(z, y, x)));
            }
        }
        let c = to_c_order(&fortran, [nz, ny, nx]);
        for ((z, y, x), v) in ndarray::indices((nz, ny, nx)).into_iter().zip(c) {
            assert_eq!(v, value(z, y, x));
        }
    }

    #[test]
    fn bad_files_are_refused_with_a_remedy() {
        let dict = |descr: &str, shape: &str| {
            format!("{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n")
        };
        for (bytes, expected) in [
            (b"\x93NUMPY".to_vec(), "cut off"),
            (
                file_bytes(9, &dict("'<f4'", "(1, 1, 1)"), &[0; 4]),
                "unknown version",
            ),
            (file_bytes(1, "{'descr': '<f4'", &[]), "damaged"),
            (
                file_bytes(1, &dict("'<f4'", "(24,)"), &[0; 96]),
                "1 dimension(s), shape [24]",
            ),
            (
                file_bytes(1, &dict("'<f4'", "()"), &[0; 4]),
                "0 dimension(s)",
            ),
            (
                file_bytes(1, &dict("'<f4'", "(2, 2, 2, 2)"), &[0; 64]),
                "4 dimension(s)",
            ),
            (
                file_bytes(1, &dict("'<f4'", "(2, 0, 2)"), &[]),
                "without a sample",
            ),
            (
                file_bytes(1, &dict("'<f4'", "(2, 2, 2)"), &[0; 31]),
                "is cut off",
            ),
            (
                file_bytes(1, &dict("'<c8'", "(2, 2, 2)"), &[0; 64]),
                "'<c8'",
            ),
            (file_bytes(1, &dict("'|O'", "(2, 2, 2)"), &[0; 64]), "'|O'"),
            (
                file_bytes(1, &dict("[('a', '<f4')]", "(2, 2, 2)"), &[0; 64]),
                "records",
            ),
            (
                file_bytes(1, &dict("'<f8'", "(4294967296, 4294967296, 8)"), &[0; 64]),
                "more than any file",
            ),
            (
                file_bytes(1, &dict("'<f8'", "(99999999999999999999, 1, 1)"), &[]),
                "damaged",
            ),
        ] {
            let error = read_bytes(&bytes).unwrap_err().to_string();
            assert!(error.contains(expected), "{error} (expected: {expected})");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..Default::default() })]
        #[test]
        fn damaged_files_never_panic(cut in 0usize..130, at in 0usize..80, byte: u8) {
            let dict = "{'descr': '<f4', 'fortran_order': True, 'shape': (2, 2, 2), }\n";
            let mut bytes = file_bytes(1, dict, &[0; 32]);
            let at = at.min(bytes.len() - 1);
            bytes[at] = byte;
            bytes.truncate(cut);
            let _ = read_any_bytes(&bytes);
        }
    }
}

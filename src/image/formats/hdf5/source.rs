//! Reads HDF5 files by the crate `hdf5-reader`, with checks of what it would read wrongly.
//!
//! The file is read in parts, never mapped into memory. What is refused names `h5repack`, which every
//! installation of HDF5 has.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use hdf5_reader::group::Group;
use hdf5_reader::storage::{BlockCacheStorage, Storage, StorageBuffer};
use hdf5_reader::{Attribute, ByteOrder, Dataset, Datatype, Hdf5File};

use crate::error::{Error, Result, cause, io_error};
use crate::files::{open, read_exact_at};
use crate::image::formats::samples::{Encoding, Endian, SampleType};
use crate::memory;

/// The first bytes of an HDF5 file.
pub const MAGIC: &[u8] = b"\x89HDF\r\n\x1a\n";
/// The first bytes of a file that MATLAB wrote, in front of the HDF5 file.
pub const MATLAB_MAGIC: &[u8] = b"MATLAB 7.3 MAT-file";

/// Largest number of groups within one another.
const MAX_DEPTH: usize = 32;
/// Largest number of data sets that are looked at.
const MAX_DATASETS: usize = 10_000;
/// Largest number of data sets that an error lists.
pub const MAX_LISTED: usize = 12;
/// Size and number of the parts of a file that are kept.
const BLOCK_BYTES: usize = 1 << 18;
const BLOCK_COUNT: usize = 64;
/// Remedy for data sets that are not read.
const REPACK: &str = "repack it with HDF5's own tool: h5repack -f GZIP=4 -l CONTI IN.h5 OUT.h5, or write .npy with h5py";

/// A file, as the crate reads it.
struct FileBytes {
    file: File,
    length: u64,
}

impl Storage for FileBytes {
    fn len(&self) -> u64 {
        self.length
    }

    fn read_range(&self, offset: u64, len: usize) -> hdf5_reader::error::Result<StorageBuffer> {
        let end = offset.checked_add(len as u64);
        if end.is_none_or(|end| end > self.length) {
            return Err(hdf5_reader::error::Error::UnexpectedEof {
                offset,
                needed: len as u64,
                available: self.length.saturating_sub(offset),
            });
        }
        let mut buffer = vec![0; len];
        read_exact_at(&self.file, &mut buffer, offset)?;
        Ok(StorageBuffer::from_vec(buffer))
    }
}

/// Returns a file as the crates for HDF5 and NetCDF read it.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be opened.
pub fn storage(path: &Path) -> Result<Arc<dyn Storage>> {
    let file = open(path, "give a file")?;
    let metadata = file.metadata().map_err(|e| io_error(path, "read", e))?;
    let bytes = FileBytes {
        file,
        length: metadata.len(),
    };
    Ok(Arc::new(BlockCacheStorage::new(
        Arc::new(bytes),
        BLOCK_BYTES,
        BLOCK_COUNT,
    )))
}

/// Splits the name of a data set, `FILE:/PATH` or `FILE/PATH`, into the file and the path. Returns
/// `None` unless the file exists and is HDF5.
pub fn split_path(path: &Path) -> Option<(PathBuf, String)> {
    let text = path.to_str()?;
    let mut ends = text.char_indices().filter(|(_, c)| [':', '/'].contains(c));
    let at = ends.find(|(at, _)| is_hdf5(Path::new(&text[..*at])))?.0;
    let inner = text[at..].trim_start_matches(':').trim_start_matches('/');
    (!inner.is_empty()).then(|| (PathBuf::from(&text[..at]), format!("/{inner}")))
}

/// Returns `true` if a file begins as HDF5 files do.
pub fn is_hdf5(path: &Path) -> bool {
    let mut head = [0; 19];
    let file = path.is_file().then(|| File::open(path).ok()).flatten();
    file.is_some_and(|file| {
        let length = file.metadata().map_or(0, |metadata| metadata.len());
        let head = &mut head[..length.min(19) as usize];
        read_exact_at(&file, head, 0).is_ok()
            && (head.starts_with(MAGIC) || head.starts_with(MATLAB_MAGIC))
    })
}

/// An open HDF5 file.
pub struct Hdf5Source {
    file: Hdf5File,
    path: PathBuf,
}

impl Hdf5Source {
    /// Opens a file.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if the file cannot be read or is damaged.
    pub fn open(path: &Path) -> Result<Self> {
        let file = Hdf5File::from_storage(storage(path)?).map_err(|e| {
            let problem = format!("is damaged or no HDF5 file: {e}");
            Error::Io(cause(
                path.display(),
                problem,
                crate::files::REWRITE_DAMAGED,
            ))
        })?;
        Ok(Self {
            file,
            path: path.to_path_buf(),
        })
    }

    /// Returns the path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Creates an error about an object of this file.
    pub fn error(
        &self,
        object: &str,
        problem: impl std::fmt::Display,
        remedy: impl std::fmt::Display,
    ) -> Error {
        Error::Io(cause(
            format!("{}:{object}", self.path.display()),
            problem,
            remedy,
        ))
    }

    /// Returns a group, or `None` if there is none with this path.
    pub fn group(&self, path: &str) -> Option<Group> {
        self.file.group(path).ok()
    }

    /// Returns the paths of all data sets, in the order of their names, without those of MATLAB's own
    /// groups.
    pub fn contents(&self) -> Contents {
        let mut contents = Contents::default();
        match self.file.root_group() {
            Ok(root) => contents.collect(&root, "", 0),
            Err(_) => contents.unlisted.push("/".into()),
        }
        contents.datasets.sort();
        contents
    }

    /// Opens a data set.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if there is none with this path, or if it is stored in a way that is not
    /// read.
    pub fn dataset(&self, path: &str) -> Result<NumberSet<'_>> {
        let dataset = self.file.dataset(path).map_err(|e| {
            let contents = self.contents();
            let is_in = |group: &String| path.starts_with(group.as_str());
            let is_listed = contents.datasets.iter().any(|known| known == path);
            if is_listed || contents.unlisted.iter().any(is_in) {
                return self.unreadable(path, &e);
            }
            let shown = contents.datasets.iter().take(MAX_LISTED);
            let shown: Vec<&str> = shown.map(String::as_str).collect();
            let remedy = format!("give one of {}", shown.join(", "));
            self.error(path, "is no data set of this file", remedy)
        })?;
        Ok(NumberSet {
            source: self,
            path: path.to_string(),
            dataset,
        })
    }

    /// Returns the error for a data set that is stored in a way that is not read.
    fn unreadable(&self, path: &str, error: &hdf5_reader::error::Error) -> Error {
        self.error(path, format!("cannot be read: {error}"), REPACK)
    }
}

/// The content of a file.
#[derive(Default)]
pub struct Contents {
    /// Paths of data sets.
    pub datasets: Vec<String>,
    /// Paths of groups that cannot be listed, because they are damaged or have a virtual data set.
    pub unlisted: Vec<String>,
}

impl Contents {
    /// Adds the content of a group.
    fn collect(&mut self, group: &Group, prefix: &str, depth: usize) {
        let Ok((groups, datasets)) = group.member_names() else {
            self.unlisted.push(format!("{prefix}/"));
            return;
        };
        let paths = datasets.iter().map(|name| format!("{prefix}/{name}"));
        self.datasets.extend(paths);
        for name in groups {
            // MATLAB keeps the contents of cells and objects there.
            let is_internal = ["#refs#", "#subsystem#"].contains(&name.as_str());
            if is_internal || depth >= MAX_DEPTH || self.datasets.len() >= MAX_DATASETS {
                continue;
            }
            let path = format!("{prefix}/{name}");
            match group.group(&name) {
                Ok(child) => self.collect(&child, &path, depth + 1),
                Err(_) => self.unlisted.push(format!("{path}/")),
            }
        }
    }
}

/// A data set of numbers.
pub struct NumberSet<'a> {
    source: &'a Hdf5Source,
    /// Path within the file.
    pub path: String,
    dataset: Dataset,
}

impl NumberSet<'_> {
    /// Returns the length along each axis, the slowest axis first.
    pub fn shape(&self) -> Vec<usize> {
        let lengths = self.dataset.shape().iter();
        lengths
            .map(|&n| usize::try_from(n).unwrap_or(usize::MAX))
            .collect()
    }

    /// Creates an error about this data set.
    pub fn error(&self, problem: impl std::fmt::Display, remedy: impl std::fmt::Display) -> Error {
        self.source.error(&self.path, problem, remedy)
    }

    /// Returns the numbers of an attribute, or `None` if there is none of this name.
    pub fn attribute_numbers(&self, name: &str) -> Option<Vec<f64>> {
        attribute_numbers(&self.dataset.attribute(name).ok()?)
    }

    /// Returns the text of an attribute, or `None` if there is none of this name.
    pub fn attribute_text(&self, name: &str) -> Option<String> {
        attribute_text(&self.dataset.attribute(name).ok()?)
    }

    /// Returns the encoding of the numbers.
    ///
    /// # Errors
    /// Returns [`Error::Io`] for data sets of other things than whole or real numbers of usual
    /// precision.
    pub fn encoding(&self) -> Result<Encoding> {
        let kind = self.dataset.dtype();
        let raw = self.dataset.raw_datatype();
        let raw = raw.map_err(|e| self.source.unreadable(&self.path, &e))?;
        let (number, message) = match kind {
            // The message of the numbers stands behind the head of that of the enumeration.
            Datatype::Enum { base, .. } => (base.as_ref(), raw.get(8..).unwrap_or_default()),
            other => (other, raw.as_slice()),
        };
        let encoding = encoding(number).filter(|encoding| has_full_precision(message, *encoding));
        encoding.ok_or_else(|| {
            let what = match kind {
                Datatype::Compound { .. } => "compound or complex values".to_string(),
                Datatype::String { .. } | Datatype::VarLen { .. } => "texts or lists".to_string(),
                Datatype::Reference { .. } => "references".to_string(),
                Datatype::FixedPoint { size, .. } | Datatype::FloatingPoint { size, .. } => {
                    format!("numbers of {size} bytes that do not use all their bits")
                }
                other => format!("values of the type {other:?}"),
            };
            self.error(
                format!("holds {what}, which are not read"),
                "convert it to 32-bit numbers in Python: h5py reads it",
            )
        })
    }

    /// Reads the bytes of all numbers, in the order of the file.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if there is not enough memory, and [`Error::Io`] if the data set is
    /// damaged or compressed in a way that is not read.
    pub fn read_bytes(&self) -> Result<Vec<u8>> {
        let count = self
            .shape()
            .iter()
            .fold(1.0, |product, &n| product * n as f64);
        let size = self.encoding()?.size();
        memory::ensure_available(
            format!("{}:{}", self.source.path.display(), self.path),
            count * size as f64,
            format!("{count} numbers"),
            "give a part of the data set",
        )?;
        let bytes = self.dataset.read_raw_bytes();
        bytes.map_err(|e| self.source.unreadable(&self.path, &e))
    }
}

/// Returns the text of an attribute; `None` for numbers.
pub fn attribute_text(attribute: &Attribute) -> Option<String> {
    let texts = attribute.read_strings().ok();
    let text = texts.and_then(|texts| texts.into_iter().next());
    let text = text.or_else(|| attribute.read_string().ok())?;
    Some(text.trim_end_matches('\0').to_string())
}

/// Returns the numbers of an attribute; `None` for texts.
pub fn attribute_numbers(attribute: &Attribute) -> Option<Vec<f64>> {
    let encoding = encoding(&attribute.datatype)?;
    Some(encoding.numbers(&attribute.raw_data).collect())
}

/// Returns the encoding of whole and real numbers; `None` for other types.
fn encoding(kind: &Datatype) -> Option<Encoding> {
    use SampleType::{F16, F32, F64, I8, I16, I32, I64, U8, U16, U32, U64};
    let (sample_type, order) = match kind {
        Datatype::FixedPoint {
            size,
            signed,
            byte_order,
        } => {
            let sample_type = match (size, signed) {
                (1, true) => I8,
                (1, false) => U8,
                (2, true) => I16,
                (2, false) => U16,
                (4, true) => I32,
                (4, false) => U32,
                (8, true) => I64,
                (8, false) => U64,
                _ => return None,
            };
            (sample_type, byte_order)
        }
        Datatype::Bitfield { size, byte_order } => {
            let sample_type = match size {
                1 => U8,
                2 => U16,
                4 => U32,
                8 => U64,
                _ => return None,
            };
            (sample_type, byte_order)
        }
        Datatype::FloatingPoint { size, byte_order } => {
            let sample_type = match size {
                2 => F16,
                4 => F32,
                8 => F64,
                _ => return None,
            };
            (sample_type, byte_order)
        }
        _ => return None,
    };
    Some(Encoding {
        sample_type,
        endian: match order {
            ByteOrder::LittleEndian => Endian::Little,
            ByteOrder::BigEndian => Endian::Big,
        },
    })
}

/// Returns `true` if the message of a type says that the numbers use all their bits in the usual way.
/// Layout: "HDF5 File Format Specification", section IV.A.2.d.
fn has_full_precision(message: &[u8], encoding: Encoding) -> bool {
    let short = |at: usize| match message.get(at..at + 2) {
        Some(&[low, high]) => Some(u16::from_le_bytes([low, high])),
        _ => None,
    };
    let bits = 8 * encoding.size() as u16;
    if short(8) != Some(0) || short(10) != Some(bits) {
        return false;
    }
    // Position and size of the exponent and of the mantissa.
    let fields: [u8; 4] = match encoding.sample_type {
        SampleType::F16 => [10, 5, 0, 10],
        SampleType::F32 => [23, 8, 0, 23],
        SampleType::F64 => [52, 11, 0, 52],
        _ => return true,
    };
    message.get(12..16) == Some(&fields[..])
}

//! Metadata of a node: a group, or an array with its chunks and codecs.

use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::codecs::Codecs;
use super::version_2;
use crate::error::{Result, io_error};
use crate::image::formats::packed::file_error;
use crate::image::formats::samples::SampleType;

/// Name of the file that marks a folder as a node of Zarr version 3.
pub const NODE_FILE: &str = "zarr.json";

/// Largest size of a chunk in bytes, which is also the limit of Blosc.
const MAX_CHUNK_BYTES: usize = i32::MAX as usize;

/// Largest number of elements of an array. Chunks without a file take no space, but reading them
/// takes time.
const MAX_ELEMENTS: u64 = 1 << 40;

/// Largest size of a metadata file in bytes.
const MAX_METADATA_BYTES: u64 = 1 << 26;

/// Node of the hierarchy.
pub enum ZarrNode {
    /// A folder of nodes, with its attributes.
    Group(Map<String, Value>),
    /// An array.
    Array(Box<ArrayMetadata>),
}

/// Metadata of an array.
pub struct ArrayMetadata {
    /// Folder of the array.
    pub folder: PathBuf,
    /// Number of elements along each axis, the slowest first.
    pub shape: Vec<usize>,
    /// Value of elements that no chunk holds.
    pub fill_value: f64,
    /// Codecs of the chunks.
    pub codecs: Codecs,
    /// Names of the axes; empty where an axis has none.
    pub axis_names: Vec<String>,
    /// The two or three axes of an image, the slowest first. All others have one element.
    pub image_axes: Vec<usize>,
    /// Further attributes.
    pub attributes: Map<String, Value>,
    /// Naming scheme of chunk files.
    chunk_keys: ChunkKeys,
}

/// Naming scheme of chunk files.
struct ChunkKeys {
    /// `true` for names such as `c/1/2/3`, `false` for `1/2/3`.
    has_prefix: bool,
    /// Character between the numbers.
    separator: char,
}

impl ZarrNode {
    /// Reads the metadata of the node in a folder, of version 3 or 2.
    ///
    /// # Errors
    /// Returns a [`crate::Error::Io`] if there are no metadata, or if they are not supported.
    pub fn open(folder: &Path) -> Result<Self> {
        let path = folder.join(NODE_FILE);
        if !path.is_file() && version_2::is_node(folder) {
            return Self::open_version_2(folder);
        }
        let to_error = |problem: String| file_error(&path, problem, REWRITE_REMEDY);
        let value = read_json(&path)?;
        if value["zarr_format"] != 3 {
            let problem = format!("is of Zarr version {}, not 2 or 3", value["zarr_format"]);
            return Err(to_error(problem));
        }
        let attributes = value["attributes"].as_object().cloned().unwrap_or_default();
        match value["node_type"].as_str() {
            Some("group") => Ok(Self::Group(attributes)),
            Some("array") => {
                let array = ArrayMetadata::parse(folder, &value, attributes);
                array
                    .map(|array| Self::Array(Box::new(array)))
                    .map_err(to_error)
            }
            _ => Err(to_error(format!(
                "has the node_type {}, neither array nor group",
                value["node_type"]
            ))),
        }
    }

    fn open_version_2(folder: &Path) -> Result<Self> {
        let attributes_file = folder.join(version_2::ATTRIBUTES_FILE);
        let attributes = if attributes_file.is_file() {
            let value = read_json(&attributes_file)?;
            value.as_object().cloned().unwrap_or_default()
        } else {
            Map::new()
        };
        let path = folder.join(version_2::ARRAY_FILE);
        if !path.is_file() {
            return Ok(Self::Group(attributes));
        }
        let value = read_json(&path)?;
        version_2::array_metadata(&value, &attributes)
            .and_then(|value| ArrayMetadata::parse(folder, &value, attributes))
            .map(|array| Self::Array(Box::new(array)))
            .map_err(|problem| file_error(&path, problem, REWRITE_REMEDY))
    }
}

/// Returns `true` if a folder is a node of Zarr version 3 or 2.
pub fn is_node(folder: &Path) -> bool {
    folder.join(NODE_FILE).is_file() || version_2::is_node(folder)
}

/// Reads a metadata file.
///
/// # Errors
/// Returns a [`crate::Error::Io`] if it cannot be read or is no JSON.
pub fn read_json(path: &Path) -> Result<Value> {
    let length = std::fs::metadata(path).map_err(|e| io_error(path, "open", e))?;
    if length.len() > MAX_METADATA_BYTES {
        let problem = format!("has {} bytes, too many for metadata", length.len());
        return Err(file_error(path, problem, REWRITE_REMEDY));
    }
    let text = std::fs::read(path).map_err(|e| io_error(path, "read", e))?;
    // Version 2 writes NaN and infinities of attributes as bare words, which JSON has not.
    let without_words = || -> Option<Value> {
        let text = String::from_utf8(text.clone()).ok()?;
        let words = [("-Infinity", "null"), ("Infinity", "null"), ("NaN", "null")];
        let replaced = words.iter().fold(text, |text, (word, value)| {
            text.replace(&format!(": {word}"), &format!(": {value}"))
        });
        serde_json::from_str(&replaced).ok()
    };
    match serde_json::from_slice(&text) {
        Ok(value) => Ok(value),
        Err(error) => without_words().ok_or_else(|| {
            let problem = format!("is not JSON metadata of Zarr: {error}");
            file_error(path, problem, REWRITE_REMEDY).with_source(error)
        }),
    }
}

/// Remedy for invalid metadata.
pub const REWRITE_REMEDY: &str = "write the array again, e.g. with zarr-python's defaults";

impl ArrayMetadata {
    /// Parses the metadata of an array in the form of version 3.
    ///
    /// # Errors
    /// Returns a message if they are invalid or not supported.
    pub fn parse(
        folder: &Path,
        value: &Value,
        attributes: Map<String, Value>,
    ) -> std::result::Result<Self, String> {
        let shape = parse_counts(&value["shape"]).ok_or("has no shape")?;
        let grid = &value["chunk_grid"];
        if grid["name"] != "regular" {
            return Err(format!("has the chunk grid {}, not regular", grid["name"]));
        }
        let chunk = parse_counts(&grid["configuration"]["chunk_shape"])
            .filter(|chunk| chunk.len() == shape.len() && !chunk.contains(&0))
            .ok_or_else(|| format!("has no chunk_shape of {} numbers", shape.len()))?;
        let sample = sample_type(&value["data_type"])?;
        let codecs = Codecs::parse(&value["codecs"], &chunk, sample)?;
        // Of a shard only one of its chunks is in memory at a time.
        let cell = &codecs.cell_shape;
        checked_product(cell)
            .and_then(|count| count.checked_mul(sample_bytes(sample)))
            .filter(|&bytes| bytes <= MAX_CHUNK_BYTES)
            .ok_or_else(|| format!("has chunks of {cell:?} elements, more than 2 GB"))?;
        checked_product(&shape)
            .filter(|&count| count as u64 <= MAX_ELEMENTS)
            .ok_or_else(|| format!("has the shape {shape:?}, more than any survey"))?;
        let encoding = &value["chunk_key_encoding"];
        let has_prefix = match encoding["name"].as_str().or(encoding.as_str()) {
            Some("default") => true,
            Some("v2") => false,
            _ => {
                return Err(format!(
                    "has the chunk_key_encoding {encoding}, not default or v2"
                ));
            }
        };
        let separator = match encoding["configuration"]["separator"].as_str() {
            Some("/") => '/',
            Some(".") => '.',
            None if has_prefix => '/',
            None => '.',
            Some(other) => return Err(format!("has chunk keys separated by '{other}'")),
        };
        let transformers = value["storage_transformers"].as_array();
        if transformers.is_some_and(|list| !list.is_empty()) {
            return Err("has storage transformers, which are not read".into());
        }
        let names = match value["dimension_names"].as_array() {
            Some(names) if names.len() == shape.len() => names
                .iter()
                .map(|name| name.as_str().unwrap_or_default().to_string())
                .collect(),
            _ => vec![String::new(); shape.len()],
        };
        Ok(Self {
            folder: folder.to_path_buf(),
            codecs,
            fill_value: parse_fill_value(&value["fill_value"], sample)?,
            chunk_keys: ChunkKeys {
                has_prefix,
                separator,
            },
            image_axes: default_image_axes(&shape, &names),
            shape,
            axis_names: names,
            attributes,
        })
    }

    /// Returns the path of the file of a chunk.
    pub fn chunk_file(&self, chunk: &[usize]) -> PathBuf {
        let numbers: Vec<String> = chunk.iter().map(usize::to_string).collect();
        let ChunkKeys {
            has_prefix,
            separator,
        } = self.chunk_keys;
        let joined = numbers.join(&separator.to_string());
        let key = match (has_prefix, joined.is_empty()) {
            (true, true) => "c".to_string(),
            (true, false) => format!("c{separator}{joined}"),
            (false, true) => "0".to_string(),
            (false, false) => joined,
        };
        self.folder.join(key)
    }
}

/// Returns the axes of an image: all but axes of one element, as many as there are more than three.
/// Axes of channels go first, then the slowest ones.
fn default_image_axes(shape: &[usize], names: &[String]) -> Vec<usize> {
    let mut axes: Vec<usize> = (0..shape.len()).collect();
    let is_channel = |axis: usize| {
        let name = names[axis].to_lowercase();
        matches!(&*name, "c" | "channel" | "channels" | "t")
    };
    for wants_channel in [true, false] {
        let mut axis = 0;
        while axes.len() > 3 && axis < axes.len() {
            if shape[axes[axis]] == 1 && is_channel(axes[axis]) == wants_channel {
                axes.remove(axis);
            } else {
                axis += 1;
            }
        }
    }
    axes
}

/// Returns the product, or `None` if it overflows.
pub fn checked_product(counts: &[usize]) -> Option<usize> {
    counts
        .iter()
        .try_fold(1usize, |product, &n| product.checked_mul(n))
}

/// Parses a list of whole numbers.
pub fn parse_counts(value: &Value) -> Option<Vec<usize>> {
    let values = value.as_array()?.iter();
    values
        .map(|n| n.as_u64().and_then(|n| usize::try_from(n).ok()))
        .collect()
}

fn sample_type(value: &Value) -> std::result::Result<SampleType, String> {
    use SampleType::*;
    Ok(match value.as_str().or(value["name"].as_str()) {
        Some("bool") => Bool,
        Some("int8") => I8,
        Some("uint8") => U8,
        Some("int16") => I16,
        Some("uint16") => U16,
        Some("int32") => I32,
        Some("uint32") => U32,
        Some("int64") => I64,
        Some("uint64") => U64,
        Some("float16") => F16,
        Some("float32") => F32,
        Some("float64") => F64,
        Some(other) => return Err(format!("has the data type {other}, no real number")),
        None => return Err("has no data type".into()),
    })
}

fn sample_bytes(sample: SampleType) -> usize {
    use crate::image::formats::samples::{Encoding, Endian};
    let endian = Endian::Little;
    Encoding {
        sample_type: sample,
        endian,
    }
    .size()
}

/// Parses the value of elements that no chunk holds.
fn parse_fill_value(value: &Value, sample: SampleType) -> std::result::Result<f64, String> {
    let invalid =
        || format!("has the fill_value {value}, which is not a value of the type {sample:?}");
    match value {
        Value::Bool(flag) => Ok(f64::from(u8::from(*flag))),
        Value::Number(number) => number.as_f64().ok_or_else(invalid),
        Value::String(text) => match (text.as_str(), sample) {
            ("NaN", _) => Ok(f64::NAN),
            ("Infinity", _) => Ok(f64::INFINITY),
            ("-Infinity", _) => Ok(f64::NEG_INFINITY),
            (text, _) => {
                let bits = text
                    .strip_prefix("0x")
                    .map(|hex| u64::from_str_radix(hex, 16));
                match (bits, sample) {
                    (Some(Ok(bits)), SampleType::F16) => {
                        Ok(half::f16::from_bits(bits as u16).to_f64())
                    }
                    (Some(Ok(bits)), SampleType::F32) => Ok(f32::from_bits(bits as u32).into()),
                    (Some(Ok(bits)), SampleType::F64) => Ok(f64::from_bits(bits)),
                    _ => Err(invalid()),
                }
            }
        },
        _ => Err(invalid()),
    }
}

//! Zarr version 3 in local folders: a chunked array, alone or in a group; and MDIO version 1, which
//! stores a survey as such a group.
//!
//! An array of shape `(nz, ny, nx)` becomes an image of dimensions `[nx, ny, nz]`. It is read chunk
//! by chunk on all threads, so that the compressed data are never in memory as a whole.
//!
//! - `metadata`: the content of `zarr.json`
//! - `codecs`: decodes the bytes of a chunk to elements; `blosc` is one of the codecs
//! - `array`: the elements of an array
//! - `placement`: the geometry of an array, from the arrays next to it
//! - `write`: writes an image as a group

mod array;
mod blosc;
mod codecs;
mod metadata;
mod placement;
mod write;

use std::ops::Range;
use std::path::Path;

use serde_json::Value;

use super::packed::file_error;
use super::stream::{ImageHeader, ImageStream, PlaneReader};
use super::{ImageFormat, samples};
use crate::error::{Error, Result, io_error};
use metadata::{ArrayMetadata, NODE_FILE, VERSION_2_REMEDY, ZarrNode};

pub use write::write;

/// Returns `true` if the path is a Zarr folder.
///
/// # Errors
/// Returns an [`Error::Io`] if it is a folder of version 2.
pub fn is_node(path: &Path) -> Result<bool> {
    if !path.is_dir() {
        return Ok(false);
    }
    if path.join(NODE_FILE).is_file() {
        return Ok(true);
    }
    let version_2_files = [".zarray", ".zgroup", ".zmetadata"];
    if version_2_files.iter().any(|name| path.join(name).is_file()) {
        let problem = "is of Zarr version 2 (or MDIO version 0), which is not read";
        Err(file_error(path, problem, VERSION_2_REMEDY))
    } else {
        Ok(false)
    }
}

/// Opens an array, or the only array of a group that can be an image.
///
/// # Errors
/// Returns an [`Error::Io`] if the metadata cannot be read, or if there is no such array or more
/// than one.
pub fn open(path: &Path) -> Result<ImageStream> {
    let (array, group) = match ZarrNode::open(path)? {
        ZarrNode::Group(attributes) => (select_array(path, &attributes)?, Some(path.to_path_buf())),
        ZarrNode::Array(array) => {
            let folder = path.canonicalize().map_err(|e| io_error(path, "open", e))?;
            let parent = folder
                .parent()
                .filter(|folder| folder.join(NODE_FILE).is_file());
            (*array, parent.map(Path::to_path_buf))
        }
    };
    let shape_text = format_shape(&array.shape);
    let [nz, ny, nx] = array
        .volume_shape()
        .filter(|dims| !dims.contains(&0))
        .ok_or_else(|| {
            let problem = format!("holds {shape_text} elements, where 2 or 3 axes are needed");
            file_error(
                &array.folder,
                problem,
                "give another array, or a part of this one",
            )
        })?;
    let encoding = array.codecs.cell_codecs.encoding;
    let mut header = ImageHeader {
        encoding: format!("{encoding}{}", array.codecs.cell_codecs.compression_label()),
        notes: Vec::new(),
        ..ImageHeader::without_geometry(ImageFormat::Zarr, [nx, ny, nz], encoding, "Zarr")
    };
    if group.as_deref() == Some(path) {
        let name = array.folder.file_name().unwrap_or_default();
        header
            .notes
            .push(format!("the array {}", name.to_string_lossy()));
    }
    placement::place(&mut header, &array, group.as_deref())?;
    let reader: Box<dyn PlaneReader> = if header.missing.is_empty() {
        Box::new(array)
    } else {
        Box::new(MaskedArray {
            array,
            missing: header.missing.clone(),
            plane_dims: [nx, ny],
        })
    };
    Ok(ImageStream {
        header,
        encoding,
        reader,
        max_magnitude_bits: Default::default(),
    })
}

/// Selects the array of a group that is an image: the default array that the group names, or else
/// the only one.
fn select_array(
    group: &Path,
    attributes: &serde_json::Map<String, Value>,
) -> Result<ArrayMetadata> {
    let entries = std::fs::read_dir(group).map_err(|e| io_error(group, "read", e))?;
    let mut folders: Vec<_> = entries
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.join(NODE_FILE).is_file())
        .collect();
    folders.sort();
    let group_attributes = attributes.get("attributes").unwrap_or(&Value::Null);
    if let Some(name) = group_attributes["defaultVariableName"].as_str()
        && let Some(folder) = folders.iter().find(|path| path.ends_with(name))
        && let ZarrNode::Array(array) = ZarrNode::open(folder)?
    {
        return Ok(*array);
    }
    let mut failed: Option<Error> = None;
    let mut arrays: Vec<ArrayMetadata> = Vec::new();
    for folder in &folders {
        match ZarrNode::open(folder) {
            Ok(ZarrNode::Array(array)) => arrays.push(*array),
            Ok(ZarrNode::Group(_)) => (),
            Err(error) => failed = failed.or(Some(error)),
        }
    }
    // Arrays that hold coordinates or the trace mask are not images.
    let coordinate_names: Vec<String> = arrays
        .iter()
        .filter_map(|array| array.attributes.get("coordinates")?.as_str())
        .flat_map(|names| names.split_whitespace().map(String::from))
        .chain([placement::TRACE_MASK.to_string()])
        .collect();
    let name = |array: &ArrayMetadata| {
        let name = array.folder.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    };
    for axes in [3, 2] {
        let mut candidates: Vec<ArrayMetadata> = Vec::new();
        let (selected, remaining): (Vec<_>, Vec<_>) = arrays.into_iter().partition(|array| {
            array.volume_shape().is_some()
                && array.shape.len() >= axes
                && !coordinate_names.contains(&name(array))
        });
        arrays = remaining;
        candidates.extend(selected);
        let Some(first) = candidates.pop() else {
            continue;
        };
        if candidates.is_empty() {
            return Ok(first);
        }
        candidates.push(first);
        let descriptions: Vec<String> = candidates
            .iter()
            .map(|array| format!("{} ({})", name(array), format_shape(&array.shape)))
            .collect();
        return Err(file_error(
            group,
            format!("holds several arrays: {}", descriptions.join(", ")),
            &format!("give one of them, as in {}", candidates[0].folder.display()),
        ));
    }
    Err(failed.unwrap_or_else(|| {
        let problem = "is a group of Zarr without an array of two or three axes";
        file_error(group, problem, "give the folder of an array")
    }))
}

/// Formats a shape, e.g. `3 x 4 x 5`.
fn format_shape(counts: &[usize]) -> String {
    let words: Vec<String> = counts.iter().map(usize::to_string).collect();
    words.join(" x ")
}

/// An array with rows that hold no data. These rows are read as zeros, whatever the array holds
/// there.
struct MaskedArray {
    array: ArrayMetadata,
    missing: Vec<bool>,
    /// Number of samples of a plane along its axes.
    plane_dims: [usize; 2],
}

impl PlaneReader for MaskedArray {
    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        self.array.read_rows(first, rows.clone(), out)?;
        let [nx, ny] = self.plane_dims;
        let missing = self.missing.chunks(ny).skip(first);
        let missing = missing.flat_map(|plane| &plane[rows.clone()]);
        for (row, _) in out.chunks_mut(nx).zip(missing).filter(|(_, m)| **m) {
            row.fill(0.0);
        }
        Ok(())
    }

    fn batch_planes(&self) -> usize {
        self.array.batch_planes()
    }
}

/// Returns a type that holds all samples of this type without loss, as far as 32-bit floats do.
fn lossless_type(sample: samples::SampleType) -> samples::SampleType {
    use samples::SampleType::*;
    match sample {
        Bool | I8 | U8 | I16 | U16 | F16 => sample,
        _ => F32,
    }
}

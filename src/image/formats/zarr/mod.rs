//! Zarr versions 2 and 3 in local folders: a chunked array, alone or in a group; OME-Zarr, which stores
//! images of several resolutions as such groups; and MDIO version 1, which stores surveys so.
//!
//! An array of shape `(nz, ny, nx)` becomes an image of dimensions `[nx, ny, nz]`; axes of one
//! element, such as channel and time, are left out. It is read chunk by chunk on all threads, so that
//! the compressed data are never in memory as a whole.
//!
//! - `metadata`: the content of `zarr.json`; `version_2`: that of `.zarray` and `.zattrs`
//! - `codecs`: decodes the bytes of a chunk to elements; `blosc` is one of the codecs
//! - `array`: the elements of an array
//! - `ome`: the levels of OME-Zarr and their geometry
//! - `placement`: the geometry of an array, from the arrays next to it; `trace_headers`: those of MDIO
//! - `write`: writes an image as a group

mod array;
mod blosc;
mod codecs;
mod metadata;
mod ome;
mod placement;
mod trace_headers;
mod version_2;
mod write;

use std::ops::Range;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::packed::file_error;
use super::stream::{ImageHeader, ImageStream, PlaneReader};
use super::{ImageFormat, samples};
use crate::error::{Error, Result, io_error};
use metadata::{ArrayMetadata, NODE_FILE, ZarrNode};

pub use write::write;

/// Returns `true` if the path is a Zarr folder.
///
/// # Errors
/// Returns an [`Error::Io`] if it is a survey of MDIO version 0.
pub fn is_node(path: &Path) -> Result<bool> {
    if !path.is_dir() || !metadata::is_node(path) {
        return Ok(false);
    }
    let has_group = |name: &str| version_2::is_node(&path.join(name));
    if !path.join(NODE_FILE).is_file() && has_group("data") && has_group("metadata") {
        let problem = "is of MDIO version 0, which is not read";
        let remedy = "import the SEG-Y file again with multidimio 1, or convert it to SEG-Y with multidimio 0";
        return Err(file_error(path, problem, remedy));
    }
    Ok(true)
}

/// Opens an array, or the array of a group that is its image: the finest level of OME-Zarr, or else the
/// only array that can be an image.
///
/// # Errors
/// Returns an [`Error::Io`] if the metadata cannot be read, or if there is no such array or more
/// than one.
pub fn open(path: &Path) -> Result<ImageStream> {
    let (mut array, note) = match ZarrNode::open(path)? {
        ZarrNode::Group(attributes) => {
            let (array, note) = image_of_group(path, &attributes)?;
            (array, Some(note))
        }
        ZarrNode::Array(array) => (*array, None),
    };
    let folder = (array.folder.canonicalize()).map_err(|e| io_error(path, "open", e))?;
    let group = folder.parent().filter(|folder| metadata::is_node(folder));
    let level = ome::LevelMetadata::find(&array);
    if let Some(axes) = level.as_ref().map(ome::LevelMetadata::space_axes)
        && (2..=3).contains(&axes.len())
    {
        array.image_axes = axes;
    }
    let shape_text = format_shape(&array.shape);
    let [nz, ny, nx] = array
        .volume_shape()
        .filter(|dims| !dims.contains(&0))
        .ok_or_else(|| {
            let problem = format!(
                "holds {shape_text} elements, where 2 or 3 axes are needed (and others have one element)"
            );
            file_error(
                &array.folder,
                problem,
                "give another array, or a part of this one",
            )
        })?;
    let encoding = array.codecs.cell_codecs.encoding;
    let mut header = ImageHeader {
        encoding: format!("{encoding}{}", array.codecs.cell_codecs.compression_label()),
        notes: note.into_iter().collect(),
        ..ImageHeader::without_geometry(ImageFormat::Zarr, [nx, ny, nz], encoding, "Zarr")
    };
    placement::place(&mut header, &array, group, level.as_ref())?;
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

/// Returns the array of a group that is its image, and a note that names it.
fn image_of_group(group: &Path, attributes: &Map<String, Value>) -> Result<(ArrayMetadata, String)> {
    if let Some(level) = ome::finest_level(attributes) {
        let folder = group.join(&level.path);
        let array = match ZarrNode::open(&folder)? {
            ZarrNode::Array(array) => *array,
            ZarrNode::Group(attributes) => select_array(&folder, &attributes)?,
        };
        let name = level.path.display();
        let mut note = match level.count {
            1 => format!("the array {name}"),
            count => format!("the array {name}, the finest of {count} levels"),
        };
        if level.image_count > 1 {
            note += &format!(" of the first of {} images", level.image_count);
        }
        return Ok((array, note));
    }
    let mut images = images_below(group)?;
    if let (Some((name, attributes)), true) = (images.pop(), images.is_empty()) {
        let (array, note) = image_of_group(&group.join(&name), &attributes)?;
        return Ok((array, format!("{note} of the group {name}")));
    } else if !images.is_empty() {
        let names = images_below(group)?.into_iter().map(|(name, _)| name);
        let names: Vec<String> = names.collect();
        return Err(file_error(
            group,
            format!("holds several images: {}", names.join(", ")),
            &format!("give one of them, as in {}", group.join(&names[0]).display()),
        ));
    }
    let array = select_array(group, attributes)?;
    let name = array.folder.file_name().unwrap_or_default();
    let note = format!("the array {}", name.to_string_lossy());
    Ok((array, note))
}

/// Returns the groups of a group that have images of several resolutions, such as the series that
/// bioformats2raw writes: their names and attributes.
fn images_below(group: &Path) -> Result<Vec<(String, Map<String, Value>)>> {
    let has_levels = |folder: &PathBuf| match ZarrNode::open(folder) {
        Ok(ZarrNode::Group(attributes)) if ome::finest_level(&attributes).is_some() => {
            let name = folder.file_name()?.to_string_lossy().into_owned();
            Some((name, attributes))
        }
        _ => None,
    };
    Ok(nodes_in(group)?.iter().filter_map(has_levels).collect())
}

/// Returns the folders in a group that are nodes, in the order of their names.
fn nodes_in(group: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(group).map_err(|e| io_error(group, "read", e))?;
    let mut folders: Vec<_> = entries
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| metadata::is_node(path))
        .collect();
    folders.sort();
    Ok(folders)
}

/// Selects the array of a group that is an image: the default array that the group names, or else
/// the only one.
fn select_array(
    group: &Path,
    attributes: &Map<String, Value>,
) -> Result<ArrayMetadata> {
    let folders = nodes_in(group)?;
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
                && array.image_axes.len() >= axes
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

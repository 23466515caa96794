//! Writes an image as a Zarr group, with arrays that hold its coordinates. xarray opens the group
//! as a data set; the group of a survey has the arrays of MDIO.

use std::fs::{self, File};
use std::io::Write;
use std::path::Path;

use crate::parallel::prelude::*;
use serde_json::{Map, Value, json};

use super::metadata::NODE_FILE;
use super::placement::{GEOMETRY_ATTRIBUTE, POSITION_NAMES, TRACE_MASK};
use super::{blosc, lossless_type};
use crate::error::{Result, io_error};
use crate::files::Batch;
use crate::image::Geometry;
use crate::image::formats::StreamedImage;
use crate::image::formats::samples::SampleType;
use crate::units::{self, Quantity};

/// Number of samples of a chunk along each axis.
const CHUNK: usize = 64;

/// Writes an image as a folder of Zarr version 3, with chunks of 64 samples along each axis,
/// compressed with Blosc.
///
/// # Errors
/// Returns an [`crate::Error::Io`] if it cannot be written.
pub fn write<const D: usize>(path: &Path, image: &StreamedImage<'_, D>) -> Result<()> {
    let mut batch = Batch::default();
    batch.write_tree(path, NODE_FILE, |folder| write_arrays(path, folder, image))?;
    batch.commit()
}

fn write_arrays<const D: usize>(
    path: &Path,
    folder: &Path,
    image: &StreamedImage<'_, D>,
) -> Result<()> {
    let to_error = |error| io_error(path, "write", error);
    let names = axis_names(image.geometry);
    let name = match image.line_numbers {
        Some(_) => "amplitude",
        None => "samples",
    };
    let group = json!({
        "zarr_format": 3,
        "node_type": "group",
        "attributes": { "attributes": { "defaultVariableName": name } },
    });
    write_metadata(folder, &group).map_err(to_error)?;

    let shape: Vec<usize> = image.dims.iter().rev().copied().collect();
    let array = ArrayWriter {
        folder: folder.join(name),
        axis_names: names.iter().rev().cloned().collect(),
        chunk_shape: shape.iter().map(|&n| n.clamp(1, CHUNK)).collect(),
        shape,
        sample_type: lossless_type(image.sample_type),
    };
    let space = image.geometry.to_3d();
    let mut attributes = Map::new();
    attributes.insert(
        GEOMETRY_ATTRIBUTE.into(),
        json!({
            "about": "position = origin + sum of index[k] * axes[k], index of the fastest axis first",
            "origin": space.origin, "axes": space.axes, "names": space.names, "units": space.units,
        }),
    );
    let coordinate_names = write_coordinates(folder, image, &names).map_err(to_error)?;
    if !coordinate_names.is_empty() {
        attributes.insert("coordinates".into(), coordinate_names.join(" ").into());
    }
    array.create(Value::Object(attributes)).map_err(to_error)?;
    let mut first = 0;
    let result = image
        .slabs
        .for_each_slab(array.chunk_shape[0], &mut |slab| {
            let planes = slab.len() / array.plane_len().max(1);
            array.write_planes(first, planes, slab)?;
            first += planes;
            Ok(())
        });
    result.map_err(to_error)
}

/// Returns the quantity of a unit, if it is known.
fn quantity(unit: &str) -> Option<Quantity> {
    units::find(unit).map(|unit| unit.quantity)
}

/// Returns a different name for each axis, x first.
fn axis_names<const D: usize>(geometry: &Geometry<D>) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for k in 0..D {
        let unit = match geometry.axes[k].iter().position(|step| *step != 0.0) {
            Some(c) => &*geometry.units[c],
            None => "",
        };
        let name = match (&*geometry.names[k], unit) {
            // MDIO uses these names.
            ("sample", unit) => match quantity(unit) {
                Some(Quantity::Time) => "time",
                Some(Quantity::Length) => "depth",
                None => "sample",
            },
            (name, _) => name,
        };
        let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-');
        let clean: String = name.chars().filter(|c| is_plain(*c)).collect();
        let reserved = [
            TRACE_MASK,
            POSITION_NAMES[0],
            POSITION_NAMES[1],
            "amplitude",
            "samples",
        ];
        if clean.is_empty() || names.contains(&clean) || reserved.contains(&&*clean) {
            names.push(format!("axis_{k}"))
        } else {
            names.push(clean)
        }
    }
    names
}

/// Writes the coordinate arrays. Returns the names of those that do not belong to a single axis.
fn write_coordinates<const D: usize>(
    folder: &Path,
    image: &StreamedImage<'_, D>,
    names: &[String],
) -> std::io::Result<Vec<String>> {
    let geometry = image.geometry;
    for k in 0..D {
        let count = image.dims[k];
        let lines = match (&*names[k], image.line_numbers) {
            ("inline", Some([inlines, _])) => Some(inlines),
            ("crossline", Some([_, crosslines])) => Some(crosslines),
            _ => None,
        };
        let write_axis = |bytes: Vec<u8>, sample_type: SampleType, unit: &str| {
            let (name, axes) = (&names[k], &names[k..=k]);
            let array = single_chunk_array(folder, name, axes, vec![count], sample_type);
            array.write_single_chunk(&bytes, unit)
        };
        if let Some(lines) = lines {
            let numbers = (0..count as i64).map(|i| (lines.first + i * lines.step) as i32);
            let bytes = numbers.flat_map(i32::to_le_bytes).collect();
            write_axis(bytes, SampleType::I32, "")?;
            continue;
        }
        // The coordinate of an axis along one physical coordinate; depths and times are written as
        // positive numbers.
        let coordinates: Vec<usize> = (0..D).filter(|&c| geometry.axes[k][c] != 0.0).collect();
        let [c] = coordinates[..] else { continue };
        let downwards = matches!(&*names[k], "time" | "depth" | "sample" | "twt");
        let sign = if downwards && geometry.axes[k][c] < 0.0 {
            -1.0
        } else {
            1.0
        };
        let value = |i| 0.0 + sign * (geometry.origin[c] + i as f64 * geometry.axes[k][c]);
        let bytes = (0..count).flat_map(|i| f64::to_le_bytes(value(i)));
        write_axis(bytes.collect(), SampleType::F64, &geometry.units[c])?;
    }
    if image.line_numbers.is_none() || D < 3 {
        return Ok(Vec::new());
    }
    let [ny, nz] = [image.dims[1], image.dims[2]];
    let line_axes = [names[2].clone(), names[1].clone()];
    let mut written = Vec::new();
    for (c, name) in POSITION_NAMES.into_iter().enumerate() {
        let position = |row: usize| {
            let [inline, crossline] = [row / ny, row % ny].map(|i| i as f64);
            let offset = inline * geometry.axes[2][c] + crossline * geometry.axes[1][c];
            geometry.origin[c] + offset
        };
        let bytes: Vec<u8> = (0..ny * nz)
            .flat_map(|row| f64::to_le_bytes(position(row)))
            .collect();
        let array = single_chunk_array(folder, name, &line_axes, vec![nz, ny], SampleType::F64);
        array.write_single_chunk(&bytes, &geometry.units[c])?;
        written.push(name.to_string());
    }
    let is_live = |row: usize| u8::from(!image.missing.get(row).unwrap_or(&false));
    let bytes: Vec<u8> = (0..ny * nz).map(is_live).collect();
    single_chunk_array(
        folder,
        TRACE_MASK,
        &line_axes,
        vec![nz, ny],
        SampleType::Bool,
    )
    .write_single_chunk(&bytes, "")?;
    Ok(written)
}

/// Returns a writer of an array that is a single chunk.
fn single_chunk_array(
    folder: &Path,
    name: &str,
    axes: &[String],
    shape: Vec<usize>,
    sample: SampleType,
) -> ArrayWriter {
    ArrayWriter {
        folder: folder.join(name),
        axis_names: axes.to_vec(),
        chunk_shape: shape.iter().map(|&n| n.max(1)).collect(),
        shape,
        sample_type: sample,
    }
}

/// Writer of an array.
struct ArrayWriter {
    folder: std::path::PathBuf,
    axis_names: Vec<String>,
    shape: Vec<usize>,
    chunk_shape: Vec<usize>,
    sample_type: SampleType,
}

impl ArrayWriter {
    /// Creates the folder and the metadata.
    fn create(&self, attributes: Value) -> std::io::Result<()> {
        use SampleType::*;
        let (name, endian) = match self.sample_type {
            Bool => ("bool", None),
            I8 => ("int8", None),
            U8 => ("uint8", None),
            I16 => ("int16", Some("little")),
            U16 => ("uint16", Some("little")),
            I32 => ("int32", Some("little")),
            F16 => ("float16", Some("little")),
            F64 => ("float64", Some("little")),
            _ => ("float32", Some("little")),
        };
        let bytes = match endian {
            Some(endian) => json!({ "name": "bytes", "configuration": { "endian": endian } }),
            None => json!({ "name": "bytes" }),
        };
        let fill = match self.sample_type {
            Bool => json!(false),
            F16 | F32 | F64 => json!(0.0),
            _ => json!(0),
        };
        fs::create_dir(&self.folder)?;
        let array = json!({
            "zarr_format": 3,
            "node_type": "array",
            "shape": self.shape,
            "data_type": name,
            "chunk_grid": { "name": "regular", "configuration": { "chunk_shape": self.chunk_shape } },
            "chunk_key_encoding": { "name": "default", "configuration": { "separator": "/" } },
            "fill_value": fill,
            "codecs": [bytes, { "name": "blosc", "configuration": {
                "typesize": self.element_bytes(), "cname": "lz4", "clevel": 5, "shuffle": "shuffle", "blocksize": 0,
            } }],
            "attributes": attributes,
            "dimension_names": self.axis_names,
        });
        write_metadata(&self.folder, &array)
    }

    /// Returns the number of bytes of an element.
    fn element_bytes(&self) -> usize {
        use SampleType::*;
        match self.sample_type {
            Bool | I8 | U8 => 1,
            I16 | U16 | F16 => 2,
            F64 => 8,
            _ => 4,
        }
    }

    /// Writes the only chunk, and the metadata with its unit.
    fn write_single_chunk(&self, bytes: &[u8], unit: &str) -> std::io::Result<()> {
        let kind = match quantity(unit) {
            Some(Quantity::Time) => "time",
            _ => "length",
        };
        let units = match unit {
            "" => json!({}),
            unit => json!({ "units": unit, "unitsV1": { kind: unit } }),
        };
        self.create(units)?;
        self.write_chunk(&vec![0; self.shape.len()], bytes)
    }

    /// Returns the number of elements of a plane perpendicular to the slowest axis.
    fn plane_len(&self) -> usize {
        self.shape[1..].iter().product()
    }

    /// Writes the chunks of consecutive planes, which begin at a chunk boundary.
    fn write_planes(&self, first: usize, planes: usize, samples: &[f32]) -> std::io::Result<()> {
        // In 2-D the slowest axis is y, and the third axis has a single chunk.
        let (ny, nx, cy, cx) = match self.shape[..] {
            [_, ny, nx] => (ny, nx, self.chunk_shape[1], self.chunk_shape[2]),
            _ => (
                1,
                self.plane_len(),
                1,
                self.chunk_shape[self.chunk_shape.len() - 1],
            ),
        };
        let cz = self.chunk_shape[0];
        let [rows, columns] = [ny.div_ceil(cy), nx.div_ceil(cx)];
        let count = planes.div_ceil(cz) * rows * columns;
        (0..count).into_par_iter().try_for_each(|number| {
            let (z, rest) = (number / (rows * columns), number % (rows * columns));
            let (y, x) = (rest / columns, rest % columns);
            // A chunk that extends beyond the array is padded with zeros.
            let mut values = vec![0.0; cz * cy * cx];
            let width = cx.min(nx - x * cx);
            for k in 0..cz.min(planes - z * cz) {
                for j in 0..cy.min(ny - y * cy) {
                    let source = ((z * cz + k) * ny + y * cy + j) * nx + x * cx;
                    let target = (k * cy + j) * cx;
                    values[target..target + width]
                        .copy_from_slice(&samples[source..source + width]);
                }
            }
            // A chunk of zeros need not be written, because the fill value is zero.
            if values.iter().all(|v| v.to_bits() == 0) {
                return Ok(());
            }
            let bytes = self.encode(&values);
            match self.shape.len() {
                3 => self.write_chunk(&[first / cz + z, y, x], &bytes),
                _ => self.write_chunk(&[first / cz + z, x], &bytes),
            }
        })
    }

    /// Converts samples to bytes.
    fn encode(&self, samples: &[f32]) -> Vec<u8> {
        use SampleType::*;
        match self.sample_type {
            Bool => samples.iter().map(|v| u8::from(*v != 0.0)).collect(),
            I8 => samples.iter().map(|v| *v as i8 as u8).collect(),
            U8 => samples.iter().map(|v| *v as u8).collect(),
            I16 => samples
                .iter()
                .flat_map(|v| (*v as i16).to_le_bytes())
                .collect(),
            U16 => samples
                .iter()
                .flat_map(|v| (*v as u16).to_le_bytes())
                .collect(),
            F16 => samples
                .iter()
                .flat_map(|v| half::f16::from_f32(*v).to_le_bytes())
                .collect(),
            _ => samples.iter().flat_map(|v| v.to_le_bytes()).collect(),
        }
    }

    fn write_chunk(&self, chunk: &[usize], bytes: &[u8]) -> std::io::Result<()> {
        let mut path = self.folder.join("c");
        path.extend(chunk.iter().map(usize::to_string));
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        write_synced(&path, &blosc::compress(bytes, self.element_bytes()))
    }
}

/// Writes the metadata of a node.
fn write_metadata(folder: &Path, value: &Value) -> std::io::Result<()> {
    write_synced(&folder.join(NODE_FILE), format!("{value:#}\n").as_bytes())
}

/// Writes a file and flushes it to the disk.
fn write_synced(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

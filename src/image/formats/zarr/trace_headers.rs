//! Trace headers of MDIO: sample interval and time of the first sample, which its axis of whole numbers
//! does not hold.
//!
//! MDIO stores the trace headers of a SEG-Y file as records, one for each trace, in the array `headers`.
//! It cuts the numbers of its vertical axis off to whole ones, and begins them at 0 whatever the delay.

use std::path::Path;

use serde_json::{Value, json};

use super::metadata::{self, ArrayMetadata, NODE_FILE};
use crate::error::Result;
use crate::image::formats::samples::Endian;
use crate::image::formats::stream::PlaneReader;

/// Name of the array of trace headers.
const HEADERS: &str = "headers";

/// Intervals in depth are in thousandths of the unit, but some writers give whole units.
const MIN_THOUSANDTHS: f64 = 100.0;

/// Vertical sampling of a trace by its header.
pub struct VerticalSampling {
    /// Sample interval in thousandths of the axis' unit.
    thousandths: f64,
    /// Coordinate of the first sample.
    pub first: f64,
}

impl VerticalSampling {
    /// Returns the distance between samples along an axis of this name.
    pub fn step(&self, axis: &str) -> f64 {
        if axis == "depth" && self.thousandths < MIN_THOUSANDTHS {
            self.thousandths
        } else {
            self.thousandths / 1000.0
        }
    }

    /// Returns `true` if the numbers of an axis are those of this interval, cut off to whole numbers or
    /// not, from 0.
    pub fn fits(&self, axis: &[f64]) -> bool {
        let exact = |i: usize| i as f64 * self.thousandths / 1000.0;
        let is_near = |a: f64, b: f64| (a - b).abs() < 1e-6 * b.abs().max(1.0);
        let mut numbers = axis.iter().enumerate();
        numbers.all(|(i, &v)| is_near(v, exact(i)) || v == (exact(i) + 1e-9).trunc())
    }
}

/// Position and size of a field in a record.
struct Field {
    name: String,
    offset: usize,
    size: usize,
}

/// Returns the fields of a record and its size, or `None` if the data type is no record of integers and
/// floats.
fn record_fields(data_type: &Value) -> Option<(Vec<Field>, usize)> {
    let mut offset = 0;
    let mut fields = Vec::new();
    for field in data_type["configuration"]["fields"].as_array()? {
        // Both forms occur: objects, and pairs of name and type.
        let (name, kind) = match field {
            Value::Array(pair) => (pair.first()?, pair.get(1)?),
            _ => (&field["name"], &field["data_type"]),
        };
        let size = match kind.as_str()? {
            "int8" | "uint8" | "bool" => 1,
            "int16" | "uint16" | "float16" => 2,
            "int32" | "uint32" | "float32" => 4,
            "int64" | "uint64" | "float64" => 8,
            _ => return None,
        };
        let name = name.as_str()?.to_string();
        fields.push(Field { name, offset, size });
        offset += size;
    }
    Some((fields, offset))
}

/// Returns the metadata of an array of records as one of bytes, with an axis for the bytes of a record.
fn as_bytes(metadata: &Value, record_size: usize) -> Option<Value> {
    let longer = |counts: &Value| {
        let mut counts = counts.as_array()?.clone();
        counts.push(json!(record_size));
        Some(Value::Array(counts))
    };
    let mut bytes = metadata.clone();
    bytes["shape"] = longer(&metadata["shape"])?;
    bytes["data_type"] = json!("uint8");
    bytes["fill_value"] = json!(0);
    let chunk_shape = longer(&metadata["chunk_grid"]["configuration"]["chunk_shape"])?;
    bytes["chunk_grid"]["configuration"]["chunk_shape"] = chunk_shape;
    bytes["dimension_names"] = Value::Null;
    Some(bytes)
}

/// Reads the vertical sampling in the header of a trace of a group. `trace` is its index along each axis
/// of the survey. Returns `None` if the group has no trace headers with an interval.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if the headers cannot be read.
pub fn vertical_sampling(group: &Path, trace: &[usize]) -> Result<Option<VerticalSampling>> {
    let folder = group.join(HEADERS);
    if !folder.join(NODE_FILE).is_file() {
        return Ok(None);
    }
    let metadata = metadata::read_json(&folder.join(NODE_FILE))?;
    let Some((fields, size)) = record_fields(&metadata["data_type"]) else {
        return Ok(None);
    };
    let Some(array) = as_bytes(&metadata, size)
        .and_then(|value| ArrayMetadata::parse(&folder, &value, Default::default()).ok())
    else {
        return Ok(None);
    };
    let [plane, row] = match *trace {
        [row] => [0, row],
        [plane, row] => [plane, row],
        _ => return Ok(None),
    };
    let is_inside = array.shape.len() == trace.len() + 1
        && trace.iter().zip(&array.shape).all(|(index, n)| index < n);
    if !is_inside {
        return Ok(None);
    }
    let mut record = vec![0.0; size];
    array.read_rows(plane, row..row + 1, &mut record)?;
    let codecs = metadata["codecs"].as_array().into_iter().flatten();
    let is_big = codecs
        .filter(|codec| codec["name"] == "bytes")
        .any(|codec| codec["configuration"]["endian"] == "big");
    let endian = if is_big { Endian::Big } else { Endian::Little };
    let bytes: Vec<u8> = record.iter().map(|&value| value as u8).collect();
    let value = |names: &[&str]| -> Option<u64> {
        let field = fields.iter().find(|field| names.contains(&&*field.name))?;
        let mut bytes = bytes.get(field.offset..field.offset + field.size)?.to_vec();
        if endian == Endian::Little {
            bytes.reverse();
        }
        Some(bytes.iter().fold(0, |sum, &byte| sum << 8 | u64::from(byte)))
    };
    let signed = |name: &str| value(&[name]).map_or(0.0, |v| f64::from(v as u16 as i16));
    // Intervals above 32,767 us need the sign's bit.
    let interval = value(&["sample_interval", "samples_interval"]).map_or(0.0, |v| v as f64);
    let delay = signed("delay_recording_time");
    let first = match signed("times_scalar") {
        s if [1.0, 10.0, 100.0, 1000.0, 10000.0].contains(&s) => delay * s,
        s if [-1.0, -10.0, -100.0, -1000.0, -10000.0].contains(&s) => delay / -s,
        _ => delay,
    };
    Ok((interval > 0.0).then_some(VerticalSampling {
        thousandths: interval,
        first,
    }))
}

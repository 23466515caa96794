//! Writes NetCDF's classic format with 64-bit offsets (CDF-2) and at most one record. Every NetCDF
//! library since 3.6 reads it.
//!
//! A file has a header of dimensions, attributes and variables, big-endian, with names padded to 4
//! bytes. The values of each variable follow. Source: "NetCDF Classic Format Specification"
//! (Unidata).

use std::io::{self, Write};

use super::binary::LazyArray;

/// Maximum size of a variable in bytes.
pub const MAX_VARIABLE_BYTES: u64 = u32::MAX as u64 - 3;

/// Tags of the lists of dimensions, variables and attributes, and numbers of value types.
const DIMENSION_TAG: u32 = 10;
const VARIABLE_TAG: u32 = 11;
const ATTRIBUTE_TAG: u32 = 12;
const CHAR: u32 = 2;
const INT: u32 = 4;
const FLOAT: u32 = 5;
const DOUBLE: u32 = 6;

/// Value of an attribute.
pub enum NetcdfAttribute {
    /// Text.
    Text(String),
    /// Integer.
    Int(i32),
    /// Floating-point number.
    Float(f32),
}

/// Contents of a file.
#[derive(Default)]
pub struct NetcdfFile<'a> {
    /// Dimensions: name and length. Length 0 marks the record dimension, which has one record.
    pub dimensions: Vec<(String, usize)>,
    /// Attributes of the file.
    pub attributes: Vec<(String, NetcdfAttribute)>,
    /// Variables. Record variables come after the others.
    pub variables: Vec<NetcdfVariable<'a>>,
}

/// Array of numbers or text with named dimensions.
pub struct NetcdfVariable<'a> {
    /// Name of the variable.
    pub name: String,
    /// Names of its dimensions, the slowest first.
    pub dimensions: Vec<String>,
    /// Attributes of the variable.
    pub attributes: Vec<(String, NetcdfAttribute)>,
    /// Values: 32-bit integers, 64-bit floating-point numbers, or bytes of text.
    pub values: LazyArray<'a>,
}

impl<'a> NetcdfVariable<'a> {
    /// Creates a variable without attributes.
    pub fn new(name: impl Into<String>, dimensions: &[&str], values: LazyArray<'a>) -> Self {
        Self {
            name: name.into(),
            dimensions: dimensions.iter().map(|&name| name.into()).collect(),
            attributes: Vec::new(),
            values,
        }
    }

    /// Creates a variable from texts. Each text has `length` bytes and is filled with zeros. Longer
    /// texts are cut.
    pub fn from_texts(
        name: impl Into<String>,
        dimensions: &[&str],
        length: usize,
        texts: &[String],
    ) -> Self {
        let mut bytes = vec![0u8; texts.len() * length];
        for (row, text) in bytes.chunks_exact_mut(length).zip(texts) {
            let count = text.len().min(length - 1);
            row[..count].copy_from_slice(&text.as_bytes()[..count]);
        }
        let values = LazyArray::from_fn(bytes.len(), move |i| bytes[i]);
        Self::new(name, dimensions, values)
    }
}

/// Writes the file.
///
/// # Errors
/// Returns an error if `out` cannot be written, or if a variable names a dimension that does not
/// exist.
pub fn write(out: &mut impl Write, file: &NetcdfFile) -> io::Result<()> {
    // The length of the header does not depend on the offsets in it.
    let mut next = header(file, &vec![0; file.variables.len()])?.len() as u64;
    let mut offsets = Vec::with_capacity(file.variables.len());
    for variable in &file.variables {
        offsets.push(next);
        next += variable.values.byte_len().next_multiple_of(4);
    }
    out.write_all(&header(file, &offsets)?)?;
    for variable in &file.variables {
        variable.values.write_big_endian(out)?;
        let bytes = variable.values.byte_len();
        out.write_all(&[0; 4][..(bytes.next_multiple_of(4) - bytes) as usize])?;
    }
    Ok(())
}

fn header(file: &NetcdfFile, offsets: &[u64]) -> io::Result<Vec<u8>> {
    let mut bytes = b"CDF\x02".to_vec();
    let has_records = file.dimensions.iter().any(|(_, length)| *length == 0);
    push_int(&mut bytes, u32::from(has_records));
    push_list_header(&mut bytes, DIMENSION_TAG, file.dimensions.len());
    for (label, length) in &file.dimensions {
        push_name(&mut bytes, label);
        push_int(&mut bytes, *length as u32);
    }
    push_attributes(&mut bytes, &file.attributes);
    push_list_header(&mut bytes, VARIABLE_TAG, file.variables.len());
    for (variable, offset) in file.variables.iter().zip(offsets) {
        push_name(&mut bytes, &variable.name);
        push_int(&mut bytes, variable.dimensions.len() as u32);
        for dimension in &variable.dimensions {
            let number = file
                .dimensions
                .iter()
                .position(|(name, _)| name == dimension);
            let number =
                number.ok_or_else(|| io::Error::other(format!("no dimension {dimension}")))?;
            push_int(&mut bytes, number as u32);
        }
        push_attributes(&mut bytes, &variable.attributes);
        push_int(&mut bytes, type_number(variable.values.vtk_type));
        push_int(
            &mut bytes,
            variable.values.byte_len().next_multiple_of(4) as u32,
        );
        bytes.extend(offset.to_be_bytes());
    }
    Ok(bytes)
}

/// Returns NetCDF's number of the VTK type `kind`.
fn type_number(kind: &str) -> u32 {
    match kind {
        "UInt8" => CHAR,
        "Int32" => INT,
        _ => DOUBLE,
    }
}

fn push_int(bytes: &mut Vec<u8>, value: u32) {
    bytes.extend(value.to_be_bytes());
}

fn push_list_header(bytes: &mut Vec<u8>, tag: u32, length: usize) {
    push_int(bytes, if length == 0 { 0 } else { tag });
    push_int(bytes, length as u32);
}

fn push_name(bytes: &mut Vec<u8>, name: &str) {
    push_int(bytes, name.len() as u32);
    bytes.extend(name.as_bytes());
    bytes.resize(bytes.len().next_multiple_of(4), 0);
}

fn push_attributes(bytes: &mut Vec<u8>, attributes: &[(String, NetcdfAttribute)]) {
    push_list_header(bytes, ATTRIBUTE_TAG, attributes.len());
    for (label, value) in attributes {
        push_name(bytes, label);
        match value {
            NetcdfAttribute::Text(text) => {
                push_int(bytes, CHAR);
                push_name(bytes, text);
            }
            NetcdfAttribute::Int(value) => {
                push_int(bytes, INT);
                push_int(bytes, 1);
                bytes.extend(value.to_be_bytes());
            }
            NetcdfAttribute::Float(value) => {
                push_int(bytes, FLOAT);
                push_int(bytes, 1);
                bytes.extend(value.to_be_bytes());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_big_endian_at_the_header_offsets() {
        let dimensions = vec![("three".into(), 3), ("time".into(), 0)];
        let file = NetcdfFile {
            dimensions,
            attributes: vec![("title".into(), NetcdfAttribute::Text("a mesh".into()))],
            variables: vec![
                NetcdfVariable::from_texts("names", &["three"], 3, &["ab".into()]),
                NetcdfVariable::new(
                    "x",
                    &["time", "three"],
                    LazyArray::from_slice(&[1.5, -2.0, 3.0]),
                ),
            ],
        };
        let mut bytes = Vec::new();
        write(&mut bytes, &file).unwrap();
        let position = bytes.len() - 28;
        assert_eq!(&bytes[position..position + 4], b"ab\0\0");
        assert_eq!(bytes[position + 4..position + 12], 1.5f64.to_be_bytes());
        for offset in [position as u64, position as u64 + 4] {
            let offset = offset.to_be_bytes();
            assert_eq!(bytes.windows(8).filter(|w| *w == offset).count(), 1);
        }
        let variable = NetcdfVariable::new("y", &["four"], LazyArray::from_slice(&[1.0]));
        let file = NetcdfFile {
            variables: vec![variable],
            ..NetcdfFile::default()
        };
        assert!(write(&mut Vec::new(), &file).is_err());
    }
}

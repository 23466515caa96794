//! NetCDF's classic format with 64-bit offsets (CDF-2), written in one go: what every NetCDF library since
//! 3.6 reads. One record at most.
//!
//! Layout: "NetCDF Classic Format Specification" (Unidata): a header of dimensions, attributes and
//! variables, big endian, names padded to 4 bytes; then the numbers of each variable.

use std::io::{self, Write};

use super::binary::LazyArray;

/// The numbers of a variable may take so many bytes.
pub const MAX_VARIABLE_BYTES: u64 = u32::MAX as u64 - 3;

/// The words for a list of dimensions, of variables, of attributes.
const DIMENSION_TAG: u32 = 10;
const VARIABLE_TAG: u32 = 11;
const ATTRIBUTE_TAG: u32 = 12;
const CHAR: u32 = 2;
const INT: u32 = 4;
const FLOAT: u32 = 5;
const DOUBLE: u32 = 6;

/// What an attribute says.
pub enum NetcdfAttribute {
    /// A text.
    Text(String),
    /// A whole number.
    Int(i32),
    /// A number.
    Float(f32),
}

/// A file.
#[derive(Default)]
pub struct NetcdfFile<'a> {
    /// Dimensions by name; one of no length counts records, of which there is one.
    pub dimensions: Vec<(String, usize)>,
    /// What is said of the whole.
    pub attributes: Vec<(String, NetcdfAttribute)>,
    /// Variables; those of records come after the others.
    pub variables: Vec<NetcdfVariable<'a>>,
}

/// Numbers or text on some dimensions.
pub struct NetcdfVariable<'a> {
    /// Its name.
    pub name: String,
    /// Names of dimensions, the slowest first.
    pub dimensions: Vec<String>,
    /// What is said of it.
    pub attributes: Vec<(String, NetcdfAttribute)>,
    /// Whole numbers of 32 bits, numbers of 64, or bytes of text.
    pub values: LazyArray<'a>,
}

impl<'a> NetcdfVariable<'a> {
    /// Without attributes.
    pub fn new(name: impl Into<String>, on: &[&str], values: LazyArray<'a>) -> Self {
        Self {
            name: name.into(),
            dimensions: on.iter().map(|&name| name.into()).collect(),
            attributes: Vec::new(),
            values,
        }
    }

    /// Texts, each in `length` bytes, the last of which are 0.
    pub fn from_texts(
        name: impl Into<String>,
        on: &[&str],
        length: usize,
        texts: &[String],
    ) -> Self {
        let mut bytes = vec![0u8; texts.len() * length];
        for (row, text) in bytes.chunks_exact_mut(length).zip(texts) {
            let count = text.len().min(length - 1);
            row[..count].copy_from_slice(&text.as_bytes()[..count]);
        }
        let values = LazyArray::from_fn(bytes.len(), move |i| bytes[i]);
        Self::new(name, on, values)
    }
}

/// Writes the file.
///
/// # Errors
/// If `out` cannot be written, or a variable names a dimension that there is not.
pub fn write(out: &mut impl Write, file: &NetcdfFile) -> io::Result<()> {
    // The header's length does not depend on the offsets in it.
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
    let records = file.dimensions.iter().any(|(_, length)| *length == 0);
    push_int(&mut bytes, u32::from(records));
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
        for on in &variable.dimensions {
            let number = file.dimensions.iter().position(|(name, _)| name == on);
            let number = number.ok_or_else(|| io::Error::other(format!("no dimension {on}")))?;
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

/// NetCDF's number of the type that VTK calls `kind`.
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

fn push_list_header(bytes: &mut Vec<u8>, of: u32, length: usize) {
    push_int(bytes, if length == 0 { 0 } else { of });
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
    fn numbers_are_where_the_header_says_and_big_endian() {
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
        let at = bytes.len() - 28;
        assert_eq!(&bytes[at..at + 4], b"ab\0\0");
        assert_eq!(bytes[at + 4..at + 12], 1.5f64.to_be_bytes());
        for offset in [at as u64, at as u64 + 4] {
            let offset = offset.to_be_bytes();
            assert_eq!(bytes.windows(8).filter(|w| *w == offset).count(), 1);
        }
        let nowhere = NetcdfVariable::new("y", &["four"], LazyArray::from_slice(&[1.0]));
        let file = NetcdfFile {
            variables: vec![nowhere],
            ..NetcdfFile::default()
        };
        assert!(write(&mut Vec::new(), &file).is_err());
    }
}

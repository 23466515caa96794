//! NetCDF's classic format with 64-bit offsets (CDF-2), written in one go: what every NetCDF library since
//! 3.6 reads. One record at most.
//!
//! Layout: "NetCDF Classic Format Specification" (Unidata): a header of dimensions, attributes and
//! variables, big endian, names padded to 4 bytes; then the numbers of each variable.

use std::io::{self, Write};

use super::binary::Numbers;

/// The numbers of a variable may take so many bytes.
pub const MOST_BYTES: u64 = u32::MAX as u64 - 3;

/// The words for a list of dimensions, of variables, of attributes.
const DIMENSION: u32 = 10;
const VARIABLE: u32 = 11;
const ATTRIBUTE: u32 = 12;
const CHAR: u32 = 2;
const INT: u32 = 4;
const FLOAT: u32 = 5;
const DOUBLE: u32 = 6;

/// What an attribute says.
pub enum Attribute {
    /// A text.
    Text(String),
    /// A whole number.
    Int(i32),
    /// A number.
    Float(f32),
}

/// A file.
#[derive(Default)]
pub struct File<'a> {
    /// Dimensions by name; one of no length counts records, of which there is one.
    pub dimensions: Vec<(String, usize)>,
    /// What is said of the whole.
    pub attributes: Vec<(String, Attribute)>,
    /// Variables; those of records come after the others.
    pub variables: Vec<Variable<'a>>,
}

/// Numbers or text on some dimensions.
pub struct Variable<'a> {
    /// Its name.
    pub name: String,
    /// Names of dimensions, the slowest first.
    pub on: Vec<String>,
    /// What is said of it.
    pub attributes: Vec<(String, Attribute)>,
    /// Whole numbers of 32 bits, numbers of 64, or bytes of text.
    pub values: Numbers<'a>,
}

impl<'a> Variable<'a> {
    /// Without attributes.
    pub fn new(name: impl Into<String>, on: &[&str], values: Numbers<'a>) -> Self {
        Self {
            name: name.into(),
            on: on.iter().map(|&name| name.into()).collect(),
            attributes: Vec::new(),
            values,
        }
    }

    /// Texts, each in `length` bytes, the last of which are 0.
    pub fn texts(name: impl Into<String>, on: &[&str], length: usize, texts: &[String]) -> Self {
        let mut bytes = vec![0u8; texts.len() * length];
        for (row, text) in bytes.chunks_exact_mut(length).zip(texts) {
            let count = text.len().min(length - 1);
            row[..count].copy_from_slice(&text.as_bytes()[..count]);
        }
        let values = Numbers::computed(bytes.len(), move |i| bytes[i]);
        Self::new(name, on, values)
    }
}

/// Writes the file.
///
/// # Errors
/// If `out` cannot be written, or a variable names a dimension that there is not.
pub fn write(out: &mut impl Write, file: &File) -> io::Result<()> {
    // The header's length does not depend on the offsets in it.
    let mut next = header(file, &vec![0; file.variables.len()])?.len() as u64;
    let mut offsets = Vec::with_capacity(file.variables.len());
    for variable in &file.variables {
        offsets.push(next);
        next += variable.values.bytes().next_multiple_of(4);
    }
    out.write_all(&header(file, &offsets)?)?;
    for variable in &file.variables {
        variable.values.write_big_endian(out)?;
        let bytes = variable.values.bytes();
        out.write_all(&[0; 4][..(bytes.next_multiple_of(4) - bytes) as usize])?;
    }
    Ok(())
}

fn header(file: &File, offsets: &[u64]) -> io::Result<Vec<u8>> {
    let mut bytes = b"CDF\x02".to_vec();
    let records = file.dimensions.iter().any(|(_, length)| *length == 0);
    int(&mut bytes, u32::from(records));
    list(&mut bytes, DIMENSION, file.dimensions.len());
    for (label, length) in &file.dimensions {
        name(&mut bytes, label);
        int(&mut bytes, *length as u32);
    }
    attributes(&mut bytes, &file.attributes);
    list(&mut bytes, VARIABLE, file.variables.len());
    for (variable, offset) in file.variables.iter().zip(offsets) {
        name(&mut bytes, &variable.name);
        int(&mut bytes, variable.on.len() as u32);
        for on in &variable.on {
            let number = file.dimensions.iter().position(|(name, _)| name == on);
            let number = number.ok_or_else(|| io::Error::other(format!("no dimension {on}")))?;
            int(&mut bytes, number as u32);
        }
        attributes(&mut bytes, &variable.attributes);
        int(&mut bytes, kind(variable.values.kind));
        int(
            &mut bytes,
            variable.values.bytes().next_multiple_of(4) as u32,
        );
        bytes.extend(offset.to_be_bytes());
    }
    Ok(bytes)
}

/// NetCDF's number of the type that VTK calls `kind`.
fn kind(kind: &str) -> u32 {
    match kind {
        "UInt8" => CHAR,
        "Int32" => INT,
        _ => DOUBLE,
    }
}

fn int(bytes: &mut Vec<u8>, value: u32) {
    bytes.extend(value.to_be_bytes());
}

fn list(bytes: &mut Vec<u8>, of: u32, length: usize) {
    int(bytes, if length == 0 { 0 } else { of });
    int(bytes, length as u32);
}

fn name(bytes: &mut Vec<u8>, name: &str) {
    int(bytes, name.len() as u32);
    bytes.extend(name.as_bytes());
    bytes.resize(bytes.len().next_multiple_of(4), 0);
}

fn attributes(bytes: &mut Vec<u8>, attributes: &[(String, Attribute)]) {
    list(bytes, ATTRIBUTE, attributes.len());
    for (label, value) in attributes {
        name(bytes, label);
        match value {
            Attribute::Text(text) => {
                int(bytes, CHAR);
                name(bytes, text);
            }
            Attribute::Int(value) => {
                int(bytes, INT);
                int(bytes, 1);
                bytes.extend(value.to_be_bytes());
            }
            Attribute::Float(value) => {
                int(bytes, FLOAT);
                int(bytes, 1);
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
        let file = File {
            dimensions,
            attributes: vec![("title".into(), Attribute::Text("a mesh".into()))],
            variables: vec![
                Variable::texts("names", &["three"], 3, &["ab".into()]),
                Variable::new("x", &["time", "three"], Numbers::slice(&[1.5, -2.0, 3.0])),
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
        let nowhere = Variable::new("y", &["four"], Numbers::slice(&[1.0]));
        let file = File {
            variables: vec![nowhere],
            ..File::default()
        };
        assert!(write(&mut Vec::new(), &file).is_err());
    }
}

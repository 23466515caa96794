//! Writes MATLAB MAT-files, version 5, which MATLAB, Octave and SciPy read: structures, cell
//! arrays, text and matrices, without compression.
//!
//! All matrices are of class double. Their numbers may be stored in a smaller type, as MATLAB does.
//! Source: "MAT-File Format", The MathWorks, chapter 1.

use super::padded;
use std::io::{self, Write};
use std::path::Path;

use super::binary::LazyArray;
use crate::error::cause;
use crate::names::NameRules;
use crate::{Error, Result};

/// Value of a variable or a field.
pub enum MatValue<'a> {
    /// Matrix: number of rows, number of columns, and the values column by column.
    Matrix(usize, usize, LazyArray<'a>),
    /// Row of ASCII characters.
    Text(&'a str),
    /// Row of values.
    CellArray(Vec<MatValue<'a>>),
    /// Named values. Names have at most 31 characters.
    Struct(MatFields<'a>),
    /// Column of structures with the same field names.
    StructArray(Vec<MatFields<'a>>),
}

/// Named values.
pub type MatFields<'a> = Vec<(&'a str, MatValue<'a>)>;

/// Types of the elements of a file.
const INT8: u32 = 1;
const UINT16: u32 = 4;
const INT32: u32 = 5;
const UINT32: u32 = 6;
const MATRIX: u32 = 14;
/// Size of a field name in bytes.
const FIELD_NAME_BYTES: usize = 32;
/// Maximum size of a variable in bytes.
const MAX_VARIABLE_BYTES: u64 = (1 << 31) - 1;

impl<'a> MatValue<'a> {
    /// Creates a column of numbers.
    pub fn column(numbers: LazyArray<'a>) -> Self {
        Self::Matrix(numbers.len, 1, numbers)
    }

    /// Creates a single number.
    pub fn scalar(value: f64) -> Self {
        Self::column(LazyArray::from_fn(1, move |_| value))
    }

    fn array_class(&self) -> u32 {
        match self {
            Self::CellArray(_) => 1,
            Self::Struct(_) | Self::StructArray(_) => 2,
            Self::Text(_) => 4,
            Self::Matrix(..) => 6,
        }
    }

    fn dims(&self) -> [usize; 2] {
        match self {
            Self::Matrix(rows, columns, _) => [*rows, *columns],
            Self::Text(text) => [1, text.len()],
            Self::CellArray(values) => [1, values.len()],
            Self::Struct(_) => [1, 1],
            Self::StructArray(elements) => [elements.len(), 1],
        }
    }

    /// Returns the size of the element in bytes, without its tag.
    fn content_size(&self, name: &str) -> u64 {
        let head = 16 + 16 + 8 + padded(name.len() as u64);
        head + match self {
            Self::Matrix(_, _, numbers) => 8 + padded(numbers.byte_len()),
            Self::Text(text) => 8 + padded(2 * text.len() as u64),
            Self::CellArray(values) => values.iter().map(|value| 8 + value.content_size("")).sum(),
            Self::Struct(fields) => structs_size(std::slice::from_ref(fields)),
            Self::StructArray(elements) => structs_size(elements),
        }
    }

    fn write(&self, name: &str, out: &mut impl Write) -> io::Result<()> {
        tag(out, MATRIX, self.content_size(name))?;
        element(
            out,
            UINT32,
            &[self.array_class(), 0].map(u32::to_le_bytes).concat(),
        )?;
        let dims = self.dims().map(|n| (n as u32).to_le_bytes());
        element(out, INT32, &dims.concat())?;
        element(out, INT8, name.as_bytes())?;
        match self {
            Self::Matrix(_, _, numbers) => {
                tag(out, type_number(numbers.vtk_type), numbers.byte_len())?;
                numbers.write(out)?;
                pad(out, numbers.byte_len())
            }
            Self::Text(text) => {
                let letters: Vec<u8> = text.bytes().flat_map(|b| [b, 0]).collect();
                element(out, UINT16, &letters)
            }
            Self::CellArray(values) => values.iter().try_for_each(|value| value.write("", out)),
            Self::Struct(fields) => write_structs(std::slice::from_ref(fields), out),
            Self::StructArray(elements) => write_structs(elements, out),
        }
    }
}

/// Returns the size of the names and values of structures in bytes.
fn structs_size(elements: &[MatFields<'_>]) -> u64 {
    let names = 8 + padded((FIELD_NAME_BYTES * elements.first().map_or(0, Vec::len)) as u64);
    let values = elements
        .iter()
        .flatten()
        .map(|(_, value)| 8 + value.content_size(""));
    8 + names + values.sum::<u64>()
}

fn write_structs(elements: &[MatFields<'_>], out: &mut impl Write) -> io::Result<()> {
    // This element is packed with its tag, because readers such as Octave expect that here.
    out.write_all(&(INT32 | 4 << 16).to_le_bytes())?;
    out.write_all(&(FIELD_NAME_BYTES as u32).to_le_bytes())?;
    let fields = elements.first().map_or(&[][..], Vec::as_slice);
    let mut names = vec![0; FIELD_NAME_BYTES * fields.len()];
    for (slot, (name, _)) in names.chunks_mut(FIELD_NAME_BYTES).zip(fields) {
        slot[..name.len()].copy_from_slice(name.as_bytes());
    }
    element(out, INT8, &names)?;
    let mut values = elements.iter().flatten();
    values.try_for_each(|(_, value)| value.write("", out))
}

fn pad(out: &mut impl Write, bytes: u64) -> io::Result<()> {
    out.write_all(&[0; 8][..(padded(bytes) - bytes) as usize])
}

fn tag(out: &mut impl Write, kind: u32, bytes: u64) -> io::Result<()> {
    out.write_all(&kind.to_le_bytes())?;
    out.write_all(&(bytes as u32).to_le_bytes())
}

fn element(out: &mut impl Write, kind: u32, bytes: &[u8]) -> io::Result<()> {
    tag(out, kind, bytes.len() as u64)?;
    out.write_all(bytes)?;
    pad(out, bytes.len() as u64)
}

/// Returns the number of the VTK type `kind`.
fn type_number(kind: &str) -> u32 {
    match kind {
        "Int8" => INT8,
        "UInt8" => 2,
        "Int16" => 3,
        "UInt16" => UINT16,
        "Int32" => INT32,
        "UInt32" => UINT32,
        "Float32" => 7,
        "Int64" => 12,
        "UInt64" => 13,
        _ => 9,
    }
}

/// Rules of MATLAB for the names of fields and variables. Its keywords cannot be written after a dot.
pub const FIELD_NAMES: NameRules = NameRules {
    max_bytes: FIELD_NAME_BYTES - 1,
    distinct_bytes: FIELD_NAME_BYTES - 1,
    reserved: &[
        "break",
        "case",
        "catch",
        "classdef",
        "continue",
        "else",
        "elseif",
        "end",
        "for",
        "function",
        "global",
        "if",
        "otherwise",
        "parfor",
        "persistent",
        "return",
        "spmd",
        "switch",
        "try",
        "while",
    ],
    ..NameRules::IDENTIFIER
};

/// Checks that all variables fit, before any is written to the file at `path`.
///
/// # Errors
/// Returns [`Error::Export`] if a variable has 2 GiB or more, which the format cannot hold.
pub fn check(path: &Path, variables: &[(&str, MatValue)]) -> Result<()> {
    let is_too_large =
        |(name, value): &&(&str, MatValue)| value.content_size(name) > MAX_VARIABLE_BYTES;
    let Some((name, value)) = variables.iter().find(is_too_large) else {
        return Ok(());
    };
    let size = value.content_size(name) as f64 / f64::from(1 << 30);
    Err(Error::Export(cause(
        path.display(),
        format!(
            "would have a variable {name} of {size:.1} GiB, but MAT-files hold less than 2 GiB"
        ),
        "export a coarser mesh",
    )))
}

/// Writes the file.
///
/// # Errors
/// Returns an error if `out` cannot be written.
pub fn write(out: &mut impl Write, variables: &[(&str, MatValue)]) -> io::Result<()> {
    let mut head = [b' '; 128];
    let text = format!("MATLAB 5.0 MAT-file, atomesh {}", env!("CARGO_PKG_VERSION"));
    head[..text.len()].copy_from_slice(text.as_bytes());
    head[116..124].fill(0);
    head[124..].copy_from_slice(&[0, 1, b'I', b'M']);
    out.write_all(&head)?;
    variables
        .iter()
        .try_for_each(|(name, value)| value.write(name, out))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn computed_sizes_match_written_bytes() {
        let numbers = [1.0, 2.5, -3.0];
        let fields = vec![
            ("a", MatValue::column(LazyArray::from_slice(&numbers))),
            (
                "bytes",
                MatValue::Matrix(1, 5, LazyArray::from_fn(5, |i| i as u8)),
            ),
            (
                "none",
                MatValue::Matrix(0, 3, LazyArray::from_slice::<f64>(&[])),
            ),
            (
                "kind",
                MatValue::CellArray(vec![MatValue::Text("odd"), MatValue::scalar(7.0)]),
            ),
            (
                "all",
                MatValue::StructArray(vec![
                    vec![("name", MatValue::Text("one"))],
                    vec![("name", MatValue::Text("another"))],
                ]),
            ),
        ];
        let value = MatValue::Struct(fields);
        let mut bytes = Vec::new();
        value.write("G", &mut bytes).unwrap();
        assert_eq!(bytes.len() as u64, 8 + value.content_size("G"));
        assert!(bytes.len().is_multiple_of(8));
        check(Path::new("a.mat"), &[("G", value)]).unwrap();
        let large = MatValue::column(LazyArray::from_fn(1 << 28, |_| 0.0));
        let error = check(Path::new("a.mat"), &[("T", large)]).unwrap_err();
        assert!(
            error.to_string().contains("variable T of 2.0 GiB"),
            "{error}"
        );
    }

    #[test]
    fn names_follow_matlab_rules() {
        let is_valid = |name: &str| FIELD_NAMES.is_legal(name);
        assert!(is_valid("sw_2") && !is_valid("2_sw") && !is_valid("") && !is_valid("a-b"));
        assert!(!is_valid(&"a".repeat(FIELD_NAME_BYTES)));
    }
}

//! Reads NetCDF's classic formats (CDF-1, CDF-2, CDF-5), as far as Exodus files need them.
//!
//! Layout: "NetCDF Classic Format Specification" (Unidata): a header of dimensions, attributes and
//! variables, big-endian, with names padded to 4 bytes; then the numbers of each variable.

use super::{FileProblem, ReadResult};

/// The fixed-size variables of a file, and the first record of its record variables.
pub struct NetcdfReader<'a> {
    bytes: &'a [u8],
    variables: Vec<Variable>,
}

struct Variable {
    name: String,
    shape: Vec<usize>,
    attributes: Vec<(String, String)>,
    number_type: u32,
    offset: usize,
}

impl<'a> NetcdfReader<'a> {
    /// Reads the header.
    pub fn new(bytes: &'a [u8]) -> ReadResult<Self> {
        let version = bytes.get(3).copied().unwrap_or(0);
        if ![1, 2, 5].contains(&version) {
            return Err(FileProblem::damaged(format!(
                "has the unknown NetCDF version {version}"
            )));
        }
        let mut header = HeaderReader {
            bytes,
            position: 4,
            has_64_bit_counts: version == 5,
        };
        header.count()?;
        let mut dimensions = Vec::new();
        for _ in 0..header.list_length()? {
            header.name()?;
            dimensions.push(header.count()?);
        }
        header.attributes()?;
        let mut variables = Vec::new();
        for _ in 0..header.list_length()? {
            let name = header.name()?;
            let mut shape = Vec::new();
            for _ in 0..header.count()? {
                let dimension = dimensions.get(header.count()?);
                let dimension =
                    dimension.ok_or_else(|| FileProblem::damaged("lacks a dimension"))?;
                // Of a record dimension, only the first record is used.
                shape.push((*dimension).max(1));
            }
            let attributes = header.attributes()?;
            let kind = header.word()?;
            header.count()?;
            let begin = match version {
                1 => header.word()? as usize,
                _ => header.word_64()?,
            };
            variables.push(Variable {
                name,
                shape,
                attributes,
                number_type: kind,
                offset: begin,
            });
        }
        Ok(Self { bytes, variables })
    }

    fn variable(&self, name: &str) -> Option<&Variable> {
        self.variables.iter().find(|variable| variable.name == name)
    }

    /// Returns the length of a variable along each dimension.
    pub fn shape(&self, name: &str) -> Option<&[usize]> {
        Some(&self.variable(name)?.shape)
    }

    /// Returns a text attribute of a variable.
    pub fn attribute(&self, variable: &str, name: &str) -> Option<&str> {
        let mut attributes = self.variable(variable)?.attributes.iter();
        attributes.find_map(|(known, text)| (known == name).then_some(text.as_str()))
    }

    /// Returns the numbers of a variable; empty if there is no such variable.
    pub fn numbers(&self, name: &str) -> ReadResult<Vec<f64>> {
        let Some(variable) = self.variable(name) else {
            return Ok(Vec::new());
        };
        let width = number_size(variable.number_type)?;
        let bytes = self.variable_bytes(variable, width)?;
        let number = |b: &[u8]| match variable.number_type {
            3 => f64::from(i16::from_be_bytes([b[0], b[1]])),
            4 => f64::from(i32::from_be_bytes([b[0], b[1], b[2], b[3]])),
            5 => f64::from(f32::from_be_bytes([b[0], b[1], b[2], b[3]])),
            6 => f64::from_be_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]),
            10 => i64::from_be_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]) as f64,
            _ => f64::from(b[0]),
        };
        Ok(bytes.chunks_exact(width).map(number).collect())
    }

    /// Returns the texts of a character variable, one for each row.
    pub fn texts(&self, name: &str) -> ReadResult<Vec<String>> {
        let Some(variable) = self.variable(name).filter(|v| v.number_type == 2) else {
            return Ok(Vec::new());
        };
        let bytes = self.variable_bytes(variable, 1)?;
        let row = variable.shape.last().copied().unwrap_or(1).max(1);
        Ok(bytes.chunks(row).map(text).collect())
    }

    fn variable_bytes(&self, variable: &Variable, width: usize) -> ReadResult<&[u8]> {
        let count = variable
            .shape
            .iter()
            .try_fold(width, |total, n| total.checked_mul(*n));
        let end = count.and_then(|count| variable.offset.checked_add(count));
        let bytes = end.and_then(|end| self.bytes.get(variable.offset..end));
        bytes.ok_or_else(|| FileProblem::damaged(format!("is cut off in '{}'", variable.name)))
    }
}

/// Returns the size in bytes of a number type.
fn number_size(kind: u32) -> ReadResult<usize> {
    match kind {
        1 | 2 | 7 => Ok(1),
        3 | 8 => Ok(2),
        4 | 5 | 9 => Ok(4),
        6 | 10 | 11 => Ok(8),
        unknown => Err(FileProblem::damaged(format!(
            "has numbers of NetCDF's type {unknown}"
        ))),
    }
}

/// Returns the text before the first zero byte, trimmed.
fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().to_string()
}

struct HeaderReader<'a> {
    bytes: &'a [u8],
    position: usize,
    has_64_bit_counts: bool,
}

impl<'a> HeaderReader<'a> {
    fn take(&mut self, count: usize) -> ReadResult<&'a [u8]> {
        let end = self.position.checked_add(count);
        let bytes = end.and_then(|end| self.bytes.get(self.position..end));
        self.position = end.unwrap_or(self.position);
        bytes.ok_or_else(|| FileProblem::damaged("is cut off in its header"))
    }

    fn word(&mut self) -> ReadResult<u32> {
        let b = self.take(4)?;
        Ok(u32::from_be_bytes([b[0], b[1], b[2], b[3]]))
    }

    fn word_64(&mut self) -> ReadResult<usize> {
        let high = u64::from(self.word()?);
        Ok((high << 32 | u64::from(self.word()?)) as usize)
    }

    fn count(&mut self) -> ReadResult<usize> {
        if self.has_64_bit_counts {
            self.word_64()
        } else {
            Ok(self.word()? as usize)
        }
    }

    /// Reads the number of items of a list.
    fn list_length(&mut self) -> ReadResult<usize> {
        self.word()?;
        self.count()
    }

    fn padded_bytes(&mut self, count: usize) -> ReadResult<&'a [u8]> {
        let bytes = self.take(count)?;
        self.take(count.wrapping_neg() % 4)?;
        Ok(bytes)
    }

    fn name(&mut self) -> ReadResult<String> {
        let count = self.count()?;
        Ok(text(self.padded_bytes(count)?))
    }

    /// Reads a list of attributes, and returns those that are texts.
    fn attributes(&mut self) -> ReadResult<Vec<(String, String)>> {
        let mut attributes = Vec::new();
        for _ in 0..self.list_length()? {
            let name = self.name()?;
            let kind = self.word()?;
            let count = self.count()?;
            let length = count.checked_mul(number_size(kind)?);
            let bytes =
                self.padded_bytes(length.ok_or_else(|| FileProblem::damaged("is cut off"))?)?;
            if kind == 2 {
                attributes.push((name, text(bytes)));
            }
        }
        Ok(attributes)
    }
}

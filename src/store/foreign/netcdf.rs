//! NetCDF's classic formats (CDF-1, CDF-2, CDF-5), as far as Exodus needs them.
//!
//! Layout: "NetCDF Classic Format Specification" (Unidata): a header of dimensions, attributes and
//! variables, big endian, names padded to 4 bytes; then the numbers of each variable.

use super::{FileProblem, ReadResult};

/// The first record, and all that has none, of a file.
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
                "is of NetCDF's version {version}"
            )));
        }
        let mut head = HeaderReader {
            bytes,
            position: 4,
            has_64_bit_counts: version == 5,
        };
        head.count()?;
        let mut dimensions = Vec::new();
        for _ in 0..head.list_length()? {
            head.name()?;
            dimensions.push(head.count()?);
        }
        head.attributes()?;
        let mut variables = Vec::new();
        for _ in 0..head.list_length()? {
            let name = head.name()?;
            let mut shape = Vec::new();
            for _ in 0..head.count()? {
                let dimension = dimensions.get(head.count()?);
                let dimension =
                    dimension.ok_or_else(|| FileProblem::damaged("lacks a dimension"))?;
                // Of records the first.
                shape.push((*dimension).max(1));
            }
            let attributes = head.attributes()?;
            let kind = head.word()?;
            head.count()?;
            let begin = match version {
                1 => head.word()? as usize,
                _ => head.word_64()?,
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

    /// The length of a variable along each dimension.
    pub fn shape(&self, name: &str) -> Option<&[usize]> {
        Some(&self.variable(name)?.shape)
    }

    /// A text attribute of a variable.
    pub fn attribute(&self, variable: &str, name: &str) -> Option<&str> {
        let mut attributes = self.variable(variable)?.attributes.iter();
        attributes.find_map(|(known, text)| (known == name).then_some(text.as_str()))
    }

    /// The numbers of a variable; none if there is no such.
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

    /// The texts of a variable of characters, one in each row.
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
            .try_fold(width, |all, n| all.checked_mul(*n));
        let end = count.and_then(|count| variable.offset.checked_add(count));
        let bytes = end.and_then(|end| self.bytes.get(variable.offset..end));
        bytes.ok_or_else(|| FileProblem::damaged(format!("is cut off in '{}'", variable.name)))
    }
}

/// The bytes of a number of a type.
fn number_size(kind: u32) -> ReadResult<usize> {
    match kind {
        1 | 2 | 7 => Ok(1),
        3 | 8 => Ok(2),
        4 | 5 | 9 => Ok(4),
        6 | 10 | 11 => Ok(8),
        other => Err(FileProblem::damaged(format!(
            "has numbers of NetCDF's type {other}"
        ))),
    }
}

/// Up to the first zero, trimmed.
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
        match self.has_64_bit_counts {
            true => self.word_64(),
            false => Ok(self.word()? as usize),
        }
    }

    /// How many items a list has.
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

    /// Attributes, those that are texts with what they say.
    fn attributes(&mut self) -> ReadResult<Vec<(String, String)>> {
        let mut found = Vec::new();
        for _ in 0..self.list_length()? {
            let name = self.name()?;
            let kind = self.word()?;
            let count = self.count()?;
            let length = count.checked_mul(number_size(kind)?);
            let bytes =
                self.padded_bytes(length.ok_or_else(|| FileProblem::damaged("is cut off"))?)?;
            if kind == 2 {
                found.push((name, text(bytes)));
            }
        }
        Ok(found)
    }
}

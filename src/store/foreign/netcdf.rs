//! NetCDF's classic formats (CDF-1, CDF-2, CDF-5), as far as Exodus needs them.
//!
//! Layout: "NetCDF Classic Format Specification" (Unidata): a header of dimensions, attributes and
//! variables, big endian, names padded to 4 bytes; then the numbers of each variable.

use super::{Fault, Found};

/// The first record, and all that has none, of a file.
pub struct File<'a> {
    bytes: &'a [u8],
    variables: Vec<Variable>,
}

struct Variable {
    name: String,
    shape: Vec<usize>,
    attributes: Vec<(String, String)>,
    kind: u32,
    begin: usize,
}

impl<'a> File<'a> {
    /// Reads the header.
    pub fn new(bytes: &'a [u8]) -> Found<Self> {
        let version = bytes.get(3).copied().unwrap_or(0);
        if ![1, 2, 5].contains(&version) {
            return Err(Fault::damaged(format!("is of NetCDF's version {version}")));
        }
        let mut head = Head {
            bytes,
            place: 4,
            wide: version == 5,
        };
        head.count()?;
        let mut dimensions = Vec::new();
        for _ in 0..head.list()? {
            head.name()?;
            dimensions.push(head.count()?);
        }
        head.attributes()?;
        let mut variables = Vec::new();
        for _ in 0..head.list()? {
            let name = head.name()?;
            let mut shape = Vec::new();
            for _ in 0..head.count()? {
                let dimension = dimensions.get(head.count()?);
                let dimension = dimension.ok_or_else(|| Fault::damaged("lacks a dimension"))?;
                // Of records the first.
                shape.push((*dimension).max(1));
            }
            let attributes = head.attributes()?;
            let kind = head.word()?;
            head.count()?;
            let begin = match version {
                1 => head.word()? as usize,
                _ => head.long()?,
            };
            variables.push(Variable {
                name,
                shape,
                attributes,
                kind,
                begin,
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
    pub fn numbers(&self, name: &str) -> Found<Vec<f64>> {
        let Some(variable) = self.variable(name) else {
            return Ok(Vec::new());
        };
        let width = width(variable.kind)?;
        let bytes = self.content(variable, width)?;
        let number = |b: &[u8]| match variable.kind {
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
    pub fn texts(&self, name: &str) -> Found<Vec<String>> {
        let Some(variable) = self.variable(name).filter(|v| v.kind == 2) else {
            return Ok(Vec::new());
        };
        let bytes = self.content(variable, 1)?;
        let row = variable.shape.last().copied().unwrap_or(1).max(1);
        Ok(bytes.chunks(row).map(text).collect())
    }

    fn content(&self, variable: &Variable, width: usize) -> Found<&[u8]> {
        let count = variable
            .shape
            .iter()
            .try_fold(width, |all, n| all.checked_mul(*n));
        let end = count.and_then(|count| variable.begin.checked_add(count));
        let bytes = end.and_then(|end| self.bytes.get(variable.begin..end));
        bytes.ok_or_else(|| Fault::damaged(format!("is cut off in '{}'", variable.name)))
    }
}

/// The bytes of a number of a type.
fn width(kind: u32) -> Found<usize> {
    match kind {
        1 | 2 | 7 => Ok(1),
        3 | 8 => Ok(2),
        4 | 5 | 9 => Ok(4),
        6 | 10 | 11 => Ok(8),
        other => Err(Fault::damaged(format!(
            "has numbers of NetCDF's type {other}"
        ))),
    }
}

/// Up to the first zero, trimmed.
fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().to_string()
}

struct Head<'a> {
    bytes: &'a [u8],
    place: usize,
    wide: bool,
}

impl<'a> Head<'a> {
    fn take(&mut self, count: usize) -> Found<&'a [u8]> {
        let end = self.place.checked_add(count);
        let bytes = end.and_then(|end| self.bytes.get(self.place..end));
        self.place = end.unwrap_or(self.place);
        bytes.ok_or_else(|| Fault::damaged("is cut off in its header"))
    }

    fn word(&mut self) -> Found<u32> {
        let b = self.take(4)?;
        Ok(u32::from_be_bytes([b[0], b[1], b[2], b[3]]))
    }

    fn long(&mut self) -> Found<usize> {
        let high = u64::from(self.word()?);
        Ok((high << 32 | u64::from(self.word()?)) as usize)
    }

    fn count(&mut self) -> Found<usize> {
        match self.wide {
            true => self.long(),
            false => Ok(self.word()? as usize),
        }
    }

    /// How many items a list has.
    fn list(&mut self) -> Found<usize> {
        self.word()?;
        self.count()
    }

    fn padded(&mut self, count: usize) -> Found<&'a [u8]> {
        let bytes = self.take(count)?;
        self.take(count.wrapping_neg() % 4)?;
        Ok(bytes)
    }

    fn name(&mut self) -> Found<String> {
        let count = self.count()?;
        Ok(text(self.padded(count)?))
    }

    /// Attributes, those that are texts with what they say.
    fn attributes(&mut self) -> Found<Vec<(String, String)>> {
        let mut found = Vec::new();
        for _ in 0..self.list()? {
            let name = self.name()?;
            let kind = self.word()?;
            let count = self.count()?;
            let length = count.checked_mul(width(kind)?);
            let bytes = self.padded(length.ok_or_else(|| Fault::damaged("is cut off"))?)?;
            if kind == 2 {
                found.push((name, text(bytes)));
            }
        }
        Ok(found)
    }
}

//! Reads VTK files: the XML as a tree, and arrays on demand.

use std::path::{Path, PathBuf};

use crate::parallel::prelude::*;

use super::unpack::Compressor;
use super::xml::{self, Element};
use super::{DataArray, Values, legacy};
use crate::error::{Error, Result, cause, io_error};

/// A VTK XML file in memory. Arrays are decoded only when they are requested.
pub struct VtkFile {
    path: PathBuf,
    bytes: Vec<u8>,
    is_legacy: bool,
    root: Element,
    big_endian: bool,
    has_u64_headers: bool,
    compressor: Option<Compressor>,
}

impl VtkFile {
    /// Reads a file that holds VTK's data set `kind`, for example `UnstructuredGrid`, in XML or
    /// legacy format.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if the file cannot be read, is not a VTK file, or holds another data
    /// set.
    pub fn read(path: &Path, kind: &str) -> Result<Self> {
        Self::read_one_of(path, &[kind])
    }

    /// Reads a file that holds one of VTK's data sets `kinds`, as [`read`](Self::read) does.
    ///
    /// # Errors
    /// Returns the errors of [`read`](Self::read).
    pub fn read_one_of(path: &Path, kinds: &[&str]) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|e| io_error(path, "read", e))?;
        Self::from_bytes(path, bytes, kinds)
    }

    /// Reads the bytes of a file as [`read_one_of`](Self::read_one_of) does. `path` names it in errors.
    ///
    /// # Errors
    /// Returns the errors of [`read`](Self::read).
    pub fn from_bytes(path: &Path, bytes: Vec<u8>, kinds: &[&str]) -> Result<Self> {
        let file = Self {
            path: path.to_path_buf(),
            is_legacy: bytes.starts_with(legacy::MAGIC),
            bytes,
            root: Element::default(),
            big_endian: false,
            has_u64_headers: false,
            compressor: None,
        };
        file.parse(kinds)
    }

    /// Returns `true` if the file is in the legacy format.
    pub fn is_legacy(&self) -> bool {
        self.is_legacy
    }

    fn parse(mut self, kinds: &[&str]) -> Result<Self> {
        let kinds_text = kinds.join(" or ");
        let remedy = format!("give a VTK XML file of type {kinds_text}");
        if self.bytes.is_empty() {
            return Err(self.error("is empty", remedy));
        }
        if self.is_legacy {
            self.bytes = legacy::to_xml(&self.bytes)
                .map_err(|why| self.error(why, "write it as a VTK XML file"))?;
        }
        let start = &self.bytes[..self.bytes.len().min(4096)];
        if !start.windows(8).any(|w| w == b"<VTKFile") {
            return Err(self.error("is not a VTK XML file", remedy));
        }
        let root = xml::parse(&self.bytes).map_err(|why| {
            self.error(format!("is damaged: {why}"), crate::files::REWRITE_DAMAGED)
        })?;
        let found_kind = root.attribute("type").unwrap_or("nothing");
        let is_wanted = kinds.contains(&found_kind) && root.child(found_kind).is_some();
        if root.name != "VTKFile" || !is_wanted {
            return Err(self.error(format!("holds {found_kind}, not {kinds_text}"), remedy));
        }
        self.big_endian = root.attribute("byte_order") == Some("BigEndian");
        self.has_u64_headers = match root.attribute("header_type") {
            None | Some("UInt32") => false,
            Some("UInt64") => true,
            Some(other) => {
                let problem = format!("has headers of the unknown type {other}");
                return Err(self.error(problem, "write it with UInt64 headers"));
            }
        };
        self.compressor = match root.attribute("compressor") {
            None | Some("") => None,
            Some(name) => Some(Compressor::from_name(name).ok_or_else(|| {
                let problem = format!("is compressed with {name}, which is not read");
                self.error(problem, "write it with zlib compression, or none")
            })?),
        };
        self.root = root;
        Ok(self)
    }

    /// Returns the element of the data set.
    pub fn data_set(&self) -> &Element {
        // [`VtkFile::read`] has checked that the element exists.
        let kind = self.root.attribute("type").unwrap_or_default();
        self.root.child(kind).unwrap_or(&self.root)
    }

    /// Returns the only piece of the data set.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if there is no piece or more than one.
    pub fn piece(&self) -> Result<&Element> {
        let mut pieces = self
            .data_set()
            .children
            .iter()
            .filter(|c| c.name == "Piece");
        match (pieces.next(), pieces.count()) {
            (Some(piece), 0) => Ok(piece),
            (None, _) => Err(self.error("has no piece", crate::files::REWRITE_DAMAGED)),
            (_, more) => Err(self.error(
                format!("has {} pieces", more + 1),
                "merge them into one (ParaView: Merge Blocks)",
            )),
        }
    }

    /// Returns a child element that must exist.
    ///
    /// # Errors
    /// Returns [`Error::Io`] with the name of the element if it is missing.
    pub fn child<'e>(&self, element: &'e Element, name: &str) -> Result<&'e Element> {
        element
            .child(name)
            .ok_or_else(|| self.error(format!("has no {name}"), crate::files::REWRITE_DAMAGED))
    }

    /// Parses a required attribute that holds numbers separated by spaces.
    ///
    /// # Errors
    /// Returns [`Error::Io`] with the name of the attribute if it is missing or not such a list.
    pub fn parse_attribute<T: std::str::FromStr>(
        &self,
        element: &Element,
        name: &str,
    ) -> Result<Vec<T>> {
        let text = element.attribute(name);
        text.and_then(|text| {
            text.split_ascii_whitespace()
                .map(|w| w.parse().ok())
                .collect()
        })
        .ok_or_else(|| {
            let value = text.map_or("missing".to_string(), |t| format!("'{t}'"));
            let problem = format!("the attribute {name} of {} is {value}", element.name);
            self.error(problem, crate::files::REWRITE_DAMAGED)
        })
    }

    /// Decodes an array of numbers (element `DataArray`).
    ///
    /// # Errors
    /// Returns [`Error::Io`] with the name of the array and what is wrong with it.
    pub fn array(&self, element: &Element) -> Result<DataArray> {
        let name = element.attribute("Name").unwrap_or_default().to_string();
        let fault = |problem: String| {
            self.error(
                format!("array '{name}' {problem}"),
                crate::files::REWRITE_DAMAGED,
            )
        };
        let kind = element.attribute("type").unwrap_or_default();
        let components = match element.attribute("NumberOfComponents") {
            None => 1,
            Some(text) => text
                .trim()
                .parse()
                .map_err(|_| fault(format!("has '{text}' components")))?,
        };
        let unknown = || fault(format!("has the unknown type {kind}"));
        let values = if element.attribute("format") == Some("ascii") {
            let text = std::str::from_utf8(&self.bytes[element.text.clone()])
                .map_err(|_| fault("is not text".to_string()))?;
            Values::from_text(kind, text)
                .ok_or_else(unknown)?
                .map_err(|word| fault(format!("holds '{word}', which is not of type {kind}")))?
        } else {
            let bytes = self.decode(element).map_err(fault)?;
            Values::from_bytes(kind, &bytes, self.big_endian).ok_or_else(unknown)?
        };
        if components == 0 || values.len() % components != 0 {
            let problem = format!("has {} numbers in tuples of {components}", values.len());
            return Err(fault(problem));
        }
        Ok(DataArray {
            name,
            components,
            values,
        })
    }

    /// Decodes an array that holds one string (element `Array`, or a `DataArray` of characters).
    ///
    /// # Errors
    /// Returns [`Error::Io`] as [`array`](Self::array) does.
    pub fn text(&self, element: &Element) -> Result<String> {
        let name = element.attribute("Name").unwrap_or_default();
        let fault = |problem: String| {
            self.error(
                format!("array '{name}' {problem}"),
                crate::files::REWRITE_DAMAGED,
            )
        };
        let mut bytes = if element.attribute("format") == Some("ascii") {
            let text = String::from_utf8_lossy(&self.bytes[element.text.clone()]);
            text.split_ascii_whitespace()
                .map(|word| {
                    word.parse::<u8>()
                        .map_err(|_| fault(format!("holds '{word}', which is not a character")))
                })
                .collect::<Result<Vec<u8>>>()?
        } else {
            self.decode(element).map_err(fault)?
        };
        if bytes.last() == Some(&0) {
            bytes.pop();
        }
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }

    /// Creates an error about this file.
    pub fn error(&self, problem: impl std::fmt::Display, remedy: impl std::fmt::Display) -> Error {
        Error::Io(cause(self.path.display(), problem, remedy))
    }

    /// Returns the bytes of a binary or appended array, decoded and decompressed.
    fn decode(&self, element: &Element) -> std::result::Result<Vec<u8>, String> {
        let mut stream = match element.attribute("format") {
            Some("binary") => ByteStream::base64(&self.bytes[element.text.clone()]),
            Some("appended") => self.appended_stream(element)?,
            Some(other) => return Err(format!("has the unknown format {other}")),
            None => return Err("has no format".to_string()),
        };
        let Some(compressor) = self.compressor else {
            let size = self.read_header(&mut stream, 1)?[0];
            return stream.read_bytes(size);
        };
        let blocks = self.read_header(&mut stream, 1)?[0];
        let sizes = self.read_header(&mut stream, 2)?;
        let (block, last) = (sizes[0], sizes[1]);
        let packed_sizes = self.read_header(&mut stream, blocks)?;
        // The header and the blocks are separate base64 streams.
        stream.discard_padding();
        let packed: Vec<Vec<u8>> = packed_sizes
            .iter()
            .map(|&size| stream.read_bytes(size))
            .collect::<std::result::Result<_, _>>()?;
        let unpacked: Vec<Vec<u8>> = packed
            .into_par_iter()
            .enumerate()
            .map(|(i, bytes)| {
                let is_last = i + 1 == blocks && last > 0;
                compressor.unpack(&bytes, if is_last { last } else { block })
            })
            .collect::<std::result::Result<_, _>>()?;
        Ok(unpacked.concat())
    }

    fn read_header(
        &self,
        stream: &mut ByteStream,
        count: usize,
    ) -> std::result::Result<Vec<usize>, String> {
        let size = if self.has_u64_headers { 8 } else { 4 };
        let bytes = stream.read_bytes(
            count
                .checked_mul(size)
                .ok_or("is damaged: its header is too long")?,
        )?;
        let number = |b: &[u8]| {
            let append_byte = |n: u64, &byte: &u8| n << 8 | u64::from(byte);
            let value = if self.big_endian {
                b.iter().fold(0, append_byte)
            } else {
                b.iter().rev().fold(0, append_byte)
            };
            usize::try_from(value).unwrap_or(usize::MAX)
        };
        Ok(bytes.chunks_exact(size).map(number).collect())
    }

    /// Returns the stream of an appended array.
    fn appended_stream(&self, element: &Element) -> std::result::Result<ByteStream<'_>, String> {
        let data = self
            .root
            .child("AppendedData")
            .ok_or("is appended, but no data is")?;
        let bytes = &self.bytes[data.text.clone()];
        let blank = bytes.iter().take_while(|b| b.is_ascii_whitespace()).count();
        let bytes = bytes[blank..]
            .strip_prefix(b"_")
            .ok_or("is appended, but no '_' starts the data")?;
        let offset = element
            .attribute("offset")
            .and_then(|o| o.trim().parse::<usize>().ok());
        let offset = offset.ok_or("is appended, but at no offset")?;
        let bytes = bytes
            .get(offset..)
            .ok_or("is cut off: the file ends before it")?;
        Ok(match data.attribute("encoding") {
            Some("raw") => ByteStream::Raw(bytes),
            _ => ByteStream::base64(bytes),
        })
    }
}

/// The encoded bytes of an array: raw, or base64 in parts that may each end with padding.
enum ByteStream<'a> {
    Raw(&'a [u8]),
    Base64 { text: &'a [u8], decoded: Vec<u8> },
}

impl<'a> ByteStream<'a> {
    fn base64(text: &'a [u8]) -> Self {
        Self::Base64 {
            text,
            decoded: Vec::new(),
        }
    }

    /// Returns the next `count` bytes, or an error if there are fewer.
    fn read_bytes(&mut self, count: usize) -> std::result::Result<Vec<u8>, String> {
        let cut = || "is cut off or damaged: data is missing".to_string();
        match self {
            Self::Raw(bytes) => {
                let (taken, rest) = bytes.split_at_checked(count).ok_or_else(cut)?;
                *bytes = rest;
                Ok(taken.to_vec())
            }
            Self::Base64 { text, decoded } => {
                while decoded.len() < count {
                    let (bytes, rest) = decode_quad(text).ok_or_else(cut)?;
                    decoded.extend_from_slice(bytes.as_slice());
                    *text = rest;
                }
                let rest = decoded.split_off(count);
                Ok(std::mem::replace(decoded, rest))
            }
        }
    }

    /// Discards decoded bytes that have not been read, at the end of a base64 part.
    fn discard_padding(&mut self) {
        if let Self::Base64 { decoded, .. } = self {
            decoded.clear();
        }
    }
}

/// Decodes four base64 characters to one to three bytes. Returns also the text after them.
fn decode_quad(text: &[u8]) -> Option<(Bytes3, &[u8])> {
    let (mut word, mut digits, mut padding) = (0u32, 0, 0);
    for (i, &c) in text.iter().enumerate() {
        let digit = match c {
            b'A'..=b'Z' => c - b'A',
            b'a'..=b'z' => c - b'a' + 26,
            b'0'..=b'9' => c - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            b'=' if digits >= 2 => {
                padding += 1;
                0
            }
            c if c.is_ascii_whitespace() => continue,
            _ => return None,
        };
        word = word << 6 | u32::from(digit);
        digits += 1;
        if digits == 4 {
            let [_, a, b, c] = word.to_be_bytes();
            return Some((
                Bytes3 {
                    bytes: [a, b, c],
                    len: 3 - padding,
                },
                &text[i + 1..],
            ));
        }
    }
    None
}

struct Bytes3 {
    bytes: [u8; 3],
    len: usize,
}

impl Bytes3 {
    fn as_slice(&self) -> &[u8] {
        &self.bytes[..self.len]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_decodes_across_padding_and_white_space() {
        // The test vectors of RFC 4648, and two streams in a row.
        for (text, expected) in [
            ("Zg==", "f"),
            ("Zm8=", "fo"),
            ("Zm9v", "foo"),
            ("Zm9vYg==", "foob"),
            (" Zm9v\n YmFy ", "foobar"),
            ("Zg==Zm8=", "ffo"),
        ] {
            let mut stream = ByteStream::base64(text.as_bytes());
            assert_eq!(
                stream.read_bytes(expected.len()).unwrap(),
                expected.as_bytes(),
                "{text}"
            );
            assert!(stream.read_bytes(1).is_err(), "{text}");
        }
        for bad in ["Zm9", "Z===", "Zm9?", "=AAA"] {
            assert!(
                ByteStream::base64(bad.as_bytes()).read_bytes(3).is_err(),
                "{bad}"
            );
        }
    }
}

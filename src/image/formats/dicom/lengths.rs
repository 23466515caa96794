//! Lengths of elements, checked against the file before a parser allocates them.
//!
//! The elements of all sequences are visited one after another, without regard to their nesting. Source:
//! DICOM PS3.5, 7.1 (data elements), 7.5 (nesting) and A.4 (fragments).

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use flate2::read::DeflateDecoder;

use super::super::packed::{DAMAGED_REMEDY, file_error};
use super::HEAD_BYTES;
use crate::error::{Result, io_error};

/// A length that is not given: the value ends with a delimiter.
const UNDEFINED: u32 = u32::MAX;

/// Group of the elements that describe the file.
const META_GROUP: u16 = 2;

/// Group of items and delimiters.
const ITEM_GROUP: u16 = 0xfffe;

/// Value representations whose length has two bytes. That of others, also unknown ones, has four.
const SHORT_FORMS: [&[u8; 2]; 19] = [
    b"AE", b"AS", b"AT", b"CS", b"DA", b"DS", b"DT", b"FL", b"FD", b"IS", b"LO", b"LT", b"PN",
    b"SH", b"SL", b"SS", b"ST", b"TM", b"UI",
];

/// Further value representations whose length has two bytes.
const SHORT_NUMBERS: [&[u8; 2]; 2] = [b"UL", b"US"];

/// Encoding of elements.
#[derive(Clone, Copy)]
struct ElementForm {
    is_big_endian: bool,
    is_implicit: bool,
}

/// Bytes whose number may be unknown.
trait Source: Read {
    /// Passes over bytes. Returns `false` if there are fewer.
    fn pass(&mut self, count: u64) -> io::Result<bool>;
}

/// A file and its length.
struct FileSource {
    file: BufReader<File>,
    length: u64,
}

impl Read for FileSource {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.file.read(buffer)
    }
}

impl Source for FileSource {
    fn pass(&mut self, count: u64) -> io::Result<bool> {
        if count > self.length.saturating_sub(self.file.stream_position()?) {
            return Ok(false);
        }
        self.file.seek_relative(count as i64)?;
        Ok(true)
    }
}

impl<R: Read> Source for DeflateDecoder<R> {
    fn pass(&mut self, count: u64) -> io::Result<bool> {
        Ok(io::copy(&mut self.by_ref().take(count), &mut io::sink())? == count)
    }
}

/// Head of an element.
struct ElementHead {
    group: u16,
    element: u16,
    representation: [u8; 2],
    length: u32,
}

/// Reads the head of the next element; `None` at the end.
fn read_head(source: &mut dyn Source, form: ElementForm) -> io::Result<Option<ElementHead>> {
    let mut tag = [0; 4];
    let mut count = 0;
    while count < tag.len() {
        match source.read(&mut tag[count..])? {
            0 if count == 0 => return Ok(None),
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            n => count += n,
        }
    }
    let short = |bytes: [u8; 2]| {
        if form.is_big_endian {
            u16::from_be_bytes(bytes)
        } else {
            u16::from_le_bytes(bytes)
        }
    };
    let long = |bytes: [u8; 4]| {
        if form.is_big_endian {
            u32::from_be_bytes(bytes)
        } else {
            u32::from_le_bytes(bytes)
        }
    };
    let group = short([tag[0], tag[1]]);
    let mut next = [0; 4];
    source.read_exact(&mut next)?;
    let mut head = ElementHead {
        group,
        element: short([tag[2], tag[3]]),
        representation: [0; 2],
        length: long(next),
    };
    if group == ITEM_GROUP || form.is_implicit {
        return Ok(Some(head));
    }
    head.representation = [next[0], next[1]];
    let mut short_forms = SHORT_FORMS.iter().chain(&SHORT_NUMBERS);
    if short_forms.any(|known| **known == head.representation) {
        head.length = short([next[2], next[3]]).into();
    } else {
        source.read_exact(&mut next)?;
        head.length = long(next);
    }
    Ok(Some(head))
}

/// Visits all elements. Returns `false` if one is longer than what follows it.
fn are_within(source: &mut dyn Source, form: ElementForm) -> io::Result<bool> {
    // Items of compressed samples hold bytes, those of sequences hold elements.
    let mut in_fragments = false;
    while let Some(head) = read_head(source, form)? {
        if head.group == ITEM_GROUP {
            let is_fragment = in_fragments && head.element == 0xe000;
            if is_fragment && !source.pass(head.length.into())? {
                return Ok(false);
            }
            in_fragments &= head.element != 0xe0dd;
            continue;
        }
        match (&head.representation, head.length) {
            // Elements of unknown type follow in another form, up to a delimiter.
            (b"UN", UNDEFINED) => return Ok(true),
            (b"OB" | b"OW", UNDEFINED) => in_fragments = true,
            (b"SQ", _) => {}
            (_, UNDEFINED) if form.is_implicit => {}
            (_, length) => {
                if !source.pass(length.into())? {
                    return Ok(false);
                }
            }
        }
    }
    Ok(true)
}

/// Checks that no element of a file claims more bytes than the file has.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if one does, or if the file cannot be read.
pub(super) fn check_lengths(path: &Path) -> Result<()> {
    let failed = |e: io::Error| match e.kind() {
        io::ErrorKind::UnexpectedEof | io::ErrorKind::InvalidData | io::ErrorKind::InvalidInput => {
            file_error(path, "is not a complete DICOM file", DAMAGED_REMEDY)
        }
        _ => io_error(path, "read", e),
    };
    let file = File::open(path).map_err(|e| io_error(path, "open", e))?;
    let length = file
        .metadata()
        .map_err(|e| io_error(path, "open", e))?
        .len();
    let mut source = FileSource {
        file: BufReader::new(file),
        length,
    };
    if check_source(&mut source).map_err(failed)? {
        return Ok(());
    }
    let problem = "is cut off or damaged: an element is longer than the rest of the file";
    Err(file_error(path, problem, DAMAGED_REMEDY))
}

/// Visits the elements of a file, in the form that its first elements name.
fn check_source(source: &mut FileSource) -> io::Result<bool> {
    let meta = ElementForm {
        is_big_endian: false,
        is_implicit: false,
    };
    source.file.seek(SeekFrom::Start(HEAD_BYTES))?;
    let mut syntax = Vec::new();
    loop {
        let start = source.file.stream_position()?;
        let Some(head) = read_head(source, meta)? else {
            return Ok(true);
        };
        if head.group != META_GROUP {
            source.file.seek(SeekFrom::Start(start))?;
            break;
        }
        // The element that names the transfer syntax.
        if head.element == 0x0010 {
            let begin = source.file.stream_position()?;
            syntax.clear();
            (&mut source.file)
                .take(head.length.into())
                .read_to_end(&mut syntax)?;
            source.file.seek(SeekFrom::Start(begin))?;
        }
        if !source.pass(head.length.into())? {
            return Ok(false);
        }
    }
    let syntax = syntax.trim_ascii_end();
    let uid = syntax.strip_suffix(b"\0").unwrap_or(syntax);
    let form = ElementForm {
        is_big_endian: uid == b"1.2.840.10008.1.2.2",
        is_implicit: uid == b"1.2.840.10008.1.2",
    };
    if uid == b"1.2.840.10008.1.2.1.99" {
        return are_within(&mut DeflateDecoder::new(&mut source.file), form);
    }
    are_within(source, form)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a file in explicit little-endian form with one more element of this head.
    fn file(head: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0; 128];
        bytes.extend(b"DICM\x02\0\x10\0UI\x14\x001.2.840.10008.1.2.1\0");
        bytes.extend(b"\x08\0\x60\0CS\x02\0CT");
        bytes.extend(head);
        bytes
    }

    #[test]
    fn no_element_is_longer_than_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.dcm");
        let is_whole = |head: &[u8]| {
            std::fs::write(&path, file(head)).unwrap();
            check_lengths(&path).is_ok()
        };
        assert!(is_whole(b""));
        assert!(is_whole(b"\xe0\x7f\x10\0OW\0\0\x04\0\0\x001234"));
        assert!(!is_whole(b"\xe0\x7f\x10\0OW\0\0\x05\0\0\x001234"));
        assert!(!is_whole(b"\xe0\x7f\x10\0OW\0\0\xf0\xff\xff\xff1234"));
        // Within an item of a sequence, and as a fragment.
        let item = b"\x08\0\x40\x11SQ\0\0\xff\xff\xff\xff\xfe\xff\0\xe0\xff\xff\xff\xff";
        assert!(!is_whole(
            &[&item[..], b"\x08\0\x50\x11UT\0\0\xf0\xff\xff\xff"].concat()
        ));
        let fragments = b"\xe0\x7f\x10\0OB\0\0\xff\xff\xff\xff";
        assert!(is_whole(
            &[
                &fragments[..],
                b"\xfe\xff\0\xe0\0\0\0\0\xfe\xff\xdd\xe0\0\0\0\0"
            ]
            .concat()
        ));
        assert!(!is_whole(
            &[&fragments[..], b"\xfe\xff\0\xe0\xf0\xff\xff\xff"].concat()
        ));
    }
}

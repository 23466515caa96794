//! The file header: byte order, sample format, and position of the traces.
//!
//! Byte numbers in the comments count from 1 from the start of the file, as the standard does.

use std::fs::File;
use std::io;
use std::path::Path;

use super::bytes::TRACE_HEADER_BYTES;
use super::text::{self, TEXT_HEADER_BYTES};
use crate::error::{Error, Result, cause, io_error};
use crate::files::read_exact_at;
use crate::image::formats::packed::open_with_length;
use crate::image::formats::samples::{Encoding, Endian, SampleType};

/// Length in bytes of the textual and the binary header together: the minimum length of a SEG-Y
/// file.
pub const FILE_HEADER_BYTES: usize = TEXT_HEADER_BYTES + 400;

/// Constant of revision 2 in bytes 3297-3300, which shows the byte order.
const BYTE_ORDER_MARK: u32 = 0x0102_0304;

/// An open SEG-Y file and its layout.
pub struct SegyFile {
    pub file: File,
    pub encoding: Encoding,
    /// Major and minor revision.
    pub revision: (u8, u8),
    /// Lines of the textual header.
    pub text_lines: Vec<String>,
    /// Number of samples of every trace.
    pub samples_per_trace: usize,
    /// Sample interval of the file header in microseconds.
    pub interval_us: Option<f64>,
    /// `true` if lengths are in feet, `false` if they are in metres; `None` if the file does not
    /// say.
    pub lengths_in_feet: Option<bool>,
    /// Offset of the first trace in the file.
    pub traces_offset: u64,
    /// Bytes of the header or headers of each trace.
    pub trace_header_bytes: usize,
    /// Number of complete traces.
    pub trace_count: usize,
    /// Number of bytes after the last complete trace; not zero if the file is inconsistent.
    pub trailing_bytes: u64,
    pub notes: Vec<String>,
}

impl SegyFile {
    /// Returns the number of bytes of a trace, header and samples.
    pub fn trace_bytes(&self) -> u64 {
        (self.trace_header_bytes + self.samples_per_trace * self.encoding.size()) as u64
    }

    /// Opens a file and reads its headers.
    ///
    /// # Errors
    /// Returns an [`Error::Io`] if the file cannot be read or is not a supported SEG-Y file.
    pub fn open(path: &Path) -> Result<Self> {
        let refuse =
            |problem: String, remedy: &str| Error::Io(cause(path.display(), problem, remedy));
        let (file, length) = open_with_length(path)?;
        let header = read_header(path, &file, length)?;
        let (fields, sample) = BinaryHeader::parse(&header).map_err(|problem| {
            refuse(
                problem,
                "check that this is a SEG-Y file, or write it again as IBM or IEEE float (sample format 1 or 5)",
            )
        })?;
        let encoding = Encoding {
            sample_type: sample,
            endian: fields.endian,
        };
        let revision = fields.revision();
        // Old writers leave garbage in the fields of revision 2. These fields are therefore used
        // only in files of revision 2.
        let is_revision_2 = revision.0 == 2 || fields.has_byte_order_mark();
        let mut notes = Vec::new();

        let mut start = traces_start(path, &file, length, &fields, &mut notes)?;
        let mut end = length;
        if is_revision_2 {
            (start, end) = fields.trace_range(start, length);
        }
        let body = end - start;

        let fits = |samples: u32, header: usize| {
            let bytes = header as u64 + u64::from(samples) * encoding.size() as u64;
            samples > 0 && body >= bytes && body % bytes == 0
        };
        let declared = match fields.u32(3269) {
            n if is_revision_2 && n > 0 => n,
            _ => u32::from(fields.u16(3221)),
        };
        let trace_header = if is_revision_2 {
            let lengths = fields.trace_header_lengths();
            let length = lengths.into_iter().find(|&h| fits(declared, h));
            length.unwrap_or(lengths[0])
        } else {
            TRACE_HEADER_BYTES
        };
        let first_trace_samples = first_trace_sample_count(&file, start, length, fields.endian)
            .map_err(|e| io_error(path, "read", e))?;
        let samples = choose_sample_count(
            declared,
            first_trace_samples,
            |n| fits(n, trace_header),
            &mut notes,
        );
        if samples == 0 && body > 0 {
            let problem =
                "neither its file header nor its first trace gives the number of samples per trace";
            return Err(refuse(
                problem.into(),
                "set the number of samples (bytes 3221-3222) with a SEG-Y editor",
            ));
        }

        let bytes = trace_header as u64 + u64::from(samples) * encoding.size() as u64;
        Ok(Self {
            encoding,
            revision,
            text_lines: text::lines(&header[..TEXT_HEADER_BYTES]),
            samples_per_trace: samples as usize,
            interval_us: fields.interval_us(is_revision_2),
            lengths_in_feet: fields.lengths_in_feet(),
            traces_offset: start,
            trace_header_bytes: trace_header,
            trace_count: (body / bytes) as usize,
            trailing_bytes: body % bytes,
            notes,
            file,
        })
    }
}

/// Returns the textual and the binary header of a file of `length` bytes.
fn read_header(path: &Path, file: &File, length: u64) -> Result<Vec<u8>> {
    if length < FILE_HEADER_BYTES as u64 {
        let problem = format!(
            "is cut off: {length} bytes, where a SEG-Y header alone has {FILE_HEADER_BYTES}"
        );
        let error = cause(path.display(), problem, "copy it again");
        return Err(Error::Io(error));
    }
    let mut header = vec![0; FILE_HEADER_BYTES];
    read_exact_at(file, &mut header, 0).map_err(|e| io_error(path, "read", e))?;
    Ok(header)
}

/// Returns `true` if the first bytes of a file look like a SEG-Y header: text, then a plausible
/// sample format.
pub fn looks_like(head: &[u8]) -> bool {
    head.len() >= FILE_HEADER_BYTES
        && text::is_text(&head[..TEXT_HEADER_BYTES])
        && BinaryHeader::parse(head).is_ok()
}

/// Returns the number of samples per trace: that of the file header, or that of the first trace if
/// only this fits the length of the file.
fn choose_sample_count(
    declared: u32,
    first_trace_samples: u32,
    fits: impl Fn(u32) -> bool,
    notes: &mut Vec<String>,
) -> u32 {
    if !fits(declared) && (fits(first_trace_samples) || declared == 0) {
        if declared != first_trace_samples && first_trace_samples > 0 {
            notes.push(format!(
                "traces have {declared} samples by the file header and {first_trace_samples} by the first trace: {first_trace_samples} is used, as it fits the file's length"
            ));
        }
        return first_trace_samples;
    }
    if first_trace_samples > 0 && first_trace_samples != declared {
        notes.push(format!(
            "traces have {first_trace_samples} samples by the first trace and {declared} by the file header: {declared} is used"
        ));
    }
    declared
}

/// Returns the number of samples in the header of the first trace, or 0 if there is no trace.
fn first_trace_sample_count(
    file: &File,
    start: u64,
    length: u64,
    endian: Endian,
) -> io::Result<u32> {
    let mut bytes = [0; 2];
    if start + TRACE_HEADER_BYTES as u64 <= length {
        read_exact_at(file, &mut bytes, start + 114)?;
    }
    Ok(u32::from(match endian {
        Endian::Little => u16::from_le_bytes(bytes),
        Endian::Big => u16::from_be_bytes(bytes),
    }))
}

/// Returns the end of the textual headers of a file of `length` bytes, where its traces begin.
///
/// # Errors
/// Returns an [`Error::Io`] if the headers do not fit into the file, or if it cannot be read.
fn traces_start(
    path: &Path,
    file: &File,
    length: u64,
    fields: &BinaryHeader<'_>,
    notes: &mut Vec<String>,
) -> Result<u64> {
    let to_error = |e| io_error(path, "read", e);
    let mut declared = fields.i16(3505);
    if fields.revision().0 == 0 && !has_extended_text(file, length, declared).map_err(to_error)? {
        declared = 0;
    }
    let end = text_end(file, length, declared, notes).map_err(to_error)?;
    end.ok_or_else(|| {
        let problem = format!(
            "claims {declared} extended textual headers, which do not fit into its {length} bytes"
        );
        let remedy = "it is cut off or damaged: copy or write it again";
        Error::Io(cause(path.display(), problem, remedy))
    })
}

/// Returns `true` if extended textual headers, of which a file of revision 0 declares a number, exist: text
/// follows the binary header, and all of it fits into the file. Revision 0 has no such field, but some
/// programs write it.
fn has_extended_text(file: &File, length: u64, declared: i16) -> io::Result<bool> {
    let (start, block) = (FILE_HEADER_BYTES as u64, TEXT_HEADER_BYTES as u64);
    let count = u64::from(declared.max(1).unsigned_abs());
    if declared == 0 || start + count * block > length {
        return Ok(false);
    }
    let mut record = vec![0; TEXT_HEADER_BYTES];
    read_exact_at(file, &mut record, start)?;
    Ok(text::is_text(&record))
}

/// Returns the end of the textual headers. `declared` extended headers follow the binary header; if
/// `declared` is negative, headers follow up to an end stanza. Stanzas that were not declared are
/// skipped, too. Returns `None` if the headers do not fit into the file.
fn text_end(
    file: &File,
    length: u64,
    declared: i16,
    notes: &mut Vec<String>,
) -> io::Result<Option<u64>> {
    let block = TEXT_HEADER_BYTES as u64;
    let mut start = FILE_HEADER_BYTES as u64;
    let mut record = vec![0; TEXT_HEADER_BYTES];
    let mut read_stanza = |start: u64| -> io::Result<Option<String>> {
        if start + block > length {
            return Ok(None);
        }
        read_exact_at(file, &mut record, start)?;
        Ok(Some(text::decode(&record)))
    };
    if declared < 0 {
        while let Some(stanza) = read_stanza(start)? {
            start += block;
            let stanza: String = stanza.to_lowercase().split_whitespace().collect();
            if stanza.contains("((seg:endtext))") {
                return Ok(Some(start));
            }
        }
        return Ok(None);
    }
    start += declared as u64 * block;
    if start > length {
        return Ok(None);
    }
    while read_stanza(start)?.is_some_and(|stanza| stanza.starts_with("((")) {
        notes.push(
            "an extended textual header that the file header does not count is skipped".into(),
        );
        start += block;
    }
    Ok(Some(start))
}

/// Fields of the binary header.
struct BinaryHeader<'a> {
    bytes: &'a [u8],
    endian: Endian,
}

impl<'a> BinaryHeader<'a> {
    /// Determines the byte order and the sample type.
    fn parse(header: &'a [u8]) -> std::result::Result<(Self, SampleType), String> {
        let big = Self {
            bytes: header,
            endian: Endian::Big,
        };
        let little = Self {
            bytes: header,
            endian: Endian::Little,
        };
        // Byte 3225: at most one of the two orders gives a known code.
        let code = |fields: &Self| fields.u16(3225);
        let fields = match big.u32(3297) {
            BYTE_ORDER_MARK => big,
            mark if mark == BYTE_ORDER_MARK.swap_bytes() => little,
            0x0201_0403 => return Err("has its bytes swapped in pairs".into()),
            _ if (1..=16).contains(&code(&little)) => little,
            _ => big,
        };
        let sample =
            match code(&fields) {
                1 => SampleType::Ibm32,
                2 => SampleType::I32,
                3 => SampleType::I16,
                5 => SampleType::F32,
                6 => SampleType::F64,
                7 => SampleType::I24,
                8 => SampleType::I8,
                9 => SampleType::I64,
                10 => SampleType::U32,
                11 => SampleType::U16,
                12 => SampleType::U64,
                15 => SampleType::U24,
                16 => SampleType::U8,
                4 => return Err(
                    "has sample format 4 (fixed point with gain), which is obsolete and not read"
                        .into(),
                ),
                other => {
                    return Err(format!(
                        "has sample format {other} (bytes 3225-3226), which SEG-Y does not define"
                    ));
                }
            };
        Ok((fields, sample))
    }

    fn has_byte_order_mark(&self) -> bool {
        self.u32(3297) == BYTE_ORDER_MARK
    }

    /// Returns the major and the minor number of the revision. They are in bytes 3501 and 3502; some
    /// writers swap the two.
    fn revision(&self) -> (u8, u8) {
        match (self.bytes[3500], self.bytes[3501]) {
            (0, major @ 1..=2) => (major, 0),
            revision => revision,
        }
    }

    fn lengths_in_feet(&self) -> Option<bool> {
        match self.i16(3255) {
            1 => Some(false),
            2 => Some(true),
            _ => None,
        }
    }

    /// Returns the offsets of the first trace and of the end of the last one in a file of revision
    /// 2 of `length` bytes, whose traces begin at `start` unless the header says otherwise.
    fn trace_range(&self, mut start: u64, length: u64) -> (u64, u64) {
        let offset = self.u64(3521);
        if offset >= FILE_HEADER_BYTES as u64 && offset <= length {
            start = offset;
        }
        // Trailing stanzas are excluded, if their number is plausible.
        let trailer = u64::from(self.u32(3529)) * TEXT_HEADER_BYTES as u64;
        if trailer <= length - start {
            (start, length - trailer)
        } else {
            (start, length)
        }
    }

    /// Returns the numbers of bytes that the headers of a trace may have, those that the file states
    /// first. Revision 2.0 counts additional headers at 3507-3510, revision 2.1 at 3507-3508.
    fn trace_header_lengths(&self) -> [usize; 3] {
        let mut counts = [self.u16(3507), self.u16(3509), 0];
        counts.sort_by_key(|count| *count == 0);
        counts.map(|n| TRACE_HEADER_BYTES * (1 + usize::from(n)))
    }

    /// Returns the sample interval in microseconds, if it is given.
    fn interval_us(&self, is_revision_2: bool) -> Option<f64> {
        let extended = self.f64(3273);
        // Intervals above 32,767 us need the sign's bit.
        match f64::from(self.u16(3217)) {
            _ if is_revision_2 && extended.is_finite() && extended > 0.0 => Some(extended),
            dt if dt > 0.0 => Some(dt),
            _ => None,
        }
    }

    fn raw<const N: usize>(&self, byte: usize) -> [u8; N] {
        let mut raw: [u8; N] = std::array::from_fn(|i| self.bytes[byte - 1 + i]);
        if self.endian == Endian::Little {
            raw.reverse();
        }
        raw
    }

    fn u16(&self, byte: usize) -> u16 {
        u16::from_be_bytes(self.raw(byte))
    }

    fn i16(&self, byte: usize) -> i16 {
        i16::from_be_bytes(self.raw(byte))
    }

    fn u32(&self, byte: usize) -> u32 {
        u32::from_be_bytes(self.raw(byte))
    }

    fn u64(&self, byte: usize) -> u64 {
        u64::from_be_bytes(self.raw(byte))
    }

    fn f64(&self, byte: usize) -> f64 {
        f64::from_be_bytes(self.raw(byte))
    }
}

//! Fields of the headers of all traces, as columns.

use std::io;

use crate::parallel::prelude::*;

use super::bytes::TRACE_HEADER_BYTES;
use super::file_header::SegyFile;
use super::text;
use crate::files::read_exact_at;
use crate::image::formats::samples::Endian;

/// A field of a trace header: its first byte, counted from 1, and its number of bytes.
pub type HeaderField = (usize, usize);

/// Coordinates in trace header extension 1 of revision 2, with bytes counted on from the standard
/// header.
const EXTENSION_COORDINATES: [HeaderField; 2] =
    [(TRACE_HEADER_BYTES + 161, 8), (TRACE_HEADER_BYTES + 169, 8)];

/// Selected fields of every trace header, and the complete header of the first trace. The complete
/// headers of all traces would take as much memory as many an image.
pub struct TraceHeaders {
    /// The selected fields of all traces, one trace after the other.
    bytes: Vec<u8>,
    /// The selected fields, in the order in which they are stored.
    fields: Vec<HeaderField>,
    /// The standard header of the first trace, and its first additional header if there is one.
    first_header: Vec<u8>,
    endian: Endian,
}

impl TraceHeaders {
    /// Reads these fields of the headers of all traces.
    pub fn read(layout: &SegyFile, fields: &[HeaderField]) -> io::Result<Self> {
        const TRACES_PER_READ: usize = 256;
        let stride = layout.trace_header_bytes.min(2 * TRACE_HEADER_BYTES);
        let mut fields: Vec<HeaderField> = fields.to_vec();
        if stride == 2 * TRACE_HEADER_BYTES {
            fields.extend(EXTENSION_COORDINATES);
        }
        fields.sort_unstable();
        fields.dedup();
        let record_bytes: usize = fields.iter().map(|(_, width)| width).sum();
        let mut bytes = vec![0; layout.trace_count * record_bytes];
        let mut first = vec![0; if layout.trace_count > 0 { stride } else { 0 }];
        read_exact_at(&layout.file, &mut first, layout.traces_offset)?;
        let step = layout.trace_bytes();
        bytes
            .par_chunks_mut(TRACES_PER_READ * record_bytes)
            .enumerate()
            .try_for_each_init(
                || vec![0; stride],
                |header, (chunk, bytes)| {
                    for (i, record) in bytes.chunks_mut(record_bytes).enumerate() {
                        let trace = (chunk * TRACES_PER_READ + i) as u64;
                        read_exact_at(&layout.file, header, layout.traces_offset + trace * step)?;
                        let mut offset = 0;
                        for &(byte, width) in &fields {
                            record[offset..offset + width]
                                .copy_from_slice(&header[byte - 1..][..width]);
                            offset += width;
                        }
                    }
                    Ok::<_, io::Error>(())
                },
            )?;
        Ok(Self {
            bytes,
            fields,
            first_header: first,
            endian: layout.encoding.endian,
        })
    }

    /// Returns the field of `N` bytes at `byte` (from 1) of every trace, most significant byte
    /// first.
    fn values<const N: usize>(&self, byte: usize) -> impl Iterator<Item = [u8; N]> {
        let preceding = self.fields.iter().take_while(|field| **field != (byte, N));
        let offset: usize = preceding.map(|(_, width)| width).sum();
        let record_bytes: usize = self.fields.iter().map(|(_, width)| width).sum();
        assert!(
            offset + N <= record_bytes,
            "the field at byte {byte} was not read"
        );
        self.bytes
            .chunks(record_bytes)
            .map(move |fields| self.raw(&fields[offset..]))
    }

    /// Returns the first `N` bytes, most significant byte first.
    fn raw<const N: usize>(&self, bytes: &[u8]) -> [u8; N] {
        let mut raw: [u8; N] = std::array::from_fn(|i| bytes[i]);
        if self.endian == Endian::Little {
            raw.reverse();
        }
        raw
    }

    /// Returns the 4-byte integers at `byte` of all traces.
    pub fn i32s(&self, byte: usize) -> Vec<i32> {
        self.values(byte).map(i32::from_be_bytes).collect()
    }

    /// Returns the 2-byte integers at `byte` of all traces.
    pub fn i16s(&self, byte: usize) -> Vec<i16> {
        self.values(byte).map(i16::from_be_bytes).collect()
    }

    /// Returns a 2-byte integer of the first trace, whichever fields were read.
    pub fn first_i16(&self, byte: usize) -> i16 {
        i16::from_be_bytes(self.raw(&self.first_header[byte - 1..]))
    }

    /// Returns the first or second coordinate of all traces from trace header extension 1 of
    /// revision 2 (8-byte floats), or `None` if the traces have no such extension.
    pub fn extension_f64s(&self, coordinate: usize) -> Option<Vec<f64>> {
        let extension = self.first_header.get(TRACE_HEADER_BYTES..)?;
        let name = text::decode(extension.get(232..240)?);
        let (byte, _) = EXTENSION_COORDINATES[coordinate];
        (name == "SEG00001").then(|| self.values(byte).map(f64::from_be_bytes).collect())
    }
}

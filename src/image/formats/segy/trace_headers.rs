//! Fields of the headers of all traces, as columns.

use std::io;

use crate::parallel::prelude::*;

use super::bytes::TRACE_HEADER_BYTES;
use super::file_header::SegyFile;
use super::text;
use crate::files::read_exact_at;
use crate::image::formats::samples::Endian;

/// A field of a trace header: its first byte, from 1, and how many there are.
pub type HeaderField = (usize, usize);

/// Coordinates in revision 2's trace header extension 1, counted on from the standard header.
const EXTENSION_COORDINATES: [HeaderField; 2] =
    [(TRACE_HEADER_BYTES + 161, 8), (TRACE_HEADER_BYTES + 169, 8)];

/// Some fields of every trace header, and all of the first one: the rest of them would take as much memory
/// as many an image.
pub struct TraceHeaders {
    /// The fields of one trace after those of the other.
    bytes: Vec<u8>,
    /// Which fields these are, in order.
    fields: Vec<HeaderField>,
    /// The standard header of the first trace, and its first additional one if there is one.
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
        let kept: usize = fields.iter().map(|(_, width)| width).sum();
        let mut bytes = vec![0; layout.trace_count * kept];
        let mut first = vec![0; if layout.trace_count > 0 { stride } else { 0 }];
        read_exact_at(&layout.file, &mut first, layout.traces_offset)?;
        let step = layout.trace_bytes();
        bytes
            .par_chunks_mut(TRACES_PER_READ * kept)
            .enumerate()
            .try_for_each_init(
                || vec![0; stride],
                |header, (chunk, bytes)| {
                    for (i, kept) in bytes.chunks_mut(kept).enumerate() {
                        let trace = (chunk * TRACES_PER_READ + i) as u64;
                        read_exact_at(&layout.file, header, layout.traces_offset + trace * step)?;
                        let mut to = 0;
                        for &(byte, width) in &fields {
                            kept[to..to + width].copy_from_slice(&header[byte - 1..][..width]);
                            to += width;
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

    /// Field of `N` bytes at `byte` (from 1) of every trace, most significant byte first.
    fn values<const N: usize>(&self, byte: usize) -> impl Iterator<Item = [u8; N]> {
        let before = self.fields.iter().take_while(|field| **field != (byte, N));
        let at: usize = before.map(|(_, width)| width).sum();
        let kept: usize = self.fields.iter().map(|(_, width)| width).sum();
        assert!(at + N <= kept, "the field at byte {byte} was not read");
        self.bytes
            .chunks(kept)
            .map(move |fields| self.raw(&fields[at..]))
    }

    /// Some bytes, the most significant one first.
    fn raw<const N: usize>(&self, bytes: &[u8]) -> [u8; N] {
        let mut raw: [u8; N] = std::array::from_fn(|i| bytes[i]);
        if self.endian == Endian::Little {
            raw.reverse();
        }
        raw
    }

    /// 4-byte integers.
    pub fn i32s(&self, byte: usize) -> Vec<i32> {
        self.values(byte).map(i32::from_be_bytes).collect()
    }

    /// 2-byte integers.
    pub fn i16s(&self, byte: usize) -> Vec<i16> {
        self.values(byte).map(i16::from_be_bytes).collect()
    }

    /// A 2-byte integer of the first trace, whichever fields were read.
    pub fn first_i16(&self, byte: usize) -> i16 {
        i16::from_be_bytes(self.raw(&self.first_header[byte - 1..]))
    }

    /// 8-byte floats of revision 2's trace header extension 1: the first or the second coordinate; `None` if
    /// the traces have none.
    pub fn extension_f64s(&self, coordinate: usize) -> Option<Vec<f64>> {
        let extension = self.first_header.get(TRACE_HEADER_BYTES..)?;
        let name = text::decode(extension.get(232..240)?);
        let (byte, _) = EXTENSION_COORDINATES[coordinate];
        (name == "SEG00001").then(|| self.values(byte).map(f64::from_be_bytes).collect())
    }
}

//! The headers of all traces, as columns.

use std::io;

use rayon::prelude::*;

use super::bytes::TRACE_HEADER;
use super::header::Layout;
use super::text;
use crate::files::read_exact_at;
use crate::image::formats::samples::Endian;

/// Raw trace headers, one after the other.
pub struct Headers {
    bytes: Vec<u8>,
    /// Bytes kept of each trace: its standard header, and the first additional one if there is one.
    stride: usize,
    endian: Endian,
}

impl Headers {
    /// Reads the headers of all traces, and nothing else.
    pub fn read(layout: &Layout) -> io::Result<Self> {
        const TRACES: usize = 256;
        let stride = layout.trace_header.min(2 * TRACE_HEADER);
        let mut bytes = vec![0; layout.traces * stride];
        let step = layout.trace_bytes();
        bytes
            .par_chunks_mut(TRACES * stride)
            .enumerate()
            .try_for_each(|(chunk, bytes)| {
                for (i, header) in bytes.chunks_mut(stride).enumerate() {
                    let trace = (chunk * TRACES + i) as u64;
                    read_exact_at(&layout.file, header, layout.start + trace * step)?;
                }
                Ok::<_, io::Error>(())
            })?;
        Ok(Self {
            bytes,
            stride,
            endian: layout.encoding.endian,
        })
    }

    /// Field of `N` bytes at `byte` (from 1) of every trace, most significant byte first.
    fn fields<const N: usize>(&self, byte: usize) -> impl Iterator<Item = [u8; N]> {
        self.bytes.chunks(self.stride).map(move |header| {
            let mut raw: [u8; N] = std::array::from_fn(|i| header[byte - 1 + i]);
            if self.endian == Endian::Little {
                raw.reverse();
            }
            raw
        })
    }

    /// 4-byte integers.
    pub fn i32s(&self, byte: usize) -> Vec<i32> {
        self.fields(byte).map(i32::from_be_bytes).collect()
    }

    /// 2-byte integers.
    pub fn i16s(&self, byte: usize) -> Vec<i16> {
        self.fields(byte).map(i16::from_be_bytes).collect()
    }

    /// 8-byte floats of revision 2's trace header extension 1; `None` if the traces have none.
    pub fn extension_f64s(&self, byte: usize) -> Option<Vec<f64>> {
        let extension = self.bytes.get(TRACE_HEADER..self.stride)?;
        let name = text::decode(extension.get(232..240)?);
        (name == "SEG00001").then(|| {
            self.fields(TRACE_HEADER + byte)
                .map(f64::from_be_bytes)
                .collect()
        })
    }
}

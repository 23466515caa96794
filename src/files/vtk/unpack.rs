//! Decompresses blocks of arrays that VTK's compressors have written.

use std::io::{self, Write};

use flate2::{Decompress, FlushDecompress, Status};

/// The compression method of a file's arrays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Compressor {
    Zlib,
    Lz4,
    Lzma,
}

impl Compressor {
    /// Returns the method that VTK calls `name`.
    pub(super) fn from_name(name: &str) -> Option<Self> {
        match name {
            "vtkZLibDataCompressor" => Some(Self::Zlib),
            "vtkLZ4DataCompressor" => Some(Self::Lz4),
            "vtkLZMADataCompressor" => Some(Self::Lzma),
            _ => None,
        }
    }

    /// Returns the largest possible ratio of unpacked to packed size, so that a wrong header cannot
    /// make the reader allocate all memory. There is no useful bound for LZMA; its buffer grows as
    /// it is filled.
    fn max_ratio(self) -> usize {
        match self {
            Self::Zlib => 1032,
            Self::Lz4 => 255,
            Self::Lzma => usize::MAX,
        }
    }

    /// Unpacks a block, which must give exactly `size` bytes.
    ///
    /// # Errors
    /// Returns a text that says what is wrong with the block.
    pub(super) fn unpack(self, packed: &[u8], size: usize) -> Result<Vec<u8>, String> {
        if size > packed.len().saturating_mul(self.max_ratio()) {
            return Err("is damaged: a block is larger than its data can be".to_string());
        }
        let bytes = match self {
            Self::Zlib => inflate(packed, size),
            Self::Lz4 => lz4_flex::block::decompress(packed, size).ok(),
            Self::Lzma => {
                let mut bytes = BoundedBuffer {
                    bytes: Vec::new(),
                    max_len: size,
                };
                let result = lzma_rs::xz_decompress(&mut &*packed, &mut bytes);
                result.is_ok().then_some(bytes.bytes)
            }
        };
        bytes
            .filter(|bytes| bytes.len() == size)
            .ok_or_else(|| "is damaged: a block does not decompress".to_string())
    }
}

fn inflate(packed: &[u8], size: usize) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(size);
    let status = Decompress::new(true).decompress_vec(packed, &mut bytes, FlushDecompress::Finish);
    matches!(status, Ok(Status::StreamEnd)).then_some(bytes)
}

/// A buffer that accepts at most `max_len` bytes.
struct BoundedBuffer {
    bytes: Vec<u8>,
    max_len: usize,
}

impl Write for BoundedBuffer {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if bytes.len() > self.max_len - self.bytes.len() {
            return Err(io::ErrorKind::FileTooLarge.into());
        }
        self.bytes.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_that_lies_about_its_size_is_refused() {
        let text = b"the same, the same, the same, the same";
        let mut xz = Vec::new();
        lzma_rs::xz_compress(&mut &text[..], &mut xz).unwrap();
        // Literals only: the token's high half and the byte after it hold their length.
        let mut lz4 = vec![0xf0, text.len() as u8 - 15];
        lz4.extend(text);
        let mut zlib = Vec::with_capacity(100);
        flate2::Compress::new(flate2::Compression::fast(), true)
            .compress_vec(text, &mut zlib, flate2::FlushCompress::Finish)
            .unwrap();
        for (compressor, packed) in [
            (Compressor::Zlib, zlib),
            (Compressor::Lz4, lz4),
            (Compressor::Lzma, xz),
        ] {
            let unpack = |packed: &[u8], size| compressor.unpack(packed, size);
            assert_eq!(unpack(&packed, text.len()).unwrap(), text, "{compressor:?}");
            for size in [0, text.len() - 1, text.len() + 1, usize::MAX] {
                assert!(unpack(&packed, size).is_err(), "{compressor:?} {size}");
            }
            for end in 0..packed.len() / 2 {
                assert!(
                    unpack(&packed[..end], text.len()).is_err(),
                    "{compressor:?}"
                );
            }
        }
    }
}

//! Decodes the bytes of a chunk to those of its elements.
//!
//! The codec chain of an array converts elements to bytes in either byte order, may transpose axes,
//! and compresses the bytes. With sharding a file holds many such chunks and their index.

use std::io::Read;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use flate2::bufread::{MultiGzDecoder, ZlibDecoder};
use serde_json::Value;

use super::blosc;
use super::metadata::{checked_product, parse_counts};
use crate::geometry::sorted;
use crate::image::formats::samples::{Encoding, Endian, SampleType};

/// Description of a problem with a chunk or with the metadata of chunks.
pub type CodecError = String;

/// Codecs of an array.
pub struct Codecs {
    /// Codecs of the cells that are read one by one: the chunks, or the inner chunks of shards.
    pub cell_codecs: CodecChain,
    /// Number of elements of a cell along each axis.
    pub cell_shape: Vec<usize>,
    /// Layout of the cells in shard files; `None` if each cell has its own file.
    pub shard: Option<Shard>,
}

/// Layout of a file that holds several cells.
pub struct Shard {
    /// Number of cells along each axis.
    pub cell_counts: Vec<usize>,
    /// `true` if the index is at the end of the file, `false` if it is at the beginning.
    pub is_index_at_end: bool,
    /// Codecs of the index. They keep its length.
    pub index_codecs: CodecChain,
    /// Decoded indices of the shard files that were read last, the latest first.
    pub recent_indices: Mutex<Vec<(PathBuf, Arc<Vec<u8>>)>>,
}

impl Shard {
    /// Returns the number of bytes of the index in the file.
    pub fn index_bytes(&self) -> usize {
        let sums = self.index_codecs.byte_codecs.len();
        16 * self.cell_counts.iter().product::<usize>() + CHECKSUM_BYTES * sums
    }
}

/// Length of a checksum in bytes.
const CHECKSUM_BYTES: usize = 4;

/// Codecs that are applied to the elements of a cell.
pub struct CodecChain {
    /// Axis of the cell for each stored axis; empty if the order is the same.
    axis_order: Vec<usize>,
    /// Encoding of an element.
    pub encoding: Encoding,
    /// Codecs that are applied to the bytes, the last one first.
    byte_codecs: Vec<ByteCodec>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum ByteCodec {
    Gzip,
    Zlib,
    Zstd,
    Blosc,
    Lz4,
    Crc32c,
}

impl Codecs {
    /// Parses the codecs in the metadata of an array with chunks of shape `chunk`.
    ///
    /// # Errors
    /// Returns a message if a codec is not supported or the metadata are invalid.
    pub fn parse(value: &Value, chunk: &[usize], sample: SampleType) -> Result<Self, CodecError> {
        let list = value.as_array().ok_or("has no codecs")?;
        let Some(sharding_index) = list
            .iter()
            .position(|codec| codec_name(codec) == "sharding_indexed")
        else {
            return Ok(Self {
                cell_codecs: CodecChain::parse(list, chunk.len(), sample)?,
                cell_shape: chunk.to_vec(),
                shard: None,
            });
        };
        if list.len() != 1 {
            return Err(format!(
                "has shards within other codecs ({}), which are not read",
                codec_name(&list[usize::from(sharding_index == 0)])
            ));
        }
        let configuration = &list[sharding_index]["configuration"];
        let shape = parse_counts(&configuration["chunk_shape"])
            .filter(|shape| {
                shape.len() == chunk.len()
                    && shape
                        .iter()
                        .zip(chunk)
                        .all(|(&n, &total)| n > 0 && total % n == 0)
            })
            .ok_or_else(|| {
                format!("has shards of {chunk:?} elements, which are not a multiple of its chunks")
            })?;
        let cells: Vec<usize> = chunk
            .iter()
            .zip(&shape)
            .map(|(total, n)| total / n)
            .collect();
        checked_product(&cells)
            .and_then(|count| count.checked_mul(16))
            .ok_or("has shards of too many chunks")?;
        let empty = Vec::new();
        let inner = configuration["codecs"].as_array().unwrap_or(&empty);
        let index_codecs = configuration["index_codecs"].as_array().unwrap_or(&empty);
        let index = CodecChain::parse(index_codecs, cells.len() + 1, SampleType::U64)?;
        if !index.axis_order.is_empty() || index.byte_codecs.iter().any(|p| *p != ByteCodec::Crc32c)
        {
            return Err("has a compressed index of its shards, which is not read".into());
        }
        Ok(Self {
            cell_codecs: CodecChain::parse(inner, shape.len(), sample)?,
            cell_shape: shape,
            shard: Some(Shard {
                cell_counts: cells,
                is_index_at_end: configuration["index_location"] != "start",
                index_codecs: index,
                recent_indices: Mutex::default(),
            }),
        })
    }
}

/// Returns the name of a codec.
fn codec_name(codec: &Value) -> &str {
    codec["name"].as_str().or(codec.as_str()).unwrap_or("")
}

impl CodecChain {
    fn parse(list: &[Value], axes: usize, sample: SampleType) -> Result<Self, CodecError> {
        let mut order: Vec<usize> = Vec::new();
        let mut encoding = None;
        let mut packings = Vec::new();
        for codec in list {
            let packing = match (codec_name(codec), encoding.is_some()) {
                ("transpose", false) => {
                    let next = parse_permutation(&codec["configuration"]["order"], axes)?;
                    order = if order.is_empty() {
                        next
                    } else {
                        next.iter().map(|&k| order[k]).collect()
                    };
                    continue;
                }
                ("bytes", false) => {
                    let endian = match codec["configuration"]["endian"].as_str() {
                        Some("big") => Endian::Big,
                        _ => Endian::Little,
                    };
                    encoding = Some(Encoding {
                        sample_type: sample,
                        endian,
                    });
                    continue;
                }
                ("gzip", true) => ByteCodec::Gzip,
                ("zlib" | "numcodecs.zlib", true) => ByteCodec::Zlib,
                ("zstd" | "numcodecs.zstd", true) => ByteCodec::Zstd,
                ("blosc" | "numcodecs.blosc", true) => ByteCodec::Blosc,
                ("numcodecs.lz4", true) => ByteCodec::Lz4,
                ("crc32c", true) => ByteCodec::Crc32c,
                ("sharding_indexed", _) => return Err("has shards within shards".into()),
                (name, _) => {
                    return Err(format!(
                        "has the codec '{name}', which is not read here (bytes, transpose, blosc, zstd, gzip, zlib, \
                         lz4, crc32c and sharding_indexed are)"
                    ));
                }
            };
            packings.push(packing);
        }
        packings.reverse();
        let encoding = encoding.ok_or("has no codec 'bytes'")?;
        Ok(Self {
            axis_order: order,
            encoding,
            byte_codecs: packings,
        })
    }

    /// Returns a text that describes the compression, to be appended to the encoding of elements.
    pub fn compression_label(&self) -> &'static str {
        match self.byte_codecs.iter().find(|p| **p != ByteCodec::Crc32c) {
            None => "",
            Some(ByteCodec::Gzip) => ", gzip",
            Some(ByteCodec::Zlib) => ", zlib",
            Some(ByteCodec::Zstd) => ", zstd",
            Some(ByteCodec::Lz4) => ", lz4",
            Some(_) => ", blosc",
        }
    }

    /// Decodes the elements of a cell of this shape, in the axis order of the cell.
    ///
    /// # Errors
    /// Returns a message if `packed` is damaged.
    pub fn decode_cell(&self, packed: Vec<u8>, shape: &[usize]) -> Result<Vec<u8>, CodecError> {
        let size = self.encoding.size();
        let needed = size * shape.iter().product::<usize>();
        let mut bytes = packed;
        for (i, packing) in self.byte_codecs.iter().enumerate() {
            // The exact length of the output is known only if nothing but checksums follows.
            let following = self.byte_codecs[i + 1..].iter();
            let sums = following
                .clone()
                .filter(|p| **p == ByteCodec::Crc32c)
                .count();
            let only_checksums_follow = following.count() == sums;
            let max_bytes = if only_checksums_follow {
                needed + CHECKSUM_BYTES * sums
            } else {
                2 * needed + (1 << 16)
            };
            bytes = packing.decode(&bytes, max_bytes)?;
        }
        if bytes.len() != needed {
            return Err(format!("holds {} bytes instead of {needed}", bytes.len()));
        }
        if self.axis_order.is_empty() {
            return Ok(bytes);
        }
        Ok(restore_axis_order(&bytes, size, shape, &self.axis_order))
    }
}

impl ByteCodec {
    /// Decodes bytes to at most `max_bytes` bytes, or one more if there are too many.
    fn decode(self, bytes: &[u8], max_bytes: usize) -> Result<Vec<u8>, CodecError> {
        let read = |reader: &mut dyn Read| {
            let mut out = Vec::new();
            let result = reader.take(max_bytes as u64 + 1).read_to_end(&mut out);
            result.map_err(|e| format!("is damaged: {e}"))?;
            Ok(out)
        };
        match self {
            Self::Gzip => read(&mut MultiGzDecoder::new(bytes)),
            Self::Zlib => read(&mut ZlibDecoder::new(bytes)),
            Self::Zstd => decode_zstd(bytes, max_bytes),
            Self::Blosc => blosc::decompress(bytes, max_bytes),
            Self::Lz4 => {
                let (length, packed) = bytes.split_first_chunk().ok_or("is cut off")?;
                let length = u32::from_le_bytes(*length) as usize;
                if length > max_bytes {
                    return Err(format!("claims {length} bytes where {max_bytes} are needed"));
                }
                let unpacked = lz4_flex::block::decompress(packed, length);
                unpacked.map_err(|e| format!("is damaged: {e}"))
            }
            Self::Crc32c => {
                let (rest, sum) = bytes
                    .split_last_chunk::<CHECKSUM_BYTES>()
                    .ok_or("is cut off")?;
                if crc32c(rest) == u32::from_le_bytes(*sum) {
                    Ok(rest.to_vec())
                } else {
                    Err("has a checksum that does not match its content".into())
                }
            }
        }
    }
}

/// Decompresses all zstd frames to at most `max_bytes` bytes.
pub fn decode_zstd(bytes: &[u8], max_bytes: usize) -> Result<Vec<u8>, CodecError> {
    let mut out = Vec::new();
    let mut remaining = bytes;
    while !remaining.is_empty() {
        let mut decoder = ruzstd::decoding::StreamingDecoder::new(&mut remaining)
            .map_err(|e| format!("is damaged: {e}"))?;
        let limit = (max_bytes + 1).saturating_sub(out.len()) as u64;
        let result = (&mut decoder).take(limit).read_to_end(&mut out);
        result.map_err(|e| format!("is damaged: {e}"))?;
        if out.len() > max_bytes {
            return Err(format!("holds more than {max_bytes} bytes"));
        }
    }
    Ok(out)
}

/// Parses a permutation of the axes.
fn parse_permutation(value: &Value, axes: usize) -> Result<Vec<usize>, CodecError> {
    let order = parse_counts(value).unwrap_or_default();
    if sorted(order.clone()).into_iter().eq(0..axes) {
        Ok(order)
    } else {
        Err(format!(
            "has the transposition {value}, which is not a permutation of {axes} axes"
        ))
    }
}

/// Restores the axis order of a cell. `bytes` holds elements of `size` bytes, stored with axis
/// `order[k]` of the cell as axis `k`.
fn restore_axis_order(bytes: &[u8], size: usize, shape: &[usize], order: &[usize]) -> Vec<u8> {
    // Stored distance in bytes between neighbours along each axis of the cell.
    let mut strides = vec![0; shape.len()];
    let mut stride = size;
    for &k in order.iter().rev() {
        strides[k] = stride;
        stride *= shape[k];
    }
    let mut out = Vec::with_capacity(bytes.len());
    let mut index = vec![0; shape.len()];
    for _ in 0..bytes.len() / size {
        let offset: usize = index.iter().zip(&strides).map(|(i, s)| i * s).sum();
        out.extend_from_slice(&bytes[offset..offset + size]);
        for k in (0..shape.len()).rev() {
            index[k] += 1;
            if index[k] < shape[k] {
                break;
            }
            index[k] = 0;
        }
    }
    out
}

/// Returns the iSCSI checksum (RFC 3720, appendix B.4): Castagnoli's polynomial, reflected.
fn crc32c(bytes: &[u8]) -> u32 {
    const TABLE: [u32; 256] = {
        let mut table = [0; 256];
        let mut i = 0;
        while i < 256 {
            let mut value = i as u32;
            let mut bit = 0;
            while bit < 8 {
                value = (value >> 1) ^ (0x82f6_3b78 * (value & 1));
                bit += 1;
            }
            table[i] = value;
            i += 1;
        }
        table
    };
    !bytes.iter().fold(!0, |sum: u32, byte| {
        (sum >> 8) ^ TABLE[(sum as u8 ^ byte) as usize]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn check_sums_are_those_of_rfc_3720() {
        // The values are those of appendix B.4.
        assert_eq!(crc32c(&[0; 32]), 0x8a91_36aa);
        assert_eq!(crc32c(&[0xff; 32]), 0x62a8_ab43);
        let rising: Vec<u8> = (0..32).collect();
        assert_eq!(crc32c(&rising), 0x46dd_794e);
    }

    #[test]
    fn transposed_elements_are_restored() {
        // Element (i, j, k) of a 2 x 3 x 4 array is 12 i + 4 j + k; it is stored with axes (2, 0,
        // 1).
        let (shape, order) = ([2, 3, 4], [2, 0, 1]);
        let mut stored = Vec::new();
        for k in 0..4u16 {
            for i in 0..2 {
                for j in 0..3 {
                    stored.extend((12 * i + 4 * j + k).to_le_bytes());
                }
            }
        }
        let expected: Vec<u8> = (0..24u16).flat_map(u16::to_le_bytes).collect();
        assert_eq!(restore_axis_order(&stored, 2, &shape, &order), expected);
    }
}

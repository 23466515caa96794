//! From the bytes of a chunk to those of its elements.
//!
//! An array's chain of codecs turns elements into bytes in one order or the other, perhaps with axes
//! transposed, and compresses these. With sharding a file holds many such chunks and an index of them.

use std::io::Read;

use flate2::bufread::{MultiGzDecoder, ZlibDecoder};
use serde_json::Value;

use super::blosc;
use super::metadata::{checked_product, parse_counts};
use crate::image::formats::samples::{Encoding, Endian, SampleType};

/// What is wrong with a chunk, or with what is said of chunks.
pub type CodecError = String;

/// How chunks are coded.
pub struct Codecs {
    /// How the cells are coded that are read one by one: the chunks, or those within shards.
    pub cell_codecs: CodecChain,
    /// Elements of a cell along each axis.
    pub cell_shape: Vec<usize>,
    /// How cells lie in the files of chunks, unless each has its own.
    pub shard: Option<Shard>,
}

/// Cells in one file, and where.
pub struct Shard {
    /// Cells along each axis.
    pub cell_counts: Vec<usize>,
    /// Whether the index stands at the end of the file rather than at its beginning.
    pub is_index_at_end: bool,
    /// How the index is coded: only by codecs that keep its length known.
    pub index_codecs: CodecChain,
}

impl Shard {
    /// Bytes of the index as the file has it.
    pub fn index_bytes(&self) -> usize {
        let sums = self.index_codecs.byte_codecs.len();
        16 * self.cell_counts.iter().product::<usize>() + CHECKSUM_BYTES * sums
    }
}

/// Bytes of a check sum.
const CHECKSUM_BYTES: usize = 4;

/// What becomes of the elements of a cell.
pub struct CodecChain {
    /// Which axis of the cell each axis of what is stored is; empty where they are the same.
    axis_order: Vec<usize>,
    /// How an element is coded.
    pub encoding: Encoding,
    /// What is done to the bytes, the last first.
    byte_codecs: Vec<ByteCodec>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum ByteCodec {
    Gzip,
    Zlib,
    Zstd,
    Blosc,
    Crc32c,
}

impl Codecs {
    /// From an array's metadata.
    ///
    /// # Errors
    /// What is not read here.
    pub fn parse(value: &Value, chunk: &[usize], sample: SampleType) -> Result<Self, CodecError> {
        let list = value.as_array().ok_or("has no codecs")?;
        let Some(at) = list
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
                codec_name(&list[usize::from(at == 0)])
            ));
        }
        let within = &list[at]["configuration"];
        let shape = parse_counts(&within["chunk_shape"])
            .filter(|shape| {
                shape.len() == chunk.len()
                    && shape
                        .iter()
                        .zip(chunk)
                        .all(|(&n, &all)| n > 0 && all % n == 0)
            })
            .ok_or_else(|| format!("has shards of {chunk:?} elements that no chunks fill"))?;
        let cells: Vec<usize> = chunk.iter().zip(&shape).map(|(all, n)| all / n).collect();
        checked_product(&cells)
            .and_then(|count| count.checked_mul(16))
            .ok_or("has shards of too many chunks")?;
        let empty = Vec::new();
        let inner = within["codecs"].as_array().unwrap_or(&empty);
        let of_index = within["index_codecs"].as_array().unwrap_or(&empty);
        let index = CodecChain::parse(of_index, cells.len() + 1, SampleType::U64)?;
        if !index.axis_order.is_empty() || index.byte_codecs.iter().any(|p| *p != ByteCodec::Crc32c)
        {
            return Err("has a compressed index of its shards, which is not read".into());
        }
        Ok(Self {
            cell_codecs: CodecChain::parse(inner, shape.len(), sample)?,
            cell_shape: shape,
            shard: Some(Shard {
                cell_counts: cells,
                is_index_at_end: within["index_location"] != "start",
                index_codecs: index,
            }),
        })
    }
}

/// A codec's name.
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
                    order = match order.is_empty() {
                        true => next,
                        false => next.iter().map(|&k| order[k]).collect(),
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
                ("crc32c", true) => ByteCodec::Crc32c,
                ("sharding_indexed", _) => return Err("has shards within shards".into()),
                (name, _) => {
                    return Err(format!(
                        "has the codec '{name}', which is not read here (bytes, transpose, blosc, zstd, gzip, zlib, \
                         crc32c and sharding_indexed are)"
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

    /// How bytes are compressed, to be said after how elements are coded.
    pub fn compression_label(&self) -> &'static str {
        match self.byte_codecs.iter().find(|p| **p != ByteCodec::Crc32c) {
            None => "",
            Some(ByteCodec::Gzip) => ", gzip",
            Some(ByteCodec::Zlib) => ", zlib",
            Some(ByteCodec::Zstd) => ", zstd",
            Some(_) => ", blosc",
        }
    }

    /// The bytes of the elements of a cell of this shape, in its own order of axes.
    ///
    /// # Errors
    /// What is wrong with `packed`.
    pub fn decode_cell(&self, packed: Vec<u8>, shape: &[usize]) -> Result<Vec<u8>, CodecError> {
        let size = self.encoding.size();
        let needed = size * shape.iter().product::<usize>();
        let mut bytes = packed;
        for (i, packing) in self.byte_codecs.iter().enumerate() {
            // What check sums stand after is known only where nothing else follows.
            let after = self.byte_codecs[i + 1..].iter();
            let sums = after.clone().filter(|p| **p == ByteCodec::Crc32c).count();
            let last = after.count() == sums;
            let most = match last {
                true => needed + CHECKSUM_BYTES * sums,
                false => 2 * needed + (1 << 16),
            };
            bytes = packing.decode(&bytes, most)?;
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
    /// The bytes before this was done to them: `most` at most.
    fn decode(self, bytes: &[u8], most: usize) -> Result<Vec<u8>, CodecError> {
        let read = |reader: &mut dyn Read| {
            let mut out = Vec::new();
            let done = reader.take(most as u64 + 1).read_to_end(&mut out);
            done.map_err(|e| format!("is damaged: {e}"))?;
            Ok(out)
        };
        match self {
            Self::Gzip => read(&mut MultiGzDecoder::new(bytes)),
            Self::Zlib => read(&mut ZlibDecoder::new(bytes)),
            Self::Zstd => decode_zstd(bytes, most),
            Self::Blosc => blosc::decompress(bytes, most),
            Self::Crc32c => {
                let (rest, sum) = bytes
                    .split_last_chunk::<CHECKSUM_BYTES>()
                    .ok_or("is cut off")?;
                match crc32c(rest) == u32::from_le_bytes(*sum) {
                    true => Ok(rest.to_vec()),
                    false => Err("has another check sum than is written in it".into()),
                }
            }
        }
    }
}

/// What zstd's frames hold, `most` bytes at most.
pub fn decode_zstd(bytes: &[u8], most: usize) -> Result<Vec<u8>, CodecError> {
    let mut out = Vec::new();
    let mut rest = bytes;
    while !rest.is_empty() {
        let mut decoder = ruzstd::decoding::StreamingDecoder::new(&mut rest)
            .map_err(|e| format!("is damaged: {e}"))?;
        let room = (most + 1).saturating_sub(out.len()) as u64;
        let done = (&mut decoder).take(room).read_to_end(&mut out);
        done.map_err(|e| format!("is damaged: {e}"))?;
        if out.len() > most {
            return Err(format!("holds more than {most} bytes"));
        }
    }
    Ok(out)
}

/// A permutation of the axes.
fn parse_permutation(value: &Value, axes: usize) -> Result<Vec<usize>, CodecError> {
    let order = parse_counts(value).unwrap_or_default();
    let mut sorted = order.clone();
    sorted.sort_unstable();
    match sorted.into_iter().eq(0..axes) {
        true => Ok(order),
        false => Err(format!(
            "has the transposition {value}, which is none of {axes} axes"
        )),
    }
}

/// Elements of `size` bytes that are stored with axis `order[k]` of the cell as axis `k`, in the order of
/// the cell.
fn restore_axis_order(bytes: &[u8], size: usize, shape: &[usize], order: &[usize]) -> Vec<u8> {
    // How far apart neighbours along each axis of the cell are stored.
    let mut apart = vec![0; shape.len()];
    let mut stride = size;
    for &k in order.iter().rev() {
        apart[k] = stride;
        stride *= shape[k];
    }
    let mut out = Vec::with_capacity(bytes.len());
    let mut index = vec![0; shape.len()];
    for _ in 0..bytes.len() / size {
        let at: usize = index.iter().zip(&apart).map(|(i, s)| i * s).sum();
        out.extend_from_slice(&bytes[at..at + size]);
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

/// The check sum of iSCSI (RFC 3720, appendix B.4): Castagnoli's polynomial, reflected.
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
        // Appendix B.4.
        assert_eq!(crc32c(&[0; 32]), 0x8a91_36aa);
        assert_eq!(crc32c(&[0xff; 32]), 0x62a8_ab43);
        let rising: Vec<u8> = (0..32).collect();
        assert_eq!(crc32c(&rising), 0x46dd_794e);
    }

    #[test]
    fn transposed_elements_come_back() {
        // Element (i, j, k) of 2 x 3 x 4 is 12 i + 4 j + k; stored with axes (2, 0, 1).
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

//! From the bytes of a chunk to those of its elements.
//!
//! An array's chain of codecs turns elements into bytes in one order or the other, perhaps with axes
//! transposed, and compresses these. With sharding a file holds many such chunks and an index of them.

use std::io::Read;

use flate2::bufread::{MultiGzDecoder, ZlibDecoder};
use serde_json::Value;

use super::blosc;
use super::metadata::{counts, product};
use crate::image::formats::samples::{Encoding, Endian, SampleType};

/// What is wrong with a chunk, or with what is said of chunks.
pub type Problem = String;

/// How chunks are coded.
pub struct Codecs {
    /// How the cells are coded that are read one by one: the chunks, or those within shards.
    pub cell: Chain,
    /// Elements of a cell along each axis.
    pub shape: Vec<usize>,
    /// How cells lie in the files of chunks, unless each has its own.
    pub shard: Option<Shard>,
}

/// Cells in one file, and where.
pub struct Shard {
    /// Cells along each axis.
    pub cells: Vec<usize>,
    /// Whether the index stands at the end of the file rather than at its beginning.
    pub at_end: bool,
    /// How the index is coded: only by codecs that keep its length known.
    pub index: Chain,
}

impl Shard {
    /// Bytes of the index as the file has it.
    pub fn index_bytes(&self) -> usize {
        let sums = self.index.packings.len();
        16 * self.cells.iter().product::<usize>() + SUM * sums
    }
}

/// Bytes of a check sum.
const SUM: usize = 4;

/// What becomes of the elements of a cell.
pub struct Chain {
    /// Which axis of the cell each axis of what is stored is; empty where they are the same.
    order: Vec<usize>,
    /// How an element is coded.
    pub encoding: Encoding,
    /// What is done to the bytes, the last first.
    packings: Vec<Packing>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Packing {
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
    pub fn of(value: &Value, chunk: &[usize], sample: SampleType) -> Result<Self, Problem> {
        let list = value.as_array().ok_or("has no codecs")?;
        let Some(at) = list
            .iter()
            .position(|codec| name(codec) == "sharding_indexed")
        else {
            return Ok(Self {
                cell: Chain::of(list, chunk.len(), sample)?,
                shape: chunk.to_vec(),
                shard: None,
            });
        };
        if list.len() != 1 {
            return Err(format!(
                "has shards within other codecs ({}), which are not read",
                name(&list[usize::from(at == 0)])
            ));
        }
        let within = &list[at]["configuration"];
        let shape = counts(&within["chunk_shape"])
            .filter(|shape| {
                shape.len() == chunk.len()
                    && shape
                        .iter()
                        .zip(chunk)
                        .all(|(&n, &all)| n > 0 && all % n == 0)
            })
            .ok_or_else(|| format!("has shards of {chunk:?} elements that no chunks fill"))?;
        let cells: Vec<usize> = chunk.iter().zip(&shape).map(|(all, n)| all / n).collect();
        product(&cells)
            .and_then(|count| count.checked_mul(16))
            .ok_or("has shards of too many chunks")?;
        let empty = Vec::new();
        let inner = within["codecs"].as_array().unwrap_or(&empty);
        let of_index = within["index_codecs"].as_array().unwrap_or(&empty);
        let index = Chain::of(of_index, cells.len() + 1, SampleType::U64)?;
        if !index.order.is_empty() || index.packings.iter().any(|p| *p != Packing::Crc32c) {
            return Err("has a compressed index of its shards, which is not read".into());
        }
        Ok(Self {
            cell: Chain::of(inner, shape.len(), sample)?,
            shape,
            shard: Some(Shard {
                cells,
                at_end: within["index_location"] != "start",
                index,
            }),
        })
    }
}

/// A codec's name.
fn name(codec: &Value) -> &str {
    codec["name"].as_str().or(codec.as_str()).unwrap_or("")
}

impl Chain {
    fn of(list: &[Value], axes: usize, sample: SampleType) -> Result<Self, Problem> {
        let mut order: Vec<usize> = Vec::new();
        let mut encoding = None;
        let mut packings = Vec::new();
        for codec in list {
            let packing = match (name(codec), encoding.is_some()) {
                ("transpose", false) => {
                    let next = permutation(&codec["configuration"]["order"], axes)?;
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
                    encoding = Some(Encoding { sample, endian });
                    continue;
                }
                ("gzip", true) => Packing::Gzip,
                ("zlib" | "numcodecs.zlib", true) => Packing::Zlib,
                ("zstd" | "numcodecs.zstd", true) => Packing::Zstd,
                ("blosc" | "numcodecs.blosc", true) => Packing::Blosc,
                ("crc32c", true) => Packing::Crc32c,
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
            order,
            encoding,
            packings,
        })
    }

    /// How bytes are compressed, to be said after how elements are coded.
    pub fn packing(&self) -> &'static str {
        match self.packings.iter().find(|p| **p != Packing::Crc32c) {
            None => "",
            Some(Packing::Gzip) => ", gzip",
            Some(Packing::Zlib) => ", zlib",
            Some(Packing::Zstd) => ", zstd",
            Some(_) => ", blosc",
        }
    }

    /// The bytes of the elements of a cell of this shape, in its own order of axes.
    ///
    /// # Errors
    /// What is wrong with `packed`.
    pub fn unpacked(&self, packed: Vec<u8>, shape: &[usize]) -> Result<Vec<u8>, Problem> {
        let size = self.encoding.size();
        let needed = size * shape.iter().product::<usize>();
        let mut bytes = packed;
        for (i, packing) in self.packings.iter().enumerate() {
            // What check sums stand after is known only where nothing else follows.
            let after = self.packings[i + 1..].iter();
            let sums = after.clone().filter(|p| **p == Packing::Crc32c).count();
            let last = after.count() == sums;
            let most = match last {
                true => needed + SUM * sums,
                false => 2 * needed + (1 << 16),
            };
            bytes = packing.undone(&bytes, most)?;
        }
        if bytes.len() != needed {
            return Err(format!("holds {} bytes instead of {needed}", bytes.len()));
        }
        if self.order.is_empty() {
            return Ok(bytes);
        }
        Ok(turned_back(&bytes, size, shape, &self.order))
    }
}

impl Packing {
    /// The bytes before this was done to them: `most` at most.
    fn undone(self, bytes: &[u8], most: usize) -> Result<Vec<u8>, Problem> {
        let read = |reader: &mut dyn Read| {
            let mut out = Vec::new();
            let done = reader.take(most as u64 + 1).read_to_end(&mut out);
            done.map_err(|e| format!("is damaged: {e}"))?;
            Ok(out)
        };
        match self {
            Self::Gzip => read(&mut MultiGzDecoder::new(bytes)),
            Self::Zlib => read(&mut ZlibDecoder::new(bytes)),
            Self::Zstd => unzstd(bytes, most),
            Self::Blosc => blosc::unpacked(bytes, most),
            Self::Crc32c => {
                let (rest, sum) = bytes.split_last_chunk::<SUM>().ok_or("is cut off")?;
                match crc32c(rest) == u32::from_le_bytes(*sum) {
                    true => Ok(rest.to_vec()),
                    false => Err("has another check sum than is written in it".into()),
                }
            }
        }
    }
}

/// What zstd's frames hold, `most` bytes at most.
pub fn unzstd(bytes: &[u8], most: usize) -> Result<Vec<u8>, Problem> {
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
fn permutation(value: &Value, axes: usize) -> Result<Vec<usize>, Problem> {
    let order = counts(value).unwrap_or_default();
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
fn turned_back(bytes: &[u8], size: usize, shape: &[usize], order: &[usize]) -> Vec<u8> {
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
        assert_eq!(turned_back(&stored, 2, &shape, &order), expected);
    }
}

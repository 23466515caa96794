//! The Blosc container (version 1): blocks of shuffled elements, each compressed separately.
//!
//! The header has 16 bytes: version, version of the compressor, flags, and size of an element, then
//! the lengths of content, block and container as 32-bit numbers. The offset of each block follows.
//! A block consists of one compressed stream with its length in front, or of one such stream per
//! byte of the elements.

use std::io::Read;

use flate2::bufread::ZlibDecoder;

use super::codecs::{CodecError, decode_zstd};

const HEADER_BYTES: usize = 16;

// Bits of the flags byte.
const FLAG_SHUFFLE: u8 = 1;
const FLAG_MEMCPY: u8 = 2;
const FLAG_BITSHUFFLE: u8 = 4;
const FLAG_UNSPLIT: u8 = 16;

/// Position of the number of the compressor in the flags byte.
const COMPRESSOR_SHIFT: u32 = 5;
const COMPRESSOR_LZ4: u8 = 1;

/// Limits of splitting a block into streams: the largest size of an element, and the smallest
/// length of a stream, in bytes.
const MAX_STREAMS: usize = 16;
const MIN_STREAM_BYTES: usize = 128;

/// Length of a block in written containers, in bytes.
const BLOCK_BYTES: usize = 1 << 18;

/// Decompresses a container to at most `max_bytes` bytes.
///
/// # Errors
/// Returns a message if the container is damaged or not supported.
pub fn decompress(bytes: &[u8], max_bytes: usize) -> Result<Vec<u8>, CodecError> {
    let header = bytes.first_chunk::<HEADER_BYTES>().ok_or("is cut off")?;
    let [version, _, flags, size, ..] = *header;
    let number = |offset: usize| {
        let raw = [
            header[offset],
            header[offset + 1],
            header[offset + 2],
            header[offset + 3],
        ];
        u32::from_le_bytes(raw) as usize
    };
    let [length, block, packed] = [number(4), number(8), number(12)];
    if !(1..=2).contains(&version) {
        return Err(format!("has Blosc format {version}; only 1 and 2 are read"));
    }
    if length > max_bytes {
        return Err(format!(
            "claims {length} bytes where {max_bytes} are needed"
        ));
    }
    if packed > bytes.len() {
        return Err(format!(
            "is cut off: {} of {packed} bytes are there",
            bytes.len()
        ));
    }
    if flags & FLAG_MEMCPY != 0 {
        let copied = bytes.get(HEADER_BYTES..HEADER_BYTES + length);
        return Ok(copied.ok_or("is cut off")?.to_vec());
    }
    if length == 0 {
        return Ok(Vec::new());
    }
    if block == 0 {
        return Err("has blocks of 0 bytes".into());
    }
    let size = usize::from(size).max(1);
    let mut out = vec![0; length];
    let mut streams = Vec::new();
    for (i, out) in out.chunks_mut(block).enumerate() {
        let start = read_number(bytes, HEADER_BYTES + 4 * i)?;
        let split = flags & FLAG_UNSPLIT == 0
            && size <= MAX_STREAMS
            && block / size >= MIN_STREAM_BYTES
            && out.len() == block;
        let count = if split { size } else { 1 };
        let stream_len = out.len() / count;
        if stream_len * count != out.len() {
            return Err("has blocks that do not hold whole elements".into());
        }
        streams.resize(out.len(), 0);
        let mut position = start;
        for stream in streams.chunks_mut(stream_len) {
            let length = read_number(bytes, position)?;
            let packed = bytes
                .get(position + 4..)
                .and_then(|rest| rest.get(..length));
            let packed = packed.ok_or("is cut off within a block")?;
            if length == stream.len() {
                stream.copy_from_slice(packed)
            } else {
                unpack_stream(flags >> COMPRESSOR_SHIFT, packed, stream)?
            }
            position += 4 + length;
        }
        if flags & FLAG_SHUFFLE != 0 && size > 1 {
            unshuffle_bytes(&streams, size, out);
        } else if flags & FLAG_BITSHUFFLE != 0 {
            unshuffle_bits(&streams, size, version, out);
        } else {
            out.copy_from_slice(&streams);
        }
    }
    Ok(out)
}

/// Returns the 32-bit number at an offset.
fn read_number(bytes: &[u8], offset: usize) -> Result<usize, CodecError> {
    let raw = bytes.get(offset..).and_then(|rest| rest.first_chunk::<4>());
    Ok(u32::from_le_bytes(*raw.ok_or("is cut off")?) as usize)
}

/// Decompresses one stream, which fills `out`. Returns a message if it does not.
fn unpack_stream(compressor: u8, packed: &[u8], out: &mut [u8]) -> Result<(), CodecError> {
    let filled = match compressor {
        0 => unpack_blosclz(packed, out).ok_or("is damaged (blosclz)")?,
        COMPRESSOR_LZ4 => lz4_flex::block::decompress_into(packed, out)
            .map_err(|e| format!("is damaged (lz4): {e}"))?,
        3 => {
            let mut reader = ZlibDecoder::new(packed);
            reader
                .read_exact(out)
                .map_err(|e| format!("is damaged (zlib): {e}"))?;
            out.len()
        }
        4 => {
            let content = decode_zstd(packed, out.len())?;
            out[..content.len()].copy_from_slice(&content);
            content.len()
        }
        2 => return Err("is compressed with snappy, which is not read".into()),
        other => {
            return Err(format!(
                "is compressed with the unknown Blosc compressor {other}"
            ));
        }
    };
    if filled == out.len() {
        Ok(())
    } else {
        Err(format!(
            "is damaged: a block has {filled} of {} bytes",
            out.len()
        ))
    }
}

/// Decompresses a stream of BloscLZ, which resembles FastLZ: runs of literals, and copies of
/// earlier output. Returns the number of bytes written, or `None` if the stream is invalid.
fn unpack_blosclz(packed: &[u8], out: &mut [u8]) -> Option<usize> {
    /// Largest distance that is stored in the short form; larger ones take two more bytes.
    const MAX_SHORT_DISTANCE: usize = 8191;
    let mut input = packed.iter().map(|&b| usize::from(b));
    let mut written = 0;
    let mut control = input.next()? & 31;
    loop {
        if control < 32 {
            for _ in 0..=control {
                *out.get_mut(written)? = input.next()? as u8;
                written += 1;
            }
        } else {
            let mut length = (control >> 5) - 1;
            let high = (control & 31) << 8;
            if length == 6 {
                loop {
                    let extra = input.next()?;
                    length += extra;
                    if extra != 255 {
                        break;
                    }
                }
            }
            let low = input.next()?;
            let mut distance = high + low;
            if low == 255 && high == 31 << 8 {
                distance = MAX_SHORT_DISTANCE + (input.next()? << 8);
                distance += input.next()?;
            }
            let start = written.checked_sub(distance + 1)?;
            for k in start..start + length + 3 {
                *out.get_mut(written)? = *out.get(k)?;
                written += 1;
            }
        }
        match input.next() {
            Some(next) => control = next,
            None => return Some(written),
        }
    }
}

/// Restores elements that are stored as all first bytes, then all second bytes, and so on.
fn unshuffle_bytes(shuffled: &[u8], size: usize, out: &mut [u8]) {
    let count = out.len() / size;
    for (byte, plane) in shuffled[..count * size].chunks(count.max(1)).enumerate() {
        for (element, value) in out.chunks_exact_mut(size).zip(plane) {
            element[byte] = *value;
        }
    }
    out[count * size..].copy_from_slice(&shuffled[count * size..]);
}

/// Restores elements that are stored as all first bits, then all second bits, and so on, with eight
/// elements per byte.
fn unshuffle_bits(shuffled: &[u8], size: usize, version: u8, out: &mut [u8]) {
    let count = out.len() / size;
    // Format 2 of Blosc does not shuffle a block whose number of elements is not a multiple of
    // eight.
    let shuffled_count = match version {
        2 if !count.is_multiple_of(8) => 0,
        _ => count - count % 8,
    };
    let row = shuffled_count / 8;
    out[..shuffled_count * size].fill(0);
    for (bit, row) in (shuffled[..shuffled_count * size].chunks(row.max(1))).enumerate() {
        let (byte, bit) = (bit / 8, bit % 8);
        for (octet, packed) in row.iter().enumerate() {
            for k in 0..8 {
                out[(8 * octet + k) * size + byte] |= (packed >> k & 1) << bit;
            }
        }
    }
    out[shuffled_count * size..].copy_from_slice(&shuffled[shuffled_count * size..]);
}

/// Compresses elements of `size` bytes into a container, shuffled and with LZ4.
pub fn compress(bytes: &[u8], size: usize) -> Vec<u8> {
    // Each block holds whole elements.
    let block = (BLOCK_BYTES / size * size).min(bytes.len()).max(1);
    let count = bytes.len().div_ceil(block);
    let mut out = vec![0; HEADER_BYTES + 4 * count];
    let mut shuffled = Vec::new();
    for (i, part) in bytes.chunks(block).enumerate() {
        shuffled.clear();
        for byte in 0..size {
            shuffled.extend(part.chunks_exact(size).map(|element| element[byte]));
        }
        shuffled.extend_from_slice(&part[part.len() / size * size..]);
        let start = out.len() as u32;
        out[HEADER_BYTES + 4 * i..][..4].copy_from_slice(&start.to_le_bytes());
        let stream = lz4_flex::block::compress(&shuffled);
        let stream = if stream.len() < part.len() {
            &stream
        } else {
            &shuffled
        };
        out.extend((stream.len() as u32).to_le_bytes());
        out.extend_from_slice(stream);
    }
    let mut flags = FLAG_SHUFFLE | FLAG_UNSPLIT | COMPRESSOR_LZ4 << COMPRESSOR_SHIFT;
    if out.len() >= HEADER_BYTES + bytes.len() {
        flags |= FLAG_MEMCPY;
        out.truncate(HEADER_BYTES);
        out.extend_from_slice(bytes);
    }
    out[..4].copy_from_slice(&[2, 1, flags, size as u8]);
    for (offset, number) in [(4, bytes.len()), (8, block), (12, out.len())] {
        out[offset..offset + 4].copy_from_slice(&(number as u32).to_le_bytes());
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::splitmix64;

    #[test]
    fn compressed_bytes_are_decompressed_exactly() {
        for count in [0, 1, 31, 1000, 70_000, 300_001] {
            let bytes: Vec<u8> = (0..count).map(|i| (i / 7 % 61) as u8).collect();
            let packed = compress(&bytes, 4);
            assert_eq!(decompress(&packed, count).unwrap(), bytes, "{count}");
            assert!(packed.len() < 1000 + count / 2, "{count}: {}", packed.len());
            if count > 0 {
                assert!(decompress(&packed, count - 1).is_err());
                assert!(decompress(&packed[..packed.len() - 1], count).is_err());
            }
        }
        // Noise cannot be compressed and is copied.
        let noise: Vec<u8> = (0..5000).map(|n| splitmix64(n) as u8).collect();
        let packed = compress(&noise, 4);
        assert_eq!(packed.len(), noise.len() + HEADER_BYTES);
        assert_eq!(decompress(&packed, 5000).unwrap(), noise);
    }

    #[test]
    fn blosclz_copies_earlier_bytes() {
        // The stream has three literals, then nine bytes copied from distance three, then one
        // literal.
        let mut out = [0; 13];
        let packed = [2, b'a', b'b', b'c', 7 << 5, 0, 2, 0, b'd'];
        // The length is 6 + 0 + 3 = 9, the distance 2 + 1.
        assert_eq!(unpack_blosclz(&packed, &mut out), Some(13));
        assert_eq!(&out, b"abcabcabcabcd");
        assert_eq!(unpack_blosclz(&packed[..6], &mut out), None);
        assert_eq!(unpack_blosclz(&[0, b'a', 32, 1], &mut out), None);
    }
}

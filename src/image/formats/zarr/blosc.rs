//! Blosc's container (version 1): blocks of shuffled elements, each compressed by itself.
//!
//! After a header of 16 bytes (version, version of the compressor, flags, size of an element, then the
//! lengths of content, block and whole, as 32-bit numbers) stands where each block begins. A block is one
//! compressed stream with its length before it, or one for each byte of the elements.

use std::io::Read;

use flate2::bufread::ZlibDecoder;

use super::codecs::{CodecError, decode_zstd};

const HEADER_BYTES: usize = 16;

// Bits of the flags.
const FLAG_SHUFFLE: u8 = 1;
const FLAG_MEMCPY: u8 = 2;
const FLAG_BITSHUFFLE: u8 = 4;
const FLAG_UNSPLIT: u8 = 16;

/// The compressor's number stands in the upper bits of the flags.
const COMPRESSOR_SHIFT: u32 = 5;
const COMPRESSOR_LZ4: u8 = 1;

/// Elements of more bytes than this are not split into streams, nor are streams that would be shorter.
const MAX_STREAMS: usize = 16;
const MIN_STREAM_BYTES: usize = 128;

/// Bytes of a block that is written.
const BLOCK_BYTES: usize = 1 << 18;

/// What a container holds: `most` bytes at most.
///
/// # Errors
/// What is wrong with it.
pub fn decompress(bytes: &[u8], most: usize) -> Result<Vec<u8>, CodecError> {
    let header = bytes.first_chunk::<HEADER_BYTES>().ok_or("is cut off")?;
    let [version, _, flags, size, ..] = *header;
    let number = |at: usize| {
        let raw = [header[at], header[at + 1], header[at + 2], header[at + 3]];
        u32::from_le_bytes(raw) as usize
    };
    let [length, block, packed] = [number(4), number(8), number(12)];
    if !(1..=2).contains(&version) {
        return Err(format!("is of Blosc's format {version}; 1 and 2 are read"));
    }
    if length > most {
        return Err(format!("claims {length} bytes where {most} are needed"));
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
        let each = out.len() / count;
        if each * count != out.len() {
            return Err("has blocks of broken elements".into());
        }
        streams.resize(out.len(), 0);
        let mut from = start;
        for stream in streams.chunks_mut(each) {
            let length = read_number(bytes, from)?;
            let packed = bytes.get(from + 4..).and_then(|rest| rest.get(..length));
            let packed = packed.ok_or("is cut off within a block")?;
            match length == stream.len() {
                true => stream.copy_from_slice(packed),
                false => unpack_stream(flags >> COMPRESSOR_SHIFT, packed, stream)?,
            }
            from += 4 + length;
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

/// The number at a byte.
fn read_number(bytes: &[u8], at: usize) -> Result<usize, CodecError> {
    let raw = bytes.get(at..).and_then(|rest| rest.first_chunk::<4>());
    Ok(u32::from_le_bytes(*raw.ok_or("is cut off")?) as usize)
}

/// Unpacks one stream, which fills `out`.
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
            let found = decode_zstd(packed, out.len())?;
            out[..found.len()].copy_from_slice(&found);
            found.len()
        }
        2 => return Err("is compressed by Blosc's snappy, which is not read".into()),
        other => {
            return Err(format!(
                "is compressed by Blosc's compressor {other}, which is not known"
            ));
        }
    };
    match filled == out.len() {
        true => Ok(()),
        false => Err(format!(
            "is damaged: {filled} of {} bytes of a block",
            out.len()
        )),
    }
}

/// Unpacks a stream of BloscLZ, a kin of FastLZ: runs of literals, and copies of what was there `distance`
/// bytes before. `None` where it makes no sense.
fn unpack_blosclz(packed: &[u8], out: &mut [u8]) -> Option<usize> {
    /// Larger distances are written in two bytes more.
    const MAX_SHORT_DISTANCE: usize = 8191;
    let mut from = packed.iter().map(|&b| usize::from(b));
    let mut done = 0;
    let mut control = from.next()? & 31;
    loop {
        if control < 32 {
            for _ in 0..=control {
                *out.get_mut(done)? = from.next()? as u8;
                done += 1;
            }
        } else {
            let mut length = (control >> 5) - 1;
            let high = (control & 31) << 8;
            if length == 6 {
                loop {
                    let more = from.next()?;
                    length += more;
                    if more != 255 {
                        break;
                    }
                }
            }
            let low = from.next()?;
            let mut distance = high + low;
            if low == 255 && high == 31 << 8 {
                distance = MAX_SHORT_DISTANCE + (from.next()? << 8);
                distance += from.next()?;
            }
            let start = done.checked_sub(distance + 1)?;
            for k in start..start + length + 3 {
                *out.get_mut(done)? = *out.get(k)?;
                done += 1;
            }
        }
        match from.next() {
            Some(next) => control = next,
            None => return Some(done),
        }
    }
}

/// Elements whose first bytes stand together, then their second ones, and so on.
fn unshuffle_bytes(shuffled: &[u8], size: usize, out: &mut [u8]) {
    let count = out.len() / size;
    for (byte, plane) in shuffled[..count * size].chunks(count.max(1)).enumerate() {
        for (element, value) in out.chunks_exact_mut(size).zip(plane) {
            element[byte] = *value;
        }
    }
    out[count * size..].copy_from_slice(&shuffled[count * size..]);
}

/// Elements whose first bits stand together, then their second ones, and so on; eight elements a byte.
fn unshuffle_bits(shuffled: &[u8], size: usize, version: u8, out: &mut [u8]) {
    let count = out.len() / size;
    // Blosc's second format left alone what is no multiple of eight.
    let whole = match version {
        2 if !count.is_multiple_of(8) => 0,
        _ => count - count % 8,
    };
    let row = whole / 8;
    out[..whole * size].fill(0);
    for (bit, row) in (shuffled[..whole * size].chunks(row.max(1))).enumerate() {
        let (byte, bit) = (bit / 8, bit % 8);
        for (eight, packed) in row.iter().enumerate() {
            for k in 0..8 {
                out[(8 * eight + k) * size + byte] |= (packed >> k & 1) << bit;
            }
        }
    }
    out[whole * size..].copy_from_slice(&shuffled[whole * size..]);
}

/// Elements of `size` bytes in a container: shuffled, by LZ4.
pub fn compress(bytes: &[u8], size: usize) -> Vec<u8> {
    // Whole elements in each block.
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
    for (at, number) in [(4, bytes.len()), (8, block), (12, out.len())] {
        out[at..at + 4].copy_from_slice(&(number as u32).to_le_bytes());
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_packed_is_unpacked() {
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
        // What cannot be compressed is copied.
        let mut state = 1u32;
        let noise: Vec<u8> = (0..5000)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 24) as u8
            })
            .collect();
        let packed = compress(&noise, 4);
        assert_eq!(packed.len(), noise.len() + HEADER_BYTES);
        assert_eq!(decompress(&packed, 5000).unwrap(), noise);
    }

    #[test]
    fn blosclz_copies_what_was_there() {
        // Three literals, then nine bytes from three before, then one literal.
        let mut out = [0; 13];
        let packed = [2, b'a', b'b', b'c', 7 << 5, 0, 2, 0, b'd'];
        // Length 6 + 0 + 3 = 9 at distance 2 + 1.
        assert_eq!(unpack_blosclz(&packed, &mut out), Some(13));
        assert_eq!(&out, b"abcabcabcabcd");
        assert_eq!(unpack_blosclz(&packed[..6], &mut out), None);
        assert_eq!(unpack_blosclz(&[0, b'a', 32, 1], &mut out), None);
    }
}

//! Samples of one frame as a file stores them, compressed or not.

use std::borrow::Cow;
use std::panic::{AssertUnwindSafe, catch_unwind};

use dicom_dictionary_std::tags;
use jpeg_decoder::PixelFormat;
use jpeg2k::DecodeParameters;

use super::super::packed::DAMAGED_REMEDY;
use super::dataset::DicomFile;
use super::pixels::SampleFormat;
use crate::error::Result;

/// Bytes of the head of an item of compressed samples: a tag and a length.
const ITEM_HEAD_BYTES: usize = 8;

/// Bytes of the head of a frame of RLE: a number of segments and fifteen offsets.
const RLE_HEAD_BYTES: usize = 64;

/// Remedy that names programs that decompress files.
const DECOMPRESS_REMEDY: &str =
    "decompress the files: gdcmconv --raw IN OUT, or dcmdjpls IN OUT of DCMTK";

/// A way in which samples are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Codec {
    /// Not compressed.
    Native,
    /// Run lengths of bytes.
    Rle,
    /// JPEG, with losses or without.
    Jpeg,
    /// JPEG 2000.
    Jpeg2000,
}

impl Codec {
    /// Returns how the samples of a file are stored.
    ///
    /// # Errors
    /// Returns an [`Error::Io`](crate::Error::Io) that names a compression that is not read.
    pub fn from_file(file: &DicomFile) -> Result<Self> {
        let uid = file.syntax.as_str();
        let name = match uid.strip_prefix("1.2.840.10008.1.2").unwrap_or("?") {
            "" | ".1" | ".2" | ".1.99" | ".1.98" => return Ok(Self::Native),
            ".5" => return Ok(Self::Rle),
            ".4.50" | ".4.51" | ".4.57" | ".4.70" => return Ok(Self::Jpeg),
            ".4.90" | ".4.91" => return Ok(Self::Jpeg2000),
            ".4.80" | ".4.81" => "JPEG-LS",
            ".4.110" | ".4.111" | ".4.112" => "JPEG XL",
            ".4.201" | ".4.202" | ".4.203" => "high-throughput JPEG 2000",
            syntax if syntax.starts_with(".4.10") => "a video",
            _ => "transfer syntax",
        };
        let problem = format!("is compressed as {name} ({uid}), which is not read");
        Err(file.error(problem, DECOMPRESS_REMEDY))
    }

    /// Returns the name of the compression for a description; empty if there is none.
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Native => "",
            Self::Rle => ", RLE",
            Self::Jpeg => ", JPEG",
            Self::Jpeg2000 => ", JPEG 2000",
        }
    }
}

/// Samples of a frame, each with all its bits.
pub(super) enum StoredSamples<'a> {
    /// One bit for each sample, the lowest of each byte first, from this bit on.
    Bits(Cow<'a, [u8]>, usize),
    /// This number of bytes for each sample, the lowest first.
    Bytes(Cow<'a, [u8]>, usize),
    /// Integers.
    Integers(Vec<u32>),
}

/// Returns the samples of a frame.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if they are missing, damaged or of another size.
pub(super) fn stored_samples<'a>(
    file: &'a DicomFile,
    format: &SampleFormat,
    frame: usize,
) -> Result<StoredSamples<'a>> {
    let codec = Codec::from_file(file)?;
    let data = match codec {
        Codec::Native => return native_samples(file, format, frame),
        _ => frame_data(file, frame)?,
    };
    let damaged = |problem: &str| {
        file.error(
            format!("the compressed samples of frame {frame} {problem}"),
            DAMAGED_REMEDY,
        )
    };
    match codec {
        Codec::Rle => {
            let samples = decode_rle(&data, format.sample_bytes(), format.count());
            let samples = samples.ok_or_else(|| damaged("are damaged"))?;
            Ok(StoredSamples::Bytes(samples.into(), format.sample_bytes()))
        }
        Codec::Jpeg => decode_jpeg(&data, format).map_err(|problem| damaged(&problem)),
        Codec::Jpeg2000 => decode_jpeg_2000(&data, format).map_err(|problem| damaged(&problem)),
        Codec::Native => native_samples(file, format, frame),
    }
}

/// Returns the samples of a frame that are not compressed.
fn native_samples<'a>(
    file: &'a DicomFile,
    format: &SampleFormat,
    frame: usize,
) -> Result<StoredSamples<'a>> {
    let missing = || file.error("has no samples", DAMAGED_REMEDY);
    let element = file.data.get(format.element).ok_or_else(missing)?;
    let mut bytes = element.value().to_bytes().map_err(|_| missing())?;
    let count = format.count();
    let bits = count.saturating_mul(format.allocated as usize);
    let first = bits.saturating_mul(frame);
    let needed = first.saturating_add(bits).div_ceil(8);
    if bytes.len() < needed {
        let problem = format!(
            "is cut off: {} frames of {} x {} samples of {} bits need {needed} bytes or more, {} are there",
            frame + 1,
            format.columns,
            format.rows,
            format.allocated,
            bytes.len()
        );
        return Err(file.error(problem, DAMAGED_REMEDY));
    }
    if format.allocated == 1 {
        let part = cut(bytes, first / 8..needed);
        return Ok(StoredSamples::Bits(part, first % 8));
    }
    let size = format.sample_bytes();
    let is_big_endian = file.syntax == "1.2.840.10008.1.2.2";
    bytes = cut(bytes, first / 8..needed);
    // Samples of 32 bits are read as two words of 16 bits, the higher first.
    if is_big_endian && size == 4 && element.vr().to_string() == "OW" {
        for word in bytes.to_mut().chunks_exact_mut(4) {
            word.rotate_left(2);
        }
    }
    Ok(StoredSamples::Bytes(bytes, size))
}

/// Returns a range of bytes.
fn cut(bytes: Cow<'_, [u8]>, range: std::ops::Range<usize>) -> Cow<'_, [u8]> {
    match bytes {
        Cow::Borrowed(bytes) => Cow::Borrowed(&bytes[range]),
        Cow::Owned(mut bytes) => {
            bytes.truncate(range.end);
            bytes.drain(..range.start);
            Cow::Owned(bytes)
        }
    }
}

/// Returns the compressed bytes of a frame, which may lie in several fragments.
fn frame_data(file: &DicomFile, frame: usize) -> Result<Cow<'_, [u8]>> {
    let element = file.data.get(tags::PIXEL_DATA);
    let fragments = element.and_then(|element| element.value().fragments());
    let Some(fragments) = fragments else {
        return Err(file.error("has no compressed samples", DAMAGED_REMEDY));
    };
    let frames = file.frame_count();
    if fragments.len() == frames
        && let Some(fragment) = fragments.get(frame)
    {
        return Ok(Cow::Borrowed(fragment));
    }
    if frames == 1 {
        return Ok(Cow::Owned(fragments.concat()));
    }
    // Offsets of the frames' first fragments.
    let basic = element.and_then(|element| element.value().offset_table());
    let basic = basic
        .unwrap_or_default()
        .iter()
        .map(|&offset| u64::from(offset));
    let mut offsets: Vec<u64> = basic.collect();
    if offsets.is_empty()
        && let Some(extended) = file.data.get(tags::EXTENDED_OFFSET_TABLE)
    {
        offsets = extended.to_multi_int::<u64>().unwrap_or_default();
    }
    let mut data = Vec::new();
    let mut at = 0;
    if let Some(&start) = offsets.get(frame).filter(|_| offsets.len() == frames) {
        let end = offsets.get(frame + 1).copied().unwrap_or(u64::MAX);
        for fragment in fragments {
            if (start..end).contains(&at) {
                data.extend_from_slice(fragment);
            }
            at += (fragment.len() + ITEM_HEAD_BYTES) as u64;
        }
    }
    if data.is_empty() {
        let problem = format!(
            "holds {frames} compressed frames in {} fragments, without a table that tells them apart",
            fragments.len()
        );
        return Err(file.error(problem, DECOMPRESS_REMEDY));
    }
    Ok(Cow::Owned(data))
}

/// Decodes a frame of run lengths: a segment for each byte of the samples, the highest byte first.
/// Source: DICOM PS3.5, annex G.
fn decode_rle(data: &[u8], size: usize, count: usize) -> Option<Vec<u8>> {
    let word = |k: usize| {
        let bytes = data.get(4 * k..)?.first_chunk()?;
        Some(u32::from_le_bytes(*bytes) as usize)
    };
    if data.len() < RLE_HEAD_BYTES || word(0)? != size {
        return None;
    }
    let mut out = vec![0; count * size];
    for segment in 0..size {
        let start = word(1 + segment)?;
        let end = if segment + 1 < size {
            word(2 + segment)?
        } else {
            data.len()
        };
        let mut packed = data.get(start..end)?;
        let mut samples = out.iter_mut().skip(size - 1 - segment).step_by(size);
        let mut remaining = count;
        while remaining > 0 {
            let (&control, rest) = packed.split_first()?;
            let length = match control {
                0..=127 => {
                    let length = usize::from(control) + 1;
                    let run = rest.get(..length)?;
                    // The run comes first: a sample that is taken without a value would be left out.
                    for (value, sample) in run.iter().zip(samples.by_ref()) {
                        *sample = *value;
                    }
                    packed = &rest[length..];
                    length
                }
                128 => {
                    packed = rest;
                    0
                }
                129.. => {
                    let length = 257 - usize::from(control);
                    let (&value, rest) = rest.split_first()?;
                    for sample in samples.by_ref().take(length.min(remaining)) {
                        *sample = value;
                    }
                    packed = rest;
                    length
                }
            };
            remaining = remaining.saturating_sub(length);
        }
    }
    Some(out)
}

/// Runs a decoder, whose panics on damaged data are errors.
fn guarded<T>(
    decode: impl FnOnce() -> std::result::Result<T, String>,
) -> std::result::Result<T, String> {
    catch_unwind(AssertUnwindSafe(decode)).unwrap_or_else(|_| Err("are damaged".into()))
}

/// Returns the problem of a picture of another size than the file's rows and columns.
fn size_problem(size: [usize; 2], format: &SampleFormat) -> String {
    let [width, height] = size;
    format!(
        "are a picture of {width} x {height}, not of {} x {}",
        format.columns, format.rows
    )
}

/// Decodes a frame of JPEG.
fn decode_jpeg(
    data: &[u8],
    format: &SampleFormat,
) -> std::result::Result<StoredSamples<'static>, String> {
    guarded(|| {
        let failed = |e: jpeg_decoder::Error| format!("are no JPEG that can be read: {e}");
        let mut decoder = jpeg_decoder::Decoder::new(data);
        decoder.read_info().map_err(failed)?;
        let info = decoder.info().ok_or("have no header")?;
        let size = [info.width, info.height].map(usize::from);
        if size != [format.columns, format.rows] {
            return Err(size_problem(size, format));
        }
        let width = match info.pixel_format {
            PixelFormat::L8 => 1,
            PixelFormat::L16 => 2,
            _ => return Err("are a picture in colours".into()),
        };
        let bytes = decoder.decode().map_err(failed)?;
        if bytes.len() != format.count() * width {
            return Err("are cut off".into());
        }
        let samples = match width {
            1 => bytes.iter().map(|&byte| byte.into()).collect(),
            _ => (bytes.as_chunks().0.iter())
                .map(|pair| u16::from_ne_bytes(*pair).into())
                .collect(),
        };
        Ok(StoredSamples::Integers(samples))
    })
}

/// Decodes a frame of JPEG 2000.
fn decode_jpeg_2000(
    data: &[u8],
    format: &SampleFormat,
) -> std::result::Result<StoredSamples<'static>, String> {
    // The decoder allocates what the header claims.
    let claim = jpeg_2000_size(data).ok_or("have no header of JPEG 2000")?;
    if claim != [format.columns, format.rows] {
        return Err(size_problem(claim, format));
    }
    guarded(|| {
        let params = DecodeParameters::new().strict(true);
        let image = jpeg2k::Image::from_bytes_with(data, params)
            .map_err(|e| format!("are no JPEG 2000 that can be read: {e}"))?;
        let [component] = image.components() else {
            return Err("are a picture in colours".into());
        };
        let samples = component.data();
        if samples.len() != format.count() {
            return Err("are cut off".into());
        }
        Ok(StoredSamples::Integers(
            samples.iter().map(|&sample| sample as u32).collect(),
        ))
    })
}

/// Returns width and height of a picture of JPEG 2000, from the marker SIZ of its code stream. Source:
/// ISO/IEC 15444-1, annex A.5.1.
fn jpeg_2000_size(data: &[u8]) -> Option<[usize; 2]> {
    // Start of code stream, then SIZ.
    let marker = b"\xff\x4f\xff\x51";
    let start = data.windows(4).position(|window| window == marker)?;
    let word = |at: usize| {
        let bytes = data.get(start + at..)?.first_chunk()?;
        Some(u32::from_be_bytes(*bytes))
    };
    // After the markers: length and capabilities of 2 bytes each, then far corner and offset.
    let size = |k: usize| Some(word(8 + 4 * k)?.checked_sub(word(16 + 4 * k)?)? as usize);
    Some([size(0)?, size(1)?])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn run_lengths_give_the_bytes_of_the_standard() {
        // Three samples of two bytes: high bytes 1 1 1 as a run, low bytes 5 6 7 as they are.
        let mut data = vec![0; RLE_HEAD_BYTES];
        data[0] = 2;
        data[4] = 64;
        data[8] = 66;
        data.extend([0xfe, 1, 2, 5, 6, 7]);
        let samples = decode_rle(&data, 2, 3).unwrap();
        assert_eq!(samples, [5, 1, 6, 1, 7, 1]);
        for end in 0..data.len() {
            assert_eq!(decode_rle(&data[..end], 2, 3), None, "{end}");
        }
        assert_eq!(decode_rle(&data, 1, 3), None);

        // Runs that follow one another: two bytes as they are, three equal ones, one as it is.
        let mut data = vec![0; RLE_HEAD_BYTES];
        (data[0], data[4]) = (1, 64);
        data.extend([1, 5, 6, 0xfe, 9, 0, 7]);
        assert_eq!(decode_rle(&data, 1, 6).unwrap(), [5, 6, 9, 9, 9, 7]);
    }

    #[test]
    fn the_size_of_a_jpeg_2000_is_in_its_header() {
        let mut data = b"\xff\x4f\xff\x51\0\x29\0\0".to_vec();
        for number in [70u32, 50, 6, 2] {
            data.extend(number.to_be_bytes());
        }
        assert_eq!(jpeg_2000_size(&data), Some([64, 48]));
        assert_eq!(jpeg_2000_size(&data[..20]), None);
    }
}

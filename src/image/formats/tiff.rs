//! TIFF: a page is a plane of the volume, z its number; a single page is a 2-D image.
//!
//! Grey and colour pages of every sample type, compressed or not; colours become luminance as in
//! [`png`](mod@super::png). TIFF has no geometry that all writers agree on.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::{ColorType, TiffError};

use super::packed::{DAMAGED, refuse};
use super::png::luminance;
use super::{Format, Loaded};
use crate::error::{Result, os};
use crate::image::{Geometry, Image};

/// The first bytes of TIFF and BigTIFF files.
pub const MAGIC: [&[u8]; 4] = [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"];

/// No byte of a compressed page becomes more bytes than this (deflate).
const MOST: u64 = 1032;

/// Reads a stack of pages, or one as if it had a single sample along z.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if the file cannot be read, is cut off or damaged, its pages
/// differ in size or kind, or they are coded in a way that is not read.
pub fn read(path: &Path) -> Result<Loaded> {
    let file = File::open(path).map_err(|e| os(path, "open", e))?;
    let length = file.metadata().map_err(|e| os(path, "read", e))?.len();
    let most = usize::try_from(length.saturating_mul(MOST)).unwrap_or(usize::MAX);
    let mut limits = Limits::default();
    limits.decoding_buffer_size = most;
    limits.intermediate_buffer_size = most;
    let mut pages = 0;
    let fault = |pages: usize, e: TiffError| {
        let remedy = match e {
            TiffError::UnsupportedError(_) => "write it as grey samples, uncompressed",
            _ => DAMAGED,
        };
        refuse(path, format!("page {pages}: {e}"), remedy).because(e)
    };
    let decoder = Decoder::new(BufReader::new(file)).map_err(|e| fault(0, e))?;
    let mut decoder = decoder.with_limits(limits);
    let mut first = None;
    let mut samples = Vec::new();
    loop {
        let (nx, ny) = decoder.dimensions().map_err(|e| fault(pages, e))?;
        let color = decoder.colortype().map_err(|e| fault(pages, e))?;
        let (shown, expected) = (
            format!("{nx} x {ny}, {color:?}"),
            first.get_or_insert((nx, ny, color)),
        );
        if *expected != (nx, ny, color) {
            let (a, b, c) = expected;
            let problem = format!("page {pages} is {shown}, the first {a} x {b}, {c:?}");
            return Err(refuse(path, problem, "give pages of one size and kind"));
        }
        let channels = match color {
            ColorType::Gray(_) => 1,
            ColorType::GrayA(_) => 2,
            ColorType::RGB(_) => 3,
            ColorType::RGBA(_) => 4,
            _ => {
                let problem = format!("its pages are {color:?}, neither grey nor colours");
                return Err(refuse(path, problem, "write it as grey samples"));
            }
        };
        let page = decoder.read_image().map_err(|e| fault(pages, e))?;
        let count = nx as usize * ny as usize;
        let before = samples.len();
        add(page, channels, count, &mut samples);
        if samples.len() != before + count || count == 0 {
            let problem = format!("page {pages} does not hold {shown}");
            return Err(refuse(path, problem, DAMAGED));
        }
        pages += 1;
        if !decoder.more_images() {
            break;
        }
        decoder.next_image().map_err(|e| fault(pages, e))?;
    }
    let Some((nx, ny, color)) = first else {
        return Err(refuse(path, "has no page", DAMAGED));
    };
    let mut notes = vec!["a TIFF stack has no geometry: unit spacing, origin 0".to_string()];
    if matches!(color, ColorType::RGB(_) | ColorType::RGBA(_)) {
        notes.push("colours are read as luminance (BT.709)".into());
    }
    let dims = [nx as usize, ny as usize, pages];
    Ok(Loaded {
        image: Image::new(dims, samples, Geometry::default()),
        format: Format::Tiff,
        encoding: format!("{color:?}"),
        notes,
        survey: None,
    })
}

/// Adds a page's samples; of colours their luminance, of transparency nothing.
fn add(page: DecodingResult, channels: usize, count: usize, samples: &mut Vec<f32>) {
    let mut each = |values: &mut dyn Iterator<Item = f32>| {
        if channels == 1 {
            samples.extend(values.take(count));
            return;
        }
        let values: Vec<f32> = values.take(count * channels).collect();
        let value = |pixel: &[f32]| {
            if channels == 2 {
                pixel[0]
            } else {
                luminance(pixel)
            }
        };
        samples.extend(values.chunks_exact(channels).map(value));
    };
    match page {
        DecodingResult::U8(v) => each(&mut v.into_iter().map(f32::from)),
        DecodingResult::U16(v) => each(&mut v.into_iter().map(f32::from)),
        DecodingResult::U32(v) => each(&mut v.into_iter().map(|x| x as f32)),
        DecodingResult::U64(v) => each(&mut v.into_iter().map(|x| x as f32)),
        DecodingResult::I8(v) => each(&mut v.into_iter().map(f32::from)),
        DecodingResult::I16(v) => each(&mut v.into_iter().map(f32::from)),
        DecodingResult::I32(v) => each(&mut v.into_iter().map(|x| x as f32)),
        DecodingResult::I64(v) => each(&mut v.into_iter().map(|x| x as f32)),
        DecodingResult::F16(v) => each(&mut v.into_iter().map(f32::from)),
        DecodingResult::F32(v) => each(&mut v.into_iter()),
        DecodingResult::F64(v) => each(&mut v.into_iter().map(|x| x as f32)),
    }
}

//! INRIMAGE-4 (`.inr`, `.inr.gz`), the volumes of INRIA: a header of `KEY=VALUE` lines, padded with
//! newlines to a multiple of 256 bytes, followed by the samples.
//!
//! Positions are `(TX, TY, TZ)` plus index times `(VX, VY, VZ)`; the defaults are 0 and 1.

use std::path::Path;

use super::packed::{self, DAMAGED_REMEDY, PackedSamples, SampleStart, file_error};
use super::samples::{Encoding, Endian, SampleType};
use super::{ImageFormat, LoadedImage};
use crate::error::Result;
use crate::image::Geometry;

/// First bytes of every INRIMAGE-4 file, before compression.
pub const MAGIC: &[u8] = b"#INRIMAGE-4#{";

/// Longest header that is read, in bytes.
const MAX_HEADER_BYTES: u64 = 1 << 16;

/// Reads a volume. A plane is read as a volume with a single sample along z.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if the file cannot be read, is truncated or damaged,
/// or has more than one value per sample.
pub fn read(path: &Path) -> Result<LoadedImage> {
    let (head, packing) = packed::read_head(path, MAX_HEADER_BYTES)?;
    let text = String::from_utf8_lossy(&head);
    let end = text
        .find("##}")
        .ok_or_else(|| file_error(path, "its INRIMAGE header has no end (##})", DAMAGED_REMEDY))?;
    let value = |key: &str| {
        text[..end].lines().find_map(|line| {
            let (name, value) = line.split_once('=')?;
            (name.trim() == key).then_some(value.trim())
        })
    };
    let missing = |key: &str| file_error(path, format!("its header has no {key}"), DAMAGED_REMEDY);
    let bad = |key: &str, text: &str| {
        file_error(
            path,
            format!("its header says {key}={text}"),
            DAMAGED_REMEDY,
        )
    };
    let size = |key: &str| {
        let text = value(key).ok_or_else(|| missing(key))?;
        text.parse::<usize>().map_err(|_| bad(key, text))
    };
    let number = |key: &str, default: f64| match value(key) {
        None => Ok(default),
        Some(text) => match text.parse::<f64>() {
            Ok(v) if v.is_finite() => Ok(v),
            _ => Err(bad(key, text)),
        },
    };
    if value("VDIM").is_some_and(|n| n != "1") {
        let problem = format!(
            "has {} values per sample",
            value("VDIM").unwrap_or_default()
        );
        return Err(file_error(path, problem, "give one component"));
    }
    let kind = value("TYPE").ok_or_else(|| missing("TYPE"))?;
    let bits = value("PIXSIZE").ok_or_else(|| missing("PIXSIZE"))?;
    let sample = match (kind, bits.trim_end_matches("bits").trim()) {
        ("unsigned fixed", "8") => SampleType::U8,
        ("unsigned fixed", "16") => SampleType::U16,
        ("unsigned fixed", "32") => SampleType::U32,
        ("signed fixed", "8") => SampleType::I8,
        ("signed fixed", "16") => SampleType::I16,
        ("signed fixed", "32") => SampleType::I32,
        ("float", "32") => SampleType::F32,
        ("float", "64") => SampleType::F64,
        _ => {
            let problem = format!("its samples are '{kind}' of {bits}, which is not read");
            return Err(file_error(path, problem, "give fixed or float samples"));
        }
    };
    let endian = match value("CPU") {
        Some("sun" | "sgi") => Endian::Big,
        Some("decm" | "pc" | "alpha") | None => Endian::Little,
        Some(cpu) => return Err(bad("CPU", cpu)),
    };
    let mut notes = Vec::new();
    if let Some(scale) = value("SCALE").filter(|s| !matches!(*s, "2**0" | "1")) {
        notes.push(format!("the header's scale {scale} is not applied"));
    }
    let spacing = [number("VX", 1.0)?, number("VY", 1.0)?, number("VZ", 1.0)?];
    if let Some(k) = spacing.iter().position(|&s| s == 0.0) {
        return Err(bad(["VX", "VY", "VZ"][k], "0"));
    }
    let origin = [number("TX", 0.0)?, number("TY", 0.0)?, number("TZ", 0.0)?];
    let packed = PackedSamples {
        path: path.to_path_buf(),
        offset: 0,
        packing,
        sample_start: SampleStart::Offset((end as u64 + 3).next_multiple_of(256)),
        encoding: Encoding {
            sample_type: sample,
            endian,
        },
        dims: [size("XDIM")?, size("YDIM")?, size("ZDIM")?],
    };
    let geometry = Geometry::with_spacing(origin, spacing);
    packed.load(ImageFormat::Inrimage, geometry, None, notes)
}

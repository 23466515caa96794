//! Writes a volume as a survey of its own, so that examples can begin with a SEG-Y file.

use std::io::Write;
use std::path::Path;

use super::file_header::FILE_HEADER_BYTES;
use super::text::{TEXT_HEADER_BYTES, encode};
use crate::error::{Error, Result, cause};
use crate::files::atomic_write;
use crate::image::Image;

/// Position of the first trace, in metres.
const CORNER: [i32; 2] = [600_000, 6_000_000];
/// Distance between neighbouring inlines and crosslines, in centimetres.
const PITCH_CM: i32 = 1250;
/// Sample interval in microseconds.
const INTERVAL: u16 = 4000;
/// Bytes of a trace header.
const TRACE_HEADER_BYTES: usize = 240;

/// Writes a volume as SEG-Y, revision 1, with IEEE floats, whose lines are 12.5 m apart and whose
/// samples 4 ms. Lines are numbered from 1. The image's own geometry is not used.
///
/// # Errors
/// Returns an [`Error::Io`] if a trace has more than 32,767 samples, or if the file cannot be written.
pub fn write_synthetic(path: &Path, image: &Image<3>) -> Result<()> {
    let [samples, crosslines, _] = image.dims();
    let Ok(trace_samples) = i16::try_from(samples) else {
        let problem =
            format!("a trace of SEG-Y has at most 32767 samples, and these have {samples}");
        return Err(Error::Io(cause(
            path.display(),
            problem,
            "choose other dimensions",
        )));
    };
    atomic_write(path, |out| {
        out.write_all(&file_header(trace_samples))?;
        let mut bytes = Vec::new();
        for (number, trace) in image.as_slice().chunks_exact(samples).enumerate() {
            let (inline, crossline) = (number / crosslines, number % crosslines);
            bytes.clear();
            bytes.extend(trace_header(number, [inline, crossline], trace_samples));
            bytes.extend(trace.iter().flat_map(|value| value.to_be_bytes()));
            out.write_all(&bytes)?;
        }
        Ok(())
    })
}

/// Returns the textual and the binary header of the file.
fn file_header(samples: i16) -> [u8; FILE_HEADER_BYTES] {
    let mut header = [0; FILE_HEADER_BYTES];
    header[..TEXT_HEADER_BYTES].copy_from_slice(&encode(&[
        "C 1 Synthetic survey, made by atomesh synth",
        "C 2 Inline: bytes 189-192, crossline: bytes 193-196",
        "C 3 X: bytes 181-184, Y: bytes 185-188, in cm (scalar -100 at bytes 71-72)",
        "C 4 Lines 12.5 m apart, samples 4 ms",
    ]));
    for (byte, value) in [
        (3217, INTERVAL as i16),
        (3221, samples),
        (3225, 5),
        (3255, 1),
        (3501, 0x100),
        (3503, 1),
    ] {
        header[byte - 1..=byte].copy_from_slice(&value.to_be_bytes());
    }
    header
}

/// Returns the header of trace `number`, at an inline and a crossline counted from 0.
fn trace_header(number: usize, lines: [usize; 2], samples: i16) -> [u8; TRACE_HEADER_BYTES] {
    let mut header = [0; TRACE_HEADER_BYTES];
    let [inline, crossline] = lines.map(|line| line as i32);
    let [x, y] = [(CORNER[0], crossline), (CORNER[1], inline)]
        .map(|(corner, line)| 100 * corner + PITCH_CM * line);
    let number = number as i32 + 1;
    for (byte, value) in [
        (1, number),
        (5, number),
        (21, crossline + 1),
        (181, x),
        (185, y),
        (189, inline + 1),
        (193, crossline + 1),
    ] {
        header[byte - 1..byte + 3].copy_from_slice(&value.to_be_bytes());
    }
    for (byte, value) in [(29, 1), (71, -100), (115, samples), (117, INTERVAL as i16)] {
        header[byte - 1..=byte].copy_from_slice(&value.to_be_bytes());
    }
    header
}

#[cfg(test)]
mod tests {
    use super::super::{SegyBytes, read};
    use super::*;
    use crate::image::Geometry;

    #[test]
    fn a_synthetic_survey_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("survey.sgy");
        let samples: Vec<f32> = (0..20 * 6 * 5).map(|i| (i as f32).sin()).collect();
        let image = Image::new([20, 6, 5], samples, Geometry::default());
        write_synthetic(&path, &image).unwrap();
        let loaded = read(&path, &SegyBytes::default()).unwrap();
        assert_eq!(loaded.image.dims(), [20, 6, 5]);
        assert_eq!(loaded.image.as_slice(), image.as_slice());
        let geometry = &loaded.image.geometry;
        let last = geometry.to_physical([19.0, 5.0, 4.0]);
        let expected = [600_062.5, 6_000_050.0, -76.0];
        for (value, expected) in last.into_iter().zip(expected) {
            assert!((value - expected).abs() < 1e-6, "{last:?}");
        }
        let is_placed =
            |note: &String| note.starts_with("placed by X, Y") && note.contains("0.000 at most");
        assert!(loaded.notes.iter().all(is_placed), "{:?}", loaded.notes);
    }
}

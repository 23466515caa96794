//! Tests with SEG-Y files that this module builds byte by byte.
//!
//! - `synthetic`: reads the built files
//! - `real_data`: reads real files, if they are available

mod real_data;
mod synthetic;

use std::path::Path;

use super::file_header::FILE_HEADER_BYTES;
use super::*;
use crate::image::Image;
use crate::image::formats::{self, ReadOptions, segy};

/// A trace: its header fields as (first byte, width, value), and its samples.
#[derive(Clone)]
struct TestTrace {
    fields: Vec<(usize, usize, i64)>,
    samples: Vec<f64>,
}

#[derive(Clone)]
struct SegyBuilder {
    is_little_endian: bool,
    format: i64,
    /// Fields of the binary header: (byte in the file, width, value).
    fields: Vec<(usize, usize, i64)>,
    extended_text: Vec<&'static str>,
    traces: Vec<TestTrace>,
}

const SAMPLES_PER_TRACE: usize = 6;

/// Returns the sample at an inline, crossline and sample index. It is exact in every format,
/// including 8-bit formats.
fn sample_value(i: usize, c: usize, k: usize) -> f64 {
    ((i * 31 + c * 7 + k * 3) % 120) as f64 - 40.0
}

/// Returns the position of a trace in a survey of 4 inlines 10, 12, ... and 3 crosslines 100, 105,
/// ..., which is rotated by 30 degrees and far from the origin.
fn trace_position(i: usize, c: usize) -> [f64; 2] {
    let (sin, cos) = 30f64.to_radians().sin_cos();
    let (a, b) = (25.0 * i as f64, 12.5 * c as f64);
    [
        620_000.0 + a * cos - b * sin,
        6_070_000.0 + a * sin + b * cos,
    ]
}

fn trace(i: usize, c: usize) -> TestTrace {
    let [x, y] = trace_position(i, c).map(|v| (v * 100.0).round() as i64);
    TestTrace {
        fields: vec![
            (189, 4, 10 + 2 * i as i64),
            (193, 4, 100 + 5 * c as i64),
            (181, 4, x),
            (185, 4, y),
            (71, 2, -100),
            (109, 2, 48),
        ],
        samples: (0..SAMPLES_PER_TRACE)
            .map(|k| sample_value(i, c, k))
            .collect(),
    }
}

fn survey() -> SegyBuilder {
    let cells = (0..4).flat_map(|i| (0..3).map(move |c| (i, c)));
    SegyBuilder {
        is_little_endian: false,
        format: 5,
        fields: vec![(3217, 2, 4000), (3255, 2, 1)],
        extended_text: Vec::new(),
        traces: cells.map(|(i, c)| trace(i, c)).collect(),
    }
}

fn to_ibm(v: f64) -> u32 {
    if v == 0.0 {
        return 0;
    }
    let mut exponent = 64;
    let mut fraction = v.abs();
    while fraction >= 1.0 {
        fraction /= 16.0;
        exponent += 1;
    }
    while fraction < 1.0 / 16.0 {
        fraction *= 16.0;
        exponent -= 1;
    }
    u32::from(v < 0.0) << 31 | exponent << 24 | (fraction * f64::from(1 << 24)) as u32
}

impl SegyBuilder {
    fn write_field(&self, out: &mut [u8], (byte, width, value): (usize, usize, i64)) {
        let field = &mut out[byte - 1..byte - 1 + width];
        field.copy_from_slice(&value.to_be_bytes()[8 - width..]);
        if self.is_little_endian {
            field.reverse();
        }
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut out = vec![b' '; 3200];
        out[..11].copy_from_slice(b"C 1 MADE UP");
        out.resize(FILE_HEADER_BYTES, 0);
        self.write_field(&mut out, (3221, 2, SAMPLES_PER_TRACE as i64));
        self.write_field(&mut out, (3225, 2, self.format));
        self.write_field(&mut out, (3505, 2, self.extended_text.len() as i64));
        for &field in &self.fields {
            self.write_field(&mut out, field);
        }
        for text in &self.extended_text {
            out.extend(text.bytes().chain(std::iter::repeat(b' ')).take(3200));
        }
        for trace in &self.traces {
            let mut header = vec![0; 240];
            for &field in &trace.fields {
                self.write_field(&mut header, field);
            }
            out.extend(header);
            for &v in &trace.samples {
                let (bits, width) = match self.format {
                    1 => (i64::from(to_ibm(v)), 4),
                    5 => (i64::from((v as f32).to_bits()), 4),
                    6 => (v.to_bits() as i64, 8),
                    2 | 10 => (v as i64, 4),
                    3 | 11 => (v as i64, 2),
                    7 | 15 => (v as i64, 3),
                    8 | 16 => (v as i64, 1),
                    _ => (v as i64, 8),
                };
                let mut sample = bits.to_be_bytes()[8 - width..].to_vec();
                if self.is_little_endian {
                    sample.reverse();
                }
                out.extend(sample);
            }
        }
        out
    }

    fn read(&self) -> Result<LoadedImage> {
        self.read_with(&SegyBytes::default())
    }

    fn read_with(&self, bytes: &SegyBytes) -> Result<LoadedImage> {
        with_file(&self.to_bytes(), |path| segy::read(path, bytes))
    }

    fn scan(&self) -> SegyInfo {
        with_file(&self.to_bytes(), |path| {
            segy::scan(path, &SegyBytes::default()).unwrap().0
        })
    }

    fn error_message(&self) -> String {
        self.read().unwrap_err().to_string()
    }

    fn set_field(&mut self, trace: usize, byte: usize, width: usize, value: i64) {
        self.traces[trace].fields.push((byte, width, value));
    }
}

fn with_file<T>(bytes: &[u8], job: impl FnOnce(&Path) -> T) -> T {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("made.sgy");
    std::fs::write(&path, bytes).unwrap();
    job(&path)
}

fn assert_values(image: &Image<3>) {
    assert_eq!(image.dims(), [SAMPLES_PER_TRACE, 3, 4]);
    for ((i, c, k), v) in ndarray::indices((4, 3, SAMPLES_PER_TRACE))
        .into_iter()
        .zip(image.as_slice())
    {
        assert_eq!(
            f64::from(*v),
            sample_value(i, c, k),
            "inline {i} crossline {c} sample {k}"
        );
    }
}

fn has_note(loaded: &LoadedImage, text: &str) -> bool {
    loaded.notes.iter().any(|note| note.contains(text))
}

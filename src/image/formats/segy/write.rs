//! Writes a volume with the headers of a SEG-Y file: all bytes of the file but the samples.

use std::fmt::{self, Display, Formatter};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::str::FromStr;

use super::SegySurvey;
use super::bytes::SegyBytes;
use super::file_header::SegyFile;
use super::grid::{NO_TRACE, TraceGrid};
use crate::error::{Error, Result, cause, io_error};
use crate::files::{atomic_write, read_exact_at};
use crate::image::Image;
use crate::image::formats::samples::{Encoding, Endian, SampleType};
use crate::option_text::serde_as_text;

/// Position in the file of the code of the sample format.
const FORMAT_OFFSET: u64 = 3224;

/// Formats of the samples of a file that is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SegyFloat {
    /// IBM floating point.
    Ibm,
    /// IEEE floating point.
    Ieee,
}

impl FromStr for SegyFloat {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text {
            "ibm" => Ok(Self::Ibm),
            "ieee" => Ok(Self::Ieee),
            _ => Err("is not ibm or ieee".into()),
        }
    }
}

impl Display for SegyFloat {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ibm => "ibm",
            Self::Ieee => "ieee",
        })
    }
}

serde_as_text!(SegyFloat: [","; 2]);

/// Writes an image with the headers of the SEG-Y file `template`, whose fields are at `bytes`.
/// Traces have the order of the template. Samples have the template's format, or IEEE floats if that
/// is a format of integers, unless `float` is given. Returns notes.
///
/// # Errors
/// Returns [`Error::Io`] if the template is not a volume with as many samples as the image, or if a
/// file cannot be read or written.
pub fn write_like(
    path: &Path,
    image: &Image<3>,
    template: &Path,
    bytes: &SegyBytes,
    float: Option<SegyFloat>,
) -> Result<Vec<String>> {
    let survey = SegySurvey::open(template, bytes)?;
    if let Some(problem) = survey.problem {
        return Err(Error::Io(problem));
    }
    let Some(grid) = &survey.grid else {
        let problem = "is not a survey with inlines and crosslines";
        return Err(Error::Io(cause(
            template.display(),
            problem,
            "give the SEG-Y file of a volume",
        )));
    };
    check_dims(&survey.file, grid, image, template)?;
    let layout = &survey.file;
    let (sample_type, format_code) = written_format(float, layout.encoding.sample_type);
    let cell_of_trace = cell_of_trace(grid, layout.trace_count);
    let notes = notes_on_samples(layout, image, &cell_of_trace, float, sample_type);
    let (head, tail) = read_head_and_tail(layout, template, format_code)?;
    let encoding = Encoding {
        sample_type,
        endian: layout.encoding.endian,
    };
    let samples = image.as_slice();
    let trace_samples = layout.samples_per_trace;
    atomic_write(path, |out| {
        out.write_all(&head)?;
        let mut header = vec![0; layout.trace_header_bytes];
        let mut encoded: Vec<u8> = Vec::new();
        for (trace, &cell) in cell_of_trace.iter().enumerate() {
            let offset = layout.traces_offset + trace as u64 * layout.trace_bytes();
            read_exact_at(&layout.file, &mut header, offset)?;
            out.write_all(&header)?;
            encoded.clear();
            let values = match cell {
                NO_TRACE => None,
                cell => samples.get(cell * trace_samples..(cell + 1) * trace_samples),
            };
            for k in 0..trace_samples {
                let value = values.map_or(0.0, |values| values[k]);
                encode_sample(value, encoding, &mut encoded);
            }
            out.write_all(&encoded)?;
        }
        out.write_all(&tail)
    })?;
    Ok(notes)
}

/// Checks that the image has as many samples as the volume of the template.
fn check_dims(
    layout: &SegyFile,
    grid: &TraceGrid,
    image: &Image<3>,
    template: &Path,
) -> Result<()> {
    let lines = [grid.crossline.count, grid.inline.count].map(|count| count as usize);
    let dims = [layout.samples_per_trace, lines[0], lines[1]];
    if dims == image.dims() {
        return Ok(());
    }
    let problem = format!(
        "has {dims:?} samples (along traces, crosslines and inlines), but the volume {:?}",
        image.dims()
    );
    let remedy = "give the SEG-Y file from which the volume was made";
    Err(Error::Io(cause(template.display(), problem, remedy)))
}

/// Returns the type of the samples that are written, and its code in a SEG-Y file. `original` is the
/// type of the template's samples.
fn written_format(float: Option<SegyFloat>, original: SampleType) -> (SampleType, u16) {
    match (float, original) {
        (Some(SegyFloat::Ibm), _) | (None, SampleType::Ibm32) => (SampleType::Ibm32, 1),
        (None, SampleType::F64) => (SampleType::F64, 6),
        _ => (SampleType::F32, 5),
    }
}

/// Returns the cell of each trace; [`NO_TRACE`] for a trace that no cell has.
fn cell_of_trace(grid: &TraceGrid, trace_count: usize) -> Vec<usize> {
    let mut cell_of_trace = vec![NO_TRACE; trace_count];
    for (cell, &trace) in grid.traces.iter().enumerate() {
        if trace != NO_TRACE {
            cell_of_trace[trace] = cell;
        }
    }
    cell_of_trace
}

/// Returns notes on samples that differ from those of the template or of the image. The last argument
/// has the format that the user gave, and the type of the samples that are written.
fn notes_on_samples(
    layout: &SegyFile,
    image: &Image<3>,
    cell_of_trace: &[usize],
    float: Option<SegyFloat>,
    sample_type: SampleType,
) -> Vec<String> {
    let mut notes = Vec::new();
    let original = layout.encoding.sample_type;
    let is_float = matches!(
        original,
        SampleType::Ibm32 | SampleType::F32 | SampleType::F64
    );
    if float.is_none() && !is_float {
        notes.push(format!(
            "samples are IEEE floats, as the template's ({}) hold integers",
            layout.encoding
        ));
    }
    let unused = cell_of_trace
        .iter()
        .filter(|cell| **cell == NO_TRACE)
        .count();
    if unused > 0 {
        notes.push(format!(
            "{unused} traces that repeat a line and a crossline of the template are zero"
        ));
    }
    let invalid = image.as_slice().iter().filter(|v| !v.is_finite()).count();
    if sample_type == SampleType::Ibm32 && invalid > 0 {
        notes.push(format!(
            "{invalid} samples without a value are 0: IBM floats have no NaN"
        ));
    }
    notes
}

/// Reads the bytes of the template before and after its traces, and puts the code of the sample format
/// into the former.
fn read_head_and_tail(
    layout: &SegyFile,
    template: &Path,
    format_code: u16,
) -> Result<(Vec<u8>, Vec<u8>)> {
    let read_error = |e| io_error(template, "read", e);
    let mut file = File::open(template).map_err(read_error)?;
    let mut head = vec![0; layout.traces_offset as usize];
    file.read_exact(&mut head).map_err(read_error)?;
    let code = in_order(format_code.to_be_bytes(), layout.encoding.endian);
    head[FORMAT_OFFSET as usize..][..2].copy_from_slice(&code);
    let mut tail = Vec::new();
    let end = layout.traces_offset + layout.trace_count as u64 * layout.trace_bytes();
    file.seek(SeekFrom::Start(end)).map_err(read_error)?;
    file.read_to_end(&mut tail).map_err(read_error)?;
    Ok((head, tail))
}

/// Appends the bytes of a sample: an IBM float or an IEEE float of 4 or 8 bytes.
fn encode_sample(value: f32, encoding: Encoding, encoded: &mut Vec<u8>) {
    let endian = encoding.endian;
    match encoding.sample_type {
        SampleType::F64 => encoded.extend(in_order(f64::from(value).to_be_bytes(), endian)),
        SampleType::Ibm32 => encoded.extend(in_order(to_ibm(value).to_be_bytes(), endian)),
        _ => encoded.extend(in_order(value.to_be_bytes(), endian)),
    }
}

/// Returns big-endian bytes in another byte order.
fn in_order<const N: usize>(mut bytes: [u8; N], endian: Endian) -> [u8; N] {
    if endian == Endian::Little {
        bytes.reverse();
    }
    bytes
}

/// Returns the IBM float nearest to a number: a sign, an exponent of 16 with an offset of 64, and 24
/// bits of a fraction from 1/16 to 1. NaN and infinities are 0.
fn to_ibm(value: f32) -> u32 {
    let magnitude = f64::from(value.abs());
    if magnitude == 0.0 || !magnitude.is_finite() {
        return 0;
    }
    // The number is m 2^e with m from 1 to 2, so that its fraction is m 2^e / 16^exponent.
    let e = ((magnitude.to_bits() >> 52) as i32) - 1023;
    let mut exponent = e.div_euclid(4) + 1;
    let mut fraction = (magnitude * 2f64.powi(24 - 4 * exponent)).round_ties_even() as u32;
    if fraction == 1 << 24 {
        exponent += 1;
        fraction >>= 4;
    }
    u32::from(value.is_sign_negative()) << 31 | ((exponent + 64) as u32) << 24 | fraction
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;

    fn from_ibm(bits: u32) -> f32 {
        let encoding = Encoding {
            sample_type: SampleType::Ibm32,
            endian: Endian::Big,
        };
        let mut value = [0.0];
        encoding.decode(&bits.to_be_bytes(), &mut value);
        value[0]
    }

    #[test]
    fn ibm_floats_are_the_nearest() {
        // Of the definition: -118.625 is C276A000.
        assert_eq!(to_ibm(-118.625), 0xc276_a000);
        assert_eq!([0.0, -0.0, f32::NAN].map(to_ibm), [0; 3]);
        let mut random = Random::new(3);
        for i in 0..20_000 {
            let exponent = random.range(-90.0, 90.0);
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            let value = (sign * 2f64.powf(exponent)) as f32;
            let back = from_ibm(to_ibm(value));
            assert!(
                ((back - value) / value).abs() <= 2f32.powi(-21),
                "{value} {back}"
            );
            // What an IBM float can hold remains the same.
            assert_eq!(from_ibm(to_ibm(back)), back);
            assert_eq!(to_ibm(back), to_ibm(value));
        }
        assert_eq!(from_ibm(to_ibm(f32::MAX)), f32::MAX);
        assert_eq!(
            from_ibm(to_ibm(1.0 - f32::EPSILON / 2.0)),
            1.0 - f32::EPSILON / 2.0
        );
    }
}

//! Sample types of files, and their conversion to `f32`.

use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;

use crate::image::ExactLabels;
use crate::image::labels::{ExactSample, LabelCollector};
use crate::parallel::prelude::*;
use half::f16;

use super::stream::SlabSource;
use crate::files::read_exact_at;
use crate::{Result, memory};

/// Type of one sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // The names are self-explanatory.
pub enum SampleType {
    Bool,
    I8,
    U8,
    I16,
    U16,
    I24,
    U24,
    I32,
    U32,
    I64,
    U64,
    F16,
    F32,
    F64,
    /// IBM System/360 single precision: sign, 7-bit exponent of 16, 24-bit fraction.
    Ibm32,
}

/// Order of the bytes of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Endian {
    Little,
    Big,
}

/// Checks that there is enough memory for `count` samples of a file.
///
/// # Errors
/// Returns an [`Error::Job`](crate::Error::Job) if there is not.
pub fn check_memory(path: &Path, count: usize) -> Result<()> {
    // Every use of an image needs a second field of the same size.
    let bytes = 8.0 * count as f64;
    let description = format!("{count} samples");
    memory::ensure_available(
        path.display(),
        bytes,
        description,
        "give a part of the image",
    )
}

/// Allocates memory for `count` samples of a file, all zero.
///
/// # Errors
/// Returns the errors of [`check_memory`].
pub fn allocate(path: &Path, count: usize) -> Result<Vec<f32>> {
    check_memory(path, count)?;
    Ok(vec![0.0; count])
}

/// Encoding of the samples in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Encoding {
    /// Type of one sample.
    pub sample_type: SampleType,
    /// Order of its bytes.
    pub endian: Endian,
}

impl std::fmt::Display for Encoding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let name = match self.sample_type {
            SampleType::Bool => "1-byte logical",
            SampleType::I8 => "8-bit integer",
            SampleType::U8 => "8-bit unsigned integer",
            SampleType::I16 => "16-bit integer",
            SampleType::U16 => "16-bit unsigned integer",
            SampleType::I24 => "24-bit integer",
            SampleType::U24 => "24-bit unsigned integer",
            SampleType::I32 => "32-bit integer",
            SampleType::U32 => "32-bit unsigned integer",
            SampleType::I64 => "64-bit integer",
            SampleType::U64 => "64-bit unsigned integer",
            SampleType::F16 => "16-bit IEEE float",
            SampleType::F32 => "32-bit IEEE float",
            SampleType::F64 => "64-bit IEEE float",
            SampleType::Ibm32 => "32-bit IBM float",
        };
        match (self.size(), self.endian) {
            (1, _) => write!(f, "{name}"),
            (_, Endian::Little) => write!(f, "{name}, little-endian"),
            (_, Endian::Big) => write!(f, "{name}, big-endian"),
        }
    }
}

/// Warning that integers were rounded when they were converted to `f32`.
pub const ROUNDING_NOTE: &str =
    "integers beyond 16777216 are rounded to 32-bit floats; as labels they are exact";

/// Returns `true` if a sample may be the rounded value of an integer of more than 24 bits.
pub fn may_be_rounded(samples: &[f32]) -> bool {
    samples.iter().any(|v| v.abs() >= 16_777_216.0)
}

impl Encoding {
    /// Returns the number of bytes of one sample.
    pub fn size(self) -> usize {
        match self.sample_type {
            SampleType::Bool | SampleType::I8 | SampleType::U8 => 1,
            SampleType::I16 | SampleType::U16 | SampleType::F16 => 2,
            SampleType::I24 | SampleType::U24 => 3,
            SampleType::I32 | SampleType::U32 | SampleType::F32 | SampleType::Ibm32 => 4,
            SampleType::I64 | SampleType::U64 | SampleType::F64 => 8,
        }
    }

    /// Returns a warning if integers were rounded when they were converted to `f32`, which holds 24
    /// bits.
    pub fn rounding_note(self, samples: &[f32]) -> Option<String> {
        (self.is_wide_integer() && may_be_rounded(samples)).then(|| ROUNDING_NOTE.to_string())
    }

    /// Returns `true` if the samples are integers of more bits than `f32` holds.
    pub fn is_wide_integer(self) -> bool {
        use SampleType::*;
        matches!(self.sample_type, I32 | U32 | I64 | U64)
    }

    /// Returns `true` if these samples, converted to `f32`, may be whole numbers that were rounded:
    /// integers of more than 24 bits, or 64-bit floats.
    pub fn may_need_exact_labels(self, samples: &[f32]) -> bool {
        (self.is_wide_integer() || self.sample_type == SampleType::F64) && may_be_rounded(samples)
    }

    /// Converts `bytes` (`out.len()` samples) to `f32`, each rounded to the nearest value.
    pub fn decode(self, bytes: &[u8], out: &mut [f32]) {
        // The byte order is resolved outside the loops, so that each loop vectorises.
        macro_rules! decode_as {
            ($type:ty, $convert:expr) => {
                match self.endian {
                    Endian::Little => convert(bytes, out, |b| $convert(<$type>::from_le_bytes(b))),
                    Endian::Big => convert(bytes, out, |b| $convert(<$type>::from_be_bytes(b))),
                }
            };
        }
        match self.sample_type {
            SampleType::Bool => convert(bytes, out, |[b]| f32::from(u8::from(b != 0))),
            SampleType::I8 => convert(bytes, out, |[b]| f32::from(b as i8)),
            SampleType::U8 => convert(bytes, out, |[b]| f32::from(b)),
            SampleType::I16 => decode_as!(i16, f32::from),
            SampleType::U16 => decode_as!(u16, f32::from),
            SampleType::I24 => match self.endian {
                // The sample fills the upper three bytes; the arithmetic shift then keeps the sign.
                Endian::Little => convert(bytes, out, |[a, b, c]| {
                    (i32::from_le_bytes([0, a, b, c]) >> 8) as f32
                }),
                Endian::Big => convert(bytes, out, |[a, b, c]| {
                    (i32::from_be_bytes([a, b, c, 0]) >> 8) as f32
                }),
            },
            SampleType::U24 => match self.endian {
                Endian::Little => convert(bytes, out, |[a, b, c]| {
                    u32::from_le_bytes([a, b, c, 0]) as f32
                }),
                Endian::Big => convert(bytes, out, |[a, b, c]| {
                    u32::from_be_bytes([0, a, b, c]) as f32
                }),
            },
            SampleType::I32 => decode_as!(i32, |v| v as f32),
            SampleType::U32 => decode_as!(u32, |v| v as f32),
            SampleType::I64 => decode_as!(i64, |v| v as f32),
            SampleType::U64 => decode_as!(u64, |v| v as f32),
            SampleType::F16 => decode_as!(f16, f16::to_f32),
            SampleType::F32 => decode_as!(f32, |v| v),
            SampleType::F64 => decode_as!(f64, |v| v as f32),
            SampleType::Ibm32 => decode_as!(u32, from_ibm),
        }
    }

    /// Returns the sample in these bytes as a float, and exactly.
    fn number(self, raw: &[u8]) -> (f64, ExactSample) {
        // Bytes with the most significant byte first.
        let mut bits = [0; 8];
        let tail = &mut bits[8 - raw.len().min(8)..];
        tail.copy_from_slice(&raw[..tail.len()]);
        if self.endian == Endian::Little {
            tail.reverse();
        }
        let bits = u64::from_be_bytes(bits);
        let whole = |number: i128| (number as f64, ExactSample::Whole(number));
        let real = |number: f64| (number, number.into());
        match self.sample_type {
            SampleType::I32 => whole((bits as u32 as i32).into()),
            SampleType::I64 => whole((bits as i64).into()),
            SampleType::U32 | SampleType::U64 => whole(bits.into()),
            SampleType::F64 => real(f64::from_bits(bits)),
            _ => {
                let mut out = [0.0];
                self.decode(raw, &mut out);
                real(out[0].into())
            }
        }
    }

    /// Converts `bytes` to 64-bit floats.
    pub fn numbers(self, bytes: &[u8]) -> impl Iterator<Item = f64> {
        let samples = bytes.chunks_exact(self.size());
        samples.map(move |raw| self.number(raw).0)
    }

    /// Converts `bytes` to exact samples.
    pub fn exact_samples(self, bytes: &[u8]) -> impl Iterator<Item = ExactSample> {
        let samples = bytes.chunks_exact(self.size());
        samples.map(move |raw| self.number(raw).1)
    }

    /// Reads `count` samples that start at byte `offset` of `file` as exact labels. Returns `None`
    /// if some have a fraction.
    ///
    /// # Errors
    /// Returns the error of the operating system, also if the file is too short.
    pub fn read_exact_labels(
        self,
        file: &File,
        offset: u64,
        count: usize,
    ) -> io::Result<Option<Arc<ExactLabels>>> {
        let (mut collector, mut buffer) = (LabelCollector::default(), Vec::new());
        let mut position = offset;
        let mut remaining = count * self.size();
        while remaining > 0 {
            buffer.resize(remaining.min(1 << 20), 0);
            read_exact_at(file, &mut buffer, position)?;
            if !collector.extend_exact(self.exact_samples(&buffer)) {
                return Ok(None);
            }
            position += buffer.len() as u64;
            remaining -= buffer.len();
        }
        Ok(collector.finish_exact())
    }

    /// Reads and converts `out.len()` samples that start at byte `offset` of `file`, in parallel.
    ///
    /// # Errors
    /// Returns the error of the operating system, also if the file is too short.
    pub fn read(self, file: &File, offset: u64, out: &mut [f32]) -> io::Result<()> {
        // The allocator reuses such small buffers without a system call.
        const CHUNK: usize = 1 << 14;
        let size = self.size();
        out.par_chunks_mut(CHUNK)
            .enumerate()
            .try_for_each_init(Vec::new, |buffer, (i, chunk)| {
                buffer.resize(chunk.len() * size, 0);
                read_exact_at(file, buffer, offset + (i * CHUNK * size) as u64)?;
                self.decode(buffer, chunk);
                Ok(())
            })
    }
}

/// Writes samples as little-endian `f32`.
///
/// # Errors
/// Returns the error of the operating system.
pub fn write(writer: &mut impl io::Write, samples: &[f32]) -> io::Result<()> {
    let mut bytes = Vec::new();
    for chunk in samples.chunks(1 << 14) {
        bytes.clear();
        bytes.extend(chunk.iter().flat_map(|v| v.to_le_bytes()));
        writer.write_all(&bytes)?;
    }
    Ok(())
}

/// Writes samples as little-endian `f32`, slab by slab.
///
/// # Errors
/// Returns the error of the operating system, or the error of reading the samples.
pub fn write_slabs(writer: &mut impl io::Write, slabs: &dyn SlabSource) -> io::Result<()> {
    slabs.for_each_slab(1, &mut |slab| write(writer, slab))
}

fn convert<const N: usize>(bytes: &[u8], out: &mut [f32], value: impl Fn([u8; N]) -> f32) {
    for (out, raw) in out.iter_mut().zip(bytes.as_chunks().0) {
        *out = value(*raw);
    }
}

/// Converts an IBM float to `f32`: `(-1)^s * fraction * 16^(exponent - 64)`, where the fraction is
/// 24 bits after the binary point. Values beyond the range of `f32` become infinite.
fn from_ibm(bits: u32) -> f32 {
    let fraction = f64::from((bits & 0x00ff_ffff) as i32);
    let exponent = u64::from(bits >> 24 & 0x7f);
    // 16^(e - 64) / 2^24 = 2^(4e - 280), written as the exponent bits of an f64.
    let scale = f64::from_bits((4 * exponent + 1023 - 280) << 52);
    let magnitude = (fraction * scale) as f32;
    f32::from_bits(magnitude.to_bits() | bits & 0x8000_0000)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decode(sample: SampleType, endian: Endian, bytes: &[u8]) -> Vec<f32> {
        let encoding = Encoding {
            sample_type: sample,
            endian,
        };
        let mut out = vec![f32::NAN; bytes.len() / encoding.size()];
        encoding.decode(bytes, &mut out);
        out
    }

    #[test]
    fn both_byte_orders_of_every_type() {
        use SampleType::*;
        let cases: &[(SampleType, &[u8], f32)] = &[
            (Bool, &[2], 1.0),
            (I8, &[0xfe], -2.0),
            (U8, &[0xfe], 254.0),
            (I16, &[0xff, 0xfe], -2.0),
            (U16, &[0xff, 0xfe], 65534.0),
            (I24, &[0xff, 0xff, 0xfe], -2.0),
            (U24, &[0xff, 0xff, 0xfe], 16777214.0),
            (I32, &[0xff, 0xff, 0xff, 0xfe], -2.0),
            (U32, &[0x00, 0x01, 0x00, 0x01], 65537.0),
            (I64, &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xfe], -2.0),
            (U64, &[0, 0, 0, 0, 0, 1, 0, 1], 65537.0),
            (F16, &[0xc1, 0x00], -2.5),
            (F32, &[0xc0, 0x20, 0, 0], -2.5),
            (F64, &[0xc0, 0x04, 0, 0, 0, 0, 0, 0], -2.5),
            (Ibm32, &[0xc1, 0x28, 0, 0], -2.5),
        ];
        for (sample, big, value) in cases {
            let little: Vec<u8> = big.iter().rev().copied().collect();
            assert_eq!(decode(*sample, Endian::Big, big), [*value], "{sample:?}");
            assert_eq!(
                decode(*sample, Endian::Little, &little),
                [*value],
                "{sample:?}"
            );
        }
    }

    #[test]
    fn ibm_floats() {
        // The first value is the worked example of the System/360 manuals; others are the ends of
        // the range.
        for (bits, value) in [
            (0xc276_a000, -118.625),
            (0x4110_0000, 1.0),
            (0x0000_0000, 0.0),
            (0x4019_999a, 0.100_000_024),
            (0x7fff_ffff, f32::INFINITY),
            (0x0010_0000, 0.0),
        ] {
            assert_eq!(from_ibm(bits), value, "{bits:x}");
        }
        // Unnormalised fractions are legal.
        assert_eq!(from_ibm(0x4200_1000), 1.0 / 16.0);
    }
}

//! Values of samples: bits of stored integers, padding, and the transform to values of the modality.
//!
//! Source: DICOM PS3.3, C.7.6.3 (image pixel), C.7.5.1.1.2 (pixel padding), C.11.1 (modality lookup
//! table) and C.8.8.3 (dose grid).

use dicom_dictionary_std::tags;
use dicom_object::Tag;

use super::super::samples::{Encoding, Endian, SampleType};
use super::compressed::{Codec, StoredSamples, stored_samples};
use super::dataset::{DataSet, DicomFile, integer, items, numbers, text};
use crate::error::Result;

/// Remedy for files that are not pictures of one number for each sample.
const GREY_REMEDY: &str = "give a scan, with one number for each sample";

/// How the samples of a file are stored, and what they stand for.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SampleFormat {
    /// Number of samples of a row.
    pub columns: usize,
    /// Number of rows.
    pub rows: usize,
    /// Number of bits that a sample takes.
    pub allocated: u32,
    /// Number of bits that count.
    stored: u32,
    /// The lowest bit that counts.
    shift: u32,
    is_signed: bool,
    /// The element of the samples.
    pub element: Tag,
    /// Smallest and largest stored value of samples without data.
    padding: Option<[i64; 2]>,
    /// Value of floats without data.
    float_padding: Option<f64>,
    table: Option<LookupTable>,
}

/// Values for stored integers.
#[derive(Debug, Clone, PartialEq)]
struct LookupTable {
    /// The stored value of the first entry.
    first: i64,
    values: Vec<u16>,
}

impl SampleFormat {
    /// Returns how the samples of a file are stored. `has_indices` is `true` for segmentations, whose
    /// samples may be indices of colours, and whose padding is their background.
    ///
    /// # Errors
    /// Returns an [`Error::Io`](crate::Error::Io) if these are no single numbers of a known size.
    pub fn from_file(file: &DicomFile, has_indices: bool) -> Result<Self> {
        let set = &file.data;
        let size = |tag: Tag| {
            integer(set, tag)
                .and_then(|n| usize::try_from(n).ok())
                .filter(|&n| n > 0)
        };
        let (Some(columns), Some(rows)) = (size(tags::COLUMNS), size(tags::ROWS)) else {
            return Err(file.error("holds no image", GREY_REMEDY));
        };
        let colors = text(set, tags::PHOTOMETRIC_INTERPRETATION).unwrap_or_default();
        let is_grey = colors.is_empty()
            || colors.starts_with("MONOCHROME")
            || (has_indices && colors == "PALETTE COLOR");
        let channels = integer(set, tags::SAMPLES_PER_PIXEL).unwrap_or(1);
        if !is_grey || channels != 1 {
            let problem = format!("is a picture in colours ({colors})");
            return Err(file.error(problem, GREY_REMEDY));
        }
        let allocated = integer(set, tags::BITS_ALLOCATED).unwrap_or(0);
        let stored = integer(set, tags::BITS_STORED).unwrap_or(allocated);
        let high = integer(set, tags::HIGH_BIT).unwrap_or(stored - 1);
        let has = |tag: Tag| set.get(tag).is_some();
        // Headers that were read without samples have the attributes of floats alone.
        let element = match allocated {
            64 => tags::DOUBLE_FLOAT_PIXEL_DATA,
            32 if has(tags::FLOAT_PIXEL_DATA)
                || (!has(tags::PIXEL_DATA) && !has(tags::PIXEL_REPRESENTATION)) =>
            {
                tags::FLOAT_PIXEL_DATA
            }
            _ => tags::PIXEL_DATA,
        };
        let is_known = matches!(allocated, 1 | 8 | 16 | 32 | 64)
            && (1..=allocated).contains(&stored)
            && (stored - 1..allocated).contains(&high);
        if !is_known {
            let problem = format!(
                "stores samples as {stored} of {allocated} bits, the highest of number {high}"
            );
            return Err(file.error(problem, "write it with samples of 8, 16 or 32 bits"));
        }
        let is_signed = integer(set, tags::PIXEL_REPRESENTATION) == Some(1);
        let mut format = Self {
            columns,
            rows,
            allocated: allocated as u32,
            stored: stored as u32,
            shift: (high + 1 - stored) as u32,
            is_signed,
            element,
            padding: None,
            float_padding: None,
            table: None,
        };
        if !has_indices {
            format.padding = padding(set, format.allocated, is_signed);
            format.float_padding = [
                tags::FLOAT_PIXEL_PADDING_VALUE,
                tags::DOUBLE_FLOAT_PIXEL_PADDING_VALUE,
            ]
            .into_iter()
            .find_map(|tag| numbers(set, tag)?.first().copied());
            format.table = lookup_table(file, is_signed)?;
        }
        Ok(format)
    }

    /// Returns the number of samples of a frame.
    pub fn count(&self) -> usize {
        self.columns.saturating_mul(self.rows)
    }

    /// Returns the number of bytes of a sample.
    pub fn sample_bytes(&self) -> usize {
        self.allocated.div_ceil(8) as usize
    }

    /// Returns the type of samples as those of other files.
    pub fn encoding(&self) -> Encoding {
        use SampleType::*;
        let is_float = self.element != tags::PIXEL_DATA;
        let sample_type = match (self.allocated, self.is_signed) {
            (1, _) => Bool,
            (..=8, false) => U8,
            (..=8, true) => I8,
            (..=16, false) => U16,
            (..=16, true) => I16,
            (..=32, _) if is_float => F32,
            (..=32, false) => U32,
            (..=32, true) => I32,
            _ => F64,
        };
        Encoding {
            sample_type,
            endian: Endian::Little,
        }
    }

    /// Returns a description of the samples.
    pub fn describe(&self, codec: Codec) -> String {
        let encoding = self.encoding().to_string();
        let kind = encoding.split(',').next().unwrap_or_default();
        let bits = if self.stored < self.allocated {
            format!(" of {} bits", self.stored)
        } else {
            String::new()
        };
        format!("{kind}{bits}{}", codec.suffix())
    }

    /// Returns notes about samples that do not have the stored values.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if let Some([low, high]) = self.padding {
            let range = if low == high {
                low.to_string()
            } else {
                format!("{low} to {high}")
            };
            notes.push(format!(
                "samples stored as {range} (pixel padding) hold no data"
            ));
        }
        if let Some(value) = self.float_padding {
            notes.push(format!("samples of {value} (pixel padding) hold no data"));
        }
        if self.table.is_some() {
            notes.push("values are those of the file's modality lookup table".into());
        }
        notes
    }

    /// Returns the value of a stored sample, scaled by slope and intercept.
    fn value(&self, raw: u32, [slope, intercept]: [f64; 2]) -> f32 {
        let whole = extended(raw, self.allocated, self.is_signed);
        let stored = extended(raw >> self.shift, self.stored, self.is_signed);
        let is_padding = |value: i64| {
            self.padding
                .is_some_and(|[low, high]| (low..=high).contains(&value))
        };
        if is_padding(whole) || is_padding(stored) {
            return f32::NAN;
        }
        match &self.table {
            Some(table) => {
                let last = table.values.len() as i64 - 1;
                let entry = (stored - table.first).clamp(0, last);
                f32::from(table.values[entry as usize])
            }
            None => (stored as f64 * slope + intercept) as f32,
        }
    }

    /// Fills `out` with the values of a frame.
    ///
    /// # Errors
    /// Returns an [`Error::Io`](crate::Error::Io) if the samples are missing or damaged.
    pub fn read_frame(
        &self,
        file: &DicomFile,
        frame: usize,
        scale: [f64; 2],
        out: &mut [f32],
    ) -> Result<()> {
        let stored = stored_samples(file, self, frame)?;
        if self.element != tags::PIXEL_DATA {
            self.read_floats(&stored, scale, out);
            return Ok(());
        }
        match stored {
            StoredSamples::Bits(bytes, first) => {
                for (k, out) in out.iter_mut().enumerate() {
                    let bit = first + k;
                    let raw = u32::from(bytes[bit / 8] >> (bit % 8) & 1);
                    *out = self.value(raw, scale);
                }
            }
            StoredSamples::Bytes(bytes, 1) => {
                for (out, &raw) in out.iter_mut().zip(bytes.iter()) {
                    *out = self.value(raw.into(), scale);
                }
            }
            StoredSamples::Bytes(bytes, 2) => {
                for (out, raw) in out.iter_mut().zip(bytes.as_chunks().0) {
                    *out = self.value(u16::from_le_bytes(*raw).into(), scale);
                }
            }
            StoredSamples::Bytes(bytes, _) => {
                for (out, raw) in out.iter_mut().zip(bytes.as_chunks().0) {
                    *out = self.value(u32::from_le_bytes(*raw), scale);
                }
            }
            StoredSamples::Integers(integers) => {
                for (out, raw) in out.iter_mut().zip(integers) {
                    *out = self.value(raw, scale);
                }
            }
        }
        Ok(())
    }

    /// Fills `out` with the values of floats.
    fn read_floats(
        &self,
        stored: &StoredSamples<'_>,
        [slope, intercept]: [f64; 2],
        out: &mut [f32],
    ) {
        let StoredSamples::Bytes(bytes, _) = stored else {
            return;
        };
        for (out, number) in out.iter_mut().zip(self.encoding().numbers(bytes)) {
            *out = if self.float_padding == Some(number) {
                f32::NAN
            } else {
                (number * slope + intercept) as f32
            };
        }
    }
}

/// Returns the number in the lowest `bits` bits.
fn extended(raw: u32, bits: u32, is_signed: bool) -> i64 {
    let unused = 64 - bits.min(32);
    let top = u64::from(raw) << unused;
    if is_signed {
        top as i64 >> unused
    } else {
        (top >> unused) as i64
    }
}

/// Returns the smallest and the largest stored value of samples without data.
fn padding(set: &DataSet, allocated: u32, is_signed: bool) -> Option<[i64; 2]> {
    // Writers store negative numbers also as unsigned ones of the same bits.
    let value = |tag: Tag| Some(extended(integer(set, tag)? as u32, allocated, is_signed));
    let first = value(tags::PIXEL_PADDING_VALUE)?;
    let limit = value(tags::PIXEL_PADDING_RANGE_LIMIT).unwrap_or(first);
    Some([first.min(limit), first.max(limit)])
}

/// Returns the lookup table of a file, if it has one.
fn lookup_table(file: &DicomFile, is_signed: bool) -> Result<Option<LookupTable>> {
    let Some(item) = items(&file.data, tags::MODALITY_LUT_SEQUENCE).first() else {
        return Ok(None);
    };
    let descriptor = item.get(tags::LUT_DESCRIPTOR);
    let descriptor = descriptor.and_then(|element| element.to_multi_int::<i64>().ok());
    let data = item
        .get(tags::LUT_DATA)
        .and_then(|element| element.to_bytes().ok());
    let table = || {
        let [count, first, bits] = descriptor?.try_into().ok()?;
        let count = if count == 0 {
            1 << 16
        } else {
            usize::try_from(count).ok()?
        };
        let data = data?;
        let values: Vec<u16> = if bits <= 8 && data.len() < 2 * count {
            data.iter().map(|&byte| byte.into()).collect()
        } else {
            data.as_chunks()
                .0
                .iter()
                .map(|pair| u16::from_le_bytes(*pair))
                .collect()
        };
        let first = extended(first as u32, 16, is_signed);
        (values.len() >= count && count > 0).then(|| LookupTable {
            first,
            values: values[..count].to_vec(),
        })
    };
    let damaged = "has a modality lookup table that is damaged";
    table()
        .map(Some)
        .ok_or_else(|| file.error(damaged, super::super::packed::DAMAGED_REMEDY))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn format(allocated: u32, stored: u32, shift: u32, is_signed: bool) -> SampleFormat {
        SampleFormat {
            columns: 1,
            rows: 1,
            allocated,
            stored,
            shift,
            is_signed,
            element: tags::PIXEL_DATA,
            padding: None,
            float_padding: None,
            table: None,
        }
    }

    #[test]
    fn only_the_stored_bits_count() {
        let unsigned = format(16, 12, 0, false);
        assert_eq!(unsigned.value(0xf123, [1.0, 0.0]), 291.0);
        let signed = format(16, 12, 0, true);
        assert_eq!(signed.value(0x0fff, [1.0, 0.0]), -1.0);
        assert_eq!(signed.value(0xffff, [2.0, 0.5]), -1.5);
        assert_eq!(format(16, 12, 4, true).value(0x8005, [1.0, 0.0]), -2048.0);
        assert_eq!(
            format(32, 32, 0, false).value(u32::MAX, [1.0, 0.0]),
            4_294_967_295.0
        );
    }

    #[test]
    fn padding_has_no_value_in_any_of_its_bits() {
        // -2000 as an unsigned number, beyond the stored bits.
        let mut signed = format(16, 12, 0, true);
        signed.padding = Some([-2000, -2000]);
        assert!(signed.value(63536, [1.0, -1024.0]).is_nan());
        assert_eq!(signed.value(0, [1.0, -1024.0]), -1024.0);
        let mut range = format(16, 16, 0, false);
        range.padding = Some([10, 12]);
        let values = [9, 10, 12, 13].map(|raw| range.value(raw, [1.0, 0.0]).is_nan());
        assert_eq!(values, [false, true, true, false]);
    }

    #[test]
    fn lookup_tables_hold_their_ends() {
        let mut table = format(16, 16, 0, true);
        table.table = Some(LookupTable {
            first: -1,
            values: vec![100, 200, 400],
        });
        let values = [0xfff0u32, 0xffff, 0, 1, 7].map(|raw| table.value(raw, [3.0, 3.0]));
        assert_eq!(values, [100.0, 100.0, 200.0, 400.0, 400.0]);
    }
}

//! Samples behind a header, possibly compressed or as text. The size that a header claims is
//! checked against the length of the file before memory is allocated.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use flate2::bufread::{MultiGzDecoder, ZlibDecoder};

use super::samples::{self, Encoding, SampleType};
use super::{ImageFormat, LoadedImage};
use crate::error::{Error, Result, cause, io_error};
use crate::files;
use crate::image::labels::{ExactSample, LabelCollector};
use crate::image::{ExactLabels, Geometry, Image};

/// First bytes of gzip data.
pub const GZIP_MAGIC: &[u8] = b"\x1f\x8b";

/// Largest number of bytes that one byte of deflated data can expand to.
pub const MAX_DEFLATE_RATIO: u64 = 1032;

/// Packing of samples in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SamplePacking {
    /// Not compressed.
    Uncompressed,
    /// Compressed as gzip or zlib data, which the first bytes distinguish.
    Deflated,
    /// Not compressed; the numbers are words of text.
    Text,
}

/// Start of the samples in the unpacked bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SampleStart {
    /// After this number of bytes.
    Offset(u64),
    /// The samples are the last bytes.
    FromEnd,
}

/// Samples in a file, as its header describes them.
#[derive(Debug, Clone)]
pub struct PackedSamples {
    /// File that holds the samples.
    pub path: PathBuf,
    /// Offset in that file at which the packed bytes begin.
    pub offset: u64,
    /// Packing of the samples.
    pub packing: SamplePacking,
    /// Start of the samples in the unpacked bytes.
    pub sample_start: SampleStart,
    /// Encoding of each sample.
    pub encoding: Encoding,
    /// Number of samples along each axis, the fastest first.
    pub dims: [usize; 3],
}

impl PackedSamples {
    /// Loads the samples as an image. `scale` is a slope and an intercept that are applied to each
    /// sample.
    ///
    /// # Errors
    /// Returns an [`Error::Io`] if the file cannot be read, is damaged, or is too short for the
    /// claimed number of samples.
    pub fn load(
        self,
        format: ImageFormat,
        geometry: Geometry<3>,
        scale: Option<[f64; 2]>,
        mut notes: Vec<String>,
    ) -> Result<LoadedImage> {
        let (samples, trailing) = match scale {
            None => self.read_samples::<f32>()?,
            Some([slope, intercept]) => {
                let (mut numbers, trailing) = self.read_samples::<f64>()?;
                for number in &mut numbers {
                    *number = *number * slope + intercept;
                }
                notes.extend(self.without_quantisation(&mut numbers, slope));
                (numbers.into_iter().map(|v| v as f32).collect(), trailing)
            }
        };
        if trailing > 0 {
            notes.push(format!("{trailing} bytes after the samples are ignored"));
        }
        notes.extend(self.encoding.rounding_note(&samples));
        let exact = if self.encoding.may_need_exact_labels(&samples) {
            self.exact_labels(scale)?
        } else {
            None
        };
        let packed = match self.packing {
            SamplePacking::Uncompressed => "",
            SamplePacking::Deflated => ", compressed",
            SamplePacking::Text => ", as text",
        };
        let mut image = Image::new(self.dims, samples, geometry);
        image.labels = exact;
        Ok(LoadedImage {
            image,
            format,
            encoding: format!("{}{packed}", self.encoding),
            notes,
            survey: None,
            line_numbers: None,
        })
    }

    /// Rounds scaled integers to whole numbers if each differs from one by no more than half a step of
    /// the scale, which is smaller than 1: programs that store labels in a type with another scale
    /// round them so. Returns a note if it does.
    fn without_quantisation(&self, numbers: &mut [f64], slope: f64) -> Option<String> {
        let step = slope.abs();
        let is_scaled_integer = !matches!(
            self.encoding.sample_type,
            SampleType::F16 | SampleType::F32 | SampleType::F64
        );
        let difference = |v: f64| (v - v.round()).abs();
        let is_near_whole = |v: &f64| difference(*v) <= 0.5 * step * (1.0 + 1e-5);
        if !is_scaled_integer || step > MAX_LABEL_STEP || !numbers.iter().all(is_near_whole) {
            return None;
        }
        let largest = numbers.iter().fold(0.0f64, |max, v| max.max(difference(*v)));
        for number in numbers.iter_mut() {
            *number = number.round() + 0.0;
        }
        (largest > 0.0).then(|| {
            format!(
                "all samples are whole numbers up to {largest:.1e}, the rounding of the slope {slope}: they are \
                 taken as whole numbers"
            )
        })
    }

    /// Returns the samples as exact labels, or `None` if some have a fraction.
    fn exact_labels(&self, scale: Option<[f64; 2]>) -> Result<Option<Arc<ExactLabels>>> {
        let mut collector = LabelCollector::default();
        match scale {
            None => {
                collector.extend_exact(self.read_samples::<ExactSample>()?.0);
            }
            // Of integers, a whole slope and intercept make integers.
            Some([slope, intercept]) if slope.fract() == 0.0 && intercept.fract() == 0.0 => {
                let (slope, intercept) = (slope as i128, intercept as i128);
                let scaled = |sample| match sample {
                    ExactSample::Whole(number) => ExactSample::Whole(number * slope + intercept),
                    other => other,
                };
                let samples = self.read_samples::<ExactSample>()?.0;
                collector.extend_exact(samples.into_iter().map(scaled));
            }
            Some([slope, intercept]) => {
                let numbers = self.read_samples::<f64>()?.0;
                let samples = numbers.into_iter().map(|v| (v * slope + intercept).into());
                collector.extend_exact(samples);
            }
        }
        Ok(collector.finish_exact())
    }

    /// Returns the samples, and the number of bytes after them.
    fn read_samples<T: Sample>(&self) -> Result<(Vec<T>, u64)> {
        let mut file = files::open(&self.path, "name the file of samples")?;
        let metadata = file
            .metadata()
            .map_err(|e| io_error(&self.path, "read", e))?;
        let available = metadata.len().saturating_sub(self.offset);
        let size = self.encoding.size() as u64;
        let claimed = self
            .dims
            .iter()
            .try_fold(size, |bytes, &n| bytes.checked_mul(n as u64))
            .filter(|&bytes| bytes > 0 && bytes < 1 << 62);
        let dims = self.dims.map(|n| n.to_string()).join(" x ");
        let Some(needed) = claimed else {
            return Err(file_error(
                &self.path,
                format!("claims {dims} samples, none or more than any file holds"),
                DAMAGED_REMEDY,
            ));
        };
        let count = (needed / size) as usize;
        let too_short = |available: u64, description: &str| {
            let problem = format!(
                "is cut off: {dims} samples of {size} bytes need {needed} bytes, {available} {description}"
            );
            Err(file_error(&self.path, problem, DAMAGED_REMEDY))
        };
        match self.packing {
            SamplePacking::Uncompressed => {
                let start = match self.sample_start {
                    SampleStart::Offset(skip) => skip,
                    SampleStart::FromEnd => available.saturating_sub(needed),
                };
                let remaining = available.saturating_sub(start);
                if remaining < needed {
                    return too_short(remaining, "are there");
                }
                samples::check_memory(&self.path, count)?;
                let mut samples = vec![T::ZERO; count];
                T::read(self.encoding, &file, self.offset + start, &mut samples)
                    .map_err(|e| io_error(&self.path, "read", e))?;
                Ok((samples, remaining - needed))
            }
            SamplePacking::Text => {
                // A number takes at least one digit and one separator.
                if available < 2 * count as u64 - 1 {
                    return too_short(available, "of text are there");
                }
                samples::check_memory(&self.path, count)?;
                Ok((self.read_text(&mut file, count)?, 0))
            }
            SamplePacking::Deflated => {
                let max_bytes = available.saturating_mul(MAX_DEFLATE_RATIO);
                if max_bytes < needed {
                    return too_short(
                        available,
                        "of compressed data are there, which cannot hold them",
                    );
                }
                samples::check_memory(&self.path, count)?;
                file.seek(SeekFrom::Start(self.offset))
                    .map_err(|e| io_error(&self.path, "read", e))?;
                self.inflate(&mut unpack(file), needed)
                    .map_err(|e| match e.kind() {
                        io::ErrorKind::UnexpectedEof => file_error(
                            &self.path,
                            format!("its compressed data ends before {dims} samples are read"),
                            DAMAGED_REMEDY,
                        ),
                        _ => file_error(
                            &self.path,
                            format!("its compressed data is damaged: {e}"),
                            DAMAGED_REMEDY,
                        )
                        .with_source(e),
                    })
            }
        }
    }

    /// Returns the numbers of a text of `count` samples.
    fn read_text<T: Sample>(&self, file: &mut File, count: usize) -> Result<Vec<T>> {
        let mut text = Vec::new();
        file.seek(SeekFrom::Start(self.offset))
            .and_then(|_| file.read_to_end(&mut text))
            .map_err(|e| io_error(&self.path, "read", e))?;
        self.parse_text(&text, count)
    }

    /// Returns the samples in `reader`, and the number of bytes after them. The samples take
    /// `needed` unpacked bytes.
    fn inflate<T: Sample>(&self, reader: &mut dyn Read, needed: u64) -> io::Result<(Vec<T>, u64)> {
        let size = self.encoding.size();
        let count = needed as usize / size;
        // Memory grows with the bytes that arrive, so that a false claim allocates none.
        let mut samples = Vec::new();
        let mut decode = |bytes: &[u8]| {
            let decoded = samples.len();
            samples.resize(decoded + bytes.len() / size, T::ZERO);
            T::decode(self.encoding, bytes, &mut samples[decoded..]);
        };
        match self.sample_start {
            SampleStart::Offset(skip) => {
                if io::copy(&mut reader.take(skip), &mut io::sink())? < skip {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
                let mut buffer = vec![0; (count * size).min(size << 16)];
                let mut remaining = count * size;
                while remaining > 0 {
                    let part = remaining.min(buffer.len());
                    reader.read_exact(&mut buffer[..part])?;
                    decode(&buffer[..part]);
                    remaining -= part;
                }
                // Reading to the end verifies the checksum, if the end is near.
                let trailing = io::copy(&mut reader.take(needed.max(1 << 20)), &mut io::sink())?;
                Ok((samples, trailing))
            }
            SampleStart::FromEnd => {
                let mut bytes = Vec::new();
                while reader.take(1 << 20).read_to_end(&mut bytes)? > 0 {
                    if bytes.len() as u64 > needed.saturating_mul(2) + (1 << 21) {
                        bytes.drain(..bytes.len() - needed as usize);
                    }
                }
                let start = bytes.len().checked_sub(count * size);
                decode(&bytes[start.ok_or(io::ErrorKind::UnexpectedEof)?..]);
                Ok((samples, 0))
            }
        }
    }

    /// Parses numbers in text, separated by white space or commas.
    fn parse_text<T: Sample>(&self, text: &[u8], count: usize) -> Result<Vec<T>> {
        let mut samples = Vec::new();
        let words = text
            .split(|b| b.is_ascii_whitespace() || *b == b',')
            .filter(|word| !word.is_empty());
        for word in words {
            let word = String::from_utf8_lossy(word);
            let value = T::parse(&word).ok_or_else(|| {
                let shown: String = word.chars().take(20).collect();
                let problem = format!("sample {} is '{shown}', not a number", samples.len());
                file_error(&self.path, problem, DAMAGED_REMEDY)
            })?;
            samples.push(value);
        }
        if samples.len() == count {
            return Ok(samples);
        }
        let problem = format!("has {} numbers where {count} are needed", samples.len());
        Err(file_error(&self.path, problem, DAMAGED_REMEDY))
    }
}

/// Largest slope of scaled integers that are recognised as labels. Of other values than labels, some
/// differ from whole numbers by more than half of it.
const MAX_LABEL_STEP: f64 = 0.5;

/// Type as which a sample is read.
trait Sample: Copy + Send {
    /// Value before the sample is read.
    const ZERO: Self;

    /// Parses a number in text; returns `None` if it is not one.
    fn parse(word: &str) -> Option<Self>;

    /// Converts bytes to samples.
    fn decode(encoding: Encoding, bytes: &[u8], out: &mut [Self]);

    /// Reads `out.len()` samples that start at byte `offset` of a file.
    fn read(encoding: Encoding, file: &File, offset: u64, out: &mut [Self]) -> io::Result<()> {
        const CHUNK: usize = 1 << 17;
        let mut buffer = Vec::new();
        let mut position = offset;
        for out in out.chunks_mut(CHUNK) {
            buffer.resize(out.len() * encoding.size(), 0);
            files::read_exact_at(file, &mut buffer, position)?;
            position += buffer.len() as u64;
            Self::decode(encoding, &buffer, out);
        }
        Ok(())
    }
}

impl Sample for f32 {
    const ZERO: Self = 0.0;

    fn parse(word: &str) -> Option<Self> {
        word.parse::<f64>().ok().map(|number| number as Self)
    }

    fn decode(encoding: Encoding, bytes: &[u8], out: &mut [Self]) {
        encoding.decode(bytes, out);
    }

    fn read(encoding: Encoding, file: &File, offset: u64, out: &mut [Self]) -> io::Result<()> {
        encoding.read(file, offset, out)
    }
}

impl Sample for f64 {
    const ZERO: Self = 0.0;

    fn parse(word: &str) -> Option<Self> {
        word.parse().ok()
    }

    fn decode(encoding: Encoding, bytes: &[u8], out: &mut [Self]) {
        for (out, number) in out.iter_mut().zip(encoding.numbers(bytes)) {
            *out = number;
        }
    }
}

impl Sample for ExactSample {
    const ZERO: Self = Self::Whole(0);

    fn parse(word: &str) -> Option<Self> {
        let integer = word.parse::<i128>().ok().map(Self::Whole);
        integer.or_else(|| word.parse::<f64>().ok().map(Self::from))
    }

    fn decode(encoding: Encoding, bytes: &[u8], out: &mut [Self]) {
        for (out, sample) in out.iter_mut().zip(encoding.exact_samples(bytes)) {
            *out = sample;
        }
    }
}

/// Remedy for a file whose parts are inconsistent.
pub const DAMAGED_REMEDY: &str = "the file or its header is damaged: copy or write it again";

/// Returns a reader of the unpacked bytes of gzip or zlib data.
pub fn unpack(file: impl Read + 'static) -> Box<dyn Read> {
    let mut reader = BufReader::with_capacity(1 << 16, file);
    match io::BufRead::fill_buf(&mut reader) {
        Ok(head) if head.starts_with(GZIP_MAGIC) => Box::new(MultiGzDecoder::new(reader)),
        _ => Box::new(ZlibDecoder::new(reader)),
    }
}

/// Opens a file. Also returns its length in bytes.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be opened.
pub fn open_with_length(path: &Path) -> Result<(File, u64)> {
    let file = File::open(path).map_err(|e| io_error(path, "open", e))?;
    let metadata = file.metadata().map_err(|e| io_error(path, "read", e))?;
    Ok((file, metadata.len()))
}

/// Returns the first bytes of a file, unpacked if they are gzip data, and their packing. The result
/// is shorter if the file is short or damaged.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be read.
pub fn read_head(path: &Path, max_bytes: u64) -> Result<(Vec<u8>, SamplePacking)> {
    let mut file = File::open(path).map_err(|e| io_error(path, "open", e))?;
    let mut head = Vec::new();
    (&mut file)
        .take(max_bytes)
        .read_to_end(&mut head)
        .map_err(|e| io_error(path, "read", e))?;
    if !head.starts_with(GZIP_MAGIC) {
        return Ok((head, SamplePacking::Uncompressed));
    }
    file.rewind().map_err(|e| io_error(path, "read", e))?;
    head.clear();
    // The bytes that can be unpacked from damaged data are enough to detect the format.
    let _ = unpack(file).take(max_bytes).read_to_end(&mut head);
    Ok((head, SamplePacking::Deflated))
}

/// Returns the first bytes of a file as [`read_head`] does, each as one character, so that offsets in
/// the text are offsets in the file.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be read.
pub fn read_head_text(path: &Path, max_bytes: u64) -> Result<String> {
    let (head, _) = read_head(path, max_bytes)?;
    Ok(ascii_text(&head))
}

/// Returns a text with one character for each byte, `?` for those that are not ASCII.
pub fn ascii_text(bytes: &[u8]) -> String {
    let to_char = |&b: &u8| if b.is_ascii() { b as char } else { '?' };
    bytes.iter().map(to_char).collect()
}

/// Returns an error about a file.
pub fn file_error(path: &Path, problem: impl std::fmt::Display, remedy: &str) -> Error {
    Error::Io(cause(path.display(), problem, remedy))
}

/// Returns the dimensions of an image with two or three axes, the fastest first, with 1 for a
/// missing axis.
///
/// # Errors
/// Returns the problem if there are fewer than two axes, or a further axis with more than one
/// sample.
pub fn dims_from_sizes(sizes: &[usize]) -> std::result::Result<[usize; 3], String> {
    let shown = sizes.iter().map(usize::to_string).collect::<Vec<_>>();
    let extra = sizes.iter().skip(3).find(|&&n| n != 1);
    match (sizes.len(), extra) {
        (_, None) if sizes.len() >= 2 => {
            Ok(std::array::from_fn(|k| sizes.get(k).copied().unwrap_or(1)))
        }
        _ => Err(format!(
            "holds {} samples, where 2 or 3 axes are needed",
            shown.join(" x ")
        )),
    }
}

//! Samples behind a header, perhaps compressed, perhaps as text: what a header claims is checked
//! against the file's length before any memory is taken.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use flate2::bufread::{MultiGzDecoder, ZlibDecoder};

use super::samples::{self, Encoding};
use super::{ImageFormat, LoadedImage};
use crate::error::{Error, Result, cause, io_error};
use crate::files;
use crate::image::{ExactLabels, Geometry, Image};

/// The first bytes of gzip data.
pub const GZIP_MAGIC: &[u8] = b"\x1f\x8b";

/// No byte of deflated data becomes more bytes than this.
pub const MAX_DEFLATE_RATIO: u64 = 1032;

/// How bytes are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SamplePacking {
    /// Not at all.
    Uncompressed,
    /// As gzip or zlib data, whichever it turns out to be.
    Deflated,
    /// Not compressed, and numbers are words of text.
    Text,
}

/// Where samples begin in the unpacked bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SampleStart {
    /// After so many bytes.
    Offset(u64),
    /// They are the last bytes that there are.
    FromEnd,
}

/// Samples in a file, as its header describes them.
#[derive(Debug, Clone)]
pub struct PackedSamples {
    /// The file that holds them.
    pub path: PathBuf,
    /// Byte of that file at which the packed bytes begin.
    pub offset: u64,
    /// How they are packed.
    pub packing: SamplePacking,
    /// Where the samples begin in what is unpacked.
    pub sample_start: SampleStart,
    /// How each sample is coded.
    pub encoding: Encoding,
    /// Samples along each axis, the fastest first.
    pub dims: [usize; 3],
}

impl PackedSamples {
    /// The samples as an image; `scale` is a slope and an intercept that are applied to each.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be read, is too short for what is claimed, or damaged.
    pub fn load(
        self,
        format: ImageFormat,
        geometry: Geometry<3>,
        scale: Option<[f64; 2]>,
        mut notes: Vec<String>,
    ) -> Result<LoadedImage> {
        let (mut samples, spare) = self.read_samples::<f32>()?;
        if spare > 0 {
            notes.push(format!("{spare} bytes after the samples are ignored"));
        }
        let note = self.encoding.rounding_note(&samples);
        let exact = match (&note, self.packing) {
            (Some(_), SamplePacking::Uncompressed | SamplePacking::Deflated) if scale.is_none() => {
                Some(ExactLabels::from_integers(self.read_samples::<i128>()?.0))
            }
            _ => None,
        };
        notes.extend(note);
        if let Some([slope, intercept]) = scale {
            for v in &mut samples {
                *v = (f64::from(*v) * slope + intercept) as f32;
            }
        }
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

    /// The samples, and how many bytes there are after them.
    fn read_samples<T: Sample>(&self) -> Result<(Vec<T>, u64)> {
        let mut file = files::open(&self.path, "name the file of samples")?;
        let metadata = file
            .metadata()
            .map_err(|e| io_error(&self.path, "read", e))?;
        let there = metadata.len().saturating_sub(self.offset);
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
        let short = |there: u64, what: &str| {
            let problem = format!(
                "is cut off: {dims} samples of {size} bytes need {needed} bytes, {there} {what}"
            );
            Err(file_error(&self.path, problem, DAMAGED_REMEDY))
        };
        match self.packing {
            SamplePacking::Uncompressed => {
                let start = match self.sample_start {
                    SampleStart::Offset(skip) => skip,
                    SampleStart::FromEnd => there.saturating_sub(needed),
                };
                let rest = there.saturating_sub(start);
                if rest < needed {
                    return short(rest, "are there");
                }
                samples::check_memory(&self.path, count)?;
                let mut samples = vec![T::default(); count];
                T::read(self.encoding, &file, self.offset + start, &mut samples)
                    .map_err(|e| io_error(&self.path, "read", e))?;
                Ok((samples, rest - needed))
            }
            SamplePacking::Text => {
                // A number takes a digit and a space at least.
                if there < 2 * count as u64 - 1 {
                    return short(there, "of text are there");
                }
                samples::check_memory(&self.path, count)?;
                file.seek(SeekFrom::Start(self.offset))
                    .map_err(|e| io_error(&self.path, "read", e))?;
                let mut text = Vec::new();
                file.read_to_end(&mut text)
                    .map_err(|e| io_error(&self.path, "read", e))?;
                let words = self.parse_text(&text, count)?;
                Ok((words.into_iter().map(T::from_number).collect(), 0))
            }
            SamplePacking::Deflated => {
                let most = there.saturating_mul(MAX_DEFLATE_RATIO);
                if most < needed {
                    return short(
                        there,
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

    /// The samples in `reader`, which unpacks to `needed` bytes of them and perhaps more.
    fn inflate<T: Sample>(&self, reader: &mut dyn Read, needed: u64) -> io::Result<(Vec<T>, u64)> {
        let size = self.encoding.size();
        let count = needed as usize / size;
        // Memory is taken as bytes come, so that a false claim takes none.
        let mut samples = Vec::new();
        let mut decode = |bytes: &[u8]| {
            let done = samples.len();
            samples.resize(done + bytes.len() / size, T::default());
            T::decode(self.encoding, bytes, &mut samples[done..]);
        };
        match self.sample_start {
            SampleStart::Offset(skip) => {
                if io::copy(&mut reader.take(skip), &mut io::sink())? < skip {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
                let mut buffer = vec![0; (count * size).min(size << 16)];
                let mut left = count * size;
                while left > 0 {
                    let part = left.min(buffer.len());
                    reader.read_exact(&mut buffer[..part])?;
                    decode(&buffer[..part]);
                    left -= part;
                }
                // The check sum stands at the end, if that is near.
                let spare = io::copy(&mut reader.take(needed.max(1 << 20)), &mut io::sink())?;
                Ok((samples, spare))
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

    /// Numbers of text between white space or commas.
    fn parse_text(&self, text: &[u8], count: usize) -> Result<Vec<f32>> {
        let mut samples = Vec::new();
        let words = text
            .split(|b| b.is_ascii_whitespace() || *b == b',')
            .filter(|word| !word.is_empty());
        for word in words {
            let word = String::from_utf8_lossy(word);
            let value = word.parse::<f64>().map_err(|_| {
                let shown: String = word.chars().take(20).collect();
                let problem = format!("sample {} is '{shown}', not a number", samples.len());
                file_error(&self.path, problem, DAMAGED_REMEDY)
            })?;
            samples.push(value as f32);
        }
        if samples.len() == count {
            return Ok(samples);
        }
        let problem = format!("has {} numbers where {count} are needed", samples.len());
        Err(file_error(&self.path, problem, DAMAGED_REMEDY))
    }
}

/// What a sample is read as: `f32`, or a wide integer as it is.
trait Sample: Copy + Default + Send {
    /// A number of text.
    fn from_number(number: f32) -> Self;

    /// Converts bytes.
    fn decode(encoding: Encoding, bytes: &[u8], out: &mut [Self]);

    /// Reads `out.len()` samples that start at byte `offset` of a file.
    fn read(encoding: Encoding, file: &File, offset: u64, out: &mut [Self]) -> io::Result<()>;
}

impl Sample for f32 {
    fn from_number(number: f32) -> Self {
        number
    }

    fn decode(encoding: Encoding, bytes: &[u8], out: &mut [Self]) {
        encoding.decode(bytes, out);
    }

    fn read(encoding: Encoding, file: &File, offset: u64, out: &mut [Self]) -> io::Result<()> {
        encoding.read(file, offset, out)
    }
}

impl Sample for i128 {
    fn from_number(number: f32) -> Self {
        number as Self
    }

    fn decode(encoding: Encoding, bytes: &[u8], out: &mut [Self]) {
        for (out, number) in out.iter_mut().zip(encoding.integers(bytes)) {
            *out = number;
        }
    }

    fn read(encoding: Encoding, file: &File, offset: u64, out: &mut [Self]) -> io::Result<()> {
        const CHUNK: usize = 1 << 17;
        let mut buffer = Vec::new();
        let mut at = offset;
        for out in out.chunks_mut(CHUNK) {
            buffer.resize(out.len() * encoding.size(), 0);
            files::read_exact_at(file, &mut buffer, at)?;
            at += buffer.len() as u64;
            Self::decode(encoding, &buffer, out);
        }
        Ok(())
    }
}

/// What to do about a file whose parts do not fit.
pub const DAMAGED_REMEDY: &str = "the file or its header is damaged: copy or write it again";

/// The bytes of compressed data, gzip or zlib.
pub fn unpack(file: impl Read + 'static) -> Box<dyn Read> {
    let mut reader = BufReader::with_capacity(1 << 16, file);
    match io::BufRead::fill_buf(&mut reader) {
        Ok(head) if head.starts_with(GZIP_MAGIC) => Box::new(MultiGzDecoder::new(reader)),
        _ => Box::new(ZlibDecoder::new(reader)),
    }
}

/// The first bytes of a file, unpacked if they are gzip data; fewer if it is shorter or damaged.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read.
pub fn read_head(path: &Path, most: u64) -> Result<(Vec<u8>, SamplePacking)> {
    let mut file = File::open(path).map_err(|e| io_error(path, "open", e))?;
    let mut head = Vec::new();
    (&mut file)
        .take(most)
        .read_to_end(&mut head)
        .map_err(|e| io_error(path, "read", e))?;
    if !head.starts_with(GZIP_MAGIC) {
        return Ok((head, SamplePacking::Uncompressed));
    }
    file.rewind().map_err(|e| io_error(path, "read", e))?;
    head.clear();
    // What can be unpacked of damaged data is enough to say what it was.
    let _ = unpack(file).take(most).read_to_end(&mut head);
    Ok((head, SamplePacking::Deflated))
}

/// An error about a file.
pub fn file_error(path: &Path, problem: impl std::fmt::Display, remedy: &str) -> Error {
    Error::Io(cause(path.display(), problem, remedy))
}

/// Dims of an image of two or three axes, the fastest first, with 1 for an axis that is missing.
///
/// # Errors
/// What is wrong with them.
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

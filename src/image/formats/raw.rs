//! Raw samples without a header, described by the user: `100x400x208:f32be`.

use std::path::Path;
use std::str::FromStr;

use super::ImageFormat;
use super::packed::open_with_length;
use super::samples::{self, Encoding, Endian, SampleType};
use super::stream::{ImageHeader, ImageStream, RawPlanes, SlabSource};
use crate::error::{Error, Result, cause};
use crate::files::atomic_write;

/// Dimensions and sample type of a raw file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RawSpec {
    /// Number of samples along each axis, the fastest in the file (x) first; 1 along z in a 2-D
    /// image.
    pub dims: [usize; 3],
    /// Encoding of the samples.
    pub encoding: Encoding,
}

const SYNTAX: &str = "write NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), the fastest axis first, TYPE one of u8, i8 or u16, i16, \
u32, i32, f32, f64 with le or be, e.g. 100x400x208:f32be";

impl FromStr for RawSpec {
    type Err = Error;

    /// Parses `NXxNYxNZ:TYPE` or `NXxNY:TYPE`, x the fastest axis in the file. TYPE is u8 or i8, or
    /// one of u16, i16, u32, i32, f32 and f64 followed by le or be.
    fn from_str(text: &str) -> Result<Self> {
        let bad = |problem: String| Error::Io(cause("raw samples", problem, SYNTAX));
        let (dims, sample) = text
            .split_once(':')
            .ok_or_else(|| bad(format!("'{text}' gives no type of the samples")))?;
        let dims: Vec<usize> = dims
            .split('x')
            .map(|n| n.parse().ok().filter(|&n| n > 0))
            .collect::<Option<_>>()
            .ok_or_else(|| bad(format!("'{dims}' are not two or three positive counts")))?;
        let dims = match *dims.as_slice() {
            [nx, ny] => [nx, ny, 1],
            [nx, ny, nz] => [nx, ny, nz],
            _ => {
                return Err(bad(format!(
                    "there are {} dimensions, not 2 or 3",
                    dims.len()
                )));
            }
        };

        let (name, endian) = if let Some(name) = sample.strip_suffix("le") {
            (name, Some(Endian::Little))
        } else if let Some(name) = sample.strip_suffix("be") {
            (name, Some(Endian::Big))
        } else {
            (sample, None)
        };
        let sample = match name {
            "u8" => SampleType::U8,
            "i8" => SampleType::I8,
            "u16" => SampleType::U16,
            "i16" => SampleType::I16,
            "u32" => SampleType::U32,
            "i32" => SampleType::I32,
            "f32" => SampleType::F32,
            "f64" => SampleType::F64,
            _ => return Err(bad(format!("'{sample}' is not a type of samples"))),
        };
        let one_byte = matches!(sample, SampleType::U8 | SampleType::I8);
        let endian = match endian {
            Some(endian) => endian,
            None if one_byte => Endian::Little,
            None => return Err(bad(format!("'{name}' does not say the byte order"))),
        };
        let encoding = Encoding {
            sample_type: sample,
            endian,
        };
        Ok(Self { dims, encoding })
    }
}

/// Opens a raw file. Its length must be exactly that of the description.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be opened or its length differs.
pub fn open(path: &Path, spec: RawSpec) -> Result<ImageStream> {
    let (file, length) = open_with_length(path)?;
    let size = spec.encoding.size();
    let [nx, ny, nz] = spec.dims;
    let expected = spec
        .dims
        .iter()
        .try_fold(size as u64, |bytes, &n| bytes.checked_mul(n as u64));
    if expected != Some(length) {
        let expected = expected.map_or("more than any file's".into(), |n| n.to_string());
        let problem = format!(
            "holds {length} bytes, but {nx} x {ny} x {nz} samples of {size} bytes need {expected}"
        );
        return Err(Error::Io(cause(
            path.display(),
            problem,
            "correct the dimensions and the type in --raw",
        )));
    }
    Ok(ImageStream {
        header: ImageHeader::without_geometry(
            ImageFormat::Raw,
            spec.dims,
            spec.encoding,
            "a raw file",
        ),
        encoding: spec.encoding,
        reader: Box::new(RawPlanes {
            path: path.to_path_buf(),
            file,
            data_offset: 0,
            encoding: spec.encoding,
            plane_dims: [nx, ny],
        }),
        max_magnitude_bits: Default::default(),
    })
}

/// Writes the samples as little-endian `f32`, x fastest, without a header.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be written.
pub fn write(path: &Path, slabs: &dyn SlabSource) -> Result<()> {
    atomic_write(path, |writer| samples::write_slabs(writer, slabs))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::formats::LoadedImage;

    fn read(path: &Path, spec: RawSpec) -> Result<LoadedImage> {
        open(path, spec)?.into_loaded(path)
    }

    #[test]
    fn descriptions() {
        let spec: RawSpec = "100x400x208:f32be".parse().unwrap();
        assert_eq!(spec.dims, [100, 400, 208]);
        assert_eq!(spec.encoding.sample_type, SampleType::F32);
        assert_eq!(spec.encoding.endian, Endian::Big);
        assert!("3x3x3:u8".parse::<RawSpec>().is_ok());
        for bad in [
            "",
            "3x3x3",
            "3:u8",
            "3x3x3x3:u8",
            "3x3x0:u8",
            "3x-3x3:u8",
            "3x3x3:f32",
            "3x3x3:f33le",
            "99999999999999999999x3x3:u8",
        ] {
            let error = bad.parse::<RawSpec>().unwrap_err();
            assert!(
                error.cause().remedy.contains("100x400x208:f32be"),
                "{bad}: {error}"
            );
        }
    }

    #[test]
    fn x_is_fastest_and_the_length_must_fit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.raw");
        let bytes: Vec<u8> = (0..24i16).flat_map(|v| (v - 5).to_be_bytes()).collect();
        std::fs::write(&path, &bytes).unwrap();
        let loaded = read(&path, "4x3x2:i16be".parse().unwrap()).unwrap();
        assert_eq!(loaded.image.dims(), [4, 3, 2]);
        assert_eq!(loaded.image.samples[[1, 2, 3]], 23.0 - 5.0);
        assert_eq!(loaded.image.samples[[0, 0, 1]], 1.0 - 5.0);

        let error = read(&path, "4x3x3:i16be".parse().unwrap()).unwrap_err();
        let error = error.to_string();
        assert!(
            error.contains("48 bytes") && error.contains("need 72"),
            "{error}"
        );
        // A written file reads back unchanged.
        let written = folder.path().join("b.raw");
        write(&written, &loaded.image).unwrap();
        let again = read(&written, "4x3x2:f32le".parse().unwrap()).unwrap();
        assert_eq!(again.image, loaded.image);

        let huge = "4294967296x4294967296x4:f64le".parse().unwrap();
        assert!(read(&path, huge).is_err());
    }
}

//! PNG: grey and colour pictures as 2-D images.
//!
//! Column is x, row is y, and the first row is y = 0, so that y points down in the picture. Samples
//! are the coded values, 0 to 255 or 0 to 65535. Colours become luminance, 0.2126 R + 0.7152 G +
//! 0.0722 B of the coded values (ITU-R BT.709), and transparency is ignored. A palette of colours
//! is read as the indices of the colours, because pictures of labels have such palettes.
//!
//! An image whose samples are not whole numbers in that range is written in 65536 steps between its
//! extremes. A text chunk stores the extremes, so that the image reads back to within half a step.

use std::fs::File;
use std::io::{BufReader, ErrorKind};
use std::path::Path;

use png::{BitDepth, ColorType, Decoder, DecodingError, Encoder, Reader, Transformations};

use super::packed::{DAMAGED_REMEDY, MAX_DEFLATE_RATIO, open_with_length};
use super::placement::NO_GEOMETRY_NOTE;
use super::samples::{self, Encoding, Endian, SampleType};
use super::tiff::add_bits;
use super::{ImageFormat, LoadedImage};
use crate::error::{Error, Result, cause};
use crate::files::atomic_write;
use crate::image::{Geometry, Image};

/// First bytes of every PNG file.
pub const MAGIC: &[u8] = b"\x89PNG\r\n\x1a\n";

/// Keyword of the text chunk that holds the samples for the codes 0 and 65535.
const RANGE_KEYWORD: &str = "atomesh range";

/// Weights of red, green and blue in luminance.
const LUMINANCE_WEIGHTS: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// Largest picture that is read, in bytes of samples.
const MAX_PICTURE_BYTES: u64 = 1 << 33;

/// Reads a picture as a 2-D image.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be read, is truncated or damaged.
pub fn read(path: &Path) -> Result<LoadedImage<2>> {
    // The expansion converts samples of fewer than 8 bits to 8 bits, and a palette of greys to grey
    // values. A palette of colours is read without it.
    match read_transformed(path, Transformations::EXPAND)? {
        Some(loaded) => Ok(loaded),
        None => {
            read_transformed(path, Transformations::IDENTITY)?.ok_or_else(|| palette_error(path))
        }
    }
}

/// Returns the error for a file whose palette differs between two reads.
fn palette_error(path: &Path) -> Error {
    Error::Io(cause(
        path.display(),
        "changes while it is read",
        DAMAGED_REMEDY,
    ))
}

/// Returns `true` if all colours of a palette are greys.
fn is_grey(palette: &[u8]) -> bool {
    (palette.chunks_exact(3)).all(|color| color[0] == color[1] && color[1] == color[2])
}

/// Reads a picture with these `transformations`. Returns `None` if they would expand a palette of
/// colours.
fn read_transformed(
    path: &Path,
    transformations: Transformations,
) -> Result<Option<LoadedImage<2>>> {
    let (file, length) = open_with_length(path)?;
    let mut decoder = Decoder::new(BufReader::new(file));
    decoder.set_transformations(transformations);
    let to_error = |e| decode_error(path, e);
    let mut reader = decoder.read_info().map_err(to_error)?;
    let info = reader.info();
    let (color_type, bits) = (info.color_type, info.bit_depth as u8);
    let dims = [info.width as usize, info.height as usize];
    let palette_length = info.palette.as_ref().map(|palette| palette.len());
    if let Some(problem) = palette_length.and_then(palette_problem) {
        return Err(Error::Io(cause(path.display(), problem, DAMAGED_REMEDY)));
    }
    let reads_indices = transformations == Transformations::IDENTITY;
    let has_colors = |palette: &[u8]| !is_grey(palette);
    if color_type == ColorType::Indexed
        && !reads_indices
        && info.palette.as_deref().is_some_and(has_colors)
    {
        return Ok(None);
    }
    let size = buffer_size(&reader, length)
        .map_err(|(problem, remedy)| Error::Io(cause(path.display(), problem, remedy)))?;
    let channels = reader.output_color_type().0.samples();
    samples::check_memory(path, dims[0] * dims[1] * channels)?;
    let mut bytes = vec![0; size];
    let frame = reader.next_frame(&mut bytes).map_err(to_error)?;
    reader.finish().map_err(to_error)?;

    let encoding = Encoding {
        sample_type: match frame.bit_depth {
            BitDepth::Sixteen => SampleType::U16,
            _ => SampleType::U8,
        },
        endian: Endian::Big,
    };
    let mut values = vec![0f32; dims[0] * dims[1] * channels];
    let mut notes = vec![format!("a picture {NO_GEOMETRY_NOTE}, y down")];
    if reads_indices && bits < 8 {
        values.clear();
        add_bits(&bytes, bits, dims[0], dims[0] * dims[1], &mut values);
    } else {
        encoding.decode(&bytes, &mut values);
    }
    if reads_indices {
        notes.push("samples are indices of colours in the palette, as in images of labels".into());
    }
    let mut samples: Vec<f32> = match channels {
        1 => values,
        2 => values.iter().step_by(2).copied().collect(),
        _ => values.chunks_exact(channels).map(luminance).collect(),
    };
    if channels >= 3 && color_type != ColorType::Indexed {
        notes.push("colours are read as brightness (luminance, BT.709)".into());
    }
    if channels % 2 == 0 {
        notes.push("transparency is ignored".into());
    }
    if let Some([low, high]) = sample_range(reader.info()) {
        samples
            .iter_mut()
            .for_each(|v| *v = decode_sample(*v, low, high));
    }
    Ok(Some(LoadedImage {
        image: Image::new(dims, samples, Geometry::default()),
        format: ImageFormat::Png,
        encoding: format!("{bits}-bit {}", color_name(color_type)),
        notes,
        survey: None,
        line_numbers: None,
    }))
}

/// Returns what is wrong with a palette of `length` bytes, before the decoder uses it.
fn palette_problem(length: usize) -> Option<String> {
    let is_whole = length > 0 && length.is_multiple_of(3);
    (!is_whole).then(|| format!("has a palette of {length} bytes, not three for each colour"))
}

/// Returns `true` if a file of `length` bytes can hold `packed` bytes of samples.
fn can_hold(length: u64, packed: u64) -> bool {
    packed <= length.saturating_mul(MAX_DEFLATE_RATIO)
}

/// Returns the number of bytes of the decoded picture, after checks of the claims of a file of
/// `length` bytes. The error is the problem and the remedy.
fn buffer_size(
    reader: &Reader<BufReader<File>>,
    length: u64,
) -> std::result::Result<usize, (String, &'static str)> {
    let info = reader.info();
    let claim = format!("claims {} x {} pixels", info.width, info.height);
    let packed = (info.raw_row_length() as u64).saturating_mul(u64::from(info.height));
    if !can_hold(length, packed) {
        let problem = format!("{claim}, which its {length} bytes cannot hold");
        return Err((problem, DAMAGED_REMEDY));
    }
    let size = reader.output_buffer_size();
    size.filter(|&size| size as u64 <= MAX_PICTURE_BYTES)
        .ok_or((claim, "give a picture of at most 2^33 bytes"))
}

/// Returns how reports call the colours of a picture.
fn color_name(color_type: ColorType) -> &'static str {
    match color_type {
        ColorType::Grayscale => "grey",
        ColorType::GrayscaleAlpha => "grey with transparency",
        ColorType::Rgb => "colours",
        ColorType::Rgba => "colours with transparency",
        ColorType::Indexed => "palette",
    }
}

/// Returns the sample that a code from 0 to 65535 stands for.
fn decode_sample(code: f32, low: f32, high: f32) -> f32 {
    let span = high - low;
    if span.is_finite() {
        return low + code / 65535.0 * span;
    }
    let fraction = f64::from(code) / 65535.0;
    (f64::from(low) * (1.0 - fraction) + f64::from(high) * fraction) as f32
}

/// Returns the luminance of a pixel. It is exactly the common value if all colours are equal.
pub fn luminance(pixel: &[f32]) -> f32 {
    let [r, g, b] = [pixel[0], pixel[1], pixel[2]];
    g + LUMINANCE_WEIGHTS[0] * (r - g) + LUMINANCE_WEIGHTS[2] * (b - g)
}

/// Returns the samples for the codes 0 and 65535, if the file stores them.
fn sample_range(info: &png::Info<'_>) -> Option<[f32; 2]> {
    let chunk = info
        .uncompressed_latin1_text
        .iter()
        .find(|chunk| chunk.keyword == RANGE_KEYWORD)?;
    let (low, high) = chunk.text.split_once(' ')?;
    let [low, high] = [low, high].map(|word| word.parse::<f32>().ok().filter(|v| v.is_finite()));
    Some([low?, high?])
}

fn decode_error(path: &Path, error: DecodingError) -> Error {
    let problem = match &error {
        DecodingError::IoError(e) if e.kind() == ErrorKind::UnexpectedEof => {
            "is cut off".to_string()
        }
        error => format!("is not a complete PNG file: {error}"),
    };
    Error::Io(cause(path.display(), problem, "copy or write it again").with_source(error))
}

/// Writes a 2-D image as a grey picture: 8 bits if all samples are whole numbers from 0 to 255,
/// else 16 bits (see the module documentation).
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be written or a sample is not finite.
pub fn write(path: &Path, image: &Image<2>) -> Result<()> {
    let samples = image.as_slice();
    let stats = image.stats();
    if let Some(index) = stats.first_non_finite {
        return Err(Error::Io(cause(
            path.display(),
            format!("the image has no finite value at {index:?}, which a PNG cannot hold"),
            "write .npy or .vti",
        )));
    }
    let is_integral = samples.iter().all(|v| v.fract() == 0.0) && stats.min >= 0.0;
    let [width, height] = image.dims().map(|n| n as u32);
    let (depth, bytes, range) = if is_integral && stats.max <= 255.0 {
        (
            BitDepth::Eight,
            samples.iter().map(|&v| v as u8).collect(),
            None,
        )
    } else {
        let (low, high) = if is_integral && stats.max <= 65535.0 {
            (0.0, 65535.0)
        } else {
            (stats.min, stats.max)
        };
        let scale = if high > low {
            65535.0 / (high - low)
        } else {
            0.0
        };
        // Double precision is needed where the range or its inverse overflows 32-bit floats.
        let needs_doubles = !((high - low).is_finite() && scale.is_finite());
        let [wide_low, wide_high] = [low, high].map(f64::from);
        let wide_scale = 65535.0 / (wide_high - wide_low);
        let code = |v: &f32| {
            let code = if needs_doubles {
                ((f64::from(*v) - wide_low) * wide_scale).round() as u16
            } else {
                ((v - low) * scale).round() as u16
            };
            code.to_be_bytes()
        };
        let bytes: Vec<u8> = samples.iter().flat_map(code).collect();
        let range = (high - low != 65535.0 || low != 0.0).then(|| format!("{low:?} {high:?}"));
        (BitDepth::Sixteen, bytes, range)
    };
    atomic_write(path, |out| {
        let mut encoder = Encoder::new(out, width, height);
        encoder.set_color(ColorType::Grayscale);
        encoder.set_depth(depth);
        if let Some(range) = range {
            encoder.add_text_chunk(RANGE_KEYWORD.into(), range)?;
        }
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&bytes)?;
        Ok(writer.finish()?)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn encode_picture(color: ColorType, depth: BitDepth, dims: [u32; 2], data: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(&mut bytes, dims[0], dims[1]);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if color == ColorType::Indexed {
            encoder.set_palette(vec![0, 0, 0, 255, 0, 0, 255, 255, 255]);
        }
        let mut writer = encoder.write_header().unwrap();
        writer.write_image_data(data).unwrap();
        writer.finish().unwrap();
        bytes
    }

    fn read_bytes(bytes: &[u8]) -> Result<LoadedImage<2>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        std::fs::write(&path, bytes).unwrap();
        read(&path)
    }

    #[test]
    fn every_color_type_and_depth() {
        use BitDepth::*;
        use ColorType::*;
        let red = 255.0 * LUMINANCE_WEIGHTS[0];
        let cases: &[(ColorType, BitDepth, &[u8], [f32; 2])] = &[
            (Grayscale, One, &[0b0100_0000], [0.0, 255.0]),
            (Grayscale, Four, &[0x1f], [17.0, 255.0]),
            (Grayscale, Eight, &[3, 200], [3.0, 200.0]),
            (Grayscale, Sixteen, &[1, 2, 255, 255], [258.0, 65535.0]),
            (GrayscaleAlpha, Eight, &[3, 0, 200, 9], [3.0, 200.0]),
            (Rgb, Eight, &[7, 7, 7, 255, 0, 0], [7.0, red]),
            (Rgba, Eight, &[7, 7, 7, 1, 255, 0, 0, 2], [7.0, red]),
            (Indexed, Two, &[0b1001_0000], [2.0, 1.0]),
        ];
        for (color, depth, data, expected) in cases {
            let loaded = read_bytes(&encode_picture(*color, *depth, [2, 1], data)).unwrap();
            assert_eq!(loaded.image.dims(), [2, 1]);
            for (got, expected) in loaded.image.as_slice().iter().zip(expected) {
                assert!(
                    (got - expected).abs() < 1e-4,
                    "{color:?} {depth:?}: {got} {expected}"
                );
            }
        }
        let loaded = read_bytes(&encode_picture(Rgba, Eight, [1, 1], &[1, 1, 1, 1])).unwrap();
        assert!(loaded.notes.iter().any(|n| n.contains("transparency")));
        assert_eq!(loaded.encoding, "8-bit colours with transparency");
    }

    #[test]
    fn the_first_row_is_y_0() {
        let image = read_bytes(&encode_picture(
            ColorType::Grayscale,
            BitDepth::Eight,
            [3, 2],
            &[0, 1, 2, 10, 11, 12],
        ));
        let image = image.unwrap().image;
        assert_eq!(image.dims(), [3, 2]);
        assert_eq!(image.samples[[1, 0]], 10.0);
    }

    #[test]
    fn cut_off_and_damaged_files_are_refused() {
        let good = encode_picture(ColorType::Grayscale, BitDepth::Eight, [40, 30], &[9; 1200]);
        assert!(read_bytes(&good).is_ok());
        for end in 0..good.len() - 12 {
            let error = read_bytes(&good[..end]).unwrap_err().to_string();
            assert!(error.contains("a.png") && !error.contains('\n'), "{error}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..Default::default() })]
        #[test]
        fn what_is_written_is_read_back(
            nx in 1usize..20, ny in 1usize..20, scale in -4i32..6, whole: bool, seed in 0u32..1000,
        ) {
            let value = |i: u32| (i.wrapping_mul(2_654_435_761).wrapping_add(seed * 97) >> 16) as f32;
            let scale = if whole { [1.0 / 256.0, 1.0][(seed % 2) as usize] } else { 10f32.powi(scale) };
            let samples: Vec<f32> = (0..(nx * ny) as u32)
                .map(|i| if whole { (value(i) * scale).floor() } else { (value(i) - 3e4) * scale })
                .collect();
            let image = Image::new([nx, ny], samples, Geometry::default());
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("a.png");
            write(&path, &image).unwrap();
            let back = read(&path).unwrap().image;
            prop_assert_eq!(back.dims(), image.dims());
            let stats = image.stats();
            // Half a step of the code, and the rounding of f32.
            let allowed = if whole { 0.0 } else { (stats.max - stats.min) / 65535.0 * 0.51 + 1e-6 * stats.max.abs().max(stats.min.abs()) };
            for (a, b) in image.as_slice().iter().zip(back.as_slice()) {
                prop_assert!((a - b).abs() <= allowed, "{} {}", a, b);
            }
        }

        #[test]
        fn damaged_bytes_never_panic(at in 0usize..120, byte: u8) {
            let mut bytes = encode_picture(ColorType::Rgb, BitDepth::Eight, [5, 4], &[77; 60]);
            let at = at.min(bytes.len() - 1);
            bytes[at] = byte;
            let _ = read_bytes(&bytes);
        }
    }

    #[test]
    fn ranges_beyond_single_precision_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        for [low, high] in [[-3e38, 3e38], [0.0, 1e-42]] {
            let samples = vec![low, 0.5 * low + 0.5 * high, 0.75 * high + 0.25 * low, high];
            let image = Image::new([2, 2], samples, Geometry::default());
            write(&path, &image).unwrap();
            let back = read(&path).unwrap().image;
            let slack = (high / 65535.0 - low / 65535.0).max(1e-44);
            for (a, b) in image.as_slice().iter().zip(back.as_slice()) {
                assert!((a - b).abs() <= slack, "{a:e} {b:e}");
            }
        }
    }

    #[test]
    fn palettes_need_three_bytes_for_each_color() {
        for whole in [3, 6, 768] {
            assert_eq!(palette_problem(whole), None);
            let problem = palette_problem(whole + 1).unwrap();
            assert!(problem.contains("three for each colour"), "{problem}");
        }
        assert!(palette_problem(0).is_some());
        let indexed = encode_picture(ColorType::Indexed, BitDepth::Eight, [2, 1], &[0, 2]);
        assert!(read_bytes(&indexed).is_ok());
    }

    #[test]
    fn pictures_are_no_larger_than_their_file_can_hold() {
        for length in [1, 70, 1 << 20] {
            assert!(can_hold(length, MAX_DEFLATE_RATIO * length));
            assert!(!can_hold(length, MAX_DEFLATE_RATIO * length + 1));
        }
        assert!(can_hold(u64::MAX, u64::MAX));
    }

    #[test]
    fn non_finite_samples_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let image = Image::new([2, 1], vec![0.0, f32::NAN], Geometry::default());
        assert!(
            write(&path, &image)
                .unwrap_err()
                .to_string()
                .contains("[1, 0]")
        );
        assert!(!path.exists());
    }
}

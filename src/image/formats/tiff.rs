//! TIFF: a page is a plane of the volume, and its number is z. A single page is a 2-D image.
//!
//! Grey and colour pages of every sample type are read, compressed or not. Colours become luminance
//! as in [`png`](mod@super::png). TIFF has no geometry that all writers agree on: the spacing is
//! that of ImageJ or OME-TIFF metadata, if there are any, or else that of the resolution tags.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use quick_xml::Reader;
use quick_xml::events::Event;
use tiff::decoder::ifd::Value;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::{Tag, Type, ValueBuffer};
use tiff::{ColorType, TiffError};

use super::packed::{DAMAGED_REMEDY, MAX_DEFLATE_RATIO, file_error, open_with_length};
use super::placement::{NO_GEOMETRY_NOTE, length_unit};
use super::png::luminance;
use super::samples::{ROUNDING_NOTE, may_be_rounded};
use super::{ImageFormat, LoadedImage};
use crate::error::{Error, Result};
use crate::image::labels::LabelCollector;
use crate::image::{Geometry, Image};

/// First bytes of TIFF and BigTIFF files.
pub const MAGIC: [&[u8]; 4] = [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"];

/// Largest number of bytes that one byte of a compressed page can expand to (deflate).
const MAX_PAGE_RATIO: u64 = MAX_DEFLATE_RATIO;

/// Reads a stack of pages. A single page is read as a volume with a single sample along z.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if the file cannot be read, is truncated or damaged,
/// if its pages differ in size or kind, or if their encoding is not supported.
pub fn read(path: &Path) -> Result<LoadedImage> {
    let (file, length) = open_with_length(path)?;
    let max_bytes = usize::try_from(length.saturating_mul(MAX_PAGE_RATIO)).unwrap_or(usize::MAX);
    let mut limits = Limits::default();
    limits.decoding_buffer_size = max_bytes;
    limits.intermediate_buffer_size = max_bytes;
    let decoder = Decoder::new(BufReader::new(file)).map_err(|e| page_error(path, 0, e))?;
    let mut decoder = decoder.with_limits(limits);
    let description = image_description(&mut decoder);
    let resolution = [Tag::XResolution, Tag::YResolution].map(|tag| {
        let value = decoder.get_tag(tag).ok()?;
        match value {
            Value::Rational(a, b) if a > 0 && b > 0 => Some(f64::from(a) / f64::from(b)),
            Value::Float(x) => Some(f64::from(x)),
            Value::Double(x) => Some(x),
            _ => None,
        }
    });
    let resolution_unit = decoder.find_tag_unsigned::<u16>(Tag::ResolutionUnit);
    let resolution_unit = resolution_unit.ok().flatten();
    let pages = Pages::read_all(path, &mut decoder)?;
    let (nx, ny, color) = pages.kind;
    let stack = StackInfo::parse(&description, usize::from(color.num_samples()));
    if let Some((problem, remedy)) = stack.and_then(|stack| stack.find_problem(pages.count)) {
        return Err(file_error(path, problem, remedy));
    }
    let (spacing, note) = match stack_spacing(&description, resolution, resolution_unit) {
        Some((spacing, source)) => {
            let what = if spacing.units.iter().all(String::is_empty) {
                "spacing in pixels, without a unit,"
            } else {
                "spacing and unit"
            };
            (Some(spacing), format!("{what} from {source} metadata"))
        }
        None => tag_spacing(resolution, resolution_unit, pages.count),
    };
    let mut notes = vec![note];
    if matches!(color, ColorType::RGB(_) | ColorType::RGBA(_)) {
        notes.push("colours are read as brightness (luminance, BT.709)".into());
    }
    let is_rounded = may_be_rounded(&pages.samples);
    let labels = pages.exact.filter(|_| is_rounded);
    let labels = labels.and_then(LabelCollector::finish_exact);
    if pages.is_wide_integer && is_rounded {
        notes.push(ROUNDING_NOTE.to_string());
    }
    let dims = [nx as usize, ny as usize, pages.count];
    let mut image = Image::new(dims, pages.samples, Geometry::default());
    image.labels = labels.filter(|labels| labels.indices.len() == image.samples.len());
    if let Some(StackSpacing { steps, units }) = spacing {
        let geometry = Geometry {
            units,
            ..Geometry::with_spacing([0.0; 3], steps)
        };
        image.geometry = geometry.in_one_length_unit();
    }
    Ok(LoadedImage {
        image,
        format: ImageFormat::Tiff,
        encoding: format!("{color:?}"),
        notes,
        survey: None,
        line_numbers: None,
    })
}

/// Returns the description of the first page, which ImageJ writes in Latin-1 and others in UTF-8; empty
/// if there is none.
fn image_description(decoder: &mut Decoder<BufReader<File>>) -> String {
    let mut buffer = ValueBuffer::empty(Type::ASCII);
    let found = decoder
        .image_ifd()
        .find_tag_buf(Tag::ImageDescription, &mut buffer);
    let Ok(Some(_)) = found else {
        return String::new();
    };
    let bytes = buffer.as_bytes();
    let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    match std::str::from_utf8(&bytes[..end]) {
        Ok(text) => text.to_string(),
        Err(_) => bytes[..end].iter().map(|&b| char::from(b)).collect(),
    }
}

/// Returns the error for a page that cannot be decoded.
fn page_error(path: &Path, page: usize, error: TiffError) -> Error {
    let remedy = match error {
        TiffError::UnsupportedError(_) => "write it as grey samples, uncompressed",
        _ => DAMAGED_REMEDY,
    };
    file_error(path, format!("page {page}: {error}"), remedy).with_source(error)
}

/// The pages of a stack.
struct Pages {
    count: usize,
    /// Width, height and colours, which all pages have in common.
    kind: (u32, u32, ColorType),
    samples: Vec<f32>,
    /// The samples as exact labels, if all pages have one channel of a type of more than 24 bits and no
    /// sample has a fraction.
    exact: Option<LabelCollector>,
    is_wide_integer: bool,
}

impl Pages {
    /// Reads all pages of the file at `path`.
    fn read_all(path: &Path, decoder: &mut Decoder<BufReader<File>>) -> Result<Self> {
        let page_error = |page: usize| move |e| page_error(path, page, e);
        let kind = |decoder: &mut Decoder<_>| {
            let (nx, ny) = decoder.dimensions()?;
            Ok((nx, ny, decoder.colortype()?))
        };
        let mut pages = Self {
            count: 0,
            kind: kind(decoder).map_err(page_error(0))?,
            samples: Vec::new(),
            exact: Some(LabelCollector::default()),
            is_wide_integer: false,
        };
        loop {
            let (nx, ny, color) = kind(decoder).map_err(page_error(pages.count))?;
            if pages.kind != (nx, ny, color) {
                let (page, (a, b, c)) = (pages.count, pages.kind);
                let problem =
                    format!("page {page} is {nx} x {ny}, {color:?}, the first {a} x {b}, {c:?}");
                return Err(file_error(path, problem, "give pages of one size and kind"));
            }
            pages.read_page(path, decoder)?;
            if !decoder.more_images() {
                return Ok(pages);
            }
            decoder.next_image().map_err(page_error(pages.count))?;
        }
    }

    /// Reads the page at which `decoder` stands.
    fn read_page(&mut self, path: &Path, decoder: &mut Decoder<BufReader<File>>) -> Result<()> {
        let (number, (nx, ny, color)) = (self.count, self.kind);
        let channels = match color {
            ColorType::Gray(_) => 1,
            ColorType::GrayA(_) => 2,
            ColorType::RGB(_) => 3,
            ColorType::RGBA(_) => 4,
            _ => {
                let problem = format!("its pages are {color:?}, neither grey nor colours");
                return Err(file_error(path, problem, "write it as grey samples"));
            }
        };
        let is_planar = |decoder: &mut Decoder<_>| {
            let tag = decoder.find_tag_unsigned(Tag::PlanarConfiguration);
            tag.ok().flatten() == Some(2u16)
        };
        if channels > 1 && is_planar(decoder) {
            let problem =
                format!("page {number} stores each of its {channels} colours in a separate plane");
            let remedy = "write it as grey samples, or with interleaved colours";
            return Err(file_error(path, problem, remedy));
        }
        let page = decoder
            .read_image()
            .map_err(|e| page_error(path, number, e))?;
        let count = nx as usize * ny as usize;
        let start = self.samples.len();
        match (page, color) {
            (DecodingResult::U8(bytes), ColorType::Gray(bits @ (1 | 2 | 4))) => {
                add_bits(&bytes, bits, nx as usize, count, &mut self.samples);
            }
            (page, _) => {
                self.is_wide_integer |= matches!(
                    page,
                    DecodingResult::U32(_)
                        | DecodingResult::I32(_)
                        | DecodingResult::U64(_)
                        | DecodingResult::I64(_)
                );
                let exact = self.exact.as_mut().filter(|_| channels == 1);
                if !exact.is_some_and(|collector| add_exact(&page, count, collector)) {
                    self.exact = None;
                }
                add_page(page, channels, count, &mut self.samples);
            }
        }
        if self.samples.len() != start + count || count == 0 {
            let problem = format!("page {number} does not hold {nx} x {ny}, {color:?}");
            return Err(file_error(path, problem, DAMAGED_REMEDY));
        }
        self.count += 1;
        Ok(())
    }
}

/// Distance between samples along x, y and z.
struct StackSpacing {
    steps: [f64; 3],
    units: [String; 3],
}

/// Returns the spacing in the metadata of ImageJ or OME-TIFF, and which of the two it is. ImageJ
/// stores the spacing along x and y in the TIFF tag `resolution`, in samples per unit; the unit is
/// in its description.
fn stack_spacing(
    description: &str,
    resolution: [Option<f64>; 2],
    resolution_unit: Option<u16>,
) -> Option<(StackSpacing, &'static str)> {
    let valid = |steps: [f64; 3]| steps.iter().all(|h| h.is_finite() && *h > 0.0);
    if description.starts_with("ImageJ=") {
        let field = |name: &str| {
            let mut fields = description.lines().filter_map(|line| line.split_once('='));
            let value = fields.find(|(field, _)| field.trim() == name);
            value.map(|(_, value)| value.trim().to_string())
        };
        // ImageJ leaves out what is 1, units that are those of x, and the unit if the tag gives it.
        let unit = match (field("unit"), resolution_unit) {
            (Some(unit), _) => unit_symbol(&unit),
            (None, Some(2)) => "in".to_string(),
            (None, Some(3)) => "cm".to_string(),
            (None, _) => String::new(),
        };
        // Without a unit in the description, resolutions of screens and printers say nothing.
        let is_print =
            field("unit").is_none() && are_print_resolutions(resolution, resolution_unit);
        let unit = if is_print { String::new() } else { unit };
        let [x, y] = resolution.map(|value| value.filter(|_| !is_print).unwrap_or(1.0));
        let z = field("spacing").map_or(Some(1.0), |z| z.parse::<f64>().ok())?;
        let steps = [1.0 / x, 1.0 / y, z.abs()];
        let axis_unit = |name: &str| field(name).map_or_else(|| unit.clone(), |u| unit_symbol(&u));
        let units = [unit.clone(), axis_unit("yunit"), axis_unit("zunit")];
        let is_bare = steps == [1.0; 3] && unit.is_empty();
        let spacing = StackSpacing { steps, units };
        return (valid(steps) && !is_bare).then_some((spacing, "ImageJ"));
    }
    let mut reader = Reader::from_str(description);
    loop {
        let element = match reader.read_event() {
            Ok(Event::Eof) | Err(_) => return None,
            Ok(Event::Start(element) | Event::Empty(element)) => element,
            Ok(_) => continue,
        };
        if element.local_name().as_ref() != "Pixels" {
            continue;
        }
        let attribute_text = |name: String| {
            let attribute = element.try_get_attribute(name.as_str()).ok().flatten();
            attribute.map(|a| a.value.trim().to_string())
        };
        let step = |axis: &str| {
            attribute_text(format!("PhysicalSize{axis}"))?
                .parse::<f64>()
                .ok()
        };
        let unit = |axis: &str| match attribute_text(format!("PhysicalSize{axis}Unit")) {
            Some(unit) => unit_symbol(&unit),
            None => "um".to_string(),
        };
        let (x, y) = (step("X")?, step("Y")?);
        // A single plane has no spacing along z.
        let steps = [x, y, step("Z").unwrap_or(x)];
        let units = [unit("X"), unit("Y"), unit("Z")];
        return valid(steps).then_some((StackSpacing { steps, units }, "OME"));
    }
}

/// Returns the symbol of a unit as microscopes write it: empty for pixels, and the text itself if the unit
/// is not known.
fn unit_symbol(text: &str) -> String {
    // ImageJ writes letters that are not ASCII by their codes, such as \u00C5.
    let decoded = text.trim().strip_prefix("\\u").and_then(|code| {
        let (code, rest) = code.split_at_checked(4)?;
        let letter = char::from_u32(u32::from_str_radix(code, 16).ok()?)?;
        Some(format!("{letter}{rest}"))
    });
    match decoded.as_deref().unwrap_or(text).trim() {
        "pixel" | "pixels" | "px" | "reference frame" => String::new(),
        unit => length_unit(unit).unwrap_or(unit).to_string(),
    }
}

/// Resolutions per inch that programs write without regard to the sizes of what the image shows: those
/// of screens and printers.
const PRINT_RESOLUTIONS: [f64; 10] = [
    72.0, 75.0, 90.0, 96.0, 100.0, 150.0, 200.0, 300.0, 600.0, 1200.0,
];

/// Returns `true` if both resolutions, per centimetre if the tag of the unit is 3 and else per inch, are
/// those of screens and printers.
fn are_print_resolutions(resolution: [Option<f64>; 2], unit: Option<u16>) -> bool {
    let per_inch = if unit == Some(3) { 2.54 } else { 1.0 };
    resolution.into_iter().all(|value| {
        let mut common = PRINT_RESOLUTIONS.iter();
        value.is_some_and(|value| common.any(|print| (value * per_inch - print).abs() < 0.5))
    })
}

/// Returns the spacing in the resolution tags, if these give a size, and a note. TIFF has no spacing
/// between pages: it is taken as that of the rows.
fn tag_spacing(
    resolution: [Option<f64>; 2],
    unit: Option<u16>,
    pages: usize,
) -> (Option<StackSpacing>, String) {
    let none = || format!("a TIFF stack {NO_GEOMETRY_NOTE}");
    // The unit is an inch unless the tag says otherwise.
    let name = match unit {
        None | Some(2) => "in",
        Some(3) => "cm",
        _ => return (None, none()),
    };
    let [Some(x), Some(y)] = resolution else {
        return (None, none());
    };
    let steps = [1.0 / x, 1.0 / y, 1.0 / y];
    let is_valid = steps.iter().all(|h| h.is_finite() && *h > 0.0);
    if !is_valid || (x, y) == (1.0, 1.0) || are_print_resolutions(resolution, unit) {
        return (None, none());
    }
    let mut note = format!("spacing from its resolution tags ({x} x {y} per {name})");
    if pages > 1 {
        note += ", which say nothing of the distance of planes: taken as that of rows (--spacing sets it)";
    }
    let units = [(); 3].map(|()| name.to_string());
    (Some(StackSpacing { steps, units }), note)
}

/// Adds the samples of a page as exact labels. Returns `false` if 32-bit floats hold them exactly, or if
/// some have a fraction.
fn add_exact(page: &DecodingResult, count: usize, collector: &mut LabelCollector) -> bool {
    match page {
        DecodingResult::U32(v) => collector.extend(v.iter().take(count).map(|&x| x.into())),
        DecodingResult::U64(v) => collector.extend(v.iter().take(count).map(|&x| x.into())),
        DecodingResult::I32(v) => collector.extend(v.iter().take(count).map(|&x| x.into())),
        DecodingResult::I64(v) => collector.extend(v.iter().take(count).map(|&x| x.into())),
        DecodingResult::F64(v) => {
            return collector.extend_exact(v.iter().take(count).map(|&x| x.into()));
        }
        _ => return false,
    }
    true
}

/// Layout of a stack as ImageJ or OME-TIFF describe it in the first page.
#[derive(Default)]
struct StackInfo {
    /// Number of planes in the file.
    planes: usize,
    /// Number of images, each a stack of its own.
    images: usize,
    channels: usize,
    slices: usize,
    time_points: usize,
}

impl StackInfo {
    /// Parses a description; returns `None` if it is neither of ImageJ nor of OME-TIFF. `per_page`
    /// is the number of channels in a page.
    fn parse(description: &str, per_page: usize) -> Option<Self> {
        if description.starts_with("ImageJ=") {
            return Some(Self::parse_imagej(description));
        }
        Self::parse_ome(description, per_page)
    }

    fn parse_imagej(description: &str) -> Self {
        let count = |name: &str| {
            let mut fields = description.lines().filter_map(|line| line.split_once('='));
            let value = fields.find(|(field, _)| *field == name);
            value.map_or(1, |(_, value)| value.trim().parse().unwrap_or(1))
        };
        Self {
            planes: count("images"),
            images: 1,
            channels: count("channels"),
            slices: count("slices"),
            time_points: count("frames"),
        }
    }

    /// Parses the XML of OME. Each element `Pixels` is an image and gives the number of its planes
    /// of each kind.
    fn parse_ome(description: &str, per_page: usize) -> Option<Self> {
        let mut stack = Self::default();
        let mut reader = Reader::from_str(description);
        loop {
            let (Event::Start(element) | Event::Empty(element)) = (match reader.read_event() {
                Ok(Event::Eof) | Err(_) => break,
                Ok(event @ (Event::Start(_) | Event::Empty(_))) => event,
                Ok(_) => continue,
            }) else {
                continue;
            };
            if element.local_name().as_ref() != "Pixels" {
                continue;
            }
            let count = |name: &str| {
                let attribute = element.try_get_attribute(name).ok().flatten();
                attribute.and_then(|a| a.value.trim().parse().ok())
            };
            stack.images += 1;
            if stack.images == 1 {
                // The channels within a page are its colours.
                stack.channels = count("SizeC").unwrap_or(1) / per_page.max(1);
                stack.slices = count("SizeZ").unwrap_or(1);
                stack.time_points = count("SizeT").unwrap_or(1);
                stack.planes = 1;
            }
        }
        (stack.images > 0).then_some(stack)
    }

    /// Returns the problem and the remedy if a file with this number of pages is not a single
    /// volume.
    fn find_problem(&self, pages: usize) -> Option<(String, &'static str)> {
        let kinds = [
            (self.images, "images"),
            (self.channels, "channels"),
            (self.time_points, "times"),
        ];
        let several = kinds.iter().filter(|(count, _)| *count > 1);
        let several: Vec<String> = several
            .map(|(count, name)| format!("{count} {name}"))
            .collect();
        if !several.is_empty() {
            let (several, slices) = (several.join(" and "), self.slices);
            let slices_text = if slices > 1 {
                format!(", each of {slices} slices")
            } else {
                String::new()
            };
            return Some((
                format!(
                    "holds {several}{slices_text}, so its pages are not the planes of one volume"
                ),
                "write one channel at one time to a file, e.g. in Python with tifffile (if \
                 these are really slices, correct this in ImageJ under Image > Properties)",
            ));
        }
        // Files beyond 4 GB have one page in ImageJ, and the other planes follow it without pages.
        let planes = self.planes;
        (pages == 1 && planes > 1).then(|| {
            let problem = format!("holds {planes} planes, of which only the first is a page");
            (
                problem,
                "write a page for each, e.g. in Python with tifffile",
            )
        })
    }
}

/// Adds the samples of a page with fewer than eight bits per sample. Each row begins at a byte, and
/// the highest bits come first.
pub fn add_bits(bytes: &[u8], bits: u8, nx: usize, count: usize, samples: &mut Vec<f32>) {
    let (bits, mask) = (usize::from(bits), (1u8 << bits) - 1);
    let row = (nx * bits).div_ceil(8);
    let rows = bytes.chunks_exact(row.max(1)).take(count / nx.max(1));
    for row in rows {
        let value = |x: usize| row[x * bits / 8] >> (8 - bits - x * bits % 8) & mask;
        samples.extend((0..nx).map(|x| f32::from(value(x))));
    }
}

/// Adds the samples of a page. Colours become luminance, and transparency is dropped.
fn add_page(page: DecodingResult, channels: usize, count: usize, samples: &mut Vec<f32>) {
    let mut add = |values: &mut dyn Iterator<Item = f32>| {
        if channels == 1 {
            samples.extend(values.take(count));
            return;
        }
        let values: Vec<f32> = values.take(count * channels).collect();
        let value = |pixel: &[f32]| {
            if channels == 2 {
                pixel[0]
            } else {
                luminance(pixel)
            }
        };
        samples.extend(values.chunks_exact(channels).map(value));
    };
    match page {
        DecodingResult::U8(v) => add(&mut v.into_iter().map(f32::from)),
        DecodingResult::U16(v) => add(&mut v.into_iter().map(f32::from)),
        DecodingResult::U32(v) => add(&mut v.into_iter().map(|x| x as f32)),
        DecodingResult::U64(v) => add(&mut v.into_iter().map(|x| x as f32)),
        DecodingResult::I8(v) => add(&mut v.into_iter().map(f32::from)),
        DecodingResult::I16(v) => add(&mut v.into_iter().map(f32::from)),
        DecodingResult::I32(v) => add(&mut v.into_iter().map(|x| x as f32)),
        DecodingResult::I64(v) => add(&mut v.into_iter().map(|x| x as f32)),
        DecodingResult::F16(v) => add(&mut v.into_iter().map(f32::from)),
        DecodingResult::F32(v) => add(&mut v.into_iter()),
        DecodingResult::F64(v) => add(&mut v.into_iter().map(|x| x as f32)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_of_less_than_a_byte_are_unpacked() {
        let unpacked = |bytes: &[u8], bits, nx, count| {
            let mut samples = Vec::new();
            add_bits(bytes, bits, nx, count, &mut samples);
            samples
        };
        // Two rows each; the second row begins at a byte of its own.
        assert_eq!(
            unpacked(&[0b1010_0000, 0b0110_0000], 1, 3, 6),
            [1., 0., 1., 0., 1., 1.]
        );
        assert_eq!(
            unpacked(&[0b1101_0010, 0b0100_0000], 2, 3, 6)[..3],
            [3., 1., 0.]
        );
        assert_eq!(
            unpacked(&[0xab, 0xc0, 0x12, 0x30], 4, 3, 6),
            [10., 11., 12., 1., 2., 3.]
        );
        // The function adds nothing if data are missing; the caller detects that.
        assert_eq!(unpacked(&[0xab], 4, 3, 6), [0.; 0]);
    }
    use tiff::encoder::{
        TiffEncoder,
        colortype::{Gray8, RGB8},
    };

    #[test]
    fn imagej_leaves_out_what_is_one_and_units_of_x() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tif");
        let geometry = |resolution: Option<[u32; 2]>, fields: &[u8]| {
            let mut encoder = TiffEncoder::new(std::fs::File::create(&path).unwrap()).unwrap();
            for _ in 0..2 {
                let mut page = encoder.new_image::<Gray8>(3, 2).unwrap();
                let description = [b"ImageJ=1.53t\nimages=2\nslices=2\n", fields].concat();
                // A text in Latin-1 is written as bytes.
                let tags = page.encoder();
                tags.write_tag(Tag::ImageDescription, description.as_slice())
                    .unwrap();
                if let Some([n, d]) = resolution {
                    for tag in [Tag::XResolution, Tag::YResolution] {
                        tags.write_tag(tag, tiff::encoder::Rational { n, d })
                            .unwrap();
                    }
                }
                page.write_data(&[7; 6]).unwrap();
            }
            let geometry = read(&path).unwrap().image.geometry;
            (geometry.spacing(), geometry.units.join(","))
        };
        for (resolution, fields, steps, units) in [
            (
                Some([4, 1]),
                &b"unit=um\n"[..],
                [0.25, 0.25, 1.0],
                "um,um,um",
            ),
            (None, b"unit=um\nspacing=2.5\n", [1.0, 1.0, 2.5], "um,um,um"),
            (
                Some([1, 8]),
                b"unit=nm\nzunit=um\nspacing=0.04\n",
                [8.0, 8.0, 40.0],
                "nm,nm,nm",
            ),
            (
                Some([4, 1]),
                b"unit=\xb5m\nspacing=2.0\n",
                [0.25, 0.25, 2.0],
                "um,um,um",
            ),
            (
                Some([100, 1]),
                b"unit=inch\nspacing=0.02\n",
                [0.01, 0.01, 0.02],
                "in,in,in",
            ),
            (
                Some([10, 1]),
                b"unit=cm\nyunit=mm\n",
                [0.1, 0.01, 1.0],
                "cm,cm,cm",
            ),
            (
                Some([2, 1]),
                b"unit=\\u00C5\nspacing=0.5\n",
                [0.5, 0.5, 0.5],
                "angstrom,angstrom,angstrom",
            ),
            (
                Some([1, 2]),
                b"unit=pixel\nspacing=3.0\n",
                [2.0, 2.0, 3.0],
                ",,",
            ),
            (Some([72, 1]), b"spacing=3.0\n", [1.0, 1.0, 3.0], ",,"),
        ] {
            let (found, found_units) = geometry(resolution, fields);
            assert_eq!((found, &*found_units), (steps, units));
        }
    }

    #[test]
    fn resolution_tags_give_the_spacing_unless_they_are_those_of_printers() {
        for (resolution, unit, expected) in [
            (
                [10_000.0, 5_000.0],
                Some(3),
                Some(([1e-4, 2e-4, 2e-4], "cm")),
            ),
            ([1016.0, 1016.0], Some(2), Some(([1.0 / 1016.0; 3], "in"))),
            ([300.0, 300.0], Some(2), None),
            ([118.11, 118.11], Some(3), None),
            ([72.0, 72.0], None, None),
            ([1.0, 1.0], Some(2), None),
            ([400.0, 400.0], Some(1), None),
        ] {
            let (spacing, note) = tag_spacing(resolution.map(Some), unit, 4);
            let found = spacing.as_ref().map(|s| (s.steps, &*s.units[0]));
            assert_eq!(found, expected);
            assert_eq!(note.contains("taken as that of rows"), expected.is_some());
        }
    }

    #[test]
    fn stacks_of_imagej_that_are_no_volume_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tif");
        let read_stack = |pages: usize, description: &str| {
            let mut encoder = TiffEncoder::new(std::fs::File::create(&path).unwrap()).unwrap();
            for _ in 0..pages {
                let mut page = encoder.new_image::<Gray8>(3, 2).unwrap();
                page.encoder()
                    .write_tag(Tag::ImageDescription, description)
                    .unwrap();
                page.write_data(&[7; 6]).unwrap();
            }
            read(&path).map(|loaded| loaded.image.dims())
        };
        let refusal =
            |pages, description: &str| read_stack(pages, description).unwrap_err().to_string();
        let message = refusal(
            12,
            "ImageJ=1.11a\nimages=12\nchannels=2\nslices=3\nframes=2\n",
        );
        let expected = "a.tif: holds 2 channels and 2 times, each of 3 slices";
        assert!(message.contains(expected), "{message}");
        let message = refusal(6, "ImageJ=1.11a\nimages=6\nslices=3\nframes=2\n");
        assert!(message.contains("holds 2 times, each of 3"), "{message}");
        let message = refusal(4, "ImageJ=1.53t\nimages=4\nframes=4\n");
        assert!(message.contains("holds 4 times, so"), "{message}");
        let message = refusal(1, "ImageJ=1.53t\nimages=5\nslices=5\n");
        assert!(message.contains("a.tif: holds 5 planes"), "{message}");
        for description in ["ImageJ=1.53t\nimages=4\nslices=4\n", "a rock, channels=2"] {
            assert_eq!(read_stack(4, description).unwrap(), [3, 2, 4]);
        }
    }

    #[test]
    fn ome_stacks_that_are_no_volume_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ome.tif");
        let write = |pages: usize, images: &[[usize; 3]]| {
            let pixels = images.iter().map(|[z, c, t]| {
                format!("<Image ID=\"Image:0\"><Pixels DimensionOrder=\"XYZCT\" SizeC=\"{c}\" SizeT=\"{t}\" SizeX=\"3\" SizeY=\"2\" SizeZ=\"{z}\" Type=\"uint8\"><TiffData/></Pixels></Image>")
            });
            let description = format!(
                "<?xml version=\"1.0\"?><!-- not by hand --><OME xmlns=\"http://www.openmicroscopy.org/Schemas/OME/2016-06\">{}</OME>",
                pixels.collect::<String>()
            );
            let mut encoder = TiffEncoder::new(std::fs::File::create(&path).unwrap()).unwrap();
            for number in 0..pages {
                let mut page = encoder.new_image::<RGB8>(3, 2).unwrap();
                if number == 0 {
                    let tag = Tag::ImageDescription;
                    page.encoder().write_tag(tag, description.as_str()).unwrap();
                }
                page.write_data(&[7; 18]).unwrap();
            }
            read(&path).map(|loaded| loaded.image.dims())
        };
        // The three channels are the colours of each page.
        assert_eq!(write(4, &[[4, 3, 1]]).unwrap(), [3, 2, 4]);
        assert_eq!(write(4, &[[4, 1, 1]]).unwrap(), [3, 2, 4]);
        let refusals = [
            (6, vec![[3, 6, 1]], "holds 2 channels, each of 3 slices"),
            (6, vec![[3, 3, 2]], "holds 2 times, each of 3 slices"),
            (6, vec![[1, 6, 3]], "holds 2 channels and 3 times, so"),
            (2, vec![[1, 3, 1]; 2], "holds 2 images, so"),
        ];
        for (pages, images, expected) in refusals {
            let message = write(pages, &images).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}

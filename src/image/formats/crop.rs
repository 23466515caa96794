//! Parts of images: blocks of samples between line numbers, coordinates or indices.
//!
//! The samples outside the block are not read, as far as the format allows: of an image that stays in
//! its file, only the rows of the block are read. The result is the image that a file of the block
//! alone would give.

use std::fmt::{self, Display, Formatter};
use std::ops::Range;
use std::path::Path;
use std::str::FromStr;
use std::sync::Arc;

use super::stream::{ImageHeader, ImageStream, OpenedImage, PlaneReader};
use super::{AnyImage, LineNumbers, LoadedImage};
use crate::error::{Error, Result, cause};
use crate::geometry::grid_index::{block_rows, index_at, offset_of};
use crate::geometry::norm;
use crate::image::time::{metres_per_unit, seconds_per_unit};
use crate::image::{ExactLabels, Geometry, Image};

/// Distance in samples by which the ends of a range may miss a sample that still belongs to it.
const SAMPLE_TOLERANCE: f64 = 1e-6;

/// Number of samples that are read at a time to take a part of each row.
const MAX_SAMPLES_PER_READ: usize = 1 << 22;

const REMEDY: &str = "give ranges such as inline=100:200,crossline=50:150,time=1000:1500, x=A:B, y=A:B, z=A:B or i=A:B";

/// A block of an image: ranges of line numbers, coordinates or indices, each with both ends.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Crop(Vec<CropRange>);

/// A range of a block.
#[derive(Debug, Clone, PartialEq)]
struct CropRange {
    quantity: CropQuantity,
    /// The ends, of which the first is not above the second; infinite where there is none.
    ends: [f64; 2],
}

/// The quantity to which a range applies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CropQuantity {
    Inline,
    Crossline,
    /// Two-way time, downwards.
    Time,
    /// Depth, downwards.
    Depth,
    /// The physical coordinate x, y or z.
    Coordinate(usize),
    /// The index along the first, second or third axis, from 0.
    Index(usize),
}

/// Names of the quantities.
const QUANTITIES: [(&str, CropQuantity); 10] = [
    ("inline", CropQuantity::Inline),
    ("crossline", CropQuantity::Crossline),
    ("time", CropQuantity::Time),
    ("depth", CropQuantity::Depth),
    ("x", CropQuantity::Coordinate(0)),
    ("y", CropQuantity::Coordinate(1)),
    ("z", CropQuantity::Coordinate(2)),
    ("i", CropQuantity::Index(0)),
    ("j", CropQuantity::Index(1)),
    ("k", CropQuantity::Index(2)),
];

impl CropQuantity {
    fn name(self) -> &'static str {
        let known = QUANTITIES.iter().find(|(_, quantity)| *quantity == self);
        known.map_or("", |(name, _)| name)
    }
}

impl Display for CropRange {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let end = |end: f64| {
            if end.is_finite() {
                end.to_string()
            } else {
                String::new()
            }
        };
        let [from, to] = self.ends.map(end);
        write!(f, "{}={from}:{to}", self.quantity.name())
    }
}

impl Display for Crop {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let ranges: Vec<String> = self.0.iter().map(CropRange::to_string).collect();
        f.write_str(&ranges.join(","))
    }
}

impl FromStr for Crop {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let ranges: Vec<CropRange> = text.split(',').map(parse_range).collect::<Result<_>>()?;
        let is_repeated = |(n, range): (usize, &CropRange)| {
            ranges[..n]
                .iter()
                .any(|other| other.quantity == range.quantity)
        };
        match ranges.iter().enumerate().find(|range| is_repeated(*range)) {
            None => Ok(Self(ranges)),
            Some((_, range)) => {
                let place = format!("crop {text}");
                let problem = format!("gives {} twice", range.quantity.name());
                Err(Error::Job(cause(place, problem, "give each range once")))
            }
        }
    }
}

/// Parses one range, such as `x=10:20`, `x=10:` or `inline=105`.
fn parse_range(text: &str) -> Result<CropRange> {
    let refuse = |problem: &str| {
        let place = format!("crop {text}");
        Error::Job(cause(place, problem, REMEDY))
    };
    let (name, range) = text.split_once('=').ok_or_else(|| refuse("has no '='"))?;
    let name = name.trim();
    let quantity = QUANTITIES.iter().find(|(known, _)| *known == name);
    let quantity = quantity.ok_or_else(|| refuse("names no axis"))?.1;
    let number = |text: &str, default: f64| match text.trim() {
        "" => Ok(default),
        text => {
            let number = text.parse().ok().filter(|n: &f64| n.is_finite());
            number.ok_or_else(|| refuse("has an end that is not a number"))
        }
    };
    let (from, to) = range.split_once(':').unwrap_or((range, range));
    if from.trim().is_empty() && to.trim().is_empty() {
        return Err(refuse("has no end"));
    }
    let [a, b] = [number(from, f64::NEG_INFINITY)?, number(to, f64::INFINITY)?];
    Ok(CropRange {
        quantity,
        ends: [a.min(b), a.max(b)],
    })
}

impl Crop {
    /// Returns the part of an image that the ranges give, with a note.
    ///
    /// # Errors
    /// Returns [`Error::Image`] if a range lies outside the image, or applies to nothing in it.
    pub(super) fn apply(&self, opened: OpenedImage) -> Result<OpenedImage> {
        Ok(match opened {
            OpenedImage::Stream(stream) => {
                let block = self.block(&stream.header)?;
                let stream = crop_stream(stream, &block);
                if stream.header.dims.iter().all(|&n| n > 1) {
                    return Ok(OpenedImage::Stream(stream));
                }
                let loaded = with_thin_axis_last(stream.into_loaded(Path::new("the image"))?);
                OpenedImage::InMemory(super::into_any_image(loaded))
            }
            OpenedImage::InMemory(AnyImage::Plane(loaded)) => {
                let block = self.block(&loaded.header())?;
                OpenedImage::InMemory(AnyImage::Plane(crop_loaded(loaded, &block)))
            }
            OpenedImage::InMemory(AnyImage::Space(loaded)) => {
                let block = self.block(&loaded.header())?;
                let loaded = with_thin_axis_last(crop_loaded(loaded, &block));
                OpenedImage::InMemory(super::into_any_image(loaded))
            }
        })
    }

    /// Returns the range of samples along each axis.
    fn block<const D: usize>(&self, header: &ImageHeader<D>) -> Result<[Range<usize>; D]> {
        let (dims, geometry) = (header.dims, &header.geometry);
        let mut ends = dims.map(|n| [0.0, n as f64 - 1.0]);
        let mut slabs: Vec<Slab> = Vec::new();
        for range in &self.0 {
            match range.quantity {
                CropQuantity::Inline | CropQuantity::Crossline => {
                    let (axis, lines) = range.lines(header)?;
                    let index = range
                        .ends
                        .map(|n| (n - lines.first as f64) / lines.step as f64);
                    range.narrow(&mut ends[axis], index, || lines.to_string())?;
                }
                CropQuantity::Index(axis) => {
                    let limit = ends.get_mut(axis).ok_or_else(|| range.no_axis_error(D))?;
                    let last = dims[axis] - 1;
                    range.narrow(limit, range.ends, || format!("indices 0 to {last}"))?;
                }
                _ => slabs.push(range.slab(geometry)?),
            }
        }
        let Some([low, high]) = bounds_within(geometry, &ends, &slabs) else {
            return Err(self.outside_error(header));
        };
        let mut block = std::array::from_fn(|_| 0..0);
        for k in 0..D {
            let first = (low[k] - SAMPLE_TOLERANCE).ceil().max(0.0);
            let last = (high[k] + SAMPLE_TOLERANCE)
                .floor()
                .min(dims[k] as f64 - 1.0);
            if first > last {
                return Err(self.outside_error(header));
            }
            block[k] = first as usize..last as usize + 1;
        }
        Ok(block)
    }

    /// Returns the error for ranges that hold no sample.
    fn outside_error<const D: usize>(&self, header: &ImageHeader<D>) -> Error {
        let last = header.dims.map(|n| n as f64 - 1.0);
        let corners = (0..1usize << D).map(|corner| {
            let index = std::array::from_fn(|k| if corner >> k & 1 == 0 { 0.0 } else { last[k] });
            header.geometry.to_physical(index)
        });
        let corners: Vec<[f64; D]> = corners.collect();
        let range = |c: usize| {
            let values = corners.iter().map(|corner| corner[c]);
            let low = values.clone().fold(f64::INFINITY, f64::min);
            let high = values.fold(f64::NEG_INFINITY, f64::max);
            format!("{} from {low} to {high}", ["x", "y", "z"][c])
        };
        let ranges: Vec<String> = (0..D).map(range).collect();
        let problem = format!(
            "holds no sample of the image, which has {}",
            ranges.join(", ")
        );
        let cause = cause(format!("crop {self}"), problem, "give ranges within these");
        Error::Image(cause.with_parameter("crop"))
    }
}

/// A part of space between two planes: `ends[0] <= coordinate <= ends[1]`.
struct Slab {
    coordinate: usize,
    ends: [f64; 2],
}

impl CropRange {
    /// Returns the axis of the lines of a survey, and their numbers.
    fn lines<const D: usize>(&self, header: &ImageHeader<D>) -> Result<(usize, LineNumbers)> {
        let kind = usize::from(self.quantity == CropQuantity::Crossline);
        let name = self.quantity.name();
        let axis = header.geometry.names.iter().position(|axis| axis == name);
        let lines = header.line_numbers.map(|lines| lines[kind]);
        axis.zip(lines).ok_or_else(|| {
            let problem = format!("is given, but the image has no {name} numbers");
            let remedy = "crop by coordinates (x=A:B) or by indices (i=A:B)";
            let cause = cause(format!("crop {self}"), problem, remedy);
            Error::Image(cause.with_parameter("crop"))
        })
    }

    /// Narrows a range of indices; `known` says what there is.
    fn narrow(
        &self,
        limits: &mut [f64; 2],
        index: [f64; 2],
        known: impl Fn() -> String,
    ) -> Result<()> {
        let [low, high] = [limits[0].max(index[0]), limits[1].min(index[1])];
        let first = (low - SAMPLE_TOLERANCE).ceil();
        let last = (high + SAMPLE_TOLERANCE).floor();
        if first > last {
            let problem = format!("holds no sample of the image, which has {}", known());
            let cause = cause(format!("crop {self}"), problem, "give a range within these");
            return Err(Error::Image(cause.with_parameter("crop")));
        }
        *limits = [first, last];
        Ok(())
    }

    fn no_axis_error(&self, axes: usize) -> Error {
        let problem = format!("is for images with more than {axes} axes");
        let cause = cause(format!("crop {self}"), problem, "omit it");
        Error::Image(cause.with_parameter("crop"))
    }

    /// Returns the part of space of a range of coordinates.
    fn slab<const D: usize>(&self, geometry: &Geometry<D>) -> Result<Slab> {
        let unit = &geometry.units[D - 1];
        let (is_wrong, domain) = match self.quantity {
            CropQuantity::Time => (metres_per_unit(unit).is_some(), "depth"),
            CropQuantity::Depth => (seconds_per_unit(unit).is_some(), "time"),
            CropQuantity::Coordinate(coordinate) if coordinate >= D => {
                return Err(self.no_axis_error(D));
            }
            CropQuantity::Coordinate(coordinate) => {
                return Ok(Slab {
                    coordinate,
                    ends: self.ends,
                });
            }
            _ => (false, ""),
        };
        if is_wrong {
            let problem = format!("is given, but the image is in {domain} ({unit})");
            let cause = cause(
                format!("crop {self}"),
                problem,
                format!("give {domain}=A:B"),
            );
            return Err(Error::Image(cause.with_parameter("crop")));
        }
        let [a, b] = self.ends;
        let ends = if geometry.points_down() {
            [a, b]
        } else {
            [-b, -a]
        };
        Ok(Slab {
            coordinate: D - 1,
            ends,
        })
    }
}

/// A plane in the space of sample indices: `sum_k normal[k] index[k] = value`.
type IndexPlane<const D: usize> = ([f64; D], f64);

/// Returns the smallest and the largest index along each axis of the points between `ends` that lie
/// in all slabs, or `None` if there is no such point. They are those of the corners of a convex body,
/// in which `D` of its planes meet.
fn bounds_within<const D: usize>(
    geometry: &Geometry<D>,
    ends: &[[f64; 2]; D],
    slabs: &[Slab],
) -> Option<[[f64; D]; 2]> {
    if slabs.is_empty() {
        return Some([0, 1].map(|end| ends.map(|ends| ends[end])));
    }
    let mut planes: Vec<IndexPlane<D>> = Vec::new();
    for (k, ends) in ends.iter().enumerate() {
        let normal = std::array::from_fn(|axis| if axis == k { 1.0 } else { 0.0 });
        planes.extend(ends.map(|end| (normal, end)));
    }
    for slab in slabs {
        let normal: [f64; D] = std::array::from_fn(|axis| geometry.axes[axis][slab.coordinate]);
        let tolerance = SAMPLE_TOLERANCE * norm(normal);
        let finite = slab.ends.iter().zip([-tolerance, tolerance]);
        let finite = finite.filter(|(end, _)| end.is_finite());
        let origin = geometry.origin[slab.coordinate];
        planes.extend(finite.map(|(end, tolerance)| (normal, end + tolerance - origin)));
    }
    let is_within = |index: &[f64; D]| {
        let within_ends = (0..D).all(|k| {
            let [low, high] = ends[k];
            (low - SAMPLE_TOLERANCE..=high + SAMPLE_TOLERANCE).contains(&index[k])
        });
        let position = geometry.to_physical(*index);
        within_ends
            && slabs.iter().all(|slab| {
                let step = norm(geometry.axes.map(|axis| axis[slab.coordinate]));
                let [low, high] = slab.ends;
                let tolerance = 2.0 * SAMPLE_TOLERANCE * step;
                (low - tolerance..=high + tolerance).contains(&position[slab.coordinate])
            })
    };
    let mut bounds = [[f64::INFINITY; D], [f64::NEG_INFINITY; D]];
    for choice in 0..planes.len().pow(D as u32) {
        let chosen = index_at([planes.len(); D], choice);
        if (1..D).any(|k| chosen[k] <= chosen[k - 1]) {
            continue;
        }
        let corner = Geometry::<D> {
            origin: [0.0; D],
            axes: std::array::from_fn(|k| chosen.map(|plane| planes[plane].0[k])),
            ..Geometry::default()
        };
        let values = chosen.map(|plane| planes[plane].1);
        if let Some(index) = corner.to_index(values).filter(is_within) {
            for k in 0..D {
                bounds[0][k] = bounds[0][k].min(index[k]);
                bounds[1][k] = bounds[1][k].max(index[k]);
            }
        }
    }
    bounds[0][0].is_finite().then_some(bounds)
}

/// Returns the note on a part of an image.
fn crop_note<const D: usize>(dims: [usize; D], block: &[Range<usize>; D]) -> String {
    let text = |numbers: [usize; D]| numbers.map(|n| n.to_string()).join(" x ");
    let kept = std::array::from_fn(|k| block[k].len());
    format!("cropped to {} of {} samples", text(kept), text(dims))
}

/// Crops everything that is known of an image but its samples.
fn crop_header<const D: usize>(header: &mut ImageHeader<D>, block: &[Range<usize>; D]) {
    let dims = header.dims;
    header.notes.push(crop_note(dims, block));
    let first = std::array::from_fn(|k| block[k].start as f64);
    header.geometry.origin = header.geometry.to_physical(first);
    header.dims = std::array::from_fn(|k| block[k].len());
    if !header.missing.is_empty() {
        let mut rows = dims;
        rows[0] = 1;
        let start = std::array::from_fn(|k| if k == 0 { 0 } else { block[k].start });
        let mut size = header.dims;
        size[0] = 1;
        let kept = block_rows(rows, start, size).map(|row| header.missing[row]);
        header.missing = kept.collect();
        if !header.missing.contains(&true) {
            header.missing = Vec::new();
        }
    }
    if let Some(lines) = &mut header.line_numbers {
        for (lines, name) in lines.iter_mut().zip(["inline", "crossline"]) {
            let names = &header.geometry.names;
            if let Some(axis) = names.iter().position(|axis| axis == name) {
                lines.first += block[axis].start as i64 * lines.step;
                lines.count = block[axis].len() as u64;
            }
        }
    }
}

/// Returns the block of an image.
fn crop_image<const D: usize>(image: &Image<D>, block: &[Range<usize>; D]) -> Image<D> {
    let dims = image.dims();
    let (first, size): ([usize; D], [usize; D]) = (
        std::array::from_fn(|k| block[k].start),
        std::array::from_fn(|k| block[k].len()),
    );
    let rows = || block_rows(dims, first, size).map(|start| start..start + size[0]);
    let samples = rows().flat_map(|row| image.as_slice()[row].iter().copied());
    let mut geometry = image.geometry.clone();
    geometry.origin = geometry.to_physical(first.map(|i| i as f64));
    let mut cropped = Image::new(size, samples.collect(), geometry);
    cropped.labels = (image.labels.as_ref()).map(|labels| crop_labels(labels, rows().flatten()));
    cropped.label_names.clone_from(&image.label_names);
    if image.dead.is_empty() {
        let missing = rows().filter_map(|row| image.missing.get(row.start / dims[0]).copied());
        return cropped.with_missing(missing.collect());
    }
    cropped.with_dead(
        rows()
            .flat_map(|row| image.dead[row].iter().copied())
            .collect(),
    )
}

/// Returns the exact labels of samples, given by their offsets.
fn crop_labels(labels: &ExactLabels, offsets: impl Iterator<Item = usize>) -> Arc<ExactLabels> {
    ExactLabels::from_integers(offsets.map(|i| labels.values[labels.indices[i] as usize]))
}

fn crop_loaded<const D: usize>(
    loaded: LoadedImage<D>,
    block: &[Range<usize>; D],
) -> LoadedImage<D> {
    let mut header = loaded.header();
    crop_header(&mut header, block);
    LoadedImage {
        image: crop_image(&loaded.image, block),
        notes: header.notes,
        line_numbers: header.line_numbers,
        ..loaded
    }
}

/// Returns the image with an axis of a single sample last, so that it is a section of two axes. The
/// order of the samples in memory stays.
fn with_thin_axis_last(mut loaded: LoadedImage) -> LoadedImage {
    let dims = loaded.image.dims();
    let Some(thin) = (0..2).find(|&k| dims[k] == 1 && dims[2] > 1) else {
        return loaded;
    };
    let order: [usize; 3] = if thin == 0 { [1, 2, 0] } else { [0, 2, 1] };
    let image = &loaded.image;
    let geometry = Geometry {
        origin: image.geometry.origin,
        axes: order.map(|k| image.geometry.axes[k]),
        names: order.map(|k| image.geometry.names[k].clone()),
        units: image.geometry.units.clone(),
    };
    let mut section = Image::new(order.map(|k| dims[k]), image.as_slice().to_vec(), geometry);
    section.labels.clone_from(&image.labels);
    section.label_names.clone_from(&image.label_names);
    loaded.image = if image.dead.is_empty() && image.missing.is_empty() {
        section
    } else {
        let is_dead = |i: usize| {
            let is_set = |flags: &[bool], i: usize| flags.get(i).copied().unwrap_or(false);
            is_set(&image.dead, i) || is_set(&image.missing, i / dims[0])
        };
        section.with_dead((0..image.as_slice().len()).map(is_dead).collect())
    };
    loaded
}

/// Returns the block of an image whose samples stay in its file.
fn crop_stream(mut stream: ImageStream, block: &[Range<usize>; 3]) -> ImageStream {
    let dims = stream.header.dims;
    crop_header(&mut stream.header, block);
    ImageStream {
        reader: Box::new(CroppedReader {
            reader: stream.reader,
            dims,
            block: block.clone(),
        }),
        ..stream
    }
}

/// Reader of a block of an image.
struct CroppedReader {
    reader: Box<dyn PlaneReader>,
    /// Number of samples of the whole image along each axis.
    dims: [usize; 3],
    block: [Range<usize>; 3],
}

impl PlaneReader for CroppedReader {
    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        let [x, y, z] = &self.block;
        let (first, rows) = (first + z.start, rows.start + y.start..rows.end + y.start);
        if x.len() == self.dims[0] {
            return self.reader.read_rows(first, rows, out);
        }
        let plane_len = (rows.len() * self.dims[0]).max(1);
        let part_len = (rows.len() * x.len()).max(1);
        let planes = (MAX_SAMPLES_PER_READ / plane_len).max(1);
        let mut buffer = Vec::new();
        for (part, out) in out.chunks_mut(planes * part_len).enumerate() {
            buffer.resize(out.len() / part_len * plane_len, 0.0);
            (self.reader).read_rows(first + part * planes, rows.clone(), &mut buffer)?;
            let rows = buffer.chunks_exact(self.dims[0]);
            for (part, row) in out.chunks_exact_mut(x.len()).zip(rows) {
                part.copy_from_slice(&row[x.clone()]);
            }
        }
        Ok(())
    }

    fn batch_planes(&self) -> usize {
        self.reader.batch_planes()
    }

    fn read_exact_labels(&self, _dims: [usize; 3]) -> Result<Option<Arc<ExactLabels>>> {
        let labels = self.reader.read_exact_labels(self.dims)?;
        let first = self.block.each_ref().map(|range| range.start);
        let size = self.block.each_ref().map(Range::len);
        Ok(labels.map(|labels| {
            let offsets = (0..size.iter().product()).map(|i| {
                let index = index_at(size, i);
                offset_of(self.dims, std::array::from_fn(|k| first[k] + index[k]))
            });
            crop_labels(&labels, offsets)
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::uniform;

    /// Returns an image of random samples, with its axes turned by an angle in degrees.
    fn image(dims: [usize; 3], degrees: f64) -> Image<3> {
        let (sin, cos) = f64::to_radians(degrees).sin_cos();
        let mut geometry = Geometry {
            origin: [1000.0, 2000.0, -500.0],
            axes: [
                [0.0, 0.0, -4.0],
                [25.0 * cos, 25.0 * sin, 0.0],
                [-12.5 * sin, 12.5 * cos, 0.0],
            ],
            ..Geometry::default()
        };
        geometry.names = ["sample", "crossline", "inline"].map(String::from);
        geometry.units = ["m", "m", "ms"].map(String::from);
        let samples = (0..dims.iter().product()).map(|i| uniform(3, i as u64) as f32);
        Image::new(dims, samples.collect(), geometry)
    }

    fn survey(image: Image<3>) -> LoadedImage {
        let [_, crosslines, inlines] = image.dims();
        let lines = |first, step, count: usize| LineNumbers {
            first,
            step,
            count: count as u64,
        };
        LoadedImage {
            line_numbers: Some([lines(100, 2, inlines), lines(300, 1, crosslines)]),
            ..LoadedImage::from(image)
        }
    }

    fn cropped(loaded: &LoadedImage, ranges: &str) -> Result<AnyImage> {
        let crop: Crop = ranges.parse()?;
        let opened = OpenedImage::InMemory(AnyImage::Space(loaded.clone()));
        crop.apply(opened)?.load(Path::new("image"))
    }

    #[test]
    fn blocks_have_the_samples_and_positions_of_the_image() {
        let whole = survey(image([12, 9, 8], 0.0));
        for (ranges, first, dims) in [
            ("inline=104:110,crossline=302:307", [0, 2, 2], [12, 6, 4]),
            ("inline=103:111", [0, 0, 2], [12, 9, 4]),
            ("time=508:524", [2, 0, 0], [5, 9, 8]),
            ("z=-524:-508", [2, 0, 0], [5, 9, 8]),
            ("z=-508:-524", [2, 0, 0], [5, 9, 8]),
            ("x=1050:1130,y=2025:", [0, 2, 2], [12, 4, 6]),
            ("i=2:6,k=:3", [2, 0, 0], [5, 9, 4]),
            ("x=0:1050", [0, 0, 0], [12, 3, 8]),
        ] {
            let AnyImage::Space(part) = cropped(&whole, ranges).unwrap() else {
                panic!("{ranges} is no volume")
            };
            assert_eq!(part.image.dims(), dims, "{ranges}");
            for offset in 0..part.image.as_slice().len() {
                let index = index_at(dims, offset);
                let original = std::array::from_fn(|k| first[k] + index[k]);
                assert_eq!(
                    part.image.as_slice()[offset],
                    whole.image.as_slice()[offset_of([12, 9, 8], original)]
                );
                assert_eq!(
                    part.image.geometry.to_physical(index.map(|i| i as f64)),
                    whole.image.geometry.to_physical(original.map(|i| i as f64))
                );
            }
            let [inlines, crosslines] = part.line_numbers.unwrap();
            assert_eq!(inlines.first, 100 + 2 * first[2] as i64);
            assert_eq!(crosslines.count, dims[1] as u64);
        }
    }

    #[test]
    fn turned_surveys_are_cropped_to_the_lines_that_cover_the_box() {
        let whole = survey(image([3, 30, 40], 33.0));
        let AnyImage::Space(part) = cropped(&whole, "x=1050:1200,y=2300:2500").unwrap() else {
            panic!("no volume")
        };
        let is_inside = |image: &Image<3>, i: usize| {
            let index = index_at(image.dims(), i).map(|i| i as f64);
            let [x, y, _] = image.geometry.to_physical(index);
            (1050.0..=1200.0).contains(&x) && (2300.0..=2500.0).contains(&y)
        };
        let count = |image: &Image<3>| {
            (0..image.as_slice().len())
                .filter(|&i| is_inside(image, i))
                .count()
        };
        assert_eq!(count(&part.image), count(&whole.image));
        assert!(count(&part.image) > 100);
        // No line at the rim misses the box.
        let [_, ny, nz] = part.image.dims();
        let [crosslines, inlines] = [25.0, 12.5].map(|step| {
            let [a, b] = [150.0, 200.0];
            let (sin, cos) = f64::to_radians(33.0).sin_cos();
            if step == 25.0 {
                (a * cos + b * sin) / step
            } else {
                (a * sin + b * cos) / step
            }
        });
        assert!((ny as f64 - crosslines).abs() <= 1.0, "{ny} {crosslines}");
        assert!((nz as f64 - inlines).abs() <= 1.0, "{nz} {inlines}");
    }

    #[test]
    fn a_single_line_is_a_section() {
        let whole = survey(image([12, 9, 8], 0.0));
        let AnyImage::Plane(section) = cropped(&whole, "crossline=303").unwrap() else {
            panic!("no section")
        };
        assert_eq!(section.image.dims(), [12, 8]);
        let expected = (0..96).map(|i| whole.image.as_slice()[i / 12 * 108 + 36 + i % 12]);
        assert!(section.image.as_slice().iter().copied().eq(expected));
    }

    #[test]
    fn impossible_ranges_are_refused_with_what_there_is() {
        let whole = survey(image([12, 9, 8], 0.0));
        let bare = LoadedImage::from(image([12, 9, 8], 0.0));
        for (loaded, ranges, expected) in [
            (
                &whole,
                "inline=10:20",
                "holds no sample of the image, which has 100",
            ),
            (&whole, "x=0:10", "x from 1000 to 1200"),
            (&whole, "i=12:", "indices 0 to 11"),
            (&whole, "depth=100:200", "is in time (ms)"),
            (&whole, "inline=100:,inline=:200", "gives inline twice"),
            (&whole, "w=1:2", "names no axis"),
            (&whole, "x=a:2", "not a number"),
            (&whole, "x=:", "has no end"),
            (&bare, "inline=100:110", "has no inline numbers"),
        ] {
            let message = cropped(loaded, ranges).unwrap_err().to_string();
            assert!(message.contains(expected), "{ranges}: {message}");
        }
    }
}

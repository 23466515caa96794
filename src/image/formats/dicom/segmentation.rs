//! Segmentations (SEG): frames of bits, one segment each, or label maps.
//!
//! Frames are sorted by their positions. Slices without a frame hold no segment. Segments that overlap
//! are in layers, as those of 3D Slicer are. Source: DICOM PS3.3, C.8.20.

use dicom_dictionary_std::tags;

use super::super::packed::DAMAGED_REMEDY;
use super::super::samples;
use super::super::segments::{Segment, describe_layers, label_names, note_on_names};
use super::super::{ImageFormat, LoadedImage};
use super::compressed::Codec;
use super::dataset::{DicomFile, integer, items, text};
use super::frames::{Frame, frames};
use super::pixels::SampleFormat;
use super::series::{are_parallel, series_name};
use super::stack::Place;
use crate::error::{Error, Result, cause};
use crate::geometry::{dot, norm, sub};
use crate::image::{Geometry, Image, LabelValue};

/// Largest distance of a frame from the planes of the grid, as a share of their spacing.
const MAX_OFFSET: f64 = 0.05;

/// Largest number of slices for each frame: more would be a grid of empty slices.
const MAX_SLICES_PER_FRAME: usize = 4096;

/// Remedy that names other programs that read segmentations.
const CONVERT_REMEDY: &str =
    "convert it to .nrrd with segimage2itkimage of dcmqi, or in Python with highdicom";

/// The regular planes on which frames lie.
struct Grid {
    geometry: Geometry<3>,
    /// Number of planes.
    count: usize,
    /// The plane of each frame.
    planes: Vec<usize>,
}

/// Reads a segmentation. Of segments in several layers, that with the number `layer` is read.
///
/// # Errors
/// Returns an [`Error::Io`] if the file is damaged, if its frames lie on no regular planes, or if its
/// segments overlap and no layer is given.
pub(super) fn read(file: &DicomFile, layer: Option<usize>) -> Result<LoadedImage> {
    let kind = text(&file.data, tags::SEGMENTATION_TYPE).unwrap_or_default();
    if !matches!(kind.as_str(), "BINARY" | "LABELMAP") {
        let problem = format!("is a segmentation of type {kind}, which is not read");
        return Err(file.error(problem, "give one of type BINARY or LABELMAP"));
    }
    let organisation = text(&file.data, tags::DIMENSION_ORGANIZATION_TYPE).unwrap_or_default();
    if organisation.starts_with("TILED") {
        return Err(file.error(
            "is a segmentation in tiles, which is not read",
            CONVERT_REMEDY,
        ));
    }
    let format = SampleFormat::from_file(file, true)?;
    let frames = frames(file, 0)?;
    let grid = grid(file, &frames)?;
    let dims = [format.columns, format.rows, grid.count];
    let count = dims.iter().fold(1usize, |n, &d| n.saturating_mul(d));
    samples::check_memory(&file.path, count)?;
    let mut segments = segments(file);
    let mut layers = match kind.as_str() {
        "BINARY" => binary_layers(file, &format, &frames, &grid, &mut segments)?,
        _ => vec![label_map(file, &format, &frames, &grid)?],
    };
    let mut notes = vec![format!(
        "{}: {} segments",
        series_name(file),
        segments.len()
    )];
    let problem = match layer {
        None if layers.len() == 1 => None,
        Some(layer) if layer < layers.len() => None,
        None => Some(format!(
            "has segments that overlap, in {} layers",
            layers.len()
        )),
        Some(layer) => Some(format!("has no layer {layer}")),
    };
    if let Some(problem) = problem {
        let listed = describe_layers(&segments, layers.len());
        let error = cause(
            file.path.display(),
            problem,
            format!("give one of the layers {listed}"),
        );
        return Err(Error::Io(error.with_parameter("layer")));
    }
    let layer = layer.unwrap_or(0);
    if layers.len() > 1 {
        notes.push(format!(
            "layer {layer} of {} is read: {}",
            layers.len(),
            describe_layers(&segments, layers.len())
        ));
    }
    let mut with_frame = grid.planes.clone();
    with_frame.sort_unstable();
    with_frame.dedup();
    if with_frame.len() < grid.count {
        notes.push(format!(
            "{} slices without a frame hold no segment",
            grid.count - with_frame.len()
        ));
    }
    notes.push("the image covers the slices that have frames, not the whole scan".into());
    let mut image = Image::new(dims, layers.swap_remove(layer), grid.geometry);
    image.label_names = label_names(&segments, layer);
    notes.extend(note_on_names(&image.label_names));
    Ok(LoadedImage {
        image,
        format: ImageFormat::Dicom,
        encoding: format!("segmentation, {}", format.describe(Codec::from_file(file)?)),
        notes,
        survey: None,
        line_numbers: None,
    })
}

/// Returns the segments of a file, all in the first layer.
fn segments(file: &DicomFile) -> Vec<Segment> {
    let segment = |item| {
        let number = integer(item, tags::SEGMENT_NUMBER)?;
        let name = text(item, tags::SEGMENT_LABEL);
        Some(Segment {
            name: name.unwrap_or_else(|| format!("segment {number}")),
            label: LabelValue::Whole(number.into()),
            layer: 0,
        })
    };
    // Label maps may name their background.
    let mut segments: Vec<Segment> = (items(&file.data, tags::SEGMENT_SEQUENCE).iter())
        .filter_map(segment)
        .collect();
    segments.retain(|segment| segment.label != LabelValue::Whole(0));
    segments
}

/// Returns the grid of planes on which frames lie.
fn grid(file: &DicomFile, frames: &[Frame]) -> Result<Grid> {
    let places: Option<Vec<Place>> = frames.iter().map(|frame| frame.place).collect();
    let Some(places) = places.filter(|places| !places.is_empty() && are_parallel(frames)) else {
        let problem = "has frames without a position, or of several orientations";
        return Err(file.error(problem, CONVERT_REMEDY));
    };
    let normal = places[0].normal();
    let height = |place: &Place| dot(place.position, normal);
    let mut heights: Vec<f64> = places.iter().map(height).collect();
    let by_height = |a: &&Place, b: &&Place| height(a).total_cmp(&height(b));
    let lowest = *places.iter().min_by(by_height).unwrap_or(&places[0]);
    let highest = *places.iter().max_by(by_height).unwrap_or(&places[0]);
    let first = height(&lowest);
    heights.iter_mut().for_each(|h| *h -= first);
    let spacing = frames[0].thickness;
    let gap = smallest_gap(&heights);
    let fits = |spacing: f64| {
        heights
            .iter()
            .all(|h| (h / spacing - (h / spacing).round()).abs() <= MAX_OFFSET)
    };
    let spacing = match gap {
        Some(gap) if !(spacing <= gap * (1.0 + MAX_OFFSET) && fits(spacing)) => gap,
        _ => spacing,
    };
    let planes: Vec<usize> = heights
        .iter()
        .map(|h| (h / spacing).round() as usize)
        .collect();
    let last = planes.iter().copied().max().unwrap_or(0);
    let step = match last {
        0 => normal.map(|x| x * spacing),
        last => sub(highest.position, lowest.position).map(|x| x / last as f64),
    };
    let sample = lowest.spacing[0].min(lowest.spacing[1]);
    let is_on_grid = |(place, &plane): (&Place, &usize)| {
        let even: [f64; 3] = std::array::from_fn(|c| lowest.position[c] + plane as f64 * step[c]);
        norm(sub(place.position, even)) <= MAX_OFFSET * spacing.max(sample)
    };
    if !fits(spacing)
        || !places.iter().zip(&planes).all(is_on_grid)
        || last >= MAX_SLICES_PER_FRAME.saturating_mul(frames.len())
    {
        let problem = "has frames that are not on evenly spaced planes";
        return Err(file.error(problem, CONVERT_REMEDY));
    }
    let [dx, dy] = lowest.spacing;
    Ok(Grid {
        geometry: Geometry {
            origin: lowest.position,
            axes: [
                lowest.row.map(|x| x * dx),
                lowest.column.map(|x| x * dy),
                step,
            ],
            units: ["mm"; 3].map(String::from),
            ..Geometry::default()
        },
        count: last + 1,
        planes,
    })
}

/// Returns the smallest distance between different heights; `None` if all are equal.
fn smallest_gap(heights: &[f64]) -> Option<f64> {
    /// Heights closer than this, in millimetres, are of one plane.
    const SAME_PLANE: f64 = 1e-3;
    let mut sorted = heights.to_vec();
    sorted.sort_by(f64::total_cmp);
    let gaps = sorted.windows(2).map(|pair| pair[1] - pair[0]);
    let gaps = gaps.filter(|gap| *gap > SAME_PLANE);
    gaps.min_by(f64::total_cmp)
}

/// Returns the number of the segment of a frame.
fn segment_number(file: &DicomFile, frame: &Frame) -> Result<i64> {
    let group = file
        .frame(frame.number)
        .group(tags::SEGMENT_IDENTIFICATION_SEQUENCE);
    let number = group.and_then(|group| integer(group, tags::REFERENCED_SEGMENT_NUMBER));
    number.ok_or_else(|| {
        let problem = format!("does not say of which segment frame {} is", frame.number);
        file.error(problem, DAMAGED_REMEDY)
    })
}

/// Returns the label images of the fewest layers, filled in the order of segments, in which no segments
/// overlap. Samples are the numbers of segments.
fn binary_layers(
    file: &DicomFile,
    format: &SampleFormat,
    frames: &[Frame],
    grid: &Grid,
    segments: &mut Vec<Segment>,
) -> Result<Vec<Vec<f32>>> {
    let plane_len = format.count();
    let numbers: Vec<i64> = (frames.iter())
        .map(|frame| segment_number(file, frame))
        .collect::<Result<_>>()?;
    let mut distinct = numbers.clone();
    distinct.sort_unstable();
    distinct.dedup();
    let mut layers: Vec<Vec<f32>> = vec![samples::allocate(&file.path, plane_len * grid.count)?];
    let mut flags = vec![0.0; plane_len];
    for number in distinct {
        // The samples of the segment, as offsets.
        let mut offsets: Vec<usize> = Vec::new();
        for (k, frame) in frames
            .iter()
            .enumerate()
            .filter(|(k, _)| numbers[*k] == number)
        {
            format.read_frame(file, frame.number, [1.0, 0.0], &mut flags)?;
            let start = grid.planes[k] * plane_len;
            let set = flags.iter().enumerate().filter(|(_, flag)| **flag != 0.0);
            offsets.extend(set.map(|(i, _)| start + i));
        }
        let is_free = |layer: &Vec<f32>| offsets.iter().all(|&i| layer[i] == 0.0);
        let place = match layers.iter().position(is_free) {
            Some(place) => place,
            None => {
                layers.push(samples::allocate(&file.path, plane_len * grid.count)?);
                layers.len() - 1
            }
        };
        for &i in &offsets {
            layers[place][i] = number as f32;
        }
        let label = LabelValue::Whole(number.into());
        match segments.iter_mut().find(|segment| segment.label == label) {
            Some(segment) => segment.layer = place,
            None => segments.push(Segment {
                name: format!("segment {number}"),
                label,
                layer: place,
            }),
        }
    }
    Ok(layers)
}

/// Returns the samples of a label map.
fn label_map(
    file: &DicomFile,
    format: &SampleFormat,
    frames: &[Frame],
    grid: &Grid,
) -> Result<Vec<f32>> {
    let plane_len = format.count();
    let mut labels = samples::allocate(&file.path, plane_len * grid.count)?;
    let mut known = vec![false; grid.count];
    for (frame, &plane) in frames.iter().zip(&grid.planes) {
        if std::mem::replace(&mut known[plane], true) {
            let problem = format!("has two frames at the position of frame {}", frame.number);
            return Err(file.error(problem, CONVERT_REMEDY));
        }
        let out = &mut labels[plane * plane_len..(plane + 1) * plane_len];
        format.read_frame(file, frame.number, [1.0, 0.0], out)?;
    }
    Ok(labels)
}

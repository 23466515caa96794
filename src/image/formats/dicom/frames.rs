//! Frames of files: their positions, and the scale of their values.

use dicom_dictionary_std::tags;

use super::dataset::{DicomFile, FrameScope, array, integer, numbers, text};
use super::stack::Place;
use crate::error::Result;
use crate::geometry::{dot, norm, unit};

/// Largest deviation of the directions of rows and columns from perpendicular unit vectors.
const MAX_SKEW: f64 = 1e-2;

/// A frame of a file.
#[derive(Debug, Clone)]
pub(super) struct Frame {
    /// The number of its file.
    pub file: usize,
    /// Its number within the file.
    pub number: usize,
    /// Its position, if the file gives one.
    pub place: Option<Place>,
    /// Slope and intercept of its values.
    pub scale: [f64; 2],
    /// Distance to the next frame as the file gives it.
    pub thickness: f64,
}

/// Returns the frames of a file, which has the number `index`.
///
/// # Errors
/// Returns an [`Error::Io`](crate::Error::Io) if a position or a scale is invalid.
pub(super) fn frames(file: &DicomFile, index: usize) -> Result<Vec<Frame>> {
    let count = file.frame_count();
    let offsets = dose_offsets(file, count)?;
    let per_frame =
        super::dataset::items(&file.data, tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE).len();
    if count == 0 || (per_frame > 0 && per_frame != count) {
        let problem = format!("has {count} frames and the positions of {per_frame}");
        return Err(file.error(problem, super::super::packed::DAMAGED_REMEDY));
    }
    let frame = |number: usize| {
        let scope = file.frame(number);
        let mut place = place(file, scope)?;
        match (&offsets, &mut place) {
            (Some(offsets), Some(place)) => {
                let normal = place.normal();
                for c in 0..3 {
                    place.position[c] += offsets[number] * normal[c];
                }
            }
            // Without positions of its own, a frame has only that of the first one.
            (None, _) if count > 1 && per_frame == 0 => place = None,
            _ => {}
        }
        Ok(Frame {
            file: index,
            number,
            place,
            scale: scale(file, scope)?,
            thickness: thickness(scope),
        })
    };
    (0..count).map(frame).collect()
}

/// Returns the distance between samples within a row, and between rows, if the file gives it.
pub(super) fn pixel_spacing(scope: FrameScope<'_>) -> Option<[f64; 2]> {
    let sizes = [
        tags::PIXEL_SPACING,
        tags::IMAGER_PIXEL_SPACING,
        tags::NOMINAL_SCANNED_PIXEL_SPACING,
    ];
    let sizes = sizes
        .into_iter()
        .filter_map(|tag| array(scope.numbers(tags::PIXEL_MEASURES_SEQUENCE, tag)));
    // The first number is the distance between rows.
    let [rows, columns] = sizes
        .into_iter()
        .find(|size: &[f64; 2]| size.iter().all(|x| *x > 0.0))?;
    Some([columns, rows])
}

/// Returns the distance between frames that the file gives, 1 if none.
fn thickness(scope: FrameScope<'_>) -> f64 {
    let sizes = [tags::SPACING_BETWEEN_SLICES, tags::SLICE_THICKNESS];
    let mut sizes = (sizes.into_iter())
        .filter_map(|tag| scope.number(tags::PIXEL_MEASURES_SEQUENCE, tag))
        .map(f64::abs);
    sizes.find(|size| *size > 0.0).unwrap_or(1.0)
}

/// Returns the position of a frame, if the file gives it.
fn place(file: &DicomFile, scope: FrameScope<'_>) -> Result<Option<Place>> {
    let position = scope.numbers(tags::PLANE_POSITION_SEQUENCE, tags::IMAGE_POSITION_PATIENT);
    let directions = scope.numbers(
        tags::PLANE_ORIENTATION_SEQUENCE,
        tags::IMAGE_ORIENTATION_PATIENT,
    );
    let (Some(position), Some(directions)) = (array(position), array::<6>(directions)) else {
        return Ok(None);
    };
    let [a, b, c, d, e, f] = directions;
    let (row, column) = ([a, b, c], [d, e, f]);
    let is_unit = |v: [f64; 3]| (norm(v) - 1.0).abs() <= MAX_SKEW;
    if !is_unit(row) || !is_unit(column) || dot(row, column).abs() > MAX_SKEW {
        let problem = format!(
            "has the directions {row:?} and {column:?}, which are not perpendicular unit vectors"
        );
        return Err(file.error(problem, super::super::packed::DAMAGED_REMEDY));
    }
    let Some(spacing) = pixel_spacing(scope) else {
        let problem = "has a position, but no distance between samples (PixelSpacing)";
        let remedy = "write this attribute, e.g. in Python with pydicom";
        return Err(file.error(problem, remedy));
    };
    Ok(Some(Place {
        position,
        row: unit(row),
        column: unit(column),
        spacing,
    }))
}

/// Returns slope and intercept of a frame.
fn scale(file: &DicomFile, scope: FrameScope<'_>) -> Result<[f64; 2]> {
    let number = |tag| scope.number(tags::PIXEL_VALUE_TRANSFORMATION_SEQUENCE, tag);
    if let Some(scaling) = numbers(&file.data, tags::DOSE_GRID_SCALING) {
        return Ok([scaling[0], 0.0]);
    }
    let slope = number(tags::RESCALE_SLOPE).unwrap_or(1.0);
    if slope == 0.0 {
        let remedy = "write the slope of its values, e.g. in Python with pydicom";
        return Err(file.error(
            "has a rescale slope of 0, so that all values are equal",
            remedy,
        ));
    }
    Ok([slope, number(tags::RESCALE_INTERCEPT).unwrap_or(0.0)])
}

/// Returns the distances of the planes of a grid of doses from its first plane.
fn dose_offsets(file: &DicomFile, count: usize) -> Result<Option<Vec<f64>>> {
    let Some(mut offsets) = numbers(&file.data, tags::GRID_FRAME_OFFSET_VECTOR) else {
        return Ok(None);
    };
    if offsets.len() != count {
        let problem = format!("has {count} planes and the positions of {}", offsets.len());
        return Err(file.error(problem, super::super::packed::DAMAGED_REMEDY));
    }
    // The numbers are distances from the first plane if this has 0, and else coordinates.
    let first = offsets[0];
    offsets.iter_mut().for_each(|x| *x -= first);
    Ok(Some(offsets))
}

/// Returns `true` if the frames of a file follow one another in time.
pub(super) fn frames_are_times(file: &DicomFile) -> bool {
    let has = |tag| text(&file.data, tag).is_some();
    has(tags::FRAME_TIME)
        || has(tags::FRAME_TIME_VECTOR)
        || integer(&file.data, tags::CINE_RATE).is_some()
}

//! DICOM: scans in series of files or in files of several frames, and segmentations.
//!
//! A folder holds one series, or a file names the series of which the files beside it are. Planes are
//! sorted by their positions along their common normal. Positions are the patient's: x to the left, y to
//! the back and z up (LPS), in millimetres, as for every other format of scans. Values are those of the
//! modality: rescaled, or looked up in the file's table. Names of patients are never read.
//!
//! - `dataset`: values of elements, and those of each frame
//! - `compressed`: samples of a frame as they are stored: native, RLE, JPEG, JPEG 2000
//! - `lengths`: lengths of elements against that of the file
//! - `pixels`: bits, padding and values of samples
//! - `frames`: positions and scales of the frames of a file
//! - `stack`: the geometry of planes with positions
//! - `series`: the files that are one volume
//! - `segmentation`: segments as labels

mod compressed;
mod dataset;
mod frames;
mod lengths;
mod pixels;
mod segmentation;
mod series;
mod stack;

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dicom_dictionary_std::tags;

use super::packed::{DAMAGED_REMEDY, file_error};
use super::placement::NO_GEOMETRY_NOTE;
use super::stream::{ImageHeader, ImageStream, OpenedImage, PlaneReader};
use super::{ImageFormat, into_any_image};
use crate::error::{Error, Result, cause};
use crate::image::Geometry;
use crate::parallel::prelude::*;
use compressed::Codec;
use dataset::{DicomFile, text};
use frames::{Frame, frames_are_times, pixel_spacing};
use pixels::SampleFormat;
use series::{Series, are_parallel, series_at, series_name, stack_error};

/// Length of the preamble of a DICOM file.
const PREAMBLE_BYTES: usize = 128;

/// Number of bytes at the start of a file by which it is recognised.
const HEAD_BYTES: u64 = PREAMBLE_BYTES as u64 + 4;

/// Classes of segmentations: of bits, and of labels.
const SEGMENTATION_CLASSES: [&str; 2] = [
    "1.2.840.10008.5.1.4.1.1.66.4",
    "1.2.840.10008.5.1.4.1.1.66.7",
];

/// Returns `true` if these are the first bytes of a DICOM file.
pub fn is_dicom(head: &[u8]) -> bool {
    head.get(PREAMBLE_BYTES..)
        .is_some_and(|rest| rest.starts_with(b"DICM"))
}

/// Returns `true` for a folder that has a DICOM file.
pub fn is_folder_of_series(folder: &Path) -> bool {
    series::files_of(folder).is_ok_and(|files| !files.is_empty())
}

/// Returns `true` if a file is a segmentation.
fn is_segmentation(file: &DicomFile) -> bool {
    let class = text(&file.data, tags::SOP_CLASS_UID).unwrap_or_default();
    SEGMENTATION_CLASSES.contains(&class.as_str())
}

/// Opens a scan or a segmentation: a file, the series of a file, or the only series in a folder. Of a
/// segmentation whose segments overlap, the layer with the number `layer` is read.
///
/// # Errors
/// Returns an [`Error::Io`] if a file is damaged or of a kind that is not read, or if the images are not
/// one evenly spaced volume.
pub fn open(path: &Path, layer: Option<usize>) -> Result<OpenedImage> {
    let segmentation = if path.is_dir() {
        series::only_segmentation(&series::files_of(path)?).cloned()
    } else {
        is_segmentation(&DicomFile::read(path, false)?).then(|| path.to_path_buf())
    };
    if let Some(path) = segmentation {
        let read = segmentation::read(&DicomFile::read(&path, true)?, layer)?;
        return Ok(OpenedImage::InMemory(into_any_image(read)));
    }
    if let Some(layer) = layer {
        let problem = "has no layers: it is no segmentation";
        let error = cause(path.display(), problem, format!("omit the layer {layer}"));
        return Err(Error::Io(error.with_parameter("layer")));
    }
    let Series { files, notes } = series_at(path)?;
    open_series(path, files, notes).map(OpenedImage::Stream)
}

/// Returns the error for a file of another kind than images.
fn refuse_others(file: &DicomFile) -> Result<()> {
    let modality = text(&file.data, tags::MODALITY).unwrap_or_default();
    let class = text(&file.data, tags::SOP_CLASS_UID).unwrap_or_default();
    let (kind, remedy) = match modality.as_str() {
        "RTSTRUCT" => (
            "contours (RTSTRUCT)",
            "convert it to .nii.gz, with dcmrtstruct2nii or 3D Slicer",
        ),
        _ if class == "1.2.840.10008.1.3.10" || text(&file.data, tags::FILE_SET_ID).is_some() => (
            "an index of files (DICOMDIR)",
            "give a file of the scan, or the folder of its files",
        ),
        _ if is_segmentation(file) => (
            "a segmentation among other files",
            "give the file of the segmentation",
        ),
        _ => return Ok(()),
    };
    Err(file.error(format!("is {kind}, not a scan"), remedy))
}

/// Opens files that are one volume.
fn open_series(path: &Path, files: Vec<DicomFile>, mut notes: Vec<String>) -> Result<ImageStream> {
    files.iter().try_for_each(refuse_others)?;
    let formats: Vec<SampleFormat> = (files.iter())
        .map(|file| SampleFormat::from_file(file, false))
        .collect::<Result<_>>()?;
    let codecs: Vec<Codec> = files.iter().map(Codec::from_file).collect::<Result<_>>()?;
    let mut planes: Vec<Frame> = Vec::new();
    for (index, file) in files.iter().enumerate() {
        planes.extend(frames::frames(file, index)?);
    }
    let (Some(first), Some(format), Some(codec)) = (files.first(), formats.first(), codecs.first())
    else {
        return Err(file_error(path, "holds no image", DAMAGED_REMEDY));
    };
    let (columns, rows) = (format.columns, format.rows);
    let (geometry, order, stack_notes) = geometry(path, &planes, &files)?;
    let planes: Vec<Frame> = order.into_iter().map(|k| planes[k].clone()).collect();
    let description = series_name(first);
    notes.insert(
        0,
        format!(
            "{description}: {} slices of {columns} x {rows}",
            planes.len()
        ),
    );
    notes.extend(stack_notes);
    notes.extend(scale_note(&planes));
    notes.extend(format.notes());
    if text(&first.data, tags::PHOTOMETRIC_INTERPRETATION).is_some_and(|c| c == "MONOCHROME1") {
        notes.push("low values are shown bright (MONOCHROME1): values are not inverted".into());
    }
    let header = ImageHeader {
        dims: [columns, rows, planes.len()],
        geometry,
        missing: Vec::new(),
        label_names: Vec::new(),
        format: ImageFormat::Dicom,
        encoding: format.describe(*codec),
        notes,
        survey: None,
        line_numbers: None,
    };
    let encoding = format.encoding();
    let sources = sources(files)?;
    Ok(ImageStream {
        header,
        encoding,
        reader: Box::new(FramePlanes {
            sources,
            formats,
            planes,
        }),
        max_magnitude_bits: Default::default(),
    })
}

/// Returns the geometry of planes, their order, and notes.
fn geometry(
    path: &Path,
    planes: &[Frame],
    files: &[DicomFile],
) -> Result<(Geometry<3>, Vec<usize>, Vec<String>)> {
    let places: Option<Vec<stack::Place>> = planes.iter().map(|plane| plane.place).collect();
    if let Some(places) = places {
        if !are_parallel(planes) {
            let problem = "has frames of several orientations";
            let remedy = "convert it to .nii.gz with dcm2niix, which writes a file for each";
            return Err(file_error(path, problem, remedy));
        }
        let stacked = stack::stack(&places, planes.first().map_or(1.0, |plane| plane.thickness));
        let stacked = stacked.map_err(|problem| stack_error(path, &problem, planes, files))?;
        let mut notes = vec![
            "x points to the patient's left, y to the back, z up (LPS, as in ITK)".to_string(),
        ];
        notes.extend(stacked.notes);
        return Ok((stacked.geometry, stacked.order, notes));
    }
    let [file] = files else {
        let problem = "has images without positions, so that their order is unknown";
        let remedy = "give one of its files alone in a folder, or save the slices as .tif and give --spacing";
        return Err(file_error(path, problem, remedy));
    };
    if planes.len() > 1 && frames_are_times(file) {
        let problem = "has frames that follow one another in time";
        return Err(file_error(
            path,
            problem,
            "give a scan in space, or one frame",
        ));
    }
    let spacing = pixel_spacing(file.frame(0));
    let [x, y] = spacing.unwrap_or([1.0; 2]);
    let z = planes.first().map_or(1.0, |plane| plane.thickness);
    let units = if spacing.is_some() { "mm" } else { "" };
    let note = match spacing {
        Some(_) if planes.len() > 1 => format!(
            "its frames have no positions: they are stacked {z} mm apart, the first sample at 0; otherwise give --spacing"
        ),
        Some(_) => "the file does not say where the image lies: its first sample is at 0".into(),
        None => format!("this DICOM file {NO_GEOMETRY_NOTE}"),
    };
    let geometry = Geometry {
        units: [units; 3].map(String::from),
        ..Geometry::with_spacing([0.0; 3], [x, y, if spacing.is_some() { z } else { 1.0 }])
    };
    Ok((geometry, (0..planes.len()).collect(), vec![note]))
}

/// Returns a note about the scale of values.
fn scale_note(planes: &[Frame]) -> Option<String> {
    let first = planes.first()?.scale;
    if planes.iter().any(|plane| plane.scale != first) {
        return Some(
            "values are scaled as the header says, by a slope and an intercept of each slice"
                .into(),
        );
    }
    let [slope, intercept] = first;
    (first != [1.0, 0.0]).then(|| {
        format!(
            "values are scaled as the header says: {slope} times the stored value + {intercept}"
        )
    })
}

/// Where the samples of a file are.
enum SampleSource {
    /// In the file, which is read for each of its frames.
    Path(PathBuf),
    /// In memory, since the file has several frames.
    Loaded(Arc<DicomFile>),
}

/// Returns where the samples of files are.
fn sources(files: Vec<DicomFile>) -> Result<Vec<SampleSource>> {
    let source = |file: DicomFile| {
        if file.frame_count() == 1 {
            return Ok(SampleSource::Path(file.path));
        }
        DicomFile::read(&file.path, true).map(|file| SampleSource::Loaded(Arc::new(file)))
    };
    files.into_iter().map(source).collect()
}

/// Reader of planes, each of which is a frame.
struct FramePlanes {
    sources: Vec<SampleSource>,
    /// The format of the samples of each file.
    formats: Vec<SampleFormat>,
    planes: Vec<Frame>,
}

impl FramePlanes {
    /// Fills `out` with all samples of a plane.
    fn read_plane(&self, plane: usize, out: &mut [f32]) -> Result<()> {
        let Frame {
            file,
            number,
            scale,
            ..
        } = self.planes[plane];
        let format = &self.formats[file];
        match &self.sources[file] {
            SampleSource::Path(path) => {
                let file = DicomFile::read(path, true)?;
                format.read_frame(&file, number, scale, out)
            }
            SampleSource::Loaded(file) => format.read_frame(file, number, scale, out),
        }
    }
}

impl PlaneReader for FramePlanes {
    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        let [columns, all_rows] = self.formats.first().map_or([0; 2], |f| [f.columns, f.rows]);
        let part = (rows.len() * columns).max(1);
        let is_whole = rows.len() == all_rows;
        out.par_chunks_mut(part)
            .enumerate()
            .try_for_each(|(k, out)| {
                if is_whole {
                    return self.read_plane(first + k, out);
                }
                let mut plane = vec![0.0; columns * all_rows];
                self.read_plane(first + k, &mut plane)?;
                out.copy_from_slice(&plane[rows.start * columns..rows.end * columns]);
                Ok(())
            })
    }
}

//! Files of one series in a folder.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use dicom_dictionary_std::tags;
use dicom_object::Tag;

use super::dataset::{DicomFile, items, text};
use super::frames::{Frame, frames};
use super::stack::{Place, StackProblem, stack};
use super::{is_dicom, is_segmentation};
use crate::error::{Error, Result, cause, io_error};
use crate::parallel::prelude::*;

/// Largest number of series or groups that a message lists.
const MAX_LISTED: usize = 8;

/// Attributes that tell apart images of one series at the same positions, in the order in which they are
/// tried.
const PASS_ATTRIBUTES: [(Tag, &str); 10] = [
    (tags::TEMPORAL_POSITION_IDENTIFIER, "time"),
    (tags::ECHO_NUMBERS, "echo"),
    (tags::ECHO_TIME, "echo time"),
    (tags::INVERSION_TIME, "inversion time"),
    (tags::ACQUISITION_NUMBER, "acquisition"),
    (tags::DIFFUSION_B_VALUE, "b-value"),
    (tags::TRIGGER_TIME, "trigger time"),
    (tags::CONTENT_TIME, "content time"),
    (tags::IMAGE_TYPE, "image type"),
    (tags::ACQUISITION_TIME, "acquisition time"),
];

/// Images that are read as one volume.
pub(super) struct Series {
    /// Their headers.
    pub files: Vec<DicomFile>,
    /// Messages about files that are left out.
    pub notes: Vec<String>,
}

/// Returns `true` if a file begins as a DICOM file does.
fn is_dicom_file(path: &Path) -> bool {
    let mut head = Vec::new();
    let file = File::open(path);
    let read = file.and_then(|file| file.take(super::HEAD_BYTES).read_to_end(&mut head));
    read.is_ok() && is_dicom(&head)
}

/// Returns the DICOM files in a folder, in the order of their names.
pub(super) fn files_of(folder: &Path) -> Result<Vec<PathBuf>> {
    let failed = |e| io_error(folder, "read", e);
    let entries = std::fs::read_dir(folder).map_err(failed)?;
    let mut paths: Vec<PathBuf> = entries
        .map(|entry| Ok(entry.map_err(failed)?.path()))
        .collect::<Result<_>>()?;
    paths.sort();
    paths.retain(|path| path.is_file());
    let are_dicom: Vec<bool> = paths.par_iter().map(|path| is_dicom_file(path)).collect();
    let mut flags = are_dicom.into_iter();
    paths.retain(|_| flags.next().unwrap_or(false));
    Ok(paths)
}

/// Returns the images that are read for a path: those of a folder, or those of the series of a file, in
/// its folder.
///
/// # Errors
/// Returns an [`Error::Io`] if a file cannot be read, or if the images are of several series or passes.
pub(super) fn series_at(path: &Path) -> Result<Series> {
    let is_folder = path.is_dir();
    let mut notes = Vec::new();
    if !is_folder {
        let file = DicomFile::read(path, false)?;
        if file.frame_count() > 1 || text(&file.data, tags::SERIES_INSTANCE_UID).is_none() {
            return Ok(Series {
                files: vec![file],
                notes,
            });
        }
    }
    let folder = if is_folder {
        path
    } else {
        path.parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new("."))
    };
    let paths = files_of(folder)?;
    let read: Vec<Result<DicomFile>> = paths
        .par_iter()
        .map(|path| DicomFile::read(path, false))
        .collect();
    let mut files = Vec::new();
    let chosen_name = path.file_name().filter(|_| !is_folder);
    let is_chosen =
        |file: &DicomFile| chosen_name.is_some() && file.path.file_name() == chosen_name;
    for file in read {
        match file {
            Ok(file) => files.push(file),
            // A damaged file of another series does not matter, but its series is unknown.
            Err(error) => return Err(error),
        }
    }
    let count = files.len();
    files.retain(|file| text(&file.data, tags::ROWS).is_some());
    if files.is_empty() {
        let problem = "holds DICOM files without images";
        return Err(Error::Io(cause(
            folder.display(),
            problem,
            "give the folder of a scan",
        )));
    }
    let uid = |file: &DicomFile| text(&file.data, tags::SERIES_INSTANCE_UID).unwrap_or_default();
    if let Some(chosen) = files.iter().find(|file| is_chosen(file)) {
        let chosen = uid(chosen);
        files.retain(|file| uid(file) == chosen);
    } else if count > files.len() {
        notes.push(format!(
            "{} DICOM files without an image are left out",
            count - files.len()
        ));
    }
    let by_series = grouped(files, |a, b| uid(a) == uid(b));
    let files = match <[_; 1]>::try_from(by_series) {
        Ok([files]) => files,
        Err(groups) => return Err(several(folder, "series", &groups, |_| String::new())),
    };
    let files = without_copies(files, &mut notes);
    let files = without_localizers(files, &is_chosen, &mut notes);
    let files = one_size(files, folder, &is_chosen, &mut notes)?;
    let files = one_pass(files, folder, &is_chosen, &mut notes)?;
    Ok(Series { files, notes })
}

/// Returns files in groups, each group and its files in the order of the files.
fn grouped(
    files: Vec<DicomFile>,
    are_alike: impl Fn(&DicomFile, &DicomFile) -> bool,
) -> Vec<Vec<DicomFile>> {
    let mut groups: Vec<Vec<DicomFile>> = Vec::new();
    for file in files {
        match groups.iter_mut().find(|group| are_alike(&group[0], &file)) {
            Some(group) => group.push(file),
            None => groups.push(vec![file]),
        }
    }
    groups
}

/// Returns what a user calls the series of a file: its modality and its description.
pub(super) fn series_name(file: &DicomFile) -> String {
    let modality = text(&file.data, tags::MODALITY).unwrap_or_else(|| "image".into());
    let number = text(&file.data, tags::SERIES_NUMBER);
    let number = number
        .map(|number| format!(" series {number}"))
        .unwrap_or_default();
    match text(&file.data, tags::SERIES_DESCRIPTION) {
        Some(description) => format!("{modality}{number} '{description}'"),
        None => format!("{modality}{number}"),
    }
}

/// Returns the error for a folder with several groups of images, which lists them with a file of each.
/// `detail` says what a group has in common.
fn several(
    folder: &Path,
    kind: &str,
    groups: &[Vec<DicomFile>],
    detail: impl Fn(&DicomFile) -> String,
) -> Error {
    let name_of = |file: &DicomFile| {
        let name = file.path.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    };
    let listed = groups.iter().take(MAX_LISTED).map(|group| {
        let images = if group.len() == 1 { "image" } else { "images" };
        let detail = detail(&group[0]);
        format!(
            "{} ({} {images}{detail}, {})",
            series_name(&group[0]),
            group.len(),
            name_of(&group[0])
        )
    });
    let mut listed: Vec<String> = listed.collect();
    if groups.len() > MAX_LISTED {
        listed.push(format!("and {} more", groups.len() - MAX_LISTED));
    }
    let problem = format!("holds {} {kind}: {}", groups.len(), listed.join(", "));
    // The largest group is the likeliest.
    let largest = groups.iter().fold(&groups[0], |best, group| {
        if group.len() > best.len() {
            group
        } else {
            best
        }
    });
    let remedy = format!(
        "give a file of the one to read, such as {}",
        largest[0].path.display()
    );
    Error::Io(cause(folder.display(), problem, remedy))
}

/// Returns files without those that are copies of others.
fn without_copies(files: Vec<DicomFile>, notes: &mut Vec<String>) -> Vec<DicomFile> {
    let mut known = std::collections::BTreeSet::new();
    let count = files.len();
    let mut files = files;
    files.retain(|file| match text(&file.data, tags::SOP_INSTANCE_UID) {
        Some(uid) => known.insert(uid),
        None => true,
    });
    if files.len() < count {
        notes.push(format!(
            "{} files are copies of others and left out",
            count - files.len()
        ));
    }
    files
}

/// Returns files without localizers, which are pictures that show where slices lie.
fn without_localizers(
    files: Vec<DicomFile>,
    is_chosen: &dyn Fn(&DicomFile) -> bool,
    notes: &mut Vec<String>,
) -> Vec<DicomFile> {
    let is_localizer = |file: &DicomFile| {
        text(&file.data, tags::IMAGE_TYPE).is_some_and(|kind| kind.contains("LOCALIZER"))
    };
    let (localizers, others): (Vec<_>, Vec<_>) = files.into_iter().partition(is_localizer);
    if others.is_empty() || localizers.iter().any(is_chosen) {
        return localizers;
    }
    if !localizers.is_empty() {
        notes.push(format!("{} localizers are left out", localizers.len()));
    }
    others
}

/// Returns the size of the image of a file, and its position.
fn size_and_place(file: &DicomFile) -> ([i64; 2], Option<Place>) {
    let size = [tags::COLUMNS, tags::ROWS]
        .map(|tag| super::dataset::integer(&file.data, tag).unwrap_or(0));
    let place = frames(file, 0)
        .ok()
        .and_then(|frames| frames.first()?.place);
    (size, place)
}

/// Returns the files of images of one size and orientation.
fn one_size(
    files: Vec<DicomFile>,
    folder: &Path,
    is_chosen: &dyn Fn(&DicomFile) -> bool,
    notes: &mut Vec<String>,
) -> Result<Vec<DicomFile>> {
    let groups = grouped(files, |a, b| {
        let ((size_a, place_a), (size_b, place_b)) = (size_and_place(a), size_and_place(b));
        let are_parallel = match (place_a, place_b) {
            (Some(a), Some(b)) => a.is_parallel_to(&b),
            (None, None) => true,
            _ => false,
        };
        size_a == size_b && are_parallel
    });
    let detail = |file: &DicomFile| match size_and_place(file) {
        ([columns, rows], Some(place)) => {
            let [x, y, z] = place.normal();
            format!(" of {columns} x {rows}, normal ({x:.2}, {y:.2}, {z:.2})")
        }
        ([columns, rows], None) => format!(" of {columns} x {rows}"),
    };
    chosen_group(
        groups,
        is_chosen,
        notes,
        || "sizes or orientations of images".into(),
        folder,
        &detail,
    )
}

/// Returns the group of the chosen file, with a note about others.
fn chosen_group(
    mut groups: Vec<Vec<DicomFile>>,
    is_chosen: &dyn Fn(&DicomFile) -> bool,
    notes: &mut Vec<String>,
    kind: impl Fn() -> String,
    folder: &Path,
    detail: &dyn Fn(&DicomFile) -> String,
) -> Result<Vec<DicomFile>> {
    if groups.len() == 1 {
        return Ok(groups.remove(0));
    }
    let Some(chosen) = groups.iter().position(|group| group.iter().any(is_chosen)) else {
        return Err(several(folder, &kind(), &groups, detail));
    };
    let total: usize = groups.iter().map(Vec::len).sum();
    let group = groups.remove(chosen);
    notes.push(format!(
        "the series has {} {}: {} of its {total} images, those of the given file, are read",
        groups.len() + 1,
        kind(),
        group.len()
    ));
    Ok(group)
}

/// Returns the files of one pass over the positions: of one time, echo or acquisition.
fn one_pass(
    files: Vec<DicomFile>,
    folder: &Path,
    is_chosen: &dyn Fn(&DicomFile) -> bool,
    notes: &mut Vec<String>,
) -> Result<Vec<DicomFile>> {
    let heights = |files: &[&DicomFile]| -> bool {
        let places: Option<Vec<Place>> = files.iter().map(|file| size_and_place(file).1).collect();
        let repeats = places.map(|places| stack(&places, 1.0));
        !matches!(repeats, Some(Err(StackProblem::SamePlace(..))))
    };
    if files.len() < 2 || heights(&files.iter().collect::<Vec<_>>()) {
        return Ok(files);
    }
    for (tag, name) in PASS_ATTRIBUTES {
        let value = |file: &DicomFile| text(&file.data, tag).unwrap_or_default();
        let mut values: Vec<String> = files.iter().map(value).collect();
        values.sort();
        values.dedup();
        let files_with = |value_of_group: &String| -> Vec<&DicomFile> {
            files
                .iter()
                .filter(|file| value(file) == *value_of_group)
                .collect()
        };
        // Values that tell every image apart say nothing.
        let is_useful = (2..=files.len() / 2).contains(&values.len());
        if !is_useful || !values.iter().all(|value| heights(&files_with(value))) {
            continue;
        }
        let groups = grouped(files, |a, b| value(a) == value(b));
        let detail = |file: &DicomFile| format!(", {name} {}", value(file));
        let kind = || format!("passes over the same positions, by {name}");
        return chosen_group(groups, is_chosen, notes, kind, folder, &detail);
    }
    Ok(files)
}

/// Returns the error for frames that are no stack.
pub(super) fn stack_error(
    place: &Path,
    problem: &StackProblem,
    frames: &[Frame],
    files: &[DicomFile],
) -> Error {
    let name = |k: usize| {
        let Frame { file, number, .. } = frames[k];
        let file = &files[file];
        if file.frame_count() > 1 {
            format!("frame {number}")
        } else {
            let name = file.path.file_name().unwrap_or_default();
            name.to_string_lossy().into_owned()
        }
    };
    let position = |k: usize| match frames[k].place {
        Some(place) => {
            let [x, y, z] = place.position;
            format!("{} at ({x:.2}, {y:.2}, {z:.2})", name(k))
        }
        None => name(k),
    };
    let resample =
        "convert it to .nii.gz with dcm2niix, which resamples uneven slices (the file named _Eq)";
    let (problem, remedy) = match *problem {
        StackProblem::SamePlace(a, b) => (
            format!(
                "has several images at one position: {} and {}",
                position(a),
                name(b)
            ),
            "give the files of one volume alone in a folder, or convert it with dcm2niix and choose a volume",
        ),
        StackProblem::Missing {
            count,
            between: [a, b],
            total,
        } => (
            format!(
                "lacks slices ({total} in all): {count} between {} and {}",
                position(a),
                position(b)
            ),
            "add the missing files, or leave out those on one side of the gap",
        ),
        StackProblem::Uneven {
            distances: [low, high],
            between: [a, b],
        } => (
            format!(
                "has slices {low:.3} to {high:.3} mm apart, the widest gap between {} and {}",
                position(a),
                position(b)
            ),
            resample,
        ),
        StackProblem::Beside(k, distance) => (
            format!(
                "has {} {distance:.3} mm beside the line of the other slices",
                position(k)
            ),
            resample,
        ),
    };
    Error::Io(cause(place.display(), problem, remedy))
}

/// Returns `true` if the positions of frames are those of one direction.
pub(super) fn are_parallel(frames: &[Frame]) -> bool {
    let mut places = frames.iter().filter_map(|frame| frame.place);
    let Some(first) = places.next() else {
        return true;
    };
    places.all(|place| place.is_parallel_to(&first))
}

/// Returns the SEG file of a folder that holds nothing else, if it is the only one.
pub(super) fn only_segmentation(paths: &[PathBuf]) -> Option<&PathBuf> {
    let [path] = paths else {
        return None;
    };
    let file = DicomFile::read(path, false).ok()?;
    (is_segmentation(&file) && !items(&file.data, tags::SEGMENT_SEQUENCE).is_empty())
        .then_some(path)
}

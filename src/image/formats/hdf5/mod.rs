//! Images in HDF5 files: arrays of h5py and MATLAB 7.3, ilastik, ITK, VTKHDF.
//!
//! An array of shape `(nz, ny, nx)` has x as its fastest axis, unless its attribute `axistags` (of
//! ilastik and vigra) says otherwise. MATLAB's first index is the fastest one.
//!
//! - `source`: files and data sets, and checks of what would be read wrongly
//! - `position`: the position of the samples, as the writers of the file store it

mod position;
pub(crate) mod source;

use std::path::{Path, PathBuf};

use super::placement::NO_GEOMETRY_NOTE;
use super::samples::{Encoding, allocate};
use super::{ImageFormat, LoadedImage};
use crate::Result;
use crate::image::Image;
use crate::image::labels::LabelCollector;
use position::{ArrayAxes, Position};
pub(crate) use source::{Hdf5Source, is_hdf5, split_path};
use source::{MAX_LISTED, NumberSet};

/// Reads the image that `FILE`, `FILE:/PATH` or `FILE/PATH` names.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file is damaged, has no data set that is an image or
/// more than one, or stores it in a way that is not read.
pub fn read(path: &Path) -> Result<LoadedImage<3>> {
    let (file, inner) = match split_path(path) {
        Some((file, inner)) => (file, Some(inner)),
        None => (path.to_path_buf(), None),
    };
    let source = Hdf5Source::open(&file)?;
    if source.group("/minc-2.0").is_some() {
        return Err(source.error(
            "/minc-2.0",
            "is a MINC 2 file, whose values depend on ranges that are not read",
            "convert it to .nii, with mnc2nii, or in Python with nibabel",
        ));
    }
    let mut note = None;
    let inner = match inner {
        Some(inner) => inner,
        None => only_image(&source, &mut note)?,
    };
    let set = source.dataset(&inner)?;
    let mut position = Position::find(&source, &set)?;
    position.notes.extend(note);
    load(&set, position, file)
}

/// Returns the path of the only data set that can be an image. `note` says which groups are not read.
fn only_image(source: &Hdf5Source, note: &mut Option<String>) -> Result<String> {
    if let Some(path) = position::known_image(source) {
        return Ok(path);
    }
    let contents = source.contents();
    let paths = contents.datasets;
    if let Some(group) = contents.unlisted.first() {
        let problem = "cannot be listed: it is damaged, or has a virtual data set";
        if paths.is_empty() {
            let remedy = "copy the file again, or repack it with h5repack";
            return Err(source.error(group, problem, remedy));
        }
        *note = Some(format!(
            "the group {group} {problem}; its data sets are not looked at"
        ));
    }
    let axis_count = |path: &String| {
        let set = source.dataset(path).ok()?;
        set.encoding().ok()?;
        let axes = ArrayAxes::new(&set).ok()?;
        let lengths = axes.dims.iter().filter(|&&n| n > 1);
        Some(lengths.count())
    };
    let mut images: Vec<(usize, &String)> = paths
        .iter()
        .filter_map(|path| Some((axis_count(path)?, path)))
        .filter(|(count, _)| *count >= 2)
        .collect();
    let most = images.iter().map(|image| image.0).max().unwrap_or(0);
    images.retain(|image| image.0 == most);
    match images[..] {
        [(_, path)] => Ok(path.clone()),
        [] => {
            let shown = listed(&paths.iter().collect::<Vec<_>>());
            let problem =
                format!("has no data set of two or three axes of numbers: it has {shown}");
            Err(source.error("/", problem, "give a file with an image"))
        }
        _ => {
            let images: Vec<&String> = images.iter().map(|image| image.1).collect();
            let problem = format!("has {} data sets: {}", images.len(), listed(&images));
            let first = images[0];
            let remedy = format!("name one, such as {}:{first}", source.path().display());
            Err(source.error("/", problem, remedy))
        }
    }
}

/// Returns the paths as a list in a sentence.
fn listed(paths: &[&String]) -> String {
    let mut shown: Vec<String> = paths
        .iter()
        .take(MAX_LISTED)
        .map(|p| p.to_string())
        .collect();
    if paths.len() > MAX_LISTED {
        shown.push(format!("and {} more", paths.len() - MAX_LISTED));
    }
    if shown.is_empty() {
        "none".into()
    } else {
        shown.join(", ")
    }
}

/// Reads the samples of a data set.
fn load(set: &NumberSet<'_>, position: Position, file: PathBuf) -> Result<LoadedImage<3>> {
    let encoding = set.encoding()?;
    let axes = ArrayAxes::new(set)?;
    let count = axes
        .dims
        .iter()
        .fold(1usize, |n, &length| n.saturating_mul(length));
    if count == 0 {
        return Err(set.error("has no samples", "give a data set with samples"));
    }
    let mut samples = allocate(&file, count)?;
    let bytes = axes.in_order(set.read_bytes()?, encoding.size());
    if bytes.len() != count * encoding.size() {
        return Err(set.error("is cut off", crate::files::REWRITE_DAMAGED));
    }
    encoding.decode(&bytes, &mut samples);
    let mut notes = position.notes;
    let scaling = Scaling::new(set);
    let mut labels = None;
    if scaling.is_identity() {
        notes.extend(encoding.rounding_note(&samples));
        if encoding.may_need_exact_labels(&samples) {
            let mut collector = LabelCollector::default();
            collector.extend_exact(encoding.exact_samples(&bytes));
            labels = collector.finish_exact();
        }
    } else {
        scaling.apply(encoding, &bytes, &mut samples);
        notes.push(scaling.note());
    }
    let mut image = Image::new(axes.dims, samples, position.geometry);
    image.labels = labels;
    if image.geometry == Default::default() {
        notes.push(format!("{}: {NO_GEOMETRY_NOTE}", set.path));
    }
    Ok(LoadedImage {
        image,
        format: ImageFormat::Hdf5,
        encoding: format!("{encoding}, {}", set.path),
        notes,
        survey: None,
        line_numbers: None,
    })
}

/// Linear map from the numbers of a file to samples, and the number for no data, as the conventions of
/// NetCDF (CF) have them.
struct Scaling {
    factor: f64,
    offset: f64,
    fill: Option<f64>,
}

impl Scaling {
    fn new(set: &NumberSet<'_>) -> Self {
        let first = |name: &str| set.attribute_numbers(name)?.first().copied();
        Self {
            factor: first("scale_factor").unwrap_or(1.0),
            offset: first("add_offset").unwrap_or(0.0),
            fill: first("_FillValue").or_else(|| first("missing_value")),
        }
    }

    fn is_identity(&self) -> bool {
        self.factor == 1.0 && self.offset == 0.0 && self.fill.is_none_or(f64::is_nan)
    }

    fn apply(&self, encoding: Encoding, bytes: &[u8], samples: &mut [f32]) {
        for (sample, value) in samples.iter_mut().zip(encoding.numbers(bytes)) {
            *sample = if Some(value) == self.fill {
                f32::NAN
            } else {
                (value * self.factor + self.offset) as f32
            };
        }
    }

    fn note(&self) -> String {
        let fill = self.fill.map(|fill| format!("; {fill} is no data"));
        format!(
            "samples are the numbers of the file times {} plus {}{}",
            self.factor,
            self.offset,
            fill.unwrap_or_default()
        )
    }
}

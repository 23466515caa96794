//! Describes the content of an image file, as text for people and as JSON for programs.

use std::fmt::Write;
use std::path::Path;

use serde::Serialize;

use super::samples;
use super::stream::{ImageStream, MAX_SAMPLES_IN_MEMORY, OpenedImage, SlabSource};
use super::{ImageFormat, LoadedImage, ReadOptions, SegyInfo, detect, open, segy};
use crate::error::{Cause, Result, io_error};
use crate::grid_file::{self, GridDescription};
use crate::image::check::StatsAccumulator;
use crate::image::formats::with_loaded;
use crate::image::{Geometry, Image, LabelTable, LabelValue, Modality, Stats};

/// Content of an image file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Description {
    /// Path of the file.
    pub file: String,
    /// Format of the file.
    pub format: String,
    /// Encoding of the samples.
    pub encoding: String,
    /// The image, unless the file cannot be read as one.
    pub image: Option<ImageDescription>,
    /// Contents of the headers of a SEG-Y file.
    pub survey: Option<SegyInfo>,
    /// Cells of a corner-point grid.
    pub grid: Option<GridDescription>,
    /// Further messages for the user.
    pub notes: Vec<String>,
}

/// Dimensions, position and values of an image.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImageDescription {
    /// The image axes, x (the fastest in memory) first.
    pub axes: Vec<AxisDescription>,
    /// Shape of the array in NumPy, the fastest axis last.
    pub numpy_shape: Vec<usize>,
    /// Physical position of the first sample.
    pub origin: Vec<f64>,
    /// Physical position of the sample with the largest indices.
    pub far_corner: Vec<f64>,
    /// Unit of each physical coordinate; empty if unknown.
    pub units: Vec<String>,
    /// Smallest finite sample.
    pub min: f32,
    /// Largest finite sample.
    pub max: f32,
    /// Mean of the finite samples.
    pub mean: f64,
    /// Number of NaN samples.
    pub nan: usize,
    /// Number of infinite samples.
    pub infinite: usize,
    /// Index (x first) of the first sample that is NaN or infinite.
    pub first_non_finite: Option<Vec<usize>>,
    /// Labels in ascending order, if the image looks like an image of labels.
    pub labels: Option<Vec<LabelValue>>,
}

/// One axis of an image.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisDescription {
    /// Name of the axis.
    pub name: String,
    /// Number of samples along it.
    pub count: usize,
    /// Physical step from one sample to the next.
    pub step: Vec<f64>,
    /// Length of that step.
    pub spacing: f64,
}

/// Reads a file and describes its content. A SEG-Y file that is not an image (gathers, a single
/// trace, a truncated file) is described, too, as far as its headers allow.
///
/// # Errors
/// Returns a [`crate::Error::Io`] if the file cannot be read or understood at all.
pub fn describe(path: &Path, options: &ReadOptions) -> Result<Description> {
    let format = detect(path, options)?;
    if format == ImageFormat::Segy && options.keep_all_samples() {
        return describe_survey(segy::SegySurvey::open(path, &options.segy)?, path);
    }
    let mut description = Description::from_opened(path, open(path, options)?)?;
    if format == ImageFormat::CornerPoints {
        description.grid = Some(grid_file::describe(path)?);
    }
    Ok(description)
}

/// Describes a SEG-Y file, also if it cannot be read as an image.
fn describe_survey(mut survey: segy::SegySurvey, path: &Path) -> Result<Description> {
    let problem = survey.problem.take();
    let mut description = if survey.has_samples() {
        let stream = survey.into_stream(path)?;
        Description::from_opened(path, OpenedImage::Stream(stream))?
    } else {
        Description {
            file: path.display().to_string(),
            format: ImageFormat::Segy.to_string(),
            encoding: survey.info.encoding.clone(),
            image: None,
            survey: Some(survey.info),
            grid: None,
            notes: survey.notes,
        }
    };
    if let Some(Cause {
        problem, remedy, ..
    }) = &problem
    {
        let note = format!("cannot be read as an image: {problem}; {remedy}");
        description.notes.push(note);
    }
    Ok(description)
}

impl ImageDescription {
    /// Describes an image.
    pub fn from_image<const D: usize>(image: &Image<D>, modality: Modality) -> Self {
        let evidence = image.label_evidence(modality);
        let table = evidence.and_then(|_| LabelTable::from_image(image));
        Self {
            labels: table.map(|table| table.values),
            ..Self::from_stats(image.dims(), &image.geometry, image.stats())
        }
    }

    fn from_stats<const D: usize>(
        dims: [usize; D],
        geometry: &Geometry<D>,
        stats: Stats<D>,
    ) -> Self {
        let spacing = geometry.spacing();
        let Stats {
            min,
            max,
            mean,
            nan,
            infinite,
            first_non_finite: first_bad,
        } = stats;
        Self {
            axes: (0..D)
                .map(|k| AxisDescription {
                    name: geometry.names[k].clone(),
                    count: dims[k],
                    step: geometry.axes[k].to_vec(),
                    spacing: spacing[k],
                })
                .collect(),
            numpy_shape: dims.iter().rev().copied().collect(),
            origin: geometry.origin.to_vec(),
            far_corner: geometry
                .to_physical(dims.map(|n| n.saturating_sub(1) as f64))
                .to_vec(),
            units: geometry.units.to_vec(),
            min,
            max,
            mean,
            nan,
            infinite,
            first_non_finite: first_bad.map(|index| index.to_vec()),
            labels: None,
        }
    }
}

impl Description {
    /// Describes an opened image. Its samples are read once and need not fit into memory.
    fn from_opened(path: &Path, opened: OpenedImage) -> Result<Self> {
        let stream = match opened {
            // Small images are loaded into memory, which shows whether their samples are labels.
            OpenedImage::Stream(stream) if stream.header.dims[2] > 1 && !may_be_labels(&stream) => {
                stream
            }
            other => {
                return Ok(
                    with_loaded!(other.load(path)?, loaded => Self::from_loaded(path, loaded)),
                );
            }
        };
        let mut tally = StatsAccumulator::default();
        let add = &mut |slab: &[f32]| {
            tally.add(slab);
            Ok(())
        };
        stream
            .for_each_slab(1, add)
            .map_err(|e| io_error(path, "read", e))?;
        let note = stream.rounding_note();
        let header = stream.header;
        let stats = tally.stats(header.dims);
        Ok(Self {
            file: path.display().to_string(),
            format: header.format.to_string(),
            encoding: header.encoding,
            image: Some(ImageDescription::from_stats(
                header.dims,
                &header.geometry,
                stats,
            )),
            survey: header.survey,
            grid: None,
            notes: header.notes.into_iter().chain(note).collect(),
        })
    }

    fn from_loaded<const D: usize>(path: &Path, loaded: LoadedImage<D>) -> Self {
        let modality = Modality::detect(loaded.format, &loaded.image.geometry);
        Self {
            file: path.display().to_string(),
            format: loaded.format.to_string(),
            encoding: loaded.encoding,
            image: Some(ImageDescription::from_image(&loaded.image, modality)),
            survey: loaded.survey,
            grid: None,
            notes: loaded.notes,
        }
    }

    /// Returns the description as lines of text for a terminal.
    pub fn to_lines(&self) -> String {
        let mut rows: Vec<(String, String)> = vec![
            ("file".into(), self.file.clone()),
            (
                "format".into(),
                format!("{}, {}", self.format, self.encoding),
            ),
        ];
        let mut row = |name: &str, value: String| rows.push((name.into(), value));
        if let Some(survey) = &self.survey {
            survey_rows(survey, &mut row);
        }
        if let Some(grid) = &self.grid {
            grid_rows(grid, &mut row);
        }
        if let Some(image) = &self.image {
            image_rows(image, &mut row);
        }
        for note in &self.notes {
            row("note", note.clone());
        }
        // The textual header often says where the line numbers and coordinates are.
        for line in self.survey.iter().flat_map(|survey| &survey.text) {
            row("text", line.clone());
        }
        let mut lines = String::new();
        for (name, value) in rows {
            // Writing to a String cannot fail.
            let _ = writeln!(lines, "{name:<12}{value}");
        }
        lines
    }
}

/// Largest number of labels that are listed.
const MAX_LABELS_SHOWN: usize = 24;

/// Returns `true` if the samples in a file may be labels, and are few enough to be inspected in
/// memory.
fn may_be_labels(stream: &ImageStream) -> bool {
    let header = &stream.header;
    let count: usize = header.dims.iter().product();
    let is_survey = Modality::detect(header.format, &header.geometry) == Modality::Survey;
    count <= MAX_SAMPLES_IN_MEMORY
        && !is_survey
        && samples::check_memory(Path::new("the image"), count).is_ok()
}

fn survey_rows(survey: &SegyInfo, row: &mut impl FnMut(&str, String)) {
    row("revision", survey.revision.clone());
    row(
        "traces",
        format!("{} of {} samples", survey.traces, survey.samples),
    );
    match survey.dt_ms {
        Some(dt) if survey.is_depth => {
            row("depth", format!("from {}, every {dt}", survey.t0_ms));
        }
        Some(dt) => row("time", format!("from {} ms, every {dt} ms", survey.t0_ms)),
        None => row("time", "no sample interval in the headers".into()),
    }
    let [inline, crossline] = survey.line_bytes.map(|byte| match byte {
        0 => "from X, Y".to_string(),
        byte => format!("at byte {byte}"),
    });
    if let Some(lines) = &survey.inlines {
        row("inlines", format!("{lines}, {inline}"));
    }
    if let Some(lines) = &survey.crosslines {
        row("crosslines", format!("{lines}, {crossline}"));
    }
    if let (Some(fit), Some(inlines), Some(crosslines)) =
        (&survey.fit, &survey.inlines, &survey.crosslines)
    {
        let ends =
            [inlines, crosslines].map(|lines| [(0, lines.first), (lines.count - 1, lines.last())]);
        for (i, inline) in ends[0] {
            for (c, crossline) in ends[1] {
                let [x, y] = [0, 1].map(|k| {
                    fit.origin[k] + i as f64 * fit.inline[k] + c as f64 * fit.crossline[k]
                });
                let text = format!("inline {inline}, crossline {crossline} at ({x:.1}, {y:.1})");
                row("corner", text);
            }
        }
    }
    if survey.missing + survey.duplicates > 0 {
        row(
            "gaps",
            format!(
                "{} traces missing, {} duplicate",
                survey.missing, survey.duplicates
            ),
        );
    }
}

fn grid_rows(grid: &GridDescription, row: &mut impl FnMut(&str, String)) {
    let [nx, ny, nz] = grid.dims;
    let hand = if grid.is_left_handed { "left" } else { "right" };
    row(
        "grid",
        format!(
            "{nx} x {ny} x {nz} cells, {} active, {hand}-handed",
            grid.active
        ),
    );
    let volumes = |volume: f64, pore_volume: Option<f64>| {
        let unit = &grid.unit;
        let pores = pore_volume.map(|pores| format!(", pore volume {pores:.6e} {unit}3"));
        format!("volume {volume:.6e} {unit}3{}", pores.unwrap_or_default())
    };
    row("cells", volumes(grid.volume, grid.pore_volume));
    if grid.inverted > 0 {
        row(
            "bad",
            format!("{} cells are turned inside out", grid.inverted),
        );
    }
    if !grid.properties.is_empty() {
        row("properties", grid.properties.join(", "));
    }
    for region in grid.regions.iter().take(MAX_LABELS_SHOWN) {
        let volumes = volumes(region.volume, region.pore_volume);
        let (name, value, cells) = (&grid.property, region.value, region.cells);
        row(
            "region",
            format!("{name} {value}: {cells} cells, {volumes}"),
        );
    }
    if grid.regions.len() > MAX_LABELS_SHOWN {
        row("region", "... (all in JSON)".into());
    }
}

fn image_rows(image: &ImageDescription, row: &mut impl FnMut(&str, String)) {
    let join = |text_of: fn(&AxisDescription) -> String| {
        let parts: Vec<String> = image.axes.iter().map(text_of).collect();
        parts.join(" x ")
    };
    let counts = join(|axis| axis.count.to_string());
    row(
        "dims",
        format!("{counts} ({})", join(|axis| axis.name.clone())),
    );
    let position_text = |x: &[f64], digits: usize| {
        let numbers: Vec<String> = x.iter().map(|c| format!("{c:.digits$}")).collect();
        format!("({})", numbers.join(", "))
    };
    row("first", position_text(&image.origin, 3));
    row("last", position_text(&image.far_corner, 3));
    for axis in &image.axes {
        row(
            "step",
            format!("{} along {}", position_text(&axis.step, 4), axis.name),
        );
    }
    if image.units.iter().any(|u| !u.is_empty()) {
        let unit_or_unknown = |u: &String| {
            if u.is_empty() {
                "unknown".to_string()
            } else {
                u.clone()
            }
        };
        let units: Vec<String> = image.units.iter().map(unit_or_unknown).collect();
        row("units", units.join(", "));
    }
    row(
        "values",
        format!("{} to {}, mean {:.6}", image.min, image.max, image.mean),
    );
    if let Some(labels) = &image.labels {
        let shown = labels
            .iter()
            .take(MAX_LABELS_SHOWN)
            .map(LabelValue::to_string);
        let shown = shown.collect::<Vec<_>>().join(", ");
        let more = if labels.len() > MAX_LABELS_SHOWN {
            ", ... (all in JSON)"
        } else {
            ""
        };
        row("labels", format!("{} labels: {shown}{more}", labels.len()));
    }
    if let Some(index) = &image.first_non_finite {
        row(
            "bad",
            format!(
                "{} NaN and {} infinite samples, the first at {index:?}",
                image.nan, image.infinite
            ),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_description_has_fields_text_and_json() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ramp.npy");
        let mut samples: Vec<f32> = (0..5 * 4 * 3).map(|i| i as f32).collect();
        samples[7] = f32::NAN;
        let image = Image::new([5, 4, 3], samples, Geometry::default());
        super::super::write(&path, &image).unwrap();

        let description = describe(&path, &ReadOptions::default()).unwrap();
        let described = description.image.as_ref().unwrap();
        assert_eq!(described.numpy_shape, [3, 4, 5]);
        assert_eq!((described.min, described.max), (0.0, 59.0));
        assert_eq!(
            (described.nan, described.first_non_finite.clone()),
            (1, Some(vec![2, 1, 0]))
        );
        assert_eq!(described.far_corner, [4.0, 3.0, 2.0]);

        let lines = description.to_lines();
        assert!(
            lines.contains("5 x 4 x 3 (x x y x z)") && lines.contains("1 NaN"),
            "{lines}"
        );
        let json = serde_json::to_value(&description).unwrap();
        assert_eq!(json["image"]["axes"][0]["count"], 5);
        assert_eq!(json["survey"], serde_json::Value::Null);
    }
}

//! SEG-Y, revisions 0 to 2: post-stack 3-D volumes with traces in any order, and 2-D lines.
//!
//! Image axes are `sample` (x, fastest in memory), `crossline` and `inline`, so the NumPy shape is
//! (inline, crossline, sample). Physical coordinates are X, Y and minus the two-way time in
//! milliseconds, or minus the depth: negative downwards, so that pictures with z up show the survey
//! upright.
//!
//! - `bytes`: the trace header bytes of each field
//! - `text`, `file_header`: the headers of the file; byte order, sample format, layout
//! - `trace_headers`: the headers of all traces, as columns
//! - `grid`: arranges traces in cells by their line numbers
//! - `infer`: lines of a survey without line numbers, from the coordinates
//! - `survey_fit`: fits the affine map that places the survey to the coordinates
//! - `survey`: combines all of these in [`SegySurvey`]; [`scan`] and [`read`] return the result
//! - `line`: 2-D lines
//! - `load`: reads the samples as those of an image
//! - `write`: writes a volume with the headers of another file
//! - `synthetic`: writes a volume as a survey with headers of its own

pub(crate) mod bytes;
mod file_header;
pub(crate) mod grid;
mod infer;
mod line;
mod load;
mod survey;
pub(crate) mod survey_fit;
mod synthetic;
mod text;
mod trace_headers;
mod write;

#[cfg(test)]
mod tests;

use std::path::Path;

use serde::Serialize;

use super::LoadedImage;
use super::stream::ImageStream;
use crate::error::{Error, Result};

pub use bytes::SegyBytes;
pub use file_header::{FILE_HEADER_BYTES, looks_like};
pub use grid::LineNumbers;
pub use survey::SegySurvey;
pub use survey_fit::SurveyFit;
pub use synthetic::write_synthetic;
pub use write::{SegyFloat, write_like};

/// Contents of a SEG-Y file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SegyInfo {
    /// Sample format and byte order.
    pub encoding: String,
    /// Revision that the file claims, e.g. `1.0`.
    pub revision: String,
    /// Number of complete traces in the file.
    pub traces: usize,
    /// Number of samples of each trace.
    pub samples: usize,
    /// `true` if samples are in depth: the interval and the first sample are then in m or ft.
    pub is_depth: bool,
    /// Sample interval in ms.
    pub dt_ms: Option<f64>,
    /// Time of the first sample in ms.
    pub t0_ms: f64,
    /// First bytes of the inline number and the crossline number; 0 if they follow from the
    /// coordinates.
    pub line_bytes: [usize; 2],
    /// Inline numbers.
    pub inlines: Option<LineNumbers>,
    /// Crossline numbers.
    pub crosslines: Option<LineNumbers>,
    /// Number of cells without a trace; they are filled with zeros.
    pub missing: usize,
    /// Number of traces that are not used because an earlier trace has the same inline and
    /// crossline.
    pub duplicates: usize,
    /// Source of the coordinates, e.g. `bytes 181 and 185`.
    pub placed_by: String,
    /// Fit of the coordinates to a regular grid.
    pub fit: Option<SurveyFit>,
    /// Reason why the file cannot be read as a volume or a line.
    pub problem: Option<String>,
    /// The textual header.
    pub text: Vec<String>,
}

/// Reads all headers of a SEG-Y file and describes its content, also if it is neither a volume nor
/// a line. Returns the notes for the user, too.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be read or its file header is invalid.
pub fn scan(path: &Path, bytes: &SegyBytes) -> Result<(SegyInfo, Vec<String>)> {
    let survey = SegySurvey::open(path, bytes)?;
    Ok((survey.info, survey.notes))
}

/// Opens a post-stack volume. A line is opened as a volume that is a single trace thick.
///
/// # Errors
/// Returns an [`Error::Io`] if the file cannot be read or holds neither a post-stack volume nor a
/// line.
pub(super) fn open(path: &Path, bytes: &SegyBytes) -> Result<ImageStream> {
    let survey = SegySurvey::open(path, bytes)?;
    if let Some(problem) = survey.problem {
        return Err(Error::Io(problem));
    }
    survey.into_stream(path)
}

/// Reads a post-stack volume. A line is read as a volume that is a single trace thick.
///
/// # Errors
/// Returns the errors of [`SegySurvey::open`], and an [`Error::Io`] if the file holds neither a
/// post-stack volume nor a line.
pub fn read(path: &Path, bytes: &SegyBytes) -> Result<LoadedImage> {
    open(path, bytes)?.into_loaded(path)
}

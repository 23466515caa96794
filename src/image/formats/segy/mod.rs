//! SEG-Y, revisions 0 to 2: post-stack 3-D volumes in any order of traces, and 2-D lines.
//!
//! Image axes are `sample` (x, fastest in memory), `crossline` and `inline`, so the NumPy shape is
//! (inline, crossline, sample). Physical coordinates are X, Y and minus the two-way time in
//! milliseconds: negative downwards, so that pictures with z up show the survey the right way up.
//!
//! - `bytes`: which trace header bytes hold what
//! - `text`, `header`: the file's headers; byte order, sample format, layout
//! - `headers`: the headers of all traces, as columns
//! - `grid`: from line numbers to cells
//! - `place`: from coordinates to the affine map that places the survey
//! - [`SegySurvey`]: all of these together; [`scan`] and [`read`] show what it found
//! - `line`: 2-D lines
//! - `load`: its samples, read as an image's

pub(crate) mod bytes;
mod file_header;
pub(crate) mod grid;
mod line;
mod load;
mod survey;
pub(crate) mod survey_fit;
mod text;
mod trace_headers;

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

/// What a SEG-Y file holds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SegyInfo {
    /// Sample format and byte order.
    pub encoding: String,
    /// Revision that the file claims, e.g. `1.0`.
    pub revision: String,
    /// Number of whole traces in the file.
    pub traces: usize,
    /// Samples of each trace.
    pub samples: usize,
    /// Sample interval in ms.
    pub dt_ms: Option<f64>,
    /// Time of the first sample in ms.
    pub t0_ms: f64,
    /// First bytes of the inline and the crossline number.
    pub line_bytes: [usize; 2],
    /// Inline numbers.
    pub inlines: Option<LineNumbers>,
    /// Crossline numbers.
    pub crosslines: Option<LineNumbers>,
    /// Cells without a trace; they are filled with zeros.
    pub missing: usize,
    /// Traces left out because an earlier one has their inline and crossline.
    pub duplicates: usize,
    /// Where the coordinates come from, e.g. `bytes 181 and 185`.
    pub placed_by: String,
    /// How well the coordinates follow a regular grid.
    pub fit: Option<SurveyFit>,
    /// Why the file cannot be read as a volume or a line.
    pub problem: Option<String>,
    /// The textual header.
    pub text: Vec<String>,
}

/// Reads all headers of a SEG-Y file and says what it holds, also when that is neither volume nor line.
/// Returns also the notes that a user should see.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read or its file header makes no sense.
pub fn scan(path: &Path, bytes: &SegyBytes) -> Result<(SegyInfo, Vec<String>)> {
    let survey = SegySurvey::open(path, bytes)?;
    Ok((survey.info, survey.notes))
}

/// Opens a post-stack volume; of a line, one that is a single trace thick.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read or holds neither a post-stack volume nor a line.
pub(super) fn open(path: &Path, bytes: &SegyBytes) -> Result<ImageStream> {
    let survey = SegySurvey::open(path, bytes)?;
    if let Some(problem) = survey.problem {
        return Err(Error::Io(problem));
    }
    survey.into_stream(path)
}

/// Reads a post-stack volume; of a line, one that is a single trace thick.
///
/// # Errors
/// As [`SegySurvey::open_sides`]; [`Error::Io`] if the file holds neither a post-stack volume nor a line.
pub fn read(path: &Path, bytes: &SegyBytes) -> Result<LoadedImage> {
    open(path, bytes)?.into_loaded(path)
}

//! A SEG-Y file's headers made sense of: lines, times and places of all traces.

use std::path::Path;

use super::SegyInfo;
use super::bytes::SegyBytes;
use super::file_header::SegyFile;
use super::grid::TraceGrid;
use super::line::is_line;
use super::survey_fit::SurveyFit;
use super::trace_headers::{HeaderField, TraceHeaders};
use crate::error::{Cause, Result, cause, io_error};
use crate::image::Geometry;

/// Where line numbers are when they are not at the standard's bytes: field record, trace number,
/// or source point, and CDP.
const OTHER_LINE_BYTES: [[usize; 2]; 3] = [[9, 21], [5, 21], [17, 21]];

/// Remedies that are settings of the reader.
const LINE_BYTES_REMEDY: &str =
    "say at which bytes of the trace headers the inline and crossline numbers are";
const PRESTACK_REMEDY: &str = "stack it first, or say at which bytes of the trace headers the inline and \
crossline numbers are";
const START_TIMES_REMEDY: &str =
    "write it with one start time, or give 0 as the byte of the start time to ignore these";

/// The image axes, the fastest in memory first.
const AXIS_NAMES: [&str; 3] = ["sample", "crossline", "inline"];

/// The fields of all trace headers that are looked at.
fn header_fields(bytes: &SegyBytes) -> Vec<HeaderField> {
    let given = [bytes.inline, bytes.crossline, bytes.x, bytes.y];
    let others = OTHER_LINE_BYTES.concat();
    // Offset, source coordinates.
    let long = given.into_iter().chain(others).chain([37, 73, 77]);
    // Whether a trace is dead.
    let short = [bytes.scalar, bytes.delay, 29];
    let long = long.map(|byte| (byte, 4));
    long.chain(short.map(|byte| (byte, 2)))
        .filter(|(byte, _)| *byte > 0)
        .collect()
}

/// An open SEG-Y file whose headers have been understood.
pub struct SegySurvey {
    /// What the file holds.
    pub info: SegyInfo,
    /// What a user should know about how the file was understood.
    pub notes: Vec<String>,
    /// Why the file cannot be read as a volume or a line.
    pub problem: Option<Cause>,
    pub(super) file: SegyFile,
    pub(super) grid: Option<TraceGrid>,
    pub(super) geometry: Geometry<3>,
}

impl SegySurvey {
    /// Reads and interprets all headers.
    ///
    /// # Errors
    /// [`crate::Error::Io`] if the file cannot be read or its file header makes no sense. What is
    /// wrong with its traces is put into [`SegySurvey::problem`].
    pub fn open(path: &Path, bytes: &SegyBytes) -> Result<Self> {
        bytes.check()?;
        let layout = SegyFile::open(path)?;
        let headers = TraceHeaders::read(&layout, &header_fields(bytes))
            .map_err(|e| io_error(path, "read", e))?;
        let (major, minor) = layout.revision;
        let info = SegyInfo {
            encoding: layout.encoding.to_string(),
            revision: format!("{major}.{minor}"),
            traces: layout.trace_count,
            samples: layout.samples_per_trace,
            dt_ms: None,
            t0_ms: 0.0,
            line_bytes: [bytes.inline, bytes.crossline],
            inlines: None,
            crosslines: None,
            missing: 0,
            duplicates: 0,
            placed_by: String::new(),
            fit: None,
            problem: None,
            text: layout.text_lines.clone(),
        };
        let mut survey = Self {
            info,
            notes: layout.notes.clone(),
            problem: None,
            file: layout,
            grid: None,
            geometry: Geometry {
                names: AXIS_NAMES.map(String::from),
                ..Geometry::default()
            },
        };
        if let Err((problem, remedy)) = survey.interpret(bytes, &headers) {
            survey.info.problem = Some(problem.clone());
            let cause = cause(path.display(), problem, remedy);
            survey.problem = Some(match remedy {
                LINE_BYTES_REMEDY | PRESTACK_REMEDY => cause.with_parameter("inline-byte"),
                START_TIMES_REMEDY => cause.with_parameter("delay-byte"),
                _ => cause,
            });
        }
        Ok(survey)
    }

    /// Whether the traces make a grid whose samples can be read: a volume or a line.
    pub fn has_samples(&self) -> bool {
        self.grid.is_some()
    }

    /// Fills in all that the trace headers say; stops with problem and remedy at the first thing
    /// that keeps the file from being a volume or a line.
    fn interpret(
        &mut self,
        bytes: &SegyBytes,
        headers: &TraceHeaders,
    ) -> std::result::Result<(), (String, &'static str)> {
        if self.file.trace_count > 0 {
            self.find_times(bytes, headers);
        }
        if self.file.trailing_bytes > 0 {
            let problem = format!(
                "is cut off, or its traces differ in length: {} bytes are left over after {} traces of {} samples",
                self.file.trailing_bytes, self.file.trace_count, self.file.samples_per_trace
            );
            return Err((
                problem,
                "copy it again, or write it with traces of one length",
            ));
        }
        match self.file.trace_count {
            0 => {
                return Err((
                    "has no traces".into(),
                    "give a file with a volume or a line",
                ));
            }
            1 => {
                return Err((
                    "has a single trace".into(),
                    "give a file with a volume or a line",
                ));
            }
            _ => {}
        }

        let grid = match self.find_grid(bytes, headers) {
            Ok(grid) => grid,
            Err(problem) if !is_line(bytes, headers) => return Err((problem, LINE_BYTES_REMEDY)),
            Err(problem) => {
                self.notes.push(problem);
                self.set_line(None, bytes, headers);
                return self.start_times_problem(bytes, headers).map_or(Ok(()), Err);
            }
        };
        self.info.inlines = Some(grid.inline);
        self.info.crosslines = Some(grid.crossline);
        if grid.is_prestack() {
            let problem = format!(
                "has several traces in a cell ({} traces in {} cells): it is pre-stack, or the line numbers are not at bytes {} and {}",
                self.file.trace_count,
                grid.traces.len() - grid.missing_count,
                self.info.line_bytes[0],
                self.info.line_bytes[1]
            );
            return Err((problem, PRESTACK_REMEDY));
        }
        self.info.missing = grid.missing_count;
        self.info.duplicates = grid.duplicate_count;
        if grid.missing_count > 0 {
            self.notes.push(format!(
                "{} of {} cells have no trace: filled with zeros",
                grid.missing_count,
                grid.traces.len()
            ));
        }
        if grid.duplicate_count > 0 {
            self.notes.push(format!(
                "{} traces repeat the inline and crossline of an earlier one: the first is kept",
                grid.duplicate_count
            ));
        }
        if grid.is_volume() {
            self.place(bytes, headers, &grid);
            self.grid = Some(grid);
        } else {
            self.set_line(Some(grid), bytes, headers);
        }
        self.start_times_problem(bytes, headers).map_or(Ok(()), Err)
    }

    /// Sample interval and time of the first sample.
    fn find_times(&mut self, bytes: &SegyBytes, headers: &TraceHeaders) {
        let first = |byte: usize| match byte {
            0 => 0,
            byte => headers.first_i16(byte),
        };
        let of_trace = Some(f64::from(first(bytes.dt))).filter(|&dt| dt > 0.0);
        let dt = match (self.file.interval_us, of_trace) {
            (Some(file), Some(trace)) if file != trace => {
                self.notes.push(format!(
                    "the file header's sample interval is {file} us, the first trace's {trace} us: the former is used"
                ));
                Some(file)
            }
            (file, trace) => file.or(trace),
        };
        if dt.is_none() {
            self.notes.push(
                "no header gives the sample interval: the vertical coordinate counts samples"
                    .into(),
            );
        }
        self.info.dt_ms = dt.map(|us| us / 1000.0);

        // Revision 1 added a scalar for times at 215: it divides if negative.
        let delay = f64::from(first(bytes.delay));
        self.info.t0_ms = match first(215) {
            _ if self.file.revision.0 == 0 => delay,
            s @ (1 | 10 | 100 | 1000 | 10000) => delay * f64::from(s),
            s @ (-1 | -10 | -100 | -1000 | -10000) => delay / -f64::from(s),
            _ => delay,
        };
    }

    /// Traces that start at different times are not aligned, and the image would be wrong.
    fn start_times_problem(
        &self,
        bytes: &SegyBytes,
        headers: &TraceHeaders,
    ) -> Option<(String, &'static str)> {
        if bytes.delay == 0 {
            return None;
        }
        // Dead traces (byte 29: 2) often have no times.
        let dead = headers.i16s(29).into_iter().map(|id| id == 2);
        let delays = headers.i16s(bytes.delay).into_iter().zip(dead);
        let alive: Vec<i16> = delays.filter(|d| !d.1).map(|d| d.0).collect();
        let (least, most) = (alive.iter().min()?, alive.iter().max()?);
        (least != most).then(|| {
            (
                format!(
                    "its traces start at different times: from {least} to {most} ms (byte {})",
                    bytes.delay
                ),
                START_TIMES_REMEDY,
            )
        })
    }

    /// The grid by the given line numbers, or, if they are the standard's and make no sense, by
    /// others in use.
    fn find_grid(
        &mut self,
        bytes: &SegyBytes,
        headers: &TraceHeaders,
    ) -> std::result::Result<TraceGrid, String> {
        let offsets = headers.i32s(37);
        let grid = |[inline, crossline]: [usize; 2]| {
            TraceGrid::from_line_numbers(&headers.i32s(inline), &headers.i32s(crossline), &offsets)
        };
        let given = [bytes.inline, bytes.crossline];
        let standard = SegyBytes::default();
        let found = grid(given);
        let Err(problem) = found else {
            return found;
        };
        let problem = format!(
            "its line numbers at bytes {} and {} make no survey: {problem}",
            given[0], given[1]
        );
        if given != [standard.inline, standard.crossline]
            || offsets.iter().any(|o| *o != offsets[0])
        {
            return Err(problem);
        }
        for other in OTHER_LINE_BYTES {
            let convincing = |grid: &TraceGrid| {
                grid.is_volume()
                    && grid.duplicate_count == 0
                    && 2 * grid.missing_count <= grid.traces.len()
            };
            if let Some(grid) = grid(other).ok().filter(convincing) {
                self.notes.push(format!(
                    "{problem}; bytes {} and {} make one and are used instead",
                    other[0], other[1]
                ));
                self.info.line_bytes = other;
                return Ok(grid);
            }
        }
        Err(problem)
    }

    /// Places the survey by the best coordinates there are, the line numbers as the last resort.
    fn place(&mut self, bytes: &SegyBytes, headers: &TraceHeaders, grid: &TraceGrid) {
        let inlines = headers.i32s(self.info.line_bytes[0]);
        let crosslines = headers.i32s(self.info.line_bytes[1]);
        let cells: Vec<[usize; 2]> = inlines
            .iter()
            .zip(&crosslines)
            .map(|(&i, &c)| [grid.inline.index(i), grid.crossline.index(c)])
            .collect();
        let integers = |[x, y]: [usize; 2]| {
            let (x, y) = (headers.i32s(x), headers.i32s(y));
            if (x == inlines && y == crosslines) || (x == crosslines && y == inlines) {
                return Err("only repeat the line numbers".to_string());
            }
            SurveyFit::from_positions(&cells, &scale_coordinates(&x, &y, headers, bytes.scalar))
        };

        let standard = SegyBytes::default();
        let mut tried: Vec<(String, std::result::Result<SurveyFit, String>)> = Vec::new();
        // Where revision 2's floating-point coordinates are given, they supersede the integers.
        if let (Some(x), Some(y)) = (headers.extension_f64s(0), headers.extension_f64s(1)) {
            let positions: Vec<[f64; 2]> = x.into_iter().zip(y).map(|(x, y)| [x, y]).collect();
            if positions.iter().any(|p| *p != [0.0, 0.0]) {
                let fit = SurveyFit::from_positions(&cells, &positions);
                tried.push(("bytes 161 and 169 of trace header extension 1".into(), fit));
            }
        }
        let mut places = vec![[bytes.x, bytes.y]];
        if places[0] == [standard.x, standard.y] {
            places.push([73, 77]);
        }
        for place in places.into_iter().filter(|&[x, _]| x > 0) {
            if tried.iter().any(|(_, fit)| fit.is_ok()) {
                break;
            }
            let name = format!("bytes {} and {}", place[0], place[1]);
            tried.push((name, integers(place)));
        }

        for (name, fit) in tried {
            match fit {
                Ok(fit) => {
                    self.notes.push(format!(
                        "placed by X, Y at {name}: they miss a regular grid by {:.3} rms, {:.3} at most (pitch: inlines {:.3}, crosslines {:.3})",
                        fit.rms, fit.max, fit.line_spacing()[0], fit.line_spacing()[1]
                    ));
                    self.info.placed_by = name;
                    self.info.fit = Some(fit);
                }
                Err(reason) => {
                    self.notes
                        .push(format!("X, Y at {name} {reason}: not used"));
                }
            }
        }
        self.geometry = self.survey_geometry(grid, headers);
    }

    fn survey_geometry(&mut self, grid: &TraceGrid, headers: &TraceHeaders) -> Geometry<3> {
        let (vertical, top, time) = self.vertical_sampling();
        let (origin, crossline, inline, unit) = match &self.info.fit {
            Some(fit) => {
                let placed = (fit.origin, fit.crossline, fit.inline);
                let unit = self.length_unit(headers);
                (placed.0, placed.1, placed.2, unit)
            }
            None => {
                self.notes.push(
                    "no usable X, Y: horizontal coordinates are inline and crossline numbers"
                        .into(),
                );
                self.info.placed_by = "line numbers".into();
                (
                    [grid.inline.first as f64, grid.crossline.first as f64],
                    [0.0, grid.crossline.step as f64],
                    [grid.inline.step as f64, 0.0],
                    "line",
                )
            }
        };
        Geometry {
            origin: [origin[0], origin[1], top],
            axes: [
                [0.0, 0.0, -vertical],
                [crossline[0], crossline[1], 0.0],
                [inline[0], inline[1], 0.0],
            ],
            names: AXIS_NAMES.map(String::from),
            units: [unit, unit, time].map(String::from),
        }
    }
}

impl SegySurvey {
    /// Step and start along the vertical, which goes down, and its unit.
    pub(super) fn vertical_sampling(&self) -> (f64, f64, &'static str) {
        match self.info.dt_ms {
            Some(dt) => (dt, 0.0 - self.info.t0_ms, "ms"), // not -t0, which may be -0
            // Without an interval the start time has no place on an axis that counts samples.
            None => (1.0, 0.0, "sample"),
        }
    }

    /// The unit of X and Y; empty, with a note, where the file does not say.
    pub(super) fn length_unit(&mut self, headers: &TraceHeaders) -> &'static str {
        let unit = match (headers.first_i16(89), self.file.lengths_in_feet) {
            (2, _) => "arcsec",
            (3, _) => "deg",
            (_, Some(true)) => "ft",
            (_, Some(false)) => "m",
            (_, None) => "",
        };
        if unit.is_empty() {
            self.notes
                .push("the file does not say whether X, Y are metres or feet".into());
        }
        unit
    }
}

/// Coordinates with each trace's own scalar: divided if it is negative, multiplied if positive.
pub(super) fn scale_coordinates(
    x: &[i32],
    y: &[i32],
    headers: &TraceHeaders,
    scalar: usize,
) -> Vec<[f64; 2]> {
    let scalars = match scalar {
        0 => vec![1; x.len()],
        byte => headers.i16s(byte),
    };
    let scale = |v: i32, scalar: i16| match scalar {
        0 => f64::from(v),
        s if s < 0 => f64::from(v) / -f64::from(s),
        s => f64::from(v) * f64::from(s),
    };
    x.iter()
        .zip(y)
        .zip(scalars)
        .map(|((&x, &y), s)| [scale(x, s), scale(y, s)])
        .collect()
}

//! Interprets the headers of a SEG-Y file: lines, times and positions of all traces.

use std::path::Path;

use super::SegyInfo;
use super::bytes::SegyBytes;
use super::file_header::SegyFile;
use super::grid::{NO_TRACE, TraceGrid};
use super::infer;
use super::line::is_line;
use super::survey_fit::SurveyFit;
use super::text::{says_depth, says_time, suggests_depth};
use super::trace_headers::{HeaderField, TraceHeaders};
use crate::error::{Cause, Result, cause, io_error};
use crate::image::Geometry;
use crate::progress::ASSUMED;

/// Bytes of line numbers that are tried if those of the standard are not valid: field record, trace
/// number, or source point, each with CDP.
const OTHER_LINE_BYTES: [[usize; 2]; 3] = [[9, 21], [5, 21], [17, 21]];

/// Remedies that are options of the reader.
const LINE_BYTES_REMEDY: &str =
    "give the bytes of the inline and crossline numbers in the trace headers";
const PRESTACK_REMEDY: &str = "stack it first, or give the bytes of the inline and crossline numbers in the \
trace headers";
const START_TIMES_REMEDY: &str =
    "write it with one start time, or give 0 as the byte of the start time to ignore these";

/// Identification code of dead traces, at byte 29.
const DEAD_TRACE: i16 = 2;

/// The image axes, the fastest in memory first.
const AXIS_NAMES: [&str; 3] = ["sample", "crossline", "inline"];

/// Returns the trace header fields that are read.
fn header_fields(bytes: &SegyBytes) -> Vec<HeaderField> {
    let configured = [bytes.inline, bytes.crossline, bytes.x, bytes.y];
    let alternatives = OTHER_LINE_BYTES.concat();
    // Bytes of the offset and of the source coordinates.
    let four_byte = configured
        .into_iter()
        .chain(alternatives)
        .chain([37, 73, 77]);
    // Byte 29 identifies dead traces.
    let two_byte = [bytes.scalar, bytes.delay, 29];
    let four_byte = four_byte.map(|byte| (byte, 4));
    four_byte
        .chain(two_byte.map(|byte| (byte, 2)))
        .filter(|(byte, _)| *byte > 0)
        .collect()
}

/// An open SEG-Y file whose headers have been interpreted.
pub struct SegySurvey {
    /// Contents of the file.
    pub info: SegyInfo,
    /// Messages for the user about the interpretation of the file.
    pub notes: Vec<String>,
    /// Reason why the file cannot be read as a volume or a line.
    pub problem: Option<Cause>,
    pub(super) file: SegyFile,
    pub(super) grid: Option<TraceGrid>,
    /// Inline and crossline number of each trace, if they follow from the coordinates.
    inferred_lines: Option<[Vec<i32>; 2]>,
    pub(super) geometry: Geometry<3>,
}

impl SegySurvey {
    /// Reads and interprets all headers.
    ///
    /// # Errors
    /// Returns a [`crate::Error::Io`] if the file cannot be read or its file header is invalid.
    /// Problems with the traces are stored in [`SegySurvey::problem`] instead.
    pub fn open(path: &Path, bytes: &SegyBytes) -> Result<Self> {
        bytes.check()?;
        let layout = SegyFile::open(path)?;
        let headers = TraceHeaders::read(&layout, &header_fields(bytes))
            .map_err(|e| io_error(path, "read", e))?;
        let (major, minor) = layout.revision;
        let depth_line = layout.text_lines.iter().find(|line| says_depth(line));
        let mut notes = layout.notes.clone();
        if let (None, Some(line)) = (bytes.is_depth, depth_line) {
            notes.push(format!(
                "the textual header says that samples are in depth ({}); --domain time reads two-way time",
                line.trim()
            ));
        }
        let lines = || layout.text_lines.iter();
        let is_unstated = bytes.is_depth.is_none() && depth_line.is_none();
        if is_unstated && !lines().any(|line| says_time(line))
            && let Some(line) = lines().find(|line| suggests_depth(line))
        {
            notes.push(format!(
                "{ASSUMED}samples are in two-way time, although the textual header speaks of depth ({}): --domain \
                 depth or --domain time says it",
                line.trim()
            ));
        }
        let info = SegyInfo {
            encoding: layout.encoding.to_string(),
            revision: format!("{major}.{minor}"),
            traces: layout.trace_count,
            samples: layout.samples_per_trace,
            is_depth: bytes.is_depth.unwrap_or(depth_line.is_some()),
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
            notes,
            problem: None,
            file: layout,
            grid: None,
            inferred_lines: None,
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

    /// Returns `true` if the traces form a grid whose samples can be read: a volume or a line.
    pub fn has_samples(&self) -> bool {
        self.grid.is_some()
    }

    /// Stores all information of the trace headers. Stops with a problem and its remedy at the
    /// first obstacle to reading the file as a volume or a line.
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

        let mut grid = match self.find_grid(bytes, headers) {
            Ok(grid) => grid,
            Err(problem) if !is_line(bytes, headers) => {
                match self.infer_grid(&problem, bytes, headers) {
                    Some(grid) => grid,
                    None => return Err((problem, LINE_BYTES_REMEDY)),
                }
            }
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
        self.drop_dead_traces(headers, &mut grid);
        self.info.missing = grid.missing_count;
        self.info.duplicates = grid.duplicate_count;
        if grid.missing_count > 0 {
            self.notes.push(format!(
                "{} of the {} places on the survey's grid have no trace: they are filled with zeros",
                grid.missing_count,
                grid.traces.len()
            ));
        }
        if grid.duplicate_count > 0 {
            self.notes.push(format!(
                "{} traces have the inline and crossline of an earlier one: the earlier one is kept",
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

    /// Empties the cells of dead traces, unless most traces count as dead: their samples mean nothing.
    fn drop_dead_traces(&mut self, headers: &TraceHeaders, grid: &mut TraceGrid) {
        let is_dead: Vec<bool> = (headers.i16s(29).into_iter())
            .map(|code| code == DEAD_TRACE)
            .collect();
        let is_dead = |trace: usize| trace != NO_TRACE && is_dead[trace];
        let count = grid.traces.iter().filter(|trace| is_dead(**trace)).count();
        let live = grid.traces.len() - grid.missing_count - count;
        if count == 0 {
            return;
        }
        if count > live {
            self.notes.push(format!(
                "{count} traces are dead by their identification code ({DEAD_TRACE} at byte 29), but only {live} are not: the \
                 code is not used"
            ));
            return;
        }
        let dead = grid.traces.iter_mut().filter(|trace| is_dead(**trace));
        dead.for_each(|trace| *trace = NO_TRACE);
        grid.missing_count += count;
        self.notes.push(format!(
            "{count} traces are dead by their identification code ({DEAD_TRACE} at byte 29): they count as missing"
        ));
    }

    /// Sets the sample interval and the time of the first sample.
    fn find_times(&mut self, bytes: &SegyBytes, headers: &TraceHeaders) {
        let first_trace_value = |byte: usize| match byte {
            0 => 0,
            byte => headers.first_i16(byte),
        };
        let interval = first_trace_value(bytes.dt).cast_unsigned();
        let trace_interval = Some(f64::from(interval)).filter(|&dt| dt > 0.0);
        // A value that needs the sign's bit may be meant to be negative, which makes no sense.
        let is_signed = |dt: f64| dt <= f64::from(i16::MAX);
        let dt = match (self.file.interval_us, trace_interval) {
            (Some(file), Some(trace)) if !is_signed(file) && is_signed(trace) => Some(trace),
            (Some(file), Some(trace)) if file != trace => {
                self.notes.push(format!(
                    "the sample interval is {file} us by the file header and {trace} us by the first trace: that of the file header is used"
                ));
                Some(file)
            }
            (file, trace) => file.or(trace),
        };
        if dt.is_none() {
            self.notes.push(
                "no header gives the sample interval, so the vertical coordinate counts samples"
                    .into(),
            );
        }
        // Intervals in depth are in thousandths of the unit, but some writers give whole units.
        const MIN_THOUSANDTHS: f64 = 100.0;
        self.info.dt_ms = dt.map(|interval| {
            if self.info.is_depth && interval < MIN_THOUSANDTHS {
                interval
            } else {
                interval / 1000.0
            }
        });
        if let (true, Some(dt)) = (self.info.is_depth, self.info.dt_ms) {
            self.notes.push(format!("samples are in depth, {dt} apart"));
        }

        // Revision 1 added a scalar for times at byte 215: it divides if negative.
        let delay = f64::from(first_trace_value(bytes.delay));
        self.info.t0_ms = match first_trace_value(215) {
            _ if self.file.revision.0 == 0 => delay,
            s @ (1 | 10 | 100 | 1000 | 10000) => delay * f64::from(s),
            s @ (-1 | -10 | -100 | -1000 | -10000) => delay / -f64::from(s),
            _ => delay,
        };
    }

    /// Returns a problem and its remedy if traces start at different times: the image would be
    /// misaligned.
    fn start_times_problem(
        &self,
        bytes: &SegyBytes,
        headers: &TraceHeaders,
    ) -> Option<(String, &'static str)> {
        if bytes.delay == 0 {
            return None;
        }
        // Dead traces (value 2 at byte 29) often have no times.
        let is_dead = headers.i16s(29).into_iter().map(|code| code == DEAD_TRACE);
        let delays = headers.i16s(bytes.delay).into_iter().zip(is_dead);
        let live_delays: Vec<i16> = delays.filter(|d| !d.1).map(|d| d.0).collect();
        let (min, max) = (live_delays.iter().min()?, live_delays.iter().max()?);
        (min != max).then(|| {
            (
                format!(
                    "its traces start at different times: from {min} to {max} ms (byte {})",
                    bytes.delay
                ),
                START_TIMES_REMEDY,
            )
        })
    }

    /// Returns the grid of the configured line numbers. If these are the standard bytes and are not
    /// valid, other common bytes are tried.
    fn find_grid(
        &mut self,
        bytes: &SegyBytes,
        headers: &TraceHeaders,
    ) -> std::result::Result<TraceGrid, String> {
        let offsets = headers.i32s(37);
        let grid = |[inline, crossline]: [usize; 2]| {
            TraceGrid::from_line_numbers(&headers.i32s(inline), &headers.i32s(crossline), &offsets)
        };
        let line_bytes = [bytes.inline, bytes.crossline];
        let standard = SegyBytes::default();
        let result = grid(line_bytes);
        let Err(problem) = result else {
            return result;
        };
        let problem = format!(
            "its line numbers at bytes {} and {} do not form a survey: {problem}",
            line_bytes[0], line_bytes[1]
        );
        if line_bytes != [standard.inline, standard.crossline]
            || offsets.iter().any(|o| *o != offsets[0])
        {
            return Err(problem);
        }
        for alternative in OTHER_LINE_BYTES {
            let is_convincing = |grid: &TraceGrid| {
                grid.is_volume()
                    && grid.duplicate_count == 0
                    && 2 * grid.missing_count <= grid.traces.len()
            };
            if let Some(grid) = grid(alternative).ok().filter(is_convincing) {
                self.notes.push(format!(
                    "{problem}; bytes {} and {} do, and are used instead",
                    alternative[0], alternative[1]
                ));
                self.info.line_bytes = alternative;
                return Ok(grid);
            }
        }
        Err(problem)
    }

    /// Returns the grid that the coordinates of traces without line numbers form, if they do. It has
    /// lines from 1.
    fn infer_grid(
        &mut self,
        problem: &str,
        bytes: &SegyBytes,
        headers: &TraceHeaders,
    ) -> Option<TraceGrid> {
        let (offsets, standard) = (headers.i32s(37), SegyBytes::default());
        let is_stacked = offsets.iter().all(|offset| *offset == offsets[0]);
        if !is_stacked || [bytes.inline, bytes.crossline] != [standard.inline, standard.crossline] {
            return None;
        }
        let mut byte_pairs = vec![[bytes.x, bytes.y]];
        if byte_pairs[0] == [standard.x, standard.y] {
            byte_pairs.push([73, 77]);
        }
        byte_pairs
            .into_iter()
            .filter(|&[x, _]| x > 0)
            .find_map(|[x, y]| {
                let (xs, ys) = (headers.i32s(x), headers.i32s(y));
                let positions = scale_coordinates(&xs, &ys, headers, bytes.scalar);
                let [inlines, crosslines] = infer::line_numbers(&positions)?;
                let grid = TraceGrid::from_line_numbers(&inlines, &crosslines, &offsets).ok()?;
                self.notes.push(format!(
                "{problem}; {} x {} lines, numbered from 1, follow from X, Y at bytes {x} and {y}",
                grid.inline.count, grid.crossline.count
            ));
                self.info.line_bytes = [0; 2];
                self.inferred_lines = Some([inlines, crosslines]);
                Some(grid)
            })
    }

    /// Places the survey by the best available coordinates, or by line numbers if there are none.
    fn place(&mut self, bytes: &SegyBytes, headers: &TraceHeaders, grid: &TraceGrid) {
        let [inlines, crosslines] = match self.inferred_lines.take() {
            Some(lines) => lines,
            None => self.info.line_bytes.map(|byte| headers.i32s(byte)),
        };
        let cells: Vec<[usize; 2]> = inlines
            .iter()
            .zip(&crosslines)
            .map(|(&i, &c)| [grid.inline.index(i), grid.crossline.index(c)])
            .collect();
        let fit_integers = |[x, y]: [usize; 2]| {
            let (x, y) = (headers.i32s(x), headers.i32s(y));
            if (x == inlines && y == crosslines) || (x == crosslines && y == inlines) {
                return Err("only repeat the line numbers".to_string());
            }
            SurveyFit::from_positions(&cells, &scale_coordinates(&x, &y, headers, bytes.scalar))
        };

        let standard = SegyBytes::default();
        let mut tried: Vec<(String, std::result::Result<SurveyFit, String>)> = Vec::new();
        // Floating-point coordinates of revision 2 supersede the integers, where they are given.
        if let (Some(x), Some(y)) = (headers.extension_f64s(0), headers.extension_f64s(1)) {
            let positions: Vec<[f64; 2]> = x.into_iter().zip(y).map(|(x, y)| [x, y]).collect();
            if positions.iter().any(|p| *p != [0.0, 0.0]) {
                let fit = SurveyFit::from_positions(&cells, &positions);
                tried.push(("bytes 161 and 169 of trace header extension 1".into(), fit));
            }
        }
        let mut byte_pairs = vec![[bytes.x, bytes.y]];
        if byte_pairs[0] == [standard.x, standard.y] {
            byte_pairs.push([73, 77]);
        }
        for pair in byte_pairs.into_iter().filter(|&[x, _]| x > 0) {
            if tried.iter().any(|(_, fit)| fit.is_ok()) {
                break;
            }
            let name = format!("bytes {} and {}", pair[0], pair[1]);
            tried.push((name, fit_integers(pair)));
        }

        for (name, fit) in tried {
            match fit {
                Ok(fit) => {
                    self.notes.push(format!(
                        "placed by X, Y at {name}: a regular grid with inlines {:.3} and crosslines {:.3} apart fits them to {:.3} \
                         (rms), {:.3} at most",
                        fit.line_spacing()[0],
                        fit.line_spacing()[1],
                        fit.rms,
                        fit.max
                    ));
                    if fit.outliers > 0 {
                        self.notes.push(format!(
                            "{} traces have X, Y far off that grid, which do not count",
                            fit.outliers
                        ));
                    }
                    self.info.placed_by = name;
                    self.info.fit = Some(fit);
                }
                Err(reason) => {
                    self.notes
                        .push(format!("X, Y at {name} are not used: they {reason}"));
                }
            }
        }
        self.geometry = self.survey_geometry(grid, headers);
    }

    fn survey_geometry(&mut self, grid: &TraceGrid, headers: &TraceHeaders) -> Geometry<3> {
        let (vertical, top, time_unit) = self.vertical_sampling();
        let (origin, crossline, inline, unit) = match &self.info.fit {
            Some(fit) => {
                let placed = (fit.origin, fit.crossline, fit.inline);
                let unit = self.length_unit(headers);
                (placed.0, placed.1, placed.2, unit)
            }
            None => {
                self.notes.push(
                    "the trace headers have no usable X, Y: horizontal coordinates are inline and crossline numbers, not metres"
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
            units: [unit, unit, time_unit].map(String::from),
        }
    }
}

impl SegySurvey {
    /// Returns the step and start along the vertical, which points downwards, and its unit.
    pub(super) fn vertical_sampling(&self) -> (f64, f64, &'static str) {
        let unit = match (self.info.is_depth, self.file.lengths_in_feet) {
            (false, _) => "ms",
            (true, Some(true)) => "ft",
            (true, _) => "m",
        };
        match self.info.dt_ms {
            Some(dt) => (dt, 0.0 - self.info.t0_ms, unit), // not -t0, which may be -0
            // Without an interval the axis counts samples, so that the start time does not apply.
            None => (1.0, 0.0, "sample"),
        }
    }

    /// Returns the unit of X and Y. If the file does not say, the unit is empty and a note is
    /// added.
    pub(super) fn length_unit(&mut self, headers: &TraceHeaders) -> &'static str {
        let unit = match (headers.first_i16(89), self.file.lengths_in_feet) {
            (2, _) => "arcsec",
            (3, _) => "deg",
            (_, Some(true)) => "ft",
            (_, Some(false)) => "m",
            (_, None) => "",
        };
        if unit.is_empty() {
            self.notes.push(
                "the file does not say whether X, Y are metres or feet (--unit says it)".into(),
            );
        }
        unit
    }
}

/// Applies the scalar of each trace to its coordinates: a negative scalar divides, a positive one
/// multiplies.
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

//! 2-D lines: traces along a path, in the order of the file.

use super::bytes::SegyBytes;
use super::grid::{LineNumbers, NO_TRACE, TraceGrid};
use super::survey::{SegySurvey, scale_coordinates};
use super::trace_headers::TraceHeaders;
use crate::geometry::statistics::upper_median;
use crate::geometry::{dot, norm};
use crate::image::Geometry;

/// Largest ratio between a step and the median step along a line. A longer step leads to another
/// line.
const MAX_STEP_RATIO: f64 = 10.0;

/// Smallest cosine of the angle between a step and the next. Lines bend, but do not turn back.
const MIN_STEP_COSINE: f64 = 0.1;

/// Largest deviation of steps from their mean, relative to the mean, that is not reported.
const MAX_STEP_DEVIATION: f64 = 0.01;

/// Steps from trace to trace along a line.
struct TraceSteps {
    /// First bytes of the coordinates that were used.
    coordinate_bytes: [usize; 2],
    lengths: Vec<f64>,
    /// `true` if a step leads away from the line: backwards, sideways, or far away.
    leaves_line: bool,
}

impl TraceSteps {
    /// Computes the steps from the first coordinates in the headers that differ from trace to
    /// trace.
    fn from_headers(bytes: &SegyBytes, headers: &TraceHeaders) -> Option<Self> {
        let standard = SegyBytes::default();
        let mut byte_pairs = vec![[bytes.x, bytes.y]];
        if byte_pairs[0] == [standard.x, standard.y] {
            byte_pairs.push([73, 77]);
        }
        let byte_pairs = byte_pairs.into_iter().filter(|&[x, _]| x > 0);
        byte_pairs
            .map(|pair| Self::from_coordinates(pair, bytes, headers))
            .find(|steps| {
                // At most one step in a hundred may have the length zero.
                let zero_steps = steps.lengths.iter().filter(|length| **length == 0.0);
                100 * zero_steps.count() <= steps.lengths.len()
            })
    }

    fn from_coordinates([x, y]: [usize; 2], bytes: &SegyBytes, headers: &TraceHeaders) -> Self {
        let positions =
            scale_coordinates(&headers.i32s(x), &headers.i32s(y), headers, bytes.scalar);
        let step = |p: &[[f64; 2]]| [p[1][0] - p[0][0], p[1][1] - p[0][1]];
        let steps: Vec<[f64; 2]> = positions.windows(2).map(step).collect();
        let lengths: Vec<f64> = steps.iter().map(|&step| norm(step)).collect();
        let median = upper_median(&mut lengths.clone()).unwrap_or(0.0);
        let jumps = lengths
            .iter()
            .any(|&length| length > MAX_STEP_RATIO * median);
        let moves: Vec<[f64; 2]> = steps.into_iter().filter(|s| *s != [0.0; 2]).collect();
        let turns = moves
            .windows(2)
            .any(|s| dot(s[0], s[1]) < MIN_STEP_COSINE * norm(s[0]) * norm(s[1]));
        Self {
            coordinate_bytes: [x, y],
            lengths,
            leaves_line: jumps || turns,
        }
    }
}

/// Returns `true` if traces whose numbers do not form a survey are those of a line: they are
/// stacked, and are placed along a path or numbered consecutively.
pub(super) fn is_line(bytes: &SegyBytes, headers: &TraceHeaders) -> bool {
    let offsets = headers.i32s(37);
    let is_stacked = offsets.iter().all(|offset| *offset == offsets[0]);
    let is_evenly_numbered = |numbers: Vec<i32>| {
        let step = |pair: &[i32]| i64::from(pair[1]) - i64::from(pair[0]);
        let mut steps = numbers.windows(2).map(step);
        let first = steps.next().unwrap_or(0);
        first != 0 && first.abs() <= 16 && steps.all(|step| step == first)
    };
    let path = TraceSteps::from_headers(bytes, headers);
    let standard = SegyBytes::default();
    // Bytes that the user gives are used as they are.
    let has_default_bytes =
        [bytes.inline, bytes.crossline] == [standard.inline, standard.crossline];
    has_default_bytes
        && is_stacked
        && path.map_or_else(
            || is_evenly_numbered(headers.i32s(21)),
            |path| !path.leaves_line,
        )
}

impl SegySurvey {
    /// Uses the traces as a line. Traces of a single inline or crossline are arranged by their
    /// numbers, which may have gaps; other traces keep the order of the file.
    pub(super) fn set_line(
        &mut self,
        candidate: Option<TraceGrid>,
        bytes: &SegyBytes,
        headers: &TraceHeaders,
    ) {
        let count = self.file.trace_count;
        let (grid, name) = match candidate {
            Some(grid) if grid.inline.count == 1 => (grid, "crossline"),
            Some(grid) if grid.crossline.count == 1 => {
                let transposed = TraceGrid {
                    inline: grid.crossline,
                    crossline: grid.inline,
                    ..grid
                };
                (transposed, "inline")
            }
            _ => {
                let lines = |count: usize| LineNumbers {
                    first: 1,
                    step: 1,
                    count: count as u64,
                };
                let grid = TraceGrid {
                    inline: lines(1),
                    crossline: lines(count),
                    traces: (0..count).collect(),
                    missing_count: 0,
                    duplicate_count: 0,
                    other_offset_count: 0,
                };
                (grid, "trace")
            }
        };
        self.info.missing = grid.missing_count;
        self.info.duplicates = grid.duplicate_count;
        self.geometry = self.line_geometry(&grid, name, bytes, headers);
        self.grid = Some(grid);
    }

    /// Returns the geometry of a line: distance along the line horizontally, time downwards.
    fn line_geometry(
        &mut self,
        grid: &TraceGrid,
        name: &str,
        bytes: &SegyBytes,
        headers: &TraceHeaders,
    ) -> Geometry<3> {
        let (vertical, top, time_unit) = self.vertical_sampling();
        // The line extends from the first cell with a trace to the last, including gaps.
        let has_trace = |&(_, &trace): &(usize, &usize)| trace != NO_TRACE;
        let cells: Vec<usize> = grid
            .traces
            .iter()
            .enumerate()
            .filter(has_trace)
            .map(|c| c.0)
            .collect();
        let span = cells.last().unwrap_or(&0) - cells.first().unwrap_or(&0);
        let steps =
            TraceSteps::from_headers(bytes, headers).filter(|steps| span > 0 && !steps.leaves_line);
        let (pitch, unit) = match steps {
            Some(steps) => {
                let length: f64 = steps.lengths.iter().sum();
                let pitch = length / span as f64;
                let deviation = |step: &f64| (step - pitch).abs();
                let max_deviation = steps.lengths.iter().map(deviation).fold(0.0, f64::max);
                let [x, y] = steps.coordinate_bytes;
                let mut note = format!(
                    "a 2-D line: {} traces over {length:.1} by X, Y at bytes {x} and {y}, {pitch:.3} apart",
                    cells.len()
                );
                if max_deviation > MAX_STEP_DEVIATION * pitch && grid.missing_count == 0 {
                    note += &format!(
                        " on average, though steps differ from that by up to {max_deviation:.3}"
                    );
                }
                self.notes.push(note);
                self.info.placed_by = format!("bytes {x} and {y}");
                (pitch, self.length_unit(headers))
            }
            None => {
                self.notes.push(format!(
                    "a 2-D line without usable X, Y: positions along it are {name} numbers"
                ));
                self.info.placed_by = "trace numbers".into();
                (grid.crossline.step as f64, "trace")
            }
        };
        Geometry {
            origin: [0.0, 0.0, top],
            axes: [[0.0, 0.0, -vertical], [pitch, 0.0, 0.0], [0.0, pitch, 0.0]],
            names: ["sample", name, "line"].map(String::from),
            units: [unit, unit, time_unit].map(String::from),
        }
    }
}

//! 2-D lines: traces along a path, in the order in which they stand in the file.

use super::bytes::SegyBytes;
use super::grid::{Grid, Lines, MISSING};
use super::headers::Headers;
use super::survey::{Survey, scaled};
use crate::geometry::{dot, norm};
use crate::image::Geometry;

/// Steps between neighbouring traces that are so many times as long as most lead to another line.
const JUMP: f64 = 10.0;

/// The least cosine of the angle between a step and the next: lines bend, but do not turn.
const AHEAD: f64 = 0.1;

/// Where steps differ from their mean by more than this share, a user is told.
const UNEVEN: f64 = 0.01;

/// Steps from trace to trace along a line.
struct Steps {
    /// By the coordinates at these bytes.
    bytes: [usize; 2],
    lengths: Vec<f64>,
    /// Whether one leads elsewhere than along a line: back, aside, or far away.
    strays: bool,
}

impl Steps {
    /// By the first coordinates that lead from trace to trace.
    fn of(bytes: &SegyBytes, headers: &Headers) -> Option<Self> {
        let standard = SegyBytes::default();
        let mut places = vec![[bytes.x, bytes.y]];
        if places[0] == [standard.x, standard.y] {
            places.push([73, 77]);
        }
        let places = places.into_iter().filter(|&[x, _]| x > 0);
        places
            .map(|place| Self::by(place, bytes, headers))
            .find(|steps| {
                // At most one in a hundred stands where the one before it does.
                let none = steps.lengths.iter().filter(|length| **length == 0.0);
                100 * none.count() <= steps.lengths.len()
            })
    }

    fn by([x, y]: [usize; 2], bytes: &SegyBytes, headers: &Headers) -> Self {
        let positions = scaled(&headers.i32s(x), &headers.i32s(y), headers, bytes.scalar);
        let step = |p: &[[f64; 2]]| [p[1][0] - p[0][0], p[1][1] - p[0][1]];
        let steps: Vec<[f64; 2]> = positions.windows(2).map(step).collect();
        let lengths: Vec<f64> = steps.iter().map(|&step| norm(step)).collect();
        let mut sorted = lengths.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
        let jumps = sorted.last().is_some_and(|&last| last > JUMP * median);
        let moves: Vec<[f64; 2]> = steps.into_iter().filter(|s| *s != [0.0; 2]).collect();
        let turns = moves
            .windows(2)
            .any(|s| dot(s[0], s[1]) < AHEAD * norm(s[0]) * norm(s[1]));
        Self {
            bytes: [x, y],
            lengths,
            strays: jumps || turns,
        }
    }
}

/// Whether traces whose numbers make no survey are those of a line: they are stacked, and numbered one
/// after the other or placed along a path.
pub(super) fn is_line(bytes: &SegyBytes, headers: &Headers) -> bool {
    let offsets = headers.i32s(37);
    let stacked = offsets.iter().all(|offset| *offset == offsets[0]);
    let rises = |numbers: Vec<i32>| {
        let step = |pair: &[i32]| i64::from(pair[1]) - i64::from(pair[0]);
        let mut steps = numbers.windows(2).map(step);
        let first = steps.next().unwrap_or(0);
        first != 0 && first.abs() <= 16 && steps.all(|step| step == first)
    };
    let path = Steps::of(bytes, headers);
    let standard = SegyBytes::default();
    // Bytes that a user gives are not second-guessed.
    let by_default = [bytes.inline, bytes.crossline] == [standard.inline, standard.crossline];
    by_default && stacked && path.map_or_else(|| rises(headers.i32s(21)), |path| !path.strays)
}

impl Survey {
    /// Takes traces as those of a line: those of a single inline or crossline by its numbers, which may have
    /// gaps; others in the order of the file.
    pub(super) fn take_line(&mut self, found: Option<Grid>, bytes: &SegyBytes, headers: &Headers) {
        let count = self.layout.traces;
        let (grid, name) = match found {
            Some(grid) if grid.inline.count == 1 => (grid, "crossline"),
            Some(grid) if grid.crossline.count == 1 => {
                let turned = Grid {
                    inline: grid.crossline,
                    crossline: grid.inline,
                    ..grid
                };
                (turned, "inline")
            }
            _ => {
                let lines = |count: usize| Lines {
                    first: 1,
                    step: 1,
                    count: count as u64,
                };
                let grid = Grid {
                    inline: lines(1),
                    crossline: lines(count),
                    trace: (0..count).collect(),
                    missing: 0,
                    duplicates: 0,
                    other_offset: 0,
                };
                (grid, "trace")
            }
        };
        self.info.missing = grid.missing;
        self.info.duplicates = grid.duplicates;
        self.geometry = self.geometry_of_line(&grid, name, bytes, headers);
        self.grid = Some(grid);
    }

    /// Distances along the line across, times down.
    fn geometry_of_line(
        &mut self,
        grid: &Grid,
        name: &str,
        bytes: &SegyBytes,
        headers: &Headers,
    ) -> Geometry<3> {
        let (vertical, top, time) = self.times();
        // From the first cell with a trace to the last, whatever is missing between.
        let filled = |&(_, &trace): &(usize, &usize)| trace != MISSING;
        let cells: Vec<usize> = grid
            .trace
            .iter()
            .enumerate()
            .filter(filled)
            .map(|c| c.0)
            .collect();
        let span = cells.last().unwrap_or(&0) - cells.first().unwrap_or(&0);
        let steps = Steps::of(bytes, headers).filter(|steps| span > 0 && !steps.strays);
        let (pitch, unit) = match steps {
            Some(steps) => {
                let length: f64 = steps.lengths.iter().sum();
                let pitch = length / span as f64;
                let off = |step: &f64| (step - pitch).abs();
                let most = steps.lengths.iter().map(off).fold(0.0, f64::max);
                let [x, y] = steps.bytes;
                let mut note = format!(
                    "a 2-D line: {} traces over {length:.1} by X, Y at bytes {x} and {y}, {pitch:.3} apart",
                    cells.len()
                );
                if most > UNEVEN * pitch && grid.missing == 0 {
                    note +=
                        &format!(" on average, though steps differ from that by up to {most:.3}");
                }
                self.notes.push(note);
                self.info.placed_by = format!("bytes {x} and {y}");
                (pitch, self.unit_of_length(headers))
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
            units: [unit, unit, time].map(String::from),
        }
    }
}

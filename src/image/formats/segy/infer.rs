//! Infers the lines of a survey without line numbers from the coordinates of its traces.
//!
//! Traces are expected line by line: steps from trace to trace are alike within a line, and lines are
//! parallel and evenly spaced. The mean step of the longest line and the distance of neighbouring
//! lines give the cell of each trace; a least-squares fit to all traces then corrects both.

use super::grid::TraceGrid;
use super::survey_fit::SurveyFit;
use crate::geometry::statistics::upper_median;
use crate::geometry::{dot, norm, sub};

/// Largest difference of a step from the first step of its line, relative to that step. Coordinates
/// may be rounded.
const MAX_STEP_DEVIATION: f64 = 0.3;

/// Fewest traces of the longest line, and fewest lines.
const MIN_COUNT: usize = 3;

/// Returns the inline and the crossline number of each trace, from 1, if traces at these positions
/// form a survey.
pub fn line_numbers(positions: &[[f64; 2]]) -> Option<[Vec<i32>; 2]> {
    let lines = split_lines(positions);
    let longest = lines.iter().max_by_key(|line| line.len())?;
    if longest.len() < MIN_COUNT || lines.len() < MIN_COUNT {
        return None;
    }
    let steps = (longest.len() - 1) as f64;
    let along = sub(positions[longest.end - 1], positions[longest.start]).map(|c| c / steps);
    let pitch = norm(along);
    if pitch == 0.0 {
        return None;
    }
    let first = positions[longest.start];
    let across = [-along[1] / pitch, along[0] / pitch];
    // Position of each line across, and the step from line to line.
    let offset = |line: &std::ops::Range<usize>| {
        let sum: f64 = line
            .clone()
            .map(|t| dot(sub(positions[t], first), across))
            .sum();
        sum / line.len() as f64
    };
    let mut offsets: Vec<f64> = lines.iter().map(offset).collect();
    offsets.sort_by(f64::total_cmp);
    let gaps = offsets.windows(2).map(|pair| pair[1] - pair[0]);
    let mut gaps: Vec<f64> = gaps.filter(|gap| *gap > 0.05 * pitch).collect();
    let gap = upper_median(&mut gaps)?;
    let span = offsets[offsets.len() - 1] - offsets[0];
    let spacing = span / (span / gap).round().max(1.0);
    let cell = |p: &[f64; 2]| {
        let r = sub(*p, first);
        [dot(r, across) / spacing, dot(r, along) / (pitch * pitch)]
    };
    let mut cells: Vec<[i64; 2]> = (positions.iter())
        .map(|p| cell(p).map(|c| c.round() as i64))
        .collect();
    for _ in 0..3 {
        let indices = from_zero(&cells)?;
        let fit = SurveyFit::from_positions(&indices, positions).ok()?;
        let [a, b] = [fit.inline, fit.crossline];
        let area = a[0] * b[1] - a[1] * b[0];
        let refined = positions.iter().map(|p| {
            let r = sub(*p, fit.origin);
            [
                (r[0] * b[1] - r[1] * b[0]) / area,
                (a[0] * r[1] - a[1] * r[0]) / area,
            ]
            .map(|c| c.round() as i64)
        });
        cells = refined.collect();
    }
    let indices = from_zero(&cells)?;
    let numbers = |k: usize| -> Option<Vec<i32>> {
        let numbers = indices.iter().map(|cell| i32::try_from(cell[k] + 1).ok());
        numbers.collect()
    };
    let [inlines, crosslines] = [numbers(0)?, numbers(1)?];
    let grid = TraceGrid::from_line_numbers(&inlines, &crosslines, &vec![0; inlines.len()]).ok()?;
    let is_survey = grid.is_volume()
        && grid.duplicate_count == 0
        && 2 * grid.missing_count <= grid.traces.len();
    is_survey.then_some([inlines, crosslines])
}

/// Divides traces into lines, in each of which all steps are like the first.
fn split_lines(positions: &[[f64; 2]]) -> Vec<std::ops::Range<usize>> {
    let mut lines: Vec<std::ops::Range<usize>> = Vec::new();
    let mut start = 0;
    while start < positions.len() {
        let mut end = start + 1;
        if end < positions.len() {
            let first = sub(positions[end], positions[start]);
            let is_alike = |t: usize| {
                let difference = sub(sub(positions[t], positions[t - 1]), first);
                norm(difference) <= MAX_STEP_DEVIATION * norm(first)
            };
            while end < positions.len() && is_alike(end) {
                end += 1;
            }
        }
        lines.push(start..end);
        start = end;
    }
    lines
}

/// Returns cells counted from the smallest along each axis.
fn from_zero(cells: &[[i64; 2]]) -> Option<Vec<[usize; 2]>> {
    let low = [0, 1].map(|k| cells.iter().map(|cell| cell[k]).min());
    let low = [low[0]?, low[1]?];
    let index = |cell: &[i64; 2]| -> Option<[usize; 2]> {
        let [i, c] = [0, 1].map(|k| usize::try_from(cell[k].checked_sub(low[k])?).ok());
        Some([i?, c?])
    };
    cells.iter().map(index).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the positions of a rotated survey, rounded to multiples of `rounding`.
    fn survey([inlines, crosslines]: [usize; 2], rounding: f64, back: bool) -> Vec<[f64; 2]> {
        let (sin, cos) = 0.35f64.sin_cos();
        let mut positions = Vec::new();
        for i in 0..inlines {
            for c in 0..crosslines {
                let c = if back && i % 2 == 1 {
                    crosslines - 1 - c
                } else {
                    c
                };
                let (a, b) = (25.0 * i as f64, 12.5 * c as f64);
                let position = [
                    620_000.0 + a * cos - b * sin,
                    6_070_000.0 + a * sin + b * cos,
                ];
                positions.push(position.map(|x| (x / rounding).round() * rounding));
            }
        }
        positions
    }

    #[test]
    fn lines_are_numbered_by_position() {
        for rounding in [0.01, 1.0] {
            let positions = survey([40, 36], rounding, false);
            let [inlines, crosslines] = line_numbers(&positions).unwrap();
            for t in 0..positions.len() {
                // The direction in which lines are counted is free.
                assert_eq!(crosslines[t] as usize, t % 36 + 1, "{rounding}");
                let i = inlines[t] as usize;
                assert!(i == t / 36 + 1 || i == 40 - t / 36, "{rounding}: {i}");
            }
        }
        // Lines that run to and fro, and missing traces.
        let mut positions = survey([21, 30], 0.01, true);
        positions.remove(317);
        let [inlines, crosslines] = line_numbers(&positions).unwrap();
        let max = |numbers: &[i32]| numbers.iter().copied().max();
        assert_eq!((max(&inlines), max(&crosslines)), (Some(21), Some(30)));
    }

    #[test]
    fn other_positions_are_no_survey() {
        let line: Vec<[f64; 2]> = (0..200).map(|t| [25.0 * f64::from(t), 0.0]).collect();
        assert_eq!(line_numbers(&line), None);
        assert_eq!(line_numbers(&[[0.0; 2]; 50]), None);
        let mut random = crate::geometry::random::Random::new(5);
        let scattered: Vec<[f64; 2]> = (0..300)
            .map(|_| [random.range(0.0, 1000.0), random.range(0.0, 1000.0)])
            .collect();
        assert_eq!(line_numbers(&scattered), None);
    }
}

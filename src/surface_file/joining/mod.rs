//! Joins the sticks of a fault to a surface by where they lie, whatever their order and direction.
//!
//! 1. Sticks of one point are left out. A stick that lies on another is merged with it, and sticks
//!    that continue one another become one line.
//! 2. A stick that lies far off the plane of its neighbours, which themselves lie in a plane, is
//!    left out; if there are many such sticks, it is unclear which belong, and that is an error.
//! 3. The lines are ordered by the shortest path that visits each of them once. The distance of two
//!    lines is measured across them, so that it does not depend on where they start and end.
//! 4. If neighbours on the path are nearly parallel and do not cross, strips of triangles join them
//!    (`strip`). The surface is interrupted where neighbours are more than four times as far
//!    apart as usual, and where it would fold. If it folds at several places, it is unclear which
//!    sticks belong, and that is an error.
//! 5. Otherwise, as where sticks lie on lines and on slices, the places along all of them are joined
//!    in the direction that is perpendicular to them (`scattered`).
//!
//! All of it is done in metres. Notes say which sticks were left out.

use crate::geometry::statistics::lower_quantile;

mod line;
mod order;
mod scattered;
mod screening;
mod strip;
#[cfg(test)]
mod tests;

use self::line::{Line, Point};
use self::order::Distances;
use self::scattered::join_crossing_lines;
use self::screening::{
    MAX_GAP_RATIO, Merged, Misfit, find_misfit, merge_continuations, merge_duplicates,
    offset_between, usual_spacing,
};
use self::strip::join_lines;
use super::sticks::Stick;
use crate::Error;
use crate::error::{Result, cause};
use crate::geometry::{dot, norm};

/// Smallest cosine of the angle between neighbouring sticks that a strip joins (40 degrees).
const MIN_PARALLEL_COSINE: f64 = 0.766;

/// Length of a stick, in units of the spacing, below which its direction does not count.
const SHORT_RATIO: f64 = 0.3;

/// Distance between places on the sides of a strip, in units of the spacing.
const STRIP_STEP_RATIO: f64 = 0.5;

/// Largest number of places that are added to one side of a strip.
const MAX_ADDED_PLACES: f64 = 64.0;

/// Largest cosine of the angle between steps from stick to stick where a surface folds (75 degrees):
/// it is interrupted at the longer step.
const MAX_FOLD_COSINE: f64 = 0.26;

/// Share of the steps from stick to stick that are not longer than the usual one.
const USUAL_STEP_SHARE: f64 = 0.8;

/// Share of the sticks that may be left out because they cannot belong.
const MAX_MISFIT_SHARE: f64 = 0.2;

/// Number of sticks that a note names.
const NAMED_STICKS: usize = 5;

/// The surface of a fault.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JoinedSticks {
    /// Triangles in the coordinates of the sticks.
    pub triangles: Vec<[[f64; 3]; 3]>,
    /// Notes for the user, each one line.
    pub notes: Vec<String>,
}

/// Joins the sticks of one fault to a surface, as the head of this module says. `fault` is its name
/// for messages, and `metres_per_unit` the number of metres in a unit of each coordinate.
///
/// # Errors
/// Returns [`Error::Job`] if the sticks span no surface, or if it is unclear which of them belong to
/// it.
pub fn join_sticks(
    fault: &str,
    sticks: &[Stick],
    metres_per_unit: [f64; 3],
) -> Result<JoinedSticks> {
    let in_metres = |p: &Point| std::array::from_fn(|k| p[k] * metres_per_unit[k]);
    let line =
        |(i, stick): (usize, &Stick)| Line::new(i, stick.points.iter().map(in_metres).collect());
    let mut notes = Notes {
        fault,
        sticks,
        texts: Vec::new(),
    };
    let mut lines: Vec<Line> = sticks.iter().enumerate().map(line).collect();
    notes.single_points(&lines);
    lines.retain(|line| line.length > 0.0);
    let mut merged = merge_duplicates(&mut lines);
    let spacing = usual_spacing(&lines);
    merged.extend(merge_continuations(&mut lines, spacing));
    notes.merged(&merged);
    let count = lines.len() as f64;
    let misfits = remove_misfits(&mut lines, spacing);
    if misfits.len() > 1 && misfits.len() as f64 > MAX_MISFIT_SHARE * count {
        return notes.refuse_unclear(misfits.iter().map(|(stick, _)| *stick).collect());
    }
    notes.misfits(&misfits);
    let triangles = if lines.len() < 2 {
        Vec::new()
    } else {
        join(lines, spacing, &mut notes)?
    };
    if triangles.is_empty() {
        let problem = format!("its {} sticks span no surface", sticks.len());
        let problem = if sticks.len() == 1 {
            "is a single stick".into()
        } else {
            problem
        };
        return notes.refuse(problem, "give at least two sticks side by side");
    }
    let in_units = |p: Point| std::array::from_fn(|k| p[k] / metres_per_unit[k]);
    Ok(JoinedSticks {
        triangles: triangles.into_iter().map(|t| t.map(in_units)).collect(),
        notes: notes.texts,
    })
}

/// Removes the lines that cannot belong. Returns the first stick of each.
fn remove_misfits(lines: &mut Vec<Line>, spacing: f64) -> Vec<(usize, Misfit)> {
    let mut misfits = Vec::new();
    while let Some(misfit) = find_misfit(lines, spacing) {
        misfits.push((lines.remove(misfit.line).sticks[0], misfit));
    }
    misfits
}

/// Joins at least two lines by strips, or as scattered places.
fn join(mut lines: Vec<Line>, spacing: f64, notes: &mut Notes) -> Result<Vec<[Point; 3]>> {
    let distances = Distances::new(lines.len(), |i, j| {
        let offset = offset_between(&lines[i], &lines[j]);
        offset.mean.max(offset.gap)
    });
    let path = distances.path();
    if !is_sequence(&lines, &path, spacing) {
        return join_crossing_lines(&lines, spacing);
    }
    let mut steps: Vec<f64> = path.windows(2).map(|p| distances.get(p[0], p[1])).collect();
    let usual = lower_quantile(&mut steps, USUAL_STEP_SHARE).unwrap_or(0.0);
    let mut is_cut: Vec<bool> = (path.windows(2))
        .map(|p| distances.get(p[0], p[1]) > MAX_GAP_RATIO * usual)
        .collect();
    let mut folds: Vec<usize> = Vec::new();
    for (k, p) in path.windows(3).enumerate() {
        let [first, second] = [(0, 1), (1, 2)].map(|(a, b)| lines[p[a]].vector_to(&lines[p[b]]));
        if dot(first, second) < MAX_FOLD_COSINE * norm(first) * norm(second) {
            let step = if norm(first) > norm(second) { k } else { k + 1 };
            is_cut[step] = true;
            folds.push(step);
        }
    }
    folds.dedup();
    if folds.len() > 1 {
        let sticks = folds.iter().map(|&step| lines[path[step + 1]].sticks[0]);
        return notes.refuse_unclear(sticks.collect());
    }
    let mut parts: Vec<Vec<usize>> = vec![vec![path[0]]];
    for (&line, &is_cut) in path[1..].iter().zip(&is_cut) {
        match parts.last_mut() {
            Some(part) if !is_cut => part.push(line),
            _ => parts.push(vec![line]),
        }
    }
    notes.parts(&parts, &lines);
    let mut triangles = Vec::new();
    for part in parts {
        for pair in part.windows(2) {
            if dot(lines[pair[0]].chord(), lines[pair[1]].chord()) < 0.0 {
                lines[pair[1]].turn();
            }
            let [a, b] = [&lines[pair[0]], &lines[pair[1]]].map(|line| {
                let step = STRIP_STEP_RATIO * spacing;
                line.densified(step.max(line.length / MAX_ADDED_PLACES))
            });
            triangles.extend(join_lines(&a, &b));
        }
    }
    Ok(triangles)
}

/// Returns `true` if neighbours on the path are nearly parallel, and if they and those next to them
/// do not cross.
fn is_sequence(lines: &[Line], path: &[usize], spacing: f64) -> bool {
    let is_parallel = |a: &Line, b: &Line| {
        let is_short = a.length.min(b.length) < SHORT_RATIO * spacing;
        let (p, q) = (a.chord(), b.chord());
        is_short || dot(p, q).abs() >= MIN_PARALLEL_COSINE * norm(p) * norm(q)
    };
    let line = |place: usize| &lines[path[place]];
    (1..path.len()).all(|k| {
        is_parallel(line(k - 1), line(k))
            && !offset_between(line(k - 1), line(k)).crosses
            && (k < 2 || !offset_between(line(k - 2), line(k)).crosses)
    })
}

/// Notes for the user on the sticks of a fault.
struct Notes<'a> {
    fault: &'a str,
    sticks: &'a [Stick],
    texts: Vec<String>,
}

impl Notes<'_> {
    /// Returns the names of sticks: `sticks 3 (line 17), 4 (line 22)`.
    fn names(&self, sticks: &[usize]) -> String {
        let name = |&s: &usize| {
            let stick = &self.sticks[s];
            let line = stick.line.map(|line| format!(" (line {line})"));
            format!("{}{}", stick.name, line.unwrap_or_default())
        };
        let names: Vec<String> = sticks.iter().take(NAMED_STICKS).map(name).collect();
        let more = sticks.len().saturating_sub(NAMED_STICKS);
        let plural = if sticks.len() == 1 { "" } else { "s" };
        let more = if more > 0 {
            format!(" and {more} more")
        } else {
            String::new()
        };
        format!("stick{plural} {}{more}", names.join(", "))
    }

    /// Returns the error of sticks that make no surface.
    fn refuse<T>(&self, problem: String, remedy: &str) -> Result<T> {
        let place = format!("fault {}", self.fault);
        Err(Error::Job(cause(place, problem, remedy)))
    }

    /// Returns the error of sticks that make no single surface with the others.
    fn refuse_unclear<T>(&self, sticks: Vec<usize>) -> Result<T> {
        let names = self.names(&sticks);
        let problem =
            format!("its sticks make no single surface: {names} lie off those beside them");
        let remedy = "give each fault a name of its own, or correct the sticks";
        self.refuse(problem, remedy)
    }

    fn single_points(&mut self, lines: &[Line]) {
        let single: Vec<usize> = (lines.iter())
            .filter(|line| line.length.is_nan() || line.length <= 0.0)
            .map(|line| line.sticks[0])
            .collect();
        if !single.is_empty() {
            let names = self.names(&single);
            self.texts.push(format!("{names} left out: a single point"));
        }
    }

    fn merged(&mut self, merged: &[Merged]) {
        for is_duplicate in [true, false] {
            let of_kind: Vec<&Merged> = merged
                .iter()
                .filter(|m| m.is_duplicate == is_duplicate)
                .collect();
            let what = if is_duplicate {
                "repeated by"
            } else {
                "continued by"
            };
            if let [one] = of_kind[..] {
                let [kept, stick] = [one.kept, one.stick].map(|s| self.names(&[s]));
                self.texts.push(format!("{kept} {what} {stick}"));
            } else if !of_kind.is_empty() {
                let names = self.names(&of_kind.iter().map(|m| m.stick).collect::<Vec<_>>());
                let what = if is_duplicate {
                    "repeat others"
                } else {
                    "continue others"
                };
                self.texts.push(format!("{names} {what}"));
            }
        }
    }

    fn misfits(&mut self, misfits: &[(usize, Misfit)]) {
        for (stick, misfit) in misfits {
            let name = self.names(&[*stick]);
            let distance = misfit.distance;
            self.texts.push(format!(
                "{name} left out: {distance:.0} m off the surface of the others"
            ));
        }
    }

    fn parts(&mut self, parts: &[Vec<usize>], lines: &[Line]) {
        let joined = parts.iter().filter(|part| part.len() > 1).count();
        if joined > 1 {
            self.texts.push(format!(
                "{joined} parts, which are not joined: they are too far apart, or at an angle"
            ));
        }
        for part in parts.iter().filter(|part| part.len() == 1) {
            let name = self.names(&lines[part[0]].sticks);
            self.texts.push(format!(
                "{name} left out: too far from the others, or at an angle to them"
            ));
        }
    }
}

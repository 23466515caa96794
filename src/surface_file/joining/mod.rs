//! Joins the sticks of a fault to a surface by where they lie, whatever their order and direction.
//!
//! 1. Sticks of one point are left out. A stick that lies on another is merged with it, and sticks
//!    that continue one another become one line.
//! 2. A stick that lies far off the plane of its neighbours, which themselves lie in a plane, is
//!    left out; if there are many such sticks, it is unclear which belong, and that is an error.
//! 3. The lines are ordered by the shortest path that visits each of them once. The distance of two
//!    lines is measured across them, so that it does not depend on where they start and end.
//! 4. If neighbours on the path are nearly parallel and do not cross, strips of triangles join them
//!    ([`strip`]). The surface is interrupted where neighbours are more than four times as far
//!    apart as usual.
//! 5. Otherwise, as where sticks lie on lines and on slices, the places along all of them are joined
//!    in the direction that is perpendicular to them ([`scattered`]).
//!
//! All of it is done in metres. Notes say which sticks were left out.

mod line;
mod order;
mod scattered;
mod screening;
mod strip;

use self::line::{Line, Point};
use self::order::Distances;
use self::scattered::join_crossing_lines;
use self::screening::{
    MAX_GAP_RATIO, Merged, Misfit, find_misfit, merge_continuations, merge_twins, offset_between,
    usual_spacing,
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
    let refuse = |problem: String, remedy: &str| {
        let place = format!("fault {fault}");
        Err(Error::Job(cause(place, problem, remedy)))
    };
    let in_metres = |p: &Point| std::array::from_fn(|k| p[k] * metres_per_unit[k]);
    let line =
        |(i, stick): (usize, &Stick)| Line::new(i, stick.points.iter().map(in_metres).collect());
    let mut notes = Notes {
        sticks,
        texts: Vec::new(),
    };
    let mut lines: Vec<Line> = sticks.iter().enumerate().map(line).collect();
    notes.single_points(&lines);
    lines.retain(|line| line.length > 0.0);
    let mut merged = merge_twins(&mut lines);
    let spacing = usual_spacing(&lines);
    merged.extend(merge_continuations(&mut lines, spacing));
    notes.merged(&merged);
    let count = lines.len();
    let misfits = remove_misfits(&mut lines, spacing);
    if misfits.len() > 1 && misfits.len() as f64 > MAX_MISFIT_SHARE * count as f64 {
        let named: Vec<usize> = misfits.iter().map(|(stick, _)| *stick).collect();
        let problem = format!(
            "its sticks make no single surface: {} lie up to {:.0} m off that of the others",
            notes.names(&named),
            misfits
                .iter()
                .fold(0.0, |max: f64, (_, misfit)| max.max(misfit.distance)),
        );
        return refuse(
            problem,
            "give each fault a name of its own, or correct the sticks",
        );
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
        return refuse(problem, "give at least two sticks side by side");
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
    steps.sort_by(f64::total_cmp);
    let usual = steps[(USUAL_STEP_SHARE * (steps.len() - 1) as f64) as usize];
    let is_apart = |a: usize, b: usize| distances.get(a, b) > MAX_GAP_RATIO * usual;
    let parts: Vec<&[usize]> = path.chunk_by(|&a, &b| !is_apart(a, b)).collect();
    notes.parts(&parts, &lines, usual);
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

    fn single_points(&mut self, lines: &[Line]) {
        let single: Vec<usize> = (lines.iter())
            .filter(|line| !(line.length > 0.0))
            .map(|line| line.sticks[0])
            .collect();
        if !single.is_empty() {
            let names = self.names(&single);
            self.texts.push(format!("{names} left out: a single point"));
        }
    }

    fn merged(&mut self, merged: &[Merged]) {
        for is_twin in [true, false] {
            let of_kind: Vec<&Merged> = merged.iter().filter(|m| m.is_twin == is_twin).collect();
            let what = if is_twin {
                "repeated by"
            } else {
                "continued by"
            };
            if let [one] = of_kind[..] {
                let [kept, stick] = [one.kept, one.stick].map(|s| self.names(&[s]));
                self.texts.push(format!("{kept} {what} {stick}"));
            } else if !of_kind.is_empty() {
                let names = self.names(&of_kind.iter().map(|m| m.stick).collect::<Vec<_>>());
                let what = if is_twin {
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

    fn parts(&mut self, parts: &[&[usize]], lines: &[Line], usual: f64) {
        let joined = parts.iter().filter(|part| part.len() > 1).count();
        if joined > 1 {
            let gap = MAX_GAP_RATIO * usual;
            let text = format!("{joined} parts, which are more than {gap:.0} m apart");
            self.texts.push(text);
        }
        for part in parts.iter().filter(|part| part.len() == 1) {
            let name = self.names(&lines[part[0]].sticks);
            let gap = MAX_GAP_RATIO * usual;
            self.texts.push(format!(
                "{name} left out: more than {gap:.0} m from the others"
            ));
        }
    }
}

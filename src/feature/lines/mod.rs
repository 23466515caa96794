//! Where sheets cross, branch off one another and end, as lines; in the plane as points.
//!
//! *Crossings.* Where a point of one sheet comes near one of another, each sheet is a quadratic surface
//! through the points around (moving least squares); the place is where their tangent planes meet. Many
//! pairs of points speak of the same place, so lines are drawn by walking along their direction through
//! the mean of what is near. A sheet that goes on to both sides of the line crosses it; one that does
//! not branches off there.
//!
//! *Tips.* Where all of a sheet that is near a point is to one side of it, and neither the box nor
//! another sheet is why, it ends; these places are drawn in the same way.

#[cfg(test)]
mod tests;
mod trace;

use super::Features;
use super::candidate::{Candidate, nearest_sample};
use super::local_feature_size::to_candidates;
use super::quadric::Quadric;
use super::voxel_index::CandidateIndex;
use crate::error::Result;
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, cross, dot, norm, sub, to_3d, unit};
use crate::parallel::prelude::*;
use crate::progress::{CancelToken, Stage};
use serde::Serialize;
use trace::trace_lines;

/// Shorter lines in space are left out (samples).
pub const MIN_LENGTH: f64 = 8.0;

/// Points of two sheets nearer than this (samples) may be at a line ...
const MAX_PAIR_DISTANCE: f32 = 1.5;
/// ... at which they meet at no less than this (degrees), ...
const MIN_MEETING_ANGLE: f32 = 10.0;
/// ... or, if they were grown as one, than this, ...
const MIN_FOLD_ANGLE: f32 = 18.0;
/// ... no farther away than this (samples), ...
const MAX_LINE_DISTANCE: f64 = 6.0;
/// ... and with points of both within this of it (samples).
const LINE_RADIUS: f32 = 2.0;
/// A sheet's surface is fitted to its points within this many samples ...
const FIT_RADIUS: i32 = 12;
/// ... but for those within this of the line, ...
const FIT_EXCLUSION_RADIUS: f64 = 5.0;
/// ... so many times, each time round the place that was found, ...
const FIT_ROUNDS: usize = 3;
/// ... if these are at least so many times the terms of the fit.
const MIN_POINTS_PER_TERM: usize = 2;
/// Normals of one sheet near a place agree at least this much (cosine).
const SAME_SURFACE_COSINE: f32 = 0.9;

/// How far from a line (samples) a sheet is looked for on either side; a detector may carry a sheet that
/// ends at another a little past it.
const PROBE_DISTANCES: [f64; 4] = [4.0, 5.0, 6.0, 7.0];
/// It goes on if it is met at so many of these distances.
const MIN_PROBE_HITS: usize = 3;

/// A sheet's end is seen in what is within this of a point (samples): ...
const END_RADIUS: i32 = 3;
/// ... its mean is off by more than this share of it.
const MIN_END_OFFSET_SHARE: f64 = 0.33;
/// At the end, what is nearer ahead than this (samples) is why the sheet ends: a side or another sheet.
const AHEAD_DISTANCE: f64 = 4.0;

/// What happens at a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum LineKind {
    /// Two sheets cross: both go on.
    Crossing,
    /// Two sheets meet, and at least one of them ends.
    Branch,
    /// A sheet ends, away from all others and from the sides of the box.
    Tip,
}

/// A line at which sheets meet or end. Lengths and angles are in lattice space.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FeatureLine<const D: usize> {
    /// What happens there.
    pub kind: LineKind,
    /// The numbers of the sheets that meet, the lower first; the same where they were grown as one. Of a
    /// tip, 0 and its sheet.
    pub surfaces: [u32; 2],
    /// The mean angle between the sheets in degrees, at most 90; of a tip 0.
    pub angle: f64,
    /// Its length; 0 in the plane.
    pub length: f64,
    /// Places along it in lattice space; a single one in the plane.
    #[serde(skip)]
    pub points: Vec<[f64; D]>,
}

/// The lines at which the sheets of features meet and end: crossings and branches, then tips. Lines
/// shorter than [`MIN_LENGTH`] samples are left out.
///
/// # Errors
/// [`Error::Interrupted`](crate::Error::Interrupted) once `patience` is over.
pub fn lines<const D: usize>(features: &Features<D>) -> Result<Vec<FeatureLine<D>>> {
    lines_with_cancel(features, &CancelToken::never())
}

/// The same as long as there is patience.
///
/// # Errors
/// [`Error::Interrupted`](crate::Error::Interrupted) once it is over.
pub(crate) fn lines_with_cancel<const D: usize>(
    features: &Features<D>,
    patience: &CancelToken<'_>,
) -> Result<Vec<FeatureLine<D>>> {
    let (dims, step) = (features.potential.dims, features.potential.step);
    let points = to_candidates(dims, &features.points, step);
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.sort_by_key(|&i| points[i as usize].voxel);
    let sorted: Vec<Candidate<D>> = order.iter().map(|&i| points[i as usize]).collect();
    let sheet_of = |i: u32| features.surface.get(i as usize).copied().unwrap_or(0);
    let sheets = SurfacePoints {
        grid: CandidateIndex::new(dims, &sorted),
        surface: order.iter().map(|&i| sheet_of(i)).collect(),
        step,
    };
    let meetings = sheets.line_points(patience, |i| sheets.meetings(i));
    let met: Vec<[f64; 3]> = meetings.iter().map(|place| place.position).collect();
    let drawn = trace_lines(&meetings, D == 2, patience);
    patience.check(Stage::Features)?;
    let mut lines: Vec<FeatureLine<D>> = (drawn.iter())
        .filter_map(|line| sheets.feature_line(line, sheets.line_kind(line)))
        .collect();
    let near_meeting = CellList::new(&met, AHEAD_DISTANCE);
    let ends = sheets.line_points(patience, |i| {
        let end = sheets.tip(i, &near_meeting, &met);
        end.into_iter().collect()
    });
    let drawn = trace_lines(&ends, D == 2, patience);
    patience.check(Stage::Features)?;
    let tips = drawn.iter();
    lines.extend(tips.filter_map(|line| sheets.feature_line(line, LineKind::Tip)));
    Ok(lines)
}

/// A place at which sheets meet or one ends. In the plane, z is 0 and lines run along z.
#[derive(Clone)]
struct LinePoint {
    position: [f64; 3],
    direction: [f64; 3],
    /// The sheets, the lower first; 0 for none.
    surfaces: [u32; 2],
    normals: [[f64; 3]; 2],
    /// In degrees.
    angle: f64,
}

impl LinePoint {
    /// Whether another place may be on the same line: of the same sheets, or of one of them and another
    /// that goes on where the other ends (one sheet that is cut in two).
    fn can_join(&self, other: &Self) -> bool {
        let parallel = |i: usize, j: usize| {
            dot(self.normals[i], other.normals[j]).abs() >= f64::from(SAME_SURFACE_COSINE)
        };
        let shares =
            |i: usize, j: usize| self.surfaces[i] == other.surfaces[j] && parallel(1 - i, 1 - j);
        self.surfaces == other.surfaces || (0..2).any(|i| (0..2).any(|j| shares(i, j)))
    }
}

/// Points with their sheets, in samples.
struct SurfacePoints<'a, const D: usize> {
    grid: CandidateIndex<'a, D>,
    surface: Vec<u32>,
    step: [f64; D],
}

/// A point of a surface and the unit normal there.
type Tangent<const D: usize> = ([f64; D], [f64; D]);

impl<const D: usize> SurfacePoints<'_, D> {
    /// The places that each point tells of.
    fn line_points(
        &self,
        patience: &CancelToken<'_>,
        at: impl Fn(usize) -> Vec<LinePoint> + Sync,
    ) -> Vec<LinePoint> {
        let asked = |i: usize| {
            if patience.is_cancelled() {
                Vec::new()
            } else {
                at(i)
            }
        };
        let count = self.grid.candidates.len();
        (0..count).into_par_iter().flat_map_iter(asked).collect()
    }

    /// Where the sheet of a point meets others near it; each pair of points is asked about once.
    fn meetings(&self, i: usize) -> Vec<LinePoint> {
        let [of_two, of_one] =
            [MIN_MEETING_ANGLE, MIN_FOLD_ANGLE].map(|angle| angle.to_radians().cos());
        let c = &self.grid.candidates[i];
        // Of each sheet the nearest point.
        let mut others: Vec<(u32, f32, usize)> = Vec::new();
        self.grid.for_each_around(self.grid.coordinates(c), 2, |j| {
            if (self.surface[j], j) <= (self.surface[i], i) {
                return;
            }
            let other = &self.grid.candidates[j];
            let away = sub(other.position, c.position);
            let apart = dot(away, away);
            let most = if self.surface[j] == self.surface[i] {
                of_one
            } else {
                of_two
            };
            if apart <= MAX_PAIR_DISTANCE * MAX_PAIR_DISTANCE
                && dot(other.normal, c.normal).abs() <= most
            {
                others.push((self.surface[j], apart, j));
            }
        });
        others.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        others.dedup_by_key(|other| other.0);
        others
            .iter()
            .filter_map(|&(_, _, j)| self.meeting([i, j]))
            .collect()
    }

    /// Where the sheets of two points meet.
    fn meeting(&self, pair: [usize; 2]) -> Option<LinePoint> {
        let [p, q] = pair.map(|i| &self.grid.candidates[i]);
        let begin: [f64; D] =
            std::array::from_fn(|k| 0.5 * f64::from(p.position[k] + q.position[k]));
        let (mut at, mut normals) = (begin, [p, q].map(|c| c.normal.map(f64::from)));
        for _ in 0..FIT_ROUNDS {
            let a = self.tangent(at, normals)?;
            let b = self.tangent(at, [normals[1], normals[0]])?;
            at = intersection_point(at, &a, &b)?;
            normals = [a.1, b.1];
            if norm(sub(at, begin)) > MAX_LINE_DISTANCE {
                return None;
            }
        }
        let [a, b] = normals.map(|n| {
            let scaled: [f64; D] = std::array::from_fn(|k| n[k] / self.step[k]);
            unit(scaled)
        });
        let angle = dot(a, b).abs().min(1.0).acos().to_degrees();
        let place = LinePoint {
            position: to_3d(at),
            direction: unit(cross(to_3d(normals[0]), to_3d(normals[1]))),
            surfaces: pair.map(|i| self.surface[i]),
            normals: normals.map(to_3d),
            angle,
        };
        let both_near =
            (0..2).all(|s| self.continues_through(place.position, &place, s, LINE_RADIUS));
        (angle >= f64::from(MIN_MEETING_ANGLE) && both_near).then_some(place)
    }

    /// The surface through a place whose normal is much like the first and less like the second, which is
    /// that of another surface through it. Growth may have taken one for the other there, but normals
    /// tell them apart; and as each bends the other where they meet, that is left out.
    fn tangent(&self, at: [f64; D], normals: [[f64; D]; 2]) -> Option<Tangent<D>> {
        let along = unit(cross(to_3d(normals[0]), to_3d(normals[1])));
        let [normal, other] = normals.map(|n| n.map(|c| c as f32));
        let axis = (0..D).fold(0, |axis, k| {
            if normal[k].abs() > normal[axis].abs() {
                k
            } else {
                axis
            }
        });
        let place = at.map(|c| c as f32);
        let mut surface = Quadric::<D>::new(FIT_RADIUS);
        let mut count = 0;
        self.grid
            .for_each_around(place.map(nearest_sample), FIT_RADIUS, |i| {
                let c = &self.grid.candidates[i];
                let away = sub(c.position, place);
                let like = dot(c.normal, normal).abs();
                if like < SAME_SURFACE_COSINE
                    || like <= dot(c.normal, other).abs()
                    || dot(away, normal).abs() > 1.0 + 0.15 * dot(away, away).sqrt()
                {
                    return;
                }
                let from = to_3d(away.map(f64::from));
                if norm(add_scaled(from, -dot(from, along), along)) >= FIT_EXCLUSION_RADIUS {
                    count += 1;
                    surface.add(away, axis);
                }
            });
        if count < MIN_POINTS_PER_TERM * Quadric::<D>::TERM_COUNT {
            return None;
        }
        let c = surface.solve()?;
        let mut on = at;
        on[axis] += c[0];
        let mut normal = [0.0; D];
        normal[axis] = 1.0;
        for k in 1..D {
            normal[(axis + k) % D] = -c[k];
        }
        Some((on, unit(normal)))
    }

    /// Whether the sheets that meet at a line both go on, by most of its places.
    fn line_kind(&self, line: &[LinePoint]) -> LineKind {
        let mut balance = 0i32;
        for place in line {
            balance += match self.both_continue(place) {
                Some(true) => 1,
                Some(false) => -1,
                None => 0,
            };
        }
        match balance < 0 {
            true => LineKind::Branch,
            false => LineKind::Crossing,
        }
    }

    /// Whether both sheets go on to both sides of a place; unknown beyond the box.
    fn both_continue(&self, place: &LinePoint) -> Option<bool> {
        let mut both = true;
        for s in 0..2 {
            let beside = cross(place.direction, place.normals[s]);
            for sign in [-1.0, 1.0] {
                let mut met = 0;
                for far in PROBE_DISTANCES {
                    let at = add_scaled(place.position, sign * far, beside);
                    if !self.is_inside(at) {
                        return None;
                    }
                    met += usize::from(self.continues_through(at, place, s, LINE_RADIUS));
                }
                both &= met >= MIN_PROBE_HITS;
            }
        }
        Some(both)
    }

    /// Whether what is like the one sheet of a place, more than like the other, goes through `at`.
    fn continues_through(
        &self,
        at: [f64; 3],
        place: &LinePoint,
        sheet: usize,
        within: f32,
    ) -> bool {
        let at: [f32; D] = std::array::from_fn(|k| at[k] as f32);
        let [own, other] = [sheet, 1 - sheet].map(|s| {
            let normal: [f32; D] = std::array::from_fn(|k| place.normals[s][k] as f32);
            normal
        });
        let mut found = false;
        let reach = within.ceil() as i32;
        self.grid
            .for_each_around(at.map(nearest_sample), reach, |i| {
                let c = &self.grid.candidates[i];
                let away = sub(c.position, at);
                let like = dot(c.normal, own).abs();
                found |= dot(away, away) <= within * within
                    && like >= SAME_SURFACE_COSINE
                    && like > dot(c.normal, other).abs();
            });
        found
    }

    fn is_inside(&self, at: [f64; 3]) -> bool {
        (0..D).all(|k| (0.0..=(self.grid.dims[k] - 1) as f64).contains(&at[k]))
    }

    /// A point at which its sheet ends, for no reason that is seen.
    fn tip(&self, i: usize, meetings: &CellList<3>, met: &[[f64; 3]]) -> Option<LinePoint> {
        let c = &self.grid.candidates[i];
        let (mut sum, mut count) = ([0.0f64; D], 0);
        let reach = END_RADIUS as f32;
        self.grid
            .for_each_around(self.grid.coordinates(c), END_RADIUS, |j| {
                let other = &self.grid.candidates[j];
                let away = sub(other.position, c.position);
                if dot(other.normal, c.normal).abs() >= SAME_SURFACE_COSINE
                    && dot(away, c.normal).abs() <= 1.0
                    && dot(away, away) <= reach * reach
                {
                    count += 1;
                    for k in 0..D {
                        sum[k] += f64::from(away[k]);
                    }
                }
            });
        let normal = to_3d(c.normal.map(f64::from));
        let sum = to_3d(sum);
        let inward = add_scaled(sum, -dot(sum, normal), normal);
        if norm(inward) <= MIN_END_OFFSET_SHARE * f64::from(END_RADIUS) * f64::from(count) {
            return None;
        }
        let inward = unit(inward);
        let at = to_3d(c.position.map(f64::from));
        let ahead = |far: f64| add_scaled(at, -far, inward);
        if !self.is_inside(ahead(AHEAD_DISTANCE)) {
            return None;
        }
        let mut stopped = false;
        if !met.is_empty() {
            meetings.visit_within(at, AHEAD_DISTANCE, |m| {
                stopped |= norm(sub(met[m], at)) <= AHEAD_DISTANCE;
            });
        }
        (!stopped).then(|| LinePoint {
            position: at,
            direction: unit(cross(normal, inward)),
            surfaces: [0, self.surface[i]],
            normals: [normal; 2],
            angle: 0.0,
        })
    }

    /// What is told of a line, as far as it is in the box, if it is long enough.
    fn feature_line(&self, line: &[LinePoint], kind: LineKind) -> Option<FeatureLine<D>> {
        let in_box = |place: &LinePoint| -> [f64; D] {
            std::array::from_fn(|k| place.position[k].clamp(0.0, (self.grid.dims[k] - 1) as f64))
        };
        let length = |places: &[[f64; D]]| {
            let steps = places.windows(2).map(|p| norm(sub(p[1], p[0])));
            steps.fold(0.0, |sum, step| sum + step)
        };
        let mut places: Vec<[f64; D]> = line.iter().map(in_box).collect();
        if D == 3 && length(&places) < MIN_LENGTH {
            return None;
        }
        for place in &mut places {
            *place = std::array::from_fn(|k| place[k] * self.step[k]);
        }
        Some(FeatureLine {
            kind,
            surfaces: line[0].surfaces,
            angle: line.iter().map(|place| place.angle).sum::<f64>() / line.len() as f64,
            length: length(&places),
            points: places,
        })
    }
}

/// The place nearest to `at` in two planes.
fn intersection_point<const D: usize>(
    at: [f64; D],
    a: &Tangent<D>,
    b: &Tangent<D>,
) -> Option<[f64; D]> {
    let cos = dot(a.1, b.1);
    let square = 1.0 - cos * cos;
    let off = [a, b].map(|(on, normal)| dot(*normal, sub(*on, at)));
    if square < 1e-3 {
        return None;
    }
    let along_a = (off[0] - cos * off[1]) / square;
    let along_b = (off[1] - cos * off[0]) / square;
    Some(add_scaled(add_scaled(at, along_a, a.1), along_b, b.1))
}

//! Finds the lines along which feature surfaces cross, branch off one another and end; in the
//! plane, these are points.
//!
//! *Crossings.* Where a point of one surface is near a point of another one, each surface is
//! approximated by a quadratic surface through the points around (moving least squares). The line
//! point is the intersection of their tangent planes. Many pairs of points give the same place, so
//! lines are traced along their direction through the mean of nearby line points. If both surfaces
//! continue on both sides of the line, they cross; if not, one branches off the other.
//!
//! *Tips.* Where all points of a surface near a point are to one side of it, and neither the box
//! nor another surface is the reason, the surface ends. Tips are traced in the same way.

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

/// Smallest length (samples) of a line in space; shorter ones are dropped.
pub const MIN_LENGTH: f64 = 8.0;

/// Largest distance (samples) between points of two surfaces that may be near a line.
const MAX_PAIR_DISTANCE: f32 = 1.5;
/// Smallest angle (degrees) at which two surfaces meet.
const MIN_MEETING_ANGLE: f32 = 10.0;
/// Smallest angle (degrees) at which two parts of one grown surface meet.
const MIN_FOLD_ANGLE: f32 = 18.0;
/// Largest distance (samples) of a line from the pair of points.
const MAX_LINE_DISTANCE: f64 = 6.0;
/// Distance (samples) from a line within which both surfaces need points.
const LINE_RADIUS: f32 = 2.0;
/// Radius (samples) of the neighbourhood to which a quadratic surface is fitted.
const FIT_RADIUS: i32 = 12;
/// Distance (samples) from the line within which points are not used in the fit.
const FIT_EXCLUSION_RADIUS: f64 = 5.0;
/// Number of fits, each around the place that the last one found.
const FIT_ROUNDS: usize = 3;
/// Smallest number of points per term of the fit.
const MIN_POINTS_PER_TERM: usize = 2;
/// Smallest cosine (26 degrees) between normals of one surface near a line.
const NEAR_LINE_COSINE: f32 = 0.9;

/// Distances (samples) from a line at which a surface is looked for on either side. A detector may
/// carry a surface that ends at another one slightly past it.
const PROBE_DISTANCES: [f64; 4] = [4.0, 5.0, 6.0, 7.0];
/// Number of these distances at which a surface must be found to continue.
const MIN_PROBE_HITS: usize = 3;

/// Radius (samples) of the neighbourhood in which the end of a surface is recognised.
const END_RADIUS: i32 = 3;
/// Smallest distance of the mean of the neighbourhood from the point, as a share of the radius, at
/// an end.
const MIN_END_OFFSET_SHARE: f64 = 0.33;
/// Distance (samples) ahead of an end within which a side of the box or another surface is the
/// reason for it.
const AHEAD_DISTANCE: f64 = 4.0;

/// Kind of a line: what surfaces do there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum LineKind {
    /// Two surfaces cross: both continue on both sides.
    Crossing,
    /// Two surfaces meet, and at least one of them ends.
    Branch,
    /// A surface ends, away from all others and from the sides of the box.
    Tip,
}

/// A line at which surfaces meet or end. Lengths and angles are in lattice space.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FeatureLine<const D: usize> {
    /// Kind of the line.
    pub kind: LineKind,
    /// Numbers of the surfaces that meet, the lower first; equal if they were grown as one surface.
    /// For a tip, 0 and the number of its surface.
    pub surfaces: [u32; 2],
    /// Mean angle between the surfaces in degrees, at most 90; 0 for a tip.
    pub angle: f64,
    /// Length of the line; 0 in the plane.
    pub length: f64,
    /// Points along the line in lattice space; a single one in the plane.
    #[serde(skip)]
    pub points: Vec<[f64; D]>,
    /// For each point the unit normals of the two surfaces in lattice space.
    #[serde(skip)]
    pub normals: Vec<[[f64; D]; 2]>,
}

/// Returns the lines at which the surfaces of features meet and end: crossings and branches, then
/// tips. Lines shorter than [`MIN_LENGTH`] samples are dropped.
///
/// # Errors
/// Returns no errors: the search is not cancelled.
pub fn lines<const D: usize>(features: &Features<D>) -> Result<Vec<FeatureLine<D>>> {
    lines_with_cancel(features, &CancelToken::never())
}

/// Finds lines as [`lines`] does, until `cancel` is cancelled.
///
/// # Errors
/// Returns an [`Error::Interrupted`](crate::Error::Interrupted) if `cancel` is cancelled.
pub(crate) fn lines_with_cancel<const D: usize>(
    features: &Features<D>,
    cancel: &CancelToken<'_>,
) -> Result<Vec<FeatureLine<D>>> {
    let (dims, step) = (features.potential.dims, features.potential.step);
    let points = to_candidates(dims, &features.points, step);
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.sort_by_key(|&i| points[i as usize].voxel);
    let sorted: Vec<Candidate<D>> = order.iter().map(|&i| points[i as usize]).collect();
    let surface_of = |i: u32| features.surface.get(i as usize).copied().unwrap_or(0);
    let surfaces = SurfacePoints {
        grid: CandidateIndex::new(dims, &sorted),
        surface: order.iter().map(|&i| surface_of(i)).collect(),
        step,
    };
    let meetings = surfaces.line_points(cancel, |i| surfaces.meetings(i));
    let meeting_positions: Vec<[f64; 3]> = meetings.iter().map(|place| place.position).collect();
    let traced = trace_lines(&meetings, D == 2, cancel);
    cancel.check(Stage::Features)?;
    let mut lines: Vec<FeatureLine<D>> = (traced.iter())
        .filter_map(|line| surfaces.feature_line(line, surfaces.line_kind(line)))
        .collect();
    let meeting_cells = CellList::new(&meeting_positions, AHEAD_DISTANCE);
    let tip_points = surfaces.line_points(cancel, |i| {
        let tip = surfaces.tip(i, &meeting_cells, &meeting_positions);
        tip.into_iter().collect()
    });
    let traced = trace_lines(&tip_points, D == 2, cancel);
    cancel.check(Stage::Features)?;
    let tips = traced.iter();
    lines.extend(tips.filter_map(|line| surfaces.feature_line(line, LineKind::Tip)));
    Ok(lines)
}

/// A point at which surfaces meet or one ends. In the plane, z is 0 and lines run along z.
#[derive(Clone)]
struct LinePoint {
    position: [f64; 3],
    direction: [f64; 3],
    /// Numbers of the surfaces, the lower first; 0 for none.
    surfaces: [u32; 2],
    normals: [[f64; 3]; 2],
    /// Angle between the surfaces in degrees.
    angle: f64,
}

impl LinePoint {
    /// Returns `true` if another line point may be on the same line: if it is of the same surfaces,
    /// or of one of them and a surface that continues the other (one surface that is cut in two).
    fn can_join(&self, other: &Self) -> bool {
        let parallel = |i: usize, j: usize| {
            dot(self.normals[i], other.normals[j]).abs() >= f64::from(NEAR_LINE_COSINE)
        };
        let shares =
            |i: usize, j: usize| self.surfaces[i] == other.surfaces[j] && parallel(1 - i, 1 - j);
        self.surfaces == other.surfaces || (0..2).any(|i| (0..2).any(|j| shares(i, j)))
    }
}

/// Points with their surfaces, in samples.
struct SurfacePoints<'a, const D: usize> {
    grid: CandidateIndex<'a, D>,
    surface: Vec<u32>,
    step: [f64; D],
}

/// A point on a surface and the unit normal there.
type Tangent<const D: usize> = ([f64; D], [f64; D]);

impl<const D: usize> SurfacePoints<'_, D> {
    /// Returns the line points that `find` returns for each point.
    fn line_points(
        &self,
        cancel: &CancelToken<'_>,
        find: impl Fn(usize) -> Vec<LinePoint> + Sync,
    ) -> Vec<LinePoint> {
        let options = |i: usize| {
            if cancel.is_cancelled() {
                Vec::new()
            } else {
                find(i)
            }
        };
        let count = self.grid.candidates.len();
        (0..count).into_par_iter().flat_map_iter(options).collect()
    }

    /// Returns the points at which the surface of point `i` meets others near it; each pair of
    /// points is used once.
    fn meetings(&self, i: usize) -> Vec<LinePoint> {
        let [max_meeting_cosine, max_fold_cosine] =
            [MIN_MEETING_ANGLE, MIN_FOLD_ANGLE].map(|angle| angle.to_radians().cos());
        let c = &self.grid.candidates[i];
        // The nearest point of each other surface.
        let mut others: Vec<(u32, f32, usize)> = Vec::new();
        self.grid.for_each_around(self.grid.coordinates(c), 2, |j| {
            if (self.surface[j], j) <= (self.surface[i], i) {
                return;
            }
            let other = &self.grid.candidates[j];
            let offset = sub(other.position, c.position);
            let square_distance = dot(offset, offset);
            let max_cosine = if self.surface[j] == self.surface[i] {
                max_fold_cosine
            } else {
                max_meeting_cosine
            };
            if square_distance <= MAX_PAIR_DISTANCE * MAX_PAIR_DISTANCE
                && dot(other.normal, c.normal).abs() <= max_cosine
            {
                others.push((self.surface[j], square_distance, j));
            }
        });
        others.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        others.dedup_by_key(|other| other.0);
        others
            .iter()
            .filter_map(|&(_, _, j)| self.meeting([i, j]))
            .collect()
    }

    /// Returns the point at which the surfaces of two points meet.
    fn meeting(&self, pair: [usize; 2]) -> Option<LinePoint> {
        let [p, q] = pair.map(|i| &self.grid.candidates[i]);
        let start: [f64; D] =
            std::array::from_fn(|k| 0.5 * f64::from(p.position[k] + q.position[k]));
        let (mut at, mut normals) = (start, [p, q].map(|c| c.normal.map(f64::from)));
        for _ in 0..FIT_ROUNDS {
            let a = self.tangent(at, normals)?;
            let b = self.tangent(at, [normals[1], normals[0]])?;
            at = intersection_point(at, &a, &b)?;
            normals = [a.1, b.1];
            if norm(sub(at, start)) > MAX_LINE_DISTANCE {
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
        let both_continue =
            (0..2).all(|s| self.continues_through(place.position, &place, s, LINE_RADIUS));
        (angle >= f64::from(MIN_MEETING_ANGLE) && both_continue).then_some(place)
    }

    /// Fits a quadratic surface near `at` to points whose normals are similar to the first of
    /// `normals`, and less similar to the second, which is the normal of the other surface. Growth
    /// may have confused the surfaces near their meeting, but normals distinguish them. Points near
    /// the line are not used, because each surface bends the other one there.
    fn tangent(&self, at: [f64; D], normals: [[f64; D]; 2]) -> Option<Tangent<D>> {
        let line_direction = unit(cross(to_3d(normals[0]), to_3d(normals[1])));
        let [normal, other] = normals.map(|n| n.map(|c| c as f32));
        let axis = (0..D).fold(0, |axis, k| {
            if normal[k].abs() > normal[axis].abs() {
                k
            } else {
                axis
            }
        });
        let position = at.map(|c| c as f32);
        let mut surface = Quadric::<D>::new(FIT_RADIUS);
        let mut count = 0;
        self.grid
            .for_each_around(position.map(nearest_sample), FIT_RADIUS, |i| {
                let c = &self.grid.candidates[i];
                let offset = sub(c.position, position);
                let cosine = dot(c.normal, normal).abs();
                if cosine < NEAR_LINE_COSINE
                    || cosine <= dot(c.normal, other).abs()
                    || dot(offset, normal).abs() > 1.0 + 0.15 * dot(offset, offset).sqrt()
                {
                    return;
                }
                let offset_3d = to_3d(offset.map(f64::from));
                if norm(add_scaled(
                    offset_3d,
                    -dot(offset_3d, line_direction),
                    line_direction,
                )) >= FIT_EXCLUSION_RADIUS
                {
                    count += 1;
                    surface.add(offset, axis);
                }
            });
        if count < MIN_POINTS_PER_TERM * Quadric::<D>::TERM_COUNT {
            return None;
        }
        let c = surface.solve()?;
        let mut point = at;
        point[axis] += c[0];
        let mut normal = [0.0; D];
        normal[axis] = 1.0;
        for k in 1..D {
            normal[(axis + k) % D] = -c[k];
        }
        Some((point, unit(normal)))
    }

    /// Returns the kind of a line: the answer of most of its points to whether both surfaces
    /// continue.
    fn line_kind(&self, line: &[LinePoint]) -> LineKind {
        let mut balance = 0i32;
        for place in line {
            balance += match self.both_continue(place) {
                Some(true) => 1,
                Some(false) => -1,
                None => 0,
            };
        }
        if balance < 0 {
            LineKind::Branch
        } else {
            LineKind::Crossing
        }
    }

    /// Returns `true` if both surfaces continue on both sides of a line point; `None` if that is
    /// beyond the box.
    fn both_continue(&self, place: &LinePoint) -> Option<bool> {
        let mut both_continue = true;
        for s in 0..2 {
            let lateral = cross(place.direction, place.normals[s]);
            for sign in [-1.0, 1.0] {
                let mut hits = 0;
                for distance in PROBE_DISTANCES {
                    let at = add_scaled(place.position, sign * distance, lateral);
                    if !self.is_inside(at) {
                        return None;
                    }
                    hits += usize::from(self.continues_through(at, place, s, LINE_RADIUS));
                }
                both_continue &= hits >= MIN_PROBE_HITS;
            }
        }
        Some(both_continue)
    }

    /// Returns `true` if a surface passes within `radius` of `at` whose normal is similar to that
    /// of one `side` (0 or 1) of a line point, and more similar than to that of the other.
    fn continues_through(&self, at: [f64; 3], place: &LinePoint, side: usize, radius: f32) -> bool {
        let at: [f32; D] = std::array::from_fn(|k| at[k] as f32);
        let [own_normal, other_normal] = [side, 1 - side].map(|s| {
            let normal: [f32; D] = std::array::from_fn(|k| place.normals[s][k] as f32);
            normal
        });
        let mut found = false;
        let reach = radius.ceil() as i32;
        self.grid
            .for_each_around(at.map(nearest_sample), reach, |i| {
                let c = &self.grid.candidates[i];
                let offset = sub(c.position, at);
                let cosine = dot(c.normal, own_normal).abs();
                found |= dot(offset, offset) <= radius * radius
                    && cosine >= NEAR_LINE_COSINE
                    && cosine > dot(c.normal, other_normal).abs();
            });
        found
    }

    fn is_inside(&self, at: [f64; 3]) -> bool {
        (0..D).all(|k| (0.0..=(self.grid.dims[k] - 1) as f64).contains(&at[k]))
    }

    /// Returns the tip at point `i` if its surface ends there for no visible reason.
    fn tip(
        &self,
        i: usize,
        meetings: &CellList<3>,
        meeting_positions: &[[f64; 3]],
    ) -> Option<LinePoint> {
        let c = &self.grid.candidates[i];
        let (mut sum, mut count) = ([0.0f64; D], 0);
        let reach = END_RADIUS as f32;
        self.grid
            .for_each_around(self.grid.coordinates(c), END_RADIUS, |j| {
                let other = &self.grid.candidates[j];
                let offset = sub(other.position, c.position);
                if dot(other.normal, c.normal).abs() >= NEAR_LINE_COSINE
                    && dot(offset, c.normal).abs() <= 1.0
                    && dot(offset, offset) <= reach * reach
                {
                    count += 1;
                    for k in 0..D {
                        sum[k] += f64::from(offset[k]);
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
        let ahead = |distance: f64| add_scaled(at, -distance, inward);
        if !self.is_inside(ahead(AHEAD_DISTANCE)) {
            return None;
        }
        let mut is_near_meeting = false;
        if !meeting_positions.is_empty() {
            meetings.visit_within(at, AHEAD_DISTANCE, |m| {
                is_near_meeting |= norm(sub(meeting_positions[m], at)) <= AHEAD_DISTANCE;
            });
        }
        (!is_near_meeting).then(|| LinePoint {
            position: at,
            direction: unit(cross(normal, inward)),
            surfaces: [0, self.surface[i]],
            normals: [normal; 2],
            angle: 0.0,
        })
    }

    /// Returns the line in lattice space, clamped to the box, if it is long enough.
    fn feature_line(&self, line: &[LinePoint], kind: LineKind) -> Option<FeatureLine<D>> {
        let clamp_to_box = |place: &LinePoint| -> [f64; D] {
            std::array::from_fn(|k| place.position[k].clamp(0.0, (self.grid.dims[k] - 1) as f64))
        };
        let length = |points: &[[f64; D]]| {
            let steps = points.windows(2).map(|p| norm(sub(p[1], p[0])));
            steps.fold(0.0, |sum, step| sum + step)
        };
        let mut points: Vec<[f64; D]> = line.iter().map(clamp_to_box).collect();
        if D == 3 && length(&points) < MIN_LENGTH {
            return None;
        }
        for place in &mut points {
            *place = std::array::from_fn(|k| place[k] * self.step[k]);
        }
        let normals = line.iter().map(|place| {
            (place.normals).map(|normal| unit(std::array::from_fn(|k| normal[k] / self.step[k])))
        });
        Some(FeatureLine {
            kind,
            surfaces: line[0].surfaces,
            angle: line.iter().map(|place| place.angle).sum::<f64>() / line.len() as f64,
            length: length(&points),
            points,
            normals: normals.collect(),
        })
    }
}

/// Returns the point nearest to `at` that lies in two planes.
fn intersection_point<const D: usize>(
    at: [f64; D],
    a: &Tangent<D>,
    b: &Tangent<D>,
) -> Option<[f64; D]> {
    let cos = dot(a.1, b.1);
    let square = 1.0 - cos * cos;
    let offsets = [a, b].map(|(point, normal)| dot(*normal, sub(*point, at)));
    if square < 1e-3 {
        return None;
    }
    let along_a = (offsets[0] - cos * offsets[1]) / square;
    let along_b = (offsets[1] - cos * offsets[0]) / square;
    Some(add_scaled(add_scaled(at, along_a, a.1), along_b, b.1))
}

//! Traces lines through many points that are near them.

use super::LinePoint;
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, dot, norm, sub, unit};
use crate::progress::CancelToken;
use std::cmp::Reverse;

/// Step (samples) along a line.
const DRAW_STEP: f64 = 1.0;
/// Largest number of steps over a gap.
const MAX_GAP_STEPS: usize = 5;
/// Radius (samples) of the neighbourhood whose mean is a point of the line.
const MEAN_RADIUS: f64 = 1.5;
/// Distance (samples) within which line points are covered by a line.
const COVER_RADIUS: f64 = 3.0;
/// Smallest cosine between the directions of a line before and after one step.
const MIN_STEP_COSINE: f64 = 0.7;

/// Traces lines through points; those of the pair of surfaces that meets in most points come first.
pub(super) fn trace_lines(
    points: &[LinePoint],
    is_plane: bool,
    cancel: &CancelToken<'_>,
) -> Vec<Vec<LinePoint>> {
    if points.is_empty() {
        return Vec::new();
    }
    let positions: Vec<[f64; 3]> = points.iter().map(|place| place.position).collect();
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by_key(|&i| points[i].surfaces);
    let runs = order.chunk_by(|&i, &j| points[i].surfaces == points[j].surfaces);
    let mut runs: Vec<&[usize]> = runs.collect();
    runs.sort_by_key(|run| Reverse(run.len()));
    let mut tracer = LineTracer {
        points,
        cell_list: CellList::new(&positions, MEAN_RADIUS),
        is_covered: vec![false; points.len()],
    };
    let mut lines = Vec::new();
    for &first in runs.into_iter().flatten() {
        if tracer.is_covered[first] {
            continue;
        }
        if cancel.is_cancelled() {
            break;
        }
        lines.push(tracer.trace_line(first, is_plane));
    }
    lines
}

/// Traces one line after the other.
struct LineTracer<'a> {
    points: &'a [LinePoint],
    cell_list: CellList<3>,
    /// For each point, `true` if a line covers it.
    is_covered: Vec<bool>,
}

impl LineTracer<'_> {
    /// Returns the line through a point; a single point in the plane.
    fn trace_line(&mut self, first: usize, is_plane: bool) -> Vec<LinePoint> {
        let first = &self.points[first];
        let middle = self
            .local_mean(first.position, first)
            .unwrap_or_else(|| first.clone());
        let mut line = vec![middle.clone()];
        if !is_plane {
            self.mark_covered(&middle, 0.5 * DRAW_STEP);
            let mut reversed = middle.clone();
            reversed.direction = reversed.direction.map(|c| -c);
            self.walk(reversed, &mut line);
            line.reverse();
            self.walk(middle, &mut line);
        }
        for place in &line {
            self.mark_covered(place, f64::INFINITY);
        }
        line
    }

    /// Continues a line from a point as far as there are other points.
    fn walk(&mut self, mut current: LinePoint, line: &mut Vec<LinePoint>) {
        while let Some(next) =
            (1..=MAX_GAP_STEPS).find_map(|steps| self.next_point(&current, steps))
        {
            self.mark_covered(&next, 0.5 * DRAW_STEP);
            line.push(next.clone());
            current = next;
        }
    }

    /// Returns the point of the line `steps` steps ahead, if there are points that no line covers
    /// yet.
    fn next_point(&self, current: &LinePoint, steps: usize) -> Option<LinePoint> {
        let guess = add_scaled(
            current.position,
            steps as f64 * DRAW_STEP,
            current.direction,
        );
        let mut has_uncovered = false;
        self.cell_list.visit_within(guess, MEAN_RADIUS, |i| {
            let place = &self.points[i];
            let offset = sub(place.position, guess);
            has_uncovered |= !self.is_covered[i]
                && norm(offset) <= MEAN_RADIUS
                && dot(offset, current.direction) > -0.5 * DRAW_STEP
                && place.can_join(current);
        });
        let mut next = if has_uncovered {
            self.local_mean(guess, current)?
        } else {
            return None;
        };
        // The point is moved into the plane square to the direction, so that steps keep their
        // length.
        let offset = sub(next.position, guess);
        next.position = add_scaled(
            next.position,
            -dot(offset, current.direction),
            current.direction,
        );
        (dot(next.direction, current.direction) >= MIN_STEP_COSINE).then_some(next)
    }

    /// Returns the mean of the points near `at` that may be on the line of `reference`, which also
    /// decides the sign of the direction.
    fn local_mean(&self, at: [f64; 3], reference: &LinePoint) -> Option<LinePoint> {
        let mut mean = LinePoint {
            position: [0.0; 3],
            direction: [0.0; 3],
            normals: [[0.0; 3]; 2],
            angle: 0.0,
            ..*reference
        };
        let mut count = 0.0;
        self.cell_list.visit_within(at, MEAN_RADIUS, |i| {
            let place = &self.points[i];
            let cos = dot(place.direction, reference.direction);
            if norm(sub(place.position, at)) > MEAN_RADIUS
                || cos.abs() < MIN_STEP_COSINE
                || !place.can_join(reference)
            {
                return;
            }
            count += 1.0;
            mean.position = add_scaled(mean.position, 1.0, place.position);
            mean.direction = add_scaled(mean.direction, cos.signum(), place.direction);
            mean.angle += place.angle;
            for s in 0..2 {
                // If a surface is cut in two, the other part may come first.
                let cosines = [0, 1].map(|t| dot(place.normals[t], reference.normals[s]));
                let t = usize::from(cosines[1].abs() > cosines[0].abs());
                mean.normals[s] =
                    add_scaled(mean.normals[s], cosines[t].signum(), place.normals[t]);
            }
        });
        (count > 0.0).then(|| LinePoint {
            position: mean.position.map(|c| c / count),
            direction: unit(mean.direction),
            normals: mean.normals.map(unit),
            angle: mean.angle / count,
            ..mean
        })
    }

    /// Marks the points around `point` as covered, up to `ahead` along the line.
    fn mark_covered(&mut self, point: &LinePoint, ahead: f64) {
        let (points, is_covered) = (self.points, &mut self.is_covered);
        self.cell_list
            .visit_within(point.position, COVER_RADIUS, |i| {
                let offset = sub(points[i].position, point.position);
                is_covered[i] |= norm(offset) <= COVER_RADIUS
                    && dot(offset, point.direction).abs() <= ahead
                    && points[i].can_join(point);
            });
    }
}

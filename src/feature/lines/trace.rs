//! Lines drawn through many places that tell of them.

use super::LinePoint;
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, dot, norm, sub, unit};
use crate::progress::CancelToken;
use std::cmp::Reverse;

/// A line is drawn in steps of this (samples) ...
const DRAW_STEP: f64 = 1.0;
/// ... over gaps of at most so many, ...
const MAX_GAP_STEPS: usize = 5;
/// ... through the mean of the places within this, ...
const MEAN_RADIUS: f64 = 1.5;
/// ... and stands for all places within this.
const COVER_RADIUS: f64 = 3.0;
/// A line's direction changes by no more than this in one step (cosine).
const MIN_STEP_COSINE: f64 = 0.7;

/// Draws lines through places, those of the sheets that meet in most places first.
pub(super) fn trace_lines(
    places: &[LinePoint],
    in_plane: bool,
    patience: &CancelToken<'_>,
) -> Vec<Vec<LinePoint>> {
    if places.is_empty() {
        return Vec::new();
    }
    let positions: Vec<[f64; 3]> = places.iter().map(|place| place.position).collect();
    let mut order: Vec<usize> = (0..places.len()).collect();
    order.sort_by_key(|&i| places[i].surfaces);
    let runs = order.chunk_by(|&i, &j| places[i].surfaces == places[j].surfaces);
    let mut runs: Vec<&[usize]> = runs.collect();
    runs.sort_by_key(|run| Reverse(run.len()));
    let mut pen = LineTracer {
        points: places,
        cell_list: CellList::new(&positions, MEAN_RADIUS),
        is_covered: vec![false; places.len()],
    };
    let mut lines = Vec::new();
    for &first in runs.into_iter().flatten() {
        if pen.is_covered[first] {
            continue;
        }
        if patience.is_cancelled() {
            break;
        }
        lines.push(pen.trace_line(first, in_plane));
    }
    lines
}

/// Draws one line after the other.
struct LineTracer<'a> {
    points: &'a [LinePoint],
    cell_list: CellList<3>,
    /// Places that lines stand for.
    is_covered: Vec<bool>,
}

impl LineTracer<'_> {
    /// The line through a place; a single place in the plane.
    fn trace_line(&mut self, first: usize, in_plane: bool) -> Vec<LinePoint> {
        let first = &self.points[first];
        let middle = self
            .local_mean(first.position, first)
            .unwrap_or_else(|| first.clone());
        let mut line = vec![middle.clone()];
        if !in_plane {
            self.mark_covered(&middle, 0.5 * DRAW_STEP);
            let mut back = middle.clone();
            back.direction = back.direction.map(|c| -c);
            self.walk(back, &mut line);
            line.reverse();
            self.walk(middle, &mut line);
        }
        for place in &line {
            self.mark_covered(place, f64::INFINITY);
        }
        line
    }

    /// Goes on from a place as far as there are others.
    fn walk(&mut self, mut from: LinePoint, line: &mut Vec<LinePoint>) {
        while let Some(next) = (1..=MAX_GAP_STEPS).find_map(|steps| self.next_point(&from, steps)) {
            self.mark_covered(&next, 0.5 * DRAW_STEP);
            line.push(next.clone());
            from = next;
        }
    }

    /// The line so many steps ahead, if it was not there before.
    fn next_point(&self, from: &LinePoint, steps: usize) -> Option<LinePoint> {
        let guess = add_scaled(from.position, steps as f64 * DRAW_STEP, from.direction);
        let mut new = false;
        self.cell_list.visit_within(guess, MEAN_RADIUS, |i| {
            let place = &self.points[i];
            let away = sub(place.position, guess);
            new |= !self.is_covered[i]
                && norm(away) <= MEAN_RADIUS
                && dot(away, from.direction) > -0.5 * DRAW_STEP
                && place.can_join(from);
        });
        let mut next = if new {
            self.local_mean(guess, from)?
        } else {
            return None;
        };
        // Square to the way, so that steps stay steps.
        let away = sub(next.position, guess);
        next.position = add_scaled(next.position, -dot(away, from.direction), from.direction);
        (dot(next.direction, from.direction) >= MIN_STEP_COSINE).then_some(next)
    }

    /// The mean of the places near one that may be on the line of `like`, which says which way it goes.
    fn local_mean(&self, at: [f64; 3], like: &LinePoint) -> Option<LinePoint> {
        let mut mean = LinePoint {
            position: [0.0; 3],
            direction: [0.0; 3],
            normals: [[0.0; 3]; 2],
            angle: 0.0,
            ..*like
        };
        let mut count = 0.0;
        self.cell_list.visit_within(at, MEAN_RADIUS, |i| {
            let place = &self.points[i];
            let cos = dot(place.direction, like.direction);
            if norm(sub(place.position, at)) > MEAN_RADIUS
                || cos.abs() < MIN_STEP_COSINE
                || !place.can_join(like)
            {
                return;
            }
            count += 1.0;
            mean.position = add_scaled(mean.position, 1.0, place.position);
            mean.direction = add_scaled(mean.direction, cos.signum(), place.direction);
            mean.angle += place.angle;
            for s in 0..2 {
                // Of a sheet that is cut in two, the other part may be named first.
                let cosines = [0, 1].map(|t| dot(place.normals[t], like.normals[s]));
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

    /// Notes that a line stands for the places round this one, up to so far ahead.
    fn mark_covered(&mut self, of: &LinePoint, ahead: f64) {
        let (places, passed) = (self.points, &mut self.is_covered);
        self.cell_list.visit_within(of.position, COVER_RADIUS, |i| {
            let away = sub(places[i].position, of.position);
            passed[i] |= norm(away) <= COVER_RADIUS
                && dot(away, of.direction).abs() <= ahead
                && places[i].can_join(of);
        });
    }
}

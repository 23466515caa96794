//! Lines drawn through many places that tell of them.

use super::Place;
use crate::geometry::buckets::Buckets;
use crate::geometry::{add_scaled, dot, norm, sub, unit};
use crate::observer::Patience;
use std::cmp::Reverse;

/// A line is drawn in steps of this (samples) ...
const STEP: f64 = 1.0;
/// ... over gaps of at most so many, ...
const GAP: usize = 5;
/// ... through the mean of the places within this, ...
const MEAN: f64 = 1.5;
/// ... and stands for all places within this.
const STANDS_FOR: f64 = 3.0;
/// A line's direction changes by no more than this in one step (cosine).
const STRAIGHT: f64 = 0.7;

/// Draws lines through places, those of the sheets that meet in most places first.
pub(super) fn draw(places: &[Place], in_plane: bool, patience: &Patience<'_>) -> Vec<Vec<Place>> {
    if places.is_empty() {
        return Vec::new();
    }
    let positions: Vec<[f64; 3]> = places.iter().map(|place| place.at).collect();
    let mut order: Vec<usize> = (0..places.len()).collect();
    order.sort_by_key(|&i| places[i].sheets);
    let runs = order.chunk_by(|&i, &j| places[i].sheets == places[j].sheets);
    let mut runs: Vec<&[usize]> = runs.collect();
    runs.sort_by_key(|run| Reverse(run.len()));
    let mut pen = Pen {
        places,
        near: Buckets::new(&positions, MEAN),
        passed: vec![false; places.len()],
    };
    let mut lines = Vec::new();
    for &first in runs.into_iter().flatten() {
        if pen.passed[first] {
            continue;
        }
        if patience.over() {
            break;
        }
        lines.push(pen.line(first, in_plane));
    }
    lines
}

/// Draws one line after the other.
struct Pen<'a> {
    places: &'a [Place],
    near: Buckets<3>,
    /// Places that lines stand for.
    passed: Vec<bool>,
}

impl Pen<'_> {
    /// The line through a place; a single place in the plane.
    fn line(&mut self, first: usize, in_plane: bool) -> Vec<Place> {
        let first = &self.places[first];
        let middle = self.mean(first.at, first).unwrap_or_else(|| first.clone());
        let mut line = vec![middle.clone()];
        if !in_plane {
            self.pass(&middle, 0.5 * STEP);
            let mut back = middle.clone();
            back.along = back.along.map(|c| -c);
            self.walk(back, &mut line);
            line.reverse();
            self.walk(middle, &mut line);
        }
        for place in &line {
            self.pass(place, f64::INFINITY);
        }
        line
    }

    /// Goes on from a place as far as there are others.
    fn walk(&mut self, mut from: Place, line: &mut Vec<Place>) {
        while let Some(next) = (1..=GAP).find_map(|steps| self.next(&from, steps)) {
            self.pass(&next, 0.5 * STEP);
            line.push(next.clone());
            from = next;
        }
    }

    /// The line so many steps ahead, if it was not there before.
    fn next(&self, from: &Place, steps: usize) -> Option<Place> {
        let guess = add_scaled(from.at, steps as f64 * STEP, from.along);
        let mut new = false;
        self.near.visit_within(guess, MEAN, |i| {
            let place = &self.places[i];
            let away = sub(place.at, guess);
            new |= !self.passed[i]
                && norm(away) <= MEAN
                && dot(away, from.along) > -0.5 * STEP
                && place.joins(from);
        });
        let mut next = if new {
            self.mean(guess, from)?
        } else {
            return None;
        };
        // Square to the way, so that steps stay steps.
        let away = sub(next.at, guess);
        next.at = add_scaled(next.at, -dot(away, from.along), from.along);
        (dot(next.along, from.along) >= STRAIGHT).then_some(next)
    }

    /// The mean of the places near one that may be on the line of `like`, which says which way it goes.
    fn mean(&self, at: [f64; 3], like: &Place) -> Option<Place> {
        let mut mean = Place {
            at: [0.0; 3],
            along: [0.0; 3],
            normals: [[0.0; 3]; 2],
            angle: 0.0,
            ..*like
        };
        let mut count = 0.0;
        self.near.visit_within(at, MEAN, |i| {
            let place = &self.places[i];
            let cos = dot(place.along, like.along);
            if norm(sub(place.at, at)) > MEAN || cos.abs() < STRAIGHT || !place.joins(like) {
                return;
            }
            count += 1.0;
            mean.at = add_scaled(mean.at, 1.0, place.at);
            mean.along = add_scaled(mean.along, cos.signum(), place.along);
            mean.angle += place.angle;
            for s in 0..2 {
                // Of a sheet that is cut in two, the other part may be named first.
                let cosines = [0, 1].map(|t| dot(place.normals[t], like.normals[s]));
                let t = usize::from(cosines[1].abs() > cosines[0].abs());
                mean.normals[s] =
                    add_scaled(mean.normals[s], cosines[t].signum(), place.normals[t]);
            }
        });
        (count > 0.0).then(|| Place {
            at: mean.at.map(|c| c / count),
            along: unit(mean.along),
            normals: mean.normals.map(unit),
            angle: mean.angle / count,
            ..mean
        })
    }

    /// Notes that a line stands for the places round this one, up to so far ahead.
    fn pass(&mut self, of: &Place, ahead: f64) {
        let (places, passed) = (self.places, &mut self.passed);
        self.near.visit_within(of.at, STANDS_FOR, |i| {
            let away = sub(places[i].at, of.at);
            passed[i] |= norm(away) <= STANDS_FOR
                && dot(away, of.along).abs() <= ahead
                && places[i].joins(of);
        });
    }
}

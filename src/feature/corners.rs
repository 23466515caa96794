//! Sharpens the corners of edges in the plane.
//!
//! Where the gradient of a smoothed image is largest, an edge is rounded inside a corner, over
//! about the width of the smoothing. Farther away the two arms of the corner lie where they are in
//! the image. The arms are extended to their intersection and replace the points between. An edge
//! that bends evenly has arms that bend by as much as their directions differ, and is left
//! unchanged.

use super::candidate::Candidate;
use super::voxel_index::CandidateIndex;
use crate::geometry::{dot, hypot, sub};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Range along the edge over which an arm is fitted, in widths of the smoothing: nearer to the
/// corner the arm is bent, and farther away there may be another corner.
const ARM_RANGE: [f64; 2] = [2.0, 7.0];
/// Smallest number of points that define the line and the curvature of an arm.
const MIN_ARM_POINTS: usize = 5;
/// Largest root mean square distance (samples) of an arm's points from its line.
const MAX_ARM_RESIDUAL: f64 = 0.4;
/// Smallest angle (radians; 35 degrees) by which a corner turns in addition to the bend of its
/// arms.
const MIN_TURN_ANGLE: f64 = 0.61;
/// Largest bend of the arms, as a share of the turn at a corner.
const MAX_BEND_SHARE: f64 = 0.5;
/// Largest distance of a corner from the rounded edge, in widths of the smoothing.
const MAX_CORNER_DISTANCE: f64 = 2.5;
/// Distance (samples) within which points are side by side at one place of an edge.
const SAME_PLACE_RADIUS: f64 = 1.0;
/// Range of the distance (samples) between successive points along an edge.
const STEP_RANGE: [f64; 2] = [0.7, 2.3];
/// Step (radians; 30 degrees) in which normals at a corner turn from one arm's to the other's, so
/// that both arms belong to one surface.
const FAN_ANGLE_STEP: f64 = 0.53;

type Position = [f64; 2];

/// Returns how far (samples) from a point corners look, for a Gaussian of this width.
pub fn corner_reach(width: f64) -> usize {
    ((ARM_RANGE[1] + MAX_CORNER_DISTANCE) * width + STEP_RANGE[1]).ceil() as usize
}

/// One side of a corner: a line fitted to the edge, and the curvature of the edge.
struct Arm {
    middle: Position,
    /// Unit direction away from the corner.
    direction: Position,
    /// Angle (radians) per sample by which the edge turns to the left of `direction`.
    curvature: f64,
    /// The end nearer to the corner.
    end: Position,
    /// Mean strength of the arm's points.
    strength: f32,
}

/// A corner, with its arms.
struct EdgeCorner {
    position: Position,
    /// Distance (samples) from the point at which it was found.
    distance: f64,
    arms: [Arm; 2],
    /// The points between the arms, which the corner replaces.
    rounded_points: Vec<usize>,
}

/// Returns the candidates of edges with sharpened corners. `candidates` are in the order of samples
/// and were found after smoothing by a Gaussian of `width` samples. Corners are made where arms
/// cross whose mean strength is at least `min_strength`, because the direction of weaker edges is
/// uncertain. In three dimensions the candidates are returned unchanged.
pub fn sharpen_corners<const D: usize>(
    dims: [usize; D],
    candidates: Vec<Candidate<D>>,
    width: f64,
    min_strength: f32,
    cancel: &CancelToken<'_>,
) -> Vec<Candidate<D>> {
    if D != 2 {
        return candidates;
    }
    let grid = CandidateIndex::new(dims, &candidates);
    let edges = EdgePoints {
        grid,
        width,
        min_strength,
    };
    let mut corners: Vec<EdgeCorner> = (0..candidates.len())
        .into_par_iter()
        .filter_map(|i| {
            if cancel.is_cancelled() {
                None
            } else {
                edges.find_corner(i)
            }
        })
        .collect();
    // Several points find the same corner. The nearest of them wins, because its arms contain
    // nothing of the bend.
    corners.sort_by(|a, b| a.distance.total_cmp(&b.distance));
    let mut kept: Vec<EdgeCorner> = Vec::new();
    for corner in corners {
        let is_far =
            |other: &EdgeCorner| distance(other.position, corner.position) > ARM_RANGE[0] * width;
        if kept.iter().all(is_far) {
            kept.push(corner);
        }
    }
    if kept.is_empty() {
        return candidates;
    }
    let mut removed = vec![false; candidates.len()];
    for corner in &kept {
        edges.for_each_adjacent(&corner.rounded_points, |i| removed[i] = true);
    }
    let mut sharpened: Vec<Candidate<D>> = Vec::with_capacity(candidates.len());
    sharpened.extend(
        candidates
            .iter()
            .zip(&removed)
            .filter(|c| !c.1)
            .map(|c| *c.0),
    );
    kept.iter()
        .for_each(|corner| corner.add_corner_points(dims, &mut sharpened));
    sharpened.sort_by_key(|c| c.voxel);
    sharpened
}

/// Points of edges, indexed by sample.
struct EdgePoints<'a, const D: usize> {
    grid: CandidateIndex<'a, D>,
    width: f64,
    min_strength: f32,
}

impl<const D: usize> EdgePoints<'_, D> {
    fn position(&self, i: usize) -> Position {
        let position = self.grid.candidates[i].position;
        [f64::from(position[0]), f64::from(position[1])]
    }

    /// Returns the corner whose rounded edge passes point `i`, if there is one.
    fn find_corner(&self, i: usize) -> Option<EdgeCorner> {
        let normal = self.grid.candidates[i].normal;
        let tangent = [-f64::from(normal[1]), f64::from(normal[0])];
        let middle = self.position(i);
        let paths = [tangent, tangent.map(|t| -t)].map(|direction| self.trace_edge(i, direction));
        let [a, b] = paths.each_ref().map(|path| self.fit_arm(path));
        let (a, b) = (a?, b?);
        // Along the edge: towards the corner on arm `a`, away from it on arm `b`.
        let before = a.direction.map(|c| -c);
        let turn = turn_angle(before, b.direction);
        let arm_distance = ARM_RANGE[0] + ARM_RANGE[1];
        let bend = 0.5 * (b.curvature - a.curvature) * arm_distance * self.width;
        let excess = (turn - bend).abs();
        if excess < MIN_TURN_ANGLE || bend.abs() > MAX_BEND_SHARE * turn.abs() {
            return None;
        }
        let corner = intersect(&a, &b)?;
        let corner_distance = distance(corner, middle);
        if corner_distance > MAX_CORNER_DISTANCE * self.width {
            return None;
        }
        let rounded = |path: &EdgePath| -> Vec<usize> {
            let nearby = path.iter().take_while(|p| p.0 < ARM_RANGE[0] * self.width);
            nearby.map(|p| p.1).collect()
        };
        let rounded_points = paths.iter().flat_map(rounded).chain([i]).collect();
        Some(EdgeCorner {
            position: corner,
            distance: corner_distance,
            arms: [a, b],
            rounded_points,
        })
    }

    /// Returns the points of an edge from point `start` on, each with its distance along the edge.
    fn trace_edge(&self, start: usize, mut direction: Position) -> EdgePath {
        let (mut current, mut length, mut points) = (start, 0.0, EdgePath::new());
        while length < ARM_RANGE[1] * self.width {
            let (position, mut best) = (self.position(current), None);
            let at = self.grid.coordinates(&self.grid.candidates[current]);
            self.grid.for_each_around(at, 2, |j| {
                let step = sub(self.position(j), position);
                let step_length = hypot(step[0], step[1]);
                let ahead = dot(step, direction);
                // Prefers the nearest point, and among equally near ones the one straight ahead.
                if (STEP_RANGE[0]..STEP_RANGE[1]).contains(&step_length)
                    && ahead > 0.5 * step_length
                {
                    let cost = step_length * step_length / ahead;
                    if best.is_none_or(|(min_cost, _, _)| cost < min_cost) {
                        best = Some((cost, j, step.map(|c| c / step_length)));
                    }
                }
            });
            let Some((_, next, step)) = best else { break };
            let sum = [direction[0] + step[0], direction[1] + step[1]];
            direction = sum.map(|c| c / hypot(sum[0], sum[1]));
            length += distance(self.position(next), position);
            points.push((length, next));
            current = next;
        }
        points
    }

    /// Fits an arm to the farther points of a path.
    fn fit_arm(&self, path: &EdgePath) -> Option<Arm> {
        let points: Vec<usize> = path
            .iter()
            .filter(|p| p.0 >= ARM_RANGE[0] * self.width)
            .map(|p| p.1)
            .collect();
        if points.len() < MIN_ARM_POINTS {
            return None;
        }
        let count = points.len() as f64;
        let mut middle = [0.0; 2];
        for &i in &points {
            let p = self.position(i);
            (0..2).for_each(|k| middle[k] += p[k] / count);
        }
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for &i in &points {
            let [x, y] = sub(self.position(i), middle);
            (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        }
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let mut direction = [angle.cos(), angle.sin()];
        let (first, last) = (
            self.position(points[0]),
            self.position(points[points.len() - 1]),
        );
        if dot(sub(last, first), direction) < 0.0 {
            direction = direction.map(|c| -c);
        }
        // Least squares fit of the offset across the line to the square of the offset along it,
        // from which the constant and the linear part are removed.
        let offsets = points.iter().map(|&i| {
            let r = sub(self.position(i), middle);
            (dot(r, direction), direction[0] * r[1] - direction[1] * r[0])
        });
        let (mut t2, mut t3, mut mean_square) = (0.0, 0.0, 0.0);
        for (t, s) in offsets.clone() {
            (t2, t3, mean_square) = (
                t2 + t * t / count,
                t3 + t * t * t / count,
                mean_square + s * s / count,
            );
        }
        let (mut common, mut square) = (0.0, 0.0);
        for (t, s) in offsets {
            let q = t * t - t2 - t3 / t2 * t;
            (common, square) = (common + q * s, square + q * q);
        }
        let is_straight = mean_square.sqrt() <= MAX_ARM_RESIDUAL && square > 0.0;
        let sum: f32 = points
            .iter()
            .map(|&i| self.grid.candidates[i].strength)
            .sum();
        let strength = sum / points.len() as f32;
        (is_straight && strength >= self.min_strength).then(|| Arm {
            middle,
            direction,
            curvature: 2.0 * common / square,
            end: first,
            strength,
        })
    }

    /// Calls `visit` for points of an edge and for the points beside them.
    fn for_each_adjacent(&self, points: &[usize], mut visit: impl FnMut(usize)) {
        for &i in points {
            let at = self.grid.coordinates(&self.grid.candidates[i]);
            self.grid.for_each_around(at, 1, |j| {
                if distance(self.position(i), self.position(j)) < SAME_PLACE_RADIUS {
                    visit(j);
                }
            });
        }
    }
}

/// Successive points of an edge, each with its distance along the edge (samples) and its index.
type EdgePath = Vec<(f64, usize)>;

impl EdgeCorner {
    /// Adds the corner, and points on the lines of the arms up to the corner.
    fn add_corner_points<const D: usize>(&self, dims: [usize; D], all: &mut Vec<Candidate<D>>) {
        let strength = self.arms[0].strength.min(self.arms[1].strength);
        let mut add = |p: Position, normal: Position, axis: usize| {
            if (0..2).any(|k| p[k] < 0.0 || p[k] > (dims[k] - 1) as f64) {
                return;
            }
            let mut candidate = Candidate::new(
                dims,
                std::array::from_fn(|k| p[k].round() as usize),
                axis,
                0.0,
                std::array::from_fn(|k| normal[k]),
                strength,
            );
            candidate.position = std::array::from_fn(|k| p[k] as f32);
            all.push(candidate);
        };
        let dominant_axis = |normal: Position| usize::from(normal[1].abs() > normal[0].abs());
        let normals = self
            .arms
            .each_ref()
            .map(|arm| [-arm.direction[1], arm.direction[0]]);
        for (arm, normal) in self.arms.iter().zip(normals) {
            // One point in each column between the corner and the arm.
            let axis = dominant_axis(normal);
            let other = 1 - axis;
            let slope = arm.direction[axis] / arm.direction[other];
            let (start, end) = (
                self.position[other].min(arm.end[other]),
                self.position[other].max(arm.end[other]),
            );
            for column in start.ceil() as i64..end.ceil() as i64 {
                let mut p = self.position;
                p[other] = column as f64;
                p[axis] += slope * (p[other] - self.position[other]);
                add(p, normal, axis);
            }
        }
        // The second arm's normal points to the other side.
        let turn = turn_angle(normals[0], normals[1].map(|c| -c));
        let steps = (turn.abs() / FAN_ANGLE_STEP).ceil().max(1.0) as usize;
        for step in 0..=steps {
            let (sin, cos) = (turn * step as f64 / steps as f64).sin_cos();
            let [x, y] = normals[0];
            let normal = [cos * x - sin * y, sin * x + cos * y];
            add(self.position, normal, dominant_axis(normal));
        }
    }
}

/// Returns the intersection of the lines of two arms.
fn intersect(a: &Arm, b: &Arm) -> Option<Position> {
    let cross = a.direction[0] * b.direction[1] - a.direction[1] * b.direction[0];
    let offset = sub(b.middle, a.middle);
    let t = (offset[0] * b.direction[1] - offset[1] * b.direction[0]) / cross;
    t.is_finite()
        .then(|| [0, 1].map(|k: usize| a.middle[k] + t * a.direction[k]))
}

/// Returns the angle (radians, positive to the left) by which one direction turns to another.
fn turn_angle(from: Position, to: Position) -> f64 {
    (from[0] * to[1] - from[1] * to[0]).atan2(dot(from, to))
}

fn distance(a: Position, b: Position) -> f64 {
    hypot(a[0] - b[0], a[1] - b[1])
}

#[cfg(test)]
mod tests {
    use crate::feature::scenes::{Noise, plane_image};
    use crate::feature::{DetectionOptions, FeatureKind, FeaturePoint, detect};

    const DIMS: [usize; 2] = [96, 88];
    const CENTRE: [f64; 2] = [47.3, 43.8];

    /// Returns points of the edge of a body, 100 inside and 0 outside; the edge is one sample wide,
    /// with noise.
    fn points(
        kind: FeatureKind,
        noise: f64,
        seed: u64,
        signed_distance: impl Fn([f64; 2]) -> f64,
    ) -> Vec<FeaturePoint<2>> {
        let mut random = Noise::new(seed);
        let image = plane_image(DIMS, |p| {
            100.0 * (0.5 - signed_distance(p)).clamp(0.0, 1.0) + noise * random.normal()
        });
        detect(&image, &DetectionOptions::with_kind(kind, 4.0))
            .unwrap()
            .points
    }

    fn nearest(points: &[FeaturePoint<2>], p: [f64; 2]) -> f64 {
        let distance_to = |q: &FeaturePoint<2>| {
            (f64::from(q.position[0]) - p[0]).hypot(f64::from(q.position[1]) - p[1])
        };
        points.iter().map(distance_to).fold(f64::INFINITY, f64::min)
    }

    /// Returns the signed distance to a turned rectangle with half sides `half`, and its corners.
    fn rectangle(half: [f64; 2], degrees: f64) -> (impl Fn([f64; 2]) -> f64, [[f64; 2]; 4]) {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let signed_distance = move |p: [f64; 2]| {
            let (x, y) = (p[0] - CENTRE[0], p[1] - CENTRE[1]);
            let q = [
                (cos * x + sin * y).abs() - half[0],
                (cos * y - sin * x).abs() - half[1],
            ];
            let outside = q[0].max(0.0).hypot(q[1].max(0.0));
            outside + q[0].max(q[1]).min(0.0)
        };
        let corners =
            [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]].map(|[a, b]: [f64; 2]| {
                let (x, y) = (a * half[0], b * half[1]);
                [CENTRE[0] + cos * x - sin * y, CENTRE[1] + sin * x + cos * y]
            });
        (signed_distance, corners)
    }

    #[test]
    fn corners_of_turned_rectangles_in_noise_are_within_a_sample() {
        for kind in [FeatureKind::Canny, FeatureKind::Edges] {
            for half in [[24.0, 24.0], [30.0, 8.0]] {
                for (seed, degrees) in [0.0, 10.0, 20.0, 30.0, 45.0, 63.0].into_iter().enumerate() {
                    for noise in [0.0, 5.0] {
                        let (signed_distance, corners) = rectangle(half, degrees);
                        let points = points(kind, noise, seed as u64, signed_distance);
                        let case = format!("{kind} {half:?} {degrees} {noise}");
                        for corner in corners {
                            let miss = nearest(&points, corner);
                            assert!(miss < 1.0, "{case}: {miss}");
                        }
                        let along = |i: usize| {
                            let (a, b) = (corners[i / 200], corners[(i / 200 + 1) % 4]);
                            let t = (i % 200) as f64 / 200.0;
                            [0, 1].map(|k: usize| a[k] + t * (b[k] - a[k]))
                        };
                        let covered = (0..800).filter(|&i| nearest(&points, along(i)) < 1.0);
                        let share = covered.count() as f64 / 800.0;
                        assert!(share > 0.97, "{case}: {share}");
                        let (signed_distance, _) = rectangle(half, degrees);
                        let worst = points
                            .iter()
                            .map(|p| signed_distance(p.position.map(f64::from)).abs());
                        let worst = worst.fold(0.0, f64::max);
                        assert!(worst < 1.3, "{case}: {worst}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_disc_has_no_corners() {
        for kind in [FeatureKind::Canny, FeatureKind::Edges] {
            for radius in [5.0, 7.0, 10.0, 14.0, 20.0, 35.0] {
                for seed in 0..4 {
                    let signed_distance =
                        |p: [f64; 2]| (p[0] - CENTRE[0]).hypot(p[1] - CENTRE[1]) - radius;
                    let points = points(kind, 5.0, seed, signed_distance);
                    let worst = points
                        .iter()
                        .map(|p| signed_distance(p.position.map(f64::from)));
                    let worst = worst.fold(0.0, f64::max);
                    assert!(worst < 0.75, "{kind} {radius} {seed}: {worst}");
                }
            }
        }
    }
}

//! Corners of edges in the plane.
//!
//! Where the gradient of a smoothed image is steepest, an edge turns round a corner inside it, by about the
//! width of the smoothing. Farther away its two arms lie where they are: they are extended to the place in
//! which they cross, and take the place of the points between. An edge that bends evenly has arms that bend
//! as much as they differ, and is left as it is.

use super::candidate::Candidate;
use super::voxel_index::CandidateIndex;
use crate::geometry::{dot, sub};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Arms are looked at from here to there along the edge, in widths of the smoothing: nearer the corner bends
/// them, farther away another one may be.
const ARM_RANGE: [f64; 2] = [2.0, 7.0];
/// The fewest points that tell where an arm lies and how it bends.
const MIN_ARM_POINTS: usize = 5;
/// An arm's points are off its line by no more than this (samples, root of the mean square).
const MAX_ARM_RESIDUAL: f64 = 0.4;
/// A corner turns by this (radians: 35 degrees) more than its arms' own bending ...
const MIN_TURN_ANGLE: f64 = 0.61;
/// ... which is at most this share of the turn.
const MAX_BEND_SHARE: f64 = 0.5;
/// A corner is at most this far from the edge that turns inside it, in widths of the smoothing.
const MAX_CORNER_DISTANCE: f64 = 2.5;
/// Points nearer than this (samples) are of one place of an edge.
const SAME_PLACE_RADIUS: f64 = 1.0;
/// From point to point along an edge (samples).
const STEP_RANGE: [f64; 2] = [0.7, 2.3];
/// Normals at a corner go from one arm's to the other's in steps of this (radians: 30 degrees), so that the
/// sheet goes on.
const FAN_ANGLE_STEP: f64 = 0.53;

type Position = [f64; 2];

/// How far (samples) corners look beyond a point, at a width of the smoothing.
pub fn corner_reach(width: f64) -> usize {
    ((ARM_RANGE[1] + MAX_CORNER_DISTANCE) * width + STEP_RANGE[1]).ceil() as usize
}

/// A side of a corner: a line, and how the edge bends about it.
struct Arm {
    middle: Position,
    /// Away from the corner.
    direction: Position,
    /// To the left of `along`, per sample (radians).
    curvature: f64,
    /// The end that is nearer to the corner.
    end: Position,
    /// Mean of its points.
    strength: f32,
}

/// A corner that was found.
struct EdgeCorner {
    position: Position,
    /// How far it is from the point that saw it (samples).
    distance: f64,
    arms: [Arm; 2],
    /// The points between the arms.
    rounded_points: Vec<usize>,
}

/// Candidates (in the order of samples) of edges found after smoothing by a Gaussian of this width (samples),
/// with corners where the arms of edges cross that are `sure` on the whole: weaker ones go on to anywhere. In
/// more than two dimensions they stay as they are.
pub fn sharpen_corners<const D: usize>(
    dims: [usize; D],
    candidates: Vec<Candidate<D>>,
    width: f64,
    sure: f32,
    patience: &CancelToken<'_>,
) -> Vec<Candidate<D>> {
    if D != 2 {
        return candidates;
    }
    let grid = CandidateIndex::new(dims, &candidates);
    let edges = EdgePoints {
        grid,
        width,
        min_strength: sure,
    };
    let mut corners: Vec<EdgeCorner> = (0..candidates.len())
        .into_par_iter()
        .filter_map(|i| {
            if patience.is_cancelled() {
                None
            } else {
                edges.find_corner(i)
            }
        })
        .collect();
    // Of a corner that several points see, what the nearest sees: its arms have nothing of the bend.
    corners.sort_by(|a, b| a.distance.total_cmp(&b.distance));
    let mut kept: Vec<EdgeCorner> = Vec::new();
    for corner in corners {
        let apart =
            |other: &EdgeCorner| distance(other.position, corner.position) > ARM_RANGE[0] * width;
        if kept.iter().all(apart) {
            kept.push(corner);
        }
    }
    if kept.is_empty() {
        return candidates;
    }
    let mut gone = vec![false; candidates.len()];
    for corner in &kept {
        edges.for_each_adjacent(&corner.rounded_points, |i| gone[i] = true);
    }
    let mut all: Vec<Candidate<D>> = Vec::with_capacity(candidates.len());
    all.extend(candidates.iter().zip(&gone).filter(|c| !c.1).map(|c| *c.0));
    kept.iter()
        .for_each(|corner| corner.add_corner_points(dims, &mut all));
    all.sort_by_key(|c| c.voxel);
    all
}

/// Edges, point by point.
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

    /// The corner that an edge turns round inside at a point, if it does.
    fn find_corner(&self, i: usize) -> Option<EdgeCorner> {
        let normal = self.grid.candidates[i].normal;
        let tangent = [-f64::from(normal[1]), f64::from(normal[0])];
        let middle = self.position(i);
        let ways = [tangent, tangent.map(|t| -t)].map(|way| self.trace_edge(i, way));
        let [a, b] = ways.each_ref().map(|way| self.fit_arm(way));
        let (a, b) = (a?, b?);
        // Along the edge: towards the corner on the one arm, away from it on the other.
        let before = a.direction.map(|c| -c);
        let turn = turn_angle(before, b.direction);
        let apart = ARM_RANGE[0] + ARM_RANGE[1];
        let own = 0.5 * (b.curvature - a.curvature) * apart * self.width;
        let excess = (turn - own).abs();
        if excess < MIN_TURN_ANGLE || own.abs() > MAX_BEND_SHARE * turn.abs() {
            return None;
        }
        let at = intersect(&a, &b)?;
        let away = distance(at, middle);
        if away > MAX_CORNER_DISTANCE * self.width {
            return None;
        }
        let near = |way: &EdgePath| -> Vec<usize> {
            let near = way.iter().take_while(|p| p.0 < ARM_RANGE[0] * self.width);
            near.map(|p| p.1).collect()
        };
        let between = ways.iter().flat_map(near).chain([i]).collect();
        Some(EdgeCorner {
            position: at,
            distance: away,
            arms: [a, b],
            rounded_points: between,
        })
    }

    /// The points of an edge from one of them on, each with how far away it is along the edge.
    fn trace_edge(&self, from: usize, mut way: Position) -> EdgePath {
        let (mut here, mut length, mut points) = (from, 0.0, EdgePath::new());
        while length < ARM_RANGE[1] * self.width {
            let (place, mut best) = (self.position(here), None);
            let at = self.grid.coordinates(&self.grid.candidates[here]);
            self.grid.for_each_around(at, 2, |j| {
                let step = sub(self.position(j), place);
                let long = step[0].hypot(step[1]);
                let ahead = dot(step, way);
                // The nearest, and of those as near the one that is straight ahead.
                if (STEP_RANGE[0]..STEP_RANGE[1]).contains(&long) && ahead > 0.5 * long {
                    let cost = long * long / ahead;
                    if best.is_none_or(|(least, _, _)| cost < least) {
                        best = Some((cost, j, step.map(|c| c / long)));
                    }
                }
            });
            let Some((_, next, step)) = best else { break };
            let sum = [way[0] + step[0], way[1] + step[1]];
            way = sum.map(|c| c / sum[0].hypot(sum[1]));
            length += distance(self.position(next), place);
            points.push((length, next));
            here = next;
        }
        points
    }

    /// The arm that the farther points of a way make.
    fn fit_arm(&self, way: &EdgePath) -> Option<Arm> {
        let far: Vec<usize> = way
            .iter()
            .filter(|p| p.0 >= ARM_RANGE[0] * self.width)
            .map(|p| p.1)
            .collect();
        if far.len() < MIN_ARM_POINTS {
            return None;
        }
        let count = far.len() as f64;
        let mut middle = [0.0; 2];
        for &i in &far {
            let p = self.position(i);
            (0..2).for_each(|k| middle[k] += p[k] / count);
        }
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for &i in &far {
            let [x, y] = sub(self.position(i), middle);
            (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        }
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let mut along = [angle.cos(), angle.sin()];
        let (first, last) = (self.position(far[0]), self.position(far[far.len() - 1]));
        if dot(sub(last, first), along) < 0.0 {
            along = along.map(|c| -c);
        }
        // Across, of the square of along: by least squares with what is constant and linear taken out.
        let places = far.iter().map(|&i| {
            let r = sub(self.position(i), middle);
            (dot(r, along), along[0] * r[1] - along[1] * r[0])
        });
        let (mut t2, mut t3, mut off) = (0.0, 0.0, 0.0);
        for (t, s) in places.clone() {
            (t2, t3, off) = (
                t2 + t * t / count,
                t3 + t * t * t / count,
                off + s * s / count,
            );
        }
        let (mut common, mut square) = (0.0, 0.0);
        for (t, s) in places {
            let q = t * t - t2 - t3 / t2 * t;
            (common, square) = (common + q * s, square + q * q);
        }
        let straight = off.sqrt() <= MAX_ARM_RESIDUAL && square > 0.0;
        let sum: f32 = far.iter().map(|&i| self.grid.candidates[i].strength).sum();
        let strength = sum / far.len() as f32;
        (straight && strength >= self.min_strength).then(|| Arm {
            middle,
            direction: along,
            curvature: 2.0 * common / square,
            end: first,
            strength,
        })
    }

    /// Calls `visit` for points of an edge and what lies beside them.
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

/// Points of an edge one after the other, and how far away each is.
type EdgePath = Vec<(f64, usize)>;

impl EdgeCorner {
    /// Adds the points of the arms up to the corner, and the corner.
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
        let leading = |normal: Position| usize::from(normal[1].abs() > normal[0].abs());
        let normals = self
            .arms
            .each_ref()
            .map(|arm| [-arm.direction[1], arm.direction[0]]);
        for (arm, normal) in self.arms.iter().zip(normals) {
            // One point in each column between the corner and the arm.
            let axis = leading(normal);
            let other = 1 - axis;
            let slope = arm.direction[axis] / arm.direction[other];
            let (from, to) = (
                self.position[other].min(arm.end[other]),
                self.position[other].max(arm.end[other]),
            );
            for column in from.ceil() as i64..to.ceil() as i64 {
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
            add(self.position, normal, leading(normal));
        }
    }
}

/// Where the lines of two arms cross.
fn intersect(a: &Arm, b: &Arm) -> Option<Position> {
    let across = a.direction[0] * b.direction[1] - a.direction[1] * b.direction[0];
    let apart = sub(b.middle, a.middle);
    let t = (apart[0] * b.direction[1] - apart[1] * b.direction[0]) / across;
    t.is_finite()
        .then(|| [0, 1].map(|k: usize| a.middle[k] + t * a.direction[k]))
}

/// The angle by which one direction turns to another, to the left.
fn turn_angle(from: Position, to: Position) -> f64 {
    (from[0] * to[1] - from[1] * to[0]).atan2(dot(from, to))
}

fn distance(a: Position, b: Position) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

#[cfg(test)]
mod tests {
    use crate::feature::scenes::{Noise, plane_image};
    use crate::feature::{DetectionOptions, FeatureKind, FeaturePoint, detect};

    const DIMS: [usize; 2] = [96, 88];
    const CENTRE: [f64; 2] = [47.3, 43.8];

    /// Points of the edge of a body, 100 inside and 0 outside, an edge one sample wide, with noise.
    fn points(
        kind: FeatureKind,
        noise: f64,
        seed: u64,
        off: impl Fn([f64; 2]) -> f64,
    ) -> Vec<FeaturePoint<2>> {
        let mut random = Noise::new(seed);
        let image = plane_image(DIMS, |p| {
            100.0 * (0.5 - off(p)).clamp(0.0, 1.0) + noise * random.normal()
        });
        detect(&image, &DetectionOptions::with_kind(kind, 4.0))
            .unwrap()
            .points
    }

    fn nearest(points: &[FeaturePoint<2>], p: [f64; 2]) -> f64 {
        let away = |q: &FeaturePoint<2>| {
            (f64::from(q.position[0]) - p[0]).hypot(f64::from(q.position[1]) - p[1])
        };
        points.iter().map(away).fold(f64::INFINITY, f64::min)
    }

    /// A rectangle of these half sides, turned.
    fn rectangle(half: [f64; 2], degrees: f64) -> (impl Fn([f64; 2]) -> f64, [[f64; 2]; 4]) {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let off = move |p: [f64; 2]| {
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
        (off, corners)
    }

    #[test]
    fn corners_of_turned_rectangles_in_noise_are_within_a_sample() {
        for kind in [FeatureKind::Canny, FeatureKind::Edges] {
            for half in [[24.0, 24.0], [30.0, 8.0]] {
                for (seed, degrees) in [0.0, 10.0, 20.0, 30.0, 45.0, 63.0].into_iter().enumerate() {
                    for noise in [0.0, 5.0] {
                        let (off, corners) = rectangle(half, degrees);
                        let points = points(kind, noise, seed as u64, off);
                        let case = format!("{kind} {half:?} {degrees} {noise}");
                        for corner in corners {
                            let short = nearest(&points, corner);
                            assert!(short < 1.0, "{case}: {short}");
                        }
                        let along = |i: usize| {
                            let (a, b) = (corners[i / 200], corners[(i / 200 + 1) % 4]);
                            let t = (i % 200) as f64 / 200.0;
                            [0, 1].map(|k: usize| a[k] + t * (b[k] - a[k]))
                        };
                        let near = (0..800).filter(|&i| nearest(&points, along(i)) < 1.0);
                        let share = near.count() as f64 / 800.0;
                        assert!(share > 0.97, "{case}: {share}");
                        let (off, _) = rectangle(half, degrees);
                        let worst = points.iter().map(|p| off(p.position.map(f64::from)).abs());
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
                    let off = |p: [f64; 2]| (p[0] - CENTRE[0]).hypot(p[1] - CENTRE[1]) - radius;
                    let points = points(kind, 5.0, seed, off);
                    let worst = points.iter().map(|p| off(p.position.map(f64::from)));
                    let worst = worst.fold(0.0, f64::max);
                    assert!(worst < 0.75, "{kind} {radius} {seed}: {worst}");
                }
            }
        }
    }
}

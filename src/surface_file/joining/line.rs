//! Lines in space along which sticks run, and how far apart they are.

use crate::geometry::{dot, norm, sub};

/// Number of places along a line at which its distance from others is measured.
const SAMPLES: usize = 12;

/// A point in metres.
pub(super) type Point = [f64; 3];

/// A stick, or several that continue one another, in metres.
#[derive(Debug, Clone)]
pub(super) struct Line {
    /// Indices of its sticks, the longest first.
    pub sticks: Vec<usize>,
    /// Its points.
    pub points: Vec<Point>,
    /// Places at equal distances along it, from end to end.
    samples: Vec<Point>,
    /// Its length.
    pub length: f64,
}

/// The place of a line that is nearest to a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Nearest {
    /// The nearest place on the line, or on its straight continuation.
    pub place: Point,
    /// The distance from the start of the line along it; negative before its start.
    pub position: f64,
    /// The distance of the point from the place.
    pub distance: f64,
}

/// How one line lies beside another that is at least as long.
#[derive(Debug, Clone, Copy)]
pub(super) struct Offset {
    /// Mean distance of the shorter line from the longer one and its straight continuations.
    pub mean: f64,
    /// Smallest distance of the samples of the shorter line from the longer one itself.
    pub gap: f64,
    /// Share of the shorter line that lies beside the longer one, not beyond its ends.
    pub overlap: f64,
    /// `true` if the shorter line passes from one side of the longer one to the other.
    pub crosses: bool,
}

impl Line {
    /// Creates the line of one stick. Points that repeat the point before them are dropped.
    pub fn new(stick: usize, mut points: Vec<Point>) -> Self {
        points.dedup();
        Self::of_sticks(vec![stick], points)
    }

    /// Creates a line of several sticks.
    pub fn of_sticks(sticks: Vec<usize>, points: Vec<Point>) -> Self {
        let length = points.windows(2).map(|p| norm(sub(p[1], p[0]))).sum();
        let samples = resampled(&points, length, SAMPLES);
        Self {
            sticks,
            points,
            samples,
            length,
        }
    }

    /// Reverses the direction.
    pub fn turn(&mut self) {
        self.points.reverse();
        self.samples.reverse();
    }

    /// Returns the vector from the first point to the last.
    pub fn chord(&self) -> Point {
        match (self.points.first(), self.points.last()) {
            (Some(&first), Some(&last)) => sub(last, first),
            _ => [0.0; 3],
        }
    }

    /// Returns places at equal distances along the line.
    pub fn samples(&self) -> &[Point] {
        &self.samples
    }

    /// Returns the points, with further ones between them so that none is farther than `step` from
    /// the next.
    pub fn densified(&self, step: f64) -> Vec<Point> {
        let mut dense: Vec<Point> = self.points.first().copied().into_iter().collect();
        for pair in self.points.windows(2) {
            let pieces = (norm(sub(pair[1], pair[0])) / step).ceil().max(1.0) as usize;
            let inner = (1..pieces).map(|k| between(pair[0], pair[1], k as f64 / pieces as f64));
            dense.extend(inner);
            dense.push(pair[1]);
        }
        dense
    }

    /// Returns the place of the line that is nearest to `point`.
    pub fn nearest(&self, point: Point) -> Nearest {
        nearest_on(&self.points, point, false)
    }

    /// Returns the place that is nearest to `point` on the line through the samples. With
    /// `is_extended`, that line goes on straight beyond its ends.
    pub fn nearest_of_samples(&self, point: Point, is_extended: bool) -> Nearest {
        nearest_on(&self.samples, point, is_extended)
    }

    /// Returns the place at a distance along the line through the samples, at most that of its end.
    pub fn place_at(&self, position: f64) -> Point {
        let last = self.samples.len() - 1;
        let place = (position / self.length.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0) * last as f64;
        let first = (place.floor() as usize).min(last - 1);
        between(
            self.samples[first],
            self.samples[first + 1],
            place - first as f64,
        )
    }

    /// Returns the mean vector from this line to another, from the samples of the shorter one across to
    /// the longer one.
    pub fn vector_to(&self, other: &Self) -> Point {
        let (short, long, sign) = if self.length <= other.length {
            (self, other, 1.0)
        } else {
            (other, self, -1.0)
        };
        let share = sign / short.samples.len() as f64;
        (short.samples.iter()).fold([0.0; 3], |sum, &sample| {
            let across = sub(long.nearest_of_samples(sample, true).place, sample);
            std::array::from_fn(|k| sum[k] + share * across[k])
        })
    }

    /// Returns how this line lies beside `longer`.
    pub fn offset_from(&self, longer: &Self) -> Offset {
        let mut offset = Offset {
            mean: 0.0,
            gap: f64::INFINITY,
            overlap: 0.0,
            crosses: false,
        };
        let share = 1.0 / self.samples.len().max(1) as f64;
        let mut first_side: Option<Point> = None;
        for &sample in &self.samples {
            let near = nearest_on(&longer.samples, sample, true);
            offset.mean += share * near.distance;
            if (0.0..=longer.length).contains(&near.position) {
                offset.overlap += share;
                offset.gap = offset.gap.min(near.distance);
                let side = sub(sample, near.place);
                let first = *first_side.get_or_insert(side);
                offset.crosses |= dot(first, side) < 0.0;
            } else {
                let near = nearest_on(&longer.samples, sample, false);
                offset.gap = offset.gap.min(near.distance);
            }
        }
        offset
    }
}

/// Returns `a + t (b - a)`.
pub(super) fn between(a: Point, b: Point, t: f64) -> Point {
    std::array::from_fn(|k| a[k] + t * (b[k] - a[k]))
}

/// Returns `count` places at equal distances along a polyline of this length, from end to end.
fn resampled(points: &[Point], length: f64, count: usize) -> Vec<Point> {
    let mut places = Vec::with_capacity(count);
    let (mut start, mut next) = (0.0, 0);
    for pair in points.windows(2) {
        let piece = norm(sub(pair[1], pair[0]));
        while next < count {
            let wanted = length * next as f64 / (count - 1) as f64;
            if wanted > start + piece {
                break;
            }
            places.push(between(pair[0], pair[1], (wanted - start) / piece));
            next += 1;
        }
        start += piece;
    }
    // Rounding may leave out the end.
    places.extend((places.len()..count).filter_map(|_| points.last()));
    places
}

/// Returns the place of a polyline that is nearest to `point`.
fn nearest_on(points: &[Point], point: Point, is_extended: bool) -> Nearest {
    let mut best = Nearest {
        place: point,
        position: 0.0,
        distance: f64::INFINITY,
    };
    let (mut start, last) = (0.0, points.len().saturating_sub(2));
    for (k, pair) in points.windows(2).enumerate() {
        let along = sub(pair[1], pair[0]);
        let length = norm(along);
        let low = if is_extended && k == 0 {
            f64::NEG_INFINITY
        } else {
            0.0
        };
        let high = if is_extended && k == last {
            f64::INFINITY
        } else {
            1.0
        };
        let t = (dot(sub(point, pair[0]), along) / (length * length).max(f64::MIN_POSITIVE))
            .clamp(low, high);
        let place = between(pair[0], pair[1], t);
        let distance = norm(sub(point, place));
        if distance < best.distance {
            best = Nearest {
                place,
                position: start + t * length,
                distance,
            };
        }
        start += length;
    }
    best
}

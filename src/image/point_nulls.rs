//! Finds points whose z is a null value.
//!
//! A file or an option may name null values. Of the others, values that no measurement reaches are
//! always null values. A common null value that could be a place, such as -999 or 0, is one only
//! where at least eight points have it and these lie far from their neighbours: for most pairs of a
//! point with the value and a neighbour without it, the difference of z is several times that of
//! other neighbours.

use super::nulls::{CERTAIN_NULL_MAGNITUDE, COMMON_NULLS, MIN_NULL_COUNT, is_null};
use crate::geometry::cell_list::CellList;
use crate::geometry::statistics::nearest_quantile;
use crate::geometry::{bounding_box, distance2};

/// Smallest ratio of the difference of z between points with a null value and their neighbours to that
/// of other neighbours.
const FAR_RATIO: f64 = 6.0;

/// Smallest difference of z between points with a null value and their neighbours, relative to the
/// range of z of all other points.
const FAR_SHARE: f64 = 0.1;

/// Shares of the sorted differences that count: those of points with a null value, and those of other
/// neighbours.
const QUANTILES: [f64; 2] = [0.25, 0.9];

/// Share of the points at either end of the range of z that may be outliers.
const OUTLIER_SHARE: f64 = 0.05;

/// Largest distance of neighbours in x and y, in units of the mean distance of points.
const NEIGHBOUR_DISTANCE: f64 = 1.6;

/// Largest number of points among which neighbours in x and y are searched for.
const MAX_PLAN_POINTS: usize = 50_000;

/// Pairs of neighbouring points.
pub(crate) type Pairs = Vec<[u32; 2]>;

/// The points of a file, and its null values.
pub(crate) struct NullSearch<'a> {
    /// The points, as they stand in the file.
    pub points: &'a [[f64; 3]],
    /// Null values that the file or the option names.
    pub named: &'a [f64],
    /// `true` if common null values are recognised, too.
    pub recognises: bool,
}

/// Points that are no places.
pub(crate) struct NullPoints {
    /// `true` for each point that is no place.
    pub flags: Vec<bool>,
    /// A note on each null value.
    pub notes: Vec<String>,
}

impl NullSearch<'_> {
    /// Finds the null values. `neighbours` returns groups of neighbouring points, each of which is
    /// enough to tell that points lie far from their neighbours. It is called only if a common null
    /// value occurs.
    pub fn find(&self, neighbours: impl FnOnce() -> Vec<Pairs>) -> NullPoints {
        let is_named = |c: f64| {
            self.named
                .iter()
                .any(|null| c == *null || is_null(c as f32, *null as f32))
        };
        let is_certain = |c: f64| !c.is_finite() || c.abs() >= f64::from(CERTAIN_NULL_MAGNITUDE);
        let mut flags: Vec<bool> = (self.points.iter())
            .map(|p| {
                p.iter().any(|&c| is_certain(c))
                    || is_named(p[2])
                    || is_named(p[0]) && is_named(p[1])
            })
            .collect();
        let count = flags.iter().filter(|flag| **flag).count();
        let mut notes = Vec::new();
        if count > 0 {
            notes.push(format!("{count} points with a null value dropped"));
        }
        if !self.recognises {
            return NullPoints { flags, notes };
        }
        let candidates: Vec<f32> = (COMMON_NULLS.into_iter().chain([0.0]))
            .filter(|null| self.count(&flags, *null) >= MIN_NULL_COUNT)
            .collect();
        let groups = if candidates.is_empty() {
            Vec::new()
        } else {
            neighbours()
        };
        for null in candidates {
            let has_null: Vec<bool> = (self.points.iter().zip(&flags))
                .map(|(p, flag)| !flag && is_null(p[2] as f32, null))
                .collect();
            if !self.lie_far(f64::from(null), &has_null, &flags, &groups) {
                continue;
            }
            let count = has_null.iter().filter(|flag| **flag).count();
            notes.push(format!(
                "{count} points with the common null value {null} dropped (,null=none keeps them)"
            ));
            flags
                .iter_mut()
                .zip(has_null)
                .for_each(|(flag, null)| *flag |= null);
        }
        NullPoints { flags, notes }
    }

    /// Returns the number of points with a value that are not dropped yet.
    fn count(&self, flags: &[bool], null: f32) -> usize {
        let points = self.points.iter().zip(flags);
        points
            .filter(|(p, flag)| !**flag && is_null(p[2] as f32, null))
            .count()
    }

    /// Returns `true` if the points with a value lie far from their neighbours.
    fn lie_far(&self, null: f64, has_null: &[bool], dropped: &[bool], groups: &[Pairs]) -> bool {
        let is_other = |i: usize| !has_null[i] && !dropped[i];
        let others = (0..self.points.len()).filter(|&i| is_other(i));
        let mut others: Vec<f64> = others.map(|i| self.points[i][2]).collect();
        if others.is_empty() {
            // Zero everywhere is a plane.
            return null != 0.0;
        }
        let [low, high] =
            [OUTLIER_SHARE, 1.0 - OUTLIER_SHARE].map(|share| quantile(&mut others, share));
        let mut have_contact = false;
        let is_far = groups.iter().any(|pairs| {
            let (mut across, mut between) = (Vec::new(), Vec::new());
            for &[a, b] in pairs {
                let [a, b] = [a as usize, b as usize];
                let difference = (self.points[a][2] - self.points[b][2]).abs();
                match ([a, b].map(|i| has_null[i]), [a, b].map(is_other)) {
                    ([true, _], [_, true]) | ([_, true], [true, _]) => across.push(difference),
                    (_, [true, true]) => between.push(difference),
                    _ => {}
                }
            }
            have_contact |= !across.is_empty();
            let [across, between] = [
                quantile(&mut across, QUANTILES[0]),
                quantile(&mut between, QUANTILES[1]),
            ];
            across > FAR_RATIO * between && across > FAR_SHARE * (high - low)
        });
        let gap = f64::max(low - null, null - high);
        is_far || !have_contact && gap > 0.5 * (high - low)
    }
}

/// Returns the value at a share of values; 0 if there are none.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    nearest_quantile(values, share).unwrap_or(0.0)
}

/// Returns the pairs of points that follow one another.
pub(crate) fn consecutive_pairs(first: usize, count: usize) -> Pairs {
    let first = first as u32;
    (1..count as u32)
        .map(|i| [first + i - 1, first + i])
        .collect()
}

/// Returns the pairs of points that are close in x and y.
pub(crate) fn pairs_in_plan(points: &[[f64; 3]]) -> Pairs {
    let is_place = |p: &[f64; 3]| {
        p.iter()
            .all(|c| c.abs() < f64::from(CERTAIN_NULL_MAGNITUDE))
    };
    let places: Vec<(u32, [f64; 2])> = (0..)
        .zip(points)
        .step_by(points.len().div_ceil(MAX_PLAN_POINTS).max(1))
        .filter(|(_, p)| is_place(p))
        .map(|(i, p)| (i, [p[0], p[1]]))
        .collect();
    let positions: Vec<[f64; 2]> = places.iter().map(|(_, p)| *p).collect();
    let [low, high] = bounding_box(positions.iter().copied());
    let [width, height] = [high[0] - low[0], high[1] - low[1]];
    let count = positions.len() as f64;
    let step = f64::max(
        (width * height / count).sqrt(),
        f64::max(width, height) / count,
    );
    let mut pairs = Pairs::new();
    if !(step > 0.0 && step.is_finite()) {
        return pairs;
    }
    let radius = NEIGHBOUR_DISTANCE * step;
    let cells = CellList::new(&positions, radius);
    for (i, p) in positions.iter().enumerate() {
        cells.visit_within(*p, radius, |j| {
            if i < j && distance2(p, &positions[j]) <= radius * radius {
                pairs.push([places[i].0, places[j].0]);
            }
        });
    }
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns points of a surface z(x, y), of which those with x < `end` and y < 40 have a null value.
    fn points(end: f64, null: f64, z: impl Fn(f64, f64) -> f64) -> Vec<[f64; 3]> {
        let place = |i: u32| [10.0 * f64::from(i % 20), 10.0 * f64::from(i / 20)];
        let point = |[x, y]: [f64; 2]| [x, y, if x < end && y < 40.0 { null } else { z(x, y) }];
        (0..400).map(place).map(point).collect()
    }

    fn found(points: &[[f64; 3]], named: &[f64], recognises: bool) -> usize {
        let search = NullSearch {
            points,
            named,
            recognises,
        };
        let nulls = search.find(|| vec![consecutive_pairs(0, points.len()), pairs_in_plan(points)]);
        nulls.flags.iter().filter(|flag| **flag).count()
    }

    #[test]
    fn null_values_are_found_where_they_lie_far_from_their_neighbours() {
        let plane = |x: f64, y: f64| -1500.0 + 0.3 * x - 0.2 * y;
        for null in [-999.0, -999.25, -9999.0, 0.0] {
            assert_eq!(found(&points(60.0, null, plane), &[], true), 24, "{null}");
            assert_eq!(found(&points(60.0, null, plane), &[], false), 0, "{null}");
            // Fewer than eight.
            assert_eq!(found(&points(10.0, null, plane), &[], true), 0, "{null}");
        }
        // A null value within the range of z, and points in any order.
        let steep = |x: f64, y: f64| -1600.0 + 4.0 * x + 0.3 * y;
        assert_eq!(found(&points(60.0, -999.0, steep), &[], true), 24);
        let mut shuffled = points(60.0, -999.0, plane);
        shuffled.sort_by_key(|p| ((p[0] * 7919.0 + p[1] * 104_729.0) as u64) % 1009);
        assert_eq!(found(&shuffled, &[], true), 24);
    }

    #[test]
    fn impossible_and_named_values_are_always_null() {
        let plane = |x: f64, y: f64| -1500.0 + 0.3 * x - 0.2 * y;
        for null in [1e30, 1.70141e38, f64::NAN, 1e300] {
            assert_eq!(found(&points(10.0, null, plane), &[], false), 4, "{null}");
        }
        assert_eq!(found(&points(10.0, -42.5, plane), &[-42.5], false), 4);
    }

    #[test]
    fn values_that_are_places_stay() {
        // The sea is flat at 0 where land begins.
        let coast = |x: f64, _: f64| (x - 90.0).max(0.0) * 0.5;
        assert_eq!(found(&points(0.0, 0.0, coast), &[], true), 0);
        // A horizon passes -999.
        let passing = |x: f64, _: f64| -999.0 + (x - 100.0);
        assert_eq!(found(&points(0.0, 0.0, passing), &[], true), 0);
        // Sticks of a fault begin at 0.
        let sticks = |i: u32| {
            [
                f64::from(i / 8) * 50.0,
                f64::from(i % 8) * 20.0,
                -100.0 * f64::from(i % 8),
            ]
        };
        let sticks: Vec<[f64; 3]> = (0..160).map(sticks).collect();
        assert_eq!(found(&sticks, &[], true), 0);
    }
}

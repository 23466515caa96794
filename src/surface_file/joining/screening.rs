//! Screens the sticks of a fault: merges duplicates, joins sticks that continue one another to one
//! line, and finds sticks that cannot belong to the surface of the others.

use super::line::{Line, Nearest, Offset, Point};
use crate::geometry::eigen::{eigenvalues, eigenvector};
use crate::geometry::statistics::lower_quantile;
use crate::geometry::{dot, norm, sub};

/// Distance, relative to the length of a stick, below which it repeats another.
const DUPLICATE_TOLERANCE: f64 = 1e-3;

/// Distance between lines, in units of the spacing of sticks, below which they are the same line.
const SAME_LINE_RATIO: f64 = 0.15;

/// Smallest cosine of the angle at which a line continues another (45 degrees).
const MIN_ONWARD_COSINE: f64 = 0.707;

/// Smallest cosine of the angles of a gap with the lines that it separates (25 degrees).
const MIN_BRIDGE_COSINE: f64 = 0.906;

/// Largest gap between sticks that continue one another, and between neighbours of one surface, in
/// units of the spacing of sticks.
pub(super) const MAX_GAP_RATIO: f64 = 4.0;

/// Smallest overlap of sticks that are compared to find their spacing.
const MIN_OVERLAP: f64 = 0.25;

/// Number of neighbouring lines that make the local plane with which a stick is compared.
const NEIGHBOURS: usize = 4;

/// Smallest distance of a stick that cannot belong from the plane of its neighbours, in units of the
/// spacing.
const MIN_MISFIT_RATIO: f64 = 0.4;

/// Smallest such distance in units of the median of the other sticks.
const MIN_MISFIT_TO_MEDIAN: f64 = 6.0;

/// Largest distance of the neighbours from their own plane, in units of the stick's.
const MAX_NEIGHBOUR_MISFIT: f64 = 0.3;

/// Two lines that were found to be one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Merged {
    /// The stick that is part of the other's line.
    pub stick: usize,
    /// The stick whose line stays.
    pub kept: usize,
    /// `true` if most of the stick lies on the other.
    pub is_duplicate: bool,
}

/// Removes lines that lie wholly on a longer one, whichever their direction and points. The longest
/// lines come first afterwards.
pub(super) fn merge_duplicates(lines: &mut Vec<Line>) -> Vec<Merged> {
    lines.sort_by(|a, b| b.length.total_cmp(&a.length));
    let mut merged = Vec::new();
    let mut kept: Vec<Line> = Vec::new();
    for line in std::mem::take(lines) {
        let max = DUPLICATE_TOLERANCE * line.length;
        let is_on = |other: &&Line| {
            line.points
                .iter()
                .all(|&p| other.nearest(p).distance <= max)
        };
        match kept.iter().find(is_on) {
            Some(duplicate) => merged.push(Merged {
                stick: line.sticks[0],
                kept: duplicate.sticks[0],
                is_duplicate: true,
            }),
            None => kept.push(line),
        }
    }
    *lines = kept;
    merged
}

/// Returns how the shorter of two lines lies beside the longer one.
pub(super) fn offset_between(a: &Line, b: &Line) -> Offset {
    if a.length <= b.length {
        a.offset_from(b)
    } else {
        b.offset_from(a)
    }
}

/// Returns the usual distance of a line from its neighbour; the median stick's length if the lines
/// have no neighbours. Of each line the second nearest counts, because the nearest may be a second
/// pick of the same line.
pub(super) fn usual_spacing(lines: &[Line]) -> f64 {
    let rank = usize::from(lines.len() > 3);
    let neighbour = |i: usize| {
        let others = (0..lines.len()).filter(|&j| j != i);
        let offsets = others.map(|j| offset_between(&lines[i], &lines[j]));
        let mut means: Vec<f64> = offsets
            .filter(|offset| offset.overlap >= MIN_OVERLAP)
            .map(|offset| offset.mean)
            .collect();
        means.sort_by(f64::total_cmp);
        means.get(rank).or(means.last()).copied()
    };
    let mut spacings: Vec<f64> = (0..lines.len()).filter_map(neighbour).collect();
    if spacings.is_empty() {
        spacings = lines.iter().map(|line| line.length).collect();
    }
    lower_quantile(&mut spacings, 0.4).unwrap_or(0.0)
}

/// Makes one line of lines that lie on one another or continue one another.
pub(super) fn merge_continuations(lines: &mut Vec<Line>, spacing: f64) -> Vec<Merged> {
    let mut merged = Vec::new();
    let mut i = 0;
    while i < lines.len() {
        let found = (i + 1..lines.len()).find_map(|j| {
            let union = united(&lines[i], &lines[j], spacing)?;
            Some((j, union))
        });
        let Some((j, (points, is_duplicate))) = found else {
            i += 1;
            continue;
        };
        let other = lines.remove(j);
        merged.push(Merged {
            stick: other.sticks[0],
            kept: lines[i].sticks[0],
            is_duplicate,
        });
        let mut sticks = lines[i].sticks.clone();
        sticks.extend(other.sticks);
        lines[i] = Line::of_sticks(sticks, points);
        // The longer line may reach further ones.
        i = 0;
    }
    merged
}

/// Returns the points of two lines that are one, and whether most of them is twice there. Returns
/// `None` if they are two lines.
fn united(a: &Line, b: &Line, spacing: f64) -> Option<(Vec<Point>, bool)> {
    let (long, short) = if a.length >= b.length { (a, b) } else { (b, a) };
    if let Some(points) = continued(long, short, spacing) {
        return Some((points, false));
    }
    let offset = short.offset_from(long);
    if offset.mean > SAME_LINE_RATIO * spacing || offset.gap > MAX_GAP_RATIO * spacing {
        return None;
    }
    let nearest: Vec<(Nearest, Point)> = (short.points.iter())
        .map(|&p| (long.nearest_of_samples(p, true), p))
        .collect();
    let beyond = |is_beyond: &dyn Fn(f64) -> bool| -> Vec<Point> {
        let mut beyond: Vec<(f64, Point)> = (nearest.iter())
            .filter(|(near, _)| is_beyond(near.position))
            .map(|(near, p)| (near.position, *p))
            .collect();
        beyond.sort_by(|a, b| a.0.total_cmp(&b.0));
        beyond.into_iter().map(|(_, p)| p).collect()
    };
    let mut points = beyond(&|position| position < 0.0);
    points.extend(&long.points);
    points.extend(beyond(&|position| position > long.length));
    points.dedup();
    Some((points, offset.overlap > 0.5))
}

/// Returns the points of two lines that run on in the same direction, where they meet at their ends or
/// beyond a small gap.
fn continued(a: &Line, b: &Line, spacing: f64) -> Option<Vec<Point>> {
    let turned = |line: &Line| {
        let mut turned = line.clone();
        turned.turn();
        turned
    };
    for first in [a.clone(), turned(a)] {
        for second in [b.clone(), turned(b)] {
            let [.., before, end] = first.samples() else {
                continue;
            };
            let [start, after, ..] = second.samples() else {
                continue;
            };
            let (out, on) = (sub(*end, *before), sub(*after, *start));
            let gap = sub(*start, *end);
            let cosine = |a: Point, b: Point| dot(a, b) / (norm(a) * norm(b));
            let meets =
                norm(gap) <= SAME_LINE_RATIO * spacing && cosine(out, on) > MIN_ONWARD_COSINE;
            let is_bridged =
                norm(gap) <= spacing && cosine(out, gap).min(cosine(gap, on)) > MIN_BRIDGE_COSINE;
            if meets || is_bridged {
                let mut points = first.points;
                points.extend(second.points);
                points.dedup();
                return Some(points);
            }
        }
    }
    None
}

/// The stick that fits its neighbours least.
#[derive(Debug, Clone, Copy)]
pub(super) struct Misfit {
    /// Index of its line.
    pub line: usize,
    /// Its mean distance from the planes of its neighbours.
    pub distance: f64,
}

/// Finds the line that lies farthest off the surface of the others, if it clearly cannot belong to
/// it: its neighbours lie in a plane, and it does not.
pub(super) fn find_misfit(lines: &[Line], spacing: f64) -> Option<Misfit> {
    if lines.len() <= NEIGHBOURS.min(3) {
        return None;
    }
    let misfits: Vec<[f64; 2]> = (0..lines.len())
        .map(|i| misfit_of(lines, i, None, spacing))
        .collect();
    let is_clear = |&i: &usize| {
        let [misfit, of_neighbours] = misfits[i];
        misfit > MIN_MISFIT_RATIO * spacing && of_neighbours < MAX_NEIGHBOUR_MISFIT * misfit
    };
    let mut clear: Vec<usize> = (0..lines.len()).filter(is_clear).collect();
    clear.sort_by(|&i, &j| misfits[j][0].total_cmp(&misfits[i][0]));
    let median_without = |i: usize| {
        let others = (0..lines.len()).filter(|&j| j != i);
        let mut rest: Vec<f64> = others
            .map(|j| misfit_of(lines, j, Some(i), spacing)[0])
            .collect();
        lower_quantile(&mut rest, 0.5).unwrap_or(0.0)
    };
    let line = clear
        .into_iter()
        .find(|&i| misfits[i][0] > MIN_MISFIT_TO_MEDIAN * median_without(i))?;
    Some(Misfit {
        line,
        distance: misfits[line][0],
    })
}

/// Returns the mean distance of a line from the planes of its neighbours, and that of the neighbours
/// from these planes. A line `without` is no neighbour.
fn misfit_of(lines: &[Line], index: usize, without: Option<usize>, spacing: f64) -> [f64; 2] {
    let samples = lines[index].samples();
    let mut sums = [0.0; 2];
    for &sample in samples {
        let mut near: Vec<(usize, Nearest)> = (0..lines.len())
            .filter(|&j| j != index && Some(j) != without)
            .map(|j| (j, lines[j].nearest_of_samples(sample, false)))
            .collect();
        near.sort_by(|a, b| a.1.distance.total_cmp(&b.1.distance));
        let points: Vec<Point> = (near.iter().take(NEIGHBOURS))
            .flat_map(|(j, near)| {
                let place = |step: f64| lines[*j].place_at(near.position + step * spacing);
                [place(-0.5), place(0.0), place(0.5)]
            })
            .collect();
        let plane = Plane::fit(&points);
        sums[0] += plane.distance(sample);
        sums[1] += points.iter().map(|&p| plane.distance(p)).sum::<f64>() / points.len() as f64;
    }
    sums.map(|sum| sum / samples.len() as f64)
}

/// The plane that fits points best.
struct Plane {
    mean: Point,
    normal: Point,
}

impl Plane {
    fn fit(points: &[Point]) -> Self {
        let share = 1.0 / points.len().max(1) as f64;
        let mean = points.iter().fold([0.0; 3], |sum, p| {
            std::array::from_fn(|k| sum[k] + share * p[k])
        });
        let vectors = points.iter().map(|&p| sub(p, mean));
        Self {
            mean,
            normal: least_direction(vectors),
        }
    }

    fn distance(&self, point: Point) -> f64 {
        dot(sub(point, self.mean), self.normal).abs()
    }
}

/// Returns the unit vector along which the sum of squares of the vectors' components is smallest.
pub(super) fn least_direction(vectors: impl Iterator<Item = Point>) -> Point {
    let mut moments = [[0.0; 3]; 3];
    for v in vectors {
        for k in 0..3 {
            for l in 0..3 {
                moments[k][l] += v[k] * v[l];
            }
        }
    }
    let direction = eigenvector(&moments, eigenvalues(&moments)[0]);
    let length = norm(direction);
    direction.map(|c| c / length)
}

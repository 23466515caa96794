//! Ridges up to the sides of the box.
//!
//! At the sides of the box, mirrored samples bend crests and turn the Hessian's eigenvectors. There
//! candidates are *doubtful*. The others tell where the sheets run: from the rim of the doubtful zone
//! each sheet is continued column by column, every new point read from a quadratic surface fitted to the
//! reliable points nearby. Doubtful candidates beside a continued sheet are dropped.

use super::by_sample::{BySample, segment};
use super::crossing::{Candidate, Voxel, nearest};
use super::quadric::Quadric;
use super::slab::Slab;
use super::volume::Volume;
use crate::error::Result;
use crate::geometry::{dot, sub};
use crate::observer::Patience;
use crate::parallel::prelude::*;

/// Reliable points within this many samples of a new point are fitted; the second radius is for the
/// middle of wide zones, where the first finds too few.
const RADII: [i32; 2] = [8, 15];
/// Normals of one sheet agree at least this much (cosine).
const SAME_NORMAL: f32 = 0.966;
/// Two fits of one sheet agree at least this much (cosine).
const SAME_FIT: f32 = 0.97;
/// A sheet goes on while the smoothed image is at least this share of what it was at the rim.
const SUPPORT: f32 = 0.7;
/// No point.
const NONE: u32 = u32::MAX;
/// A front goes this many columns into the zone at most.
const STEPS: u32 = 16;
/// What is continued depends on no layers farther off than this: on those that fronts come from, which others may
/// stand in the way of, and on those of the points that are fitted.
pub const SEES: usize = 64;
/// So many fronts go on together ...
const TOGETHER: usize = 1 << 12;
/// ... and at least so many on one thread.
const FEW: usize = 64;
/// A sample is given this many new points at most.
const MOST: usize = 4;
/// Doubtful candidates at most this many samples along each axis from a new point are dropped.
const BESIDE: i32 = 2;

/// The heights of a smoothed volume that [`repair`] asks for: near the sides of the box, of some layers.
pub struct Shell<const D: usize> {
    dims: [usize; D],
    /// Samples along each axis from either side that are kept: none or all of them, if they would meet.
    low: [usize; D],
    high: [usize; D],
    /// Those of the layers that are here, of which the first is one of so many before it.
    heights: Vec<f32>,
    first: usize,
}

impl<const D: usize> Shell<D> {
    /// For a volume smoothed over `scale` samples, without its heights.
    pub fn new(dims: [usize; D], scale: f64) -> Self {
        let width = margin(scale) + 1;
        let met = |k: usize| dims[k] <= 2 * width;
        Self {
            dims,
            low: std::array::from_fn(|k| if met(k) { dims[k] } else { width }),
            high: std::array::from_fn(|k| if met(k) { 0 } else { width }),
            heights: Vec::new(),
            first: 0,
        }
    }

    /// With the heights of this rank's own layers.
    pub fn with(self, heights: Vec<f32>) -> Self {
        Self { heights, ..self }
    }

    /// With those of the halo, too.
    fn beside(mut self, slab: &Slab<'_, D>) -> Result<Self> {
        let own = std::mem::take(&mut self.heights);
        let before = |layer: usize| self.before(D - 1, layer);
        let (heights, first) = slab.layers_beside("heights near sides", own, before)?;
        Ok(Self {
            heights,
            first,
            ..self
        })
    }

    /// How many heights are kept of a layer's layers before one of these, square to an axis.
    fn before(&self, k: usize, at: usize) -> usize {
        let near = at.min(self.low[k]) + at.saturating_sub(self.dims[k] - self.high[k]);
        near * self.layer(k) + (at - near) * self.kept(k)
    }

    /// Samples of a layer square to an axis, of those axes before it.
    fn layer(&self, axis: usize) -> usize {
        self.dims[..axis].iter().product()
    }

    /// Those of them that are kept where the layer is not near a side.
    fn kept(&self, axis: usize) -> usize {
        match axis {
            0 => 0,
            _ => {
                let k = axis - 1;
                let near = self.low[k] + self.high[k];
                near * self.layer(k) + (self.dims[k] - near) * self.kept(k)
            }
        }
    }

    /// The heights that are kept of some layers along the last axis.
    pub fn of_layers(&self, layers: &[f32], first: usize) -> Vec<f32> {
        let (last, mut kept) = (D - 1, Vec::new());
        let count = layers.len() / self.layer(last).max(1);
        let near = (first..first + count)
            .filter(|&i| self.near(i, last))
            .count();
        kept.reserve_exact(near * self.layer(last) + (count - near) * self.kept(last));
        for (i, layer) in layers.chunks_exact(self.layer(last).max(1)).enumerate() {
            match self.near(first + i, last) {
                true => kept.extend_from_slice(layer),
                false => self.add_part(layer, last, &mut kept),
            }
        }
        kept
    }

    fn near(&self, at: usize, k: usize) -> bool {
        at < self.low[k] || at >= self.dims[k] - self.high[k]
    }

    /// Adds what is kept of a layer square to an axis.
    fn add_part(&self, layer: &[f32], axis: usize, kept: &mut Vec<f32>) {
        let k = axis - 1;
        if k == 0 {
            kept.extend_from_slice(&layer[..self.low[0]]);
            kept.extend_from_slice(&layer[self.dims[0] - self.high[0]..]);
            return;
        }
        for (at, part) in layer.chunks_exact(self.layer(k).max(1)).enumerate() {
            match self.near(at, k) {
                true => kept.extend_from_slice(part),
                false => self.add_part(part, k, kept),
            }
        }
    }

    /// The height at a sample at most one farther from a side than where candidates are doubtful.
    fn at(&self, at: [usize; D]) -> f32 {
        let mut place = 0;
        for k in (0..D).rev() {
            place += self.before(k, at[k]);
            if self.near(at[k], k) {
                // All of it is kept. What is beyond the halo is of no interest.
                place += (0..k).rev().fold(0, |i, l| i * self.dims[l] + at[l]);
                let here = self.heights.get(place.wrapping_sub(self.first));
                return here.copied().unwrap_or(f32::NEG_INFINITY);
            }
        }
        debug_assert!(false, "{at:?} is not near a side");
        f32::NEG_INFINITY
    }
}

/// How far from the sides (samples) candidates are doubtful.
fn margin(scale: f64) -> usize {
    (1.5 * scale).ceil() as usize
}

/// Continues sheets to the sides of the box; `slab` has ridge points of a volume smoothed over `scale` samples, those of
/// at least `strong` sure, with a halo of [`SEES`] layers. Those of this rank's own layers, in the order of samples.
///
/// # Errors
/// Those of other ranks.
pub fn repair<const D: usize>(
    smoothed: Shell<D>,
    mut slab: Slab<'_, D>,
    scale: f64,
    strong: f32,
    patience: &Patience<'_>,
) -> Result<Vec<Candidate<D>>> {
    let smoothed = &smoothed.beside(&slab)?;
    let candidates = std::mem::take(&mut slab.candidates);
    let (dims, samples) = (smoothed.dims, Volume::new(smoothed.dims, &[]));
    let zone = Zone::new(dims, scale);
    let in_zone = |c: &Candidate<D>| {
        let at = samples.coordinates(c.voxel.index());
        zone.holds(at.map(|i| i as i32))
    };
    let doubtful: Vec<Candidate<D>> = (candidates.par_iter().copied())
        .filter(|c| in_zone(c))
        .collect();
    let own = candidates[slab.own.clone()].par_iter();
    let figures = [slab.own.len(), own.filter(|c| in_zone(c)).count()].map(|n| n as u64);
    let [all, in_doubt] = slab.sums("doubtful candidates", figures)?;
    // Where most is doubtful (foam, pores), there is nothing to continue from.
    if all < 2 * in_doubt {
        return Ok(slab.own_of(candidates));
    }
    let mut reliable = candidates;
    reliable.retain(|c| !in_zone(c));
    let grid = BySample::new(dims, &reliable);
    let shift = segment(dims);
    let mut fill = Continuation {
        smoothed,
        zone: &zone,
        reliable: &grid,
        points: Vec::new(),
        fronts: Vec::new(),
        previous: Vec::new(),
        shift,
        by_segment: vec![NONE; (dims.iter().product::<usize>() >> shift) + 1],
    };
    let at_rim = |c: &&Candidate<D>| c.strength >= strong && zone.near(grid.coordinates(c));
    let departure = |c: &Candidate<D>| Departure {
        level: smoothed.at(samples.coordinates(c.voxel.index())),
        normal: c.normal,
        steps: 0,
    };
    let rim: Vec<(Candidate<D>, Departure<D>)> = (reliable.par_iter().filter(at_rim))
        .map(|c| (*c, departure(c)))
        .collect();
    for some in rim.chunks(TOGETHER) {
        fill.step_from(some, patience);
    }
    let mut next = 0;
    while next < fill.points.len() && !patience.over() {
        let end = fill.points.len().min(next + TOGETHER);
        let some = fill.points[next..end].iter().zip(&fill.fronts[next..end]);
        let some = some.filter(|(_, front)| front.steps < STEPS);
        let some: Vec<_> = some.map(|(point, front)| (*point, *front)).collect();
        fill.step_from(&some, patience);
        next = end;
    }
    let mut points = fill.points;
    drop(grid);
    points.sort_by_key(|c| c.voxel);
    let continued = BySample::new(dims, &points);
    let beside = |c: &Candidate<D>| {
        let mut found = false;
        continued.each_around(continued.coordinates(c), BESIDE, |_| found = true);
        found
    };
    let mut all = reliable;
    all.par_extend(doubtful.into_par_iter().filter(|c| !beside(c)));
    all.extend(&points);
    all.par_sort_by_key(|c| c.voxel);
    Ok(slab.own_of(all))
}

/// Where candidates are doubtful: near the sides.
struct Zone<const D: usize> {
    dims: [i32; D],
    margin: i32,
}

impl<const D: usize> Zone<D> {
    fn new(dims: [usize; D], scale: f64) -> Self {
        Self {
            dims: dims.map(|n| n as i32),
            margin: margin(scale) as i32,
        }
    }

    /// Whether a sample of the box is in the zone.
    fn holds(&self, at: [i32; D]) -> bool {
        (0..D).any(|k| at[k] < self.margin || at[k] >= self.dims[k] - self.margin)
    }

    fn inside(&self, at: [i32; D]) -> bool {
        (0..D).all(|k| at[k] >= 0 && at[k] < self.dims[k])
    }

    /// Whether a sample touches the zone.
    fn near(&self, at: [i32; D]) -> bool {
        (0..D).any(|k| {
            [-1, 1].iter().any(|s| {
                let mut next = at;
                next[k] += s;
                self.inside(next) && self.holds(next)
            })
        })
    }
}

/// Where a front left the reliable part of its sheet.
#[derive(Clone, Copy)]
struct Departure<const D: usize> {
    /// The smoothed image there.
    level: f32,
    /// The sheet's normal there.
    normal: [f32; D],
    /// Columns passed since.
    steps: u32,
}

/// The fronts that fill the zone.
struct Continuation<'a, const D: usize> {
    smoothed: &'a Shell<D>,
    zone: &'a Zone<D>,
    reliable: &'a BySample<'a, D>,
    points: Vec<Candidate<D>>,
    /// Where the front of each new point comes from.
    fronts: Vec<Departure<D>>,
    /// New points are listed by this many samples in a row, as a power of two.
    shift: u32,
    /// The latest new point among these.
    by_segment: Vec<u32>,
    /// For each new point, the one before it among the same samples.
    previous: Vec<u32>,
}

/// The column in which a point was sought, and the point.
type Step<const D: usize> = ([i32; D], Candidate<D>);

impl<const D: usize> Continuation<'_, D> {
    /// Tries to continue sheets from some points, one after the other, into the columns around each. What
    /// each would give is found first, by all threads: what is taken meanwhile stays taken.
    fn step_from(&mut self, some: &[(Candidate<D>, Departure<D>)], patience: &Patience<'_>) {
        let steps = some.par_iter().with_min_len(FEW);
        let steps: Vec<_> = steps
            .map(|(from, front)| match patience.over() {
                true => [[None; 2]; D],
                false => self.steps(from, front),
            })
            .collect();
        for ((from, front), steps) in some.iter().zip(steps) {
            for (column, point) in steps.into_iter().flatten().flatten() {
                let at = point.position.map(nearest);
                if self.taken(column, from) || self.taken(at, from) {
                    continue;
                }
                let latest = &mut self.by_segment[point.voxel.index() >> self.shift];
                self.previous.push(*latest);
                *latest = self.points.len() as u32;
                self.points.push(point);
                self.fronts.push(Departure {
                    steps: front.steps + 1,
                    ..*front
                });
            }
        }
    }

    /// Where a sheet goes on from a point in the columns around it, one behind and one ahead along each axis
    /// but its own, unless that is taken.
    fn steps(&self, from: &Candidate<D>, front: &Departure<D>) -> [[Option<Step<D>>; 2]; D] {
        let (axis, least) = (from.axis as usize, SUPPORT * front.level);
        let step = |lateral: usize, by: f32| {
            let mut guess = from.position;
            guess[lateral] += by;
            guess[axis] -= by * from.normal[lateral] / from.normal[axis];
            let column = guess.map(nearest);
            if !self.zone.inside(column)
                || !self.zone.holds(column)
                || self.taken(column, from)
                || !self.reaches(least, column, axis)
            {
                return None;
            }
            let mut fits = RADII.iter();
            let point = fits.find_map(|&radius| self.fit(guess, from, radius))?;
            let at = point.position.map(nearest);
            let goes_on = self.zone.holds(at)
                && self.smoothed.at(at.map(|i| i as usize)) >= least
                && dot(point.normal, front.normal).abs() >= SAME_NORMAL;
            goes_on.then_some((column, point))
        };
        std::array::from_fn(|k| match k {
            0 => [None; 2],
            _ => [-1.0, 1.0].map(|by| step((axis + k) % D, by)),
        })
    }

    /// Whether the smoothed image is at least this high anywhere a fit in a column may end.
    fn reaches(&self, least: f32, column: [i32; D], axis: usize) -> bool {
        (-1..=1).any(|j| {
            let mut at = column;
            at[axis] += j;
            self.zone.inside(at) && self.smoothed.at(at.map(|i| i as usize)) >= least
        })
    }

    /// Whether the column round `at` has a new point of the sheet of `like` already.
    fn taken(&self, at: [i32; D], like: &Candidate<D>) -> bool {
        let axis = like.axis as usize;
        (-1..=1).any(|j| {
            let mut v = at;
            v[axis] += j;
            if !self.zone.inside(v) {
                return false;
            }
            let voxel = Voxel::of(self.smoothed.dims, v.map(|i| i as usize));
            let mut count = 0;
            let mut i = self.by_segment[voxel.index() >> self.shift];
            while i != NONE {
                let p = &self.points[i as usize];
                if p.voxel == voxel {
                    count += 1;
                    if p.axis == like.axis && dot(p.normal, like.normal).abs() > SAME_FIT {
                        return true;
                    }
                }
                i = self.previous[i as usize];
            }
            count >= MOST
        })
    }

    /// The point of the sheet of `like` in the column round `guess`.
    fn fit(&self, guess: [f32; D], like: &Candidate<D>, radius: i32) -> Option<Candidate<D>> {
        let axis = like.axis as usize;
        let n = like.normal;
        let mut surface = Quadric::<D>::new(radius);
        let mut count = 0;
        let centre = guess.map(nearest);
        // Smoothing ties neighbours together: columns a few samples apart carry all there is to know.
        let stride = if radius > RADII[0] { 3 } else { 2 };
        let side = 2 * radius / stride + 1;
        for number in 0..side.pow(D as u32 - 1) {
            let mut rest = number;
            let mut away = [0i32; D];
            for k in 1..D {
                away[(axis + k) % D] = rest % side * stride - radius;
                rest /= side;
            }
            if away.iter().map(|u| u * u).sum::<i32>() > radius * radius {
                continue;
            }
            let slope = -dot(n, away.map(|u| u as f32)) / n[axis];
            let slack = 1 + away.iter().fold(0, |a, u| a.max(u.abs())) / 6;
            let mut at: [i32; D] = std::array::from_fn(|k| centre[k] + away[k]);
            let middle = nearest(guess[axis] + slope);
            at[axis] = middle - slack;
            self.reliable.each_in_column(at, axis, 2 * slack + 1, |i| {
                let q = &self.reliable.candidates[i];
                let away = sub(q.position, guess);
                let distance = dot(away, away).sqrt();
                if dot(q.normal, n).abs() >= SAME_NORMAL
                    && dot(away, n).abs() <= 0.75 + 0.12 * distance
                {
                    count += 1;
                    surface.add(away, axis);
                }
            });
        }
        if count < Quadric::<D>::TERMS {
            return None;
        }
        let c = surface.solve()?;
        let height = c[0] as f32;
        let mut position = guess;
        position[axis] += height;
        let mut normal = [0.0f32; D];
        normal[axis] = 1.0;
        for k in 1..D {
            normal[(axis + k) % D] = -c[k] as f32;
        }
        let length = dot(normal, normal).sqrt();
        let normal = normal.map(|c| c / length);
        let at = position.map(nearest);
        let agrees = height.abs() < 1.0 && dot(normal, n).abs() >= SAME_NORMAL;
        if !agrees || !self.zone.inside(at) {
            return None;
        }
        Some(Candidate {
            voxel: Voxel::of(self.smoothed.dims, at.map(|i| i as usize)),
            axis: like.axis,
            position,
            normal,
            strength: like.strength,
        })
    }
}

//! Ridges up to the sides of the box.
//!
//! At the sides of the box, mirrored samples bend crests and turn the Hessian's eigenvectors. There
//! candidates are *doubtful*. The others tell where the sheets run: from the rim of the doubtful zone
//! each sheet is continued column by column, every new point read from a quadratic surface fitted to the
//! reliable points nearby. Doubtful candidates beside a continued sheet are dropped.

use super::candidate::{Candidate, Voxel, nearest_sample};
use super::candidate_slab::CandidateSlab;
use super::quadric::Quadric;
use super::volume::Volume;
use super::voxel_index::{CandidateIndex, segment_bits};
use crate::error::Result;
use crate::geometry::{dot, sub};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Reliable points within this many samples of a new point are fitted; the second radius is for the
/// middle of wide zones, where the first finds too few.
const FIT_RADII: [i32; 2] = [8, 15];
/// Normals of one sheet agree at least this much (cosine).
const SAME_NORMAL_COSINE: f32 = 0.966;
/// Two fits of one sheet agree at least this much (cosine).
const SAME_FIT_COSINE: f32 = 0.97;
/// A sheet goes on while the smoothed image is at least this share of what it was at the rim.
const MIN_SUPPORT_RATIO: f32 = 0.7;
/// No point.
const NO_POINT: u32 = u32::MAX;
/// A front goes this many columns into the zone at most.
const MAX_STEPS: u32 = 16;
/// What is continued depends on no layers farther off than this: on those that fronts come from, which others may
/// stand in the way of, and on those of the points that are fitted.
pub const HALO_LAYERS: usize = 64;
/// So many fronts go on together ...
const BATCH_SIZE: usize = 1 << 12;
/// ... and at least so many on one thread.
const MIN_FRONTS_PER_THREAD: usize = 64;
/// A sample is given this many new points at most.
const MAX_POINTS_PER_SAMPLE: usize = 4;
/// Doubtful candidates at most this many samples along each axis from a new point are dropped.
const DROP_RADIUS: i32 = 2;

/// The heights of a smoothed volume that [`boundary_extension`] asks for: near the sides of the box, of some layers.
pub struct BoundaryShell<const D: usize> {
    dims: [usize; D],
    /// Samples along each axis from either side that are kept: none or all of them, if they would meet.
    low_width: [usize; D],
    high_width: [usize; D],
    /// Those of the layers that are here, of which the first is one of so many before it.
    heights: Vec<f32>,
    first_layer: usize,
}

impl<const D: usize> BoundaryShell<D> {
    /// For a volume smoothed over `scale` samples, without its heights.
    pub fn new(dims: [usize; D], scale: f64) -> Self {
        let width = side_margin(scale) + 1;
        let met = |k: usize| dims[k] <= 2 * width;
        Self {
            dims,
            low_width: std::array::from_fn(|k| if met(k) { dims[k] } else { width }),
            high_width: std::array::from_fn(|k| if met(k) { 0 } else { width }),
            heights: Vec::new(),
            first_layer: 0,
        }
    }

    /// With the heights of this rank's own layers.
    pub fn with_heights(self, heights: Vec<f32>) -> Self {
        Self { heights, ..self }
    }

    /// With those of the halo, too.
    fn with_halo(mut self, slab: &CandidateSlab<'_, D>) -> Result<Self> {
        let own = std::mem::take(&mut self.heights);
        let before = |layer: usize| self.layer_offset(D - 1, layer);
        let (heights, first) = slab.layers_with_halo("heights near sides", own, before)?;
        Ok(Self {
            heights,
            first_layer: first,
            ..self
        })
    }

    /// How many heights are kept of a layer's layers before one of these, square to an axis.
    fn layer_offset(&self, k: usize, at: usize) -> usize {
        let near = at.min(self.low_width[k]) + at.saturating_sub(self.dims[k] - self.high_width[k]);
        near * self.layer_len(k) + (at - near) * self.kept_len(k)
    }

    /// Samples of a layer square to an axis, of those axes before it.
    fn layer_len(&self, axis: usize) -> usize {
        self.dims[..axis].iter().product()
    }

    /// Those of them that are kept where the layer is not near a side.
    fn kept_len(&self, axis: usize) -> usize {
        match axis {
            0 => 0,
            _ => {
                let k = axis - 1;
                let near = self.low_width[k] + self.high_width[k];
                near * self.layer_len(k) + (self.dims[k] - near) * self.kept_len(k)
            }
        }
    }

    /// The heights that are kept of some layers along the last axis.
    pub fn extract_layers(&self, layers: &[f32], first: usize) -> Vec<f32> {
        let (last, mut kept) = (D - 1, Vec::new());
        let count = layers.len() / self.layer_len(last).max(1);
        let near = (first..first + count)
            .filter(|&i| self.is_near_side(i, last))
            .count();
        kept.reserve_exact(near * self.layer_len(last) + (count - near) * self.kept_len(last));
        for (i, layer) in layers.chunks_exact(self.layer_len(last).max(1)).enumerate() {
            match self.is_near_side(first + i, last) {
                true => kept.extend_from_slice(layer),
                false => self.append_layer(layer, last, &mut kept),
            }
        }
        kept
    }

    fn is_near_side(&self, at: usize, k: usize) -> bool {
        at < self.low_width[k] || at >= self.dims[k] - self.high_width[k]
    }

    /// Adds what is kept of a layer square to an axis.
    fn append_layer(&self, layer: &[f32], axis: usize, kept: &mut Vec<f32>) {
        let k = axis - 1;
        if k == 0 {
            kept.extend_from_slice(&layer[..self.low_width[0]]);
            kept.extend_from_slice(&layer[self.dims[0] - self.high_width[0]..]);
            return;
        }
        for (at, part) in layer.chunks_exact(self.layer_len(k).max(1)).enumerate() {
            match self.is_near_side(at, k) {
                true => kept.extend_from_slice(part),
                false => self.append_layer(part, k, kept),
            }
        }
    }

    /// The height at a sample at most one farther from a side than where candidates are doubtful.
    fn height_at(&self, at: [usize; D]) -> f32 {
        let mut place = 0;
        for k in (0..D).rev() {
            place += self.layer_offset(k, at[k]);
            if self.is_near_side(at[k], k) {
                // All of it is kept. What is beyond the halo is of no interest.
                place += (0..k).rev().fold(0, |i, l| i * self.dims[l] + at[l]);
                let here = self.heights.get(place.wrapping_sub(self.first_layer));
                return here.copied().unwrap_or(f32::NEG_INFINITY);
            }
        }
        debug_assert!(false, "{at:?} is not near a side");
        f32::NEG_INFINITY
    }
}

/// How far from the sides (samples) candidates are doubtful.
fn side_margin(scale: f64) -> usize {
    (1.5 * scale).ceil() as usize
}

/// Continues sheets to the sides of the box; `slab` has ridge points of a volume smoothed over `scale` samples, those of
/// at least `strong` sure, with a halo of [`HALO_LAYERS`] layers. Those of this rank's own layers, in the order of samples.
///
/// # Errors
/// Those of other ranks.
pub fn extend_to_sides<const D: usize>(
    smoothed: BoundaryShell<D>,
    mut slab: CandidateSlab<'_, D>,
    scale: f64,
    strong: f32,
    patience: &CancelToken<'_>,
) -> Result<Vec<Candidate<D>>> {
    let smoothed = &smoothed.with_halo(&slab)?;
    let candidates = std::mem::take(&mut slab.candidates);
    let (dims, samples) = (smoothed.dims, Volume::new(smoothed.dims, &[]));
    let zone = DoubtfulZone::new(dims, scale);
    let in_zone = |c: &Candidate<D>| {
        let at = samples.coordinates(c.voxel.index());
        zone.contains(at.map(|i| i as i32))
    };
    let doubtful: Vec<Candidate<D>> = (candidates.par_iter().copied())
        .filter(|c| in_zone(c))
        .collect();
    let own = candidates[slab.owned.clone()].par_iter();
    let figures = [slab.owned.len(), own.filter(|c| in_zone(c)).count()].map(|n| n as u64);
    let [all, in_doubt] = slab.global_sums("doubtful candidates", figures)?;
    // Where most is doubtful (foam, pores), there is nothing to continue from.
    if all < 2 * in_doubt {
        return Ok(slab.owned_candidates(candidates));
    }
    let mut reliable = candidates;
    reliable.retain(|c| !in_zone(c));
    let grid = CandidateIndex::new(dims, &reliable);
    let shift = segment_bits(dims);
    let mut fill = Continuation {
        shell: smoothed,
        zone: &zone,
        reliable_points: &grid,
        points: Vec::new(),
        fronts: Vec::new(),
        previous: Vec::new(),
        shift,
        latest_in_segment: vec![NO_POINT; (dims.iter().product::<usize>() >> shift) + 1],
    };
    let at_rim = |c: &&Candidate<D>| c.strength >= strong && zone.touches(grid.coordinates(c));
    let departure = |c: &Candidate<D>| FrontOrigin {
        level: smoothed.height_at(samples.coordinates(c.voxel.index())),
        normal: c.normal,
        steps: 0,
    };
    let rim: Vec<(Candidate<D>, FrontOrigin<D>)> = (reliable.par_iter().filter(at_rim))
        .map(|c| (*c, departure(c)))
        .collect();
    for some in rim.chunks(BATCH_SIZE) {
        fill.advance(some, patience);
    }
    let mut next = 0;
    while next < fill.points.len() && !patience.is_cancelled() {
        let end = fill.points.len().min(next + BATCH_SIZE);
        let some = fill.points[next..end].iter().zip(&fill.fronts[next..end]);
        let some = some.filter(|(_, front)| front.steps < MAX_STEPS);
        let some: Vec<_> = some.map(|(point, front)| (*point, *front)).collect();
        fill.advance(&some, patience);
        next = end;
    }
    let mut points = fill.points;
    drop(grid);
    points.sort_by_key(|c| c.voxel);
    let continued = CandidateIndex::new(dims, &points);
    let beside = |c: &Candidate<D>| {
        let mut found = false;
        continued.for_each_around(continued.coordinates(c), DROP_RADIUS, |_| found = true);
        found
    };
    let mut all = reliable;
    all.par_extend(doubtful.into_par_iter().filter(|c| !beside(c)));
    all.extend(&points);
    all.par_sort_by_key(|c| c.voxel);
    Ok(slab.owned_candidates(all))
}

/// Where candidates are doubtful: near the sides.
struct DoubtfulZone<const D: usize> {
    dims: [i32; D],
    margin: i32,
}

impl<const D: usize> DoubtfulZone<D> {
    fn new(dims: [usize; D], scale: f64) -> Self {
        Self {
            dims: dims.map(|n| n as i32),
            margin: side_margin(scale) as i32,
        }
    }

    /// Whether a sample of the box is in the zone.
    fn contains(&self, at: [i32; D]) -> bool {
        (0..D).any(|k| at[k] < self.margin || at[k] >= self.dims[k] - self.margin)
    }

    fn is_in_box(&self, at: [i32; D]) -> bool {
        (0..D).all(|k| at[k] >= 0 && at[k] < self.dims[k])
    }

    /// Whether a sample touches the zone.
    fn touches(&self, at: [i32; D]) -> bool {
        (0..D).any(|k| {
            [-1, 1].iter().any(|s| {
                let mut next = at;
                next[k] += s;
                self.is_in_box(next) && self.contains(next)
            })
        })
    }
}

/// Where a front left the reliable part of its sheet.
#[derive(Clone, Copy)]
struct FrontOrigin<const D: usize> {
    /// The smoothed image there.
    level: f32,
    /// The sheet's normal there.
    normal: [f32; D],
    /// Columns passed since.
    steps: u32,
}

/// The fronts that fill the zone.
struct Continuation<'a, const D: usize> {
    shell: &'a BoundaryShell<D>,
    zone: &'a DoubtfulZone<D>,
    reliable_points: &'a CandidateIndex<'a, D>,
    points: Vec<Candidate<D>>,
    /// Where the front of each new point comes from.
    fronts: Vec<FrontOrigin<D>>,
    /// New points are listed by this many samples in a row, as a power of two.
    shift: u32,
    /// The latest new point among these.
    latest_in_segment: Vec<u32>,
    /// For each new point, the one before it among the same samples.
    previous: Vec<u32>,
}

/// The column in which a point was sought, and the point.
type ColumnPoint<const D: usize> = ([i32; D], Candidate<D>);

impl<const D: usize> Continuation<'_, D> {
    /// Tries to continue sheets from some points, one after the other, into the columns around each. What
    /// each would give is found first, by all threads: what is taken meanwhile stays taken.
    fn advance(&mut self, some: &[(Candidate<D>, FrontOrigin<D>)], patience: &CancelToken<'_>) {
        let steps = some.par_iter().with_min_len(MIN_FRONTS_PER_THREAD);
        let steps: Vec<_> = steps
            .map(|(from, front)| match patience.is_cancelled() {
                true => [[None; 2]; D],
                false => self.next_points(from, front),
            })
            .collect();
        for ((from, front), steps) in some.iter().zip(steps) {
            for (column, point) in steps.into_iter().flatten().flatten() {
                let at = point.position.map(nearest_sample);
                if self.is_occupied(column, from) || self.is_occupied(at, from) {
                    continue;
                }
                let latest = &mut self.latest_in_segment[point.voxel.index() >> self.shift];
                self.previous.push(*latest);
                *latest = self.points.len() as u32;
                self.points.push(point);
                self.fronts.push(FrontOrigin {
                    steps: front.steps + 1,
                    ..*front
                });
            }
        }
    }

    /// Where a sheet goes on from a point in the columns around it, one behind and one ahead along each axis
    /// but its own, unless that is taken.
    fn next_points(
        &self,
        from: &Candidate<D>,
        front: &FrontOrigin<D>,
    ) -> [[Option<ColumnPoint<D>>; 2]; D] {
        let (axis, least) = (from.axis as usize, MIN_SUPPORT_RATIO * front.level);
        let step = |lateral: usize, by: f32| {
            let mut guess = from.position;
            guess[lateral] += by;
            guess[axis] -= by * from.normal[lateral] / from.normal[axis];
            let column = guess.map(nearest_sample);
            if !self.zone.is_in_box(column)
                || !self.zone.contains(column)
                || self.is_occupied(column, from)
                || !self.is_supported(least, column, axis)
            {
                return None;
            }
            let mut fits = FIT_RADII.iter();
            let point = fits.find_map(|&radius| self.fit_point(guess, from, radius))?;
            let at = point.position.map(nearest_sample);
            let goes_on = self.zone.contains(at)
                && self.shell.height_at(at.map(|i| i as usize)) >= least
                && dot(point.normal, front.normal).abs() >= SAME_NORMAL_COSINE;
            goes_on.then_some((column, point))
        };
        std::array::from_fn(|k| match k {
            0 => [None; 2],
            _ => [-1.0, 1.0].map(|by| step((axis + k) % D, by)),
        })
    }

    /// Whether the smoothed image is at least this high anywhere a fit in a column may end.
    fn is_supported(&self, least: f32, column: [i32; D], axis: usize) -> bool {
        (-1..=1).any(|j| {
            let mut at = column;
            at[axis] += j;
            self.zone.is_in_box(at) && self.shell.height_at(at.map(|i| i as usize)) >= least
        })
    }

    /// Whether the column round `at` has a new point of the sheet of `like` already.
    fn is_occupied(&self, at: [i32; D], like: &Candidate<D>) -> bool {
        let axis = like.axis as usize;
        (-1..=1).any(|j| {
            let mut v = at;
            v[axis] += j;
            if !self.zone.is_in_box(v) {
                return false;
            }
            let voxel = Voxel::new(self.shell.dims, v.map(|i| i as usize));
            let mut count = 0;
            let mut i = self.latest_in_segment[voxel.index() >> self.shift];
            while i != NO_POINT {
                let p = &self.points[i as usize];
                if p.voxel == voxel {
                    count += 1;
                    if p.axis == like.axis && dot(p.normal, like.normal).abs() > SAME_FIT_COSINE {
                        return true;
                    }
                }
                i = self.previous[i as usize];
            }
            count >= MAX_POINTS_PER_SAMPLE
        })
    }

    /// The point of the sheet of `like` in the column round `guess`.
    fn fit_point(&self, guess: [f32; D], like: &Candidate<D>, radius: i32) -> Option<Candidate<D>> {
        let axis = like.axis as usize;
        let n = like.normal;
        let mut surface = Quadric::<D>::new(radius);
        let mut count = 0;
        let centre = guess.map(nearest_sample);
        // Smoothing ties neighbours together: columns a few samples apart carry all there is to know.
        let stride = if radius > FIT_RADII[0] { 3 } else { 2 };
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
            let middle = nearest_sample(guess[axis] + slope);
            at[axis] = middle - slack;
            self.reliable_points
                .for_each_in_column(at, axis, 2 * slack + 1, |i| {
                    let q = &self.reliable_points.candidates[i];
                    let away = sub(q.position, guess);
                    let distance = dot(away, away).sqrt();
                    if dot(q.normal, n).abs() >= SAME_NORMAL_COSINE
                        && dot(away, n).abs() <= 0.75 + 0.12 * distance
                    {
                        count += 1;
                        surface.add(away, axis);
                    }
                });
        }
        if count < Quadric::<D>::TERM_COUNT {
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
        let at = position.map(nearest_sample);
        let agrees = height.abs() < 1.0 && dot(normal, n).abs() >= SAME_NORMAL_COSINE;
        if !agrees || !self.zone.is_in_box(at) {
            return None;
        }
        Some(Candidate {
            voxel: Voxel::new(self.shell.dims, at.map(|i| i as usize)),
            axis: like.axis,
            position,
            normal,
            strength: like.strength,
        })
    }
}

//! Extends ridges to the sides of the box.
//!
//! Near the sides of the box, mirrored samples bend the crests of ridges and turn the eigenvectors
//! of the Hessian. Candidates there are *doubtful*; the others are reliable. From the rim of the
//! doubtful zone, each surface is continued column by column: every new point is read from a
//! quadratic surface fitted to nearby reliable points. Doubtful candidates near a continued surface
//! are dropped.

use super::candidate::{Candidate, Voxel, nearest_sample};
use super::quadric::Quadric;
use super::shared_grid::CandidateSlab;
use super::volume::Volume;
use super::voxel_index::{CandidateIndex, segment_bits};
use crate::error::Result;
use crate::geometry::NONE;
use crate::geometry::{dot, norm, sub, unit};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Radii (samples) of the neighbourhood of a new point that is fitted. The second radius is for the
/// middle of wide zones, where the first finds too few points.
const FIT_RADII: [i32; 2] = [8, 15];
/// Smallest cosine between normals of one surface.
const SAME_NORMAL_COSINE: f32 = 0.966;
/// Smallest cosine between the normals of two fits of one surface.
const SAME_FIT_COSINE: f32 = 0.97;
/// A surface continues while the smoothed image is at least this share of its value at the rim.
const MIN_SUPPORT_RATIO: f32 = 0.7;
/// Largest number of columns that a front goes into the zone.
const MAX_STEPS: u32 = 16;
/// Number of layers on which the result depends: the layers from which fronts come, those of other
/// fronts that may stop them, and those of the fitted points.
pub const HALO_LAYERS: usize = 64;
/// Number of fronts that advance together.
const BATCH_SIZE: usize = 1 << 12;
/// Smallest number of fronts on one thread.
const MIN_FRONTS_PER_THREAD: usize = 64;
/// Largest number of new points at one sample.
const MAX_POINTS_PER_SAMPLE: usize = 4;
/// Doubtful candidates within this many samples, along each axis, of a new point are dropped.
const DROP_RADIUS: i32 = 2;

/// Heights of a smoothed volume near the sides of the box, in some layers, as the
/// [extension](extend_to_sides) of ridges needs them.
pub struct BoundaryShell<const D: usize> {
    dims: [usize; D],
    /// Number of samples along each axis, from the low and from the high side, whose heights are
    /// kept. If the two zones would meet, all samples are kept.
    low_width: [usize; D],
    high_width: [usize; D],
    /// Kept heights of the available layers, and number of kept heights in the layers before them.
    heights: Vec<f32>,
    first_layer: usize,
}

impl<const D: usize> BoundaryShell<D> {
    /// Creates the shell of a volume smoothed over `scale` samples, without its heights.
    pub fn new(dims: [usize; D], scale: f64) -> Self {
        let width = side_margin(scale) + 1;
        let sides_meet = |k: usize| dims[k] <= 2 * width;
        Self {
            dims,
            low_width: std::array::from_fn(|k| if sides_meet(k) { dims[k] } else { width }),
            high_width: std::array::from_fn(|k| if sides_meet(k) { 0 } else { width }),
            heights: Vec::new(),
            first_layer: 0,
        }
    }

    /// Sets the heights of the layers that this rank owns.
    pub fn with_heights(self, heights: Vec<f32>) -> Self {
        Self { heights, ..self }
    }

    /// Adds the heights of the halo.
    fn with_halo(mut self, slab: &CandidateSlab<'_, D>) -> Result<Self> {
        let owned = std::mem::take(&mut self.heights);
        let offset = |layer: usize| self.layer_offset(D - 1, layer);
        let (heights, first_layer) = slab.layers_with_halo("heights near sides", owned, offset)?;
        Ok(Self {
            heights,
            first_layer,
            ..self
        })
    }

    /// Returns the number of kept heights in the sub-layers square to axis `k` before index
    /// `index`.
    fn layer_offset(&self, k: usize, index: usize) -> usize {
        let near_sides =
            index.min(self.low_width[k]) + index.saturating_sub(self.dims[k] - self.high_width[k]);
        near_sides * self.layer_len(k) + (index - near_sides) * self.kept_len(k)
    }

    /// Returns the number of samples of a sub-layer square to an axis, along the axes before it.
    fn layer_len(&self, axis: usize) -> usize {
        self.dims[..axis].iter().product()
    }

    /// Returns the number of them that are kept if the sub-layer is not near a side.
    fn kept_len(&self, axis: usize) -> usize {
        match axis {
            0 => 0,
            _ => {
                let k = axis - 1;
                let near_sides = self.low_width[k] + self.high_width[k];
                near_sides * self.layer_len(k) + (self.dims[k] - near_sides) * self.kept_len(k)
            }
        }
    }

    /// Returns the kept heights of some layers along the last axis, of which `first` is the first.
    pub fn extract_layers(&self, layers: &[f32], first: usize) -> Vec<f32> {
        let (last, mut kept) = (D - 1, Vec::new());
        let count = layers.len() / self.layer_len(last).max(1);
        let near_sides = (first..first + count)
            .filter(|&i| self.is_near_side(i, last))
            .count();
        kept.reserve_exact(
            near_sides * self.layer_len(last) + (count - near_sides) * self.kept_len(last),
        );
        for (i, layer) in layers.chunks_exact(self.layer_len(last).max(1)).enumerate() {
            if self.is_near_side(first + i, last) {
                kept.extend_from_slice(layer);
            } else {
                self.append_layer(layer, last, &mut kept);
            }
        }
        kept
    }

    fn is_near_side(&self, at: usize, k: usize) -> bool {
        at < self.low_width[k] || at >= self.dims[k] - self.high_width[k]
    }

    /// Appends the kept heights of a sub-layer square to an axis.
    fn append_layer(&self, layer: &[f32], axis: usize, kept: &mut Vec<f32>) {
        let k = axis - 1;
        if k == 0 {
            kept.extend_from_slice(&layer[..self.low_width[0]]);
            kept.extend_from_slice(&layer[self.dims[0] - self.high_width[0]..]);
            return;
        }
        for (at, part) in layer.chunks_exact(self.layer_len(k).max(1)).enumerate() {
            if self.is_near_side(at, k) {
                kept.extend_from_slice(part);
            } else {
                self.append_layer(part, k, kept);
            }
        }
    }

    /// Returns the height at a sample of the doubtful zone or next to it.
    fn height_at(&self, at: [usize; D]) -> f32 {
        let mut offset = 0;
        for k in (0..D).rev() {
            offset += self.layer_offset(k, at[k]);
            if self.is_near_side(at[k], k) {
                // The whole sub-layer is kept. Samples beyond the halo do not influence the owned
                // layers.
                offset += (0..k).rev().fold(0, |i, l| i * self.dims[l] + at[l]);
                let height = self.heights.get(offset.wrapping_sub(self.first_layer));
                return height.copied().unwrap_or(f32::NEG_INFINITY);
            }
        }
        debug_assert!(false, "{at:?} is not near a side");
        f32::NEG_INFINITY
    }
}

/// Returns the distance from the sides (samples) within which candidates are doubtful.
fn side_margin(scale: f64) -> usize {
    (1.5 * scale).ceil() as usize
}

/// Continues surfaces to the sides of the box. `slab` has the ridge points of a volume smoothed
/// over `scale` samples, with a halo of [`HALO_LAYERS`] layers; surfaces are continued from points
/// of at least `min_rim_strength`. Returns the candidates of the layers that this rank owns, in the
/// order of samples.
///
/// # Errors
/// Returns the errors of other ranks.
pub fn extend_to_sides<const D: usize>(
    shell: BoundaryShell<D>,
    mut slab: CandidateSlab<'_, D>,
    scale: f64,
    min_rim_strength: f32,
    cancel: &CancelToken<'_>,
) -> Result<Vec<Candidate<D>>> {
    let shell = &shell.with_halo(&slab)?;
    let candidates = std::mem::take(&mut slab.candidates);
    let (dims, samples) = (shell.dims, Volume::new(shell.dims, &[]));
    let zone = DoubtfulZone::new(dims, scale);
    let in_zone = |c: &Candidate<D>| {
        let at = samples.coordinates(c.voxel.index());
        zone.contains(at.map(|i| i as i32))
    };
    let doubtful: Vec<Candidate<D>> = (candidates.par_iter().copied())
        .filter(|c| in_zone(c))
        .collect();
    let owned = candidates[slab.owned.clone()].par_iter();
    let counts = [slab.owned.len(), owned.filter(|c| in_zone(c)).count()];
    let [total, doubtful_count] = slab.grid.sum("doubtful candidates", counts)?;
    // Where most candidates are doubtful (foam, pores), there is nothing to continue from.
    if total < 2 * doubtful_count {
        return Ok(slab.owned_candidates(candidates));
    }
    let mut reliable = candidates;
    reliable.retain(|c| !in_zone(c));
    let grid = CandidateIndex::new(dims, &reliable);
    let shift = segment_bits(dims);
    let mut continuation = Continuation {
        shell,
        zone: &zone,
        reliable_points: &grid,
        points: Vec::new(),
        fronts: Vec::new(),
        previous: Vec::new(),
        shift,
        latest_in_segment: vec![NONE; (dims.iter().product::<usize>() >> shift) + 1],
    };
    let at_rim =
        |c: &&Candidate<D>| c.strength >= min_rim_strength && zone.touches(grid.coordinates(c));
    let origin = |c: &Candidate<D>| FrontOrigin {
        level: shell.height_at(samples.coordinates(c.voxel.index())),
        normal: c.normal,
        steps: 0,
    };
    let rim: Vec<(Candidate<D>, FrontOrigin<D>)> = (reliable.par_iter().filter(at_rim))
        .map(|c| (*c, origin(c)))
        .collect();
    for batch in rim.chunks(BATCH_SIZE) {
        continuation.advance(batch, cancel);
    }
    let mut next = 0;
    while next < continuation.points.len() && !cancel.is_cancelled() {
        let end = continuation.points.len().min(next + BATCH_SIZE);
        let batch = continuation.points[next..end]
            .iter()
            .zip(&continuation.fronts[next..end]);
        let batch = batch.filter(|(_, front)| front.steps < MAX_STEPS);
        let batch: Vec<_> = batch.map(|(point, front)| (*point, *front)).collect();
        continuation.advance(&batch, cancel);
        next = end;
    }
    let mut points = continuation.points;
    drop(grid);
    points.sort_by_key(|c| c.voxel);
    let continued = CandidateIndex::new(dims, &points);
    let is_near_new = |c: &Candidate<D>| {
        let mut found = false;
        continued.for_each_around(continued.coordinates(c), DROP_RADIUS, |_| found = true);
        found
    };
    let mut all = reliable;
    all.par_extend(doubtful.into_par_iter().filter(|c| !is_near_new(c)));
    all.extend(&points);
    all.par_sort_by_key(|c| c.voxel);
    Ok(slab.owned_candidates(all))
}

/// The zone near the sides in which candidates are doubtful.
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

    /// Returns `true` if a sample of the box is in the zone.
    fn contains(&self, at: [i32; D]) -> bool {
        (0..D).any(|k| at[k] < self.margin || at[k] >= self.dims[k] - self.margin)
    }

    fn is_in_box(&self, at: [i32; D]) -> bool {
        (0..D).all(|k| at[k] >= 0 && at[k] < self.dims[k])
    }

    /// Returns `true` if a neighbour of a sample is in the zone.
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

/// The point at which a front left the reliable part of its surface.
#[derive(Clone, Copy)]
struct FrontOrigin<const D: usize> {
    /// Value of the smoothed image there.
    level: f32,
    /// Normal of the surface there.
    normal: [f32; D],
    /// Number of columns passed since.
    steps: u32,
}

/// The fronts that advance into the zone.
struct Continuation<'a, const D: usize> {
    shell: &'a BoundaryShell<D>,
    zone: &'a DoubtfulZone<D>,
    reliable_points: &'a CandidateIndex<'a, D>,
    points: Vec<Candidate<D>>,
    /// Origin of the front of each new point.
    fronts: Vec<FrontOrigin<D>>,
    /// Number of successive samples per list of new points, as a power of two.
    shift: u32,
    /// Latest new point in each such segment of samples.
    latest_in_segment: Vec<u32>,
    /// For each new point, the one before it in the same segment.
    previous: Vec<u32>,
}

/// The column in which a point was searched for, and the point.
type ColumnPoint<const D: usize> = ([i32; D], Candidate<D>);

impl<const D: usize> Continuation<'_, D> {
    /// Tries to continue surfaces from each of some points into the columns around it. All fits are
    /// made first, in parallel; then points are accepted in order, unless an earlier one has taken
    /// the place.
    fn advance(&mut self, batch: &[(Candidate<D>, FrontOrigin<D>)], cancel: &CancelToken<'_>) {
        let steps = batch.par_iter().with_min_len(MIN_FRONTS_PER_THREAD);
        let steps: Vec<_> = steps
            .map(|(source, front)| {
                if cancel.is_cancelled() {
                    [[None; 2]; D]
                } else {
                    self.next_points(source, front)
                }
            })
            .collect();
        for ((source, front), steps) in batch.iter().zip(steps) {
            for (column, point) in steps.into_iter().flatten().flatten() {
                let at = point.position.map(nearest_sample);
                if self.is_occupied(column, source) || self.is_occupied(at, source) {
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

    /// Returns the points at which a surface continues from a point, in the columns before and
    /// after it along each axis but its own, unless these are occupied.
    fn next_points(
        &self,
        source: &Candidate<D>,
        front: &FrontOrigin<D>,
    ) -> [[Option<ColumnPoint<D>>; 2]; D] {
        let (axis, min_level) = (source.axis as usize, MIN_SUPPORT_RATIO * front.level);
        let step = |lateral: usize, offset: f32| {
            let mut guess = source.position;
            guess[lateral] += offset;
            guess[axis] -= offset * source.normal[lateral] / source.normal[axis];
            let column = guess.map(nearest_sample);
            if !self.zone.is_in_box(column)
                || !self.zone.contains(column)
                || self.is_occupied(column, source)
                || !self.is_supported(min_level, column, axis)
            {
                return None;
            }
            let mut fits = FIT_RADII.iter();
            let point = fits.find_map(|&radius| self.fit_point(guess, source, radius))?;
            let at = point.position.map(nearest_sample);
            let continues = self.zone.contains(at)
                && self.shell.height_at(at.map(|i| i as usize)) >= min_level
                && dot(point.normal, front.normal).abs() >= SAME_NORMAL_COSINE;
            continues.then_some((column, point))
        };
        std::array::from_fn(|k| match k {
            0 => [None; 2],
            _ => [-1.0, 1.0].map(|offset| step((axis + k) % D, offset)),
        })
    }

    /// Returns `true` if the smoothed image is at least `min_level` where a fit in a column may
    /// end.
    fn is_supported(&self, min_level: f32, column: [i32; D], axis: usize) -> bool {
        (-1..=1).any(|j| {
            let mut at = column;
            at[axis] += j;
            self.zone.is_in_box(at) && self.shell.height_at(at.map(|i| i as usize)) >= min_level
        })
    }

    /// Returns `true` if the column around `at` has a new point of the surface of `reference`
    /// already.
    fn is_occupied(&self, at: [i32; D], reference: &Candidate<D>) -> bool {
        let axis = reference.axis as usize;
        (-1..=1).any(|j| {
            let mut v = at;
            v[axis] += j;
            if !self.zone.is_in_box(v) {
                return false;
            }
            let voxel = Voxel::new(self.shell.dims, v.map(|i| i as usize));
            let mut count = 0;
            let mut i = self.latest_in_segment[voxel.index() >> self.shift];
            while i != NONE {
                let p = &self.points[i as usize];
                if p.voxel == voxel {
                    count += 1;
                    if p.axis == reference.axis
                        && dot(p.normal, reference.normal).abs() > SAME_FIT_COSINE
                    {
                        return true;
                    }
                }
                i = self.previous[i as usize];
            }
            count >= MAX_POINTS_PER_SAMPLE
        })
    }

    /// Returns the point of the surface of `reference` in the column around `guess`.
    fn fit_point(
        &self,
        guess: [f32; D],
        reference: &Candidate<D>,
        radius: i32,
    ) -> Option<Candidate<D>> {
        let axis = reference.axis as usize;
        let n = reference.normal;
        let mut surface = Quadric::<D>::new(radius);
        let mut count = 0;
        let centre = guess.map(nearest_sample);
        // Smoothing correlates neighbours: columns a few samples apart carry all the information.
        let stride = if radius > FIT_RADII[0] { 3 } else { 2 };
        let side = 2 * radius / stride + 1;
        for number in 0..side.pow(D as u32 - 1) {
            let mut remaining = number;
            let mut offset = [0i32; D];
            for k in 1..D {
                offset[(axis + k) % D] = remaining % side * stride - radius;
                remaining /= side;
            }
            if offset.iter().map(|u| u * u).sum::<i32>() > radius * radius {
                continue;
            }
            let slope = -dot(n, offset.map(|u| u as f32)) / n[axis];
            let slack = 1 + offset.iter().fold(0, |a, u| a.max(u.abs())) / 6;
            let mut at: [i32; D] = std::array::from_fn(|k| centre[k] + offset[k]);
            let middle = nearest_sample(guess[axis] + slope);
            at[axis] = middle - slack;
            self.reliable_points
                .for_each_in_column(at, axis, 2 * slack + 1, |i| {
                    let q = &self.reliable_points.candidates[i];
                    let offset = sub(q.position, guess);
                    if dot(q.normal, n).abs() >= SAME_NORMAL_COSINE
                        && dot(offset, n).abs() <= 0.75 + 0.12 * norm(offset)
                    {
                        count += 1;
                        surface.add(offset, axis);
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
        let normal = unit(normal);
        let at = position.map(nearest_sample);
        let agrees = height.abs() < 1.0 && dot(normal, n).abs() >= SAME_NORMAL_COSINE;
        if !agrees || !self.zone.is_in_box(at) {
            return None;
        }
        Some(Candidate {
            voxel: Voxel::new(self.shell.dims, at.map(|i| i as usize)),
            axis: reference.axis,
            position,
            normal,
            strength: reference.strength,
        })
    }
}

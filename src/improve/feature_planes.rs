//! The detected features as local planes: where is the nearest sheet, and does an edge pierce one?
//!
//! Feature points are noisy samples of surfaces. Near a position, the points within a small radius
//! are split into sheets by their normals, and each sheet is fitted by a plane (moving least
//! squares, weights (1 - r^2/R^2)^2). Where two features cross, a position has two sheets; where
//! three meet, three.

use crate::feature::FeaturePoint;
use crate::files::codec::codec_fields;
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::morphology::dilate;
use crate::geometry::{add_scaled, dot, norm, sub};
use crate::parallel::prelude::*;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// Most sheets that one position can have.
pub const MAX_PLANES: usize = 3;

/// A plane fitted to one sheet near a position x.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LocalPlane {
    /// Unit normal; its sign means nothing.
    pub normal: [f64; 3],
    /// Signed distance of x from the plane, along the normal.
    pub offset: f64,
}

codec_fields! {
    LocalPlane as LocalPlane { normal, offset }
    NearbyPlanes as NearbyPlanes { planes, count }
}

/// The sheets near a position, nearest first.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NearbyPlanes {
    planes: [LocalPlane; MAX_PLANES],
    count: usize,
}

impl NearbyPlanes {
    /// The sheets, nearest first.
    pub fn iter(&self) -> impl Iterator<Item = &LocalPlane> {
        self.planes[..self.count].iter()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The same planes, as seen from a place that is so far from the first.
    pub(super) fn translated(&self, way: [f64; 3]) -> Self {
        let mut moved = Self::default();
        for sheet in self.iter() {
            moved.push(LocalPlane {
                offset: sheet.offset + dot(way, sheet.normal),
                ..*sheet
            });
        }
        moved
    }

    fn push(&mut self, sheet: LocalPlane) {
        if self.count < MAX_PLANES {
            self.planes[self.count] = sheet;
            self.count += 1;
            self.planes[..self.count].sort_by(|a, b| a.offset.abs().total_cmp(&b.offset.abs()));
        }
    }
}

/// Two normals belong to one sheet if they differ by less than about 35 degrees.
pub const SAME_SURFACE_COSINE: f64 = 0.82;

/// The middle of a face on a sheet is at most this far off it.
pub(super) const MAX_FACE_OFFSET: f64 = 0.75;

/// How many cells make up the reach of [`FeaturePlanes::is_far`].
const DILATION_CELLS: u32 = 2;

/// The cells of a grid in the box that feature points are in or near to: elsewhere there is nothing to be known.
#[derive(Debug)]
struct CellWindow {
    /// Cells of the whole box along each axis.
    global_dims: [usize; 3],
    /// The first of those that are there, and how many are.
    low: [usize; 3],
    dims: [usize; 3],
}

impl CellWindow {
    fn empty() -> Self {
        Self {
            global_dims: [1; 3],
            low: [0; 3],
            dims: [0; 3],
        }
    }

    /// Of `all` cells of the box, those from one corner to the other and `beside` more to every side.
    fn from_corners(
        global_dims: [usize; 3],
        low: [usize; 3],
        high: [usize; 3],
        beside: usize,
    ) -> Self {
        let low = low.map(|c| c.saturating_sub(beside));
        let dims = std::array::from_fn(|k| (high[k] + beside + 1).min(global_dims[k]) - low[k]);
        Self {
            global_dims,
            low,
            dims,
        }
    }

    fn count(&self) -> usize {
        self.dims.iter().product()
    }

    /// The place of a cell of the box, if it is there.
    #[inline]
    fn cell_index(&self, cell: [usize; 3]) -> Option<usize> {
        let mut place = 0;
        for k in (0..3).rev() {
            let c = cell[k]
                .min(self.global_dims[k] - 1)
                .wrapping_sub(self.low[k]);
            if c >= self.dims[k] {
                return None;
            }
            place = place * self.dims[k] + c;
        }
        Some(place)
    }
}

/// The cell of so long a side that a position is in.
#[inline]
fn cell_of(side: f64, x: [f64; 3]) -> [usize; 3] {
    x.map(|x| (x.max(0.0) / side) as usize)
}

/// The feature points in a cell grid.
#[derive(Debug)]
pub struct FeaturePlanes {
    radius: f64,
    cell_size: f64,
    cells: CellWindow,
    cell_starts: Vec<u32>,
    points: Vec<([f32; 3], [f32; 3])>,
    /// Cells of side `coarse` that have a point within [`DILATION_CELLS`] cells.
    coarse_size: f64,
    coarse_cells: CellWindow,
    is_near: Vec<bool>,
    /// Cells of side 1 that a feature point is in or beside: a bit each.
    fine_cells: CellWindow,
    fine_bits: Vec<u64>,
}

impl FeaturePlanes {
    /// From points in the box `[0, extent]`; planes are fitted within `radius`, and
    /// [`FeaturePlanes::is_far`] means that no point is within `reach`, which is at least the radius.
    pub fn new(points: &[FeaturePoint<3>], extent: [f64; 3], radius: f64, reach: f64) -> Self {
        let cell_size = radius * 0.75;
        let coarse_size = reach.max(radius) / f64::from(DILATION_CELLS);
        let at = |p: &FeaturePoint<3>| p.position.map(f64::from);
        let (mut low, mut high) = ([f64::INFINITY; 3], [0.0f64; 3]);
        for x in points.iter().map(at) {
            low = std::array::from_fn(|k| low[k].min(x[k]));
            high = std::array::from_fn(|k| high[k].max(x[k]));
        }
        let cells = |side: f64, beside: usize| {
            if points.is_empty() {
                return CellWindow::empty();
            }
            let [all, low, high] = [extent, low, high].map(|x| cell_of(side, x));
            let all = all.map(|last| last + 1);
            let [low, high] = [low, high].map(|c| std::array::from_fn(|k| c[k].min(all[k] - 1)));
            CellWindow::from_corners(all, low, high, beside)
        };
        let fine_cells = cells(1.0, 1);
        let coarse_cells = cells(coarse_size, DILATION_CELLS as usize);
        let cells = cells(cell_size, 0);
        // Every point is in a cell that is there.
        let place = |cells: &CellWindow, side: f64, x: [f64; 3]| {
            cells.cell_index(cell_of(side, x)).unwrap_or(0)
        };
        let of_points = points.iter().map(|p| place(&cells, cell_size, at(p)));
        let (cell_starts, order) = sort_by_group(cells.count(), of_points);
        let sorted = order.par_iter().map(|&i| {
            let p = &points[i as usize];
            (p.position, p.normal)
        });
        let near: Vec<AtomicBool> = atomic_marks(coarse_cells.count());
        let fine: Vec<AtomicU64> = atomic_marks(fine_cells.count() / 64 + 2);
        points.par_iter().for_each(|p| {
            near[place(&coarse_cells, coarse_size, at(p))].store(true, Relaxed);
            mark_around(&fine, &fine_cells, at(p));
        });
        let mut is_near: Vec<bool> = near.into_iter().map(AtomicBool::into_inner).collect();
        for axis in 0..3 {
            dilate(
                &mut is_near,
                coarse_cells.dims,
                axis,
                DILATION_CELLS as usize,
            );
        }
        let fine_bits = fine.into_iter().map(AtomicU64::into_inner).collect();
        Self {
            radius,
            cell_size,
            cell_starts,
            points: sorted.collect(),
            cells,
            coarse_size,
            coarse_cells,
            is_near,
            fine_cells,
            fine_bits,
        }
    }

    /// Planes are fitted to the points within this.
    pub(super) fn radius(&self) -> f64 {
        self.radius
    }

    /// A quick and safe test before [`FeaturePlanes::intersection`]: whether a feature point may be within about
    /// one unit of the edge, but for its part near ends that are `alone` on a sheet.
    pub fn may_intersect(&self, p: [f64; 3], q: [f64; 3], alone: [bool; 2]) -> bool {
        let edge = sub(q, p);
        let length = norm(edge);
        let [from, to] = uncertain_range(length, alone);
        let steps = ((to - from) * length / 0.6).ceil().max(1.0);
        let start = add_scaled(p, from, edge);
        let stride = (to - from) / steps;
        (0..=steps as usize)
            .any(|i| self.is_fine_cell_set(add_scaled(start, stride * i as f64, edge)))
    }

    /// Whether no feature lies within the reach of `x`: a quick and safe "nothing to see here".
    #[inline]
    pub fn is_far(&self, x: [f64; 3]) -> bool {
        let place = self.coarse_cells.cell_index(cell_of(self.coarse_size, x));
        place.is_none_or(|place| !self.is_near[place])
    }

    /// Whether a feature point may be within about two units of `x`: quick, where [`FeaturePlanes::planes_near`]
    /// would only find sheets that pass farther away.
    #[inline]
    pub fn is_close(&self, x: [f64; 3]) -> bool {
        // Every feature point has marked its cell of side 1 and those beside it.
        (0..27).any(|c| {
            let shift = [c % 3, c / 3 % 3, c / 9].map(|s| 1.5 * (f64::from(s) - 1.0));
            self.is_fine_cell_set(std::array::from_fn(|k| x[k] + shift[k]))
        })
    }

    #[inline]
    fn is_fine_cell_set(&self, x: [f64; 3]) -> bool {
        // Casts cut off at zero.
        let place = self.fine_cells.cell_index(x.map(|x| x as u32 as usize));
        place.is_some_and(|at| self.fine_bits[at / 64] >> (at % 64) & 1 == 1)
    }

    /// Runs `visit` on every point, with its number, in the cells within `radius` of `x`.
    #[inline]
    fn visit_points(&self, x: [f64; 3], radius: f64, mut visit: impl FnMut(u32, [f32; 3])) {
        let CellWindow {
            global_dims: all,
            low,
            dims,
        } = &self.cells;
        // From which of the cells that are there to which.
        let end = |k: usize, x: f64| ((x / self.cell_size).max(0.0) as usize).min(all[k] - 1);
        let first: [usize; 3] =
            std::array::from_fn(|k| end(k, x[k] - radius).saturating_sub(low[k]));
        let after: [usize; 3] = std::array::from_fn(|k| {
            (end(k, x[k] + radius) + 1)
                .saturating_sub(low[k])
                .min(dims[k])
        });
        if first[0] >= after[0] {
            return;
        }
        for z in first[2]..after[2] {
            for y in first[1]..after[1] {
                let row = (z * dims[1] + y) * dims[0];
                let (from, to) = (
                    self.cell_starts[row + first[0]],
                    self.cell_starts[row + after[0]],
                );
                for i in from..to {
                    visit(i, self.points[i as usize].0);
                }
            }
        }
    }

    /// The sheets near `x`: those that pass within the fitting radius, fitted by planes.
    pub fn planes_near(&self, x: [f64; 3]) -> NearbyPlanes {
        self.fit_planes(x, self.radius, 0.6, |_| true)
    }

    /// The same within another radius, and up to nearly that far beyond a sheet's edge; to `every_second`
    /// point, for wide patches, so that all sheets of a crossing find room.
    pub fn planes_within(&self, x: [f64; 3], radius: f64, every_second: bool) -> NearbyPlanes {
        let takes = |p: [f32; 3]| p.iter().map(|c| c.round() as i64).sum::<i64>() & 1 == 0;
        self.fit_planes(x, radius, 0.9, |p| !every_second || takes(p))
    }

    /// Sheets fitted to the points within `radius` that are taken; they end `beyond` times that from the
    /// mean of theirs.
    #[inline]
    fn fit_planes(
        &self,
        x: [f64; 3],
        radius: f64,
        beyond: f64,
        takes: impl Fn([f32; 3]) -> bool,
    ) -> NearbyPlanes {
        const MAX_FIT_POINTS: usize = 192;
        let mut result = NearbyPlanes::default();
        if self.points.is_empty() || self.is_far(x) {
            return result;
        }
        // The points within the radius: their numbers, and their squared distances from x. All is
        // relative to x, so that single precision is enough.
        let mut found = [(0u32, 0f32); MAX_FIT_POINTS + 1];
        let mut count = 0;
        let centre = x.map(|c| c as f32);
        let limit = (radius * radius) as f32;
        self.visit_points(x, radius, |i, p| {
            let r = sub(p, centre);
            let r2 = dot(r, r);
            // No branch: which of them are near cannot be foretold.
            found[count] = (i, r2);
            count = (count + usize::from(r2 < limit && takes(p))).min(MAX_FIT_POINTS);
        });
        // One sheet after the other, each grown from the nearest point that is left.
        while count >= 4 && result.count < MAX_PLANES {
            let (nearest, _) = found[..count]
                .iter()
                .copied()
                .fold(found[0], |best, f| if f.1 < best.1 { f } else { best });
            let (seed, seed_normal) = self.points[nearest as usize];
            let seed = sub(seed, centre);
            let (mut weight, mut mean, mut normal, mut members) = (0f32, [0f32; 3], [0f32; 3], 0);
            let mut kept = 0;
            for i in 0..count {
                let f = found[i];
                let (p, n) = self.points[f.0 as usize];
                let along = dot(n, seed_normal);
                if along.abs() <= SAME_SURFACE_COSINE as f32 {
                    // What is left for the next sheet differs in direction.
                    found[kept] = f;
                    kept += 1;
                    continue;
                }
                let p = sub(p, centre);
                let r = sub(p, seed);
                let height = dot(r, seed_normal).abs() - 0.4;
                if height <= 0.0 || height * height < 0.16 * dot(r, r) {
                    let inside = 1.0 - f.1 / limit;
                    let w = inside * inside + 1e-3;
                    let sign = w.copysign(along);
                    for k in 0..3 {
                        mean[k] += w * p[k];
                        normal[k] += sign * n[k];
                    }
                    weight += w;
                    members += 1;
                }
            }
            count = kept;
            let normal = normal.map(f64::from);
            let length = norm(normal);
            if members >= 4 && length > 0.0 {
                let normal = normal.map(|c| c / length);
                let r = mean.map(|c| -f64::from(c / weight));
                let offset = dot(r, normal);
                // Beyond the sheet's edge there is no sheet.
                let aside = norm(add_scaled(r, -offset, normal));
                if aside < beyond * radius && offset.abs() < radius {
                    result.push(LocalPlane { normal, offset });
                }
            }
        }
        result
    }

    /// Whether the inside of the edge (p, q) passes through a sheet that holds neither end.
    ///
    /// `holds` tells whether an end is known to lie on a sheet of that normal, and `alone` whether
    /// an end lies on a sheet and no other is near it. Returns the point where the edge pierces,
    /// and the sheet there.
    pub fn intersection(
        &self,
        p: [f64; 3],
        q: [f64; 3],
        alone: [bool; 2],
        holds: impl Fn(usize, [f64; 3]) -> bool,
    ) -> Option<([f64; 3], LocalPlane)> {
        if self.points.is_empty() || (self.is_far(p) && self.is_far(q)) {
            return None;
        }
        let edge = sub(q, p);
        let length = norm(edge);
        if !self.may_intersect(p, q, alone) {
            return None;
        }
        let pace = 0.45 * self.radius;
        // Sheets that cross the edge this far from where planes are fitted are seen there.
        let sight = 0.75 * pace + 0.25;
        let steps = (length / pace).ceil().max(2.0) as usize;
        let [from, to] = uncertain_range(length, alone);
        let seen = |i: usize, side: f64| (i as f64 / steps as f64) + side * sight / length;
        let mut last = f64::NEG_INFINITY;
        for i in 1..steps {
            // What the next place, or the one before, sees all of need not be looked at.
            if i + 1 < steps && seen(i + 1, -1.0) <= from || i > 1 && seen(i - 1, 1.0) >= to {
                continue;
            }
            let t = i as f64 / steps as f64;
            let x = add_scaled(p, t, edge);
            for sheet in self.planes_near(x).iter() {
                let slope = dot(edge, sheet.normal);
                // Where the edge meets the plane fitted here.
                let crossing = t - sheet.offset / slope;
                if !(0.0..=1.0).contains(&crossing)
                    || (crossing - t).abs() * length > sight
                    || (crossing - last).abs() * length < 0.1
                {
                    continue;
                }
                last = crossing;
                if holds(0, sheet.normal) || holds(1, sheet.normal) {
                    continue;
                }
                // Ends this close to the sheet touch it rather than pass it.
                let touch = 0.25;
                if crossing * slope.abs() < touch || (1.0 - crossing) * slope.abs() < touch {
                    continue;
                }
                // Once more at the place itself: the sheet may end before it.
                let at = add_scaled(p, crossing, edge);
                let here = self.planes_near(at);
                let exact = here.iter().find(|s| {
                    dot(s.normal, sheet.normal).abs() > SAME_SURFACE_COSINE && s.offset.abs() < 0.75
                });
                if let Some(&exact) = exact {
                    return Some((at, exact));
                }
            }
        }
        None
    }
}

/// The part of an edge of that length where a sheet may pass. Near an end on a single sheet there is
/// only that sheet.
#[inline]
fn uncertain_range(length: f64, alone: [bool; 2]) -> [f64; 2] {
    // Between two such ends something must be left to look at.
    let most = if alone == [true; 2] { 0.4 } else { 0.55 };
    let clear = (3.0 / length).min(most);
    let [p, q] = alone.map(|alone| if alone { clear } else { 0.0 });
    [p, 1.0 - q]
}

/// Marks that many threads may set.
fn atomic_marks<T: Default>(count: usize) -> Vec<T> {
    let mut marks = Vec::new();
    marks.resize_with(count, T::default);
    marks
}

/// Sets the bits of the cell of side 1 that holds `x`, and of those beside it.
fn mark_around(bits: &[AtomicU64], cells: &CellWindow, x: [f64; 3]) {
    let CellWindow {
        global_dims: all,
        low,
        dims,
    } = cells;
    let at = cell_of(1.0, x);
    let at: [usize; 3] = std::array::from_fn(|k| at[k].min(all[k] - 1));
    let first: [usize; 3] = std::array::from_fn(|k| at[k].saturating_sub(1) - low[k]);
    let last: [usize; 3] = std::array::from_fn(|k| (at[k] + 1).min(all[k] - 1) - low[k]);
    let row = (1u128 << (last[0] - first[0] + 1)) - 1;
    for z in first[2]..=last[2] {
        for y in first[1]..=last[1] {
            let i = (z * dims[1] + y) * dims[0] + first[0];
            let row = row << (i % 64);
            for (word, part) in [row as u64, (row >> 64) as u64].into_iter().enumerate() {
                let bits = &bits[i / 64 + word];
                // Mostly they are set already.
                if bits.load(Relaxed) & part != part {
                    bits.fetch_or(part, Relaxed);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;
    use crate::geometry::unit;

    #[test]
    fn what_is_near_a_place_is_known_from_the_points_near_it() {
        let extent = [60.0, 50.0, 40.0];
        let mut random = Random::new(4);
        let mut points = Vec::new();
        for _ in 0..4 {
            let middle = extent.map(|e| random.range(0.2, 0.8) * e);
            let normal = unit([1.0, random.range(-0.5, 0.5), random.range(-0.5, 0.5)]);
            for i in 0..=2000 {
                let [y, z] = [f64::from(i % 51), f64::from(i / 51)];
                let off = normal[1] * (y - middle[1]) + normal[2] * (z - middle[2]);
                let x = middle[0] - off / normal[0];
                if (0.0..=extent[0]).contains(&x) {
                    points.push(FeaturePoint {
                        position: [x, y, z].map(|c| c as f32),
                        normal: normal.map(|c| c as f32),
                        strength: 1.0,
                    });
                }
            }
        }
        let (radius, reach) = (3.2, 5.0);
        let whole = FeaturePlanes::new(&points, extent, radius, reach);
        let (mut near, mut pierced) = (0, 0);
        for low in [0.0, 13.0, 44.0] {
            let high = low + 16.0;
            // From the box's side, from a grid's middle, and up to the other side.
            let seen = low - 2.0 * reach..=high + 2.0 * reach;
            let is_near = |p: &&FeaturePoint<3>| seen.contains(&f64::from(p.position[0]));
            let some: Vec<FeaturePoint<3>> = points.iter().filter(is_near).copied().collect();
            assert!(some.len() < points.len());
            let part = FeaturePlanes::new(&some, extent, radius, reach);
            assert!(
                part.fine_bits.len() < whole.fine_bits.len()
                    && part.cell_starts.len() < whole.cell_starts.len()
            );
            for _ in 0..4000 {
                let mut place = || {
                    let [_, y, z] = extent.map(|e| random.range(0.0, e));
                    [random.range(low, high.min(extent[0])), y, z]
                };
                let (p, far) = (place(), place());
                let q = add_scaled(p, 6.0 / norm(sub(far, p)).max(6.0), sub(far, p));
                assert_eq!(part.planes_near(p), whole.planes_near(p));
                assert_eq!(
                    (part.is_far(p), part.is_close(p)),
                    (whole.is_far(p), whole.is_close(p))
                );
                let alone = [random.draw() < 0.3, random.draw() < 0.3];
                let of = [&part, &whole].map(|sheets| {
                    let may = sheets.may_intersect(p, q, alone);
                    (may, sheets.intersection(p, q, alone, |_, _| false))
                });
                assert_eq!(of[0], of[1]);
                near += usize::from(!whole.planes_near(p).is_empty());
                pierced += usize::from(of[1].1.is_some());
            }
        }
        assert!(near > 2000 && pierced > 500, "{near} {pierced}");
        let none = FeaturePlanes::new(&[], extent, radius, reach);
        assert!(none.is_far([1.0; 3]) && !none.is_close([60.0; 3]));
        assert!(none.planes_near([20.0; 3]).is_empty());
    }
}

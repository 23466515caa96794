//! The detected features as local planes: finds the feature surfaces near a position, and where an
//! edge passes through one.
//!
//! Feature points are noisy samples of surfaces. Near a position, the points within a small radius
//! are split into surfaces by their normals, and a plane is fitted to each (moving least squares,
//! weights (1 - r^2/R^2)^2). Where two features cross, a position has two planes; where three meet,
//! three.

use crate::feature::FeaturePoint;
use crate::files::codec::codec_fields;
use crate::geometry::cell_list::CellList;
use crate::geometry::morphology::dilate;
use crate::geometry::{add_scaled, bounding_box, dot, norm, sub, to_3d};
use crate::parallel::prelude::*;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// Largest number of planes near one position.
pub const MAX_PLANES: usize = 3;

/// A plane fitted to one feature surface near a position x.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LocalPlane {
    /// Unit normal. Its sign has no meaning.
    pub normal: [f64; 3],
    /// Signed distance of x from the plane, along the normal, in samples.
    pub offset: f64,
}

codec_fields! {
    LocalPlane as LocalPlane { normal, offset }
    NearbyPlanes as NearbyPlanes { planes, count }
}

/// The planes near a position, nearest first.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NearbyPlanes {
    planes: [LocalPlane; MAX_PLANES],
    count: usize,
}

impl NearbyPlanes {
    /// Returns the planes, nearest first.
    pub fn iter(&self) -> impl Iterator<Item = &LocalPlane> {
        self.planes[..self.count].iter()
    }

    /// Returns `true` if no plane is near.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Returns the same planes for the position moved by `displacement`.
    pub(super) fn translated(&self, displacement: [f64; 3]) -> Self {
        let mut moved = Self::default();
        for plane in self.iter() {
            moved.push(LocalPlane {
                offset: plane.offset + dot(displacement, plane.normal),
                ..*plane
            });
        }
        moved
    }

    /// Adds a plane, sorted by its distance; does nothing if there are already [`MAX_PLANES`].
    fn push(&mut self, plane: LocalPlane) {
        if self.count < MAX_PLANES {
            self.planes[self.count] = plane;
            self.count += 1;
            self.planes[..self.count].sort_by(|a, b| a.offset.abs().total_cmp(&b.offset.abs()));
        }
    }
}

/// Smallest cosine between two normals of one surface (about 35 degrees).
pub const SAME_SURFACE_COSINE: f64 = 0.82;

/// Largest distance, in samples, between the middle of a face on a surface and that surface.
pub(super) const MAX_FACE_OFFSET: f64 = 0.75;

/// Number of coarse cells that make up the reach of [`FeaturePlanes::is_far`].
const DILATION_CELLS: u32 = 2;

/// The cells of a grid over the box that are stored: those that contain feature points, and a
/// margin around them.
#[derive(Debug)]
struct CellWindow {
    /// Number of cells of the whole box along each axis.
    global_dims: [usize; 3],
    /// First stored cell and number of stored cells along each axis.
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

    /// Creates the window from cell `low` to cell `high` and `margin` more cells to every side,
    /// clipped to the `global_dims` cells of the box.
    fn from_corners(
        global_dims: [usize; 3],
        low: [usize; 3],
        high: [usize; 3],
        margin: usize,
    ) -> Self {
        let low = low.map(|c| c.saturating_sub(margin));
        let dims = std::array::from_fn(|k| (high[k] + margin + 1).min(global_dims[k]) - low[k]);
        Self {
            global_dims,
            low,
            dims,
        }
    }

    fn count(&self) -> usize {
        self.dims.iter().product()
    }

    /// Returns the index of a cell of the box in the window, or `None` if it is outside.
    #[inline]
    fn cell_index(&self, cell: [usize; 3]) -> Option<usize> {
        let mut index = 0;
        for k in (0..3).rev() {
            let c = cell[k]
                .min(self.global_dims[k] - 1)
                .wrapping_sub(self.low[k]);
            if c >= self.dims[k] {
                return None;
            }
            index = index * self.dims[k] + c;
        }
        Some(index)
    }
}

/// Returns the cell that contains a position, for cells of edge `side`.
#[inline]
fn cell_of(side: f64, x: [f64; 3]) -> [usize; 3] {
    x.map(|x| (x.max(0.0) / side) as usize)
}

/// The feature points, sorted into a cell grid.
#[derive(Debug)]
pub struct FeaturePlanes {
    radius: f64,
    cells: CellList<3>,
    /// Position and normal of each point, in the order of the cells.
    points: Vec<([f32; 3], [f32; 3])>,
    /// Grid of edge `coarse_size`; a cell of `is_near` is set if a point lies within
    /// [`DILATION_CELLS`] cells.
    coarse_size: f64,
    coarse_cells: CellWindow,
    is_near: Vec<bool>,
    /// Grid of edge 1; a bit of `fine_bits` is set if a feature point lies in the cell or an
    /// adjacent one.
    fine_cells: CellWindow,
    fine_bits: Vec<u64>,
}

impl FeaturePlanes {
    /// Creates the planes of points in the box `[0, extent]`. Points in the plane are in space, with
    /// z = 0. Planes are fitted to the points
    /// within `radius` samples. [`FeaturePlanes::is_far`] means that no point lies within `reach`,
    /// or within `radius` if that is larger.
    pub fn new<const D: usize>(
        points: &[FeaturePoint<D>],
        extent: [f64; D],
        radius: f64,
        reach: f64,
    ) -> Self {
        let coarse_size = reach.max(radius) / f64::from(DILATION_CELLS);
        let position = |p: &FeaturePoint<D>| to_3d(p.position).map(f64::from);
        let positions = points.iter().map(position);
        let [low, high] = bounding_box(positions.clone());
        let window = |side: f64, margin: usize| {
            if points.is_empty() {
                return CellWindow::empty();
            }
            let [last_cell, low, high] = [to_3d(extent), low, high].map(|x| cell_of(side, x));
            let global_dims = last_cell.map(|last| last + 1);
            let [low, high] =
                [low, high].map(|c| std::array::from_fn(|k| c[k].min(global_dims[k] - 1)));
            CellWindow::from_corners(global_dims, low, high, margin)
        };
        let fine_cells = window(1.0, 1);
        let coarse_cells = window(coarse_size, DILATION_CELLS as usize);
        let cells = CellList::with_origin([0.0; 3], positions, 0.75 * radius);
        // The window contains the cell of every point.
        let index_of = |cells: &CellWindow, side: f64, x: [f64; 3]| {
            cells.cell_index(cell_of(side, x)).unwrap_or(0)
        };
        let sorted = cells.order().par_iter().map(|&i| {
            let p = &points[i as usize];
            (to_3d(p.position), to_3d(p.normal))
        });
        let atomic_near: Vec<AtomicBool> = atomic_marks(coarse_cells.count());
        let atomic_fine: Vec<AtomicU64> = atomic_marks(fine_cells.count() / 64 + 2);
        points.par_iter().for_each(|p| {
            atomic_near[index_of(&coarse_cells, coarse_size, position(p))].store(true, Relaxed);
            mark_around(&atomic_fine, &fine_cells, position(p));
        });
        let mut is_near: Vec<bool> = atomic_near
            .into_iter()
            .map(AtomicBool::into_inner)
            .collect();
        for axis in 0..3 {
            dilate(
                &mut is_near,
                coarse_cells.dims,
                axis,
                DILATION_CELLS as usize,
            );
        }
        let fine_bits = atomic_fine.into_iter().map(AtomicU64::into_inner).collect();
        Self {
            radius,
            points: sorted.collect(),
            cells,
            coarse_size,
            coarse_cells,
            is_near,
            fine_cells,
            fine_bits,
        }
    }

    /// Returns the radius, in samples, within which points are fitted.
    pub(super) fn radius(&self) -> f64 {
        self.radius
    }

    /// Returns `false` only if [`FeaturePlanes::intersection`] finds nothing: no feature point lies
    /// within about one sample of the edge. The test is fast. It leaves out the part of the edge
    /// near each end that `is_isolated` marks as lying on its only surface.
    pub fn may_intersect(&self, p: [f64; 3], q: [f64; 3], is_isolated: [bool; 2]) -> bool {
        let edge = sub(q, p);
        let length = norm(edge);
        let [begin, end] = uncertain_range(length, self.radius, is_isolated);
        let steps = ((end - begin) * length / 0.6).ceil().max(1.0);
        let start = add_scaled(p, begin, edge);
        let stride = (end - begin) / steps;
        (0..=steps as usize)
            .any(|i| self.is_fine_cell_set(add_scaled(start, stride * i as f64, edge)))
    }

    /// Returns `true` if no feature lies within the reach of `x`. The test is fast and never wrong
    /// in that case.
    #[inline]
    pub fn is_far(&self, x: [f64; 3]) -> bool {
        let index = self.coarse_cells.cell_index(cell_of(self.coarse_size, x));
        index.is_none_or(|index| !self.is_near[index])
    }

    /// Returns `true` if a feature point may lie within about two samples of `x`. The test is fast;
    /// where it returns `false`, [`FeaturePlanes::planes_near`] finds only surfaces that pass
    /// farther away.
    #[inline]
    pub fn is_close(&self, x: [f64; 3]) -> bool {
        // Every feature point has set the bits of its cell of edge 1 and of the adjacent cells.
        (0..27).any(|c| {
            let shift = [c % 3, c / 3 % 3, c / 9].map(|s| 1.5 * (f64::from(s) - 1.0));
            self.is_fine_cell_set(std::array::from_fn(|k| x[k] + shift[k]))
        })
    }

    /// Returns the bit of the cell of edge 1 that contains `x`.
    #[inline]
    fn is_fine_cell_set(&self, x: [f64; 3]) -> bool {
        // The cast turns negative coordinates into zero.
        let index = self.fine_cells.cell_index(x.map(|x| x as u32 as usize));
        index.is_some_and(|bit| self.fine_bits[bit / 64] >> (bit % 64) & 1 == 1)
    }

    /// Calls `visit` with the index and position of every point in the cells within `radius` of
    /// `x`.
    #[inline]
    fn visit_points(&self, x: [f64; 3], radius: f64, mut visit: impl FnMut(u32, [f32; 3])) {
        let [low, high] = [-radius, radius].map(|r| x.map(|c| c + r));
        self.cells.visit_rows(low, high, |_, range| {
            range.for_each(|i| visit(i as u32, self.points[i].0));
        });
    }

    /// Returns the planes of the surfaces that pass within the fitting radius of `x`.
    pub fn planes_near(&self, x: [f64; 3]) -> NearbyPlanes {
        self.fit_planes(x, self.radius, 0.6, |_| true)
    }

    /// Returns the planes within another radius, up to 0.9 radii beyond the edge of a surface.
    /// `every_second` takes only every second point: use it for large radii, so that the points of
    /// all surfaces at a crossing fit into the buffer.
    pub fn planes_within(&self, x: [f64; 3], radius: f64, every_second: bool) -> NearbyPlanes {
        let is_even = |p: [f32; 3]| p.iter().map(|c| c.round() as i64).sum::<i64>() & 1 == 0;
        self.fit_planes(x, radius, 0.9, |p| !every_second || is_even(p))
    }

    /// Fits planes to the points within `radius` for which `keeps` is true. A surface ends
    /// `max_lateral_ratio` radii from the mean of its points.
    #[inline]
    fn fit_planes(
        &self,
        x: [f64; 3],
        radius: f64,
        max_lateral_ratio: f64,
        keeps: impl Fn([f32; 3]) -> bool,
    ) -> NearbyPlanes {
        /// Largest number of points to which planes are fitted.
        const MAX_FIT_POINTS: usize = 192;
        let mut result = NearbyPlanes::default();
        if self.points.is_empty() || self.is_far(x) {
            return result;
        }
        // The points within the radius: their indices and squared distances from x. All coordinates
        // are relative to x, so that single precision is enough.
        let mut candidates = [(0u32, 0f32); MAX_FIT_POINTS + 1];
        let mut count = 0;
        let centre = x.map(|c| c as f32);
        let limit = (radius * radius) as f32;
        self.visit_points(x, radius, |i, p| {
            let r = sub(p, centre);
            let r2 = dot(r, r);
            // No branch here: it would be unpredictable.
            candidates[count] = (i, r2);
            count = (count + usize::from(r2 < limit && keeps(p))).min(MAX_FIT_POINTS);
        });
        // Fit one surface after the other, each grown from the nearest remaining point.
        while count >= 4 && result.count < MAX_PLANES {
            let (nearest, _) = candidates[..count]
                .iter()
                .copied()
                .fold(candidates[0], |best, f| if f.1 < best.1 { f } else { best });
            let (seed, seed_normal) = self.points[nearest as usize];
            let seed = sub(seed, centre);
            let (mut weight, mut mean, mut normal, mut members) = (0f32, [0f32; 3], [0f32; 3], 0);
            let mut kept_count = 0;
            for i in 0..count {
                let f = candidates[i];
                let (p, n) = self.points[f.0 as usize];
                let cosine = dot(n, seed_normal);
                if cosine.abs() <= SAME_SURFACE_COSINE as f32 {
                    // Points with another direction remain for the next surface.
                    candidates[kept_count] = f;
                    kept_count += 1;
                    continue;
                }
                let p = sub(p, centre);
                let r = sub(p, seed);
                let height = dot(r, seed_normal).abs() - 0.4;
                if height <= 0.0 || height * height < 0.16 * dot(r, r) {
                    let falloff = 1.0 - f.1 / limit;
                    let w = falloff * falloff + 1e-3;
                    let sign = w.copysign(cosine);
                    for k in 0..3 {
                        mean[k] += w * p[k];
                        normal[k] += sign * n[k];
                    }
                    weight += w;
                    members += 1;
                }
            }
            count = kept_count;
            let normal = normal.map(f64::from);
            let length = norm(normal);
            if members >= 4 && length > 0.0 {
                let normal = normal.map(|c| c / length);
                let r = mean.map(|c| -f64::from(c / weight));
                let offset = dot(r, normal);
                // A surface has no plane beyond its edge.
                let lateral_distance = norm(add_scaled(r, -offset, normal));
                if lateral_distance < max_lateral_ratio * radius && offset.abs() < radius {
                    result.push(LocalPlane { normal, offset });
                }
            }
        }
        result
    }

    /// Returns where the inside of the edge (p, q) passes through a surface that holds neither end,
    /// and the plane there; `None` if it passes through no surface.
    ///
    /// `is_on_surface` is called with the index of an end, a normal, and the displacement from that
    /// end to where the edge meets the surface. It returns `true` if the end is known to lie on that
    /// surface. `is_isolated` is `true` for each end that
    /// lies on a surface and has no other surface near.
    pub fn intersection(
        &self,
        p: [f64; 3],
        q: [f64; 3],
        is_isolated: [bool; 2],
        is_on_surface: impl Fn(usize, [f64; 3], [f64; 3]) -> bool,
    ) -> Option<([f64; 3], LocalPlane)> {
        if self.points.is_empty() || (self.is_far(p) && self.is_far(q)) {
            return None;
        }
        let edge = sub(q, p);
        let length = norm(edge);
        if !self.may_intersect(p, q, is_isolated) {
            return None;
        }
        let step_length = 0.45 * self.radius;
        // Distance along the edge over which planes fitted at one position detect a crossing.
        let view_distance = 0.75 * step_length + 0.25;
        let steps = (length / step_length).ceil().max(2.0) as usize;
        let [begin, end] = uncertain_range(length, self.radius, is_isolated);
        let seen = |i: usize, side: f64| (i as f64 / steps as f64) + side * view_distance / length;
        let mut last = f64::NEG_INFINITY;
        for i in 1..steps {
            // Skip a position if the next or the previous one covers its whole uncertain range.
            if i + 1 < steps && seen(i + 1, -1.0) <= begin || i > 1 && seen(i - 1, 1.0) >= end {
                continue;
            }
            let t = i as f64 / steps as f64;
            let x = add_scaled(p, t, edge);
            for plane in self.planes_near(x).iter() {
                let slope = dot(edge, plane.normal);
                // Position along the edge where it meets the plane fitted here.
                let crossing = t - plane.offset / slope;
                if !(0.0..=1.0).contains(&crossing)
                    || (crossing - t).abs() * length > view_distance
                    || (crossing - last).abs() * length < 0.1
                {
                    continue;
                }
                last = crossing;
                if [crossing, crossing - 1.0]
                    .into_iter()
                    .enumerate()
                    .any(|(end, share)| is_on_surface(end, plane.normal, edge.map(|c| share * c)))
                {
                    continue;
                }
                // An end this close to the surface touches it and does not pass it.
                let touch = 0.25;
                if crossing * slope.abs() < touch || (1.0 - crossing) * slope.abs() < touch {
                    continue;
                }
                // Fit again at the crossing: the surface may end before it.
                let point = add_scaled(p, crossing, edge);
                let nearby = self.planes_near(point);
                let exact = nearby.iter().find(|s| {
                    dot(s.normal, plane.normal).abs() > SAME_SURFACE_COSINE && s.offset.abs() < 0.75
                });
                if let Some(&exact) = exact {
                    return Some((point, exact));
                }
            }
        }
        None
    }
}

/// Returns the part of an edge of this length where a surface may pass, as fractions of the edge.
/// Near an end that is isolated on a surface there is only that surface, as far as planes are
/// fitted.
#[inline]
fn uncertain_range(length: f64, radius: f64, is_isolated: [bool; 2]) -> [f64; 2] {
    // Some part must remain to be tested between two such ends.
    let max_share = if is_isolated == [true; 2] { 0.4 } else { 0.55 };
    let clear_share = (radius.min(3.0) / length).min(max_share);
    let [p, q] = is_isolated.map(|isolated| if isolated { clear_share } else { 0.0 });
    [p, 1.0 - q]
}

/// Returns atomic flags that many threads may set.
fn atomic_marks<T: Default>(count: usize) -> Vec<T> {
    let mut marks = Vec::new();
    marks.resize_with(count, T::default);
    marks
}

/// Sets the bits of the cell of edge 1 that contains `x`, and of the adjacent cells.
fn mark_around(bits: &[AtomicU64], cells: &CellWindow, x: [f64; 3]) {
    let CellWindow {
        global_dims,
        low,
        dims,
    } = cells;
    let cell = cell_of(1.0, x);
    let cell: [usize; 3] = std::array::from_fn(|k| cell[k].min(global_dims[k] - 1));
    let first: [usize; 3] = std::array::from_fn(|k| cell[k].saturating_sub(1) - low[k]);
    let last: [usize; 3] = std::array::from_fn(|k| (cell[k] + 1).min(global_dims[k] - 1) - low[k]);
    let row = (1u128 << (last[0] - first[0] + 1)) - 1;
    for z in first[2]..=last[2] {
        for y in first[1]..=last[1] {
            let i = (z * dims[1] + y) * dims[0] + first[0];
            let row = row << (i % 64);
            for (word, mask) in [row as u64, (row >> 64) as u64].into_iter().enumerate() {
                let bits = &bits[i / 64 + word];
                // Most bits are set already, and a load is cheaper than an atomic write.
                if bits.load(Relaxed) & mask != mask {
                    bits.fetch_or(mask, Relaxed);
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
    fn planes_of_nearby_points_agree_with_planes_of_all_points() {
        let extent = [60.0, 50.0, 40.0];
        let mut random = Random::new(4);
        let mut points = Vec::new();
        for _ in 0..4 {
            let middle = extent.map(|e| random.range(0.2, 0.8) * e);
            let normal = unit([1.0, random.range(-0.5, 0.5), random.range(-0.5, 0.5)]);
            for i in 0..=2000 {
                let [y, z] = [f64::from(i % 51), f64::from(i / 51)];
                let offset = normal[1] * (y - middle[1]) + normal[2] * (z - middle[2]);
                let x = middle[0] - offset / normal[0];
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
        let all_planes = FeaturePlanes::new(&points, extent, radius, reach);
        let (mut near_count, mut intersection_count) = (0, 0);
        for low in [0.0, 13.0, 44.0] {
            let high = low + 16.0;
            // Ranges at a side of the box, in the middle of it, and at the opposite side.
            let range = low - 2.0 * reach..=high + 2.0 * reach;
            let is_near = |p: &&FeaturePoint<3>| range.contains(&f64::from(p.position[0]));
            let nearby_points: Vec<FeaturePoint<3>> =
                points.iter().filter(is_near).copied().collect();
            assert!(nearby_points.len() < points.len());
            let some_planes = FeaturePlanes::new(&nearby_points, extent, radius, reach);
            assert!(some_planes.fine_bits.len() < all_planes.fine_bits.len());
            for _ in 0..4000 {
                let mut random_point = || {
                    let [_, y, z] = extent.map(|e| random.range(0.0, e));
                    [random.range(low, high.min(extent[0])), y, z]
                };
                let (p, target) = (random_point(), random_point());
                let q = add_scaled(p, 6.0 / norm(sub(target, p)).max(6.0), sub(target, p));
                assert_eq!(some_planes.planes_near(p), all_planes.planes_near(p));
                assert_eq!(
                    (some_planes.is_far(p), some_planes.is_close(p)),
                    (all_planes.is_far(p), all_planes.is_close(p))
                );
                let is_isolated = [random.draw() < 0.3, random.draw() < 0.3];
                let results = [&some_planes, &all_planes].map(|planes| {
                    let may_intersect = planes.may_intersect(p, q, is_isolated);
                    (
                        may_intersect,
                        planes.intersection(p, q, is_isolated, |_, _, _| false),
                    )
                });
                assert_eq!(results[0], results[1]);
                near_count += usize::from(!all_planes.planes_near(p).is_empty());
                intersection_count += usize::from(results[1].1.is_some());
            }
        }
        assert!(
            near_count > 2000 && intersection_count > 500,
            "{near_count} {intersection_count}"
        );
        let no_planes = FeaturePlanes::new(&[], extent, radius, reach);
        assert!(no_planes.is_far([1.0; 3]) && !no_planes.is_close([60.0; 3]));
        assert!(no_planes.planes_near([20.0; 3]).is_empty());
    }
}

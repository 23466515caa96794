//! Finds the points near an atom.

use crate::parallel::prelude::*;
use pulp::{Simd, WithSimd};

use super::rows::NeighbourRows;
use super::scratch::RowScratch;
use super::{IntPoint, LANES, PointSet, UNREACHABLE_POINT};
use crate::error::Result;
use crate::files::codec::codec_fields;
use crate::geometry::counting_sort::sort_by_group_into;

/// Points sorted into the cells of a regular grid.
///
/// Unlike [`CellList`](crate::geometry::cell_list::CellList), it is sorted again at every repair of
/// the list, so its arrays are reused, and rows of cells are scanned in whole groups of points
/// whose positions lie together.
#[derive(Clone, Default)]
pub struct AtomCells {
    /// The near corner of the grid.
    origin: [i32; 3],
    /// Edges of a cell, in fixed-point units.
    cell_edges: [f32; 3],
    /// The first cell along each axis that contains a local point.
    first_cell: [usize; 3],
    dims: [usize; 3],
    /// Where each cell's points start in the arrays below; x fastest, one more at the end.
    starts: Vec<u32>,
    /// The points' indices in cell order.
    order: Vec<u32>,
    /// Positions in cell order, with the point's index as their last element, and as many extra
    /// points as a group may need.
    points: Vec<IntPoint>,
    /// Square of each point's reach, in the same order.
    reach2: Vec<f32>,
    /// The cell of each point, in the points' original order.
    cell_of: Vec<u32>,
}

impl AtomCells {
    /// Sorts points into cells of the standard edges, or larger ones if there would be many more
    /// cells than points. The grid is laid over the bounds of all points of the lattice
    /// (`global_bounds`), of which only those in `local_bounds` are here.
    fn sort(
        &mut self,
        points: &[IntPoint],
        reach: &[f32],
        local_bounds: &PointBounds,
        global_bounds: &PointBounds,
    ) {
        let edges = CELL_EDGE_RATIOS.map(|edge| edge * global_bounds.min_reach);
        let (low, high) = (global_bounds.low, global_bounds.high);
        let spans = high.iter().zip(&low).map(|(h, l)| h.saturating_sub(*l));
        let spans: Vec<f32> = spans.filter(|&s| s > 0).map(|s| s as f32).collect();
        let cell_size = spans.iter().product::<f32>() / (4.0 * global_bounds.count.max(1) as f32);
        let cell_size = cell_size.powf(1.0 / spans.len().max(1) as f32);
        let edge = edges.iter().product::<f32>().cbrt();
        let enlargement = (cell_size / edge).max(1.0);
        self.cell_edges = edges.map(|edge| (enlargement * edge).max(1.0));
        self.origin = low;
        let per_unit = self.cell_edges.map(|edge| 1.0 / edge);
        let cell_along =
            |k: usize, x: i32| (x.saturating_sub(low[k]) as f32 * per_unit[k]) as usize;
        let first: [usize; 3] = std::array::from_fn(|k| cell_along(k, local_bounds.low[k]));
        let dims: [usize; 3] = if points.is_empty() {
            [0; 3]
        } else {
            std::array::from_fn(|k| cell_along(k, local_bounds.high[k]) + 1 - first[k])
        };
        (self.first_cell, self.dims) = (first, dims);
        let cell = |p: &IntPoint| {
            let cell: [usize; 3] = std::array::from_fn(|k| cell_along(k, p[k]) - first[k]);
            ((cell[2] * dims[1] + cell[1]) * dims[0] + cell[0]) as u32
        };
        points
            .par_iter()
            .map(cell)
            .collect_into_vec(&mut self.cell_of);
        let count = dims.iter().product();
        sort_by_group_into(count, &self.cell_of, &mut self.starts, &mut self.order);
        self.points.resize(points.len() + LANES, UNREACHABLE_POINT);
        self.reach2.resize(points.len() + LANES, 0.0);
        let sorted = self.points.par_iter_mut().zip(&mut self.reach2);
        sorted.zip(&self.order).for_each(|((target, reach2), &n)| {
            let point = points[n as usize];
            *target = [point[0], point[1], point[2], n as i32];
            *reach2 = reach[n as usize] * reach[n as usize];
        });
    }
}

/// Finds the points near an atom.
pub struct NeighbourSearch<'a> {
    points: PointSet<'a>,
    /// The largest reach of all points of the lattice.
    max_reach: f32,
    cells: &'a AtomCells,
}

/// Edges of a search cell in units of the smallest reach. Rows of cells along x are scanned from
/// one end to the other, in groups, so rows are thick and their ends fine.
const CELL_EDGE_RATIOS: [f32; 3] = [0.25, 0.75, 0.75];

/// Bounds of points and of their reaches.
#[derive(Clone)]
struct PointBounds {
    low: [i32; 3],
    high: [i32; 3],
    min_reach: f32,
    max_reach: f32,
    count: usize,
}

codec_fields! { PointBounds as PointBounds { low, high, min_reach, max_reach, count } }

impl PointBounds {
    /// The bounds of no points.
    const EMPTY: Self = Self {
        low: [i32::MAX; 3],
        high: [i32::MIN; 3],
        min_reach: f32::INFINITY,
        max_reach: 0.0,
        count: 0,
    };

    /// Returns the bounds of one point.
    fn from_point((p, &reach): (&IntPoint, &f32)) -> Self {
        Self {
            low: [p[0], p[1], p[2]],
            high: [p[0], p[1], p[2]],
            min_reach: reach,
            max_reach: reach,
            count: 1,
        }
    }

    /// Returns the bounds of both.
    fn union(self, other: Self) -> Self {
        Self {
            low: std::array::from_fn(|k| self.low[k].min(other.low[k])),
            high: std::array::from_fn(|k| self.high[k].max(other.high[k])),
            min_reach: self.min_reach.min(other.min_reach),
            max_reach: self.max_reach.max(other.max_reach),
            count: self.count + other.count,
        }
    }
}

impl<'a> NeighbourSearch<'a> {
    /// Prepares a search among the local points.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub fn new(point_set: PointSet<'a>, cells: &'a mut AtomCells) -> Result<Self> {
        let PointSet { points, reach, .. } = point_set;
        let bounds = points.par_iter().zip(reach).map(PointBounds::from_point);
        let bounds = bounds.reduce(|| PointBounds::EMPTY, PointBounds::union);
        let owned_bounds = PointBounds {
            count: point_set.images.owned_point_count(point_set.halo),
            ..bounds.clone()
        };
        let global_bounds = point_set.halo.fold(
            "extent of atoms",
            owned_bounds,
            PointBounds::EMPTY,
            PointBounds::union,
        )?;
        cells.sort(points, reach, &bounds, &global_bounds);
        Ok(Self {
            points: point_set,
            max_reach: global_bounds.max_reach,
            cells,
        })
    }

    /// Lists the neighbours of atom `n` of the chunk again.
    #[inline]
    pub fn list(&self, n: usize, rows: &mut NeighbourRows, scratch: &mut RowScratch) {
        let atom = rows.members[n];
        let (arch, mut nearby_points) = (scratch.arch, std::mem::take(&mut scratch.nearby_points));
        let count = arch.dispatch(GatherKernel {
            search: self,
            atom,
            nearby_points: &mut nearby_points,
        });
        let mut row = std::mem::take(&mut scratch.row);
        row.clear();
        row.extend(
            nearby_points[..count]
                .iter()
                .map(|&point| scratch.find_or_add_member(point, rows)),
        );
        rows.replace(n, &row);
        (scratch.nearby_points, scratch.row) = (nearby_points, row);
    }
}

/// Fills `nearby_points` with the points near an atom, and returns their count.
struct GatherKernel<'a> {
    search: &'a NeighbourSearch<'a>,
    atom: u32,
    nearby_points: &'a mut Vec<u32>,
}

impl WithSimd for GatherKernel<'_> {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        let Self {
            search,
            atom,
            nearby_points,
        } = self;
        let cells = &search.cells;
        let centre = search.points.points[atom as usize];
        let reach = search.points.reach[atom as usize];
        let centre_reach2 = reach * reach;
        // r < reach_j <= reach_i + slope r  =>  r < reach_i / (1 - slope)
        let radius = (reach / (1.0 - search.points.slope).max(1e-3)).min(search.max_reach);
        // Relative to the near corner of the grid; the margin covers the rounding to f32.
        let position: [f32; 3] = std::array::from_fn(|k| (centre[k] - cells.origin[k]) as f32);
        let radius = radius + 1e-6 * position[0].max(position[1]).max(position[2]);
        let per_unit = cells.cell_edges.map(|edge| 1.0 / edge);
        let range = |k: usize, radius: f32| {
            let first = ((position[k] - radius) * per_unit[k]).max(0.0) as usize;
            let last = ((position[k] + radius) * per_unit[k]) as usize;
            let end = cells.first_cell[k] + cells.dims[k];
            (first.max(cells.first_cell[k]), last.min(end - 1))
        };
        // Distance of the atom from the slab of a cell along an axis.
        let gap = |k: usize, cell: usize| {
            let low = cell as f32 * cells.cell_edges[k];
            (low - position[k])
                .max(position[k] - low - cells.cell_edges[k])
                .max(0.0)
        };
        let mut end = 0;
        let (ys, zs) = (range(1, radius), range(2, radius));
        for z in zs.0..=zs.1 {
            for y in ys.0..=ys.1 {
                let remaining2 = radius * radius - gap(1, y).powi(2) - gap(2, z).powi(2);
                if remaining2 <= 0.0 {
                    continue;
                }
                let xs = range(0, remaining2.sqrt());
                let row = (z - cells.first_cell[2]) * cells.dims[1] + y - cells.first_cell[1];
                let row = row * cells.dims[0];
                let (first_x, last_x) = (xs.0 - cells.first_cell[0], xs.1 - cells.first_cell[0]);
                let points =
                    cells.starts[row + first_x] as usize..cells.starts[row + last_x + 1] as usize;
                if nearby_points.len() < end + points.len() + LANES {
                    nearby_points.resize(2 * (end + points.len() + LANES), 0);
                }
                let mut first = points.start;
                while first < points.end {
                    let group = &cells.points[first..first + LANES];
                    let index: [u32; LANES] = std::array::from_fn(|l| group[l][3] as u32);
                    let remaining = (points.end - first) as u32;
                    let mut is_near = [0u32; LANES];
                    for l in 0..LANES {
                        let step = |k: usize| group[l][k].wrapping_sub(centre[k]) as f32;
                        let (dx, dy, dz) = (step(0), step(1), step(2));
                        let is_inside = dx * dx + dy * dy + dz * dz < centre_reach2;
                        is_near[l] =
                            u32::from(is_inside & ((l as u32) < remaining) & (index[l] != atom));
                    }
                    if search.points.slope > 0.0 {
                        // Points with a larger reach than the atom's.
                        let reach2 = &cells.reach2[first..first + LANES];
                        for l in 0..LANES {
                            let step = |k: usize| group[l][k].wrapping_sub(centre[k]) as f32;
                            let (dx, dy, dz) = (step(0), step(1), step(2));
                            let is_inside = dx * dx + dy * dy + dz * dz < reach2[l];
                            is_near[l] |= u32::from(
                                is_inside & ((l as u32) < remaining) & (index[l] != atom),
                            );
                        }
                    }
                    // Without branches: the end advances only past the points to be kept.
                    let slots = &mut nearby_points[end..end + LANES];
                    let mut kept_count = 0;
                    for l in 0..LANES {
                        slots[kept_count & (LANES - 1)] = index[l];
                        kept_count += is_near[l] as usize;
                    }
                    end += kept_count;
                    first += LANES;
                }
            }
        }
        end
    }
}

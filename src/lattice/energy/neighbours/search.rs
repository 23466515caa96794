//! Finding the points near an atom.

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
/// Not [`Buckets`](crate::geometry::cell_list::CellList): sorted anew at every repair of the list, so arrays
/// are kept, and rows of cells are looked at in whole groups of points whose positions lie together.
#[derive(Clone, Default)]
pub struct AtomCells {
    /// The near corner of the grid.
    origin: [i32; 3],
    /// Edges of a cell, in fixed-point units.
    cell_edges: [f32; 3],
    /// The first cell along each axis that has points of those held, and how many there are from it to the last.
    first_cell: [usize; 3],
    dims: [usize; 3],
    /// Where each cell's points start in the arrays below; x fastest, one more at the end.
    starts: Vec<u32>,
    /// The points' indices in cell order.
    order: Vec<u32>,
    /// Positions in cell order, with the point's index as their last element, and as many more as a
    /// group may need.
    points: Vec<IntPoint>,
    /// Square of each point's reach, in the same order.
    reach2: Vec<f32>,
    /// The cell of each point, in the points' own order.
    cell_of: Vec<u32>,
}

impl AtomCells {
    /// Sorts points into cells of the given edges, or larger ones if they were many more than points. The grid is that of
    /// `all` points of the lattice, of which some are held here.
    fn sort(&mut self, points: &[IntPoint], reach: &[f32], held: &PointBounds, all: &PointBounds) {
        let edges = CELL_EDGE_RATIOS.map(|edge| edge * all.min_reach);
        let (low, high) = (all.low, all.high);
        let spans = high.iter().zip(&low).map(|(h, l)| h.saturating_sub(*l));
        let spans: Vec<f32> = spans.filter(|&s| s > 0).map(|s| s as f32).collect();
        let roomy = spans.iter().product::<f32>() / (4.0 * all.count.max(1) as f32);
        let roomy = roomy.powf(1.0 / spans.len().max(1) as f32);
        let edge = edges.iter().product::<f32>().cbrt();
        let larger = (roomy / edge).max(1.0);
        self.cell_edges = edges.map(|edge| (larger * edge).max(1.0));
        self.origin = low;
        let per_unit = self.cell_edges.map(|edge| 1.0 / edge);
        let along = |k: usize, x: i32| (x.saturating_sub(low[k]) as f32 * per_unit[k]) as usize;
        let first: [usize; 3] = std::array::from_fn(|k| along(k, held.low[k]));
        let dims: [usize; 3] = match points.is_empty() {
            true => [0; 3],
            false => std::array::from_fn(|k| along(k, held.high[k]) + 1 - first[k]),
        };
        (self.first_cell, self.dims) = (first, dims);
        let cell = |p: &IntPoint| {
            let at: [usize; 3] = std::array::from_fn(|k| along(k, p[k]) - first[k]);
            ((at[2] * dims[1] + at[1]) * dims[0] + at[0]) as u32
        };
        points
            .par_iter()
            .map(cell)
            .collect_into_vec(&mut self.cell_of);
        let count = dims.iter().product();
        sort_by_group_into(count, &self.cell_of, &mut self.starts, &mut self.order);
        self.points.resize(points.len() + LANES, UNREACHABLE_POINT);
        self.reach2.resize(points.len() + LANES, 0.0);
        let places = self.points.par_iter_mut().zip(&mut self.reach2);
        places.zip(&self.order).for_each(|((place, reach2), &n)| {
            let point = points[n as usize];
            *place = [point[0], point[1], point[2], n as i32];
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

/// Edges of a search cell in units of the smallest reach: rows of cells along x are looked at from one
/// end to the other, in groups, so rows are thick and their ends fine.
const CELL_EDGE_RATIOS: [f32; 3] = [0.25, 0.75, 0.75];

/// How far points spread, and their reaches.
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
    /// Of no points.
    const EMPTY: Self = Self {
        low: [i32::MAX; 3],
        high: [i32::MIN; 3],
        min_reach: f32::INFINITY,
        max_reach: 0.0,
        count: 0,
    };

    /// Of a point.
    fn from_point((p, &reach): (&IntPoint, &f32)) -> Self {
        Self {
            low: [p[0], p[1], p[2]],
            high: [p[0], p[1], p[2]],
            min_reach: reach,
            max_reach: reach,
            count: 1,
        }
    }

    /// Of both.
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
    /// Among the points held here.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn new(among: PointSet<'a>, cells: &'a mut AtomCells) -> Result<Self> {
        let PointSet { points, reach, .. } = among;
        let spread = points.par_iter().zip(reach).map(PointBounds::from_point);
        let spread = spread.reduce(|| PointBounds::EMPTY, PointBounds::union);
        let own = PointBounds {
            count: among.images.owned_point_count(among.halo),
            ..spread.clone()
        };
        let all = among.halo.all_gather("extent of atoms", own)?;
        let all = all.into_iter().fold(PointBounds::EMPTY, PointBounds::union);
        cells.sort(points, reach, &spread, &all);
        Ok(Self {
            points: among,
            max_reach: all.max_reach,
            cells,
        })
    }

    /// Lists the neighbours of the chunk's `n`th atom anew.
    #[inline]
    pub fn list(&self, n: usize, rows: &mut NeighbourRows, scratch: &mut RowScratch) {
        let atom = rows.members[n];
        let (arch, mut found) = (scratch.arch, std::mem::take(&mut scratch.found));
        let count = arch.dispatch(GatherKernel {
            search: self,
            atom,
            found: &mut found,
        });
        let mut row = std::mem::take(&mut scratch.row);
        row.clear();
        row.extend(
            found[..count]
                .iter()
                .map(|&point| scratch.find_or_add_member(point, rows)),
        );
        rows.replace(n, &row);
        (scratch.found, scratch.row) = (found, row);
    }
}

/// Fills `found` with the points near an atom, and returns their number.
struct GatherKernel<'a> {
    search: &'a NeighbourSearch<'a>,
    atom: u32,
    found: &'a mut Vec<u32>,
}

impl WithSimd for GatherKernel<'_> {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        let Self {
            search,
            atom,
            found,
        } = self;
        let cells = &search.cells;
        let centre = search.points.points[atom as usize];
        let reach = search.points.reach[atom as usize];
        let own2 = reach * reach;
        // r < reach_j <= reach_i + slope r  =>  r < reach_i / (1 - slope)
        let radius = (reach / (1.0 - search.points.slope).max(1e-3)).min(search.max_reach);
        // From the near corner of the grid; the margin covers the rounding to f32.
        let at: [f32; 3] = std::array::from_fn(|k| (centre[k] - cells.origin[k]) as f32);
        let radius = radius + 1e-6 * at[0].max(at[1]).max(at[2]);
        let per_unit = cells.cell_edges.map(|edge| 1.0 / edge);
        let range = |k: usize, radius: f32| {
            let first = ((at[k] - radius) * per_unit[k]).max(0.0) as usize;
            let last = ((at[k] + radius) * per_unit[k]) as usize;
            let end = cells.first_cell[k] + cells.dims[k];
            (first.max(cells.first_cell[k]), last.min(end - 1))
        };
        // How far the atom is from the slab of a cell along an axis.
        let gap = |k: usize, cell: usize| {
            let low = cell as f32 * cells.cell_edges[k];
            (low - at[k])
                .max(at[k] - low - cells.cell_edges[k])
                .max(0.0)
        };
        let mut end = 0;
        let (ys, zs) = (range(1, radius), range(2, radius));
        for z in zs.0..=zs.1 {
            for y in ys.0..=ys.1 {
                let left = radius * radius - gap(1, y).powi(2) - gap(2, z).powi(2);
                if left <= 0.0 {
                    continue;
                }
                let xs = range(0, left.sqrt());
                let row = (z - cells.first_cell[2]) * cells.dims[1] + y - cells.first_cell[1];
                let row = row * cells.dims[0];
                let (from, to) = (xs.0 - cells.first_cell[0], xs.1 - cells.first_cell[0]);
                let run = cells.starts[row + from] as usize..cells.starts[row + to + 1] as usize;
                if found.len() < end + run.len() + LANES {
                    found.resize(2 * (end + run.len() + LANES), 0);
                }
                let mut first = run.start;
                while first < run.end {
                    let group = &cells.points[first..first + LANES];
                    let index: [u32; LANES] = std::array::from_fn(|l| group[l][3] as u32);
                    let left = (run.end - first) as u32;
                    let mut near = [0u32; LANES];
                    for l in 0..LANES {
                        let step = |k: usize| group[l][k].wrapping_sub(centre[k]) as f32;
                        let (dx, dy, dz) = (step(0), step(1), step(2));
                        let inside = dx * dx + dy * dy + dz * dz < own2;
                        near[l] = u32::from(inside & ((l as u32) < left) & (index[l] != atom));
                    }
                    if search.points.slope > 0.0 {
                        // Those that reach farther than the atom.
                        let reach2 = &cells.reach2[first..first + LANES];
                        for l in 0..LANES {
                            let step = |k: usize| group[l][k].wrapping_sub(centre[k]) as f32;
                            let (dx, dy, dz) = (step(0), step(1), step(2));
                            let inside = dx * dx + dy * dy + dz * dz < reach2[l];
                            near[l] |= u32::from(inside & ((l as u32) < left) & (index[l] != atom));
                        }
                    }
                    // Without branches: the end moves on only past those to be kept.
                    let slots = &mut found[end..end + LANES];
                    let mut kept = 0;
                    for l in 0..LANES {
                        slots[kept & (LANES - 1)] = index[l];
                        kept += near[l] as usize;
                    }
                    end += kept;
                    first += LANES;
                }
            }
        }
        end
    }
}

//! Finding the points near an atom.

use crate::parallel::prelude::*;
use pulp::{Simd, WithSimd};

use super::rows::Rows;
use super::scratch::Scratch;
use super::{Among, LANES, NOWHERE, Point};
use crate::error::Result;
use crate::files::kept::fields;
use crate::geometry::groups::group;

/// Points sorted into the cells of a regular grid.
///
/// Not [`Buckets`](crate::geometry::buckets::Buckets): sorted anew at every repair of the list, so arrays
/// are kept, and rows of cells are looked at in whole groups of points whose positions lie together.
#[derive(Clone, Default)]
pub struct AtomCells {
    /// The near corner of the grid.
    origin: [i32; 3],
    /// Edges of a cell, in fixed-point units.
    edges: [f32; 3],
    /// The first cell along each axis that has points of those held, and how many there are from it to the last.
    first: [usize; 3],
    dims: [usize; 3],
    /// Where each cell's points start in the arrays below; x fastest, one more at the end.
    starts: Vec<u32>,
    /// The points' indices in cell order.
    order: Vec<u32>,
    /// Positions in cell order, with the point's index as their last element, and as many more as a
    /// group may need.
    points: Vec<Point>,
    /// Square of each point's reach, in the same order.
    reach2: Vec<f32>,
    /// The cell of each point, in the points' own order.
    cell_of: Vec<u32>,
}

impl AtomCells {
    /// Sorts points into cells of the given edges, or larger ones if they were many more than points. The grid is that of
    /// `all` points of the lattice, of which some are held here.
    fn sort(&mut self, points: &[Point], reach: &[f32], held: &Spread, all: &Spread) {
        let edges = EDGES.map(|edge| edge * all.least);
        let (low, high) = (all.low, all.high);
        let spans = high.iter().zip(&low).map(|(h, l)| h.saturating_sub(*l));
        let spans: Vec<f32> = spans.filter(|&s| s > 0).map(|s| s as f32).collect();
        let roomy = spans.iter().product::<f32>() / (4.0 * all.points.max(1) as f32);
        let roomy = roomy.powf(1.0 / spans.len().max(1) as f32);
        let edge = edges.iter().product::<f32>().cbrt();
        let larger = (roomy / edge).max(1.0);
        self.edges = edges.map(|edge| (larger * edge).max(1.0));
        self.origin = low;
        let per_unit = self.edges.map(|edge| 1.0 / edge);
        let along = |k: usize, x: i32| (x.saturating_sub(low[k]) as f32 * per_unit[k]) as usize;
        let first: [usize; 3] = std::array::from_fn(|k| along(k, held.low[k]));
        let dims: [usize; 3] = match points.is_empty() {
            true => [0; 3],
            false => std::array::from_fn(|k| along(k, held.high[k]) + 1 - first[k]),
        };
        (self.first, self.dims) = (first, dims);
        let cell = |p: &Point| {
            let at: [usize; 3] = std::array::from_fn(|k| along(k, p[k]) - first[k]);
            ((at[2] * dims[1] + at[1]) * dims[0] + at[0]) as u32
        };
        points
            .par_iter()
            .map(cell)
            .collect_into_vec(&mut self.cell_of);
        let count = dims.iter().product();
        group(count, &self.cell_of, &mut self.starts, &mut self.order);
        self.points.resize(points.len() + LANES, NOWHERE);
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
pub struct Search<'a> {
    among: Among<'a>,
    /// The largest reach of all points of the lattice.
    most: f32,
    cells: &'a AtomCells,
}

/// Edges of a search cell in units of the smallest reach: rows of cells along x are looked at from one
/// end to the other, in groups, so rows are thick and their ends fine.
const EDGES: [f32; 3] = [0.25, 0.75, 0.75];

/// How far points spread, and their reaches.
#[derive(Clone)]
struct Spread {
    low: [i32; 3],
    high: [i32; 3],
    least: f32,
    most: f32,
    points: usize,
}

fields! { Spread as Spread { low, high, least, most, points } }

impl Spread {
    /// Of no points.
    const NONE: Self = Self {
        low: [i32::MAX; 3],
        high: [i32::MIN; 3],
        least: f32::INFINITY,
        most: 0.0,
        points: 0,
    };

    /// Of a point.
    fn of((p, &reach): (&Point, &f32)) -> Self {
        Self {
            low: [p[0], p[1], p[2]],
            high: [p[0], p[1], p[2]],
            least: reach,
            most: reach,
            points: 1,
        }
    }

    /// Of both.
    fn and(self, other: Self) -> Self {
        Self {
            low: std::array::from_fn(|k| self.low[k].min(other.low[k])),
            high: std::array::from_fn(|k| self.high[k].max(other.high[k])),
            least: self.least.min(other.least),
            most: self.most.max(other.most),
            points: self.points + other.points,
        }
    }
}

impl<'a> Search<'a> {
    /// Among the points held here.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn new(among: Among<'a>, cells: &'a mut AtomCells) -> Result<Self> {
        let Among { points, reach, .. } = among;
        let spread = points.par_iter().zip(reach).map(Spread::of);
        let spread = spread.reduce(|| Spread::NONE, Spread::and);
        let own = Spread {
            points: among.images.own_points(among.held),
            ..spread.clone()
        };
        let all = among.held.told("extent of atoms", own)?;
        let all = all.into_iter().fold(Spread::NONE, Spread::and);
        cells.sort(points, reach, &spread, &all);
        Ok(Self {
            among,
            most: all.most,
            cells,
        })
    }

    /// Lists the neighbours of the chunk's `n`th atom anew.
    #[inline]
    pub fn list(&self, n: usize, rows: &mut Rows, scratch: &mut Scratch) {
        let atom = rows.members[n];
        let (arch, mut found) = (scratch.arch, std::mem::take(&mut scratch.found));
        let count = arch.dispatch(Gather {
            search: self,
            atom,
            found: &mut found,
        });
        let mut row = std::mem::take(&mut scratch.row);
        row.clear();
        row.extend(
            found[..count]
                .iter()
                .map(|&point| scratch.member(point, rows)),
        );
        rows.replace(n, &row);
        (scratch.found, scratch.row) = (found, row);
    }
}

/// Fills `found` with the points near an atom, and returns their number.
struct Gather<'a> {
    search: &'a Search<'a>,
    atom: u32,
    found: &'a mut Vec<u32>,
}

impl WithSimd for Gather<'_> {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        let Self {
            search,
            atom,
            found,
        } = self;
        let cells = &search.cells;
        let centre = search.among.points[atom as usize];
        let reach = search.among.reach[atom as usize];
        let own2 = reach * reach;
        // r < reach_j <= reach_i + slope r  =>  r < reach_i / (1 - slope)
        let radius = (reach / (1.0 - search.among.slope).max(1e-3)).min(search.most);
        // From the near corner of the grid; the margin covers the rounding to f32.
        let at: [f32; 3] = std::array::from_fn(|k| (centre[k] - cells.origin[k]) as f32);
        let radius = radius + 1e-6 * at[0].max(at[1]).max(at[2]);
        let per_unit = cells.edges.map(|edge| 1.0 / edge);
        let range = |k: usize, radius: f32| {
            let first = ((at[k] - radius) * per_unit[k]).max(0.0) as usize;
            let last = ((at[k] + radius) * per_unit[k]) as usize;
            let end = cells.first[k] + cells.dims[k];
            (first.max(cells.first[k]), last.min(end - 1))
        };
        // How far the atom is from the slab of a cell along an axis.
        let gap = |k: usize, cell: usize| {
            let low = cell as f32 * cells.edges[k];
            (low - at[k]).max(at[k] - low - cells.edges[k]).max(0.0)
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
                let row = (z - cells.first[2]) * cells.dims[1] + y - cells.first[1];
                let row = row * cells.dims[0];
                let (from, to) = (xs.0 - cells.first[0], xs.1 - cells.first[0]);
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
                    if search.among.slope > 0.0 {
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

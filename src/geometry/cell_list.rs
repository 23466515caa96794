//! Cell list: points sorted into the cells of a regular grid, to find nearby points (Allen and
//! Tildesley, Computer Simulation of Liquids, 5.3.2).
//!
//! Cells that follow one another along the first axis are neighbours in memory, so a search visits
//! one range of points for each row of cells.

use super::bounding_box;
use super::counting_sort::sort_by_group;
use super::grid_index::offset_of;
use std::ops::Range;

/// Largest number of cells of [`bounded_edge`].
const MAX_CELLS: f64 = (1 << 24) as f64;
/// Searches are wider by this factor, so that rounding does not exclude a point.
const ROUNDING_SLACK: f64 = 1.0 + 1e-9;

/// Points sorted into the cells of a regular grid.
///
/// Only the cells of the points' bounding box are stored. The list holds the order of the points,
/// not their positions.
#[derive(Debug)]
pub struct CellList<const D: usize> {
    origin: [f64; D],
    cell_edge: f64,
    /// The first stored cell along each axis, counted from the origin, and the number of cells.
    first: [usize; D],
    dims: [usize; D],
    /// Position in `order` of the first point of each cell, first axis fastest, and the end.
    starts: Vec<u32>,
    /// The points by cell, ascending in each.
    order: Vec<u32>,
}

impl<const D: usize> CellList<D> {
    /// Sorts points into cells of edge length `cell_edge`, or longer if there would be too many.
    pub fn new(points: &[[f64; D]], cell_edge: f64) -> Self {
        let bounds = bounding_box(points);
        Self::with_origin(
            bounds[0],
            points.iter().copied(),
            bounded_edge(bounds, cell_edge),
        )
    }

    /// Sorts points into cells of edge length `cell_edge` that are laid from a corner `origin`.
    /// Points below the origin belong to the first cells. Any part of the points is in the same
    /// cells.
    pub fn with_origin(
        origin: [f64; D],
        points: impl Iterator<Item = [f64; D]> + Clone,
        cell_edge: f64,
    ) -> Self {
        let [low, high] = bounding_box(points.clone());
        let mut list = Self {
            origin,
            cell_edge,
            first: [0; D],
            dims: [0; D],
            starts: Vec::new(),
            order: Vec::new(),
        };
        if low[0] <= high[0] {
            let [first, last] = [low, high].map(|x| list.cell_of(x));
            list.first = first;
            list.dims = std::array::from_fn(|k| last[k] - first[k] + 1);
        }
        let cells = points.map(|x| list.offset_of(x));
        let (starts, order) = sort_by_group(list.dims.iter().product(), cells);
        Self {
            starts,
            order,
            ..list
        }
    }

    /// Returns the points in the order of their cells.
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// Returns the edge length of the cells.
    pub fn cell_edge(&self) -> f64 {
        self.cell_edge
    }

    /// Returns the position of a point's cell in the order of the cells. The point must be in the
    /// bounding box of the sorted points.
    pub fn offset_of(&self, x: [f64; D]) -> usize {
        let cell = self.cell_of(x);
        offset_of(self.dims, std::array::from_fn(|k| cell[k] - self.first[k]))
    }

    /// Visits every point that is nearer to `x` than `radius`, and some that are farther, always in
    /// the same order.
    pub fn visit_within(&self, x: [f64; D], radius: f64, mut visit: impl FnMut(usize)) {
        let [low, high] = [-radius, radius].map(|r| x.map(|c| c + r * ROUNDING_SLACK));
        self.visit_rows(low, high, |_, range| {
            self.order[range].iter().for_each(|&i| visit(i as usize));
        });
    }

    /// Visits the rows of stored cells along the first axis that touch a box: the index of the row
    /// along the other axes, and the range of its points in [`order`](Self::order).
    #[inline]
    pub fn visit_rows(
        &self,
        low: [f64; D],
        high: [f64; D],
        mut visit: impl FnMut([usize; D], Range<usize>),
    ) {
        let (low, high) = (self.cell_of(low), self.cell_of(high));
        let (mut begin, mut last) = ([0; D], [0; D]);
        for k in 0..D {
            if high[k] < self.first[k] || low[k] >= self.first[k] + self.dims[k] {
                return;
            }
            begin[k] = low[k].saturating_sub(self.first[k]);
            last[k] = (high[k] - self.first[k]).min(self.dims[k] - 1);
        }
        // There are at most three axes; the last one is the slowest.
        let along = |k: usize| if k < D { begin[k]..=last[k] } else { 0..=0 };
        let dim = |k: usize| if k < D { self.dims[k] } else { 1 };
        let mut row = begin;
        for z in along(2) {
            for y in along(1) {
                let offset = (z * dim(1) + y) * dim(0);
                for (k, index) in [(1, y), (2, z)] {
                    if k < D {
                        row[k] = index;
                    }
                }
                let start = self.starts[offset + begin[0]] as usize;
                let end = self.starts[offset + last[0] + 1] as usize;
                visit(row, start..end);
            }
        }
    }

    /// Returns the square of the distance along axis `k` between `x` and the cells of index `i`
    /// along that axis.
    #[inline]
    pub fn squared_gap(&self, k: usize, i: usize, x: f64) -> f64 {
        let (x, index) = (x - self.origin[k], self.first[k] + i);
        let mut gap = (x - self.cell_edge * (index + 1) as f64).max(0.0);
        if index > 0 {
            gap = gap.max(self.cell_edge * index as f64 - x);
        }
        gap * gap
    }

    /// Returns the cell that contains a position, counted from the origin.
    #[inline]
    fn cell_of(&self, x: [f64; D]) -> [usize; D] {
        // The cast turns negative values to zero, and cells too far to be counted to the last one.
        std::array::from_fn(|k| ((x[k] - self.origin[k]) / self.cell_edge) as u32 as usize)
    }
}

/// Returns the edge length of cells for points in a box: `edge`, or its smallest double, fourfold
/// and so on with which the box has no more than [`MAX_CELLS`] cells.
pub fn bounded_edge<const D: usize>([low, high]: [[f64; D]; 2], edge: f64) -> f64 {
    let mut edge = edge.max(f64::MIN_POSITIVE);
    let count = |edge: f64| -> f64 { (0..D).map(|k| (high[k] - low[k]) / edge + 1.0).product() };
    while count(edge) > MAX_CELLS {
        edge *= 2.0;
    }
    edge
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::distance2;
    use crate::geometry::random::Random;

    #[test]
    fn nearby_points_are_visited_once_in_cell_order() {
        let mut random = Random::new(3);
        let mut point = || [[0.0, 9.0], [-2.0, 3.0], [0.0, 7.0]].map(|[a, b]| random.range(a, b));
        let points: Vec<[f64; 3]> = (0..700).map(|_| point()).collect();
        let list = CellList::new(&points, 1.3);
        let anchored = CellList::with_origin([-9.0; 3], points.iter().copied(), 0.7);
        for p in points.iter().step_by(7).chain(&[[-4.0; 3], [20.0; 3]]) {
            for radius in [0.3, 1.3, 4.0, 30.0] {
                for list in [&list, &anchored] {
                    let mut visited = Vec::new();
                    list.visit_within(*p, radius, |i| visited.push(i));
                    let is_near = |i: &usize| distance2(&points[*i], p).sqrt() <= radius;
                    let nearby = (0..points.len()).filter(is_near);
                    assert!(nearby.into_iter().all(|i| visited.contains(&i)));
                    assert!(visited.is_sorted_by_key(|&i| (list.offset_of(points[i]), i)));
                }
            }
        }
    }

    #[test]
    fn few_points_and_tiny_cells_are_no_problem() {
        let empty = CellList::<2>::new(&[], 1.0);
        empty.visit_within([1.0, 2.0], 9.0, |_| panic!("there is none"));
        let points = [[0.0, 0.0], [1e9, 1.0], [1e9, 1.0]];
        let list = CellList::new(&points, f64::MIN_POSITIVE);
        let mut visited = Vec::new();
        list.visit_within([1e9, 1.0], 1e-3, |i| visited.push(i));
        assert_eq!(visited, [1, 2]);
    }
}

//! A grid of cells to which points are added one by one, to find out whether a point is nearby.

use super::NONE;
use super::distance2;
use super::grid_index::offset_of;

/// Points in a box, in the order in which they were added.
#[derive(Debug, Clone)]
pub struct IncrementalGrid<const D: usize> {
    positions: Vec<[f64; D]>,
    low: [f64; D],
    dims: [usize; D],
    cell_edge: f64,
    /// The last point added to each cell.
    last_in_cell: Vec<u32>,
    /// For each point the point added to the same cell before it.
    previous_in_cell: Vec<u32>,
}

impl<const D: usize> IncrementalGrid<D> {
    /// Creates an empty grid for the box from `low` to `high` with cells of edge length
    /// `cell_edge`. Points outside the box belong to the nearest cells.
    pub fn new(low: [f64; D], high: [f64; D], cell_edge: f64) -> Self {
        let dims: [usize; D] =
            std::array::from_fn(|k| ((high[k] - low[k]).max(0.0) / cell_edge) as usize + 1);
        Self {
            positions: Vec::new(),
            low,
            dims,
            cell_edge,
            last_in_cell: vec![NONE; dims.iter().product()],
            previous_in_cell: Vec::new(),
        }
    }

    /// Returns the positions of all points.
    pub fn positions(&self) -> &[[f64; D]] {
        &self.positions
    }

    /// Adds a point and returns its index.
    pub fn add(&mut self, x: [f64; D]) -> u32 {
        let n = self.positions.len() as u32;
        let cell = self.index(self.cell(&x, 0.0));
        self.previous_in_cell.push(self.last_in_cell[cell]);
        self.last_in_cell[cell] = n;
        self.positions.push(x);
        n
    }

    /// Removes all points.
    pub fn clear(&mut self) {
        for n in 0..self.positions.len() {
            let cell = self.index(self.cell(&self.positions[n], 0.0));
            self.last_in_cell[cell] = NONE;
        }
        self.positions.clear();
        self.previous_in_cell.clear();
    }

    /// Returns `true` if no point is nearer to `x` than `radius`.
    pub fn is_free(&self, x: &[f64; D], radius: f64) -> bool {
        let radius2 = radius * radius;
        !self.any_near(x, radius, |n| distance2(&self.positions[n], x) < radius2)
    }

    /// Returns `true` if `accept` returns `true` for any point nearer to `x` than `radius`.
    /// `accept` may also be called for points that are farther away.
    pub fn any_near(
        &self,
        x: &[f64; D],
        radius: f64,
        mut accept: impl FnMut(usize) -> bool,
    ) -> bool {
        // Most searches end in the cell of `x` itself.
        let home = self.index(self.cell(x, 0.0));
        if self.any_in_cell(home, &mut accept) {
            return true;
        }
        let (low, high) = (self.cell(x, -radius), self.cell(x, radius));
        let mut cell = low;
        loop {
            let index = self.index(cell);
            if index != home && self.any_in_cell(index, &mut accept) {
                return true;
            }
            // Go to the next cell of the block, x fastest.
            let Some(k) = (0..D).find(|&k| cell[k] < high[k]) else {
                return false;
            };
            cell[k] += 1;
            cell[..k].copy_from_slice(&low[..k]);
        }
    }

    /// Returns `true` if `accept` returns `true` for a point of a cell.
    fn any_in_cell(&self, cell: usize, mut accept: impl FnMut(usize) -> bool) -> bool {
        let mut n = self.last_in_cell[cell];
        while n != NONE {
            if accept(n as usize) {
                return true;
            }
            n = self.previous_in_cell[n as usize];
        }
        false
    }

    /// Returns the indices of the cell that contains `x + shift` (the same shift along each axis).
    fn cell(&self, x: &[f64; D], shift: f64) -> [usize; D] {
        std::array::from_fn(|k| {
            // The cast turns negative values to zero.
            (((x[k] + shift - self.low[k]) / self.cell_edge) as usize).min(self.dims[k] - 1)
        })
    }

    fn index(&self, cell: [usize; D]) -> usize {
        offset_of(self.dims, cell)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;

    #[test]
    fn a_place_is_free_where_a_scan_finds_nothing() {
        let mut random = Random::new(3);
        let mut point = || [random.range(-3.0, 4.0), random.range(0.0, 9.0)];
        let mut grid = IncrementalGrid::new([-2.0, 0.0], [4.0, 8.0], 0.7);
        let mut free_count = 0;
        for _ in 0..2000 {
            let x = point();
            let is_free = grid.is_free(&x, 0.5);
            let scanned = grid.positions().iter().all(|y| distance2(&x, y) >= 0.25);
            assert_eq!(is_free, scanned);
            if is_free {
                assert_eq!(grid.add(x), free_count);
                free_count += 1;
            }
        }
        assert!(free_count > 50);
        assert!(grid.any_near(&[0.0, 4.0], 9.0, |n| n == 0));
        grid.clear();
        assert!(grid.positions().is_empty() && grid.is_free(&[0.0, 4.0], 20.0));
    }
}

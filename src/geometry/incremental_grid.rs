//! Points put into cells one by one, to find whether there is one nearby.

use super::distance2;

/// No point.
const NO_POINT: u32 = u32::MAX;

/// Points in a box, in the order in which they were added.
#[derive(Debug, Clone)]
pub struct IncrementalGrid<const D: usize> {
    positions: Vec<[f64; D]>,
    low: [f64; D],
    dims: [usize; D],
    cell_edge: f64,
    /// The last point put into each cell.
    last_in_cell: Vec<u32>,
    /// The point put into the same cell before.
    previous_in_cell: Vec<u32>,
}

impl<const D: usize> IncrementalGrid<D> {
    /// None yet, in the box from `low` to `high`, whose cells are `edge` wide. Points outside belong to
    /// the nearest cells.
    pub fn new(low: [f64; D], high: [f64; D], cell_edge: f64) -> Self {
        let dims: [usize; D] =
            std::array::from_fn(|k| ((high[k] - low[k]).max(0.0) / cell_edge) as usize + 1);
        Self {
            positions: Vec::new(),
            low,
            dims,
            cell_edge,
            last_in_cell: vec![NO_POINT; dims.iter().product()],
            previous_in_cell: Vec::new(),
        }
    }

    /// All of them.
    pub fn positions(&self) -> &[[f64; D]] {
        &self.positions
    }

    /// Adds one and returns its number.
    pub fn add(&mut self, x: [f64; D]) -> u32 {
        let n = self.positions.len() as u32;
        let cell = self.index(self.cell(&x, 0.0));
        self.previous_in_cell.push(self.last_in_cell[cell]);
        self.last_in_cell[cell] = n;
        self.positions.push(x);
        n
    }

    /// Takes all of them out again.
    pub fn clear(&mut self) {
        for n in 0..self.positions.len() {
            let cell = self.index(self.cell(&self.positions[n], 0.0));
            self.last_in_cell[cell] = NO_POINT;
        }
        self.positions.clear();
        self.previous_in_cell.clear();
    }

    /// Whether no point is nearer to `x` than `radius`.
    pub fn is_free(&self, x: &[f64; D], radius: f64) -> bool {
        let radius2 = radius * radius;
        !self.any_near(x, radius, |n| distance2(&self.positions[n], x) < radius2)
    }

    /// Whether any of the points nearer to `x` than `radius`, or of some that are not, will do.
    pub fn any_near(
        &self,
        x: &[f64; D],
        radius: f64,
        mut will_do: impl FnMut(usize) -> bool,
    ) -> bool {
        // Most points are sought near where they are.
        let own = self.index(self.cell(x, 0.0));
        if self.any_in_cell(own, &mut will_do) {
            return true;
        }
        let (low, high) = (self.cell(x, -radius), self.cell(x, radius));
        let mut cell = low;
        loop {
            let index = self.index(cell);
            if index != own && self.any_in_cell(index, &mut will_do) {
                return true;
            }
            // The next cell of the block, x fastest.
            let Some(k) = (0..D).find(|&k| cell[k] < high[k]) else {
                return false;
            };
            cell[k] += 1;
            cell[..k].copy_from_slice(&low[..k]);
        }
    }

    /// Whether a point of a cell will do.
    fn any_in_cell(&self, cell: usize, mut will_do: impl FnMut(usize) -> bool) -> bool {
        let mut n = self.last_in_cell[cell];
        while n != NO_POINT {
            if will_do(n as usize) {
                return true;
            }
            n = self.previous_in_cell[n as usize];
        }
        false
    }

    /// The index of the cell `x + shift` along each axis.
    fn cell(&self, x: &[f64; D], shift: f64) -> [usize; D] {
        std::array::from_fn(|k| {
            // A cast cuts off what is below zero.
            (((x[k] + shift - self.low[k]) / self.cell_edge) as usize).min(self.dims[k] - 1)
        })
    }

    fn index(&self, cell: [usize; D]) -> usize {
        (0..D)
            .rev()
            .fold(0, |index, k| index * self.dims[k] + cell[k])
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
        let mut scatter = IncrementalGrid::new([-2.0, 0.0], [4.0, 8.0], 0.7);
        let mut free = 0;
        for _ in 0..2000 {
            let x = point();
            let is_free = scatter.is_free(&x, 0.5);
            let scanned = scatter.positions().iter().all(|y| distance2(&x, y) >= 0.25);
            assert_eq!(is_free, scanned);
            if is_free {
                assert_eq!(scatter.add(x), free);
                free += 1;
            }
        }
        assert!(free > 50);
        assert!(scatter.any_near(&[0.0, 4.0], 9.0, |n| n == 0));
        scatter.clear();
        assert!(scatter.positions().is_empty() && scatter.is_free(&[0.0, 4.0], 20.0));
    }
}

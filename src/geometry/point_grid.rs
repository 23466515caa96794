//! Points in single precision, sorted into cells, for searches of the nearest point.

use super::cell_list::{CellList, bounded_edge};
use super::{bounding_box, distance2};

/// Points in the cells of a grid, for searches in which most nearest points are within a cell or
/// two.
pub struct PointGrid<const D: usize> {
    cells: CellList<D>,
    /// Points in the order of their cells.
    sorted: Vec<[f32; D]>,
}

/// Smallest edge length of a cell.
const MIN_CELL_EDGE: f64 = 2.0;

impl<const D: usize> PointGrid<D> {
    /// Sorts points into cells that are laid from the origin.
    pub fn new(points: &[[f32; D]]) -> Self {
        let positions = points.iter().map(|p| p.map(f64::from));
        let edge = bounded_edge(bounding_box(positions.clone()), MIN_CELL_EDGE);
        let cells = CellList::with_origin([0.0; D], positions, edge);
        let sorted = cells.order().iter().map(|&i| points[i as usize]).collect();
        Self { cells, sorted }
    }

    /// Returns the original number of each sorted point.
    pub fn order(&self) -> &[u32] {
        self.cells.order()
    }

    /// Returns the position of sorted point `i`.
    pub fn position(&self, i: usize) -> [f32; D] {
        self.sorted[i]
    }

    #[inline]
    fn squared_distance(&self, p: [f64; D], i: usize) -> f64 {
        distance2(&p, &self.sorted[i].map(f64::from))
    }

    /// Returns the sorted index of the nearest point (the first of several at the same distance),
    /// and its squared distance. Returns `None` if no point is closer than `limit`. `hint` may be
    /// the index of a point that is probably near; it saves time.
    pub fn nearest(&self, p: [f64; D], limit: f64, hint: Option<usize>) -> Option<(usize, f64)> {
        // Upper bound of the squared distance of the nearest point.
        let mut upper_bound = hint.map_or(f64::INFINITY, |i| self.squared_distance(p, i));
        let known_distance = upper_bound.sqrt() * (1.0 + 1e-9);
        // All points within the radius are examined. The radius grows until the nearest point is
        // inside.
        let mut radius = known_distance.min(self.cells.cell_edge()).min(limit);
        loop {
            let best = self.nearest_within(p, radius, limit, upper_bound);
            upper_bound = best.map_or(upper_bound, |(_, square)| square.min(upper_bound));
            if upper_bound <= radius * radius || radius >= limit {
                return best;
            }
            radius = (2.0 * radius).max(1e-3).min(limit);
        }
    }

    /// Visits the sorted indices of the points in a box.
    pub fn visit_box(&self, low: [f64; D], high: [f64; D], mut visit: impl FnMut(usize)) {
        self.cells.visit_rows(low, high, |_, points| {
            for i in points {
                let q = &self.sorted[i];
                let mut is_inside = true;
                for k in 0..D {
                    let x = f64::from(q[k]);
                    is_inside &= low[k] <= x && x <= high[k];
                }
                if is_inside {
                    visit(i);
                }
            }
        });
    }

    /// Returns the nearest of the points in the cells within `radius` of `p`, if it is closer than
    /// `limit`. `upper_bound` is an upper bound of the squared distance of the nearest point.
    fn nearest_within(
        &self,
        p: [f64; D],
        radius: f64,
        limit: f64,
        upper_bound: f64,
    ) -> Option<(usize, f64)> {
        let (mut nearest, mut min_square) = (usize::MAX, limit * limit);
        // The upper bound excludes distant rows. Rounding must not exclude points at the same
        // distance, of which the first is returned.
        let mut upper_bound = upper_bound.min(min_square);
        self.cells.visit_rows(p, p, |_, points| {
            upper_bound = points.fold(upper_bound, |bound, i| {
                bound.min(self.squared_distance(p, i))
            });
        });
        upper_bound *= 1.0 + 1e-9;
        let radius = radius.min(upper_bound.sqrt());
        let [low, high] = [-radius, radius].map(|r| p.map(|c| c + r));
        self.cells.visit_rows(low, high, |row, points| {
            let mut row_square = 0.0;
            for k in 1..D {
                row_square += self.cells.squared_gap(k, row[k], p[k]);
            }
            if row_square > upper_bound {
                return;
            }
            for i in points {
                let square = self.squared_distance(p, i);
                if square < min_square {
                    (nearest, min_square) = (i, square);
                }
            }
        });
        (nearest != usize::MAX).then_some((nearest, min_square))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;
    use crate::geometry::{dot, sub};

    #[test]
    fn grid_and_scan_find_the_same_points() {
        let mut random = Random::new(3);
        let extent = [20.0, 9.0, 14.0];
        let points: Vec<[f32; 3]> = (0..400)
            .map(|_| extent.map(|e| (0.2 * e + 0.7 * e * random.draw()) as f32))
            .collect();
        let grid = PointGrid::new(&points);
        let order = grid.order();
        for _ in 0..500 {
            let p: [f64; 3] = extent.map(|e| e * (1.4 * random.draw() - 0.2));
            let square = |i: usize| {
                let gap = sub(p, points[i].map(f64::from));
                dot(gap, gap)
            };
            let scanned = (0..points.len()).map(square).fold(f64::INFINITY, f64::min);
            for hint in [None, Some(7)] {
                let (i, actual) = grid.nearest(p, 50.0, hint).unwrap();
                assert!((actual - scanned).abs() < 1e-12);
                assert!((square(order[i] as usize) - scanned).abs() < 1e-12);
                assert_eq!(grid.position(i), points[order[i] as usize]);
                assert!(grid.nearest(p, 0.999 * scanned.sqrt(), hint).is_none());
                assert!(grid.nearest(p, 1.001 * scanned.sqrt(), hint).is_some());
            }
        }
        for _ in 0..100 {
            let low: [f64; 3] = extent.map(|e| e * (1.4 * random.draw() - 0.4));
            let high = low.map(|c| c + 6.0 * random.draw());
            let mut indices = Vec::new();
            grid.visit_box(low, high, |i| indices.push(order[i]));
            indices.sort_unstable();
            let inside = |q: &[f32; 3]| (0..3).all(|k| (low[k]..=high[k]).contains(&q[k].into()));
            let scanned = (0..).zip(&points).filter(|(_, q)| inside(q));
            assert!(indices.into_iter().eq(scanned.map(|(i, _)| i)));
        }
        let empty_grid = PointGrid::new(&[]);
        assert!(empty_grid.nearest([1.0; 3], 9.0, None).is_none());
    }
}

//! Cell list: points sorted into the cells of a regular grid, to find nearby points.

use super::bounding_box;

/// Points sorted into the cells of a regular grid, to find nearby points.
///
/// Points may have labels; a search then visits only the points of one label.
#[derive(Debug)]
pub struct CellList<const D: usize> {
    low: [f64; D],
    cell_edge: f64,
    /// Cell (last axis first) and index of each point, label by label and in cell order.
    points: Vec<([u32; D], u32)>,
    /// Position of the first point of each label in `points`, and the end.
    label_starts: Vec<usize>,
}

impl<const D: usize> CellList<D> {
    /// Sorts points into cells of edge length `cell`. All points get label 0.
    pub fn new(points: &[[f64; D]], cell: f64) -> Self {
        Self::labelled(points, |_| 0, cell)
    }

    /// Sorts points with labels into cells of edge length `cell`.
    pub fn labelled(points: &[[f64; D]], label: impl Fn(usize) -> u32, cell: f64) -> Self {
        let [low, _] = bounding_box(points);
        let mut list = Self {
            low,
            cell_edge: cell,
            points: Vec::new(),
            label_starts: vec![0],
        };
        let mut sorted: Vec<(u32, [u32; D], u32)> = (points.iter().enumerate())
            .map(|(i, &p)| (label(i), list.cell_of(p), i as u32))
            .collect();
        sorted.sort_unstable();
        for group in sorted.chunk_by(|a, b| a.0 == b.0) {
            list.label_starts
                .resize(group[0].0 as usize + 1, list.points.len());
            list.points
                .extend(group.iter().map(|&(_, cell, i)| (cell, i)));
        }
        list.label_starts.push(list.points.len());
        list
    }

    /// Returns the cell that contains a point, last axis first. Points are visited in the order of
    /// these cells.
    pub fn cell_of(&self, p: [f64; D]) -> [u32; D] {
        // One index is left free below and one above, so that indices of neighbour cells cannot
        // overflow.
        const MAX_CELL_INDEX: f64 = (u32::MAX - 2) as f64;
        std::array::from_fn(|k| {
            let axis = D - 1 - k;
            ((p[axis] - self.low[axis]) / self.cell_edge).clamp(0.0, MAX_CELL_INDEX) as u32 + 1
        })
    }

    /// Visits every point of label 0 in the cell of `p` and the cells around it, always in the same
    /// order.
    pub fn visit(&self, p: [f64; D], visit: impl FnMut(usize)) {
        self.visit_labelled(p, 0, visit);
    }

    /// Visits every point of the given label in the cell of `p` and the cells around it, always in
    /// the same order.
    pub fn visit_labelled(&self, p: [f64; D], label: u32, visit: impl FnMut(usize)) {
        let middle = self.cell_of(p);
        self.visit_cells(middle.map(|c| c - 1), middle.map(|c| c + 1), label, visit);
    }

    /// Visits every point of label 0 that is nearer to `p` than `radius`, and some that are
    /// farther.
    pub fn visit_within(&self, p: [f64; D], radius: f64, visit: impl FnMut(usize)) {
        // The margin makes up for rounding.
        let radius = radius * (1.0 + 1e-9);
        let [low, high] = [-radius, radius].map(|r| self.cell_of(p.map(|c| c + r)));
        self.visit_cells(low, high, 0, visit);
    }

    fn visit_cells(&self, low: [u32; D], high: [u32; D], label: u32, mut visit: impl FnMut(usize)) {
        let Some(&[start, end]) = self
            .label_starts
            .get(label as usize..label as usize + 2)
            .and_then(|bounds| bounds.first_chunk::<2>())
        else {
            return;
        };
        let points = &self.points[start..end];
        let row_count: f64 = (0..D - 1)
            .map(|k| f64::from(high[k] - low[k]) + 1.0)
            .product();
        if row_count > points.len() as f64 {
            // If cells are small compared with the radius, there are fewer points than rows of
            // cells.
            let is_inside =
                |cell: &[u32; D]| (0..D).all(|k| low[k] <= cell[k] && cell[k] <= high[k]);
            (points.iter().filter(|(cell, _)| is_inside(cell)))
                .for_each(|&(_, i)| visit(i as usize));
            return;
        }
        // Cells that differ only along the first axis follow one another in `points`.
        let mut row = low;
        loop {
            let last = {
                let mut last = row;
                last[D - 1] = high[D - 1];
                last
            };
            let row_start = points.partition_point(|(cell, _)| *cell < row);
            let tail = &points[row_start..];
            let row_points = &tail[..tail.partition_point(|(cell, _)| *cell <= last)];
            row_points.iter().for_each(|&(_, i)| visit(i as usize));
            let Some(k) = (0..D - 1).rev().find(|&k| row[k] < high[k]) else {
                return;
            };
            row[k] += 1;
            row[k + 1..].copy_from_slice(&low[k + 1..]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;

    #[test]
    fn adjacent_points_are_visited_once_in_cell_order() {
        let mut random = Random::new(3);
        let mut point = || [[0.0, 9.0], [-2.0, 3.0], [0.0, 7.0]].map(|[a, b]| random.range(a, b));
        let points: Vec<[f64; 3]> = (0..700).map(|_| point()).collect();
        let grid = CellList::labelled(&points, |i| i as u32 % 3 * 2, 1.3);
        let plain = CellList::new(&points, 1.3);
        for &p in points.iter().step_by(7) {
            let middle = plain.cell_of(p);
            let is_adjacent =
                |i: &usize| (0..3).all(|k| plain.cell_of(points[*i])[k].abs_diff(middle[k]) < 2);
            let mut expected: Vec<usize> = (0..points.len()).filter(is_adjacent).collect();
            expected.sort_by_key(|&i| (plain.cell_of(points[i]), i));
            let mut visited = Vec::new();
            plain.visit(p, |i| visited.push(i));
            assert_eq!(visited, expected);
            for label in 0..7 {
                let mut visited = Vec::new();
                grid.visit_labelled(p, label, |i| visited.push(i));
                let expected = expected
                    .iter()
                    .copied()
                    .filter(|i| *i as u32 % 3 * 2 == label);
                assert_eq!(visited, expected.collect::<Vec<_>>());
            }
            for radius in [0.3, 1.3, 4.0, 30.0] {
                let mut visited = Vec::new();
                plain.visit_within(p, radius, |i| visited.push(i));
                let squared_distance =
                    |i: usize| (0..3).map(|k| (points[i][k] - p[k]).powi(2)).sum::<f64>();
                let nearby = (0..points.len()).filter(|&i| squared_distance(i).sqrt() <= radius);
                assert!(nearby.into_iter().all(|i| visited.contains(&i)));
                visited.sort_unstable();
                assert!(visited.windows(2).all(|pair| pair[0] < pair[1]));
            }
        }
        assert!(CellList::<2>::new(&[], 1.0).points.is_empty());
        CellList::<2>::new(&[], 1.0).visit([1.0, 2.0], |_| panic!("there is none"));
    }
}

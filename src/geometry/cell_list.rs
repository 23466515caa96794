//! Points sorted into cells, to find those nearby.

/// Points in cells, to find those nearby.
///
/// Points may bear labels; then only those of one label are looked at.
#[derive(Debug)]
pub struct CellList<const D: usize> {
    low: [f64; D],
    cell_edge: f64,
    /// Cell (the last axis first) and number of each point, label by label in the order of cells.
    points: Vec<([u32; D], u32)>,
    /// Where the points of each label begin, and the end.
    label_starts: Vec<usize>,
}

impl<const D: usize> CellList<D> {
    /// Sorts points into cells of this size. Their label is 0.
    pub fn new(points: &[[f64; D]], cell: f64) -> Self {
        Self::labelled(points, |_| 0, cell)
    }

    /// Sorts points that bear labels into cells of this size.
    pub fn labelled(points: &[[f64; D]], label: impl Fn(usize) -> u32, cell: f64) -> Self {
        let low = points.iter().fold([f64::INFINITY; D], |low, p| {
            std::array::from_fn(|k| low[k].min(p[k]))
        });
        let mut buckets = Self {
            low,
            cell_edge: cell,
            points: Vec::new(),
            label_starts: vec![0],
        };
        let mut sorted: Vec<(u32, [u32; D], u32)> = (points.iter().enumerate())
            .map(|(i, &p)| (label(i), buckets.cell_of(p), i as u32))
            .collect();
        sorted.sort_unstable();
        for same in sorted.chunk_by(|a, b| a.0 == b.0) {
            buckets
                .label_starts
                .resize(same[0].0 as usize + 1, buckets.points.len());
            buckets
                .points
                .extend(same.iter().map(|&(_, cell, i)| (cell, i)));
        }
        buckets.label_starts.push(buckets.points.len());
        buckets
    }

    /// The cell that holds a point, the last axis first: points are visited in the order of these.
    pub fn cell_of(&self, p: [f64; D]) -> [u32; D] {
        // One cell is left below and one above, so that neighbours need no care.
        const MAX_CELL_INDEX: f64 = (u32::MAX - 2) as f64;
        std::array::from_fn(|k| {
            let axis = D - 1 - k;
            ((p[axis] - self.low[axis]) / self.cell_edge).clamp(0.0, MAX_CELL_INDEX) as u32 + 1
        })
    }

    /// Every point of label 0 in the cell of `p` and those around it, always in the same order.
    pub fn visit(&self, p: [f64; D], visit: impl FnMut(usize)) {
        self.visit_labelled(p, 0, visit);
    }

    /// The same with those of another label.
    pub fn visit_labelled(&self, p: [f64; D], label: u32, visit: impl FnMut(usize)) {
        let middle = self.cell_of(p);
        self.visit_cells(middle.map(|c| c - 1), middle.map(|c| c + 1), label, visit);
    }

    /// Every point of label 0 nearer to `p` than `radius`, and some that are not.
    pub fn visit_within(&self, p: [f64; D], radius: f64, visit: impl FnMut(usize)) {
        // Rounding must not lose what lies just within.
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
        let rows: f64 = (0..D - 1)
            .map(|k| f64::from(high[k] - low[k]) + 1.0)
            .product();
        if rows > points.len() as f64 {
            // Cells that are small against the radius: points are fewer than rows of cells.
            let within = |cell: &[u32; D]| (0..D).all(|k| low[k] <= cell[k] && cell[k] <= high[k]);
            (points.iter().filter(|(cell, _)| within(cell))).for_each(|&(_, i)| visit(i as usize));
            return;
        }
        // Cells that differ along the first axis only lie one after the other.
        let mut row = low;
        loop {
            let last = {
                let mut last = row;
                last[D - 1] = high[D - 1];
                last
            };
            let from = points.partition_point(|(cell, _)| *cell < row);
            let here = &points[from..];
            let here = &here[..here.partition_point(|(cell, _)| *cell <= last)];
            here.iter().for_each(|&(_, i)| visit(i as usize));
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

    #[test]
    fn all_points_near_are_visited_once_and_in_the_order_of_cells() {
        let mut state = 3u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24)
        };
        let points: Vec<[f64; 3]> = (0..700)
            .map(|_| [9.0 * random(), 5.0 * random() - 2.0, 7.0 * random()])
            .collect();
        let grid = CellList::labelled(&points, |i| i as u32 % 3 * 2, 1.3);
        let plain = CellList::new(&points, 1.3);
        for &p in points.iter().step_by(7) {
            let middle = plain.cell_of(p);
            let beside =
                |i: &usize| (0..3).all(|k| plain.cell_of(points[*i])[k].abs_diff(middle[k]) < 2);
            let mut want: Vec<usize> = (0..points.len()).filter(beside).collect();
            want.sort_by_key(|&i| (plain.cell_of(points[i]), i));
            let mut got = Vec::new();
            plain.visit(p, |i| got.push(i));
            assert_eq!(got, want);
            for label in 0..7 {
                let mut got = Vec::new();
                grid.visit_labelled(p, label, |i| got.push(i));
                let want = want.iter().copied().filter(|i| *i as u32 % 3 * 2 == label);
                assert_eq!(got, want.collect::<Vec<_>>());
            }
            for radius in [0.3, 1.3, 4.0, 30.0] {
                let mut got = Vec::new();
                plain.visit_within(p, radius, |i| got.push(i));
                let far = |i: usize| (0..3).map(|k| (points[i][k] - p[k]).powi(2)).sum::<f64>();
                let near = (0..points.len()).filter(|&i| far(i).sqrt() <= radius);
                assert!(near.into_iter().all(|i| got.contains(&i)));
                got.sort_unstable();
                assert!(got.windows(2).all(|pair| pair[0] < pair[1]));
            }
        }
        assert!(CellList::<2>::new(&[], 1.0).points.is_empty());
        CellList::<2>::new(&[], 1.0).visit([1.0, 2.0], |_| panic!("there is none"));
    }
}

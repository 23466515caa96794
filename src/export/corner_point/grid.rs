//! The cells of a corner-point grid: pillars, and layers between them.

use super::layers::GridLayers;
use super::pillars::Pillars;
use crate::geometry::{norm, sub};

/// Steps of Newton's method to the place of a point in a column; a column is nearly a parallelogram.
const MAX_NEWTON_STEPS: usize = 8;

/// A corner-point grid.
pub struct CornerPointGrid<'a> {
    /// Its pillars.
    pub pillars: &'a Pillars,
    /// Its layers.
    pub layers: &'a GridLayers,
}

impl CornerPointGrid<'_> {
    /// Number of cells along i, j and k.
    pub fn dims(&self) -> [usize; 3] {
        let [n, m] = self.pillars.columns;
        [n, m, self.layers.count]
    }

    /// The place of a cell in arrays: i is fastest, k slowest.
    pub fn cell_index(&self, [i, j, k]: [usize; 3]) -> usize {
        let [n, m, _] = self.dims();
        i + n * (j + m * k)
    }

    /// z at a share of a column along i and j, at the top of layer `k` (or the bottom of the last).
    fn layer_top_z(&self, column: usize, [u, v]: [f64; 2], k: usize) -> f64 {
        let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
        let corner = |c: usize| weights[c] * self.layers.corner_depths(column, c)[k];
        (0..4).map(corner).sum()
    }

    /// A point in a cell, at shares of it along i, j and k.
    pub fn point(&self, [i, j, k]: [usize; 3], [u, v, w]: [f64; 3]) -> [f64; 3] {
        let column = j * self.pillars.columns[0] + i;
        let z = (1.0 - w) * self.layer_top_z(column, [u, v], k)
            + w * self.layer_top_z(column, [u, v], k + 1);
        self.point_at_z(column, [u, v], z)
    }

    /// The point at z on the line through a column at a share of it.
    fn point_at_z(&self, column: usize, share: [f64; 2], z: f64) -> [f64; 3] {
        let [top, bottom] = self.pillars.line_ends(column, share);
        let down = (z - top[2]) / (bottom[2] - top[2]);
        std::array::from_fn(|k| top[k] + down * (bottom[k] - top[k]))
    }

    /// Lengths of a cell along i, j and k, through its middle.
    pub fn cell_lengths(&self, cell: [usize; 3]) -> [f64; 3] {
        std::array::from_fn(|axis| {
            let end = |share: f64| {
                let mut shares = [0.5; 3];
                shares[axis] = share;
                self.point(cell, shares)
            };
            norm(sub(end(1.0), end(0.0)))
        })
    }

    /// The cell that holds a point; `from` is a column to begin with.
    pub fn find_cell(&self, point: [f64; 3], from: usize) -> Option<[usize; 3]> {
        let [n, m, layers] = self.dims();
        let columns = (from..n * m).chain(0..from.min(n * m));
        for column in columns {
            let Some(share) = self.column_coordinates(column, point) else {
                continue;
            };
            let tops: Vec<f64> = (0..=layers)
                .map(|k| self.layer_top_z(column, share, k))
                .collect();
            let k = (0..layers).find(|&k| tops[k] >= point[2] && point[2] >= tops[k + 1]);
            return k.map(|k| [column % n, column / n, k]);
        }
        None
    }

    /// Where a point is in a column along i and j, if it is in it.
    fn column_coordinates(&self, column: usize, point: [f64; 3]) -> Option<[f64; 2]> {
        let at = |share: [f64; 2]| {
            let [x, y, _] = self.point_at_z(column, share, point[2]);
            [x, y]
        };
        let mut share = [0.5; 2];
        for _ in 0..MAX_NEWTON_STEPS {
            let here = at(share);
            let off = [point[0] - here[0], point[1] - here[1]];
            // Shares are linear along i and along j.
            let [u, v] = share;
            let along_i = sub(at([1.0, v]), at([0.0, v]));
            let along_j = sub(at([u, 1.0]), at([u, 0.0]));
            let area = along_i[0] * along_j[1] - along_i[1] * along_j[0];
            share[0] += (off[0] * along_j[1] - off[1] * along_j[0]) / area;
            share[1] += (along_i[0] * off[1] - along_i[1] * off[0]) / area;
        }
        share
            .iter()
            .all(|s| (-1e-9..=1.0 + 1e-9).contains(s))
            .then_some(share)
    }
}

//! Geometry of the cells of a corner-point grid: pillars, and layers between them.

use super::layers::GridLayers;
use super::pillars::Pillars;
use crate::geometry::grid_index::{index_at, offset_of};
use crate::geometry::{norm, sub};
use crate::parallel::prelude::*;

/// Number of Newton steps that find the coordinates of a point in a column. A column is nearly a
/// parallelogram, so few are enough.
const MAX_NEWTON_STEPS: usize = 8;

/// Thickness of a cell, relative to the height of the grid, up to which its layer is pinched out.
const PINCHED_HEIGHT_RATIO: f64 = 1e-9;

/// Thickness in metres of an inactive cell up to which simulators connect the cells above and below
/// it, unless the grid is less high than a thousand times as much.
const MAX_PINCH_THICKNESS: f64 = 1e-3;

/// Corner-point grid.
pub struct CornerPointGrid<'a> {
    /// Pillars of the grid.
    pub pillars: &'a Pillars,
    /// Layers of the grid.
    pub layers: &'a GridLayers,
}

impl CornerPointGrid<'_> {
    /// Returns the number of cells along i, j and k.
    pub fn dims(&self) -> [usize; 3] {
        let [n, m] = self.pillars.columns;
        [n, m, self.layers.count]
    }

    /// Returns the index of a cell in arrays. i is fastest, k slowest.
    pub fn cell_index(&self, cell: [usize; 3]) -> usize {
        offset_of(self.dims(), cell)
    }

    /// Returns `true` if the layer of a cell is pinched out in its column: the cell has no thickness.
    pub fn is_pinched(&self, [i, j, k]: [usize; 3]) -> bool {
        let column = j * self.pillars.columns[0] + i;
        let max_thickness = PINCHED_HEIGHT_RATIO * self.height();
        (0..4).all(|corner| {
            let depths = self.layers.corner_depths(column, corner);
            depths[k] - depths[k + 1] <= max_thickness
        })
    }

    /// Returns `true` if a layer is pinched out in any column.
    pub fn has_pinched_cells(&self) -> bool {
        let dims = self.dims();
        let cells = 0..dims.iter().product();
        cells
            .into_par_iter()
            .any(|cell| self.is_pinched(index_at(dims, cell)))
    }

    /// Returns the thickness in metres up to which simulators are to connect the cells above and below
    /// an inactive cell: that of no cell that is there.
    pub fn pinch_thickness(&self) -> f64 {
        MAX_PINCH_THICKNESS.min(1e-6 * self.height())
    }

    fn height(&self) -> f64 {
        let [high, low] = self.pillars.z;
        high - low
    }

    /// Returns z at fractions of a column along i and j, at the top of layer `k` (or the bottom of
    /// the last layer).
    fn layer_top_z(&self, column: usize, [u, v]: [f64; 2], k: usize) -> f64 {
        let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
        let corner = |c: usize| weights[c] * self.layers.corner_depths(column, c)[k];
        (0..4).map(corner).sum()
    }

    /// Returns the point in a cell at fractions of it along i, j and k.
    pub fn point(&self, [i, j, k]: [usize; 3], [u, v, w]: [f64; 3]) -> [f64; 3] {
        let column = j * self.pillars.columns[0] + i;
        let z = (1.0 - w) * self.layer_top_z(column, [u, v], k)
            + w * self.layer_top_z(column, [u, v], k + 1);
        self.point_at_z(column, [u, v], z)
    }

    /// Returns the point at `z` on the line through a column at fractions of it along i and j.
    fn point_at_z(&self, column: usize, fractions: [f64; 2], z: f64) -> [f64; 3] {
        let [top, bottom] = self.pillars.line_ends(column, fractions);
        let fraction = (z - top[2]) / (bottom[2] - top[2]);
        std::array::from_fn(|k| top[k] + fraction * (bottom[k] - top[k]))
    }

    /// Returns the lengths of a cell along i, j and k, through its centre.
    pub fn cell_lengths(&self, cell: [usize; 3]) -> [f64; 3] {
        std::array::from_fn(|axis| {
            let end = |fraction: f64| {
                let mut fractions = [0.5; 3];
                fractions[axis] = fraction;
                self.point(cell, fractions)
            };
            norm(sub(end(1.0), end(0.0)))
        })
    }

    /// Returns the cell that contains a point. The search begins at the column `start_column`.
    pub fn find_cell(&self, point: [f64; 3], start_column: usize) -> Option<[usize; 3]> {
        let [n, m, layers] = self.dims();
        let columns = (start_column..n * m).chain(0..start_column.min(n * m));
        for column in columns {
            let Some(fractions) = self.column_coordinates(column, point) else {
                continue;
            };
            let tops: Vec<f64> = (0..=layers)
                .map(|k| self.layer_top_z(column, fractions, k))
                .collect();
            let k = (0..layers).find(|&k| tops[k] >= point[2] && point[2] >= tops[k + 1]);
            return k.map(|k| [column % n, column / n, k]);
        }
        None
    }

    /// Returns the fractions of a column along i and j at which a point lies, or `None` if the
    /// point is outside the column.
    fn column_coordinates(&self, column: usize, point: [f64; 3]) -> Option<[f64; 2]> {
        let point_at = |fractions: [f64; 2]| {
            let [x, y, _] = self.point_at_z(column, fractions, point[2]);
            [x, y]
        };
        let mut fractions = [0.5; 2];
        for _ in 0..MAX_NEWTON_STEPS {
            let position = point_at(fractions);
            let offset = [point[0] - position[0], point[1] - position[1]];
            // The position is linear in the fraction along i and in the fraction along j.
            let [u, v] = fractions;
            let along_i = sub(point_at([1.0, v]), point_at([0.0, v]));
            let along_j = sub(point_at([u, 1.0]), point_at([u, 0.0]));
            let area = along_i[0] * along_j[1] - along_i[1] * along_j[0];
            fractions[0] += (offset[0] * along_j[1] - offset[1] * along_j[0]) / area;
            fractions[1] += (along_i[0] * offset[1] - along_i[1] * offset[0]) / area;
        }
        fractions
            .iter()
            .all(|s| (-1e-9..=1.0 + 1e-9).contains(s))
            .then_some(fractions)
    }
}

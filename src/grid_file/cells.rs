//! Positions and volumes of the cells of a corner-point grid, in the world: z grows upwards.

use super::GridFile;
use crate::geometry::grid_index::index_at;
use crate::geometry::{cross, dot, sub};
use crate::parallel::prelude::*;

/// Coordinates of the two points of Gauss' rule on 0..1, which integrates cubic polynomials exactly. The
/// Jacobian of a trilinear cell is of degree 2 along each axis.
const GAUSS_POINTS: [f64; 2] = [0.5 - 0.288_675_134_594_812_9, 0.5 + 0.288_675_134_594_812_9];

/// A straight line on which corners of cells lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pillar {
    /// Position in map view at z = 0.
    base: [f64; 2],
    /// Change of the position with z.
    slope: [f64; 2],
}

impl Pillar {
    fn new([top, bottom]: [[f64; 3]; 2]) -> Self {
        let height = top[2] - bottom[2];
        // A pillar of two equal depths is upright.
        let slope = if height == 0.0 {
            [0.0; 2]
        } else {
            [0, 1].map(|c| (top[c] - bottom[c]) / height)
        };
        Self {
            base: [0, 1].map(|c| top[c] - top[2] * slope[c]),
            slope,
        }
    }

    /// Returns the position at `z`, also beyond the ends.
    pub fn at(&self, z: f64) -> [f64; 2] {
        [0, 1].map(|c| self.base[c] + z * self.slope[c])
    }

    /// Returns the point at `z`.
    pub fn point(&self, z: f64) -> [f64; 3] {
        let [x, y] = self.at(z);
        [x, y, z]
    }

    /// Returns the pillar with each position in map view replaced by `map(position)`, which must be
    /// affine.
    pub fn mapped(&self, map: impl Fn([f64; 2]) -> [f64; 2]) -> Self {
        let (base, end) = (map(self.base), map(self.at(1.0)));
        Self {
            base,
            slope: [0, 1].map(|c| end[c] - base[c]),
        }
    }
}

/// Pillars and corners of a grid in the world.
pub(crate) struct CornerPoints<'a> {
    grid: &'a GridFile,
    /// Pillars in rows along i.
    pub pillars: Vec<Pillar>,
    /// Factor from lengths of the file to those in the world.
    pub scale: f64,
}

impl GridFile {
    /// Returns the pillars and corners in the world.
    pub fn corner_points(&self) -> CornerPoints<'_> {
        let to_world = self.frame.to_world();
        let ends = self.coord.par_chunks(6).map(|pillar| {
            let end = |at: usize| to_world([pillar[at], pillar[at + 1], pillar[at + 2]]);
            Pillar::new([end(0), end(3)])
        });
        CornerPoints {
            grid: self,
            pillars: ends.collect(),
            scale: self.frame.scale(),
        }
    }
}

impl CornerPoints<'_> {
    /// Returns the index of the pillar at a corner of a column. Corner bit 0 is towards larger i, and bit
    /// 1 towards larger j.
    pub fn pillar_index(&self, [i, j]: [usize; 2], corner: usize) -> usize {
        (j + corner / 2 % 2) * (self.grid.dims[0] + 1) + i + corner % 2
    }

    /// Returns z of a corner of a cell. Corner bits 0, 1 and 2 are towards larger i, j and k.
    pub fn z(&self, [i, j, k]: [usize; 3], corner: usize) -> f64 {
        let [nx, ny, _] = self.grid.dims;
        let row = (2 * k + corner / 4) * 2 * ny + 2 * j + corner / 2 % 2;
        -self.scale * self.grid.zcorn[row * 2 * nx + 2 * i + corner % 2]
    }

    /// Returns the eight corners of a cell, in the order of [`z`](Self::z).
    pub fn corners(&self, cell: [usize; 3]) -> [[f64; 3]; 8] {
        let [i, j, _] = cell;
        std::array::from_fn(|corner| {
            let pillar = &self.pillars[self.pillar_index([i, j], corner)];
            pillar.point(self.z(cell, corner))
        })
    }

    /// Returns the volume of each cell, as the integral over its trilinear map. It is negative if the
    /// cell's axes i, j and k (downwards) are left-handed.
    pub fn volumes(&self) -> Vec<f64> {
        let dims = self.grid.dims;
        let cells = (0..self.grid.cell_count()).into_par_iter();
        cells
            .map(|cell| trilinear_volume(&self.corners(index_at(dims, cell))))
            .collect()
    }

    /// Returns the mean of the thickness of active cells with any, or `None` if no such cell has a
    /// thickness.
    pub fn mean_thickness(&self) -> Option<f64> {
        let dims = self.grid.dims;
        let mut sum = 0.0;
        let mut count = 0;
        for cell in (0..self.grid.cell_count()).filter(|&cell| self.grid.is_active(cell)) {
            let thickness = self.thickness(index_at(dims, cell));
            if thickness > 0.0 {
                sum += thickness;
                count += 1;
            }
        }
        (count > 0).then(|| sum / f64::from(count))
    }

    /// Returns the mean thickness of a cell at its four pillars.
    pub fn thickness(&self, cell: [usize; 3]) -> f64 {
        let at_pillar = |corner| self.z(cell, corner) - self.z(cell, corner + 4);
        (0..4).map(at_pillar).sum::<f64>() / 4.0
    }
}

/// Returns the signed volume of a trilinear cell. The sign is positive for right-handed axes i, j and k
/// where k points downwards and i, j are as on a map with y down; so cells of a grid whose j runs to the
/// south of i have positive volumes.
fn trilinear_volume(corners: &[[f64; 3]; 8]) -> f64 {
    let mut volume = 0.0;
    // Coordinates from the first corner keep the digits of cells far from the origin.
    let corners = corners.map(|corner| sub(corner, corners[0]));
    for point in 0..8 {
        let at = [point & 1, point >> 1 & 1, point >> 2].map(|n| GAUSS_POINTS[n]);
        let derivative = |axis: usize| {
            let mut sum = [0.0; 3];
            for (corner, position) in corners.iter().enumerate() {
                let mut weight = if corner >> axis & 1 == 1 { 1.0 } else { -1.0 };
                for other in (0..3).filter(|&other| other != axis) {
                    weight *= if corner >> other & 1 == 1 {
                        at[other]
                    } else {
                        1.0 - at[other]
                    };
                }
                (0..3).for_each(|c| sum[c] += weight * position[c]);
            }
            sum
        };
        volume += dot(cross(derivative(0), derivative(1)), derivative(2)) / 8.0;
    }
    volume
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the corners of a cell from a function of fractions along i, j and k.
    fn cell(map: impl Fn([f64; 3]) -> [f64; 3]) -> [[f64; 3]; 8] {
        std::array::from_fn(|c| map([c & 1, c >> 1 & 1, c >> 2].map(|bit| bit as f64)))
    }

    #[test]
    fn volumes_are_those_of_trilinear_cells() {
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12 * b.abs(), "{a} {b}");
        close(
            trilinear_volume(&cell(|[u, v, w]| [2.0 * u, 3.0 * v, 4.0 * w])),
            24.0,
        );
        // The volume of a sheared box is the determinant of its edges.
        let sheared = cell(|[u, v, w]| [2.0 * u + 7.0 * w, 3.0 * v - w + u, 4.0 * w + 5.0 * u]);
        close(trilinear_volume(&sheared), 3.0 * (2.0 * 4.0 - 7.0 * 5.0));
        // A frustum of side 2 to 1: a third of the height times the sum of areas and their mean.
        let frustum = cell(|[u, v, w]| {
            let side = 2.0 - w;
            [side * (u - 0.5), side * (v - 0.5), 3.0 * w]
        });
        close(trilinear_volume(&frustum), 7.0);
        // A base of 1 with upright sides, whose top is a saddle: the mean height counts.
        let saddle = cell(|[u, v, w]| [u, v, w * (1.0 + u * v)]);
        close(trilinear_volume(&saddle), 1.25);
        let mirrored = cell(|[u, v, w]| [u, -v, w]);
        close(trilinear_volume(&mirrored), -1.0);
        let far = cell(|[u, v, w]| [450_000.0 + u, 6_500_000.0 + v, w - 2500.0]);
        close(trilinear_volume(&far), 1.0);
    }

    #[test]
    fn pillars_are_straight_and_continue() {
        let pillar = Pillar::new([[1.0, 2.0, -10.0], [3.0, 2.0, -20.0]]);
        assert_eq!(pillar.at(-15.0), [2.0, 2.0]);
        assert_eq!(pillar.at(-30.0), [5.0, 2.0]);
        let upright = Pillar::new([[1.0, 2.0, -10.0]; 2]);
        assert_eq!(upright.point(-15.0), [1.0, 2.0, -15.0]);
    }
}

//! The Verlet list: for every atom the atoms within reach, kept while atoms move a little.
//!
//! Positions are fixed-point numbers (see [`FixedPoint`]): differences of neighbours are exact and
//! become `f32` without loss, wherever in the box they are.

use rayon::prelude::*;

/// Atoms per unit of parallel work. Fixed, so that sums do not depend on the number of threads.
pub const CHUNK: usize = 1024;

/// Neighbours are listed, and worked on, in groups of this size.
pub const LANES: usize = 4;

/// A position as integers (axes beyond `D` are 0); the last element is the user's.
pub type Point = [i32; 4];

/// Maps lattice space to integers: 31 bits a coordinate, whatever the size of the box. A box of 256
/// samples is resolved to 2e-7 of a sample.
#[derive(Debug, Clone, Copy)]
pub struct FixedPoint {
    /// Integer units per unit of lattice space; a power of two.
    pub scale: f64,
}

impl FixedPoint {
    /// The largest box coordinate becomes at most 2^30.
    pub fn new(extent: &[f64]) -> Self {
        let longest = extent.iter().fold(1e-30f64, |a, &b| a.max(b));
        Self {
            scale: (30.0 - longest.log2().ceil()).exp2(),
        }
    }

    /// The integers of a position, with 0 for the last element.
    #[inline]
    pub fn of<const D: usize>(&self, x: &[f64; D]) -> Point {
        let mut point = [0; 4];
        for k in 0..D {
            point[k] = (x[k] * self.scale).round_ties_even() as i32;
        }
        point
    }
}

/// A point so far from the box that no atom feels it: fills up groups of neighbours.
pub const NOWHERE: Point = [i32::MAX, i32::MAX, i32::MAX, 0];

/// The neighbours of [`CHUNK`] successive atoms.
#[derive(Default)]
pub struct Rows {
    /// Where each atom's row ends in `list`.
    ends: Vec<u32>,
    /// Indices of neighbours; rows are filled to whole groups with the number of atoms, which is
    /// the index of [`NOWHERE`].
    list: Vec<[u32; LANES]>,
}

impl Rows {
    /// The groups of neighbours of each atom of the chunk.
    #[inline]
    pub fn iter(&self) -> impl Iterator<Item = &[[u32; LANES]]> {
        let mut first = 0;
        self.ends.iter().map(move |&end| {
            let row = &self.list[first..end as usize];
            first = end as usize;
            row
        })
    }
}

/// For every atom, all atoms nearer than the larger of the two atoms' reaches (each pair is listed
/// twice, so no atom writes to another's sums).
#[derive(Default)]
pub struct Neighbours {
    /// One for each chunk of atoms.
    pub chunks: Vec<Rows>,
}

/// Atoms sorted into the cells of a regular grid.
struct Cells {
    /// Edge of a cell, in fixed-point units.
    edge: f32,
    dims: [usize; 3],
    /// Where each cell's atoms start in the arrays below; x fastest, one more at the end.
    starts: Vec<u32>,
    /// Position in cell order, with the atom's index as its last element.
    points: Vec<Point>,
    /// Square of each atom's reach, in cell order.
    reach2: Vec<f32>,
}

impl Cells {
    fn new(points: &[Point], reach: &[f32], edge: f32) -> Self {
        let mut most = [0; 3];
        for point in points {
            for k in 0..3 {
                most[k] = most[k].max(point[k]);
            }
        }
        let dims = most.map(|m| (m as f32 / edge) as usize + 1);
        let cell = |p: &Point| {
            let c = |k: usize| ((p[k] as f32 / edge) as usize).min(dims[k] - 1);
            (c(2) * dims[1] + c(1)) * dims[0] + c(0)
        };
        let mut starts = vec![0u32; dims.iter().product::<usize>() + 1];
        let cells: Vec<u32> = points.par_iter().map(|p| cell(p) as u32).collect();
        for &c in &cells {
            starts[c as usize + 1] += 1;
        }
        for n in 1..starts.len() {
            starts[n] += starts[n - 1];
        }
        let mut next = starts.clone();
        let mut sorted = vec![[0; 4]; points.len()];
        let mut reach2 = vec![0.0; points.len()];
        for (n, &c) in cells.iter().enumerate() {
            let place = next[c as usize] as usize;
            next[c as usize] += 1;
            sorted[place] = [points[n][0], points[n][1], points[n][2], n as i32];
            reach2[place] = reach[n] * reach[n];
        }
        Self {
            edge,
            dims,
            starts,
            points: sorted,
            reach2,
        }
    }

    /// Appends to `found` the atoms nearer to `centre` (atom `index`) than the larger of the two
    /// reaches, none of them farther than `search`.
    #[inline]
    fn near(&self, centre: &Point, index: i32, reach: f32, search: f32, found: &mut Vec<u32>) {
        let inverse = 1.0 / self.edge;
        let x = [centre[0] as f32, centre[1] as f32, centre[2] as f32];
        let range = |k: usize, radius: f32| {
            // The margin covers the rounding of positions to f32.
            let radius = radius + 1e-6 * x[k];
            let low = ((x[k] - radius) * inverse).max(0.0) as usize;
            let high = ((x[k] + radius) * inverse) as usize;
            (low.min(self.dims[k] - 1), high.min(self.dims[k] - 1))
        };
        // How far the centre is from a slab of cells along one axis.
        let gap = |k: usize, cell: usize| {
            let low = cell as f32 * self.edge;
            (low - x[k]).max(x[k] - low - self.edge).max(0.0)
        };
        let (own2, search2) = (reach * reach, search * search);
        let (z0, z1) = range(2, search);
        let (y0, y1) = range(1, search);
        for z in z0..=z1 {
            let left = search2 - gap(2, z).powi(2);
            for y in y0..=y1 {
                let left = left - gap(1, y).powi(2);
                if left < 0.0 {
                    continue;
                }
                let (x0, x1) = range(0, left.sqrt());
                let row = (z * self.dims[1] + y) * self.dims[0];
                let run = self.starts[row + x0] as usize..self.starts[row + x1 + 1] as usize;
                for (point, &other2) in self.points[run.clone()].iter().zip(&self.reach2[run]) {
                    let dx = (point[0] - centre[0]) as f32;
                    let dy = (point[1] - centre[1]) as f32;
                    let dz = (point[2] - centre[2]) as f32;
                    let r2 = dx * dx + dy * dy + dz * dz;
                    if r2 < own2.max(other2) && point[3] != index {
                        found.push(point[3] as u32);
                    }
                }
            }
        }
    }
}

impl Neighbours {
    /// Lists the neighbours of all atoms anew.
    ///
    /// `reach` is each atom's own reach in fixed-point units, `slope` a bound on how fast it changes
    /// over space (0 where it is the same for all), so that an atom finds also those that reach
    /// farther than itself. `points` may have more elements than `reach` (see [`NOWHERE`]).
    pub fn build(&mut self, points: &[Point], reach: &[f32], slope: f32) {
        let count = reach.len();
        let points = &points[..count];
        let (mut least, mut most) = (f32::INFINITY, 0.0f32);
        for &r in reach {
            least = least.min(r);
            most = most.max(r);
        }
        // Half the reach is the cheapest edge; never many more cells than atoms.
        let volume: f32 = (0..3)
            .map(|k| points.iter().map(|p| p[k]).max().unwrap_or(0) as f32)
            .filter(|&length| length > 0.0)
            .product();
        let axes = points
            .iter()
            .fold([0; 3], |a, p| std::array::from_fn(|k| a[k].max(p[k])));
        let axes = axes.iter().filter(|&&a| a > 0).count().max(1);
        let roomy = (volume / (4.0 * count.max(1) as f32)).powf(1.0 / axes as f32);
        let cells = Cells::new(points, reach, (0.5 * least).max(roomy).max(1.0));

        self.chunks
            .resize_with(count.div_ceil(CHUNK), Rows::default);
        self.chunks
            .par_iter_mut()
            .enumerate()
            .for_each_init(Vec::new, |found, (n, rows)| {
                rows.ends.clear();
                rows.list.clear();
                for index in n * CHUNK..((n + 1) * CHUNK).min(count) {
                    found.clear();
                    // r < reach_j <= reach_i + slope r  =>  r < reach_i / (1 - slope)
                    let search = (reach[index] / (1.0 - slope).max(1e-3)).min(most);
                    cells.near(&points[index], index as i32, reach[index], search, found);
                    found.resize(found.len().next_multiple_of(LANES), count as u32);
                    let groups = found.chunks_exact(LANES);
                    rows.list.extend(groups.map(|g| [g[0], g[1], g[2], g[3]]));
                    rows.ends.push(rows.list.len() as u32);
                }
            });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_exactly_the_pairs_in_reach() {
        let fixed = FixedPoint::new(&[20.0, 13.0, 9.0]);
        let mut seed = 7u64;
        let mut random = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 33) as f64 / (1u64 << 31) as f64
        };
        let positions: Vec<[f64; 3]> = (0..1500)
            .map(|_| [20.0 * random(), 13.0 * random(), 9.0 * random()])
            .collect();
        let mut points: Vec<Point> = positions.iter().map(|x| fixed.of(x)).collect();
        points.push(NOWHERE);
        for slope in [0.0, 0.15] {
            let reach: Vec<f32> = positions
                .iter()
                .map(|x| ((1.5 + slope * x[0]) * fixed.scale) as f32)
                .collect();
            let mut neighbours = Neighbours::default();
            neighbours.build(&points, &reach, slope as f32);
            let rows = neighbours.chunks.iter().flat_map(Rows::iter);
            let mut listed = 0;
            for (i, row) in rows.enumerate() {
                let mut found: Vec<usize> = row
                    .iter()
                    .flatten()
                    .map(|&j| j as usize)
                    .filter(|&j| j != positions.len())
                    .collect();
                found.sort_unstable();
                let truth: Vec<usize> = (0..positions.len())
                    .filter(|&j| {
                        let r2: f64 = (0..3)
                            .map(|k| (positions[i][k] - positions[j][k]).powi(2))
                            .sum();
                        i != j && r2.sqrt() * fixed.scale < f64::from(reach[i].max(reach[j]))
                    })
                    .collect();
                assert_eq!(found, truth, "atom {i}");
                listed += 1;
            }
            assert_eq!(listed, positions.len());
        }
    }
}

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
    /// Where each atom's row starts and ends in `list`.
    spans: Vec<[u32; 2]>,
    /// Indices of neighbours; rows are filled to whole groups with the number of atoms, which is
    /// the index of [`NOWHERE`].
    list: Vec<[u32; LANES]>,
}

impl Rows {
    /// The groups of neighbours of each atom of the chunk.
    #[inline]
    pub fn iter(&self) -> impl Iterator<Item = &[[u32; LANES]]> {
        (0..self.spans.len()).map(|n| self.row(n))
    }

    /// The groups of neighbours of the chunk's `n`th atom.
    fn row(&self, n: usize) -> &[[u32; LANES]] {
        let [start, end] = self.spans[n];
        &self.list[start as usize..end as usize]
    }

    /// Adds a neighbour to the row of the chunk's `n`th atom, if it is not there.
    fn insert(&mut self, n: usize, neighbour: u32, filler: u32) {
        let [start, end] = self.spans[n].map(|bound| bound as usize);
        if self.list[start..end]
            .iter()
            .any(|group| group.contains(&neighbour))
        {
            return;
        }
        let last = self.list[start..end].last_mut();
        if let Some(slot) = last.and_then(|group| group.iter_mut().find(|j| **j == filler)) {
            *slot = neighbour;
            return;
        }
        // No room left: the row moves to the end of the list.
        if end < self.list.len() {
            self.spans[n][0] = self.list.len() as u32;
            self.list.extend_from_within(start..end);
        }
        let mut group = [filler; LANES];
        group[0] = neighbour;
        self.list.push(group);
        self.spans[n][1] = self.list.len() as u32;
    }

    /// Number of groups that are in use.
    fn live(&self) -> usize {
        self.spans
            .iter()
            .map(|[start, end]| (end - start) as usize)
            .sum()
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
    /// The cell of each atom, in the atoms' own order.
    cell_of: Vec<u32>,
}

/// Atoms that may be near a few others that share a cell; arrays, so that tests vectorise.
#[derive(Default)]
struct Candidates {
    /// Position relative to some origin in the cell.
    x: [Vec<f32>; 3],
    reach2: Vec<f32>,
    index: Vec<u32>,
    /// Whether each is near the atom at hand.
    near: Vec<bool>,
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
            ((c(2) * dims[1] + c(1)) * dims[0] + c(0)) as u32
        };
        let cell_of: Vec<u32> = points.iter().map(cell).collect();
        let mut starts = vec![0u32; dims.iter().product::<usize>() + 2];
        for &c in &cell_of {
            starts[c as usize + 2] += 1;
        }
        for n in 2..starts.len() {
            starts[n] += starts[n - 1];
        }
        let mut sorted = vec![[0; 4]; points.len()];
        let mut reach2 = vec![0.0; points.len()];
        for (n, &c) in cell_of.iter().enumerate() {
            // The start of the next cell counts up to its place.
            let place = starts[c as usize + 1] as usize;
            starts[c as usize + 1] += 1;
            sorted[place] = [points[n][0], points[n][1], points[n][2], n as i32];
            reach2[place] = reach[n] * reach[n];
        }
        Self {
            edge,
            dims,
            starts,
            points: sorted,
            reach2,
            cell_of,
        }
    }

    /// Collects the atoms within `radius` of the box `[low, high]` (fixed-point units), with
    /// positions relative to `low`.
    fn collect(&self, low: &Point, high: &Point, radius: f32, found: &mut Candidates) {
        // The margin covers the rounding of positions to f32.
        let range = |k: usize| {
            let radius = radius + 1e-6 * high[k] as f32;
            let first = ((low[k] as f32 - radius) / self.edge).max(0.0) as usize;
            let last = ((high[k] as f32 + radius) / self.edge) as usize;
            (first.min(self.dims[k] - 1), last.min(self.dims[k] - 1))
        };
        let (xs, ys, zs) = (range(0), range(1), range(2));
        let size: [f32; 3] = std::array::from_fn(|k| (high[k] - low[k]) as f32);
        let mut end = 0;
        for z in zs.0..=zs.1 {
            for y in ys.0..=ys.1 {
                let row = (z * self.dims[1] + y) * self.dims[0];
                let run = self.starts[row + xs.0] as usize..self.starts[row + xs.1 + 1] as usize;
                found.resize(end + run.len());
                // Without branches: the end moves on only past those to be kept.
                for (point, &reach2) in self.points[run.clone()].iter().zip(&self.reach2[run]) {
                    let x: [f32; 4] = std::array::from_fn(|k| (point[k] - low[k]) as f32);
                    let gap = |k: usize| (-x[k]).max(x[k] - size[k]).max(0.0);
                    let gap2 = gap(0) * gap(0) + gap(1) * gap(1) + gap(2) * gap(2);
                    for k in 0..3 {
                        found.x[k][end] = x[k];
                    }
                    found.reach2[end] = reach2;
                    found.index[end] = point[3] as u32;
                    end += usize::from(gap2 < radius * radius);
                }
            }
        }
        found.resize(end);
    }
}

impl Candidates {
    fn resize(&mut self, count: usize) {
        self.x.iter_mut().for_each(|x| x.resize(count, 0.0));
        self.reach2.resize(count, 0.0);
        self.index.resize(count, 0);
    }

    /// Appends to `list` those nearer to `x` (atom `index`) than the larger of the two reaches, in
    /// groups filled up with `filler`.
    fn append_near(
        &mut self,
        x: [f32; 3],
        index: u32,
        reach: f32,
        filler: u32,
        row: &mut Vec<u32>,
        list: &mut Vec<[u32; LANES]>,
    ) {
        let count = self.index.len();
        let own2 = reach * reach;
        self.near.resize(count, false);
        let [xs, ys, zs] = self.x.each_ref().map(|c| &c[..count]);
        let reach2 = &self.reach2[..count];
        for (n, near) in self.near.iter_mut().enumerate() {
            let (dx, dy, dz) = (xs[n] - x[0], ys[n] - x[1], zs[n] - x[2]);
            *near = dx * dx + dy * dy + dz * dz < own2.max(reach2[n]);
        }
        // Without branches: the row's end moves on only past those to be kept.
        row.resize(count + LANES, filler);
        let mut end = 0;
        for (&other, &near) in self.index.iter().zip(&self.near) {
            row[end] = other;
            end += usize::from(near & (other != index));
        }
        row[end..end + LANES].fill(filler);
        let groups = row[..end.next_multiple_of(LANES)].chunks_exact(LANES);
        list.extend(groups.map(|g| [g[0], g[1], g[2], g[3]]));
    }
}

impl Neighbours {
    /// Lists the neighbours of all atoms anew.
    ///
    /// `reach` is each atom's own reach in fixed-point units, `slope` a bound on how fast it changes
    /// over space (0 where it is the same for all), so that an atom finds also those that reach
    /// farther than itself.
    pub fn build(&mut self, points: &[Point], reach: &[f32], slope: f32) {
        let search = Search::new(points, reach, slope, EDGE_FOR_ALL);
        self.chunks
            .resize_with(points.len().div_ceil(CHUNK), Rows::default);
        self.chunks.par_iter_mut().enumerate().for_each_init(
            Scratch::default,
            |scratch, (n, rows)| {
                let first = n * CHUNK;
                let last = (first + CHUNK).min(points.len());
                rows.list.clear();
                rows.spans.clear();
                rows.spans.resize(last - first, [0; 2]);
                search.list(first..last, first, rows, scratch);
            },
        );
    }

    /// Brings the lists up to date after a few atoms, `moved` in rising order, have got new
    /// positions or reaches: lists their own neighbours anew and adds them to the rows of those. The
    /// result has the same pairs as a new build, besides some that are farther apart.
    pub fn repair(&mut self, points: &[Point], reach: &[f32], slope: f32, moved: &[u32]) {
        let search = Search::new(points, reach, slope, EDGE_FOR_FEW);
        let chunks = self.chunks.par_iter_mut().enumerate();
        chunks.for_each_init(Scratch::default, |scratch, (n, rows)| {
            let first = n * CHUNK;
            let from = moved.partition_point(|&i| (i as usize) < first);
            let to = moved.partition_point(|&i| (i as usize) < first + CHUNK);
            if rows.list.len() > 2 * rows.live() {
                // Mostly old rows: list all anew.
                rows.list.clear();
                search.list(first..first + rows.spans.len(), first, rows, scratch);
            } else {
                let atoms = moved[from..to].iter().map(|&i| i as usize);
                search.list(atoms, first, rows, scratch);
            }
        });
        let filler = points.len() as u32;
        let mut neighbours: Vec<u32> = Vec::new();
        for &i in moved {
            neighbours.clear();
            let row = self.chunks[i as usize / CHUNK].row(i as usize % CHUNK);
            neighbours.extend(row.iter().flatten().filter(|&&j| j != filler));
            for &j in &neighbours {
                self.chunks[j as usize / CHUNK].insert(j as usize % CHUNK, i, filler);
            }
        }
    }
}

/// Finds neighbours.
struct Search<'a> {
    points: &'a [Point],
    reach: &'a [f32],
    slope: f32,
    most: f32,
    cells: Cells,
}

impl<'a> Search<'a> {
    fn new(points: &'a [Point], reach: &'a [f32], slope: f32, edge: f32) -> Self {
        let (mut least, mut most) = (f32::INFINITY, 0.0f32);
        for &r in reach {
            least = least.min(r);
            most = most.max(r);
        }
        // Never many more cells than atoms.
        let axes = points
            .iter()
            .fold([0; 3], |a, p| std::array::from_fn(|k| a[k].max(p[k])));
        let axes: Vec<f32> = axes.iter().filter(|&&a| a > 0).map(|&a| a as f32).collect();
        let roomy = axes.iter().product::<f32>() / (4.0 * points.len().max(1) as f32);
        let roomy = roomy.powf(1.0 / axes.len().max(1) as f32);
        let cells = Cells::new(points, reach, (edge * least).max(roomy).max(1.0));
        Self {
            points,
            reach,
            slope,
            most,
            cells,
        }
    }

    /// Appends new rows of some atoms of the chunk that begins with atom `first`.
    fn list(
        &self,
        atoms: impl Iterator<Item = usize>,
        first: usize,
        rows: &mut Rows,
        scratch: &mut Scratch,
    ) {
        let Scratch {
            order,
            candidates,
            row,
        } = scratch;
        // Those of a cell together: they share their candidates.
        order.clear();
        order.extend(atoms.map(|i| (self.cells.cell_of[i], i as u32)));
        order.sort_unstable();
        for atoms in order.chunk_by(|a, b| a.0 == b.0) {
            let (mut low, mut high, mut radius) = ([i32::MAX; 4], [i32::MIN; 4], 0.0f32);
            for &(_, i) in atoms {
                let point = &self.points[i as usize];
                low = std::array::from_fn(|k| low[k].min(point[k]));
                high = std::array::from_fn(|k| high[k].max(point[k]));
                // r < reach_j <= reach_i + slope r  =>  r < reach_i / (1 - slope)
                let search = self.reach[i as usize] / (1.0 - self.slope).max(1e-3);
                radius = radius.max(search.min(self.most));
            }
            self.cells.collect(&low, &high, radius, candidates);
            for &(_, i) in atoms {
                let point = &self.points[i as usize];
                let x = std::array::from_fn(|k| (point[k] - low[k]) as f32);
                let (reach, filler) = (self.reach[i as usize], self.points.len() as u32);
                let start = rows.list.len() as u32;
                candidates.append_near(x, i, reach, filler, row, &mut rows.list);
                rows.spans[i as usize - first] = [start, rows.list.len() as u32];
            }
        }
    }
}

/// Edge of a search cell in units of the smallest reach, where all atoms are listed: large, as the
/// atoms of a cell share their candidates.
const EDGE_FOR_ALL: f32 = 1.1;
/// The same where atoms here and there are listed: smaller, for fewer candidates.
const EDGE_FOR_FEW: f32 = 0.6;

/// Working memory of one thread.
#[derive(Default)]
struct Scratch {
    order: Vec<(u32, u32)>,
    candidates: Candidates,
    row: Vec<u32>,
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
            neighbours.build(&points[..reach.len()], &reach, slope as f32);
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

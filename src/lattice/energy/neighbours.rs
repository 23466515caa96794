//! The Verlet list: for every atom the atoms within reach, kept while atoms move a little.
//!
//! Positions are fixed-point numbers (see [`FixedPoint`]): differences of neighbours are exact and
//! become `f32` without loss, wherever in the box they are.
//!
//! Atoms are worked on in chunks of successive ones, which lie together in space. A chunk has a table
//! of its *members*: its own atoms, then all others that are neighbours of any. Rows of neighbours
//! are indices into that table, which are short, and the positions of a chunk's members, copied
//! together, fit the nearest cache.

use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Atoms per unit of parallel work. Fixed, so that sums do not depend on the number of threads.
pub const CHUNK: usize = 1024;

/// Neighbours are listed, and worked on, in groups of this size.
pub const LANES: usize = 8;

/// Most members of a chunk; that of index [`FILLER`] is nowhere.
pub const MEMBERS: usize = 1 << 16;

/// Fills up groups of neighbours.
pub const FILLER: u16 = u16::MAX;

/// A position as integers (axes beyond `D` are 0); the last element is the user's.
pub type Point = [i32; 4];

/// Maps lattice space to integers: 31 bits a coordinate, whatever the size of the box. A box of 256
/// samples is resolved to 5e-7 of a sample.
#[derive(Debug, Clone, Copy)]
pub struct FixedPoint {
    /// Integer units per unit of lattice space; a power of two.
    pub scale: f64,
}

impl FixedPoint {
    /// The largest box coordinate becomes at most 2^29, so that mirror images beyond a side and
    /// differences fit as well.
    pub fn new(extent: &[f64]) -> Self {
        let longest = extent.iter().fold(1e-30f64, |a, &b| a.max(b));
        Self {
            scale: (29.0 - longest.log2().ceil()).exp2(),
        }
    }

    /// The integer nearest to a coordinate in units of `1 / scale`, which is less than 2^31.
    #[inline(always)]
    pub fn coordinate(&self, x: f64) -> i32 {
        // Adding 1.5 * 2^52 leaves the integer in the lowest bits of the sum.
        (x * self.scale + 6_755_399_441_055_744.0).to_bits() as i32
    }

    /// The integers of a position, with 0 for the last element.
    #[inline(always)]
    pub fn of<const D: usize>(&self, x: &[f64; D]) -> Point {
        let mut point = [0; 4];
        for k in 0..D {
            point[k] = self.coordinate(x[k]);
        }
        point
    }
}

/// A point so far from the box that no atom feels it.
pub const NOWHERE: Point = [i32::MAX, i32::MAX, i32::MAX, 0];

/// The neighbours of up to [`CHUNK`] successive atoms.
#[derive(Clone, Default)]
pub struct Rows {
    /// Index of each member among all points: first the chunk's own atoms, then their neighbours.
    pub members: Vec<u32>,
    /// Where each atom's row starts and ends in `list`.
    spans: Vec<[u32; 2]>,
    /// Members, in rows filled up to whole groups.
    list: Vec<[u16; LANES]>,
    /// Whether there are more members than can be numbered.
    pub overflowed: bool,
}

impl Rows {
    /// Number of the chunk's own atoms.
    pub fn len(&self) -> usize {
        self.spans.len()
    }

    /// Whether the chunk has no atoms.
    pub fn is_empty(&self) -> bool {
        self.spans.is_empty()
    }

    /// The groups of neighbours of each atom of the chunk.
    #[inline(always)]
    pub fn iter(&self) -> impl Iterator<Item = &[[u16; LANES]]> {
        let spans = self.spans.iter();
        spans.map(|&[start, end]| &self.list[start as usize..end as usize])
    }

    /// The neighbours of the chunk's `n`th atom, as members.
    fn row(&self, n: usize) -> impl Iterator<Item = u16> {
        let [start, end] = self.spans[n].map(|bound| bound as usize);
        let row = self.list[start..end].as_flattened().iter();
        row.copied().filter(|&m| m != FILLER)
    }

    /// Begins anew with the given atoms and no neighbours.
    fn reset(&mut self, atoms: Range<usize>) {
        self.members.clear();
        self.members.extend(atoms.start as u32..atoms.end as u32);
        self.list.clear();
        self.spans.clear();
        self.spans.resize(atoms.len(), [0; 2]);
        self.overflowed = false;
    }

    /// Replaces the row of the chunk's `n`th atom: in its place if it fits.
    fn replace(&mut self, n: usize, row: &[u16]) {
        let groups = row.len().div_ceil(LANES);
        let [start, end] = self.spans[n].map(|bound| bound as usize);
        let start = if groups <= end - start {
            start
        } else {
            self.list.len()
        };
        if start + groups > self.list.len() {
            self.list.resize(start + groups, [FILLER; LANES]);
        }
        for (group, row) in self.list[start..].iter_mut().zip(row.chunks(LANES)) {
            *group = [FILLER; LANES];
            group[..row.len()].copy_from_slice(row);
        }
        self.spans[n] = [start as u32, (start + groups) as u32];
    }

    /// Adds a member to the row of the chunk's `n`th atom, if it is not there.
    fn insert(&mut self, n: usize, member: u16) {
        let [start, end] = self.spans[n].map(|bound| bound as usize);
        let row = self.list[start..end].as_flattened_mut();
        if row.contains(&member) {
            return;
        }
        if let Some(slot) = row.iter_mut().rev().take(LANES).find(|m| **m == FILLER) {
            *slot = member;
            return;
        }
        // No room left: the row moves to the end of the list.
        if end < self.list.len() {
            self.spans[n][0] = self.list.len() as u32;
            self.list.extend_from_within(start..end);
        }
        let mut group = [FILLER; LANES];
        group[0] = member;
        self.list.push(group);
        self.spans[n][1] = self.list.len() as u32;
    }

    /// Takes a member out of the row of the chunk's `n`th atom, if it is there.
    fn remove(&mut self, n: usize, member: u16) {
        let [start, end] = self.spans[n].map(|bound| bound as usize);
        let row = self.list[start..end].as_flattened_mut();
        let Some(place) = row.iter().position(|&m| m == member) else {
            return;
        };
        // The last neighbour takes its place.
        let last = row.iter().rposition(|&m| m != FILLER).unwrap_or(place);
        row[place] = row[last];
        row[last] = FILLER;
        if last % LANES == 0 {
            self.spans[n][1] -= 1;
        }
    }

    /// Drops what no row uses.
    fn compact(&mut self, scratch: &mut Scratch) {
        let (members, list) = (
            std::mem::take(&mut self.members),
            std::mem::take(&mut self.list),
        );
        self.members.extend_from_slice(&members[..self.spans.len()]);
        for n in 0..self.spans.len() {
            let [start, end] = self.spans[n].map(|bound| bound as usize);
            self.spans[n][0] = self.list.len() as u32;
            for group in &list[start..end] {
                let renumbered = group.map(|m| match members.get(m as usize) {
                    Some(&point) => scratch.member(point, self),
                    None => FILLER,
                });
                self.list.push(renumbered);
            }
            self.spans[n][1] = self.list.len() as u32;
        }
    }

    /// Number of groups that are in use.
    fn live(&self) -> usize {
        let spans = self.spans.iter();
        spans.map(|[start, end]| (end - start) as usize).sum()
    }
}

/// For every atom, all points nearer than the larger of the two reaches (each pair of atoms is
/// listed twice, so no atom writes to another's sums).
#[derive(Clone, Default)]
pub struct Neighbours {
    /// One for each chunk of atoms.
    pub chunks: Vec<Rows>,
    cells: Cells,
}

impl Neighbours {
    /// Lists the neighbours of the first `atoms` of `points` anew.
    ///
    /// `reach` is each point's own reach in fixed-point units, `slope` a bound on how fast it changes
    /// over space (0 where it is the same for all), so that an atom finds also those that reach
    /// farther than itself.
    pub fn build(&mut self, points: &[Point], atoms: usize, reach: &[f32], slope: f32) {
        let search = Search::new(points, reach, slope, &mut self.cells);
        self.chunks
            .resize_with(atoms.div_ceil(CHUNK), Rows::default);
        let chunks = self.chunks.par_iter_mut().enumerate();
        chunks.for_each_init(
            || Scratch::new(points.len()),
            |scratch, (n, rows)| {
                rows.reset(n * CHUNK..(n * CHUNK + CHUNK).min(atoms));
                scratch.take(rows);
                for n in 0..rows.len() {
                    search.list(n, rows, scratch);
                }
            },
        );
    }

    /// Brings the lists up to date after a few points, `moved` in rising order, have got new
    /// positions or reaches: lists the neighbours of the `atoms` among them anew, and tells those
    /// atoms whose neighbours they have become or ceased to be. The result has the same pairs as a
    /// new build.
    ///
    /// `partner(i, j)` is the pair by which the other atom knows of a pair of atom `i` and point `j`.
    pub fn repair(
        &mut self,
        points: &[Point],
        atoms: usize,
        reach: &[f32],
        slope: f32,
        moved: &[u32],
        partner: impl Fn(u32, u32) -> (u32, u32) + Sync,
    ) {
        let search = Search::new(points, reach, slope, &mut self.cells);
        let moved = &moved[..moved.partition_point(|&i| (i as usize) < atoms)];
        let chunks = self.chunks.par_iter_mut().enumerate();
        let changes: Vec<Vec<Change>> = chunks
            .map_init(
                || Scratch::new(points.len()),
                |scratch, (n, rows)| {
                    let first = n * CHUNK;
                    let from = moved.partition_point(|&i| (i as usize) < first);
                    let to = moved.partition_point(|&i| (i as usize) < first + CHUNK);
                    let mut changes = Vec::new();
                    if from == to {
                        return changes;
                    }
                    scratch.take(rows);
                    if rows.list.len() > 2 * rows.live() || rows.members.len() > 4 * CHUNK {
                        rows.compact(scratch);
                    }
                    for &i in &moved[from..to] {
                        let n = i as usize - first;
                        scratch.old.clear();
                        scratch.old.extend(rows.row(n));
                        search.list(n, rows, scratch);
                        scratch.compare(|member, is_new| {
                            let (atom, point) = partner(i, rows.members[member as usize]);
                            changes.push(Change {
                                atom,
                                point,
                                is_new,
                            });
                        });
                    }
                    changes
                },
            )
            .collect();
        // By chunk of the atom that must know, in the same order always.
        let mut by_chunk: Vec<Vec<Change>> = vec![Vec::new(); self.chunks.len()];
        for change in changes.into_iter().flatten() {
            by_chunk[change.atom as usize / CHUNK].push(change);
        }
        let chunks = self.chunks.par_iter_mut().zip(&by_chunk);
        chunks.for_each_init(
            || Scratch::new(points.len()),
            |scratch, (rows, changes)| {
                if !changes.is_empty() {
                    scratch.take(rows);
                }
                for change in changes {
                    let (n, member) = (
                        change.atom as usize % CHUNK,
                        scratch.member(change.point, rows),
                    );
                    if change.is_new {
                        rows.insert(n, member);
                    } else {
                        rows.remove(n, member);
                    }
                }
            },
        );
    }
}

/// A point has become a neighbour of an atom, or has ceased to be one.
#[derive(Clone, Copy)]
struct Change {
    atom: u32,
    point: u32,
    is_new: bool,
}

/// Working memory of one thread.
struct Scratch {
    arch: Arch,
    /// For each point, its number among the members of the chunk at hand, if that member is it.
    number: Vec<u16>,
    /// Points found near an atom.
    found: Vec<u32>,
    /// The row made of them, and that before.
    row: Vec<u16>,
    old: Vec<u16>,
    /// Whether a member is in the old row.
    was_there: Vec<bool>,
}

impl Scratch {
    fn new(points: usize) -> Self {
        Self {
            arch: Arch::new(),
            number: vec![0; points],
            found: Vec::new(),
            row: Vec::new(),
            old: Vec::new(),
            was_there: Vec::new(),
        }
    }

    /// Tells which members the new row has (`true`) and the old one had not, and the reverse.
    fn compare(&mut self, mut tell: impl FnMut(u16, bool)) {
        self.was_there.resize(MEMBERS, false);
        for &member in &self.old {
            self.was_there[member as usize] = true;
        }
        for &member in &self.row {
            if !std::mem::take(&mut self.was_there[member as usize]) {
                tell(member, true);
            }
        }
        for &member in &self.old {
            if std::mem::take(&mut self.was_there[member as usize]) {
                tell(member, false);
            }
        }
    }

    /// Turns to another chunk.
    fn take(&mut self, rows: &Rows) {
        for (number, &point) in rows.members.iter().enumerate() {
            self.number[point as usize] = number as u16;
        }
    }

    /// The number of a point among the members of the chunk at hand, which it becomes if it is none.
    #[inline(always)]
    fn member(&mut self, point: u32, rows: &mut Rows) -> u16 {
        let number = self.number[point as usize];
        if rows.members.get(number as usize) == Some(&point) {
            return number;
        }
        if rows.members.len() >= FILLER as usize {
            rows.overflowed = true;
            return FILLER;
        }
        let number = rows.members.len() as u16;
        self.number[point as usize] = number;
        rows.members.push(point);
        number
    }
}

/// Points sorted into the cells of a regular grid.
#[derive(Clone, Default)]
struct Cells {
    /// The near corner of the grid.
    origin: [i32; 3],
    /// Edges of a cell, in fixed-point units.
    edges: [f32; 3],
    dims: [usize; 3],
    /// Where each cell's points start in the arrays below; x fastest, one more at the end.
    starts: Vec<u32>,
    /// Positions in cell order, with the point's index as their last element, and as many more as a
    /// group may need.
    points: Vec<Point>,
    /// Square of each point's reach, in the same order.
    reach2: Vec<f32>,
    /// The cell of each point, in the points' own order.
    cell_of: Vec<u32>,
}

impl Cells {
    /// Sorts points into cells of the given edges, or larger ones if they were many more than points.
    fn sort(&mut self, points: &[Point], reach: &[f32], edges: [f32; 3]) {
        let (mut low, mut high) = ([i32::MAX; 3], [i32::MIN; 3]);
        for point in points {
            for k in 0..3 {
                low[k] = low[k].min(point[k]);
                high[k] = high[k].max(point[k]);
            }
        }
        let spans = high.iter().zip(&low).map(|(h, l)| h.saturating_sub(*l));
        let spans: Vec<f32> = spans.filter(|&s| s > 0).map(|s| s as f32).collect();
        let roomy = spans.iter().product::<f32>() / (4.0 * points.len().max(1) as f32);
        let roomy = roomy.powf(1.0 / spans.len().max(1) as f32);
        let edge = edges.iter().product::<f32>().cbrt();
        let larger = (roomy / edge).max(1.0);
        self.edges = edges.map(|edge| (larger * edge).max(1.0));
        self.origin = low;
        let per_unit = self.edges.map(|edge| 1.0 / edge);
        let along = |k: usize, x: i32| (x.saturating_sub(low[k]) as f32 * per_unit[k]) as usize;
        let dims: [usize; 3] = std::array::from_fn(|k| along(k, high[k]) + 1);
        self.dims = dims;
        self.starts.clear();
        self.starts.resize(dims.iter().product::<usize>() + 2, 0);
        self.cell_of.clear();
        for p in points {
            let cell = (along(2, p[2]) * dims[1] + along(1, p[1])) * dims[0] + along(0, p[0]);
            self.starts[cell + 2] += 1;
            self.cell_of.push(cell as u32);
        }
        for n in 2..self.starts.len() {
            self.starts[n] += self.starts[n - 1];
        }
        self.points.resize(points.len() + LANES, NOWHERE);
        self.reach2.resize(points.len() + LANES, 0.0);
        for (n, (point, &c)) in points.iter().zip(&self.cell_of).enumerate() {
            // The start of the next cell counts up to its place.
            let place = self.starts[c as usize + 1] as usize;
            self.starts[c as usize + 1] += 1;
            self.points[place] = [point[0], point[1], point[2], n as i32];
            self.reach2[place] = reach[n] * reach[n];
        }
    }
}

/// Finds the points near an atom.
struct Search<'a> {
    points: &'a [Point],
    reach: &'a [f32],
    slope: f32,
    most: f32,
    cells: &'a Cells,
}

/// Edges of a search cell in units of the smallest reach: rows of cells along x are looked at from one
/// end to the other, in groups, so rows are thick and their ends fine.
const EDGES: [f32; 3] = [0.25, 0.75, 0.75];

impl<'a> Search<'a> {
    fn new(points: &'a [Point], reach: &'a [f32], slope: f32, cells: &'a mut Cells) -> Self {
        let (mut least, mut most) = (f32::INFINITY, 0.0f32);
        for &r in reach {
            least = least.min(r);
            most = most.max(r);
        }
        cells.sort(points, reach, EDGES.map(|edge| edge * least));
        Self {
            points,
            reach,
            slope,
            most,
            cells,
        }
    }

    /// Lists the neighbours of the chunk's `n`th atom anew.
    #[inline]
    fn list(&self, n: usize, rows: &mut Rows, scratch: &mut Scratch) {
        let atom = rows.members[n];
        let (arch, mut found) = (scratch.arch, std::mem::take(&mut scratch.found));
        let count = arch.dispatch(Near {
            search: self,
            atom,
            found: &mut found,
        });
        let mut row = std::mem::take(&mut scratch.row);
        row.clear();
        row.extend(
            found[..count]
                .iter()
                .map(|&point| scratch.member(point, rows)),
        );
        rows.replace(n, &row);
        (scratch.found, scratch.row) = (found, row);
    }
}

/// Fills `found` with the points near an atom, and returns their number.
struct Near<'a> {
    search: &'a Search<'a>,
    atom: u32,
    found: &'a mut Vec<u32>,
}

impl WithSimd for Near<'_> {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        let Self {
            search,
            atom,
            found,
        } = self;
        let cells = &search.cells;
        let centre = search.points[atom as usize];
        let reach = search.reach[atom as usize];
        let own2 = reach * reach;
        // r < reach_j <= reach_i + slope r  =>  r < reach_i / (1 - slope)
        let radius = (reach / (1.0 - search.slope).max(1e-3)).min(search.most);
        // From the near corner of the grid; the margin covers the rounding to f32.
        let at: [f32; 3] = std::array::from_fn(|k| (centre[k] - cells.origin[k]) as f32);
        let radius = radius + 1e-6 * at[0].max(at[1]).max(at[2]);
        let per_unit = cells.edges.map(|edge| 1.0 / edge);
        let range = |k: usize, radius: f32| {
            let first = ((at[k] - radius) * per_unit[k]).max(0.0) as usize;
            let last = ((at[k] + radius) * per_unit[k]) as usize;
            (first, last.min(cells.dims[k] - 1))
        };
        // How far the atom is from the slab of a cell along an axis.
        let gap = |k: usize, cell: usize| {
            let low = cell as f32 * cells.edges[k];
            (low - at[k]).max(at[k] - low - cells.edges[k]).max(0.0)
        };
        let mut end = 0;
        let (ys, zs) = (range(1, radius), range(2, radius));
        for z in zs.0..=zs.1 {
            for y in ys.0..=ys.1 {
                let left = radius * radius - gap(1, y).powi(2) - gap(2, z).powi(2);
                if left <= 0.0 {
                    continue;
                }
                let xs = range(0, left.sqrt());
                let row = (z * cells.dims[1] + y) * cells.dims[0];
                let run = cells.starts[row + xs.0] as usize..cells.starts[row + xs.1 + 1] as usize;
                if found.len() < end + run.len() + LANES {
                    found.resize(2 * (end + run.len() + LANES), 0);
                }
                let mut first = run.start;
                while first < run.end {
                    let group = &cells.points[first..first + LANES];
                    let index: [u32; LANES] = std::array::from_fn(|l| group[l][3] as u32);
                    let left = (run.end - first) as u32;
                    let mut near = [0u32; LANES];
                    for l in 0..LANES {
                        let step = |k: usize| group[l][k].wrapping_sub(centre[k]) as f32;
                        let (dx, dy, dz) = (step(0), step(1), step(2));
                        let inside = dx * dx + dy * dy + dz * dz < own2;
                        near[l] = u32::from(inside & ((l as u32) < left) & (index[l] != atom));
                    }
                    if search.slope > 0.0 {
                        // Those that reach farther than the atom.
                        let reach2 = &cells.reach2[first..first + LANES];
                        for l in 0..LANES {
                            let step = |k: usize| group[l][k].wrapping_sub(centre[k]) as f32;
                            let (dx, dy, dz) = (step(0), step(1), step(2));
                            let inside = dx * dx + dy * dy + dz * dz < reach2[l];
                            near[l] |= u32::from(inside & ((l as u32) < left) & (index[l] != atom));
                        }
                    }
                    // Without branches: the end moves on only past those to be kept.
                    let slots = &mut found[end..end + LANES];
                    let mut kept = 0;
                    for l in 0..LANES {
                        slots[kept & (LANES - 1)] = index[l];
                        kept += near[l] as usize;
                    }
                    end += kept;
                    first += LANES;
                }
            }
        }
        end
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fixed_point_rounds_to_the_nearest() {
        let fixed = FixedPoint { scale: 1024.0 };
        for (x, truth) in [(0.0, 0), (1.0, 1024), (-2.5, -2560), (0.75 / 1024.0, 1)] {
            assert_eq!(fixed.coordinate(x), truth);
        }
        assert!(FixedPoint::new(&[255.0, 3.0]).coordinate(255.0) <= 1 << 29);
    }

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
        let points: Vec<Point> = positions.iter().map(|x| fixed.of(x)).collect();
        // The last 200 are points, but no atoms.
        let atoms = 1300;
        for slope in [0.0, 0.15] {
            let reach: Vec<f32> = positions
                .iter()
                .map(|x| ((1.5 + slope * x[0]) * fixed.scale) as f32)
                .collect();
            let mut neighbours = Neighbours::default();
            neighbours.build(&points, atoms, &reach, slope as f32);
            let mut listed = 0;
            for rows in &neighbours.chunks {
                assert!(!rows.overflowed);
                for n in 0..rows.len() {
                    let i = rows.members[n] as usize;
                    assert_eq!(i, listed);
                    let mut found: Vec<u32> =
                        rows.row(n).map(|m| rows.members[m as usize]).collect();
                    found.sort_unstable();
                    let truth: Vec<u32> = (0..positions.len())
                        .filter(|&j| {
                            let r2: f64 = (0..3)
                                .map(|k| (positions[i][k] - positions[j][k]).powi(2))
                                .sum();
                            i != j && r2.sqrt() * fixed.scale < f64::from(reach[i].max(reach[j]))
                        })
                        .map(|j| j as u32)
                        .collect();
                    assert_eq!(found, truth, "atom {i}");
                    listed += 1;
                }
            }
            assert_eq!(listed, atoms);
        }
    }
}

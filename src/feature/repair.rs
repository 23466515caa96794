//! Ridges through crossings and up to the sides of the box.
//!
//! Within some widths of the smoothing, two crossing ridges bend one another's crests together and
//! turn the Hessian's eigenvectors to the bisectors; at the sides of the box, mirrored samples do
//! the same. There candidates are *doubtful*. The others around them tell where the sheets run: from
//! the rim of the doubtful zone each sheet is continued column by column, every new point read from
//! a quadratic surface fitted to the reliable points nearby (on the far side of a crossing too).
//! Doubtful candidates beside a continued sheet are dropped.

use super::crossing::Candidate;
use super::grid::Grid;
use super::symmetric::eigenvalues;
use super::volume::Volume;
use std::collections::HashMap;

/// Reliable points within this many samples of a new point are fitted; the second radius is for the
/// middle of wide zones, where the first finds too few.
const RADII: [i32; 2] = [8, 15];
/// Normals of one sheet agree at least this much (cosine).
const SAME_NORMAL: f32 = 0.9;
/// Two fits of one sheet agree at least this much (cosine).
const SAME_FIT: f32 = 0.97;
/// A sheet goes on while the smoothed image is at least this share of what it was at the rim.
const SUPPORT: f32 = 0.7;
/// A front goes this many columns into the zone at most.
const STEPS: u32 = 16;
/// A sample is given this many new points at most.
const MOST: usize = 4;
/// Fewer points than this carry no fit.
const FEWEST: usize = 6;
/// Expected error of a point (samples) ...
const ERROR: f64 = 0.15;
/// ... and expected second-order coefficient of a sheet (per sample): radius of curvature a hundred.
const BEND: f64 = 0.005;
/// Where normals nearby spread more than this (share of the tensor of normals that is not along
/// their main direction), sheets cross.
const MIXED: f64 = 0.05;

/// Continues sheets through crossings and to the sides of the box; `candidates` are ridge points, in
/// the order of samples, of a volume smoothed over `scale` samples, those of at least `strong` sure.
pub fn repair(
    smoothed: Volume<'_>,
    candidates: Vec<Candidate>,
    scale: f64,
    strong: f32,
) -> Vec<Candidate> {
    let zone = Zone::new(smoothed.dims, &candidates, scale, strong);
    let grid = Grid::new(smoothed.dims, &candidates);
    let reliable: Vec<bool> = candidates
        .iter()
        .map(|c| !zone.holds(grid.coordinates(c)))
        .collect();
    // Where most is doubtful (foam, pores), there is nothing to continue from.
    if 2 * reliable.iter().filter(|r| **r).count() < reliable.len() {
        return candidates;
    }
    let mut fill = Fill {
        smoothed,
        zone: &zone,
        grid: &grid,
        reliable: &reliable,
        points: Vec::new(),
        fronts: Vec::new(),
        by_voxel: HashMap::new(),
    };
    for (i, c) in candidates.iter().enumerate() {
        if reliable[i] && c.strength >= strong && zone.near(grid.coordinates(c)) {
            let level = smoothed.samples[c.voxel as usize];
            fill.step_from(
                c,
                Front {
                    level,
                    normal: c.normal,
                    steps: 0,
                },
            );
        }
    }
    let mut next = 0;
    while next < fill.points.len() {
        let (point, front) = (fill.points[next], fill.fronts[next]);
        if front.steps < STEPS {
            fill.step_from(&point, front);
        }
        next += 1;
    }
    let points = fill.points;
    let beside = beside(smoothed.dims, &grid, &points);
    let keep = |i: usize| reliable[i] || !beside[candidates[i].voxel as usize];
    let mut all: Vec<Candidate> = candidates
        .iter()
        .enumerate()
        .filter(|(i, _)| keep(*i))
        .map(|(_, c)| *c)
        .collect();
    all.extend(points);
    all.sort_by_key(|c| c.voxel);
    all
}

/// Samples at most two from a new point along each axis.
fn beside(dims: [usize; 3], grid: &Grid<'_>, points: &[Candidate]) -> Vec<bool> {
    let mut beside = vec![false; dims.iter().product()];
    for point in points {
        let at = grid.coordinates(point);
        let range =
            |k: usize| (at[k] - 2).max(0) as usize..=((at[k] + 2) as usize).min(dims[k] - 1);
        for z in range(2) {
            for y in range(1) {
                let row = (z * dims[1] + y) * dims[0];
                beside[row + range(0).start()..=row + range(0).end()].fill(true);
            }
        }
    }
    beside
}

/// Where candidates are doubtful: near the sides, and in cells where normals are mixed.
struct Zone {
    dims: [i32; 3],
    margin: i32,
    cell: i32,
    cells: [i32; 3],
    mixed: Vec<bool>,
}

impl Zone {
    fn new(dims: [usize; 3], candidates: &[Candidate], scale: f64, strong: f32) -> Self {
        let cell = (2.5 * scale).ceil() as usize;
        let cells = dims.map(|n| n.div_ceil(cell));
        let count = cells.iter().product();
        let mut tensors = vec![[0.0f32; 6]; count];
        for c in candidates.iter().filter(|c| c.strength >= strong) {
            let v = c.voxel as usize;
            let (x, y, z) = (v % dims[0], v / dims[0] % dims[1], v / dims[0] / dims[1]);
            let [a, b, d] = c.normal;
            let tensor = &mut tensors[(z / cell * cells[1] + y / cell) * cells[0] + x / cell];
            for (t, p) in tensor
                .iter_mut()
                .zip([a * a, b * b, d * d, a * b, a * d, b * d])
            {
                *t += p;
            }
        }
        let mut mixed = vec![false; count];
        for i in 0..count {
            let at = [
                i % cells[0],
                i / cells[0] % cells[1],
                i / cells[0] / cells[1],
            ];
            if tensors[i][..3] == [0.0; 3] {
                continue;
            }
            let range = |k: usize| at[k].saturating_sub(1)..=(at[k] + 1).min(cells[k] - 1);
            let mut sum = [0.0f64; 6];
            for z in range(2) {
                for y in range(1) {
                    for x in range(0) {
                        let tensor = &tensors[(z * cells[1] + y) * cells[0] + x];
                        for (s, t) in sum.iter_mut().zip(tensor) {
                            *s += f64::from(*t);
                        }
                    }
                }
            }
            let trace = sum[0] + sum[1] + sum[2];
            mixed[i] = trace - eigenvalues(&sum)[2] > MIXED * trace;
        }
        Self {
            dims: dims.map(|n| n as i32),
            margin: (1.5 * scale).ceil() as i32,
            cell: cell as i32,
            cells: cells.map(|n| n as i32),
            mixed,
        }
    }

    /// Whether a sample of the box is in the zone.
    fn holds(&self, at: [i32; 3]) -> bool {
        let [x, y, z] = at.map(|i| i / self.cell);
        (0..3).any(|k| at[k] < self.margin || at[k] >= self.dims[k] - self.margin)
            || self.mixed[((z * self.cells[1] + y) * self.cells[0] + x) as usize]
    }

    fn inside(&self, at: [i32; 3]) -> bool {
        (0..3).all(|k| at[k] >= 0 && at[k] < self.dims[k])
    }

    /// Whether a sample touches the zone.
    fn near(&self, at: [i32; 3]) -> bool {
        (0..3).any(|k| {
            [-1, 1].iter().any(|s| {
                let mut next = at;
                next[k] += s;
                self.inside(next) && self.holds(next)
            })
        })
    }
}

/// Where a front left the reliable part of its sheet.
#[derive(Clone, Copy)]
struct Front {
    /// The smoothed image there.
    level: f32,
    /// The sheet's normal there.
    normal: [f32; 3],
    /// Columns passed since.
    steps: u32,
}

/// The fronts that fill the zone.
struct Fill<'a> {
    smoothed: Volume<'a>,
    zone: &'a Zone,
    grid: &'a Grid<'a>,
    reliable: &'a [bool],
    points: Vec<Candidate>,
    /// Where the front of each new point comes from.
    fronts: Vec<Front>,
    /// New points of each sample.
    by_voxel: HashMap<u32, Vec<u32>>,
}

impl Fill<'_> {
    /// Tries to continue a sheet from one point into the four columns around it.
    fn step_from(&mut self, from: &Candidate, front: Front) {
        let axis = from.axis as usize;
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        for (lateral, by) in [(a, -1.0), (a, 1.0), (b, -1.0), (b, 1.0)] {
            let mut guess = from.position;
            guess[lateral] += by;
            guess[axis] -= by * from.normal[lateral] / from.normal[axis];
            let column = guess.map(nearest);
            if !self.zone.inside(column) || !self.zone.holds(column) || self.taken(column, from) {
                continue;
            }
            let fitted = RADII
                .iter()
                .find_map(|&radius| self.fit(guess, from, radius));
            let Some(point) = fitted else { continue };
            let at = point.position.map(nearest);
            let goes_on = self.smoothed.samples[point.voxel as usize] >= SUPPORT * front.level
                && dot(point.normal, front.normal).abs() >= SAME_NORMAL;
            if goes_on && self.zone.holds(at) && !self.taken(at, from) {
                self.by_voxel
                    .entry(point.voxel)
                    .or_default()
                    .push(self.points.len() as u32);
                self.points.push(point);
                self.fronts.push(Front {
                    steps: front.steps + 1,
                    ..front
                });
            }
        }
    }

    /// Whether the column round `at` has a new point of the sheet of `like` already.
    fn taken(&self, at: [i32; 3], like: &Candidate) -> bool {
        let axis = like.axis as usize;
        (-1..=1).any(|j| {
            let mut v = at;
            v[axis] += j;
            self.zone.inside(v) && {
                let voxel = self.smoothed.index(v.map(|i| i as usize)) as u32;
                self.by_voxel.get(&voxel).is_some_and(|list| {
                    let same = |p: &Candidate| {
                        p.axis == like.axis && dot(p.normal, like.normal).abs() > SAME_FIT
                    };
                    list.len() >= MOST || list.iter().any(|&i| same(&self.points[i as usize]))
                })
            }
        })
    }

    /// The point of the sheet of `like` in the column round `guess`.
    fn fit(&self, guess: [f32; 3], like: &Candidate, radius: i32) -> Option<Candidate> {
        let axis = like.axis as usize;
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        let n = like.normal;
        let mut normal_matrix = [[0.0f64; 7]; 6];
        let mut count = 0;
        let centre = guess.map(nearest);
        // Smoothing ties neighbours together: columns a few samples apart carry all there is to know.
        let stride = if radius > RADII[0] { 3 } else { 2 };
        for v in (-radius..=radius).step_by(stride) {
            for u in (-radius..=radius).step_by(stride) {
                if u * u + v * v > radius * radius {
                    continue;
                }
                let slope = -(n[a] * u as f32 + n[b] * v as f32) / n[axis];
                let slack = 1 + (u.abs().max(v.abs())) / 6;
                for j in -slack..=slack {
                    let mut at = centre;
                    at[a] += u;
                    at[b] += v;
                    at[axis] = nearest(guess[axis] + slope) + j;
                    self.grid.each(at, |i| {
                        let q = &self.grid.candidates[i];
                        let away: [f32; 3] = std::array::from_fn(|k| q.position[k] - guess[k]);
                        let distance = dot(away, away).sqrt();
                        if self.reliable[i]
                            && dot(q.normal, n).abs() >= SAME_NORMAL
                            && dot(away, n).abs() <= 0.75 + 0.12 * distance
                        {
                            count += 1;
                            add(&mut normal_matrix, away[a], away[b], away[axis], radius);
                        }
                    });
                }
            }
        }
        if count < FEWEST {
            return None;
        }
        let c = solve(normal_matrix)?;
        let height = c[0] as f32;
        let mut position = guess;
        position[axis] += height;
        let mut normal = [0.0f32; 3];
        normal[axis] = 1.0;
        normal[a] = -c[1] as f32;
        normal[b] = -c[2] as f32;
        let length = dot(normal, normal).sqrt();
        let normal = normal.map(|c| c / length);
        let at = position.map(nearest);
        let agrees = height.abs() < 1.0 && dot(normal, n).abs() >= SAME_NORMAL;
        let voxel = self.smoothed.index(at.map(|i| i.max(0) as usize)) as u32;
        (agrees && self.zone.inside(at)).then_some(Candidate {
            voxel,
            axis: like.axis,
            position,
            normal,
            strength: like.strength,
        })
    }
}

/// The nearest sample, for positions in or near the box (without a call to the maths library).
pub fn nearest(position: f32) -> i32 {
    (position + 1024.5) as i32 - 1024
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Adds a point at (u, v) with height h to the normal equations (last column: right-hand side).
fn add(m: &mut [[f64; 7]; 6], u: f32, v: f32, h: f32, radius: i32) {
    let (u, v, h) = (f64::from(u), f64::from(v), f64::from(h));
    let half = f64::from(radius) / 2.0;
    let weight = (-0.5 * (u * u + v * v) / (half * half)).exp() / (ERROR * ERROR);
    let row = [1.0, u, v, u * u, u * v, v * v, h];
    for i in 0..6 {
        for j in i..7 {
            m[i][j] += weight * row[i] * row[j];
        }
    }
}

/// Solves the normal equations (upper half given) with the prior on bending, by Cholesky.
fn solve(mut m: [[f64; 7]; 6]) -> Option<[f64; 6]> {
    for i in 3..6 {
        m[i][i] += 1.0 / (BEND * BEND);
    }
    for i in 0..6 {
        for k in 0..i {
            let f = m[k][i] / m[k][k];
            for j in i..7 {
                m[i][j] -= f * m[k][j];
            }
        }
        if m[i][i] <= 1e-9 {
            return None;
        }
    }
    let mut c = [0.0; 6];
    for i in (0..6).rev() {
        let sum: f64 = (i + 1..6).map(|j| m[i][j] * c[j]).sum();
        c[i] = (m[i][6] - sum) / m[i][i];
    }
    Some(c)
}

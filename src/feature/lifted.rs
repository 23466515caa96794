//! Ridges where sheets cross, branch or run close: orientation as a coordinate of its own.
//!
//! Seen through an isotropic Gaussian, two sheets that meet at a shallow angle or run a few samples
//! apart are one ridge. A filter that is long along a sheet and narrow across it tells them apart.
//! Two sheets through one place share the line in which they meet, so that only the angle about this
//! line has to be sought: the image is smoothed along the line, and in the plane square to it filters
//! at [`ANGLES`] angles give the second derivative across, C, and the first, D. *Every* maximum of C
//! over the angle is a point of a sheet, D / C samples off: one sample may hold several (orientation
//! scores: Janssen and others 2018; surface voting: Wu & Fomel 2018).
//!
//! This is done only where it matters: see [`Ambiguous`]. Elsewhere ridges are as
//! [`ridges`](mod@super::ridges) finds them, at a tenth of the cost.

use super::by_sample::BySample;
use super::crossing::{Candidate, OVERLAP, dominant_axes};
use super::gaussian;
use super::quadric::Quadric;
use super::symmetric::{Symmetric, eigenvalues, eigenvector};
use super::volume::Volume;
use crate::geometry::groups::grouped;
use crate::geometry::wide::wide;
use crate::geometry::{cross, dot, in_space, sub, unit};
use crate::observer::Patience;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Angles at which filters look, over half a turn.
pub const ANGLES: usize = 24;
/// Standard deviations (samples) of the filters along a sheet, across it, and along the line that the
/// sheets share.
#[derive(Debug, Clone, Copy)]
struct Shape {
    /// Along a sheet, square to the line.
    along: f64,
    /// In all directions, beforehand; interpolation adds 0.65 to what comes of it across a sheet.
    blur: f64,
    /// Along the line.
    line: f64,
}

/// The filters where sheets cross ...
const CROSSING: Shape = Shape {
    along: 8.0,
    blur: 0.8,
    line: 3.0,
};
/// ... and where two of them look like one that is too wide.
const CLOSE: Shape = Shape {
    along: 8.0,
    blur: 0.0,
    line: 6.0,
};

/// Directions that normals gather round in a block, at most ...
const MODES: usize = 4;
/// ... judged by so many normals ...
const NORMALS: usize = 300;
/// ... within this (cosine: 18 degrees) ...
const SAME_MODE: f64 = 0.95;
/// ... with at least this share of all.
const LEAST_MODE: f64 = 0.04;
/// Sheets are sought up to this many angles (15 degrees) from the direction that normals have where
/// there is one, and (30 degrees) where there are more or ridges are wide ...
const TURNS: [i32; 2] = [2, 4];
/// ... if these are no farther off the plane square to the line (cosine: 37 degrees).
const SQUARE: f64 = 0.8;
/// Lines nearer than this (cosine: 15 degrees) are one.
const SAME_LINE: f64 = 0.966;
/// Points of one column with normals nearer than this (cosine: 10 degrees) are of one sheet.
const SAME_SHEET: f32 = 0.985;

/// Filters are cut at this many standard deviations.
const CUT: f64 = 2.0;
/// Step (samples) of the places along a sheet at which the image is read.
const STEP: f64 = 2.5;
/// Samples along an edge of a block with one line and one set of filters.
const BLOCK: usize = 16;
/// Samples along an edge of the cells that are ambiguous or not.
const CELL: usize = 4;
/// Cells on either side over which the ambiguous zone is widened.
const WIDEN: usize = 2;
/// Normals of a cell and those around it are mixed where this share of their tensor is not along
/// their main direction: sheets that cross at 15 degrees have 0.017.
const MIXED: f64 = 0.013;
/// Ridges are too wide to be one where their squared width is this many times that of the narrow ones (of which there are a
/// quarter: where many run in pairs, half of all may be too wide).
const WIDE: f64 = 1.5;
/// A mean is one of what is inside the image if at least this share is.
const LEAST_INSIDE: f32 = 0.1;
/// Nearer to a side of the box than this (samples) normals say nothing.
const SIDE: usize = 4;
/// A point's offset along the normal at most, in samples: further off it is another sample's.
const OFFSET: f64 = 0.95;
/// Squared width (samples) of a filtered ridge, for the bend of its profile.
const PROFILE: f64 = 3.0;
/// Squared width (samples) of a typical ridge, for the height that a curvature stands for.
const RIDGE: f64 = 2.25;
/// Points within this many samples along each axis smooth one another.
const ROUND: i32 = 4;
/// Mean square (samples) of the places along a sheet that a filter sees, for both directions alike.
const SEEN: f64 = 28.0;
/// Points are stronger than this share of the strong ones, of which there are [`STRONG`].
const SHARE: f64 = 0.46;
/// Where sheets are followed down to less than that, still stronger than this share.
const LEAST_SHARE: f32 = 0.15;
/// Share of all points that are at least as strong as a strong one.
const STRONG: f64 = 0.03;
/// Points are sought where the image is at least this share as high as on typical ridges.
const FLOOR: f64 = 0.25;

/// Where one orientation a sample may not be all there is: normals are mixed, or a ridge is wider than
/// ridges are.
pub struct Ambiguous<const D: usize> {
    /// Number of cells along each axis.
    cells: [usize; D],
    /// Of each cell, why it is ambiguous: [`MIXED_NORMALS`], [`WIDE_RIDGES`].
    flags: Vec<u8>,
    /// Sum over the candidates of each cell of the tensors of their normals.
    tensors: Vec<Symmetric<D>>,
}

/// Normals of different sheets meet.
const MIXED_NORMALS: u8 = 1;
/// Ridges are wider than one is.
const WIDE_RIDGES: u8 = 2;

impl<const D: usize> Ambiguous<D> {
    /// Judges ridge points of at least `strong` in a smoothed image.
    pub fn new(smoothed: Volume<'_, D>, candidates: &[Candidate<D>], strong: f32) -> Self {
        let dims = smoothed.dims;
        let cells = dims.map(|n| n.div_ceil(CELL));
        let count = cells.iter().product();
        let mut zone = Self {
            cells,
            flags: vec![0; count],
            tensors: vec![[[0.0; D]; D]; count],
        };
        // Height over curvature of a ridge is its squared width.
        let mut widths = vec![[0.0f64; 2]; count];
        for c in candidates.iter().filter(|c| c.strength >= strong) {
            let at = smoothed.coordinates(c.voxel as usize);
            // At the sides mirrored samples turn normals.
            if (0..D).any(|k| at[k] < SIDE || at[k] + SIDE >= dims[k]) {
                continue;
            }
            let cell = zone.cell_of(at);
            let height = f64::from(smoothed.samples[c.voxel as usize]);
            widths[cell][0] += height;
            widths[cell][1] += f64::from(c.strength);
            for k in 0..D {
                for l in 0..D {
                    zone.tensors[cell][k][l] += f64::from(c.normal[k] * c.normal[l]);
                }
            }
        }
        let ratio = |w: &[f64; 2]| w[0] / w[1];
        let mut ratios: Vec<f64> = widths.iter().filter(|w| w[1] > 0.0).map(ratio).collect();
        if ratios.is_empty() {
            return zone;
        }
        let middle = ratios.len() / 4;
        let usual = *ratios.select_nth_unstable_by(middle, f64::total_cmp).1;
        let wide_around = |i: usize| {
            let mut sum = [0.0; 2];
            for j in zone.cells_around(i, 1) {
                sum = [0, 1].map(|k: usize| sum[k] + widths[j][k]);
            }
            sum
        };
        let spread: Vec<f64> = (0..count)
            .into_par_iter()
            .map(|i| {
                if trace(&zone.tensors[i]) == 0.0 {
                    return 0.0;
                }
                let around = zone.around(i, 1);
                1.0 - eigenvalues(&around)[D - 1] / trace(&around)
            })
            .collect();
        let flags: Vec<u8> = (0..count)
            .into_par_iter()
            .map(|i| {
                if trace(&zone.tensors[i]) == 0.0 {
                    return 0;
                }
                let mixed = spread[i] > MIXED;
                let wide = usual > 0.0 && ratio(&wide_around(i)) > WIDE * usual;
                u8::from(mixed) * MIXED_NORMALS + u8::from(wide) * WIDE_RIDGES
            })
            .collect();
        for (i, flag) in flags.into_iter().enumerate().filter(|f| f.1 != 0) {
            let around: Vec<usize> = zone.cells_around(i, WIDEN).collect();
            for j in around {
                zone.flags[j] |= flag;
            }
        }
        zone
    }

    /// Share of the image that is ambiguous.
    pub fn share(&self) -> f64 {
        let flagged = self.flags.iter().filter(|&&f| f != 0).count();
        flagged as f64 / self.flags.len().max(1) as f64
    }

    /// Whether a sample is ambiguous.
    pub fn holds(&self, at: [usize; D]) -> bool {
        self.flags[self.cell_of(at)] != 0
    }

    fn cell_of(&self, at: [usize; D]) -> usize {
        (0..D)
            .rev()
            .fold(0, |i, k| i * self.cells[k] + at[k] / CELL)
    }

    /// The cells at most `reach` away along each axis.
    fn cells_around(&self, cell: usize, reach: usize) -> impl Iterator<Item = usize> {
        let cells = self.cells;
        let mut rest = cell;
        let at: [usize; D] = std::array::from_fn(|k| {
            let i = rest % cells[k];
            rest /= cells[k];
            i
        });
        let side = 2 * reach + 1;
        (0..side.pow(D as u32)).filter_map(move |number| {
            let mut rest = number;
            let near: [usize; D] = std::array::from_fn(|k| {
                let i = (at[k] + rest % side).wrapping_sub(reach);
                rest /= side;
                i
            });
            (0..D)
                .all(|k| near[k] < cells[k])
                .then(|| (0..D).rev().fold(0, |i, k| i * cells[k] + near[k]))
        })
    }

    /// The tensor of normals of a cell and those around it.
    fn around(&self, cell: usize, reach: usize) -> Symmetric<D> {
        let mut sum = [[0.0; D]; D];
        for j in self.cells_around(cell, reach) {
            for k in 0..D {
                for l in 0..D {
                    sum[k][l] += self.tensors[j][k][l];
                }
            }
        }
        sum
    }
}

fn trace<const D: usize>(m: &Symmetric<D>) -> f64 {
    (0..D).map(|k| m[k][k]).sum()
}

/// What is sought in an image.
pub struct Search<'a, const D: usize> {
    /// The image as it is.
    pub image: Volume<'a, D>,
    /// The same, smoothed as ridges were sought in it.
    pub smoothed: Volume<'a, D>,
    /// Where.
    pub zone: &'a Ambiguous<D>,
    /// Ridge points, in the order of samples, from whose normals the lines are guessed.
    pub candidates: &'a [Candidate<D>],
    /// Candidates of at least this strength are sure.
    pub strong: f32,
    /// Down to this strength sheets are followed.
    pub low: f32,
    /// Strength that the strong ones are given.
    pub typical: f32,
    /// Asked at each block.
    pub patience: &'a Patience<'a>,
}

impl<const D: usize> Search<'_, D> {
    /// Ridge points of the ambiguous samples, in the order of samples.
    pub fn points(&self) -> Vec<Candidate<D>> {
        let dims = self.image.dims;
        let blocks = dims.map(|n| n.div_ceil(BLOCK));
        let mut blurred = self.image.samples.to_vec();
        gaussian::smooth(dims, &mut blurred, [CROSSING.blur; D], self.patience);
        let edges = dims.map(|n| n.div_ceil(BLOCK));
        let block_of = |c: &Candidate<D>| {
            let at = self.image.coordinates(c.voxel as usize);
            (0..D).rev().fold(0, |i, k| i * edges[k] + at[k] / BLOCK)
        };
        let count = edges.iter().product();
        let (start, order) = grouped(count, self.candidates.iter().map(block_of));
        let job = Job {
            by_block: (start, order),
            search: self,
            sources: [Volume::new(dims, &blurred), self.image],
            level: median(self.image.samples.iter().copied().step_by(7)),
            floor: self.floor(),
        };
        let found: Vec<Vec<Candidate<D>>> = (0..blocks.iter().product::<usize>())
            .into_par_iter()
            .map_init(Scratch::default, |scratch, block| {
                if self.patience.over() {
                    return Vec::new();
                }
                let mut rest = block;
                let first: [usize; D] = std::array::from_fn(|k| {
                    let i = rest % blocks[k];
                    rest /= blocks[k];
                    i * BLOCK
                });
                job.of_block(first, scratch)
            })
            .collect();
        let mut found: Vec<Candidate<D>> = found.into_iter().flatten().collect();
        let mut strengths: Vec<f32> = found.iter().map(|c| c.strength).collect();
        if strengths.is_empty() {
            return found;
        }
        let rank = ((1.0 - STRONG) * strengths.len() as f64) as usize;
        let strong = *strengths.select_nth_unstable_by(rank, f32::total_cmp).1;
        let least = (SHARE as f32).min((self.low / self.typical).max(LEAST_SHARE)) * strong;
        found.retain(|c| c.strength > least);
        for c in &mut found {
            c.strength *= self.typical / strong;
        }
        found.sort_by_key(|c| c.voxel);
        self.polished(&found)
    }

    /// Points moved onto the quadratic surface through those round them, and back by what a long filter
    /// shifts a sheet that bends.
    fn polished(&self, points: &[Candidate<D>]) -> Vec<Candidate<D>> {
        let grid = BySample::new(self.image.dims, points);
        let polish = |c: &Candidate<D>| {
            let axis = c.axis as usize;
            let mut surface = Quadric::<D>::new(2 * ROUND);
            let mut count = 0;
            grid.each_around(grid.coordinates(c), ROUND, |j| {
                let other = &points[j];
                let away = sub(other.position, c.position);
                let length = dot(away, away).sqrt();
                if dot(other.normal, c.normal).abs() >= SAME_SHEET
                    && dot(away, c.normal).abs() <= 0.4 + 0.08 * length
                {
                    surface.add(away, axis);
                    count += 1;
                }
            });
            let solved = match count > 2 * Quadric::<D>::TERMS {
                true => surface.solve(),
                false => None,
            };
            let Some(terms) = solved else { return *c };
            // What a filter sees of a bent sheet is its mean height.
            let (mut shift, mut bend) = (0.0, D);
            for k in 1..D {
                for l in k..D {
                    if k == l {
                        shift += SEEN * terms[bend];
                    }
                    bend += 1;
                }
            }
            let height = (terms[0] - shift) as f32;
            let mut normal = [0.0f32; D];
            normal[axis] = 1.0;
            for k in 1..D {
                normal[(axis + k) % D] = -terms[k] as f32;
            }
            let length = dot(normal, normal).sqrt();
            let normal = normal.map(|n| n / length);
            if height.abs() > 0.75 || dot(normal, c.normal).abs() < SAME_SHEET {
                return *c;
            }
            let mut moved = *c;
            let last = (self.image.dims[axis] - 1) as f32;
            moved.position[axis] = (c.position[axis] + height).clamp(0.0, last);
            moved.normal = normal;
            moved
        };
        points.par_iter().map(polish).collect()
    }

    /// The height of the smoothed image below which there is nothing to find.
    fn floor(&self) -> f32 {
        let all = self.smoothed.samples;
        let level = median(all.iter().copied().step_by(7));
        // The highest of each row of 64 samples: mostly ridges, if there are ridges.
        let mut tops: Vec<f32> = all
            .chunks(64)
            .map(|row| row.iter().copied().fold(f32::MIN, f32::max))
            .collect();
        let rank = tops.len() * 9 / 10;
        match tops.is_empty() {
            true => level,
            false => {
                level
                    + FLOOR as f32 * (*tops.select_nth_unstable_by(rank, f32::total_cmp).1 - level)
            }
        }
    }
}

/// Ridge points of a volume that is ambiguous here and there: those at all angles where these explain
/// the `usual` ones, which are kept elsewhere and where sheets bend too much for long filters. In the
/// order of samples; and the number of points at all angles among them.
pub fn merged<const D: usize>(
    dims: [usize; D],
    zone: &Ambiguous<D>,
    usual: &[Candidate<D>],
    lifted: &[Candidate<D>],
    strong: f32,
) -> (Vec<Candidate<D>>, usize) {
    let samples = Volume { dims, samples: &[] };
    let edges = dims.map(|n| n.div_ceil(BLOCK));
    let at = |c: &Candidate<D>| samples.coordinates(c.voxel as usize);
    let block = |c: &Candidate<D>| (0..D).rev().fold(0, |i, k| i * edges[k] + at(c)[k] / BLOCK);
    let grid = BySample::new(dims, lifted);
    // Of each block: the sure usual points, and those with a point at some angle beside them.
    let mut seen = vec![[0usize; 2]; edges.iter().product()];
    for c in usual
        .iter()
        .filter(|c| c.strength >= strong && zone.holds(at(c)))
    {
        let mut beside = false;
        grid.each_around(grid.coordinates(c), 2, |_| beside = true);
        let seen = &mut seen[block(c)];
        seen[0] += 1;
        seen[1] += usize::from(beside);
    }
    let explained: Vec<bool> = seen
        .iter()
        .map(|&[all, beside]| beside as f64 >= EXPLAINED * all as f64)
        .collect();
    let by_lifted = |c: &Candidate<D>| zone.holds(at(c)) && explained[block(c)];
    let mut all: Vec<Candidate<D>> = lifted
        .iter()
        .copied()
        .filter(|c| explained[block(c)])
        .collect();
    let count = all.len();
    all.extend(usual.iter().copied().filter(|c| !by_lifted(c)));
    all.sort_by_key(|c| c.voxel);
    (all, count)
}

/// Points at all angles are believed where they are beside this share of the usual ones in a block.
const EXPLAINED: f64 = 0.4;

fn median(samples: impl Iterator<Item = f32>) -> f32 {
    let mut some: Vec<f32> = samples.collect();
    let middle = some.len() / 2;
    match some.is_empty() {
        true => 0.0,
        false => *some.select_nth_unstable_by(middle, f32::total_cmp).1,
    }
}

/// What all blocks share.
struct Job<'a, const D: usize> {
    /// Candidates by the block that they lie in: where each block's begin, and their numbers.
    by_block: (Vec<u32>, Vec<u32>),
    search: &'a Search<'a, D>,
    /// The image for [`CROSSING`] and for [`CLOSE`].
    sources: [Volume<'a, D>; 2],
    level: f32,
    floor: f32,
}

/// What a thread needs for a block.
#[derive(Default)]
struct Scratch {
    /// Samples of the block and a margin.
    raw: Vec<f32>,
    /// 1 for those inside the image, 0 for the others; nothing if all are inside.
    inside: Vec<f32>,
    /// Both, smoothed along the line.
    line: Vec<f32>,
    line_inside: Vec<f32>,
    /// The block and a small margin, smoothed along a sheet.
    sheet: Vec<f32>,
    /// C and D of each row that matters, of each angle, of each sample of the row.
    second: Vec<f32>,
    first: Vec<f32>,
}

impl<const D: usize> Job<'_, D> {
    fn of_block(&self, first: [usize; D], scratch: &mut Scratch) -> Vec<Candidate<D>> {
        let (zone, dims) = (self.search.zone, self.search.image.dims);
        // The ambiguous cells of the block decide on the line.
        let side = BLOCK / CELL;
        let (mut tensor, mut kinds) = ([[0.0; D]; D], [false; 2]);
        for number in 0..side.pow(D as u32) {
            let mut rest = number;
            let at: [usize; D] = std::array::from_fn(|k| {
                let i = first[k] + rest % side * CELL;
                rest /= side;
                i
            });
            if (0..D).any(|k| at[k] >= dims[k]) {
                continue;
            }
            let cell = zone.cell_of(at);
            kinds[0] |= zone.flags[cell] == MIXED_NORMALS;
            kinds[1] |= zone.flags[cell] & WIDE_RIDGES != 0;
            let around = zone.around(cell, 1);
            for k in 0..D {
                for l in 0..D {
                    tensor[k][l] += around[k][l];
                }
            }
        }
        let mut found = Vec::new();
        if trace(&tensor) == 0.0 {
            return found;
        }
        let modes = self.modes(first);
        let lines = self.lines(&modes, &tensor);
        for (kind, shape) in [CROSSING, CLOSE].into_iter().enumerate() {
            let wanted = |at: [usize; D]| {
                let flags = zone.flags[zone.cell_of(at)];
                let of_kind = if flags & WIDE_RIDGES != 0 { 1 } else { 0 };
                flags != 0
                    && of_kind == kind
                    && self.search.smoothed.samples[self.search.smoothed.index(at)] >= self.floor
            };
            if kinds[kind] {
                let mask = Mask::new(dims, first, wanted);
                for line in lines.iter().filter(|_| mask.any) {
                    let filters = Filters::new(shape, frame(*line), &modes, kind == 1);
                    filters.fill(self.sources[kind], first, self.level, &mask, scratch);
                    filters.apply(&mask, scratch);
                    filters.points(dims, &mask, first, scratch, &mut found);
                }
            }
        }
        if lines.len() > 1 {
            found = once(found);
        }
        found
    }

    /// The lines in which the sheets of a block may meet: square to each two of the directions that
    /// normals have there.
    fn lines(&self, modes: &[[f64; D]], tensor: &Symmetric<D>) -> Vec<[f64; D]> {
        let usual = vec![eigenvector(tensor, eigenvalues(tensor)[0])];
        if D == 2 {
            return usual;
        }
        let mut lines: Vec<[f64; D]> = Vec::new();
        for (i, a) in modes.iter().enumerate() {
            for b in &modes[..i] {
                let line = cross(in_space(*a), in_space(*b));
                let length = dot(line, line).sqrt();
                let line = std::array::from_fn(|k| line[k] / length);
                if lines.iter().all(|l| dot(*l, line).abs() < SAME_LINE) {
                    lines.push(line);
                }
            }
        }
        match lines.is_empty() {
            true => usual,
            false => lines,
        }
    }

    /// Up to [`MODES`] directions round which the normals of candidates in and beside a block gather.
    fn modes(&self, first: [usize; D]) -> Vec<[f64; D]> {
        let dims = self.search.image.dims;
        let edges = dims.map(|n| n.div_ceil(BLOCK));
        let reach = BLOCK / 2;
        let mut normals: Vec<([f64; D], f64)> = Vec::new();
        for number in 0..3usize.pow(D as u32) {
            let mut rest = number;
            let near: [usize; D] = std::array::from_fn(|k| {
                let i = (first[k] / BLOCK + rest % 3).wrapping_sub(1);
                rest /= 3;
                i
            });
            if (0..D).any(|k| near[k] >= edges[k]) {
                continue;
            }
            let block = (0..D).rev().fold(0, |i, k| i * edges[k] + near[k]);
            let (start, order) = &self.by_block;
            for &i in &order[start[block] as usize..start[block + 1] as usize] {
                let c = &self.search.candidates[i as usize];
                let at = self.search.image.coordinates(c.voxel as usize);
                let close =
                    (0..D).all(|k| at[k] + reach >= first[k] && at[k] < first[k] + BLOCK + reach);
                if close && c.strength >= self.search.strong {
                    normals.push((c.normal.map(f64::from), f64::from(c.strength)));
                }
            }
        }
        let every = normals.len() / NORMALS + 1;
        let mut normals: Vec<([f64; D], f64)> = normals.into_iter().step_by(every).collect();
        let all: f64 = normals.iter().map(|n| n.1).sum();
        let mut modes = Vec::new();
        while modes.len() < MODES {
            let Some((start, _)) = normals.iter().max_by(|a, b| a.1.total_cmp(&b.1)).copied()
            else {
                break;
            };
            // The best of some starts, moved to the mean of what is round it.
            let support = |about: [f64; D]| -> ([f64; D], f64) {
                let (mut sum, mut weight) = ([0.0; D], 0.0);
                for (n, w) in &normals {
                    let c = dot(*n, about);
                    if c.abs() > SAME_MODE {
                        weight += w;
                        for k in 0..D {
                            sum[k] += w * c.signum() * n[k];
                        }
                    }
                }
                (unit(sum), weight)
            };
            let some = normals.iter().step_by(normals.len() / 16 + 1).map(|n| n.0);
            let best = some
                .chain([start])
                .map(support)
                .max_by(|a, b| a.1.total_cmp(&b.1));
            let Some((mode, _)) = best else { break };
            let (mode, weight) = support(mode);
            if weight < LEAST_MODE * all {
                break;
            }
            modes.push(mode);
            normals.retain(|(n, _)| dot(*n, mode).abs() <= SAME_MODE);
        }
        modes
    }
}

/// Which samples of a block matter.
struct Mask {
    samples: Vec<bool>,
    /// Of each row of x.
    rows: Vec<bool>,
    /// Of each row of x in the block and its small margin.
    around: Vec<bool>,
    any: bool,
}

impl Mask {
    fn new<const D: usize>(
        dims: [usize; D],
        first: [usize; D],
        wanted: impl Fn([usize; D]) -> bool,
    ) -> Self {
        let rows = BLOCK.pow(D as u32 - 1);
        let wide = BLOCK + 2 * NEAR;
        let mut mask = Self {
            samples: vec![false; rows * BLOCK],
            rows: vec![false; rows],
            around: vec![false; wide.pow(D as u32 - 1)],
            any: false,
        };
        for i in 0..rows * BLOCK {
            let at = in_block(i, first);
            if (0..D).all(|k| at[k] < dims[k]) && wanted(at) {
                mask.samples[i] = true;
                mask.rows[i / BLOCK] = true;
                mask.any = true;
            }
        }
        for row in (0..rows).filter(|&r| mask.rows[r]) {
            let side = 2 * NEAR + 1;
            for number in 0..side.pow(D as u32 - 1) {
                let (mut rest, mut near, mut to, mut stride) = (row, number, 0, 1);
                for _ in 1..D {
                    to += (rest % BLOCK + near % side) * stride;
                    rest /= BLOCK;
                    near /= side;
                    stride *= wide;
                }
                mask.around[to] = true;
            }
        }
        mask
    }
}

/// The sample of the image that is number `i` of a block.
fn in_block<const D: usize>(i: usize, first: [usize; D]) -> [usize; D] {
    let mut rest = i;
    std::array::from_fn(|k| {
        let j = first[k] + rest % BLOCK;
        rest /= BLOCK;
        j
    })
}

/// Of points that different lines gave for one sheet in one column, the strongest.
fn once<const D: usize>(mut found: Vec<Candidate<D>>) -> Vec<Candidate<D>> {
    found.sort_by(|a, b| {
        (a.voxel, a.axis)
            .cmp(&(b.voxel, b.axis))
            .then(b.strength.total_cmp(&a.strength))
    });
    let mut kept: Vec<Candidate<D>> = Vec::with_capacity(found.len());
    for c in found {
        let same = |k: &&Candidate<D>| (k.voxel, k.axis) == (c.voxel, c.axis);
        let known = kept
            .iter()
            .rev()
            .take_while(same)
            .any(|k| dot(k.normal, c.normal).abs() > SAME_SHEET);
        if !known {
            kept.push(c);
        }
    }
    kept
}

/// The line in which sheets meet (in 2-D none), and two directions square to it.
fn frame<const D: usize>(line: [f64; D]) -> [[f64; D]; 3] {
    let mut frame = [[0.0; D]; 3];
    if D == 2 {
        frame[1][0] = 1.0;
        frame[2][1] = 1.0;
        return frame;
    }
    let line = in_space(line);
    let least = (0..3).fold(0, |best, k| {
        if line[k].abs() < line[best].abs() {
            k
        } else {
            best
        }
    });
    let mut other = [0.0; 3];
    other[least] = 1.0;
    let a = cross(line, other);
    let length = dot(a, a).sqrt();
    let a = a.map(|c| c / length);
    let b = cross(line, a);
    for k in 0..D {
        (frame[0][k], frame[1][k], frame[2][k]) = (line[k], a[k], b[k]);
    }
    frame
}

/// Samples round a block that the derivatives across a sheet reach ...
const NEAR: usize = 2;
/// ... and in x, which makes rows of a width that vector registers like.
const NEAR_X: usize = 4;
/// Samples of x smoothed at once along the line.
const LANES: usize = 32;
/// Samples of x of a block and its small margin.
const WIDTH: usize = BLOCK + 2 * NEAR_X;

/// Weights of the samples round one, by how far they are in a buffer.
type Taps = Vec<(isize, f32)>;

/// The filters of a block.
struct Filters<const D: usize> {
    shape: Shape,
    frame: [[f64; D]; 3],
    /// Samples round a block that filters reach.
    margin: usize,
    /// Edge of the buffer.
    edge: usize,
    /// The angles at which sheets are looked for: those near normals that there are.
    angles: [bool; ANGLES],
}

impl<const D: usize> Filters<D> {
    fn new(shape: Shape, frame: [[f64; D]; 3], modes: &[[f64; D]], wide: bool) -> Self {
        let line = if D == 3 { shape.line } else { 0.0 };
        let reach = (CUT * shape.along.hypot(line)).ceil() as usize + NEAR_X + 1;
        let edge = (BLOCK + 2 * reach).next_multiple_of(LANES);
        let margin = (edge - BLOCK) / 2;
        let mut filters = Self {
            shape,
            frame,
            margin,
            edge,
            angles: [modes.is_empty(); ANGLES],
        };
        let turns = TURNS[usize::from(wide || modes.len() > 1)];
        for mode in modes {
            let [a, b] = [1, 2].map(|k: usize| dot(frame[k], *mode));
            if a.hypot(b) > SQUARE {
                // The direction across turns with the angle: (-sin, cos).
                let bin = (-a).atan2(b) / PI * ANGLES as f64;
                for turn in -turns..=turns {
                    let near = (bin.round() as i32 + turn).rem_euclid(ANGLES as i32);
                    filters.angles[near as usize] = true;
                }
            }
        }
        filters
    }

    /// Directions along and across a sheet at an angle (in steps of half a turn over [`ANGLES`]).
    fn directions(&self, angle: f64) -> ([f64; D], [f64; D]) {
        let (sin, cos) = (PI * angle / ANGLES as f64).sin_cos();
        let [_, a, b] = &self.frame;
        (
            std::array::from_fn(|k| cos * a[k] + sin * b[k]),
            std::array::from_fn(|k| cos * b[k] - sin * a[k]),
        )
    }

    /// A Gaussian of a width along a direction, read at every `step`, in a buffer of `strides`.
    fn bell(direction: [f64; D], width: f64, step: f64, strides: [usize; D]) -> Taps {
        let half = (CUT * width / step).round() as i32;
        let places: Vec<([f64; D], f64)> = (-half..=half)
            .map(|j| {
                let at = step * f64::from(j);
                (
                    direction.map(|c| c * at),
                    (-0.5 * (at / width).powi(2)).exp(),
                )
            })
            .collect();
        let sum: f64 = places.iter().map(|p| p.1).sum();
        taps(places.into_iter().map(|(at, w)| (at, w / sum)), strides)
    }

    /// Copies the block and its margin, zero outside of the image, and smooths them along the line.
    /// (A block whose margin is inside the image is read where it is.)
    fn fill(
        &self,
        image: Volume<'_, D>,
        first: [usize; D],
        level: f32,
        mask: &Mask,
        scratch: &mut Scratch,
    ) {
        let (edge, margin) = (self.edge, self.margin as isize);
        // Sums at the rows' ends read a little beyond the buffer; they are not used.
        let beyond = (CUT * self.shape.line).ceil() as isize + 1;
        let inside = (0..D).all(|k| {
            let (low, high) = (
                first[k] as isize - margin,
                (first[k] + BLOCK) as isize + margin,
            );
            low - beyond >= 0 && high + beyond <= image.dims[k] as isize
        });
        let strides = match inside {
            true => image.strides(),
            false => std::array::from_fn(|k| edge.pow(k as u32)),
        };
        let line = match D {
            3 => Self::bell(
                self.frame[0],
                self.shape.line,
                0.5 * self.shape.line,
                strides,
            ),
            _ => vec![(0, 1.0)],
        };
        let rows = edge.pow(D as u32 - 1);
        let pad = line.iter().map(|t| t.0.unsigned_abs()).max().unwrap_or(0) + LANES;
        let copied = if inside { 0 } else { rows };
        for buffer in [&mut scratch.raw, &mut scratch.inside] {
            buffer.clear();
            buffer.resize(edge * copied + 2 * pad, 0.0);
        }
        for row in 0..copied {
            let mut rest = row;
            let mut at = [0isize; D];
            for k in 1..D {
                at[k] = first[k] as isize + (rest % edge) as isize - margin;
                rest /= edge;
            }
            if (1..D).any(|k| at[k] < 0 || at[k] >= image.dims[k] as isize) {
                continue;
            }
            let start = (1..D)
                .rev()
                .fold(0, |i, k| (i + at[k] as usize) * image.dims[k - 1]);
            let from = first[0] as isize - margin;
            let low = from.max(0);
            let high = (from + edge as isize).min(image.dims[0] as isize);
            if low >= high {
                continue;
            }
            let to = pad + row * edge + (low - from) as usize;
            let source = &image.samples[start + low as usize..start + high as usize];
            for (out, s) in scratch.raw[to..].iter_mut().zip(source) {
                *out = s - level;
            }
            scratch.inside[to..to + source.len()].fill(1.0);
        }
        // Rows that are not needed hold anything.
        scratch.line.resize(edge * rows, 0.0);
        scratch
            .line_inside
            .resize(if inside { 0 } else { edge * rows }, 0.0);
        let needed = self.needed(mask);
        let (raw, out) = (&scratch.raw, &mut scratch.line);
        let (raw_inside, out_inside) = (&scratch.inside, &mut scratch.line_inside);
        let origin = image.index(first) as isize - strides.iter().sum::<usize>() as isize * margin;
        wide(
            #[inline(always)]
            || {
                for (row, _) in needed.iter().enumerate().filter(|r| *r.1) {
                    // The edge is a multiple of the lanes.
                    let (mut rest, mut from) = (row, origin);
                    for k in 1..D {
                        from += (rest % edge * strides[k]) as isize;
                        rest /= edge;
                    }
                    for part in 0..edge / LANES {
                        let at = row * edge + part * LANES;
                        let sum = match inside {
                            true => {
                                let from = from + (part * LANES) as isize;
                                summed::<LANES>(image.samples, from, &line).map(|s| s - level)
                            }
                            false => {
                                let part = summed::<LANES>(raw_inside, (pad + at) as isize, &line);
                                out_inside[at..at + LANES].copy_from_slice(&part);
                                summed::<LANES>(raw, (pad + at) as isize, &line)
                            }
                        };
                        out[at..at + LANES].copy_from_slice(&sum);
                    }
                }
            },
        );
    }

    /// The rows of the buffer that smoothing along sheets reads.
    fn needed(&self, mask: &Mask) -> Vec<bool> {
        let wide_edge = BLOCK + 2 * NEAR;
        let mut strides = [0; D];
        for k in 1..D {
            strides[k] = self.edge.pow(k as u32 - 1);
        }
        let mut needed = vec![false; self.edge.pow(D as u32 - 1)];
        let mut offsets = Vec::new();
        for angle in (0..ANGLES).filter(|&a| self.angles[a]) {
            let (along, _) = self.directions(angle as f64);
            let rows = Self::bell(along, self.shape.along, STEP, strides);
            offsets.extend(rows.into_iter().map(|tap| tap.0));
        }
        offsets.sort_unstable();
        offsets.dedup();
        for (row, _) in mask.around.iter().enumerate().filter(|r| *r.1) {
            let (mut rest, mut at) = (row, 0isize);
            for k in 1..D {
                at += ((self.margin - NEAR + rest % wide_edge) * strides[k]) as isize;
                rest /= wide_edge;
            }
            for offset in &offsets {
                needed[(at + offset) as usize] = true;
            }
        }
        needed
    }

    /// C and D of every sample of the block at every angle.
    fn apply(&self, mask: &Mask, scratch: &mut Scratch) {
        let rows = mask.rows.iter().filter(|r| **r).count();
        let wide_edge = BLOCK + 2 * NEAR;
        let big = std::array::from_fn(|k| self.edge.pow(k as u32));
        let small: [usize; D] = std::array::from_fn(|k| match k {
            0 => 1,
            _ => WIDTH * wide_edge.pow(k as u32 - 1),
        });
        for buffer in [&mut scratch.second, &mut scratch.first] {
            buffer.clear();
            buffer.resize(rows * ANGLES * BLOCK, 0.0);
        }
        scratch.sheet.resize(mask.around.len() * WIDTH, 0.0);
        for angle in (0..ANGLES).filter(|&a| self.angles[a]) {
            let (along, across) = self.directions(angle as f64);
            let bell = Self::bell(along, self.shape.along, STEP, big);
            let minus = across.map(|c| -c);
            let third = |w: [f64; 3]| {
                taps(
                    [([0.0; D], w[0]), (minus, w[1]), (across, w[2])].into_iter(),
                    small,
                )
            };
            // Curvature upside down, and slope.
            let (second, first) = (third([2.0, -1.0, -1.0]), third([0.0, -0.5, 0.5]));
            let Scratch {
                line,
                line_inside,
                sheet,
                second: seconds,
                first: firsts,
                ..
            } = scratch;
            wide(
                #[inline(always)]
                || {
                    for (row, _) in mask.around.iter().enumerate().filter(|r| *r.1) {
                        let (mut rest, mut at) = (row, self.margin - NEAR_X);
                        for k in 1..D {
                            at += (self.margin - NEAR + rest % wide_edge) * big[k];
                            rest /= wide_edge;
                        }
                        let mut sum = summed::<WIDTH>(line, at as isize, &bell);
                        // Where the image ends, the mean of what is inside.
                        if !line_inside.is_empty() {
                            let part = summed::<WIDTH>(line_inside, at as isize, &bell);
                            for l in 0..WIDTH {
                                sum[l] = if part[l] > LEAST_INSIDE {
                                    sum[l] / part[l]
                                } else {
                                    0.0
                                };
                            }
                        }
                        sheet[row * WIDTH..(row + 1) * WIDTH].copy_from_slice(&sum);
                    }
                    let rows = mask.rows.iter().enumerate().filter(|r| *r.1);
                    for (number, (row, _)) in rows.enumerate() {
                        let (mut rest, mut at) = (row, NEAR_X);
                        for k in 1..D {
                            at += (NEAR + rest % BLOCK) * small[k];
                            rest /= BLOCK;
                        }
                        let to = (number * ANGLES + angle) * BLOCK;
                        let c = summed::<BLOCK>(sheet, at as isize, &second);
                        let d = summed::<BLOCK>(sheet, at as isize, &first);
                        seconds[to..to + BLOCK].copy_from_slice(&c);
                        firsts[to..to + BLOCK].copy_from_slice(&d);
                    }
                },
            );
        }
    }

    /// Points of sheets: maxima of C over the angle.
    fn points(
        &self,
        dims: [usize; D],
        mask: &Mask,
        first: [usize; D],
        scratch: &Scratch,
        found: &mut Vec<Candidate<D>>,
    ) {
        // The height of a ridge of typical width that curves so.
        let across = self.shape.blur.powi(2) + 0.5;
        let scale = (across + RIDGE).powf(1.5) / RIDGE.sqrt();
        let (mut row, mut number) = (usize::MAX, usize::MAX);
        for (i, _) in mask.samples.iter().enumerate().filter(|s| *s.1) {
            if i / BLOCK != row {
                (row, number) = (i / BLOCK, number.wrapping_add(1));
            }
            let at = in_block(i, first);
            let place = |angle: usize| (number * ANGLES + angle % ANGLES) * BLOCK + i % BLOCK;
            let c = |angle: usize| f64::from(scratch.second[place(angle)]);
            // Half a turn on, the direction across is the opposite one.
            let d = |angle: usize| {
                let sign = if angle / ANGLES % 2 == 1 { 1.0 } else { -1.0 };
                sign * f64::from(scratch.first[place(angle)])
            };
            for angle in ANGLES..2 * ANGLES {
                let (before, here, after) = (c(angle - 1), c(angle), c(angle + 1));
                // Zero: not looked at; a maximum at the end of what was looked at is none.
                if !(here > 0.0 && here >= before && here > after && before != 0.0 && after != 0.0)
                {
                    continue;
                }
                let bend = before + after - 2.0 * here;
                let turn = (0.5 * (before - after) / bend.min(-1e-12)).clamp(-0.5, 0.5);
                let curvature = here - 0.25 * (before - after) * turn;
                let next = if turn < 0.0 {
                    d(angle - 1)
                } else {
                    d(angle + 1)
                };
                let slope = d(angle) + turn.abs() * (next - d(angle));
                let (_, normal) = self.directions((angle - ANGLES) as f64 + turn);
                let linear = slope / curvature;
                if linear.abs() > OFFSET {
                    continue;
                }
                let off = linear / (1.0 + linear * linear / PROFILE);
                let strength = (scale * curvature) as f32;
                for axis in dominant_axes(normal) {
                    let offset = off / normal[axis];
                    if offset.abs() <= 0.5 + f64::from(OVERLAP) {
                        found.push(Candidate::new(
                            dims,
                            at,
                            axis,
                            offset as f32,
                            normal,
                            strength,
                        ));
                    }
                }
            }
        }
    }
}

/// Weights of samples, from weights of places between them by multilinear interpolation.
fn taps<const D: usize>(
    places: impl Iterator<Item = ([f64; D], f64)>,
    strides: [usize; D],
) -> Taps {
    let mut taps: BTreeMap<isize, f64> = BTreeMap::new();
    for (at, weight) in places {
        let low = at.map(f64::floor);
        for corner in 0..1usize << D {
            let (mut share, mut offset) = (weight, 0isize);
            for k in 0..D {
                let above = corner >> k & 1 == 1;
                let fraction = at[k] - low[k];
                share *= if above { fraction } else { 1.0 - fraction };
                offset += (low[k] as isize + isize::from(above)) * strides[k] as isize;
            }
            if share.abs() > 1e-6 {
                *taps.entry(offset).or_default() += share;
            }
        }
    }
    taps.into_iter()
        .map(|(offset, weight)| (offset, weight as f32))
        .collect()
}

/// Weighted sums of neighbours, for `N` samples in a row: as many at once as stay in registers.
#[inline(always)]
fn summed<const N: usize>(samples: &[f32], at: isize, taps: &Taps) -> [f32; N] {
    let mut sum = [0.0f32; N];
    for &(offset, weight) in taps {
        let start = (at + offset) as usize;
        let from = &samples[start..start + N];
        for l in 0..N {
            sum[l] += weight * from[l];
        }
    }
    sum
}

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

use super::crossing::{Candidate, OVERLAP, dominant_axes};
use super::gaussian;
use super::symmetric::{Matrix, eigenvalues, eigenvector};
use super::volume::Volume;
use crate::geometry::wide::wide;
use crate::geometry::{cross, dot, in_space};
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
const CROSSING: Shape = Shape { along: 8.0, blur: 0.8, line: 3.0 };
/// ... and where two of them look like one that is too wide.
const CLOSE: Shape = Shape { along: 8.0, blur: 0.0, line: 6.0 };

/// Filters are cut at this many standard deviations.
const CUT: f64 = 2.0;
/// Step (samples) of the places along a sheet at which the image is read.
const STEP: f64 = 2.0;
/// Samples along an edge of a block with one line and one set of filters.
const BLOCK: usize = 16;
/// Samples along an edge of the cells that are ambiguous or not.
const CELL: usize = 4;
/// Cells on either side over which the ambiguous zone is widened.
const WIDEN: usize = 2;
/// Normals of a cell and those around it are mixed where this share of their tensor is not along
/// their main direction: sheets that cross at 15 degrees have 0.017.
const MIXED: f64 = 0.013;
/// Ridges are too wide to be one where their squared width is this many times the median.
const WIDE: f64 = 1.5;
/// A point's offset along the normal at most, in samples: further off it is another sample's.
const OFFSET: f64 = 0.95;
/// Squared width (samples) of a filtered ridge, for the bend of its profile.
const PROFILE: f64 = 3.0;
/// Squared width (samples) of a typical ridge, for the height that a curvature stands for.
const RIDGE: f64 = 2.25;
/// Points are sought where the image is at least this share as high as on typical ridges.
const FLOOR: f64 = 0.25;

/// Where one orientation a sample may not be all there is: normals are mixed, or a ridge is wider than
/// ridges are.
pub struct Ambiguous<const D: usize> {
    dims: [usize; D],
    /// Number of cells along each axis.
    cells: [usize; D],
    /// Of each cell, why it is ambiguous: [`MIXED_NORMALS`], [`WIDE_RIDGES`].
    flags: Vec<u8>,
    /// Sum over the candidates of each cell of the tensors of their normals.
    tensors: Vec<Matrix<D>>,
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
        let mut zone = Self { dims, cells, flags: vec![0; count], tensors: vec![[[0.0; D]; D]; count] };
        // Height over curvature of a ridge is its squared width.
        let mut widths = vec![[0.0f64; 2]; count];
        for c in candidates.iter().filter(|c| c.strength >= strong) {
            let cell = zone.cell_of(smoothed.coordinates(c.voxel as usize));
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
        let middle = ratios.len() / 2;
        let median = *ratios.select_nth_unstable_by(middle, f64::total_cmp).1;
        let flags: Vec<u8> = (0..count)
            .into_par_iter()
            .map(|i| {
                if trace(&zone.tensors[i]) == 0.0 {
                    return 0;
                }
                let around = zone.around(i, 1);
                let total = trace(&around);
                let mixed = total - eigenvalues(&around)[D - 1] > env("MIXED", MIXED) * total;
                let wide = median > 0.0 && ratio(&widths[i]) > WIDE * median;
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
        (0..D).rev().fold(0, |i, k| i * self.cells[k] + at[k] / CELL)
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
    fn around(&self, cell: usize, reach: usize) -> Matrix<D> {
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

fn trace<const D: usize>(m: &Matrix<D>) -> f64 {
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
    /// Points are stronger than this share of the strong ones (their 97th percentile).
    pub share: f64,
    /// Strength that these are given.
    pub typical: f32,
}

impl<const D: usize> Search<'_, D> {
    /// Ridge points of the ambiguous samples, in the order of samples.
    pub fn points(&self) -> Vec<Candidate<D>> {
        let dims = self.image.dims;
        let blocks = dims.map(|n| n.div_ceil(BLOCK));
        let mut blurred = self.image.samples.to_vec();
        gaussian::smooth(dims, &mut blurred, [CROSSING.blur; D]);
        let job = Job {
            search: self,
            sources: [Volume::new(dims, &blurred), self.image],
            level: median(self.image.samples.iter().copied().step_by(7)),
            floor: self.floor(),
        };
        let found: Vec<Vec<Candidate<D>>> = (0..blocks.iter().product::<usize>())
            .into_par_iter()
            .map_init(Scratch::default, |scratch, block| {
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
        let rank = strengths.len() * 97 / 100;
        let strong = *strengths.select_nth_unstable_by(rank, f32::total_cmp).1;
        let least = env("SHARE", self.share) as f32 * strong;
        found.retain(|c| c.strength > least);
        found.iter_mut().for_each(|c| c.strength *= self.typical / strong);
        found.sort_by_key(|c| c.voxel);
        found
    }

    /// The height of the smoothed image below which there is nothing to find.
    fn floor(&self) -> f32 {
        let all = self.smoothed.samples;
        let level = median(all.iter().copied().step_by(7));
        // The highest of each row of 64 samples: mostly ridges, if there are ridges.
        let mut tops: Vec<f32> = all.chunks(64).map(|row| row.iter().copied().fold(f32::MIN, f32::max)).collect();
        let rank = tops.len() * 9 / 10;
        match tops.is_empty() {
            true => level,
            false => level + FLOOR as f32 * (*tops.select_nth_unstable_by(rank, f32::total_cmp).1 - level),
        }
    }
}

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
    /// The same, smoothed along the line.
    line: Vec<f32>,
    /// The block and a small margin, smoothed along a sheet.
    sheet: Vec<f32>,
    /// C and D of each angle and sample.
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
        let frame = frame(&tensor);
        for (kind, shape) in [CROSSING, CLOSE].into_iter().enumerate() {
            let wanted = |at: [usize; D]| {
                let flags = zone.flags[zone.cell_of(at)];
                let of_kind = if flags & WIDE_RIDGES != 0 { 1 } else { 0 };
                flags != 0 && of_kind == kind && self.search.smoothed.samples[self.search.smoothed.index(at)] >= self.floor
            };
            if kinds[kind] {
                let mask = Mask::new(dims, first, wanted);
                if mask.any {
                    let filters = Filters::new(shape, frame);
                    filters.fill(self.sources[kind], first, self.level, scratch);
                    filters.apply(&mask, scratch);
                    filters.points(dims, &mask, first, scratch, &mut found);
                }
            }
        }
        found
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
    fn new<const D: usize>(dims: [usize; D], first: [usize; D], wanted: impl Fn([usize; D]) -> bool) -> Self {
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

/// The line in which sheets meet (in 2-D none), and two directions square to it.
fn frame<const D: usize>(tensor: &Matrix<D>) -> [[f64; D]; 3] {
    let mut frame = [[0.0; D]; 3];
    if D == 2 {
        frame[1][0] = 1.0;
        frame[2][1] = 1.0;
        return frame;
    }
    let line = in_space(eigenvector(tensor, eigenvalues(tensor)[0]));
    let least = (0..3).fold(0, |best, k| if line[k].abs() < line[best].abs() { k } else { best });
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
/// ... and in x, where samples are handled [`LANES`] at once.
const NEAR_X: usize = 4;
/// Samples of x handled at once.
const LANES: usize = 8;
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
}

impl<const D: usize> Filters<D> {
    fn new(shape: Shape, frame: [[f64; D]; 3]) -> Self {
        let line = if D == 3 { shape.line } else { 0.0 };
        let margin = (CUT * shape.along.hypot(line)).ceil() as usize + NEAR_X + 1;
        Self { shape, frame, margin, edge: BLOCK + 2 * margin }
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
                (direction.map(|c| c * at), (-0.5 * (at / width).powi(2)).exp())
            })
            .collect();
        let sum: f64 = places.iter().map(|p| p.1).sum();
        taps(places.into_iter().map(|(at, w)| (at, w / sum)), strides)
    }

    /// Copies the block and its margin, zero outside of the image, and smooths them along the line.
    fn fill(&self, image: Volume<'_, D>, first: [usize; D], level: f32, scratch: &mut Scratch) {
        let (edge, margin) = (self.edge, self.margin as isize);
        let strides = std::array::from_fn(|k| edge.pow(k as u32));
        let line = match D {
            3 => Self::bell(self.frame[0], self.shape.line, 1.0, strides),
            _ => vec![(0, 1.0)],
        };
        let rows = edge.pow(D as u32 - 1);
        // Sums near the buffer's ends read beyond it; they are not used.
        let pad = line.iter().map(|t| t.0.unsigned_abs()).max().unwrap_or(0) + LANES;
        scratch.raw.clear();
        scratch.raw.resize(edge * rows + 2 * pad, 0.0);
        for row in 0..rows {
            let mut rest = row;
            let mut at = [0isize; D];
            for k in 1..D {
                at[k] = first[k] as isize + (rest % edge) as isize - margin;
                rest /= edge;
            }
            if (1..D).any(|k| at[k] < 0 || at[k] >= image.dims[k] as isize) {
                continue;
            }
            let start = (1..D).rev().fold(0, |i, k| (i + at[k] as usize) * image.dims[k - 1]);
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
        }
        scratch.line.clear();
        scratch.line.resize((edge * rows).next_multiple_of(LANES), 0.0);
        let (raw, out) = (&scratch.raw, &mut scratch.line);
        wide(
            #[inline(always)]
            || {
                for (i, out) in out.chunks_exact_mut(LANES).enumerate() {
                    let sum: [f32; LANES] = summed(raw, (pad + i * LANES) as isize, &line);
                    out.copy_from_slice(&sum);
                }
            },
        );
    }

    /// C and D of every sample of the block at every angle.
    fn apply(&self, mask: &Mask, scratch: &mut Scratch) {
        let rows = BLOCK.pow(D as u32 - 1);
        let count = rows * BLOCK;
        let wide_edge = BLOCK + 2 * NEAR;
        let big = std::array::from_fn(|k| self.edge.pow(k as u32));
        let small: [usize; D] = std::array::from_fn(|k| match k {
            0 => 1,
            _ => WIDTH * wide_edge.pow(k as u32 - 1),
        });
        for buffer in [&mut scratch.second, &mut scratch.first] {
            buffer.clear();
            buffer.resize(ANGLES * count, 0.0);
        }
        scratch.sheet.clear();
        scratch.sheet.resize(mask.around.len() * WIDTH, 0.0);
        for angle in 0..ANGLES {
            let (along, across) = self.directions(angle as f64);
            let bell = Self::bell(along, self.shape.along, STEP, big);
            let minus = across.map(|c| -c);
            let third = |w: [f64; 3]| taps([([0.0; D], w[0]), (minus, w[1]), (across, w[2])].into_iter(), small);
            // Curvature upside down, and slope.
            let (second, first) = (third([2.0, -1.0, -1.0]), third([0.0, -0.5, 0.5]));
            let Scratch { line, sheet, second: seconds, first: firsts, .. } = scratch;
            wide(
                #[inline(always)]
                || {
                    for (row, _) in mask.around.iter().enumerate().filter(|r| *r.1) {
                        let (mut rest, mut at) = (row, self.margin - NEAR_X);
                        for k in 1..D {
                            at += (self.margin - NEAR + rest % wide_edge) * big[k];
                            rest /= wide_edge;
                        }
                        for part in 0..WIDTH / LANES {
                            let sum: [f32; LANES] = summed(line, (at + part * LANES) as isize, &bell);
                            let to = row * WIDTH + part * LANES;
                            sheet[to..to + LANES].copy_from_slice(&sum);
                        }
                    }
                    for (row, _) in mask.rows.iter().enumerate().filter(|r| *r.1) {
                        let (mut rest, mut at) = (row, NEAR_X);
                        for k in 1..D {
                            at += (NEAR + rest % BLOCK) * small[k];
                            rest /= BLOCK;
                        }
                        for part in 0..BLOCK / LANES {
                            let from = (at + part * LANES) as isize;
                            let to = angle * count + row * BLOCK + part * LANES;
                            let c: [f32; LANES] = summed(sheet, from, &second);
                            let d: [f32; LANES] = summed(sheet, from, &first);
                            seconds[to..to + LANES].copy_from_slice(&c);
                            firsts[to..to + LANES].copy_from_slice(&d);
                        }
                    }
                },
            );
        }
    }

    /// Points of sheets: maxima of C over the angle.
    fn points(&self, dims: [usize; D], mask: &Mask, first: [usize; D], scratch: &Scratch, found: &mut Vec<Candidate<D>>) {
        let count = mask.samples.len();
        // The height of a ridge of typical width that curves so.
        let across = self.shape.blur.powi(2) + 0.5;
        let scale = (across + RIDGE).powf(1.5) / RIDGE.sqrt();
        for (i, _) in mask.samples.iter().enumerate().filter(|s| *s.1) {
            let at = in_block(i, first);
            let c = |angle: usize| f64::from(scratch.second[angle % ANGLES * count + i]);
            // Half a turn on, the direction across is the opposite one.
            let d = |angle: usize| {
                let sign = if angle / ANGLES % 2 == 1 { 1.0 } else { -1.0 };
                sign * f64::from(scratch.first[angle % ANGLES * count + i])
            };
            for angle in ANGLES..2 * ANGLES {
                let (before, here, after) = (c(angle - 1), c(angle), c(angle + 1));
                if !(here > 0.0 && here >= before && here > after) {
                    continue;
                }
                let bend = before + after - 2.0 * here;
                let turn = (0.5 * (before - after) / bend.min(-1e-12)).clamp(-0.5, 0.5);
                let curvature = here - 0.25 * (before - after) * turn;
                let next = if turn < 0.0 { d(angle - 1) } else { d(angle + 1) };
                let slope = d(angle) + turn.abs() * (next - d(angle));
                let (along, normal) = self.directions((angle - ANGLES) as f64 + turn);
                let linear = slope / curvature;
                if linear.abs() > OFFSET {
                    continue;
                }
                let off = linear / (1.0 + linear * linear / PROFILE);
                let strength = (scale * curvature / self.seen(at, along, dims)) as f32;
                for axis in dominant_axes(normal) {
                    let offset = off / normal[axis];
                    if offset.abs() <= 0.5 + f64::from(OVERLAP) {
                        found.push(Candidate::new(dims, at, axis, offset as f32, normal, strength));
                    }
                }
            }
        }
    }

    /// The share of a filter's weight that is inside the image, to some per cent.
    fn seen(&self, at: [usize; D], along: [f64; D], dims: [usize; D]) -> f64 {
        let mut share = 1.0;
        for (direction, width) in [(along, self.shape.along), (self.frame[0], self.shape.line)] {
            let mut ends = [f64::INFINITY; 2];
            for k in 0..D {
                if direction[k].abs() > 1e-6 {
                    let (low, high) = (at[k] as f64 + 0.5, (dims[k] - at[k]) as f64 - 0.5);
                    let (back, ahead) = if direction[k] > 0.0 { (low, high) } else { (high, low) };
                    ends[0] = ends[0].min(back / direction[k].abs());
                    ends[1] = ends[1].min(ahead / direction[k].abs());
                }
            }
            // A Gaussian cut at two standard deviations, as a parabola for each half.
            let half = |end: f64| {
                let u = (end / width / CUT).min(1.0);
                0.5 * u * (1.6 - 0.6 * u)
            };
            share *= half(ends[0]) + half(ends[1]);
        }
        share.max(0.2)
    }
}

/// Weights of samples, from weights of places between them by multilinear interpolation.
fn taps<const D: usize>(places: impl Iterator<Item = ([f64; D], f64)>, strides: [usize; D]) -> Taps {
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
    taps.into_iter().map(|(offset, weight)| (offset, weight as f32)).collect()
}

/// Weighted sums of neighbours, for [`LANES`] samples in a row.
#[inline(always)]
fn summed(samples: &[f32], at: isize, taps: &Taps) -> [f32; LANES] {
    let mut sum = [0.0f32; LANES];
    for &(offset, weight) in taps {
        let from: &[f32; LANES] = samples[(at + offset) as usize..].first_chunk().unwrap_or(&[0.0; LANES]);
        for l in 0..LANES {
            sum[l] += weight * from[l];
        }
    }
    sum
}

/// Lab.
pub fn env(name: &str, default: f64) -> f64 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

//! A block of samples, in which sheets meet in a few lines.

use super::ambiguity::{CELL_SIZE, MIXED_NORMALS, WIDE_RIDGES, cells_around, trace};
use super::filters::{CLOSE_SHAPE, CROSSING_SHAPE, DERIVATIVE_MARGIN, OrientedFilters};
use super::{OrientedSearch, SAME_SURFACE_COSINE};
use crate::feature::candidate::Candidate;
use crate::feature::eigen::{SymmetricMatrix, eigenvalues, eigenvector};
use crate::feature::volume::Volume;
use crate::feature::windows::{LAYER_MULTIPLE, LayerWindow};
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{cross, dot, to_3d, unit};
use crate::parallel::prelude::*;
use std::cmp::Ordering::{Equal, Greater, Less};
use std::ops::Range;

/// Samples along an edge of a block with one line and one set of filters.
pub const BLOCK_SIZE: usize = LAYER_MULTIPLE;
/// Directions that normals gather round in a block, at most ...
const MAX_MODES: usize = 4;
/// ... judged by so many normals ...
const MAX_MODE_NORMALS: usize = 300;
/// ... within this (cosine: 18 degrees) ...
const SAME_MODE_COSINE: f64 = 0.95;
/// ... with at least this share of all.
const MIN_MODE_SHARE: f64 = 0.025;
/// Lines nearer than this (cosine: 15 degrees) are one.
const SAME_LINE_COSINE: f64 = 0.966;

/// The blocks of an image, numbered as samples are.
pub fn blocks<const D: usize>(dims: [usize; D]) -> Volume<'static, D> {
    Volume::new(dims.map(|n| n.div_ceil(BLOCK_SIZE)), &[])
}

/// What all blocks share.
pub struct BlockContext<'a, const D: usize> {
    pub blocks: Volume<'a, D>,
    pub normals: &'a BlockNormals<D>,
    pub search: &'a OrientedSearch<'a, D>,
    /// The layers of the image in which blocks are looked at.
    pub window: &'a LayerWindow<'a, D>,
}

/// Normals of clear candidates, by the block that they lie in.
pub struct BlockNormals<const D: usize> {
    /// Where each block's begin.
    block_starts: Vec<u32>,
    normals: Vec<NormalSample<D>>,
}

struct NormalSample<const D: usize> {
    /// The candidate's sample, counted from the block's first.
    offset: [u8; D],
    normal: [f32; D],
    strength: f32,
}

impl<const D: usize> BlockNormals<D> {
    /// Those of candidates of a volume of `dims` samples that are at least as strong as `clear` says.
    pub fn new(candidates: &[Candidate<D>], dims: [usize; D], clear: f32) -> Self {
        let (samples, blocks) = (Volume::new(dims, &[]), blocks(dims));
        let at = |c: &Candidate<D>| samples.coordinates(c.voxel.index());
        let clear = |i: &u32| candidates[*i as usize].strength >= clear;
        let clear: Vec<u32> = (0..candidates.len() as u32)
            .into_par_iter()
            .filter(clear)
            .collect();
        let of = |i: u32| &candidates[clear[i as usize] as usize];
        let block = |i| blocks.index(at(of(i)).map(|i| i / BLOCK_SIZE));
        let count = blocks.dims.iter().product();
        let (block_starts, order) = sort_by_group(count, (0..clear.len() as u32).map(block));
        let normal = |&i: &u32| {
            let c = of(i);
            NormalSample {
                offset: at(c).map(|i| (i % BLOCK_SIZE) as u8),
                normal: c.normal,
                strength: c.strength,
            }
        };
        let normals = order.par_iter().map(normal).collect();
        Self {
            block_starts,
            normals,
        }
    }

    fn in_block(&self, block: usize) -> &[NormalSample<D>] {
        &self.normals[self.block_starts[block] as usize..self.block_starts[block + 1] as usize]
    }
}

/// What a thread needs for a block.
#[derive(Default)]
pub struct BlockScratch {
    /// The block and a margin, smoothed along the line.
    pub line: Vec<f32>,
    /// Whether all that these are means of is inside the image; if not, what share of each.
    pub is_inside: bool,
    pub inside_share: Vec<f32>,
    /// The block and a small margin, smoothed along a sheet.
    pub surface: Vec<f32>,
    /// C and D of each row that matters, of each angle that does, of each sample of the row.
    pub second_derivative: Vec<f32>,
    pub first_derivative: Vec<f32>,
}

impl<const D: usize> BlockContext<'_, D> {
    /// Ridge points of the block that begins at sample `first`.
    pub fn find_points(&self, first: [usize; D], scratch: &mut BlockScratch) -> Vec<Candidate<D>> {
        let (zone, window, dims) = (self.search.ambiguity, self.window, self.window.dims);
        // The ambiguous cells of the block decide on the line.
        let side = BLOCK_SIZE / CELL_SIZE;
        let (mut tensor, mut kinds) = ([[0.0; D]; D], [false; 2]);
        for number in 0..side.pow(D as u32) {
            let mut rest = number;
            let at: [usize; D] = std::array::from_fn(|k| {
                let i = first[k] + rest % side * CELL_SIZE;
                rest /= side;
                i
            });
            if (0..D).any(|k| at[k] >= dims[k]) {
                continue;
            }
            let cell = zone.cell_of(at);
            kinds[0] |= zone.flags[cell] == MIXED_NORMALS;
            kinds[1] |= zone.flags[cell] & WIDE_RIDGES != 0;
            let around = zone.normal_tensor(cell, 1);
            for k in 0..D {
                for l in 0..D {
                    tensor[k][l] += around[k][l];
                }
            }
        }
        let mut found = Vec::new();
        if kinds == [false; 2] {
            return found;
        }
        let modes = self.dominant_directions(first);
        if modes.is_empty() {
            return found;
        }
        // Sheets that run side by side may have no sure point here.
        if trace(&tensor) == 0.0 {
            for n in &modes {
                for k in 0..D {
                    for l in 0..D {
                        tensor[k][l] += n[k] * n[l];
                    }
                }
            }
        }
        let lines = self.candidate_lines(&modes, &tensor);
        let sources = [(CROSSING_SHAPE, window.blurred), (CLOSE_SHAPE, window.raw)];
        for (kind, (shape, source)) in sources.into_iter().enumerate() {
            let wanted = |at: [usize; D]| {
                let flags = zone.flags[zone.cell_of(at)];
                let of_kind = if flags & WIDE_RIDGES != 0 { 1 } else { 0 };
                flags != 0
                    && of_kind == kind
                    && window.smoothed.value_at(at) >= self.search.noise_floor
            };
            if kinds[kind] {
                let mask = BlockMask::new(dims, first, wanted);
                let (image, begin) = (source.volume, source.to_stack(first));
                for line in lines.iter().filter(|_| mask.has_any) {
                    let filters = OrientedFilters::new(shape, frame(*line), &modes, kind == 1);
                    filters.fill_line_means(image, begin, self.search.background, &mask, scratch);
                    filters.apply(image.dims, begin, &mask, scratch);
                    filters.points(dims, &mask, first, scratch, &mut found);
                }
            }
        }
        if lines.len() > 1 {
            found = deduplicate(found);
        }
        found
    }

    /// The lines in which the sheets of a block may meet: square to each two of the directions that
    /// normals have there.
    fn candidate_lines(&self, modes: &[[f64; D]], tensor: &SymmetricMatrix<D>) -> Vec<[f64; D]> {
        let usual = vec![eigenvector(tensor, eigenvalues(tensor)[0])];
        if D == 2 {
            return usual;
        }
        let mut lines: Vec<[f64; D]> = Vec::new();
        for (i, a) in modes.iter().enumerate() {
            for b in &modes[..i] {
                let line = cross(to_3d(*a), to_3d(*b));
                let length = dot(line, line).sqrt();
                let line = std::array::from_fn(|k| line[k] / length);
                if lines.iter().all(|l| dot(*l, line).abs() < SAME_LINE_COSINE) {
                    lines.push(line);
                }
            }
        }
        match lines.is_empty() {
            true => usual,
            false => lines,
        }
    }

    /// Up to [`MAX_MODES`] directions round which the normals of candidates in and beside a block gather.
    fn dominant_directions(&self, first: [usize; D]) -> Vec<[f64; D]> {
        let blocks = &self.blocks;
        let mut normals: Vec<([f64; D], f64)> = Vec::new();
        let own = blocks.index(first.map(|i| i / BLOCK_SIZE));
        for block in cells_around(blocks, own, 1) {
            // Of blocks beside it the nearer half.
            let (here, there) = (blocks.coordinates(own), blocks.coordinates(block));
            let near: [Range<u8>; D] = std::array::from_fn(|k| match there[k].cmp(&here[k]) {
                Less => (BLOCK_SIZE / 2) as u8..BLOCK_SIZE as u8,
                Equal => 0..BLOCK_SIZE as u8,
                Greater => 0..(BLOCK_SIZE / 2) as u8,
            });
            let close = |c: &&NormalSample<D>| (0..D).all(|k| near[k].contains(&c.offset[k]));
            let some = self.normals.in_block(block).iter().filter(close);
            normals.extend(some.map(|c| (c.normal.map(f64::from), f64::from(c.strength))));
        }
        let every = normals.len() / MAX_MODE_NORMALS + 1;
        let mut normals: Vec<([f64; D], f64)> = normals.into_iter().step_by(every).collect();
        let all: f64 = normals.iter().map(|n| n.1).sum();
        let mut modes = Vec::new();
        while modes.len() < MAX_MODES {
            let Some((start, _)) = normals.iter().max_by(|a, b| a.1.total_cmp(&b.1)).copied()
            else {
                break;
            };
            // The best of some starts, moved to the mean of what is round it.
            let support = |about: [f64; D]| -> ([f64; D], f64) {
                let (mut sum, mut weight) = ([0.0; D], 0.0);
                for (n, w) in &normals {
                    let c = dot(*n, about);
                    if c.abs() > SAME_MODE_COSINE {
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
            if weight < MIN_MODE_SHARE * all {
                break;
            }
            modes.push(mode);
            normals.retain(|(n, _)| dot(*n, mode).abs() <= SAME_MODE_COSINE);
        }
        modes
    }
}

/// Which samples of a block matter.
pub struct BlockMask {
    pub samples: Vec<bool>,
    /// Of each row of x.
    pub rows: Vec<bool>,
    /// Of each row of x in the block and a margin of [`DERIVATIVE_MARGIN`] round it, those that derivatives at these need,
    /// counted from the margin's first.
    pub rows_around: RowRanges,
    pub has_any: bool,
}

impl BlockMask {
    pub fn new<const D: usize>(
        dims: [usize; D],
        first: [usize; D],
        wanted: impl Fn([usize; D]) -> bool,
    ) -> Self {
        let rows = BLOCK_SIZE.pow(D as u32 - 1);
        let wide = BLOCK_SIZE + 2 * DERIVATIVE_MARGIN;
        let mut mask = Self {
            samples: vec![false; rows * BLOCK_SIZE],
            rows: vec![false; rows],
            rows_around: RowRanges::empty(wide.pow(D as u32 - 1)),
            has_any: false,
        };
        let mut parts = RowRanges::empty(rows);
        for i in 0..rows * BLOCK_SIZE {
            let at = block_sample(i, first);
            if (0..D).all(|k| at[k] < dims[k]) && wanted(at) {
                mask.samples[i] = true;
                mask.rows[i / BLOCK_SIZE] = true;
                mask.has_any = true;
                let x = i % BLOCK_SIZE;
                parts.add(
                    i / BLOCK_SIZE,
                    [x, x + 2 * DERIVATIVE_MARGIN + 1].map(|x| x as i8),
                );
            }
        }
        for row in (0..rows).filter(|&r| mask.rows[r]) {
            let side = 2 * DERIVATIVE_MARGIN + 1;
            for number in 0..side.pow(D as u32 - 1) {
                let (mut rest, mut near, mut to, mut stride) = (row, number, 0, 1);
                for _ in 1..D {
                    to += (rest % BLOCK_SIZE + near % side) * stride;
                    rest /= BLOCK_SIZE;
                    near /= side;
                    stride *= wide;
                }
                mask.rows_around.add(to, [parts.start[row], parts.end[row]]);
            }
        }
        mask
    }
}

/// Of each of some rows, from where to where samples matter.
pub struct RowRanges {
    pub start: Vec<i8>,
    pub end: Vec<i8>,
}

impl RowRanges {
    /// None of so many rows: a range that is none even when it is moved by 39 along x with others.
    pub fn empty(rows: usize) -> Self {
        Self {
            start: vec![80; rows],
            end: vec![-80; rows],
        }
    }

    /// Of a row those, too, from `start` to `end`.
    fn add(&mut self, row: usize, [start, end]: [i8; 2]) {
        self.start[row] = self.start[row].min(start);
        self.end[row] = self.end[row].max(end);
    }

    /// Of the rows from number `to` on those, too, that others have so far off, the first and the last.
    #[inline(always)]
    pub fn add_shifted(&mut self, to: usize, other: [&[i8]; 2], [first, last]: [i8; 2]) {
        for (start, other) in self.start[to..].iter_mut().zip(other[0]) {
            *start = (*start).min(other + first);
        }
        for (end, other) in self.end[to..].iter_mut().zip(other[1]) {
            *end = (*end).max(other + last);
        }
    }

    pub fn range(&self, row: usize) -> Range<usize> {
        match self.start[row] < self.end[row] {
            true => self.start[row] as usize..self.end[row] as usize,
            false => 0..0,
        }
    }
}

/// The sample of the image that is number `i` of a block.
pub fn block_sample<const D: usize>(i: usize, first: [usize; D]) -> [usize; D] {
    let mut rest = i;
    std::array::from_fn(|k| {
        let j = first[k] + rest % BLOCK_SIZE;
        rest /= BLOCK_SIZE;
        j
    })
}

/// Of points that different lines gave for one sheet in one column, the strongest.
fn deduplicate<const D: usize>(mut found: Vec<Candidate<D>>) -> Vec<Candidate<D>> {
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
            .any(|k| dot(k.normal, c.normal).abs() > SAME_SURFACE_COSINE);
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
    let line = to_3d(line);
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

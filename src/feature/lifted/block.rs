//! A block of samples, in which sheets meet in a few lines.

use super::filters::{CLOSE, CROSSING, Filters, NEAR};
use super::zone::{CELL, MIXED_NORMALS, WIDE_RIDGES, around, trace};
use super::{SAME_SHEET, Search};
use crate::feature::crossing::Candidate;
use crate::feature::symmetric::{Symmetric, eigenvalues, eigenvector};
use crate::feature::volume::Volume;
use crate::feature::windows::{MULTIPLE, Window};
use crate::geometry::groups::grouped;
use crate::geometry::{cross, dot, in_space, unit};
use crate::parallel::prelude::*;
use std::cmp::Ordering::{Equal, Greater, Less};
use std::ops::Range;

/// Samples along an edge of a block with one line and one set of filters.
pub const BLOCK: usize = MULTIPLE;
/// Directions that normals gather round in a block, at most ...
const MODES: usize = 4;
/// ... judged by so many normals ...
const NORMALS: usize = 300;
/// ... within this (cosine: 18 degrees) ...
const SAME_MODE: f64 = 0.95;
/// ... with at least this share of all.
const LEAST_MODE: f64 = 0.025;
/// Lines nearer than this (cosine: 15 degrees) are one.
const SAME_LINE: f64 = 0.966;

/// The blocks of an image, numbered as samples are.
pub fn blocks<const D: usize>(dims: [usize; D]) -> Volume<'static, D> {
    Volume::new(dims.map(|n| n.div_ceil(BLOCK)), &[])
}

/// What all blocks share.
pub struct Job<'a, const D: usize> {
    pub blocks: Volume<'a, D>,
    pub normals: &'a Normals<D>,
    pub search: &'a Search<'a, D>,
    /// The layers of the image in which blocks are looked at.
    pub window: &'a Window<'a, D>,
}

/// Normals of clear candidates, by the block that they lie in.
pub struct Normals<const D: usize> {
    /// Where each block's begin.
    start: Vec<u32>,
    all: Vec<Normal<D>>,
}

struct Normal<const D: usize> {
    /// The candidate's sample, counted from the block's first.
    at: [u8; D],
    normal: [f32; D],
    strength: f32,
}

impl<const D: usize> Normals<D> {
    /// Those of candidates of a volume of `dims` samples that are at least as strong as `clear` says.
    pub fn of(candidates: &[Candidate<D>], dims: [usize; D], clear: f32) -> Self {
        let (samples, blocks) = (Volume::new(dims, &[]), blocks(dims));
        let at = |c: &Candidate<D>| samples.coordinates(c.voxel.index());
        let clear = |i: &u32| candidates[*i as usize].strength >= clear;
        let clear: Vec<u32> = (0..candidates.len() as u32)
            .into_par_iter()
            .filter(clear)
            .collect();
        let of = |i: u32| &candidates[clear[i as usize] as usize];
        let block = |i| blocks.index(at(of(i)).map(|i| i / BLOCK));
        let count = blocks.dims.iter().product();
        let (start, order) = grouped(count, (0..clear.len() as u32).map(block));
        let normal = |&i: &u32| {
            let c = of(i);
            Normal {
                at: at(c).map(|i| (i % BLOCK) as u8),
                normal: c.normal,
                strength: c.strength,
            }
        };
        let all = order.par_iter().map(normal).collect();
        Self { start, all }
    }

    fn of_block(&self, block: usize) -> &[Normal<D>] {
        &self.all[self.start[block] as usize..self.start[block + 1] as usize]
    }
}

/// What a thread needs for a block.
#[derive(Default)]
pub struct Scratch {
    /// The block and a margin, smoothed along the line.
    pub line: Vec<f32>,
    /// Whether all that these are means of is inside the image; if not, what share of each.
    pub whole: bool,
    pub line_inside: Vec<f32>,
    /// The block and a small margin, smoothed along a sheet.
    pub sheet: Vec<f32>,
    /// C and D of each row that matters, of each angle that does, of each sample of the row.
    pub second: Vec<f32>,
    pub first: Vec<f32>,
}

impl<const D: usize> Job<'_, D> {
    /// Ridge points of the block that begins at sample `first`.
    pub fn of_block(&self, first: [usize; D], scratch: &mut Scratch) -> Vec<Candidate<D>> {
        let (zone, window, dims) = (self.search.zone, self.window, self.window.dims);
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
        if kinds == [false; 2] {
            return found;
        }
        let modes = self.modes(first);
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
        let lines = self.lines(&modes, &tensor);
        let sources = [(CROSSING, window.blurred), (CLOSE, window.raw)];
        for (kind, (shape, source)) in sources.into_iter().enumerate() {
            let wanted = |at: [usize; D]| {
                let flags = zone.flags[zone.cell_of(at)];
                let of_kind = if flags & WIDE_RIDGES != 0 { 1 } else { 0 };
                flags != 0 && of_kind == kind && window.smoothed.at(at) >= self.search.floor
            };
            if kinds[kind] {
                let mask = Mask::new(dims, first, wanted);
                let (image, begin) = (source.volume, source.in_stack(first));
                for line in lines.iter().filter(|_| mask.any) {
                    let filters = Filters::new(shape, frame(*line), &modes, kind == 1);
                    filters.fill(image, begin, self.search.level, &mask, scratch);
                    filters.apply(image.dims, begin, &mask, scratch);
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
        let blocks = &self.blocks;
        let mut normals: Vec<([f64; D], f64)> = Vec::new();
        let own = blocks.index(first.map(|i| i / BLOCK));
        for block in around(blocks, own, 1) {
            // Of blocks beside it the nearer half.
            let (here, there) = (blocks.coordinates(own), blocks.coordinates(block));
            let near: [Range<u8>; D] = std::array::from_fn(|k| match there[k].cmp(&here[k]) {
                Less => (BLOCK / 2) as u8..BLOCK as u8,
                Equal => 0..BLOCK as u8,
                Greater => 0..(BLOCK / 2) as u8,
            });
            let close = |c: &&Normal<D>| (0..D).all(|k| near[k].contains(&c.at[k]));
            let some = self.normals.of_block(block).iter().filter(close);
            normals.extend(some.map(|c| (c.normal.map(f64::from), f64::from(c.strength))));
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
pub struct Mask {
    pub samples: Vec<bool>,
    /// Of each row of x.
    pub rows: Vec<bool>,
    /// Of each row of x in the block and a margin of [`NEAR`] round it, those that derivatives at these need,
    /// counted from the margin's first.
    pub around: Parts,
    pub any: bool,
}

impl Mask {
    pub fn new<const D: usize>(
        dims: [usize; D],
        first: [usize; D],
        wanted: impl Fn([usize; D]) -> bool,
    ) -> Self {
        let rows = BLOCK.pow(D as u32 - 1);
        let wide = BLOCK + 2 * NEAR;
        let mut mask = Self {
            samples: vec![false; rows * BLOCK],
            rows: vec![false; rows],
            around: Parts::none(wide.pow(D as u32 - 1)),
            any: false,
        };
        let mut parts = Parts::none(rows);
        for i in 0..rows * BLOCK {
            let at = in_block(i, first);
            if (0..D).all(|k| at[k] < dims[k]) && wanted(at) {
                mask.samples[i] = true;
                mask.rows[i / BLOCK] = true;
                mask.any = true;
                let x = i % BLOCK;
                parts.add(i / BLOCK, [x, x + 2 * NEAR + 1].map(|x| x as i8));
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
                mask.around.add(to, [parts.start[row], parts.end[row]]);
            }
        }
        mask
    }
}

/// Of each of some rows, from where to where samples matter.
pub struct Parts {
    pub start: Vec<i8>,
    pub end: Vec<i8>,
}

impl Parts {
    /// None of so many rows: a range that is none even when it is moved by 39 along x with others.
    pub fn none(rows: usize) -> Self {
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
    pub fn add_all(&mut self, to: usize, other: [&[i8]; 2], [first, last]: [i8; 2]) {
        for (start, other) in self.start[to..].iter_mut().zip(other[0]) {
            *start = (*start).min(other + first);
        }
        for (end, other) in self.end[to..].iter_mut().zip(other[1]) {
            *end = (*end).max(other + last);
        }
    }

    pub fn of(&self, row: usize) -> Range<usize> {
        match self.start[row] < self.end[row] {
            true => self.start[row] as usize..self.end[row] as usize,
            false => 0..0,
        }
    }
}

/// The sample of the image that is number `i` of a block.
pub fn in_block<const D: usize>(i: usize, first: [usize; D]) -> [usize; D] {
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

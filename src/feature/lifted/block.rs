//! A block of samples, in which sheets meet in a few lines.

use super::filters::{CLOSE, CROSSING, Filters, NEAR};
use super::modes::modes;
use super::zone::{CELL, MIXED_NORMALS, WIDE_RIDGES, around, trace};
use super::{SAME_SHEET, Search};
use crate::feature::crossing::Candidate;
use crate::feature::symmetric::{Symmetric, eigenvalues, eigenvector};
use crate::feature::volume::Volume;
use crate::feature::windows::{MULTIPLE, Window};
use crate::geometry::groups::group;
use crate::geometry::{cross, dot, in_space};
use rayon::prelude::*;

/// Samples along an edge of a block with one line and one set of filters.
pub const BLOCK: usize = MULTIPLE;
/// Lines nearer than this (cosine: 15 degrees) are one.
const SAME_LINE: f64 = 0.966;

/// The blocks of an image, numbered as samples are.
pub fn blocks<const D: usize>(dims: [usize; D]) -> Volume<'static, D> {
    Volume::new(dims.map(|n| n.div_ceil(BLOCK)), &[])
}

/// What all blocks share.
pub struct Job<'a, const D: usize> {
    pub blocks: Volume<'a, D>,
    pub clear: &'a Clear<D>,
    pub search: &'a Search<'a, D>,
    /// The layers of the image in which blocks are looked at.
    pub window: &'a Window<'a, D>,
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

    /// Directions round which the normals of clear candidates in and beside a block gather.
    fn modes(&self, first: [usize; D]) -> Vec<[f64; D]> {
        let reach = BLOCK / 2;
        let mut normals = Vec::new();
        let own = self.blocks.index(first.map(|i| i / BLOCK));
        for block in around(&self.blocks, own, 1) {
            let range = self.clear.starts[block] as usize..self.clear.starts[block + 1] as usize;
            for c in &self.clear.normals[range] {
                let close = |k: usize| {
                    let at = c.at[k] as usize;
                    at + reach >= first[k] && at < first[k] + BLOCK + reach
                };
                if (0..D).all(close) {
                    normals.push((c.normal.map(f64::from), f64::from(c.strength)));
                }
            }
        }
        modes(normals)
    }
}

/// Candidates that are clear, by the block that they lie in.
pub struct Clear<const D: usize> {
    /// Where each block's begin.
    starts: Vec<u32>,
    normals: Vec<Normal<D>>,
}

/// What is known of one.
struct Normal<const D: usize> {
    /// Its sample.
    at: [u32; D],
    normal: [f32; D],
    strength: f32,
}

impl<const D: usize> Clear<D> {
    /// Those of at least some strength.
    pub fn new(dims: [usize; D], candidates: &[Candidate<D>], least: f32) -> Self {
        let (samples, blocks) = (Volume::new(dims, &[]), blocks(dims));
        let clear: Vec<&Candidate<D>> = (candidates.par_iter())
            .filter(|c| c.strength >= least)
            .collect();
        let at = |c: &Candidate<D>| samples.coordinates(c.voxel as usize);
        let block_of: Vec<u32> = (clear.par_iter())
            .map(|c| blocks.index(at(c).map(|i| i / BLOCK)) as u32)
            .collect();
        let (mut starts, mut order) = (Vec::new(), Vec::new());
        group(
            blocks.dims.iter().product(),
            &block_of,
            &mut starts,
            &mut order,
        );
        let normal = |&number: &u32| {
            let c = clear[number as usize];
            Normal {
                at: at(c).map(|i| i as u32),
                normal: c.normal,
                strength: c.strength,
            }
        };
        let normals = order.par_iter().map(normal).collect();
        Self { starts, normals }
    }
}

/// Which samples of a block matter.
pub struct Mask {
    pub samples: Vec<bool>,
    /// Of each row of x.
    pub rows: Vec<bool>,
    /// Of each row of x in the block and its small margin.
    pub around: Vec<bool>,
    pub any: bool,
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

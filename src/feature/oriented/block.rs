//! A block of samples, in which surfaces meet in a few lines.

use super::ambiguity::{CELL_SIZE, MIXED_NORMALS, WIDE_RIDGES, cells_around, trace};
use super::filters::{CLOSE_SHAPE, CROSSING_SHAPE, OrientedFilters};
use super::row_ranges::RowRanges;
use super::{OrientedSearch, SAME_COLUMN_COSINE};
use crate::feature::candidate::Candidate;
use crate::feature::volume::Volume;
use crate::feature::windows::{LAYER_MULTIPLE, LayerWindow};
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::eigen::{SymmetricMatrix, eigenvalues, eigenvector};
use crate::geometry::grid_index::index_at;
use crate::geometry::{cross, dot, to_3d, unit};
use crate::parallel::prelude::*;
use std::cmp::Ordering::{Equal, Greater, Less};
use std::ops::Range;

/// Number of samples along the edge of a block, which has one set of lines and filters.
pub const BLOCK_SIZE: usize = LAYER_MULTIPLE;
/// Largest number of directions around which the normals of a block cluster.
const MAX_MODES: usize = 4;
/// Largest number of normals that are used.
const MAX_MODE_NORMALS: usize = 300;
/// Smallest cosine (18 degrees) between normals of one cluster.
const SAME_MODE_COSINE: f64 = 0.95;
/// Smallest share of all normals in a cluster.
const MIN_MODE_SHARE: f64 = 0.025;
/// Cosine (15 degrees) above which two lines are the same.
const SAME_LINE_COSINE: f64 = 0.966;

/// Returns the grid of blocks of an image, in the order of samples.
pub fn blocks<const D: usize>(dims: [usize; D]) -> Volume<'static, D> {
    Volume::new(dims.map(|n| n.div_ceil(BLOCK_SIZE)), &[])
}

/// Data that all blocks share.
pub struct BlockContext<'a, const D: usize> {
    pub blocks: Volume<'a, D>,
    pub normals: &'a BlockNormals<D>,
    pub search: &'a OrientedSearch<'a, D>,
    /// The window of the image in which blocks are processed.
    pub window: &'a LayerWindow<'a, D>,
}

/// Normals of clear candidates, grouped by block.
pub struct BlockNormals<const D: usize> {
    /// Index of the first normal of each block.
    block_starts: Vec<u32>,
    normals: Vec<NormalSample<D>>,
}

struct NormalSample<const D: usize> {
    /// Sample of the candidate, relative to the block's first sample.
    offset: [u8; D],
    normal: [f32; D],
    strength: f32,
}

impl<const D: usize> BlockNormals<D> {
    /// Groups the candidates of a volume of `dims` samples that are at least as strong as
    /// `min_strength`.
    pub fn new(candidates: &[Candidate<D>], dims: [usize; D], min_strength: f32) -> Self {
        let (samples, blocks) = (Volume::new(dims, &[]), blocks(dims));
        let at = |c: &Candidate<D>| samples.coordinates(c.voxel.index());
        let is_clear = |i: &u32| candidates[*i as usize].strength >= min_strength;
        let clear_indices: Vec<u32> = (0..candidates.len() as u32)
            .into_par_iter()
            .filter(is_clear)
            .collect();
        let candidate = |i: u32| &candidates[clear_indices[i as usize] as usize];
        let block_of = |i| blocks.index(at(candidate(i)).map(|i| i / BLOCK_SIZE));
        let count = blocks.dims.iter().product();
        let (block_starts, order) =
            sort_by_group(count, (0..clear_indices.len() as u32).map(block_of));
        let normal = |&i: &u32| {
            let c = candidate(i);
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

/// Buffers of one thread.
#[derive(Default)]
pub struct BlockScratch {
    /// Means along the line, of the block and its margin.
    pub line: Vec<f32>,
    /// `true` if all samples that contribute to these means are inside the image; otherwise
    /// `inside_share` has the share inside for each mean.
    pub is_inside: bool,
    pub inside_share: Vec<f32>,
    /// For each angle, the samples of the block and its derivative margin that derivatives read.
    pub surface_ranges: Vec<RowRanges>,
    /// Means along a surface, of the block and its derivative margin.
    pub surface: Vec<f32>,
    /// C and D, for each needed row, each angle, and each sample of the row.
    pub second_derivative: Vec<f32>,
    pub first_derivative: Vec<f32>,
}

impl<const D: usize> BlockContext<'_, D> {
    /// Finds the ridge points of the block that begins at sample `first`.
    pub fn find_points(&self, first: [usize; D], scratch: &mut BlockScratch) -> Vec<Candidate<D>> {
        let (ambiguity, window, dims) = (self.search.ambiguity, self.window, self.window.dims);
        // The ambiguous cells of the block decide on the line.
        let side = BLOCK_SIZE / CELL_SIZE;
        let (mut tensor, mut kinds) = ([[0.0; D]; D], [false; 2]);
        for number in 0..side.pow(D as u32) {
            let cell = index_at([side; D], number);
            let at: [usize; D] = std::array::from_fn(|k| first[k] + cell[k] * CELL_SIZE);
            if (0..D).any(|k| at[k] >= dims[k]) {
                continue;
            }
            let cell = ambiguity.cell_of(at);
            kinds[0] |= ambiguity.flags[cell] == MIXED_NORMALS;
            kinds[1] |= ambiguity.flags[cell] & WIDE_RIDGES != 0;
            let cell_tensor = ambiguity.normal_tensor(cell, 1);
            for k in 0..D {
                for l in 0..D {
                    tensor[k][l] += cell_tensor[k][l];
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
        // Surfaces that run side by side may have no strong point here.
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
            let is_wanted = |at: [usize; D]| {
                let flags = ambiguity.flags[ambiguity.cell_of(at)];
                let cell_kind = if flags & WIDE_RIDGES != 0 { 1 } else { 0 };
                flags != 0
                    && cell_kind == kind
                    && window.smoothed.value_at(at) >= self.search.noise_floor
            };
            if kinds[kind] {
                let mask = BlockMask::new(dims, first, is_wanted);
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

    /// Returns the lines in which the surfaces of a block may meet: the directions square to each
    /// pair of dominant normals.
    fn candidate_lines(&self, modes: &[[f64; D]], tensor: &SymmetricMatrix<D>) -> Vec<[f64; D]> {
        let default_line = vec![eigenvector(tensor, eigenvalues(tensor)[0])];
        if D == 2 {
            return default_line;
        }
        let mut lines: Vec<[f64; D]> = Vec::new();
        for (i, a) in modes.iter().enumerate() {
            for b in &modes[..i] {
                let line = unit(cross(to_3d(*a), to_3d(*b)));
                let line = std::array::from_fn(|k| line[k]);
                if lines.iter().all(|l| dot(*l, line).abs() < SAME_LINE_COSINE) {
                    lines.push(line);
                }
            }
        }
        if lines.is_empty() {
            default_line
        } else {
            lines
        }
    }

    /// Returns up to [`MAX_MODES`] directions around which the normals of candidates in and near a
    /// block cluster.
    fn dominant_directions(&self, first: [usize; D]) -> Vec<[f64; D]> {
        let blocks = &self.blocks;
        let mut normals: Vec<([f64; D], f64)> = Vec::new();
        let centre_block = blocks.index(first.map(|i| i / BLOCK_SIZE));
        for block in cells_around(blocks, centre_block, 1) {
            // Of neighbouring blocks, the nearer half is used.
            let (centre, position) = (blocks.coordinates(centre_block), blocks.coordinates(block));
            let ranges: [Range<u8>; D] =
                std::array::from_fn(|k| match position[k].cmp(&centre[k]) {
                    Less => (BLOCK_SIZE / 2) as u8..BLOCK_SIZE as u8,
                    Equal => 0..BLOCK_SIZE as u8,
                    Greater => 0..(BLOCK_SIZE / 2) as u8,
                });
            let is_near = |c: &&NormalSample<D>| (0..D).all(|k| ranges[k].contains(&c.offset[k]));
            let selected = self.normals.in_block(block).iter().filter(is_near);
            normals.extend(selected.map(|c| (c.normal.map(f64::from), f64::from(c.strength))));
        }
        let stride = normals.len() / MAX_MODE_NORMALS + 1;
        let mut normals: Vec<([f64; D], f64)> = normals.into_iter().step_by(stride).collect();
        let total_weight: f64 = normals.iter().map(|n| n.1).sum();
        let mut modes = Vec::new();
        while modes.len() < MAX_MODES {
            let Some((start, _)) = normals.iter().max_by(|a, b| a.1.total_cmp(&b.1)).copied()
            else {
                break;
            };
            // The mode is the best of some starting directions, moved to the mean of the normals
            // around it.
            let support = |direction: [f64; D]| -> ([f64; D], f64) {
                let (mut sum, mut weight) = ([0.0; D], 0.0);
                for (n, w) in &normals {
                    let c = dot(*n, direction);
                    if c.abs() > SAME_MODE_COSINE {
                        weight += w;
                        for k in 0..D {
                            sum[k] += w * c.signum() * n[k];
                        }
                    }
                }
                (unit(sum), weight)
            };
            let starts = normals.iter().step_by(normals.len() / 16 + 1).map(|n| n.0);
            let best = starts
                .chain([start])
                .map(support)
                .max_by(|a, b| a.1.total_cmp(&b.1));
            let Some((mode, _)) = best else { break };
            let (mode, weight) = support(mode);
            if weight < MIN_MODE_SHARE * total_weight {
                break;
            }
            modes.push(mode);
            normals.retain(|(n, _)| dot(*n, mode).abs() <= SAME_MODE_COSINE);
        }
        modes
    }
}

/// Mask of the needed samples of a block.
pub struct BlockMask {
    pub samples: Vec<bool>,
    /// For each row of x, `true` if it has needed samples.
    pub rows: Vec<bool>,
    /// For each row of x, the range of its needed samples.
    pub ranges: RowRanges,
    pub has_any: bool,
}

impl BlockMask {
    pub fn new<const D: usize>(
        dims: [usize; D],
        first: [usize; D],
        is_wanted: impl Fn([usize; D]) -> bool,
    ) -> Self {
        let rows = BLOCK_SIZE.pow(D as u32 - 1);
        let mut mask = Self {
            samples: vec![false; rows * BLOCK_SIZE],
            rows: vec![false; rows],
            ranges: RowRanges::empty::<D>(BLOCK_SIZE),
            has_any: false,
        };
        for i in 0..rows * BLOCK_SIZE {
            let at = block_sample(i, first);
            if (0..D).all(|k| at[k] < dims[k]) && is_wanted(at) {
                mask.samples[i] = true;
                mask.rows[i / BLOCK_SIZE] = true;
                mask.has_any = true;
                mask.ranges.add(i / BLOCK_SIZE, (i % BLOCK_SIZE) as i8);
            }
        }
        mask
    }
}

/// Returns the image coordinates of sample `i` of a block.
pub fn block_sample<const D: usize>(i: usize, first: [usize; D]) -> [usize; D] {
    let in_block = index_at([BLOCK_SIZE; D], i);
    std::array::from_fn(|k| first[k] + in_block[k])
}

/// Keeps the strongest of points of one surface in one column that different lines gave.
fn deduplicate<const D: usize>(mut found: Vec<Candidate<D>>) -> Vec<Candidate<D>> {
    found.sort_by(|a, b| {
        (a.voxel, a.axis)
            .cmp(&(b.voxel, b.axis))
            .then(b.strength.total_cmp(&a.strength))
    });
    let mut kept: Vec<Candidate<D>> = Vec::with_capacity(found.len());
    for c in found {
        let is_same_column = |k: &&Candidate<D>| (k.voxel, k.axis) == (c.voxel, c.axis);
        let is_duplicate = kept
            .iter()
            .rev()
            .take_while(is_same_column)
            .any(|k| dot(k.normal, c.normal).abs() > SAME_COLUMN_COSINE);
        if !is_duplicate {
            kept.push(c);
        }
    }
    kept
}

/// Returns the line in which surfaces meet (in 2-D zero), and two directions square to it.
fn frame<const D: usize>(line: [f64; D]) -> [[f64; D]; 3] {
    let mut frame = [[0.0; D]; 3];
    if D == 2 {
        frame[1][0] = 1.0;
        frame[2][1] = 1.0;
        return frame;
    }
    let line = to_3d(line);
    let smallest = (0..3).fold(0, |best, k| {
        if line[k].abs() < line[best].abs() {
            k
        } else {
            best
        }
    });
    let mut other = [0.0; 3];
    other[smallest] = 1.0;
    let a = unit(cross(line, other));
    let b = cross(line, a);
    for k in 0..D {
        (frame[0][k], frame[1][k], frame[2][k]) = (line[k], a[k], b[k]);
    }
    frame
}

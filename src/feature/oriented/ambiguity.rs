//! Mask of the samples at which more than one surface orientation is possible.

use super::normal_dispersion::normal_dispersion;
use crate::error::Result;
use crate::feature::SharedGrid;
use crate::feature::candidate::Candidate;
use crate::feature::ridges::HEIGHT_FACTOR;
use crate::feature::shared_grid::CandidateSlab;
use crate::feature::volume::Volume;
use crate::feature::windows::WindowInterior;
use crate::geometry::eigen::SymmetricMatrix;
use crate::geometry::grid_index::{index_at, offset_of};
use crate::parallel::prelude::*;
use std::ops::Range;

/// Number of samples along the edge of a cell of the mask.
pub const CELL_SIZE: usize = 4;
/// Number of cells on either side by which the mask is dilated.
const DILATION_CELLS: usize = 2;
/// Normals are mixed if their [dispersion](normal_dispersion) (0.017 for surfaces that cross at 15
/// degrees) is this many times that of noise on a single surface. The dispersion of noise is the
/// value that a tenth of the cells stays below.
const NOISE_FACTOR: f64 = 6.0;
/// Bounds of the dispersion above which normals are mixed.
const DISPERSION_BOUNDS: [f64; 2] = [0.003, 0.009];
/// Ridges are too wide to be single if their squared width is this many times that of narrow
/// ridges. A quarter of the cells counts as narrow, because half of all may be too wide if many
/// surfaces run in pairs.
const WIDE_VARIANCE_RATIO: f64 = 1.5;
/// Largest squared width (samples) of a single narrow ridge before smoothing; wider ones are pairs.
const MAX_SINGLE_VARIANCE: f64 = 4.0;
/// Smallest height of a weak ridge that may be a pair, as a share of the mean height of strong
/// ones.
const MIN_HEIGHT_SHARE: f64 = 0.8;
/// Distance (samples) from a side of the box within which normals are not used.
const SIDE_MARGIN: usize = 4;

/// Mask of the samples at which more than one surface orientation is possible: normals are mixed,
/// or a ridge is wider than a single one.
pub struct AmbiguityMask<const D: usize> {
    /// The grid of cells, in the order of samples.
    cells: Volume<'static, D>,
    /// Reasons why each cell is ambiguous: [`MIXED_NORMALS`], [`WIDE_RIDGES`].
    pub(super) flags: Vec<u8>,
    /// Cells of the layers that this rank owns.
    owned_cells: Range<usize>,
    /// Share of all cells that are ambiguous.
    share: f64,
    /// Cells that have candidates.
    slots: CellSlots,
    /// For each of these cells, the sum of the tensors of its candidates' normals.
    tensors: Vec<SymmetricMatrix<D>>,
}

/// A subset of the cells, numbered in ascending order. Few cells have candidates, so that one bit
/// per cell takes less memory than a number.
struct CellSlots {
    bits: Vec<u64>,
    /// Number of cells of the subset before each word of bits.
    counts_before: Vec<u32>,
}

impl CellSlots {
    /// Creates the subset `cells` of `count` cells.
    fn from_cells(count: usize, cells: impl Iterator<Item = usize>) -> Self {
        let mut bits = vec![0u64; count.div_ceil(64)];
        cells.for_each(|cell| bits[cell / 64] |= 1 << (cell % 64));
        let mut sum = 0;
        let count_before = |word: &u64| {
            let previous_count = sum;
            sum += word.count_ones();
            previous_count
        };
        let counts_before = bits.iter().map(count_before).collect();
        Self {
            bits,
            counts_before,
        }
    }

    /// Returns the number of a cell in the subset, if it is in it.
    #[inline]
    fn slot(&self, cell: usize) -> Option<usize> {
        let (word, bit) = (self.bits[cell / 64], 1 << (cell % 64));
        let lower_bits = (word & (bit - 1)).count_ones();
        (word & bit != 0).then(|| (self.counts_before[cell / 64] + lower_bits) as usize)
    }

    /// Returns the cells of the subset in ascending order.
    fn iter(&self) -> impl Iterator<Item = usize> {
        let words = self.bits.iter().enumerate().filter(|(_, word)| **word != 0);
        words.flat_map(|(number, word)| {
            let set = (0..64).filter(move |bit| word & (1 << bit) != 0);
            set.map(move |bit| 64 * number + bit)
        })
    }
}

/// Sums over the ridge points of a cell.
#[derive(Clone, Copy)]
struct CellRidges<const D: usize> {
    cell: usize,
    /// Sum of positions.
    position_sum: [f64; D],
    /// Sums of heights and of strengths, over all points and over strong ones. The ratio of height
    /// to strength is the squared width of a ridge in other units, because strength is a multiple
    /// of the curvature.
    width_sums: [f64; 2],
    strong_width_sums: [f64; 2],
}

/// Flag of cells in which normals of different surfaces meet.
pub const MIXED_NORMALS: u8 = 1;
/// Flag of cells in which ridges are wider than a single one.
pub const WIDE_RIDGES: u8 = 2;

impl<const D: usize> AmbiguityMask<D> {
    /// Computes the mask from ridge points of an image smoothed over `scale` samples. `heights` are
    /// the heights of the smoothed image above its median at these points. Normals are measured at
    /// points of at least `strong_threshold`, widths at points of at least `clear_threshold`,
    /// because a ridge that is too wide for its height is weak. The mask of a rank's own layers,
    /// and of layers near them, is the same for any number of ranks.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn new(
        slab: &CandidateSlab<'_, D>,
        scale: f64,
        heights: &[f32],
        strong_threshold: f32,
        clear_threshold: f32,
    ) -> Result<Self> {
        let (grid, candidates) = (slab.grid, &slab.candidates);
        let dims = grid.dims;
        let samples = Volume::new(dims, &[]);
        let cells = Volume::new(dims.map(|n| n.div_ceil(CELL_SIZE)), &[]);
        let count = cells.dims.iter().product();
        let with_heights = || candidates.iter().zip(heights.iter().map(|&h| f64::from(h)));
        let sure_height = |i: usize| {
            (candidates[i].strength >= strong_threshold).then(|| [f64::from(heights[i]), 1.0])
        };
        let [height_sum, sure_count] = slab.sums_by_layer("heights of ridges", sure_height)?;
        let mean_sure_height = height_sum / sure_count.max(1.0);
        // Points that are weak and not high are noise, and near the sides mirrored samples turn
        // normals.
        let clear_points = || with_heights().filter(|(c, _)| c.strength >= clear_threshold);
        let informative = clear_points().filter_map(|(c, height)| {
            let at = samples.coordinates(c.voxel.index());
            let inside = (0..D).all(|k| at[k] >= SIDE_MARGIN && at[k] + SIDE_MARGIN < dims[k]);
            let is_informative = inside
                && (c.strength >= strong_threshold
                    || height >= MIN_HEIGHT_SHARE * mean_sure_height);
            is_informative.then(|| (c, height, cells.index(at.map(|i| i / CELL_SIZE))))
        });
        let slots = CellSlots::from_cells(count, informative.clone().map(|(_, _, cell)| cell));
        let ridges = |cell| CellRidges {
            cell,
            position_sum: [0.0; D],
            width_sums: [0.0; 2],
            strong_width_sums: [0.0; 2],
        };
        let ridges: Vec<CellRidges<D>> = slots.iter().map(ridges).collect();
        let layer: usize = cells.dims[..D - 1].iter().product();
        let layers = slab.owned_layers();
        let owned_cells =
            layers.start.div_ceil(CELL_SIZE) * layer..layers.end.div_ceil(CELL_SIZE) * layer;
        let mut mask = Self {
            cells,
            flags: vec![0; count],
            owned_cells,
            share: 0.0,
            slots,
            tensors: vec![[[0.0; D]; D]; ridges.len()],
        };
        let ridges = mask.sum_ridges(ridges, informative, strong_threshold);
        if let Some(flags) = mask.ridge_flags(&ridges, scale, grid)? {
            mask.dilate(&ridges, &flags);
            let owned_flags = &mask.flags[mask.owned_cells.clone()];
            let flagged = owned_flags.iter().filter(|&&flag| flag != 0).count();
            let [flagged] = grid.sum("ambiguous cells", [flagged])?;
            mask.share = flagged as f64 / mask.flags.len().max(1) as f64;
        }
        Ok(mask)
    }

    /// Adds ridge points, each with its height and its cell, to `ridges` and to the tensors of
    /// normals, and returns `ridges`. Normals are those of points of at least `strong_threshold`.
    fn sum_ridges<'a>(
        &mut self,
        mut ridges: Vec<CellRidges<D>>,
        points: impl Iterator<Item = (&'a Candidate<D>, f64, usize)>,
        strong_threshold: f32,
    ) -> Vec<CellRidges<D>> {
        for (c, height, cell) in points {
            let Some(slot) = self.slots.slot(cell) else {
                continue;
            };
            let (cell, tensor) = (&mut ridges[slot], &mut self.tensors[slot]);
            let width = [height, f64::from(c.strength)];
            cell.width_sums = [0, 1].map(|k: usize| cell.width_sums[k] + width[k]);
            if c.strength < strong_threshold {
                continue;
            }
            cell.strong_width_sums = [0, 1].map(|k: usize| cell.strong_width_sums[k] + width[k]);
            for k in 0..D {
                cell.position_sum[k] += f64::from(c.position[k]);
                for l in 0..D {
                    tensor[k][l] += f64::from(c.normal[k] * c.normal[l]);
                }
            }
        }
        ridges
    }

    /// Returns the flags of each of `ridges`, found in an image smoothed over `scale` samples;
    /// `None` if there is no strong ridge.
    fn ridge_flags(
        &self,
        ridges: &[CellRidges<D>],
        scale: f64,
        grid: SharedGrid<'_, D>,
    ) -> Result<Option<Vec<u8>>> {
        let ratio = |w: [f64; 2]| w[0] / w[1];
        let owned_ridges = ridges
            .iter()
            .filter(|ridge| self.owned_cells.contains(&ridge.cell));
        let sure_widths = owned_ridges.map(|cell| cell.strong_width_sums);
        let ratios: Vec<f64> = sure_widths.filter(|w| w[1] > 0.0).map(ratio).collect();
        let Some(narrow_ratio) = grid.select_nth("widths of ridges", ratios, |count| count / 4)?
        else {
            return Ok(None);
        };
        // All ridges may be pairs. A strength is a curvature times HEIGHT_FACTOR scale^2.
        let usual_ratio =
            narrow_ratio.min((1.0 + MAX_SINGLE_VARIANCE / (scale * scale)) / HEIGHT_FACTOR);
        let slots_around =
            |cell| cells_around(&self.cells, cell, 1).filter_map(|cell| self.slots.slot(cell));
        let width_sums_around = |cell| {
            let mut sum = [0.0; 2];
            for j in slots_around(cell) {
                sum = [0, 1].map(|k: usize| sum[k] + ridges[j].width_sums[k]);
            }
            sum
        };
        let position_sums: Vec<[f64; D]> = ridges.iter().map(|cell| cell.position_sum).collect();
        let neighbours = |slot: usize| slots_around(ridges[slot].cell);
        let dispersion = normal_dispersion(&self.tensors, &position_sums, neighbours);
        let positive = dispersion.iter().zip(ridges).filter(|(s, _)| **s > 0.0);
        let positive = positive.filter(|(_, ridge)| self.owned_cells.contains(&ridge.cell));
        let positive = positive.map(|(s, _)| *s).collect();
        let noise = grid.select_nth("spreads of normals", positive, |count| count / 10)?;
        let noise = noise.unwrap_or(0.0);
        let max_dispersion =
            (NOISE_FACTOR * noise).clamp(DISPERSION_BOUNDS[0], DISPERSION_BOUNDS[1]);
        let flags = (0..ridges.len()).into_par_iter().map(|i| {
            if ridges[i].width_sums[1] == 0.0 {
                return 0;
            }
            let is_mixed = dispersion[i] > max_dispersion;
            let is_wide = usual_ratio > 0.0
                && ratio(width_sums_around(ridges[i].cell)) > WIDE_VARIANCE_RATIO * usual_ratio;
            u8::from(is_mixed) * MIXED_NORMALS + u8::from(is_wide) * WIDE_RIDGES
        });
        Ok(Some(flags.collect()))
    }

    /// Sets the flags of ridges in their cells and in the cells around these.
    fn dilate(&mut self, ridges: &[CellRidges<D>], flags: &[u8]) {
        for (ridge, flag) in ridges.iter().zip(flags).filter(|f| *f.1 != 0) {
            for j in cells_around(&self.cells, ridge.cell, DILATION_CELLS) {
                self.flags[j] |= flag;
            }
        }
    }

    /// Returns the share of the image that is ambiguous.
    pub fn share(&self) -> f64 {
        self.share
    }

    /// Returns `true` if a sample is ambiguous.
    pub fn is_ambiguous(&self, at: [usize; D]) -> bool {
        self.flags[self.cell_of(at)] != 0
    }

    /// Returns the number of ambiguous cells in the interior of a window.
    pub fn count_within(&self, interior: &WindowInterior) -> usize {
        let flags = interior
            .in_cells(CELL_SIZE)
            .layer_index_ranges(self.cells.dims);
        let flags = flags.flat_map(|cells| &self.flags[cells]);
        flags.filter(|&&flag| flag != 0).count()
    }

    pub(super) fn cell_of(&self, at: [usize; D]) -> usize {
        self.cells.index(at.map(|i| i / CELL_SIZE))
    }

    /// Returns the tensor of the normals of a cell and the cells around it.
    pub(super) fn normal_tensor(&self, cell: usize, reach: usize) -> SymmetricMatrix<D> {
        let mut sum = [[0.0; D]; D];
        for j in cells_around(&self.cells, cell, reach).filter_map(|j| self.slots.slot(j)) {
            for k in 0..D {
                for l in 0..D {
                    sum[k][l] += self.tensors[j][k][l];
                }
            }
        }
        sum
    }
}

/// Returns the cells of a grid that are at most `reach` away from a cell along each axis, including
/// itself.
pub fn cells_around<const D: usize>(
    grid: &Volume<'_, D>,
    cell: usize,
    reach: usize,
) -> impl Iterator<Item = usize> {
    let (at, dims) = (grid.coordinates(cell), grid.dims);
    let side = 2 * reach + 1;
    (0..side.pow(D as u32)).filter_map(move |number| {
        let step = index_at([side; D], number);
        let neighbour: [usize; D] = std::array::from_fn(|k| (at[k] + step[k]).wrapping_sub(reach));
        (0..D)
            .all(|k| neighbour[k] < dims[k])
            .then(|| offset_of(dims, neighbour))
    })
}

/// Returns the sum of a matrix's diagonal.
pub fn trace<const D: usize>(m: &SymmetricMatrix<D>) -> f64 {
    (0..D).map(|k| m[k][k]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn some_cells_are_numbered_in_their_order() {
        let cells = [0, 1, 63, 64, 130, 191, 192, 259];
        let slots = CellSlots::from_cells(260, [192, 64, 0, 259, 63, 1, 130, 191, 64].into_iter());
        assert!(slots.iter().eq(cells));
        for cell in 0..260 {
            assert_eq!(slots.slot(cell), cells.iter().position(|&c| c == cell));
        }
    }
}

//! Where one orientation a sample may not be all there is.

use super::normal_dispersion::normal_dispersion;
use crate::error::Result;
use crate::feature::candidate_slab::{CandidateSlab, select_nth};
use crate::feature::eigen::SymmetricMatrix;
use crate::feature::ridges::HEIGHT_FACTOR;
use crate::feature::volume::Volume;
use crate::feature::windows::WindowInterior;
use crate::parallel::prelude::*;
use std::ops::Range;

/// Samples along an edge of the cells that are ambiguous or not.
pub const CELL_SIZE: usize = 4;
/// Cells on either side over which the ambiguous zone is widened.
const DILATION_CELLS: usize = 2;
/// Normals are mixed where their [`percentiles`] (sheets that cross at 15 degrees have 0.017) is as many times above what
/// noise leaves on a sheet: what a tenth of the cells stays below ...
const NOISE_FACTOR: f64 = 6.0;
/// ... but no less and no more than this.
const DISPERSION_BOUNDS: [f64; 2] = [0.003, 0.009];
/// Ridges are too wide to be one where their squared width is this many times that of the narrow ones (of
/// which there are a quarter: where many run in pairs, half of all may be too wide).
const WIDE_VARIANCE_RATIO: f64 = 1.5;
/// The narrow ones have a squared width (samples) of at most this before smoothing, or are two each.
const MAX_SINGLE_VARIANCE: f64 = 4.0;
/// A weak ridge of at least this share of the mean height of sure ones may be two side by side.
const MIN_HEIGHT_SHARE: f64 = 0.8;
/// Nearer to a side of the box than this (samples) normals say nothing.
const SIDE_MARGIN: usize = 4;

/// Where one orientation a sample may not be all there is: normals are mixed, or a ridge is wider than
/// ridges are.
pub struct AmbiguityMask<const D: usize> {
    /// The cells, numbered as samples are.
    cells: Volume<'static, D>,
    /// Of each cell, why it is ambiguous: [`MIXED_NORMALS`], [`WIDE_RIDGES`].
    pub(super) flags: Vec<u8>,
    /// Cells of this rank's own layers.
    owned_cells: Range<usize>,
    /// Share of all cells that are ambiguous.
    share: f64,
    /// Cells with candidates.
    slots: CellSlots,
    /// Sum over the candidates of each of these of the tensors of their normals.
    tensors: Vec<SymmetricMatrix<D>>,
}

/// Some of the cells, numbered in their order. Few have candidates: a bit for each costs less than a number.
struct CellSlots {
    bits: Vec<u64>,
    /// How many there are before each word of bits.
    counts_before: Vec<u32>,
}

impl CellSlots {
    /// Those `cells` of so many.
    fn from_cells(count: usize, cells: impl Iterator<Item = usize>) -> Self {
        let mut bits = vec![0u64; count.div_ceil(64)];
        cells.for_each(|cell| bits[cell / 64] |= 1 << (cell % 64));
        let mut sum = 0;
        let before = |word: &u64| {
            let before = sum;
            sum += word.count_ones();
            before
        };
        let counts_before = bits.iter().map(before).collect();
        Self {
            bits,
            counts_before,
        }
    }

    /// The number of a cell, if it is one of them.
    #[inline]
    fn slot(&self, cell: usize) -> Option<usize> {
        let (word, bit) = (self.bits[cell / 64], 1 << (cell % 64));
        let passed = (word & (bit - 1)).count_ones();
        (word & bit != 0).then(|| (self.counts_before[cell / 64] + passed) as usize)
    }

    /// All of them, in their order.
    fn iter(&self) -> impl Iterator<Item = usize> {
        let words = self.bits.iter().enumerate().filter(|(_, word)| **word != 0);
        words.flat_map(|(number, word)| {
            let set = (0..64).filter(move |bit| word & (1 << bit) != 0);
            set.map(move |bit| 64 * number + bit)
        })
    }
}

/// What the ridge points of a cell say.
#[derive(Clone, Copy)]
struct CellRidges<const D: usize> {
    cell: usize,
    /// Sum of positions.
    position_sum: [f64; D],
    /// Height over curvature of a ridge is its squared width, and so is in other units height over
    /// strength: sums of heights and strengths, of all and of the sure ones.
    width_sums: [f64; 2],
    strong_width_sums: [f64; 2],
}

/// Normals of different sheets meet.
pub const MIXED_NORMALS: u8 = 1;
/// Ridges are wider than one is.
pub const WIDE_RIDGES: u8 = 2;

impl<const D: usize> AmbiguityMask<D> {
    /// Judges ridge points of a smoothed image, of which `heights` tells how much higher it is there than
    /// where there is nothing: normals by points of at least `strong`, and widths by those of at least
    /// `clear`, for a ridge too wide for its height is weak. `scale` is the width (samples) of the Gaussian that
    /// smoothed it. What is said of a rank's own layers and of those near them is so for any number of ranks.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn new(
        slab: &CandidateSlab<'_, D>,
        scale: f64,
        heights: &[f32],
        strong: f32,
        clear: f32,
    ) -> Result<Self> {
        let (dims, candidates, group) = (slab.dims, &slab.candidates, slab.comm());
        let samples = Volume::new(dims, &[]);
        let cells = Volume::new(dims.map(|n| n.div_ceil(CELL_SIZE)), &[]);
        let count = cells.dims.iter().product();
        let all = || candidates.iter().zip(heights.iter().map(|&h| f64::from(h)));
        let sure =
            |i: usize| (candidates[i].strength >= strong).then(|| [f64::from(heights[i]), 1.0]);
        let [high, sure] = slab.sums_by_layer("heights of ridges", sure)?;
        let high = high / sure.max(1.0);
        // What is weak and not high either is noise, and at the sides mirrored samples turn normals.
        let clear = || all().filter(|(c, _)| c.strength >= clear);
        let tell = clear().filter_map(|(c, height)| {
            let at = samples.coordinates(c.voxel.index());
            let inside = (0..D).all(|k| at[k] >= SIDE_MARGIN && at[k] + SIDE_MARGIN < dims[k]);
            let tells = inside && (c.strength >= strong || height >= MIN_HEIGHT_SHARE * high);
            tells.then(|| (c, height, cells.index(at.map(|i| i / CELL_SIZE))))
        });
        let slots = CellSlots::from_cells(count, tell.clone().map(|(_, _, cell)| cell));
        let ridges = |cell| CellRidges {
            cell,
            position_sum: [0.0; D],
            width_sums: [0.0; 2],
            strong_width_sums: [0.0; 2],
        };
        let mut ridges: Vec<CellRidges<D>> = slots.iter().map(ridges).collect();
        let layer: usize = cells.dims[..D - 1].iter().product();
        let own = slab.owned_layers();
        let own = own.start.div_ceil(CELL_SIZE) * layer..own.end.div_ceil(CELL_SIZE) * layer;
        let mut zone = Self {
            cells,
            flags: vec![0; count],
            owned_cells: own,
            share: 0.0,
            slots,
            tensors: vec![[[0.0; D]; D]; ridges.len()],
        };
        for (c, height, cell) in tell {
            let Some(slot) = zone.slots.slot(cell) else {
                continue;
            };
            let (cell, tensor) = (&mut ridges[slot], &mut zone.tensors[slot]);
            let width = [height, f64::from(c.strength)];
            cell.width_sums = [0, 1].map(|k: usize| cell.width_sums[k] + width[k]);
            if c.strength < strong {
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
        let ratio = |w: [f64; 2]| w[0] / w[1];
        let own = ridges
            .iter()
            .filter(|ridge| zone.owned_cells.contains(&ridge.cell));
        let sure_widths = own.map(|cell| cell.strong_width_sums);
        let ratios: Vec<f64> = sure_widths.filter(|w| w[1] > 0.0).map(ratio).collect();
        let Some(narrow) = select_nth("widths of ridges", ratios, |count| count / 4, group)? else {
            return Ok(zone);
        };
        // All may run in pairs. A strength is a curvature times HEIGHT scale^2.
        let usual = narrow.min((1.0 + MAX_SINGLE_VARIANCE / (scale * scale)) / HEIGHT_FACTOR);
        let wide_around = |i: usize| {
            let mut sum = [0.0; 2];
            for j in cells_around(&zone.cells, i, 1).filter_map(|j| zone.slots.slot(j)) {
                sum = [0, 1].map(|k: usize| sum[k] + ridges[j].width_sums[k]);
            }
            sum
        };
        let places: Vec<[f64; D]> = ridges.iter().map(|cell| cell.position_sum).collect();
        let beside = |slot: usize| {
            cells_around(&zone.cells, ridges[slot].cell, 1).filter_map(|cell| zone.slots.slot(cell))
        };
        let spread = normal_dispersion(&zone.tensors, &places, beside);
        let least = spread.iter().zip(&ridges).filter(|(s, _)| **s > 0.0);
        let least = least.filter(|(_, ridge)| zone.owned_cells.contains(&ridge.cell));
        let least = least.map(|(s, _)| *s).collect();
        let noise = select_nth("spreads of normals", least, |count| count / 10, group)?;
        let noise = noise.unwrap_or(0.0);
        let mixed = (NOISE_FACTOR * noise).clamp(DISPERSION_BOUNDS[0], DISPERSION_BOUNDS[1]);
        let flags: Vec<u8> = (0..ridges.len())
            .into_par_iter()
            .map(|i| {
                if ridges[i].width_sums[1] == 0.0 {
                    return 0;
                }
                let mixed = spread[i] > mixed;
                let wide =
                    usual > 0.0 && ratio(wide_around(ridges[i].cell)) > WIDE_VARIANCE_RATIO * usual;
                u8::from(mixed) * MIXED_NORMALS + u8::from(wide) * WIDE_RIDGES
            })
            .collect();
        for (i, flag) in flags.into_iter().enumerate().filter(|f| f.1 != 0) {
            let around: Vec<usize> =
                cells_around(&zone.cells, ridges[i].cell, DILATION_CELLS).collect();
            for j in around {
                zone.flags[j] |= flag;
            }
        }
        let own = &zone.flags[zone.owned_cells.clone()];
        let flagged = own.iter().filter(|&&flag| flag != 0).count() as u64;
        let [flagged] = slab.global_sums("ambiguous cells", [flagged])?;
        zone.share = flagged as f64 / zone.flags.len().max(1) as f64;
        Ok(zone)
    }

    /// Share of the image that is ambiguous.
    pub fn share(&self) -> f64 {
        self.share
    }

    /// Whether a sample is ambiguous.
    pub fn is_ambiguous(&self, at: [usize; D]) -> bool {
        self.flags[self.cell_of(at)] != 0
    }

    /// How many cells in a window's own part are ambiguous.
    pub fn count_within(&self, own: &WindowInterior) -> usize {
        let flags = own.in_cells(CELL_SIZE).layer_index_ranges(self.cells.dims);
        let flags = flags.flat_map(|cells| &self.flags[cells]);
        flags.filter(|&&flag| flag != 0).count()
    }

    pub(super) fn cell_of(&self, at: [usize; D]) -> usize {
        self.cells.index(at.map(|i| i / CELL_SIZE))
    }

    /// The tensor of normals of a cell and those around it.
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

/// The cells of a grid at most `reach` from one along each axis, itself among them.
pub fn cells_around<const D: usize>(
    grid: &Volume<'_, D>,
    cell: usize,
    reach: usize,
) -> impl Iterator<Item = usize> {
    let (at, dims) = (grid.coordinates(cell), grid.dims);
    let side = 2 * reach + 1;
    (0..side.pow(D as u32)).filter_map(move |number| {
        let mut rest = number;
        let near: [usize; D] = std::array::from_fn(|k| {
            let i = (at[k] + rest % side).wrapping_sub(reach);
            rest /= side;
            i
        });
        (0..D)
            .all(|k| near[k] < dims[k])
            .then(|| Volume::new(dims, &[]).index(near))
    })
}

/// The sum of a matrix's diagonal.
pub fn trace<const D: usize>(m: &SymmetricMatrix<D>) -> f64 {
    (0..D).map(|k| m[k][k]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn some_cells_are_numbered_in_their_order() {
        let some = [0, 1, 63, 64, 130, 191, 192, 259];
        let slots = CellSlots::from_cells(260, [192, 64, 0, 259, 63, 1, 130, 191, 64].into_iter());
        assert!(slots.iter().eq(some));
        for cell in 0..260 {
            assert_eq!(slots.slot(cell), some.iter().position(|&c| c == cell));
        }
    }
}

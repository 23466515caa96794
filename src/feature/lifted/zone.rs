//! Where one orientation a sample may not be all there is.

use super::median;
use super::spread::spread;
use crate::feature::crossing::Candidate;
use crate::feature::ridges::HEIGHT;
use crate::feature::symmetric::Symmetric;
use crate::feature::volume::Volume;
use rayon::prelude::*;

/// Samples along an edge of the cells that are ambiguous or not.
pub const CELL: usize = 4;
/// Cells on either side over which the ambiguous zone is widened.
const WIDEN: usize = 2;
/// Normals are mixed where their [`spread`] (sheets that cross at 15 degrees have 0.017) is as many times above what
/// noise leaves on a sheet: what a tenth of the cells stays below ...
const NOISE: f64 = 6.0;
/// ... but no less and no more than this.
const MIXED: [f64; 2] = [0.003, 0.009];
/// Ridges are too wide to be one where their squared width is this many times that of the narrow ones (of
/// which there are a quarter: where many run in pairs, half of all may be too wide).
const WIDE: f64 = 1.5;
/// The narrow ones have a squared width (samples) of at most this before smoothing, or are two each.
const SINGLE: f64 = 4.0;
/// A weak ridge of at least this share of the mean height of sure ones may be two side by side.
const HIGH: f64 = 0.8;
/// Nearer to a side of the box than this (samples) normals say nothing.
const SIDE: usize = 4;

/// Where one orientation a sample may not be all there is: normals are mixed, or a ridge is wider than
/// ridges are.
pub struct Ambiguous<const D: usize> {
    /// The cells, numbered as samples are.
    cells: Volume<'static, D>,
    /// Of each cell, why it is ambiguous: [`MIXED_NORMALS`], [`WIDE_RIDGES`].
    pub(super) flags: Vec<u8>,
    /// Sum over the candidates of each cell of the tensors of their normals.
    tensors: Vec<Symmetric<D>>,
}

/// Normals of different sheets meet.
pub const MIXED_NORMALS: u8 = 1;
/// Ridges are wider than one is.
pub const WIDE_RIDGES: u8 = 2;

impl<const D: usize> Ambiguous<D> {
    /// Judges ridge points of a smoothed image: normals by points of at least `strong`, and widths by those
    /// of at least `clear`, for a ridge too wide for its height is weak. `scale` is the width (samples) of the
    /// Gaussian that smoothed it.
    pub fn new(
        smoothed: Volume<'_, D>,
        scale: f64,
        candidates: &[Candidate<D>],
        strong: f32,
        clear: f32,
    ) -> Self {
        let dims = smoothed.dims;
        let cells = Volume::new(dims.map(|n| n.div_ceil(CELL)), &[]);
        let count = cells.dims.iter().product();
        let mut zone = Self {
            cells,
            flags: vec![0; count],
            tensors: vec![[[0.0; D]; D]; count],
        };
        let level = median(smoothed.samples.iter().copied().step_by(7));
        let height = |c: &Candidate<D>| f64::from(smoothed.samples[c.voxel as usize] - level);
        let sure = || candidates.iter().filter(|c| c.strength >= strong);
        let high = sure().map(height).sum::<f64>() / sure().count().max(1) as f64;
        let mut places = vec![[0.0; D]; count];
        // Height over curvature of a ridge is its squared width, and so is in other units height over strength.
        let (mut widths, mut sure_widths) = (vec![[0.0f64; 2]; count], vec![[0.0f64; 2]; count]);
        for c in candidates.iter().filter(|c| c.strength >= clear) {
            // What is weak and not high either is noise.
            if c.strength < strong && height(c) < HIGH * high {
                continue;
            }
            let at = smoothed.coordinates(c.voxel as usize);
            // At the sides mirrored samples turn normals.
            if (0..D).any(|k| at[k] < SIDE || at[k] + SIDE >= dims[k]) {
                continue;
            }
            let cell = zone.cell_of(at);
            let width = [height(c), f64::from(c.strength)];
            widths[cell] = [0, 1].map(|k: usize| widths[cell][k] + width[k]);
            if c.strength < strong {
                continue;
            }
            sure_widths[cell] = [0, 1].map(|k: usize| sure_widths[cell][k] + width[k]);
            for k in 0..D {
                places[cell][k] += f64::from(c.position[k]);
                for l in 0..D {
                    zone.tensors[cell][k][l] += f64::from(c.normal[k] * c.normal[l]);
                }
            }
        }
        let ratio = |w: &[f64; 2]| w[0] / w[1];
        let mut ratios: Vec<f64> = sure_widths
            .iter()
            .filter(|w| w[1] > 0.0)
            .map(ratio)
            .collect();
        if ratios.is_empty() {
            return zone;
        }
        let middle = ratios.len() / 4;
        let narrow = *ratios.select_nth_unstable_by(middle, f64::total_cmp).1;
        // All may run in pairs. A strength is a curvature times HEIGHT scale^2.
        let usual = narrow.min((1.0 + SINGLE / (scale * scale)) / HEIGHT);
        let wide_around = |i: usize| {
            let mut sum = [0.0; 2];
            for j in around(&zone.cells, i, 1) {
                sum = [0, 1].map(|k: usize| sum[k] + widths[j][k]);
            }
            sum
        };
        let spread = spread(&zone.cells, &zone.tensors, &places);
        let mut least: Vec<f64> = spread.iter().copied().filter(|s| *s > 0.0).collect();
        let tenth = least.len() / 10;
        let noise = match least.is_empty() {
            true => 0.0,
            false => *least.select_nth_unstable_by(tenth, f64::total_cmp).1,
        };
        let mixed = (NOISE * noise).clamp(MIXED[0], MIXED[1]);
        let flags: Vec<u8> = (0..count)
            .into_par_iter()
            .map(|i| {
                if widths[i][1] == 0.0 {
                    return 0;
                }
                let mixed = spread[i] > mixed;
                let wide = usual > 0.0 && ratio(&wide_around(i)) > WIDE * usual;
                u8::from(mixed) * MIXED_NORMALS + u8::from(wide) * WIDE_RIDGES
            })
            .collect();
        for (i, flag) in flags.into_iter().enumerate().filter(|f| f.1 != 0) {
            let around: Vec<usize> = around(&zone.cells, i, WIDEN).collect();
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

    pub(super) fn cell_of(&self, at: [usize; D]) -> usize {
        self.cells.index(at.map(|i| i / CELL))
    }

    /// The tensor of normals of a cell and those around it.
    pub(super) fn around(&self, cell: usize, reach: usize) -> Symmetric<D> {
        let mut sum = [[0.0; D]; D];
        for j in around(&self.cells, cell, reach) {
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
pub fn around<const D: usize>(
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
pub fn trace<const D: usize>(m: &Symmetric<D>) -> f64 {
    (0..D).map(|k| m[k][k]).sum()
}

//! Marks the samples that hold data and the gaps that are small enough to be bridged, and fills
//! gaps for filters that reach into them. Module `nulls` finds the samples that hold no data.

use super::Image;
use crate::error::Result;
use crate::geometry::NONE;
use crate::geometry::grid_index::{index_at, offset_of, strides};
use crate::memory;
use crate::parallel::prelude::*;

/// Largest distance, in samples, from live samples on all sides at which dead samples are bridged.
/// Gaps up to twice as wide are bridged.
const BRIDGE_RADIUS: usize = 3;

/// Largest distance, in samples, that filters reach into a gap.
const MAX_FILL_DISTANCE: usize = 64;

/// Memory, in bytes per sample, for finding and filling gaps.
const BYTES_PER_SAMPLE: f64 = 16.0;

impl<const D: usize> Image<D> {
    /// Returns the mask of the samples that hold data, or `None` if all samples do.
    ///
    /// # Errors
    /// Returns an [`Error::Job`](crate::Error::Job) if there is not enough memory.
    pub(crate) fn live_mask(&self) -> Result<Option<LiveMask<D>>> {
        let Some(gaps) = self.gaps() else {
            return Ok(None);
        };
        memory::ensure_available(
            "the image",
            BYTES_PER_SAMPLE * gaps.flags.len() as f64,
            "finding the gaps in the image",
            "give a part of the image",
        )?;
        Ok(Some(LiveMask::new(gaps)))
    }

    /// Returns the gaps in the image, or `None` if all samples hold data.
    pub(super) fn gaps(&self) -> Option<Gaps<D>> {
        if self.dead.is_empty() && self.missing.is_empty() {
            return None;
        }
        let mut dims = self.dims();
        let (uniform_axis, flags) = if self.dead.is_empty() {
            (Some(0), self.missing.clone())
        } else {
            self.collapse_dead()
        };
        let uniform_len = uniform_axis.map_or(1, |axis| std::mem::replace(&mut dims[axis], 1));
        Some(Gaps {
            dims,
            uniform_axis,
            uniform_len,
            flags,
        })
    }

    /// Returns the axis along which the dead flags are constant, if there is one, and the flags
    /// without that axis.
    fn collapse_dead(&self) -> (Option<usize>, Vec<bool>) {
        for axis in 1..D {
            let (length, stride) = (self.dims()[axis], strides(self.dims())[axis]);
            let blocks = self.dead.chunks(stride * length);
            let is_uniform =
                |block: &[bool]| block.chunks(stride).all(|layer| *layer == block[..stride]);
            if blocks.clone().all(is_uniform) {
                let flags = blocks.flat_map(|block| block[..stride].iter().copied());
                return (Some(axis), flags.collect());
            }
        }
        (None, self.dead.clone())
    }
}

/// The samples of an image that hold no data.
pub(super) struct Gaps<const D: usize> {
    /// Number of cells along each axis. A cell is a sample; along the axis with constant flags
    /// there is one cell.
    pub dims: [usize; D],
    /// The axis along which all samples are alike, if there is one.
    pub uniform_axis: Option<usize>,
    /// Number of samples along `uniform_axis`; 1 if there is none.
    pub uniform_len: usize,
    /// `true` for each cell that holds no data.
    pub flags: Vec<bool>,
}

/// State of a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
enum SampleState {
    Live,
    /// Dead, but in a gap that is small enough for detectors to bridge.
    Bridged,
    Dead,
}

/// The samples of an image that hold data, and the gaps that are small.
#[derive(Debug, Clone)]
pub(crate) struct LiveMask<const D: usize> {
    /// Number of cells along each axis. A cell is a sample; along the axis with constant flags
    /// there is one cell.
    dims: [usize; D],
    uniform_axis: Option<usize>,
    /// Number of samples along `uniform_axis`; 1 if there is none.
    uniform_len: usize,
    states: Vec<SampleState>,
    /// Nearest live cell of each cell; [`NONE`] if it is farther than [`MAX_FILL_DISTANCE`].
    nearest_live: Vec<u32>,
}

impl<const D: usize> LiveMask<D> {
    fn new(gaps: Gaps<D>) -> Self {
        let Gaps {
            dims,
            uniform_axis,
            uniform_len,
            flags: dead,
        } = gaps;
        let nearest_live = nearest_cells(dims, |i| !dead[i], MAX_FILL_DISTANCE);
        let is_within = |i: usize, other: u32| {
            other != NONE
                && distance_squared(dims, i, other as usize) <= BRIDGE_RADIUS * BRIDGE_RADIUS
        };
        let nearest_outside =
            self::nearest_cells(dims, |i| !is_within(i, nearest_live[i]), BRIDGE_RADIUS);
        let state = |i: usize| match (dead[i], is_within(i, nearest_outside[i])) {
            (false, _) => SampleState::Live,
            (true, false) => SampleState::Bridged,
            (true, true) => SampleState::Dead,
        };
        Self {
            dims,
            uniform_axis,
            uniform_len,
            states: (0..dead.len()).into_par_iter().map(state).collect(),
            nearest_live,
        }
    }

    /// Returns the mask of a grid of `dims` samples with `factors` samples in place of one along each axis. A
    /// sample between two others holds data if both do. The mask has no nearest live samples: it cannot
    /// [fill](Self::fill) gaps.
    pub fn refined(&self, dims: [usize; D], factors: [usize; D]) -> Self {
        let mut cell_dims = dims;
        if let Some(axis) = self.uniform_axis {
            cell_dims[axis] = 1;
        }
        let state = |i: usize| {
            let at = index_at(cell_dims, i);
            let mut state = SampleState::Live;
            for corner in 0..1usize << D {
                let near = std::array::from_fn(|k| {
                    let rounded_up = (corner >> k & 1) * (factors[k] - 1);
                    ((at[k] + rounded_up) / factors[k]).min(self.dims[k] - 1)
                });
                state = match (state, self.states[self.cell_index(near)]) {
                    (SampleState::Dead, _) | (_, SampleState::Dead) => SampleState::Dead,
                    (SampleState::Live, SampleState::Live) => SampleState::Live,
                    _ => SampleState::Bridged,
                };
            }
            state
        };
        let count: usize = cell_dims.iter().product();
        Self {
            dims: cell_dims,
            uniform_axis: self.uniform_axis,
            uniform_len: self.uniform_axis.map_or(1, |axis| dims[axis]),
            states: (0..count).into_par_iter().map(state).collect(),
            nearest_live: vec![NONE; count],
        }
    }

    fn cell_index(&self, mut at: [usize; D]) -> usize {
        if let Some(axis) = self.uniform_axis {
            at[axis] = 0;
        }
        offset_of(self.dims, at)
    }

    /// Returns `true` if the sample holds data.
    pub fn is_live(&self, at: [usize; D]) -> bool {
        self.states[self.cell_index(at)] == SampleState::Live
    }

    /// Returns a function that is `true` for the samples of a layer along the last axis that hold
    /// data. Its argument is the position of the sample within the layer, in memory order.
    pub fn layer_mask(&self, layer: usize) -> impl Fn(usize) -> bool + '_ {
        let mut first = [0; D];
        first[D - 1] = layer;
        let start = self.cell_index(first);
        let (uniform_axis, dims) = (self.uniform_axis, self.dims);
        let layer_len: usize = dims[..D - 1].iter().product();
        move |i| {
            let cell = match uniform_axis {
                Some(axis) if axis < D - 1 => {
                    // Removes the axis with constant flags from the position of the sample.
                    let stride = strides(dims)[axis];
                    i % stride + i / (stride * self.uniform_len) * stride
                }
                _ => i,
            };
            debug_assert!(cell < layer_len);
            self.states[start + cell] == SampleState::Live
        }
    }

    /// Returns `true` if features may lie at the sample: it holds data, or its gap is bridged.
    pub fn is_usable(&self, at: [usize; D]) -> bool {
        self.states[self.cell_index(at)] != SampleState::Dead
    }

    /// Returns the share of dead samples and the share of bridged samples.
    pub fn gap_shares(&self) -> [f64; 2] {
        [SampleState::Dead, SampleState::Bridged].map(|state| {
            let count = self.states.iter().filter(|s| **s == state).count();
            count as f64 / self.states.len().max(1) as f64
        })
    }

    /// Fills dead samples with the nearest live samples. If `bridge` is set, samples in bridged
    /// gaps are instead interpolated linearly along the axes between the live samples on both
    /// sides.
    pub fn fill(&self, dims: [usize; D], samples: &mut [f32], bridge: bool) {
        let cell_strides = strides(self.dims);
        let coordinates = |i: usize| index_at(self.dims, i);
        let index = |at: [usize; D]| offset_of(dims, at);
        let values: Vec<f64> = samples.iter().map(|s| f64::from(*s)).collect();
        let mean = {
            let is_live = |i: &usize| self.states[*i] == SampleState::Live;
            let live_values = (0..self.states.len())
                .filter(is_live)
                .map(|i| values[index(coordinates(i))]);
            let (count, sum) = live_values.fold((0usize, 0.0), |(n, sum), s| (n + 1, sum + s));
            sum / count.max(1) as f64
        };
        let uniform_len = self.uniform_len;
        let step = self.uniform_axis.map_or(0, |axis| strides(dims)[axis]);
        // The first samples of the cells from which a cell is filled, and their weights.
        let sources = |i: usize| -> Vec<(usize, f64)> {
            let at = coordinates(i);
            let mut weighted = Vec::new();
            if bridge && self.states[i] == SampleState::Bridged {
                for k in 0..D {
                    let is_live = |i: &usize| self.states[*i] == SampleState::Live;
                    let max_gap = 2 * BRIDGE_RADIUS + 1;
                    let before =
                        (1..=max_gap.min(at[k])).find(|n| is_live(&(i - n * cell_strides[k])));
                    let after = (self.dims[k] - 1 - at[k]).min(max_gap);
                    let after = (1..=after).find(|n| is_live(&(i + n * cell_strides[k])));
                    if let (Some(before), Some(after)) = (before, after) {
                        let gap = (before + after) as f64;
                        let [mut low, mut high] = [at; 2];
                        low[k] -= before;
                        high[k] += after;
                        let weight = 1.0 / (gap * gap * gap);
                        weighted.push((index(low), weight * after as f64));
                        weighted.push((index(high), weight * before as f64));
                    }
                }
            }
            if weighted.is_empty() && self.nearest_live[i] != NONE {
                weighted.push((index(coordinates(self.nearest_live[i] as usize)), 1.0));
            }
            weighted
        };
        for i in (0..self.states.len()).filter(|i| self.states[*i] != SampleState::Live) {
            let (start, sources) = (index(coordinates(i)), sources(i));
            let total: f64 = sources.iter().map(|(_, weight)| weight).sum();
            for n in 0..uniform_len {
                let weighted_value =
                    |(source, weight): &(usize, f64)| weight * values[source + n * step];
                samples[start + n * step] = if sources.is_empty() {
                    mean as f32
                } else {
                    (sources.iter().map(weighted_value).sum::<f64>() / total) as f32
                };
            }
        }
    }
}

/// Returns the squared distance between two cells.
pub(super) fn distance_squared<const D: usize>(dims: [usize; D], a: usize, b: usize) -> usize {
    let [a, b] = [a, b].map(|cell| index_at(dims, cell));
    (0..D).map(|k| a[k].abs_diff(b[k]).pow(2)).sum()
}

/// Returns for each cell the nearest cell that satisfies `is_target` and is at most `reach` away,
/// [`NONE`] if there is none. Each pass extends the search along one more axis: it chooses among
/// the nearest targets that the previous passes found for the cells of a line.
pub(super) fn nearest_cells<const D: usize>(
    dims: [usize; D],
    is_target: impl Fn(usize) -> bool + Sync,
    reach: usize,
) -> Vec<u32> {
    let count: usize = dims.iter().product();
    let initial = |i: usize| if is_target(i) { i as u32 } else { NONE };
    let mut nearest: Vec<u32> = (0..count).into_par_iter().map(initial).collect();
    let mut stride = 1;
    for n in dims {
        if n == 1 {
            continue;
        }
        let previous = nearest;
        let nearer = |i: usize| {
            let coordinate = i / stride % n;
            let mut best = previous[i];
            let mut min_squared = match best {
                NONE => reach.saturating_mul(reach).saturating_add(1),
                other => distance_squared(dims, i, other as usize),
            };
            for step in 1..n {
                if step * step >= min_squared {
                    break;
                }
                let back = (coordinate >= step).then(|| i - step * stride);
                let forth = (coordinate + step < n).then(|| i + step * stride);
                for other in [back, forth].into_iter().flatten().map(|i| previous[i]) {
                    if other != NONE {
                        let squared = distance_squared(dims, i, other as usize);
                        if squared < min_squared {
                            (min_squared, best) = (squared, other);
                        }
                    }
                }
            }
            best
        };
        nearest = (0..count).into_par_iter().map(nearer).collect();
        stride *= n;
    }
    nearest
}

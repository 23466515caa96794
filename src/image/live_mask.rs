//! Which samples hold data, which gaps are small enough to be bridged, and what fills gaps for filters that look
//! across them. `nulls` finds the samples that hold no data.

use super::Image;
use crate::error::Result;
use crate::memory;
use crate::parallel::prelude::*;

/// Dead samples within this distance (samples) of live ones on all sides are bridged: gaps up to twice as
/// wide.
const BRIDGE_RADIUS: usize = 3;

/// Filters look no farther than this (samples) into a gap.
const MAX_FILL_DISTANCE: usize = 64;

/// Bytes a sample that finding and filling gaps takes.
const BYTES_PER_SAMPLE: f64 = 16.0;

impl<const D: usize> Image<D> {
    /// Returns which samples hold data, or `None` if all do.
    ///
    /// # Errors
    /// [`Error::Job`](crate::Error::Job) if there is no memory for it.
    pub(crate) fn live_mask(&self) -> Result<Option<LiveMask<D>>> {
        let mut dims = self.dims();
        if self.dead.is_empty() && self.missing.is_empty() {
            return Ok(None);
        }
        let (alike, flags) = match self.dead.is_empty() {
            true => (Some(0), self.missing.clone()),
            false => self.collapse_dead(),
        };
        let depth = alike.map_or(1, |axis| std::mem::replace(&mut dims[axis], 1));
        memory::ensure_available(
            "the image",
            BYTES_PER_SAMPLE * flags.len() as f64,
            "finding the gaps in the image",
            "mesh a part of it",
        )?;
        Ok(Some(LiveMask::new((dims, alike, depth), &flags)))
    }

    /// Returns the axis along which dead samples are alike, if there is one, and the flags without it.
    fn collapse_dead(&self) -> (Option<usize>, Vec<bool>) {
        for axis in 1..D {
            let (length, stride) = (self.dims()[axis], self.stride(axis));
            let blocks = self.dead.chunks(stride * length);
            let alike =
                |block: &[bool]| block.chunks(stride).all(|layer| *layer == block[..stride]);
            if blocks.clone().all(alike) {
                let flags = blocks.flat_map(|block| block[..stride].iter().copied());
                return (Some(axis), flags.collect());
            }
        }
        (None, self.dead.clone())
    }
}

/// Whether a sample holds data.
#[derive(Debug, Clone, Copy, PartialEq)]
enum SampleState {
    Live,
    /// In a gap that is small enough for detectors to look across.
    Bridged,
    Dead,
}

/// Says which samples of an image hold data, and which gaps are small.
#[derive(Debug, Clone)]
pub(crate) struct LiveMask<const D: usize> {
    /// Cells along each axis: samples, but only one along the axis along which all are alike.
    dims: [usize; D],
    uniform_axis: Option<usize>,
    /// Samples along that axis.
    uniform_len: usize,
    states: Vec<SampleState>,
    /// For each cell the nearest live one, [`NO_CELL`] beyond [`MAX_FILL_DISTANCE`].
    nearest_live: Vec<u32>,
}

/// No cell.
const NO_CELL: u32 = u32::MAX;

impl<const D: usize> LiveMask<D> {
    fn new(
        (dims, uniform_axis, uniform_len): ([usize; D], Option<usize>, usize),
        dead: &[bool],
    ) -> Self {
        let nearest_live = nearest_cells(dims, |i| !dead[i], MAX_FILL_DISTANCE);
        let within = |i: usize, other: u32| {
            other != NO_CELL
                && distance_squared(dims, i, other as usize) <= BRIDGE_RADIUS * BRIDGE_RADIUS
        };
        let beyond = self::nearest_cells(dims, |i| !within(i, nearest_live[i]), BRIDGE_RADIUS);
        let state = |i: usize| match (dead[i], within(i, beyond[i])) {
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

    fn cell_index(&self, mut at: [usize; D]) -> usize {
        if let Some(axis) = self.uniform_axis {
            at[axis] = 0;
        }
        (0..D).rev().fold(0, |i, k| i * self.dims[k] + at[k])
    }

    /// Returns whether the sample holds data.
    pub fn is_live(&self, at: [usize; D]) -> bool {
        self.states[self.cell_index(at)] == SampleState::Live
    }

    /// Returns for a layer along the last axis which of its samples, in memory order, hold data.
    pub fn layer_mask(&self, layer: usize) -> impl Fn(usize) -> bool + '_ {
        let mut first = [0; D];
        first[D - 1] = layer;
        let start = self.cell_index(first);
        let (alike, dims) = (self.uniform_axis, self.dims);
        let size: usize = dims[..D - 1].iter().product();
        move |i| {
            let cell = match alike {
                Some(axis) if axis < D - 1 => {
                    // The cell of a sample without the axis along which all are alike.
                    let stride: usize = dims[..axis].iter().product();
                    i % stride + i / (stride * self.uniform_len) * stride
                }
                _ => i,
            };
            debug_assert!(cell < size);
            self.states[start + cell] == SampleState::Live
        }
    }

    /// Returns whether features may lie at the sample: it holds data, or its gap is bridged.
    pub fn is_usable(&self, at: [usize; D]) -> bool {
        self.states[self.cell_index(at)] != SampleState::Dead
    }

    /// Returns the shares of all samples that are dead, and that are bridged.
    pub fn gap_shares(&self) -> [f64; 2] {
        [SampleState::Dead, SampleState::Bridged].map(|state| {
            let count = self.states.iter().filter(|s| **s == state).count();
            count as f64 / self.states.len().max(1) as f64
        })
    }

    /// Fills dead samples with the nearest live ones; if `bridge` is set, in bridged gaps linearly between
    /// the live samples on either side along the axes.
    pub fn fill(&self, dims: [usize; D], samples: &mut [f32], bridge: bool) {
        let strides: [usize; D] = std::array::from_fn(|k| dims[..k].iter().product());
        let cell_strides: [usize; D] = std::array::from_fn(|k| self.dims[..k].iter().product());
        let coordinates = |mut i: usize| -> [usize; D] {
            self.dims.map(|n| {
                let at = i % n;
                i /= n;
                at
            })
        };
        let index = |at: [usize; D]| (0..D).map(|k| at[k] * strides[k]).sum::<usize>();
        let live: Vec<f64> = samples.iter().map(|s| f64::from(*s)).collect();
        let mean = {
            let of_live = |i: &usize| self.states[*i] == SampleState::Live;
            let starts = (0..self.states.len())
                .filter(of_live)
                .map(|i| live[index(coordinates(i))]);
            let (count, sum) = starts.fold((0usize, 0.0), |(n, sum), s| (n + 1, sum + s));
            sum / count.max(1) as f64
        };
        let depth = self.uniform_len;
        let step = self.uniform_axis.map_or(0, |axis| strides[axis]);
        // First samples of the cells that a cell is filled from, and their weights.
        let sources = |i: usize| -> Vec<(usize, f64)> {
            let at = coordinates(i);
            let mut found = Vec::new();
            if bridge && self.states[i] == SampleState::Bridged {
                for k in 0..D {
                    let live = |i: &usize| self.states[*i] == SampleState::Live;
                    let most = 2 * BRIDGE_RADIUS + 1;
                    let before = (1..=most.min(at[k])).find(|n| live(&(i - n * cell_strides[k])));
                    let after = (self.dims[k] - 1 - at[k]).min(most);
                    let after = (1..=after).find(|n| live(&(i + n * cell_strides[k])));
                    if let (Some(before), Some(after)) = (before, after) {
                        let gap = (before + after) as f64;
                        let [mut low, mut high] = [at; 2];
                        low[k] -= before;
                        high[k] += after;
                        let weight = 1.0 / (gap * gap * gap);
                        found.push((index(low), weight * after as f64));
                        found.push((index(high), weight * before as f64));
                    }
                }
            }
            if found.is_empty() && self.nearest_live[i] != NO_CELL {
                found.push((index(coordinates(self.nearest_live[i] as usize)), 1.0));
            }
            found
        };
        for i in (0..self.states.len()).filter(|i| self.states[*i] != SampleState::Live) {
            let (start, sources) = (index(coordinates(i)), sources(i));
            let total: f64 = sources.iter().map(|(_, weight)| weight).sum();
            for n in 0..depth {
                let from = |(source, weight): &(usize, f64)| weight * live[source + n * step];
                samples[start + n * step] = match sources.is_empty() {
                    true => mean as f32,
                    false => (sources.iter().map(from).sum::<f64>() / total) as f32,
                };
            }
        }
    }
}

/// Returns the square of the distance between two cells.
pub(super) fn distance_squared<const D: usize>(
    dims: [usize; D],
    mut a: usize,
    mut b: usize,
) -> usize {
    let mut sum = 0;
    for n in dims {
        sum += (a % n).abs_diff(b % n).pow(2);
        (a, b) = (a / n, b / n);
    }
    sum
}

/// Returns for each cell the nearest one that is wanted, if there is one within `reach`: axis by axis, each
/// time the nearest among those that are nearest so far.
pub(super) fn nearest_cells<const D: usize>(
    dims: [usize; D],
    wanted: impl Fn(usize) -> bool + Sync,
    reach: usize,
) -> Vec<u32> {
    let count: usize = dims.iter().product();
    let own = |i: usize| if wanted(i) { i as u32 } else { NO_CELL };
    let mut nearest: Vec<u32> = (0..count).into_par_iter().map(own).collect();
    let mut stride = 1;
    for n in dims {
        if n == 1 {
            continue;
        }
        let before = nearest;
        let nearer = |i: usize| {
            let at = i / stride % n;
            let mut best = before[i];
            let mut least = match best {
                NO_CELL => reach.saturating_mul(reach).saturating_add(1),
                other => distance_squared(dims, i, other as usize),
            };
            for step in 1..n {
                if step * step >= least {
                    break;
                }
                let back = (at >= step).then(|| i - step * stride);
                let forth = (at + step < n).then(|| i + step * stride);
                for other in [back, forth].into_iter().flatten().map(|i| before[i]) {
                    if other != NO_CELL {
                        let apart = distance_squared(dims, i, other as usize);
                        if apart < least {
                            (least, best) = (apart, other);
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

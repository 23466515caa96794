//! Reads samples of an image some layers at a time, unsmoothed and smoothed by Gaussians.
//!
//! Detectors look no farther than a number of samples. So a window of layers along the last axis,
//! with a *halo* of layers on either side, gives bitwise the same results as the whole image. A
//! small volume is one window, smoothed once. Of a larger one, which may still be in its file, only
//! the layers of the window are in memory; the window slides, so that every layer is read and
//! smoothed once per pass. Where layers are large and filters look far, windows go along one
//! *strip* of rows after another; a strip has a halo of rows on either side as well.
//!
//! - `layer_buffer`: layers in memory, and their smoothing while a window slides
//! - `strip`: rows and layers of windows
//! - `sizes`: sizes of windows and strips

mod layer_buffer;
mod sizes;
mod strip;
#[cfg(test)]
pub(crate) mod tests;

use super::gaussian;
use super::shared_grid::SharedGrid;
use super::volume::Volume;
use crate::error::Result;
use crate::files::codec::Codec;
use crate::image::ImageLayers;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use layer_buffer::{LayerBuffer, SmoothingStages, widen};
use sizes::{
    DEFAULT_LIMITS, MIN_WIDE_HALO_LAYERS, WHOLE_BYTES_PER_SAMPLE, WindowHalo, WindowLimits,
    has_memory,
};
use std::borrow::Cow;
use std::ops::Range;
use strip::{Strip, hull, split_layers, strip_windows};

pub use crate::image::layers::rows_per_layer;
pub use sizes::{LAYER_MULTIPLE, MAX_WHOLE_SAMPLES, min_mapped_samples, strip_layer_samples};
pub use strip::{CoveredLayers, WindowInterior};

/// The samples of a volume, and the Gaussians under which they are read.
pub struct Samples<'a, const D: usize> {
    /// The grid of the samples, whose layers ranks share.
    grid: SharedGrid<'a, D>,
    raw: SampleStore<'a, D>,
    /// Widths (samples) of the Gaussians that are applied one after the other.
    scales: Vec<f64>,
    /// The smoothed samples, if the volume is small.
    smoothed: Option<Vec<f32>>,
    limits: WindowLimits,
}

/// Storage of the samples.
enum SampleStore<'a, const D: usize> {
    InMemory(Cow<'a, [f32]>),
    /// Layers to read, and the factor (1 or -1) by which samples are multiplied.
    Layered(&'a dyn ImageLayers<D>, f32),
    /// Each rank holds some layers.
    Distributed(LayerBuffer),
}

/// Some layers of a volume, with their halo.
pub struct LayerWindow<'w, const D: usize> {
    /// Samples without smoothing.
    pub raw: LayerStack<'w, D>,
    /// Samples under the Gaussians of [`Samples::smooth`].
    pub smoothed: LayerStack<'w, D>,
    /// Samples under the separate Gaussian of the pass, if it has one.
    pub blurred: LayerStack<'w, D>,
    /// Number of samples of the whole volume along each axis.
    pub dims: [usize; D],
    /// Rows and layers of the volume to be processed in this window: all rows, unless it is in a
    /// strip.
    pub interior: WindowInterior,
}

/// Layers of a volume: the interior of a window and its halo.
#[derive(Clone, Copy)]
pub struct LayerStack<'w, const D: usize> {
    pub volume: Volume<'w, D>,
    /// The volume's sample at which these layers begin.
    origin: [usize; D],
}

impl<'w, const D: usize> LayerStack<'w, D> {
    /// Returns other samples in the place of these layers.
    pub fn with_samples<'s>(&self, samples: &'s [f32]) -> LayerStack<'s, D> {
        LayerStack {
            volume: Volume::new(self.volume.dims, samples),
            origin: self.origin,
        }
    }

    /// Converts coordinates in this stack to coordinates in the volume.
    #[inline]
    pub fn to_volume(self, at: [usize; D]) -> [usize; D] {
        std::array::from_fn(|k| at[k] + self.origin[k])
    }

    /// Converts coordinates in the volume to coordinates in this stack.
    #[inline]
    pub fn to_stack(self, at: [usize; D]) -> [usize; D] {
        std::array::from_fn(|k| at[k] - self.origin[k])
    }

    /// Returns the value at a sample of the volume.
    #[inline]
    pub fn value_at(&self, at: [usize; D]) -> f32 {
        self.volume.samples[self.volume.index(self.to_stack(at))]
    }

    /// Returns the samples of some layers of the volume, as far as their rows are in this stack.
    pub fn layers(&self, layers: &Range<usize>) -> &'w [f32] {
        let (layer, first_layer) = (layer_len(self.volume.dims), self.origin[D - 1]);
        &self.volume.samples
            [(layers.start - first_layer) * layer..(layers.end - first_layer) * layer]
    }

    /// Returns the interior rows of each interior layer.
    fn interior_rows(&self, interior: &WindowInterior) -> impl Iterator<Item = &'w [f32]> {
        // In the plane a layer is one row, and both offsets are along the same axis.
        let shift_down =
            |range: &Range<usize>, offset: usize| range.start - offset..range.end - offset;
        let relative = WindowInterior {
            rows: shift_down(&interior.rows, self.origin[D - 2]),
            layers: shift_down(&interior.layers, self.origin[D - 1]),
        };
        let samples = self.volume.samples;
        let ranges = relative.layer_index_ranges(self.volume.dims);
        ranges.map(move |range| &samples[range])
    }
}

impl<const D: usize> LayerWindow<'_, D> {
    /// Collects what `visit` finds in each interior row of x, given its first sample in the
    /// smoothed stack; see [`Volume::map_rows`]. The window must not be in a strip.
    pub fn map_rows<S: Default, T: Send>(
        &self,
        cancel: &CancelToken<'_>,
        visit: impl Fn([usize; D], &mut S, &mut Vec<T>) + Sync,
    ) -> Vec<T> {
        let rows = rows_per_layer(self.dims);
        let (first, layers) = (self.smoothed.origin[D - 1], &self.interior.layers);
        let own_rows = (layers.start - first) * rows..(layers.end - first) * rows;
        self.smoothed
            .volume
            .map_selected_rows(own_rows, cancel, visit)
    }
}

/// Returns the number of samples of a layer along the last axis.
pub fn layer_len<const D: usize>(dims: [usize; D]) -> usize {
    dims[..D - 1].iter().product()
}

impl<'a, const D: usize> Samples<'a, D> {
    /// Wraps the samples of a volume in memory.
    pub fn in_memory(dims: [usize; D], samples: impl Into<Cow<'a, [f32]>>) -> Self {
        Self {
            grid: SharedGrid::of_one_process(dims),
            raw: SampleStore::InMemory(samples.into()),
            scales: Vec::new(),
            smoothed: None,
            limits: DEFAULT_LIMITS,
        }
    }

    /// Wraps a volume that is read layer by layer; each sample is multiplied by `sign`.
    pub fn from_layers(layers: &'a dyn ImageLayers<D>, sign: f32) -> Self {
        Self {
            grid: SharedGrid::of_one_process(layers.dims()),
            raw: SampleStore::Layered(layers, sign),
            scales: Vec::new(),
            smoothed: None,
            limits: DEFAULT_LIMITS,
        }
    }

    /// Shares the work on windows among the ranks of `grid`, which all have these samples.
    pub fn with_grid(self, grid: SharedGrid<'a, D>) -> Self {
        Self { grid, ..self }
    }

    /// Loads the samples into memory if the volume is small and there is enough memory to process
    /// it as a whole.
    ///
    /// # Errors
    /// Returns the errors of reading.
    pub fn load_if_small(self) -> Result<Self> {
        match self.raw {
            SampleStore::Layered(layers, sign)
                if !self.grid.is_shared()
                    && self.count() <= self.limits.max_whole
                    && has_memory(WHOLE_BYTES_PER_SAMPLE * self.count() as f64) =>
            {
                let mut samples = vec![0.0; self.count()];
                layers.read_layers(0, &mut samples)?;
                samples.iter_mut().for_each(|s| *s *= sign);
                Ok(Self {
                    raw: SampleStore::InMemory(Cow::Owned(samples)),
                    ..self
                })
            }
            _ => Ok(self),
        }
    }

    /// Returns n, where one in n windows of a large volume is enough for statistics.
    pub fn window_stride(&self) -> usize {
        self.count().div_ceil(MAX_WHOLE_SAMPLES)
    }

    /// Sets the largest number of samples that are smoothed as a whole, and the number of samples
    /// of a window.
    #[cfg(test)]
    pub fn with_limits(self, [max_whole, window]: [usize; 2]) -> Self {
        let limits = WindowLimits {
            max_whole,
            window,
            ..self.limits
        };
        Self { limits, ..self }
    }

    /// Forces strips of about `strip` samples per layer, and limits the samples of a window with
    /// its halo in [`Samples::map_windows`].
    #[cfg(test)]
    pub fn with_strips(self, strip: usize, max_with_halo: usize) -> Self {
        let limits = WindowLimits {
            large_layer: 0,
            strip,
            max_with_halo,
            ..self.limits
        };
        Self { limits, ..self }
    }

    /// Returns the number of samples along each axis.
    pub fn dims(&self) -> [usize; D] {
        self.grid.dims
    }

    fn count(&self) -> usize {
        self.grid.dims.iter().product()
    }

    /// Returns n, where one in n samples is enough for statistics; larger for large volumes.
    pub fn sample_stride(&self) -> usize {
        7 * (self.count().div_ceil(MAX_WHOLE_SAMPLES) | 1)
    }

    /// Returns `true` if the volume is in memory and small.
    fn is_small(&self) -> bool {
        !matches!(self.raw, SampleStore::Layered(..)) && self.count() <= self.limits.max_whole
    }

    /// Returns the unsmoothed samples of a volume in memory.
    #[cfg(test)]
    pub fn as_slice(&self) -> &[f32] {
        match &self.raw {
            SampleStore::InMemory(samples) => samples,
            _ => &[],
        }
    }

    /// Adds a Gaussian of width `scale` samples to those under which samples are read.
    pub fn smooth(&mut self, scale: f64, cancel: &CancelToken<'_>) {
        self.scales.push(scale);
        if let (SampleStore::InMemory(raw), true) = (&self.raw, self.is_small()) {
            match &mut self.smoothed {
                Some(samples) => gaussian::smooth(self.grid.dims, samples, [scale; D], cancel),
                None => {
                    let samples = self.smoothed.insert(vec![0.0; raw.len()]);
                    gaussian::smooth_into(self.grid.dims, raw, samples, [scale; D], cancel);
                }
            }
        }
    }

    /// Calls `work` for one window after the other, and `take` with the results, in order; ranks
    /// share the windows. `work_of` returns the amount of work in a window's interior; windows
    /// without work are skipped.
    ///
    /// Each window has a halo on either side, as far as there are layers: `halo` layers of smoothed
    /// samples. If `blur` is (width, reach), unsmoothed samples and samples under a Gaussian of
    /// this width have `reach` layers, and windows may be in strips, with a halo of as many rows.
    ///
    /// # Errors
    /// Returns the errors of reading, and those of other ranks.
    pub fn for_each_window<T: Codec>(
        &self,
        halo: usize,
        blur: Option<(f64, usize)>,
        work_of: &dyn Fn(&WindowInterior) -> usize,
        cancel: &CancelToken<'_>,
        work: &mut dyn FnMut(&LayerWindow<'_, D>) -> T,
        take: &mut dyn FnMut(T),
    ) -> Result<()> {
        let window_halo = WindowHalo { halo, blur };
        let (strips, windows) = self.windows(window_halo, &(0..self.grid.dims[D - 1]))?;
        let windows = windows
            .into_iter()
            .map(|interior| (work_of(&interior), interior));
        let (weights, windows): (Vec<usize>, Vec<WindowInterior>) =
            windows.filter(|(weight, _)| *weight > 0).unzip();
        let visit_share = |share: Range<usize>, emit: &mut dyn FnMut(T)| {
            let emit = &mut |window: &LayerWindow<'_, D>| emit(work(window));
            self.visit_windows(&strips, &windows[share], window_halo, cancel, emit)
        };
        self.grid.visit_shares(&weights, visit_share, take)
    }

    /// Calls `work` for one window after the other of the layers that this rank owns; see
    /// [`Samples::for_each_window`].
    ///
    /// # Errors
    /// Returns the errors of reading.
    pub fn for_each_window_in(
        &self,
        owned: &Range<usize>,
        halo: usize,
        blur: Option<(f64, usize)>,
        work_of: &dyn Fn(&WindowInterior) -> usize,
        cancel: &CancelToken<'_>,
        work: &mut dyn FnMut(&LayerWindow<'_, D>),
    ) -> Result<()> {
        let window_halo = WindowHalo { halo, blur };
        let (strips, windows) = self.windows(window_halo, owned)?;
        let windows: Vec<WindowInterior> = windows
            .into_iter()
            .filter(|interior| work_of(interior) > 0)
            .collect();
        self.visit_windows(&strips, &windows, window_halo, cancel, work)
    }

    /// Returns the windows that cover some layers, in the order of their strips, and the strips.
    fn windows(
        &self,
        window_halo: WindowHalo,
        owned: &Range<usize>,
    ) -> Result<(Vec<Strip<D>>, Vec<WindowInterior>)> {
        let strips = self.strips(window_halo);
        let strip_layer_len = strips.iter().map(Strip::layer_len).max();
        let [min_layers, max_whole] = match window_halo.blur {
            Some(_) => [MIN_WIDE_HALO_LAYERS, 4 * self.limits.window],
            None => [LAYER_MULTIPLE, self.limits.max_whole],
        };
        let layers_per_window =
            if self.is_small() && !self.grid.is_shared() && self.count() <= max_whole {
                owned.len()
            } else {
                self.interior_layers(min_layers, strip_layer_len.unwrap_or_default())?
            };
        let ranges = || split_layers(owned.len(), layers_per_window).into_iter();
        let shifted_ranges =
            || ranges().map(|layers| owned.start + layers.start..owned.start + layers.end);
        let windows = strips
            .iter()
            .flat_map(|strip| strip_windows(&strip.interior_rows, shifted_ranges().collect()));
        let windows = windows.collect();
        Ok((strips, windows))
    }

    /// Applies `change` to all smoothed samples, window by window, with a halo of `reach` layers
    /// and rows; each rank gets a share of the result.
    ///
    /// # Errors
    /// Returns the errors of [`Samples::for_each_window`].
    pub fn map_windows(
        &self,
        reach: usize,
        cancel: &CancelToken<'_>,
        change: impl Fn(LayerStack<'_, D>) -> Vec<f32>,
    ) -> Result<Samples<'a, D>> {
        let window_halo = WindowHalo {
            halo: reach,
            blur: None,
        };
        let [own_rows, own_layers] = self.mapped_interior(window_halo)?;
        let all_layers = split_layers(self.grid.dims[D - 1], own_layers);
        let strips = self.strips_with_rows(own_rows, window_halo);
        let layer = layer_len(self.grid.dims);
        let mut share = LayerBuffer::default();
        let work = |indices: Range<usize>| {
            let ranges = &all_layers[indices];
            share.range = hull(ranges);
            let share_start = share.range.start * layer;
            let windows = strips
                .iter()
                .flat_map(|strip| strip_windows(&strip.interior_rows, ranges.to_vec()));
            let windows: Vec<WindowInterior> = windows.collect();
            let store = &mut |window: &LayerWindow<'_, D>| {
                let (stack, interior) = (window.smoothed, &window.interior);
                let changed = change(stack);
                let mut share_dims = self.grid.dims;
                share_dims[D - 1] = share.range.len();
                if interior.layers == share.range && stack.volume.dims == share_dims {
                    // The window is the whole share.
                    share.samples = changed;
                    return;
                }
                share.samples.resize(share.range.len() * layer, 0.0);
                for (target, rows) in interior
                    .layer_index_ranges(self.grid.dims)
                    .zip(stack.with_samples(&changed).interior_rows(interior))
                {
                    share.samples[target.start - share_start..target.end - share_start]
                        .copy_from_slice(rows);
                }
            };
            self.visit_windows(&strips, &windows, window_halo, cancel, store)?;
            // Samples are missing only if the search was cancelled.
            share.samples.resize(share.range.len() * layer, 0.0);
            Ok(())
        };
        self.grid.compute_share(all_layers.len(), work)?;
        Ok(Samples {
            grid: self.grid,
            raw: if self.grid.is_shared() {
                SampleStore::Distributed(share)
            } else {
                SampleStore::InMemory(share.samples.into())
            },
            scales: Vec::new(),
            smoothed: None,
            limits: self.limits,
        })
    }

    /// Returns the widths of the Gaussians that have not been applied to the samples in memory.
    fn pending_scales(&self) -> &[f64] {
        match self.smoothed {
            Some(_) => &[],
            None => &self.scales,
        }
    }

    /// Calls `work` for these windows, which are in the order of the strips.
    fn visit_windows(
        &self,
        strips: &[Strip<D>],
        windows: &[WindowInterior],
        window_halo: WindowHalo,
        cancel: &CancelToken<'_>,
        work: &mut dyn FnMut(&LayerWindow<'_, D>),
    ) -> Result<()> {
        let (blurs, scales) = (window_halo.blurs(), self.pending_scales());
        let mut buffers = StripBuffers {
            raw: LayerBuffer::default(),
            smoothed: SmoothingStages::new(scales),
            blurred: SmoothingStages::new(&blurs),
        };
        for strip in strips {
            let first =
                windows.partition_point(|interior| interior.rows.start < strip.interior_rows.start);
            let end =
                windows.partition_point(|interior| interior.rows.start < strip.interior_rows.end);
            self.visit_strip(
                strip,
                &windows[first..end],
                window_halo,
                &mut buffers,
                cancel,
                work,
            )?;
        }
        Ok(())
    }

    /// Calls `work` for the windows of one strip.
    fn visit_strip(
        &self,
        strip: &Strip<D>,
        windows: &[WindowInterior],
        window_halo: WindowHalo,
        StripBuffers {
            raw,
            smoothed,
            blurred,
        }: &mut StripBuffers,
        cancel: &CancelToken<'_>,
        work: &mut dyn FnMut(&LayerWindow<'_, D>),
    ) -> Result<()> {
        let (dims, layer, count) = (strip.dims(), strip.layer_len(), self.grid.dims[D - 1]);
        let halos = [window_halo.halo, window_halo.blurred_halo()];
        let reach = (halos[0] + smoothed.reach()).max(halos[1] + blurred.reach());
        raw.range = 0..0;
        smoothed.clear();
        blurred.clear();
        if let SampleStore::Distributed(share) = &self.raw {
            let visible = match windows {
                [] => 0..0,
                [first, ..] => {
                    let end = windows[windows.len() - 1].layers.end;
                    widen(&(first.layers.start..end), reach, count)
                }
            };
            let rows_of = |layers| strip.strip_rows(share.layers(layers, strip.volume_layer_len()));
            raw.samples = (self.grid).fetch_layers(&share.range, &visible, rows_of)?;
            raw.range = visible;
        }
        for interior in windows {
            if cancel.is_cancelled() {
                break;
            }
            self.load_layers(raw, widen(&interior.layers, reach, count), strip)?;
            let raw = |range: Range<usize>| match &self.raw {
                SampleStore::InMemory(samples) if strip.is_entire() => {
                    &samples[range.start * layer..range.end * layer]
                }
                _ => raw.layers(range, layer),
            };
            let [range, wide_range] = halos.map(|halo| widen(&interior.layers, halo, count));
            smoothed.slide(&range, dims, &raw, cancel)?;
            blurred.slide(&wide_range, dims, &raw, cancel)?;
            let stack = |samples, layers: &Range<usize>| {
                let (mut dims, mut origin) = (dims, [0; D]);
                dims[D - 1] = layers.len();
                origin[D - 2] = strip.visible_rows.start;
                origin[D - 1] = layers.start;
                LayerStack {
                    volume: Volume::new(dims, samples),
                    origin,
                }
            };
            let raw_stack = stack(raw(wide_range.clone()), &wide_range);
            let smoothed_volume = self.smoothed.as_deref();
            let smoothed_layers =
                smoothed_volume.map(|samples| &samples[range.start * layer..range.end * layer]);
            work(&LayerWindow {
                raw: raw_stack,
                smoothed: match smoothed_layers.or_else(|| smoothed.layers(&range, layer)) {
                    Some(samples) => stack(samples, &range),
                    None => stack(raw(range.clone()), &range),
                },
                blurred: match blurred.layers(&wide_range, layer) {
                    Some(samples) => stack(samples, &wide_range),
                    None => raw_stack,
                },
                dims: self.grid.dims,
                interior: interior.clone(),
            });
        }
        Ok(())
    }

    /// Loads the visible layers of a strip that are not in the buffer, unless the strip's samples are
    /// in memory as they are.
    fn load_layers(
        &self,
        raw: &mut LayerBuffer,
        visible: Range<usize>,
        strip: &Strip<D>,
    ) -> Result<()> {
        let layer = strip.layer_len();
        match &self.raw {
            SampleStore::Layered(layers, sign) => raw.slide(visible, layer, |new, out| {
                layers.read_rows(new.start, strip.visible_rows.clone(), out)?;
                if *sign != 1.0 {
                    out.par_iter_mut().for_each(|s| *s *= sign);
                }
                Ok(())
            }),
            SampleStore::InMemory(samples) if !strip.is_entire() => {
                raw.slide(visible, layer, |new, out| {
                    let volume_layer = strip.volume_layer_len();
                    let parts = strip
                        .strip_rows(&samples[new.start * volume_layer..new.end * volume_layer]);
                    let out = out.chunks_exact_mut(layer);
                    out.zip(parts)
                        .for_each(|(out, part)| out.copy_from_slice(part));
                    Ok(())
                })
            }
            SampleStore::InMemory(_) | SampleStore::Distributed(_) => Ok(()),
        }
    }
}

/// Buffers of the current strip.
struct StripBuffers {
    raw: LayerBuffer,
    smoothed: SmoothingStages,
    blurred: SmoothingStages,
}

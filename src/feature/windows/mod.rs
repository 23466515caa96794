//! Samples looked at some layers at a time, as they are and under Gaussians.
//!
//! What is looked for in a volume sees no farther than a few samples, so that a stack of layers along the
//! last axis with a *halo* of layers to either side shows all that the whole would, bit for bit. A volume
//! that is not large is one window, smoothed once. Of a larger one, which may be in its file still, only
//! the window's layers are held; windows slide, so that every layer is read and smoothed once a pass.
//! Where layers are large, and what is looked for sees far, windows go along one *strip* of their rows after
//! another, which has a halo of rows to either side as well.
//!
//! - `held`: layers that are held, and what is made of them as a window moves on
//! - `strip`: which samples a window is for
//! - `sizes`: how many

mod layer_buffer;
mod sizes;
mod strip;
#[cfg(test)]
pub(crate) mod tests;

use super::gaussian;
use super::volume::Volume;
use crate::comm::{self, WorldComm};
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

/// Samples of a volume.
pub struct Samples<'a, const D: usize> {
    dims: [usize; D],
    raw: SampleStore<'a, D>,
    /// Widths (samples) of the Gaussians under which they are looked at, one after the other.
    scales: Vec<f64>,
    /// Under these, if the volume is not large.
    smoothed: Option<Vec<f32>>,
    limits: WindowLimits,
}

/// Where samples are.
enum SampleStore<'a, const D: usize> {
    InMemory(Cow<'a, [f32]>),
    /// With the sign that they are taken with.
    Layered(&'a dyn ImageLayers<D>, f32),
    /// Each rank has some layers.
    Distributed(LayerBuffer),
}

/// Some layers of a volume.
pub struct LayerWindow<'w, const D: usize> {
    /// The samples as they are.
    pub raw: LayerStack<'w, D>,
    /// Under the Gaussians.
    pub smoothed: LayerStack<'w, D>,
    /// Under another one.
    pub blurred: LayerStack<'w, D>,
    /// Samples of the whole volume along each axis.
    pub dims: [usize; D],
    /// What it is for, numbered as in the volume: all rows, unless it is in a strip.
    pub interior: WindowInterior,
}

/// Layers of a volume: a window's own, and others to either side.
#[derive(Clone, Copy)]
pub struct LayerStack<'w, const D: usize> {
    pub volume: Volume<'w, D>,
    /// The sample of the volume with which these begin.
    origin: [usize; D],
}

impl<'w, const D: usize> LayerStack<'w, D> {
    /// Other samples of the same layers.
    pub fn with_samples<'s>(&self, samples: &'s [f32]) -> LayerStack<'s, D> {
        LayerStack {
            volume: Volume::new(self.volume.dims, samples),
            origin: self.origin,
        }
    }

    /// A sample of these as one of the volume.
    #[inline]
    pub fn to_volume(&self, at: [usize; D]) -> [usize; D] {
        std::array::from_fn(|k| at[k] + self.origin[k])
    }

    /// A sample of the volume as one of these.
    #[inline]
    pub fn to_stack(&self, at: [usize; D]) -> [usize; D] {
        std::array::from_fn(|k| at[k] - self.origin[k])
    }

    /// The value at a sample of the volume.
    #[inline]
    pub fn value_at(&self, at: [usize; D]) -> f32 {
        self.volume.samples[self.volume.index(self.to_stack(at))]
    }

    /// Some layers of the volume: their rows that are among these.
    pub fn layers(&self, layers: &Range<usize>) -> &'w [f32] {
        let (layer, from) = (layer_len(self.volume.dims), self.origin[D - 1]);
        &self.volume.samples[(layers.start - from) * layer..(layers.end - from) * layer]
    }

    /// The rows of each layer that are a window's own.
    fn interior_rows(&self, own: &WindowInterior) -> impl Iterator<Item = &'w [f32]> {
        // In the plane, where a layer is one row, all begin with it.
        let less = |range: &Range<usize>, by: usize| range.start - by..range.end - by;
        let own = WindowInterior {
            rows: less(&own.rows, self.origin[D - 2]),
            layers: less(&own.layers, self.origin[D - 1]),
        };
        let samples = self.volume.samples;
        let of_each = own.layer_index_ranges(self.volume.dims);
        of_each.map(move |range| &samples[range])
    }
}

impl<const D: usize> LayerWindow<'_, D> {
    /// What `visit` finds in each of the own rows of x, given its first sample among the smoothed ones;
    /// see [`Volume::map_rows`]. The window must not be in a strip.
    pub fn map_rows<S: Default, T: Send>(
        &self,
        patience: &CancelToken<'_>,
        visit: impl Fn([usize; D], &mut S, &mut Vec<T>) + Sync,
    ) -> Vec<T> {
        let rows = rows_per_layer(self.dims);
        let (first, own) = (self.smoothed.origin[D - 1], &self.interior.layers);
        let own = (own.start - first) * rows..(own.end - first) * rows;
        self.smoothed.volume.map_selected_rows(own, patience, visit)
    }
}

/// Samples of a layer along the last axis.
pub fn layer_len<const D: usize>(dims: [usize; D]) -> usize {
    dims[..D - 1].iter().product()
}

impl<'a, const D: usize> Samples<'a, D> {
    /// Of a volume in memory.
    pub fn in_memory(dims: [usize; D], samples: impl Into<Cow<'a, [f32]>>) -> Self {
        Self {
            dims,
            raw: SampleStore::InMemory(samples.into()),
            scales: Vec::new(),
            smoothed: None,
            limits: DEFAULT_LIMITS,
        }
    }

    /// Of a volume that is somewhere else, each sample times `sign`.
    pub fn from_layers(layers: &'a dyn ImageLayers<D>, sign: f32) -> Self {
        Self {
            dims: layers.dims(),
            raw: SampleStore::Layered(layers, sign),
            scales: Vec::new(),
            smoothed: None,
            limits: DEFAULT_LIMITS,
        }
    }

    /// In memory, if it is not large and there is room for it and what is made of it.
    ///
    /// # Errors
    /// That of reading.
    pub fn load_if_small(self) -> Result<Self> {
        match self.raw {
            SampleStore::Layered(layers, sign)
                if comm::size() == 1
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

    /// The share of the windows of a large volume that tell enough, as one in so many.
    pub fn window_stride(&self) -> usize {
        self.count().div_ceil(MAX_WHOLE_SAMPLES)
    }

    /// With other limits: most samples that are smoothed as a whole, and samples of a window.
    #[cfg(test)]
    pub fn with_limits(self, [whole, window]: [usize; 2]) -> Self {
        let limits = WindowLimits {
            max_whole: whole,
            window,
            ..self.limits
        };
        Self { limits, ..self }
    }

    /// In strips, where halos are wide: of about so many samples of a layer; and of windows that see no more than so many
    /// samples, where they are changed.
    #[cfg(test)]
    pub fn with_strips(self, strip: usize, seen: usize) -> Self {
        let limits = WindowLimits {
            large_layer: 0,
            strip,
            max_with_halo: seen,
            ..self.limits
        };
        Self { limits, ..self }
    }

    /// Samples along each axis.
    pub fn dims(&self) -> [usize; D] {
        self.dims
    }

    fn count(&self) -> usize {
        self.dims.iter().product()
    }

    /// Every how many samples one is looked at where not all need be: of large volumes fewer.
    pub fn sample_stride(&self) -> usize {
        7 * (self.count().div_ceil(MAX_WHOLE_SAMPLES) | 1)
    }

    /// Whether it is in memory, and not large.
    fn is_small(&self) -> bool {
        !matches!(self.raw, SampleStore::Layered(..)) && self.count() <= self.limits.max_whole
    }

    /// All samples as they are, of a volume in memory.
    #[cfg(test)]
    pub fn as_slice(&self) -> &[f32] {
        match &self.raw {
            SampleStore::InMemory(all) => all,
            _ => &[],
        }
    }

    /// From now on under one Gaussian more.
    pub fn smooth(&mut self, scale: f64, patience: &CancelToken<'_>) {
        self.scales.push(scale);
        if let (SampleStore::InMemory(raw), true) = (&self.raw, self.is_small()) {
            match &mut self.smoothed {
                Some(samples) => gaussian::smooth(self.dims, samples, [scale; D], patience),
                None => {
                    let samples = self.smoothed.insert(vec![0.0; raw.len()]);
                    gaussian::smooth_into(self.dims, raw, samples, [scale; D], patience);
                }
            }
        }
    }

    /// Takes what `work` gives for one window after the other; ranks share them. `much` says how much work there is
    /// in a window's own part: those in which there is none are left out. Each has so many layers to either side,
    /// as far as there are any: under the Gaussians `halo`, and as they are and under a Gaussian of width `blur` as
    /// many as that says. With a `blur` windows may be in strips, with as many rows to either side.
    ///
    /// # Errors
    /// That of reading, and those of [`comm::min_strength_share`].
    pub fn for_each_window<T: Codec>(
        &self,
        halo: usize,
        blur: Option<(f64, usize)>,
        much: &dyn Fn(&WindowInterior) -> usize,
        patience: &CancelToken<'_>,
        work: &mut dyn FnMut(&LayerWindow<'_, D>) -> T,
        take: &mut dyn FnMut(T),
    ) -> Result<()> {
        let looks = WindowHalo { halo, blur };
        let (strips, windows) = self.windows(looks, &(0..self.dims[D - 1]))?;
        let windows = windows.into_iter().map(|own| (much(&own), own));
        let (work_in, windows): (Vec<usize>, Vec<WindowInterior>) =
            windows.filter(|(much, _)| *much > 0).unzip();
        let these = |mine: Range<usize>, give: &mut dyn FnMut(T)| {
            let give = &mut |window: &LayerWindow<'_, D>| give(work(window));
            self.visit_windows(&strips, &windows[mine], looks, patience, give)
        };
        comm::distribute_weighted("layers", &work_in, these, take)
    }

    /// Calls `work` for one window of these layers after the other, which are this rank's; else as [`Samples::for_each_window`].
    ///
    /// # Errors
    /// That of reading.
    pub fn for_each_window_in(
        &self,
        own: &Range<usize>,
        halo: usize,
        blur: Option<(f64, usize)>,
        much: &dyn Fn(&WindowInterior) -> usize,
        patience: &CancelToken<'_>,
        work: &mut dyn FnMut(&LayerWindow<'_, D>),
    ) -> Result<()> {
        let looks = WindowHalo { halo, blur };
        let (strips, windows) = self.windows(looks, own)?;
        let windows: Vec<WindowInterior> =
            windows.into_iter().filter(|own| much(own) > 0).collect();
        self.visit_windows(&strips, &windows, looks, patience, work)
    }

    /// The windows in which all samples of some layers are looked at, in the order of their strips.
    fn windows(
        &self,
        looks: WindowHalo,
        own: &Range<usize>,
    ) -> Result<(Vec<Strip<D>>, Vec<WindowInterior>)> {
        let strips = self.strips(looks);
        let seen = strips.iter().map(Strip::layer_len).max();
        let [least, whole] = match looks.blur {
            Some(_) => [MIN_WIDE_HALO_LAYERS, 4 * self.limits.window],
            None => [LAYER_MULTIPLE, self.limits.max_whole],
        };
        let each = match self.is_small() && comm::size() == 1 && self.count() <= whole {
            true => own.len(),
            false => self.interior_layers(least, seen.unwrap_or_default())?,
        };
        let some = || split_layers(own.len(), each).into_iter();
        let some = || some().map(|layers| own.start + layers.start..own.start + layers.end);
        let windows = strips
            .iter()
            .flat_map(|strip| strip_windows(&strip.interior_rows, some().collect()));
        let windows = windows.collect();
        Ok((strips, windows))
    }

    /// What `change` makes of all samples under the Gaussians, which it is given some at a time and sees so many
    /// layers and rows to either side; each rank has a share of it.
    ///
    /// # Errors
    /// As [`Samples::for_each_window`].
    pub fn map_windows(
        &self,
        sees: usize,
        patience: &CancelToken<'_>,
        change: impl Fn(LayerStack<'_, D>) -> Vec<f32>,
    ) -> Result<Samples<'static, D>> {
        let looks = WindowHalo {
            halo: sees,
            blur: None,
        };
        let [own_rows, own_layers] = self.mapped_interior(looks)?;
        let all_layers = split_layers(self.dims[D - 1], own_layers);
        let strips = self.strips_with_rows(own_rows, looks);
        let layer = layer_len(self.dims);
        let mut share = LayerBuffer::default();
        let work = |mine: Range<usize>, _: &mut dyn FnMut(())| {
            let mine = &all_layers[mine];
            share.range = hull(mine);
            let before = share.range.start * layer;
            let windows = strips
                .iter()
                .flat_map(|strip| strip_windows(&strip.interior_rows, mine.to_vec()));
            let windows: Vec<WindowInterior> = windows.collect();
            let take = &mut |window: &LayerWindow<'_, D>| {
                let (stack, own) = (window.smoothed, &window.interior);
                let all = change(stack);
                let mut of_share = self.dims;
                of_share[D - 1] = share.range.len();
                if own.layers == share.range && stack.volume.dims == of_share {
                    // It is all there is.
                    share.samples = all;
                    return;
                }
                share.samples.resize(share.range.len() * layer, 0.0);
                for (to, rows) in own
                    .layer_index_ranges(self.dims)
                    .zip(stack.with_samples(&all).interior_rows(own))
                {
                    share.samples[to.start - before..to.end - before].copy_from_slice(rows);
                }
            };
            self.visit_windows(&strips, &windows, looks, patience, take)?;
            // Fewer only once patience is over.
            share.samples.resize(share.range.len() * layer, 0.0);
            Ok(())
        };
        comm::distribute("layers changed", all_layers.len(), work, &mut |()| ())?;
        Ok(Samples {
            dims: self.dims,
            raw: match comm::size() {
                1 => SampleStore::InMemory(share.samples.into()),
                _ => SampleStore::Distributed(share),
            },
            scales: Vec::new(),
            smoothed: None,
            limits: self.limits,
        })
    }

    /// Widths of the Gaussians, unless the samples are held under them.
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
        looks: WindowHalo,
        patience: &CancelToken<'_>,
        work: &mut dyn FnMut(&LayerWindow<'_, D>),
    ) -> Result<()> {
        let (blurs, scales) = (looks.blurs(), self.pending_scales());
        let mut seen = StripBuffers {
            raw: LayerBuffer::default(),
            smoothed: SmoothingStages::new(scales),
            blurred: SmoothingStages::new(&blurs),
        };
        for strip in strips {
            let first = windows.partition_point(|own| own.rows.start < strip.interior_rows.start);
            let end = windows.partition_point(|own| own.rows.start < strip.interior_rows.end);
            self.visit_strip(
                strip,
                &windows[first..end],
                looks,
                &mut seen,
                patience,
                work,
            )?;
        }
        Ok(())
    }

    /// The same of the windows of one strip.
    fn visit_strip(
        &self,
        strip: &Strip<D>,
        windows: &[WindowInterior],
        looks: WindowHalo,
        StripBuffers {
            raw,
            smoothed,
            blurred,
        }: &mut StripBuffers,
        patience: &CancelToken<'_>,
        work: &mut dyn FnMut(&LayerWindow<'_, D>),
    ) -> Result<()> {
        let (dims, layer, count) = (strip.dims(), strip.layer_len(), self.dims[D - 1]);
        let halos = [looks.halo, looks.blurred_halo()];
        let beyond = (halos[0] + smoothed.reach()).max(halos[1] + blurred.reach());
        raw.range = 0..0;
        smoothed.clear();
        blurred.clear();
        if let SampleStore::Distributed(share) = &self.raw {
            let seen = match windows {
                [] => 0..0,
                [first, ..] => {
                    let end = windows[windows.len() - 1].layers.end;
                    widen(&(first.layers.start..end), beyond, count)
                }
            };
            *raw = share.exchange_layers(seen, strip, &WorldComm)?;
        }
        for own in windows {
            if patience.is_cancelled() {
                break;
            }
            let seen = widen(&own.layers, beyond, count);
            match &self.raw {
                SampleStore::Layered(layers, sign) => raw.slide(seen, layer, |new, out| {
                    layers.read_rows(new.start, strip.visible_rows.clone(), out)?;
                    if *sign != 1.0 {
                        out.par_iter_mut().for_each(|s| *s *= sign);
                    }
                    Ok(())
                })?,
                SampleStore::InMemory(all) if !strip.is_entire() => {
                    raw.slide(seen, layer, |new, out| {
                        let whole = strip.volume_layer_len();
                        let parts = strip.strip_rows(&all[new.start * whole..new.end * whole]);
                        let out = out.chunks_exact_mut(layer);
                        out.zip(parts)
                            .for_each(|(out, part)| out.copy_from_slice(part));
                        Ok(())
                    })?
                }
                SampleStore::InMemory(_) | SampleStore::Distributed(_) => (),
            }
            let raw = |range: Range<usize>| match &self.raw {
                SampleStore::InMemory(all) if strip.is_entire() => {
                    &all[range.start * layer..range.end * layer]
                }
                _ => raw.layers(range, layer),
            };
            let [range, wide_range] = halos.map(|halo| widen(&own.layers, halo, count));
            smoothed.slide(&range, dims, &raw, patience)?;
            blurred.slide(&wide_range, dims, &raw, patience)?;
            let stack = |samples, layers: &Range<usize>| {
                let (mut dims, mut from) = (dims, [0; D]);
                dims[D - 1] = layers.len();
                from[D - 2] = strip.visible_rows.start;
                from[D - 1] = layers.start;
                LayerStack {
                    volume: Volume::new(dims, samples),
                    origin: from,
                }
            };
            let as_they_are = stack(raw(wide_range.clone()), &wide_range);
            let whole = self.smoothed.as_deref();
            let whole = whole.map(|whole| &whole[range.start * layer..range.end * layer]);
            work(&LayerWindow {
                raw: as_they_are,
                smoothed: match whole.or_else(|| smoothed.layers(&range, layer)) {
                    Some(samples) => stack(samples, &range),
                    None => stack(raw(range.clone()), &range),
                },
                blurred: match blurred.layers(&wide_range, layer) {
                    Some(samples) => stack(samples, &wide_range),
                    None => as_they_are,
                },
                dims: self.dims,
                interior: own.clone(),
            });
        }
        Ok(())
    }
}

/// What is held of a strip.
struct StripBuffers {
    raw: LayerBuffer,
    smoothed: SmoothingStages,
    blurred: SmoothingStages,
}

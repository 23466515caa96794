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

mod held;
mod sizes;
mod strip;
#[cfg(test)]
pub(crate) mod tests;

use super::gaussian;
use super::volume::Volume;
use crate::error::Result;
use crate::files::kept::Kept;
use crate::image::Layers;
use crate::observer::Patience;
use crate::parallel::prelude::*;
use crate::ranks::{self, Ranks};
use held::{Held, Stages, wide};
use sizes::{HELD, Limits, Looks, USUAL, WIDE, has_room};
use std::borrow::Cow;
use std::ops::Range;
use strip::{Strip, hull, layers, of_strip};

pub use crate::image::layers::rows;
pub use sizes::{MULTIPLE, WHOLE, changed_together, looked_at};
pub use strip::{LookedAt, Own};

/// Samples of a volume.
pub struct Samples<'a, const D: usize> {
    dims: [usize; D],
    raw: Raw<'a, D>,
    /// Widths (samples) of the Gaussians under which they are looked at, one after the other.
    scales: Vec<f64>,
    /// Under these, if the volume is not large.
    whole: Option<Vec<f32>>,
    limits: Limits,
}

/// Where samples are.
enum Raw<'a, const D: usize> {
    Held(Cow<'a, [f32]>),
    /// With the sign that they are taken with.
    InLayers(&'a dyn Layers<D>, f32),
    /// Each rank has some layers.
    InShares(Held),
}

/// Some layers of a volume.
pub struct Window<'w, const D: usize> {
    /// The samples as they are.
    pub raw: Stack<'w, D>,
    /// Under the Gaussians.
    pub smoothed: Stack<'w, D>,
    /// Under another one.
    pub blurred: Stack<'w, D>,
    /// Samples of the whole volume along each axis.
    pub dims: [usize; D],
    /// What it is for, numbered as in the volume: all rows, unless it is in a strip.
    pub own: Own,
}

/// Layers of a volume: a window's own, and others to either side.
#[derive(Clone, Copy)]
pub struct Stack<'w, const D: usize> {
    pub volume: Volume<'w, D>,
    /// The sample of the volume with which these begin.
    from: [usize; D],
}

impl<'w, const D: usize> Stack<'w, D> {
    /// Other samples of the same layers.
    pub fn with<'s>(&self, samples: &'s [f32]) -> Stack<'s, D> {
        Stack {
            volume: Volume::new(self.volume.dims, samples),
            from: self.from,
        }
    }

    /// A sample of these as one of the volume.
    #[inline]
    pub fn in_volume(&self, at: [usize; D]) -> [usize; D] {
        std::array::from_fn(|k| at[k] + self.from[k])
    }

    /// A sample of the volume as one of these.
    #[inline]
    pub fn in_stack(&self, at: [usize; D]) -> [usize; D] {
        std::array::from_fn(|k| at[k] - self.from[k])
    }

    /// The value at a sample of the volume.
    #[inline]
    pub fn at(&self, at: [usize; D]) -> f32 {
        self.volume.samples[self.volume.index(self.in_stack(at))]
    }

    /// Some layers of the volume: their rows that are among these.
    pub fn layers(&self, layers: &Range<usize>) -> &'w [f32] {
        let (layer, from) = (layer(self.volume.dims), self.from[D - 1]);
        &self.volume.samples[(layers.start - from) * layer..(layers.end - from) * layer]
    }

    /// The rows of each layer that are a window's own.
    fn rows(&self, own: &Own) -> impl Iterator<Item = &'w [f32]> {
        // In the plane, where a layer is one row, all begin with it.
        let less = |range: &Range<usize>, by: usize| range.start - by..range.end - by;
        let own = Own {
            rows: less(&own.rows, self.from[D - 2]),
            layers: less(&own.layers, self.from[D - 1]),
        };
        let samples = self.volume.samples;
        let of_each = own.of_each_layer(self.volume.dims);
        of_each.map(move |range| &samples[range])
    }
}

impl<const D: usize> Window<'_, D> {
    /// What `visit` finds in each of the own rows of x, given its first sample among the smoothed ones;
    /// see [`Volume::by_rows`]. The window must not be in a strip.
    pub fn by_rows<S: Default, T: Send>(
        &self,
        patience: &Patience<'_>,
        visit: impl Fn([usize; D], &mut S, &mut Vec<T>) + Sync,
    ) -> Vec<T> {
        let rows = rows(self.dims);
        let (first, own) = (self.smoothed.from[D - 1], &self.own.layers);
        let own = (own.start - first) * rows..(own.end - first) * rows;
        self.smoothed.volume.by_some_rows(own, patience, visit)
    }
}

/// Samples of a layer along the last axis.
pub fn layer<const D: usize>(dims: [usize; D]) -> usize {
    dims[..D - 1].iter().product()
}

impl<'a, const D: usize> Samples<'a, D> {
    /// Of a volume in memory.
    pub fn held(dims: [usize; D], samples: impl Into<Cow<'a, [f32]>>) -> Self {
        Self {
            dims,
            raw: Raw::Held(samples.into()),
            scales: Vec::new(),
            whole: None,
            limits: USUAL,
        }
    }

    /// Of a volume that is somewhere else, each sample times `sign`.
    pub fn in_layers(layers: &'a dyn Layers<D>, sign: f32) -> Self {
        Self {
            dims: layers.dims(),
            raw: Raw::InLayers(layers, sign),
            scales: Vec::new(),
            whole: None,
            limits: USUAL,
        }
    }

    /// In memory, if it is not large and there is room for it and what is made of it.
    ///
    /// # Errors
    /// That of reading.
    pub fn held_if_small(self) -> Result<Self> {
        match self.raw {
            Raw::InLayers(layers, sign)
                if ranks::count() == 1
                    && self.count() <= self.limits.whole
                    && has_room(HELD * self.count() as f64) =>
            {
                let mut samples = vec![0.0; self.count()];
                layers.read(0, &mut samples)?;
                samples.iter_mut().for_each(|s| *s *= sign);
                Ok(Self {
                    raw: Raw::Held(Cow::Owned(samples)),
                    ..self
                })
            }
            _ => Ok(self),
        }
    }

    /// The share of the windows of a large volume that tell enough, as one in so many.
    pub fn one_in(&self) -> usize {
        self.count().div_ceil(WHOLE)
    }

    /// With other limits: most samples that are smoothed as a whole, and samples of a window.
    #[cfg(test)]
    pub fn limited(self, [whole, window]: [usize; 2]) -> Self {
        let limits = Limits {
            whole,
            window,
            ..self.limits
        };
        Self { limits, ..self }
    }

    /// In strips, where halos are wide: of about so many samples of a layer; and of windows that see no more than so many
    /// samples, where they are changed.
    #[cfg(test)]
    pub fn in_strips(self, strip: usize, seen: usize) -> Self {
        let limits = Limits {
            layer: 0,
            strip,
            seen,
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
    pub fn every(&self) -> usize {
        7 * (self.count().div_ceil(WHOLE) | 1)
    }

    /// Whether it is in memory, and not large.
    fn is_small(&self) -> bool {
        !matches!(self.raw, Raw::InLayers(..)) && self.count() <= self.limits.whole
    }

    /// All samples as they are, of a volume in memory.
    #[cfg(test)]
    pub fn all(&self) -> &[f32] {
        match &self.raw {
            Raw::Held(all) => all,
            _ => &[],
        }
    }

    /// From now on under one Gaussian more.
    pub fn smooth(&mut self, scale: f64, patience: &Patience<'_>) {
        self.scales.push(scale);
        if let (Raw::Held(raw), true) = (&self.raw, self.is_small()) {
            match &mut self.whole {
                Some(samples) => gaussian::smooth(self.dims, samples, [scale; D], patience),
                None => {
                    let samples = self.whole.insert(vec![0.0; raw.len()]);
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
    /// That of reading, and those of [`ranks::share`].
    pub fn each<T: Kept>(
        &self,
        halo: usize,
        blur: Option<(f64, usize)>,
        much: &dyn Fn(&Own) -> usize,
        patience: &Patience<'_>,
        work: &mut dyn FnMut(&Window<'_, D>) -> T,
        take: &mut dyn FnMut(T),
    ) -> Result<()> {
        let looks = Looks { halo, blur };
        let (strips, windows) = self.windows(looks, &(0..self.dims[D - 1]))?;
        let windows = windows.into_iter().map(|own| (much(&own), own));
        let (work_in, windows): (Vec<usize>, Vec<Own>) =
            windows.filter(|(much, _)| *much > 0).unzip();
        let these = |mine: Range<usize>, give: &mut dyn FnMut(T)| {
            let give = &mut |window: &Window<'_, D>| give(work(window));
            self.each_of(&strips, &windows[mine], looks, patience, give)
        };
        ranks::share_fairly("layers", &work_in, these, take)
    }

    /// Calls `work` for one window of these layers after the other, which are this rank's; else as [`Samples::each`].
    ///
    /// # Errors
    /// That of reading.
    pub fn each_within(
        &self,
        own: &Range<usize>,
        halo: usize,
        blur: Option<(f64, usize)>,
        much: &dyn Fn(&Own) -> usize,
        patience: &Patience<'_>,
        work: &mut dyn FnMut(&Window<'_, D>),
    ) -> Result<()> {
        let looks = Looks { halo, blur };
        let (strips, windows) = self.windows(looks, own)?;
        let windows: Vec<Own> = windows.into_iter().filter(|own| much(own) > 0).collect();
        self.each_of(&strips, &windows, looks, patience, work)
    }

    /// The windows in which all samples of some layers are looked at, in the order of their strips.
    fn windows(&self, looks: Looks, own: &Range<usize>) -> Result<(Vec<Strip<D>>, Vec<Own>)> {
        let strips = self.strips(looks);
        let seen = strips.iter().map(Strip::layer).max();
        let [least, whole] = match looks.blur {
            Some(_) => [WIDE, 4 * self.limits.window],
            None => [MULTIPLE, self.limits.whole],
        };
        let each = match self.is_small() && ranks::count() == 1 && self.count() <= whole {
            true => own.len(),
            false => self.own_layers(least, seen.unwrap_or_default())?,
        };
        let some = || layers(own.len(), each).into_iter();
        let some = || some().map(|layers| own.start + layers.start..own.start + layers.end);
        let windows = strips
            .iter()
            .flat_map(|strip| of_strip(&strip.own, some().collect()));
        let windows = windows.collect();
        Ok((strips, windows))
    }

    /// What `change` makes of all samples under the Gaussians, which it is given some at a time and sees so many
    /// layers and rows to either side; each rank has a share of it.
    ///
    /// # Errors
    /// As [`Samples::each`].
    pub fn changed(
        &self,
        sees: usize,
        patience: &Patience<'_>,
        change: impl Fn(Stack<'_, D>) -> Vec<f32>,
    ) -> Result<Samples<'static, D>> {
        let looks = Looks {
            halo: sees,
            blur: None,
        };
        let [own_rows, own_layers] = self.own_of_changed(looks)?;
        let all_layers = layers(self.dims[D - 1], own_layers);
        let strips = self.strips_of(own_rows, looks);
        let layer = layer(self.dims);
        let mut share = Held::default();
        let work = |mine: Range<usize>, _: &mut dyn FnMut(())| {
            let mine = &all_layers[mine];
            share.range = hull(mine);
            let before = share.range.start * layer;
            let windows = strips
                .iter()
                .flat_map(|strip| of_strip(&strip.own, mine.to_vec()));
            let windows: Vec<Own> = windows.collect();
            let take = &mut |window: &Window<'_, D>| {
                let (stack, own) = (window.smoothed, &window.own);
                let all = change(stack);
                let mut of_share = self.dims;
                of_share[D - 1] = share.range.len();
                if own.layers == share.range && stack.volume.dims == of_share {
                    // It is all there is.
                    share.samples = all;
                    return;
                }
                share.samples.resize(share.range.len() * layer, 0.0);
                for (to, rows) in own.of_each_layer(self.dims).zip(stack.with(&all).rows(own)) {
                    share.samples[to.start - before..to.end - before].copy_from_slice(rows);
                }
            };
            self.each_of(&strips, &windows, looks, patience, take)?;
            // Fewer only once patience is over.
            share.samples.resize(share.range.len() * layer, 0.0);
            Ok(())
        };
        ranks::share("layers changed", all_layers.len(), work, &mut |()| ())?;
        Ok(Samples {
            dims: self.dims,
            raw: match ranks::count() {
                1 => Raw::Held(share.samples.into()),
                _ => Raw::InShares(share),
            },
            scales: Vec::new(),
            whole: None,
            limits: self.limits,
        })
    }

    /// Widths of the Gaussians, unless the samples are held under them.
    fn scales_left(&self) -> &[f64] {
        match self.whole {
            Some(_) => &[],
            None => &self.scales,
        }
    }

    /// Calls `work` for these windows, which are in the order of the strips.
    fn each_of(
        &self,
        strips: &[Strip<D>],
        windows: &[Own],
        looks: Looks,
        patience: &Patience<'_>,
        work: &mut dyn FnMut(&Window<'_, D>),
    ) -> Result<()> {
        let (blurs, scales) = (looks.blurs(), self.scales_left());
        let mut seen = Seen {
            raw: Held::default(),
            smoothed: Stages::new(scales),
            blurred: Stages::new(&blurs),
        };
        for strip in strips {
            let first = windows.partition_point(|own| own.rows.start < strip.own.start);
            let end = windows.partition_point(|own| own.rows.start < strip.own.end);
            self.each_in(
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
    fn each_in(
        &self,
        strip: &Strip<D>,
        windows: &[Own],
        looks: Looks,
        Seen {
            raw,
            smoothed,
            blurred,
        }: &mut Seen,
        patience: &Patience<'_>,
        work: &mut dyn FnMut(&Window<'_, D>),
    ) -> Result<()> {
        let (dims, layer, count) = (strip.dims(), strip.layer(), self.dims[D - 1]);
        let halos = [looks.halo, looks.blurred_halo()];
        let beyond = (halos[0] + smoothed.reach()).max(halos[1] + blurred.reach());
        raw.range = 0..0;
        smoothed.clear();
        blurred.clear();
        if let Raw::InShares(share) = &self.raw {
            let seen = match windows {
                [] => 0..0,
                [first, ..] => {
                    let end = windows[windows.len() - 1].layers.end;
                    wide(&(first.layers.start..end), beyond, count)
                }
            };
            *raw = share.wanted(seen, strip, &Ranks)?;
        }
        for own in windows {
            if patience.over() {
                break;
            }
            let seen = wide(&own.layers, beyond, count);
            match &self.raw {
                Raw::InLayers(layers, sign) => raw.slide(seen, layer, |new, out| {
                    layers.read_rows(new.start, strip.seen.clone(), out)?;
                    if *sign != 1.0 {
                        out.par_iter_mut().for_each(|s| *s *= sign);
                    }
                    Ok(())
                })?,
                Raw::Held(all) if !strip.is_whole() => raw.slide(seen, layer, |new, out| {
                    let whole = strip.whole_layer();
                    let parts = strip.of_layers(&all[new.start * whole..new.end * whole]);
                    let out = out.chunks_exact_mut(layer);
                    out.zip(parts)
                        .for_each(|(out, part)| out.copy_from_slice(part));
                    Ok(())
                })?,
                Raw::Held(_) | Raw::InShares(_) => (),
            }
            let raw = |range: Range<usize>| match &self.raw {
                Raw::Held(all) if strip.is_whole() => &all[range.start * layer..range.end * layer],
                _ => raw.layers(range, layer),
            };
            let [range, wide_range] = halos.map(|halo| wide(&own.layers, halo, count));
            smoothed.slide(&range, dims, &raw, patience)?;
            blurred.slide(&wide_range, dims, &raw, patience)?;
            let stack = |samples, layers: &Range<usize>| {
                let (mut dims, mut from) = (dims, [0; D]);
                dims[D - 1] = layers.len();
                from[D - 2] = strip.seen.start;
                from[D - 1] = layers.start;
                Stack {
                    volume: Volume::new(dims, samples),
                    from,
                }
            };
            let as_they_are = stack(raw(wide_range.clone()), &wide_range);
            let whole = self.whole.as_deref();
            let whole = whole.map(|whole| &whole[range.start * layer..range.end * layer]);
            work(&Window {
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
                own: own.clone(),
            });
        }
        Ok(())
    }
}

/// What is held of a strip.
struct Seen {
    raw: Held,
    smoothed: Stages,
    blurred: Stages,
}

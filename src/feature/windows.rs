//! Samples looked at some layers at a time, as they are and under Gaussians.
//!
//! What is looked for in a volume sees no farther than a few samples, so that a stack of layers along the
//! last axis with a *halo* of layers to either side shows all that the whole would, bit for bit. A volume
//! that is not large is one window, smoothed once. Of a larger one, which may be in its file still, only
//! the window's layers are held; windows slide, so that every layer is read and smoothed once a pass.

use super::gaussian;
use super::volume::Volume;
use crate::error::Result;
use crate::files::kept::Kept;
use crate::image::Layers;
use crate::memory;
use crate::observer::Patience;
use crate::ranks::{self, Group, Ranks};
use rayon::prelude::*;
use std::borrow::Cow;
use std::ops::Range;

/// A volume of at most so many samples is smoothed as a whole ...
pub const WHOLE: usize = 1 << 27;
/// ... if there is room for so many bytes a sample ...
const HELD: f64 = 12.0;
/// ... of others a window's own layers have about so many samples ...
const WINDOW: usize = 1 << 21;
/// ... and are a multiple of these ...
pub const MULTIPLE: usize = 16;
/// ... but have so many layers where halos are wide, for these are moved along with every window ...
const WIDE: usize = 3 * MULTIPLE;
/// ... if there is room for so many.
const LAYERS: usize = 200;

/// Samples of a volume.
pub struct Samples<'a, const D: usize> {
    dims: [usize; D],
    raw: Raw<'a, D>,
    /// Widths (samples) of the Gaussians under which they are looked at, one after the other.
    scales: Vec<f64>,
    /// Under these, if the volume is not large.
    whole: Option<Vec<f32>>,
    /// Most samples that are smoothed as a whole, and samples of a window.
    limits: [usize; 2],
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
    /// The window's own layers, numbered as those of the volume.
    pub own: Range<usize>,
}

/// Layers of a volume: a window's own, and others to either side.
#[derive(Clone, Copy)]
pub struct Stack<'w, const D: usize> {
    pub volume: Volume<'w, D>,
    /// The layer of the volume with which these begin.
    from: usize,
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
    pub fn in_volume(&self, mut at: [usize; D]) -> [usize; D] {
        at[D - 1] += self.from;
        at
    }

    /// A sample of the volume as one of these.
    #[inline]
    pub fn in_stack(&self, mut at: [usize; D]) -> [usize; D] {
        at[D - 1] -= self.from;
        at
    }

    /// The value at a sample of the volume.
    #[inline]
    pub fn at(&self, at: [usize; D]) -> f32 {
        self.volume.samples[self.volume.index(self.in_stack(at))]
    }

    /// Some layers of the volume.
    pub fn layers(&self, layers: &Range<usize>) -> &'w [f32] {
        let layer = layer(self.volume.dims);
        &self.volume.samples[(layers.start - self.from) * layer..(layers.end - self.from) * layer]
    }
}

impl<const D: usize> Window<'_, D> {
    /// What `visit` finds in each of the own rows of x, given its first sample among the smoothed ones;
    /// see [`Volume::by_rows`].
    pub fn by_rows<S: Default, T: Send>(
        &self,
        patience: &Patience<'_>,
        visit: impl Fn([usize; D], &mut S, &mut Vec<T>) + Sync,
    ) -> Vec<T> {
        let rows = layer(self.dims) / self.dims[0].max(1);
        let first = self.smoothed.from;
        let own = (self.own.start - first) * rows..(self.own.end - first) * rows;
        self.smoothed.volume.by_some_rows(own, patience, visit)
    }
}

/// Samples of a layer along the last axis.
pub fn layer<const D: usize>(dims: [usize; D]) -> usize {
    dims[..D - 1].iter().product()
}

/// Layers that are held.
#[derive(Default)]
struct Held {
    range: Range<usize>,
    samples: Vec<f32>,
}

impl Held {
    /// Holds these layers, of which `make` fills in those that are not there yet.
    fn slide(
        &mut self,
        to: Range<usize>,
        layer: usize,
        make: impl FnOnce(Range<usize>, &mut [f32]) -> Result<()>,
    ) -> Result<()> {
        let kept = match self.range.contains(&to.start) {
            true => to.start..self.range.end,
            false => to.start..to.start,
        };
        // The room is used again: to ask for it anew would cost as much as to smooth it.
        let from = self.samples.len() - kept.len() * layer;
        self.samples.copy_within(from.., 0);
        let more = (to.len() * layer).saturating_sub(self.samples.len());
        self.samples.reserve_exact(more);
        self.samples.resize(to.len() * layer, 0.0);
        let new = kept.end..to.end;
        if !new.is_empty() {
            make(new, &mut self.samples[kept.len() * layer..])?;
        }
        self.range = to;
        Ok(())
    }

    fn layers(&self, range: Range<usize>, layer: usize) -> &[f32] {
        let first = self.range.start;
        &self.samples[(range.start - first) * layer..(range.end - first) * layer]
    }
}

impl Held {
    /// Some layers of a volume, of which these are this rank's share and others have the rest; of `layer` samples each.
    ///
    /// # Errors
    /// Those of other ranks.
    fn wanted(&self, wanted: Range<usize>, layer: usize) -> Result<Self> {
        let group: &dyn Group = &Ranks;
        let asked: Vec<[usize; 2]> = group.all("layers wanted", [wanted.start, wanted.end])?;
        let part = |asked: [usize; 2]| {
            let [start, end] = asked.map(|at| at.clamp(self.range.start, self.range.end));
            self.layers(start..end, layer)
        };
        // What is here need not be passed on.
        let told = (asked.iter().enumerate()).map(|(rank, &asked)| match rank == group.rank() {
            true => Vec::new(),
            false => part(asked).to_vec(),
        });
        let parts: Vec<Vec<f32>> = group.pass("layers", told.collect())?;
        // Ranks have shares in their order.
        let mut samples = Vec::with_capacity(wanted.len() * layer);
        for (rank, other) in parts.iter().enumerate() {
            samples.extend_from_slice(match rank == group.rank() {
                true => part(asked[rank]),
                false => other,
            });
        }
        Ok(Self {
            range: wanted,
            samples,
        })
    }
}

/// Layers under a Gaussian.
struct Stage {
    scale: f64,
    /// Along all axes but the last.
    flat: Held,
    /// Along all.
    smoothed: Held,
}

/// Layers under Gaussians, one after the other.
struct Stages(Vec<Stage>);

impl Stages {
    fn new(scales: &[f64]) -> Self {
        let stage = |&scale: &f64| Stage {
            scale,
            flat: Held::default(),
            smoothed: Held::default(),
        };
        Self(scales.iter().map(stage).collect())
    }

    /// How many layers to either side they look.
    fn reach(&self) -> usize {
        self.0
            .iter()
            .map(|stage| gaussian::radius(stage.scale))
            .sum()
    }

    /// Those that are held; `None` if there is no Gaussian.
    fn layers(&self, range: &Range<usize>, layer: usize) -> Option<&[f32]> {
        let last = self.0.last()?;
        Some(last.smoothed.layers(range.clone(), layer))
    }

    /// Holds these layers of a volume, of which `raw` gives some as they are.
    fn slide<'r, const D: usize>(
        &mut self,
        to: &Range<usize>,
        dims: [usize; D],
        raw: &dyn Fn(Range<usize>) -> &'r [f32],
        patience: &Patience<'_>,
    ) -> Result<()> {
        let (layer, count) = (layer(dims), dims[D - 1]);
        let mut beyond = self.reach();
        for i in 0..self.0.len() {
            let (before, stage) = self.0.split_at_mut(i);
            let (before, stage) = (before.last(), &mut stage[0]);
            let radius = gaussian::radius(stage.scale);
            beyond -= radius;
            let wanted = wide(to, beyond, count);
            // Of what is smoothed already nothing is asked again.
            let known = &stage.smoothed.range;
            let first = match known.contains(&wanted.start) {
                true => known.end,
                false => wanted.start,
            };
            let seen = wide(&(first..wanted.end), radius, count);
            let deep = |layers: usize| {
                let mut dims = dims;
                dims[D - 1] = layers;
                dims
            };
            stage.flat.slide(seen, layer, |new, out| {
                let source = match before {
                    None => raw(new.clone()),
                    Some(before) => before.smoothed.layers(new.clone(), layer),
                };
                let mut scales = [stage.scale; D];
                scales[D - 1] = 0.0;
                gaussian::smooth_into(deep(new.len()), source, out, scales, patience);
                Ok(())
            })?;
            let Stage {
                scale,
                flat,
                smoothed,
            } = stage;
            smoothed.slide(wanted, layer, |new, out| {
                let seen = wide(&new, radius, count);
                let (dims, first) = (deep(seen.len()), new.start - seen.start);
                let flat = flat.layers(seen, layer);
                gaussian::smooth_last(dims, flat, *scale, first, out, patience);
                Ok(())
            })?;
        }
        Ok(())
    }
}

/// Whether there is memory for so many samples and what is made of them.
fn has_room(samples: usize) -> bool {
    let bytes = HELD * samples as f64;
    memory::afford("features", bytes, "samples", "look at fewer layers").is_ok()
}

/// From the first of some windows, one after the other, to the last.
fn hull(windows: &[Range<usize>]) -> Range<usize> {
    match windows {
        [first, .., last] => first.start..last.end,
        [one] => one.clone(),
        [] => 0..0,
    }
}

/// A range of layers and so many to either side, of those there are.
fn wide(range: &Range<usize>, by: usize, count: usize) -> Range<usize> {
    range.start.saturating_sub(by)..(range.end + by).min(count)
}

impl<'a, const D: usize> Samples<'a, D> {
    /// Of a volume in memory.
    pub fn held(dims: [usize; D], samples: impl Into<Cow<'a, [f32]>>) -> Self {
        Self {
            dims,
            raw: Raw::Held(samples.into()),
            scales: Vec::new(),
            whole: None,
            limits: [WHOLE, WINDOW],
        }
    }

    /// Of a volume that is somewhere else, each sample times `sign`.
    pub fn in_layers(layers: &'a dyn Layers<D>, sign: f32) -> Self {
        Self {
            dims: layers.dims(),
            raw: Raw::InLayers(layers, sign),
            scales: Vec::new(),
            whole: None,
            limits: [WHOLE, WINDOW],
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
                    && self.count() <= self.limits[0]
                    && has_room(self.count()) =>
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
    pub fn limited(self, limits: [usize; 2]) -> Self {
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
        !matches!(self.raw, Raw::InLayers(..)) && self.count() <= self.limits[0]
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
    /// in a window's own layers: those in which there is none are left out. Each has so many layers to either side,
    /// as far as there are any: under the Gaussians `halo`, and as they are and under a Gaussian of width `blur` as
    /// many as that says.
    ///
    /// # Errors
    /// That of reading, and those of [`ranks::share`].
    pub fn each<T: Kept>(
        &self,
        halo: usize,
        blur: Option<(f64, usize)>,
        much: &dyn Fn(Range<usize>) -> usize,
        patience: &Patience<'_>,
        work: &mut dyn FnMut(&Window<'_, D>) -> T,
        take: &mut dyn FnMut(T),
    ) -> Result<()> {
        let [least, whole] = match blur {
            Some(_) => [WIDE, 4 * self.limits[1]],
            None => [MULTIPLE, self.limits[0]],
        };
        let windows = self.windows(least, whole)?;
        let windows = windows.into_iter().map(|own| (own.clone(), much(own)));
        let (windows, work_in): (Vec<Range<usize>>, Vec<usize>) =
            windows.filter(|(_, much)| *much > 0).unzip();
        let these = |mine: Range<usize>, give: &mut dyn FnMut(T)| {
            let give = &mut |window: &Window<'_, D>| give(work(window));
            self.each_of(&windows[mine], (halo, blur), patience, give)
        };
        ranks::share_fairly("layers", &work_in, these, take)
    }

    /// What `change` makes of all samples under the Gaussians, which it is given some layers at a time and sees so many
    /// layers to either side; each rank has a share of it.
    ///
    /// # Errors
    /// As [`Samples::each`].
    pub fn changed(
        &self,
        sees: usize,
        patience: &Patience<'_>,
        change: impl Fn(Stack<'_, D>) -> Vec<f32>,
    ) -> Result<Samples<'static, D>> {
        // Layers to either side are changed in vain: of windows as wide as these half of all.
        let windows = self.windows((2 * sees).max(MULTIPLE), self.limits[0])?;
        let mut own = Held::default();
        let work = |mine: Range<usize>, _: &mut dyn FnMut(())| {
            let windows = &windows[mine];
            own.range = hull(windows);
            let room = own.range.len() * layer(self.dims);
            let take = &mut |window: &Window<'_, D>| {
                let stack = window.smoothed;
                let all = change(stack);
                match window.own == own.range && stack.volume.dims[D - 1] == own.range.len() {
                    true => own.samples = all,
                    false => {
                        own.samples.reserve_exact(room - own.samples.len());
                        let layers = stack.with(&all);
                        own.samples.extend_from_slice(layers.layers(&window.own));
                    }
                }
            };
            self.each_of(windows, (sees, None), patience, take)?;
            // Fewer only once patience is over.
            own.samples.resize(room, 0.0);
            Ok(())
        };
        ranks::share("layers changed", windows.len(), work, &mut |()| ())?;
        Ok(Samples {
            dims: self.dims,
            raw: match ranks::count() {
                1 => Raw::Held(own.samples.into()),
                _ => Raw::InShares(own),
            },
            scales: Vec::new(),
            whole: None,
            limits: [WHOLE, WINDOW],
        })
    }

    /// The own layers of windows that have about so many at least, if there is room for them. A volume of no more samples
    /// than `whole` is one, if it is looked at as a whole and by one process.
    ///
    /// # Errors
    /// Those of other ranks.
    fn windows(&self, least: usize, whole: usize) -> Result<Vec<Range<usize>>> {
        let (count, alone) = (self.dims[D - 1], ranks::count() == 1);
        let own = match self.is_small() && alone && self.count() <= whole {
            true => count.max(1),
            false => self.own_layers(least)?,
        };
        let firsts = (0..count).step_by(own);
        Ok(firsts
            .map(|first| first..(first + own).min(count))
            .collect())
    }

    /// A window's own layers, at least so many if there is room for them.
    fn own_layers(&self, least: usize) -> Result<usize> {
        let layer = layer(self.dims);
        // Ranks share out windows that are not that wide better without.
        let wide = least > WIDE || least == WIDE && ranks::count() == 1;
        let room = LAYERS.max(4 * least) * layer;
        let least = match wide && ranks::of_first("room for layers", || Ok(has_room(room)))? {
            true => least,
            false => MULTIPLE,
        };
        let some = match self.is_small() {
            // Every rank has a share.
            true => self.limits[1].min(self.count() / ranks::count()),
            false => self.limits[1],
        };
        let some = (some / layer.max(1)).next_multiple_of(MULTIPLE);
        Ok(some.max(least))
    }

    /// Calls `work` for these windows.
    fn each_of(
        &self,
        windows: &[Range<usize>],
        (halo, blur): (usize, Option<(f64, usize)>),
        patience: &Patience<'_>,
        work: &mut dyn FnMut(&Window<'_, D>),
    ) -> Result<()> {
        let (dims, layer, count) = (self.dims, layer(self.dims), self.dims[D - 1]);
        let blurs: Vec<f64> = blur.iter().map(|blur| blur.0).collect();
        let wide_halo = blur.map_or(halo, |blur| blur.1);
        let scales = match self.whole {
            Some(_) => &[][..],
            None => &self.scales,
        };
        let (mut raw, [mut smoothed, mut blurred]) =
            (Held::default(), [scales, &blurs].map(Stages::new));
        let beyond = (halo + smoothed.reach()).max(wide_halo + blurred.reach());
        if let Raw::InShares(share) = &self.raw {
            let seen = match hull(windows) {
                none if none.is_empty() => none,
                all => wide(&all, beyond, count),
            };
            raw = share.wanted(seen, layer)?;
        }
        for own in windows.iter().cloned() {
            if patience.over() {
                break;
            }
            if let Raw::InLayers(layers, sign) = self.raw {
                raw.slide(wide(&own, beyond, count), layer, |new, out| {
                    layers.read(new.start, out)?;
                    if sign != 1.0 {
                        out.par_iter_mut().for_each(|s| *s *= sign);
                    }
                    Ok(())
                })?;
            }
            let raw = |range: Range<usize>| match &self.raw {
                Raw::Held(all) => &all[range.start * layer..range.end * layer],
                Raw::InLayers(..) | Raw::InShares(_) => raw.layers(range, layer),
            };
            let [range, wide_range] = [halo, wide_halo].map(|halo| wide(&own, halo, count));
            smoothed.slide(&range, dims, &raw, patience)?;
            blurred.slide(&wide_range, dims, &raw, patience)?;
            let stack = |samples, layers: &Range<usize>| {
                let mut dims = dims;
                dims[D - 1] = layers.len();
                Stack {
                    volume: Volume::new(dims, samples),
                    from: layers.start,
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
                dims,
                own,
            });
        }
        Ok(())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::feature::scenes::Noise;
    use crate::image::{Geometry, Image};

    /// An image that gives its layers as if it were in a file.
    pub struct ByLayers<'a, const D: usize>(pub &'a Image<D>);

    impl<const D: usize> Layers<D> for ByLayers<'_, D> {
        fn dims(&self) -> [usize; D] {
            self.0.dims()
        }

        fn geometry(&self) -> &Geometry<D> {
            &self.0.geometry
        }

        fn read(&self, first: usize, out: &mut [f32]) -> Result<()> {
            let samples = &self.0.as_slice()[first * layer(self.dims())..];
            out.copy_from_slice(&samples[..out.len()]);
            Ok(())
        }

        fn load(&self) -> Result<Image<D>> {
            Ok(self.0.clone())
        }
    }

    /// All that windows show of an image, one after the other.
    fn shown<const D: usize>(image: &Image<D>, from_file: bool, limits: [usize; 2]) -> Vec<f32> {
        let patience = &Patience::endless();
        let by_layers = ByLayers(image);
        let mut samples = match from_file {
            true => Samples::in_layers(&by_layers, -1.0),
            false => {
                let negated: Vec<f32> = image.as_slice().iter().map(|s| -s).collect();
                Samples::held(image.dims(), negated)
            }
        }
        .limited(limits);
        samples.smooth(1.5, patience);
        samples.smooth(0.8, patience);
        let (count, mut next) = (image.dims()[D - 1], 0);
        let work = &mut |window: &Window<'_, D>| {
            let mut seen = Vec::new();
            assert_eq!(window.own.start, next, "windows follow one another");
            next = window.own.end;
            for (stack, halo) in [(window.raw, 20), (window.smoothed, 3), (window.blurred, 20)] {
                let from = window.own.start.saturating_sub(halo);
                let to = (window.own.end + halo).min(count);
                assert_eq!(stack.from, from);
                assert_eq!(stack.volume.dims[D - 1], to - from);
                seen.extend_from_slice(stack.layers(&window.own));
                // What is in the halo is as right as what is the window's own.
                for side in [from..window.own.start, window.own.end..to] {
                    let layers = stack.layers(&side);
                    let wanted = match halo {
                        3 => gaussian_of(image, &[1.5, 0.8]),
                        _ => continue,
                    };
                    let layer = layer(image.dims());
                    assert!(
                        layers == &wanted[side.start * layer..side.end * layer],
                        "halo"
                    );
                }
            }
            seen
        };
        let (all, mut shown) = (&|_: Range<usize>| 1, Vec::new());
        let take = &mut |seen: Vec<f32>| shown.extend(seen);
        samples
            .each(3, Some((0.8, 20)), all, patience, work, take)
            .unwrap();
        assert_eq!(next, count);
        shown
    }

    fn gaussian_of<const D: usize>(image: &Image<D>, scales: &[f64]) -> Vec<f32> {
        let mut samples: Vec<f32> = image.as_slice().iter().map(|s| -s).collect();
        for &scale in scales {
            let patience = &Patience::endless();
            gaussian::smooth(image.dims(), &mut samples, [scale; D], patience);
        }
        samples
    }

    fn noise<const D: usize>(dims: [usize; D]) -> Image<D> {
        let mut noise = Noise::new(5);
        let samples = (0..dims.iter().product()).map(|_| noise.normal() as f32);
        Image::new(dims, samples.collect(), Geometry::default())
    }

    fn windows_show_the_whole<const D: usize>(dims: [usize; D]) {
        let image = noise(dims);
        let count = image.as_slice().len();
        // One window shows one kind after the other.
        let whole = shown(&image, false, [count; 2]);
        assert_eq!(whole.len(), 3 * count);
        assert!(whole[..count] == gaussian_of(&image, &[]), "as they are");
        assert!(
            whole[count..2 * count] == gaussian_of(&image, &[1.5, 0.8]),
            "smoothed"
        );
        assert!(whole[2 * count..] == gaussian_of(&image, &[0.8]), "blurred");
        let layer = layer(dims);
        for own in [48, 64] {
            let parts = shown(&image, false, [0, own * layer]);
            let mut rest = &parts[..];
            for first in (0..dims[D - 1]).step_by(own) {
                let end = (first + own).min(dims[D - 1]);
                for kind in 0..3 {
                    let (part, after) = rest.split_at((end - first) * layer);
                    assert!(
                        part == &whole[kind * count..][first * layer..end * layer],
                        "{kind}"
                    );
                    rest = after;
                }
            }
            assert!(rest.is_empty());
            assert!(
                parts == shown(&image, true, [0, own * layer]),
                "from layers"
            );
        }
    }

    #[test]
    fn windows_show_what_the_whole_shows() {
        windows_show_the_whole([9, 11, 150]);
        windows_show_the_whole([13, 170]);
    }

    #[test]
    fn what_nobody_wants_is_not_shown() {
        let image = noise([8, 7, 80]);
        let samples = Samples::held(image.dims(), image.as_slice()).limited([0, 1]);
        let mut shown = Vec::new();
        let wanted = &|own: Range<usize>| usize::from(own.contains(&40));
        let patience = &Patience::endless();
        let look = &mut |window: &Window<'_, 3>| [window.own.start, window.own.end];
        let keep = &mut |own: [usize; 2]| shown.push(own);
        samples.each(2, None, wanted, patience, look, keep).unwrap();
        assert_eq!(shown, [[32, 48]]);
    }
}

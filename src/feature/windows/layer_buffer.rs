//! Layers that are held, and what is made of them as a window moves on.

use super::strip::Strip;
use crate::comm::Comm;
use crate::error::Result;
use crate::feature::gaussian;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use std::ops::Range;

/// Samples that one thread moves at a time.
const SAMPLES_PER_TASK: usize = 1 << 16;

/// Layers that are held.
#[derive(Default)]
pub(super) struct LayerBuffer {
    pub range: Range<usize>,
    pub samples: Vec<f32>,
}

impl LayerBuffer {
    /// Holds these layers, of which `make` fills in those that are not there yet.
    pub fn slide(
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
        move_to_front(&mut self.samples, from);
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

    /// Some of them.
    pub fn layers(&self, range: Range<usize>, layer: usize) -> &[f32] {
        let first = self.range.start;
        &self.samples[(range.start - first) * layer..(range.end - first) * layer]
    }

    /// The strip's rows of some layers of a volume, of which these are this rank's share and others of the group have
    /// the rest.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn exchange_layers<const D: usize>(
        &self,
        wanted: Range<usize>,
        strip: &Strip<D>,
        group: &dyn Comm,
    ) -> Result<Self> {
        let asked: Vec<[usize; 2]> =
            group.all_gather("layers wanted", [wanted.start, wanted.end])?;
        let part = |asked: [usize; 2]| {
            let [start, end] = asked.map(|at| at.clamp(self.range.start, self.range.end));
            strip.strip_rows(self.layers(start..end, strip.volume_layer_len()))
        };
        // What is here need not be passed on.
        let told = (asked.iter().enumerate()).map(|(rank, &asked)| match rank == group.rank() {
            true => Vec::new(),
            false => part(asked).flatten().copied().collect(),
        });
        let parts: Vec<Vec<f32>> = group.all_to_all("layers", told.collect())?;
        // Ranks have shares in their order.
        let mut samples = Vec::with_capacity(wanted.len() * strip.layer_len());
        for (rank, other) in parts.iter().enumerate() {
            match rank == group.rank() {
                true => part(asked[rank]).for_each(|layer| samples.extend_from_slice(layer)),
                false => samples.extend_from_slice(other),
            }
        }
        Ok(Self {
            range: wanted,
            samples,
        })
    }
}

/// Moves samples, from one on, to the front: all threads, for layers are many megabytes.
fn move_to_front(samples: &mut [f32], from: usize) {
    let mut left = samples.len() - from;
    let mut rest = samples;
    while left > 0 && from > 0 {
        let count = from.min(left);
        let (to, source) = rest.split_at_mut(from);
        let parts = to[..count].par_chunks_mut(SAMPLES_PER_TASK);
        parts
            .zip(source[..count].par_chunks(SAMPLES_PER_TASK))
            .for_each(|(to, source)| to.copy_from_slice(source));
        (rest, left) = (source, left - count);
    }
}

/// Layers under a Gaussian.
struct SmoothingStage {
    scale: f64,
    /// Along all axes but the last.
    in_plane: LayerBuffer,
    /// Along all.
    smoothed: LayerBuffer,
}

/// Layers under Gaussians, one after the other.
pub(super) struct SmoothingStages(Vec<SmoothingStage>);

impl SmoothingStages {
    pub fn new(scales: &[f64]) -> Self {
        let stage = |&scale: &f64| SmoothingStage {
            scale,
            in_plane: LayerBuffer::default(),
            smoothed: LayerBuffer::default(),
        };
        Self(scales.iter().map(stage).collect())
    }

    /// How many samples to either side they look.
    pub fn reach(&self) -> usize {
        self.0
            .iter()
            .map(|stage| gaussian::radius(stage.scale))
            .sum()
    }

    /// Those that are held; `None` if there is no Gaussian.
    pub fn layers(&self, range: &Range<usize>, layer: usize) -> Option<&[f32]> {
        let last = self.0.last()?;
        Some(last.smoothed.layers(range.clone(), layer))
    }

    /// Holds nothing, to begin with another strip.
    pub fn clear(&mut self) {
        for stage in &mut self.0 {
            (stage.in_plane.range, stage.smoothed.range) = (0..0, 0..0);
        }
    }

    /// Holds these layers of a volume of `dims` samples, of which `raw` gives some as they are.
    pub fn slide<'r, const D: usize>(
        &mut self,
        to: &Range<usize>,
        dims: [usize; D],
        raw: &dyn Fn(Range<usize>) -> &'r [f32],
        patience: &CancelToken<'_>,
    ) -> Result<()> {
        let (layer, count) = (super::layer_len(dims), dims[D - 1]);
        let mut beyond = self.reach();
        for i in 0..self.0.len() {
            let (before, stage) = self.0.split_at_mut(i);
            let (before, stage) = (before.last(), &mut stage[0]);
            let radius = gaussian::radius(stage.scale);
            beyond -= radius;
            let wanted = widen(to, beyond, count);
            // Of what is smoothed already nothing is asked again.
            let known = &stage.smoothed.range;
            let first = match known.contains(&wanted.start) {
                true => known.end,
                false => wanted.start,
            };
            let seen = widen(&(first..wanted.end), radius, count);
            let deep = |layers: usize| {
                let mut dims = dims;
                dims[D - 1] = layers;
                dims
            };
            stage.in_plane.slide(seen, layer, |new, out| {
                let source = match before {
                    None => raw(new.clone()),
                    Some(before) => before.smoothed.layers(new.clone(), layer),
                };
                let mut scales = [stage.scale; D];
                scales[D - 1] = 0.0;
                gaussian::smooth_into(deep(new.len()), source, out, scales, patience);
                Ok(())
            })?;
            let SmoothingStage {
                scale,
                in_plane: flat,
                smoothed,
            } = stage;
            smoothed.slide(wanted, layer, |new, out| {
                let seen = widen(&new, radius, count);
                let (dims, first) = (deep(seen.len()), new.start - seen.start);
                let flat = flat.layers(seen, layer);
                gaussian::smooth_last_axis(dims, flat, *scale, first, out, patience);
                Ok(())
            })?;
        }
        Ok(())
    }
}

/// A range of layers or rows and so many to either side, of those there are.
pub(super) fn widen(range: &Range<usize>, by: usize, count: usize) -> Range<usize> {
    range.start.saturating_sub(by)..(range.end + by).min(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_move_to_the_front_whole() {
        for (count, from) in [
            (10, 0),
            (10, 3),
            (10, 7),
            (10, 10),
            (5 * SAMPLES_PER_TASK, SAMPLES_PER_TASK + 1),
        ] {
            let mut samples: Vec<f32> = (0..count).map(|i| i as f32).collect();
            move_to_front(&mut samples, from);
            let moved = samples[..count - from].iter().zip(from..);
            assert!(
                moved.into_iter().all(|(s, i)| *s == i as f32),
                "{from} of {count}"
            );
        }
    }
}

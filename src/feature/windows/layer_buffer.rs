//! Layers in memory, and their smoothing while a window slides.

use crate::error::Result;
use crate::feature::gaussian;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use std::ops::Range;

/// Number of samples that one thread moves at a time.
const SAMPLES_PER_TASK: usize = 1 << 16;

/// A range of layers and their samples.
#[derive(Default)]
pub(super) struct LayerBuffer {
    pub range: Range<usize>,
    pub samples: Vec<f32>,
}

impl LayerBuffer {
    /// Moves the buffer to the layers `target`; `fill` computes those that it does not contain yet.
    pub fn slide(
        &mut self,
        target: Range<usize>,
        layer: usize,
        fill: impl FnOnce(Range<usize>, &mut [f32]) -> Result<()>,
    ) -> Result<()> {
        let kept = if self.range.contains(&target.start) {
            target.start..self.range.end
        } else {
            target.start..target.start
        };
        // The memory is used again: a new allocation would cost as much time as the smoothing.
        let first_kept = self.samples.len() - kept.len() * layer;
        move_to_front(&mut self.samples, first_kept);
        let additional = (target.len() * layer).saturating_sub(self.samples.len());
        self.samples.reserve_exact(additional);
        self.samples.resize(target.len() * layer, 0.0);
        let new = kept.end..target.end;
        if !new.is_empty() {
            fill(new, &mut self.samples[kept.len() * layer..])?;
        }
        self.range = target;
        Ok(())
    }

    /// Returns the samples of some of the layers.
    pub fn layers(&self, range: Range<usize>, layer: usize) -> &[f32] {
        let first = self.range.start;
        &self.samples[(range.start - first) * layer..(range.end - first) * layer]
    }
}

/// Moves the samples from index `first` on to the front, in parallel, because layers are many
/// megabytes.
fn move_to_front(samples: &mut [f32], first: usize) {
    let mut remaining = samples.len() - first;
    let mut tail = samples;
    while remaining > 0 && first > 0 {
        let count = first.min(remaining);
        let (target, source) = tail.split_at_mut(first);
        let parts = target[..count].par_chunks_mut(SAMPLES_PER_TASK);
        parts
            .zip(source[..count].par_chunks(SAMPLES_PER_TASK))
            .for_each(|(target, source)| target.copy_from_slice(source));
        (tail, remaining) = (source, remaining - count);
    }
}

/// Layers under one Gaussian.
struct SmoothingStage {
    scale: f64,
    /// Layers smoothed along all axes but the last.
    in_plane: LayerBuffer,
    /// Layers smoothed along all axes.
    smoothed: LayerBuffer,
}

/// Layers under several Gaussians, applied one after the other.
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

    /// Returns how many samples to either side the Gaussians look.
    pub fn reach(&self) -> usize {
        self.0
            .iter()
            .map(|stage| gaussian::radius(stage.scale))
            .sum()
    }

    /// Returns smoothed layers in the buffer; `None` if there is no Gaussian.
    pub fn layers(&self, range: &Range<usize>, layer: usize) -> Option<&[f32]> {
        let last = self.0.last()?;
        Some(last.smoothed.layers(range.clone(), layer))
    }

    /// Empties the buffers, for another strip.
    pub fn clear(&mut self) {
        for stage in &mut self.0 {
            (stage.in_plane.range, stage.smoothed.range) = (0..0, 0..0);
        }
    }

    /// Moves the buffers to the layers `target` of a volume of `dims` samples; `raw` returns
    /// unsmoothed layers.
    pub fn slide<'r, const D: usize>(
        &mut self,
        target: &Range<usize>,
        dims: [usize; D],
        raw: &dyn Fn(Range<usize>) -> &'r [f32],
        cancel: &CancelToken<'_>,
    ) -> Result<()> {
        let (layer, count) = (super::layer_len(dims), dims[D - 1]);
        let mut reach = self.reach();
        for i in 0..self.0.len() {
            let (previous, stage) = self.0.split_at_mut(i);
            let (previous, stage) = (previous.last(), &mut stage[0]);
            let radius = gaussian::radius(stage.scale);
            reach -= radius;
            let needed = widen(target, reach, count);
            // Layers that are smoothed already need no input.
            let available = &stage.smoothed.range;
            let first = if available.contains(&needed.start) {
                available.end
            } else {
                needed.start
            };
            let source_range = widen(&(first..needed.end), radius, count);
            let dims_of = |layers: usize| {
                let mut dims = dims;
                dims[D - 1] = layers;
                dims
            };
            stage.in_plane.slide(source_range, layer, |new, out| {
                let source = match previous {
                    None => raw(new.clone()),
                    Some(previous) => previous.smoothed.layers(new.clone(), layer),
                };
                let mut scales = [stage.scale; D];
                scales[D - 1] = 0.0;
                gaussian::smooth_into(dims_of(new.len()), source, out, scales, cancel);
                Ok(())
            })?;
            let SmoothingStage {
                scale,
                in_plane,
                smoothed,
            } = stage;
            smoothed.slide(needed, layer, |new, out| {
                let source_range = widen(&new, radius, count);
                let (dims, first) = (dims_of(source_range.len()), new.start - source_range.start);
                let source = in_plane.layers(source_range, layer);
                gaussian::smooth_last_axis(dims, source, *scale, first, out, cancel);
                Ok(())
            })?;
        }
        Ok(())
    }
}

/// Returns a range of layers or rows widened by `margin` on either side, within 0 to `count`.
pub(super) fn widen(range: &Range<usize>, margin: usize, count: usize) -> Range<usize> {
    range.start.saturating_sub(margin)..(range.end + margin).min(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_move_to_the_front_whole() {
        for (count, first) in [
            (10, 0),
            (10, 3),
            (10, 7),
            (10, 10),
            (5 * SAMPLES_PER_TASK, SAMPLES_PER_TASK + 1),
        ] {
            let mut samples: Vec<f32> = (0..count).map(|i| i as f32).collect();
            move_to_front(&mut samples, first);
            let moved = samples[..count - first].iter().zip(first..);
            assert!(
                moved.into_iter().all(|(s, i)| *s == i as f32),
                "{first} of {count}"
            );
        }
    }
}

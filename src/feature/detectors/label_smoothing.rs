//! Finds the winning label of each sample after smoothing, so that interfaces have no steps.
//!
//! The indicator of each label is smoothed, and the label with the largest value wins. This shrinks
//! components that are thin or small. Components that would lose many samples are therefore
//! restored: the smoothed indicator of the component is multiplied by a factor, such that as many
//! samples are above a half as the component has, or such that the volume in which its multilinear
//! interpolation wins is that of the component's samples. The smaller of the two factors is used: the
//! first suits membranes as thin as one sample, but moves the sides of boxes outwards.

use crate::feature::components::{Component, Components};
use crate::feature::gaussian::smooth;
use crate::feature::volume::Volume;
use crate::progress::CancelToken;

/// A component is restored if it keeps less than this share of its samples.
const MIN_KEPT_SHARE: f64 = 0.9;
/// Largest number of samples that are processed to restore components, in units of the image's
/// samples.
const MAX_PASSES: usize = 8;

/// Scores of the best and the second label of each sample.
pub struct LabelCompetition {
    /// Index of the winning label of each sample.
    pub winner: Vec<u32>,
    best_score: Vec<f32>,
    second_score: Vec<f32>,
}

impl LabelCompetition {
    /// Smooths `count` labels over `sigma` samples; `label` is the label index of each sample.
    pub fn run<const D: usize>(
        components: &Components<D>,
        label: &[u32],
        count: usize,
        sigma: f64,
        cancel: &CancelToken<'_>,
    ) -> Self {
        let mut competition = Self {
            winner: vec![0; label.len()],
            best_score: vec![f32::NEG_INFINITY; label.len()],
            second_score: vec![0.0; label.len()],
        };
        let mut parts_by_label = vec![Vec::new(); count];
        for part in &components.components {
            parts_by_label[part.label as usize].push(part);
        }
        for (number, parts) in (0..).zip(parts_by_label) {
            if cancel.is_cancelled() {
                break;
            }
            let Some(sample_box) = SampleBox::around_parts(components.dims, parts, sigma) else {
                continue;
            };
            let share = sample_box.smooth_indicator(|i| label[i] == number, sigma, cancel);
            sample_box.for_each_sample(|i, j| competition.update(i, number, share[j]));
        }
        competition.restore_parts(components, label, sigma, cancel);
        competition
    }

    /// Returns the winner of each sample and its lead over the second label.
    pub fn into_lead(self) -> (Vec<u32>, Vec<f32>) {
        let mut lead = self.best_score;
        lead.iter_mut()
            .zip(&self.second_score)
            .for_each(|(b, s)| *b -= s);
        (self.winner, lead)
    }

    fn update(&mut self, i: usize, number: u32, share: f32) {
        if share > self.best_score[i] {
            if self.winner[i] != number && self.best_score[i] > self.second_score[i] {
                self.second_score[i] = self.best_score[i];
            }
            self.best_score[i] = share;
            self.winner[i] = number;
        } else if share > self.second_score[i] && self.winner[i] != number {
            self.second_score[i] = share;
        }
    }

    /// Restores components that lost many samples.
    fn restore_parts<const D: usize>(
        &mut self,
        components: &Components<D>,
        label: &[u32],
        sigma: f64,
        cancel: &CancelToken<'_>,
    ) {
        let mut kept_counts = vec![0usize; components.components.len()];
        let mut majority_counts = vec![0usize; components.components.len()];
        for (i, &part) in components.component_of_sample.iter().enumerate() {
            kept_counts[part as usize] += usize::from(self.winner[i] == label[i]);
            majority_counts[part as usize] +=
                usize::from(self.winner[i] == label[i] && self.best_score[i] > 0.5);
        }
        let mut remaining_samples = MAX_PASSES * label.len();
        for (number, part) in components.components.iter().enumerate() {
            // A wall between two other labels may win although no label has a majority, but by so
            // little that most of it is lost.
            let loses_much = (kept_counts[number] as f64)
                < MIN_KEPT_SHARE * part.sample_count as f64
                || 2 * majority_counts[number] < part.sample_count;
            let Some(sample_box) =
                SampleBox::around_parts(components.dims, [part], sigma).filter(|_| loses_much)
            else {
                continue;
            };
            if cancel.is_cancelled() || sample_box.sample_count() > remaining_samples {
                break;
            }
            remaining_samples -= sample_box.sample_count();
            let part_indicator = sample_box.smooth_indicator(
                |i| components.component_of_sample[i] == number as u32,
                sigma,
                cancel,
            );
            let is_part = |i: usize| components.component_of_sample[i] == number as u32;
            let volume = sample_box.volume_inside(is_part);
            let levels = [
                level_of_volume(&sample_box, &part_indicator, volume),
                level_of_count(&part_indicator, part.sample_count),
            ];
            let level = levels.into_iter().flatten().reduce(f32::max);
            let Some(level) = level.filter(|level| *level < 0.5) else {
                continue;
            };
            let factor = (1.0 - level) / level;
            let label_indicator =
                sample_box.smooth_indicator(|i| label[i] == part.label, sigma, cancel);
            sample_box.for_each_sample(|i, j| {
                if part_indicator[j] > 0.0 {
                    self.update(
                        i,
                        part.label,
                        label_indicator[j] + (factor - 1.0) * part_indicator[j],
                    );
                }
            });
        }
    }
}

/// Number of bins of the histogram of a smoothed indicator.
const BIN_COUNT: usize = 4096;

/// Returns the level above which the multilinear interpolation of a smoothed indicator has this volume, in
/// samples.
fn level_of_volume<const D: usize>(
    sample_box: &SampleBox<D>,
    indicator: &[f32],
    volume: f64,
) -> Option<f32> {
    let mut counts = vec![0u64; BIN_COUNT];
    sample_box.for_each_interpolated(indicator, |value| {
        let bin = (value * BIN_COUNT as f32) as usize;
        counts[bin.min(BIN_COUNT - 1)] += 1;
    });
    let target = volume * f64::from(1u32 << D);
    let mut above = 0.0;
    let bin = (0..BIN_COUNT).rev().find(|&bin| {
        above += counts[bin] as f64;
        above >= target
    })?;
    let excess = (above - target) / (counts[bin] as f64).max(1.0);
    (bin > 0).then_some(((bin as f64 + excess) / BIN_COUNT as f64) as f32)
}

/// Returns the level above which a smoothed indicator has this number of samples.
fn level_of_count(indicator: &[f32], count: usize) -> Option<f32> {
    let mut sorted: Vec<f32> = indicator.to_vec();
    let last = count
        .checked_sub(1)
        .filter(|last| last + 1 < sorted.len())?;
    let descending = |a: &f32, b: &f32| b.total_cmp(a);
    let (_, &mut inside, outside) = sorted.select_nth_unstable_by(last, descending);
    let outside = outside.iter().copied().fold(0.0, f32::max);
    let level = 0.5 * (inside + outside);
    (level > 0.0).then_some(level)
}

/// A box of samples around components of labels, widened by the reach of smoothing.
struct SampleBox<const D: usize> {
    origin: [usize; D],
    size: [usize; D],
    image_dims: [usize; D],
}

impl<const D: usize> SampleBox<D> {
    /// Returns the box around some components; `None` if there are none.
    fn around_parts<'a>(
        dims: [usize; D],
        parts: impl IntoIterator<Item = &'a Component<D>>,
        sigma: f64,
    ) -> Option<Self> {
        let bounds = parts
            .into_iter()
            .map(|part| (part.min_corner, part.max_corner));
        let (low, high) = bounds.reduce(|(low, high), (l, h)| {
            (
                std::array::from_fn(|k| low[k].min(l[k])),
                std::array::from_fn(|k| high[k].max(h[k])),
            )
        })?;
        let reach = (4.0 * sigma).ceil() as usize + 1;
        let low = low.map(|l| l.saturating_sub(reach));
        Some(Self {
            size: std::array::from_fn(|k| (high[k] + reach + 1).min(dims[k]) - low[k]),
            origin: low,
            image_dims: dims,
        })
    }

    fn sample_count(&self) -> usize {
        self.size.iter().product()
    }

    /// Calls `visit` for each sample, with its index in the image and in the box.
    fn for_each_sample(&self, mut visit: impl FnMut(usize, usize)) {
        let (image_volume, box_volume) = (
            Volume::new(self.image_dims, &[]),
            Volume::new(self.size, &[]),
        );
        for row in 0..self.sample_count() / self.size[0] {
            let first = box_volume.coordinates(row * self.size[0]);
            let start = image_volume.index(std::array::from_fn(|k| first[k] + self.origin[k]));
            for x in 0..self.size[0] {
                visit(start + x, row * self.size[0] + x);
            }
        }
    }

    /// Returns the volume of the samples that are `inside`, in samples. Samples on a side of the image
    /// count by half.
    fn volume_inside(&self, inside: impl Fn(usize) -> bool) -> f64 {
        let volume = Volume::new(self.image_dims, &[]);
        let mut sum = 0.0;
        self.for_each_sample(|i, _| {
            if inside(i) {
                let at: [usize; D] = volume.coordinates(i);
                let is_on_side = |&k: &usize| {
                    let last = self.image_dims[k] - 1;
                    last > 0 && (at[k] == 0 || at[k] == last)
                };
                sum += 0.5f64.powi((0..D).filter(is_on_side).count() as i32);
            }
        });
        sum
    }

    /// Calls `visit` with the multilinear interpolation of values at two points along each axis of each
    /// cell between samples.
    fn for_each_interpolated(&self, values: &[f32], mut visit: impl FnMut(f32)) {
        let box_volume = Volume::new(self.size, &[]);
        let strides = box_volume.strides();
        let mut corners = [0.0f32; 8];
        for first in 0..self.sample_count() {
            let at: [usize; D] = box_volume.coordinates(first);
            if (0..D).any(|k| self.size[k] > 1 && at[k] + 1 == self.size[k]) {
                continue;
            }
            for (corner, value) in corners.iter_mut().enumerate().take(1 << D) {
                let offset = |k: usize| {
                    let is_upper = corner >> k & 1 == 1 && self.size[k] > 1;
                    if is_upper { strides[k] } else { 0 }
                };
                *value = values[first + (0..D).map(offset).sum::<usize>()];
            }
            if corners[..1 << D].iter().all(|value| *value == 0.0) {
                continue;
            }
            for point in 0..1usize << D {
                let weight = |corner: usize| {
                    // The nearer of the two samples along an axis has three quarters.
                    let far = (point ^ corner).count_ones() as i32;
                    0.75f32.powi(D as i32 - far) * 0.25f32.powi(far)
                };
                let terms = (0..1 << D).map(|corner| weight(corner) * corners[corner]);
                visit(terms.sum());
            }
        }
    }

    /// Returns the smoothed indicator of the samples that are `inside`.
    fn smooth_indicator(
        &self,
        inside: impl Fn(usize) -> bool,
        sigma: f64,
        cancel: &CancelToken<'_>,
    ) -> Vec<f32> {
        let mut indicator = vec![0.0; self.sample_count()];
        self.for_each_sample(|i, j| indicator[j] = f32::from(u8::from(inside(i))));
        smooth(self.size, &mut indicator, [sigma; D], cancel);
        indicator
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the number of samples that label 1 wins, divided by the number of samples that are
    /// `inside`.
    fn kept_share(inside: impl Fn([usize; 3]) -> bool) -> f64 {
        let dims = [24, 22, 20];
        let volume = Volume::new(dims, &[]);
        let label: Vec<u32> = (0..dims.iter().product())
            .map(|i| u32::from(inside(volume.coordinates(i))))
            .collect();
        let components = Components::from_labels(dims, &label);
        let competition = LabelCompetition::run(&components, &label, 2, 1.0, &CancelToken::never());
        let (winner, lead) = competition.into_lead();
        assert!(lead.iter().all(|lead| *lead >= 0.0));
        let count = |labels: &[u32]| labels.iter().filter(|label| **label == 1).count() as f64;
        count(&winner) / count(&label)
    }

    /// Along the lines through its middle, an interface lies a little outside of the box, as much as makes
    /// up for its round edges.
    #[test]
    fn a_box_keeps_its_volume_within_a_fiftieth() {
        let dims = [28, 24, 20];
        let volume = Volume::new(dims, &[]);
        let ranges = [4..14, 6..18, 5..13];
        let label: Vec<u32> = (0..dims.iter().product())
            .map(|i| {
                let at = volume.coordinates(i);
                u32::from((0..3).all(|k| ranges[k].contains(&at[k])))
            })
            .collect();
        let components = Components::from_labels(dims, &label);
        let competition = LabelCompetition::run(&components, &label, 2, 1.0, &CancelToken::never());
        let (winner, lead) = competition.into_lead();
        let signed: Vec<f32> = (winner.iter().zip(&lead))
            .map(|(winner, lead)| if *winner == 1 { *lead } else { -lead })
            .collect();
        let whole = SampleBox {
            origin: [0; 3],
            size: dims,
            image_dims: dims,
        };
        let mut points = 0;
        whole.for_each_interpolated(&signed, |value| points += usize::from(value > 0.0));
        let share = points as f64 / 8.0 / 960.0;
        assert!((share - 1.0).abs() < 0.02, "{share}");
    }

    #[test]
    fn small_or_thin_parts_keep_their_volume() {
        assert_eq!(kept_share(|p| p == [12, 11, 9]), 1.0);
        let square_distance = |p: [usize; 3]| {
            [12.0, 11.0, 9.0]
                .map(|c| c)
                .iter()
                .zip(p)
                .fold(0.0, |s, (c, x)| s + (x as f64 - c).powi(2))
        };
        assert!((kept_share(|p| square_distance(p) < 3.0) - 1.0).abs() < 0.1);
        // A membrane one sample thick, flat and tilted.
        assert_eq!(kept_share(|p| p[2] == 8), 1.0);
        let tilted = kept_share(|p| (p[0] + 2 * p[2]) / 2 == 17);
        assert!((tilted - 1.0).abs() < 0.1, "{tilted}");
    }
}

//! Which label leads at each sample, once their stairs are smoothed.
//!
//! The indicator of each label is smoothed; the label with the largest one leads. That takes from
//! whatever is thin or small. Parts of labels that would lose much to their neighbours are therefore
//! raised: their own smoothed indicator, times a factor such that as many samples are above a half as
//! the part has, so that balls and membranes as thin as a sample keep their volume.

use crate::feature::components::{Component, Components};
use crate::feature::gaussian::smooth;
use crate::feature::volume::Volume;
use crate::progress::CancelToken;

/// A part of which fewer of its samples stay its own is raised.
const MIN_KEPT_SHARE: f64 = 0.9;
/// So many times the samples of the image may be looked at to raise parts.
const MAX_PASSES: usize = 8;

/// Labels, each with its lead over the next.
pub struct LabelCompetition {
    /// The number of the label that leads at each sample.
    pub winner: Vec<u32>,
    best_score: Vec<f32>,
    second_score: Vec<f32>,
}

impl LabelCompetition {
    /// Between the labels of samples, of which there are `count`, smoothed over `sigma`.
    pub fn run<const D: usize>(
        components: &Components<D>,
        label: &[u32],
        count: usize,
        sigma: f64,
        patience: &CancelToken<'_>,
    ) -> Self {
        let mut contest = Self {
            winner: vec![0; label.len()],
            best_score: vec![f32::NEG_INFINITY; label.len()],
            second_score: vec![0.0; label.len()],
        };
        let mut parts = vec![Vec::new(); count];
        for part in &components.components {
            parts[part.label as usize].push(part);
        }
        for (number, parts) in (0..).zip(parts) {
            if patience.is_cancelled() {
                break;
            }
            let Some(room) = SampleBox::around_parts(components.dims, parts, sigma) else {
                continue;
            };
            let share = room.smooth_indicator(|i| label[i] == number, sigma, patience);
            room.for_each_sample(|i, j| contest.update(i, number, share[j]));
        }
        contest.restore_parts(components, label, sigma, patience);
        contest
    }

    /// By how much the winner leads.
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

    /// Raises what lost much.
    fn restore_parts<const D: usize>(
        &mut self,
        components: &Components<D>,
        label: &[u32],
        sigma: f64,
        patience: &CancelToken<'_>,
    ) {
        let mut stay = vec![0usize; components.components.len()];
        let mut half = vec![0usize; components.components.len()];
        for (i, &part) in components.component_of_sample.iter().enumerate() {
            stay[part as usize] += usize::from(self.winner[i] == label[i]);
            half[part as usize] +=
                usize::from(self.winner[i] == label[i] && self.best_score[i] > 0.5);
        }
        let mut effort = MAX_PASSES * label.len();
        for (number, part) in components.components.iter().enumerate() {
            // A wall between two others leads where neither has more, but by so little that most of it is lost.
            let few = (stay[number] as f64) < MIN_KEPT_SHARE * part.sample_count as f64
                || 2 * half[number] < part.sample_count;
            let Some(room) =
                SampleBox::around_parts(components.dims, [part], sigma).filter(|_| few)
            else {
                continue;
            };
            if patience.is_cancelled() || room.sample_count() > effort {
                break;
            }
            effort -= room.sample_count();
            let own = room.smooth_indicator(
                |i| components.component_of_sample[i] == number as u32,
                sigma,
                patience,
            );
            let Some(factor) = restoring_factor(&own, part.sample_count) else {
                continue;
            };
            let all = room.smooth_indicator(|i| label[i] == part.label, sigma, patience);
            room.for_each_sample(|i, j| {
                if own[j] > 0.0 {
                    self.update(i, part.label, all[j] + (factor - 1.0) * own[j]);
                }
            });
        }
    }
}

/// What a smoothed indicator is to be multiplied by so that it leads at `count` samples over what is
/// left to others; `None` if it does so anyhow.
fn restoring_factor(indicator: &[f32], count: usize) -> Option<f32> {
    let mut sorted: Vec<f32> = indicator.to_vec();
    let last = count
        .checked_sub(1)
        .filter(|last| last + 1 < sorted.len())?;
    let descending = |a: &f32, b: &f32| b.total_cmp(a);
    let (_, &mut inside, outside) = sorted.select_nth_unstable_by(last, descending);
    let outside = outside.iter().copied().fold(0.0, f32::max);
    let level = 0.5 * (inside + outside);
    (level > 0.0 && level < 0.5).then(|| (1.0 - level) / level)
}

/// A box of samples: parts of labels, and as far round them as smoothing carries.
struct SampleBox<const D: usize> {
    origin: [usize; D],
    size: [usize; D],
    image_dims: [usize; D],
}

impl<const D: usize> SampleBox<D> {
    /// Round some parts; `None` if there is none.
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

    /// Visits each sample: its index in the image and here.
    fn for_each_sample(&self, mut visit: impl FnMut(usize, usize)) {
        let (whole, here) = (
            Volume::new(self.image_dims, &[]),
            Volume::new(self.size, &[]),
        );
        for row in 0..self.sample_count() / self.size[0] {
            let first = here.coordinates(row * self.size[0]);
            let at = whole.index(std::array::from_fn(|k| first[k] + self.origin[k]));
            for x in 0..self.size[0] {
                visit(at + x, row * self.size[0] + x);
            }
        }
    }

    /// The indicator of what is `inside`, smoothed.
    fn smooth_indicator(
        &self,
        inside: impl Fn(usize) -> bool,
        sigma: f64,
        patience: &CancelToken<'_>,
    ) -> Vec<f32> {
        let mut indicator = vec![0.0; self.sample_count()];
        self.for_each_sample(|i, j| indicator[j] = f32::from(u8::from(inside(i))));
        smooth(self.size, &mut indicator, [sigma; D], patience);
        indicator
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The share of its samples that label 1 wins where `inside` is painted.
    fn kept_share(inside: impl Fn([usize; 3]) -> bool) -> f64 {
        let dims = [24, 22, 20];
        let volume = Volume::new(dims, &[]);
        let label: Vec<u32> = (0..dims.iter().product())
            .map(|i| u32::from(inside(volume.coordinates(i))))
            .collect();
        let components = Components::from_labels(dims, &label);
        let contest = LabelCompetition::run(&components, &label, 2, 1.0, &CancelToken::never());
        let (winner, lead) = contest.into_lead();
        assert!(lead.iter().all(|lead| *lead >= 0.0));
        let count = |of: &[u32]| of.iter().filter(|label| **label == 1).count() as f64;
        count(&winner) / count(&label)
    }

    #[test]
    fn what_is_small_or_thin_keeps_its_volume() {
        assert_eq!(kept_share(|p| p == [12, 11, 9]), 1.0);
        let off = |p: [usize; 3]| {
            [12.0, 11.0, 9.0]
                .map(|c| c)
                .iter()
                .zip(p)
                .fold(0.0, |s, (c, x)| s + (x as f64 - c).powi(2))
        };
        assert!((kept_share(|p| off(p) < 3.0) - 1.0).abs() < 0.1);
        // A membrane one sample thick, flat and tilted.
        assert_eq!(kept_share(|p| p[2] == 8), 1.0);
        let tilted = kept_share(|p| (p[0] + 2 * p[2]) / 2 == 17);
        assert!((tilted - 1.0).abs() < 0.1, "{tilted}");
    }
}

//! Which label leads at each sample, once their stairs are smoothed.
//!
//! The indicator of each label is smoothed; the label with the largest one leads. That takes from
//! whatever is thin or small. Parts of labels that would lose much to their neighbours are therefore
//! raised: their own smoothed indicator, times a factor such that as many samples are above a half as
//! the part has, so that balls and membranes as thin as a sample keep their volume.

use crate::feature::components::{Component, Components};
use crate::feature::gaussian::smooth;
use crate::feature::volume::Volume;
use crate::observer::Patience;

/// A part of which fewer of its samples stay its own is raised.
const STAYS: f64 = 0.9;
/// So many times the samples of the image may be looked at to raise parts.
const EFFORT: usize = 8;

/// Labels, each with its lead over the next.
pub struct Contest {
    /// The number of the label that leads at each sample.
    pub winner: Vec<u32>,
    best: Vec<f32>,
    second: Vec<f32>,
}

impl Contest {
    /// Between the labels of samples, of which there are `count`, smoothed over `sigma`.
    pub fn held<const D: usize>(
        components: &Components<D>,
        label: &[u32],
        count: usize,
        sigma: f64,
        patience: &Patience<'_>,
    ) -> Self {
        let mut contest = Self {
            winner: vec![0; label.len()],
            best: vec![f32::NEG_INFINITY; label.len()],
            second: vec![0.0; label.len()],
        };
        let mut parts = vec![Vec::new(); count];
        for part in &components.all {
            parts[part.label as usize].push(part);
        }
        for (number, parts) in (0..).zip(parts) {
            if patience.over() {
                break;
            }
            let Some(room) = Room::of(components.dims, parts, sigma) else {
                continue;
            };
            let share = room.smoothed(|i| label[i] == number, sigma, patience);
            room.each(|i, j| contest.enter(i, number, share[j]));
        }
        contest.raise(components, label, sigma, patience);
        contest
    }

    /// By how much the winner leads.
    pub fn lead(self) -> (Vec<u32>, Vec<f32>) {
        let mut lead = self.best;
        lead.iter_mut().zip(&self.second).for_each(|(b, s)| *b -= s);
        (self.winner, lead)
    }

    fn enter(&mut self, i: usize, number: u32, share: f32) {
        if share > self.best[i] {
            if self.winner[i] != number && self.best[i] > self.second[i] {
                self.second[i] = self.best[i];
            }
            self.best[i] = share;
            self.winner[i] = number;
        } else if share > self.second[i] && self.winner[i] != number {
            self.second[i] = share;
        }
    }

    /// Raises what lost much.
    fn raise<const D: usize>(
        &mut self,
        components: &Components<D>,
        label: &[u32],
        sigma: f64,
        patience: &Patience<'_>,
    ) {
        let mut stay = vec![0usize; components.all.len()];
        let mut half = vec![0usize; components.all.len()];
        for (i, &part) in components.of_sample.iter().enumerate() {
            stay[part as usize] += usize::from(self.winner[i] == label[i]);
            half[part as usize] += usize::from(self.winner[i] == label[i] && self.best[i] > 0.5);
        }
        let mut effort = EFFORT * label.len();
        for (number, part) in components.all.iter().enumerate() {
            // A wall between two others leads where neither has more, but by so little that most of it is lost.
            let few = (stay[number] as f64) < STAYS * part.samples as f64
                || 2 * half[number] < part.samples;
            let Some(room) = Room::of(components.dims, [part], sigma).filter(|_| few) else {
                continue;
            };
            if patience.over() || room.samples() > effort {
                break;
            }
            effort -= room.samples();
            let own = room.smoothed(
                |i| components.of_sample[i] == number as u32,
                sigma,
                patience,
            );
            let Some(factor) = factor(&own, part.samples) else {
                continue;
            };
            let all = room.smoothed(|i| label[i] == part.label, sigma, patience);
            room.each(|i, j| {
                if own[j] > 0.0 {
                    self.enter(i, part.label, all[j] + (factor - 1.0) * own[j]);
                }
            });
        }
    }
}

/// What a smoothed indicator is to be multiplied by so that it leads at `count` samples over what is
/// left to others; `None` if it does so anyhow.
fn factor(indicator: &[f32], count: usize) -> Option<f32> {
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
struct Room<const D: usize> {
    low: [usize; D],
    size: [usize; D],
    dims: [usize; D],
}

impl<const D: usize> Room<D> {
    /// Round some parts; `None` if there is none.
    fn of<'a>(
        dims: [usize; D],
        parts: impl IntoIterator<Item = &'a Component<D>>,
        sigma: f64,
    ) -> Option<Self> {
        let bounds = parts.into_iter().map(|part| (part.low, part.high));
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
            low,
            dims,
        })
    }

    fn samples(&self) -> usize {
        self.size.iter().product()
    }

    /// Visits each sample: its index in the image and here.
    fn each(&self, mut visit: impl FnMut(usize, usize)) {
        let (whole, here) = (Volume::new(self.dims, &[]), Volume::new(self.size, &[]));
        for row in 0..self.samples() / self.size[0] {
            let first = here.coordinates(row * self.size[0]);
            let at = whole.index(std::array::from_fn(|k| first[k] + self.low[k]));
            for x in 0..self.size[0] {
                visit(at + x, row * self.size[0] + x);
            }
        }
    }

    /// The indicator of what is `inside`, smoothed.
    fn smoothed(
        &self,
        inside: impl Fn(usize) -> bool,
        sigma: f64,
        patience: &Patience<'_>,
    ) -> Vec<f32> {
        let mut indicator = vec![0.0; self.samples()];
        self.each(|i, j| indicator[j] = f32::from(u8::from(inside(i))));
        smooth(self.size, &mut indicator, [sigma; D], patience);
        indicator
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The share of its samples that label 1 wins where `inside` is painted.
    fn kept(inside: impl Fn([usize; 3]) -> bool) -> f64 {
        let dims = [24, 22, 20];
        let volume = Volume::new(dims, &[]);
        let label: Vec<u32> = (0..dims.iter().product())
            .map(|i| u32::from(inside(volume.coordinates(i))))
            .collect();
        let components = Components::of(dims, &label);
        let contest = Contest::held(&components, &label, 2, 1.0, &Patience::endless());
        let (winner, lead) = contest.lead();
        assert!(lead.iter().all(|lead| *lead >= 0.0));
        let count = |of: &[u32]| of.iter().filter(|label| **label == 1).count() as f64;
        count(&winner) / count(&label)
    }

    #[test]
    fn what_is_small_or_thin_keeps_its_volume() {
        assert_eq!(kept(|p| p == [12, 11, 9]), 1.0);
        let off = |p: [usize; 3]| {
            [12.0, 11.0, 9.0]
                .map(|c| c)
                .iter()
                .zip(p)
                .fold(0.0, |s, (c, x)| s + (x as f64 - c).powi(2))
        };
        assert!((kept(|p| off(p) < 3.0) - 1.0).abs() < 0.1);
        // A membrane one sample thick, flat and tilted.
        assert_eq!(kept(|p| p[2] == 8), 1.0);
        let tilted = kept(|p| (p[0] + 2 * p[2]) / 2 == 17);
        assert!((tilted - 1.0).abs() < 0.1, "{tilted}");
    }
}

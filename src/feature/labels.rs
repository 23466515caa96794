//! Interfaces between labels, and thin masks.
//!
//! The indicator of each label is smoothed; the winner at a sample is the label with the largest
//! smoothed indicator, and its lead is how far it is ahead of the runner-up. Between two samples with
//! different winners the interface lies where the lead changes hands. That is smooth where the labels
//! are stairs, counts every interface once, and needs no special case where three labels meet.

use super::crossing::{Candidate, dominant_axes};
use super::gaussian::smooth;
use super::volume::Volume;

/// More different values than this are no labels.
pub const MOST_LABELS: usize = 64;

/// The different values of a volume in ascending order, if there are at most [`MOST_LABELS`].
pub fn values(samples: &[f32]) -> Option<Vec<f32>> {
    let mut found: Vec<f32> = Vec::new();
    let mut last = f32::NAN;
    for &s in samples {
        if s != last {
            last = s;
            if let Err(i) = found.binary_search_by(|v| v.total_cmp(&s)) {
                if found.len() == MOST_LABELS {
                    return None;
                }
                found.insert(i, s);
            }
        }
    }
    Some(found)
}

/// Masks thinner than this (samples) stand for the sheet in their middle: no lattice has cells inside.
pub const THIN: f64 = 3.5;

/// A mask's minority: its value, its share of the volume and its mean thickness in samples.
#[derive(Debug, Clone, Copy)]
pub struct Mask {
    /// The value of the samples in the minority.
    pub value: f32,
    /// Their share of all samples.
    pub share: f64,
    /// Mean thickness in samples: twice the volume over the surface.
    pub thickness: f64,
}

/// Describes a volume of two values.
pub fn mask<const D: usize>(volume: Volume<'_, D>, [a, b]: [f32; 2]) -> Mask {
    let s = volume.samples;
    let count = s.iter().filter(|v| **v == b).count();
    let (value, count) = if 2 * count <= s.len() {
        (b, count)
    } else {
        (a, s.len() - count)
    };
    let faces: usize = volume
        .strides()
        .iter()
        .map(|&stride| {
            s.iter()
                .zip(s.iter().skip(stride))
                .filter(|(u, v)| u != v)
                .count()
        })
        .sum();
    // On average over all slopes, a surface has 3/2 as many sample faces as its area, and a curve
    // 4 / pi as many sample edges as its length.
    let excess = if D == 3 {
        1.5
    } else {
        4.0 / std::f64::consts::PI
    };
    Mask {
        value,
        share: count as f64 / s.len().max(1) as f64,
        thickness: 2.0 * excess * count as f64 / faces.max(1) as f64,
    }
}

/// Points on the interfaces between labels, in the order of samples; `sigma` smooths the stairs.
pub fn interfaces<const D: usize>(
    volume: Volume<'_, D>,
    labels: &[f32],
    sigma: f64,
) -> Vec<Candidate<D>> {
    let dims = volume.dims;
    let count = volume.samples.len();
    let mut winner = vec![0u8; count];
    let mut best = vec![f32::NEG_INFINITY; count];
    let mut second = vec![f32::NEG_INFINITY; count];
    let mut indicator = vec![0.0f32; count];
    for (number, label) in labels.iter().enumerate() {
        for (i, s) in indicator.iter_mut().zip(volume.samples) {
            *i = f32::from(u8::from(s == label));
        }
        smooth(dims, &mut indicator, [sigma; D]);
        for i in 0..count {
            let value = indicator[i];
            if value > best[i] {
                second[i] = best[i];
                best[i] = value;
                winner[i] = number as u8;
            } else if value > second[i] {
                second[i] = value;
            }
        }
    }
    drop(indicator);
    best.iter_mut().zip(&second).for_each(|(b, s)| *b -= s);
    drop(second);
    let lead = Lead {
        winner: &winner,
        lead: Volume {
            dims,
            samples: &best,
        },
    };
    lead.lead
        .by_rows(|first, (): &mut (), found| lead.row(first, found))
}

/// The winning label of each sample and how far it leads.
struct Lead<'a, const D: usize> {
    winner: &'a [u8],
    lead: Volume<'a, D>,
}

impl<const D: usize> Lead<'_, D> {
    fn row(&self, first: [usize; D], found: &mut Vec<Candidate<D>>) {
        let (lead, dims, strides) = (self.lead.samples, self.lead.dims, self.lead.strides());
        let start = self.lead.index(first);
        for x in 0..dims[0] {
            let mut at = first;
            at[0] = x;
            let i = start + x;
            for axis in 0..D {
                if at[axis] + 1 >= dims[axis] {
                    continue;
                }
                let j = i + strides[axis];
                if self.winner[i] == self.winner[j] {
                    continue;
                }
                let normal = self.normal(at, self.winner[i], self.winner[j]);
                if !dominant_axes(normal).any(|a| a == axis) {
                    continue;
                }
                let offset = lead[i] / (lead[i] + lead[j]).max(1e-12);
                let mut position = at.map(|i| i as f32);
                position[axis] += offset;
                found.push(Candidate {
                    voxel: i as u32,
                    axis: axis as u8,
                    position,
                    normal: normal.map(|c| c as f32),
                    strength: 1.0,
                });
            }
        }
    }

    /// Unit gradient of label `a`'s lead over label `b` round a sample (other labels: no lead).
    fn normal(&self, at: [usize; D], a: u8, b: u8) -> [f64; D] {
        let signed = |p: [usize; D]| {
            let i = self.lead.index(p);
            match self.winner[i] {
                w if w == a => f64::from(self.lead.samples[i]),
                w if w == b => -f64::from(self.lead.samples[i]),
                _ => 0.0,
            }
        };
        let gradient: [f64; D] = std::array::from_fn(|k| {
            let (mut before, mut after) = (at, at);
            before[k] = before[k].saturating_sub(1);
            after[k] = (after[k] + 1).min(self.lead.dims[k] - 1);
            let span = (after[k] - before[k]).max(1) as f64;
            (signed(after) - signed(before)) / span
        });
        let length = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        if length > 0.0 {
            return gradient.map(|g| g / length);
        }
        let mut any = [0.0; D];
        any[0] = 1.0;
        any
    }
}

//! Labels: the interfaces between them, and thin masks.
//!
//! The indicator of each label is smoothed; the winner at a sample is the label with the largest
//! smoothed indicator, and its lead is how far it is ahead of the runner-up. Between two samples with
//! different winners the interface lies where the lead changes hands. That is smooth where the labels
//! are stairs, counts every interface once, and needs no special case where three labels meet.
//!
//! A mask (two values) of thin sheets stands for what is in their middle: see
//! [`masks`](mod@super::masks).
//!
//! Scale: one sample. Assumption: a label's regions are thicker than 1.4 times the scale, or smoothing
//! gives them to their neighbours.

use super::masks::{self, Mask};
use super::ridges::RidgeSearch;
use super::{Detector, Found, Scene, Thresholds};
use crate::error::{Error, Result, cause};
use crate::feature::FeatureKind;
use crate::feature::crossing::{Candidate, dominant_axes};
use crate::feature::gaussian::smooth;
use crate::feature::volume::Volume;
use crate::observer::Patience;

/// Finds interfaces between labels, and the middle of a thin mask.
pub struct Labels;

impl<const D: usize> Detector<D> for Labels {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Labels
    }

    fn find(&self, scene: &Scene<'_, D>, notes: &mut Vec<String>) -> Result<Found<D>> {
        let volume = scene.volume();
        let Some(values) = values(volume.samples) else {
            return Err(Error::Feature(cause(
                "feature 'labels'",
                format!("the image has more than {MOST_LABELS} different values"),
                "choose ridges, edges or horizons, or merge labels",
            )));
        };
        if let Some(settled) = scene.settled {
            if let Some(value) = settled.mask {
                let middle = masks::middle_of(volume, value, scene.patience);
                return Ok(middle_sheet(value, middle, scene, notes));
            }
        } else if let [a, b] = values[..]
            && let Some(mask) = Mask::of(volume, [a, b], scene.patience)
        {
            notes.push(format!(
                "a mask {:.1} samples thick, {:.1} % of the volume: its middle is the feature",
                mask.thickness,
                100.0 * mask.share
            ));
            return Ok(middle_sheet(mask.value, mask.middle, scene, notes));
        }
        let scale = scene.scale();
        notes.push(format!(
            "interfaces between {} labels, smoothed over {scale}",
            values.len()
        ));
        let candidates = interfaces(volume, &values, scale, scene.patience);
        // Each is as strong as 1: all are followed.
        let thresholds = Thresholds {
            low: 0.0,
            high: 1.0,
            origin: "all",
        };
        Ok(Found::new(candidates, scale, thresholds))
    }
}

/// The sheets in the middle of the mask of one value.
fn middle_sheet<const D: usize>(
    value: f32,
    middle: Vec<f32>,
    scene: &Scene<'_, D>,
    notes: &mut Vec<String>,
) -> Found<D> {
    let search = RidgeSearch {
        finest: MIDDLE,
        most_ambiguous: f64::INFINITY,
        least: |_| LEAST,
        ..RidgeSearch::new(scene)
    };
    Found {
        mask: Some(value),
        ..search.find(middle, notes)
    }
}

/// The scale (samples) at which the middle of a mask is sought: it is narrow, and noise has no part in it.
const MIDDLE: f64 = 1.0;
/// Points at all angles are kept down to this share of the strong ones: without noise, more than usual.
const LEAST: f32 = 0.4;

/// More different values than this are no labels.
const MOST_LABELS: usize = 64;

/// The different values of a volume in ascending order, if there are at most 64.
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

/// Points on the interfaces between labels, in the order of samples; `sigma` smooths the stairs.
fn interfaces<const D: usize>(
    volume: Volume<'_, D>,
    labels: &[f32],
    sigma: f64,
    patience: &Patience<'_>,
) -> Vec<Candidate<D>> {
    let dims = volume.dims;
    let count = volume.samples.len();
    let mut winner = vec![0u8; count];
    let mut best = vec![f32::NEG_INFINITY; count];
    let mut second = vec![f32::NEG_INFINITY; count];
    let mut indicator = vec![0.0f32; count];
    for (number, label) in labels.iter().enumerate() {
        if patience.over() {
            break;
        }
        for (i, s) in indicator.iter_mut().zip(volume.samples) {
            *i = f32::from(u8::from(s == label));
        }
        smooth(dims, &mut indicator, [sigma; D], patience);
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
        .by_rows(patience, |first, (): &mut (), found| lead.row(first, found))
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
                found.push(Candidate::new(dims, at, axis, offset, normal, 1.0));
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

#[cfg(test)]
mod tests {
    use crate::feature::scenes::{Sheet, fit, image_of};
    use crate::feature::{Detection, FeatureKind, detect};

    #[test]
    fn interfaces_of_labels_are_smooth_and_counted_once() {
        let dims = [64, 60, 56];
        let ball = || Sheet::Sphere([32.0, 30.0, 28.0], 18.0);
        let floor = || Sheet::plane([0.2, 0.1, 1.0], [32.0, 30.0, 4.0]);
        let image = image_of(dims, |p| {
            if ball().distance(p) < 0.0 {
                7.0
            } else {
                f64::from(u8::from(floor().distance(p) > 0.0))
            }
        });
        let features = detect(&image, &Detection::of(FeatureKind::Auto, 5.0)).unwrap();
        assert!(features.notes[0].contains("labels"), "{:?}", features.notes);
        let sheets = [ball(), floor()];
        let fit = fit(dims, &sheets, &features.points);
        assert!(fit.coverage > 0.98 && fit.precision > 0.995, "{fit:?}");
        assert!(fit.rms < 0.2 && fit.angle < 6.0, "{fit:?}");
        // One point per column: the ball has 4 pi r^2 / 1.5 columns, the floor one per (x, y).
        let columns = 4.0 * std::f64::consts::PI * 18.0f64.powi(2) / 1.5 + 64.0 * 60.0;
        let ratio = features.points.len() as f64 / columns;
        assert!(ratio > 0.95 && ratio < 1.25, "{ratio}");
    }

    #[test]
    fn a_thin_mask_is_one_sheet_and_not_two() {
        let (dims, sheets) = (
            [64, 60, 56],
            [Sheet::plane([1.0, 0.35, 0.2], [32.0, 30.0, 28.0])],
        );
        for half in [0.6, 1.5] {
            let image = image_of(dims, |p| {
                255.0 * f64::from(u8::from(sheets[0].distance(p).abs() < half))
            });
            let features = detect(&image, &Detection::of(FeatureKind::Auto, 8.0)).unwrap();
            let fit = fit(dims, &sheets, &features.points);
            assert!(
                fit.coverage > 0.99 && fit.precision > 0.99 && fit.rms < 0.25,
                "{half} {fit:?}"
            );
        }
    }

    #[test]
    fn a_layer_three_samples_thick_keeps_both_sides() {
        let dims = [64, 60, 56];
        let middle = [32.0, 30.0, 28.0];
        let flat =
            |off: f64| Sheet::plane([0.15, 0.1, 1.0], [middle[0], middle[1], middle[2] + off]);
        let bent = |off: f64| Sheet::Cylinder([32.0, -40.0], 70.0 + off);
        for sides in [[flat(-1.5), flat(1.5)], [bent(-1.5), bent(1.5)]] {
            let image = image_of(dims, |p| {
                let above = sides.iter().filter(|s| s.distance(p) > 0.0).count();
                [2.0, 5.0, 9.0][above]
            });
            let asked = Detection {
                up_to: Some(8.0),
                ..Detection::of(FeatureKind::Auto, 8.0 / 3.0)
            };
            let features = detect(&image, &asked).unwrap();
            let fit = fit(dims, &sides, &features.points);
            assert!(fit.coverage > 0.99 && fit.precision > 0.999, "{fit:?}");
            assert!(fit.rms < 0.15, "{fit:?}");
            // Atoms may stand as far apart as the layer is thick.
            let spacing = features.spacing.unwrap();
            let mean = spacing.iter().map(|&d| f64::from(d)).sum::<f64>() / spacing.len() as f64;
            assert!((2.8..3.2).contains(&mean), "{mean}");
        }
    }
}

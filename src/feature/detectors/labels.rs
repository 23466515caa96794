//! Labels: the interfaces between them.
//!
//! The winner at a sample is the label that leads there once stairs are smoothed
//! ([`contest`](mod@super::compete)), and its lead is how far it is ahead of the runner-up. Between two
//! samples with different winners the interface lies where the lead changes hands. That is smooth where
//! the labels are stairs, counts every interface once, and needs no special case where three labels
//! meet.
//!
//! Connected parts of labels that no lattice of the distance asked for can hold are given to what they
//! lie in; where parts are small, atoms stand closer, as far as the distance asked for allows.
//!
//! A mask of thin sheets is sought by [`masks`](mod@super::masks).
//!
//! Scale: one sample.

use super::label_smoothing::LabelCompetition;
use super::masks;
use super::{Detector, DetectorInput, DetectorOutput, Thresholds};
use crate::error::Result;
use crate::feature::candidate::{Candidate, dominant_axes};
use crate::feature::components::{Component, Components};
use crate::feature::label_map::{
    LabelMap, LabelOptions, are_valid_regions, missing_label_error, too_many_labels_error, volumes,
};
use crate::feature::volume::Volume;
use crate::feature::{DetectionOptions, FeatureKind, FeaturePoint};
use crate::image::{LabelTable, LabelValue};
use crate::progress::CancelToken;

/// Finds interfaces between labels.
pub struct Labels;

impl<const D: usize> Detector<D> for Labels {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Labels
    }

    fn find(
        &self,
        scene: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        if let Some(value) = scene.resolved.and_then(|settled| settled.mask) {
            // Meshes of earlier versions name a mask so.
            return masks::find_again(scene, value, notes);
        }
        let table = LabelTable::from_image(scene.image()?).ok_or_else(too_many_labels_error)?;
        let values = &table.values;
        let absent =
            |wish: &&LabelOptions| wish.merge_into.is_none() && !values.contains(&wish.label);
        if let Some(wish) = scene.options.labels.iter().find(absent) {
            return Err(missing_label_error(wish, values));
        }
        if !are_valid_regions(values) {
            notes.push(
                "labels are not all whole numbers of 32 bits: 'region' numbers them from 0, in ascending order"
                    .into(),
            );
        }
        let scale = scene.scale();
        notes.push(format!(
            "interfaces between {} labels, smoothed over {scale}",
            values.len()
        ));
        let (labelled, limits) = compete(scene, table, scale, notes)?;
        let candidates = LabelLead::new(&labelled).candidates(scene.cancel);
        // Each is as strong as 1: all are followed.
        let thresholds = Thresholds {
            low: 0.0,
            high: 1.0,
            origin: "all",
        };
        Ok(DetectorOutput {
            labels: Some((labelled, limits)),
            ..DetectorOutput::new(candidates, scale, thresholds)
        })
    }
}

/// Parts of labels thinner than this, in least distances between atoms, ...
const THIN_DISTANCE_RATIO: f64 = 1.5;
/// ... have atoms this share of their thickness apart: with one lattice plane on either side edges through them
/// are too long for faces on both ...
const THICKNESS_SHARE: f64 = 0.7;
/// ... and at least this share of the least distance.
pub const MIN_THIN_DISTANCE_RATIO: f64 = 0.74;

/// Returns the distance that atoms may have in a gap between interfaces of labels, in lattice units, where they
/// are from `least` to `most` apart.
pub fn distance_in_gap(gap: f32, [least, most]: [f64; 2]) -> f32 {
    let gap = f64::from(gap);
    let distance = if gap < THIN_DISTANCE_RATIO * least {
        (THICKNESS_SHARE * gap).max(MIN_THIN_DISTANCE_RATIO * least)
    } else {
        gap.max(least)
    };
    distance.min(most) as f32
}

/// A part of a label is kept if its volume is at least this share of the cube of the distance between
/// atoms.
const MIN_VOLUME_SHARE: f64 = 0.3;

/// The labels as they lead after smoothing, without what no lattice can hold; and the distance that atoms
/// may have in each part.
fn compete<const D: usize>(
    scene: &DetectorInput<'_, D>,
    table: LabelTable,
    scale: f64,
    notes: &mut Vec<String>,
) -> Result<(LabelMap<D>, LabelSpacing<D>)> {
    let (asked, dims) = (scene.options, scene.dims());
    let sample: f64 = asked.step.iter().product();
    let LabelTable {
        values,
        indices: mut label,
    } = table;
    let mut components = Components::from_labels(dims, &label);
    let least = |part: &Component<D>| min_label_distance(asked, values[part.label as usize]);
    let gone = components.absorb(&mut label, |part| {
        let volume = part.sample_count as f64 * sample;
        // Of a part of an image nobody knows how far it goes on.
        let unknown = scene.resolved.is_some() && part.touches_side(dims);
        unknown || volume >= MIN_VOLUME_SHARE * least(part).powi(D as i32)
    });
    if gone[1] > 0 {
        notes.push(format!(
            "{} parts of labels, {} samples in all, are too small to be followed",
            gone[1], gone[0]
        ));
        components = Components::from_labels(dims, &label);
    }
    let (winner, lead) =
        LabelCompetition::run(&components, &label, values.len(), scale, scene.cancel).into_lead();
    let most = asked.d_max();
    let distance = components.components.iter().map(|part| {
        let least = min_label_distance(asked, values[part.label as usize]);
        let wish = label_distance(asked, values[part.label as usize]).unwrap_or(most);
        let radius = part.radius(sample);
        // Faces so long are at most half a sample off a ball.
        let bend = 2.0 * radius.sqrt();
        match asked.gap_distance_range() {
            Some(_) => radius.min(bend).min(wish).max(least) as f32,
            None => wish as f32,
        }
    });
    let limits = LabelSpacing {
        distance: distance.collect(),
        max_distance: most as f32,
        components,
    };
    let of_regions = are_valid_regions(&values);
    // Elsewhere the number of a label is lost if its name does not have it.
    let named = |&label: &LabelValue| match label_name(asked, label) {
        None if !of_regions => Some(format!("label_{label}").replace('.', "_")),
        name => name,
    };
    let labelled = LabelMap {
        dims,
        step: asked.step,
        volumes: volumes(dims, asked.step, &label, values.len()),
        names: values.iter().map(named).collect(),
        labels: values,
        winner,
        lead,
    };
    Ok((labelled, limits))
}

/// What a label is called.
fn label_name<const D: usize>(asked: &DetectionOptions<D>, label: LabelValue) -> Option<String> {
    let wish = asked.labels.iter().find(|wish| wish.label == label);
    wish.and_then(|wish| wish.name.clone())
}

/// The distance wished for in a label.
fn label_distance<const D: usize>(asked: &DetectionOptions<D>, label: LabelValue) -> Option<f64> {
    let wish = asked.labels.iter().find(|wish| wish.label == label);
    wish.and_then(|wish| wish.distance)
}

/// The least distance that atoms may have in a label.
fn min_label_distance<const D: usize>(asked: &DetectionOptions<D>, label: LabelValue) -> f64 {
    label_distance(asked, label).map_or(asked.d_min, |wish| match asked.gap_distance_range() {
        Some(_) => wish.min(asked.d_min),
        None => wish,
    })
}

/// How far apart atoms may stand in each part of each label.
#[derive(Debug, Clone)]
pub struct LabelSpacing<const D: usize> {
    distance: Vec<f32>,
    max_distance: f32,
    components: Components<D>,
}

impl<const D: usize> LabelSpacing<D> {
    /// The distance that atoms may have at feature points: that of gaps, and no more than what is on
    /// either side allows; `None` if it is the same everywhere.
    pub fn spacing(
        &self,
        points: &[FeaturePoint<D>],
        step: [f64; D],
        gaps: Option<Vec<f32>>,
    ) -> Option<Vec<f32>> {
        let dims = self.components.dims;
        let volume = Volume::new(dims, &[]);
        let limit = |point: &FeaturePoint<D>| {
            // It lies between two samples along one axis, on samples along the others.
            let at: [f32; D] = std::array::from_fn(|k| point.position[k] / step[k] as f32);
            let corner = |c: usize| {
                let near = |k: usize| match c >> k & 1 {
                    0 => (at[k] + 1e-3).floor(),
                    _ => (at[k] - 1e-3).ceil(),
                };
                let sample: [usize; D] =
                    std::array::from_fn(|k| (near(k).max(0.0) as usize).min(dims[k] - 1));
                let part = self.components.component_of_sample[volume.index(sample)];
                self.distance[part as usize]
            };
            (0..1usize << D).map(corner).fold(f32::INFINITY, f32::min)
        };
        if gaps.is_none() && self.distance.iter().all(|&d| d == self.max_distance) {
            return None;
        }
        let gaps = gaps.unwrap_or_else(|| vec![f32::INFINITY; points.len()]);
        Some(
            (points.iter().zip(gaps))
                .map(|(point, gap)| gap.min(limit(point)))
                .collect(),
        )
    }
}

/// The winning label of each sample and how far it leads.
struct LabelLead<'a, const D: usize> {
    winner: &'a [u32],
    lead: Volume<'a, D>,
}

impl<'a, const D: usize> LabelLead<'a, D> {
    fn new(labelled: &'a LabelMap<D>) -> Self {
        Self {
            winner: &labelled.winner,
            lead: Volume::new(labelled.dims, &labelled.lead),
        }
    }

    /// Points on the interfaces between labels, in the order of samples.
    fn candidates(&self, patience: &CancelToken<'_>) -> Vec<Candidate<D>> {
        self.lead.map_rows(patience, |first, (): &mut (), found| {
            self.find_in_row(first, found)
        })
    }

    fn find_in_row(&self, first: [usize; D], found: &mut Vec<Candidate<D>>) {
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
    fn normal(&self, at: [usize; D], a: u32, b: u32) -> [f64; D] {
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
    use crate::feature::scenes::{ExactSurface, image_of, measure_fit};
    use crate::feature::{DetectionOptions, FeatureKind, detect};

    #[test]
    fn interfaces_of_labels_are_smooth_and_counted_once() {
        let dims = [64, 60, 56];
        let ball = || ExactSurface::Sphere([32.0, 30.0, 28.0], 18.0);
        let floor = || ExactSurface::plane([0.2, 0.1, 1.0], [32.0, 30.0, 4.0]);
        let image = image_of(dims, |p| {
            if ball().distance(p) < 0.0 {
                7.0
            } else {
                f64::from(u8::from(floor().distance(p) > 0.0))
            }
        });
        let features =
            detect(&image, &DetectionOptions::with_kind(FeatureKind::Auto, 5.0)).unwrap();
        assert!(features.notes[0].contains("labels"), "{:?}", features.notes);
        let sheets = [ball(), floor()];
        let fit = measure_fit(dims, &sheets, &features.points);
        assert!(fit.coverage > 0.98 && fit.precision > 0.995, "{fit:?}");
        assert!(fit.rms < 0.2 && fit.angle < 6.0, "{fit:?}");
        // One point per column: the ball has 4 pi r^2 / 1.5 columns, the floor one per (x, y).
        let columns = 4.0 * std::f64::consts::PI * 18.0f64.powi(2) / 1.5 + 64.0 * 60.0;
        let ratio = features.points.len() as f64 / columns;
        assert!(ratio > 0.95 && ratio < 1.25, "{ratio}");
    }

    #[test]
    fn a_layer_three_samples_thick_keeps_both_sides() {
        let dims = [64, 60, 56];
        let middle = [32.0, 30.0, 28.0];
        let flat = |off: f64| {
            ExactSurface::plane([0.15, 0.1, 1.0], [middle[0], middle[1], middle[2] + off])
        };
        let bent = |off: f64| ExactSurface::Cylinder([32.0, -40.0], 70.0 + off);
        for sides in [[flat(-1.5), flat(1.5)], [bent(-1.5), bent(1.5)]] {
            let image = image_of(dims, |p| {
                let above = sides.iter().filter(|s| s.distance(p) > 0.0).count();
                [2.0, 5.0, 9.0][above]
            });
            let asked = DetectionOptions {
                gap_d_max: Some(8.0),
                ..DetectionOptions::with_kind(FeatureKind::Auto, 8.0 / 3.0)
            };
            let features = detect(&image, &asked).unwrap();
            let fit = measure_fit(dims, &sides, &features.points);
            assert!(fit.coverage > 0.99 && fit.precision > 0.999, "{fit:?}");
            assert!(fit.rms < 0.15, "{fit:?}");
            // Atoms stand 0.7 of the layer's thickness apart.
            let spacing = features.spacing.unwrap();
            let mean = spacing.iter().map(|&d| f64::from(d)).sum::<f64>() / spacing.len() as f64;
            assert!((1.9..2.3).contains(&mean), "{mean}");
        }
    }
}

//! Labels: the interfaces between them.
//!
//! The winner at a sample is the label with the largest score after smoothing
//! ([`label_smoothing`](mod@super::label_smoothing)), and its lead is the difference from the
//! second score. Scores keep the volumes of the samples in each neighbourhood, and interfaces stay
//! between the centres of samples, unless the option `label_smoothing` says more. Between two samples with different winners, the interface lies where the lead
//! changes its sign. The interface is smooth although labels have steps, every interface is counted
//! once, and no special case is needed where three labels meet.
//!
//! Connected components of labels that are too small for the requested distance between atoms are
//! absorbed by the labels around them. In other small components, atoms are closer, as far as the
//! requested distances allow.
//!
//! A mask of thin surfaces is found by [`masks`](mod@super::masks).
//!
//! Scale: one sample.

use super::label_slices::{slice_axis, smooth_slices};
use super::label_smoothing::smooth_labels;
use super::masks;
use super::{Detector, DetectorInput, DetectorOutput, ThresholdMeaning, Thresholds};
use crate::error::Result;
use crate::feature::candidate::{Candidate, dominant_axes};
use crate::feature::components::{Component, Components};
use crate::feature::label_map::{
    LabelMap, LabelOptions, are_valid_regions, missing_label_error, too_many_labels_error, volumes,
};
use crate::feature::volume::Volume;
use crate::feature::{DetectionOptions, FeatureKind, FeaturePoint};
use crate::geometry::grid_index::index_at;
use crate::geometry::{dot, unit};
use crate::image::labels::rounding_of_labels;
use crate::image::{LabelTable, LabelValue};
use crate::progress::CancelToken;

/// Detector of interfaces between labels.
pub struct Labels;

impl<const D: usize> Detector<D> for Labels {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Labels
    }

    /// Returns `false`: between labels, no value makes sense.
    fn fills_gaps(&self) -> bool {
        false
    }

    fn has_labels(&self) -> bool {
        true
    }

    fn threshold_meaning(&self) -> ThresholdMeaning {
        ThresholdMeaning::Unused
    }

    fn find(
        &self,
        input: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        if let Some(value) = input.resolved.and_then(|resolved| resolved.mask) {
            // Meshes of earlier versions use this kind for a mask.
            return masks::find_again(input, value, notes);
        }
        let image = input.image()?;
        let table = LabelTable::from_image(image).ok_or_else(too_many_labels_error)?;
        if let Some(difference) = rounding_of_labels(image) {
            notes.push(format!(
                "samples differ from whole numbers by up to {difference:.1e}: they are taken as whole numbers"
            ));
        }
        let values = &table.values;
        let absent = |options: &&LabelOptions| {
            options.merge_into.is_none() && !values.contains(&options.label)
        };
        if let Some(label_options) = input.options.labels.iter().find(absent) {
            return Err(missing_label_error(label_options, values));
        }
        if !are_valid_regions(values) {
            notes.push(
                "some labels are not whole numbers of 32 bits, so the cell array 'region' numbers the labels from 0, in \
                 ascending order"
                    .into(),
            );
        }
        let scale = input.scale();
        notes.push(format!(
            "boundaries between {} labels, smoothed over {scale} samples",
            values.len()
        ));
        let (label_map, label_spacing) = compete(input, table, scale, notes)?;
        let candidates = LabelLead::new(&label_map).candidates(input.cancel);
        // All candidates have strength 1, so that all are followed.
        let thresholds = Thresholds {
            low: 0.0,
            high: 1.0,
            origin: "all",
        };
        Ok(DetectorOutput {
            labels: Some((label_map, label_spacing)),
            ..DetectorOutput::new(candidates, scale, thresholds)
        })
    }
}

/// Thickness, in smallest distances between atoms, below which a part of a label is thin.
const THIN_DISTANCE_RATIO: f64 = 1.5;
/// Distance between atoms in a thin part, as a share of its thickness.
const THICKNESS_SHARE: f64 = 0.9;
/// Smallest distance between atoms in a thin part, in samples.
pub const MIN_THIN_DISTANCE: f64 = 0.7;

/// Number of atoms around a feature point of unit area, times the square of their distance there. It was
/// measured on nested shells, and counts those between which the distance grows to that elsewhere.
const ATOMS_PER_POINT: f64 = 5.0;
/// Number of atoms that thin parts may have in any image.
const MIN_THIN_ATOMS: f64 = 200_000.0;
/// Number of atoms that thin parts may have per sample of the image.
const THIN_ATOMS_PER_SAMPLE: f64 = 0.25;
/// Number of atoms that thin parts may have at most: about six million tetrahedra.
const MAX_THIN_ATOMS: f64 = 1e6;
/// Factor by which the smallest distance in thin parts grows until the atoms are few enough.
const THIN_DISTANCE_GROWTH: f64 = 1.15;

/// Distances between atoms in gaps between interfaces of labels.
#[derive(Debug, Clone, Copy)]
pub struct ThinDistances {
    /// Smallest and largest distance in general, in lattice units.
    pub limits: [f64; 2],
    /// Smallest distance in thin parts.
    pub min_thin: f64,
}

impl ThinDistances {
    /// Returns the distances for these gaps: as small as [`MIN_THIN_DISTANCE`], unless thin parts would
    /// have too many atoms.
    pub fn for_gaps(gaps: &[f32], limits: [f64; 2], min_step: f64, sample_count: usize) -> Self {
        let allowed =
            (THIN_ATOMS_PER_SAMPLE * sample_count as f64).clamp(MIN_THIN_ATOMS, MAX_THIN_ATOMS);
        let mut distances = Self {
            limits,
            min_thin: (MIN_THIN_DISTANCE * min_step).min(limits[0]),
        };
        let atom_count = |distances: &Self| {
            let thin = gaps.iter().map(|&gap| f64::from(distances.in_gap(gap)));
            let thin = thin.filter(|&d| d < limits[0]);
            thin.map(|d| ATOMS_PER_POINT * (min_step / d).powi(2))
                .sum::<f64>()
        };
        while distances.min_thin < limits[0] && atom_count(&distances) > allowed {
            distances.min_thin = (THIN_DISTANCE_GROWTH * distances.min_thin).min(limits[0]);
        }
        distances
    }

    /// Returns the distance in a gap: little less than the thickness of what is thin, so that atoms lie on its
    /// two sides.
    pub fn in_gap(&self, gap: f32) -> f32 {
        let [min, max] = self.limits;
        let gap = f64::from(gap);
        let distance = if gap < THIN_DISTANCE_RATIO * min {
            (THICKNESS_SHARE * gap).max(self.min_thin)
        } else {
            gap.max(min)
        };
        distance.min(max) as f32
    }
}

/// Smallest volume of a component that is kept, as a share of the cube of the distance between
/// atoms.
const MIN_VOLUME_SHARE: f64 = 0.3;

/// Smooths the labels, without components that are too small for the lattice, and computes the
/// distance between atoms in each component.
fn compete<const D: usize>(
    input: &DetectorInput<'_, D>,
    table: LabelTable,
    scale: f64,
    notes: &mut Vec<String>,
) -> Result<(LabelMap<D>, LabelSpacing<D>)> {
    let (options, dims) = (input.options, input.dims());
    let LabelTable {
        values,
        indices: mut label,
    } = table;
    let components = absorb_small_parts(input, &values, &mut label, notes);
    let is_bounded = input.options.label_smoothing.is_none();
    let sigma = input.options.label_smoothing.unwrap_or(scale);
    let (winner, lead) = match slice_axis(dims, options.step) {
        Some(axis) => {
            notes.push(format!(
                "samples are {:.1} times as far apart along {} as across it: labels are interpolated between slices by their shapes",
                options.step[axis] / options.step.iter().fold(f64::INFINITY, |min, step| min.min(*step)),
                ["x", "y", "z"][axis]
            ));
            smooth_slices(
                dims,
                options.step,
                axis,
                &label,
                sigma,
                is_bounded,
                input.cancel,
            )
        }
        None => smooth_labels(dims, &label, sigma, is_bounded, input.cancel),
    };
    let label_spacing = label_spacing(input, components, &values);
    let are_regions = are_valid_regions(&values);
    // If regions do not have the values of labels, names must contain these, or they would be lost.
    let name_of = |&label: &LabelValue| match label_name(options, label) {
        None if !are_regions => Some(format!("label_{label}")),
        name => name,
    };
    let label_map = LabelMap {
        dims,
        step: options.step,
        volumes: volumes(dims, options.step, &label, values.len()),
        names: values.iter().map(name_of).collect(),
        labels: values,
        winner,
        lead,
        values: None,
    };
    Ok((label_map, label_spacing))
}

/// Gives the samples of parts of labels that are too small for the lattice to the labels around them.
/// Returns the connected parts that are left. `label` has the index of the label of each sample.
pub fn absorb_small_parts<const D: usize>(
    input: &DetectorInput<'_, D>,
    values: &[LabelValue],
    label: &mut [u32],
    notes: &mut Vec<String>,
) -> Components<D> {
    let (options, dims) = (input.options, input.dims());
    let sample_volume: f64 = options.step.iter().product();
    let components = Components::from_labels(dims, label);
    let min_distance =
        |part: &Component<D>| min_label_distance(options, values[part.label as usize]);
    let absorbed = components.absorb(label, |part| {
        let volume = part.sample_count as f64 * sample_volume;
        // In a part of an image, a component on a side may continue beyond it.
        let may_continue = input.resolved.is_some() && part.touches_side(dims);
        may_continue
            || part.sample_count >= options.min_part
                && volume >= MIN_VOLUME_SHARE * min_distance(part).powi(D as i32)
    });
    if absorbed[1] == 0 {
        return components;
    }
    let reason = match options.min_part {
        0 | 1 => "too small to become regions".to_string(),
        min => format!("of fewer than {min} samples, or too small to become regions,"),
    };
    notes.push(format!(
        "{} parts of labels ({} samples in all) are {reason} and join their neighbours",
        absorbed[1], absorbed[0]
    ));
    Components::from_labels(dims, label)
}

/// Gives the samples of parts of fewer than `min_part` samples to the labels around them.
pub fn absorb_parts_below<const D: usize>(dims: [usize; D], label: &mut [u32], min_part: usize) {
    if min_part > 1 {
        let components = Components::from_labels(dims, label);
        components.absorb(label, |part| part.sample_count >= min_part);
    }
}

/// Returns the distances between atoms in the connected parts of labels.
pub fn label_spacing<const D: usize>(
    input: &DetectorInput<'_, D>,
    components: Components<D>,
    values: &[LabelValue],
) -> LabelSpacing<D> {
    let options = input.options;
    let sample_volume: f64 = options.step.iter().product();
    let max_distance = options.d_max();
    let distance = components.components.iter().map(|part| {
        let min_distance = min_label_distance(options, values[part.label as usize]);
        let requested =
            label_distance(options, values[part.label as usize]).unwrap_or(max_distance);
        let radius = part.radius(sample_volume);
        // Faces of this length are at most half a sample away from the surface of a ball.
        let curvature_limit = 2.0 * radius.sqrt();
        match options.gap_distance_range() {
            Some(_) => radius.min(curvature_limit).min(requested).max(min_distance) as f32,
            None => requested as f32,
        }
    });
    LabelSpacing {
        distance: distance.collect(),
        max_distance: max_distance as f32,
        components,
    }
}

/// Returns the name of a label, if it has one.
pub fn label_name<const D: usize>(
    options: &DetectionOptions<D>,
    label: LabelValue,
) -> Option<String> {
    let label_options = options.labels.iter().find(|o| o.label == label);
    label_options.and_then(|label_options| label_options.name.clone())
}

/// Returns the requested distance between atoms in a label.
fn label_distance<const D: usize>(options: &DetectionOptions<D>, label: LabelValue) -> Option<f64> {
    let label_options = options.labels.iter().find(|o| o.label == label);
    label_options.and_then(|label_options| label_options.distance)
}

/// Returns the smallest distance between atoms in a label.
fn min_label_distance<const D: usize>(options: &DetectionOptions<D>, label: LabelValue) -> f64 {
    label_distance(options, label).map_or(options.d_min, |distance| {
        match options.gap_distance_range() {
            Some(_) => distance.min(options.d_min),
            None => distance,
        }
    })
}

/// Distance between atoms in each component of each label.
#[derive(Debug, Clone)]
pub struct LabelSpacing<const D: usize> {
    distance: Vec<f32>,
    max_distance: f32,
    components: Components<D>,
}

impl<const D: usize> LabelSpacing<D> {
    /// Returns the distance between atoms at feature points: that of gaps, but at most that of the
    /// components on either side; `None` if it is the same everywhere.
    pub fn spacing(
        &self,
        points: &[FeaturePoint<D>],
        step: [f64; D],
        gaps: Option<Vec<f32>>,
    ) -> Option<Vec<f32>> {
        let dims = self.components.dims;
        let volume = Volume::new(dims, &[]);
        let limit = |point: &FeaturePoint<D>| {
            // The point lies between two samples along one axis, and on samples along the others.
            let at: [f32; D] = std::array::from_fn(|k| point.position[k] / step[k] as f32);
            let corner = |c: usize| {
                let nearest = |k: usize| match c >> k & 1 {
                    0 => (at[k] + 1e-3).floor(),
                    _ => (at[k] - 1e-3).ceil(),
                };
                let sample: [usize; D] =
                    std::array::from_fn(|k| (nearest(k).max(0.0) as usize).min(dims[k] - 1));
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

/// Weights of five samples that smooth across a derivative, and that give a smoothed derivative.
const WIDE_STENCIL: [[f64; 5]; 2] = [
    [0.0625, 0.25, 0.375, 0.25, 0.0625],
    [-0.125, -0.25, 0.0, 0.25, 0.125],
];
/// Weights without smoothing.
const NARROW_STENCIL: [[f64; 5]; 2] = [[0.0, 0.0, 1.0, 0.0, 0.0], [0.0, -0.5, 0.0, 0.5, 0.0]];
/// Largest angle, in degrees, between the normals of the two stencils on a smooth interface.
const MAX_NORMAL_DIFFERENCE: f64 = 20.0;

/// The winning label of each sample, and its lead.
struct LabelLead<'a, const D: usize> {
    winner: &'a [u32],
    lead: Volume<'a, D>,
}

impl<'a, const D: usize> LabelLead<'a, D> {
    fn new(label_map: &'a LabelMap<D>) -> Self {
        Self {
            winner: &label_map.winner,
            lead: Volume::new(label_map.dims, &label_map.lead),
        }
    }

    /// Returns points on the interfaces between labels, in the order of samples.
    fn candidates(&self, cancel: &CancelToken<'_>) -> Vec<Candidate<D>> {
        self.lead.map_rows(cancel, |first, (): &mut (), found| {
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
                let normal = self.normal(at, axis, [self.winner[i], self.winner[j]]);
                if !dominant_axes(normal).any(|a| a == axis) {
                    continue;
                }
                let offset = lead[i] / (lead[i] + lead[j]).max(1e-12);
                found.push(Candidate::new(dims, at, axis, offset, normal, 1.0));
            }
        }
    }

    /// Returns the unit gradient of the lead of label `a` over label `b` between a sample and the next one
    /// along `axis`; other labels have lead 0. The gradient is smoothed over the samples beside the two, as
    /// Sobel's operator does it, so that it has little of the steps of the samples.
    /// Near corners, where the smoothed gradient is that of other faces, fewer samples count.
    fn normal(&self, at: [usize; D], axis: usize, labels: [u32; 2]) -> [f64; D] {
        let [narrow, wide] = [&NARROW_STENCIL, &WIDE_STENCIL]
            .map(|stencil| self.gradient(at, axis, labels, stencil));
        let is_smooth = dot(narrow, wide) >= MAX_NORMAL_DIFFERENCE.to_radians().cos();
        if is_smooth { wide } else { narrow }
    }

    /// Returns the unit gradient with the weights of a stencil.
    fn gradient(
        &self,
        at: [usize; D],
        axis: usize,
        [a, b]: [u32; 2],
        stencil: &[[f64; 5]; 2],
    ) -> [f64; D] {
        let signed_lead = |p: [usize; D]| {
            let i = self.lead.index(p);
            match self.winner[i] {
                w if w == a => f64::from(self.lead.samples[i]),
                w if w == b => -f64::from(self.lead.samples[i]),
                _ => 0.0,
            }
        };
        let mut gradient = [0.0; D];
        for number in 0..5usize.pow(D as u32) {
            let offset: [usize; D] = index_at([5; D], number);
            // Along the axis there are two samples, with offsets 2 and 3.
            if !(2..4).contains(&offset[axis]) {
                continue;
            }
            let p = std::array::from_fn(|k| {
                (at[k] + offset[k])
                    .saturating_sub(2)
                    .min(self.lead.dims[k] - 1)
            });
            let lead = signed_lead(p);
            for (k, slope) in gradient.iter_mut().enumerate() {
                let others = (0..D).filter(|&other| other != k && other != axis);
                let product: f64 = others.map(|other| stencil[0][offset[other]]).product();
                *slope += lead
                    * product
                    * if k == axis {
                        2.0 * offset[k] as f64 - 5.0
                    } else {
                        0.5 * stencil[1][offset[k]]
                    };
            }
        }
        if gradient == [0.0; D] {
            gradient[axis] = 1.0;
        }
        unit(gradient)
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
        let surfaces = [ball(), floor()];
        let fit = measure_fit(dims, &surfaces, &features.points);
        assert!(fit.coverage > 0.98 && fit.precision > 0.995, "{fit:?}");
        assert!(fit.rms < 0.2 && fit.angle < 6.0, "{fit:?}");
        // One point per column: the ball has 4 pi r^2 / 1.5 columns, the plane one per (x, y).
        let columns = 4.0 * std::f64::consts::PI * 18.0f64.powi(2) / 1.5 + 64.0 * 60.0;
        let ratio = features.points.len() as f64 / columns;
        assert!(ratio > 0.95 && ratio < 1.25, "{ratio}");
    }

    #[test]
    fn a_layer_three_samples_thick_keeps_both_sides() {
        let dims = [64, 60, 56];
        let middle = [32.0, 30.0, 28.0];
        let flat = |offset: f64| {
            ExactSurface::plane([0.15, 0.1, 1.0], [middle[0], middle[1], middle[2] + offset])
        };
        let bent = |offset: f64| ExactSurface::Cylinder([32.0, -40.0], 70.0 + offset);
        for sides in [[flat(-1.5), flat(1.5)], [bent(-1.5), bent(1.5)]] {
            let image = image_of(dims, |p| {
                let above = sides.iter().filter(|s| s.distance(p) > 0.0).count();
                [2.0, 5.0, 9.0][above]
            });
            let options = DetectionOptions {
                gap_d_max: Some(8.0),
                ..DetectionOptions::with_kind(FeatureKind::Auto, 8.0 / 3.0)
            };
            let features = detect(&image, &options).unwrap();
            let fit = measure_fit(dims, &sides, &features.points);
            assert!(fit.coverage > 0.99 && fit.precision > 0.999, "{fit:?}");
            assert!(fit.rms < 0.15, "{fit:?}");
            // The distance between atoms is 0.9 of the layer's thickness.
            let spacing = features.spacing.unwrap();
            let mean = spacing.iter().map(|&d| f64::from(d)).sum::<f64>() / spacing.len() as f64;
            assert!((2.4..2.8).contains(&mean), "{mean}");
        }
    }
}

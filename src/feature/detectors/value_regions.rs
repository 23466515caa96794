//! Regions below and above a value of the image, whose interface is its isosurface.
//!
//! The lead of a region at a sample is the difference of the sample from the value, so that the
//! interface lies where linear interpolation between the samples gives the value. Regions keep the
//! volumes that they have under multilinear interpolation.

use super::input::DetectorInput;
use super::labels::{LabelSpacing, absorb_small_parts, label_name, label_spacing};
use crate::feature::components::for_each_sample;
use crate::feature::label_map::LabelMap;
use crate::feature::volume::Volume;
use crate::image::LabelValue;

/// Labels of the regions below and above the value.
pub const REGION_VALUES: [LabelValue; 2] = [LabelValue::Whole(0), LabelValue::Whole(1)];

/// Lead of samples of parts that are too small for a region, and join the other one.
const ABSORBED_LEAD: f32 = 1e-6;

/// Number of points along each axis at which a cell between samples is measured.
const POINTS_PER_AXIS: usize = 4;

/// Returns the regions below and above `level`, and the distances between atoms in them. `samples` are
/// those of the image in memory order. Returns `None` if only one region is left without its small parts.
pub fn value_regions<const D: usize>(
    input: &DetectorInput<'_, D>,
    samples: &[f32],
    level: f32,
    notes: &mut Vec<String>,
) -> Option<(LabelMap<D>, LabelSpacing<D>)> {
    let dims = input.dims();
    let values = REGION_VALUES.to_vec();
    let is_above = |sample: &f32| u32::from(*sample >= level);
    let mut winner: Vec<u32> = samples.iter().map(is_above).collect();
    let components = absorb_small_parts(input, &values, &mut winner, notes);
    if components.components.len() < 2 {
        return None;
    }
    let difference = |sample: &f32| (sample - level).abs();
    let largest = samples.iter().map(difference).fold(0.0, f32::max);
    let lead: Vec<f32> = (samples.iter().zip(&winner))
        .map(|(sample, winner)| {
            if is_above(sample) == *winner {
                difference(sample) / largest
            } else {
                ABSORBED_LEAD
            }
        })
        .collect();
    let names = ["below", "above"];
    let name = |(value, name): (&LabelValue, &str)| {
        Some(label_name(input.options, *value).unwrap_or_else(|| name.to_string()))
    };
    let mut label_map = LabelMap {
        dims,
        step: input.options.step,
        volumes: Vec::new(),
        names: values.iter().zip(names).map(name).collect(),
        winner,
        lead,
        labels: values,
    };
    label_map.volumes = volumes(&label_map);
    let spacing = label_spacing(input, components, &label_map.labels);
    Some((label_map, spacing))
}

/// Returns the volumes of the two regions under multilinear interpolation, in lattice units.
fn volumes<const D: usize>(label_map: &LabelMap<D>) -> Vec<f64> {
    let (dims, step) = (label_map.dims, label_map.step);
    let strides = Volume::new(dims, &[]).strides();
    let offset = |corner: usize| -> usize { (0..D).map(|k| (corner >> k & 1) * strides[k]).sum() };
    let mut above = 0.0;
    for_each_sample(dims, |i, at| {
        if (0..D).any(|k| at[k] + 1 >= dims[k]) {
            return;
        }
        let is_above = |corner: usize| label_map.winner[i + offset(corner)] == 1;
        above += match (0..1 << D).filter(|&corner| is_above(corner)).count() {
            0 => 0.0,
            count if count == 1 << D => 1.0,
            _ => share_above(label_map, at),
        };
    });
    let cell: f64 = step.iter().product();
    let total: f64 = (0..D).map(|k| (dims[k] - 1) as f64).product::<f64>() * cell;
    vec![total - above * cell, above * cell]
}

/// Returns the share of the upper region in the cell between sample `at` and the next ones.
fn share_above<const D: usize>(label_map: &LabelMap<D>, at: [usize; D]) -> f64 {
    let count = POINTS_PER_AXIS.pow(D as u32);
    let above = (0..count).filter(|number| {
        let x: [f64; D] = std::array::from_fn(|k| {
            let index = number / POINTS_PER_AXIS.pow(k as u32) % POINTS_PER_AXIS;
            (at[k] as f64 + (index as f64 + 0.5) / POINTS_PER_AXIS as f64) * label_map.step[k]
        });
        label_map.lead_between(x, [1, 0]) > 0.0
    });
    above.count() as f64 / count as f64
}

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
    let label_map = LabelMap {
        dims,
        step: input.options.step,
        volumes: volumes(dims, input.options.step, &winner, &lead),
        names: values.iter().zip(names).map(name).collect(),
        winner,
        lead,
        labels: values,
    };
    let spacing = label_spacing(input, components, &label_map.labels);
    Some((label_map, spacing))
}

/// Returns the volumes of the two regions under multilinear interpolation, in lattice units.
fn volumes<const D: usize>(
    dims: [usize; D],
    step: [f64; D],
    winner: &[u32],
    lead: &[f32],
) -> Vec<f64> {
    let strides = Volume::new(dims, &[]).strides();
    let signed = |i: usize| match winner[i] {
        0 => -f64::from(lead[i]),
        _ => f64::from(lead[i]),
    };
    let corner_offset =
        |corner: usize| -> usize { (0..D).map(|k| (corner >> k & 1) * strides[k]).sum() };
    let mut above = 0.0;
    for_each_sample(dims, |i, at| {
        if (0..D).any(|k| at[k] + 1 >= dims[k]) {
            return;
        }
        let corners = |corner: usize| i + corner_offset(corner);
        let count = (0..1 << D).filter(|&c| winner[corners(c)] == 1).count();
        above += match count {
            0 => 0.0,
            n if n == 1 << D => 1.0,
            _ => share_above::<D>(|corner| signed(corners(corner))),
        };
    });
    let cell: f64 = step.iter().product();
    let total: f64 = (0..D).map(|k| (dims[k] - 1) as f64).product::<f64>() * cell;
    vec![total - above * cell, above * cell]
}

/// Returns the share of a cell in which the multilinear interpolation of its corners is positive.
fn share_above<const D: usize>(value: impl Fn(usize) -> f64) -> f64 {
    let count = POINTS_PER_AXIS.pow(D as u32);
    let inside = (0..count).filter(|number| {
        let position: [f64; D] = std::array::from_fn(|k| {
            let index = number / POINTS_PER_AXIS.pow(k as u32) % POINTS_PER_AXIS;
            (index as f64 + 0.5) / POINTS_PER_AXIS as f64
        });
        let sum: f64 = (0..1 << D)
            .map(|corner| {
                let weight = (0..D).map(|k| match corner >> k & 1 {
                    0 => 1.0 - position[k],
                    _ => position[k],
                });
                weight.product::<f64>() * value(corner)
            })
            .sum();
        sum > 0.0
    });
    inside.count() as f64 / count as f64
}

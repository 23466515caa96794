//! Regions of values of an image, whose interfaces are its isosurfaces.
//!
//! A sample is in the region of the thresholds that it reaches. Between samples, the interfaces lie where
//! interpolation of the values gives the thresholds ([`ValueField`]), and regions have the volumes of this.
//! They end on the sides of the image.
//!
//! Samples of parts that join another region get a value just within it.

use super::input::DetectorInput;
use super::labels::{LabelSpacing, absorb_small_parts, label_name, label_spacing};
use crate::feature::label_map::LabelMap;
use crate::feature::value_field::{ValueField, region_of};
use crate::image::{LabelTable, LabelValue};

/// Difference of samples from a threshold, as a share of the range of values, in parts that join the region
/// beyond it.
const ABSORBED_SHARE: f32 = 1e-5;

/// Returns the labels of the regions that `count` thresholds make: 0 below the first one, and so on.
pub fn region_values(count: usize) -> Vec<LabelValue> {
    (0..=count as i128).map(LabelValue::Whole).collect()
}

/// Returns the names of the regions that thresholds make.
pub fn region_names(levels: &[f32]) -> Vec<String> {
    let name = |n: usize| match n {
        0 => "below".to_string(),
        n if n == levels.len() => "above".to_string(),
        _ if levels.len() == 2 => "between".to_string(),
        n => format!("between_{}_and_{}", levels[n - 1], levels[n]),
    };
    (0..=levels.len()).map(name).collect()
}

/// Returns the region of each sample as a label: the number of thresholds that it reaches. The table has all
/// regions, also those without samples.
pub fn threshold_labels(samples: &[f32], levels: &[f32]) -> LabelTable {
    LabelTable {
        values: region_values(levels.len()),
        indices: samples
            .iter()
            .map(|value| region_of(levels, *value))
            .collect(),
    }
}

/// Returns the regions between `levels`, which ascend, and the distances between atoms in them. `samples` are
/// those of the image in memory order. Returns `None` if only one region is left without its small parts.
pub fn value_regions<const D: usize>(
    input: &DetectorInput<'_, D>,
    samples: Vec<f32>,
    levels: &[f32],
    notes: &mut Vec<String>,
) -> Option<(LabelMap<D>, LabelSpacing<D>)> {
    let dims = input.dims();
    let LabelTable {
        values: labels,
        indices: mut winner,
    } = threshold_labels(&samples, levels);
    let mut values = ValueField {
        dims,
        samples,
        levels: levels.to_vec(),
    };
    let components = absorb_small_parts(input, &labels, &mut winner, notes);
    if components.components.len() < 2 {
        return None;
    }
    move_absorbed_samples(&mut values, &winner);
    let lead = leads(&values, &winner);
    let name = |(label, name): (&LabelValue, String)| {
        Some(label_name(input.options, *label).unwrap_or(name))
    };
    let sample_volume: f64 = input.options.step.iter().product();
    let volumes = values
        .volumes()
        .into_iter()
        .map(|volume| volume * sample_volume);
    let label_map = LabelMap {
        dims,
        step: input.options.step,
        volumes: volumes.collect(),
        names: labels.iter().zip(region_names(levels)).map(name).collect(),
        winner,
        lead,
        values: Some(values),
        labels,
    };
    let spacing = label_spacing(input, components, &label_map.labels);
    Some((label_map, spacing))
}

/// Gives samples that joined another region a value within it, next to the threshold that they were beyond.
fn move_absorbed_samples<const D: usize>(values: &mut ValueField<D>, winner: &[u32]) {
    let range = values
        .samples
        .iter()
        .fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], &value| {
            [low.min(value), high.max(value)]
        });
    let margin = ABSORBED_SHARE * (range[1] - range[0]);
    let levels = &values.levels;
    for (value, &region) in values.samples.iter_mut().zip(winner) {
        let own = region_of(levels, *value);
        if own < region {
            let level = levels[region as usize - 1];
            *value = (level + margin).max(level);
        } else if own > region {
            let level = levels[region as usize];
            *value = (level - margin).min(level.next_down());
        }
        // Thresholds may be nearer to each other than the margin.
        if region_of(levels, *value) != region {
            *value = match region {
                0 => levels[0].next_down(),
                n => levels[n as usize - 1],
            };
        }
    }
}

/// Returns the difference of each sample from the nearest threshold of its region, from 0 to 1.
fn leads<const D: usize>(values: &ValueField<D>, winner: &[u32]) -> Vec<f32> {
    let levels = &values.levels;
    let difference = |(value, region): (&f32, &u32)| {
        let n = *region as usize;
        let above = n
            .checked_sub(1)
            .map_or(f32::INFINITY, |n| value - levels[n]);
        let below = levels.get(n).map_or(f32::INFINITY, |level| level - value);
        above.min(below)
    };
    let mut leads: Vec<f32> = values.samples.iter().zip(winner).map(difference).collect();
    let largest = leads.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
    leads.iter_mut().for_each(|lead| *lead /= largest);
    leads
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::components::Components;
    use crate::feature::scenes::image_of;
    use crate::feature::{DetectionOptions, FeatureKind, Features, detect};
    use crate::geometry::{norm, sub};
    use crate::image::Image;

    fn detect_levels<const D: usize>(
        image: &Image<D>,
        levels: &[f32],
        min_part: usize,
    ) -> Features<D> {
        let options = DetectionOptions {
            threshold: Some(levels[0]),
            further_levels: levels[1..].to_vec(),
            min_part,
            ..DetectionOptions::with_kind(FeatureKind::Isosurface, 4.0)
        };
        detect(image, &options).unwrap()
    }

    #[test]
    fn each_interface_of_two_thresholds_lies_where_the_image_has_its_value() {
        let centre = [21.3, 19.8, 20.6];
        // Values fall by 100 in a sample: thresholds at radii of 14 and 9.
        let image = image_of([43, 41, 42], |p| 100.0 * (20.0 - norm(sub(p, centre))));
        let features = detect_levels(&image, &[600.0, 1100.0], 0);
        let label_map = features.labels.unwrap();
        let names: Vec<&str> = label_map
            .names
            .iter()
            .flatten()
            .map(String::as_str)
            .collect();
        assert_eq!(names, ["below", "between", "above"]);
        let ball = |r: f64| 4.0 / 3.0 * std::f64::consts::PI * r.powi(3);
        let exact = [
            42.0 * 40.0 * 41.0 - ball(14.0),
            ball(14.0) - ball(9.0),
            ball(9.0),
        ];
        for (volume, exact) in label_map.volumes.iter().zip(exact) {
            assert!((volume / exact - 1.0).abs() < 0.001, "{volume} {exact}");
        }
        for direction in [[1.0, 0.0, 0.0], [0.0, 0.6, 0.8], [-0.48, 0.6, -0.64]] {
            let at = |r: f64| std::array::from_fn(|k| centre[k] + r * direction[k]);
            for (radius, pair) in [(14.0, [1, 0]), (9.0, [2, 1])] {
                for start in [-1.6, -0.4, 0.7, 1.9] {
                    let distance = label_map
                        .interface_distance(at(radius + start), direction, pair, 3.0)
                        .unwrap();
                    assert!(
                        (distance + start).abs() < 0.02,
                        "{radius} {start}: {distance}"
                    );
                }
            }
            assert_eq!(label_map.label_at(at(13.9)), 1);
            assert_eq!(label_map.label_at(at(14.1)), 0);
            assert_eq!(label_map.label_at(at(8.9)), 2);
        }
    }

    #[test]
    fn small_parts_join_their_surroundings_before_meshing() {
        // A large disc with a hole of 9 samples, and a disc of 29 samples outside.
        let image = image_of([60, 50], |p: [f64; 2]| {
            let depth = |centre: [f64; 2], radius: f64| radius - norm(sub(p, centre));
            let large = depth([22.0, 25.0], 15.0);
            let hole = depth([22.0, 25.0], 2.0);
            let island = depth([48.0, 12.0], 3.0);
            500.0 + 100.0 * large.min(-hole).max(island)
        });
        let part_count = |min_part: usize| {
            let features = detect_levels(&image, &[500.0], min_part);
            let label_map = features.labels.unwrap();
            let values = label_map.values.unwrap();
            let regions = threshold_labels(&values.samples, &values.levels).indices;
            assert_eq!(regions, label_map.winner);
            let parts = Components::from_labels([60, 50], &regions);
            parts.components.len()
        };
        assert_eq!([0, 9, 10, 30].map(part_count), [4, 4, 3, 2]);
    }

    #[test]
    fn samples_are_labelled_by_the_thresholds_that_they_reach() {
        let table = threshold_labels(&[1.0, 3.0, 5.0, 7.0, 9.0, 7.5], &[3.0, 7.5]);
        assert_eq!(table.indices, [0, 1, 1, 1, 2, 2]);
        assert_eq!(table.values.len(), 3);
        assert_eq!(
            region_names(&[1.0, 2.5, 7.0]),
            ["below", "between_1_and_2.5", "between_2.5_and_7", "above"]
        );
    }
}

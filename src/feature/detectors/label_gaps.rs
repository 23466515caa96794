//! Measures how thick labels are at the points of their interfaces, and how much these bend.
//!
//! From each point, a ray follows the normal into the label on either side until another label wins. Its
//! length is the thickness there. A ray that leaves through an interface at more than
//! [`MAX_WEDGE_ANGLE`] degrees to that of the point is in a corner, not in a thin part.
//!
//! The bend is that of the normals within [`BEND_RADIUS`]: on a surface with the principal radii of curvature R1
//! and R2, the normals in a disc of radius r have the variance r^2 / 4 (1 / R1^2 + 1 / R2^2).

use crate::feature::FeaturePoint;
use crate::feature::label_map::LabelMap;
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, distance2, dot, unit};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Largest angle, in degrees, between the two interfaces of a thin part.
const MAX_WEDGE_ANGLE: f64 = 40.0;
/// Step along a ray, in samples.
const RAY_STEP: f64 = 0.25;
/// Distance, in samples, from the interface at which a ray starts.
const RAY_START: f64 = 0.15;
/// Distance, in samples, between the positions whose difference gives the normal of an interface.
const NORMAL_STEP: f64 = 0.75;

/// Distance, in samples, within which normals say how much an interface bends.
const BEND_RADIUS: f64 = 4.0;
/// Smallest cosine between normals of one interface: beyond it (60 degrees), there is an edge between them.
const MIN_BEND_COSINE: f64 = 0.5;

/// Returns the thickness of the thinner label at each point, in lattice units; at most `max`.
pub fn label_gaps<const D: usize>(
    label_map: &LabelMap<D>,
    points: &[FeaturePoint<D>],
    max: f64,
) -> Vec<f32> {
    let gap = |point: &FeaturePoint<D>| {
        let [position, normal] = [&point.position, &point.normal].map(|v| v.map(f64::from));
        let gaps = [-1.0, 1.0].map(|sign| {
            let direction = normal.map(|n| sign * n);
            ray_length(label_map, position, direction, max)
        });
        gaps[0].min(gaps[1]) as f32
    };
    points.par_iter().map(gap).collect()
}

/// Returns the largest length of faces at each point, in lattice units, at which they stay within half a sample of
/// an interface that bends as it does there.
pub fn bend_limits<const D: usize>(
    points: &[FeaturePoint<D>],
    min_step: f64,
    cancel: &CancelToken<'_>,
) -> Vec<f32> {
    let positions: Vec<[f64; D]> = points.iter().map(|p| p.position.map(f64::from)).collect();
    let radius = BEND_RADIUS * min_step;
    let cells = CellList::new(&positions, 0.5 * radius);
    // The variance of a coordinate in a disc, or in a segment in the plane.
    let spread = radius * radius / if D == 2 { 3.0 } else { 4.0 };
    let limit = |i: usize| {
        if cancel.is_cancelled() {
            return f32::INFINITY;
        }
        let own = points[i].normal.map(f64::from);
        let (mut sum, mut count) = ([0.0; D], 0.0);
        cells.visit_within(positions[i], radius, |j| {
            let normal = points[j].normal.map(f64::from);
            let cosine = dot(normal, own);
            let is_near = distance2(&positions[i], &positions[j]) <= radius * radius;
            if is_near && cosine.abs() >= MIN_BEND_COSINE {
                sum = add_scaled(sum, 1.0_f64.copysign(cosine), normal);
                count += 1.0;
            }
        });
        let variance = (1.0 - dot(sum, sum) / f64::max(count * count, 1.0)).max(1e-12);
        let curvature_radius = (spread / variance).sqrt();
        // A face of length l on a sphere of radius R is l^2 / (8 R) off its middle.
        (2.0 * (curvature_radius * min_step).sqrt()) as f32
    };
    (0..points.len()).into_par_iter().map(limit).collect()
}

/// Returns the length of a ray inside the label that it enters; `max` if the ray is longer or the label
/// has a corner there.
fn ray_length<const D: usize>(
    label_map: &LabelMap<D>,
    start: [f64; D],
    direction: [f64; D],
    max: f64,
) -> f64 {
    let step = label_map.min_step();
    let is_inside = |x: &[f64; D]| {
        (0..D).all(|k| x[k] >= 0.0 && x[k] <= (label_map.dims[k] - 1) as f64 * label_map.step[k])
    };
    let label = label_map.label_at(add_scaled(start, RAY_START * step, direction));
    let mut length = RAY_START * step;
    while length < max {
        length += RAY_STEP * step;
        let x = add_scaled(start, length, direction);
        if !is_inside(&x) {
            return max;
        }
        let other = label_map.label_at(x);
        if other == label {
            continue;
        }
        let lead = |x| label_map.lead_between(x, [label, other]);
        let half = 0.5 * NORMAL_STEP * step;
        let slope: [f64; D] = std::array::from_fn(|k| {
            let axis = std::array::from_fn(|i| if i == k { 1.0 } else { 0.0 });
            lead(add_scaled(x, half, axis)) - lead(add_scaled(x, -half, axis))
        });
        let is_parallel = dot(unit(slope), direction).abs() >= MAX_WEDGE_ANGLE.to_radians().cos();
        return if is_parallel {
            length - 0.5 * RAY_STEP * step
        } else {
            max
        };
    }
    max
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::LabelValue;

    /// Returns the map of a layer between two planes with normal (0.6, 0.8), which is `thickness` thick.
    fn layer(thickness: f64) -> LabelMap<2> {
        let dims = [40, 36];
        let depth = |i: usize| 0.6 * (i % 40) as f64 + 0.8 * (i / 40) as f64 - 26.0;
        let lead = |i: usize| 0.5 * thickness - depth(i).abs();
        LabelMap {
            values: None,
            dims,
            step: [1.0; 2],
            labels: [0.0, 1.0].map(LabelValue::from_sample).to_vec(),
            names: vec![None; 2],
            winner: (0..40 * 36).map(|i| u32::from(lead(i) > 0.0)).collect(),
            lead: (0..40 * 36).map(|i| lead(i).abs() as f32).collect(),
            volumes: vec![0.0; 2],
        }
    }

    #[test]
    fn a_layer_has_its_thickness_within_a_fifth_of_a_sample() {
        for thickness in [2.0, 3.1, 5.0] {
            let map = layer(thickness);
            let centre = [16.0, 20.5];
            let normal = [0.6f32, 0.8];
            let points: Vec<FeaturePoint<2>> = [-0.5, 0.5]
                .map(|side| FeaturePoint {
                    position: std::array::from_fn(|k| {
                        (centre[k] + side * thickness * f64::from(normal[k])) as f32
                    }),
                    normal,
                    strength: 1.0,
                })
                .to_vec();
            for gap in label_gaps(&map, &points, 8.0) {
                assert!(
                    (f64::from(gap) - thickness).abs() < 0.2,
                    "{thickness} {gap}"
                );
            }
        }
        assert_eq!(label_gaps(&layer(30.0), &[], 8.0), Vec::<f32>::new());
    }

    /// Returns points on the wall of a cylinder of this radius about z, one for each square of a sample.
    fn cylinder(radius: f64) -> Vec<FeaturePoint<3>> {
        let count = (2.0 * std::f64::consts::PI * radius).round() as usize;
        let point = |i: usize| {
            let angle = 2.0 * std::f64::consts::PI * (i % count) as f64 / count as f64;
            FeaturePoint {
                position: [
                    (radius * angle.cos()) as f32,
                    (radius * angle.sin()) as f32,
                    (i / count) as f32,
                ],
                normal: [angle.cos() as f32, angle.sin() as f32, 0.0],
                strength: 1.0,
            }
        };
        (0..20 * count).map(point).collect()
    }

    #[test]
    fn faces_on_cylinders_are_as_long_as_their_curvature_allows_within_a_fifth() {
        for radius in [6.0, 10.0, 20.0] {
            let limits = bend_limits(&cylinder(radius), 1.0, &CancelToken::never());
            let middle = limits[limits.len() / 2];
            let ratio = f64::from(middle) / (2.0 * radius.sqrt());
            assert!((ratio - 1.0).abs() < 0.2, "{radius} {middle}");
        }
        // On a narrow tube the disc wraps around it.
        let limits = bend_limits(&cylinder(2.5), 1.0, &CancelToken::never());
        assert!(limits.iter().all(|limit| *limit < 4.0), "{limits:?}");
    }
}

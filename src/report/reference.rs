//! Features with which a mesh is compared.
//!
//! All positions and distances are in samples, that is, in lattice space with a step of 1.

use crate::feature::{FeaturePoint, Features};
use crate::geometry::point_grid::PointGrid;
use crate::geometry::{add_scaled, dot, hypot, norm, unit};
use crate::image::synth::Truth;
use crate::image::synth::truth::MAX_DISTANCE;

/// Radius, in samples, within which a detected point represents the plane through it.
const PLANE_RADIUS: f64 = 1.0;

/// Features of an image, as points on them and as a distance field.
pub struct Reference<'a, const D: usize = 3> {
    /// Source of the features, for the report.
    pub source: &'static str,
    /// Points on the features. From truth: each sample closer than half a sample to a feature,
    /// moved onto it (except where the feature tapers out). Otherwise the detected points, or this
    /// rank's part of them.
    pub points: Vec<[f32; D]>,
    /// Number of the surface of each point; empty for truth.
    pub surface: Vec<u32>,
    /// Distance of the next feature and its angle (degrees) at each point, where the truth has
    /// them.
    pub next_feature: Option<Vec<[f32; 2]>>,
    field: DistanceField<'a, D>,
}

enum DistanceField<'a, const D: usize> {
    Truth(&'a Truth<D>),
    Detected(DetectedPoints<D>),
}

/// Detected points, for distances.
struct DetectedPoints<const D: usize> {
    points: PointGrid<D>,
    /// Normal of each point, in the order of the grid.
    normals: Vec<[f32; D]>,
}

impl<'a, const D: usize> Reference<'a, D> {
    /// Creates a reference from ground truth. Feature points that are moved out of the box (where a
    /// feature leaves through a side) are omitted, since no mesh of the box can contain them.
    pub fn from_truth(truth: &'a Truth<D>) -> Self {
        let last = truth.dims.map(|n| (n - 1) as f32);
        let point = |i: usize| -> [f32; D] {
            let index = truth.index_of(i);
            std::array::from_fn(|k| index[k] as f32 + truth.distance[i] * truth.direction[i][k])
        };
        let inside = |p: [f32; D]| (0..D).all(|k| (-1e-3..=last[k] + 1e-3).contains(&p[k]));
        let (mut points, mut next_feature) =
            (Vec::new(), truth.next_feature.as_ref().map(|_| Vec::new()));
        let is_counted = |i: usize| {
            truth
                .next_feature
                .as_ref()
                .is_none_or(|next| next[i][0] >= 0.0)
        };
        let is_selected = |&i: &usize| truth.distance[i] < 0.5 && is_counted(i) && inside(point(i));
        for i in (0..truth.distance.len()).filter(is_selected) {
            points.push(point(i));
            if let (Some(next), Some(sample_values)) = (&mut next_feature, &truth.next_feature) {
                next.push(sample_values[i]);
            }
        }
        let source = if truth.is_smooth { "truth" } else { "mask" };
        Self {
            source,
            points,
            surface: Vec::new(),
            next_feature,
            field: DistanceField::Truth(truth),
        }
    }

    /// Creates a reference from detected features, if no truth is known.
    pub fn from_features(features: &Features<D>) -> Self {
        Self::from_share(features, &features.points)
    }

    /// Creates a reference for one of several ranks, each of which has a part of the feature
    /// points. `nearby` are the points near the cells that this rank measures.
    pub(crate) fn from_share(features: &Features<D>, nearby: &[FeaturePoint<D>]) -> Self {
        let step = features.potential.step.map(|s| s as f32);
        let in_samples = |points: &[FeaturePoint<D>]| -> Vec<[f32; D]> {
            let points = points.iter();
            points
                .map(|p| std::array::from_fn(|k| p.position[k] / step[k]))
                .collect()
        };
        let sorted = PointGrid::new(&in_samples(nearby));
        let normals = (sorted.order().iter())
            .map(|&i| {
                let p = &nearby[i as usize];
                unit(std::array::from_fn(|k| p.normal[k] * step[k]))
            })
            .collect();
        Self {
            source: "detected",
            points: in_samples(&features.points),
            surface: features.surface.clone(),
            next_feature: None,
            field: DistanceField::Detected(DetectedPoints {
                points: sorted,
                normals,
            }),
        }
    }

    /// Returns `true` if a position is within `limit` of the features. This is cheap far from them.
    pub fn is_within(&self, p: [f64; D], limit: f64) -> bool {
        match &self.field {
            DistanceField::Truth(truth) => {
                let sample: [usize; D] = std::array::from_fn(|k| {
                    (p[k].max(0.0).round() as usize).min(truth.dims[k] - 1)
                });
                let gap: [f64; D] = std::array::from_fn(|k| p[k] - sample[k] as f64);
                let d = f64::from(truth.distance[truth.sample_index(sample)]);
                d - norm(gap) <= limit && distance_from_corners(truth, p) <= limit
            }
            DistanceField::Detected(detected) => {
                // The nearest point is farther away than its plane by a limited distance.
                let search_radius = hypot(limit, PLANE_RADIUS) + 1e-9;
                detected.distance(p, search_radius, &mut None) <= limit
            }
        }
    }

    /// Returns the distance from a position to the features, at most [`MAX_DISTANCE`].
    ///
    /// From truth it is third-order accurate, see `distance_from_corners`. From detected points it
    /// is the distance to the plane of the nearest point, or to that point if it is more than one
    /// sample away sideways. `hint` stores that point. It saves time if the next position is near
    /// this one.
    pub fn distance(&self, p: [f64; D], hint: &mut Option<usize>) -> f64 {
        match &self.field {
            DistanceField::Truth(truth) => distance_from_corners(truth, p),
            DistanceField::Detected(detected) => {
                detected.distance(p, f64::from(MAX_DISTANCE), hint)
            }
        }
    }
}

impl<const D: usize> DetectedPoints<D> {
    /// Returns the distance from the detected points, or `max_distance` if no point is closer than
    /// that.
    fn distance(&self, p: [f64; D], max_distance: f64, hint: &mut Option<usize>) -> f64 {
        let Some((i, square)) = self.points.nearest(p, max_distance, *hint) else {
            return max_distance;
        };
        *hint = Some(i);
        let point = self.points.position(i);
        let gap: [f64; D] = std::array::from_fn(|k| p[k] - f64::from(point[k]));
        let along = dot(gap, self.normals[i].map(f64::from)).abs();
        let sideways = square - along * along;
        if sideways > PLANE_RADIUS * PLANE_RADIUS {
            square.sqrt()
        } else {
            along
        }
    }
}

/// Maximum number of corners of a cell of samples: eight in 3-D. In 2-D four of them are used.
const MAX_CORNERS: usize = 8;

/// Returns the distance computed from the eight samples (in 2-D four) around a position.
///
/// Each sample i has its closest feature point q_i and the normal n_i there. On a smooth surface, a
/// chord is perpendicular to the mean of the normals at its ends up to third order. So the height
/// of p over the surface of sample i is (p - q_i) . (n_i + n_p) / 2, where n_p is interpolated from
/// the samples with the same surface. The minimum height is used, which is correct on both sides of
/// a crossing. A distance changes no faster than the position, so it is at least d_i - |p - x_i|
/// for every sample. This bound is used where a surface ends (except for less than one sample
/// beyond the end, where the surface may seem to continue).
fn distance_from_corners<const D: usize>(truth: &Truth<D>, p: [f64; D]) -> f64 {
    let cell: [usize; D] = std::array::from_fn(|k| (p[k].max(0.0) as usize).min(truth.dims[k] - 2));
    let fractions: [f64; D] = std::array::from_fn(|k| (p[k] - cell[k] as f64).clamp(0.0, 1.0));
    let count = 1 << D;
    let mut weights = [0f64; MAX_CORNERS];
    let mut normals = [[0f64; D]; MAX_CORNERS];
    let mut gaps = [[0f64; D]; MAX_CORNERS];
    let mut is_known = [false; MAX_CORNERS];
    let mut lower_bound = 0f64;
    for c in 0..count {
        let bit: [usize; D] = std::array::from_fn(|k| c >> k & 1);
        let sample: [usize; D] = std::array::from_fn(|k| cell[k] + bit[k]);
        let i = truth.sample_index(sample);
        let d = f64::from(truth.distance[i]);
        let offset: [f64; D] = std::array::from_fn(|k| p[k] - sample[k] as f64);
        lower_bound = lower_bound.max(d - norm(offset));
        normals[c] = truth.direction[i].map(f64::from);
        is_known[c] = truth.direction[i] != [0.0; D] || d == 0.0;
        gaps[c] = std::array::from_fn(|k| offset[k] - d * normals[c][k]);
        weights[c] = (0..D)
            .map(|k| {
                if bit[k] == 1 {
                    fractions[k]
                } else {
                    1.0 - fractions[k]
                }
            })
            .product();
    }
    let corners = CellCorners {
        weights,
        normals,
        offsets: gaps,
    };
    let first = is_known.iter().position(|&k| k).unwrap_or(0);
    // Far from crossings all samples see one surface, and one mean normal is enough for all of
    // them.
    let is_one_surface =
        (0..count).all(|i| is_known[i] && corners.orientation_sign(first, i) != 0.0);
    let common_normal = (is_one_surface && truth.is_smooth).then(|| corners.mean_normal(first));
    let mut best = f64::from(MAX_DISTANCE);
    for i in (0..count).filter(|&i| is_known[i]) {
        let height = if truth.is_smooth && normals[i] != [0.0; D] {
            let mean = match common_normal {
                Some(mean) => mean.map(|c| corners.orientation_sign(first, i) * c),
                None => corners.mean_normal(i),
            };
            0.5 * (dot(gaps[i], normals[i]) + dot(gaps[i], mean)).abs()
        } else {
            norm(gaps[i])
        };
        best = best.min(height);
    }
    best.max(lower_bound).clamp(0.0, f64::from(MAX_DISTANCE))
}

/// Samples around a position p: their interpolation weights at p, their normals, and the vectors
/// from their closest feature points to p.
struct CellCorners<const D: usize> {
    weights: [f64; MAX_CORNERS],
    normals: [[f64; D]; MAX_CORNERS],
    offsets: [[f64; D]; MAX_CORNERS],
}

impl<const D: usize> CellCorners<D> {
    /// Returns 1 or -1 if samples i and j see the same surface with equal or opposite normals, else
    /// 0.
    #[inline]
    fn orientation_sign(&self, i: usize, j: usize) -> f64 {
        let cosine = dot(self.normals[i], self.normals[j]);
        if cosine.abs() < 0.9 {
            return 0.0;
        }
        let sign = cosine.signum();
        // The chord q_j - q_i times the sum of the normals is small on the same surface.
        let chord: f64 = (0..D)
            .map(|k| {
                (self.offsets[i][k] - self.offsets[j][k])
                    * (self.normals[i][k] + sign * self.normals[j][k])
            })
            .sum();
        if chord.abs() < 0.1 { sign } else { 0.0 }
    }

    /// Returns the unit normal at p of the surface of sample i, on the side of i's normal.
    fn mean_normal(&self, i: usize) -> [f64; D] {
        let mut sum = [0f64; D];
        for j in 0..1 << D {
            let weight = self.orientation_sign(i, j) * self.weights[j];
            sum = add_scaled(sum, weight, self.normals[j]);
        }
        if norm(sum) > 0.0 {
            unit(sum)
        } else {
            self.normals[i]
        }
    }
}

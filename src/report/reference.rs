//! Where the features really are: what a mesh is compared with.
//!
//! All positions and distances here are in samples, that is, in lattice space with a step of 1.

use super::nearest::PointGrid;
use crate::comm::LocalOrComm;
use crate::feature::{FeaturePoint, Features};
use crate::geometry::dot;
use crate::image::synth::Truth;
use crate::image::synth::truth::MAX_DISTANCE;
use std::ops::Range;

/// How far sideways, in samples, a detected point stands for the plane through it.
const PLANE_RADIUS: f64 = 1.0;

/// The features of an image: as points on them, and as a distance from anywhere.
pub struct Reference<'a, const D: usize = 3> {
    /// What it was made from, for the report.
    pub source: &'static str,
    /// Points on the features: from truth, each sample closer than half a sample to a feature, moved
    /// onto it (but where the feature tapers out); else the detected points, or a share of them.
    pub points: Vec<[f32; D]>,
    is_shared: bool,
    /// For each of them, where the truth knows it, how far the next feature is and at what angle it
    /// lies (degrees).
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
    /// Of each point, in the order of the cells.
    normals: Vec<[f32; D]>,
}

impl<'a, const D: usize> Reference<'a, D> {
    /// Ground truth. Feature points that the move takes out of the box (where a feature leaves
    /// through a side) are left out, since no mesh of the box can hold them.
    pub fn from_truth(truth: &'a Truth<D>) -> Self {
        let last = truth.dims.map(|n| (n - 1) as f32);
        let point = |i: usize| -> [f32; D] {
            let index = truth.index_of(i);
            std::array::from_fn(|k| index[k] as f32 + truth.distance[i] * truth.direction[i][k])
        };
        let inside = |p: [f32; D]| (0..D).all(|k| (-1e-3..=last[k] + 1e-3).contains(&p[k]));
        let (mut points, mut next_feature) =
            (Vec::new(), truth.next_feature.as_ref().map(|_| Vec::new()));
        let asked_for = |i: usize| {
            truth
                .next_feature
                .as_ref()
                .is_none_or(|next| next[i][0] >= 0.0)
        };
        let wanted = |&i: &usize| truth.distance[i] < 0.5 && asked_for(i) && inside(point(i));
        for i in (0..truth.distance.len()).filter(wanted) {
            points.push(point(i));
            if let (Some(next), Some(of_samples)) = (&mut next_feature, &truth.next_feature) {
                next.push(of_samples[i]);
            }
        }
        let source = if truth.is_smooth { "truth" } else { "mask" };
        Self {
            source,
            points,
            is_shared: false,
            next_feature,
            field: DistanceField::Truth(truth),
        }
    }

    /// The detected features, when no truth is known.
    pub fn from_features(features: &Features<D>) -> Self {
        Self::detected(features, &features.points)
    }

    /// The same where each of several has a share of the points: `near` are those near to what is measured here.
    pub(crate) fn from_share(features: &Features<D>, near: &[FeaturePoint<D>]) -> Self {
        Self {
            is_shared: true,
            ..Self::detected(features, near)
        }
    }

    fn detected(features: &Features<D>, near: &[FeaturePoint<D>]) -> Self {
        let step = features.potential.step.map(|s| s as f32);
        let in_samples = |points: &[FeaturePoint<D>]| -> Vec<[f32; D]> {
            let points = points.iter();
            points
                .map(|p| std::array::from_fn(|k| p.position[k] / step[k]))
                .collect()
        };
        let dims = features.potential.dims;
        let extent = dims.map(|n| (n.max(1) - 1) as f64);
        let (sorted, order) = PointGrid::new(&in_samples(near), extent);
        let normals = order
            .iter()
            .map(|&i| {
                let p = &near[i as usize];
                let n: [f32; D] = std::array::from_fn(|k| p.normal[k] * step[k]);
                let length = n
                    .iter()
                    .map(|c| c * c)
                    .sum::<f32>()
                    .sqrt()
                    .max(f32::MIN_POSITIVE);
                n.map(|c| c / length)
            })
            .collect();
        Self {
            source: "detected",
            points: in_samples(&features.points),
            is_shared: false,
            next_feature: None,
            field: DistanceField::Detected(DetectedPoints {
                points: sorted,
                normals,
            }),
        }
    }

    /// The points that one of some holders compares with faces.
    pub(super) fn owned_points<H: LocalOrComm + ?Sized>(&self, holders: &H) -> Range<usize> {
        match self.is_shared {
            true => 0..self.points.len(),
            false => holders.range_of_rank(self.points.len(), holders.rank()),
        }
    }

    /// Whether a position is within `limit` of the features; cheap far from them.
    pub fn is_within(&self, p: [f64; D], limit: f64) -> bool {
        match &self.field {
            DistanceField::Truth(truth) => {
                let at: [usize; D] = std::array::from_fn(|k| {
                    (p[k].max(0.0).round() as usize).min(truth.dims[k] - 1)
                });
                let gap: [f64; D] = std::array::from_fn(|k| p[k] - at[k] as f64);
                let d = f64::from(truth.distance[truth.sample_index(at)]);
                d - dot(gap, gap).sqrt() <= limit && distance_from_corners(truth, p) <= limit
            }
            DistanceField::Detected(detected) => {
                // The nearest point is that much farther at most than the distance to its plane.
                let far = limit.hypot(PLANE_RADIUS) + 1e-9;
                detected.distance(p, far, &mut None) <= limit
            }
        }
    }

    /// Distance from a position to the features, at most [`INFLUENCE_RADIUS`].
    ///
    /// From truth it is third-order accurate: see `from_corners`. From detected points it is the
    /// distance to the plane of the nearest point, or to that point if it is more than one sample
    /// away sideways. `hint` remembers that point: of positions in turn, the next is mostly near the
    /// one before, which saves time.
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
    /// The distance from detected points; `far` if no point is nearer than that.
    fn distance(&self, p: [f64; D], far: f64, hint: &mut Option<usize>) -> f64 {
        let Some((i, square)) = self.points.nearest(p, far, *hint) else {
            return far;
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

/// Most corners of a cell of samples: eight in space, four of them used in the plane.
const MAX_CORNERS: usize = 8;

/// Distance from the eight samples (four in the plane) about a position.
///
/// Each sample i knows its closest feature point q_i and the normal n_i there. On a smooth surface
/// a chord is perpendicular to the mean of the normals at its ends up to third order, so the height
/// of p over the surface of sample i is (p - q_i) . (n_i + n_p) / 2, with n_p interpolated among
/// the samples that see the same surface. The least height wins, which is right on both sides of a
/// crossing. As a distance changes no faster than position, it is at least every
/// d_i - |p - x_i|: that holds where a surface ends (but for less than a sample behind its end, where
/// it may still seem to go on).
fn distance_from_corners<const D: usize>(truth: &Truth<D>, p: [f64; D]) -> f64 {
    let cell: [usize; D] = std::array::from_fn(|k| (p[k].max(0.0) as usize).min(truth.dims[k] - 2));
    let inside: [f64; D] = std::array::from_fn(|k| (p[k] - cell[k] as f64).clamp(0.0, 1.0));
    let count = 1 << D;
    let mut weights = [0f64; MAX_CORNERS];
    let mut normals = [[0f64; D]; MAX_CORNERS];
    let mut gaps = [[0f64; D]; MAX_CORNERS];
    let mut known = [false; MAX_CORNERS];
    let mut least = 0f64;
    for c in 0..count {
        let bit: [usize; D] = std::array::from_fn(|k| c >> k & 1);
        let at: [usize; D] = std::array::from_fn(|k| cell[k] + bit[k]);
        let i = truth.sample_index(at);
        let d = f64::from(truth.distance[i]);
        let from: [f64; D] = std::array::from_fn(|k| p[k] - at[k] as f64);
        least = least.max(d - dot(from, from).sqrt());
        normals[c] = truth.direction[i].map(f64::from);
        known[c] = truth.direction[i] != [0.0; D] || d == 0.0;
        gaps[c] = std::array::from_fn(|k| from[k] - d * normals[c][k]);
        weights[c] = (0..D)
            .map(|k| {
                if bit[k] == 1 {
                    inside[k]
                } else {
                    1.0 - inside[k]
                }
            })
            .product();
    }
    let corners = CellCorners {
        weights,
        normals,
        offsets: gaps,
    };
    let first = known.iter().position(|&k| k).unwrap_or(0);
    // Far from crossings all samples see one surface, and one mean normal serves them all.
    let shared = (0..count).all(|i| known[i] && corners.orientation_sign(first, i) != 0.0);
    let shared = (shared && truth.is_smooth).then(|| corners.mean_normal(first));
    let mut best = f64::from(MAX_DISTANCE);
    for i in (0..count).filter(|&i| known[i]) {
        let height = if truth.is_smooth && normals[i] != [0.0; D] {
            let mean = match shared {
                Some(mean) => mean.map(|c| corners.orientation_sign(first, i) * c),
                None => corners.mean_normal(i),
            };
            0.5 * (dot(gaps[i], normals[i]) + dot(gaps[i], mean)).abs()
        } else {
            dot(gaps[i], gaps[i]).sqrt()
        };
        best = best.min(height);
    }
    best.max(least).clamp(0.0, f64::from(MAX_DISTANCE))
}

/// The samples about a position p: their weights in p, their normals, and p minus their
/// closest feature points.
struct CellCorners<const D: usize> {
    weights: [f64; MAX_CORNERS],
    normals: [[f64; D]; MAX_CORNERS],
    offsets: [[f64; D]; MAX_CORNERS],
}

impl<const D: usize> CellCorners<D> {
    /// 1 or -1 if samples i and j see the same surface with normals alike or opposite, else 0.
    #[inline]
    fn orientation_sign(&self, i: usize, j: usize) -> f64 {
        let turn = dot(self.normals[i], self.normals[j]);
        if turn.abs() < 0.9 {
            return 0.0;
        }
        let sign = turn.signum();
        // The chord q_j - q_i against the mean normal: small on one and the same surface.
        let chord: f64 = (0..D)
            .map(|k| {
                (self.offsets[i][k] - self.offsets[j][k])
                    * (self.normals[i][k] + sign * self.normals[j][k])
            })
            .sum();
        if chord.abs() < 0.1 { sign } else { 0.0 }
    }

    /// The unit normal at p of the surface that sample i sees, on the side of i's normal.
    fn mean_normal(&self, i: usize) -> [f64; D] {
        let mut sum = [0f64; D];
        for j in 0..1 << D {
            let share = self.orientation_sign(i, j) * self.weights[j];
            for k in 0..D {
                sum[k] += share * self.normals[j][k];
            }
        }
        let length = dot(sum, sum).sqrt();
        if length > 0.0 {
            sum.map(|c| c / length)
        } else {
            self.normals[i]
        }
    }
}

//! Surfaces that the user gives, as features.
//!
//! A surface of triangles becomes points as a detector finds them: those at which the columns of
//! samples along the axis nearest to its normal cross it. From there on, given surfaces are
//! features like others: they have valleys in b(x), and the mesh has faces on them. No feature is
//! searched for next to them, so that each surface is followed once.

use std::sync::Arc;

use super::candidate::{Candidate, Voxel, dominant_axes, nearest_sample};
use super::potential::PotentialValleys;
use super::{DetectionOptions, FeaturePoint, Features, SharedGrid, local_feature_size};
use crate::error::Result;
use crate::files::codec::codec_fields;
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, dot, norm, normal, sub, unit};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use std::borrow::Cow;

/// Smallest cosine between the normals of parallel surfaces.
const MIN_PARALLEL_COSINE: f32 = 0.9;

/// Largest distance (samples) of boundaries of labels from a given surface that they follow in steps, and
/// smallest cosine between their normals.
const STEP_DISTANCE: f64 = 1.5;
const MIN_STEP_COSINE: f32 = 0.6;

/// Largest distance (samples) from the plane of a given surface at which boundaries of labels are those that
/// the surface makes, whatever their normal. Where the boundary meets others, its normal is not that of the
/// surface.
const CUT_DISTANCE: f64 = 0.75;
/// Distance (samples) between neighbours of a point in one surface: those of adjacent columns.
const NEIGHBOUR_DISTANCE: f64 = 1.8;
/// Distance (samples) from a point to the mean of its neighbours from which its surface ends there.
/// Along a straight rim, the mean is a third of a sample off.
const MIN_RIM_OFFSET: f32 = 0.2;
/// Distance (samples) within which points of one surface in the same column are one point.
const SAME_POINT_DISTANCE: f32 = 1e-3;
/// Strength of the points.
const STRENGTH: f32 = 1.0;

/// A surface of triangles (in 2-D, of segments) in sample coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct GivenSurface<const D: usize> {
    /// Name of the surface.
    pub name: String,
    /// `true` for a horizon, which is no barrier to flow.
    pub is_horizon: bool,
    /// Corners of each triangle.
    pub triangles: Vec<[[f64; D]; D]>,
}

/// Name of a feature surface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SurfaceName {
    /// Number of the surface in [`Features::surface`].
    pub number: u32,
    /// Its name.
    pub name: String,
    /// `true` for a horizon, which is no barrier to flow.
    pub is_horizon: bool,
}

codec_fields! {
    SurfaceName as SurfaceName { number, name, is_horizon }
}

/// The points of given surfaces in an image.
#[derive(Debug, Clone, PartialEq)]
pub struct GivenPoints<const D: usize> {
    /// Name of each surface, and `true` if it is a horizon.
    pub surfaces: Vec<(String, bool)>,
    /// Points in sample coordinates in the order of samples, each with the index of its surface.
    points: Vec<(FeaturePoint<D>, u32)>,
    /// Number of samples of the image.
    dims: [usize; D],
}

impl<const D: usize> GivenPoints<D> {
    /// Returns the points of surfaces in an image of `dims` samples.
    pub fn new(surfaces: &[GivenSurface<D>], dims: [usize; D]) -> Self {
        let mut points: Vec<(FeaturePoint<D>, u32)> = Vec::new();
        for (index, surface) in (0..).zip(surfaces) {
            let crossings = surface.triangles.par_iter().flat_map_iter(|triangle| {
                let mut crossings = Vec::new();
                add_crossings(triangle, dims, &mut crossings);
                crossings
            });
            points.extend(crossings.map(|p| (p, index)).collect::<Vec<_>>());
        }
        let voxel = |p: &FeaturePoint<D>| {
            let at = std::array::from_fn(|k| {
                (nearest_sample(p.position[k]).max(0) as usize).min(dims[k] - 1)
            });
            Voxel::new(dims, at).index()
        };
        points.sort_by(|(p, s), (q, t)| {
            (voxel(p).cmp(&voxel(q)))
                .then(s.cmp(t))
                .then_with(|| compare(p.position, q.position))
        });
        // Triangles that share an edge or a corner both have the points on it.
        let mut merged: Vec<(FeaturePoint<D>, u32)> = Vec::with_capacity(points.len());
        for (point, surface) in points {
            match merged.last_mut() {
                Some((last, s))
                    if *s == surface
                        && norm(sub(last.position, point.position)) < SAME_POINT_DISTANCE =>
                {
                    let sign = 1f32.copysign(dot(last.normal, point.normal));
                    last.normal = unit(add_scaled(last.normal, sign, point.normal));
                }
                _ => merged.push((point, surface)),
            }
        }
        Self {
            surfaces: surfaces
                .iter()
                .map(|s| (s.name.clone(), s.is_horizon))
                .collect(),
            points: merged,
            dims,
        }
    }

    /// Returns the number of points on a surface.
    pub fn count(&self, surface: usize) -> usize {
        self.points
            .iter()
            .filter(|(_, s)| *s as usize == surface)
            .count()
    }

    /// Drops the candidates that are parallel to a given surface and nearer to it than `distance`
    /// samples. Returns their number. Boundaries of labels (`are_labels`) also follow the surface where
    /// they are steps of samples beside it, or end at it.
    pub(super) fn drop_parallel(
        &self,
        candidates: &mut Vec<Candidate<D>>,
        distance: f64,
        are_labels: bool,
    ) -> usize {
        let positions = self.positions();
        let grid = CellList::new(&positions, distance.max(STEP_DISTANCE));
        let is_parallel = |c: &Candidate<D>| {
            let (position, mut is_near) = (c.position.map(f64::from), false);
            grid.visit_within(position, distance.max(STEP_DISTANCE), |i| {
                let (point, offset) = (&self.points[i].0, sub(positions[i], position));
                let cosine = dot(point.normal, c.normal).abs();
                let height = dot(point.normal.map(f64::from), offset).abs();
                let is_step = cosine >= MIN_STEP_COSINE || height <= CUT_DISTANCE;
                is_near |= norm(offset) <= distance && cosine >= MIN_PARALLEL_COSINE
                    || are_labels && norm(offset) <= STEP_DISTANCE && is_step;
            });
            is_near
        };
        let keeps: Vec<bool> = candidates.par_iter().map(|c| !is_parallel(c)).collect();
        let before = candidates.len();
        let mut keep = keeps.iter();
        candidates.retain(|_| keep.next().copied().unwrap_or(true));
        before - candidates.len()
    }

    /// Returns the positions of the points.
    fn positions(&self) -> Vec<[f64; D]> {
        let points = self.points.iter();
        points.map(|(p, _)| p.position.map(f64::from)).collect()
    }

    /// Returns for each point `true` if its surface ends there.
    fn rims(&self) -> Vec<bool> {
        let positions = self.positions();
        let grid = CellList::new(&positions, NEIGHBOUR_DISTANCE);
        let is_rim = |i: usize| {
            let (point, surface) = &self.points[i];
            let (mut sum, mut count) = ([0.0f32; D], 0);
            grid.visit_within(positions[i], NEIGHBOUR_DISTANCE, |j| {
                let (other, other_surface) = &self.points[j];
                let distance = norm(sub(positions[j], positions[i]));
                if surface == other_surface && distance <= NEIGHBOUR_DISTANCE {
                    count += 1;
                    sum = add_scaled(sum, 1.0, sub(other.position, point.position));
                }
            });
            count < 1 << (D - 1) || norm(sum) > MIN_RIM_OFFSET * count as f32
        };
        (0..self.points.len()).into_par_iter().map(is_rim).collect()
    }

    /// Returns the given surfaces as features.
    ///
    /// # Errors
    /// Returns the errors of the distance between atoms.
    pub(super) fn features(
        &self,
        options: &DetectionOptions<D>,
        cancel: &CancelToken<'_>,
    ) -> Result<Features<D>> {
        let (dims, step) = (self.dims, options.step);
        let grid = SharedGrid::of_one_process(dims);
        let in_lattice = |(p, _): &(FeaturePoint<D>, u32)| FeaturePoint {
            position: std::array::from_fn(|k| p.position[k] * step[k] as f32),
            normal: unit(std::array::from_fn(|k| p.normal[k] / step[k] as f32)),
            strength: p.strength,
        };
        let points: Vec<FeaturePoint<D>> = self.points.iter().map(in_lattice).collect();
        let spacing = (options.gap_distance_range())
            .map(|limits| local_feature_size::spacing(grid, &points, None, step, limits))
            .transpose()?;
        let sigma = options.d_max() / 4.0;
        let valleys = PotentialValleys {
            grid,
            step,
            sigma,
            points: Cow::Borrowed(&points),
            is_rim: Cow::Owned(self.rims()),
            spacing: spacing.as_deref().map(Cow::Borrowed),
        };
        let potential = valleys.potential(cancel);
        let mut names: Vec<SurfaceName> = (1..)
            .zip(&self.surfaces)
            .map(|(number, (name, is_horizon))| SurfaceName {
                number,
                name: name.clone(),
                is_horizon: *is_horizon,
            })
            .collect();
        // A face on a fault and a horizon belongs to the fault, which may be a barrier.
        names.sort_by_key(|name| name.is_horizon);
        Ok(Features {
            surface: self.points.iter().map(|(_, s)| s + 1).collect(),
            on_horizon: (self.points.iter())
                .map(|(_, s)| self.surfaces[*s as usize].1)
                .collect(),
            points,
            potential,
            spacing,
            names,
            ..Features::empty(dims, options)
        })
    }
}

/// Points of given surfaces, which clones of options share.
pub type SharedPoints<const D: usize> = Option<Arc<GivenPoints<D>>>;

/// Compares positions by their coordinates, the first one first.
fn compare<const D: usize>(a: [f32; D], b: [f32; D]) -> std::cmp::Ordering {
    (0..D).fold(std::cmp::Ordering::Equal, |order, k| {
        order.then(a[k].total_cmp(&b[k]))
    })
}

/// Adds the points at which columns of samples cross a triangle.
fn add_crossings<const D: usize>(
    triangle: &[[f64; D]; D],
    dims: [usize; D],
    crossings: &mut Vec<FeaturePoint<D>>,
) {
    let area_vector = normal(triangle);
    if !(norm(area_vector) > 0.0 && norm(area_vector).is_finite()) {
        return;
    }
    let direction = unit(area_vector);
    for axis in dominant_axes(direction) {
        let range = |k: usize| {
            let values = triangle.iter().map(|corner| corner[k]);
            let low = values.clone().fold(f64::INFINITY, f64::min);
            let high = values.fold(f64::NEG_INFINITY, f64::max);
            let last = (dims[k] - 1) as f64;
            // Rounding must not drop a column at the end of the triangle.
            let [low, high] = [(low - 1e-9).ceil(), (high + 1e-9).floor()];
            (low.max(0.0) as usize, high.min(last))
        };
        let lateral: Vec<usize> = (1..D).map(|k| (axis + k) % D).collect();
        let ranges: Vec<(usize, f64)> = lateral.iter().map(|&k| range(k)).collect();
        if ranges.iter().any(|&(low, high)| (low as f64) > high) {
            continue;
        }
        let counts: Vec<usize> = (ranges.iter())
            .map(|&(low, high)| high as usize - low + 1)
            .collect();
        for column in 0..counts.iter().product() {
            let (mut x, mut rest) = ([0.0; D], column);
            for ((&k, (low, _)), count) in lateral.iter().zip(&ranges).zip(&counts) {
                x[k] = (low + rest % count) as f64;
                rest /= count;
            }
            let slope: f64 = lateral
                .iter()
                .map(|&k| direction[k] * (x[k] - triangle[0][k]))
                .sum();
            x[axis] = triangle[0][axis] - slope / direction[axis];
            let last = (dims[axis] - 1) as f64;
            if !(-1e-6..=last + 1e-6).contains(&x[axis]) || !is_in_column(triangle, x, axis) {
                continue;
            }
            x[axis] = x[axis].clamp(0.0, last);
            crossings.push(FeaturePoint {
                position: x.map(|c| c as f32),
                normal: direction.map(|c| c as f32),
                strength: STRENGTH,
            });
        }
    }
}

/// Returns `true` if a column along `axis` through `x` crosses a triangle.
fn is_in_column<const D: usize>(triangle: &[[f64; D]; D], x: [f64; D], axis: usize) -> bool {
    let total = normal(triangle)[axis];
    (0..D).all(|i| {
        let mut part = *triangle;
        part[i] = x;
        normal(&part)[axis] / total >= -1e-9
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::{FeatureKind, detect};
    use crate::image::{Geometry, Image};

    /// Returns a rectangle of two triangles with normal (1, slope, 0) through x = `x` at y = 0.
    fn plane(name: &str, x: f64, slope: f64, height: f64) -> GivenSurface<3> {
        let node = |y: f64, z: f64| [x - slope * y, y, z];
        let [a, b, c, d] = [
            node(-5.0, -5.0),
            node(60.0, -5.0),
            node(60.0, height),
            node(-5.0, height),
        ];
        GivenSurface {
            name: name.into(),
            is_horizon: false,
            triangles: vec![[a, b, c], [a, c, d]],
        }
    }

    #[test]
    fn every_column_has_one_point_on_the_surface() {
        let dims = [40, 30, 20];
        for slope in [0.0, 0.3, 0.9] {
            let given = GivenPoints::new(&[plane("a", 35.2, slope, 60.0)], dims);
            assert_eq!(given.points.len(), 30 * 20, "{slope}");
            let rims = given.rims();
            for ((p, _), is_rim) in given.points.iter().zip(rims) {
                let [x, y, z] = p.position;
                assert!((x - 35.2 + slope as f32 * y).abs() < 1e-4, "{p:?}");
                let expected = unit([1.0, slope as f32, 0.0]);
                assert!(dot(p.normal, expected).abs() > 1.0 - 1e-6);
                let is_side = y == 0.0 || z == 0.0 || y == 29.0 || z == 19.0;
                assert_eq!(is_rim, is_side, "{p:?}");
            }
        }
        // Columns along both axes where neither is nearer to the normal.
        let both = GivenPoints::new(&[plane("a", 35.2, 1.0, 60.0)], dims);
        assert!(both.points.len() > 30 * 20 + 25 * 20);
    }

    #[test]
    fn a_surface_that_ends_in_the_image_has_a_rim_there() {
        let dims = [40, 30, 20];
        let given = GivenPoints::new(&[plane("a", 20.0, 0.2, 9.4)], dims);
        let rims = given.rims();
        let inner = given.points.iter().zip(&rims).filter(|((p, _), _)| {
            let [_, y, z] = p.position;
            (1.0..=28.0).contains(&y) && (1.0..=8.0).contains(&z)
        });
        assert!(inner.clone().count() == 28 * 8 && inner.clone().all(|(_, rim)| !rim));
        let end = given
            .points
            .iter()
            .zip(&rims)
            .filter(|((p, _), _)| p.position[2] == 9.0);
        assert!(end.clone().count() == 30 && end.clone().all(|(_, rim)| *rim));
    }

    #[test]
    fn given_surfaces_are_followed_with_detection_and_without() {
        // A ridge at x = 12, where a surface is given, too, and one at x = 30.
        let dims = [48, 40, 32];
        let image = Image::from_fn(dims, Geometry::<3>::default(), |x| {
            let ridge = |at: f64| (-0.5 * ((x[0] - at) / 1.5).powi(2)).exp();
            ridge(12.3) + ridge(30.0)
        });
        let surfaces = [
            plane("mine", 12.0, 0.0, 60.0),
            plane("other", 44.0, 0.05, 60.0),
        ];
        let given = Some(Arc::new(GivenPoints::new(&surfaces, dims)));
        let options = |kind, given| DetectionOptions {
            given,
            ..DetectionOptions::with_kind(kind, 5.0)
        };
        let alone = detect(&image, &options(FeatureKind::NoFeatures, given.clone())).unwrap();
        assert_eq!(alone.points.len(), 2 * 40 * 32);
        let names: Vec<(u32, &str)> = alone.names.iter().map(|n| (n.number, &*n.name)).collect();
        assert_eq!(names, [(1, "mine"), (2, "other")]);
        let found = detect(&image, &options(FeatureKind::Ridges, None)).unwrap();
        let both = detect(&image, &options(FeatureKind::Ridges, given)).unwrap();
        // The ridge next to the given surface is left out.
        let count = |features: &Features<3>, x: f32| {
            let is_at = |p: &&FeaturePoint<3>| (p.position[0] - x).abs() < 0.2;
            features.points.iter().filter(is_at).count()
        };
        assert!(count(&found, 12.3) > 1000 && count(&found, 30.0) > 1000);
        assert_eq!(count(&both, 12.3), 0);
        assert_eq!(count(&both, 12.0), 40 * 32);
        assert_eq!(count(&both, 30.0), count(&found, 30.0));
        let b = |x: f64| both.potential.value([x, 20.0, 16.0]);
        assert!(
            b(12.0) < -0.99 && b(30.0) < -0.99 && b(43.0) < -0.99,
            "valleys"
        );
        let max = both.surface.iter().max().copied();
        assert_eq!(both.names.iter().map(|n| Some(n.number)).max(), Some(max));
    }
}

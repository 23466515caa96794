//! Computes how fine a lattice must be to resolve a feature and the next one.
//!
//! From each point of a surface, the next surface is searched for along the normal, in both directions.
//! If the gap is smaller than the largest distance between atoms, it is the distance of atoms
//! there; at a shallow crossing the gap goes to zero, and the smallest distance is used. Surfaces
//! that cross at more than [`MAX_PARALLEL_ANGLE`] degrees need no finer lattice, because one row of
//! atoms stands on both. Neither does a surface whose normals scatter in noise, if the surface of
//! each point is known.

use super::candidate::{Candidate, Voxel, nearest_sample};
use super::shared_grid::PointsWithHalo;
use super::voxel_index::CandidateIndex;
use super::{FeaturePoint, SharedGrid};
use crate::error::Result;
use crate::geometry::{dot, norm, sub, unit};
use crate::parallel::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Largest angle (degrees) between surfaces that run side by side.
const MAX_PARALLEL_ANGLE: f32 = 40.0;
/// Distance (samples) from a point within which points with its normal belong to its own surface.
const SAME_SURFACE_RADIUS: f32 = 1.5;
/// Largest angle (degrees) between the normals of these points.
const SAME_SURFACE_ANGLE: f32 = 10.0;
/// Distance (samples) along the normal below which points of one surface are neighbours, whatever
/// their normals.
const MIN_SELF_DISTANCE: f32 = 1.0;
/// Largest distance (samples) at which a normal passes a point to meet its disc.
const DISC_RADIUS: f32 = 0.9;
/// Largest growth of the distance per unit of length along surfaces.
const MAX_GROWTH_RATE: f32 = 0.1;
/// Number of layers beyond the end of a gap in which the bounding surface may lie.
const EXTRA_HALO_LAYERS: usize = 3;

/// Returns for each feature point, in the order of samples, the distance between atoms there in
/// lattice units: from `min` in gaps and at shallow crossings to `max`. `surface` numbers the
/// surface of each point, if normals alone do not distinguish surfaces. Each rank may have the
/// points of some layers.
///
/// # Errors
/// Returns the errors of other ranks.
pub fn spacing<const D: usize>(
    grid: SharedGrid<'_, D>,
    points: &[FeaturePoint<D>],
    surface: Option<&[u32]>,
    step: [f64; D],
    [min, max]: [f64; 2],
) -> Result<Vec<f32>> {
    let min_step = step.iter().fold(f64::INFINITY, |a, &h| a.min(h));
    let reach = (max / min_step).ceil() as usize + EXTRA_HALO_LAYERS;
    let owned = to_candidates(grid.dims, points, step);
    let points = PointsWithHalo::new(grid, owned, surface, reach)?;
    let (min, max) = (min as f32, max as f32);
    let index = CandidateIndex::new(grid.dims, &points.candidates);
    let step = step.map(|h| h as f32);
    let surface = surface.map(|_| &points.surface[..]);
    let spacing_at = |i: usize| {
        if points.is_owned[i] {
            gap_width(&index, surface, i, step, max).clamp(min, max)
        } else {
            max
        }
    };
    let mut spacing: Vec<f32> = (0..points.is_owned.len())
        .into_par_iter()
        .map(spacing_at)
        .collect();
    propagate(grid, &points, &index, &mut spacing, max, step)?;
    Ok(points.owned_values(&spacing))
}

/// Returns for each feature point the smallest of `gaps`, the distance between atoms there in lattice
/// units, after small distances have been propagated along surfaces.
///
/// # Errors
/// Returns the errors of other ranks.
pub fn propagate_gaps<const D: usize>(
    grid: SharedGrid<'_, D>,
    points: &[FeaturePoint<D>],
    step: [f64; D],
    gaps: &[f32],
    max: f64,
) -> Result<Vec<f32>> {
    let owned = to_candidates(grid.dims, points, step);
    let points = PointsWithHalo::new(grid, owned, None, EXTRA_HALO_LAYERS)?;
    let index = CandidateIndex::new(grid.dims, &points.candidates);
    let mut owned_gaps = gaps.iter();
    let mut spacing: Vec<f32> = (points.is_owned.iter())
        .map(|&is_owned| {
            let gap = is_owned.then(|| owned_gaps.next()).flatten();
            gap.map_or(max as f32, |&gap| gap)
        })
        .collect();
    let step = step.map(|h| h as f32);
    propagate(grid, &points, &index, &mut spacing, max as f32, step)?;
    Ok(points.owned_values(&spacing))
}

/// Propagates small distances along surfaces, the smallest first, so that the result does not
/// depend on how points are distributed over ranks.
fn propagate<const D: usize>(
    grid: SharedGrid<'_, D>,
    points: &PointsWithHalo<'_, D>,
    index: &CandidateIndex<'_, D>,
    spacing: &mut [f32],
    max: f32,
    step: [f32; D],
) -> Result<()> {
    // Distances are not negative, so that their bits sort like the values.
    let entry = |i: u32, d: f32| Reverse((d.to_bits(), i));
    let small = (0..).zip(spacing.iter()).filter(|(_, d)| **d < max);
    let mut queue: BinaryHeap<_> = small.map(|(i, &d)| entry(i, d)).collect();
    loop {
        while let Some(Reverse((bits, i))) = queue.pop() {
            let (source, d) = (&points.candidates[i as usize], spacing[i as usize]);
            if bits > d.to_bits() {
                continue;
            }
            index.for_each_around(index.coordinates(source), 1, |j| {
                let offset = sub(points.candidates[j].position, source.position);
                let length: f32 = (0..D).map(|k| (offset[k] * step[k]).powi(2)).sum();
                let d = d + MAX_GROWTH_RATE * length.sqrt();
                if points.is_owned[j] && d < spacing[j] {
                    spacing[j] = d;
                    queue.push(entry(j as u32, d));
                }
            });
        }
        for (i, d) in points.adjacent_values("distances near layers", spacing)? {
            if d < spacing[i as usize] {
                spacing[i as usize] = d;
                queue.push(entry(i, d));
            }
        }
        if !grid.any("distances to carry on", !queue.is_empty())? {
            return Ok(());
        }
    }
}

/// Returns a note on the distances of the points of all ranks.
///
/// # Errors
/// Returns the errors of other ranks.
pub fn spacing_note<const D: usize>(
    grid: SharedGrid<'_, D>,
    spacing: &[f32],
    [min, max]: [f64; 2],
) -> Result<String> {
    let fine = spacing.iter().filter(|&&d| d < 0.99 * max as f32).count();
    let [fine, total] = grid.sum("fine points", [fine, spacing.len()])?;
    Ok(format!(
        "atoms (points of the mesh) are {max:.2} samples apart, and down to {min:.2} where features run close to each other or \
         cross at small angles ({:.1} % of the feature points)",
        100.0 * fine as f64 / total.max(1) as f64,
    ))
}

/// Returns feature points as candidates, in sample coordinates, at the nearest samples.
pub(super) fn to_candidates<const D: usize>(
    dims: [usize; D],
    points: &[FeaturePoint<D>],
    step: [f64; D],
) -> Vec<Candidate<D>> {
    points
        .iter()
        .map(|p| {
            let position: [f32; D] = std::array::from_fn(|k| p.position[k] / step[k] as f32);
            let normal: [f32; D] = std::array::from_fn(|k| p.normal[k] * step[k] as f32);
            let at: [usize; D] = std::array::from_fn(|k| {
                (nearest_sample(position[k]).max(0) as usize).min(dims[k] - 1)
            });
            Candidate {
                voxel: Voxel::new(dims, at),
                axis: 0,
                position,
                normal: unit(normal),
                strength: p.strength,
            }
        })
        .collect()
}

/// Returns the distance, along the normal of a point, to the next surface in lattice units; at most
/// `max`.
fn gap_width<const D: usize>(
    grid: &CandidateIndex<'_, D>,
    surfaces: Option<&[u32]>,
    i: usize,
    step: [f32; D],
    max: f32,
) -> f32 {
    let c = &grid.candidates[i];
    let same_surface = |o: usize| surfaces.is_some_and(|surfaces| surfaces[o] == surfaces[i]);
    let min_parallel_cosine = MAX_PARALLEL_ANGLE.to_radians().cos();
    let same_surface_cosine = SAME_SURFACE_ANGLE.to_radians().cos();
    // Lattice units along the normal in lattice space per sample along the normal in sample space.
    let scaled: [f32; D] = std::array::from_fn(|k| c.normal[k] / step[k]);
    let unit_length = 1.0 / norm(scaled);
    let reach = (max / unit_length).ceil() as i32;
    let mut gap = max;
    for sign in [-1.0, 1.0] {
        for j in 0..=reach {
            let distance = sign * j as f32;
            let at: [i32; D] =
                std::array::from_fn(|k| nearest_sample(c.position[k] + distance * c.normal[k]));
            let mut hit = false;
            grid.for_each_around(at, 1, |o| {
                let other = &grid.candidates[o];
                let cosine = dot(other.normal, c.normal).abs();
                let offset = sub(other.position, c.position);
                let along = dot(offset, c.normal);
                let lateral = (dot(offset, offset) - along * along).max(0.0).sqrt();
                let is_own = (cosine >= same_surface_cosine && along.abs() < SAME_SURFACE_RADIUS)
                    || (same_surface(o) && along.abs() < MIN_SELF_DISTANCE);
                if cosine >= min_parallel_cosine
                    && !is_own
                    && lateral <= DISC_RADIUS
                    && along * sign >= 0.0
                {
                    gap = gap.min(along.abs() * unit_length);
                    hit = true;
                }
            });
            if hit {
                break;
            }
        }
    }
    gap
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::run_threads;

    fn spacing(
        dims: [usize; 3],
        points: &[FeaturePoint<3>],
        surface: Option<&[u32]>,
        step: [f64; 3],
        limits: [f64; 2],
    ) -> Vec<f32> {
        let grid = SharedGrid::of_one_process(dims);
        super::spacing(grid, points, surface, step, limits).unwrap()
    }

    /// Returns points on planes, and the number of the plane of each point.
    fn planes(
        dims: [usize; 3],
        planes: &[([f64; 3], [f64; 3])],
    ) -> (Vec<FeaturePoint<3>>, Vec<u32>) {
        let (mut points, mut surface) = (Vec::new(), Vec::new());
        for (number, &(middle, normal)) in planes.iter().enumerate() {
            let n = crate::geometry::unit(normal);
            for z in 0..dims[2] {
                for y in 0..dims[1] {
                    let p = [0.0, y as f64, z as f64];
                    let x =
                        middle[0] - (n[1] * (p[1] - middle[1]) + n[2] * (p[2] - middle[2])) / n[0];
                    if x >= 0.0 && x <= (dims[0] - 1) as f64 {
                        points.push(FeaturePoint {
                            position: [x as f32, y as f32, z as f32],
                            normal: n.map(|c| c as f32),
                            strength: 1.0,
                        });
                        surface.push(number as u32 + 1);
                    }
                }
            }
        }
        (points, surface)
    }

    #[test]
    fn spacing_between_parallel_surfaces_is_the_gap() {
        let dims = [40, 30, 30];
        let x = [1.0, 0.0, 0.0];
        let (points, _) = planes(dims, &[([15.0, 0.0, 0.0], x), ([20.0, 0.0, 0.0], x)]);
        for d in spacing(dims, &points, None, [1.0; 3], [2.0, 8.0]) {
            assert!((d - 5.0).abs() < 1e-3, "{d}");
        }
        // The distance is in lattice units, and not smaller than the minimum.
        let mut stretched = points.clone();
        stretched.iter_mut().for_each(|p| p.position[0] *= 2.0);
        for d in spacing(dims, &stretched, None, [2.0, 1.0, 1.0], [2.0, 16.0]) {
            assert!((d - 10.0).abs() < 1e-3, "{d}");
        }
        assert!(
            spacing(dims, &points, None, [1.0; 3], [6.0, 8.0])
                .iter()
                .all(|&d| d == 6.0)
        );
    }

    #[test]
    fn spacing_falls_to_the_minimum_at_a_shallow_crossing() {
        let dims = [60, 100, 12];
        let slope = 20f64.to_radians().tan();
        let middle = [30.0, 50.0, 6.0];
        let (points, _) = planes(
            dims,
            &[(middle, [1.0, 0.0, 0.0]), (middle, [1.0, slope, 0.0])],
        );
        let distances = spacing(dims, &points, None, [1.0; 3], [2.5, 8.0]);
        for (p, d) in points.iter().zip(distances) {
            let distance = f64::from((p.position[1] - 50.0).abs());
            let gap = slope * distance;
            if distance < 2.0 {
                assert!(d < 2.6, "{distance} {d}");
            }
            // Within the limits of the growth along the surface.
            let upper_bound = (2.5 + 0.11 * distance).clamp(2.5, 8.0);
            assert!(
                f64::from(d) <= upper_bound + 0.2 && f64::from(d) >= gap.min(upper_bound).min(2.5),
                "{distance} {d}"
            );
        }
    }

    #[test]
    fn steep_crossings_and_single_surfaces_need_no_finer_lattice() {
        let dims = [60, 60, 12];
        let middle = [30.0, 30.0, 6.0];
        let (points, _) = planes(
            dims,
            &[(middle, [1.0, 0.5, 0.0]), (middle, [1.0, -0.6, 0.0])],
        );
        assert!(
            spacing(dims, &points, None, [1.0; 3], [2.5, 8.0])
                .iter()
                .all(|&d| d == 8.0)
        );
    }

    #[test]
    fn a_surface_with_noisy_normals_has_no_gap_to_itself() {
        let dims = [40, 30, 30];
        let (mut points, surface) = planes(dims, &[([15.0, 0.0, 0.0], [1.0, 0.0, 0.0])]);
        let mut random = crate::geometry::random::Random::new(5);
        for p in &mut points {
            let mut scatter = |max: f64| random.range(-max, max);
            p.position[0] += scatter(0.25) as f32;
            let normal = [1.0, scatter(0.25), scatter(0.25)];
            p.normal = crate::geometry::unit(normal).map(|c| c as f32);
        }
        let lattice = [2.0, 8.0];
        let distances = spacing(dims, &points, Some(&surface), [1.0; 3], lattice);
        assert!(distances.iter().all(|&d| d == 8.0), "{distances:?}");
        // Half of the same points, taken as another surface, give gaps.
        let two_surfaces: Vec<u32> = (0..points.len() as u32).map(|i| i % 2).collect();
        let distances = spacing(dims, &points, Some(&two_surfaces), [1.0; 3], lattice);
        assert!(distances.iter().any(|&d| d < 8.0));
    }

    #[test]
    fn spacing_of_distributed_points_matches_one_rank() {
        let dims = [60, 40, 120];
        let slope = 20f64.to_radians().tan();
        let middle = [30.0, 20.0, 45.0];
        let (points, surface) = planes(
            dims,
            &[
                (middle, [1.0, 0.0, 0.0]),
                (middle, [1.0, 0.3 * slope, slope]),
            ],
        );
        let (mut pairs, limits): (Vec<_>, _) =
            (points.into_iter().zip(surface).collect(), [2.5, 8.0]);
        pairs.sort_by_key(|(p, _)| (p.position[2] as u32, p.position[1] as u32));
        let (points, surface): (Vec<_>, Vec<_>) = pairs.into_iter().unzip();
        for surface in [None, Some(&surface[..])] {
            let reference = spacing(dims, &points, surface, [1.0; 3], limits);
            let propagated = reference.iter().filter(|d| (2.6..7.9).contains(*d)).count();
            assert!(propagated > 1000, "{propagated}");
            for count in [2, 3, 40] {
                let parts = run_threads(count, |comm| {
                    let range = crate::comm::partition_range(points.len() / 40, comm.rank(), count);
                    let range = range.start * 40..range.end * 40;
                    let surface = surface.map(|surface| &surface[range.clone()]);
                    let local_points = &points[range];
                    let grid = SharedGrid::new(dims, comm);
                    super::spacing(grid, local_points, surface, [1.0; 3], limits).unwrap()
                });
                assert!(parts.concat() == reference, "{count}");
            }
        }
    }
}

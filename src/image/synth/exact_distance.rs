//! Distance, direction and side of every sample, from analytic surfaces.

use super::surface::{ImplicitSurface, SurfacePoint};
use super::truth::{MAX_DISTANCE, Truth};
use crate::geometry::{dot, norm, sub};
use crate::parallel::prelude::*;

/// Samples along each side of a block for which distant surfaces are excluded together.
const BLOCK_EDGE: usize = 8;

/// Returns the truth for `surfaces` and the sides of each sample, one bit per surface. A bit is set
/// where the level of the surface is positive (and, if the surface ends at another one, on the side
/// where it exists).
pub(super) fn compute_truth(surfaces: &[ImplicitSurface], dims: [usize; 3]) -> (Truth, Vec<u32>) {
    let [nx, ny, nz] = dims;
    let count = nx * ny * nz;
    let mut distance = vec![MAX_DISTANCE; count];
    let mut direction = vec![[0f32; 3]; count];
    let mut sides = vec![0u32; count];
    let slab = nx * ny * BLOCK_EDGE;
    distance
        .par_chunks_mut(slab)
        .zip(direction.par_chunks_mut(slab))
        .zip(sides.par_chunks_mut(slab))
        .enumerate()
        .for_each(|(k, ((distance, direction), sides))| {
            let depth = distance.len() / (nx * ny);
            for y0 in (0..ny).step_by(BLOCK_EDGE) {
                for x0 in (0..nx).step_by(BLOCK_EDGE) {
                    let origin = [x0, y0, k * BLOCK_EDGE];
                    let nearby = NearbySurfaces::new(surfaces, origin);
                    for z in 0..depth {
                        for y in y0..ny.min(y0 + BLOCK_EDGE) {
                            for x in x0..nx.min(x0 + BLOCK_EDGE) {
                                let index = (z * ny + y) * nx + x;
                                let p = [x as f64, y as f64, (k * BLOCK_EDGE + z) as f64];
                                let side;
                                (distance[index], direction[index], side) =
                                    nearby.query(surfaces, p);
                                sides[index] = side;
                            }
                        }
                    }
                }
            }
        });
    (
        Truth {
            dims,
            distance,
            direction,
            is_smooth: true,
            next_feature: None,
        },
        sides,
    )
}

/// Returns `true` if surface `k` exists at a point of its level set: the point is on the valid side
/// of the surface at which it ends.
pub(super) fn exists_at(surfaces: &[ImplicitSurface], k: usize, point: [f64; 3]) -> bool {
    surfaces[k].exists_at(|i| &surfaces[i], point)
}

/// Returns, for each sample within half a sample of a surface, the distance from the closest point
/// of the surface to the next surface (at most [`MAX_DISTANCE`]), and the angle between the two
/// there in degrees. The value of other samples is ([`MAX_DISTANCE`], 90). Where the surface tapers
/// out to less than half its strength, it is (-1, 90).
pub(super) fn next_features(surfaces: &[ImplicitSurface], truth: &Truth) -> Vec<[f32; 2]> {
    let position = |i: usize| truth.index_of(i).map(|c| c as f64);
    let nearest = |p: [f64; 3], excluded: Option<usize>| {
        let mut best: Option<(f64, usize, SurfacePoint)> = None;
        for (k, surface) in surfaces.iter().enumerate() {
            let max = best.as_ref().map_or(f64::from(MAX_DISTANCE), |b| b.0);
            if Some(k) == excluded || surface.level(p).abs() >= max * surface.max_gradient {
                continue;
            }
            let foot = surface.closest_point_in_rim(p);
            let d = norm(sub(foot.point, p));
            if d < max && exists_at(surfaces, k, foot.point) {
                best = Some((d, k, foot));
            }
        }
        best
    };
    let no_next = [MAX_DISTANCE, 90.0];
    (0..truth.distance.len())
        .into_par_iter()
        .map(|i| {
            if truth.distance[i] >= 0.5 {
                return no_next;
            }
            let Some((_, k, foot)) = nearest(position(i), None) else {
                return no_next;
            };
            if surfaces[k].strength(foot.point) < 0.5 {
                return [-1.0, 90.0];
            }
            nearest(foot.point, Some(k)).map_or(no_next, |(d, _, next_foot)| {
                let cosine = dot(next_foot.normal, foot.normal).abs().min(1.0);
                [d as f32, cosine.acos().to_degrees() as f32]
            })
        })
        .collect()
}

/// The surfaces that may be within reach of a block, and the sides of all other surfaces.
struct NearbySurfaces {
    surfaces: Vec<usize>,
    sides: u32,
}

impl NearbySurfaces {
    fn new(surfaces: &[ImplicitSurface], origin: [usize; 3]) -> Self {
        let half = (BLOCK_EDGE - 1) as f64 / 2.0;
        let middle = origin.map(|o| o as f64 + half);
        let radius = f64::from(MAX_DISTANCE) + half * 3f64.sqrt();
        let mut nearby = Self {
            surfaces: Vec::new(),
            sides: 0,
        };
        for (i, surface) in surfaces.iter().enumerate() {
            let level = surface.level(middle);
            // The sides of a surface that ends must be computed for each sample.
            if level.abs() <= radius * surface.max_gradient || surface.end.is_some() {
                nearby.surfaces.push(i);
            } else if level > 0.0 {
                nearby.sides |= 1 << i;
            }
        }
        nearby
    }

    /// Returns the distance, the unit direction to the closest point, and the sides of one sample.
    fn query(&self, surfaces: &[ImplicitSurface], p: [f64; 3]) -> (f32, [f32; 3], u32) {
        let mut best = f64::from(MAX_DISTANCE);
        let mut direction = [0f64; 3];
        let mut sides = self.sides;
        for &i in &self.surfaces {
            let surface = &surfaces[i];
            let level = surface.level(p);
            let exists = |q: [f64; 3]| exists_at(surfaces, i, q);
            if level > 0.0 && exists(p) {
                sides |= 1 << i;
            }
            if level.abs() >= best * surface.max_gradient {
                continue;
            }
            let foot = surface.closest_point_in_rim(p);
            let offset = sub(foot.point, p);
            let d = norm(offset);
            // If the closest point is beyond the end, the surface at which this one ends is closer
            // than any point of this one.
            if d < best && exists(foot.point) {
                best = d;
                // The normal is exact even if the distance vanishes.
                let sign = if dot(offset, foot.normal) < 0.0 {
                    -1.0
                } else {
                    1.0
                };
                direction = foot.normal.map(|c| sign * c);
                // Beyond a rim the direction to the closest point is not the normal.
                if surface.rim.is_some() && d > 1e-6 && dot(offset, direction) < 0.999_999 * d {
                    direction = offset.map(|c| c / d);
                }
            }
        }
        (best as f32, direction.map(|c| c as f32), sides)
    }
}

/// Returns the exact distance from any position, for tests.
#[cfg(test)]
pub(super) fn distance(surfaces: &[ImplicitSurface], p: [f64; 3]) -> f64 {
    let all = NearbySurfaces {
        surfaces: (0..surfaces.len()).collect(),
        sides: 0,
    };
    f64::from(all.query(surfaces, p).0)
}

//! The image potential b(x): every feature a valley of depth 1.
//!
//! b = -exp(-s^2 / (2 sigma^2)), with s the distance to the nearest feature. Each feature point
//! stands for a disc of its sheet, so that s is the distance to the nearest *disc*: in the middle of
//! a sheet exactly the distance to its plane, wherever the points lie on it (no pimples along the
//! valley); past the sheet's end the distance to its rim, so that the valley's end is as round as its
//! walls; where sheets cross, the distance to the nearer one (depth 1, not 2).
//!
//! The bell is cut at 3 sigma and lowered by what is left there, so that b falls to exactly 0.

use super::FeaturePoint;
use crate::image::Field;
use rayon::prelude::*;

/// The bell is cut at this many sigma.
const CUT: f64 = 3.0;

/// Radius of a point's disc, in samples: half the diagonal of a column's cell, and a bit, so that the
/// discs of neighbouring columns overlap.
const DISC: f32 = 0.75;

/// Planes of samples per parallel task: fixed, so that results do not depend on the threads.
const SLAB: usize = 32;

/// The potential of feature points that are sorted by z, on a grid of `dims` samples; `rim` tells
/// for each point whether its sheet ends there.
pub fn potential(
    points: &[FeaturePoint<3>],
    rim: &[bool],
    dims: [usize; 3],
    step: [f64; 3],
    sigma: f64,
) -> Field<3> {
    let mut samples = vec![f32::INFINITY; dims.iter().product()];
    let plane = dims[0] * dims[1];
    // Points are sorted by their samples, so by z within half a sample and a bit.
    let reach = CUT * sigma + 2.5 * step[2];
    samples
        .par_chunks_mut((plane * SLAB).max(1))
        .enumerate()
        .for_each(|(slab, out)| {
            let from = slab * SLAB;
            let z = |p: &FeaturePoint<3>| f64::from(p.position[2]);
            let near = (
                from as f64 * step[2] - reach,
                (from + SLAB) as f64 * step[2] + reach,
            );
            let start = points.partition_point(|p| z(p) < near.0);
            let end = points.partition_point(|p| z(p) <= near.1);
            let mut splat = Splat {
                dims,
                step: step.map(|h| h as f32),
                from,
                out,
                sigma: sigma as f32,
            };
            for (point, &ends) in points[start..end].iter().zip(&rim[start..end]) {
                splat.add(point);
                if ends {
                    splat.add_round(point);
                }
            }
            bells(splat.out, sigma as f32);
        });
    Field {
        dims,
        step,
        samples,
    }
}

/// Squared distances to the nearest disc, in a slab of planes.
struct Splat<'a> {
    dims: [usize; 3],
    step: [f32; 3],
    from: usize,
    out: &'a mut [f32],
    sigma: f32,
}

impl Splat<'_> {
    /// Lowers the squared distances along the point's normal to those from its disc.
    fn add(&mut self, point: &FeaturePoint<3>) {
        let (p, n) = (point.position, point.normal);
        // Samples passed along each axis per lattice unit along the normal; the fastest axis leads.
        let speed: [f32; 3] = std::array::from_fn(|k| n[k] / self.step[k]);
        let axis = (1..3).fold(0, |a, k| {
            if speed[k].abs() > speed[a].abs() {
                k
            } else {
                a
            }
        });
        let centre: [f32; 3] = std::array::from_fn(|k| p[k] / self.step[k]);
        let slope = speed.map(|s| s / speed[axis]);
        let reach = CUT as f32 * self.sigma * speed[axis].abs();
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        let radius = DISC * self.step[a].max(self.step[b]);
        for j in (centre[axis] - reach).ceil() as i32..=(centre[axis] + reach).floor() as i32 {
            let along = j as f32 - centre[axis];
            let mut at = [0i32; 3];
            at[axis] = j;
            let low = [a, b].map(|k| (centre[k] + along * slope[k]).floor() as i32);
            for corner in 0..4 {
                at[a] = low[0] + (corner & 1);
                at[b] = low[1] + (corner >> 1);
                self.lower(at, point, radius);
            }
        }
    }

    /// Lowers the squared distances all round the point to those from its disc.
    fn add_round(&mut self, point: &FeaturePoint<3>) {
        let (p, n) = (point.position, point.normal);
        let [hx, hy, hz] = self.step;
        let [nx, ny, _] = self.dims;
        let radius = DISC * hx.min(hy).min(hz);
        let reach = CUT as f32 * self.sigma;
        let planes = self.out.len() / (nx * ny);
        let range = |k: usize, from: usize, n: usize| {
            let low = ((p[k] - reach) / self.step[k]).ceil() as i32 - from as i32;
            let high = ((p[k] + reach) / self.step[k]).floor() as i32 + 1 - from as i32;
            low.max(0) as usize..high.clamp(0, n as i32) as usize
        };
        let (xs, ys, zs) = (
            range(0, 0, nx),
            range(1, 0, ny),
            range(2, self.from, planes),
        );
        if xs.is_empty() {
            return;
        }
        for z in zs {
            let rz = (z + self.from) as f32 * hz - p[2];
            for y in ys.clone() {
                let ry = y as f32 * hy - p[1];
                let (along, square) = (ry * n[1] + rz * n[2], ry * ry + rz * rz);
                let start = (z * ny + y) * nx;
                let first = xs.start as f32 * hx - p[0];
                let row = &mut self.out[start + xs.start..start + xs.end];
                for (x, nearest) in row.iter_mut().enumerate() {
                    let rx = first + x as f32 * hx;
                    let s = rx * n[0] + along;
                    let across = (rx * rx + square - s * s).max(0.0).sqrt();
                    let past = (across - radius).max(0.0);
                    *nearest = nearest.min(s * s + past * past);
                }
            }
        }
    }

    /// Lowers the squared distance of one sample to that from the point's disc.
    #[inline]
    fn lower(&mut self, at: [i32; 3], point: &FeaturePoint<3>, radius: f32) {
        let (p, n) = (point.position, point.normal);
        let z = at[2] - self.from as i32;
        let inside = at[0] >= 0
            && (at[0] as usize) < self.dims[0]
            && at[1] >= 0
            && (at[1] as usize) < self.dims[1]
            && z >= 0;
        if !inside {
            return;
        }
        let i = (z as usize * self.dims[1] + at[1] as usize) * self.dims[0] + at[0] as usize;
        let Some(nearest) = self.out.get_mut(i) else {
            return;
        };
        let r: [f32; 3] = std::array::from_fn(|k| at[k] as f32 * self.step[k] - p[k]);
        let s = r[0] * n[0] + r[1] * n[1] + r[2] * n[2];
        let across = r[0] * r[0] + r[1] * r[1] + r[2] * r[2] - s * s;
        let past = (across.max(0.0).sqrt() - radius).max(0.0);
        *nearest = nearest.min(s * s + past * past);
    }
}

/// Squared distances -> valleys.
fn bells(samples: &mut [f32], sigma: f32) {
    let cut = (CUT * CUT) as f32;
    let rest = (-0.5 * cut).exp();
    for s in samples {
        let u = *s / (sigma * sigma);
        *s = if u < cut {
            -((-0.5 * u).exp() - rest) / (1.0 - rest)
        } else {
            0.0
        };
    }
}

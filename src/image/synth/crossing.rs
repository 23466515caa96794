//! Random networks of crossing faults.

use super::network::fault_normal;
use super::surface::{ImplicitSurface, Termination, Wave};
use super::{Options, Result};
use crate::Error;
use crate::error::cause;
use crate::geometry::random::Random;
use crate::geometry::{dot, hypot};
use crate::parallel::prelude::*;

/// Smallest radius of curvature, in samples.
const MIN_CURVATURE_RADIUS: f64 = 45.0;
/// Largest slope of a fault against its mean plane.
const MAX_SLOPE: f64 = 0.4;
/// Distance, in samples, below which two faults count as crossing.
const MIN_FAULT_DISTANCE: f64 = 10.0;
/// Largest cosine of the angle between the normals of crossing faults: they cross at 30 degrees or
/// more.
const MAX_NORMAL_COSINE: f64 = 0.866;
const MAX_ATTEMPTS: usize = 400;

/// Returns `options.count()` faults that are steep against the x axis. `curving` is from 0 (planes)
/// to 1. Candidates that barely touch the box, or that are close to an earlier fault at less than
/// 30 degrees, are drawn again.
///
/// # Errors
/// Returns an [`Error::Job`] if not enough faults are found.
pub(super) fn faults(options: &Options, curving: f64) -> Result<Vec<ImplicitSurface>> {
    let mut random = Random::for_purpose(options.seed, 0xfa17);
    let probe = ProbeGrid::new(options.dims);
    let mut faults: Vec<ImplicitSurface> = Vec::new();
    let mut levels: Vec<Vec<f32>> = Vec::new();
    for _ in 0..MAX_ATTEMPTS {
        let (centre, fault) = candidate(&mut random, options.dims, curving);
        let level = probe.levels(&fault);
        let crosses_well = faults
            .iter()
            .zip(&levels)
            .all(|(f, l)| probe.crosses_steeply(&fault, &level, f, l));
        if crosses_well && probe.area(&level) > probe.min_area {
            faults.push(fault);
            levels.push(level);
        }
        if faults.len() == options.count() {
            if curving > 0.0 && options.count() >= 4 {
                let side = faults[0].level(centre).signum();
                if let Some(last) = faults.last_mut() {
                    last.end = Some(Termination { surface: 0, side });
                }
            }
            return Ok(faults);
        }
    }
    Err(Error::Job(cause(
        format!("synth count {}", options.count()),
        format!(
            "only {} faults fit into {:?} samples without crossing at less than 30 degrees",
            faults.len(),
            options.dims
        ),
        "give fewer faults, larger dimensions or another seed",
    )))
}

/// Draws a fault and a point on it.
fn candidate(random: &mut Random, dims: [usize; 3], curving: f64) -> ([f64; 3], ImplicitSurface) {
    let extent = dims.map(|n| (n - 1) as f64);
    let centre: [f64; 3] = std::array::from_fn(|k| extent[k] * random.range(0.2, 0.8));
    let dip = random.range(55.0, 88.0).to_radians();
    let strike = random.range(0.0, std::f64::consts::TAU);
    let is_2d = dims[2] == 1;
    let normal = fault_normal(dip, strike, is_2d);
    let size = extent.iter().sum::<f64>() / if is_2d { 2.0 } else { 3.0 };
    let mut waves: Vec<Wave> = (0..3)
        .map(|_| {
            let k = std::f64::consts::TAU / (size * random.range(0.7, 1.6));
            let mut azimuth = random.range(0.0, std::f64::consts::TAU);
            if is_2d {
                azimuth = 0.0;
            }
            let (sin, cos) = azimuth.sin_cos();
            let phase = random.range(0.0, std::f64::consts::TAU);
            // Amplitudes are relative to the curvature that each wave contributes.
            Wave {
                amplitude: random.range(0.3, 1.0) / (k * k),
                wave: [k * cos, k * sin],
                phase,
            }
        })
        .collect();
    let norm = |w: &Wave| hypot(w.wave[0], w.wave[1]);
    let curvature: f64 = waves.iter().map(|w| w.amplitude * norm(w).powi(2)).sum();
    let slope: f64 = waves.iter().map(|w| w.amplitude * norm(w)).sum();
    let scale = curving * (1.0 / (MIN_CURVATURE_RADIUS * curvature)).min(MAX_SLOPE / slope);
    waves.iter_mut().for_each(|w| w.amplitude *= scale);
    if curving == 0.0 {
        waves.clear();
    }
    (centre, ImplicitSurface::sheet(centre, normal, waves))
}

/// A coarse grid of points at which faults are compared.
struct ProbeGrid {
    points: Vec<[f64; 3]>,
    /// Volume of the box per point.
    point_volume: f64,
    min_area: f64,
}

impl ProbeGrid {
    fn new(dims: [usize; 3]) -> Self {
        let largest = dims.iter().copied().max().unwrap_or(1);
        let stride = largest.div_ceil(40).max(2);
        let [nx, ny, nz] = dims;
        let mut points = Vec::new();
        for z in (0..nz).step_by(stride) {
            for y in (0..ny).step_by(stride) {
                points.extend(
                    (0..nx)
                        .step_by(stride)
                        .map(|x| [x as f64, y as f64, z as f64]),
                );
            }
        }
        let volume = (nx * ny * nz) as f64;
        let point_volume = volume / points.len() as f64;
        let power = if nz == 1 { 0.5 } else { 2.0 / 3.0 };
        Self {
            points,
            point_volume,
            min_area: 0.4 * volume.powf(power),
        }
    }

    fn levels(&self, fault: &ImplicitSurface) -> Vec<f32> {
        self.points
            .par_iter()
            .map(|&p| fault.level(p) as f32)
            .collect()
    }

    /// Returns the area of a fault in the box, from the volume of a layer about it.
    fn area(&self, level: &[f32]) -> f64 {
        level
            .iter()
            .filter(|l| l.abs() < MIN_FAULT_DISTANCE as f32)
            .count() as f64
            * self.point_volume
            / (2.0 * MIN_FAULT_DISTANCE)
    }

    /// Returns `true` if two faults cross at 30 degrees or more wherever both are near.
    fn crosses_steeply(
        &self,
        a: &ImplicitSurface,
        la: &[f32],
        b: &ImplicitSurface,
        lb: &[f32],
    ) -> bool {
        let max_level = MIN_FAULT_DISTANCE as f32;
        self.points
            .par_iter()
            .zip(la)
            .zip(lb)
            .all(|((&p, la), lb)| {
                la.abs() >= max_level
                    || lb.abs() >= max_level
                    || dot(a.unit_gradient(p), b.unit_gradient(p)).abs() < MAX_NORMAL_COSINE
            })
    }
}

//! Test scenes: surfaces with exact distances, noisy images of them, and the fit of points to them.

use super::FeaturePoint;
use crate::geometry::grid_index::index_at;
use crate::geometry::hypot;
use crate::image::{Geometry, Image};

/// A surface given by its exact signed distance.
pub enum ExactSurface {
    /// All x with normal . x = offset; the normal is a unit vector.
    Plane([f64; 3], f64),
    /// A circular cylinder along y: axis at (x, z), radius.
    Cylinder([f64; 2], f64),
    /// A sphere.
    Sphere([f64; 3], f64),
}

impl ExactSurface {
    /// Returns the plane with a normal of any length through a point.
    pub fn plane(normal: [f64; 3], through: [f64; 3]) -> Self {
        let length = normal.iter().map(|n| n * n).sum::<f64>().sqrt();
        let normal = normal.map(|n| n / length);
        Self::Plane(normal, (0..3).map(|k| normal[k] * through[k]).sum())
    }

    /// Returns the signed distance of a position.
    pub fn distance(&self, p: [f64; 3]) -> f64 {
        match self {
            Self::Plane(n, offset) => n[0] * p[0] + n[1] * p[1] + n[2] * p[2] - offset,
            Self::Cylinder(c, r) => hypot(p[0] - c[0], p[2] - c[1]) - r,
            Self::Sphere(c, r) => (0..3).map(|k| (p[k] - c[k]).powi(2)).sum::<f64>().sqrt() - r,
        }
    }

    /// Returns the unit normal (the gradient of the distance).
    pub fn normal(&self, p: [f64; 3]) -> [f64; 3] {
        let h = 1e-4;
        std::array::from_fn(|k| {
            let (mut a, mut b) = (p, p);
            a[k] -= h;
            b[k] += h;
            (self.distance(b) - self.distance(a)) / (2.0 * h)
        })
    }
}

/// Pseudo-random, normally distributed numbers (sums of twelve uniform ones).
pub struct Noise(u64);

impl Noise {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub fn uniform(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (self.0 >> 33) as f64 / f64::from(1u32 << 31)
    }

    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Returns an image of Gaussian ridges of height 1 and width `width` on the surfaces (the higher
/// one where they cross), plus white noise.
pub fn ridge_image(
    dims: [usize; 3],
    surfaces: &[ExactSurface],
    width: f64,
    noise: f64,
) -> Image<3> {
    let mut random = Noise::new(7);
    let value = |p: [f64; 3]| {
        let bell = |s: &ExactSurface| (-0.5 * (s.distance(p) / width).powi(2)).exp();
        surfaces.iter().map(bell).fold(0.0, f64::max)
    };
    image_of(dims, |p| value(p) + noise * random.normal())
}

/// Returns an image of Gaussian ridges as in [`ridge_image`], plus noise correlated over `length`
/// samples.
pub fn ridges_in_correlated_noise(
    dims: [usize; 3],
    surfaces: &[ExactSurface],
    width: f64,
    noise: f64,
    length: f64,
) -> Image<3> {
    let mut random = Noise::new(7);
    let white = image_of(dims, |_| random.normal());
    let mut grain = white.as_slice().to_vec();
    crate::feature::gaussian::smooth(
        dims,
        &mut grain,
        [length; 3],
        &crate::progress::CancelToken::never(),
    );
    let power = grain.iter().map(|g| f64::from(g * g)).sum::<f64>() / grain.len() as f64;
    let gain = (noise / power.sqrt()) as f32;
    let clean = ridge_image(dims, surfaces, width, 0.0);
    let sum = clean
        .as_slice()
        .iter()
        .zip(&grain)
        .map(|(c, g)| c + gain * g)
        .collect();
    Image::new(dims, sum, Geometry::default())
}

/// Returns an image of a function of the sample coordinates.
pub fn image_of<const D: usize>(dims: [usize; D], mut f: impl FnMut([f64; D]) -> f64) -> Image<D> {
    let position = |i: usize| index_at(dims, i).map(|c| c as f64);
    let samples = (0..dims.iter().product()).map(|i| f(position(i)) as f32);
    Image::new(dims, samples.collect(), Geometry::default())
}

/// Fit of detected points to the true surfaces.
#[derive(Debug)]
pub struct FitQuality {
    /// Share of true surface points within 0.5 samples of a detected point's disc.
    pub coverage: f64,
    /// Share of detected points within 1 sample of a surface.
    pub precision: f64,
    /// Root mean square distance of the points within 1 sample.
    pub rms: f64,
    /// Root mean square angle (degrees) between normals, more than 6 samples from other surfaces.
    pub angle: f64,
}

/// Compares points (lattice space = samples) with the true surfaces.
pub fn measure_fit(
    dims: [usize; 3],
    surfaces: &[ExactSurface],
    points: &[FeaturePoint<3>],
) -> FitQuality {
    let cell = |p: [f64; 3]| -> [usize; 3] {
        std::array::from_fn(|k| (p[k].round().max(0.0) as usize).min(dims[k] - 1))
    };
    let index = |[x, y, z]: [usize; 3]| (z * dims[1] + y) * dims[0] + x;
    let mut grid = vec![Vec::new(); dims.iter().product()];
    let (mut precise, mut squares, mut angles, mut measured) = (0usize, 0.0, 0.0, 0usize);
    for (i, point) in points.iter().enumerate() {
        let p = point.position.map(f64::from);
        grid[index(cell(p))].push(i);
        let mut distances: Vec<(f64, usize)> = surfaces
            .iter()
            .enumerate()
            .map(|(s, surface)| (surface.distance(p).abs(), s))
            .collect();
        distances.sort_by(|a, b| a.0.total_cmp(&b.0));
        if distances[0].0 <= 1.0 {
            precise += 1;
            squares += distances[0].0 * distances[0].0;
            if distances.len() < 2 || distances[1].0 > 6.0 {
                let n = surfaces[distances[0].1].normal(p);
                let c: f64 = (0..3).map(|k| n[k] * f64::from(point.normal[k])).sum();
                angles += c.abs().min(1.0).acos().to_degrees().powi(2);
                measured += 1;
            }
        }
    }
    let (mut total, mut covered) = (0usize, 0usize);
    for z in 0..dims[2] {
        for y in 0..dims[1] {
            for x in 0..dims[0] {
                let p = [x as f64, y as f64, z as f64];
                for surface in surfaces {
                    let s = surface.distance(p);
                    if s.abs() > 0.5 {
                        continue;
                    }
                    let n = surface.normal(p);
                    let q: [f64; 3] = std::array::from_fn(|k| p[k] - s * n[k]);
                    if (0..3).any(|k| q[k] < 0.0 || q[k] > (dims[k] - 1) as f64) {
                        continue;
                    }
                    total += 1;
                    let c = cell(q);
                    let range = |k: usize| c[k].saturating_sub(2)..=(c[k] + 2).min(dims[k] - 1);
                    let is_near = range(2).any(|cz| {
                        range(1).any(|cy| {
                            range(0).any(|cx| {
                                grid[index([cx, cy, cz])].iter().any(|&i: &usize| {
                                    let point = &points[i];
                                    let r: [f64; 3] = std::array::from_fn(|k| {
                                        q[k] - f64::from(point.position[k])
                                    });
                                    let s: f64 =
                                        (0..3).map(|k| r[k] * f64::from(point.normal[k])).sum();
                                    let t = r.iter().map(|c| c * c).sum::<f64>() - s * s;
                                    s.abs() <= 0.5 && t <= 1.0
                                })
                            })
                        })
                    });
                    covered += usize::from(is_near);
                }
            }
        }
    }
    FitQuality {
        coverage: covered as f64 / total.max(1) as f64,
        precision: precise as f64 / points.len().max(1) as f64,
        rms: (squares / precise.max(1) as f64).sqrt(),
        angle: (angles / measured.max(1) as f64).sqrt(),
    }
}

/// Returns a scene of crossing, curved and tilted surfaces.
pub fn crossing_surfaces() -> ([usize; 3], Vec<ExactSurface>) {
    (
        [120, 104, 96],
        vec![
            ExactSurface::plane([1.0, 0.2, 0.35], [40.0, 52.0, 48.0]),
            ExactSurface::plane([-0.7, 0.25, 1.0], [60.0, 52.0, 50.0]),
            ExactSurface::Cylinder([-60.0, -20.0], 150.0),
            ExactSurface::Sphere([60.0, 160.0, 40.0], 90.0),
        ],
    )
}

/// Returns an image of a function of the sample coordinates in two dimensions.
pub fn plane_image(dims: [usize; 2], mut f: impl FnMut([f64; 2]) -> f64) -> Image<2> {
    let at = |i: usize| [(i % dims[0]) as f64, (i / dims[0]) as f64];
    let samples = (0..dims[0] * dims[1]).map(|i| f(at(i)) as f32).collect();
    Image::new(dims, samples, Geometry::default())
}

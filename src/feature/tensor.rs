//! Structure tensor: the normal of layers.
//!
//! The outer products of the gradient, averaged under a Gaussian window; the eigenvector of the
//! largest eigenvalue is the direction in which the image varies most. The averaged tensor varies
//! slowly, so it is kept on a grid coarser than the image: products are averaged over cells of
//! `factor`^3 samples, smoothed there, and normals are interpolated between cell centres.

use super::gaussian::smooth;
use super::symmetric::{eigenvalues, eigenvector};
use super::volume::Volume;
use rayon::prelude::*;

/// Unit normals on a coarse grid.
pub struct Normals {
    dims: [usize; 3],
    factor: usize,
    vectors: Vec<[f32; 3]>,
}

impl Normals {
    /// Normals of a volume (already smoothed to the scale of its derivatives), averaged under a
    /// Gaussian window of width `window` samples.
    pub fn new(volume: Volume<'_>, window: f64) -> Self {
        let factor = ((window / 2.0) as usize).clamp(1, 4);
        let dims = volume.dims.map(|n| n.div_ceil(factor));
        let plane = dims[0] * dims[1];
        let mut products = vec![vec![0.0f32; plane * dims[2]]; 6];
        let mut planes: Vec<Vec<&mut [f32]>> = (0..dims[2]).map(|_| Vec::new()).collect();
        for component in &mut products {
            for (z, part) in component.chunks_mut(plane).enumerate() {
                planes[z].push(part);
            }
        }
        planes.par_iter_mut().enumerate().for_each(|(cz, parts)| {
            for z in cz * factor..((cz + 1) * factor).min(volume.dims[2]) {
                for y in 0..volume.dims[1] {
                    let row = y / factor * dims[0];
                    for x in 0..volume.dims[0] {
                        let [a, b, c] = volume.gradient([x, y, z]);
                        let cell = row + x / factor;
                        let p = [a * a, b * b, c * c, a * b, a * c, b * c];
                        for (part, p) in parts.iter_mut().zip(p) {
                            part[cell] += p;
                        }
                    }
                }
            }
        });
        // Cells on the far sides hold fewer samples; their weight is less, the direction the same.
        for component in &mut products {
            smooth(dims, component, [window / factor as f64; 3]);
        }
        let vectors = (0..plane * dims[2])
            .into_par_iter()
            .map(|i| {
                let m: [f64; 6] = std::array::from_fn(|k| f64::from(products[k][i]));
                eigenvector(&m, eigenvalues(&m)[2]).map(|c| c as f32)
            })
            .collect();
        Self {
            dims,
            factor,
            vectors,
        }
    }

    /// The normal of the cell that holds a sample.
    #[inline]
    pub fn coarse(&self, at: [usize; 3]) -> [f32; 3] {
        let [x, y, z] = at.map(|i| i / self.factor);
        self.vectors[(z * self.dims[1] + y) * self.dims[0] + x]
    }

    /// The normal at a position in samples, interpolated between cell centres.
    pub fn at(&self, position: [f32; 3]) -> [f32; 3] {
        let f = self.factor as f32;
        let (mut low, mut t) = ([0usize; 3], [0.0f32; 3]);
        for k in 0..3 {
            let u = ((position[k] - 0.5 * (f - 1.0)) / f).clamp(0.0, (self.dims[k] - 1) as f32);
            low[k] = (u as usize).min(self.dims[k].saturating_sub(2));
            t[k] = u - low[k] as f32;
        }
        let mut sum = [0.0f32; 3];
        for corner in 0..8usize {
            let mut weight = 1.0;
            let [x, y, z]: [usize; 3] = std::array::from_fn(|k| {
                let far = corner >> k & 1;
                weight *= if far == 1 { t[k] } else { 1.0 - t[k] };
                (low[k] + far).min(self.dims[k] - 1)
            });
            let v = self.vectors[(z * self.dims[1] + y) * self.dims[0] + x];
            // A normal has no sign: add each on the side of the sum so far.
            let side = v[0] * sum[0] + v[1] * sum[1] + v[2] * sum[2];
            let weight = if side < 0.0 { -weight } else { weight };
            for k in 0..3 {
                sum[k] += weight * v[k];
            }
        }
        let length = (sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]).sqrt();
        if length > 1e-6 {
            sum.map(|c| c / length)
        } else {
            self.coarse(low.map(|i| i * self.factor))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::image_of;

    #[test]
    fn normals_of_plane_waves_over_all_dips() {
        let dims = [40, 36, 44];
        let mut worst = 0.0f64;
        for dip in (0..=90).step_by(15) {
            for azimuth in (0..360).step_by(45) {
                let (dip, azimuth) = (f64::from(dip).to_radians(), f64::from(azimuth).to_radians());
                let n = [
                    dip.cos(),
                    dip.sin() * azimuth.cos(),
                    dip.sin() * azimuth.sin(),
                ];
                let image = image_of(dims, |p| {
                    (0.5 * (n[0] * p[0] + n[1] * p[1] + n[2] * p[2])).sin()
                });
                let mut samples = image.as_slice().to_vec();
                smooth(dims, &mut samples, [1.0; 3]);
                let normals = Normals::new(
                    Volume {
                        dims,
                        samples: &samples,
                    },
                    4.0,
                );
                for p in [[20.0, 18.0, 22.0], [19.3, 17.6, 21.2], [24.0, 15.0, 20.5]] {
                    let w = normals.at(p);
                    let c: f64 = (0..3).map(|k| f64::from(w[k]) * n[k]).sum();
                    worst = worst.max(c.abs().min(1.0).acos().to_degrees());
                }
            }
        }
        assert!(worst < 1.0, "{worst}");
    }
}

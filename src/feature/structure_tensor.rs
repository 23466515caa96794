//! Structure tensor: normals of layers.
//!
//! The tensor is the outer product of the gradient with itself, averaged under a Gaussian window.
//! The eigenvector of the largest eigenvalue is the direction in which the image varies most. The
//! averaged tensor varies slowly, so it is stored on a grid coarser than the image: products are
//! summed over cells of `cell_size`^3 samples and smoothed there, and normals are interpolated
//! between cell centres.

use super::chaos::ChaoticZones;
use super::gaussian::smooth;
use super::windows::{LayerWindow, Samples, layer_len};
use crate::error::Result;
use crate::geometry::eigen::{eigenvalues, eigenvector};
use crate::geometry::grid_index::offset_of;
use crate::geometry::{add_scaled, dot, norm};
use crate::image::LiveMask;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Unit normals on a coarse grid.
pub struct NormalField<const D: usize> {
    dims: [usize; D],
    cell_size: usize,
    vectors: Vec<[f32; D]>,
    chaotic_zones: Option<ChaoticZones<D>>,
}

/// Root mean square of an image's samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RootMeanSquares {
    pub smoothed: f32,
    pub unsmoothed: f32,
}

impl<const D: usize> NormalField<D> {
    /// Computes the normals of an image (smoothed to the scale of its derivatives) under a Gaussian
    /// window of width `window` samples, and the root mean square of its samples, smoothed and
    /// unsmoothed. Samples that are not `live` are left out of all.
    ///
    /// # Errors
    /// Returns the errors of reading layers.
    pub fn new(
        samples: &Samples<'_, D>,
        window: f64,
        live: Option<&LiveMask<D>>,
        cancel: &CancelToken<'_>,
    ) -> Result<(Self, RootMeanSquares)> {
        // Windows of layers begin at the edge of a cell.
        let factor = match window {
            8.0.. => 4,
            4.0.. => 2,
            _ => 1,
        };
        let dims = samples.dims().map(|n| n.div_ceil(factor));
        let mut products = vec![Vec::new(); D * (D + 1) / 2];
        let mut sums = [0.0; 2];
        let mut measure = |window: &LayerWindow<'_, D>| {
            let squares = [window.smoothed, window.raw].map(|stack| -> Vec<f64> {
                let layers = stack.layers(&window.interior.layers);
                let layers = layers.par_chunks(layer_len(window.dims).max(1)).enumerate();
                let squares = layers.map(|(number, layer)| match live {
                    None => square_sum(layer),
                    Some(live) => {
                        live_square_sum(layer, window.interior.layers.start + number, live)
                    }
                });
                squares.collect()
            });
            (squares, interior_products(window, factor, live, cancel))
        };
        let mut take = |(squares, window_products): ([Vec<f64>; 2], Vec<Vec<f32>>)| {
            for (sum, squares) in sums.iter_mut().zip(&squares) {
                *sum = squares.iter().fold(*sum, |sum, square| sum + square);
            }
            for (component, part) in products.iter_mut().zip(window_products) {
                component.extend(part);
            }
        };
        samples.for_each_window(1, None, &|_| 1, cancel, &mut measure, &mut take)?;
        // Cells are missing only if the search was cancelled.
        for component in &mut products {
            component.resize(dims.iter().product(), 0.0);
        }
        let count: usize = samples.dims().iter().product();
        let count = match live {
            None => count.max(1) as f64,
            Some(live) => (count as f64 * (1.0 - live.gap_shares().iter().sum::<f64>())).max(1.0),
        };
        let [smoothed, unsmoothed] = sums.map(|sum| (sum / count).sqrt() as f32);
        Ok((
            Self::from_products(dims, factor, products, window, cancel),
            RootMeanSquares {
                smoothed,
                unsmoothed,
            },
        ))
    }

    /// Computes the normals from the products of the gradient's components, summed over cells.
    fn from_products(
        dims: [usize; D],
        cell_size: usize,
        products: Vec<Vec<f32>>,
        window: f64,
        cancel: &CancelToken<'_>,
    ) -> Self {
        let chaotic_zones = ChaoticZones::find(dims, cell_size, &products, cancel);
        // Cells on the far sides hold fewer samples: their weight is smaller, their direction the
        // same.
        let products: Vec<Vec<f32>> = products
            .into_iter()
            .map(|mut component| {
                smooth(dims, &mut component, [window / cell_size as f64; D], cancel);
                component
            })
            .collect();
        let vectors = (0..dims.iter().product())
            .into_par_iter()
            .map(|i| {
                let mut m = [[0.0; D]; D];
                for (number, (k, l)) in upper_indices::<D>().enumerate() {
                    m[k][l] = f64::from(products[number][i]);
                    m[l][k] = m[k][l];
                }
                eigenvector(&m, eigenvalues(&m)[D - 1]).map(|c| c as f32)
            })
            .collect();
        Self {
            dims,
            cell_size,
            vectors,
            chaotic_zones,
        }
    }

    /// Returns the chaotic zones, if there are any.
    pub fn chaotic_zones(&self) -> Option<&ChaoticZones<D>> {
        self.chaotic_zones.as_ref()
    }

    /// Returns the axis to which most normals are nearest.
    pub fn main_axis(&self) -> usize {
        let total = |k: usize| -> f64 { self.vectors.iter().map(|n| f64::from(n[k].abs())).sum() };
        let totals: [f64; D] = std::array::from_fn(total);
        (1..D).fold(0, |a, k| if totals[k] > totals[a] { k } else { a })
    }

    /// Returns the normal of the cell that contains a sample.
    #[inline]
    pub fn cell_normal(&self, at: [usize; D]) -> [f32; D] {
        self.vectors[offset_of(self.dims, at.map(|i| i / self.cell_size))]
    }

    /// Returns the normal at a position in samples, interpolated between cell centres.
    pub fn normal_at(&self, position: [f32; D]) -> [f32; D] {
        let f = self.cell_size as f32;
        let (mut low, mut t) = ([0usize; D], [0.0f32; D]);
        for k in 0..D {
            let u = ((position[k] - 0.5 * (f - 1.0)) / f).clamp(0.0, (self.dims[k] - 1) as f32);
            low[k] = (u as usize).min(self.dims[k].saturating_sub(2));
            t[k] = u - low[k] as f32;
        }
        let mut sum = [0.0f32; D];
        for corner in 0..1usize << D {
            let mut weight = 1.0;
            let at = std::array::from_fn(|k| {
                let upper = corner >> k & 1;
                weight *= if upper == 1 { t[k] } else { 1.0 - t[k] };
                (low[k] + upper).min(self.dims[k] - 1)
            });
            let v = self.vectors[offset_of(self.dims, at)];
            // A normal has no sign: each one is added on the side of the sum so far.
            let weight = if dot(v, sum) < 0.0 { -weight } else { weight };
            sum = add_scaled(sum, weight, v);
        }
        let length = norm(sum);
        if length > 1e-6 {
            sum.map(|c| c / length)
        } else {
            self.vectors[offset_of(self.dims, low)]
        }
    }
}

/// Returns the index pairs of the upper half of a symmetric matrix.
fn upper_indices<const D: usize>() -> impl Iterator<Item = (usize, usize)> {
    (0..D).flat_map(|k| (k..D).map(move |l| (k, l)))
}

/// Returns the sum of the squares of samples.
fn square_sum(samples: &[f32]) -> f64 {
    samples.iter().map(|s| f64::from(s * s)).sum()
}

/// Returns the sum of the squares of the live samples of a layer.
fn live_square_sum<const D: usize>(samples: &[f32], layer: usize, live: &LiveMask<D>) -> f64 {
    let is_live = live.layer_mask(layer);
    let squares = samples.iter().enumerate().filter(|(i, _)| is_live(*i));
    squares.map(|(_, s)| f64::from(s * s)).sum()
}

/// Returns the products of the gradient's components (upper half), summed over the cells of
/// `factor`^D samples in the interior of a window. Samples that are not `live` are left out.
fn interior_products<const D: usize>(
    window: &LayerWindow<'_, D>,
    factor: usize,
    live: Option<&LiveMask<D>>,
    cancel: &CancelToken<'_>,
) -> Vec<Vec<f32>> {
    let stack = window.smoothed;
    let volume = stack.volume;
    let mut dims = window.dims.map(|n| n.div_ceil(factor));
    dims[D - 1] = window.interior.layers.len().div_ceil(factor);
    let count: usize = dims.iter().product();
    let mut products = vec![vec![0.0f32; count]; D * (D + 1) / 2];
    // One task per layer of cells along the last axis.
    let cells = (count / dims[D - 1].max(1)).max(1);
    let mut layers: Vec<Vec<&mut [f32]>> = (0..dims[D - 1]).map(|_| Vec::new()).collect();
    for component in &mut products {
        for (parts, part) in layers.iter_mut().zip(component.chunks_mut(cells)) {
            parts.push(part);
        }
    }
    layers
        .par_iter_mut()
        .enumerate()
        .for_each(|(number, parts)| {
            let first = window.interior.layers.start + number * factor;
            let mut begin = [0; D];
            begin[D - 1] = first;
            let start = volume.index(stack.to_stack(begin));
            let rows =
                (window.interior.layers.end.min(first + factor) - first) * layer_len(window.dims);
            for start in (start..start + rows).step_by(volume.dims[0]) {
                if cancel.is_cancelled() {
                    return;
                }
                let mut at = volume.coordinates(start);
                let mut cell = at.map(|i| i / factor);
                cell[D - 1] = 0;
                let row = offset_of(dims, cell);
                for x in 0..volume.dims[0] {
                    at[0] = x;
                    if live.is_some_and(|live| !live.is_live(stack.to_volume(at))) {
                        continue;
                    }
                    let gradient = volume.gradient(at);
                    for (part, (k, l)) in parts.iter_mut().zip(upper_indices::<D>()) {
                        part[row + x / factor] += gradient[k] * gradient[l];
                    }
                }
            }
        });
    products
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
                let mut samples = Samples::in_memory(dims, image.as_slice());
                samples.smooth(1.0, &CancelToken::never());
                let (normals, rms) =
                    NormalField::new(&samples, 4.0, None, &CancelToken::never()).unwrap();
                assert!((0.55..0.75).contains(&rms.smoothed), "{rms:?}");
                for p in [[20.0, 18.0, 22.0], [19.3, 17.6, 21.2], [24.0, 15.0, 20.5]] {
                    let w = normals.normal_at(p);
                    let c: f64 = (0..3).map(|k| f64::from(w[k]) * n[k]).sum();
                    worst = worst.max(c.abs().min(1.0).acos().to_degrees());
                }
            }
        }
        assert!(worst < 1.0, "{worst}");
    }

    #[test]
    fn normals_of_plane_waves_in_a_plane_image() {
        let dims = [44, 40];
        for dip in (0..180).step_by(5) {
            let (sin, cos) = f64::from(dip).to_radians().sin_cos();
            let wave = |i: usize| (0.5 * (cos * (i % 44) as f64 + sin * (i / 44) as f64)).sin();
            let mut samples: Vec<f32> = (0..44 * 40).map(|i| wave(i) as f32).collect();
            smooth(dims, &mut samples, [1.0; 2], &CancelToken::never());
            let samples = Samples::in_memory(dims, samples);
            let (normals, _) =
                NormalField::new(&samples, 4.0, None, &CancelToken::never()).unwrap();
            let normal = normals.normal_at([21.3, 19.8]);
            let c = (cos * f64::from(normal[0]) + sin * f64::from(normal[1])).abs();
            assert!(c.min(1.0).acos().to_degrees() < 1.0, "{dip} {normal:?}");
        }
    }
}

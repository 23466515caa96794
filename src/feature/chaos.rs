//! Chaotic zones of a seismic volume: salt, gas chimneys, and other bodies without layers.
//!
//! In layers, the gradient has one direction, which a structure tensor shows. In a body without
//! layers it has every direction. Tensors of small cells, each divided by its trace, are averaged
//! under a Gaussian window, so that strong reflectors beside a body do not outshine it. The largest
//! eigenvalue of the average, as a share of the trace, is the *planarity*: near 1 in layers, near 1/3 in
//! chaos. Cells are chaotic if their planarity is low, in a zone that is thicker than crossings of faults
//! are. What is low depends on the planarity of most of the image, which noise lowers everywhere; in an
//! image of noise alone, nothing is chaotic.

use super::gaussian::smooth;
use crate::geometry::eigen::eigenvalues;
use crate::geometry::grid_index::{index_at, offset_of};
use crate::geometry::statistics::upper_median;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Edge (samples) of the cells.
const CELL_SIZE: usize = 4;

/// Width (cells) of the window in which tensors are averaged.
const WINDOW: f64 = 1.0;

/// Planarity of noise in that window.
const NOISE_PLANARITY: f32 = 0.36;

/// Smallest planarity of most of an image with layers.
const MIN_MEDIAN_PLANARITY: f32 = 0.55;

/// Planarity, between that of noise and that of most of the image, below which a zone is chaotic.
const CORE_LEVEL: f32 = 0.28;

/// Planarity, on the same scale, below which the rim of a zone belongs to it.
const RIM_LEVEL: f32 = 0.6;

/// Radius (cells) of the ball that must fit into a zone, and of its growth into its rim.
const RADIUS: isize = 2;

/// The chaotic zones of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct ChaoticZones<const D: usize> {
    dims: [usize; D],
    is_chaotic: Vec<bool>,
    /// Share of the image.
    pub share: f64,
}

impl<const D: usize> ChaoticZones<D> {
    /// Finds the chaotic zones from the products of the gradient's components (upper half), summed over
    /// cells of `cell_size` samples, a divisor of [`CELL_SIZE`]. Returns `None` if there is none, and for
    /// images in the plane, in which a window holds too few gradients.
    pub fn find(
        dims: [usize; D],
        cell_size: usize,
        products: &[Vec<f32>],
        cancel: &CancelToken<'_>,
    ) -> Option<Self> {
        if D != 3 {
            return None;
        }
        let factor = CELL_SIZE / cell_size;
        let coarse_dims = dims.map(|n| n.div_ceil(factor));
        let count: usize = coarse_dims.iter().product();
        let mut tensors: Vec<Vec<f32>> = (products.par_iter())
            .map(|component| coarsened(dims, component, factor, coarse_dims))
            .collect();
        // The diagonal of the upper half.
        let diagonal: Vec<usize> = (0..D).map(|k| k * D - k * (k + 1) / 2 + k).collect();
        for i in 0..count {
            let trace: f32 = diagonal.iter().map(|&k| tensors[k][i]).sum();
            let scale = if trace > 0.0 { 1.0 / trace } else { 0.0 };
            tensors.iter_mut().for_each(|t| t[i] *= scale);
        }
        for component in &mut tensors {
            smooth(coarse_dims, component, [WINDOW; D], cancel);
        }
        let planarity = |i: usize| {
            let mut m = [[0.0; D]; D];
            let mut number = 0;
            for k in 0..D {
                for l in k..D {
                    m[k][l] = f64::from(tensors[number][i]);
                    m[l][k] = m[k][l];
                    number += 1;
                }
            }
            let trace: f64 = (0..D).map(|k| m[k][k]).sum();
            if trace > 0.0 {
                (eigenvalues(&m)[D - 1] / trace) as f32
            } else {
                1.0
            }
        };
        let planarity: Vec<f32> = (0..count).into_par_iter().map(planarity).collect();
        Self::from_planarity(coarse_dims, &planarity)
    }

    fn from_planarity(dims: [usize; D], planarity: &[f32]) -> Option<Self> {
        let median = upper_median(&mut planarity.to_vec())?;
        if median < MIN_MEDIAN_PLANARITY {
            return None;
        }
        let level = |share: f32| NOISE_PLANARITY + share * (median - NOISE_PLANARITY);
        let is_below = |level: f32| planarity.iter().map(|&p| p < level).collect::<Vec<bool>>();
        let (core, rim) = (is_below(level(CORE_LEVEL)), is_below(level(RIM_LEVEL)));
        if !core.contains(&true) {
            return None;
        }
        let ball = ball_offsets::<D>();
        // Cells around which a ball is chaotic, then these balls, then their rims.
        let inner = mapped(dims, &core, |at| {
            neighbours(dims, at, &ball).all(|i| core[i])
        });
        let grow = |zone: &[bool], within: &[bool]| {
            mapped(dims, within, |at| {
                neighbours(dims, at, &ball).any(|i| zone[i])
            })
        };
        let is_chaotic = grow(&grow(&inner, &core), &rim);
        let count = is_chaotic.iter().filter(|is_chaotic| **is_chaotic).count();
        let share = count as f64 / is_chaotic.len() as f64;
        (count > 0).then_some(Self {
            dims,
            is_chaotic,
            share,
        })
    }

    /// Returns `true` if a position in samples lies in a chaotic zone.
    pub fn contains(&self, position: [f32; D]) -> bool {
        let cell = std::array::from_fn(|k| {
            ((position[k].max(0.0) + 0.5) as usize / CELL_SIZE).min(self.dims[k] - 1)
        });
        self.is_chaotic[offset_of(self.dims, cell)]
    }
}

/// Returns sums over cubes of `factor` cells.
fn coarsened<const D: usize>(
    dims: [usize; D],
    values: &[f32],
    factor: usize,
    coarse_dims: [usize; D],
) -> Vec<f32> {
    if factor == 1 {
        return values.to_vec();
    }
    let mut sums = vec![0.0; coarse_dims.iter().product()];
    for (i, value) in values.iter().enumerate() {
        let cell = index_at(dims, i).map(|i| i / factor);
        sums[offset_of(coarse_dims, cell)] += value;
    }
    sums
}

/// Returns the offsets of the cells in a ball of [`RADIUS`].
fn ball_offsets<const D: usize>() -> Vec<[isize; D]> {
    let edge = 2 * RADIUS as usize + 1;
    (0..edge.pow(D as u32))
        .map(|i| index_at([edge; D], i).map(|i| i as isize - RADIUS))
        .filter(|offset| offset.iter().map(|c| c * c).sum::<isize>() <= RADIUS * RADIUS)
        .collect()
}

/// Returns the cells at these offsets from a cell that lie in the image.
fn neighbours<const D: usize>(
    dims: [usize; D],
    at: [usize; D],
    offsets: &[[isize; D]],
) -> impl Iterator<Item = usize> {
    offsets.iter().filter_map(move |offset| {
        let mut cell = at;
        for k in 0..D {
            cell[k] = at[k]
                .checked_add_signed(offset[k])
                .filter(|&i| i < dims[k])?;
        }
        Some(offset_of(dims, cell))
    })
}

/// Returns for each cell that is `true` in `within` the value of `f`, and `false` for all others.
fn mapped<const D: usize>(
    dims: [usize; D],
    within: &[bool],
    f: impl Fn([usize; D]) -> bool + Sync,
) -> Vec<bool> {
    (0..within.len())
        .into_par_iter()
        .map(|i| within[i] && f(index_at(dims, i)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::Noise;
    use crate::feature::structure_tensor::NormalField;
    use crate::feature::windows::Samples;
    use crate::feature::{DetectionOptions, FeatureKind, detect};
    use crate::image::{Geometry, Image};

    const DIMS: [usize; 3] = [72, 72, 72];

    /// Returns layers across x with a fault, and noise in a ball of this radius.
    fn layers_with_body(radius: f64, noise: f64) -> Image<3> {
        let mut random = Noise::new(5);
        let white: Vec<f32> = (0..DIMS.iter().product())
            .map(|_| random.normal() as f32)
            .collect();
        let mut smooth_noise = white.clone();
        smooth(DIMS, &mut smooth_noise, [1.3; 3], &CancelToken::never());
        let samples = (0..white.len()).map(|i| {
            let p = index_at(DIMS, i).map(|c| c as f64);
            let distance = p.map(|c| (c - 36.0).powi(2)).iter().sum::<f64>().sqrt();
            if distance < radius {
                return 8.0 * smooth_noise[i];
            }
            let throw = if p[1] > 58.0 { 5.0 } else { 0.0 };
            let depth = p[0] + 0.1 * p[2] + throw;
            let waves = [(0.52, 1.0), (0.71, 0.8), (0.33, 0.7)];
            let signal: f64 = waves.iter().map(|(k, a)| a * (k * depth).sin()).sum();
            (signal + noise * f64::from(white[i])) as f32
        });
        Image::new(DIMS, samples.collect(), Geometry::default())
    }

    /// Returns the chaotic zones of an image, as the detector of faults finds them.
    fn zones(image: &Image<3>) -> Option<ChaoticZones<3>> {
        let mut samples = Samples::in_memory(DIMS, image.as_slice());
        samples.smooth(1.0, &CancelToken::never());
        let (normals, _) = NormalField::new(&samples, 12.0, None, &CancelToken::never()).unwrap();
        normals.chaotic_zones().cloned()
    }

    #[test]
    fn a_body_without_layers_is_chaotic() {
        let zones = zones(&layers_with_body(18.0, 0.2)).unwrap();
        // The ball has 6.5 % of the volume.
        assert!((0.045..0.1).contains(&zones.share), "{}", zones.share);
        for (y, is_inside) in [(36.0, true), (24.0, true), (6.0, false), (64.0, false)] {
            assert_eq!(zones.contains([36.0, y, 36.0]), is_inside, "{y}");
        }
    }

    #[test]
    fn layers_faults_and_noise_are_not_chaotic() {
        for (radius, noise) in [(0.0, 0.2), (0.0, 0.8), (100.0, 0.0)] {
            let zones = zones(&layers_with_body(radius, noise));
            assert_eq!(zones, None, "{radius} {noise}");
        }
    }

    #[test]
    fn horizons_are_not_searched_for_in_a_body_without_layers() {
        let image = layers_with_body(18.0, 0.2);
        let run = |keep_chaos| {
            let options = DetectionOptions {
                keep_chaos,
                ..DetectionOptions::with_kind(FeatureKind::Horizons, 4.0)
            };
            detect(&image, &options).unwrap()
        };
        let (with, without) = (run(true), run(false));
        assert!(without.points.len() < with.points.len());
        assert!(without.outcomes[0].chaotic.unwrap() > 0.04);
        assert!(without.notes.iter().any(|note| note.contains("chaotic")));
        assert_eq!(with.outcomes[0].chaotic, None);
    }
}

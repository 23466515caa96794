//! Horizons: crests and troughs of seismic amplitude.
//!
//! Along a layer the amplitude hardly changes, so the crest of a layer is its extremum along any
//! direction across it. Along the image axis nearest to the layer's normal (structure tensor) each
//! column of samples meets it once, at the top of the parabola through three samples.

use super::crossing::{Candidate, dominant_axes};
use super::tensor::Normals;
use super::volume::Volume;
use rayon::prelude::*;

/// Crests and troughs of at least `low` in amplitude, in the order of samples.
pub fn horizons<const D: usize>(
    volume: Volume<'_, D>,
    normals: &Normals<D>,
    low: f32,
) -> Vec<Candidate<D>> {
    let strides = volume.strides();
    volume.by_rows(|first, (): &mut (), found| {
        let start = volume.index(first);
        for x in 0..volume.dims[0] {
            let i = start + x;
            let here = volume.samples[i].abs();
            if here < low {
                continue;
            }
            let mut at = first;
            at[0] = x;
            let sign = volume.samples[i].signum();
            for axis in dominant_axes(normals.coarse(at).map(f64::from)) {
                if at[axis] == 0 || at[axis] + 1 >= volume.dims[axis] {
                    continue;
                }
                let before = sign * volume.samples[i - strides[axis]];
                let after = sign * volume.samples[i + strides[axis]];
                // One of two equal samples: the first.
                if before >= here || after > here {
                    continue;
                }
                let offset = 0.5 * (before - after) / (before + after - 2.0 * here);
                let mut position = at.map(|i| i as f32);
                position[axis] += offset;
                found.push(Candidate {
                    voxel: i as u32,
                    axis: axis as u8,
                    position,
                    normal: normals.at(position),
                    strength: here - 0.25 * (before - after) * offset,
                });
            }
        }
    })
}

/// Samples whose squares are summed at once.
const CHUNK: usize = 1 << 16;

/// Root mean square of samples, summed chunk by chunk.
pub fn root_mean_square(samples: &[f32]) -> f32 {
    let sums: Vec<f64> = samples
        .par_chunks(CHUNK)
        .map(|chunk| chunk.iter().map(|s| f64::from(s * s)).sum())
        .collect();
    (sums.iter().sum::<f64>() / samples.len().max(1) as f64).sqrt() as f32
}

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
pub fn horizons(volume: Volume<'_>, normals: &Normals, low: f32) -> Vec<Candidate> {
    let [nx, ny, nz] = volume.dims;
    let strides = [1, nx, nx * ny];
    let planes: Vec<Vec<Candidate>> = (0..nz)
        .into_par_iter()
        .map(|z| {
            let mut found = Vec::new();
            for y in 0..ny {
                for x in 0..nx {
                    let at = [x, y, z];
                    let i = volume.index(at);
                    let here = volume.samples[i].abs();
                    if here < low {
                        continue;
                    }
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
                        let normal = normals.at(position);
                        let strength = here - 0.25 * (before - after) * offset;
                        found.push(Candidate {
                            voxel: i as u32,
                            axis: axis as u8,
                            position,
                            normal,
                            strength,
                        });
                    }
                }
            }
            found
        })
        .collect();
    planes.concat()
}

/// Root mean square of a volume's samples, summed plane by plane.
pub fn root_mean_square(volume: Volume<'_>) -> f32 {
    let plane = (volume.dims[0] * volume.dims[1]).max(1);
    let sums: Vec<f64> = volume
        .samples
        .par_chunks(plane)
        .map(|p| p.iter().map(|s| f64::from(s * s)).sum())
        .collect();
    (sums.iter().sum::<f64>() / volume.samples.len().max(1) as f64).sqrt() as f32
}

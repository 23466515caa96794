//! Smooth noise from random numbers that depend on seed and position only.

use crate::parallel::prelude::*;

use crate::geometry::random::splitmix64;

/// Returns a nearly Gaussian number of mean 0 and variance 1: the scaled sum of four uniform 16-bit
/// numbers.
fn gaussian(bits: u64) -> f32 {
    let sum = (bits & 0xffff) + (bits >> 16 & 0xffff) + (bits >> 32 & 0xffff) + (bits >> 48);
    // Each of the four has mean 65535/2 and variance (2^32 - 1)/12.
    (sum as f32 - 131_070.0) * (3f32.sqrt() / 65_536.0)
}

/// Adds noise of standard deviation `rms`. It is correlated over about one sample (a 1-2-1 filter
/// along each axis), as the noise of processed images is.
pub(super) fn add_noise(samples: &mut [f32], dims: [usize; 3], seed: u64, rms: f64) {
    if rms == 0.0 {
        return;
    }
    let [nx, ny, _] = dims;
    let key = splitmix64(seed ^ 0x006e_6f69_7365);
    let (wx, wy) = (nx + 2, ny + 2);
    // The filter 1/4 1/2 1/4 reduces variance 1 to 6/16 along each axis.
    let gain = (rms * (16f64 / 6.0).powf(1.5) / 64.0) as f32;
    samples.par_chunks_mut(nx * ny).enumerate().for_each_init(
        || vec![0f32; wx * wy],
        |raw, (z, plane)| {
            for (i, raw) in raw.iter_mut().enumerate() {
                let random_at =
                    |z: usize| gaussian(splitmix64(key ^ ((z as u64) << 40 | i as u64)));
                *raw = random_at(z) + 2.0 * random_at(z + 1) + random_at(z + 2);
            }
            for (y, row) in plane.chunks_mut(nx).enumerate() {
                let column = |x: usize| {
                    raw[y * wx + x] + 2.0 * raw[(y + 1) * wx + x] + raw[(y + 2) * wx + x]
                };
                for (x, sample) in row.iter_mut().enumerate() {
                    *sample += gain * (column(x) + 2.0 * column(x + 1) + column(x + 2));
                }
            }
        },
    );
}

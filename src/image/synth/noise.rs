//! Random numbers that are a function of seed and position only, and smooth noise made of them.

use rayon::prelude::*;

/// One step of SplitMix64 (Steele, Lea and Flood 2014): a bijection that scrambles 64 bits.
pub(super) fn scramble(mut bits: u64) -> u64 {
    bits = bits.wrapping_add(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}

/// A reproducible sequence of random numbers.
pub(super) struct Random(u64);

impl Random {
    /// A sequence of its own for each seed and purpose.
    pub(super) fn new(seed: u64, purpose: u64) -> Self {
        Self(scramble(seed ^ scramble(purpose)))
    }

    /// The next number, uniform in [low, high).
    pub(super) fn range(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let unit = (scramble(self.0) >> 11) as f64 / (1u64 << 53) as f64;
        low + (high - low) * unit
    }
}

/// Nearly Gaussian, mean 0 and variance 1: the sum of four uniform 16-bit numbers.
fn normal(bits: u64) -> f32 {
    let sum = (bits & 0xffff) + (bits >> 16 & 0xffff) + (bits >> 32 & 0xffff) + (bits >> 48);
    // Each of the four has mean 65535/2 and variance (2^32 - 1)/12.
    (sum as f32 - 131_070.0) * (3f32.sqrt() / 65_536.0)
}

/// Adds noise of standard deviation `rms`, correlated over about one sample (a 1-2-1 filter along
/// each axis), as the noise of processed images is.
pub(super) fn add(samples: &mut [f32], dims: [usize; 3], seed: u64, rms: f64) {
    if rms == 0.0 {
        return;
    }
    let [nx, ny, _] = dims;
    let key = scramble(seed ^ 0x006e_6f69_7365);
    let (wx, wy) = (nx + 2, ny + 2);
    // The filter 1/4 1/2 1/4 turns variance 1 into 6/16, once an axis.
    let gain = (rms * (16f64 / 6.0).powf(1.5) / 64.0) as f32;
    samples.par_chunks_mut(nx * ny).enumerate().for_each_init(
        || vec![0f32; wx * wy],
        |raw, (z, plane)| {
            for (i, raw) in raw.iter_mut().enumerate() {
                let at = |z: usize| normal(scramble(key ^ ((z as u64) << 40 | i as u64)));
                *raw = at(z) + 2.0 * at(z + 1) + at(z + 2);
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

//! Random numbers that depend only on seed and counter: the same on every machine and for any
//! number of threads.
//!
//! All numbers come from SplitMix64 (Steele, Lea & Flood 2014): a counter advances in steps of the
//! golden ratio, and its bits are mixed.

/// Step of the counter: 2^64 over the golden ratio.
const COUNTER_STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// Mixes 64 bits by a bijection.
fn mix(mut bits: u64) -> u64 {
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}

/// Converts 64 bits to a number in [0, 1).
fn to_unit_interval(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1u64 << 53) as f64
}

/// Returns 64 random bits that follow from a seed: one step of the generator.
pub fn splitmix64(seed: u64) -> u64 {
    mix(seed.wrapping_add(COUNTER_STEP))
}

/// Returns number `count` of the sequence of `key`, in [0, 1). Keys may be small successive
/// integers, because they are mixed first.
pub fn uniform(key: u64, count: u64) -> f64 {
    to_unit_interval(mix(mix(key).wrapping_add(count.wrapping_mul(COUNTER_STEP))))
}

/// Returns number `count` of the sequence of `key`, in [-1, 1).
pub fn uniform_signed(key: u64, count: u64) -> f64 {
    2.0 * uniform(key, count) - 1.0
}

/// A sequence of random numbers.
#[derive(Debug, Clone)]
pub struct Random(u64);

impl Random {
    /// Creates the sequence of a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Creates a sequence that is different for each pair of seed and purpose.
    pub fn for_purpose(seed: u64, purpose: u64) -> Self {
        Self(splitmix64(seed ^ splitmix64(purpose)).wrapping_add(COUNTER_STEP))
    }

    /// Returns the next number, in [0, 1).
    pub fn draw(&mut self) -> f64 {
        let number = to_unit_interval(splitmix64(self.0));
        self.0 = self.0.wrapping_add(COUNTER_STEP);
        number
    }

    /// Returns the next number, in [low, high).
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.draw()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_uniform_bounded_and_not_correlated() {
        let n = 100_000;
        let mut random = Random::new(5);
        for numbers in [
            (0..n).map(|k| uniform_signed(5, k)).collect::<Vec<f64>>(),
            (0..n).map(|_| random.range(-1.0, 1.0)).collect(),
        ] {
            let mean = numbers.iter().sum::<f64>() / n as f64;
            let square = numbers.iter().map(|x| x * x).sum::<f64>() / n as f64;
            let next = numbers.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / n as f64;
            assert!(numbers.iter().all(|x| (-1.0..1.0).contains(x)));
            assert!(mean.abs() < 0.01 && (square - 1.0 / 3.0).abs() < 0.01 && next.abs() < 0.01);
        }
    }

    #[test]
    fn bits_are_those_of_splitmix64() {
        // The first three outputs of the published program for seed 1234567.
        let outputs: Vec<u64> = (0..3u64)
            .map(|n| splitmix64(1_234_567u64.wrapping_add(n.wrapping_mul(COUNTER_STEP))))
            .collect();
        assert_eq!(
            outputs,
            [
                6_457_827_717_110_365_317,
                3_203_168_211_198_807_973,
                9_817_491_932_198_370_423
            ]
        );
    }
}

//! The order in which points are inserted: rounds of random points (Amenta, Choi & Rote 2003,
//! "Incremental constructions con BRIO"), and in each round along a Hilbert curve, so that each
//! point is near the one before.

use crate::geometry::bounding_box;
use crate::parallel::prelude::*;

/// Share of the points of a round and all earlier rounds that earlier rounds have: 1 in 8.
const ROUND_RATIO_BITS: u32 = 3;
/// The first round has at most this many points, if there are few enough rounds.
const FIRST_ROUND: usize = 1000;
/// Largest number of rounds.
const MAX_ROUNDS: u32 = 8;
/// Bits of a position along each axis of the curve.
const MAX_BITS: u32 = 19;

/// Returns the numbers of `points` in the order in which they are inserted.
pub fn insertion_order(points: &[[f64; 3]]) -> Vec<u32> {
    let [low, high] = bounding_box(points);
    let size = (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
    // About 8 cells of the curve for each point of a volume, more for points of a surface.
    let bits = (points.len().max(1).ilog2() / 2 + 2).min(MAX_BITS);
    let scale = f64::from((1u32 << bits) - 1) / size;
    let mut rounds = 1;
    let mut count = points.len();
    while count > FIRST_ROUND && rounds < MAX_ROUNDS {
        rounds += 1;
        count >>= ROUND_RATIO_BITS;
    }
    let mut keys: Vec<(u64, u32)> = (points.par_iter().enumerate())
        .map(|(i, p)| {
            let cell = std::array::from_fn(|k| ((p[k] - low[k]) * scale) as u32);
            let round = (hash(i as u64).trailing_zeros() / ROUND_RATIO_BITS).min(rounds - 1);
            (
                u64::from(rounds - 1 - round) << (3 * MAX_BITS) | hilbert_index(cell, bits),
                i as u32,
            )
        })
        .collect();
    keys.par_sort_unstable();
    keys.into_iter().map(|key| key.1).collect()
}

/// Returns a number that looks random (SplitMix64).
fn hash(i: u64) -> u64 {
    let mut z = (i + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Returns the position of a cell along the Hilbert curve of 2^(3 `bits`) cells (Skilling 2004,
/// "Programming the Hilbert curve").
fn hilbert_index(mut x: [u32; 3], bits: u32) -> u64 {
    let mut bit = 1 << (bits - 1);
    while bit > 1 {
        let below = bit - 1;
        for k in 0..3 {
            if x[k] & bit != 0 {
                x[0] ^= below;
            } else {
                let exchange = (x[0] ^ x[k]) & below;
                x[0] ^= exchange;
                x[k] ^= exchange;
            }
        }
        bit >>= 1;
    }
    x[1] ^= x[0];
    x[2] ^= x[1];
    let mut flip = 0;
    let mut bit = 1 << (bits - 1);
    while bit > 1 {
        if x[2] & bit != 0 {
            flip ^= bit - 1;
        }
        bit >>= 1;
    }
    let x = x.map(|x| x ^ flip);
    (0..bits).rev().fold(0, |index, b| {
        x.iter()
            .fold(index, |index, x| index << 1 | u64::from(x >> b & 1))
    })
}

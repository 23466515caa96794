//! Order statistics of values that are distributed over ranks: a radix selection, which neither sorts the values nor
//! sends them.

use crate::parallel::prelude::*;

use super::Comm;
use crate::error::Result;

/// Values with integer keys, which have the order of `total_cmp`. A key has digits of [`DIGIT_BITS`] bits.
pub trait RadixKey: Copy {
    /// Number of digits of a key.
    const DIGIT_COUNT: u32;

    /// Returns the key of a value.
    fn to_key(self) -> u64;

    /// Returns the value of a key.
    fn from_key(key: u64) -> f64;
}

impl RadixKey for f32 {
    const DIGIT_COUNT: u32 = 32_u32.div_ceil(DIGIT_BITS);

    fn to_key(self) -> u64 {
        let bits = match self.to_bits() {
            bits if bits >> 31 == 1 => !bits,
            bits => bits | 1 << 31,
        };
        bits.into()
    }

    fn from_key(key: u64) -> f64 {
        let bits = match key as u32 {
            bits if bits >> 31 == 1 => bits & !(1 << 31),
            bits => !bits,
        };
        Self::from_bits(bits).into()
    }
}

impl RadixKey for f64 {
    const DIGIT_COUNT: u32 = 64_u32.div_ceil(DIGIT_BITS);

    fn to_key(self) -> u64 {
        match self.to_bits() {
            bits if bits >> 63 == 1 => !bits,
            bits => bits | 1 << 63,
        }
    }

    fn from_key(key: u64) -> f64 {
        Self::from_bits(match key {
            bits if bits >> 63 == 1 => bits & !(1 << 63),
            bits => !bits,
        })
    }
}

/// Number of bits of a digit: so few that counts fit in the cache and are sent quickly.
const DIGIT_BITS: u32 = 11;
/// Number of values of a digit.
const RADIX: usize = 1 << DIGIT_BITS;

/// Returns for each series of values the values with the given ranks in sorted order, over all ranks of `comm`.
/// `ranks` is called with the total number of values, or with 1 if there are none; then the result is NaN.
///
/// Digit by digit, from the most significant one, all ranks count how often each digit follows the known prefix of a
/// result.
///
/// # Errors
/// Returns the communication errors of `comm`.
pub fn order_statistics<V: RadixKey, R: AsRef<[usize]>>(
    series: &[impl Iterator<Item = V> + Clone + Sync],
    ranks: &[impl Fn(usize) -> R],
    comm: &dyn Comm,
) -> Result<Vec<Vec<f64>>> {
    // For each result its prefix, and its rank among the values with this prefix. At first all prefixes are empty.
    let mut states = vec![vec![(0u64, 0usize)]; series.len()];
    let mut totals = vec![0; series.len()];
    for digit in (0..V::DIGIT_COUNT).rev() {
        let prefixes: Vec<Vec<u64>> = states
            .iter()
            .map(|states| distinct_prefixes(states))
            .collect();
        let counts: Vec<Vec<u64>> = (series.par_iter().zip(&prefixes))
            .map(|(values, prefixes)| digit_counts(values.clone(), prefixes, DIGIT_BITS * digit))
            .collect();
        let counts = comm.all_reduce_sum("digits of values", counts.concat())?;
        let mut counts = counts.chunks_exact(RADIX);
        for (s, prefixes) in prefixes.iter().enumerate() {
            let counts: Vec<&[u64]> = counts.by_ref().take(prefixes.len()).collect();
            if digit + 1 == V::DIGIT_COUNT {
                totals[s] = counts.iter().copied().flatten().sum::<u64>() as usize;
                let ranks = ranks[s](totals[s].max(1));
                states[s] = ranks.as_ref().iter().map(|&rank| (0, rank)).collect();
            }
            for (prefix, rank) in &mut states[s] {
                let index = prefixes.iter().position(|p| p == prefix);
                let counts = counts[index.unwrap_or_default()];
                let mut before = 0;
                let next = counts.iter().position(|&count| {
                    before += count as usize;
                    before > *rank
                });
                let next = next.unwrap_or_default();
                *rank = (*rank + counts[next] as usize).saturating_sub(before);
                *prefix = *prefix << DIGIT_BITS | next as u64;
            }
        }
    }
    let value = |total: usize, key: u64| match total {
        0 => f64::NAN,
        _ => V::from_key(key),
    };
    let results = states.iter().zip(totals);
    Ok(results
        .map(|(states, total)| states.iter().map(|&(key, _)| value(total, key)).collect())
        .collect())
}

/// Returns the prefixes of results without duplicates.
fn distinct_prefixes(states: &[(u64, usize)]) -> Vec<u64> {
    let mut prefixes: Vec<u64> = states.iter().map(|(prefix, _)| *prefix).collect();
    prefixes.sort_unstable();
    prefixes.dedup();
    prefixes
}

/// Counts for each prefix how many values have it and continue with each digit. The digit begins at bit `shift`.
fn digit_counts<V: RadixKey>(
    values: impl Iterator<Item = V>,
    prefixes: &[u64],
    shift: u32,
) -> Vec<u64> {
    let mut counts = vec![0; RADIX * prefixes.len()];
    for v in values {
        let key = v.to_key();
        // The prefix before the first digit is empty.
        let prefix = key.checked_shr(shift + DIGIT_BITS).unwrap_or(0);
        if let Some(index) = prefixes.iter().position(|&p| p == prefix) {
            counts[RADIX * index + (key >> shift) as usize % RADIX] += 1;
        }
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::SelfComm;
    use crate::comm::run_threads;
    use crate::geometry::random::Random;

    #[test]
    fn values_by_rank_are_those_of_the_sorted_values() {
        let mut random = Random::new(3);
        // Of all sizes, some many times, both zeros, and what is no number.
        let mut values: Vec<f64> = (0..3000)
            .map(|i| match i % 4 {
                0 => random.draw() - 0.5,
                1 => 0.75,
                2 => 1e-3 * random.draw() + 0.75,
                _ => (40.0 * (random.draw() - 0.5)).exp(),
            })
            .collect();
        values.extend([0.0, -0.0, f64::INFINITY, f64::NEG_INFINITY, f64::NAN]);
        let short: Vec<f32> = values.iter().map(|&v| v as f32).collect();
        let ranks = |total: usize| [0, 1, total / 100, total / 2, total - 2, total - 1];
        let wanted = |sorted: &[f64]| ranks(sorted.len()).map(|rank| sorted[rank].to_bits());
        let mut sorted = values.clone();
        sorted.sort_by(f64::total_cmp);
        let mut short_sorted: Vec<f64> = short.iter().map(|&v| v.into()).collect();
        short_sorted.sort_by(f64::total_cmp);
        let wanted = [wanted(&sorted), wanted(&short_sorted)];
        let bits = |found: Vec<Vec<f64>>| std::array::from_fn(|i| found[0][i].to_bits());
        for count in [1, 2, 3, 7] {
            let found = run_threads(count, |group| {
                let own = |i: &usize| i % count == group.rank();
                let own = (0..values.len()).filter(own);
                let (long, short) = (own.clone().map(|i| values[i]), own.map(|i| short[i]));
                let long = order_statistics(&[long], &[ranks], group).unwrap();
                [
                    bits(long),
                    bits(order_statistics(&[short], &[ranks], group).unwrap()),
                ]
            });
            assert!(found.iter().all(|found| *found == wanted), "{count}");
        }
        let none: [f64; 0] = [];
        let found =
            order_statistics(&[none.iter().copied()], &[|_| [0usize; 2]], &SelfComm).unwrap();
        assert!(found[0].iter().all(|v| v.is_nan()));
    }
}

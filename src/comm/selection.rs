//! Values by their rank among all that several have, without sorting them.

use crate::parallel::prelude::*;

use super::LocalOrComm;

/// Values with whole numbers, of so many digits of [`DIGIT_BITS`], that are ordered as they are by `total_cmp`.
pub trait RadixKey: Copy {
    /// Digits of the numbers.
    const DIGIT_COUNT: u32;

    /// The number of a value.
    fn to_key(self) -> u64;

    /// The value of a number.
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

/// Bits of a digit: few enough that counts stay close to the processor, and are soon told.
const DIGIT_BITS: u32 = 11;
/// So many values a digit has.
const RADIX: usize = 1 << DIGIT_BITS;

/// Of each series of values those of which so many are smaller: `ranks` is told how many there are in all, which is
/// never 0; of no values, NaN. For one digit after the other it is counted how many of those that begin as the wanted
/// ones do go on with each digit: nobody is told a value.
///
/// # Errors
/// Those of the other holders.
pub fn order_statistics<V: RadixKey, R: AsRef<[usize]>, H: LocalOrComm + ?Sized>(
    series: &[impl Iterator<Item = V> + Clone + Sync],
    ranks: &[impl Fn(usize) -> R],
    holders: &H,
) -> Result<Vec<Vec<f64>>, H::Error> {
    // For each wanted value its beginning, and how many of the same beginning are before it.
    // At first all begin alike.
    let mut places = vec![vec![(0u64, 0usize)]; series.len()];
    let mut totals = vec![0; series.len()];
    for digit in (0..V::DIGIT_COUNT).rev() {
        let begun: Vec<Vec<u64>> = places
            .iter()
            .map(|places| distinct_prefixes(places))
            .collect();
        let counts: Vec<Vec<u64>> = (series.par_iter().zip(&begun))
            .map(|(values, begun)| digit_counts(values.clone(), begun, DIGIT_BITS * digit))
            .collect();
        let counts = holders.all_reduce_sum("values by their size", counts.concat())?;
        let mut counts = counts.chunks_exact(RADIX);
        for (s, begun) in begun.iter().enumerate() {
            let counts: Vec<&[u64]> = counts.by_ref().take(begun.len()).collect();
            if digit + 1 == V::DIGIT_COUNT {
                totals[s] = counts.iter().copied().flatten().sum::<u64>() as usize;
                let ranks = ranks[s](totals[s].max(1));
                places[s] = ranks.as_ref().iter().map(|&rank| (0, rank)).collect();
            }
            for (beginning, rank) in &mut places[s] {
                let with = begun.iter().position(|b| b == beginning);
                let counts = counts[with.unwrap_or_default()];
                let mut before = 0;
                let next = counts.iter().position(|&count| {
                    before += count as usize;
                    before > *rank
                });
                let next = next.unwrap_or_default();
                *rank = (*rank + counts[next] as usize).saturating_sub(before);
                *beginning = *beginning << DIGIT_BITS | next as u64;
            }
        }
    }
    let value = |total: usize, key: u64| match total {
        0 => f64::NAN,
        _ => V::from_key(key),
    };
    let found = places.iter().zip(totals);
    Ok(found
        .map(|(places, total)| places.iter().map(|&(key, _)| value(total, key)).collect())
        .collect())
}

/// The beginnings of wanted values, each once.
fn distinct_prefixes(places: &[(u64, usize)]) -> Vec<u64> {
    let mut begun: Vec<u64> = places.iter().map(|(beginning, _)| *beginning).collect();
    begun.sort_unstable();
    begun.dedup();
    begun
}

/// For each of the beginnings how many values begin so and go on with each digit, which is so many bits from the
/// end.
fn digit_counts<V: RadixKey>(
    values: impl Iterator<Item = V>,
    begun: &[u64],
    bits: u32,
) -> Vec<u64> {
    let mut counts = vec![0; RADIX * begun.len()];
    for v in values {
        let key = v.to_key();
        // All begin alike before the first digit.
        let beginning = key.checked_shr(bits + DIGIT_BITS).unwrap_or(0);
        if let Some(with) = begun.iter().position(|&b| b == beginning) {
            counts[RADIX * with + (key >> bits) as usize % RADIX] += 1;
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
                let own = |i: &usize| i % count == LocalOrComm::rank(group);
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
        let Ok(found) = order_statistics(&[none.iter().copied()], &[|_| [0usize; 2]], &SelfComm);
        assert!(found[0].iter().all(|v| v.is_nan()));
    }
}

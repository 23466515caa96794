//! How far things are from others, where several have some each: shares, largest, and up to where a share of them is.
//! Counts and areas are whole numbers, so that it makes no difference who has what.

use crate::comm::LocalOrComm;
use crate::parallel::prelude::*;

/// Areas are counted in these parts of a square sample.
const PARTS_PER_AREA: f64 = (1u64 << 24) as f64;

/// Distances, none negative, each with a weight.
#[derive(Debug, Default)]
pub(super) struct WeightedDistances {
    /// Rising.
    sorted: Vec<f64>,
    /// The weights up to each; none where all weigh one.
    cumulative_weights: Vec<u64>,
}

impl WeightedDistances {
    /// Of as many things.
    pub fn from_distances(mut distances: Vec<f64>) -> Self {
        distances.par_sort_unstable_by(f64::total_cmp);
        Self {
            sorted: distances,
            cumulative_weights: Vec::new(),
        }
    }

    /// Of things with areas.
    pub fn from_weighted(mut all: Vec<(f64, f64)>) -> Self {
        all.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let mut sum = 0;
        let weigh = |area: f64| {
            sum += (area * PARTS_PER_AREA).round() as u64;
            sum
        };
        Self {
            cumulative_weights: all.iter().map(|(_, area)| *area).map(weigh).collect(),
            sorted: all.into_iter().map(|(distance, _)| distance).collect(),
        }
    }

    /// The weight of the first.
    fn prefix_weight(&self, count: usize) -> u64 {
        match count.checked_sub(1) {
            Some(last) => *self.cumulative_weights.get(last).unwrap_or(&(count as u64)),
            None => 0,
        }
    }

    /// The weight of all.
    fn total_weight(&self) -> u64 {
        self.prefix_weight(self.sorted.len())
    }

    /// The weight of those up to a distance.
    fn weight_within(&self, distance: f64) -> u64 {
        self.prefix_weight(self.sorted.partition_point(|&d| d <= distance))
    }

    /// The weight of those that come before one whose bits are these: distances are in the order of their bits.
    fn weight_before(&self, bits: u64) -> u64 {
        self.prefix_weight(self.sorted.partition_point(|&d| d.to_bits() < bits))
    }
}

/// What all holders have of some distances together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DistanceShares<const N: usize> {
    /// How many there are.
    pub count: u64,
    /// Their weight, and that of those up to each of the distances that were asked for.
    pub total_weight: u64,
    pub weights_within: [u64; N],
    /// The largest, if there is any.
    pub largest: Option<f64>,
}

impl<const N: usize> DistanceShares<N> {
    /// The share of the weight that is up to one of the distances; NaN if there is none.
    pub fn share(&self, i: usize) -> f64 {
        self.weights_within[i] as f64 / self.total_weight as f64
    }

    /// The weight as an area.
    pub fn area(&self) -> f64 {
        self.total_weight as f64 / PARTS_PER_AREA
    }
}

/// For each of some distances what all holders have together; `up_to` is what the weight is asked for.
///
/// # Errors
/// Those of the other holders.
pub(super) fn summaries<const M: usize, const N: usize, H: LocalOrComm + ?Sized>(
    own: [&WeightedDistances; M],
    up_to: [f64; N],
    holders: &H,
) -> Result<[DistanceShares<N>; M], H::Error> {
    let of = |own: &WeightedDistances| {
        let figures = [own.sorted.len() as u64, own.total_weight()];
        let within = up_to.map(|distance| own.weight_within(distance));
        (figures, (within, own.sorted.last().copied()))
    };
    let told = holders.try_all_gather("distances", own.map(of))?;
    let of_all = |i: usize| {
        let mut all = DistanceShares {
            count: 0,
            total_weight: 0,
            weights_within: [0; N],
            largest: None,
        };
        for ([count, weight], (within, largest)) in told.iter().map(|told| told[i]) {
            all.count += count;
            all.total_weight += weight;
            all.weights_within = std::array::from_fn(|k| all.weights_within[k] + within[k]);
            all.largest = all
                .largest
                .into_iter()
                .chain(largest)
                .max_by(f64::total_cmp);
        }
        all
    };
    Ok(std::array::from_fn(of_all))
}

/// For each of some distances the least up to which all holders' have so much weight together, which is more than none
/// and at most all.
///
/// # Errors
/// Those of the other holders.
pub(super) fn quantiles<const M: usize, H: LocalOrComm + ?Sized>(
    own: [&WeightedDistances; M],
    weights: [u64; M],
    holders: &H,
) -> Result<[f64; M], H::Error> {
    // Bit by bit: the largest before which there is less.
    let mut found = [0u64; M];
    for bit in (0..63).rev() {
        let tried = found.map(|found| found | 1 << bit);
        let before: [u64; M] = std::array::from_fn(|i| own[i].weight_before(tried[i]));
        let told = holders.try_all_gather("distances before one", before)?;
        for i in 0..M {
            if told.iter().map(|before| before[i]).sum::<u64>() < weights[i] {
                found[i] = tried[i];
            }
        }
    }
    Ok(found.map(f64::from_bits))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::{Comm, SelfComm, run_threads};
    use crate::geometry::random::Random;

    #[test]
    fn several_have_the_figures_of_one() {
        let mut random = Random::new(3);
        let mut some = |count: usize| -> Vec<(f64, f64)> {
            let mut one = || {
                let far = random.range(0.0, 3.0);
                let far = match far {
                    2.9.. => f64::INFINITY,
                    ..0.3 => 0.0,
                    _ => (8.0 * far).round() / 8.0,
                };
                (far, random.range(0.0, 2.0))
            };
            (0..count).map(|_| one()).collect()
        };
        for count in [1, 5, 300] {
            let all = some(count);
            let distances =
                |of: &[(f64, f64)]| -> Vec<f64> { of.iter().map(|one| one.0).collect() };
            let counted = WeightedDistances::from_distances(distances(&all));
            let weighted = WeightedDistances::from_weighted(all.clone());
            let both = [&counted, &weighted];
            let Ok(found) = summaries(both, [0.5, 1.0], &SelfComm);
            let within = |far: f64| all.iter().filter(move |one| one.0 <= far);
            assert_eq!(found[0].share(0), within(0.5).count() as f64 / count as f64);
            let area = |far: f64| within(far).map(|one| one.1).sum::<f64>();
            let whole = area(f64::INFINITY);
            assert!((found[1].area() - whole).abs() < 1e-7 * whole.max(1.0));
            assert!((found[1].share(1) - area(1.0) / whole).abs() < 1e-7);
            let mut sorted = distances(&all);
            sorted.sort_by(f64::total_cmp);
            assert!(
                found
                    .iter()
                    .all(|found| found.largest == sorted.last().copied())
            );
            let weights = [
                1 + (0.95 * count as f64) as u64,
                (0.5 * found[1].total_weight as f64) as u64,
            ];
            let weights = weights.map(|weight| weight.clamp(1, u64::MAX));
            let Ok(reach) = quantiles(both, [weights[0].min(count as u64), weights[1]], &SelfComm);
            assert_eq!(reach[0], sorted[weights[0].min(count as u64) as usize - 1]);
            let before = sorted.iter().rev().find(|&&far| far < reach[1]);
            assert!(area(reach[1]) >= 0.5 * whole - 1e-6);
            assert!(before.is_none_or(|&far| area(far) < 0.5 * whole + 1e-6));
            for holders in [2, 7] {
                run_threads(holders, |group: &dyn Comm| {
                    let own = group.range_of_rank(count, group.rank());
                    let own = &all[own];
                    let own = [
                        WeightedDistances::from_distances(distances(own)),
                        WeightedDistances::from_weighted(own.to_vec()),
                    ];
                    let own = own.each_ref();
                    assert_eq!(summaries(own, [0.5, 1.0], group).unwrap(), found);
                    let weights = [weights[0].min(count as u64), weights[1]];
                    assert_eq!(quantiles(own, weights, group).unwrap(), reach);
                });
            }
        }
        let none = WeightedDistances::default();
        let Ok([nothing]) = summaries([&none], [0.5], &SelfComm);
        assert!(nothing.share(0).is_nan() && nothing.largest.is_none() && nothing.area() == 0.0);
    }
}

//! Statistics of distances that are distributed over the parts of a mesh: fractions within a distance, maxima and
//! quantiles. Counts and areas are integers, so that results do not depend on the distribution.

use crate::Result;
use crate::mesh::view::MeshView;
use crate::parallel::prelude::*;

/// Number of units in which a square sample of area is counted.
const PARTS_PER_AREA: f64 = (1u64 << 24) as f64;

/// Non-negative distances, each with a weight.
#[derive(Debug, Default)]
pub(super) struct WeightedDistances {
    /// Distances, ascending.
    sorted: Vec<f64>,
    /// Cumulative weights. Empty if all weights are one.
    cumulative_weights: Vec<u64>,
}

impl WeightedDistances {
    /// Creates distances with weight one.
    pub fn from_distances(mut distances: Vec<f64>) -> Self {
        distances.par_sort_unstable_by(f64::total_cmp);
        Self {
            sorted: distances,
            cumulative_weights: Vec::new(),
        }
    }

    /// Creates distances with areas as weights.
    pub fn from_weighted(mut samples: Vec<(f64, f64)>) -> Self {
        samples.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let mut sum = 0;
        let cumulative_weight = |area: f64| {
            sum += (area * PARTS_PER_AREA).round() as u64;
            sum
        };
        Self {
            cumulative_weights: samples
                .iter()
                .map(|(_, area)| *area)
                .map(cumulative_weight)
                .collect(),
            sorted: samples.into_iter().map(|(distance, _)| distance).collect(),
        }
    }

    /// Returns the weight of the first `count` distances.
    fn prefix_weight(&self, count: usize) -> u64 {
        match count.checked_sub(1) {
            Some(last) => *self.cumulative_weights.get(last).unwrap_or(&(count as u64)),
            None => 0,
        }
    }

    /// Returns the total weight.
    fn total_weight(&self) -> u64 {
        self.prefix_weight(self.sorted.len())
    }

    /// Returns the weight of the distances up to `distance`.
    fn weight_within(&self, distance: f64) -> u64 {
        self.prefix_weight(self.sorted.partition_point(|&d| d <= distance))
    }

    /// Returns the weight of the distances whose bits are less than `bits`. Non-negative numbers
    /// are in the order of their bits.
    fn weight_before(&self, bits: u64) -> u64 {
        self.prefix_weight(self.sorted.partition_point(|&d| d.to_bits() < bits))
    }
}

/// Summary of distances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DistanceShares<const N: usize> {
    /// Number of distances.
    pub count: u64,
    /// Total weight, and weight of the distances up to each of the limits.
    pub total_weight: u64,
    pub weights_within: [u64; N],
    /// Maximum, if there are any distances.
    pub largest: Option<f64>,
}

impl<const N: usize> DistanceShares<N> {
    /// Returns the fraction of the weight within limit `i`; NaN if there is no weight.
    pub fn share(&self, i: usize) -> f64 {
        self.weights_within[i] as f64 / self.total_weight as f64
    }

    /// Returns the total weight as an area.
    pub fn area(&self) -> f64 {
        self.total_weight as f64 / PARTS_PER_AREA
    }
}

/// Returns for each of the given lists the summary over all parts of a mesh, with the weight within
/// each of the `limits`. Collective.
///
/// # Errors
/// Returns the communication errors of the view.
pub(super) fn summaries<const L: usize, const N: usize, const D: usize, M>(
    view: &MeshView<'_, D, M>,
    local: [&WeightedDistances; L],
    limits: [f64; N],
) -> Result<[DistanceShares<N>; L]> {
    let summarize = |distances: &WeightedDistances| {
        let figures = [distances.sorted.len() as u64, distances.total_weight()];
        let within = limits.map(|distance| distances.weight_within(distance));
        (figures, (within, distances.sorted.last().copied()))
    };
    let merged = view.merge_parts("distances", local.map(summarize), |all, part| {
        std::array::from_fn(|i| {
            let (([m, v], (sums, a)), ([n, w], (within, b))) = (all[i], part[i]);
            let sums = std::array::from_fn(|k| sums[k] + within[k]);
            let largest = a.into_iter().chain(b).max_by(f64::total_cmp);
            ([m + n, v + w], (sums, largest))
        })
    })?;
    Ok(merged.map(
        |([count, total_weight], (weights_within, largest))| DistanceShares {
            count,
            total_weight,
            weights_within,
            largest,
        },
    ))
}

/// Returns for each of the given lists the smallest distance up to which all parts of a mesh together
/// have the weight `weights[i]`, which is at least 1 and at most the total weight. Collective.
///
/// # Errors
/// Returns the communication errors of the view.
pub(super) fn quantiles<const L: usize, const D: usize, M>(
    view: &MeshView<'_, D, M>,
    local: [&WeightedDistances; L],
    weights: [u64; L],
) -> Result<[f64; L]> {
    // The result is found bit by bit: it is the largest value before which there is less weight.
    let mut bits = [0u64; L];
    for bit in (0..63).rev() {
        let candidates = bits.map(|bits| bits | 1 << bit);
        let before: [u64; L] = std::array::from_fn(|i| local[i].weight_before(candidates[i]));
        let before = view.merge_parts("distances before one", before, |a, b| {
            std::array::from_fn(|i| a[i] + b[i])
        })?;
        for i in (0..L).filter(|&i| before[i] < weights[i]) {
            bits[i] = candidates[i];
        }
    }
    Ok(bits.map(f64::from_bits))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::{partition_range, run_threads};
    use crate::geometry::random::Random;
    use crate::mesh::TetMesh;

    #[test]
    fn figures_do_not_depend_on_the_number_of_ranks() {
        let (mut random, empty_mesh) = (Random::new(3), TetMesh::default());
        let alone = MeshView::from_mesh(&empty_mesh);
        let mut random_samples = |count: usize| -> Vec<(f64, f64)> {
            let mut draw = || {
                let distance = random.range(0.0, 3.0);
                let distance = match distance {
                    2.9.. => f64::INFINITY,
                    ..0.3 => 0.0,
                    _ => (8.0 * distance).round() / 8.0,
                };
                (distance, random.range(0.0, 2.0))
            };
            (0..count).map(|_| draw()).collect()
        };
        for count in [1, 5, 300] {
            let samples = random_samples(count);
            let distances =
                |samples: &[(f64, f64)]| -> Vec<f64> { samples.iter().map(|one| one.0).collect() };
            let counted = WeightedDistances::from_distances(distances(&samples));
            let weighted = WeightedDistances::from_weighted(samples.clone());
            let series = [&counted, &weighted];
            let expected = summaries(&alone, series, [0.5, 1.0]).unwrap();
            let within = |limit: f64| samples.iter().filter(move |sample| sample.0 <= limit);
            assert_eq!(
                expected[0].share(0),
                within(0.5).count() as f64 / count as f64
            );
            let area = |limit: f64| within(limit).map(|sample| sample.1).sum::<f64>();
            let total_area = area(f64::INFINITY);
            assert!((expected[1].area() - total_area).abs() < 1e-7 * total_area.max(1.0));
            assert!((expected[1].share(1) - area(1.0) / total_area).abs() < 1e-7);
            let mut sorted = distances(&samples);
            sorted.sort_by(f64::total_cmp);
            assert!(
                expected
                    .iter()
                    .all(|found| found.largest == sorted.last().copied())
            );
            let weights = [
                1 + (0.95 * count as f64) as u64,
                (0.5 * expected[1].total_weight as f64) as u64,
            ];
            let weights = weights.map(|weight| weight.clamp(1, u64::MAX));
            let expected_weights = [weights[0].min(count as u64), weights[1]];
            let expected_quantiles = quantiles(&alone, series, expected_weights).unwrap();
            assert_eq!(
                expected_quantiles[0],
                sorted[weights[0].min(count as u64) as usize - 1]
            );
            let previous = sorted
                .iter()
                .rev()
                .find(|&&far| far < expected_quantiles[1]);
            assert!(area(expected_quantiles[1]) >= 0.5 * total_area - 1e-6);
            assert!(previous.is_none_or(|&far| area(far) < 0.5 * total_area + 1e-6));
            for ranks in [2, 7] {
                run_threads(ranks, |comm| {
                    let view = MeshView::from_cells(&empty_mesh, 0, [0; 2], comm);
                    let range = partition_range(count, comm.rank(), comm.size());
                    let local = &samples[range];
                    let local = [
                        WeightedDistances::from_distances(distances(local)),
                        WeightedDistances::from_weighted(local.to_vec()),
                    ];
                    let local = local.each_ref();
                    assert_eq!(summaries(&view, local, [0.5, 1.0]).unwrap(), expected);
                    let weights = [weights[0].min(count as u64), weights[1]];
                    assert_eq!(
                        quantiles(&view, local, weights).unwrap(),
                        expected_quantiles
                    );
                });
            }
        }
        let empty = WeightedDistances::default();
        let [shares] = summaries(&alone, [&empty], [0.5]).unwrap();
        assert!(shares.share(0).is_nan() && shares.largest.is_none() && shares.area() == 0.0);
    }
}

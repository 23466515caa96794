//! How a sequence of parts is divided among ranks.

use std::ops::Range;

/// Returns the parts of one rank, if `size` ranks divide `parts` parts evenly.
pub fn partition_range(parts: usize, rank: usize, size: usize) -> Range<usize> {
    rank * parts / size..(rank + 1) * parts / size
}

/// Returns the parts of one rank, if `size` ranks divide parts with these weights so that each has about the same
/// total weight.
pub(super) fn weighted_partition_range(
    weights: &[usize],
    rank: usize,
    size: usize,
) -> Range<usize> {
    let total: usize = weights.iter().sum();
    // A part goes to the rank whose share of the total weight contains the part's middle.
    let first_of_rank = |rank: usize| {
        let mut before = 0;
        let begins = |&weight: &usize| {
            let middle = 2 * before + weight;
            before += weight;
            middle * size >= 2 * rank * total
        };
        weights.iter().position(begins).unwrap_or(weights.len())
    };
    let end = if rank + 1 == size {
        weights.len()
    } else {
        first_of_rank(rank + 1)
    };
    match rank {
        0 => 0..end,
        _ => first_of_rank(rank)..end,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_belongs_to_one_rank() {
        for (parts, size) in [(0, 3), (1, 3), (7, 3), (64, 7), (3, 8)] {
            let ranges = (0..size).flat_map(|rank| partition_range(parts, rank, size));
            assert!(ranges.eq(0..parts), "{parts} parts, {size} ranks");
        }
    }

    #[test]
    fn weighted_ranges_cover_all_parts_and_balance_the_weight() {
        let weights = [1, 1, 1, 9, 1, 1, 8, 2, 0, 4];
        for size in 1..12 {
            let range = |rank| weighted_partition_range(&weights, rank, size);
            assert!((0..size).flat_map(range).eq(0..weights.len()), "{size}");
        }
        let totals: Vec<usize> = (0..3)
            .map(|rank| {
                weights[weighted_partition_range(&weights, rank, 3)]
                    .iter()
                    .sum()
            })
            .collect();
        assert_eq!(totals, [12, 10, 6]);
        for weights in [&[][..], &[0, 0, 0]] {
            let range = |rank| weighted_partition_range(weights, rank, 2);
            assert!((0..2).flat_map(range).eq(0..weights.len()));
        }
    }
}

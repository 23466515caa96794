//! Medians and other quantiles.
//!
//! The quantile at a share from 0 to 1 is one of the values, never a mean of two. Of `n` values in
//! ascending order it is the one with this index, counted from 0:
//!
//! - [`lower_quantile`]: `share * (n - 1)`, rounded down
//! - [`nearest_quantile`]: `share * (n - 1)`, rounded to the nearest integer
//! - [`upper_quantile`]: `share * n`, rounded down; [`upper_median`] for a share of 1/2
//!
//! The order is the total order of IEEE 754: NaN without a sign is above all numbers. Without values there is
//! no quantile. The functions change the order of the values.

use std::cmp::Ordering;

/// Values with a total order.
pub trait TotalOrder: Copy {
    /// Compares two values.
    fn compare(&self, other: &Self) -> Ordering;
}

impl TotalOrder for f32 {
    fn compare(&self, other: &Self) -> Ordering {
        self.total_cmp(other)
    }
}

impl TotalOrder for f64 {
    fn compare(&self, other: &Self) -> Ordering {
        self.total_cmp(other)
    }
}

impl TotalOrder for usize {
    fn compare(&self, other: &Self) -> Ordering {
        self.cmp(other)
    }
}

/// Returns the index of the [`lower_quantile`] of `count` values.
pub fn lower_index(count: usize, share: f64) -> usize {
    (share * count.saturating_sub(1) as f64) as usize
}

/// Returns the quantile whose index is rounded down; `None` without values.
pub fn lower_quantile<T: TotalOrder>(values: &mut [T], share: f64) -> Option<T> {
    nth(values, lower_index(values.len(), share))
}

/// Returns the quantile whose index is rounded to the nearest integer; `None` without values.
pub fn nearest_quantile<T: TotalOrder>(values: &mut [T], share: f64) -> Option<T> {
    let index = share * values.len().saturating_sub(1) as f64;
    nth(values, index.round() as usize)
}

/// Returns the smallest value that is not below the given share of the values; `None` without values, and
/// for a share of 1.
pub fn upper_quantile<T: TotalOrder>(values: &mut [T], share: f64) -> Option<T> {
    nth(values, (share * values.len() as f64) as usize)
}

/// Returns the median, of an even number of values the upper one; `None` without values.
pub fn upper_median<T: TotalOrder>(values: &mut [T]) -> Option<T> {
    nth(values, values.len() / 2)
}

/// Returns the value with this index in ascending order.
fn nth<T: TotalOrder>(values: &mut [T], index: usize) -> Option<T> {
    (index < values.len()).then(|| *values.select_nth_unstable_by(index, T::compare).1)
}

/// Returns the values up to which these shares of the total weight lie, from pairs of a value and its
/// weight; `None` without any.
pub fn weighted_quantiles<const N: usize>(
    mut values: Vec<[f64; 2]>,
    shares: [f64; N],
) -> Option<[f64; N]> {
    values.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let last = values.last()?[0];
    let total: f64 = values.iter().map(|[_, weight]| weight).sum();
    Some(shares.map(|share| {
        let mut below = 0.0;
        let found = values.iter().find(|[_, weight]| {
            below += weight;
            below >= share * total
        });
        found.map_or(last, |[value, _]| *value)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_differ_by_how_their_index_is_rounded() {
        let values = [3.0, 1.0, 0.0, 2.0];
        let at = |share: f64| {
            [lower_quantile, nearest_quantile, upper_quantile]
                .map(|f| f(&mut values.clone(), share))
        };
        assert_eq!(at(0.0), [Some(0.0); 3]);
        assert_eq!(at(0.5), [Some(1.0), Some(2.0), Some(2.0)]);
        assert_eq!(at(0.75), [Some(2.0), Some(2.0), Some(3.0)]);
        assert_eq!(at(1.0), [Some(3.0), Some(3.0), None]);
        assert_eq!(upper_median(&mut values.clone()), Some(2.0));
        assert_eq!(upper_median(&mut [5usize, 7, 6]), Some(6));
        assert_eq!(upper_median::<f32>(&mut []), None);
        assert_eq!(upper_median(&mut [f32::NAN, 1.0, 0.0]), Some(1.0));
    }

    #[test]
    fn quantiles_are_weighted() {
        let values = vec![[5.0, 1.0], [1.0, 3.0], [9.0, 1.0]];
        assert_eq!(
            weighted_quantiles(values, [0.05, 0.5, 0.95]),
            Some([1.0, 1.0, 9.0])
        );
        assert_eq!(weighted_quantiles(Vec::new(), [0.5]), None);
    }
}

//! Numbers sorted by the group that each belongs to.

use crate::parallel::prelude::*;

/// Fewer numbers are sorted by one thread.
const MIN_PARALLEL_LEN: usize = 1 << 14;

/// Sorts the numbers from 0 on by their group, given for each in turn. Those of group g are
/// `order[start[g]..start[g + 1]]`, rising.
pub fn sort_by_group(groups: usize, of: impl Iterator<Item = usize>) -> (Vec<u32>, Vec<u32>) {
    let of: Vec<u32> = of.map(|group| group as u32).collect();
    let (mut start, mut order) = (Vec::new(), Vec::new());
    sort_by_group_into(groups, &of, &mut start, &mut order);
    (start, order)
}

/// The same into arrays that there are, whatever they hold: each thread looks through all numbers for those
/// of its share of the groups.
pub fn sort_by_group_into(groups: usize, of: &[u32], start: &mut Vec<u32>, order: &mut Vec<u32>) {
    let parts = match of.len() {
        ..MIN_PARALLEL_LEN => 1,
        _ => rayon::current_num_threads(),
    };
    let share = groups.div_ceil(parts).max(1);
    start.clear();
    start.resize(groups + 1, 0);
    order.resize(of.len(), 0);
    let counts = start[..groups].par_chunks_mut(share).enumerate();
    counts.for_each(|(part, counts)| {
        for &group in of {
            if let Some(count) = counts.get_mut((group as usize).wrapping_sub(part * share)) {
                *count += 1;
            }
        }
    });
    let mut sum = 0;
    for start in start.iter_mut() {
        sum += std::mem::replace(start, sum);
    }
    let mut rest = order.as_mut_slice();
    let mut orders = Vec::with_capacity(parts);
    for first in (0..groups).step_by(share) {
        let end = (first + share).min(groups);
        let (own, others) = rest.split_at_mut((start[end] - start[first]) as usize);
        orders.push(own);
        rest = others;
    }
    let starts = start[..groups].par_chunks_mut(share).zip(orders);
    starts.enumerate().for_each(|(part, (starts, order))| {
        let first = starts[0];
        for (n, &group) in of.iter().enumerate() {
            // The start of a group counts up to its end, where the next one starts.
            if let Some(place) = starts.get_mut((group as usize).wrapping_sub(part * share)) {
                order[(*place - first) as usize] = n as u32;
                *place += 1;
            }
        }
        starts.rotate_right(1);
        starts[0] = first;
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_group_has_its_own_in_rising_order() {
        let (start, order) = sort_by_group(4, [2, 0, 2, 3, 0, 2].into_iter());
        assert_eq!(start, [0, 2, 2, 5, 6]);
        assert_eq!(order, [1, 4, 0, 2, 5, 3]);
        assert_eq!(sort_by_group(2, std::iter::empty()), (vec![0; 3], vec![]));
        assert_eq!(sort_by_group(0, std::iter::empty()), (vec![0], vec![]));
    }

    #[test]
    fn many_numbers_are_grouped_alike_by_any_number_of_threads() {
        let of = |n: usize| n * 7919 % 1009 * (n % 3) / 2;
        let by = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let pool = pool.build().unwrap();
            pool.install(|| sort_by_group(1009, (0..3 * MIN_PARALLEL_LEN).map(of)))
        };
        let (start, order) = by(3);
        assert!(by(1) == (start.clone(), order.clone()));
        for g in 0..1009 {
            let own = &order[start[g] as usize..start[g + 1] as usize];
            assert!(own.iter().all(|&n| of(n as usize) == g) && own.is_sorted());
        }
        assert_eq!(start[1009] as usize, order.len());
    }
}

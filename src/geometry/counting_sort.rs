//! Counting sort: sorts the numbers from 0 on by the group that each belongs to.

use crate::parallel::prelude::*;

/// Shorter lists are sorted by one thread.
const MIN_PARALLEL_LEN: usize = 1 << 14;

/// Sorts the numbers from 0 on by group; `groups` gives the group of each number in turn. Returns
/// `start` and `order`: the numbers of group g are `order[start[g]..start[g + 1]]`, in ascending
/// order. Numbers of the groups from `group_count` on are left out.
pub fn sort_by_group(
    group_count: usize,
    groups: impl Iterator<Item = usize>,
) -> (Vec<u32>, Vec<u32>) {
    let groups: Vec<u32> = groups.map(|group| group as u32).collect();
    let (mut start, mut order) = (Vec::new(), Vec::new());
    sort_by_group_into(group_count, &groups, &mut start, &mut order);
    (start, order)
}

/// Sorts as [`sort_by_group`] does, into existing arrays whose content is replaced. Each thread
/// scans all numbers for those of its own range of groups.
pub fn sort_by_group_into(
    group_count: usize,
    groups: &[u32],
    start: &mut Vec<u32>,
    order: &mut Vec<u32>,
) {
    let part_count = match groups.len() {
        ..MIN_PARALLEL_LEN => 1,
        _ => rayon::current_num_threads(),
    };
    let groups_per_part = group_count.div_ceil(part_count).max(1);
    start.clear();
    start.resize(group_count + 1, 0);
    let counts = start[..group_count]
        .par_chunks_mut(groups_per_part)
        .enumerate();
    counts.for_each(|(part, counts)| {
        for &group in groups {
            if let Some(count) =
                counts.get_mut((group as usize).wrapping_sub(part * groups_per_part))
            {
                *count += 1;
            }
        }
    });
    let mut sum = 0;
    for start in start.iter_mut() {
        sum += std::mem::replace(start, sum);
    }
    order.resize(start[group_count] as usize, 0);
    let mut rest = order.as_mut_slice();
    let mut orders = Vec::with_capacity(part_count);
    for first in (0..group_count).step_by(groups_per_part) {
        let end = (first + groups_per_part).min(group_count);
        let (part_order, tail) = rest.split_at_mut((start[end] - start[first]) as usize);
        orders.push(part_order);
        rest = tail;
    }
    let starts = start[..group_count]
        .par_chunks_mut(groups_per_part)
        .zip(orders);
    starts.enumerate().for_each(|(part, (starts, order))| {
        let first = starts[0];
        for (n, &group) in groups.iter().enumerate() {
            // Each start is advanced to the end of its group, which is the start of the next group;
            // the rotation below restores the starts.
            if let Some(position) =
                starts.get_mut((group as usize).wrapping_sub(part * groups_per_part))
            {
                order[(*position - first) as usize] = n as u32;
                *position += 1;
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
    fn groups_hold_their_numbers_in_rising_order() {
        let (start, order) = sort_by_group(4, [2, 0, 2, 3, 0, 2].into_iter());
        assert_eq!(start, [0, 2, 2, 5, 6]);
        assert_eq!(order, [1, 4, 0, 2, 5, 3]);
        assert_eq!(sort_by_group(2, std::iter::empty()), (vec![0; 3], vec![]));
        assert_eq!(sort_by_group(0, std::iter::empty()), (vec![0], vec![]));
        let (start, order) = sort_by_group(2, [1, 2, 0, 9, 1].into_iter());
        assert_eq!((start, order), (vec![0, 1, 3], vec![2, 0, 4]));
    }

    #[test]
    fn many_numbers_are_grouped_alike_by_any_number_of_threads() {
        let group_of = |n: usize| n * 7919 % 1009 * (n % 3) / 2;
        let sort_with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let pool = pool.build().unwrap();
            pool.install(|| sort_by_group(1009, (0..3 * MIN_PARALLEL_LEN).map(group_of)))
        };
        let (start, order) = sort_with(3);
        assert!(sort_with(1) == (start.clone(), order.clone()));
        for g in 0..1009 {
            let members = &order[start[g] as usize..start[g + 1] as usize];
            assert!(members.iter().all(|&n| group_of(n as usize) == g) && members.is_sorted());
        }
        assert_eq!(start[1009] as usize, order.len());
    }
}

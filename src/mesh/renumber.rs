//! New numbers of the nodes or cells that are kept.

use super::complex::NONE;

/// Returns those of `count` items that are used, each once, in ascending order.
pub fn used_items(count: usize, used: impl IntoIterator<Item = u32>) -> Vec<u32> {
    let mut is_used = vec![false; count];
    used.into_iter()
        .for_each(|item| is_used[item as usize] = true);
    (0..count as u32)
        .filter(|&item| is_used[item as usize])
        .collect()
}

/// Returns for each of `count` items its position in `kept`, or [`NONE`] if it is not kept.
pub fn new_numbers(count: usize, kept: &[u32]) -> Vec<u32> {
    let mut numbers = vec![NONE; count];
    for (number, &item) in (0..).zip(kept) {
        numbers[item as usize] = number;
    }
    numbers
}

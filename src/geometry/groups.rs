//! Numbers sorted by the group that each belongs to.

/// Sorts the numbers from 0 on by their group, given for each in turn. Those of group g are
/// `order[start[g]..start[g + 1]]`, rising.
pub fn grouped(groups: usize, of: impl Iterator<Item = usize> + Clone) -> (Vec<u32>, Vec<u32>) {
    let mut start = vec![0u32; groups + 2];
    let mut count = 0;
    for group in of.clone() {
        start[group + 2] += 1;
        count += 1;
    }
    for i in 2..start.len() {
        start[i] += start[i - 1];
    }
    let mut order = vec![0; count];
    for (n, group) in of.enumerate() {
        // The start of the next group counts up to its place.
        let place = &mut start[group + 1];
        order[*place as usize] = n as u32;
        *place += 1;
    }
    start.pop();
    (start, order)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_group_has_its_own_in_rising_order() {
        let (start, order) = grouped(4, [2, 0, 2, 3, 0, 2].into_iter());
        assert_eq!(start, [0, 2, 2, 5, 6]);
        assert_eq!(order, [1, 4, 0, 2, 5, 3]);
        assert_eq!(grouped(2, std::iter::empty()), (vec![0; 3], vec![]));
    }
}

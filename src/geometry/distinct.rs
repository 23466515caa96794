//! Sorted lists, with and without duplicates.

/// Returns a list in ascending order.
pub fn sorted<T: Ord, L: AsMut<[T]>>(mut items: L) -> L {
    items.as_mut().sort_unstable();
    items
}

/// Returns the different items in ascending order.
pub fn sorted_distinct<T: Ord>(items: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut items: Vec<T> = items.into_iter().collect();
    items.sort_unstable();
    items.dedup();
    items
}

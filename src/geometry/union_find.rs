//! Sets that are united pair by pair.

use crate::parallel::prelude::*;

/// Numbers that one thread looks at in one go.
const CHUNK_LEN: usize = 1 << 16;

/// Sets of numbers that are united pair by pair; the smallest member names a set.
#[derive(Debug, Clone)]
pub struct UnionFind(Vec<u32>);

impl UnionFind {
    /// `count` sets of one number each.
    pub fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    /// The name of the set that holds `i`.
    pub fn find(&mut self, i: u32) -> u32 {
        find(&mut self.0, 0, i)
    }

    /// Unites the sets of `i` and `j`.
    pub fn unite(&mut self, i: u32, j: u32) {
        unite(&mut self.0, 0, i, j);
    }

    /// Unites each number with those that `beside` finds for it, of sets of one number each: what lies
    /// together at the same time.
    pub fn unite_neighbours<I: Iterator<Item = u32>>(&mut self, beside: impl Fn(u32) -> I + Sync) {
        let chunks = self.0.par_chunks_mut(CHUNK_LEN).enumerate();
        let apart: Vec<Vec<[u32; 2]>> = chunks
            .map(|(number, names)| {
                let first = (number * CHUNK_LEN) as u32;
                let own = first..first + names.len() as u32;
                let mut apart = Vec::new();
                for i in own.clone() {
                    for j in beside(i) {
                        match own.contains(&j) {
                            true => unite(names, first, i, j),
                            false => apart.push([i, j]),
                        }
                    }
                }
                apart
            })
            .collect();
        for [i, j] in apart.into_iter().flatten() {
            self.unite(i, j);
        }
    }

    /// For each number the number of its set, sets being numbered in the order of their names; and
    /// how many sets there are.
    pub fn into_labels(mut self) -> (Vec<u32>, usize) {
        let mut count = 0;
        let mut number = vec![u32::MAX; self.0.len()];
        for i in 0..self.0.len() as u32 {
            let name = self.find(i) as usize;
            // A name is the smallest of its set, so it comes first.
            if name as u32 == i {
                number[name] = count;
                count += 1;
            } else {
                number[i as usize] = number[name];
            }
        }
        (number, count as usize)
    }
}

/// The name of the set that holds `i`, among the names of the numbers from `first` on.
fn find(names: &mut [u32], first: u32, i: u32) -> u32 {
    let mut at = (i - first) as usize;
    while names[at] - first != at as u32 {
        names[at] = names[(names[at] - first) as usize];
        at = (names[at] - first) as usize;
    }
    names[at]
}

fn unite(names: &mut [u32], first: u32, i: u32, j: u32) {
    let (i, j) = (find(names, first, i), find(names, first, j));
    names[(i.max(j) - first) as usize] = i.min(j);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_numbered_in_order() {
        let mut sets = UnionFind::new(6);
        sets.unite(5, 1);
        sets.unite(4, 2);
        sets.unite(4, 5);
        assert_eq!(sets.into_labels(), (vec![0, 1, 1, 2, 1, 1], 3));
    }

    #[test]
    fn what_lies_together_is_united_as_pair_by_pair() {
        let count = 3 * CHUNK_LEN as u32 + 17;
        // Steps within and across chunks; each seventh number stays alone.
        let beside = |i: u32| {
            let to = [i + 7, i + 7 * 10_007, i.wrapping_sub(21)];
            to.into_iter()
                .filter(move |&j| !i.is_multiple_of(7) && j < count)
        };
        let (mut at_once, mut by_pairs) = (
            UnionFind::new(count as usize),
            UnionFind::new(count as usize),
        );
        at_once.unite_neighbours(beside);
        for i in 0..count {
            beside(i).for_each(|j| by_pairs.unite(i, j));
        }
        let (numbers, sets) = at_once.into_labels();
        assert_eq!(sets, (count as usize).div_ceil(7) + 6);
        assert!((numbers, sets) == by_pairs.into_labels());
    }
}

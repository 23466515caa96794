//! Union-find: disjoint sets of numbers that are united pair by pair.

use super::NONE;
use crate::parallel::prelude::*;

/// Count of numbers that one thread processes at a time.
const CHUNK_LEN: usize = 1 << 16;

/// Disjoint sets of numbers, united pair by pair. The smallest member of a set represents it.
#[derive(Debug, Clone)]
pub struct UnionFind(Vec<u32>);

impl UnionFind {
    /// Creates `count` sets of one number each.
    pub fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    /// Returns the representative of the set that contains `i`.
    pub fn find(&mut self, i: u32) -> u32 {
        find(&mut self.0, 0, i)
    }

    /// Unites the sets of `i` and `j`.
    pub fn unite(&mut self, i: u32, j: u32) {
        unite(&mut self.0, 0, i, j);
    }

    /// Unites each number with the numbers that `neighbours` returns for it, in parallel. All sets
    /// must have one number before.
    pub fn unite_neighbours<I: Iterator<Item = u32>>(
        &mut self,
        neighbours: impl Fn(u32) -> I + Sync,
    ) {
        let chunks = self.0.par_chunks_mut(CHUNK_LEN).enumerate();
        let cross_pairs: Vec<Vec<[u32; 2]>> = chunks
            .map(|(number, parents)| {
                let first = (number * CHUNK_LEN) as u32;
                let range = first..first + parents.len() as u32;
                let mut cross_pairs = Vec::new();
                for i in range.clone() {
                    for j in neighbours(i) {
                        if range.contains(&j) {
                            unite(parents, first, i, j);
                        } else {
                            cross_pairs.push([i, j]);
                        }
                    }
                }
                cross_pairs
            })
            .collect();
        for [i, j] in cross_pairs.into_iter().flatten() {
            self.unite(i, j);
        }
    }

    /// Returns the label of each number and the count of sets. Sets are labelled from 0 in the
    /// order of their representatives.
    pub fn into_labels(mut self) -> (Vec<u32>, usize) {
        let mut count = 0;
        let mut labels = vec![NONE; self.0.len()];
        for i in 0..self.0.len() as u32 {
            let root = self.find(i) as usize;
            // A representative is the smallest member of its set, so it comes first.
            if root as u32 == i {
                labels[root] = count;
                count += 1;
            } else {
                labels[i as usize] = labels[root];
            }
        }
        (labels, count as usize)
    }
}

/// Returns the representative of the set that contains `i`. `parents` holds the parents of the
/// numbers from `first` on.
fn find(parents: &mut [u32], first: u32, i: u32) -> u32 {
    let mut index = (i - first) as usize;
    while parents[index] - first != index as u32 {
        parents[index] = parents[(parents[index] - first) as usize];
        index = (parents[index] - first) as usize;
    }
    parents[index]
}

fn unite(parents: &mut [u32], first: u32, i: u32, j: u32) {
    let (i, j) = (find(parents, first, i), find(parents, first, j));
    parents[(i.max(j) - first) as usize] = i.min(j);
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
    fn neighbours_are_united_as_pair_by_pair() {
        let count = 3 * CHUNK_LEN as u32 + 17;
        // Steps within and across chunks; each seventh number stays alone.
        let neighbours = |i: u32| {
            let candidates = [i + 7, i + 7 * 10_007, i.wrapping_sub(21)];
            candidates
                .into_iter()
                .filter(move |&j| !i.is_multiple_of(7) && j < count)
        };
        let (mut at_once, mut by_pairs) = (
            UnionFind::new(count as usize),
            UnionFind::new(count as usize),
        );
        at_once.unite_neighbours(neighbours);
        for i in 0..count {
            neighbours(i).for_each(|j| by_pairs.unite(i, j));
        }
        let (numbers, sets) = at_once.into_labels();
        assert_eq!(sets, (count as usize).div_ceil(7) + 6);
        assert!((numbers, sets) == by_pairs.into_labels());
    }
}

//! Those who hold parts of a thing: a group, or one alone, who cannot fail.

use std::convert::Infallible;
use std::ops::Range;

use super::{Alone, Group, share_of};
use crate::files::kept::Kept;

/// Those who hold the parts of a mesh: a group, or one that holds all of it, which cannot fail. All ask the same
/// things in the same order.
pub trait Holders: Sync {
    /// How telling one another may fail.
    type Error;

    /// Which of them this is, from 0.
    fn rank(&self) -> usize;

    /// How many they are.
    fn count(&self) -> usize;

    /// What each of them has, in their order, on all of them.
    ///
    /// # Errors
    /// Those of the others.
    fn told<T: Kept>(&self, what: &str, own: T) -> Result<Vec<T>, Self::Error>;

    /// What each of them has for this one, in their order; `to` has something for each.
    ///
    /// # Errors
    /// Those of the others.
    fn passed<T: Kept>(&self, what: &str, to: Vec<T>) -> Result<Vec<T>, Self::Error>;

    /// Counts of which all have as many, summed up. Each sums up a share of them: nobody gets all that the others
    /// have.
    ///
    /// # Errors
    /// Those of the others.
    fn summed(&self, what: &str, own: Vec<u64>) -> Result<Vec<u64>, Self::Error> {
        let count = self.count();
        let share = |to: usize| own[self.share(own.len(), to)].to_vec();
        let mut from = self.passed(what, (0..count).map(share).collect())?;
        let mut sums = from.pop().unwrap_or_default();
        for other in from {
            sums.iter_mut().zip(other).for_each(|(sum, n)| *sum += n);
        }
        Ok(self.told(what, sums)?.concat())
    }

    /// Which of so many things one of them has to do.
    fn share(&self, things: usize, of: usize) -> Range<usize> {
        share_of(things, of, self.count())
    }

    /// Which of them answers for a node, of so many in the whole.
    fn owner(&self, node: u32, nodes: usize) -> usize {
        (node as usize * self.count() / nodes.max(1)).min(self.count() - 1)
    }
}

impl Holders for Alone {
    type Error = Infallible;

    fn rank(&self) -> usize {
        0
    }

    fn count(&self) -> usize {
        1
    }

    fn told<T: Kept>(&self, _: &str, own: T) -> Result<Vec<T>, Infallible> {
        Ok(vec![own])
    }

    fn passed<T: Kept>(&self, _: &str, to: Vec<T>) -> Result<Vec<T>, Infallible> {
        Ok(to)
    }
}

impl Holders for dyn Group + '_ {
    type Error = crate::Error;

    fn rank(&self) -> usize {
        Group::rank(self)
    }

    fn count(&self) -> usize {
        Group::count(self)
    }

    fn told<T: Kept>(&self, what: &str, own: T) -> crate::Result<Vec<T>> {
        self.all(what, own)
    }

    fn passed<T: Kept>(&self, what: &str, to: Vec<T>) -> crate::Result<Vec<T>> {
        self.pass(what, to)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ranks::shared;

    #[test]
    fn counts_are_summed_up_by_all() {
        for count in [1, 2, 3, 7] {
            for length in [0, 1, 5, 100] {
                let own = |rank: usize| (0..length).map(move |i| (i * (rank + 1)) as u64);
                let sums = shared(count, |group| {
                    group
                        .summed("counts", own(Group::rank(group)).collect())
                        .unwrap()
                });
                let all = (1..=count).sum::<usize>();
                let wanted: Vec<u64> = (0..length).map(|i| (i * all) as u64).collect();
                assert!(sums.iter().all(|sums| *sums == wanted));
            }
        }
        assert_eq!(Alone.summed("counts", vec![3, 4]), Ok(vec![3, 4]));
    }
}

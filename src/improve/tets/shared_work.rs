//! Work on a mesh that several ranks have: each does some of it, and all get all results in order.

use std::ops::Range;

use crate::Result;
use crate::comm::{Comm, SelfComm};
use crate::files::codec::Codec;

/// Smallest number of items that ranks share.
const MIN_SHARED_COUNT: usize = 1 << 12;

/// The ranks that improve the same mesh together.
#[derive(Clone, Copy)]
pub struct SharedWork<'a> {
    comm: &'a dyn Comm,
}

impl<'a> SharedWork<'a> {
    /// Creates the work of one rank, which no other rank shares.
    pub fn alone() -> Self {
        Self { comm: &SelfComm }
    }

    /// Creates the work that the ranks of `comm` share. All of them have the same mesh.
    pub fn among(comm: &'a dyn Comm) -> Self {
        Self { comm }
    }

    /// Returns the results of a search at `count` places in a mesh, in their order. `search` returns
    /// those of a range of the places. `name` names the search if ranks are out of step.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub(super) fn search<T: Codec>(
        self,
        name: &str,
        count: usize,
        search: impl FnOnce(Range<usize>) -> Vec<T>,
    ) -> Result<Vec<T>> {
        if self.comm.size() == 1 || count < MIN_SHARED_COUNT {
            return Ok(search(0..count));
        }
        self.distribute(name, &vec![1; count], search)
    }

    /// Returns the results of local patches, in their order. The work on a patch grows with its
    /// weight. `work_on` returns the results of a range of the patches.
    ///
    /// # Errors
    /// Returns an error if another rank fails.
    pub(super) fn patches<T: Codec>(
        self,
        weights: &[usize],
        work_on: impl FnOnce(Range<usize>) -> Vec<T>,
    ) -> Result<Vec<T>> {
        self.distribute("patches", weights, work_on)
    }

    fn distribute<T: Codec>(
        self,
        name: &str,
        weights: &[usize],
        work_on: impl FnOnce(Range<usize>) -> Vec<T>,
    ) -> Result<Vec<T>> {
        let mut results = Vec::with_capacity(weights.len());
        let work = |range, give: &mut dyn FnMut(T)| {
            work_on(range).into_iter().for_each(give);
            Ok(())
        };
        (self.comm).distribute_weighted(name, weights, work, &mut |result| results.push(result))?;
        Ok(results)
    }
}

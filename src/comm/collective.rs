//! Communicators, and the collective operations on them.

use std::fmt;
use std::ops::Range;

use super::partition_range::{partition_range, weighted_partition_range};
use crate::error::{Error, Result, cause};
use crate::files::codec::{Codec, checksum, encode_to_vec};

/// A group of ranks that work on one job. All of them make the same calls in the same order; `place` names the call,
/// and must be the same on all ranks.
pub trait Comm: Sync {
    /// Returns the number of this rank, from 0.
    fn rank(&self) -> usize;

    /// Returns the number of ranks.
    fn size(&self) -> usize;

    /// Gathers the bytes of all ranks on all ranks, or the error of one of them; `receive` gets the bytes of each rank,
    /// in the order of ranks, and returns `None` if they are not as they should be.
    ///
    /// # Errors
    /// Returns the error of this rank, or else of another one, and [`Error::Job`] if ranks are not at the same place.
    fn all_gather_results(
        &self,
        place: &str,
        own: Result<Vec<u8>>,
        receive: &mut dyn FnMut(Vec<u8>) -> Option<()>,
    ) -> Result<()>;

    /// Sends `to[k]` to rank `k`, and returns what this rank receives of each, in the order of ranks.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    fn all_to_all_bytes(&self, place: &str, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>>;

    /// Tells the other ranks how the job has ended on this one. After that, nothing is exchanged any more.
    ///
    /// # Errors
    /// Returns the error with which this rank, or else another one, ended.
    fn agree_on_end(&self, own: Result<()>) -> Result<()>;

    /// Returns `true` if all ranks know an error, so that only one of them needs to print it.
    fn is_error_shared(&self) -> bool;
}

impl fmt::Debug for dyn Comm + '_ {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "rank {} of {}", self.rank(), self.size())
    }
}

impl dyn Comm + '_ {
    /// Returns `true` if this is the rank that writes and prints.
    pub fn is_root(&self) -> bool {
        self.rank() == 0
    }

    /// Returns the value of each rank, in the order of ranks, on all ranks.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn all_gather<T: Codec>(&self, place: &str, own: T) -> Result<Vec<T>> {
        if self.size() == 1 {
            return Ok(vec![own]);
        }
        let mut all = Vec::with_capacity(self.size());
        self.all_gather_results(place, Ok(encode_to_vec(&own)), &mut |bytes| {
            all.push(bytes);
            Some(())
        })?;
        decode_received(place, all, self.rank(), Some(own))
    }

    /// Sends `to[k]` to rank `k`, and returns the value that this rank receives of each, in the order of ranks.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn all_to_all<T: Codec>(&self, place: &str, to: Vec<T>) -> Result<Vec<T>> {
        if self.size() == 1 {
            return Ok(to);
        }
        let (rank, mut own) = (self.rank(), None);
        let encode = |(to, value): (usize, T)| {
            if to == rank {
                own = Some(value);
                Vec::new()
            } else {
                encode_to_vec(&value)
            }
        };
        let sent = to.into_iter().enumerate().map(encode).collect();
        decode_received(place, self.all_to_all_bytes(place, sent)?, rank, own)
    }

    /// Fetches what other ranks hold. `requests[k]` names what this rank requests of rank `k`, and `select` returns
    /// what a request names. Returns the request to this rank itself, which is not answered, and the answers of all
    /// ranks. `places` name the two exchanges.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn fetch<R: Codec + Default, T: Codec>(
        &self,
        places: [&str; 2],
        requests: Vec<R>,
        select: impl Fn(&R) -> T,
    ) -> Result<(R, Vec<T>)> {
        let mut received = self.all_to_all(places[0], requests)?;
        let own = std::mem::take(&mut received[self.rank()]);
        let answers = received.iter().map(select).collect();
        Ok((own, self.all_to_all(places[1], answers)?))
    }

    /// Returns the elementwise sum of the counts of all ranks, which have equally many. Each rank sums a part of them,
    /// so that no rank receives all counts of all ranks.
    ///
    /// # Errors
    /// Returns the errors of other ranks.
    pub fn all_reduce_sum(&self, place: &str, own: Vec<u64>) -> Result<Vec<u64>> {
        let size = self.size();
        let part = |to: usize| own[partition_range(own.len(), to, size)].to_vec();
        let mut received = self.all_to_all(place, (0..size).map(part).collect())?;
        let mut sums = received.pop().unwrap_or_default();
        for other in received {
            sums.iter_mut().zip(other).for_each(|(sum, n)| *sum += n);
        }
        Ok(self.all_gather(place, sums)?.concat())
    }

    /// Passes the result of each of `parts` parts to `take`, in the order of the parts, on every rank. `work` computes
    /// the results of a range of parts, one after the other; each rank calls it with its own range.
    ///
    /// # Errors
    /// Returns the errors of the work, on whichever rank, and [`Error::Job`] if ranks are not at the same place.
    pub fn distribute<T: Codec>(
        &self,
        place: &str,
        parts: usize,
        work: impl FnOnce(Range<usize>, &mut dyn FnMut(T)) -> Result<()>,
        take: &mut dyn FnMut(T),
    ) -> Result<()> {
        let own = partition_range(parts, self.rank(), self.size());
        self.distribute_range(place, parts, own, work, take)
    }

    /// Passes the result of each part to `take` as `distribute` does, where parts are unequal:
    /// each part has a weight, and ranks have about the same total weight.
    ///
    /// # Errors
    /// Returns errors as `distribute` does.
    pub fn distribute_weighted<T: Codec>(
        &self,
        place: &str,
        weights: &[usize],
        work: impl FnOnce(Range<usize>, &mut dyn FnMut(T)) -> Result<()>,
        take: &mut dyn FnMut(T),
    ) -> Result<()> {
        let own = weighted_partition_range(weights, self.rank(), self.size());
        self.distribute_range(place, weights.len(), own, work, take)
    }

    fn distribute_range<T: Codec>(
        &self,
        place: &str,
        parts: usize,
        own: Range<usize>,
        work: impl FnOnce(Range<usize>, &mut dyn FnMut(T)) -> Result<()>,
        take: &mut dyn FnMut(T),
    ) -> Result<()> {
        if self.size() == 1 {
            return work(own, take);
        }
        let mut bytes = Vec::new();
        // Writing to memory cannot fail.
        let done = work(own, &mut |value| {
            value.encode(&mut bytes).unwrap_or_default()
        });
        self.all_gather_results(
            &format!("{place} ({parts})"),
            done.map(|()| bytes),
            &mut |bytes| {
                let from = &mut &bytes[..];
                while !from.is_empty() {
                    take(T::decode(from)?);
                }
                Some(())
            },
        )
    }

    /// Returns the root's value on every rank; `make` is called on the root only.
    ///
    /// # Errors
    /// Returns the errors of `make`, and errors as `distribute` does.
    pub fn broadcast_from_root<T: Codec>(
        &self,
        place: &str,
        make: impl FnOnce() -> Result<T>,
    ) -> Result<T> {
        if self.size() == 1 {
            return make();
        }
        let mut bytes = Vec::new();
        let made = if self.is_root() {
            make().map(|value| value.encode(&mut bytes).unwrap_or_default())
        } else {
            Ok(())
        };
        let mut value = None;
        self.all_gather_results(place, made.map(|()| bytes), &mut |bytes| {
            if !bytes.is_empty() {
                value = Some(T::decode(&mut &bytes[..])?);
            }
            Some(())
        })?;
        value.ok_or_else(|| out_of_step_error(place, self.rank()))
    }

    /// Makes sure that all ranks have the same value. They must, but processors of different kinds may round
    /// differently.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if they have not.
    pub fn ensure_identical<T: Codec>(&self, place: &str, value: &T) -> Result<()> {
        if self.size() == 1 {
            return Ok(());
        }
        let sum = checksum(value).unwrap_or_default();
        let place = format!("{place}, {sum:x?}");
        self.all_gather_results(&place, Ok(Vec::new()), &mut |_| Some(()))
    }

    /// Ends the job on this rank, before the files that it wrote take their names: `ended` is a success only if all
    /// other ranks succeed.
    ///
    /// # Errors
    /// Returns the error with which this rank, or else another one, ended.
    pub fn finish<T>(&self, ended: Result<T>) -> Result<T> {
        match ended {
            Ok(value) => self.agree_on_end(Ok(())).map(|()| value),
            Err(error) => {
                self.agree_on_end(Err(error))?;
                Err(out_of_step_error("the end", self.rank()))
            }
        }
    }
}

/// Decodes what was received of each rank; this rank's own value is not decoded.
fn decode_received<T: Codec>(
    place: &str,
    all: Vec<Vec<u8>>,
    rank: usize,
    mut own: Option<T>,
) -> Result<Vec<T>> {
    let value = |(from, bytes): (usize, Vec<u8>)| {
        if from == rank {
            own.take()
        } else {
            T::decode(&mut &bytes[..])
        }
    };
    let values = all.into_iter().enumerate().map(value);
    values
        .map(|value| value.ok_or_else(|| out_of_step_error(place, rank)))
        .collect()
}

/// Returns the error of ranks that are not at the same place.
pub(super) fn out_of_step_error(place: &str, rank: usize) -> Error {
    Error::Job(cause(
        format!("rank {rank}, {place}"),
        "other ranks are elsewhere in the job, or have other results",
        "start the same program with the same arguments, files and kind of processor on all machines",
    ))
}

/// Concatenates lists. A single list is not copied.
pub fn concatenate<T>(mut lists: Vec<Vec<T>>) -> Vec<T> {
    match lists.len() {
        1 => lists.pop().unwrap_or_default(),
        _ => lists.into_iter().flatten().collect(),
    }
}

/// A group of one, whose communication never fails.
pub struct SelfComm;

impl SelfComm {
    /// Message for [`Result::expect`], for work whose only errors are those of communication.
    pub const NEVER_FAILS: &str = "a group of one communicates without errors";
}

impl Comm for SelfComm {
    fn rank(&self) -> usize {
        0
    }

    fn size(&self) -> usize {
        1
    }

    fn all_gather_results(
        &self,
        place: &str,
        own: Result<Vec<u8>>,
        receive: &mut dyn FnMut(Vec<u8>) -> Option<()>,
    ) -> Result<()> {
        receive(own?).ok_or_else(|| out_of_step_error(place, 0))
    }

    fn all_to_all_bytes(&self, _: &str, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>> {
        Ok(to)
    }

    fn agree_on_end(&self, own: Result<()>) -> Result<()> {
        own
    }

    fn is_error_shared(&self) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::run_threads;

    #[test]
    fn each_rank_receives_what_is_for_it_and_what_is_for_all() {
        for size in [1, 2, 5] {
            let received = run_threads(size, |comm| {
                let own = comm.rank();
                let all = comm.all_gather("numbers", own).unwrap();
                let to: Vec<String> = (0..size).map(|to| format!("{own} to {to}")).collect();
                (all, comm.all_to_all("words", to).unwrap())
            });
            for (rank, (all, words)) in received.into_iter().enumerate() {
                assert!(all.into_iter().eq(0..size));
                let expected = (0..size).map(|from| format!("{from} to {rank}"));
                assert!(words.into_iter().eq(expected));
            }
        }
        let alone: &dyn Comm = &SelfComm;
        assert_eq!(alone.all_to_all("numbers", vec![7usize]).unwrap(), [7]);
    }

    #[test]
    fn counts_are_summed_up_by_all() {
        for size in [1, 2, 3, 7] {
            for length in [0, 1, 5, 100] {
                let own = |rank: usize| (0..length).map(move |i| (i * (rank + 1)) as u64);
                let sums = run_threads(size, |comm| {
                    let own = own(comm.rank()).collect();
                    comm.all_reduce_sum("counts", own).unwrap()
                });
                let all = (1..=size).sum::<usize>();
                let wanted: Vec<u64> = (0..length).map(|i| (i * all) as u64).collect();
                assert!(sums.iter().all(|sums| *sums == wanted));
            }
        }
    }

    #[test]
    fn distributed_parts_come_in_order_on_every_rank() {
        let check = |comm: &dyn Comm| {
            let work = |own: Range<usize>, give: &mut dyn FnMut(usize)| {
                own.for_each(|part| give(10 * part));
                Ok(())
            };
            let mut taken = Vec::new();
            let take = &mut |value| taken.push(value);
            comm.distribute("parts", 4, work, take).unwrap();
            let weights = [1, 5, 1, 1];
            comm.distribute_weighted("weighted parts", &weights, work, take)
                .unwrap();
            assert_eq!(taken, [0, 10, 20, 30, 0, 10, 20, 30]);
            let root_rank = comm.broadcast_from_root("rank", || Ok(comm.rank()));
            assert_eq!(root_rank.unwrap(), 0);
        };
        check(&SelfComm);
        for size in [1, 2, 3, 6] {
            run_threads(size, check);
        }
    }
}

//! The communicator of all ranks of MPI.

use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::collective::{Comm, out_of_step_error};
use super::world::World;
use crate::error::{Error, Result, cause};
use crate::files::codec::Codec;

/// Results of at most this many bytes, all ranks together, are gathered by one call.
const MAX_GATHER_BYTES: usize = 1 << 16;

/// All ranks of MPI, on top of the calls that [`World`] offers.
///
/// Before ranks exchange anything, they exchange headers: where in the job each is, and whether it has failed. If a
/// rank has failed, all ranks return its error. After that, and after [`Comm::agree_on_end`], nothing is exchanged
/// any more, because other ranks may be gone.
pub struct MpiComm<'a> {
    world: Mutex<Box<dyn World + 'a>>,
    rank: usize,
    size: usize,
    /// `true` at the end of the job: nothing is exchanged any more.
    is_closed: AtomicBool,
    /// `true` if all ranks know an error.
    is_error_shared: AtomicBool,
}

impl<'a> MpiComm<'a> {
    /// Returns the communicator of these processes. They leave MPI when it is dropped.
    pub fn new(world: Box<dyn World + 'a>) -> Self {
        Self {
            rank: world.rank(),
            size: world.size(),
            world: Mutex::new(world),
            is_closed: AtomicBool::new(false),
            is_error_shared: AtomicBool::new(false),
        }
    }

    fn world(&self) -> MutexGuard<'_, Box<dyn World + 'a>> {
        self.world.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends the exchange, because all ranks return an error.
    fn close_with_error(&self) {
        self.is_closed.store(true, Relaxed);
        self.is_error_shared.store(true, Relaxed);
    }
}

impl Comm for MpiComm<'_> {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.size
    }

    fn all_gather_results(
        &self,
        place: &str,
        own: Result<Vec<u8>>,
        receive: &mut dyn FnMut(Vec<u8>) -> Option<()>,
    ) -> Result<()> {
        if self.is_closed.load(Relaxed) {
            return own.map(|_| ());
        }
        let (failed, mut bytes, own_error) = match own {
            Ok(bytes) => (false, bytes, None),
            Err(error) => {
                let (mut bytes, why) = (Vec::new(), error.cause());
                for text in [&why.place, &why.problem, &why.remedy] {
                    text.encode(&mut bytes).unwrap_or_default();
                }
                (true, bytes, Some(error))
            }
        };
        let header = [place_hash(place), u64::from(failed), bytes.len() as u64];
        let headers = self.world().all_gather_headers(header);
        let out_of_step = || out_of_step_error(place, self.rank);
        if let Some(failed) = headers.iter().position(|header| header[1] != 0) {
            self.close_with_error();
            let mut words = vec![0; headers[failed][2] as usize];
            if failed == self.rank {
                words = bytes;
            }
            self.world().broadcast(failed, &mut words);
            let texts: Option<[String; 3]> = Codec::decode(&mut &words[..]);
            return Err(match (own_error, texts) {
                (Some(own), _) => own,
                (None, Some([place, problem, remedy])) => {
                    Error::Job(cause(format!("rank {failed}: {place}"), problem, remedy))
                }
                (None, None) => out_of_step(),
            });
        }
        if headers.iter().any(|header| header[0] != headers[0][0]) {
            self.close_with_error();
            return Err(out_of_step());
        }
        let lengths: Vec<usize> = headers.iter().map(|header| header[2] as usize).collect();
        if lengths.iter().sum::<usize>() <= MAX_GATHER_BYTES {
            let all = self.world().all_gather(&bytes, &lengths);
            let mut rest = &all[..];
            for length in lengths {
                let (received, after) = rest.split_at(length);
                rest = after;
                receive(received.to_vec()).ok_or_else(out_of_step)?;
            }
            return Ok(());
        }
        for (from, length) in lengths.into_iter().enumerate() {
            let mut received = if from == self.rank {
                std::mem::take(&mut bytes)
            } else {
                vec![0; length]
            };
            self.world().broadcast(from, &mut received);
            receive(received).ok_or_else(out_of_step)?;
        }
        Ok(())
    }

    fn all_to_all_bytes(&self, place: &str, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>> {
        if self.size == 1 {
            return Ok(to);
        }
        // Each rank lists for which ranks it has how many bytes. This also makes sure that all ranks are here, and
        // that none has failed.
        let sent = to.iter().map(Vec::len).enumerate();
        let sent: Vec<(usize, usize)> = sent.filter(|(_, length)| *length > 0).collect();
        let sent: Vec<Vec<(usize, usize)>> = (self as &dyn Comm).all_gather(place, sent)?;
        let length_for_this = |sent: &Vec<(usize, usize)>| {
            let mut sent = sent.iter();
            sent.find(|(to, _)| *to == self.rank)
                .map_or(0, |(_, length)| *length)
        };
        let lengths: Vec<usize> = sent.iter().map(length_for_this).collect();
        Ok(self.world().all_to_all(&to, &lengths))
    }

    fn agree_on_end(&self, own: Result<()>) -> Result<()> {
        if self.size == 1 || self.is_closed.load(Relaxed) {
            return own;
        }
        let own = own.map(|()| Vec::new());
        let all = self.all_gather_results("the end", own, &mut |_| Some(()));
        self.is_closed.store(true, Relaxed);
        all
    }

    fn is_error_shared(&self) -> bool {
        self.is_error_shared.load(Relaxed)
    }
}

/// Returns a number for a place in the job.
fn place_hash(place: &str) -> u64 {
    use crate::geometry::random::splitmix64;
    place
        .bytes()
        .fold(0, |key, byte| splitmix64(key ^ u64::from(byte)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::run_threads;

    fn error(problem: &str) -> Error {
        Error::Job(cause("the work", problem, "give up"))
    }

    #[test]
    fn results_of_any_length_come_in_the_order_of_ranks() {
        for length in [0, 100, MAX_GATHER_BYTES] {
            let all = run_threads(3, |comm| {
                let (mut all, own) = (Vec::new(), vec![comm.rank() as u8; length]);
                comm.all_gather_results("numbers", Ok(own), &mut |bytes| {
                    all.push(bytes);
                    Some(())
                })
                .unwrap();
                all
            });
            let expected: Vec<Vec<u8>> = (0..3).map(|rank| vec![rank; length]).collect();
            assert!(all.into_iter().all(|all| all == expected));
        }
    }

    #[test]
    fn the_error_of_one_rank_is_the_error_of_all() {
        let errors = run_threads(3, |comm| {
            let work = |own: std::ops::Range<usize>, give: &mut dyn FnMut(usize)| {
                if own.contains(&2) {
                    return Err(error("has failed"));
                }
                own.for_each(give);
                Ok(())
            };
            let done = comm.distribute("parts", 6, work, &mut |_| ());
            assert!(comm.is_error_shared());
            // Then nothing is exchanged any more.
            let ended = comm.finish(done).unwrap_err();
            ended.to_string()
        });
        assert_eq!(errors[1], error("has failed").to_string());
        let elsewhere = Error::Job(cause("rank 1: the work", "has failed", "give up"));
        for rank in [0, 2] {
            assert_eq!(errors[rank], elsewhere.to_string());
        }
    }

    #[test]
    fn ranks_at_different_places_or_with_different_results_are_an_error() {
        let ended = run_threads(2, |comm| comm.ensure_identical("rank", &comm.rank()));
        assert!(ended.iter().all(Result::is_err));
        let ended = run_threads(2, |comm| {
            let place = if comm.is_root() { "first" } else { "second" };
            comm.all_gather(place, 1_usize)
        });
        assert!(ended.iter().all(Result::is_err));
        let ended = run_threads(2, |comm| comm.ensure_identical("number", &7_usize));
        assert!(ended.iter().all(Result::is_ok));
    }

    #[test]
    fn the_end_is_agreed_on() {
        let ended = run_threads(3, |comm| comm.finish(Ok(comm.rank())).unwrap());
        assert_eq!(ended, [0, 1, 2]);
        let ended = run_threads(3, |comm| match comm.rank() {
            0 => comm.finish(Err::<(), _>(error("is full"))),
            _ => comm.finish(Ok(())),
        });
        assert!(ended.iter().all(Result::is_err));
    }
}

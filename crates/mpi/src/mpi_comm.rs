//! MPI, as the processes among which atomesh shares a job.

use atomesh::cli::world::World;
use atomesh::error::{Error, Result, cause};
use mpi::Threading;
use mpi::datatype::PartitionMut;
use mpi::environment::Universe;
use mpi::traits::{Communicator, CommunicatorCollectives, Destination, Root, Source};

/// Most bytes that one call sends: MPI counts them with 31 bits.
const MAX_BYTES_PER_CALL: usize = 1 << 28;

/// All processes that `mpirun` has started. MPI ends when it is dropped.
struct MpiComm(Universe);

/// Joins the other processes.
///
/// # Errors
/// [`Error::Job`] if MPI does not start.
pub fn join() -> Result<Box<dyn World>> {
    let refuse = |problem: &str| {
        let remedy = "start it with the mpirun of the MPI library that it was built with";
        Error::Job(cause("MPI", problem, remedy))
    };
    let (universe, threading) = mpi::initialize_with_threading(Threading::Serialized)
        .ok_or_else(|| refuse("was joined before"))?;
    if threading < Threading::Serialized {
        return Err(refuse(
            "does not take calls from other threads than the first",
        ));
    }
    Ok(Box::new(MpiComm(universe)))
}

impl World for MpiComm {
    fn rank(&self) -> usize {
        self.0.world().rank() as usize
    }

    fn size(&self) -> usize {
        self.0.world().size() as usize
    }

    fn all_gather_headers(&self, own: [u64; 3]) -> Vec<[u64; 3]> {
        let mut all = vec![[0u64; 3]; self.size()];
        (self.0.world()).all_gather_into(&own[..], all.as_flattened_mut());
        all
    }

    fn all_gather(&self, own: &[u8], lengths: &[usize]) -> Vec<u8> {
        let mut all = vec![0; lengths.iter().sum()];
        if all.is_empty() {
            return all;
        }
        let counts: Vec<i32> = lengths.iter().map(|&length| length as i32).collect();
        let begins = counts.iter().scan(0, |sum, count| {
            let begin = *sum;
            *sum += count;
            Some(begin)
        });
        let begins: Vec<i32> = begins.collect();
        let mut parts = PartitionMut::new(&mut all[..], counts, begins);
        (self.0.world()).all_gather_varcount_into(own, &mut parts);
        all
    }

    fn broadcast(&self, root: usize, bytes: &mut [u8]) {
        let world = self.0.world();
        for part in bytes.chunks_mut(MAX_BYTES_PER_CALL) {
            world.process_at_rank(root as i32).broadcast_into(part);
        }
    }

    /// Exchanges with two others at a time, since all at once is more than some networks take.
    fn all_to_all(&self, to: &[Vec<u8>], lengths: &[usize]) -> Vec<Vec<u8>> {
        let (world, own, count) = (self.0.world(), self.rank(), self.size());
        let mut received: Vec<Vec<u8>> = vec![Vec::new(); count];
        received[own].clone_from(&to[own]);
        for step in 1..count {
            let (next, before) = ((own + step) % count, (own + count - step) % count);
            let (sent, got) = (&to[next], &mut received[before]);
            got.resize(lengths[before], 0);
            let parts = sent.len().max(got.len()).div_ceil(MAX_BYTES_PER_CALL);
            let (mut sent, mut got) = (
                sent.chunks(MAX_BYTES_PER_CALL),
                got.chunks_mut(MAX_BYTES_PER_CALL),
            );
            for _ in 0..parts {
                mpi::request::scope(|scope| {
                    let next = world.process_at_rank(next as i32);
                    let sending = sent.next().map(|part| next.immediate_send(scope, part));
                    if let Some(part) = got.next() {
                        world.process_at_rank(before as i32).receive_into(part);
                    }
                    if let Some(sending) = sending {
                        sending.wait_without_status();
                    }
                });
            }
        }
        received
    }
}

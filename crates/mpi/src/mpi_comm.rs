//! Implements the communicator of atomesh by MPI.

use atomesh::cli::world::World;
use atomesh::error::{Error, Result, cause};
use mpi::Threading;
use mpi::datatype::PartitionMut;
use mpi::environment::Universe;
use mpi::traits::{Communicator, CommunicatorCollectives, Destination, Root, Source};

/// Maximum number of bytes in one call, since MPI counts bytes with 31 bits.
const MAX_BYTES_PER_CALL: usize = 1 << 28;

/// All processes that `mpirun` has started. MPI is finalised when the value is dropped.
struct MpiWorld(Universe);

/// Starts MPI and returns the communicator of all processes.
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
    Ok(Box::new(MpiWorld(universe)))
}

impl World for MpiWorld {
    fn rank(&self) -> usize {
        self.0.world().rank() as usize
    }

    fn size(&self) -> usize {
        self.0.world().size() as usize
    }

    fn all_gather_headers(&self, local: [u64; 3]) -> Vec<[u64; 3]> {
        let mut gathered = vec![[0u64; 3]; self.size()];
        (self.0.world()).all_gather_into(&local[..], gathered.as_flattened_mut());
        gathered
    }

    fn all_gather(&self, local: &[u8], lengths: &[usize]) -> Vec<u8> {
        let mut gathered = vec![0; lengths.iter().sum()];
        if gathered.is_empty() {
            return gathered;
        }
        let counts: Vec<i32> = lengths.iter().map(|&length| length as i32).collect();
        let offsets = counts.iter().scan(0, |sum, count| {
            let offset = *sum;
            *sum += count;
            Some(offset)
        });
        let offsets: Vec<i32> = offsets.collect();
        let mut parts = PartitionMut::new(&mut gathered[..], counts, offsets);
        (self.0.world()).all_gather_varcount_into(local, &mut parts);
        gathered
    }

    fn broadcast(&self, root: usize, bytes: &mut [u8]) {
        let world = self.0.world();
        for part in bytes.chunks_mut(MAX_BYTES_PER_CALL) {
            world.process_at_rank(root as i32).broadcast_into(part);
        }
    }

    /// Exchanges with two other ranks at a time, since some networks fail if all ranks exchange at
    /// once.
    fn all_to_all(&self, outgoing: &[Vec<u8>], lengths: &[usize]) -> Vec<Vec<u8>> {
        let (world, rank, count) = (self.0.world(), self.rank(), self.size());
        let mut received: Vec<Vec<u8>> = vec![Vec::new(); count];
        received[rank].clone_from(&outgoing[rank]);
        for step in 1..count {
            let (next, previous) = ((rank + step) % count, (rank + count - step) % count);
            let (outgoing_chunks, incoming) = (&outgoing[next], &mut received[previous]);
            incoming.resize(lengths[previous], 0);
            let parts = outgoing_chunks
                .len()
                .max(incoming.len())
                .div_ceil(MAX_BYTES_PER_CALL);
            let (mut outgoing_chunks, mut incoming) = (
                outgoing_chunks.chunks(MAX_BYTES_PER_CALL),
                incoming.chunks_mut(MAX_BYTES_PER_CALL),
            );
            for _ in 0..parts {
                mpi::request::scope(|scope| {
                    let next = world.process_at_rank(next as i32);
                    let sending = outgoing_chunks
                        .next()
                        .map(|part| next.immediate_send(scope, part));
                    if let Some(part) = incoming.next() {
                        world.process_at_rank(previous as i32).receive_into(part);
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

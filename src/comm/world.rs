//! The processes that share a job, as the program that joined them passes them in.

use super::launch::{is_mpi_launch, launcher_size};
use super::{Comm, MpiComm, SelfComm};
use crate::error::{Error, Result, cause};

/// Processes that share a job, and what they can send one another. All of them make the same calls in the
/// same order.
pub trait World: Send {
    /// Returns the number of this process, from 0.
    fn rank(&self) -> usize;

    /// Returns the number of processes.
    fn size(&self) -> usize;

    /// Gathers three numbers of each process, on all of them.
    fn all_gather_headers(&self, own: [u64; 3]) -> Vec<[u64; 3]>;

    /// Gathers the bytes of all processes, one after the other, on all of them. `lengths` are their numbers of
    /// bytes.
    fn all_gather(&self, own: &[u8], lengths: &[usize]) -> Vec<u8>;

    /// Sends the bytes of the process `root` to all others, whose `bytes` have the same length.
    fn broadcast(&self, root: usize, bytes: &mut [u8]);

    /// Sends `to[k]` to the process `k`, and returns what this one receives of each: `lengths[k]` bytes of
    /// the process `k`. Two processes that have nothing for one another need not communicate.
    fn all_to_all(&self, to: &[Vec<u8>], lengths: &[usize]) -> Vec<Vec<u8>>;
}

/// Joins the other processes of the job.
pub type JoinFn = fn() -> Result<Box<dyn World>>;

/// Joins the other processes with `join`, which is `None` in a program without MPI. Returns the communicator of all
/// processes, or [`SelfComm`] if this process was not started by the launcher of MPI.
///
/// # Errors
/// Returns [`Error::Job`] if several processes were started and cannot be joined.
pub(crate) fn join_world(join: Option<JoinFn>) -> Result<Box<dyn Comm>> {
    if !is_mpi_launch() {
        return Ok(Box::new(SelfComm));
    }
    let several = launcher_size().is_some_and(|size| size > 1);
    let Some(join) = join else {
        if several {
            return Err(Error::Job(cause(
                "MPI",
                "this program was built without it, and each rank would do the same",
                "start atomesh-mpi instead (cargo build --release -p atomesh-mpi), or leave mpirun out",
            )));
        }
        return Ok(Box::new(SelfComm));
    };
    let comm = MpiComm::new(join()?);
    if comm.size() == 1 && several {
        return Err(Error::Job(cause(
            "MPI",
            "finds no other rank, though several were started",
            "start it with the mpirun of the MPI library that it was built with",
        )));
    }
    Ok(Box::new(comm))
}

//! The processes that share a job, as the program that joined them passes them in.

use std::sync::{Mutex, OnceLock, PoisonError};

use super::{is_mpi_launch, launcher_size};
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

/// The other processes, until this one has told them that it ends.
static WORLD: Mutex<Option<Box<dyn World>>> = Mutex::new(None);
/// This process's number, and how many there are.
static RANK_AND_SIZE: OnceLock<[usize; 2]> = OnceLock::new();
/// How the program joins other processes, if it can.
static JOIN: OnceLock<Option<JoinFn>> = OnceLock::new();

/// Says how the program joins other processes.
pub fn set_join(join: Option<JoinFn>) {
    let _ = JOIN.set(join);
}

/// Returns whether the program can join other processes.
pub fn can_join() -> bool {
    JOIN.get().is_some_and(Option::is_some)
}

/// Joins the other processes, if there are any.
///
/// # Errors
/// [`Error::Job`] if several were started and cannot be joined.
pub fn join() -> Result<()> {
    if !is_mpi_launch() {
        return Ok(());
    }
    let several = launcher_size().is_some_and(|size| size > 1);
    let Some(join) = JOIN.get().copied().flatten() else {
        if several {
            return Err(Error::Job(cause(
                "MPI",
                "this program was built without it, and each rank would do the same",
                "start atomesh-mpi instead (cargo build --release -p atomesh-mpi), or leave mpirun out",
            )));
        }
        return Ok(());
    };
    let world = join()?;
    let place = [world.rank(), world.size()];
    if place[1] == 1 && several {
        return Err(Error::Job(cause(
            "MPI",
            "finds no other rank, though several were started",
            "start it with the mpirun of the MPI library that it was built with",
        )));
    }
    let _ = RANK_AND_SIZE.set(place);
    *lock() = Some(world);
    Ok(())
}

fn lock() -> std::sync::MutexGuard<'static, Option<Box<dyn World>>> {
    WORLD.lock().unwrap_or_else(PoisonError::into_inner)
}

/// This process's number.
pub fn rank() -> usize {
    RANK_AND_SIZE.get().map_or(0, |place| place[0])
}

/// How many there are.
pub fn size() -> usize {
    RANK_AND_SIZE.get().map_or(1, |place| place[1])
}

/// [`World::all_gather_headers`].
pub fn all_gather_headers(own: [u64; 3]) -> Vec<[u64; 3]> {
    lock()
        .as_ref()
        .map_or_else(|| vec![own], |world| world.all_gather_headers(own))
}

/// [`World::all_gather`].
pub fn all_gather(own: &[u8], lengths: &[usize]) -> Vec<u8> {
    lock()
        .as_ref()
        .map_or_else(|| own.to_vec(), |world| world.all_gather(own, lengths))
}

/// [`World::broadcast`].
pub fn broadcast(root: usize, bytes: &mut [u8]) {
    if let Some(world) = &*lock() {
        world.broadcast(root, bytes);
    }
}

/// [`World::all_to_all`].
pub fn all_to_all(to: &[Vec<u8>], lengths: &[usize]) -> Vec<Vec<u8>> {
    lock()
        .as_ref()
        .map_or_else(|| to.to_vec(), |world| world.all_to_all(to, lengths))
}

/// Ends this process's part in the job, after which no other hears of it.
pub fn leave() {
    drop(lock().take());
}

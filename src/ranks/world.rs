//! MPI itself.

use std::sync::{Mutex, OnceLock, PoisonError};

use mpi::Threading;
use mpi::environment::Universe;
use mpi::point_to_point::send_receive_into;
use mpi::traits::{Communicator, CommunicatorCollectives, Root};

use super::{launched, size_said};
use crate::error::{Error, Result, cause};

/// Bytes or numbers that are passed on at once: MPI counts them with 31 bits.
const AT_ONCE: usize = 1 << 28;

/// MPI is there until the process has told the others that it ends.
static UNIVERSE: Mutex<Option<Universe>> = Mutex::new(None);
/// This process's number, and how many there are.
static PLACE: OnceLock<[usize; 2]> = OnceLock::new();

/// Joins the other processes, if there are any.
pub fn join() -> Result<()> {
    if !launched() {
        return Ok(());
    }
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
    let world = universe.world();
    let place = [world.rank() as usize, world.size() as usize];
    if place[1] == 1 && size_said().is_some_and(|said| said > 1) {
        return Err(refuse("finds no other rank, though several were started"));
    }
    let _ = PLACE.set(place);
    *UNIVERSE.lock().unwrap_or_else(PoisonError::into_inner) = Some(universe);
    Ok(())
}

/// This process's number.
pub fn rank() -> usize {
    PLACE.get().map_or(0, |place| place[0])
}

/// How many there are.
pub fn size() -> usize {
    PLACE.get().map_or(1, |place| place[1])
}

/// The heads of what all ranks have to tell.
pub fn heads(own: [u64; 3]) -> Vec<[u64; 3]> {
    let mut all = vec![[0u64; 3]; size()];
    let universe = UNIVERSE.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(universe) = &*universe {
        universe
            .world()
            .all_gather_into(&own[..], all.as_flattened_mut());
    }
    all
}

/// Gives what a rank has to all others, which have room for it.
pub fn broadcast(from: usize, bytes: &mut [u8]) {
    let universe = UNIVERSE.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(universe) = &*universe {
        let (world, from) = (universe.world(), from as i32);
        for part in bytes.chunks_mut(AT_ONCE) {
            world.process_at_rank(from).broadcast_into(part);
        }
    }
}

/// What each rank has for this one; `to` has something for each, and `much` says how many bytes each has for each.
/// Two at a time: all to all at once is more than some networks take where there is much.
pub fn pass(to: &[Vec<u8>], much: &[Vec<usize>]) -> Vec<Vec<u8>> {
    let mut heard: Vec<Vec<u8>> = vec![Vec::new(); size()];
    let universe = UNIVERSE.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(universe) = &*universe else {
        return heard;
    };
    let (world, own, count) = (universe.world(), rank(), size());
    heard[own].clone_from(&to[own]);
    let most = much.iter().flatten().copied().max().unwrap_or(0);
    for step in 1..count {
        let (next, before) = ((own + step) % count, (own + count - step) % count);
        let (sent, got) = (&to[next], &mut heard[before]);
        got.resize(much[before][own], 0);
        // All go as often, some with nothing.
        for from in (0..most).step_by(AT_ONCE) {
            let now = |all: usize| all.min(from)..all.min(from + AT_ONCE);
            let all = got.len();
            send_receive_into(
                &sent[now(sent.len())],
                &world.process_at_rank(next as i32),
                &mut got[now(all)],
                &world.process_at_rank(before as i32),
            );
        }
    }
    heard
}

/// MPI's own end, after which no rank hears of this one.
pub fn leave() {
    drop(
        UNIVERSE
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take(),
    );
}

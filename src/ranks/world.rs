//! MPI itself.

use std::sync::{Mutex, OnceLock, PoisonError};

use mpi::Threading;
use mpi::datatype::PartitionMut;
use mpi::environment::Universe;
use mpi::traits::{Communicator, CommunicatorCollectives, Destination, Root, Source};

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

/// What all ranks have, one after the other: so many bytes each.
pub fn gather(own: &[u8], lengths: &[usize]) -> Vec<u8> {
    let mut all = vec![0; lengths.iter().sum()];
    let universe = UNIVERSE.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(universe) = &*universe
        && !all.is_empty()
    {
        let counts: Vec<i32> = lengths.iter().map(|&length| length as i32).collect();
        let begins = counts.iter().scan(0, |sum, count| {
            let begin = *sum;
            *sum += count;
            Some(begin)
        });
        let begins: Vec<i32> = begins.collect();
        let mut parts = PartitionMut::new(&mut all[..], counts, begins);
        (universe.world()).all_gather_varcount_into(own, &mut parts);
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

/// What each rank has for this one, so many `bytes`; `to` has something for each. Two at a time: all to all at once is
/// more than some networks take where there is much. Those who have nothing for one another are left alone.
pub fn pass(to: &[Vec<u8>], bytes: &[usize]) -> Vec<Vec<u8>> {
    let mut heard: Vec<Vec<u8>> = vec![Vec::new(); size()];
    let universe = UNIVERSE.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(universe) = &*universe else {
        return heard;
    };
    let (world, own, count) = (universe.world(), rank(), size());
    heard[own].clone_from(&to[own]);
    for step in 1..count {
        let (next, before) = ((own + step) % count, (own + count - step) % count);
        let (sent, got) = (&to[next], &mut heard[before]);
        got.resize(bytes[before], 0);
        let parts = sent.len().max(got.len()).div_ceil(AT_ONCE);
        let (mut sent, mut got) = (sent.chunks(AT_ONCE), got.chunks_mut(AT_ONCE));
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

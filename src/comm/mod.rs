//! Processes that share a job: the ranks of MPI, where the program is `atomesh-mpi`.
//!
//! Every rank runs the whole job. Where work is in parts (windows of an image's layers, slabs of points), each
//! does its [`partition`], and all have the results of all, in the order of the parts: so whatever is made of them
//! is the same on every rank, and for any number of ranks the same as of a single process. Where no rank needs all,
//! each holds its part, and tells others what they need of it ([`Comm`]). What only one must do or say is the first
//! one's.
//!
//! Before they pass on anything, ranks tell one another where they are and whether one has failed: then all end
//! with its error.
//!
//! - `group`: those who each hold a part of one thing
//! - `holders`: a group, or one alone, where the same is done by either
//! - `order`: values by their rank among those that several have
//! - `world`: the other processes, as the program passes them in

mod collective;
mod local_or_comm;
pub(crate) mod selection;
pub mod world;

use std::ops::Range;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;

use crate::error::{Error, Result, cause};
use crate::files::codec::{self, Codec};

#[cfg(test)]
pub(crate) use collective::tests::run_threads;
pub use collective::{Comm, SelfComm, WorldComm, concatenate};
pub use local_or_comm::LocalOrComm;

/// So many bytes of all ranks are told at once.
const MAX_GATHER_BYTES: usize = 1 << 16;

/// Nothing is told any more: the job is at its end.
static IS_CLOSED: AtomicBool = AtomicBool::new(false);
/// All ranks know of an error.
static IS_ERROR_SHARED: AtomicBool = AtomicBool::new(false);

/// Whether `mpirun` (of Open MPI, or of MPICH and its like) or Slurm's `srun` has started this process for MPI.
fn is_mpi_launch() -> bool {
    let by = ["OMPI_COMM_WORLD_SIZE", "PMIX_RANK", "PMI_RANK"];
    by.into_iter().any(|name| std::env::var_os(name).is_some())
}

/// Of how many processes this is one, as what started it says.
fn launcher_size() -> Option<usize> {
    env_number(&["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_NTASKS"])
}

/// The number that the first of these variables has.
fn env_number(names: &[&str]) -> Option<usize> {
    names
        .iter()
        .find_map(|name| std::env::var(name).ok()?.parse().ok())
}

/// How many of the ranks have the processors that this one sees: those on this machine, unless each is bound to some.
pub fn ranks_sharing_processors() -> usize {
    let local = env_number(&["OMPI_COMM_WORLD_LOCAL_SIZE", "MPI_LOCALNRANKS"]);
    match local {
        Some(local) if is_mpi_launch() && !is_pinned() => local.max(1),
        _ => 1,
    }
}

/// Whether this process may run on some of the machine's processors only.
fn is_pinned() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let allowed = status
        .lines()
        .find_map(|line| line.strip_prefix("Cpus_allowed_list:"));
    let online = std::fs::read_to_string("/sys/devices/system/cpu/online").ok();
    match (
        allowed.and_then(count_in_ranges),
        online.as_deref().and_then(count_in_ranges),
    ) {
        (Some(allowed), Some(online)) => allowed < online,
        _ => false,
    }
}

/// How many numbers a list of ranges has, such as `0-3,8`.
fn count_in_ranges(ranges: &str) -> Option<usize> {
    let count = |range: &str| {
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        (last.parse::<usize>().ok()? + 1).checked_sub(first.parse().ok()?)
    };
    ranges.trim().split(',').map(count).sum()
}

/// How many processes share the job.
pub fn size() -> usize {
    world::size()
}

/// Which of them this is, from 0.
pub fn rank() -> usize {
    world::rank()
}

/// Whether all ranks know why the job fails.
pub fn is_error_shared() -> bool {
    IS_ERROR_SHARED.load(Relaxed)
}

/// Whether this is the one that speaks and writes.
pub fn is_root() -> bool {
    rank() == 0
}

/// The share of `parts` that a rank of `count` has.
pub fn partition_range(parts: usize, rank: usize, count: usize) -> Range<usize> {
    rank * parts / count..(rank + 1) * parts / count
}

/// The share of parts that a rank of `count` has, where each takes so long: about as much work as the others'.
fn weighted_partition_range(work: &[usize], rank: usize, count: usize) -> Range<usize> {
    let all: usize = work.iter().sum();
    // A part is of the rank in whose share of the work its middle is.
    let first_of = |rank: usize| {
        let mut before = 0;
        let begins = |&work: &usize| {
            let middle = 2 * before + work;
            before += work;
            middle * count >= 2 * rank * all
        };
        work.iter().position(begins).unwrap_or(work.len())
    };
    let end = match rank + 1 == count {
        true => work.len(),
        false => first_of(rank + 1),
    };
    match rank {
        0 => 0..end,
        _ => first_of(rank)..end,
    }
}

/// Which of so many parts are this rank's.
fn local_range(parts: usize) -> Range<usize> {
    partition_range(parts, rank(), size())
}

/// Takes what `work` gives for each of so many parts, in their order, on every rank: it is asked for some of
/// them one after the other, this rank's.
///
/// # Errors
/// Those of the work, on whichever rank; and [`Error::Job`] where ranks are not at the same place.
pub fn distribute<T: Codec>(
    what: &str,
    parts: usize,
    work: impl FnOnce(Range<usize>, &mut dyn FnMut(T)) -> Result<()>,
    take: &mut dyn FnMut(T),
) -> Result<()> {
    distribute_range(what, parts, local_range(parts), work, take)
}

/// The same where parts are not alike: `much` says how much work each is.
///
/// # Errors
/// As [`partition`].
pub fn distribute_weighted<T: Codec>(
    what: &str,
    much: &[usize],
    work: impl FnOnce(Range<usize>, &mut dyn FnMut(T)) -> Result<()>,
    take: &mut dyn FnMut(T),
) -> Result<()> {
    let own = weighted_partition_range(much, rank(), size());
    distribute_range(what, much.len(), own, work, take)
}

fn distribute_range<T: Codec>(
    what: &str,
    parts: usize,
    own: Range<usize>,
    work: impl FnOnce(Range<usize>, &mut dyn FnMut(T)) -> Result<()>,
    take: &mut dyn FnMut(T),
) -> Result<()> {
    if size() == 1 {
        return work(own, take);
    }
    let mut bytes = Vec::new();
    // Writing to memory cannot fail.
    let done = work(own, &mut |value| {
        value.encode(&mut bytes).unwrap_or_default()
    });
    all_gather_checked(
        &format!("{what} ({parts})"),
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

/// What the first rank has, on every rank; `make` is asked there alone.
///
/// # Errors
/// Those of `make`, and as [`partition`].
pub fn broadcast_from_root<T: Codec>(what: &str, make: impl FnOnce() -> Result<T>) -> Result<T> {
    if size() == 1 {
        return make();
    }
    let mut bytes = Vec::new();
    let told = match is_root() {
        true => make().map(|value| value.encode(&mut bytes).unwrap_or_default()),
        false => Ok(()),
    };
    let mut value = None;
    all_gather_checked(what, told.map(|()| bytes), &mut |bytes| {
        if !bytes.is_empty() {
            value = Some(T::decode(&mut &bytes[..])?);
        }
        Some(())
    })?;
    value.ok_or_else(|| out_of_step_error(what))
}

/// Makes sure that all ranks have the same, as they must: processors of different kinds may round otherwise.
///
/// # Errors
/// [`Error::Job`] if they have not.
pub fn ensure_identical<T: Codec>(what: &str, value: &T) -> Result<()> {
    if size() == 1 {
        return Ok(());
    }
    let sum = codec::checksum(value).unwrap_or_default();
    all_gather_checked(&format!("{what}, {sum:x?}"), Ok(Vec::new()), &mut |_| {
        Some(())
    })
}

/// The end of the job on this rank, before what it wrote takes its place. It is done only if all others are.
///
/// # Errors
/// The one with which it or another rank ended.
pub fn finish<T>(ended: Result<T>) -> Result<T> {
    if size() == 1 || IS_CLOSED.load(Relaxed) {
        return ended;
    }
    let (told, value) = match ended {
        Ok(value) => (Ok(Vec::new()), Some(value)),
        Err(error) => (Err(error), None),
    };
    let all = all_gather_checked("the end", told, &mut |_| Some(()));
    IS_CLOSED.store(true, Relaxed);
    all.and_then(|()| value.ok_or_else(|| out_of_step_error("the end")))
}

/// Tells all others where this rank is and what it has, or why it failed; `hear` is told what each has.
fn all_gather_checked(
    place: &str,
    told: Result<Vec<u8>>,
    hear: &mut dyn FnMut(Vec<u8>) -> Option<()>,
) -> Result<()> {
    if IS_CLOSED.load(Relaxed) {
        return told.map(|_| ());
    }
    let (failed, mut bytes, own) = match told {
        Ok(bytes) => (false, bytes, None),
        Err(error) => {
            let (mut bytes, why) = (Vec::new(), error.cause());
            for text in [&why.place, &why.problem, &why.remedy] {
                text.encode(&mut bytes).unwrap_or_default();
            }
            (true, bytes, Some(error))
        }
    };
    let heads =
        world::all_gather_headers([place_hash(place), u64::from(failed), bytes.len() as u64]);
    if let Some(rank) = heads.iter().position(|head| head[1] != 0) {
        IS_CLOSED.store(true, Relaxed);
        IS_ERROR_SHARED.store(true, Relaxed);
        let mut words = vec![0; heads[rank][2] as usize];
        if rank == world::rank() {
            words = bytes;
        }
        world::broadcast(rank, &mut words);
        let from = &mut &words[..];
        let texts: Option<[String; 3]> = Codec::decode(from);
        return Err(match (own, texts) {
            (Some(own), _) => own,
            (None, Some([place, problem, remedy])) => {
                Error::Job(cause(format!("rank {rank}: {place}"), problem, remedy))
            }
            (None, None) => out_of_step_error(place),
        });
    }
    if heads.iter().any(|head| head[0] != heads[0][0]) {
        IS_CLOSED.store(true, Relaxed);
        IS_ERROR_SHARED.store(true, Relaxed);
        return Err(out_of_step_error(place));
    }
    let lengths: Vec<usize> = heads.iter().map(|head| head[2] as usize).collect();
    if lengths.iter().sum::<usize>() <= MAX_GATHER_BYTES {
        let all = world::all_gather(&bytes, &lengths);
        let mut rest = &all[..];
        for length in lengths {
            let (theirs, after) = rest.split_at(length);
            rest = after;
            hear(theirs.to_vec()).ok_or_else(|| out_of_step_error(place))?;
        }
        return Ok(());
    }
    for (rank, length) in lengths.into_iter().enumerate() {
        let mut theirs = match rank == world::rank() {
            true => std::mem::take(&mut bytes),
            false => vec![0; length],
        };
        world::broadcast(rank, &mut theirs);
        hear(theirs).ok_or_else(|| out_of_step_error(place))?;
    }
    Ok(())
}

/// Ranks that are not at the same place.
fn out_of_step_error(place: &str) -> Error {
    Error::Job(cause(
        format!("rank {}, {place}", rank()),
        "other ranks are elsewhere in the job, or have other results",
        "start the same program with the same arguments, files and kind of processor on all machines",
    ))
}

/// A number for a place in the job.
fn place_hash(place: &str) -> u64 {
    use crate::geometry::random::splitmix64;
    place
        .bytes()
        .fold(0, |key, byte| splitmix64(key ^ u64::from(byte)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_is_in_one_share() {
        for (parts, count) in [(0, 3), (1, 3), (7, 3), (64, 7), (3, 8)] {
            let shares = (0..count).flat_map(|rank| partition_range(parts, rank, count));
            assert!(shares.eq(0..parts), "{parts} parts, {count} ranks");
        }
    }

    #[test]
    fn fair_shares_have_all_parts_and_about_as_much_work() {
        let much = [1, 1, 1, 9, 1, 1, 8, 2, 0, 4];
        for count in 1..12 {
            let share = |rank| weighted_partition_range(&much, rank, count);
            assert!((0..count).flat_map(share).eq(0..much.len()), "{count}");
        }
        let shares: Vec<usize> = (0..3)
            .map(|rank| much[weighted_partition_range(&much, rank, 3)].iter().sum())
            .collect();
        assert_eq!(shares, [12, 10, 6]);
        for much in [&[][..], &[0, 0, 0]] {
            let share = |rank| weighted_partition_range(much, rank, 2);
            assert!((0..2).flat_map(share).eq(0..much.len()));
        }
    }

    #[test]
    fn lists_of_processors_are_counted() {
        assert_eq!(count_in_ranges("0-3,8,10-11\n"), Some(7));
        assert_eq!(count_in_ranges("\t0"), Some(1));
        assert_eq!(count_in_ranges("3-1"), None);
        assert_eq!(count_in_ranges("all"), None);
    }

    #[test]
    fn one_process_does_all_parts() {
        let work = |own: Range<usize>, give: &mut dyn FnMut(usize)| {
            own.for_each(|part| give(10 * part));
            Ok(())
        };
        let mut taken = Vec::new();
        distribute("parts", 4, work, &mut |value| taken.push(value)).unwrap();
        assert_eq!(taken, [0, 10, 20, 30]);
        assert_eq!(broadcast_from_root("value", || Ok(3u32)).unwrap(), 3);
        assert_eq!(local_range(4), 0..4);
    }
}

//! How this process was started: alone, or as one of several by the launcher of MPI.

/// Returns `true` if `mpirun` (of Open MPI, or of MPICH and its derivatives) or Slurm's `srun` started this process
/// for MPI.
pub(super) fn is_mpi_launch() -> bool {
    let names = ["OMPI_COMM_WORLD_SIZE", "PMIX_RANK", "PMI_RANK"];
    names
        .into_iter()
        .any(|name| std::env::var_os(name).is_some())
}

/// Returns the number of processes that the launcher started, if it says so.
pub(super) fn launcher_size() -> Option<usize> {
    env_number(&["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_NTASKS"])
}

/// Returns the number in the first of these environment variables that is set to a number.
fn env_number(names: &[&str]) -> Option<usize> {
    names
        .iter()
        .find_map(|name| std::env::var(name).ok()?.parse().ok())
}

/// Returns how many ranks share the processors that this process sees: those on this machine, or one if each rank is
/// bound to processors of its own.
pub fn ranks_sharing_processors() -> usize {
    let local = env_number(&["OMPI_COMM_WORLD_LOCAL_SIZE", "MPI_LOCALNRANKS"]);
    match local {
        Some(local) if is_mpi_launch() && !is_pinned() => local.max(1),
        _ => 1,
    }
}

/// Returns `true` if this process may run on some of the machine's processors only.
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

/// Returns how many numbers a list of ranges has, such as `0-3,8`.
fn count_in_ranges(ranges: &str) -> Option<usize> {
    let count = |range: &str| {
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        (last.parse::<usize>().ok()? + 1).checked_sub(first.parse().ok()?)
    };
    ranges.trim().split(',').map(count).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_processors_are_counted() {
        assert_eq!(count_in_ranges("0-3,8,10-11\n"), Some(7));
        assert_eq!(count_in_ranges("\t0"), Some(1));
        assert_eq!(count_in_ranges("3-1"), None);
        assert_eq!(count_in_ranges("all"), None);
    }
}

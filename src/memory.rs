//! Whether there is memory for what is asked: said before the work, not in the midst of it.
//!
//! What large things will take is estimated from measured figures; what is free the operating system
//! says, or the user ([`set_limit`]).

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use crate::error::cause;
use crate::{Error, Result};

/// Bytes that the process may take in all, if the user said so.
static MAX_BYTES: AtomicU64 = AtomicU64::new(u64::MAX);

/// From now on the process may take so many bytes in all, whatever is free.
pub fn set_limit(bytes: u64) {
    MAX_BYTES.store(bytes.min(u64::MAX - 1), Relaxed);
}

/// Refuses what needs more memory than there is: `bytes` more than is taken already, for `what`.
/// `remedy` says what to ask for instead.
///
/// # Errors
/// [`Error::Job`] at `place`, with the figures.
pub fn ensure_available(
    place: impl fmt::Display,
    bytes: f64,
    what: impl fmt::Display,
    remedy: impl fmt::Display,
) -> Result<()> {
    let (room, whose) = match MAX_BYTES.load(Relaxed) {
        u64::MAX => (available_bytes(), "free"),
        allowed => (
            allowed.checked_sub(used_bytes()).or(Some(0)),
            "left of what is allowed",
        ),
    };
    match room {
        Some(room) if bytes > room as f64 => {
            let room = Bytes(room as f64);
            let problem = format!(
                "{what} would take about {} of memory, {room} is {whose}",
                Bytes(bytes)
            );
            let remedy = format!("{remedy}, or allow more memory");
            Err(Error::Job(
                cause(place, problem, remedy).with_parameter("max-memory"),
            ))
        }
        _ => Ok(()),
    }
}

/// A number of bytes for people.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bytes(pub f64);

impl fmt::Display for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            bytes if bytes >= 1e15 => write!(f, "{:.0e} GB", bytes / 1e9),
            bytes if bytes >= 1e10 => write!(f, "{:.0} GB", bytes / 1e9),
            bytes if bytes >= 1e9 => write!(f, "{:.1} GB", bytes / 1e9),
            bytes => write!(f, "{:.0} MB", (bytes / 1e6).ceil()),
        }
    }
}

/// Bytes that may still be taken: of the machine, of the process's control groups, and of its address
/// space. `None` where nobody says.
fn available_bytes() -> Option<u64> {
    [
        system_available(),
        cgroup_available(),
        address_space_available(),
    ]
    .into_iter()
    .flatten()
    .min()
}

/// A number after a word at the beginning of a line of a file of the kernel's, in its units.
fn read_kernel_value(path: &str, word: &str) -> Option<u64> {
    let text = std::fs::read_to_string(path).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(word))?;
    line.split_whitespace().next()?.parse().ok()
}

/// Bytes taken by this process; 0 where nobody says.
fn used_bytes() -> u64 {
    read_kernel_value("/proc/self/status", "VmRSS:").unwrap_or(0) << 10
}

fn system_available() -> Option<u64> {
    // What the kernel would give without swapping.
    Some(read_kernel_value("/proc/meminfo", "MemAvailable:")? << 10)
}

/// The least of what the process's control groups, each within the next, leave (version 2; in a container
/// version 1's is the machine's as the container sees it).
fn cgroup_available() -> Option<u64> {
    let groups = std::fs::read_to_string("/proc/self/cgroup").ok()?;
    let own = groups.lines().find_map(|line| line.strip_prefix("0::"))?;
    let root = std::path::Path::new("/sys/fs/cgroup");
    let own = root.join(own.trim_start_matches('/'));
    let number = |group: &std::path::Path, name| -> Option<u64> {
        std::fs::read_to_string(group.join(name))
            .ok()?
            .trim()
            .parse()
            .ok()
    };
    (own.ancestors().take_while(|group| group.starts_with(root)))
        .filter_map(|group| {
            let most = number(group, "memory.max")?;
            let now = number(group, "memory.current")?;
            // Cached files give way.
            let cached =
                read_kernel_value(group.join("memory.stat").to_str()?, "file ").unwrap_or(0);
            Some(most.saturating_sub(now.saturating_sub(cached)))
        })
        .min()
}

/// What `ulimit -v` leaves.
fn address_space_available() -> Option<u64> {
    let limits = std::fs::read_to_string("/proc/self/limits").ok()?;
    let line = limits
        .lines()
        .find_map(|line| line.strip_prefix("Max address space"))?;
    let most: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(most.saturating_sub(read_kernel_value("/proc/self/status", "VmSize:")? << 10))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_machine_has_is_refused_with_figures() {
        let said = ensure_available("grid", 3e18, "2e17 cells", "ask for fewer").unwrap_err();
        let text = said.to_string();
        assert!(
            text.starts_with("grid: 2e17 cells would take about 3e9 GB of memory, "),
            "{text}"
        );
        assert!(
            text.contains("is free; ask for fewer, or allow more memory"),
            "{text}"
        );
        assert_eq!(said.cause().parameter, Some("max-memory"));
        assert!(ensure_available("grid", 1e3, "ten cells", "").is_ok());
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn this_process_has_memory_and_some_is_free() {
        assert!(used_bytes() > 1 << 20);
        let free = system_available().unwrap();
        assert!(free > 1 << 24 && free < 1 << 50, "{free}");
    }

    #[test]
    fn bytes_are_said_in_round_figures() {
        let said = [1.0, 4.2e7, 3.46e9, 2.24e10, 8e18].map(|b| Bytes(b).to_string());
        assert_eq!(said, ["1 MB", "42 MB", "3.5 GB", "22 GB", "8e9 GB"]);
    }
}

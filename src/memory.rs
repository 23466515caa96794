//! Checks that there is enough memory for a task before it begins.
//!
//! The memory of large tasks is estimated from measured figures. The available memory comes from
//! the operating system, or from the user ([`set_limit`]).

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use crate::error::cause;
use crate::{Error, Result};

/// Largest memory of the process in bytes; `u64::MAX` if the user sets no limit.
static MAX_BYTES: AtomicU64 = AtomicU64::new(u64::MAX);

/// Limits the memory of the process to this number of bytes, whatever the operating system has
/// available.
pub fn set_limit(bytes: u64) {
    MAX_BYTES.store(bytes.min(u64::MAX - 1), Relaxed);
}

/// Checks that `bytes` more can be allocated for `what`. `remedy` says what to request instead.
///
/// # Errors
/// Returns [`Error::Job`] at `place`, with the figures, if they cannot.
pub fn ensure_available(
    place: impl fmt::Display,
    bytes: f64,
    task: impl fmt::Display,
    remedy: impl fmt::Display,
) -> Result<()> {
    let (available, source) = match MAX_BYTES.load(Relaxed) {
        u64::MAX => (available_bytes(), "free"),
        allowed => (
            allowed.checked_sub(used_bytes()).or(Some(0)),
            "left of what is allowed",
        ),
    };
    match available {
        Some(available) if bytes > available as f64 => {
            let available = Bytes(available as f64);
            let problem = format!(
                "{task} would take about {} of memory, {available} is {source}",
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

/// A number of bytes that is displayed with a unit and two digits.
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

/// Returns the number of bytes that may still be allocated: the smallest of what the machine, the
/// control groups of the process and its address space allow. `None` if none of them is known.
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

/// Reads the number after `word` at the beginning of a line of a kernel file, in the units of that
/// file.
fn read_kernel_value(path: &str, word: &str) -> Option<u64> {
    let text = std::fs::read_to_string(path).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(word))?;
    line.split_whitespace().next()?.parse().ok()
}

/// Returns the number of bytes that this process uses; 0 if unknown.
fn used_bytes() -> u64 {
    read_kernel_value("/proc/self/status", "VmRSS:").unwrap_or(0) << 10
}

fn system_available() -> Option<u64> {
    // `MemAvailable` is what the kernel can provide without swapping.
    Some(read_kernel_value("/proc/meminfo", "MemAvailable:")? << 10)
}

/// Returns the smallest number of bytes that the control groups of the process, which are nested,
/// leave (version 2). For version 1 in a container, [`system_available`] applies.
fn cgroup_available() -> Option<u64> {
    let groups = std::fs::read_to_string("/proc/self/cgroup").ok()?;
    let path = groups.lines().find_map(|line| line.strip_prefix("0::"))?;
    let root = std::path::Path::new("/sys/fs/cgroup");
    let group = root.join(path.trim_start_matches('/'));
    let read_number = |group: &std::path::Path, name| -> Option<u64> {
        std::fs::read_to_string(group.join(name))
            .ok()?
            .trim()
            .parse()
            .ok()
    };
    (group
        .ancestors()
        .take_while(|group| group.starts_with(root)))
    .filter_map(|group| {
        let max = read_number(group, "memory.max")?;
        let current = read_number(group, "memory.current")?;
        // The kernel evicts cached files when memory is needed.
        let cached = read_kernel_value(group.join("memory.stat").to_str()?, "file ").unwrap_or(0);
        Some(max.saturating_sub(current.saturating_sub(cached)))
    })
    .min()
}

/// Returns the number of bytes that `ulimit -v` leaves.
fn address_space_available() -> Option<u64> {
    let limits = std::fs::read_to_string("/proc/self/limits").ok()?;
    let line = limits
        .lines()
        .find_map(|line| line.strip_prefix("Max address space"))?;
    let max: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(max.saturating_sub(read_kernel_value("/proc/self/status", "VmSize:")? << 10))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_task_that_fits_no_machine_is_refused_with_figures() {
        let error = ensure_available("grid", 3e18, "2e17 cells", "ask for fewer").unwrap_err();
        let text = error.to_string();
        assert!(
            text.starts_with("grid: 2e17 cells would take about 3e9 GB of memory, "),
            "{text}"
        );
        assert!(
            text.contains("is free; ask for fewer, or allow more memory"),
            "{text}"
        );
        assert_eq!(error.cause().parameter, Some("max-memory"));
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
    fn bytes_are_displayed_in_two_digits() {
        let texts = [1.0, 4.2e7, 3.46e9, 2.24e10, 8e18].map(|b| Bytes(b).to_string());
        assert_eq!(texts, ["1 MB", "42 MB", "3.5 GB", "22 GB", "8e9 GB"]);
    }
}

//! Memory of the process and of the machine, from the files of the Linux kernel. Other systems have no such files, so
//! nothing is known there.

/// Returns the number of bytes that may still be allocated: the smallest of what the machine, the
/// control groups of the process and its address space allow. `None` if none of them is known.
pub fn available_bytes() -> Option<u64> {
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
pub fn used_bytes() -> u64 {
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

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn this_process_has_memory_and_some_is_free() {
        assert!(used_bytes() > 1 << 20);
        let free = system_available().unwrap();
        assert!(free > 1 << 24 && free < 1 << 50, "{free}");
    }
}

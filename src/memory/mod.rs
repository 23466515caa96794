//! Checks that there is enough memory for a task before it begins.
//!
//! The memory of large tasks is estimated from measured figures. The available memory comes from
//! the operating system, or from the user ([`set_limit`]).

mod last_value;
#[cfg_attr(target_arch = "wasm32", path = "wasm.rs")]
mod system;

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use crate::error::cause;
use crate::{Error, Result};
pub(crate) use last_value::LastValue;
use system::{available_bytes, used_bytes};

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
                "{task} would take about {} of memory, but {available} is {source}",
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

/// Returns the memory of small freed allocations to the operating system. The C library would keep
/// it in a separate pool for each thread, where large arrays cannot use it.
#[allow(unsafe_code, reason = "a call of the C library")]
pub(crate) fn trim() {
    // SAFETY: the call only releases pages without live allocations.
    #[cfg(all(target_os = "linux", target_env = "gnu", feature = "cli"))]
    unsafe {
        libc::malloc_trim(0);
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

/// Parses a number of bytes: 500M, 8G, 1.5T, or a number without a unit.
///
/// # Errors
/// Returns a message for anything else.
pub fn parse_bytes(text: &str) -> std::result::Result<u64, String> {
    let wrong = || format!("{text} is not a size of memory; give one such as 8G or 500M");
    let digits = text.trim_end_matches(['b', 'B']).trim_end_matches('i');
    let (number, unit) = match digits.char_indices().next_back() {
        Some((at, letter)) if letter.is_ascii_alphabetic() => {
            let power = "KMGT".find(letter.to_ascii_uppercase()).ok_or_else(wrong)?;
            (&digits[..at], 1024f64.powi(power as i32 + 1))
        }
        _ => (digits, 1.0),
    };
    let number: f64 = number.trim().parse().map_err(|_| wrong())?;
    let bytes = number * unit;
    if bytes.is_finite() && bytes >= 1.0 {
        Ok(bytes as u64)
    } else {
        Err(wrong())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_sizes_are_parsed() {
        let good = [
            ("8G", 8 << 30),
            ("1.5k", 1536),
            ("500MB", 500 << 20),
            ("2 GiB", 2 << 30),
            ("77", 77),
        ];
        for (text, expected) in good {
            assert_eq!(parse_bytes(text), Ok(expected), "{text}");
        }
        for text in ["", "G", "-1G", "8X", "nanG", "0", "infG", "é"] {
            assert!(parse_bytes(text).is_err(), "{text}");
        }
    }

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
    fn bytes_are_displayed_in_two_digits() {
        let texts = [1.0, 4.2e7, 3.46e9, 2.24e10, 8e18].map(|b| Bytes(b).to_string());
        assert_eq!(texts, ["1 MB", "42 MB", "3.5 GB", "22 GB", "8e9 GB"]);
    }
}

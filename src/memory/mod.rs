//! Checks that there is enough memory for a task before it begins.
//!
//! The memory of large tasks is estimated from measured figures. The available memory comes from
//! the operating system, or from the user ([`set_limit`]).

#[cfg_attr(target_arch = "wasm32", path = "wasm.rs")]
mod system;

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use crate::error::cause;
use crate::{Error, Result};
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
    fn bytes_are_displayed_in_two_digits() {
        let texts = [1.0, 4.2e7, 3.46e9, 2.24e10, 8e18].map(|b| Bytes(b).to_string());
        assert_eq!(texts, ["1 MB", "42 MB", "3.5 GB", "22 GB", "8e9 GB"]);
    }
}

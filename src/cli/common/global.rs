//! Options that every verb has, and the status with which a verb ends.

use clap::Args;

/// Options that every verb has.
#[derive(Debug, Clone, Args)]
pub struct CommonOptions {
    /// Print only errors (and the JSON, if requested)
    #[arg(long, global = true, display_order = 900)]
    pub quiet: bool,
    /// Print the result as JSON on standard output
    #[arg(long, global = true, display_order = 900)]
    pub json: bool,
    /// Number of threads [default: all processors]. The result does not depend on it
    #[arg(long, global = true, value_name = "N", display_order = 900)]
    pub threads: Option<usize>,
    /// Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    /// begins [default: the free memory]
    #[arg(long, global = true, value_name = "SIZE", display_order = 900, value_parser = parse_bytes)]
    pub max_memory: Option<u64>,
}

/// Parses a number of bytes: 500M, 8G, 1.5T, or a number without a unit.
///
/// # Errors
/// Returns a message for anything else.
pub fn parse_bytes(text: &str) -> Result<u64, String> {
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
}

/// The status of a verb that did not fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VerbStatus {
    /// The verb is complete.
    Done,
    /// The user interrupted the verb; the mesh so far is written.
    Interrupted,
}

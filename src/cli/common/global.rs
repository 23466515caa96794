//! What every verb has: a few options, and an ending.

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
    /// Number of threads; all processors by default. The result does not depend on it
    #[arg(long, global = true, value_name = "N", display_order = 900)]
    pub threads: Option<usize>,
    /// Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is begun
    /// [default: what is free]
    #[arg(long, global = true, value_name = "SIZE", display_order = 900, value_parser = parse_bytes)]
    pub max_memory: Option<u64>,
}

/// A number of bytes: 500M, 8G, 1.5T; without a letter, of bytes.
fn parse_bytes(text: &str) -> Result<u64, String> {
    let wrong = || format!("{text} is no size of memory; give one such as 8G or 500M");
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
    match bytes.is_finite() && bytes >= 1.0 {
        true => Ok(bytes as u64),
        false => Err(wrong()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_of_memory_are_understood() {
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

/// How a verb ended that did not fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VerbStatus {
    /// All done.
    Done,
    /// The user interrupted it; what it had is written.
    Interrupted,
}

//! Options that every verb has, and the status with which a verb ends.

use clap::Args;

use crate::memory::parse_bytes;

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

/// The status of a verb that did not fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VerbStatus {
    /// The verb is complete.
    Done,
    /// The user interrupted the verb; the mesh so far is written.
    Interrupted,
}

//! What every verb has: a few options, and an ending.

use clap::Args;

/// Options that every verb has.
#[derive(Debug, Clone, Args)]
pub struct Common {
    /// Print only errors (and the JSON, if requested)
    #[arg(long, global = true, display_order = 900)]
    pub quiet: bool,
    /// Print the result as JSON on standard output
    #[arg(long, global = true, display_order = 900)]
    pub json: bool,
    /// Number of threads; all processors by default. The result does not depend on it
    #[arg(long, global = true, value_name = "N", display_order = 900)]
    pub threads: Option<usize>,
}

/// How a verb ended that did not fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// All done.
    Done,
    /// The user interrupted it; what it had is written.
    Interrupted,
}

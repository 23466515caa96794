//! The verb `script`: runs commands on meshes that stay in memory between them.

use std::path::PathBuf;

use clap::Args;

use crate::Result;
use crate::cli::common::global::VerbStatus;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::cli::script::run_script;

/// Arguments of `atomesh script`.
#[derive(Debug, Args)]
pub struct ScriptArgs {
    /// A text file with one command of atomesh in each line, without the word atomesh. Lines that
    /// begin with # are comments
    #[arg(value_name = "SCRIPT.txt")]
    pub script: PathBuf,
}

/// Runs the verb.
pub(crate) fn script(
    args: &ScriptArgs,
    interrupts: &Interrupts,
    console: &mut Console,
) -> Result<VerbStatus> {
    let answer = run_script(&args.script, &mut console.progress(interrupts))?;
    console.answer(&answer);
    Ok(VerbStatus::Done)
}

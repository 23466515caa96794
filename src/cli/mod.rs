//! The command line.
//!
//! - [`args`]: the command line as a whole
//! - [`verbs`]: one a file, its arguments and its run
//! - [`common`]: what verbs share
//! - [`job`]: the files of a job of `mesh`
//! - [`case`]: where a model lies, and what happens in it
//! - [`faults`]: how faults resist flow
//! - [`parse`]: the small grammars inside option values
//! - [`provenance`]: the hash of the input
//! - [`rock`]: porosity, permeability and the like from numbers, tables and images
//! - [`wells`]: trajectories of wells
//! - [`console`]: everything that is printed

pub mod args;
pub mod case;
pub mod common;
pub mod console;
pub mod faults;
pub mod interrupts;
pub mod job;
pub mod parse;
pub mod provenance;
pub mod rock;
pub mod verbs;
mod wells;

use std::process::ExitCode;

use crate::error::cause;
use crate::{Error, ErrorKind, Result};
use args::{CommandLine, Verb};
use common::global::Ending;
use console::{Console, complain};
use interrupts::{INTERRUPTED, Interrupts};

/// Runs what was typed. Exit codes: 0 done, 1 bad input or failed job, 130 interrupted (wrong usage,
/// 2, is found while parsing).
pub fn main(line: &CommandLine) -> ExitCode {
    match run(line) {
        Ok(Ending::Done) => ExitCode::SUCCESS,
        Ok(Ending::Interrupted) => ExitCode::from(INTERRUPTED),
        Err(error) => {
            complain(format_args!("error: {}", console::in_words(&error)));
            match error.kind() {
                ErrorKind::Interrupted => ExitCode::from(INTERRUPTED),
                _ => ExitCode::FAILURE,
            }
        }
    }
}

fn run(line: &CommandLine) -> Result<Ending> {
    if let Some(threads) = line.common.threads {
        start_threads(threads)?;
    }
    let console = &mut Console::new(&line.common);
    let interrupts = &Interrupts::watch()?;
    match &line.verb {
        Verb::Mesh(args) => return verbs::mesh::mesh(args, interrupts, console),
        Verb::Quality(args) => verbs::quality::quality(args, console)?,
        Verb::Report(args) => verbs::report::report(args, console)?,
        Verb::Validate(args) => verbs::validate::validate(args, console)?,
        Verb::Slice(args) => verbs::slice::slice(args, console)?,
        Verb::Info(args) => verbs::info::info(args, console)?,
        Verb::Feature(args) => verbs::feature::feature(args, console)?,
        Verb::Convert(args) => verbs::convert::convert(args, console)?,
        Verb::Edit(args) => verbs::edit::edit(args, console)?,
        Verb::Flow(args) => verbs::flow::flow(args, interrupts, console)?,
        Verb::Columns(args) => verbs::columns::run(args, console)?,
        Verb::Export(args) => verbs::export::export(args, console)?,
        Verb::Paint(args) => verbs::paint::paint(args, console)?,
        Verb::Segment(args) => verbs::segment::segment(args, console)?,
        Verb::Surface(args) => verbs::surface::surface(args, console)?,
        Verb::Synth(args) => verbs::synth::synth(args, console)?,
        Verb::Doctor => verbs::setup::doctor(console)?,
        Verb::Completions(args) => verbs::setup::completions(args),
        Verb::Man(args) => verbs::setup::man(args, console)?,
    }
    Ok(Ending::Done)
}

fn start_threads(count: usize) -> Result<()> {
    let refuse = |problem: &str| {
        let remedy = "give the number of processors, or omit it";
        Error::Job(cause(format!("--threads {count}"), problem, remedy))
    };
    if count == 0 || count > 4096 {
        return Err(refuse("is not from 1 to 4096"));
    }
    rayon::ThreadPoolBuilder::new()
        .num_threads(count)
        .build_global()
        .map_err(|e| refuse(&e.to_string()).because(e))
}

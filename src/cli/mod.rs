//! The command line.
//!
//! - [`args`]: as typed
//! - [`parse`]: the small grammars inside option values
//! - [`job`]: a job of `mesh`, validated
//! - [`mesh`](mod@mesh): the verb `mesh`
//! - [`paint`](mod@paint): the verb `paint`
//! - [`provenance`]: the hash of the input
//! - [`images`]: the verbs about images
//! - [`meshes`]: the verbs about meshes
//! - [`edit`](mod@edit): the verb `edit`
//! - [`export`](mod@export): the verb `export`
//! - [`flow`](mod@flow): the verb `flow`
//! - [`rock`]: porosity, permeability and the like from numbers, tables and images
//! - [`segment`](mod@segment): the verb `segment`
//! - [`slice`](mod@slice): the verb `slice`
//! - [`surface`](mod@surface): the verb `surface`
//! - [`wells`]: trajectories of wells
//! - [`columns`]: the verb `columns`
//! - [`console`]: everything that is printed

pub mod args;
pub mod columns;
pub mod console;
pub mod edit;
pub mod export;
pub mod flow;
pub mod images;
pub mod job;
pub mod mesh;
pub mod meshes;
pub mod paint;
pub mod parse;
pub mod provenance;
pub mod rock;
pub mod segment;
pub mod slice;
pub mod surface;
pub mod wells;

use std::process::ExitCode;

use crate::error::cause;
use crate::{Error, Result};
use args::{CommandLine, Verb};
use console::{Console, complain};

/// How a verb ended that did not fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// All done.
    Done,
    /// The user interrupted it; what it had is written.
    Interrupted,
}

/// Runs what was typed. Exit codes: 0 done, 1 bad input or failed job, 130 interrupted (wrong usage,
/// 2, is found while parsing).
pub fn main(line: &CommandLine) -> ExitCode {
    match run(line) {
        Ok(Ending::Done) => ExitCode::SUCCESS,
        Ok(Ending::Interrupted) => ExitCode::from(130),
        Err(error) => {
            complain(format_args!(
                "error: {}",
                error.to_string().replace(['\n', '\r'], " ")
            ));
            ExitCode::FAILURE
        }
    }
}

fn run(line: &CommandLine) -> Result<Ending> {
    if let Some(threads) = line.common.threads {
        start_threads(threads)?;
    }
    let console = &mut Console::new(&line.common);
    match &line.verb {
        Verb::Mesh(args) => return mesh::mesh(args, console),
        Verb::Quality(args) => meshes::quality(args, console)?,
        Verb::Validate(args) => meshes::validate(args, console)?,
        Verb::Slice(args) => slice::slice(args, console)?,
        Verb::Info(args) => images::info(args, console)?,
        Verb::Feature(args) => images::feature(args, console)?,
        Verb::Convert(args) => images::convert(args, console)?,
        Verb::Edit(args) => edit::edit(args, console)?,
        Verb::Flow(args) => flow::flow(args, console)?,
        Verb::Columns(args) => columns::run(args, console)?,
        Verb::Export(args) => export::export(args, console)?,
        Verb::Paint(args) => paint::paint(args, console)?,
        Verb::Segment(args) => segment::segment(args, console)?,
        Verb::Surface(args) => surface::surface(args, console)?,
        Verb::Synth(args) => images::synth(args, console)?,
    }
    Ok(Ending::Done)
}

fn start_threads(count: usize) -> Result<()> {
    let refuse = |problem: String| {
        let place = format!("--threads {count}");
        Error::Job(cause(
            place,
            problem,
            "give the number of processors, or leave it out",
        ))
    };
    if count == 0 || count > 4096 {
        return Err(refuse("is not from 1 to 4096".into()));
    }
    rayon::ThreadPoolBuilder::new()
        .num_threads(count)
        .build_global()
        .map_err(|e| refuse(e.to_string()))
}

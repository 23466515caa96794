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
//! - `time_left`: how far a mesh job is, and how much longer it takes at most
//! - [`rock`]: porosity, permeability and the like from numbers, tables and images
//! - [`console`]: everything that is printed
//! - [`desk`]: where a verb works, for other front ends
//! - [`allocator`]: memory is given back, and how the process ends where there is none

pub mod allocator;
pub mod args;
pub mod case;
pub mod common;
pub mod console;
pub mod faults;
pub mod host;
pub mod interrupts;
pub mod job_files;
pub mod parse;
pub mod provenance;
pub mod rock;
mod time_left;
pub mod verbs;

#[doc(hidden)]
pub use crate::comm::world;

use std::process::ExitCode;
use std::thread;

use clap::Parser;

use crate::error::cause;
use crate::files::transaction;
use crate::{Error, ErrorKind, Result, comm, memory};
use args::{CommandLine, Verb, value_error};
use common::global::VerbStatus;
use console::{Console, print_stderr};
use interrupts::{INTERRUPTED_EXIT_CODE, Interrupts};

/// The argument with which this program is TetGen's worker and nothing else.
#[cfg(feature = "tetgen")]
const TETGEN_WORKER_ARG: &str = "--tetgen-worker";

/// Bytes of the stack on which all runs that is not shared among threads.
const MAIN_STACK_BYTES: usize = 8 << 20;

/// Runs what was typed. Exit codes: 0 done, 1 bad input or failed job, 130 interrupted, 2 an unknown option or verb.
pub fn main() -> ExitCode {
    main_with_join(None)
}

/// Runs what was typed, in a program that can `join` other processes which share its job.
pub fn main_with_join(join: Option<world::JoinFn>) -> ExitCode {
    world::set_join(join);
    allocator::configure();
    allocator::exit_on_thread_oom();
    #[cfg(feature = "tetgen")]
    {
        use crate::mesh::delaunay::{serve, share_with_workers};
        // This program again, for TetGen's part of large meshes.
        if std::env::args_os()
            .nth(1)
            .is_some_and(|first| first == TETGEN_WORKER_ARG)
        {
            return ExitCode::from(serve());
        }
        if let Ok(program) = std::env::current_exe() {
            share_with_workers(program, &[TETGEN_WORKER_ARG]);
        }
    }
    // A stack that is there from the start: the first one's grows, and where it finds no memory to do so
    // the system kills the process without a word.
    let stack = thread::Builder::new()
        .name("main".into())
        .stack_size(MAIN_STACK_BYTES);
    match stack.spawn(parse_and_run) {
        // A panic has been told by its thread; its code is that of any.
        Ok(thread) => thread.join().unwrap_or(ExitCode::from(101)),
        Err(error) => {
            let remedy = "end other programs, or use a machine with more memory";
            print_stderr(format_args!("error: {}", cause("memory", error, remedy)));
            ExitCode::FAILURE
        }
    }
}

/// Runs the command line of this process.
fn parse_and_run() -> ExitCode {
    match CommandLine::try_parse() {
        Ok(line) => run_process(&line),
        Err(error) => match value_error(&error) {
            Some(error) => {
                print_stderr(format_args!("error: {error}"));
                ExitCode::FAILURE
            }
            None => error.exit(),
        },
    }
}

/// Runs what was typed, in a process of its own.
fn run_process(line: &CommandLine) -> ExitCode {
    let joined = world::join();
    let prepared = joined.and_then(|()| start_threads(line.common.threads));
    let prepared = prepared.and_then(|()| Interrupts::install());
    let ended = prepared.and_then(|interrupts| run(line, &interrupts));
    let code = match comm::finish(ended) {
        Ok(VerbStatus::Done) => ExitCode::SUCCESS,
        Ok(VerbStatus::Interrupted) => ExitCode::from(INTERRUPTED_EXIT_CODE),
        Err(error) => {
            // What all know one says.
            if comm::is_root() || !comm::is_error_shared() {
                print_stderr(format_args!("error: {}", console::error_line(&error)));
            }
            match error.kind() {
                ErrorKind::Interrupted => ExitCode::from(INTERRUPTED_EXIT_CODE),
                _ => ExitCode::FAILURE,
            }
        }
    };
    world::leave();
    code
}

/// Runs what was typed in a process that goes on: with its threads, and with interrupts as they come. What
/// it writes appears when it is done, or not at all.
///
/// # Errors
/// Those of the verb.
pub fn run(line: &CommandLine, interrupts: &Interrupts) -> Result<VerbStatus> {
    run_with_console(line, interrupts, &mut Console::new(&line.common))
}

/// The same at a console, at which what it writes need not be files.
///
/// # Errors
/// Those of the verb.
pub fn run_with_console(
    line: &CommandLine,
    interrupts: &Interrupts,
    console: &mut Console,
) -> Result<VerbStatus> {
    if let Some(bytes) = line.common.max_memory {
        memory::set_limit(bytes);
    }
    // No rank's files take their names before all are written.
    transaction(|| comm::finish(run_verb(line, interrupts, console)))
}

fn run_verb(
    line: &CommandLine,
    interrupts: &Interrupts,
    console: &mut Console,
) -> Result<VerbStatus> {
    if comm::size() > 1 && !matches!(line.verb, Verb::Mesh(_)) {
        return Err(Error::Job(cause(
            "MPI",
            "ranks share the work of atomesh mesh only",
            "start this without mpirun",
        )));
    }
    match &line.verb {
        Verb::Mesh(args) => return verbs::mesh::mesh(args, interrupts, console),
        Verb::Quality(args) => verbs::quality::quality(args, console)?,
        Verb::Report(args) => verbs::report::report(args, console)?,
        Verb::Validate(args) => verbs::validate::validate(args, console)?,
        Verb::Slice(args) => verbs::slice::slice(args, console)?,
        Verb::Info(args) => verbs::info::info(args, console)?,
        Verb::Feature(args) => verbs::feature::feature(args, console)?,
        Verb::Convert(args) => verbs::convert::convert(args, console)?,
        Verb::Edit(args) => verbs::edit::edit(args, interrupts, console)?,
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
    Ok(VerbStatus::Done)
}

/// As many as asked for, otherwise one for each processor that is not another rank's.
fn start_threads(count: Option<usize>) -> Result<()> {
    let refuse = |problem: &str| {
        let (place, remedy) = match count {
            Some(count) => (
                format!("--threads {count}"),
                "give the number of processors, or omit it",
            ),
            None => ("threads".into(), "give a smaller number with --threads"),
        };
        Error::Job(cause(place, problem, remedy))
    };
    if count.is_some_and(|count| count == 0 || count > 4096) {
        return Err(refuse("is not from 1 to 4096"));
    }
    let processors = || thread::available_parallelism().map_or(1, usize::from);
    let few = (comm::ranks_sharing_processors() > 1)
        .then(|| (processors() / comm::ranks_sharing_processors()).max(1));
    rayon::ThreadPoolBuilder::new()
        .num_threads(count.or(few).unwrap_or_default())
        .build_global()
        .map_err(|e| refuse(&e.to_string()).with_source(e))
}

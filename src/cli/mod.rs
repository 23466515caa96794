//! The command line.
//!
//! - [`args`]: the command line as a whole
//! - [`verbs`]: the verbs, one file each with its arguments
//! - [`common`]: code that several verbs share
//! - `script`: commands as the lines of a text
//! - `option_table`: the options of all verbs as JSON
//! - [`console`]: the console, on which verbs print
//! - [`interrupts`]: handling of Ctrl-C
//! - `time_left`: the progress of a mesh job, and an upper bound of its time left
//! - [`allocator`]: the memory allocator, which also ends the process if there is no memory left

pub mod allocator;
pub mod args;
pub mod common;
pub mod console;
pub mod interrupts;
mod option_table;
mod script;
mod time_left;
pub mod verbs;

#[doc(hidden)]
pub use crate::comm::world;
pub use option_table::option_table;
#[doc(hidden)]
pub use script::{run_line, with_console};

use std::mem::ManuallyDrop;
use std::process::ExitCode;
use std::thread;

use clap::{Args, Parser};

use crate::comm::{Comm, SelfComm, ranks_sharing_processors};
use crate::error::cause;
use crate::files::output::path_text;
use crate::files::transaction;
use crate::job::MeshSpec;
use crate::model::validate::CheckerVerdict;
use crate::session::{Answer, Objects, Session};
use crate::{Error, ErrorKind, Result, memory};
use args::{CommandLine, Verb, value_error};
use common::global::VerbStatus;
use common::options::with_option_name;
use console::{Console, print_stderr};
use interrupts::{INTERRUPTED_EXIT_CODE, Interrupts};

/// Size in bytes of the stack of the main thread.
const MAIN_STACK_BYTES: usize = 8 << 20;

/// Runs the command line. Exit codes: 0 success, 1 wrong input or failed job, 2 unknown option or
/// verb, 130 interrupted.
pub fn main() -> ExitCode {
    main_with_join(None)
}

/// Runs the command line in a program that can `join` other processes which share its job.
pub fn main_with_join(join: Option<world::JoinFn>) -> ExitCode {
    allocator::configure();
    allocator::exit_on_thread_oom();
    // WebAssembly has one thread, whose stack the linker sizes.
    if cfg!(target_family = "wasm") {
        return parse_and_run(join);
    }
    // A stack of fixed size. The stack of the first thread grows, and if there is no memory for
    // that, the system kills the process without a message.
    let stack = thread::Builder::new()
        .name("main".into())
        .stack_size(MAIN_STACK_BYTES);
    match stack.spawn(move || parse_and_run(join)) {
        // The thread has already printed the panic; 101 is the exit code of any panic.
        Ok(thread) => thread.join().unwrap_or(ExitCode::from(101)),
        Err(error) => {
            let remedy = "end other programs, or use a machine with more memory";
            print_stderr(format_args!("error: {}", cause("memory", error, remedy)));
            ExitCode::FAILURE
        }
    }
}

/// Runs the command line of this process.
fn parse_and_run(join: Option<world::JoinFn>) -> ExitCode {
    match CommandLine::try_parse() {
        Ok(line) => run_process(&line, join),
        Err(error) => match value_error(&error) {
            Some(error) => {
                print_stderr(format_args!("error: {error}"));
                ExitCode::FAILURE
            }
            None => error.exit(),
        },
    }
}

/// The processes in which a verb runs.
#[derive(Clone, Copy)]
struct ProcessGroup<'a> {
    /// The processes that share the job.
    comm: &'a dyn Comm,
    /// `true` if the program is built with MPI.
    has_mpi: bool,
}

/// Runs the parsed command line in a process of its own, which can `join` other processes.
fn run_process(line: &CommandLine, join: Option<world::JoinFn>) -> ExitCode {
    let (world_comm, joined): (Box<dyn Comm>, _) = match world::join_world(join) {
        Ok(comm) => (comm, Ok(())),
        Err(error) => (Box::new(SelfComm), Err(error)),
    };
    // A panic must not drop the communicator: MPI would wait for the other ranks.
    let world_comm = ManuallyDrop::new(world_comm);
    let comm = &**world_comm;
    let group = ProcessGroup {
        comm,
        has_mpi: join.is_some(),
    };
    let prepared = joined.and_then(|()| start_threads(line.common.threads));
    let prepared = prepared.and_then(|()| Interrupts::install());
    let result = prepared.and_then(|interrupts| {
        let console = &mut Console::new(&line.common, comm.is_root());
        run_in_group(line, &interrupts, console, group)
    });
    let code = match comm.finish(result) {
        Ok(VerbStatus::Done) => ExitCode::SUCCESS,
        Ok(VerbStatus::Interrupted) => ExitCode::from(INTERRUPTED_EXIT_CODE),
        Err(error) => {
            // Only the root rank prints an error that all ranks share.
            if comm.is_root() || !comm.is_error_shared() {
                print_stderr(format_args!("error: {}", console::error_line(&error)));
            }
            match error.kind() {
                ErrorKind::Interrupted => ExitCode::from(INTERRUPTED_EXIT_CODE),
                _ => ExitCode::FAILURE,
            }
        }
    };
    drop(ManuallyDrop::into_inner(world_comm));
    code
}

/// Runs a parsed command line in a process that continues afterwards, with the threads of that
/// process. Output files appear when the verb has succeeded, or not at all.
///
/// # Errors
/// Returns the errors of the verb.
pub fn run(line: &CommandLine) -> Result<VerbStatus> {
    let group = ProcessGroup {
        comm: &SelfComm,
        has_mpi: false,
    };
    let console = &mut Console::new(&line.common, true);
    run_in_group(line, &Interrupts::default(), console, group)
}

/// Runs the parsed command line in one process of `group`.
fn run_in_group(
    line: &CommandLine,
    interrupts: &Interrupts,
    console: &mut Console,
    group: ProcessGroup<'_>,
) -> Result<VerbStatus> {
    if let Some(bytes) = line.common.max_memory {
        memory::set_limit(bytes);
    }
    // The files of all ranks are written before any of them gets its final name.
    transaction(|| (group.comm).finish(run_verb(line, interrupts, console, group)))
}

fn run_verb(
    line: &CommandLine,
    interrupts: &Interrupts,
    console: &mut Console,
    ProcessGroup { comm, has_mpi }: ProcessGroup<'_>,
) -> Result<VerbStatus> {
    if comm.size() > 1 && !matches!(line.verb, Verb::Mesh(_)) {
        return Err(Error::Job(cause(
            "MPI",
            "ranks share the work of atomesh mesh only",
            "start this without mpirun",
        )));
    }
    match &line.verb {
        Verb::Mesh(args) => return verbs::mesh::mesh(args, interrupts, console, comm),
        Verb::Script(args) => return verbs::script::script(args, interrupts, console),
        Verb::Doctor => verbs::setup::doctor(console, has_mpi)?,
        Verb::Completions(args) => verbs::setup::completions(args),
        Verb::Man(args) => verbs::setup::man(args, console)?,
        verb => {
            let mut session = Session {
                objects: &Objects::default(),
                progress: &mut console.progress(interrupts),
            };
            let (answer, checked) = run_session(verb, &mut session)?;
            console.answer(&answer);
            checked?;
        }
    }
    Ok(VerbStatus::Done)
}

/// Runs a verb on files. Also returns the error of a mesh that was found to be invalid.
fn run_session(verb: &Verb, session: &mut Session<'_>) -> Result<(Answer, Result<()>)> {
    /// Returns the result with names of options as on the command line.
    fn named<A: Args>(_: &A, result: Result<Answer>) -> Result<Answer> {
        result.map_err(with_option_name::<A>)
    }
    let answer = match verb {
        Verb::Quality(a) => named(a, session.quality(&a.mesh, &a.spec)),
        Verb::Report(a) => named(a, session.report(&a.image, &a.mesh, &a.output, &a.spec)),
        Verb::Slice(a) => named(a, session.slice(&a.files, &a.output, &a.spec)),
        Verb::Info(a) => named(a, session.info(&a.file, &a.input)),
        Verb::Feature(a) => named(a, session.feature(&a.image, &a.output, &a.spec)),
        Verb::Convert(a) => named(a, session.convert(&a.input_file, &a.output, &a.spec)),
        Verb::Edit(a) => named(a, session.edit(&a.mesh, &a.image, &a.output, &a.spec))
            .map_err(with_option_name::<MeshSpec>),
        Verb::Flow(a) => named(a, session.flow(&a.mesh, &a.output, &a.spec)),
        Verb::Columns(a) => named(a, session.columns(&a.map, &a.horizon, &a.output, &a.spec)),
        Verb::Export(a) => named(&**a, session.export(&a.mesh, &a.to, &a.output, &a.spec)),
        Verb::Paint(a) => named(a, session.paint(&a.mesh, &a.output, &a.spec)),
        Verb::Segment(a) => named(a, session.segment(&a.image, &a.mesh, &a.output, &a.spec)),
        Verb::Surface(a) => named(a, session.surface(&a.mesh, &a.output, &a.spec)),
        Verb::Synth(a) => named(a, session.synth(&a.kind, &a.output, &a.spec)),
        Verb::Validate(a) => {
            let (answer, verdicts) = session.validate(&a.mesh)?;
            // Scripts notice a mesh that is not valid.
            let checked = CheckerVerdict::require_valid(&verdicts, &path_text(&a.mesh));
            return Ok((answer, checked));
        }
        Verb::Mesh(_) | Verb::Script(_) | Verb::Doctor | Verb::Completions(_) | Verb::Man(_) => {
            unreachable!("they need more than files")
        }
    };
    Ok((answer?, Ok(())))
}

/// Starts the threads: `count`, or one for each processor that no other rank uses.
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
    let per_rank = (ranks_sharing_processors() > 1)
        .then(|| (processors() / ranks_sharing_processors()).max(1));
    let pool = rayon::ThreadPoolBuilder::new();
    let pool = if cfg!(target_family = "wasm") {
        pool.num_threads(1).use_current_thread()
    } else {
        pool.num_threads(count.or(per_rank).unwrap_or_default())
    };
    pool.build_global()
        .map_err(|e| refuse(&e.to_string()).with_source(e))
}

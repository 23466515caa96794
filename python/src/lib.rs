//! The extension module of the Python package `atomesh`: verbs of the command line at a desk of their own,
//! where meshes and images are in memory.
//!
//! - `held`: meshes, images and surfaces as Python sees them, their arrays without copies
//! - `desk`: where verbs find them, and what they say meanwhile
//! - `verbs`: what verbs there are, and their options
//! - `words`: errors in the words of Python

mod errors;
mod host;
mod objects;
mod verbs;

use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use atomesh::ErrorKind;
use atomesh::cli::args::CommandLine;
use atomesh::cli::common::global::VerbStatus;
use atomesh::cli::console::Console;
use atomesh::cli::interrupts::Interrupts;
use clap::Parser;
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use errors::Error;
use host::{Event, MemoryHost, SharedResults};

/// How often Python's signals are looked for.
const SIGNAL_POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Runs a verb.
///
/// `held` are meshes and images by the names under which `words` speak of them; results that are to be
/// written under the names `keep` are given back instead. `tell(kind, share, text)` hears of stages,
/// progress and notes, in the calling thread.
///
/// The work is done in a thread of its own while this one, without the lock of the interpreter, waits for
/// what it says, so that neither Ctrl-C nor a callback ever has to wait for it.
#[pyfunction]
fn run<'py>(
    py: Python<'py>,
    words: Vec<String>,
    held: HashMap<PathBuf, Bound<'py, PyAny>>,
    keep: Vec<PathBuf>,
    tell: Option<Bound<'py, PyAny>>,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyDict>> {
    let line = CommandLine::try_parse_from(["atomesh".to_string()].into_iter().chain(words))
        .map_err(|error| errors::usage_error(py, &error))?;
    let pool = match threads {
        Some(count) => Some(
            rayon::ThreadPoolBuilder::new()
                .num_threads(count)
                .build()
                .map_err(|error| errors::os_error(py, &format!("threads={count}"), &error))?,
        ),
        None => None,
    };
    let (sender, events) = channel();
    let events = Mutex::new(events);
    let (memory, said) = MemoryHost::new(&held, keep, sender)?;
    let interrupts = Interrupts::default();
    let asked = interrupts.clone();
    let job = std::thread::Builder::new()
        .name("atomesh".into())
        .spawn(move || {
            let mut console = Console::with_host(memory);
            let mut work = || atomesh::cli::run_with_console(&line, &asked, &mut console);
            catch_unwind(AssertUnwindSafe(|| match &pool {
                Some(pool) => pool.install(&mut work),
                None => work(),
            }))
        })
        .map_err(|error| errors::os_error(py, "a thread", &error))?;

    // Ctrl-C, which also reaches a callback that is at work; and what else a callback raises.
    let mut signal: Option<PyErr> = None;
    let mut raised: Option<PyErr> = None;
    loop {
        let event = py.detach(|| {
            let events = events.lock().unwrap_or_else(PoisonError::into_inner);
            events.recv_timeout(SIGNAL_POLL_INTERVAL)
        });
        let heard = match (event, &tell) {
            (Err(RecvTimeoutError::Disconnected), _) => break,
            (Ok(event), Some(tell)) if raised.is_none() => forward_event(tell, &event),
            _ => Ok(()),
        };
        if let Err(error) = heard.and_then(|()| py.check_signals()) {
            if signal.is_some() {
                // A second time: whatever becomes of the work, which has been asked to stop.
                return Err(error);
            }
            interrupts.request();
            match error.is_instance_of::<PyKeyboardInterrupt>(py) {
                true => signal = Some(error),
                false => raised = Some(error),
            }
        }
    }
    let ended = py.detach(|| job.join());
    if let Some(error) = raised {
        return Err(error);
    }
    let ending = match ended {
        Ok(Ok(Ok(ending))) => ending,
        Ok(Ok(Err(error))) => {
            return Err(match (signal, error.kind()) {
                (Some(signal), ErrorKind::Interrupted) => signal,
                _ => errors::library_error(py, &error),
            });
        }
        _ => return Err(errors::panic_error(py)),
    };
    match signal {
        Some(signal) if ending == VerbStatus::Done => Err(signal),
        _ => said.to_python(py, ending == VerbStatus::Interrupted),
    }
}

fn forward_event(tell: &Bound<'_, PyAny>, event: &Event) -> PyResult<()> {
    match event {
        Event::Stage(name) => tell.call1(("stage", 0.0, name)),
        Event::Progress(share, what) => tell.call1(("progress", share, what)),
        Event::Note(line) => tell.call1(("note", 0.0, errors::options_to_keywords(line))),
    }
    .map(|_| ())
}

/// From now on TetGen runs in processes of this program.
#[pyfunction]
fn run_tetgen_in(program: PathBuf) {
    atomesh::mesh::delaunay::run_in_worker(program);
}

/// What verbs there are and the options of each, as JSON.
#[pyfunction]
fn describe() -> String {
    verbs::describe_verbs().to_string()
}

#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("Error", module.py().get_type::<Error>())?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<objects::Mesh>()?;
    module.add_class::<objects::Image>()?;
    module.add_class::<objects::Surfaces>()?;
    module.add_function(wrap_pyfunction!(run, module)?)?;
    module.add_function(wrap_pyfunction!(run_tetgen_in, module)?)?;
    module.add_function(wrap_pyfunction!(describe, module)?)
}

impl SharedResults {
    /// What a verb has said, and the results that were kept.
    fn to_python<'py>(&self, py: Python<'py>, interrupted: bool) -> PyResult<Bound<'py, PyDict>> {
        let all = PyDict::new(py);
        let mut said = self.lock();
        all.set_item("text", errors::options_to_keywords(&said.text))?;
        all.set_item("json", said.json.to_string())?;
        all.set_item("notes", &said.notes)?;
        all.set_item("interrupted", interrupted)?;
        let kept = PyDict::new(py);
        for (name, result) in std::mem::take(&mut said.stored) {
            kept.set_item(name, objects::to_python(py, result)?)?;
        }
        all.set_item("kept", kept)?;
        Ok(all)
    }
}

//! The extension module of the Python package `atomesh`. It calls the functions of the library with
//! meshes and images in memory.
//!
//! - `call`: a call of a verb
//! - `options`: options of the library from keyword arguments
//! - `progress`: the progress of a verb as events
//! - `objects`: meshes, images and surfaces as Python objects, with their arrays without copies
//! - `parts`: the arrays from which meshes and surfaces are made, for pickles and subsets
//! - `errors`: exceptions for errors of the library

mod call;
mod errors;
mod objects;
mod options;
mod parts;
mod progress;

use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use atomesh::ErrorKind;
use atomesh::session::Answer;
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use call::Call;
use errors::Error;
use options::Options;
use progress::{Event, EventProgress};

/// Interval at which Python's signals are checked.
const SIGNAL_POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Runs a verb with these positional arguments, and its options by their names on the command line.
///
/// `objects` are meshes and images by the names under which arguments and options refer to them.
/// A result with a name of the form `<name>` is returned. The calling thread calls `on_event(kind,
/// fraction, text)` for stages, progress and notes.
///
/// A thread of its own does the work. The calling thread waits for its events without the
/// interpreter lock, so that neither Ctrl-C nor a callback has to wait for the work.
#[pyfunction]
#[allow(
    clippy::too_many_arguments,
    reason = "the signature of the Python function"
)]
fn run<'py>(
    py: Python<'py>,
    verb: String,
    arguments: Vec<PathBuf>,
    options: &Bound<'py, PyDict>,
    objects: HashMap<PathBuf, Bound<'py, PyAny>>,
    on_event: Option<Bound<'py, PyAny>>,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyDict>> {
    let call = Call {
        verb,
        arguments,
        options: Options(pythonize::depythonize(options)?),
        objects: objects::by_name(&objects)?,
    };
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
    let is_stopped = Arc::new(AtomicBool::new(false));
    let mut progress = EventProgress {
        events: sender,
        is_stopped: Arc::clone(&is_stopped),
    };
    let job = std::thread::Builder::new()
        .name("atomesh".into())
        .spawn(move || {
            let work = || call.run(&mut progress);
            catch_unwind(AssertUnwindSafe(|| match &pool {
                Some(pool) => pool.install(work),
                None => work(),
            }))
        })
        .map_err(|error| errors::os_error(py, "a thread", &error))?;

    // `signal_error` is Ctrl-C, which may also arrive inside a callback; `callback_error` is any
    // other exception of a callback.
    let mut signal_error: Option<PyErr> = None;
    let mut callback_error: Option<PyErr> = None;
    let mut notes: Vec<String> = Vec::new();
    loop {
        let event = py.detach(|| {
            let events = events.lock().unwrap_or_else(PoisonError::into_inner);
            events.recv_timeout(SIGNAL_POLL_INTERVAL)
        });
        if let Ok(Event::Note(line)) = &event {
            notes.push(line.clone());
        }
        let forwarded = match (event, &on_event) {
            (Err(RecvTimeoutError::Disconnected), _) => break,
            (Ok(event), Some(on_event)) if callback_error.is_none() => {
                forward_event(on_event, &event)
            }
            _ => Ok(()),
        };
        if let Err(error) = forwarded.and_then(|()| py.check_signals()) {
            if signal_error.is_some() {
                // At the second Ctrl-C the function returns without waiting for the work, which has
                // already been asked to stop.
                return Err(error);
            }
            is_stopped.store(true, Ordering::SeqCst);
            if error.is_instance_of::<PyKeyboardInterrupt>(py) {
                signal_error = Some(error);
            } else {
                callback_error = Some(error);
            }
        }
    }
    let joined = py.detach(|| job.join());
    if let Some(error) = callback_error {
        return Err(error);
    }
    let answer = match joined {
        Ok(Ok(Ok(answer))) => answer,
        Ok(Ok(Err(error))) => {
            return Err(match (signal_error, error.kind()) {
                (Some(signal_error), ErrorKind::Interrupted) => signal_error,
                _ => errors::library_error(py, &error),
            });
        }
        _ => return Err(errors::panic_error(py)),
    };
    match signal_error {
        Some(signal_error) if !answer.is_interrupted => Err(signal_error),
        _ => answer_to_python(py, answer, notes),
    }
}

fn forward_event(on_event: &Bound<'_, PyAny>, event: &Event) -> PyResult<()> {
    match event {
        Event::Stage(name) => on_event.call1(("stage", 0.0, name)),
        Event::Progress(fraction, detail) => on_event.call1(("progress", fraction, detail)),
        Event::Note(line) | Event::Line(line) => {
            on_event.call1(("note", 0.0, errors::options_to_keywords(line)))
        }
    }
    .map(|_| ())
}

/// Returns the verbs and their options as JSON.
#[pyfunction]
fn describe() -> String {
    atomesh::option_table().to_string()
}

/// Returns the name, the description and the file extensions of each format of `atomesh export`.
#[pyfunction]
fn export_formats() -> Vec<(&'static str, &'static str, Vec<&'static str>)> {
    atomesh::export::formats()
        .map(|format| (format.name, format.description, format.extensions.to_vec()))
        .collect()
}

#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("Error", module.py().get_type::<Error>())?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<objects::Mesh>()?;
    module.add_class::<objects::Image>()?;
    module.add_class::<objects::Surfaces>()?;
    module.add_function(wrap_pyfunction!(run, module)?)?;
    module.add_function(wrap_pyfunction!(describe, module)?)?;
    module.add_function(wrap_pyfunction!(export_formats, module)?)
}

/// Returns the messages of a verb and the result that is kept in memory.
fn answer_to_python(
    py: Python<'_>,
    answer: Answer,
    notes: Vec<String>,
) -> PyResult<Bound<'_, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("text", errors::options_to_keywords(&answer.text))?;
    dict.set_item("json", answer.json.to_string())?;
    dict.set_item("notes", notes)?;
    dict.set_item("interrupted", answer.is_interrupted)?;
    let kept = PyDict::new(py);
    if let Some((name, output)) = answer.kept {
        kept.set_item(name, objects::to_python(py, output)?)?;
    }
    dict.set_item("kept", kept)?;
    Ok(dict)
}

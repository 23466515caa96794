//! Python's exceptions for errors of the library. Options appear in them as keyword arguments.
//!
//! Every exception is an instance of `atomesh.Error`, and of the standard exception that fits it.

use std::error::Error as _;
use std::io;

use atomesh::ErrorKind;
use pyo3::create_exception;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;

create_exception!(
    atomesh,
    Error,
    PyException,
    "An error: what is wrong, where, and what to do about it.\n\n\
     Attributes\n----------\nplace, problem, remedy : str\n    The parts of the message.\n\
     kind : str\n    The kind of the error: \"Io\", \"Image\", \"Mesh\" ..."
);

/// The subclasses of `Error`, which `atomesh._errors` defines.
#[derive(Debug, Clone, Copy)]
enum ErrorClass {
    /// A value is impossible, or the content of a file is: also a `ValueError`.
    Value,
    /// A file or a folder does not exist: also a `FileNotFoundError`.
    MissingFile,
    /// A file cannot be read or written: also an `OSError`.
    File,
    /// The work failed: also a `RuntimeError`.
    Failure,
}

impl ErrorClass {
    fn from_error(error: &atomesh::Error) -> Self {
        let io_error = error
            .source()
            .and_then(|source| source.downcast_ref::<io::Error>());
        match (io_error, error.kind()) {
            (Some(io_error), _) if io_error.kind() == io::ErrorKind::NotFound => Self::MissingFile,
            // Without a code of the operating system, the content of the file is at fault.
            (Some(io_error), _) if io_error.raw_os_error().is_some() => Self::File,
            (_, ErrorKind::Delaunay | ErrorKind::Interrupted) => Self::Failure,
            _ => Self::Value,
        }
    }

    /// Returns the exception with this message.
    fn new_error(self, py: Python<'_>, message: String) -> PyErr {
        let name = match self {
            Self::Value => "InvalidValueError",
            Self::MissingFile => "MissingFileError",
            Self::File => "FileError",
            Self::Failure => "FailureError",
        };
        let class = py
            .import("atomesh._errors")
            .and_then(|module| module.getattr(name));
        match class.and_then(|class| class.call1((&message,))) {
            Ok(value) => PyErr::from_value(value),
            Err(_) => Error::new_err(message),
        }
    }
}

/// Converts an error of the library.
pub fn library_error(py: Python<'_>, error: &atomesh::Error) -> PyErr {
    let cause = error.cause();
    let remedy = match cause.parameter {
        Some(parameter) => format!("{} ({}=)", cause.remedy, parameter.replace('-', "_")),
        None => cause.remedy.clone(),
    };
    new_error(
        py,
        ErrorClass::from_error(error),
        &cause.place,
        &cause.problem,
        &remedy,
        &format!("{:?}", error.kind()),
    )
}

/// Returns an exception for an error of the operating system.
pub fn os_error(py: Python<'_>, place: &str, error: &dyn std::error::Error) -> PyErr {
    let (class, remedy) = (ErrorClass::Failure, "try again with less");
    new_error(py, class, place, &error.to_string(), remedy, "Job")
}

/// Returns the exception for a panic, which is an error in the library.
pub fn panic_error(py: Python<'_>) -> PyErr {
    let remedy = "please report it with the image and the options";
    new_error(
        py,
        ErrorClass::Failure,
        "atomesh",
        "stopped because of an internal error",
        remedy,
        "Internal",
    )
}

fn new_error(
    py: Python<'_>,
    class: ErrorClass,
    place: &str,
    problem: &str,
    remedy: &str,
    kind: &str,
) -> PyErr {
    let [place, problem, remedy] = [place, problem, remedy].map(options_to_keywords);
    let error = class.new_error(py, format!("{place}: {problem}; {remedy}"));
    let value = error.value(py);
    let attributes = [
        ("place", &place),
        ("problem", &problem),
        ("remedy", &remedy),
    ];
    for (name, text) in attributes.into_iter().chain([("kind", &kind.to_string())]) {
        if let Err(error) = value.setattr(name, text) {
            return error;
        }
    }
    error
}

/// Words that follow the name of an option in messages, and are not its value.
const WORDS_AFTER_OPTIONS: [&str; 14] = [
    "above",
    "and",
    "are",
    "below",
    "converts",
    "everywhere",
    "has",
    "is",
    "makes",
    "names",
    "or",
    "says",
    "seeks",
    "shows",
];

/// Returns the text with options as keyword arguments: `--well-radius` becomes `well_radius=`,
/// `--well-radius 0.1` becomes `well_radius=0.1`, and `--distance 2:5` becomes `distance="2:5"`.
pub fn options_to_keywords(text: impl AsRef<str>) -> String {
    let mut words = text.as_ref().split("--");
    let mut converted = words.next().unwrap_or_default().to_string();
    for word in words {
        let name: String = word
            .chars()
            .take_while(|c| c.is_ascii_lowercase() || *c == '-')
            .collect();
        let name = name.trim_end_matches('-');
        let starts = converted.is_empty() || converted.ends_with([' ', '(', '\'', '`', '\n']);
        if name.is_empty() || !starts {
            converted += "--";
            converted += word;
            continue;
        }
        let rest = &word[name.len()..];
        converted += &name.replace('-', "_");
        converted += "=";
        let next_word = rest.split_whitespace().next().unwrap_or_default();
        match rest.strip_prefix([' ', '=']) {
            Some(value) if !WORDS_AFTER_OPTIONS.contains(&next_word) => {
                let end = value.find(char::is_whitespace).unwrap_or(value.len());
                let trimmed = value[..end].trim_end_matches(|c: char| ":;,.)'`".contains(c));
                converted += &python_value(trimmed);
                converted += &value[trimmed.len()..];
            }
            _ if name == "details" => {
                converted += "True";
                converted += rest;
            }
            _ => converted += rest,
        }
    }
    converted
}

/// Returns a value of the command line as Python writes it: numbers as they are, other values quoted.
fn python_value(value: &str) -> String {
    let is_bare = value.is_empty()
        || value.parse::<f64>().is_ok()
        || value.starts_with(['\'', '"', '<', '[']);
    if is_bare {
        value.to_string()
    } else {
        format!("\"{value}\"")
    }
}

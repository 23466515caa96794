//! Verbs from Python's keyword arguments. Each value becomes a field of the verb's options.

use std::path::PathBuf;

use atomesh::cli::args::{CommandLine, Verb};
use atomesh::cli::common::global::{CommonOptions, parse_bytes};
use atomesh::cli::common::options::Typed;
use atomesh::cli::verbs::columns::ColumnsArgs;
use atomesh::cli::verbs::convert::ConvertArgs;
use atomesh::cli::verbs::edit::EditArgs;
use atomesh::cli::verbs::export::ExportArgs;
use atomesh::cli::verbs::feature::FeatureArgs;
use atomesh::cli::verbs::flow::FlowArgs;
use atomesh::cli::verbs::info::InfoArgs;
use atomesh::cli::verbs::mesh::MeshArgs;
use atomesh::cli::verbs::paint::PaintArgs;
use atomesh::cli::verbs::quality::QualityArgs;
use atomesh::cli::verbs::report::ReportArgs;
use atomesh::cli::verbs::segment::SegmentArgs;
use atomesh::cli::verbs::slice::SliceArgs;
use atomesh::cli::verbs::surface::SurfaceArgs;
use atomesh::cli::verbs::synth::SynthArgs;
use atomesh::cli::verbs::validate::ValidateArgs;
use atomesh::error::cause;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use crate::errors;

/// Returns a verb with these positional arguments, and its options by their names on the command
/// line.
///
/// # Errors
/// Returns the exception for a value that an option cannot have.
pub fn command_line(
    py: Python<'_>,
    verb: &str,
    arguments: &[PathBuf],
    options: &Bound<'_, PyDict>,
) -> PyResult<CommandLine> {
    let mut options = Options(pythonize::depythonize(options)?);
    let line = options.line(verb, arguments);
    line.map_err(|error| errors::library_error(py, &error))
}

/// Options that no field has taken yet, by their names on the command line.
struct Options(Map<String, Value>);

impl Options {
    fn line(&mut self, verb: &str, arguments: &[PathBuf]) -> atomesh::Result<CommandLine> {
        let max_memory = self.take("max-memory").map(|size| {
            let size = plain_text(&size);
            let refuse = |problem: String| refused("max-memory", &size, &problem);
            parse_bytes(&size).map_err(refuse)
        });
        Ok(CommandLine {
            verb: self.verb(verb, arguments)?,
            common: CommonOptions {
                quiet: false,
                json: false,
                threads: None,
                max_memory: max_memory.transpose()?,
            },
        })
    }

    /// Returns the verb with its arguments; the options that it takes are removed.
    fn verb(&mut self, verb: &str, arguments: &[PathBuf]) -> atomesh::Result<Verb> {
        let argument = |k: usize| arguments.get(k).cloned().unwrap_or_default();
        Ok(match verb {
            "mesh" => {
                let config = self.take_path("config");
                Verb::Mesh(Box::new(MeshArgs {
                    image: arguments.first().cloned(),
                    config,
                    details: false,
                    print_config: false,
                    spec: Typed {
                        names: self.0.keys().cloned().collect(),
                        options: self.spec()?,
                    },
                }))
            }
            "feature" => Verb::Feature(FeatureArgs {
                image: argument(0),
                output: self.take_output(),
                spec: self.spec()?,
            }),
            "columns" => Verb::Columns(ColumnsArgs {
                map: argument(0),
                output: self.take_output(),
                horizon: self.take_texts("horizon"),
                spec: self.spec()?,
            }),
            "convert" => Verb::Convert(ConvertArgs {
                input_file: argument(0),
                output: argument(1),
                spec: self.spec()?,
            }),
            "edit" => Verb::Edit(EditArgs {
                mesh: argument(0),
                image: argument(1),
                output: self.take_output(),
                spec: self.spec()?,
            }),
            "flow" => Verb::Flow(FlowArgs {
                mesh: argument(0),
                output: self.take_output(),
                spec: self.spec()?,
            }),
            "info" => Verb::Info(InfoArgs {
                file: argument(0),
                input: self.spec()?,
            }),
            "paint" => Verb::Paint(PaintArgs {
                mesh: argument(0),
                output: self.take_output(),
                spec: self.spec()?,
            }),
            "quality" => Verb::Quality(QualityArgs {
                mesh: argument(0),
                spec: self.spec()?,
            }),
            "report" => Verb::Report(ReportArgs {
                image: argument(0),
                mesh: argument(1),
                output: self.take_output(),
                spec: self.spec()?,
            }),
            "segment" => Verb::Segment(SegmentArgs {
                image: argument(0),
                mesh: argument(1),
                output: self.take_output(),
                spec: self.spec()?,
            }),
            "slice" => Verb::Slice(SliceArgs {
                files: arguments.to_vec(),
                output: self.take_output(),
                spec: self.spec()?,
            }),
            "surface" => {
                if let Some(image) = arguments.get(1) {
                    let image = image.to_string_lossy().into_owned();
                    self.0.insert("image".into(), image.into());
                }
                Verb::Surface(SurfaceArgs {
                    mesh: argument(0),
                    output: self.take_output(),
                    spec: self.spec()?,
                })
            }
            "synth" => Verb::Synth(SynthArgs {
                kind: argument(0).to_string_lossy().into_owned(),
                output: self.take_output(),
                spec: self.spec()?,
            }),
            "validate" => Verb::Validate(ValidateArgs { mesh: argument(0) }),
            _ => Verb::Export(Box::new(ExportArgs {
                mesh: argument(0),
                to: self
                    .take("to")
                    .map(|to| plain_text(&to))
                    .unwrap_or_default(),
                output: self.take_output(),
                spec: self.spec()?,
            })),
        })
    }

    fn take(&mut self, name: &str) -> Option<Value> {
        self.0.remove(name)
    }

    fn take_path(&mut self, name: &str) -> Option<PathBuf> {
        self.take(name).map(|path| plain_text(&path).into())
    }

    fn take_texts(&mut self, name: &str) -> Vec<String> {
        match self.take(name) {
            Some(Value::Array(values)) => values.iter().map(plain_text).collect(),
            value => value.iter().map(plain_text).collect(),
        }
    }

    fn take_output(&mut self) -> PathBuf {
        self.take_path("output").unwrap_or_default()
    }

    /// Returns the options as one value. Options of a group, such as those for reading the image,
    /// become fields of this group.
    fn spec<T: Default + Serialize + DeserializeOwned>(&self) -> atomesh::Result<T> {
        let failed = |error: serde_json::Error| refused("options", "", &error.to_string());
        let template = serde_json::to_value(T::default()).map_err(failed)?;
        let mut spec = Value::Object(Map::new());
        for (name, value) in &self.0 {
            let path = group_of(&template, name).unwrap_or_default();
            let mut single = Value::Object(Map::new());
            insert(&mut single, &path, name, value.clone());
            serde_json::from_value::<T>(single).map_err(|error| {
                let text = plain_text(value);
                refused(name, &text, &error.to_string())
            })?;
            insert(&mut spec, &path, name, value.clone());
        }
        serde_json::from_value(spec).map_err(failed)
    }
}

/// Returns the names of the groups, from the outside, in which the option is.
fn group_of(template: &Value, name: &str) -> Option<Vec<String>> {
    let fields = template.as_object()?;
    if fields.get(name).is_some_and(|field| !field.is_object()) {
        return Some(Vec::new());
    }
    fields.iter().find_map(|(group, field)| {
        let mut path = group_of(field, name)?;
        path.insert(0, group.clone());
        Some(path)
    })
}

/// Sets a field in a group, which is created if necessary.
fn insert(spec: &mut Value, path: &[String], name: &str, value: Value) {
    let group = path
        .iter()
        .fold(spec, |group, name| &mut group[name.as_str()]);
    group[name] = value;
}

/// Returns a value as in messages.
fn plain_text(value: &Value) -> String {
    value
        .as_str()
        .map_or_else(|| value.to_string(), str::to_string)
}

/// Returns the error about the value of an option. `message` is `'value' problem; remedy`, or any
/// other message of serde.
fn refused(name: &str, value: &str, message: &str) -> atomesh::Error {
    let quoted = message
        .strip_prefix('\'')
        .and_then(|rest| rest.split_once("' "));
    let (value, message) = quoted.unwrap_or((value, message));
    let place = format!("--{name} {value}");
    let (problem, remedy) = match (message.split_once("; "), message.split_once(", expected ")) {
        (Some((problem, remedy)), _) => (problem, remedy.to_string()),
        (None, Some((problem, expected))) => {
            let expected = match expected {
                "f32" | "f64" => "a number".into(),
                "usize" | "u64" => "a whole number".into(),
                other => other.replace('`', ""),
            };
            let is_name = problem.starts_with("unknown variant");
            let problem = if is_name {
                "is not one of the possible values"
            } else {
                problem
            };
            (problem, format!("give {expected}"))
        }
        (None, None) => (message, "atomesh.options(verb) says what it can be".into()),
    };
    atomesh::Error::Job(cause(place.trim_end(), problem, remedy))
}

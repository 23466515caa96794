//! Options of the library from Python's keyword arguments: each value becomes a field.

use std::path::PathBuf;

use atomesh::error::cause;
use atomesh::memory::parse_bytes;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

/// Options that no field has taken yet, by their names on the command line.
pub struct Options(pub Map<String, Value>);

impl Options {
    /// Takes the option that is not one of a verb.
    pub fn take_max_memory(&mut self) -> atomesh::Result<Option<u64>> {
        let Some(size) = self.0.remove("max-memory") else {
            return Ok(None);
        };
        let size = plain_text(&size);
        let bytes = parse_bytes(&size).map_err(|problem| refused("max-memory", &size, &problem));
        bytes.map(Some)
    }

    pub fn take_path(&mut self, name: &str) -> Option<PathBuf> {
        self.0.remove(name).map(|path| plain_text(&path).into())
    }

    pub fn take_texts(&mut self, name: &str) -> Vec<String> {
        match self.0.remove(name) {
            Some(Value::Array(values)) => values.iter().map(plain_text).collect(),
            value => value.iter().map(plain_text).collect(),
        }
    }

    /// Returns the options as one value. Options of a group, such as those for reading the image,
    /// become fields of this group.
    pub fn spec<T: Default + Serialize + DeserializeOwned>(&self) -> atomesh::Result<T> {
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

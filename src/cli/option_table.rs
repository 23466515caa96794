//! The verbs and their options as JSON, as the command line declares them: the names, types and help
//! texts of the keywords in Python.

use std::any::TypeId;
use std::path::PathBuf;

use clap::{Arg, ArgAction, Command, CommandFactory};
use serde_json::{Value, json};

use super::args::CommandLine;

/// Returns the options of each verb by its name: names, types, help texts and defaults.
pub fn option_table() -> Value {
    let line = CommandLine::command();
    // Of the options that every verb has, only this one is not an argument of the Python functions.
    let shared: Vec<&Arg> = (line.get_arguments())
        .filter(|arg| arg.get_long() == Some("max-memory"))
        .collect();
    let verbs = line
        .get_subcommands()
        .filter(|verb| verb.get_name() != "help");
    Value::Object(
        verbs
            .map(|verb| (verb.get_name().to_string(), describe_verb(verb, &shared)))
            .collect(),
    )
}

fn describe_verb(verb: &Command, shared: &[&Arg]) -> Value {
    let is_own_option = |arg: &&Arg| !matches!(arg.get_id().as_str(), "help" | "version");
    let [positional_args, options]: [Vec<Value>; 2] = [true, false].map(|positional| {
        verb.get_arguments()
            .chain(shared.iter().copied())
            .filter(is_own_option)
            .filter(|arg| arg.is_positional() == positional)
            .map(describe_arg)
            .collect()
    });
    json!({
        "about": verb.get_about().map(ToString::to_string),
        "positional": positional_args,
        "options": options,
    })
}

fn describe_arg(arg: &Arg) -> Value {
    let values = arg.get_possible_values();
    let names: Vec<&str> = values.iter().map(|value| value.get_name()).collect();
    let defaults: Vec<String> = arg
        .get_default_values()
        .iter()
        .map(|value| value.to_string_lossy().into_owned())
        .collect();
    json!({
        "name": arg.get_long().unwrap_or(arg.get_id().as_str()),
        "type": value_kind(arg),
        "help": arg.get_help().map(ToString::to_string),
        "flag": matches!(arg.get_action(), ArgAction::SetTrue),
        "repeated": matches!(arg.get_action(), ArgAction::Append),
        "required": arg.is_required_set(),
        "value": arg.get_value_names().and_then(|names| names.first()).map(ToString::to_string),
        "choices": names,
        "default": defaults.first(),
    })
}

/// Returns the type of an option's value.
fn value_kind(arg: &Arg) -> &'static str {
    let value_type = arg.get_value_parser().type_id();
    if value_type == TypeId::of::<f64>() || value_type == TypeId::of::<f32>() {
        "number"
    } else if value_type == TypeId::of::<usize>() || value_type == TypeId::of::<u64>() {
        "whole"
    } else if value_type == TypeId::of::<PathBuf>() {
        "path"
    } else {
        "text"
    }
}

//! Runs verbs within this process, and checks what they promise for any input.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs;
use std::path::Path;

use atomesh::cli::args::CommandLine;
use atomesh::cli::console::error_line;
use atomesh::cli::run;
use clap::Parser;

/// Runs a verb and returns `true` if it succeeds.
///
/// A verb that fails must give its reason in one line and leave every file unchanged.
///
/// # Panics
/// Panics if the verb breaks this promise.
pub fn run_verb(folder: &Path, arguments: &[String]) -> bool {
    let typed = ["atomesh".to_string()]
        .into_iter()
        .chain(arguments.iter().cloned())
        .chain(["--quiet".into()]);
    let Ok(line) = CommandLine::try_parse_from(typed) else {
        return false;
    };
    let before = file_names(folder);
    match run(&line) {
        Ok(_) => {
            let hidden = file_names(folder)
                .into_iter()
                .find(|name| name.as_encoded_bytes().starts_with(b"."));
            assert_eq!(hidden, None, "left behind by {arguments:?}");
            true
        }
        Err(error) => {
            let message = error_line(&error);
            assert!(
                message.contains(": ") && message.contains("; ") && !message.contains('\n'),
                "{arguments:?}: {message}"
            );
            assert!(
                !message.contains("please report"),
                "{arguments:?}: {message}"
            );
            assert_eq!(
                file_names(folder),
                before,
                "left behind by {arguments:?}, with the error {message}"
            );
            false
        }
    }
}

/// Runs a verb that writes a mesh and returns `true` if it succeeds. The mesh must be valid.
///
/// # Panics
/// Panics if the verb breaks this promise.
pub fn run_mesh_verb(folder: &Path, arguments: &[String], mesh: &Path) -> bool {
    if !run_verb(folder, arguments) {
        return false;
    }
    let validate = [
        "validate".to_string(),
        mesh.to_string_lossy().into_owned(),
        "--quiet".into(),
    ];
    let line = CommandLine::try_parse_from(["atomesh".to_string()].into_iter().chain(validate));
    let line = line.expect("the verb");
    if let Err(error) = run(&line) {
        panic!("{arguments:?} made an invalid mesh: {error}");
    }
    true
}

fn file_names(folder: &Path) -> BTreeSet<OsString> {
    let entries = fs::read_dir(folder).expect("the folder");
    entries
        .map(|entry| entry.expect("an entry").file_name())
        .collect()
}

//! Verbs within this process, and what they promise whatever they are given.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs;
use std::path::Path;

use atomesh::cli::args::CommandLine;
use atomesh::cli::interrupts::Interrupts;
use atomesh::cli::{console, run};
use clap::Parser;

/// Whether a verb did what was typed. If not it has said why in one line, and left every file as it was.
///
/// # Panics
/// If it broke that promise.
pub fn performed(folder: &Path, words: &[String]) -> bool {
    let typed = ["atomesh".to_string()]
        .into_iter()
        .chain(words.iter().cloned())
        .chain(["--quiet".into()]);
    let Ok(line) = CommandLine::try_parse_from(typed) else {
        return false;
    };
    let before = names(folder);
    match run(&line, &Interrupts::default()) {
        Ok(_) => {
            let hidden = names(folder)
                .into_iter()
                .find(|name| name.as_encoded_bytes().starts_with(b"."));
            assert_eq!(hidden, None, "left behind by {words:?}");
            true
        }
        Err(error) => {
            let said = console::error_line(&error);
            assert!(
                said.contains(": ") && said.contains("; ") && !said.contains('\n'),
                "{words:?}: {said}"
            );
            assert!(!said.contains("please report"), "{words:?}: {said}");
            assert_eq!(
                names(folder),
                before,
                "left behind by {words:?}, which said {said}"
            );
            false
        }
    }
}

/// The same of a verb that writes a mesh, which then must be a valid one.
///
/// # Panics
/// If it broke that promise.
pub fn meshed(folder: &Path, words: &[String], mesh: &Path) -> bool {
    if !performed(folder, words) {
        return false;
    }
    let validate = [
        "validate".to_string(),
        mesh.to_string_lossy().into_owned(),
        "--quiet".into(),
    ];
    let line = CommandLine::try_parse_from(["atomesh".to_string()].into_iter().chain(validate));
    let line = line.expect("the verb");
    if let Err(error) = run(&line, &Interrupts::default()) {
        panic!("{words:?} made an invalid mesh: {error}");
    }
    true
}

fn names(folder: &Path) -> BTreeSet<OsString> {
    let entries = fs::read_dir(folder).expect("the folder");
    entries
        .map(|entry| entry.expect("an entry").file_name())
        .collect()
}

//! The verbs `completions`, `man` and `doctor`, which belong to an installation.

use std::path::PathBuf;
use std::process::{Command, Stdio};

use clap::{Args, CommandFactory};
use clap_complete::Shell;
use serde_json::json;

use crate::cli::args::CommandLine;
use crate::cli::console::{Console, print};
use crate::error::{cause, io_error};
use crate::files::output::path_text;
use crate::{Error, Result};

/// Arguments of `atomesh completions`.
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// The shell
    #[arg(value_name = "SHELL")]
    pub shell: Shell,
}

/// Arguments of `atomesh man`.
#[derive(Debug, Args)]
pub struct ManArgs {
    /// The folder for the manual pages, which must exist
    #[arg(short, long, value_name = "FOLDER")]
    pub output: PathBuf,
}

/// Prints a script with which a shell completes commands and options.
pub fn completions(args: &CompletionsArgs) {
    let mut text = Vec::new();
    clap_complete::generate(
        args.shell,
        &mut CommandLine::command(),
        "atomesh",
        &mut text,
    );
    print(String::from_utf8_lossy(&text).trim_end());
}

/// Writes a manual page for the program and one for each verb.
pub fn man(args: &ManArgs, console: &mut Console) -> Result<()> {
    if !args.output.is_dir() {
        let place = format!("--output {}", args.output.display());
        return Err(Error::Io(cause(
            place,
            "is not a folder",
            "make it, or give another",
        )));
    }
    let command = CommandLine::command();
    let count = 1 + command.get_subcommands().count();
    clap_mangen::generate_to(command, &args.output)
        .map_err(|e| io_error(&args.output, "write", e))?;
    console.result(
        format_args!("wrote {count} pages into {}", args.output.display()),
        &json!({ "folder": path_text(&args.output), "pages": count }),
    );
    Ok(())
}

/// Programs that check or use the output of atomesh: name, option that shows whether the program is
/// installed, and purpose.
const EXTERNAL_PROGRAMS: [(&str, &str, &str); 8] = [
    (
        "flow",
        "--version",
        "OPM Flow, simulates what export --to opm writes",
    ),
    (
        "ccx",
        "-v",
        "CalculiX, computes what export --to inp writes",
    ),
    (
        "checkMesh",
        "-help",
        "OpenFOAM, checks what export --to openfoam writes",
    ),
    (
        "octave",
        "--version",
        "Octave, opens what export --to mrst writes",
    ),
    (
        "gmsh",
        "--version",
        "Gmsh, opens what export --to msh writes",
    ),
    (
        "chromium-headless-shell",
        "--version",
        "Chromium, tests pages",
    ),
    (
        "python3",
        "--version",
        "Python, runs the scripts and some tests",
    ),
    (
        "paraview",
        "--version",
        "ParaView, shows .vtu, .vti and .vtp files",
    ),
];

/// Reports how this program was built, what it runs on, and which external programs are installed.
pub fn doctor(console: &mut Console, has_mpi: bool) -> Result<()> {
    let built = |is_built_in: bool, purpose: &str, missing: &str| {
        if is_built_in {
            purpose.to_string()
        } else {
            format!("not built in: {missing}")
        }
    };
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let folder = std::env::temp_dir();
    let writable = tempfile::tempfile_in(&folder).is_ok();
    let mut lines = vec![
        ("atomesh", env!("CARGO_PKG_VERSION").to_string()),
        (
            "licence",
            match (cfg!(feature = "tetgen"), cfg!(feature = "cgal")) {
                (true, _) => "AGPL-3.0 as a whole, because of TetGen",
                (false, true) => "GPL-3.0 as a whole, because of CGAL",
                (false, false) => "MIT OR Apache-2.0",
            }
            .to_string(),
        ),
        (
            "TetGen",
            built(
                cfg!(feature = "tetgen"),
                "built in (AGPL-3.0)",
                "atomesh's own kernel makes the same tetrahedra",
            ),
        ),
        (
            "CGAL",
            built(
                cfg!(feature = "cgal"),
                "built in (GPL-3.0)",
                "no second opinion",
            ),
        ),
        (
            "MPI",
            built(has_mpi, "built in", "one process a job; atomesh-mpi has it"),
        ),
        ("processors", threads.to_string()),
        (
            "work folder",
            format!(
                "{}{}",
                folder.display(),
                if writable {
                    ""
                } else {
                    ": cannot be written; set TMPDIR"
                }
            ),
        ),
    ];
    for (program, option, purpose) in EXTERNAL_PROGRAMS {
        // The output of the programs differs too much to be shown; only success counts.
        let is_present = Command::new(program)
            .arg(option)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status()
            .is_ok();
        let state = if is_present { "there" } else { "absent" };
        lines.push((program, format!("{state} ({purpose})")));
    }
    let text: Vec<String> = (lines.iter())
        .map(|(name, text)| format!("{name:<25}{text}"))
        .collect();
    let json: serde_json::Map<String, serde_json::Value> = (lines.into_iter())
        .map(|(name, text)| (name.to_string(), text.into()))
        .collect();
    console.result(text.join("\n"), &json.into());
    Ok(())
}

//! The verb `validate`: checks a mesh with atomesh's own checker, the Delaunay kernels (spade in 2-D) and
//! CGAL, as far as they are built in.

use std::path::PathBuf;

use clap::Args;

use crate::Result;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::files::output::{file_report, path_text};
use crate::model::validate::CheckerVerdict;

/// Arguments of `atomesh validate`.
#[derive(Debug, Args)]
pub struct ValidateArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
}

/// Runs the verb. It returns an error if the mesh is not valid, so that scripts notice it.
pub fn validate(args: &ValidateArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let verdicts = console.run_on_mesh(interrupts, &args.mesh, |mesh, progress| {
        crate::validate(mesh, progress)
    })?;
    let lines: Vec<String> = verdicts.iter().map(CheckerVerdict::summary_line).collect();
    let report = file_report(&args.mesh, CheckerVerdict::to_json(&verdicts));
    console.result(lines.join("\n"), &report);
    CheckerVerdict::require_valid(&verdicts, &path_text(&args.mesh))
}

//! The verb `validate`: checks a mesh with atomesh's own checker, the Delaunay kernels (spade in 2-D) and
//! CGAL, as far as they are built in.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::cli::common::output::path_text;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::error::cause;
use crate::model::validate::CheckerVerdict;
use crate::{Error, Result};

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
    let failed = verdicts
        .iter()
        .find_map(|v| Some((v.checker, v.problem.clone()?)));
    console.result(
        lines.join("\n"),
        &json!({ "file": path_text(&args.mesh), "valid": failed.is_none(), "checks": verdicts }),
    );
    match failed {
        None => Ok(()),
        Some((checker, problem)) => Err(Error::Mesh(cause(
            args.mesh.display(),
            format!("{checker} finds it invalid: {problem}"),
            "mesh the image again",
        ))),
    }
}

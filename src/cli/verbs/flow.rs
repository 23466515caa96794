//! The verb `flow`: computes steady pressure and flow from sources to sinks.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::model::flow::FlowSpec;
use crate::progress::Stage;

/// Arguments of `atomesh flow`.
#[derive(Debug, Args)]
pub struct FlowArgs {
    /// A mesh written by atomesh; its coordinates are assumed to be in metres
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The mesh to write, split along faults, with pressure (Pa) and Darcy velocity (m/s)
    #[arg(short, long, value_name = "OUT.vtu")]
    pub output: PathBuf,
    /// Options of the computation.
    #[command(flatten)]
    pub spec: FlowSpec,
}

/// Runs the verb.
pub fn flow(args: &FlowArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let (spec, output) = (&args.spec, args.output.as_path());
    spec.check_files(&args.mesh, output)
        .map_err(with_option_name::<FlowSpec>)?;
    let outcome = console.run_on_mesh(interrupts, &args.mesh, |input, progress| {
        crate::flow(input, spec, progress).map_err(with_option_name::<FlowSpec>)
    })?;
    console.begin_stage(Stage::Writing);
    outcome.write_others(spec)?;
    outcome.mesh.write(output)?;
    let report = outcome.report;
    console.result(
        format_args!("{}\nwrote {}", report.table(), output.display()),
        &json!(report),
    );
    Ok(())
}

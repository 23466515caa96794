//! The verb `flow`: computes steady pressure and flow from sources to sinks.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::cli::common::options::with_option_name;
use crate::cli::common::output::check_output;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::error::cause;
use crate::model::flow::{FaultMultiplier, FlowPermeability, FlowSpec};
use crate::progress::Stage;
use crate::{Error, Result};

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

impl FlowArgs {
    /// Checks that no output replaces an input or the other output.
    fn check_files(&self) -> Result<()> {
        let mut inputs = vec![self.mesh.as_path()];
        if let FlowPermeability::Named(name) = &self.spec.permeability {
            inputs.push(Path::new(name));
        }
        for multiplier in &self.spec.fault_options.fault_multiplier {
            if let FaultMultiplier::File(path) = multiplier {
                inputs.push(path);
            }
        }
        check_output(&self.output, "--output", &["vtu"], &inputs)?;
        inputs.push(&self.output);
        match (&self.spec.streamlines, self.spec.lines) {
            (Some(path), _) => check_output(path, "--streamlines", &["vtp"], &inputs),
            (None, Some(_)) => {
                let problem = "is the number of streamlines, but none are to be written";
                Err(Error::Job(cause("--lines", problem, "omit it")))
            }
            (None, None) => Ok(()),
        }
    }
}

/// Runs the verb.
pub fn flow(args: &FlowArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let spec = &args.spec;
    spec.validate().map_err(with_option_name::<FlowSpec>)?;
    args.check_files()?;
    let outcome = console.run_on_mesh(interrupts, &args.mesh, |input, progress| {
        crate::flow(input, spec, progress).map_err(with_option_name::<FlowSpec>)
    })?;
    console.begin_stage(Stage::Writing);
    if let (Some(path), Some(lines)) = (&spec.streamlines, &outcome.streamlines) {
        lines.write(path)?;
    }
    console.write_any_mesh(&args.output, outcome.mesh)?;
    let report = outcome.report;
    console.result(
        format_args!("{}\nwrote {}", report.table(), args.output.display()),
        &json!(report),
    );
    Ok(())
}

//! The verb `quality`: measures the quality and the fidelity of a mesh.

use std::path::PathBuf;

use clap::Args;

use crate::Result;
use crate::assess::quality::QualitySpec;
use crate::cli::common::options::with_option_name;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;

/// Arguments of `atomesh quality`.
#[derive(Debug, Args)]
pub struct QualityArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// Options of the measurement.
    #[command(flatten)]
    pub spec: QualitySpec,
}

/// Runs the verb.
pub fn quality(args: &QualityArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let spec = &args.spec;
    spec.check_files(&args.mesh)?;
    let report = console.run_on_mesh(interrupts, &args.mesh, |input, progress| {
        crate::quality(input, spec, progress).map_err(with_option_name::<QualitySpec>)
    })?;
    console.result(report.table().trim_end(), &report.to_json());
    Ok(())
}

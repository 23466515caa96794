//! The verb `export`: writes a mesh for a reservoir simulator, or for another mesher.

use std::path::PathBuf;

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser};

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::export::{ExportFormat, ExportSpec, formats};

/// Arguments of `atomesh export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The format to write
    #[arg(long, value_name = "FORMAT", value_parser = format_names())]
    pub to: String,
    /// The file to write, or the folder for formats with several files
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,
    /// Options of the model.
    #[command(flatten)]
    pub spec: ExportSpec,
}

/// Returns the names of the formats with their descriptions.
fn format_names() -> PossibleValuesParser {
    let named = |format: &ExportFormat| {
        PossibleValue::new(format.name)
            .help(format.description)
            .aliases(format.programs())
    };
    PossibleValuesParser::new(formats().map(named))
}

/// Runs the verb.
pub fn export(args: &ExportArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let (spec, output) = (&args.spec, args.output.as_path());
    let format = ExportFormat::from_name(&args.to)?;
    spec.validate(format)
        .map_err(with_option_name::<ExportSpec>)?;
    format.check_files(&args.mesh, output)?;
    let outcome = console.run_on_mesh(interrupts, &args.mesh, |input, progress| {
        let outcome = crate::export(input, format, output, spec, progress);
        outcome.map_err(with_option_name::<ExportSpec>)
    })?;
    console.result(outcome.table(), &outcome.to_json());
    Ok(())
}

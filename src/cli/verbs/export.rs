//! The verb `export`: writes a mesh for a reservoir simulator, or for another mesher.

use std::path::PathBuf;

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser};

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

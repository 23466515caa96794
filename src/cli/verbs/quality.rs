//! The verb `quality`: measures the quality and the fidelity of a mesh.

use std::path::PathBuf;

use clap::Args;

use crate::assess::quality::QualitySpec;

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

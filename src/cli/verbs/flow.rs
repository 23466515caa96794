//! The verb `flow`: computes steady pressure and flow from sources to sinks.

use std::path::PathBuf;

use clap::Args;

use crate::model::flow::FlowSpec;

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

//! The verb `edit`: adds, moves and removes atoms, and meshes only their neighbourhood again.

use std::path::PathBuf;

use clap::Args;

use crate::edit::EditSpec;

/// Arguments of `atomesh edit`.
#[derive(Debug, Args)]
pub struct EditArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The image that was meshed
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// The edited mesh to write
    #[arg(short, long, value_name = "OUT.vtu")]
    pub output: PathBuf,
    /// Options of the edits.
    #[command(flatten)]
    pub spec: EditSpec,
}

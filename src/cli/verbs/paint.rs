//! The verb `paint`: grows regions of cells from seeds, within layers but not across surfaces.

use std::path::PathBuf;

use clap::Args;

use crate::model::paint::PaintSpec;

/// Arguments of `atomesh paint`.
#[derive(Debug, Args)]
pub struct PaintArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The mesh to write, with the painted regions as cell data `region` (0: not painted)
    #[arg(short, long, value_name = "OUT.vtu")]
    pub output: PathBuf,
    /// Options of the paint.
    #[command(flatten)]
    pub spec: PaintSpec,
}

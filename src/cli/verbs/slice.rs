//! The verb `slice`: draws pictures of meshes, images, surfaces and lines.

use std::path::PathBuf;

use clap::Args;

use crate::model::slice::SliceSpec;

/// Arguments of `atomesh slice`.
#[derive(Debug, Args)]
pub struct SliceArgs {
    /// The files to draw: the image that was meshed, its mesh (.vtu), surfaces and lines (.vtp).
    /// With --view 3d each of these may be drawn alone
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,
    /// The picture to write
    #[arg(short, long, value_name = "OUT.png")]
    pub output: PathBuf,
    /// Options of the picture.
    #[command(flatten)]
    pub spec: SliceSpec,
}

//! The verb `report`: writes a page with mesh, image and figures.

use std::path::PathBuf;

use clap::Args;

use crate::assess::ReportSpec;

/// Arguments of `atomesh report`.
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// The image that was meshed
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// The mesh of the image
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The page to write
    #[arg(short, long, value_name = "PAGE.html")]
    pub output: PathBuf,
    /// Options of the page.
    #[command(flatten)]
    pub spec: ReportSpec,
}

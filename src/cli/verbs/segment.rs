//! The verb `segment`: separates an object from the background by a minimum cut on the cells of a
//! mesh.

use std::path::PathBuf;

use clap::Args;

use crate::model::segment::SegmentSpec;

/// Arguments of `atomesh segment`.
#[derive(Debug, Args)]
pub struct SegmentArgs {
    /// The image that was meshed, or another of the same dimensions
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The mesh to write, with `label` (1 object, 0 background) and `mean` (of the image) for each
    /// cell
    #[arg(short, long, value_name = "SEG.vtu")]
    pub output: PathBuf,
    /// Options of the segmentation.
    #[command(flatten)]
    pub spec: SegmentSpec,
}

//! The verb `info`: describes an image file or a mesh file.

use std::path::PathBuf;

use clap::Args;

use crate::image::formats::InputOptions;

/// Arguments of `atomesh info`.
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// An image or a mesh
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

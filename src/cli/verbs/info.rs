//! The verb `info`: describes an image file or a mesh file.

use std::path::PathBuf;

use clap::Args;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::console::Console;
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

/// Runs the verb.
pub fn info(args: &InfoArgs, console: &mut Console) -> Result<()> {
    let info = crate::info(&args.file, &args.input).map_err(with_option_name::<InputOptions>)?;
    console.result(info.text, &info.json);
    Ok(())
}

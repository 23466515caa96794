//! `atomesh convert`: from one image format to another.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::Result;
use crate::cli::common::output::{WRITTEN, check_output, written};
use crate::cli::console::Console;
use crate::image::formats::InputOptions;
use crate::image::formats::{AnyLoaded, Loaded};

/// `atomesh convert`.
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// The image to read
    #[arg(value_name = "IN")]
    pub input_file: PathBuf,
    /// The image to write: .vti, .npy, .nrrd, .mha, .nii or .nii.gz; .png in 2-D
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// How to read the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// Runs the verb.
pub fn convert(args: &ConvertArgs, console: &mut Console) -> Result<()> {
    check_output(&args.output, "OUT", &WRITTEN, &[&args.input_file])?;
    match console.read_image(&args.input_file, &args.input)? {
        AnyLoaded::Plane(loaded) => rewrite(loaded, &args.output, console),
        AnyLoaded::Space(loaded) => rewrite(loaded, &args.output, console),
    }
}

fn rewrite<const D: usize>(loaded: Loaded<D>, to: &Path, console: &mut Console) -> Result<()> {
    for note in &loaded.notes {
        console.note(note);
    }
    written(console, to, loaded.image)
}

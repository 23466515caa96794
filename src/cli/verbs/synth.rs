//! The verb `synth`: makes synthetic images whose features are known exactly.

use std::path::PathBuf;

use clap::Args;

use crate::cli::common::output::{IMAGE_EXTENSIONS, check_output, report_written_image};
use crate::cli::console::Console;
use crate::error::cause;
use crate::image::formats::AnyImage;
use crate::image::formats::segy::write_synthetic;
use crate::image::synth::{SynthSpec, SyntheticKind};
use crate::{Error, Result};

/// Arguments of `atomesh synth`.
#[derive(Debug, Args)]
pub struct SynthArgs {
    /// The kind of image
    #[arg(value_name = "KIND", value_parser = synth_kind())]
    pub kind: String,
    /// The image to write: .vti, .npy, .nrrd, .mha, .nii or .nii.gz; .png in 2-D; .sgy in 3-D, a
    /// survey with samples of 12.5 m x 12.5 m x 4 ms
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,
    /// Options of the image.
    #[command(flatten)]
    pub spec: SynthSpec,
}

fn synth_kind() -> clap::builder::PossibleValuesParser {
    SyntheticKind::ALL.map(|(name, _)| name).into()
}

/// Runs the verb.
pub fn synth(args: &SynthArgs, console: &mut Console) -> Result<()> {
    let spec = &args.spec;
    let endings = [&IMAGE_EXTENSIONS[..], &["sgy"]].concat();
    check_output(&args.output, "--output", &endings, &[])?;
    let mut others = vec![args.output.as_path()];
    for (path, option) in [(&spec.truth, "--truth"), (&spec.layers, "--layers")] {
        if let Some(path) = path {
            check_output(path, option, &["npy"], &others)?;
            others.push(path);
        }
    }
    let image = crate::synth(args.kind.parse()?, spec)?;
    let dims = image.dims();
    let is_segy = args
        .output
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("sgy"));
    match image {
        AnyImage::Space(loaded) if is_segy => write_synthetic(&args.output, &loaded.image)?,
        AnyImage::Plane(_) if is_segy => {
            let remedy = "give three dimensions, or another ending";
            return Err(Error::Job(cause(
                format!("--output {}", args.output.display()),
                "a survey has three axes, and this image has two",
                remedy,
            )));
        }
        image => console.write_any_image(&args.output, image)?,
    }
    report_written_image(console, &args.output, &dims);
    Ok(())
}

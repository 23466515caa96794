//! The verb `synth`: makes synthetic images whose features are known exactly.

use std::path::PathBuf;

use clap::Args;

use crate::Result;
use crate::cli::common::output::{IMAGE_EXTENSIONS, check_output, report_written_image};
use crate::cli::console::Console;
use crate::image::synth::{SynthSpec, SyntheticKind};

/// Arguments of `atomesh synth`.
#[derive(Debug, Args)]
pub struct SynthArgs {
    /// The kind of image
    #[arg(value_name = "KIND", value_parser = synth_kind())]
    pub kind: String,
    /// The image to write: .vti, .npy, .nrrd, .mha, .nii or .nii.gz; .png in 2-D
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
    check_output(&args.output, "--output", &IMAGE_EXTENSIONS, &[])?;
    let mut others = vec![args.output.as_path()];
    for (path, option) in [(&spec.truth, "--truth"), (&spec.layers, "--layers")] {
        if let Some(path) = path {
            check_output(path, option, &["npy"], &others)?;
            others.push(path);
        }
    }
    let image = crate::synth(args.kind.parse()?, spec)?;
    let dims = image.dims();
    console.write_any_image(&args.output, image)?;
    report_written_image(console, &args.output, &dims);
    Ok(())
}

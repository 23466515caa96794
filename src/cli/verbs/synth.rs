//! The verb `synth`: makes synthetic images whose features are known exactly.

use std::path::PathBuf;

use clap::Args;

use crate::image::synth::{SynthSpec, SyntheticKind};

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

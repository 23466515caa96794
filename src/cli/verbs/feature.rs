//! The verb `feature`: runs only the detection of features.

use std::path::PathBuf;

use clap::Args;

use crate::job::FeatureSpec;

/// Arguments of `atomesh feature`.
#[derive(Debug, Args)]
pub struct FeatureArgs {
    /// The image
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// The potential b(x) to write: .vti, .npy, .nrrd, .mha, .nii or .nii.gz; .png in 2-D
    #[arg(short, long, value_name = "OUT.vti")]
    pub output: PathBuf,
    /// Options of the detection.
    #[command(flatten)]
    pub spec: FeatureSpec,
}

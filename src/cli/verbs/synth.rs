//! The verb `synth`: makes synthetic images whose features are known exactly.

use std::path::PathBuf;

use clap::Args;

use crate::Result;
use crate::cli::common::output::{IMAGE_EXTENSIONS, check_output, write_image};
use crate::cli::console::Console;
use crate::cli::parse;
use crate::image::synth;
use crate::image::synth::SyntheticImage;

/// Arguments of `atomesh synth`.
#[derive(Debug, Args)]
pub struct SynthArgs {
    /// The kind of image
    #[arg(value_name = "KIND", value_parser = synth_kind())]
    pub kind: String,
    /// The image to write: .vti, .npy, .nrrd, .mha, .nii or .nii.gz; .png in 2-D
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,
    /// Also write the exact distance to the features
    #[arg(long, value_name = "DIST.npy")]
    pub truth: Option<PathBuf>,
    /// Also write the depth of each sample before folding and faulting, which is constant along a
    /// reflector (amplitude and network-amplitude)
    #[arg(long, value_name = "DEPTH.npy")]
    pub layers: Option<PathBuf>,
    /// Number of samples along x, y and z; NX,NY makes a 2-D image
    #[arg(long, value_name = "NX,NY,NZ", default_value = "128,128,128")]
    pub dims: String,
    /// Number of faults or shells [default: 4; for a network 2 to 6, from its seed]
    #[arg(long, value_name = "N")]
    pub count: Option<usize>,
    /// Ratio of the signal to the rms of the noise; inf for no noise
    #[arg(long, value_name = "RATIO", default_value_t = 4.0)]
    pub signal_to_noise: f64,
    /// Standard deviation of the features' profile, in samples
    #[arg(long, value_name = "SAMPLES", default_value_t = 1.5)]
    pub width: f64,
    /// Seed of all random numbers
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub rng_seed: u64,
}

fn synth_kind() -> clap::builder::PossibleValuesParser {
    synth::SyntheticKind::ALL.map(|(name, _)| name).into()
}

/// Runs the verb.
pub fn synth(args: &SynthArgs, console: &mut Console) -> Result<()> {
    check_output(&args.output, "--output", &IMAGE_EXTENSIONS, &[])?;
    if let Some(truth) = &args.truth {
        check_output(truth, "--truth", &["npy"], &[&args.output])?;
    }
    let dims = parse::dims("--dims", &args.dims)?;
    let options = synth::Options {
        dims: std::array::from_fn(|k| dims.get(k).copied().unwrap_or(1)),
        seed: args.rng_seed,
        count: args.count,
        signal_to_noise: args.signal_to_noise,
        width: args.width,
    };
    let kind = args.kind.parse()?;
    if let Some(layers) = &args.layers {
        let others = [Some(args.output.as_path()), args.truth.as_deref()];
        check_output(
            layers,
            "--layers",
            &["npy"],
            &others.into_iter().flatten().collect::<Vec<_>>(),
        )?;
        let depth = synth::layer_depths(kind, &options)?;
        match dims.len() {
            2 => console.write_image(layers, depth.flatten())?,
            _ => console.write_image(layers, depth)?,
        }
    }
    match dims.len() {
        2 => write_synthetic(args, synth::make_2d(kind, &options)?, console),
        _ => write_synthetic(args, synth::make(kind, &options)?, console),
    }
}

fn write_synthetic<const D: usize>(
    args: &SynthArgs,
    synthetic: SyntheticImage<D>,
    console: &mut Console,
) -> Result<()> {
    if let Some(path) = &args.truth {
        synthetic.truth.write(path)?;
    }
    write_image(console, &args.output, synthetic.image)
}

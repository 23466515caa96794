//! The verb `feature`: runs only the detection of features.

use std::path::PathBuf;

use clap::Args;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::common::output::format_dims;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::files::output::file_report;
use crate::image::formats::{self, AnyImage, LoadedImage, read_with_options};
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

/// Runs the verb.
pub fn feature(args: &FeatureArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let spec = &args.spec;
    spec.check_files(&args.image, &args.output)
        .map_err(with_option_name::<FeatureSpec>)?;
    match read_with_options(&args.image, &spec.input).map_err(with_option_name::<FeatureSpec>)? {
        AnyImage::Plane(loaded) => detect_features(args, &loaded, interrupts, console),
        AnyImage::Space(loaded) => detect_features(args, &loaded, interrupts, console),
    }
}

fn detect_features<const D: usize>(
    args: &FeatureArgs,
    loaded: &LoadedImage<D>,
    interrupts: &Interrupts,
    console: &mut Console,
) -> Result<()> {
    let (spec, output) = (&args.spec, args.output.as_path());
    loaded.notes.iter().for_each(|note| console.note(note));
    loaded.image.check(&args.image.display().to_string())?;
    let outcome = crate::features(loaded, spec, &mut console.progress(interrupts))
        .map_err(with_option_name::<FeatureSpec>)?;
    let (features, geometry) = (&outcome.features, &loaded.image.geometry);
    let others = outcome.write_others(spec, geometry)?;
    let potential = features.potential.to_dense().into_image(geometry);
    formats::write(output, &potential)?;
    let dims = format_dims(&potential.dims());
    let mut text = features.notes.join("\n");
    text += &format!("\nwrote {}: {dims} samples", output.display());
    for file in others {
        text += &format!("\nwrote {file}");
    }
    console.result(text, &file_report(output, outcome.to_json(spec)));
    Ok(())
}

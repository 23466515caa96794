//! The verb `feature`: runs only the detection of features.

use std::path::PathBuf;

use clap::Args;
use serde_json::{Value, json};

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::common::output::{
    IMAGE_EXTENSIONS, check_output, file_report, format_dims, path_text, potential_image,
};
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::image::formats::LoadedImage;
use crate::image::formats::with_loaded;
use crate::job::FeatureSpec;
use crate::job::{write_feature_lines, write_feature_points};

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
    check_output(&args.output, "--output", &IMAGE_EXTENSIONS, &[&args.image])?;
    let inputs = [args.image.as_path(), &args.output];
    if let Some(path) = &spec.lines {
        check_output(path, "--lines", &["vtp"], &inputs)?;
    }
    if let Some(path) = &spec.points {
        check_output(path, "--points", &["csv", "vtp"], &inputs)?;
    }
    if let Some(path) = &spec.confidence_out {
        check_output(path, "--confidence-out", &IMAGE_EXTENSIONS, &inputs)?;
    }
    spec.validate().map_err(with_option_name::<FeatureSpec>)?;
    let image = console.read_image(&args.image, &spec.input)?;
    with_loaded!(image, loaded => detect_features(args, &loaded, interrupts, console))
}

fn detect_features<const D: usize>(
    args: &FeatureArgs,
    loaded: &LoadedImage<D>,
    interrupts: &Interrupts,
    console: &mut Console,
) -> Result<()> {
    let spec = &args.spec;
    for note in &loaded.notes {
        console.note(note);
    }
    loaded.image.check(&args.image.display().to_string())?;
    let outcome = console.run(interrupts, |_, progress| {
        crate::features(loaded, spec, progress).map_err(with_option_name::<FeatureSpec>)
    })?;
    let features = &outcome.features;
    let geometry = &loaded.image.geometry;
    if let (Some(path), Some(confidence)) = (&spec.confidence_out, &features.confidence) {
        console.write_image(path, potential_image(confidence.clone(), geometry))?;
    }
    let (mut lines_text, mut lines_json) = (String::new(), Value::Null);
    if let (Some(path), Some(lines), Some((summary, counts))) =
        (&spec.lines, &outcome.lines, outcome.lines_summary())
    {
        write_feature_lines(path, lines, |x| geometry.to_physical(x))?;
        lines_text = format!("\nwrote {}: {summary}", path.display());
        lines_json = file_report(path, counts);
    }
    if let Some(path) = &spec.points {
        write_feature_points(path, features, geometry)?;
        let count = features.points.len();
        lines_text += &format!("\nwrote {}: {count} points", path.display());
    }
    let potential = potential_image(features.potential.to_dense(), geometry);
    let dims = potential.dims().to_vec();
    console.write_image(&args.output, potential)?;
    console.result(
        format_args!(
            "{}\nwrote {}: {} samples{lines_text}",
            features.notes.join("\n"),
            args.output.display(),
            format_dims(&dims),
        ),
        &json!({
            "file": path_text(&args.output),
            "dims": dims,
            "points": features.points.len(),
            "sigma": features.sigma,
            "notes": features.notes,
            "lines": lines_json,
        }),
    );
    Ok(())
}

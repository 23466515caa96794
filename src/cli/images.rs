//! The verbs about images: `info`, `convert`, `feature`, `synth`.

use std::path::Path;

use serde_json::json;

use super::args::{ConvertArgs, FeatureArgs, InfoArgs, SynthArgs};
use super::console::Console;
use super::job::{check_output, feature_scale, positive_distance, threshold};
use super::parse;
use crate::image::{Field, Geometry, Image};
use crate::{Result, feature, io, synth};

/// The endings of the image formats that are written.
pub const WRITTEN: [&str; 2] = ["vti", "npy"];

/// `atomesh info`.
pub fn info(args: &InfoArgs, console: &mut Console) -> Result<()> {
    let description = io::describe(&args.file, &args.input.read_options()?)?;
    let value = serde_json::to_value(&description).unwrap_or_default();
    console.result(description.to_lines().trim_end(), &value);
    Ok(())
}

/// `atomesh convert`.
pub fn convert(args: &ConvertArgs, console: &mut Console) -> Result<()> {
    check_output(&args.output, "OUT", &WRITTEN, &[&args.input_file])?;
    let loaded = io::read(&args.input_file, &args.input.read_options()?)?;
    for note in &loaded.notes {
        console.note(note);
    }
    io::write(&args.output, &loaded.image)?;
    written(console, &args.output, &loaded.image);
    Ok(())
}

/// `atomesh feature`.
pub fn feature(args: &FeatureArgs, console: &mut Console) -> Result<()> {
    check_output(&args.output, "--output", &WRITTEN, &[&args.image])?;
    let options = feature::Options {
        kind: args.feature.into(),
        scale: feature_scale(args.sigma)?,
        threshold: threshold(args.threshold)?,
        d_min: positive_distance(args.distance)?,
        ..feature::Options::default()
    };
    let loaded = io::read(&args.image, &args.input.read_options()?)?;
    for note in &loaded.notes {
        console.note(note);
    }
    loaded.image.check(&args.image.display().to_string())?;
    console.begin_stage("finding features");
    let found = feature::detect(&loaded.image, &options)?;
    let potential = potential_image(&found.potential, &loaded.image.geometry);
    io::write(&args.output, &potential)?;
    let [nx, ny, nz] = potential.dims();
    let path = args.output.display();
    console.result(
        format_args!(
            "{}\nwrote {path}: {nx} x {ny} x {nz} samples",
            found.notes.join("\n")
        ),
        &json!({
            "file": args.output,
            "dims": [nx, ny, nz],
            "points": found.points.len(),
            "sigma": found.sigma,
            "notes": found.notes,
        }),
    );
    Ok(())
}

/// The potential as an image that lies where the image it came from lies.
pub fn potential_image(potential: &Field<3>, geometry: &Geometry<3>) -> Image<3> {
    Image::new(potential.dims, potential.samples.clone(), geometry.clone())
}

/// `atomesh synth`.
pub fn synth(args: &SynthArgs, console: &mut Console) -> Result<()> {
    check_output(&args.output, "--output", &WRITTEN, &[])?;
    if let Some(truth) = &args.truth {
        check_output(truth, "--truth", &["npy"], &[&args.output])?;
    }
    let options = synth::Options {
        dims: parse::dims("--dims", &args.dims)?,
        seed: args.rng_seed,
        count: args.count,
        signal_to_noise: args.signal_to_noise,
        width: args.width,
    };
    let made = synth::make(args.kind.parse()?, &options)?;
    io::write(&args.output, &made.image)?;
    if let Some(path) = &args.truth {
        made.truth.write(path)?;
    }
    written(console, &args.output, &made.image);
    Ok(())
}

/// Says which image was written.
pub fn written(console: &mut Console, path: &Path, image: &Image<3>) {
    let [nx, ny, nz] = image.dims();
    console.result(
        format_args!("wrote {}: {nx} x {ny} x {nz} samples", path.display()),
        &json!({ "file": path, "dims": [nx, ny, nz] }),
    );
}

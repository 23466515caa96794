//! The verbs about images: `info`, `convert`, `feature`, `synth`.

use std::io::Read;
use std::path::Path;

use serde_json::json;

use super::meshes;
use crate::cli::args::{ConvertArgs, FeatureArgs, FeatureChoice, InfoArgs, SynthArgs};
use crate::cli::console::Console;
use crate::cli::job::{
    check_output, feature_scale, feature_weights, positive_distance, seeds, threshold,
};
use crate::cli::parse;
use crate::error::cause;
use crate::image::formats::{AnyLoaded, Loaded};
use crate::image::synth::Synthetic;
use crate::image::{Field, Geometry, Image};
use crate::image::{formats, synth};
use crate::{Error, Result, feature};

/// The endings of the image formats that are written.
pub const WRITTEN: [&str; 7] = ["vti", "npy", "png", "nrrd", "mha", "nii", "gz"];

/// `atomesh info`: of an image, or of a mesh.
pub fn info(args: &InfoArgs, console: &mut Console) -> Result<()> {
    if is_mesh(&args.file) {
        return meshes::info(&args.file, console);
    }
    let description = formats::describe(&args.file, &args.input.read_options()?)?;
    let value = serde_json::to_value(&description).unwrap_or_default();
    console.result(description.to_lines().trim_end(), &value);
    Ok(())
}

/// Whether a file looks like a VTK unstructured grid.
fn is_mesh(path: &Path) -> bool {
    let mut head = Vec::new();
    let file = std::fs::File::open(path);
    let read = file.and_then(|file| file.take(1024).read_to_end(&mut head));
    read.is_ok() && String::from_utf8_lossy(&head).contains("type=\"UnstructuredGrid\"")
}

/// `atomesh convert`.
pub fn convert(args: &ConvertArgs, console: &mut Console) -> Result<()> {
    check_output(&args.output, "OUT", &WRITTEN, &[&args.input_file])?;
    match formats::read_any(&args.input_file, &args.input.read_options()?)? {
        AnyLoaded::Plane(loaded) => rewrite(&loaded, &args.output, console),
        AnyLoaded::Space(loaded) => rewrite(&loaded, &args.output, console),
    }
}

fn rewrite<const D: usize>(loaded: &Loaded<D>, to: &Path, console: &mut Console) -> Result<()> {
    for note in &loaded.notes {
        console.note(note);
    }
    formats::write(to, &loaded.image)?;
    written(console, to, &loaded.image);
    Ok(())
}

/// `atomesh feature`.
pub fn feature(args: &FeatureArgs, console: &mut Console) -> Result<()> {
    check_output(&args.output, "--output", &WRITTEN, &[&args.image])?;
    if let Some(path) = &args.confidence_out {
        check_output(
            path,
            "--confidence-out",
            &WRITTEN,
            &[&args.image, &args.output],
        )?;
        if args.feature != FeatureChoice::Paths {
            return Err(Error::Job(cause(
                "--confidence-out",
                "is of paths, which are not asked for",
                "add --feature paths, or leave it away",
            )));
        }
    }
    match formats::read_any(&args.image, &args.input.read_options()?)? {
        AnyLoaded::Plane(loaded) => find(args, loaded, console),
        AnyLoaded::Space(loaded) => find(args, loaded, console),
    }
}

fn find<const D: usize>(
    args: &FeatureArgs,
    loaded: Loaded<D>,
    console: &mut Console,
) -> Result<()> {
    let options = feature::Detection {
        kind: args.feature.into(),
        scale: feature_scale(args.sigma)?,
        threshold: threshold(args.threshold)?,
        weights: feature_weights(args.feature_weights.as_deref())?,
        seeds: seeds(&args.object, &args.background, args.rng_seed)?,
        d_min: positive_distance(args.distance)?,
        ..feature::Detection::default()
    };
    for note in &loaded.notes {
        console.note(note);
    }
    loaded.image.check(&args.image.display().to_string())?;
    console.begin_stage("finding features");
    let found = feature::detect(&loaded.image, &options)?;
    let potential = potential_image(&found.potential, &loaded.image.geometry);
    formats::write(&args.output, &potential)?;
    if let (Some(path), Some(confidence)) = (&args.confidence_out, &found.confidence) {
        formats::write(path, &potential_image(confidence, &loaded.image.geometry))?;
    }
    let dims = potential.dims().to_vec();
    let path = args.output.display();
    console.result(
        format_args!(
            "{}\nwrote {path}: {} samples",
            found.notes.join("\n"),
            by(&dims)
        ),
        &json!({
            "file": args.output,
            "dims": dims,
            "points": found.points.len(),
            "sigma": found.sigma,
            "notes": found.notes,
        }),
    );
    Ok(())
}

/// 3 x 4 x 5.
fn by(dims: &[usize]) -> String {
    let words: Vec<String> = dims.iter().map(usize::to_string).collect();
    words.join(" x ")
}

/// A potential, or what else there is a value of for every sample, as an image that lies where the image it came from lies.
pub fn potential_image<const D: usize>(potential: &Field<D>, geometry: &Geometry<D>) -> Image<D> {
    Image::new(potential.dims, potential.samples.clone(), geometry.clone())
}

/// `atomesh synth`.
pub fn synth(args: &SynthArgs, console: &mut Console) -> Result<()> {
    check_output(&args.output, "--output", &WRITTEN, &[])?;
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
    match dims.len() {
        2 => keep(args, &synth::make_plane(kind, &options)?, console),
        _ => keep(args, &synth::make(kind, &options)?, console),
    }
}

fn keep<const D: usize>(
    args: &SynthArgs,
    made: &Synthetic<D>,
    console: &mut Console,
) -> Result<()> {
    formats::write(&args.output, &made.image)?;
    if let Some(path) = &args.truth {
        made.truth.write(path)?;
    }
    written(console, &args.output, &made.image);
    Ok(())
}

/// Says which image was written.
pub fn written<const D: usize>(console: &mut Console, path: &Path, image: &Image<D>) {
    let dims = image.dims();
    console.result(
        format_args!("wrote {}: {} samples", path.display(), by(&dims)),
        &json!({ "file": path, "dims": dims.to_vec() }),
    );
}

//! The verbs about images: `info`, `convert`, `synth`.

use std::path::Path;

use serde_json::json;

use super::args::{ConvertArgs, InfoArgs, SynthArgs};
use super::console::Console;
use super::job::check_output;
use super::parse;
use crate::image::{Geometry, Image};
use crate::{Result, io, synth};

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
        let [nx, ny, nz] = made.truth.dims;
        let array = made.truth.to_array().into_raw_vec_and_offset().0;
        io::npy::write(path, &Image::new([nx, ny, nz, 4], array, Geometry::default()))?;
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

//! `atomesh convert`: from one format to another: images, grids of heights, surfaces.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::cli::common::depth::image_in_depth;
use crate::cli::common::output::{WRITTEN, check_output, said_written, shown};
use crate::cli::console::Console;
use crate::error::cause;
use crate::export::surfaces::vtp::read_surfaces;
use crate::export::{
    Gocad, Sticks, SurfaceFile, read_gocad, read_sticks, write_obj, write_sticks, write_tsurf,
    write_vtp,
};
use crate::image::formats::stream::{Opened, Stream};
use crate::image::formats::{AnyLoaded, InputOptions, Loaded, Parts, is_written_in_parts};
use crate::job::asked::VelocityFrom;
use crate::{Error, Result};

/// `atomesh convert`.
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// The image or grid to read; or surfaces: .vtp, GOCAD's .ts or .pl, or .csv of fault sticks
    #[arg(value_name = "IN")]
    pub input_file: PathBuf,
    /// What to write: an image (.vti, .npy, .nrrd, .mha, .nii, .nii.gz, .zarr, in 2-D .png), a grid (.irap, .zmap,
    /// .cps3), or surfaces (.vtp, .obj, .ts, .pl, .csv)
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// Makes depth in metres of an image in two-way time: one velocity in m/s, or a file of interval velocities
    /// in m/s on a grid of its own in two-way time, by which the image is stretched
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    pub velocity: Option<VelocityFrom>,
    /// How to read the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// The endings of surfaces that are read and of those that are written.
const SURFACES: [&str; 4] = ["vtp", "ts", "pl", "csv"];
const SURFACES_OUT: [&str; 5] = ["vtp", "obj", "ts", "pl", "csv"];

/// Runs the verb.
pub fn convert(args: &ConvertArgs, console: &mut Console) -> Result<()> {
    if SURFACES.contains(&ending(&args.input_file).as_str()) {
        args.input.refuse_unused("surfaces are read")?;
        if let Some(velocity) = &args.velocity {
            let place = format!("--velocity {velocity}");
            let problem = "makes depth of images, but surfaces are read";
            let remedy = "make the surfaces in depth, by atomesh surface --velocity";
            return Err(Error::Job(cause(place, problem, remedy)));
        }
        check_output(&args.output, "OUT", &SURFACES_OUT, &[&args.input_file])?;
        return surfaces(&args.input_file, &args.output, console);
    }
    let mut inputs = vec![args.input_file.as_path()];
    inputs.extend(args.input.geometry_from.as_deref());
    if let Some(VelocityFrom::File(path)) = &args.velocity {
        inputs.push(path);
    }
    check_output(&args.output, "OUT", &WRITTEN, &inputs)?;
    let opened = match console.open_image(&args.input_file, &args.input)? {
        Opened::Stream(stream) if args.velocity.is_none() && in_parts(&args.output, console) => {
            return pass_on(stream, &args.output, console);
        }
        other => other,
    };
    match opened.load(&args.input_file)? {
        AnyLoaded::Plane(loaded) => rewrite(loaded, args, console),
        AnyLoaded::Space(loaded) => rewrite(loaded, args, console),
    }
}

fn rewrite<const D: usize>(
    loaded: Loaded<D>,
    args: &ConvertArgs,
    console: &mut Console,
) -> Result<()> {
    let (image, stretch) = image_in_depth(loaded.image, args.velocity.as_ref(), false, console)?;
    let stretched = stretch.iter().flat_map(|stretch| &stretch.notes);
    for note in loaded.notes.iter().chain(stretched) {
        console.note(note);
    }
    let (to, dims) = (args.output.as_path(), image.dims());
    console.write_survey(to, image, loaded.lines)?;
    said_written(console, to, &dims);
    Ok(())
}

/// Whether what goes to `to` is written part by part.
fn in_parts(to: &Path, console: &Console) -> bool {
    !console.keeps(to) && is_written_in_parts(to)
}

/// Writes an image that may be larger than memory as it is read.
fn pass_on(stream: Stream, to: &Path, console: &mut Console) -> Result<()> {
    let head = &stream.head;
    for note in &head.notes {
        console.note(note);
    }
    let parts = Parts {
        dims: head.dims,
        geometry: &head.geometry,
        missing: &head.missing,
        lines: head.lines,
        sample: stream.coded.sample,
        slabs: &stream,
    };
    parts.write(to)?;
    if let Some(note) = stream.note() {
        console.note(note);
    }
    said_written(console, to, &head.dims);
    Ok(())
}

fn ending(path: &Path) -> String {
    let ending = path.extension().unwrap_or_default();
    ending.to_string_lossy().to_lowercase()
}

/// What a file of surfaces holds.
enum Found {
    Surfaces(SurfaceFile<3>),
    Lines(SurfaceFile<2>),
    Sticks(Vec<Sticks>),
}

fn surfaces(from: &Path, to: &Path, console: &mut Console) -> Result<()> {
    let found = match ending(from).as_str() {
        "vtp" => Found::Surfaces(read_surfaces(from)?),
        "csv" => Found::Sticks(read_sticks(from)?),
        _ => match read_gocad(from)? {
            Gocad::Surfaces(file) => Found::Surfaces(file),
            Gocad::Lines(file) => Found::Lines(file),
        },
    };
    let count = match (found, ending(to).as_str()) {
        (Found::Surfaces(_), "pl") => {
            let remedy = "write surfaces as .ts, or as .csv of sticks, and these as .pl";
            let place = format!("OUT {}", to.display());
            let problem = format!("holds lines, but {} surfaces", from.display());
            return Err(Error::Job(cause(place, problem, remedy)));
        }
        (Found::Surfaces(file), "csv") => {
            let sticks = Sticks::of(&file, None);
            write_sticks(to, &sticks)?;
            sticks.len()
        }
        (Found::Surfaces(file), _) => put(to, file, console)?,
        (Found::Lines(file), "csv") => {
            let sticks = Sticks::of_lines(&file);
            write_sticks(to, &sticks)?;
            sticks.len()
        }
        (Found::Lines(file), _) => put(to, file, console)?,
        (Found::Sticks(sticks), "csv") => {
            write_sticks(to, &sticks)?;
            sticks.len()
        }
        (Found::Sticks(sticks), "pl") => put(to, Sticks::lines(&sticks), console)?,
        (Found::Sticks(sticks), _) => put(to, Sticks::surfaces(&sticks), console)?,
    };
    if count == 0 {
        let remedy = "give a file with some";
        return Err(Error::Job(cause(
            from.display(),
            "holds no surface",
            remedy,
        )));
    }
    console.result(
        format_args!("wrote {}: {count} surfaces", to.display()),
        &json!({ "file": shown(to), "surfaces": count }),
    );
    Ok(())
}

fn put<const D: usize>(to: &Path, file: SurfaceFile<D>, console: &mut Console) -> Result<usize> {
    let count = file.names.len();
    console.write_surfaces(to, file, |file| match ending(to).as_str() {
        "vtp" => write_vtp(to, file),
        "obj" => write_obj(to, file),
        _ => write_tsurf(to, file),
    })?;
    Ok(count)
}

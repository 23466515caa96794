//! The verb `convert`: converts images, grids of heights and surfaces from one format to another.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::cli::common::depth::image_in_depth;
use crate::cli::common::output::{IMAGE_EXTENSIONS, check_output, path_text, report_written_image};
use crate::cli::console::Console;
use crate::error::cause;
use crate::export::surfaces::sticks::read_charisma;
use crate::export::surfaces::vtp::read_surfaces;
use crate::export::{FaultSticks, Gocad, SurfaceFile, read_gocad, read_sticks, write_sticks};
use crate::image::formats::segy::{SegyFloat, write_like};
use crate::image::formats::stream::{ImageStream, OpenedImage};
use crate::image::formats::{
    AnyImage, ImageFormat, InputOptions, LoadedImage, ReadOptions, StreamedImage, can_stream,
    detect,
};
use crate::job::spec::NumberOrFile;
use crate::{Error, Result};

/// Arguments of `atomesh convert`.
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// The image or grid to read, or surfaces: .vtp, GOCAD's .ts or .pl, or fault sticks: .csv, .charisma
    #[arg(value_name = "IN")]
    pub input_file: PathBuf,
    /// The file to write: an image (.vti, .npy, .nrrd, .mha, .nii, .nii.gz, .zarr, in 2-D .png, with
    /// --like .sgy), a grid (.irap, .zmap, .cps3), or surfaces (.vtp, .obj, .ts, .pl, .csv)
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// Convert an image from two-way time to depth in metres, with one velocity in m/s or a file of
    /// interval velocities in m/s. Such a file is a grid in two-way time, and the image is
    /// resampled
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    pub velocity: Option<NumberOrFile>,
    /// Write SEG-Y (OUT.sgy) with the headers of this survey, which has as many samples: its text,
    /// lines, coordinates and order of traces
    #[arg(long, value_name = "SURVEY.sgy")]
    pub like: Option<PathBuf>,
    /// The samples of SEG-Y that is written: ibm or ieee floats [default: as in the survey]
    #[arg(long, value_name = "FORMAT", requires = "like")]
    pub sample_format: Option<SegyFloat>,
    /// Options for reading the image, and the survey.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// File endings of SEG-Y.
const SEGY_EXTENSIONS: [&str; 2] = ["sgy", "segy"];

/// File endings of surfaces that can be read, and of those that can be written.
const SURFACE_INPUT_EXTENSIONS: [&str; 5] = ["vtp", "ts", "pl", "csv", "charisma"];
const SURFACE_OUTPUT_EXTENSIONS: [&str; 5] = ["vtp", "obj", "ts", "pl", "csv"];

/// Runs the verb.
pub fn convert(args: &ConvertArgs, console: &mut Console) -> Result<()> {
    if SURFACE_INPUT_EXTENSIONS.contains(&extension(&args.input_file).as_str()) {
        args.input.refuse_unused("surfaces are read")?;
        if let Some(velocity) = &args.velocity {
            let place = format!("--velocity {velocity}");
            let problem = "converts images to depth, but the input holds surfaces";
            let remedy = "extract the surfaces in depth with atomesh surface --velocity";
            return Err(Error::Job(cause(place, problem, remedy)));
        }
        check_output(
            &args.output,
            "OUT",
            &SURFACE_OUTPUT_EXTENSIONS,
            &[&args.input_file],
        )?;
        return convert_surfaces(&args.input_file, &args.output, console);
    }
    let mut inputs = vec![args.input_file.as_path()];
    inputs.extend(args.input.geometry_from.as_deref());
    if let Some(NumberOrFile::File(path)) = &args.velocity {
        inputs.push(path);
    }
    if let Some(template) = &args.like {
        inputs.push(template);
        check_output(&args.output, "OUT", &SEGY_EXTENSIONS, &inputs)?;
        return convert_like(args, template, console);
    }
    if SEGY_EXTENSIONS.contains(&extension(&args.output).as_str()) {
        let place = format!("OUT {}", args.output.display());
        let problem = "is SEG-Y, which is written with the headers of a survey";
        let remedy = "give the survey from which the volume was made: --like survey.sgy";
        return Err(Error::Job(cause(place, problem, remedy)));
    }
    check_output(&args.output, "OUT", &IMAGE_EXTENSIONS, &inputs)?;
    let opened = match console.open_image(&args.input_file, &args.input)? {
        OpenedImage::Stream(stream)
            if args.velocity.is_none() && is_streamed(&args.output, console) =>
        {
            return convert_stream(stream, &args.output, console);
        }
        other => other,
    };
    match opened.load(&args.input_file)? {
        AnyImage::Plane(loaded) => rewrite(loaded, args, console),
        AnyImage::Space(loaded) => rewrite(loaded, args, console),
    }
}

/// Converts a volume to SEG-Y with the headers of a survey.
fn convert_like(args: &ConvertArgs, template: &Path, console: &mut Console) -> Result<()> {
    if let Some(velocity) = &args.velocity {
        let place = format!("--velocity {velocity}");
        let problem = "makes a volume in depth, but the survey's headers are in time";
        return Err(Error::Job(cause(place, problem, "omit it, or write .vti")));
    }
    let bytes = args.input.read_options()?.segy;
    let input = if detect(&args.input_file, &ReadOptions::default()).ok() == Some(ImageFormat::Segy)
    {
        args.input.clone()
    } else {
        args.input.without_segy()
    };
    let AnyImage::Space(loaded) = console
        .open_image(&args.input_file, &input)?
        .load(&args.input_file)?
    else {
        let problem = "is not a volume, but 2-D";
        let remedy = "give a volume that was made from the survey";
        return Err(Error::Job(cause(
            args.input_file.display(),
            problem,
            remedy,
        )));
    };
    let dims = loaded.image.dims();
    let notes = write_like(
        &args.output,
        &loaded.image,
        template,
        &bytes,
        args.sample_format,
    )?;
    notes.iter().for_each(|note| console.note(note));
    report_written_image(console, &args.output, &dims);
    Ok(())
}

fn rewrite<const D: usize>(
    loaded: LoadedImage<D>,
    args: &ConvertArgs,
    console: &mut Console,
) -> Result<()> {
    let (image, conversion) = image_in_depth(loaded.image, args.velocity.as_ref(), false, console)?;
    let conversion_notes = conversion.iter().flat_map(|conversion| &conversion.notes);
    for note in loaded.notes.iter().chain(conversion_notes) {
        console.note(note);
    }
    let (output, dims) = (args.output.as_path(), image.dims());
    console.write_survey(output, image, loaded.line_numbers)?;
    report_written_image(console, output, &dims);
    Ok(())
}

/// Returns `true` if output to `path` is written slab by slab.
fn is_streamed(path: &Path, console: &Console) -> bool {
    !console.keeps_in_memory(path) && can_stream(path)
}

/// Converts an image that may be larger than memory: it is written as it is read.
fn convert_stream(stream: ImageStream, output: &Path, console: &mut Console) -> Result<()> {
    let head = &stream.header;
    for note in &head.notes {
        console.note(note);
    }
    let parts = StreamedImage {
        dims: head.dims,
        geometry: &head.geometry,
        missing: &head.missing,
        line_numbers: head.line_numbers,
        sample_type: stream.encoding.sample_type,
        slabs: &stream,
    };
    parts.write(output)?;
    if let Some(note) = stream.rounding_note() {
        console.note(note);
    }
    report_written_image(console, output, &head.dims);
    Ok(())
}

fn extension(path: &Path) -> String {
    let ending = path.extension().unwrap_or_default();
    ending.to_string_lossy().to_lowercase()
}

/// The content of a file of surfaces.
enum SurfaceInput {
    Surfaces(SurfaceFile<3>),
    Lines(SurfaceFile<2>),
    Sticks(Vec<FaultSticks>),
}

fn convert_surfaces(input: &Path, output: &Path, console: &mut Console) -> Result<()> {
    let content = match extension(input).as_str() {
        "vtp" => SurfaceInput::Surfaces(read_surfaces(input)?),
        "csv" => SurfaceInput::Sticks(read_sticks(input)?),
        "charisma" => SurfaceInput::Sticks(read_charisma(input)?),
        _ => match read_gocad(input)? {
            Gocad::Surfaces(file) => SurfaceInput::Surfaces(file),
            Gocad::Lines(file) => SurfaceInput::Lines(file),
        },
    };
    let count = match (content, extension(output).as_str()) {
        (SurfaceInput::Surfaces(_), "pl") => {
            let remedy =
                "write surfaces as .ts, or as sticks (.csv), which can be converted to .pl";
            let place = format!("OUT {}", output.display());
            let problem = format!("holds lines, but {} surfaces", input.display());
            return Err(Error::Job(cause(place, problem, remedy)));
        }
        (SurfaceInput::Surfaces(file), "csv") => {
            let sticks = FaultSticks::from_surfaces(&file, None);
            write_sticks(output, &sticks)?;
            sticks.len()
        }
        (SurfaceInput::Surfaces(file), _) => write_surfaces(output, file, console)?,
        (SurfaceInput::Lines(file), "csv") => {
            let sticks = FaultSticks::from_lines(&file);
            write_sticks(output, &sticks)?;
            sticks.len()
        }
        (SurfaceInput::Lines(file), _) => write_surfaces(output, file, console)?,
        (SurfaceInput::Sticks(sticks), "csv") => {
            write_sticks(output, &sticks)?;
            sticks.len()
        }
        (SurfaceInput::Sticks(sticks), "pl") => {
            write_surfaces(output, FaultSticks::to_lines(&sticks), console)?
        }
        (SurfaceInput::Sticks(sticks), _) => {
            write_surfaces(output, FaultSticks::to_surfaces(&sticks), console)?
        }
    };
    if count == 0 {
        let remedy = "give a file with surfaces";
        return Err(Error::Job(cause(
            input.display(),
            "holds no surface",
            remedy,
        )));
    }
    console.result(
        format_args!("wrote {}: {count} surfaces", output.display()),
        &json!({ "file": path_text(output), "surfaces": count }),
    );
    Ok(())
}

fn write_surfaces<const D: usize>(
    path: &Path,
    file: SurfaceFile<D>,
    console: &mut Console,
) -> Result<usize> {
    let count = file.names.len();
    console.write_surfaces(path, file)?;
    Ok(count)
}

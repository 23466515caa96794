//! The verb `convert`: converts images, grids of heights and surfaces from one format to another.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::common::output::{IMAGE_EXTENSIONS, check_output, path_text, report_written_image};
use crate::cli::console::Console;
use crate::export::convert::{ConvertSpec, Converted, SEGY_EXTENSIONS, holds_surfaces};
use crate::image::formats::{InputOptions, OpenedImage};
use crate::job::spec::NumberOrFile;

/// Arguments of `atomesh convert`.
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// The image or grid to read, or surfaces: .vtp, GOCAD's .ts or .pl, .obj, .stl,
    /// .ply, or fault sticks: .csv, .charisma
    #[arg(value_name = "IN")]
    pub input_file: PathBuf,
    /// The file to write: an image (.vti, .npy, .nrrd, .mha, .nii, .nii.gz, .zarr, in 2-D .png, with
    /// --like .sgy), a grid (.irap, .zmap, .cps3, .grd, .asc), or surfaces (.vtp, .obj, .ts, .pl, .csv)
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// Options of the conversion.
    #[command(flatten)]
    pub spec: ConvertSpec,
}

/// File endings of surfaces that can be written.
const SURFACE_EXTENSIONS: [&str; 5] = ["vtp", "obj", "ts", "pl", "csv"];

impl ConvertArgs {
    /// Checks that the options apply, and that the output replaces no input.
    fn check_files(&self) -> Result<()> {
        let Self {
            input_file,
            output,
            spec,
        } = self;
        spec.validate(input_file, output)?;
        if holds_surfaces(input_file) {
            return check_output(output, "OUT", &SURFACE_EXTENSIONS, &[input_file]);
        }
        let mut inputs = vec![input_file.as_path()];
        inputs.extend(spec.input.geometry_from.as_deref());
        inputs.extend(spec.like.as_deref());
        if let Some(NumberOrFile::File(path)) = &spec.velocity {
            inputs.push(path);
        }
        let endings = match &spec.like {
            Some(_) => &SEGY_EXTENSIONS[..],
            None => &IMAGE_EXTENSIONS,
        };
        check_output(output, "OUT", endings, &inputs)
    }
}

/// Runs the verb.
pub fn convert(args: &ConvertArgs, console: &mut Console) -> Result<()> {
    let output = args.output.as_path();
    args.check_files()
        .map_err(with_option_name::<ConvertSpec>)?;
    let in_memory = console.keeps_in_memory(output);
    let open = |path: &Path, input: &InputOptions| {
        if in_memory {
            console.read_image(path, input).map(OpenedImage::InMemory)
        } else {
            console.open_image(path, input)
        }
    };
    let (converted, notes) = crate::convert(&args.input_file, output, &args.spec, &open)
        .map_err(with_option_name::<ConvertSpec>)?;
    notes.iter().for_each(|note| console.note(note));
    let (dims, surfaces) = (converted.dims(), converted.surface_count());
    match converted {
        Converted::Image(image) => console.write_any_image(output, image)?,
        Converted::Surfaces(surfaces) => console.write_any_surfaces(output, surfaces)?,
        other => other
            .write(output)?
            .iter()
            .for_each(|note| console.note(note)),
    }
    if dims.is_empty() {
        console.result(
            format_args!("wrote {}: {surfaces} surfaces", output.display()),
            &json!({ "file": path_text(output), "surfaces": surfaces }),
        );
    } else {
        report_written_image(console, output, &dims);
    }
    Ok(())
}

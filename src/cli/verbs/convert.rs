//! The verb `convert`: converts images, grids of heights and surfaces from one format to another.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::common::output::report_written_image;
use crate::cli::console::Console;
use crate::export::convert::{ConvertSpec, open_with_options};
use crate::files::output::file_report;

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

/// Runs the verb.
pub fn convert(args: &ConvertArgs, console: &mut Console) -> Result<()> {
    let (input, output, spec) = (&args.input_file, args.output.as_path(), &args.spec);
    spec.check_files(input, output)
        .map_err(with_option_name::<ConvertSpec>)?;
    let (converted, notes) = crate::convert(input, output, spec, &open_with_options)
        .map_err(with_option_name::<ConvertSpec>)?;
    notes.iter().for_each(|note| console.note(note));
    let notes = converted.write(output)?;
    notes.iter().for_each(|note| console.note(note));
    match &converted.dims()[..] {
        [] => {
            let surfaces = converted.surface_count();
            console.result(
                format_args!("wrote {}: {surfaces} surfaces", output.display()),
                &file_report(output, json!({ "surfaces": surfaces })),
            );
        }
        dims => report_written_image(console, output, dims),
    }
    Ok(())
}

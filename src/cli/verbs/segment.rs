//! The verb `segment`: separates an object from the background by a minimum cut on the cells of a
//! mesh.

use std::path::PathBuf;

use clap::Args;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::files::output::file_report;
use crate::image::formats::read_with_options;
use crate::model::segment::SegmentSpec;
use crate::progress::Stage;

/// Arguments of `atomesh segment`.
#[derive(Debug, Args)]
pub struct SegmentArgs {
    /// The image that was meshed, or another of the same dimensions
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The mesh to write, with `label` (1 object, 0 background) and `mean` (of the image) for each
    /// cell
    #[arg(short, long, value_name = "SEG.vtu")]
    pub output: PathBuf,
    /// Options of the segmentation.
    #[command(flatten)]
    pub spec: SegmentSpec,
}

/// Runs the verb.
pub fn segment(args: &SegmentArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let (spec, output) = (&args.spec, args.output.as_path());
    spec.check_files(&args.image, &args.mesh, output)
        .map_err(with_option_name::<SegmentSpec>)?;
    console.begin_stage(Stage::Reading);
    let mesh = console.read_mesh(&args.mesh)?;
    let image =
        read_with_options(&args.image, &spec.input).map_err(with_option_name::<SegmentSpec>)?;
    let (mesh, image) = ((mesh, args.mesh.as_path()), (image, args.image.as_path()));
    let outcome =
        console.run_on_mesh_and_image(interrupts, mesh, image, None, |mesh, image, progress| {
            crate::segment(mesh, image, spec, progress).map_err(with_option_name::<SegmentSpec>)
        })?;
    console.begin_stage(Stage::Writing);
    outcome.write_others(spec)?;
    outcome.mesh.write(output)?;
    console.result(
        format_args!("{}\nwrote {}", outcome.table(), output.display()),
        &file_report(output, outcome.to_json(spec)),
    );
    Ok(())
}

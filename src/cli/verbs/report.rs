//! The verb `report`: writes a page with mesh, image and figures.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::Result;
use crate::assess::ReportSpec;
use crate::cli::common::options::with_option_name;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::files::output::file_report;
use crate::image::formats::{file_hash, read_with_options};
use crate::progress::Stage;

/// Arguments of `atomesh report`.
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// The image that was meshed
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// The mesh of the image
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The page to write
    #[arg(short, long, value_name = "PAGE.html")]
    pub output: PathBuf,
    /// Options of the page.
    #[command(flatten)]
    pub spec: ReportSpec,
}

/// Runs the verb.
pub fn report(args: &ReportArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let (spec, output) = (&args.spec, args.output.as_path());
    spec.check_files(&args.image, &args.mesh, output)?;
    console.begin_stage(Stage::Reading);
    let image =
        read_with_options(&args.image, &spec.input).map_err(with_option_name::<ReportSpec>)?;
    let mesh = console.read_mesh(&args.mesh)?;
    // The figures of a run hold the hash already.
    let hash = || file_hash(&args.image);
    let sha256 = spec.figures.is_none().then(hash).transpose()?;
    let (mesh, image) = ((mesh, args.mesh.as_path()), (image, args.image.as_path()));
    let stats = console.run_on_mesh_and_image(
        interrupts,
        mesh,
        image,
        sha256,
        |mesh, image, progress| {
            crate::report(mesh, image, output, spec, progress)
                .map_err(with_option_name::<ReportSpec>)
        },
    )?;
    console.result(
        format_args!("wrote {}", stats.written_message(output)),
        &file_report(output, json!({ "page": stats })),
    );
    Ok(())
}

//! The verb `slice`: draws pictures of meshes, images, surfaces and lines.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::export::convert::open_with_options;
use crate::export::surfaces::vtp::read_shapes;
use crate::files::output::file_report;
use crate::model::slice::{SliceInput, SliceSpec};
use crate::progress::Stage;

/// Arguments of `atomesh slice`.
#[derive(Debug, Args)]
pub struct SliceArgs {
    /// The files to draw: the image that was meshed, its mesh (.vtu), surfaces and lines (.vtp).
    /// With --view 3d each of these may be drawn alone
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,
    /// The picture to write
    #[arg(short, long, value_name = "OUT.png")]
    pub output: PathBuf,
    /// Options of the picture.
    #[command(flatten)]
    pub spec: SliceSpec,
}

/// Runs the verb.
pub fn slice(args: &SliceArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let (spec, output) = (&args.spec, args.output.as_path());
    let names = spec
        .check_files(&args.files, output)
        .map_err(with_option_name::<SliceSpec>)?;
    console.begin_stage(Stage::Reading);
    let open = |path: &PathBuf| open_with_options(path, &spec.input);
    let image = names.image.as_ref().map(open).transpose();
    let read_mesh = |path: &PathBuf| console.read_mesh(path);
    let input = SliceInput {
        image: image.map_err(with_option_name::<SliceSpec>)?,
        mesh: names.mesh.as_ref().map(read_mesh).transpose()?,
        shapes: (names
            .shapes
            .iter()
            .map(|path| read_shapes(path))
            .collect::<Result<Vec<_>>>())?
        .concat(),
        names,
    };
    let picture = crate::slice(input, spec, &mut console.progress(interrupts))
        .map_err(with_option_name::<SliceSpec>)?;
    picture.write(output)?;
    let [width, height] = picture.size();
    console.result(
        format_args!("wrote {}: {width} x {height} pixels", output.display()),
        &file_report(output, json!({ "size": [width, height] })),
    );
    Ok(())
}

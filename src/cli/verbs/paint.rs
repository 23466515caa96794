//! The verb `paint`: grows regions of cells from seeds, within layers but not across surfaces.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::common::output::{check_output, path_text};
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::model::paint::PaintSpec;
use crate::progress::Stage;
use crate::surfaces::outcome::SURFACE_EXTENSIONS;

/// Arguments of `atomesh paint`.
#[derive(Debug, Args)]
pub struct PaintArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The mesh to write, with the painted regions as cell data `region` (0: not painted)
    #[arg(short, long, value_name = "OUT.vtu")]
    pub output: PathBuf,
    /// Options of the paint.
    #[command(flatten)]
    pub spec: PaintSpec,
}

/// Runs the verb.
pub fn paint(args: &PaintArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let spec = &args.spec;
    let mut inputs: Vec<&Path> = vec![&args.mesh];
    inputs.extend(spec.image.as_deref());
    check_output(&args.output, "--output", &["vtu"], &inputs)?;
    if let Some(path) = &spec.surface_out {
        inputs.push(&args.output);
        check_output(path, "--surface-out", &SURFACE_EXTENSIONS, &inputs)?;
    }
    spec.validate().map_err(with_option_name::<PaintSpec>)?;
    let outcome = console.run_on_mesh(interrupts, &args.mesh, |input, progress| {
        crate::paint(input, spec, progress).map_err(with_option_name::<PaintSpec>)
    })?;
    console.begin_stage(Stage::Writing);
    let (table, count) = (outcome.table(), outcome.regions.len());
    if let (Some(path), Some(surfaces)) = (&spec.surface_out, outcome.surfaces) {
        console.write_any_surfaces(path, surfaces)?;
    }
    console.write_any_mesh(&args.output, outcome.mesh)?;
    console.result(
        format_args!("{table}\nwrote {}: {count} regions", args.output.display()),
        &json!({
            "file": path_text(&args.output),
            "surface": spec.surface_out.as_deref().map(path_text),
            "blocks": outcome.blocks,
            "regions": outcome.regions,
        }),
    );
    Ok(())
}

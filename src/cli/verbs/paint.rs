//! The verb `paint`: grows regions of cells from seeds, within layers but not across surfaces.

use std::path::PathBuf;

use clap::Args;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::files::output::file_report;
use crate::model::paint::PaintSpec;
use crate::progress::Stage;

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
    let (spec, output) = (&args.spec, args.output.as_path());
    spec.check_files(&args.mesh, output)
        .map_err(with_option_name::<PaintSpec>)?;
    let outcome = console.run_on_mesh(interrupts, &args.mesh, |input, progress| {
        crate::paint(input, spec, progress).map_err(with_option_name::<PaintSpec>)
    })?;
    console.begin_stage(Stage::Writing);
    outcome.write_others(spec)?;
    outcome.mesh.write(output)?;
    let (table, count) = (outcome.table(), outcome.regions.len());
    console.result(
        format_args!("{table}\nwrote {}: {count} regions", output.display()),
        &file_report(output, outcome.to_json(spec)),
    );
    Ok(())
}

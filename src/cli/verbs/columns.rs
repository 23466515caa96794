//! The verb `columns`: extends the Voronoi cells of a map down through layers between horizons.

use std::path::PathBuf;

use clap::Args;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::files::output::{file_report, path_text};
use crate::image::formats::{file_hash, read_with_options};
use crate::model::columns::given::GivenHorizon;
use crate::model::columns::{ColumnsInput, ColumnsSpec};
use crate::progress::Stage;
use crate::store::AnyMesh;

/// Arguments of `atomesh columns`.
#[derive(Debug, Args)]
pub struct ColumnsArgs {
    /// The map: a mesh of Voronoi cells of a 2-D image, made by `atomesh mesh MAP --cells voronoi`
    #[arg(value_name = "MAP.vtu")]
    pub map: PathBuf,
    /// The mesh to write
    #[arg(short, long, value_name = "CELLS.vtu")]
    pub output: PathBuf,
    /// A horizon; give at least two, from the top down. Each is a number z, a 2-D image of z (with
    /// the dimensions of the meshed image, or with its own position), a grid (IRAP, ZMAP+, CPS-3, Surfer, ESRI ASCII), or
    /// surfaces FILE[:NAME] (.ts, .vtp, .obj) or points. z is brought to one unit and one direction; what a file does not say
    /// follows it: ,unit=ft ,z=down ,null=-999
    #[arg(long, value_name = "Z", required = true, allow_hyphen_values = true)]
    pub horizon: Vec<String>,
    /// Options of the columns.
    #[command(flatten)]
    pub spec: ColumnsSpec,
}

/// Runs the verb.
pub fn columns(args: &ColumnsArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let (spec, output) = (&args.spec, args.output.as_path());
    spec.check_files(&args.map, &args.horizon, output)
        .map_err(with_option_name::<ColumnsSpec>)?;
    console.begin_stage(Stage::Reading);
    let map = console.read_mesh(&args.map)?;
    let sha256 = file_hash(&args.map)?;
    let progress = &mut console.progress(interrupts);
    let horizon =
        |text: &String| GivenHorizon::read(text, &spec.input, &read_with_options, progress);
    let horizons: Result<_> = args.horizon.iter().map(horizon).collect();
    let outcome = horizons
        .and_then(|horizons| {
            let input = ColumnsInput {
                map,
                name: &path_text(&args.map),
                sha256,
                horizons,
            };
            crate::columns(input, spec, progress)
        })
        .map_err(with_option_name::<ColumnsSpec>)?;
    console.begin_stage(Stage::Writing);
    let (table, report) = (outcome.table(), outcome.to_json());
    AnyMesh::Polyhedra(outcome.mesh).write(output)?;
    console.result(
        format_args!("{table}\nwrote {}", output.display()),
        &file_report(output, report),
    );
    Ok(())
}

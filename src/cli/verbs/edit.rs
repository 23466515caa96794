//! The verb `edit`: adds, moves and removes atoms, and meshes only their neighbourhood again.

use std::path::PathBuf;

use clap::Args;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::edit::{EditSpec, input_options};
use crate::files::output::{file_report, path_text};
use crate::image::formats::{InputOptions, file_hash, read_with_options};
use crate::job::MeshSpec;
use crate::progress::Stage;
use crate::report::Clock;

/// Arguments of `atomesh edit`.
#[derive(Debug, Args)]
pub struct EditArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The image that was meshed
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// The edited mesh to write
    #[arg(short, long, value_name = "OUT.vtu")]
    pub output: PathBuf,
    /// Options of the edits.
    #[command(flatten)]
    pub spec: EditSpec,
}

/// Runs the verb.
pub fn edit(args: &EditArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let (spec, output) = (&args.spec, args.output.as_path());
    spec.check_files(&args.mesh, &args.image, output)?;
    let mut clock = Clock::new();
    console.begin_stage(Stage::Reading);
    clock.begin(Stage::Reading);
    let mesh = console.read_mesh(&args.mesh)?;
    let input = input_options(&mesh, &path_text(&args.mesh), &spec.input)?;
    let image = read_with_options(&args.image, &input).map_err(with_option_name::<InputOptions>)?;
    let sha256 = Some(file_hash(&args.image)?);
    clock.end();
    let (mesh, image) = ((mesh, args.mesh.as_path()), (image, args.image.as_path()));
    let outcome = console.run_on_mesh_and_image(
        interrupts,
        mesh,
        image,
        sha256,
        |mesh, image, progress| {
            crate::edit(mesh, image, spec, progress)
                .map_err(with_option_name::<EditSpec>)
                .map_err(with_option_name::<MeshSpec>)
        },
    )?;
    console.begin_stage(Stage::Writing);
    clock.begin(Stage::Writing);
    outcome.mesh.write(output)?;
    clock.end();
    let mut report = outcome.report;
    report.add_costs(clock.costs());
    console.result(
        format_args!("{}\nwrote {}", report.table(), output.display()),
        &file_report(output, report.to_json()),
    );
    Ok(())
}

//! The verb `edit`: adds, moves and removes atoms, and meshes only their neighbourhood again.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::common::output::{check_output, file_report, path_text};
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::edit::{EditSpec, input_options};
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
    let spec = &args.spec;
    let mut inputs: Vec<&Path> = vec![&args.mesh, &args.image];
    inputs.extend(spec.edits.as_deref());
    check_output(&args.output, "--output", &["vtu"], &inputs)?;
    spec.validate()?;
    let mut clock = Clock::new();
    console.begin_stage(Stage::Reading);
    clock.begin(Stage::Reading);
    let mesh = console.read_mesh(&args.mesh)?;
    let mesh_name = path_text(&args.mesh);
    let input = input_options(&mesh, &mesh_name, &spec.input)?;
    let image = console.read_image(&args.image, &input)?;
    let sha256 = Some(console.hash(&args.image)?);
    clock.end();
    let outcome = console.run_on_mesh_and_image(
        interrupts,
        mesh,
        image,
        [&args.mesh, &args.image],
        sha256,
        |mesh, image, progress| {
            crate::edit(mesh, image, spec, progress)
                .map_err(with_option_name::<EditSpec>)
                .map_err(with_option_name::<MeshSpec>)
        },
    )?;
    console.begin_stage(Stage::Writing);
    clock.begin(Stage::Writing);
    console.write_any_mesh(&args.output, outcome.mesh)?;
    clock.end();
    let mut report = outcome.report;
    let stages = &mut report.summary.stages;
    stages.splice(0..0, clock.costs()[..1].iter().cloned());
    stages.extend_from_slice(&clock.costs()[1..]);
    console.result(
        format_args!("{}\nwrote {}", report.table(), args.output.display()),
        &file_report(&args.output, report.to_json()),
    );
    Ok(())
}

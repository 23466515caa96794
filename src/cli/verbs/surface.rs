//! The verb `surface`: groups faces on features into labelled surfaces.

use std::path::PathBuf;

use clap::Args;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::files::output::{file_report, path_text};
use crate::progress::Stage;
use crate::surfaces::SurfaceSpec;

/// Arguments of `atomesh surface`.
#[derive(Debug, Args)]
pub struct SurfaceArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The file to write: surfaces as .vtp, .obj, or GOCAD's .ts; faults as sticks: .csv, .charisma;
    /// horizons as grids of their heights, .irap, .zmap, .cps3, .grd, .asc, or as points, .xyz
    #[arg(short, long, value_name = "S.vtp")]
    pub output: PathBuf,
    /// Options of the surfaces.
    #[command(flatten)]
    pub spec: SurfaceSpec,
}

/// Runs the verb.
pub fn surface(args: &SurfaceArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let (spec, output) = (&args.spec, args.output.as_path());
    spec.check_files(&args.mesh, output)
        .map_err(with_option_name::<SurfaceSpec>)?;
    let outcome = console.run_on_mesh(interrupts, &args.mesh, |input, progress| {
        crate::surfaces(input, spec, progress).map_err(with_option_name::<SurfaceSpec>)
    })?;
    console.begin_stage(Stage::Writing);
    let mut text = outcome.table(spec.meets);
    let mut fields = outcome.to_json(spec);
    if let Some(path) = &spec.mesh_out {
        outcome.write_mesh(spec)?;
        text += &format!("\nwrote {}: the mesh with these names", path.display());
    }
    let note = outcome.grid_note(output, spec);
    note.iter().for_each(|note| console.note(note));
    let files = outcome.write(output, spec)?;
    if let [only] = &files[..] {
        let what = match spec.number {
            Some(number) => format!("surface {number}"),
            None => format!("{} surfaces", outcome.len()),
        };
        text += &format!("\nwrote {}: {what}", only.display());
    } else {
        for file in &files {
            text += &format!("\nwrote {}", file.display());
        }
        fields["files"] = files.iter().map(|file| path_text(file)).collect();
    }
    console.result(text, &file_report(output, fields));
    Ok(())
}

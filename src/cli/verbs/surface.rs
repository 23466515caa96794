//! The verb `surface`: groups faces on features into labelled surfaces.

use std::path::PathBuf;

use clap::Args;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::common::output::{check_output, file_report, path_text};
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::image::formats::grids::GRID_EXTENSIONS;
use crate::progress::Stage;
use crate::surfaces::SurfaceSpec;
use crate::surfaces::outcome::{POINT_EXTENSIONS, STICK_EXTENSIONS, SURFACE_EXTENSIONS};

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
    let mut inputs = vec![args.mesh.as_path()];
    inputs.extend(spec.image.as_deref());
    inputs.extend(spec.survey.as_deref());
    inputs.extend(spec.names_from.as_ref().map(|file| &*file.path));
    let endings = [
        &SURFACE_EXTENSIONS[..],
        &STICK_EXTENSIONS,
        &GRID_EXTENSIONS,
        &POINT_EXTENSIONS,
    ]
    .concat();
    check_output(output, "--output", &endings, &inputs)?;
    if let Some(path) = &spec.mesh_out {
        inputs.push(output);
        check_output(path, "--mesh-out", &["vtu"], &inputs)?;
    }
    spec.check_target(output)
        .and_then(|()| spec.validate())
        .map_err(with_option_name::<SurfaceSpec>)?;
    let mut outcome = console.run_on_mesh(interrupts, &args.mesh, |input, progress| {
        crate::surfaces(input, spec, progress).map_err(with_option_name::<SurfaceSpec>)
    })?;
    console.begin_stage(Stage::Writing);
    let mut text = outcome.table(spec.meets);
    let (count, mut fields) = (outcome.len(), outcome.to_json());
    if let (Some(path), Some(mesh)) = (&spec.mesh_out, outcome.mesh.take()) {
        console.write_any_mesh(path, mesh)?;
        text += &format!("\nwrote {}: the mesh with these names", path.display());
        fields["mesh"] = path_text(path).into();
    }
    let note = outcome.grid_note(output, spec);
    note.iter().for_each(|note| console.note(note));
    let files = console.write_outcome_surfaces(output, outcome, spec)?;
    if let [only] = &files[..] {
        let what = match spec.number {
            Some(number) => format!("surface {number}"),
            None => format!("{count} surfaces"),
        };
        text += &format!("\nwrote {}: {what}", only.display());
    } else {
        for file in &files {
            text += &format!("\nwrote {}", file.display());
        }
        fields["files"] = files.iter().map(|file| path_text(file)).collect();
    }
    let report = file_report(output, fields);
    console.result(text, &report);
    Ok(())
}

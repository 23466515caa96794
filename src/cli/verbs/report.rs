//! The verb `report`: writes a page with mesh, image and figures.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::Result;
use crate::assess::ReportSpec;
use crate::cli::common::options::with_option_name;
use crate::cli::common::output::{check_output, path_text};
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::export::page::PageStats;
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
    let spec = &args.spec;
    let mut inputs = vec![args.image.as_path(), args.mesh.as_path()];
    inputs.extend(spec.figures.as_deref());
    check_output(&args.output, "--output", &["html"], &inputs)?;
    console.begin_stage(Stage::Reading);
    let image = console.read_image(&args.image, &spec.input)?;
    let mesh = console.read_mesh(&args.mesh)?;
    // The figures of a run hold the hash already.
    let hash = || console.hash(&args.image);
    let sha256 = spec.figures.is_none().then(hash).transpose()?;
    let stats = console.run_on_mesh_and_image(
        interrupts,
        mesh,
        image,
        [&args.mesh, &args.image],
        sha256,
        |mesh, image, progress| {
            crate::report(mesh, image, &args.output, spec, progress)
                .map_err(with_option_name::<ReportSpec>)
        },
    )?;
    console.result(
        written_message(&args.output, stats),
        &json!({ "file": path_text(&args.output), "page": stats }),
    );
    Ok(())
}

/// Returns a line that describes the page that was written.
pub(super) fn written_message(path: &Path, stats: PageStats) -> String {
    let megabytes = stats.bytes as f64 * 1e-6;
    let thinned = if stats.is_thinned {
        format!(
            ", {} of {} faces: its cut stops at {} places along each axis",
            stats.faces,
            stats.total_faces,
            stats.cut_steps - 1
        )
    } else {
        String::new()
    };
    format!("wrote {}: {megabytes:.1} MB{thinned}", path.display())
}

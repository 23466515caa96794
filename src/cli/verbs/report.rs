//! The verb `report`: writes a page with mesh, image and figures.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::{Value, json};

use super::quality::{cell_figures, figures};
use crate::cli::common::output::{check_output, path_text};
use crate::cli::console::Console;
use crate::error::{cause, io_error};
use crate::export::page::{self, MAX_PAGE_BYTES, PageInfo, PageStats};
use crate::image::Image;
use crate::image::formats::{AnyImage, InputOptions};
use crate::mesh::Simplices;
use crate::mesh::poly::PolyMesh;
use crate::report::{Input, Report};
use crate::store::{AnyMesh, FieldValue, MeshFile, Storable, StoredMesh};
use crate::{Error, Result};

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
    /// The file that mesh --report has written, for its fidelity, notes and cost [default: figures
    /// are measured from the mesh]
    #[arg(long, value_name = "REPORT.json")]
    pub figures: Option<PathBuf>,
    /// Heading of the page [default: the mesh's name]
    #[arg(long, value_name = "TEXT")]
    pub title: Option<String>,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// Runs the verb.
pub fn report(args: &ReportArgs, console: &mut Console) -> Result<()> {
    let mut inputs = vec![args.image.as_path(), args.mesh.as_path()];
    inputs.extend(args.figures.as_deref());
    check_output(&args.output, "--output", &["html"], &inputs)?;
    console.begin_stage("reading");
    let run_report = args.figures.as_deref().map(read_figures).transpose()?;
    let image = console.read_image(&args.image, &args.input)?;
    let mesh = console.read_mesh(&args.mesh)?;
    let job = ReportRequest { args, run_report };
    let stats = match (image, mesh) {
        (AnyImage::Plane(l), AnyMesh::Triangles(file)) => {
            job.report_simplices(&l.image, file, console)?
        }
        (AnyImage::Plane(l), AnyMesh::Polygons(file)) => {
            job.report_cells(&l.image, file, console)?
        }
        (AnyImage::Space(l), AnyMesh::Tetrahedra(file)) => {
            job.report_simplices(&l.image, file, console)?
        }
        (AnyImage::Space(l), AnyMesh::Polyhedra(file)) => {
            job.report_cells(&l.image, file, console)?
        }
        (image, _) => {
            let (image_dimension, mesh_dimension) = match image {
                AnyImage::Plane(_) => (2, 3),
                AnyImage::Space(_) => (3, 2),
            };
            let problem =
                format!("is a {mesh_dimension}-D mesh, but the image is {image_dimension}-D");
            let remedy = "give the mesh of the image";
            return Err(Error::Job(cause(args.mesh.display(), problem, remedy)));
        }
    };
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

/// Reads the report of a run.
fn read_figures(path: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(path).map_err(|e| io_error(path, "read", e))?;
    let refuse = |problem: String| {
        let place = format!("--figures {}", path.display());
        Error::Job(cause(
            place,
            problem,
            "give the file that mesh --report has written",
        ))
    };
    let value: Value = serde_json::from_str(&text)
        .map_err(|e| refuse(format!("is not JSON ({e})")).with_source(e))?;
    if value.get("version").is_some() && value.get("quality").is_some() {
        Ok(value)
    } else {
        Err(refuse("is not a report of atomesh".to_string()))
    }
}

/// The arguments, and the report of the run if it is given.
struct ReportRequest<'a> {
    args: &'a ReportArgs,
    run_report: Option<Value>,
}

impl ReportRequest<'_> {
    fn report_simplices<const D: usize, M: Simplices<D>>(
        self,
        image: &Image<D>,
        file: MeshFile<M>,
        console: &mut Console,
    ) -> Result<PageStats> {
        self.write(image, file, console, |stored| figures(stored, None))
    }

    fn report_cells<const D: usize>(
        self,
        image: &Image<D>,
        file: MeshFile<PolyMesh<D>>,
        console: &mut Console,
    ) -> Result<PageStats> {
        self.write(image, file, console, |stored| {
            Ok(cell_figures(stored, None))
        })
    }

    fn write<const D: usize, M: Storable<D>>(
        self,
        image: &Image<D>,
        file: MeshFile<M>,
        console: &mut Console,
        measure: impl FnOnce(&mut StoredMesh<D, M>) -> Result<Report>,
    ) -> Result<PageStats> {
        let Self { args, run_report } = self;
        let place = args.mesh.display().to_string();
        let mut stored = StoredMesh::new(file, &place)?;
        stored.space.check_image(
            &image.geometry,
            image.dims(),
            &args.image.display().to_string(),
        )?;
        let report = match run_report {
            Some(run_report) => run_report,
            None => {
                console.begin_stage("measuring the mesh");
                let mut report = measure(&mut stored)?;
                report.input = Some(Input {
                    file: path_text(&args.image),
                    dims: image.dims().to_vec(),
                    hash: format!("sha256:{}", console.hash(&args.image)?),
                });
                report.to_json()
            }
        };
        console.begin_stage("writing");
        let text = |name: &str| match stored.arrays.field_value(name) {
            Some(FieldValue::Text(text)) => text.trim_end_matches('\0').to_string(),
            _ => String::new(),
        };
        let name = args.mesh.file_name().unwrap_or(args.mesh.as_os_str());
        let info = PageInfo {
            title: (args.title.clone()).unwrap_or_else(|| name.to_string_lossy().into_owned()),
            report,
            parameters: text("parameters"),
            input_hash: text("input_sha256"),
        };
        page::write(&args.output, Some(image), &stored, &info, MAX_PAGE_BYTES)
    }
}

//! Writes a page with mesh, image and figures, as `atomesh report` does.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::quality::{measure_cells, measure_simplices};
use crate::error::{cause, io_error};
use crate::export::page::{self, MAX_PAGE_BYTES, PageInfo, PageStats};
use crate::files::output::check_output;
use crate::image::formats::{AnyImage, InputOptions};
use crate::progress::{Progress, Stage};
use crate::report::{Input, Report};
use crate::store::input::image_part;
use crate::store::{FieldValue, MeshFile, Storable, StoredMesh, with_mesh};
use crate::store::{ImageInput, MeshInput};
use crate::{Error, Result};

/// Options of `atomesh report`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ReportSpec {
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

impl ReportSpec {
    /// Checks that the page replaces no input.
    ///
    /// # Errors
    /// Returns [`Error::Job`] or [`Error::Io`] that names the option.
    pub fn check_files(&self, image: &Path, mesh: &Path, output: &Path) -> Result<()> {
        let mut inputs = vec![image, mesh];
        inputs.extend(self.figures.as_deref());
        check_output(output, "--output", &["html"], &inputs)
    }
}

/// Writes a page with a mesh, its image and its figures, one HTML file for any browser, as `atomesh
/// report` does.
///
/// ```
/// use atomesh::image::formats::AnyImage;
/// use atomesh::image::{Geometry, Image};
/// use atomesh::progress::NoProgress;
/// use atomesh::{MeshSpec, ReportSpec};
///
/// let disc = |i: usize| f32::from(u8::from((i % 40).abs_diff(20) < 11 && (i / 40).abs_diff(18) < 9));
/// let image = Image::new([40, 36], (0..40 * 36).map(disc).collect(), Geometry::default());
/// let spec = MeshSpec { distance: "5".parse()?, ..MeshSpec::default() };
/// let mesh = atomesh::mesh(&image, &spec, &mut NoProgress)?.mesh_file(&image)?;
///
/// let path = std::env::temp_dir().join("atomesh-report-example.html");
/// let image = AnyImage::Plane(image.into());
/// let stats = atomesh::report(mesh, image, &path, &ReportSpec::default(), &mut NoProgress)?;
/// assert!(!stats.is_thinned);
/// # std::fs::remove_file(&path).ok();
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Returns [`Error::Job`] for a mesh of another dimension than the image and for a file of figures
/// that is no report, and the errors of [`page::write`].
pub fn report<'a>(
    mesh: impl Into<MeshInput<'a>>,
    image: impl Into<ImageInput<'a>>,
    path: &Path,
    spec: &ReportSpec,
    progress: &mut dyn Progress,
) -> Result<PageStats> {
    let MeshInput { mesh, name, .. } = mesh.into();
    let run = PageRun {
        spec,
        name,
        image: image.into(),
        path,
        progress,
    };
    with_mesh!(mesh,
        simplices file => {
            let file = image_part(file, &mut *run.progress);
            run.write(file, |stored| measure_simplices(stored, None))
        },
        cells file => run.write(file, |stored| Ok(measure_cells(stored, None)))
    )
}

/// The input, the options and the progress of a page.
struct PageRun<'a> {
    spec: &'a ReportSpec,
    /// The name of the mesh in messages.
    name: &'a str,
    image: ImageInput<'a>,
    path: &'a Path,
    progress: &'a mut dyn Progress,
}

impl PageRun<'_> {
    /// Writes the page of a mesh of any kind, which `measure` measures.
    fn write<const D: usize, M: Storable<D>>(
        self,
        file: MeshFile<M>,
        measure: impl FnOnce(&mut StoredMesh<D, M>) -> Result<Report>,
    ) -> Result<PageStats> {
        let Self { spec, image, .. } = self;
        let run_report = spec.figures.as_deref().map(read_figures).transpose()?;
        let image_name = image.name;
        let image_dimension = match &image.image {
            AnyImage::Plane(_) => 2,
            AnyImage::Space(_) => 3,
        };
        let loaded = image.image.into_image::<D>().ok_or_else(|| {
            let problem = format!("is a {D}-D mesh, but the image is {image_dimension}-D");
            Error::Job(cause(self.name, problem, "give the mesh of the image"))
        })?;
        let mut stored = StoredMesh::new(file, self.name)?;
        let (geometry, dims) = (&loaded.geometry, loaded.dims());
        stored.space.check_image(geometry, dims, image_name)?;
        let report = match run_report {
            Some(report) => report,
            None => {
                self.progress.stage(Stage::Measuring);
                let mut report = measure(&mut stored)?;
                report.input = Some(Input {
                    file: image_name.to_string(),
                    dims: dims.to_vec(),
                    hash: image
                        .sha256
                        .map(|hash| format!("sha256:{hash}"))
                        .unwrap_or_default(),
                });
                report.to_json()
            }
        };
        self.progress.stage(Stage::Writing);
        let text = |name: &str| match stored.arrays.field_value(name) {
            Some(FieldValue::Text(text)) => text.trim_end_matches('\0').to_string(),
            _ => String::new(),
        };
        let file_name = Path::new(self.name)
            .file_name()
            .unwrap_or(self.name.as_ref());
        let info = PageInfo {
            title: (spec.title.clone()).unwrap_or_else(|| file_name.to_string_lossy().into_owned()),
            report,
            parameters: text("parameters"),
            input_hash: text("input_sha256"),
        };
        page::write(self.path, Some(&loaded), &stored, &info, MAX_PAGE_BYTES)
    }
}

/// Reads the report of a run.
fn read_figures(path: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(path).map_err(|e| io_error(path, "read", e))?;
    let refuse = |problem: String| {
        let place = format!("figures {}", path.display());
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

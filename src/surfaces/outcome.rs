//! The surfaces of a mesh with their measures: as a table, as JSON, and as a file of each format.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::SurfaceSpec;
use super::table::{self, amplitude_table, interface_table, surface_table};
use crate::error::cause;
use crate::export::surfaces::heights::{bin_heights, height_grid, write_points};
use crate::export::surfaces::survey_grid::SurveyGrid;
use crate::files::output::{check_output, path_text};
use crate::image::formats;
use crate::image::formats::grids::{GRID_EXTENSIONS, displacement_note};
use crate::model::surface::{SurfaceKind, SurfaceMeasure};
use crate::names::NameRules;
use crate::store::AnyMesh;
use crate::surface_file::sticks::{FaultSticks, write_charisma, write_sticks};
use crate::surface_file::{AnySurfaces, SURFACE_EXTENSIONS, SurfaceFile, has_extension};
use crate::{Error, Result};

/// File endings of fault sticks.
pub(crate) const STICK_EXTENSIONS: [&str; 2] = ["csv", "charisma"];

/// File endings of points on horizons.
pub(crate) const POINT_EXTENSIONS: [&str; 1] = ["xyz"];

/// Rules for names in a table of sticks, whose values are separated by commas.
const STICK_NAMES: NameRules = NameRules {
    is_allowed: |c| !c.is_control() && ![',', ';', '"'].contains(&c),
    ..NameRules::TEXT
};

/// The surfaces of a mesh, and their measures.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct SurfaceOutcome {
    /// The surfaces, with their names and the values of their faces.
    pub surfaces: AnySurfaces,
    /// The measures of the surfaces.
    pub report: SurfaceReport,
    /// The bins of the survey, if it is given.
    pub survey: Option<SurveyGrid>,
    /// The mesh with the names of its surfaces, if [`SurfaceSpec::mesh_out`] is given.
    pub mesh: Option<AnyMesh>,
}

/// The measures of the surfaces of a mesh.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum SurfaceReport {
    /// Surfaces of faces that continue one another.
    Bends {
        /// The surfaces.
        measures: Vec<SurfaceMeasure>,
        /// The number of surfaces that are too small.
        dropped_count: usize,
        /// Their area in square samples, in 2-D their length in samples.
        dropped_area: f64,
        /// Their fraction of the area of all surfaces.
        dropped_share: f64,
    },
    /// Interfaces between regions.
    Regions(Vec<InterfaceMeasure>),
}

/// The measures of an interface between two regions.
#[derive(Debug, Clone, PartialEq)]
pub struct InterfaceMeasure {
    /// The region behind the faces, and its name.
    pub inner: (i32, String),
    /// The region in front of the faces, and its name; `None` at the sides of the mesh.
    pub outer: Option<(i32, String)>,
    /// The name of the boundary, if the region in front of the faces was left out.
    pub boundary: Option<String>,
    /// The number of faces.
    pub faces: usize,
    /// The total area of the faces (length in 2-D).
    pub area: f64,
}

impl InterfaceMeasure {
    /// Returns the name of the region in front of the faces.
    pub(super) fn outer_name(&self) -> &str {
        match (&self.outer, &self.boundary) {
            (Some(outer), _) => &outer.1,
            (None, Some(boundary)) => boundary,
            (None, None) => "outside",
        }
    }

    /// Returns the name of the surface in files: that of a boundary, or else of the two regions.
    pub(super) fn file_name(&self) -> String {
        let regions = || format!("{}_{}", self.inner.1, self.outer_name());
        self.boundary.clone().unwrap_or_else(regions)
    }
}

impl SurfaceSpec {
    /// Checks the options, that the outputs have the right endings and replace neither an input nor
    /// each other, and that each option has an effect.
    ///
    /// # Errors
    /// Returns [`Error::Job`] or [`Error::Io`] that names the option.
    pub fn check_files(&self, mesh: &Path, output: &Path) -> Result<()> {
        let mut inputs = vec![mesh];
        inputs.extend(self.image.as_deref());
        inputs.extend(self.survey.as_deref());
        inputs.extend(self.names_from.as_ref().map(|file| &*file.path));
        let endings = [
            &SURFACE_EXTENSIONS[..],
            &STICK_EXTENSIONS,
            &GRID_EXTENSIONS,
            &POINT_EXTENSIONS,
        ]
        .concat();
        check_output(output, "--output", &endings, &inputs)?;
        if let Some(path) = &self.mesh_out {
            inputs.push(output);
            check_output(path, "--mesh-out", &["vtu"], &inputs)?;
        }
        self.check_target(output)?;
        self.validate()
    }

    /// Checks that no option is given that has no effect on a file of this name.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for an option that does not apply to this file.
    pub(crate) fn check_target(&self, path: &Path) -> Result<()> {
        let is_grid = has_extension(path, &GRID_EXTENSIONS);
        let is_points = has_extension(path, &POINT_EXTENSIONS);
        let is_sticks = has_extension(path, &STICK_EXTENSIONS);
        let refuse = |option: &str, formats: &str| {
            let problem = format!("applies to {formats}, but the output is {}", path.display());
            Err(Error::Job(cause(option, problem, "omit it")))
        };
        if self.number.is_some() && !is_grid && !is_points {
            return refuse(
                "number",
                "grids and points of horizons (.irap, .zmap, .cps3, .grd, .asc, .xyz)",
            );
        }
        if self.step.is_some() && !is_grid && !is_sticks {
            return refuse(
                "step",
                "sticks (.csv, .charisma) or grids (.irap, .zmap, .cps3, .grd, .asc)",
            );
        }
        Ok(())
    }
}

impl SurfaceOutcome {
    /// Returns the number of surfaces.
    pub fn len(&self) -> usize {
        match &self.report {
            SurfaceReport::Bends { measures, .. } => measures.len(),
            SurfaceReport::Regions(measures) => measures.len(),
        }
    }

    /// Returns `true` if there is no surface.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Writes the surfaces in the format of the file's ending: surfaces as `.vtp`, `.obj` or GOCAD's
    /// `.ts`; faults as sticks: `.csv`, `.charisma`; horizons as grids of their heights, `.irap`, `.zmap`,
    /// `.cps3`, `.grd`, `.asc`, or as points, `.xyz`. The options `number` and `step` of `spec` apply to sticks, grids
    /// and points. Returns the paths of the files: several horizons have a file each, and its name ends
    /// with that of the horizon.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if there is no surface of the required kind, or for an option that does
    /// not apply to this file, and [`Error::Io`] if a file cannot be written.
    pub fn write(&self, path: &Path, spec: &SurfaceSpec) -> Result<Vec<PathBuf>> {
        spec.check_target(path)?;
        let is_horizon_file =
            has_extension(path, &GRID_EXTENSIONS) || has_extension(path, &POINT_EXTENSIONS);
        let written = vec![path.to_path_buf()];
        if !is_horizon_file && !has_extension(path, &STICK_EXTENSIONS) {
            self.surfaces.write(path)?;
            return Ok(written);
        }
        let refuse =
            |problem: &str, remedy: &str| Err(Error::Job(cause(path.display(), problem, remedy)));
        let AnySurfaces::Surfaces(file) = &self.surfaces else {
            return refuse(
                "is for surfaces in space, but the mesh is 2-D",
                "write .vtp, .obj or .ts",
            );
        };
        let SurfaceReport::Bends { measures, .. } = &self.report else {
            return refuse(
                "is for faults or horizons, but the surfaces are those between regions",
                "write .vtp, .obj or .ts",
            );
        };
        let is_charisma = has_extension(path, &["charisma"]);
        let named = file.written_names(match (is_horizon_file, is_charisma) {
            (true, _) => &NameRules::FILE,
            (_, true) => &NameRules::UNSPACED,
            _ => &STICK_NAMES,
        });
        let file = &*named.file;
        if is_horizon_file {
            let written = self.write_horizons(path, file, measures, spec)?;
            if written.len() > 1 {
                named.write_table(path)?;
            }
            return Ok(written);
        }
        let sticks = FaultSticks::from_surfaces(file, spec.step);
        let faults: Vec<FaultSticks> = (sticks.into_iter().zip(measures))
            .filter_map(|(sticks, measure)| (measure.kind == SurfaceKind::Fault).then_some(sticks))
            .collect();
        if faults.is_empty() {
            let remedy = "write surfaces as .vtp, or horizons as .irap";
            return refuse("there is no fault", remedy);
        }
        named.write_table(path)?;
        if !is_charisma {
            write_sticks(path, &faults)?;
            return Ok(written);
        }
        let Some(survey) = self.survey.as_ref().filter(|survey| survey.has_lines()) else {
            let remedy = "give the SEG-Y file that was meshed, or write .csv";
            let problem = "sticks in this format have line numbers, which no survey gives";
            let error = cause(path.display(), problem, remedy);
            return Err(Error::Job(error.with_parameter("survey")));
        };
        write_charisma(path, &faults, file.z_up, |[x, y, _]| {
            survey.lines_at([x, y]).unwrap_or_default()
        })?;
        Ok(written)
    }

    /// Writes horizons as grids or points, each to a file of its own.
    fn write_horizons(
        &self,
        path: &Path,
        file: &SurfaceFile<3>,
        measures: &[SurfaceMeasure],
        spec: &SurfaceSpec,
    ) -> Result<Vec<PathBuf>> {
        let horizons = horizon_indices(measures, spec.number)?;
        let survey = self.survey.as_ref().filter(|_| spec.step.is_none());
        let mut written = Vec::new();
        for &s in &horizons {
            let path = match horizons.len() {
                1 => path.to_path_buf(),
                _ => numbered_path(path, &file.names[s]),
            };
            if has_extension(&path, &POINT_EXTENSIONS) {
                let survey = survey.filter(|survey| survey.has_lines());
                write_points(&path, file, s, survey)?;
            } else {
                let mut image = match survey {
                    Some(survey) => bin_heights(file, s, survey),
                    None => height_grid(file, s, spec.step)?,
                };
                image.geometry.units = [file.units[0].clone(), file.units[1].clone()];
                formats::write(&path, &image)?;
            }
            written.push(path);
        }
        Ok(written)
    }

    /// Returns a note if nodes of the grids that [`write`](Self::write) writes do not lie exactly at the
    /// bins of the survey.
    pub fn grid_note(&self, path: &Path, spec: &SurfaceSpec) -> Option<String> {
        let survey = self.survey.as_ref().filter(|_| spec.step.is_none())?;
        displacement_note(path, survey.dims, &survey.geometry)
    }

    /// Returns the measures as a table. `meets` says whether it shows which surfaces meet.
    pub fn table(&self, meets: bool) -> String {
        let is_plane = matches!(self.surfaces, AnySurfaces::Curves(_));
        match &self.report {
            SurfaceReport::Bends {
                measures,
                dropped_count,
                dropped_area,
                dropped_share,
            } => {
                let mut text = surface_table(measures, is_plane, meets);
                if measures.iter().any(|m| m.amplitudes.is_some()) {
                    text += "\n\n";
                    text += &amplitude_table(measures);
                }
                if *dropped_count > 0 {
                    text += &format!(
                        "\nomitted: {dropped_count} small surfaces, {dropped_area:.0} {} in all, {:.1} % of the area; --min-area 0 keeps them",
                        if is_plane {
                            "samples"
                        } else {
                            "square samples"
                        },
                        100.0 * dropped_share,
                    );
                }
                text
            }
            SurfaceReport::Regions(measures) => interface_table(measures, is_plane),
        }
    }

    /// Returns the measures as JSON.
    pub fn to_json(&self, spec: &SurfaceSpec) -> Value {
        let mut json = match &self.report {
            SurfaceReport::Bends {
                measures,
                dropped_count,
                dropped_area,
                ..
            } => json!({
                "surfaces": measures,
                "dropped": dropped_count,
                "dropped_area": dropped_area,
            }),
            SurfaceReport::Regions(measures) => {
                let area = table::area_name(matches!(self.surfaces, AnySurfaces::Curves(_)));
                let rows = measures.iter().map(|m| {
                    json!({
                        "inside": m.inner.0,
                        "outside": m.outer.as_ref().map(|outer| outer.0),
                        "faces": m.faces,
                        area: m.area,
                    })
                });
                json!({ "surfaces": rows.collect::<Vec<_>>() })
            }
        };
        if let (Some(path), Some(_)) = (&spec.mesh_out, &self.mesh) {
            json["mesh"] = path_text(path).into();
        }
        json
    }
}

/// Returns the path with a name before its ending: `top-horizon2.irap`.
fn numbered_path(path: &Path, name: &str) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}-{name}.{ending}"))
}

/// Returns the indices of the surfaces that become grids or points: that with this number, or all
/// horizons.
fn horizon_indices(measures: &[SurfaceMeasure], number: Option<usize>) -> Result<Vec<usize>> {
    let is_chosen = |measure: &SurfaceMeasure| match number {
        Some(number) => measure.surface == number,
        None => measure.kind == SurfaceKind::Horizon,
    };
    let indices: Vec<usize> = (0..measures.len())
        .filter(|&s| is_chosen(&measures[s]))
        .collect();
    if indices.is_empty() {
        let problem = match number {
            Some(number) => format!("there is no surface {number}"),
            None => "there is no horizon".into(),
        };
        let remedy = "give the number of a surface in the table";
        let error = cause("a grid of a surface", problem, remedy);
        return Err(Error::Job(error.with_parameter("number")));
    }
    Ok(indices)
}

//! The surfaces of a mesh with their measures: as a table, as JSON, and as a file of each format.

use std::path::Path;

use serde_json::{Value, json};

use super::heights::height_grid;
use super::sticks::{FaultSticks, write_sticks};
use super::table::{amplitude_table, interface_table, surface_table};
use super::{AnySurfaces, table};
use crate::error::cause;
use crate::image::formats;
use crate::model::surface::{SurfaceKind, SurfaceMeasure, SurfaceSpec};
use crate::surface_file::has_extension;
use crate::{Error, Result};

/// File endings of the surface formats that can be written.
#[cfg(feature = "cli")]
pub(crate) const SURFACE_EXTENSIONS: [&str; 3] = ["vtp", "obj", "ts"];

/// File endings of fault sticks.
pub(crate) const STICK_EXTENSIONS: [&str; 1] = ["csv"];

/// File endings of grids of heights.
pub(crate) const GRID_EXTENSIONS: [&str; 3] = ["irap", "zmap", "cps3"];

/// The surfaces of a mesh, and their measures.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct SurfaceOutcome {
    /// The surfaces, with their names and the values of their faces.
    pub surfaces: AnySurfaces,
    /// The measures of the surfaces.
    pub report: SurfaceReport,
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
    /// The number of faces.
    pub faces: usize,
    /// The total area of the faces (length in 2-D).
    pub area: f64,
}

impl InterfaceMeasure {
    /// Returns the name of the region in front of the faces.
    pub(super) fn outer_name(&self) -> &str {
        self.outer.as_ref().map_or("outside", |outer| &outer.1)
    }
}

impl SurfaceSpec {
    /// Checks that no option is given that has no effect on a file of this name.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for an option that does not apply to this file.
    pub(crate) fn check_target(&self, path: &Path) -> Result<()> {
        let is_grid = has_extension(path, &GRID_EXTENSIONS);
        let is_sticks = has_extension(path, &STICK_EXTENSIONS);
        let refuse = |option: &str, formats: &str| {
            let problem = format!("applies to {formats}, but the output is {}", path.display());
            Err(Error::Job(cause(option, problem, "omit it")))
        };
        if self.number.is_some() && !is_grid {
            return refuse("number", "a grid (.irap, .zmap, .cps3)");
        }
        if self.step.is_some() && !is_grid && !is_sticks {
            return refuse("step", "sticks (.csv) or a grid (.irap, .zmap, .cps3)");
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
    /// `.ts`; faults as sticks: `.csv`; a horizon as a grid of its heights: `.irap`, `.zmap`,
    /// `.cps3`. The options `number` and `step` of `spec` apply to sticks and grids.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if there is no surface of the required kind, if it is ambiguous, or for
    /// an option that does not apply to this file, and [`Error::Io`] if the file cannot be written.
    pub fn write(&self, path: &Path, spec: &SurfaceSpec) -> Result<()> {
        spec.check_target(path)?;
        let is_grid = has_extension(path, &GRID_EXTENSIONS);
        if !is_grid && !has_extension(path, &STICK_EXTENSIONS) {
            return match &self.surfaces {
                AnySurfaces::Curves(file) => file.write(path),
                AnySurfaces::Surfaces(file) => file.write(path),
            };
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
        if is_grid {
            let mut image = height_grid(file, horizon_index(measures, spec.number)?, spec.step)?;
            image.geometry.units = [file.units[0].clone(), file.units[1].clone()];
            return formats::write(path, &image);
        }
        let sticks = FaultSticks::from_surfaces(file, spec.step);
        let faults: Vec<FaultSticks> = (sticks.into_iter().zip(measures))
            .filter_map(|(sticks, measure)| (measure.kind == SurfaceKind::Fault).then_some(sticks))
            .collect();
        if faults.is_empty() {
            let remedy = "write surfaces as .vtp, or a horizon as .irap";
            return refuse("there is no fault", remedy);
        }
        write_sticks(path, &faults)
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
    pub fn to_json(&self) -> Value {
        match &self.report {
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
        }
    }
}

/// Returns the index of the surface that becomes a grid: that with this number, or the only horizon.
fn horizon_index(measures: &[SurfaceMeasure], number: Option<usize>) -> Result<usize> {
    let refuse = |problem: String| {
        let remedy = "give the number of a surface in the table";
        Err(Error::Job(
            cause("a grid of one surface", problem, remedy).with_parameter("number"),
        ))
    };
    if let Some(number) = number {
        let index = measures.iter().position(|m| m.surface == number);
        return match index {
            Some(index) => Ok(index),
            None => refuse(format!("there is no surface {number}")),
        };
    }
    let horizons: Vec<usize> = (0..measures.len())
        .filter(|&s| measures[s].kind == SurfaceKind::Horizon)
        .collect();
    match horizons[..] {
        [only] => Ok(only),
        _ => {
            let numbers = horizons.iter().map(|&s| measures[s].surface.to_string());
            let numbers: Vec<String> = numbers.take(20).collect();
            let (count, list) = (horizons.len(), numbers.join(", "));
            refuse(format!(
                "there are {count} horizons{}{list}",
                if count > 0 { ": " } else { "" }
            ))
        }
    }
}

//! Output of surfaces in formats of interpretation software: faults as sticks, a horizon as a grid
//! of its heights.

use std::any::Any;
use std::path::Path;

use clap::Args;

use crate::cli::console::Console;
use crate::cli::parse;
use crate::error::cause;
use crate::export::surfaces::heights::height_grid;
use crate::export::{FaultSticks, SurfaceFile, write_sticks};
use crate::image::Geometry;
use crate::model::surface::{SurfaceKind, SurfaceMeasure};
use crate::{Error, Result};

/// File endings of fault sticks, and of grids.
pub const STICK_EXTENSIONS: [&str; 1] = ["csv"];
pub const GRID_EXTENSIONS: [&str; 3] = ["irap", "zmap", "cps3"];

/// Options for formats that cannot hold all surfaces as they are.
#[derive(Debug, Clone, Default, Args)]
pub struct InterpretationOptions {
    /// The number of the surface that becomes a grid, as in the printed table [default: the only
    /// horizon]
    #[arg(long, value_name = "N")]
    pub number: Option<usize>,
    /// Distance between sticks, or between the nodes of a grid, in the unit of x [default: ten
    /// sticks per fault; for a grid about the length of the surface's edges]
    #[arg(long, value_name = "LENGTH", allow_negative_numbers = true)]
    pub step: Option<f64>,
}

impl InterpretationOptions {
    /// Checks that no option is typed that has no effect on this file.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for an option that does not apply to this file, and for a step that
    /// is not positive.
    pub fn refuse_unused(&self, path: &Path) -> Result<()> {
        let [is_grid, is_sticks] = [
            has_extension(path, &GRID_EXTENSIONS),
            has_extension(path, &STICK_EXTENSIONS),
        ];
        let refuse = |option: &str, formats: &str| {
            let problem = format!("applies to {formats}, but the output is {}", path.display());
            Err(Error::Job(cause(option, problem, "omit it")))
        };
        if self.number.is_some() && !is_grid {
            return refuse("--number", "a grid (.irap, .zmap, .cps3)");
        }
        if self.step.is_some() && !is_grid && !is_sticks {
            return refuse("--step", "sticks (.csv) or a grid (.irap, .zmap, .cps3)");
        }
        match self.step {
            Some(step) if !(step.is_finite() && step > 0.0) => {
                let remedy = "give a length above 0, in the unit of x";
                Err(parse::option_error(
                    "--step",
                    &step.to_string(),
                    "is no distance",
                    remedy,
                ))
            }
            _ => Ok(()),
        }
    }

    /// Writes sticks or a grid, if the file is to hold one of them. Returns `true` if it does.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if there is no surface of the required kind, or if it is ambiguous,
    /// and [`Error::Io`] if the file cannot be written.
    pub fn write<const D: usize>(
        &self,
        path: &Path,
        file: &SurfaceFile<D>,
        geometry: &Geometry<D>,
        measures: &[SurfaceMeasure],
        console: &mut Console,
    ) -> Result<bool> {
        let [is_grid, is_sticks] = [
            has_extension(path, &GRID_EXTENSIONS),
            has_extension(path, &STICK_EXTENSIONS),
        ];
        if !is_grid && !is_sticks {
            return Ok(false);
        }
        let Some(file) = (file as &dyn Any).downcast_ref::<SurfaceFile<3>>() else {
            let problem = "is for surfaces in space, but the mesh is 2-D";
            let remedy = "write .vtp, .obj or .ts";
            return Err(Error::Job(cause(path.display(), problem, remedy)));
        };
        if is_grid {
            let mut image = height_grid(file, self.horizon_index(measures)?, self.step)?;
            let units = geometry.to_3d().units;
            image.geometry.units = [units[0].clone(), units[1].clone()];
            console.write_image(path, image)?;
            return Ok(true);
        }
        let faults = FaultSticks::from_surfaces(file, self.step)
            .into_iter()
            .zip(measures);
        let faults: Vec<FaultSticks> = faults
            .filter_map(|(sticks, measure)| (measure.kind == SurfaceKind::Fault).then_some(sticks))
            .collect();
        if faults.is_empty() {
            let remedy = "write surfaces as .vtp, or a horizon as .irap";
            return Err(Error::Job(cause(
                path.display(),
                "there is no fault",
                remedy,
            )));
        }
        write_sticks(path, &faults)?;
        Ok(true)
    }

    /// Returns the index of the surface that becomes a grid.
    fn horizon_index(&self, measures: &[SurfaceMeasure]) -> Result<usize> {
        let refuse = |problem: String| {
            let remedy = "give the number of a surface in the table with --number";
            Err(Error::Job(cause("a grid of one surface", problem, remedy)))
        };
        if let Some(number) = self.number {
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
}

fn has_extension(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    endings
        .iter()
        .any(|known| ending.eq_ignore_ascii_case(known))
}

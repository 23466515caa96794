//! Options for the position of a model, and for the wells and fluids of a simulation.

use std::cell::OnceCell;
use std::path::Path;

use clap::{Args, ValueEnum};

use super::console::Console;
use super::parse::{number, option_error, point};
use crate::error::cause;
use crate::job::well_file::{WellFile, is_well_file};
use crate::mesh::graph::Locator;
use crate::model::reservoir::frame::metres_per_unit;
use crate::model::reservoir::{
    BAR, Completion, Control, DAY, DepthAxis, Fluid, MeshPlacement, Model, PreparedModel,
    SimulationCase, Trajectory, Well, WellTracer,
};
use crate::{Error, Result};

/// Options that convert a mesh's coordinates to metres and depth.
#[derive(Debug, Clone, Args)]
pub struct SpaceOptions {
    /// Unit of the mesh's coordinates, if it is not the one that the mesh states: m, km, ft, cm,
    /// mm, um or nm. The export is in metres [default: what the mesh states, or m; scans in mm or
    /// less keep their unit where flow is not simulated]
    #[arg(long, value_name = "UNIT")]
    pub length_unit: Option<String>,
    /// The coordinate that is depth, with its sign: -z if z grows upwards, z if it grows downwards,
    /// x ...
    #[arg(
        long,
        value_name = "AXIS",
        default_value = "-z",
        allow_hyphen_values = true
    )]
    pub down: String,
    /// Depth (m) of the mesh's shallowest point [default: from its coordinates]
    #[arg(long, value_name = "DEPTH", allow_hyphen_values = true)]
    pub depth_at_top: Option<f64>,
    /// Velocity (m/s) that converts two-way time to depth
    #[arg(long, value_name = "V", allow_hyphen_values = true)]
    pub velocity: Option<f64>,
    /// Thickness of a 2-D mesh, in the unit of its coordinates [default: 1]
    #[arg(long, value_name = "T")]
    pub thickness: Option<f64>,
}

/// The fluids in the pores.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FluidChoice {
    /// Water only
    Water,
    /// Oil, into which water is injected
    OilWater,
}

/// Options for the wells, fluids and duration of a simulation.
#[derive(Debug, Clone, Args)]
pub struct CaseOptions {
    /// Fluids in the pores [default: water]
    #[arg(long, value_name = "FLUID")]
    pub fluid: Option<FluidChoice>,
    /// A well that injects water at a rate in m^3/day. It is vertical in the cell at X,Y,Z (the
    /// mesh's coordinates), or follows the trajectory in a CSV file of lines x,y,z,radius:
    /// [NAME=]FILE.csv:RATE; may be repeated
    #[arg(long, value_name = "[NAME=]X,Y,Z:RATE", allow_hyphen_values = true)]
    pub injector: Vec<String>,
    /// A well that produces at a pressure in bar, at X,Y,Z or along the trajectory in a CSV file;
    /// may be repeated
    #[arg(long, value_name = "[NAME=]X,Y,Z:BAR", allow_hyphen_values = true)]
    pub producer: Vec<String>,
    /// Radius (m) of wells that are given by a point [default: 0.1]
    #[arg(long, value_name = "R")]
    pub well_radius: Option<f64>,
    /// Initial pressure (bar) at the top [default: hydrostatic from 1.01325 at depth 0]
    #[arg(long, value_name = "BAR")]
    pub pressure_at_top: Option<f64>,
    /// Ignore gravity: no hydrostatic gradient
    #[arg(long)]
    pub no_gravity: bool,
    /// Number of days to simulate [default: 3650]
    #[arg(long, value_name = "DAYS")]
    pub days: Option<f64>,
}

impl SpaceOptions {
    /// Returns the placement of the mesh that the options describe.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for an unknown unit or axis, or for numbers that make no sense.
    pub fn placement(&self) -> Result<MeshPlacement> {
        let parse_unit = |unit: &String| {
            let remedy = "give m, km, ft, cm, mm, um or nm";
            let unknown = || option_error("--length-unit", unit, "is not a known unit", remedy);
            metres_per_unit(unit).ok_or_else(unknown)
        };
        let length = self.length_unit.as_ref().map(parse_unit).transpose()?;
        let is_downward = !self.down.starts_with('-');
        let name = self.down.trim_start_matches('-');
        let axis = ["x", "y", "z"].iter().position(|axis| *axis == name);
        let axis = axis.ok_or_else(|| {
            let remedy = "give x, y, z, -x, -y or -z";
            option_error("--down", &self.down, "is not an axis", remedy)
        })?;
        if let Some(thickness) = self.thickness {
            check_positive("--thickness", thickness)?;
        }
        Ok(MeshPlacement {
            length,
            keeps_unit: false,
            depth_axis: DepthAxis { axis, is_downward },
            velocity: self.velocity,
            top: self.depth_at_top,
            thickness: self.thickness.unwrap_or(1.0),
        })
    }
}

fn check_positive(option: &str, value: f64) -> Result<()> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    let problem = "is not a positive number";
    Err(option_error(
        option,
        &value.to_string(),
        problem,
        "give one above 0",
    ))
}

impl CaseOptions {
    /// Returns the simulation case, with its wells in cells of the model.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for options that make no sense, and [`Error::Export`] for wells that
    /// lie outside the mesh.
    pub fn case(&self, prepared: &PreparedModel, console: &Console) -> Result<SimulationCase> {
        let days = self.days.unwrap_or(3650.0);
        check_positive("--days", days)?;
        if self.days.is_some() && self.injector.is_empty() && self.producer.is_empty() {
            let problem = "has no effect without wells";
            let remedy = "give --injector or --producer, or omit it";
            return Err(option_error("--days", &days.to_string(), problem, remedy));
        }
        let radius = self.well_radius.unwrap_or(0.1);
        check_positive("--well-radius", radius)?;
        let model = &prepared.model;
        let mut wells: Vec<Well> = Vec::new();
        let (tracer, locator) = (OnceCell::new(), OnceCell::new());
        let typed = [
            ("--injector", &self.injector, 'I'),
            ("--producer", &self.producer, 'P'),
        ];
        for (option, texts, letter) in typed {
            for text in texts {
                let (name, rest) = match text.split_once('=') {
                    Some((name, rest)) => (Some(name.to_string()), rest),
                    None => (None, text.as_str()),
                };
                let remedy = "give X,Y,Z:VALUE or FILE.csv:VALUE, with NAME= before it or not";
                let Some((place, value)) = rest.rsplit_once(':') else {
                    return Err(option_error(option, text, "has no ':'", remedy));
                };
                let value = number(option, value, remedy)?;
                check_positive(option, value)?;
                let label = format!("{option} {text}");
                let tracer = tracer.get_or_init(|| WellTracer::new(model));
                let (default_name, radius, points, completions) = if is_well_file(place) {
                    let (name, trajectory, completions) =
                        well_from_file(place, label, tracer, prepared, console)?;
                    (name, trajectory.radii[0], trajectory.points, completions)
                } else {
                    let point = prepared.frame.to_model(point(option, place, remedy)?);
                    let locator = locator.get_or_init(|| Locator::new(&model.graph));
                    let cell = locator.cell_at(point).ok_or_else(|| {
                        let remedy = "give a point inside, in the mesh's coordinates (`atomesh info` shows its extent)";
                        option_error(option, text, "lies outside the mesh", remedy)
                    })?;
                    let default_name = format!("{letter}{}", wells.len() + 1);
                    (
                        default_name,
                        radius,
                        vec![point],
                        tracer.complete_cell(&label, cell, radius)?,
                    )
                };
                let name = name.unwrap_or(default_name);
                if wells.iter().any(|known| known.name == name) {
                    return Err(option_error(
                        option,
                        text,
                        "has the same name as another well",
                        remedy,
                    ));
                }
                wells.push(Well {
                    name,
                    cells: completions.iter().map(|c| (c.cell, c.index)).collect(),
                    lengths: completions.iter().map(|c| c.length).collect(),
                    radius,
                    path: points,
                    control: match letter {
                        'I' => Control::Inject(value / DAY),
                        _ => Control::Pressure(value * BAR),
                    },
                });
            }
        }
        let top = (0..model.len()).map(|cell| model.depth(cell));
        let top = top.fold(f64::INFINITY, f64::min);
        let hydrostatic = 1.013_25 * BAR + 1000.0 * crate::model::reservoir::GRAVITY * top;
        if let Some(bar) = self.pressure_at_top {
            check_positive("--pressure-at-top", bar)?;
        }
        Ok(SimulationCase {
            title: "atomesh".into(),
            fluid: match self.fluid.unwrap_or(FluidChoice::Water) {
                FluidChoice::Water => Fluid::Water,
                FluidChoice::OilWater => Fluid::OilWater,
            },
            has_gravity: !self.no_gravity,
            top_pressure: self.pressure_at_top.map_or(hydrostatic, |bar| bar * BAR),
            wells,
            duration: days * DAY,
        })
    }
}

/// Reads a well from a file. Returns its name, its trajectory and its completions.
fn well_from_file(
    path: &str,
    label: String,
    tracer: &WellTracer,
    prepared: &PreparedModel,
    console: &Console,
) -> Result<(String, Trajectory, Vec<Completion>)> {
    let file = WellFile::<3>::read(Path::new(path), 2)?;
    let frame = &prepared.frame;
    let points = file.points.iter();
    let trajectory = Trajectory {
        name: label,
        points: points.clone().map(|p| frame.to_model(p.1)).collect(),
        radii: points.map(|p| p.2 * frame.horizontal_scale()).collect(),
    };
    let completions = tracer.complete(&trajectory)?;
    let (total, inside) = (
        trajectory.length(),
        completions.iter().map(|c| c.length).sum::<f64>(),
    );
    if inside < (1.0 - 1e-6) * total {
        console.note(format_args!(
            "{path}: {inside:.2} of the well's {total:.2} m lie in the mesh"
        ));
    }
    Ok((file.name, trajectory, completions))
}

/// Checks that depth grows downwards from the surface.
///
/// # Errors
/// Returns [`Error::Export`] for a mesh that reaches above depth 0.
pub fn check_depth(model: &Model, space: &SpaceOptions) -> Result<()> {
    let depths = (0..model.len()).map(|cell| model.depth(cell));
    let top = depths.fold(f64::INFINITY, f64::min);
    if top >= 0.0 {
        return Ok(());
    }
    Err(Error::Export(cause(
        format!("--down {}", space.down),
        format!("puts the mesh's top {:.6} m above depth 0", -top),
        "give the other sign, or --depth-at-top",
    )))
}

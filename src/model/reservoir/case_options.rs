//! Options for the position of a model, and for the wells and fluids of a simulation.

use std::cell::OnceCell;
use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::frame::metres_per_unit;
use super::{
    BAR, Completion, Control, DAY, DepthAxis, Fluid, GRAVITY, MeshPlacement, Model, PreparedModel,
    SimulationCase, Trajectory, Well, WellTracer,
};
use crate::error::cause;
use crate::job::spec::{InvalidValue, SignedAxis, joined, parse_number};
use crate::job::well_file::{WellFile, is_well_file};
use crate::mesh::graph::Locator;
use crate::option_text::serde_as_text;
use crate::progress::Progress;
use crate::{Error, Result};

/// Number of days that are simulated by default.
const DEFAULT_DAYS: f64 = 3650.0;

/// Default radius in metres of wells that are given by a point.
const DEFAULT_WELL_RADIUS: f64 = 0.1;

/// Options that convert a mesh's coordinates to metres and depth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::Args))]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct SpaceOptions {
    /// Unit of the mesh's coordinates, if it is not the one that the mesh states: m, km, ft, cm,
    /// mm, um or nm. The export is in metres [default: what the mesh states, or m; scans in mm or
    /// less keep their unit where flow is not simulated]
    #[cfg_attr(feature = "cli", arg(long, value_name = "UNIT"))]
    pub length_unit: Option<String>,
    /// The coordinate that is depth, with its sign: -z if z grows upwards, z if it grows downwards,
    /// x ...
    #[cfg_attr(
        feature = "cli",
        arg(
            long,
            value_name = "AXIS",
            default_value_t = SpaceOptions::default().down,
            allow_hyphen_values = true
        )
    )]
    pub down: SignedAxis,
    /// Depth (m) of the mesh's shallowest point [default: from its coordinates]
    #[cfg_attr(
        feature = "cli",
        arg(long, value_name = "DEPTH", allow_hyphen_values = true)
    )]
    pub depth_at_top: Option<f64>,
    /// Velocity (m/s) that converts two-way time to depth
    #[cfg_attr(
        feature = "cli",
        arg(long, value_name = "V", allow_hyphen_values = true)
    )]
    pub velocity: Option<f64>,
    /// Thickness of a 2-D mesh, in the unit of its coordinates [default: 1]
    #[cfg_attr(feature = "cli", arg(long, value_name = "T"))]
    pub thickness: Option<f64>,
}

impl Default for SpaceOptions {
    fn default() -> Self {
        Self {
            length_unit: None,
            down: SignedAxis {
                axis: 2,
                is_positive: false,
            },
            depth_at_top: None,
            velocity: None,
            thickness: None,
        }
    }
}

/// The fluids in the pores.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum FluidChoice {
    /// Water only
    Water,
    /// Oil, into which water is injected
    OilWater,
}

/// Options for the wells, fluids and duration of a simulation.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::Args))]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct CaseOptions {
    /// Fluids in the pores [default: water]
    #[cfg_attr(feature = "cli", arg(long, value_name = "FLUID"))]
    pub fluid: Option<FluidChoice>,
    /// A well that injects water at a rate in m^3/day. It is vertical in the cell at X,Y,Z (the
    /// mesh's coordinates), or follows the trajectory in a CSV file of lines x,y,z,radius:
    /// [NAME=]FILE.csv:RATE; may be repeated
    #[cfg_attr(
        feature = "cli",
        arg(long, value_name = "[NAME=]X,Y,Z:RATE", allow_hyphen_values = true)
    )]
    pub injector: Vec<WellOption>,
    /// A well that produces at a pressure in bar, at X,Y,Z or along the trajectory in a CSV file;
    /// may be repeated
    #[cfg_attr(
        feature = "cli",
        arg(long, value_name = "[NAME=]X,Y,Z:BAR", allow_hyphen_values = true)
    )]
    pub producer: Vec<WellOption>,
    /// Radius (m) of wells that are given by a point [default: 0.1]
    #[cfg_attr(feature = "cli", arg(long, value_name = "R"))]
    pub well_radius: Option<f64>,
    /// Initial pressure (bar) at the top [default: hydrostatic from 1.01325 at depth 0]
    #[cfg_attr(feature = "cli", arg(long, value_name = "BAR"))]
    pub pressure_at_top: Option<f64>,
    /// Ignore gravity: no hydrostatic gradient
    #[cfg_attr(feature = "cli", arg(long))]
    pub no_gravity: bool,
    /// Number of days to simulate [default: 3650]
    #[cfg_attr(feature = "cli", arg(long, value_name = "DAYS"))]
    pub days: Option<f64>,
}

/// A well: its name, its place, and the rate or the pressure that controls it.
#[derive(Debug, Clone, PartialEq)]
pub struct WellOption {
    /// The name. By default it is that in the file, or I or P with the number of the well.
    pub name: Option<String>,
    /// The place of the well.
    pub place: WellPlace,
    /// The rate of an injector in m^3/day, or the pressure of a producer in bar.
    pub value: f64,
}

/// The place of a well.
#[derive(Debug, Clone, PartialEq)]
pub enum WellPlace {
    /// A point in the mesh's coordinates. The well is vertical in the cell that contains it.
    Point([f64; 3]),
    /// A CSV file of lines x,y,z,radius: the well's trajectory.
    File(PathBuf),
}

impl FromStr for WellOption {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let remedy = "give X,Y,Z:VALUE or FILE.csv:VALUE, with NAME= before it or not";
        let (name, rest) = match text.split_once('=') {
            Some((name, rest)) => (Some(name.to_string()), rest),
            None => (None, text),
        };
        let (place, value) = rest
            .rsplit_once(':')
            .ok_or_else(|| InvalidValue::new("has no ':'", remedy))?;
        let value = parse_number(value, remedy)?;
        if value <= 0.0 {
            let problem = format!("has the value {value}, which is not a positive number");
            return Err(InvalidValue::new(problem, "give one above 0"));
        }
        let place = if is_well_file(place) {
            WellPlace::File(place.into())
        } else {
            let numbers = place.split(',').map(|word| parse_number(word, remedy));
            let numbers: Vec<f64> = numbers.collect::<std::result::Result<_, _>>()?;
            let count = numbers.len();
            let point = <[f64; 3]>::try_from(numbers).map_err(|_| {
                InvalidValue::new(format!("has {count} coordinates, not 3"), remedy)
            })?;
            WellPlace::Point(point)
        };
        Ok(Self { name, place, value })
    }
}

impl Display for WellOption {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        if let Some(name) = &self.name {
            write!(f, "{name}=")?;
        }
        match &self.place {
            WellPlace::Point(point) => f.write_str(&joined(point))?,
            WellPlace::File(path) => write!(f, "{}", path.display())?,
        }
        write!(f, ":{}", self.value)
    }
}

serde_as_text!(WellOption: [",", ":"]);

impl SpaceOptions {
    /// Returns the placement of the mesh that the options describe.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for an unknown unit, or for numbers that make no sense.
    pub(crate) fn placement(&self) -> Result<MeshPlacement> {
        let parse_unit = |unit: &String| {
            let place = format!("length-unit {unit}");
            let remedy = "give m, km, ft, cm, mm, um or nm";
            let unknown = || Error::Job(cause(place, "is not a known unit", remedy));
            metres_per_unit(unit).ok_or_else(unknown)
        };
        if let Some(thickness) = self.thickness {
            check_positive("thickness", thickness)?;
        }
        let length = self.length_unit.as_ref().map(parse_unit).transpose()?;
        Ok(MeshPlacement {
            length,
            keeps_unit: false,
            depth_axis: DepthAxis {
                axis: self.down.axis,
                is_downward: self.down.is_positive,
            },
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
    let place = format!("{option} {value}");
    Err(Error::Job(cause(
        place,
        "is not a positive number",
        "give one above 0",
    )))
}

impl CaseOptions {
    /// Checks the options that do not depend on the model.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for options that make no sense.
    pub(crate) fn validate(&self) -> Result<()> {
        let numbers = [
            ("days", self.days),
            ("well-radius", self.well_radius),
            ("pressure-at-top", self.pressure_at_top),
        ];
        for (option, number) in numbers {
            if let Some(number) = number {
                check_positive(option, number)?;
            }
        }
        match self.days {
            Some(days) if self.injector.is_empty() && self.producer.is_empty() => {
                let remedy = "give an injector or a producer, or omit it";
                let place = format!("days {days}");
                Err(Error::Job(cause(
                    place,
                    "has no effect without wells",
                    remedy,
                )))
            }
            _ => Ok(()),
        }
    }

    /// Returns the simulation case, with its wells in cells of the model.
    ///
    /// # Errors
    /// Returns [`Error::Export`] for wells that lie outside the mesh.
    pub(crate) fn case(
        &self,
        prepared: &PreparedModel,
        progress: &mut dyn Progress,
    ) -> Result<SimulationCase> {
        let point_radius = self.well_radius.unwrap_or(DEFAULT_WELL_RADIUS);
        let model = &prepared.model;
        let mut wells: Vec<Well> = Vec::new();
        let (tracer, locator) = (OnceCell::new(), OnceCell::new());
        let given = [
            ("injector", &self.injector, 'I'),
            ("producer", &self.producer, 'P'),
        ];
        for (option, options, letter) in given {
            for well in options {
                let label = format!("{option} {well}");
                let refuse = |problem: &str, remedy: &str| {
                    Err(Error::Job(cause(
                        format!("{option} {well}"),
                        problem,
                        remedy,
                    )))
                };
                let tracer = tracer.get_or_init(|| WellTracer::new(model));
                let (default_name, radius, points, completions) = match &well.place {
                    WellPlace::File(path) => {
                        let (name, trajectory, completions) =
                            well_from_file(path, label, tracer, prepared, progress)?;
                        (name, trajectory.radii[0], trajectory.points, completions)
                    }
                    WellPlace::Point(point) => {
                        let point = prepared.frame.to_model(*point);
                        let locator = locator.get_or_init(|| Locator::new(&model.graph));
                        let Some(cell) = locator.cell_at(point) else {
                            let remedy = "give a point inside, in the mesh's coordinates (`atomesh info` shows its extent)";
                            return refuse("lies outside the mesh", remedy);
                        };
                        let default_name = format!("{letter}{}", wells.len() + 1);
                        (
                            default_name,
                            point_radius,
                            vec![point],
                            tracer.complete_cell(&label, cell, point_radius)?,
                        )
                    }
                };
                let name = well.name.clone().unwrap_or(default_name);
                if wells.iter().any(|known| known.name == name) {
                    let problem = "has the same name as another well";
                    return refuse(problem, "give it another name with NAME= before it");
                }
                wells.push(Well {
                    name,
                    cells: completions.iter().map(|c| (c.cell, c.index)).collect(),
                    lengths: completions.iter().map(|c| c.length).collect(),
                    radius,
                    path: points,
                    control: match letter {
                        'I' => Control::Inject(well.value / DAY),
                        _ => Control::Pressure(well.value * BAR),
                    },
                });
            }
        }
        let top = (0..model.len()).map(|cell| model.depth(cell));
        let top = top.fold(f64::INFINITY, f64::min);
        let hydrostatic = 1.013_25 * BAR + 1000.0 * GRAVITY * top;
        Ok(SimulationCase {
            title: "atomesh".into(),
            fluid: match self.fluid.unwrap_or(FluidChoice::Water) {
                FluidChoice::Water => Fluid::Water,
                FluidChoice::OilWater => Fluid::OilWater,
            },
            has_gravity: !self.no_gravity,
            top_pressure: self.pressure_at_top.map_or(hydrostatic, |bar| bar * BAR),
            wells,
            duration: self.days.unwrap_or(DEFAULT_DAYS) * DAY,
        })
    }
}

/// Reads a well from a file. Returns its name, its trajectory and its completions.
fn well_from_file(
    path: &Path,
    label: String,
    tracer: &WellTracer,
    prepared: &PreparedModel,
    progress: &mut dyn Progress,
) -> Result<(String, Trajectory, Vec<Completion>)> {
    let file = WellFile::<3>::read(path, 2)?;
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
        progress.note(&format!(
            "{}: {inside:.2} of the well's {total:.2} m lie in the mesh",
            path.display()
        ));
    }
    Ok((file.name, trajectory, completions))
}

/// Checks that depth grows downwards from the surface.
///
/// # Errors
/// Returns [`Error::Export`] for a mesh that reaches above depth 0.
pub(crate) fn check_depth(model: &Model, space: &SpaceOptions) -> Result<()> {
    let depths = (0..model.len()).map(|cell| model.depth(cell));
    let top = depths.fold(f64::INFINITY, f64::min);
    if top >= 0.0 {
        return Ok(());
    }
    Err(Error::Export(
        cause(
            format!("down {}", space.down),
            format!("puts the mesh's top {:.6} m above depth 0", -top),
            "give the other sign, or the depth at the top",
        )
        .with_parameter("depth-at-top"),
    ))
}

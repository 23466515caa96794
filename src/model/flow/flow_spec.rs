//! The options of `atomesh flow`, as one value.

use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::driver::{BoundaryConditions, SIDE_NAMES};
use super::faults::{FaultMultiplier, FaultOptions, FaultResistance};
use super::{PointWell, Rock, Tensor};
use crate::error::cause;
use crate::files::output::check_output;
use crate::files::table::values_by_region;
use crate::option_text::serde_as_text;
use crate::option_text::{InvalidValue, NumberOrFile, joined, parse_number};
use crate::store::{Storable, StoredMesh};
use crate::{Error, Result, memory};

/// Rate in m^3/s of a source or sink whose rate is not given.
const DEFAULT_RATE: f64 = 1e-3;

/// Options of `atomesh flow`, in SI units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct FlowSpec {
    /// A point (X,Y in 2-D) where fluid enters, with its rate in m^3/s [default rate: 0.001]; may
    /// be repeated
    #[arg(long, value_name = "X,Y,Z[:RATE]", allow_hyphen_values = true)]
    pub source: Vec<FlowPoint>,
    /// A point where fluid leaves [default rate: all that enters, or 0.001 with --pressure]; may be
    /// repeated
    #[arg(long, value_name = "X,Y,Z[:RATE]", allow_hyphen_values = true)]
    pub sink: Vec<FlowPoint>,
    /// Pressure (Pa) on a side of the box: xmin, xmax, ymin ... along the image's axes, x the
    /// fastest in memory. Sides without a pressure are closed
    #[arg(long, value_name = "SIDE=P")]
    pub pressure: Vec<SidePressure>,
    /// Options that say how faults resist flow; they are closed by default.
    #[command(flatten)]
    pub fault_options: FaultOptions,
    /// Extend faults beyond their edges by up to DIST metres, to the next fault or the sides of the mesh,
    /// along the faces of cells. An extension has a name of its own, such as fault1_extension, and the law
    /// of its fault
    #[arg(long, value_name = "DIST", allow_hyphen_values = true)]
    pub extend_faults: Option<f64>,
    /// Permeability in m^2 (1 mD is 9.87e-16 m^2): K; KX,KY,KZ; KXX,KYY,KZZ,KXY,KYZ,KXZ (in 2-D K;
    /// KX,KY; KXX,KYY,KXY); a CSV file of lines region,K; or a cell array of the mesh
    #[arg(
        long,
        value_name = "K",
        default_value = "1e-13",
        allow_hyphen_values = true
    )]
    pub permeability: FlowPermeability,
    /// Convert two-way time to depth (in the unit of x and y, m or ft), with one velocity in m/s or a file of interval
    /// velocities in m/s on a grid in two-way time. Sources and sinks are then in depth
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    pub velocity: Option<NumberOrFile>,
    /// Viscosity in Pa s
    #[arg(
            long,
            value_name = "MU",
            default_value_t = FlowSpec::default().viscosity,
            allow_hyphen_values = true
        )]
    pub viscosity: f64,
    /// Also write streamlines that carry equal rates, for ParaView
    #[arg(long, value_name = "FILE.vtp")]
    pub streamlines: Option<PathBuf>,
    /// Number of streamlines [default: 200]
    #[arg(long, value_name = "N")]
    pub lines: Option<usize>,
}

impl Default for FlowSpec {
    fn default() -> Self {
        Self {
            source: Vec::new(),
            sink: Vec::new(),
            pressure: Vec::new(),
            fault_options: FaultOptions::default(),
            extend_faults: None,
            permeability: FlowPermeability::default(),
            velocity: None,
            viscosity: 0.001,
            streamlines: None,
            lines: None,
        }
    }
}

/// A point where fluid enters or leaves.
#[derive(Debug, Clone, PartialEq)]
pub struct FlowPoint {
    /// The position, in the mesh's coordinates: two or three numbers.
    pub position: Vec<f64>,
    /// The rate in m^3/s, which is positive.
    pub rate: Option<f64>,
}

impl FromStr for FlowPoint {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let remedy = "give X,Y,Z or X,Y,Z:RATE, such as 120,80,40:0.001";
        let (place, rate) = match text.split_once(':') {
            Some((place, rate)) => (place, Some(parse_number(rate, remedy)?)),
            None => (text, None),
        };
        if rate.is_some_and(|rate| rate <= 0.0) {
            let remedy = "give a positive rate: a sink takes fluid out";
            return Err(InvalidValue::new("has a rate that is not positive", remedy));
        }
        let position = place.split(',').map(|word| parse_number(word, remedy));
        Ok(Self {
            position: position.collect::<std::result::Result<_, _>>()?,
            rate,
        })
    }
}

impl Display for FlowPoint {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(&joined(&self.position))?;
        match self.rate {
            Some(rate) => write!(f, ":{rate}"),
            None => Ok(()),
        }
    }
}

/// The pressure on a side of the box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SidePressure {
    /// The number of the side: 0 to 5 are xmin, xmax, ymin, ymax, zmin and zmax.
    pub side: u8,
    /// The pressure in Pa.
    pub pressure: f64,
}

impl FromStr for SidePressure {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let remedy = "give a side and its pressure, such as xmin=1e7";
        let (name, value) =
            (text.split_once('=')).ok_or_else(|| InvalidValue::new("has no '='", remedy))?;
        let side = SIDE_NAMES.iter().position(|side| *side == name.trim());
        let side = side.ok_or_else(|| {
            InvalidValue::new(
                format!("'{name}' is not a side of the box"),
                format!("give one of {}", SIDE_NAMES.join(", ")),
            )
        })?;
        Ok(Self {
            side: side as u8,
            pressure: parse_number(value, remedy)?,
        })
    }
}

impl Display for SidePressure {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let name = SIDE_NAMES.get(usize::from(self.side)).unwrap_or(&"?");
        write!(f, "{name}={}", self.pressure)
    }
}

/// The permeability of the cells, in m^2.
#[derive(Debug, Clone, PartialEq)]
pub enum FlowPermeability {
    /// The components of the tensor that all cells have: 1, 3 or 6 (in the plane 1, 2 or 3).
    Tensor(Vec<f64>),
    /// A cell array of the mesh, or a CSV file of lines region,K.
    Named(String),
}

impl Default for FlowPermeability {
    fn default() -> Self {
        Self::Tensor(vec![1e-13])
    }
}

impl FromStr for FlowPermeability {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> std::result::Result<Self, Self::Err> {
        let numbers: std::result::Result<Vec<f64>, _> =
            text.split(',').map(|word| word.trim().parse()).collect();
        Ok(numbers.map_or_else(|_| Self::Named(text.into()), Self::Tensor))
    }
}

impl Display for FlowPermeability {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tensor(components) => f.write_str(&joined(components)),
            Self::Named(name) => f.write_str(name),
        }
    }
}

serde_as_text!(
    FlowPoint: [",", ":"],
    SidePressure: ["="; 2],
    FlowPermeability: [","; 2],
);

impl FlowSpec {
    /// Checks the options, and that the outputs have the right endings and replace neither an input
    /// nor each other.
    ///
    /// # Errors
    /// Returns [`Error::Job`] or [`Error::Io`] that names the option.
    pub fn check_files(&self, mesh: &Path, output: &Path) -> Result<()> {
        self.validate()?;
        let mut inputs = vec![mesh];
        if let FlowPermeability::Named(name) = &self.permeability {
            inputs.push(Path::new(name));
        }
        for multiplier in &self.fault_options.fault_multiplier {
            if let FaultMultiplier::File(path) = multiplier {
                inputs.push(path);
            }
        }
        check_output(output, "--output", &["vtu"], &inputs)?;
        inputs.push(output);
        match (&self.streamlines, self.lines) {
            (Some(path), _) => check_output(path, "--streamlines", &["vtp"], &inputs),
            (None, Some(_)) => {
                let problem = "is the number of streamlines, but none are to be written";
                Err(Error::Job(cause("--lines", problem, "omit it")))
            }
            (None, None) => Ok(()),
        }
    }

    /// Checks that the options make sense together, and reads the factors of faults.
    ///
    /// # Errors
    /// Returns an error that begins with the name of the option that is impossible or has no effect.
    pub fn validate(&self) -> Result<()> {
        self.wells()?;
        for (k, side) in self.pressure.iter().enumerate() {
            if self.pressure[..k]
                .iter()
                .any(|known| known.side == side.side)
            {
                let place = format!("pressure {side}");
                return Err(Error::Job(cause(place, "is given twice", "give it once")));
            }
        }
        let laws = self.fault_options.laws(FaultResistance::Closed)?;
        laws.check_resistance()?;
        if let Some(distance) = self.extend_faults {
            let place = format!("extend-faults {distance}");
            if !(distance.is_finite() && distance > 0.0) {
                let remedy = "give a distance, or omit it";
                let problem = "is not a positive number of metres";
                return Err(Error::Job(cause(place, problem, remedy)));
            }
            if laws.law.is_open() && laws.overrides.is_empty() {
                let problem = "has no effect, because faults let flow through (open)";
                return Err(Error::Job(cause(place, problem, "omit it")));
            }
        }
        if !(self.viscosity > 0.0 && self.viscosity.is_finite()) {
            return Err(Error::Job(cause(
                format!("viscosity {}", self.viscosity),
                "is not a positive number",
                "give Pa s: water has 0.001",
            )));
        }
        if let Some(lines) = self.lines {
            let task = format!("{lines} streamlines");
            memory::ensure_available("lines", 4e3 * lines as f64, task, "ask for fewer")?;
        }
        Ok(())
    }

    /// Returns all sources, then all sinks, with as many coordinates as are given.
    fn wells(&self) -> Result<Vec<(String, &[f64], f64)>> {
        let mut wells = Vec::new();
        let mut without_rate = Vec::new();
        for (option, points, sign) in [("source", &self.source, 1.0), ("sink", &self.sink, -1.0)] {
            for point in points {
                if point.rate.is_none() && sign < 0.0 && self.pressure.is_empty() {
                    without_rate.push(wells.len());
                }
                wells.push((
                    format!("{option} {point}"),
                    point.position.as_slice(),
                    sign * point.rate.unwrap_or(DEFAULT_RATE),
                ));
            }
        }
        // Sinks without a rate share the rate of the sources. With side pressures this is not
        // needed, as they balance any difference.
        let has_rate = |i: &usize| !without_rate.contains(i);
        let net_rate: f64 = (0..wells.len()).filter(has_rate).map(|i| wells[i].2).sum();
        for &i in &without_rate {
            if net_rate <= 0.0 {
                let problem = format!("has no rate, and the others leave {net_rate} m^3/s for it");
                let remedy = "give it a rate, or the sources a larger one";
                return Err(Error::Flow(cause(&wells[i].0, problem, remedy)));
            }
            wells[i].2 = -net_rate / without_rate.len() as f64;
        }
        if wells.is_empty() && self.pressure.is_empty() {
            return Err(Error::Flow(cause(
                "flow",
                "nothing makes fluid flow",
                "give a source and a sink (--source X,Y,Z --sink X,Y,Z), or the pressure of two sides (--pressure xmin=2e7 --pressure xmax=1e7)",
            )));
        }
        Ok(wells)
    }

    /// Returns the wells and side pressures for a mesh of dimension `D`.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] for a point or a side of another dimension.
    pub(super) fn conditions<const D: usize>(&self) -> Result<BoundaryConditions<D>> {
        let well = |(name, position, rate): (String, &[f64], f64)| {
            let position = position.try_into().map_err(|_| {
                let problem = format!(
                    "has {} coordinates, but the mesh has {D} axes",
                    position.len()
                );
                Error::Flow(cause(&name, problem, "give one coordinate for each axis"))
            })?;
            Ok(PointWell {
                name,
                position,
                rate,
            })
        };
        if let Some(side) = (self.pressure.iter()).find(|side| usize::from(side.side) >= 2 * D) {
            let problem = format!("names a side that a {D}-D mesh does not have");
            let remedy = format!("give one of {}", SIDE_NAMES[..2 * D].join(", "));
            return Err(Error::Flow(cause(
                format!("pressure {side}"),
                problem,
                remedy,
            )));
        }
        let sides = self.pressure.iter().map(|side| (side.side, side.pressure));
        Ok(BoundaryConditions {
            wells: self.wells()?.into_iter().map(well).collect::<Result<_>>()?,
            sides: sides.collect(),
        })
    }

    /// Returns the mobility of every cell, from numbers, a file by region, or an array of the mesh.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for an impossible permeability, and the errors of reading the file.
    pub(super) fn rock<const D: usize, M: Storable<D>>(
        &self,
        stored: &StoredMesh<D, M>,
    ) -> Result<Rock> {
        let viscosity = self.viscosity;
        let refuse = |problem: &str| {
            let remedy = match D {
                2 => "give K, or KX,KY, or KXX,KYY,KXY, positive definite, in m^2",
                _ => "give K, or KX,KY,KZ, or KXX,KYY,KZZ,KXY,KYZ,KXZ, positive definite, in m^2",
            };
            let place = format!("permeability {}", self.permeability);
            Error::Job(cause(place, problem, remedy))
        };
        let name = match &self.permeability {
            FlowPermeability::Tensor(components) => {
                let tensor = Tensor::from_components::<D>(components);
                let tensor = tensor.ok_or_else(|| refuse("is not a permeability"))?;
                return Ok(Rock::uniform(tensor, viscosity));
            }
            FlowPermeability::Named(name) => name,
        };
        if let Some(array) = stored.arrays.cell_array(name) {
            return Rock::by_cell::<D>(&array.values.to_f64(), array.components, viscosity);
        }
        let path = std::path::Path::new(name);
        if !path.exists() {
            let arrays = stored.arrays.cell_data.iter();
            let names: Vec<&str> = arrays.map(|array| array.name.as_str()).collect();
            return Err(refuse(&format!(
                "is neither a number nor a file nor a cell array of the mesh (it has {})",
                names.join(", ")
            )));
        }
        let lines = "write region,K or region,KX,KY,KZ, in m^2";
        let by_region = values_by_region(path, Tensor::from_components::<D>, lines)?;
        let regions = stored.regions().ok_or_else(|| {
            refuse(
                "is given by region, but the mesh has no cell array 'region': give one value for all",
            )
        })?;
        Rock::by_region(&regions, &by_region, viscosity)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_read_from_texts_numbers_and_lists() {
        let json = r#"{
            "source": [[[8, 10, 12.5], 0.002], "30,20,15"],
            "sink": [[1, 2, 3]],
            "pressure": [["xmin", 1e5]],
            "permeability": [1e-13, 2e-13, 1e-14],
            "velocity": 2000
        }"#;
        let spec: FlowSpec = serde_json::from_str(json).unwrap();
        assert_eq!(spec.source[0].to_string(), "8,10,12.5:0.002");
        assert_eq!(spec.source[1].position, [30.0, 20.0, 15.0]);
        assert_eq!(spec.sink[0].rate, None);
        assert_eq!(spec.pressure[0].to_string(), "xmin=100000");
        let components = vec![1e-13, 2e-13, 1e-14];
        assert_eq!(spec.permeability, FlowPermeability::Tensor(components));
        spec.validate().unwrap();
        assert!(serde_json::from_str::<FlowSpec>(r#"{"source": ["8,10,x"]}"#).is_err());
        assert!(serde_json::from_str::<FlowSpec>(r#"{"pressure": ["top=1"]}"#).is_err());
    }

    #[test]
    fn impossible_combinations_are_refused_by_name() {
        let sink = FlowSpec {
            sink: vec!["1,2,3".parse().unwrap()],
            ..FlowSpec::default()
        };
        let twice = FlowSpec {
            pressure: vec!["xmin=1".parse().unwrap(); 2],
            ..FlowSpec::default()
        };
        for (spec, expected) in [
            (FlowSpec::default(), "flow: nothing makes fluid flow"),
            (sink, "sink 1,2,3: has no rate"),
            (twice, "pressure xmin=1: is given twice"),
        ] {
            let error = spec.validate().unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
    }
}

//! Wells of a simulation: their names, their places, and what controls them.

use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::{Completion, Control, PreparedModel, Trajectory, WellTracer};
use crate::Result;
use crate::job::spec::{InvalidValue, joined, parse_number};
use crate::job::well_file::{WellFile, is_well_file};
use crate::option_text::serde_as_text;
use crate::progress::Progress;

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

/// A well without a control of its own.
#[derive(Debug, Clone, PartialEq)]
pub struct ScheduledWell {
    /// The name. By default it is that in the file, or W with the number of the well.
    pub name: Option<String>,
    /// The place of the well.
    pub place: WellPlace,
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
        let (name, rest) = split_name(text);
        let (place, value) = rest
            .rsplit_once(':')
            .ok_or_else(|| InvalidValue::new("has no ':'", remedy))?;
        let value = parse_number(value, remedy)?;
        if value <= 0.0 {
            let problem = format!("has the value {value}, which is not a positive number");
            return Err(InvalidValue::new(problem, "give one above 0"));
        }
        let place = WellPlace::parse(place, remedy)?;
        Ok(Self { name, place, value })
    }
}

/// Splits `NAME=` from the start of a value.
fn split_name(text: &str) -> (Option<String>, &str) {
    match text.split_once('=') {
        Some((name, rest)) => (Some(name.to_string()), rest),
        None => (None, text),
    }
}

impl WellPlace {
    fn parse(text: &str, remedy: &str) -> std::result::Result<Self, InvalidValue> {
        if is_well_file(text) {
            return Ok(Self::File(text.into()));
        }
        let numbers = text.split(',').map(|word| parse_number(word, remedy));
        let numbers: Vec<f64> = numbers.collect::<std::result::Result<_, _>>()?;
        let count = numbers.len();
        let point = <[f64; 3]>::try_from(numbers)
            .map_err(|_| InvalidValue::new(format!("has {count} coordinates, not 3"), remedy))?;
        Ok(Self::Point(point))
    }
}

impl Display for WellPlace {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Point(point) => f.write_str(&joined(point)),
            Self::File(path) => write!(f, "{}", path.display()),
        }
    }
}

impl FromStr for ScheduledWell {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let remedy = "give X,Y,Z or FILE.csv, with NAME= before it or not";
        let (name, place) = split_name(text);
        let place = WellPlace::parse(place, remedy)?;
        Ok(Self { name, place })
    }
}

impl Display for ScheduledWell {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        if let Some(name) = &self.name {
            write!(f, "{name}=")?;
        }
        self.place.fmt(f)
    }
}

impl Display for WellOption {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        if let Some(name) = &self.name {
            write!(f, "{name}=")?;
        }
        write!(f, "{}:{}", self.place, self.value)
    }
}

serde_as_text!(WellOption: [",", ":"], ScheduledWell: [","; 2]);

/// A well of the options.
pub(super) struct GivenWell<'a> {
    /// The option and its value, for messages.
    pub label: String,
    pub name: Option<&'a str>,
    pub place: &'a WellPlace,
    /// The letter with which the default name begins.
    pub letter: char,
    pub control: Control,
}

/// Reads a well from a file. Returns its name, its trajectory and its completions.
pub(super) fn well_from_file(
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

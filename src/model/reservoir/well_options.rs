//! Wells of a simulation: their names, their places, and what controls them.

use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::{Completion, Control, PreparedModel, Trajectory, WellTracer};
use crate::error::cause;
use crate::geometry::spread::along_path;
use crate::image::placing::{GivenFile, MAX_TESTED_POINTS};
use crate::image::stated::CoordinateOptions;
use crate::option_text::serde_as_text;
use crate::option_text::{InvalidValue, joined, parse_number};
use crate::progress::Progress;
use crate::well_file::{WellFile, is_well_file};
use crate::{Error, Result};

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
    /// A table of the well's trajectory.
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

/// A well of a file, in the model.
pub(super) struct WellInModel {
    pub name: String,
    pub trajectory: Trajectory,
    pub completions: Vec<Completion>,
}

impl GivenWell<'_> {
    /// Reads the wells of a file: the one that the option names, the only one, or all of those that a
    /// schedule controls. `default_radius` in metres is that of a well whose file has none.
    pub(super) fn read(
        &self,
        path: &Path,
        default_radius: f64,
        tracer: &WellTracer,
        prepared: &PreparedModel,
        progress: &mut dyn Progress,
    ) -> Result<Vec<WellInModel>> {
        let mut files = WellFile::<3>::read_all(path, &[], None, 2)?;
        if files.len() > 1 {
            let names: Vec<String> = files.iter().map(|file| file.name.clone()).collect();
            let remedy = format!(
                "put one of these names before the file, NAME=: {}",
                names.join(", ")
            );
            match self.name {
                Some(name) if names.iter().any(|known| known == name) => {
                    files.retain(|file| file.name == name);
                }
                None if matches!(self.control, Control::Scheduled) => {}
                _ => {
                    let problem = format!("names a file of {} wells", names.len());
                    return Err(Error::Job(cause(&self.label, problem, remedy)));
                }
            }
        }
        let (frame, image) = (&prepared.frame, prepared.image_frame());
        let options = CoordinateOptions::default();
        let mut wells = Vec::new();
        for file in files {
            let given = GivenFile {
                place: &self.label,
                stated: &file.coordinates,
                options: &options,
            };
            let positions: Vec<[f64; 3]> = file.points.iter().map(|p| p.position).collect();
            let spread = along_path(&positions, MAX_TESTED_POINTS);
            let placing = image.placing(given, &mut spread.into_iter())?;
            let scale = placing.length(1.0) * frame.horizontal_scale();
            let points = file.points.iter();
            let radii = points
                .clone()
                .map(|p| p.radius.map_or(default_radius, |radius| radius * scale));
            let trajectory = Trajectory {
                name: self.label.clone(),
                radii: radii.collect(),
                points: points
                    .map(|p| frame.to_model(placing.apply(p.position)))
                    .collect(),
            };
            let completions = tracer.complete(&trajectory)?;
            let inside = completions.iter().map(|c| c.length).sum::<f64>();
            let total = trajectory.length();
            let place = format!("{} ({})", path.display(), file.name);
            let placed = placing.notes.iter().filter(|_| !placing.is_identity());
            for note in file.notes.iter().chain(placed) {
                progress.note(&format!("{place}: {note}"));
            }
            if file.points.iter().any(|p| p.radius.is_none()) {
                progress.note(&format!(
                    "{place}: the radius is that of --well-radius, {default_radius} m"
                ));
            }
            if inside < (1.0 - 1e-6) * total {
                progress.note(&format!(
                    "{}: {inside:.2} of the well's {total:.2} m lie in the mesh",
                    path.display()
                ));
            }
            wells.push(WellInModel {
                name: file.name,
                trajectory,
                completions,
            });
        }
        Ok(wells)
    }
}

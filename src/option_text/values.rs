//! Types of option values that several verbs share.
//!
//! Each type is parsed from a text and displayed as one, on the command line as in TOML and JSON, which
//! may also hold numbers and lists of them.

use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::serde_as_text;
use crate::error::cause;
use crate::units::{self, Unit};

/// The error about a text that is not a value of an option.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InvalidValue {
    /// The problem, as the end of a sentence that begins with the text.
    pub problem: String,
    /// The remedy: what to give instead.
    pub remedy: String,
}

impl InvalidValue {
    pub(crate) fn new(problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }
}

impl Display for InvalidValue {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{}; {}", self.problem, self.remedy)
    }
}

impl std::error::Error for InvalidValue {}
/// Returns `true` if `path` is a file, `FILE:NAME`, a part of a file, or `<name>`, the form in which front
/// ends name images in memory.
pub(crate) fn names_image(path: &Path) -> bool {
    let name = path.as_os_str().as_encoded_bytes();
    let part = path.to_str().and_then(|text| text.rsplit_once(':'));
    path.is_file()
        || part.is_some_and(|(file, _)| Path::new(file).is_file())
        || name.starts_with(b"<") && name.ends_with(b">")
}

/// A number that is the same everywhere, or a file with a number for each sample.
#[derive(Debug, Clone, PartialEq)]
pub enum NumberOrFile {
    /// A constant number.
    Constant(f64),
    /// An image of such numbers.
    File(PathBuf),
}

impl NumberOrFile {
    /// Returns the path if the value is a file.
    pub fn file(&self) -> Option<&Path> {
        match self {
            Self::Constant(_) => None,
            Self::File(path) => Some(path),
        }
    }
}

impl FromStr for NumberOrFile {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match text.trim().parse() {
            Ok(number) => Self::Constant(number),
            Err(_) => Self::File(text.into()),
        })
    }
}

impl Display for NumberOrFile {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Constant(number) => write!(f, "{number}"),
            Self::File(path) => write!(f, "{}", path.display()),
        }
    }
}
/// A point of two or three physical coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct PointValue(pub Vec<f64>);

impl PointValue {
    /// Returns the `D` coordinates. `option` is the name of the option in messages.
    ///
    /// # Errors
    /// Returns [`Error::Job`](crate::Error::Job) with this remedy for another number of coordinates.
    pub(crate) fn coordinates<const D: usize>(
        &self,
        option: &str,
        remedy: &str,
    ) -> crate::Result<[f64; D]> {
        <[f64; D]>::try_from(self.0.as_slice()).map_err(|_| {
            let problem = format!("has {} values, not {D}", self.0.len());
            crate::Error::Job(cause(format!("{option} {self}"), problem, remedy))
        })
    }
}

impl FromStr for PointValue {
    type Err = InvalidValue;

    fn from_str(text: &str) -> Result<Self, InvalidValue> {
        match finite_numbers(text) {
            Some(point) if matches!(point.len(), 2 | 3) => Ok(Self(point)),
            _ => Err(InvalidValue::new("is not a point", "give X,Y or X,Y,Z")),
        }
    }
}

impl Display for PointValue {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(&joined(&self.0))
    }
}

/// Thresholds of features: the smallest strength, or the values of isosurfaces in ascending order.
#[derive(Debug, Clone, PartialEq)]
pub struct ThresholdValues(Vec<f32>);

impl ThresholdValues {
    /// Returns the values: at least one.
    pub fn values(&self) -> &[f32] {
        &self.0
    }

    /// Returns the first value, and those beyond it.
    pub(crate) fn first_and_further(&self) -> (Option<f32>, Vec<f32>) {
        (
            self.0.first().copied(),
            self.0.iter().skip(1).copied().collect(),
        )
    }
}

impl From<f32> for ThresholdValues {
    fn from(value: f32) -> Self {
        Self(vec![value])
    }
}

impl FromStr for ThresholdValues {
    type Err = InvalidValue;

    fn from_str(text: &str) -> Result<Self, InvalidValue> {
        let remedy =
            "give a number such as 0.5, or values of isosurfaces that increase, such as 300,700";
        let Some(values) = finite_numbers(text) else {
            return Err(InvalidValue::new("is not a finite number", remedy));
        };
        let values: Vec<f32> = values.iter().map(|value| *value as f32).collect();
        if !values.iter().all(|value| value.is_finite()) {
            return Err(InvalidValue::new("is too large for a sample", remedy));
        }
        if values.windows(2).any(|pair| pair[0] >= pair[1]) {
            return Err(InvalidValue::new("has values that do not increase", remedy));
        }
        Ok(Self(values))
    }
}

impl Display for ThresholdValues {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let words: Vec<String> = self.0.iter().map(f32::to_string).collect();
        f.write_str(&words.join(","))
    }
}

/// A coordinate axis, or its opposite: x, y, z, -x, -y or -z.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SignedAxis {
    /// The number of the coordinate.
    pub axis: usize,
    /// `true` for the direction in which the coordinate increases.
    pub is_positive: bool,
}

impl SignedAxis {
    /// Checks that a mesh of `D` dimensions has the axis. `option` is its name in messages.
    ///
    /// # Errors
    /// Returns [`Error::Job`](crate::Error::Job) if it does not.
    pub(crate) fn check<const D: usize>(self, option: &str) -> crate::Result<()> {
        if self.axis < D {
            return Ok(());
        }
        let axes = &AXIS_NAMES[..D];
        Err(crate::Error::Job(cause(
            format!("{option} {self}"),
            "is not an axis of the mesh",
            format!("give {}, or -{}", axes.join(", "), axes.join(", -")),
        )))
    }
}

const AXIS_NAMES: [&str; 3] = ["x", "y", "z"];

impl FromStr for SignedAxis {
    type Err = InvalidValue;

    fn from_str(text: &str) -> Result<Self, InvalidValue> {
        let name = text.strip_prefix('-').unwrap_or(text);
        match AXIS_NAMES.iter().position(|&axis| axis == name) {
            Some(axis) => Ok(Self {
                axis,
                is_positive: name.len() == text.len(),
            }),
            None => Err(InvalidValue::new(
                "is not an axis",
                "give x, y, z, -x, -y or -z",
            )),
        }
    }
}

impl Display for SignedAxis {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let sign = if self.is_positive { "" } else { "-" };
        write!(f, "{sign}{}", AXIS_NAMES.get(self.axis).unwrap_or(&"?"))
    }
}
/// A length in samples, or in a unit of length such as `3mm`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length {
    /// The number.
    pub value: f64,
    /// Its unit; samples if `None`.
    pub unit: Option<Unit>,
}

impl Length {
    /// Returns a number of samples.
    pub fn samples(value: f64) -> Self {
        Self { value, unit: None }
    }

    /// Parses a length, or returns the problem.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let (value, unit) = units::split_length(text)?;
        Ok(Self { value, unit })
    }
}

impl FromStr for Length {
    type Err = InvalidValue;

    fn from_str(text: &str) -> Result<Self, InvalidValue> {
        let remedy = "give a number of samples such as 8, or a length such as 3mm";
        Self::parse(text).map_err(|problem| InvalidValue::new(problem, remedy))
    }
}

impl Display for Length {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}{}",
            self.value,
            self.unit.map_or("", |unit| unit.symbol)
        )
    }
}

serde_as_text!(
    Length: [","; 2],
    NumberOrFile: [","; 2],
    PointValue: [","; 2],
    SignedAxis: [","; 2],
    ThresholdValues: [","; 2],
);

/// Returns numbers with commas between them.
pub(crate) fn joined(numbers: &[f64]) -> String {
    let words: Vec<String> = numbers.iter().map(f64::to_string).collect();
    words.join(",")
}

/// Parses a finite number, which is expected as `remedy` says.
pub(crate) fn parse_number(text: &str, remedy: &str) -> Result<f64, InvalidValue> {
    match text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(_) => Err(InvalidValue::new("is not a finite number", remedy)),
        Err(_) => Err(InvalidValue::new("is not a number", remedy)),
    }
}

/// Parses a finite number.
pub(crate) fn finite_number(word: &str) -> Option<f64> {
    word.trim().parse().ok().filter(|x: &f64| x.is_finite())
}

/// Parses finite numbers with commas between them.
pub(crate) fn finite_numbers(text: &str) -> Option<Vec<f64>> {
    text.split(',').map(finite_number).collect()
}

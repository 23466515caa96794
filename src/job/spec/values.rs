//! Types of option values of `atomesh mesh` that are more than one number or word.
//!
//! Each type is parsed from a text and displayed as one, on the command line as in TOML and JSON, which
//! may also hold numbers and lists of them.

use std::fmt::{self, Display, Formatter};
use std::path::PathBuf;
use std::str::FromStr;

use crate::feature::LabelOptions;
use crate::option_text::{
    InvalidValue, Length, finite_number, finite_numbers, joined, serde_as_text,
};
use crate::units::Unit;

/// Default limits of the nominal distance, in samples: 8, and a third of that in gaps between
/// features.
pub(crate) const DEFAULT_DISTANCES: [f64; 2] = [2.7, 8.0];

/// Nominal distance between atoms, in samples or in a unit of length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NominalDistance {
    /// A constant distance.
    Constant(f64),
    /// A distance that varies, as [`DistanceSource`] says.
    Range {
        /// Smallest distance.
        min: f64,
        /// Largest distance.
        max: f64,
    },
    /// A distance in a unit of length, which [`MeshSpec::with_lengths_in`](super::MeshSpec::with_lengths_in)
    /// converts to samples: constant if both limits are the same.
    InUnit {
        /// Smallest distance.
        min: f64,
        /// Largest distance.
        max: f64,
        /// The unit of both.
        unit: Unit,
    },
}

impl NominalDistance {
    /// Returns the smallest and the largest distance.
    pub fn limits(self) -> [f64; 2] {
        match self {
            Self::Constant(d) => [d; 2],
            Self::Range { min, max } | Self::InUnit { min, max, .. } => [min, max],
        }
    }

    /// Returns `true` if the distance varies.
    pub fn varies(self) -> bool {
        let [min, max] = self.limits();
        matches!(self, Self::Range { .. }) || min < max
    }

    /// Returns the unit of length, if the distance has one.
    pub fn unit(self) -> Option<Unit> {
        match self {
            Self::InUnit { unit, .. } => Some(unit),
            _ => None,
        }
    }
}

impl Default for NominalDistance {
    fn default() -> Self {
        let [min, max] = DEFAULT_DISTANCES;
        Self::Range { min, max }
    }
}

impl FromStr for NominalDistance {
    type Err = InvalidValue;

    fn from_str(text: &str) -> Result<Self, InvalidValue> {
        let remedy = "give a positive number of samples such as 8, or MIN:MAX such as 5:15, or a length such as 3mm";
        let distance = |word| match Length::parse(word) {
            Ok(length) if length.value > 0.0 => Ok(length),
            Ok(_) => Err(InvalidValue::new("is not positive", remedy)),
            Err(problem) => Err(InvalidValue::new(problem, remedy)),
        };
        let (min, max) = match text.split_once(':') {
            Some((min, max)) => (distance(min)?, distance(max)?),
            None => (distance(text)?, distance(text)?),
        };
        // A unit behind one of the numbers counts for both, in that of the largest.
        let unit = max.unit.or(min.unit);
        let in_unit = |length: Length| match (length.unit, unit) {
            (Some(own), Some(unit)) if own != unit => length.value * own.size / unit.size,
            _ => length.value,
        };
        let (min, max) = (in_unit(min), in_unit(max));
        if min > max {
            return Err(InvalidValue::new("has a minimum above its maximum", remedy));
        }
        Ok(match unit {
            Some(unit) => Self::InUnit { min, max, unit },
            None if text.contains(':') => Self::Range { min, max },
            None => Self::Constant(max),
        })
    }
}

impl Display for NominalDistance {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Constant(d) => write!(f, "{d}"),
            Self::Range { min, max } => write!(f, "{min}:{max}"),
            Self::InUnit { min, max, unit } if min == max => write!(f, "{max}{}", unit.symbol),
            Self::InUnit { min, max, unit } => {
                write!(f, "{min}{symbol}:{max}{symbol}", symbol = unit.symbol)
            }
        }
    }
}

/// Source of a distance that varies.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum DistanceSource {
    /// Gaps between features: the distance is smallest where features run close together or cross at
    /// shallow angles.
    #[default]
    Gaps,
    /// The distance to features: the nominal distance is smallest on them and increases away from
    /// them.
    Features,
    /// The image: the distance is smallest where the image is darkest, or brightest where bright
    /// features are followed.
    Image,
    /// The Laplacian of the potential: the distance is smallest in its valleys.
    Laplacian,
    /// An image with a distance in samples for each sample.
    File(PathBuf),
}

impl FromStr for DistanceSource {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match text {
            "gaps" => Self::Gaps,
            "features" => Self::Features,
            "image" => Self::Image,
            "laplacian" => Self::Laplacian,
            file => Self::File(file.into()),
        })
    }
}

impl Display for DistanceSource {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Gaps => f.write_str("gaps"),
            Self::Features => f.write_str("features"),
            Self::Image => f.write_str("image"),
            Self::Laplacian => f.write_str("laplacian"),
            Self::File(path) => write!(f, "{}", path.display()),
        }
    }
}

/// Weights of faults and of horizons where both are followed, each in (0, 1].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeatureWeights(pub [f64; 2]);

impl Default for FeatureWeights {
    fn default() -> Self {
        Self([1.0; 2])
    }
}

impl FromStr for FeatureWeights {
    type Err = InvalidValue;

    fn from_str(text: &str) -> Result<Self, InvalidValue> {
        match finite_numbers(text).as_deref() {
            Some(&[f, h]) if [f, h].iter().all(|w| *w > 0.0 && *w <= 1.0) => Ok(Self([f, h])),
            _ => Err(InvalidValue::new(
                "is not two numbers above 0 and at most 1",
                "give the weights of faults and horizons, such as 1,0.5",
            )),
        }
    }
}

impl Display for FeatureWeights {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(&joined(&self.0))
    }
}

/// Distances by which a mesh of tetrahedra reaches beyond its image, in the image's physical units.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Padding {
    /// Distance above the image.
    pub above: f64,
    /// Distance below the image.
    pub below: f64,
    /// Distance on each of the other four sides.
    pub sides: f64,
}

impl FromStr for Padding {
    type Err = InvalidValue;

    fn from_str(text: &str) -> Result<Self, InvalidValue> {
        let remedy = "give distances beyond the image, such as above=2000,below=500,sides=1000";
        let mut padding = Self::default();
        for part in text.split(',') {
            let Some((name, value)) = part.split_once('=') else {
                return Err(InvalidValue::new("has no name=distance", remedy));
            };
            let distance = match name.trim() {
                "above" => &mut padding.above,
                "below" => &mut padding.below,
                "sides" => &mut padding.sides,
                _ => return Err(InvalidValue::new("has an unknown name", remedy)),
            };
            *distance = match finite_number(value) {
                Some(value) if value > 0.0 => value,
                _ => {
                    return Err(InvalidValue::new(
                        "has a distance that is not positive",
                        remedy,
                    ));
                }
            };
        }
        Ok(padding)
    }
}

impl Display for Padding {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self {
            above,
            below,
            sides,
        } = self;
        let parts = [("above", above), ("below", below), ("sides", sides)].into_iter();
        let given = parts.filter(|(_, distance)| **distance > 0.0);
        let texts: Vec<String> = given.map(|(name, d)| format!("{name}={d}")).collect();
        f.write_str(&texts.join(","))
    }
}

/// Axes along which a mesh is periodic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PeriodicAxes(pub [bool; 3]);

impl PeriodicAxes {
    /// The names of the axes.
    pub const NAMES: [&'static str; 3] = ["x", "y", "z"];
}

impl FromStr for PeriodicAxes {
    type Err = InvalidValue;

    fn from_str(text: &str) -> Result<Self, InvalidValue> {
        let remedy = "give axes of the image such as x or x,y,z";
        let mut axes = [false; 3];
        for name in text.split(',') {
            match Self::NAMES.iter().position(|known| *known == name.trim()) {
                Some(k) if axes[k] => return Err(InvalidValue::new("names an axis twice", remedy)),
                Some(k) => axes[k] = true,
                None => return Err(InvalidValue::new("names no axis x, y or z", remedy)),
            }
        }
        Ok(Self(axes))
    }
}

impl Display for PeriodicAxes {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let named = Self::NAMES
            .iter()
            .zip(self.0)
            .filter(|(_, is_periodic)| *is_periodic);
        let names: Vec<&str> = named.map(|(name, _)| *name).collect();
        f.write_str(&names.join(","))
    }
}

/// The length of one sample along each axis of lattice space, in which cells are well shaped.
///
/// Lattice space has these lengths except for a common factor: a unit cube of it holds one sample, so
/// that windows and grids are as large as for [`Metric::Samples`] whatever the unit of length.
#[derive(Debug, Clone, Default, PartialEq)]
pub enum Metric {
    /// [`Metric::Shape`] for scans, [`Metric::Samples`] for surveys and other images.
    #[default]
    Auto,
    /// 1 along each axis: cells are as flat as the image's own samples.
    Samples,
    /// The image's physical spacing.
    Physical,
    /// The image's physical spacing times one factor, such that a unit cube of lattice space holds one
    /// sample.
    Shape,
    /// The image's physical spacing over the square root of the permeability along each axis, times
    /// one factor as for [`Metric::Shape`]. The values are the permeabilities along x, y and z; only
    /// their ratios count. Two-point fluxes between cells with this shape are exact.
    Permeability(Vec<f64>),
    /// A positive length for each axis, x first.
    Scales(Vec<f64>),
}

impl FromStr for Metric {
    type Err = InvalidValue;

    fn from_str(text: &str) -> Result<Self, InvalidValue> {
        let remedy = "give auto, samples, physical, shape, k:KX,KY,KZ, or a positive number per axis such as 1,1,0.2";
        match text {
            "auto" => return Ok(Self::Auto),
            "samples" => return Ok(Self::Samples),
            "physical" => return Ok(Self::Physical),
            "shape" => return Ok(Self::Shape),
            _ => {}
        }
        let (is_permeability, numbers) = match text.strip_prefix("k:") {
            Some(numbers) => (true, numbers),
            None => (false, text),
        };
        let Some(scales) = finite_numbers(numbers) else {
            return Err(InvalidValue::new("is not made of numbers", remedy));
        };
        if !matches!(scales.len(), 2 | 3) {
            let problem = format!("has {} values, not 2 or 3", scales.len());
            return Err(InvalidValue::new(problem, remedy));
        }
        if scales.iter().any(|scale| *scale <= 0.0) {
            return Err(InvalidValue::new(
                "has a scale that is not positive",
                remedy,
            ));
        }
        Ok(if is_permeability {
            Self::Permeability(scales)
        } else {
            Self::Scales(scales)
        })
    }
}

impl Display for Metric {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Samples => f.write_str("samples"),
            Self::Physical => f.write_str("physical"),
            Self::Shape => f.write_str("shape"),
            Self::Permeability(values) => write!(f, "k:{}", joined(values)),
            Self::Scales(scales) => f.write_str(&joined(scales)),
        }
    }
}

impl FromStr for LabelOptions {
    type Err = InvalidValue;

    fn from_str(text: &str) -> Result<Self, InvalidValue> {
        Self::parse(text).map_err(|(problem, remedy)| InvalidValue::new(problem, remedy))
    }
}

serde_as_text!(
    NominalDistance: [":", ":"],
    DistanceSource: [","; 2],
    FeatureWeights: [","; 2],
    Padding: [","; 2],
    PeriodicAxes: [","; 2],
    Metric: [","; 2],
    LabelOptions: [",", ":"],
);

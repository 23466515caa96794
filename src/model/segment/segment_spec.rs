//! The options of `atomesh segment`, as one value.

use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::Options;
use super::places::{Place, Places};
use crate::error::cause;
use crate::files::output::check_output;
use crate::image::formats::{IMAGE_EXTENSIONS, InputOptions};
use crate::option_text::serde_as_text;
use crate::option_text::{InvalidValue, PointValue};
use crate::surface_file::SURFACE_EXTENSIONS;
use crate::{Error, Result};

/// Options of `atomesh segment`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct SegmentSpec {
    /// Places in the object, in physical coordinates: a point X,Y,Z (X,Y in 2-D), or a box given by
    /// two of its corners, X,Y,Z:X,Y,Z. May be repeated
    #[arg(
        long,
        value_name = "X,Y,Z[:X,Y,Z]",
        required = true,
        allow_hyphen_values = true
    )]
    pub object: Vec<PlaceValue>,
    /// Places in the background, given like those of the object; may be repeated
    #[arg(
        long,
        value_name = "X,Y,Z[:X,Y,Z]",
        required = true,
        allow_hyphen_values = true
    )]
    pub background: Vec<PlaceValue>,
    /// Also write the label of each sample as an image
    #[arg(long, value_name = "L.npy")]
    pub labels_out: Option<PathBuf>,
    /// Also write the boundary between object and background, smoothed: .vtp, .obj, or GOCAD's .ts
    #[arg(long, value_name = "S.vtp")]
    pub surface_out: Option<PathBuf>,
    /// Weight of the image values against the boundary
    #[arg(long, value_name = "NUMBER", default_value_t = Self::default().lambda)]
    pub lambda: f64,
    /// Difference of neighbouring cells' values at which a boundary is cheap [default: the root
    /// mean square of all differences]
    #[arg(long, value_name = "VALUE")]
    pub sigma: Option<f64>,
    /// An image of the true object (not 0), to be compared with the result
    #[arg(long, value_name = "T.npy")]
    pub truth: Option<PathBuf>,
    /// Also cut the image's samples themselves, which is the classical method, and report both
    #[arg(long)]
    pub voxels: bool,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

impl Default for SegmentSpec {
    fn default() -> Self {
        let Options { lambda, sigma } = Options::default();
        Self {
            object: Vec::new(),
            background: Vec::new(),
            labels_out: None,
            surface_out: None,
            lambda,
            sigma,
            truth: None,
            voxels: false,
            input: InputOptions::default(),
        }
    }
}

/// A point, or a box given by two of its corners, in physical coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaceValue {
    /// The point, or a corner of the box.
    pub corner: PointValue,
    /// The opposite corner of the box.
    pub opposite: Option<PointValue>,
}

impl FromStr for PlaceValue {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let point = |text: &str| {
            let wrong = |_| InvalidValue::new("is not a place", place_remedy::<3>());
            text.parse::<PointValue>().map_err(wrong)
        };
        let (corner, opposite) = match text.split_once(':') {
            Some((corner, opposite)) => (corner, Some(point(opposite)?)),
            None => (text, None),
        };
        Ok(Self {
            corner: point(corner)?,
            opposite,
        })
    }
}

impl Display for PlaceValue {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match &self.opposite {
            None => write!(f, "{}", self.corner),
            Some(opposite) => write!(f, "{}:{opposite}", self.corner),
        }
    }
}

serde_as_text!(PlaceValue: [",", ":"]);

/// Returns what to give as a place in a mesh of `D` dimensions.
fn place_remedy<const D: usize>() -> &'static str {
    match D {
        2 => "give a point X,Y or a box X,Y:X,Y",
        _ => "give a point X,Y,Z or a box X,Y,Z:X,Y,Z",
    }
}

impl SegmentSpec {
    /// Checks the options, and that the outputs have the right endings and replace neither an input
    /// nor each other.
    ///
    /// # Errors
    /// Returns [`Error::Job`] or [`Error::Io`] that names the option.
    pub fn check_files(&self, image: &Path, mesh: &Path, output: &Path) -> Result<()> {
        let mut inputs = vec![image, mesh];
        inputs.extend(self.truth.as_deref());
        check_output(output, "--output", &["vtu"], &inputs)?;
        inputs.push(output);
        if let Some(path) = &self.labels_out {
            check_output(path, "--labels-out", &IMAGE_EXTENSIONS, &inputs)?;
            inputs.push(path);
        }
        if let Some(path) = &self.surface_out {
            check_output(path, "--surface-out", &SURFACE_EXTENSIONS, &inputs)?;
        }
        self.validate()
    }

    /// Checks that the options are possible.
    ///
    /// # Errors
    /// Returns [`Error::Job`] that begins with the name of the option that is impossible.
    pub fn validate(&self) -> Result<()> {
        self.input.refuse_label_table()?;
        for (option, places) in [("object", &self.object), ("background", &self.background)] {
            if places.is_empty() {
                let problem = "gives no place";
                return Err(Error::Job(cause(option, problem, place_remedy::<3>())));
            }
        }
        for (option, value) in [("lambda", Some(self.lambda)), ("sigma", self.sigma)] {
            if let Some(value) = value.filter(|v| !(v.is_finite() && *v > 0.0)) {
                let place = format!("{option} {value}");
                let problem = "is out of range";
                return Err(Error::Job(cause(place, problem, "give a positive number")));
            }
        }
        Ok(())
    }

    /// Returns the places in a mesh of `D` dimensions.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for a point that does not have `D` coordinates.
    pub(super) fn places<const D: usize>(&self) -> Result<Places<D>> {
        let places = |option: &'static str, values: &[PlaceValue]| {
            let place = |value: &PlaceValue| {
                let point = |point: &PointValue| point.coordinates(option, place_remedy::<D>());
                let corner = point(&value.corner)?;
                let opposite = value.opposite.as_ref().map(point).transpose()?;
                let name = format!("{option} {value}");
                Ok(Place::new(name, corner, opposite.unwrap_or(corner)))
            };
            values.iter().map(place).collect::<Result<Vec<_>>>()
        };
        Ok(Places {
            object: places("object", &self.object)?,
            background: places("background", &self.background)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_points_and_boxes() {
        let json = r#"{"object": [[1, 2, 3], [[1, 5, 3], [4, 2, 6]]], "background": ["0,0,0"]}"#;
        let spec: SegmentSpec = serde_json::from_str(json).unwrap();
        spec.validate().unwrap();
        assert_eq!(spec.object[1].to_string(), "1,5,3:4,2,6");
        let places = spec.places::<3>().unwrap();
        let [point, cuboid] = &places.object[..] else {
            panic!("two places")
        };
        assert!(point.contains([1.0, 2.0, 3.0]) && !point.contains([1.0, 2.0, 3.1]));
        assert!(cuboid.contains([2.0, 4.0, 5.0]) && !cuboid.contains([2.0, 6.0, 5.0]));
        let error = spec.places::<2>().err().unwrap().to_string();
        assert!(error.starts_with("object 1,2,3: has 3 values"), "{error}");
    }

    #[test]
    fn impossible_options_are_refused_by_name() {
        let places = SegmentSpec {
            object: vec!["1,2".parse().unwrap()],
            background: vec!["3,4".parse().unwrap()],
            ..SegmentSpec::default()
        };
        places.validate().unwrap();
        let flat = SegmentSpec {
            lambda: 0.0,
            ..places.clone()
        };
        let without_object = SegmentSpec {
            object: Vec::new(),
            ..places
        };
        for (spec, expected) in [
            (flat, "lambda 0: is out of range"),
            (without_object, "object: gives no place"),
        ] {
            let error = spec.validate().unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
        assert!("1,2:3".parse::<PlaceValue>().is_err());
    }
}

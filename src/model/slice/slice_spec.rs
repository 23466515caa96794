//! The options of `atomesh slice`, as one value.

use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::drawing::InputNames;
use crate::error::cause;
use crate::files::output::check_output;
use crate::image::Geometry;
use crate::image::formats::InputOptions;
use crate::image::formats::stream::ImageHeader;
use crate::option_text::serde_as_text;
use crate::option_text::{InvalidValue, PointValue, SignedAxis};
use crate::{Error, Result};

/// Options of `atomesh slice`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct SliceSpec {
    /// The view: sections with three planes, or a view in space of which a part is cut away
    #[arg(long, value_name = "VIEW", default_value = "sections")]
    pub view: View,
    /// Array of the mesh, of cells or of nodes, that colours the cells, such as pressure or region
    /// [default: the image]
    #[arg(long, value_name = "ARRAY")]
    pub color: Option<String>,
    /// The point where the planes meet, in physical coordinates; of a survey, also lines, such as
    /// inline=2047, or inline=2047,crossline=310,z=-900 [default: the middle]
    #[arg(long, value_name = "X,Y,Z", allow_negative_numbers = true)]
    pub at: Option<SlicePosition>,
    /// The part that is cut away in --view 3d: the corner beyond that point, or all in front of the
    /// plane through it across x, y or z [default: corner]
    #[arg(long, value_name = "WHERE")]
    pub cut: Option<CutMode>,
    /// The direction that is up: x, y, z or -x, -y, -z in physical coordinates [default: as the
    /// image has it; z if unknown]
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    pub up: Option<SignedAxis>,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// Remedy for a point that has not three coordinates.
const POINT_REMEDY: &str = "give a point such as 1500,2000,300";

/// The point where the planes of sections meet.
#[derive(Debug, Clone, PartialEq)]
pub enum SlicePosition {
    /// A point in physical coordinates.
    Point(PointValue),
    /// Numbers of an inline and of a crossline, and z; those that are missing are in the middle.
    Lines(Vec<(String, f64)>),
}

impl FromStr for SlicePosition {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        if !text.contains('=') {
            return text.parse().map(Self::Point);
        }
        let line = |entry: &str| {
            let (name, value) = entry.split_once('=')?;
            let name = name.trim();
            let value = value.trim().parse::<f64>().ok().filter(|v| v.is_finite())?;
            ["inline", "crossline", "z"]
                .contains(&name)
                .then(|| (name.to_string(), value))
        };
        let lines: Option<Vec<_>> = text.split(',').map(line).collect();
        lines.map(Self::Lines).ok_or_else(|| {
            InvalidValue::new(
                "names no lines",
                "give numbers of inline, crossline and z, such as inline=2047,z=-900",
            )
        })
    }
}

impl Display for SlicePosition {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Point(point) => point.fmt(f),
            Self::Lines(lines) => {
                let lines = lines.iter().map(|(name, value)| format!("{name}={value}"));
                f.write_str(&lines.collect::<Vec<_>>().join(","))
            }
        }
    }
}

serde_as_text!(SlicePosition: [","; 2]);

/// Returns the image axis that a line or z is a position along, and the index there.
fn line_index(head: Option<&ImageHeader<3>>, name: &str, value: f64) -> Result<(usize, f64)> {
    let refuse = |problem: String, remedy: &str| {
        Err(Error::Job(cause(
            format!("at {name}={value}"),
            problem,
            remedy,
        )))
    };
    let Some(head) = head else {
        let problem = "is a line of a survey, but no image is given".to_string();
        return refuse(problem, "give the image, or a point X,Y,Z");
    };
    if name == "z" {
        let geometry = &head.geometry;
        return match geometry.axis_along(2) {
            Some(axis) => Ok((axis, (value - geometry.origin[2]) / geometry.axes[axis][2])),
            None => refuse("is along no axis of the image".into(), "give a point X,Y,Z"),
        };
    }
    let axis = head.geometry.names.iter().position(|axis| axis == name);
    let (Some(axis), Some([inlines, crosslines])) = (axis, head.line_numbers) else {
        let problem = "is a line of a survey, but the image has no line numbers".to_string();
        return refuse(problem, "give a point X,Y,Z, or the SEG-Y file");
    };
    let lines = if name == "inline" {
        inlines
    } else {
        crosslines
    };
    let index = (value - lines.first as f64) / lines.step as f64;
    if !(0.0..=lines.count as f64 - 1.0).contains(&index) {
        return refuse(
            format!("lies outside the survey, which has {name}s {lines}"),
            "give one of these",
        );
    }
    Ok((axis, index))
}

/// The view that a picture shows.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum View {
    /// The whole mesh in 2-D, or its sections with three planes in 3-D
    #[default]
    Sections,
    /// The objects in space, seen from outside (3-D)
    #[value(name = "3d")]
    #[serde(rename = "3d")]
    Solid,
}

/// The part of a body that is cut away.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum CutMode {
    /// A corner; of a mesh, whole cells are removed
    #[default]
    Corner,
    /// One half, across x
    X,
    /// One half, across y
    Y,
    /// One half, across z
    Z,
}

impl CutMode {
    /// Returns the physical coordinate that is constant on the plane of the cut; `None` for a corner.
    pub(super) fn coordinate(self) -> Option<usize> {
        match self {
            Self::Corner => None,
            Self::X => Some(0),
            Self::Y => Some(1),
            Self::Z => Some(2),
        }
    }
}

impl SliceSpec {
    /// Checks the options for these files, and that the picture replaces none of them. Returns what
    /// the files are.
    ///
    /// # Errors
    /// Returns [`Error::Job`] or [`Error::Io`] that names the option or the file.
    pub fn check_files(&self, files: &[PathBuf], output: &Path) -> Result<InputNames> {
        let inputs: Vec<&Path> = files.iter().map(PathBuf::as_path).collect();
        check_output(output, "--output", &["png"], &inputs)?;
        let names = InputNames::classify(files)?;
        self.validate(names.image.is_some(), names.mesh.is_some())?;
        Ok(names)
    }

    /// Checks that every option has an effect with the others, and with the presence of an image and
    /// of a mesh.
    ///
    /// # Errors
    /// Returns [`Error::Job`] that begins with the name of the option that is impossible or has no
    /// effect.
    pub fn validate(&self, has_image: bool, has_mesh: bool) -> Result<()> {
        self.input.refuse_label_table()?;
        let refuse = |place: &str, problem: &str, remedy: &str| {
            Err(Error::Job(cause(place, problem, remedy)))
        };
        if let Some(SlicePosition::Point(point)) = &self.at {
            point.coordinates::<3>("at", POINT_REMEDY)?;
        }
        if !has_image {
            self.input
                .refuse_unused("no image is given", "omit it, or give the image")?;
        }
        if self.view == View::Sections {
            if !has_image {
                let problem = "needs an image, but none is given";
                return refuse("view sections", problem, "give the image, or --view 3d");
            }
            if self.cut.is_some() {
                let problem = "applies to --view 3d only";
                return refuse("cut", problem, "give --view 3d, or omit it");
            }
        }
        if self.color.is_some() && !has_mesh {
            let problem = "colours the cells of a mesh, but none is given";
            return refuse("color", problem, "give the mesh, or omit it");
        }
        let given = [("at", self.at.is_some()), ("cut", self.cut.is_some())];
        if let Some((option, _)) = given.iter().find(|(_, given)| *given)
            && !(has_image || has_mesh)
        {
            let problem = "cuts an image or a mesh, but none is given";
            return refuse(option, problem, "omit it");
        }
        Ok(())
    }

    /// Returns the point where the planes meet in sample indices, if it is given. `head` is that of
    /// the image, if there is one.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for a point in the plane, for a line that the image does not have, and
    /// for axes that do not span space.
    pub(super) fn crossing_index(
        &self,
        geometry: &Geometry<3>,
        head: Option<&ImageHeader<3>>,
    ) -> Result<Option<[f64; 3]>> {
        match &self.at {
            None => Ok(None),
            Some(SlicePosition::Point(point)) => {
                let point = point.coordinates("at", POINT_REMEDY)?;
                let index = geometry.to_index(point).ok_or_else(|| {
                    let problem = "cannot be found: the image's axes are linearly dependent";
                    Error::Job(cause(
                        format!("at {point:?}"),
                        problem,
                        "correct the geometry",
                    ))
                })?;
                Ok(Some(index))
            }
            Some(SlicePosition::Lines(lines)) => {
                let mut at = head.map_or([0.0; 3], |head| head.dims.map(|n| (n / 2) as f64));
                for (name, value) in lines {
                    let (axis, index) = line_index(head, name, *value)?;
                    at[axis] = index;
                }
                Ok(Some(at))
            }
        }
    }

    /// Returns the direction that is up, if it is given.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for an axis that an image of `D` dimensions does not have.
    pub(super) fn up_direction<const D: usize>(&self) -> Result<Option<SignedAxis>> {
        if let Some(up) = self.up {
            up.check::<D>("up")?;
        }
        Ok(self.up)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_without_effect_are_refused_by_name() {
        let spec = |json: &str| serde_json::from_str::<SliceSpec>(json).unwrap();
        for (json, has_image, has_mesh, expected) in [
            ("{}", false, true, "view sections: needs an image"),
            (r#"{"cut": "x"}"#, true, true, "cut: applies to"),
            (r#"{"color": "p"}"#, true, false, "color: colours the cells"),
            (
                r#"{"at": [1, 2]}"#,
                true,
                true,
                "at 1,2: has 2 values, not 3",
            ),
            (
                r#"{"view": "3d", "at": [1, 2, 3]}"#,
                false,
                false,
                "at: cuts an image or a mesh",
            ),
        ] {
            let error = spec(json).validate(has_image, has_mesh).unwrap_err();
            assert!(error.to_string().starts_with(expected), "{error}");
        }
        let solid = spec(r#"{"view": "3d", "up": "-y", "cut": "z"}"#);
        solid.validate(false, true).unwrap();
        assert_eq!(solid.cut.and_then(CutMode::coordinate), Some(2));
    }
}

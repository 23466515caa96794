//! The options of `atomesh columns`, as one value.

use std::fmt::{self, Display, Formatter};
use std::path::Path;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::LayerDivision;
use super::given::horizon_file;
use crate::error::cause;
use crate::files::output::check_output;
use crate::image::formats::InputOptions;
use crate::option_text::InvalidValue;
use crate::option_text::serde_as_text;
use crate::surface_file::FileOption;
use crate::{Error, Result};

/// Options of `atomesh columns`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ColumnsSpec {
    /// Number of layers between two horizons: one number for all intervals, or N,N,... [default: 1]
    #[arg(long, value_name = "N,...", conflicts_with = "layer_thickness")]
    pub layers: Option<LayerCounts>,
    /// Mean thickness of the layers; replaces --layers
    #[arg(long, value_name = "T", allow_hyphen_values = true)]
    pub layer_thickness: Option<f64>,
    /// Smallest thickness of a layer; thinner layers vanish at that place
    #[arg(
        long,
        value_name = "T",
        default_value_t = 0.0,
        allow_hyphen_values = true
    )]
    pub least_thickness: f64,
    /// Let horizons be offset at the map's faults: z closer than DIST to a fault is continued from the
    /// same side
    #[arg(long, value_name = "DIST", allow_hyphen_values = true)]
    pub throws: Option<f64>,
    /// Unit of z [default: the unit of the map's x]
    #[arg(long, value_name = "UNIT")]
    pub z_unit: Option<String>,
    /// Options for reading the images.
    #[command(flatten, next_help_heading = "Reading images")]
    pub input: InputOptions,
}

/// Numbers of layers: one for all intervals, or one for each.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LayerCounts(pub Vec<usize>);

impl FromStr for LayerCounts {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let counts: Option<Vec<usize>> = text.split(',').map(|w| w.trim().parse().ok()).collect();
        counts.map(Self).ok_or_else(|| {
            let remedy = "give one, or one for each interval, such as 3,5";
            InvalidValue::new("is not a number of layers", remedy)
        })
    }
}

impl Display for LayerCounts {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let counts: Vec<String> = self.0.iter().map(usize::to_string).collect();
        f.write_str(&counts.join(","))
    }
}

serde_as_text!(LayerCounts: [","; 2]);

impl ColumnsSpec {
    /// Checks the options, and that the output replaces neither the map nor a file of the
    /// `horizons`.
    ///
    /// # Errors
    /// Returns [`Error::Job`] or [`Error::Io`] that names the option.
    pub fn check_files(&self, map: &Path, horizons: &[String], output: &Path) -> Result<()> {
        self.validate()?;
        let options: Vec<Option<FileOption>> = horizons
            .iter()
            .map(|text| horizon_file(text))
            .collect::<Result<_>>()?;
        let mut inputs = vec![map];
        inputs.extend(options.iter().flatten().map(|option| option.path.as_path()));
        check_output(output, "--output", &["vtu"], &inputs)
    }

    /// Checks that the options make sense together.
    ///
    /// # Errors
    /// Returns [`Error::Job`] that begins with the name of the option that is impossible or has no
    /// effect.
    pub fn validate(&self) -> Result<()> {
        self.input.refuse_label_table()?;
        if self.layers.is_some() && self.layer_thickness.is_some() {
            let problem = "is given, but the thickness of layers determines their number";
            let remedy = "omit it, or the thickness";
            return Err(Error::Job(cause("layers", problem, remedy)));
        }
        if !(self.least_thickness >= 0.0 && self.least_thickness.is_finite()) {
            let place = format!("least-thickness {}", self.least_thickness);
            let remedy = "give 0 or more, in the unit of z";
            return Err(Error::Job(cause(place, "is not a thickness", remedy)));
        }
        if let Some(throws) = self.throws.filter(|d| !(*d > 0.0 && d.is_finite())) {
            let remedy = "give a positive distance in the unit of the map";
            return Err(Error::Job(cause(
                format!("throws {throws}"),
                "is not a distance",
                remedy,
            )));
        }
        Ok(())
    }

    /// Returns how the intervals between horizons are divided.
    pub(super) fn division(&self) -> LayerDivision {
        let counts = self.layers.as_ref().map(|counts| counts.0.clone());
        match self.layer_thickness {
            Some(thickness) => LayerDivision::Thickness(thickness),
            None => LayerDivision::Counts(counts.unwrap_or_else(|| vec![1])),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layers_are_numbers_or_a_thickness() {
        let spec = |json: &str| serde_json::from_str::<ColumnsSpec>(json).unwrap();
        for (json, expected) in [
            ("{}", LayerDivision::Counts(vec![1])),
            (r#"{"layers": 4}"#, LayerDivision::Counts(vec![4])),
            (r#"{"layers": [3, 5]}"#, LayerDivision::Counts(vec![3, 5])),
            (r#"{"layer-thickness": 2.5}"#, LayerDivision::Thickness(2.5)),
        ] {
            let spec = spec(json);
            spec.validate().unwrap();
            assert_eq!(spec.division(), expected);
        }
        for (json, expected) in [
            (r#"{"layers": 4, "layer-thickness": 1}"#, "layers: is given"),
            (r#"{"least-thickness": -1}"#, "least-thickness -1: is not"),
            (r#"{"throws": 0}"#, "throws 0: is not a distance"),
        ] {
            let error = spec(json).validate().unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
        assert!("3,x".parse::<LayerCounts>().is_err());
    }
}

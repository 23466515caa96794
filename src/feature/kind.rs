//! Kinds of features and their names.

use crate::error::{Error, Result, cause};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Kinds of features. The doc comments of the variants are help texts of the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum FeatureKind {
    /// Chosen by what the image looks like; the report says which
    Auto,
    /// Bright surfaces: fault images, fractures, membranes
    Ridges,
    /// Dark surfaces
    Valleys,
    /// Steps of brightness
    Edges,
    /// Steps of brightness, by non-maximum suppression and hysteresis
    Canny,
    /// The boundary of an object, by random shortest paths (2-D; needs a point of the object)
    Paths,
    /// Peaks and troughs of seismic amplitude along the bedding's normal
    Horizons,
    /// Places where layers of seismic amplitude are broken
    Faults,
    /// Faults and horizons, each with its weight
    #[cfg_attr(feature = "cli", value(name = "faults+horizons"))]
    #[serde(rename = "faults+horizons")]
    FaultsAndHorizons,
    /// Interfaces between labels
    Labels,
    /// The middle of a mask of thin objects, as interpreters paint faults
    Mask,
    /// The image is b(x) already: -1 on features, 0 elsewhere
    Potential,
}

/// Names on the command line.
const NAMES: [(FeatureKind, &str); 12] = [
    (FeatureKind::Auto, "auto"),
    (FeatureKind::Ridges, "ridges"),
    (FeatureKind::Valleys, "valleys"),
    (FeatureKind::Edges, "edges"),
    (FeatureKind::Canny, "canny"),
    (FeatureKind::Paths, "paths"),
    (FeatureKind::Horizons, "horizons"),
    (FeatureKind::Faults, "faults"),
    (FeatureKind::FaultsAndHorizons, "faults+horizons"),
    (FeatureKind::Labels, "labels"),
    (FeatureKind::Mask, "mask"),
    (FeatureKind::Potential, "potential"),
];

impl fmt::Display for FeatureKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(
            NAMES
                .iter()
                .find(|(kind, _)| kind == self)
                .map_or("", |(_, name)| name),
        )
    }
}

impl FromStr for FeatureKind {
    type Err = Error;

    fn from_str(s: &str) -> Result<Self> {
        let names = || NAMES.map(|(_, name)| name).join(", ");
        NAMES
            .iter()
            .find(|(_, name)| *name == s)
            .map(|(kind, _)| *kind)
            .ok_or_else(|| {
                Error::Feature(cause(
                    format!("feature '{s}'"),
                    "is not known",
                    format!("choose one of {}", names()),
                ))
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_have_the_names_of_the_command_line() {
        for (kind, name) in NAMES {
            assert_eq!(kind.to_string(), name);
            assert_eq!(name.parse::<FeatureKind>().unwrap(), kind);
        }
        let message = "ridge".parse::<FeatureKind>().unwrap_err().to_string();
        assert!(
            message.contains("'ridge'") && message.contains("ridges"),
            "{message}"
        );
    }
}

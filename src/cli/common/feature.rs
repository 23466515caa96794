//! How features are asked for, which several verbs do.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use crate::Result;
use crate::cli::parse::{self, refuse};
use crate::feature;
use crate::feature::paths::Seeds;

/// Which features of the image the mesh shall follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FeatureChoice {
    /// Picked by what the image looks like; the report says what was picked
    Auto,
    /// Bright sheets: fault images, fractures, membranes
    Ridges,
    /// Dark sheets
    Valleys,
    /// Steps of brightness
    Edges,
    /// Steps of brightness, by non-maximum suppression and hysteresis
    Canny,
    /// The boundary of an object, by random shortest paths (2-D; needs --object)
    Paths,
    /// Peaks and troughs of seismic amplitude along the bedding's normal
    Horizons,
    /// Where the layers of seismic amplitude do not continue
    Faults,
    /// Both, each with its weight
    #[value(name = "faults+horizons")]
    #[serde(rename = "faults+horizons")]
    FaultsAndHorizons,
    /// Interfaces between labels, or the rim of a mask
    Labels,
    /// The image is b(x) already: -1 on features, 0 elsewhere
    Potential,
}

impl From<FeatureChoice> for feature::Kind {
    fn from(choice: FeatureChoice) -> Self {
        match choice {
            FeatureChoice::Auto => Self::Auto,
            FeatureChoice::Ridges => Self::Ridges,
            FeatureChoice::Valleys => Self::Valleys,
            FeatureChoice::Edges => Self::Edges,
            FeatureChoice::Canny => Self::Canny,
            FeatureChoice::Paths => Self::Paths,
            FeatureChoice::Horizons => Self::Horizons,
            FeatureChoice::Faults => Self::Faults,
            FeatureChoice::FaultsAndHorizons => Self::FaultsAndHorizons,
            FeatureChoice::Labels => Self::Labels,
            FeatureChoice::Potential => Self::Potential,
        }
    }
}

/// `--object` and `--background`: points near which paths begin and end.
///
/// # Errors
/// [`Error::Job`] for what is no point of `D` coordinates.
pub fn seeds<const D: usize>(
    object: &[String],
    background: &[String],
    seed: u64,
) -> Result<Seeds<D>> {
    let remedy = match D {
        2 => "give a point X,Y",
        _ => "give a point X,Y,Z",
    };
    let points = |option: &str, words: &[String]| {
        let point = |text: &String| parse::point(option, text, remedy);
        words.iter().map(point).collect::<Result<_>>()
    };
    Ok(Seeds {
        object: points("--object", object)?,
        background: points("--background", background)?,
        seed,
        ..Seeds::default()
    })
}

/// `--feature-weights`: two numbers in (0, 1].
pub fn feature_weights(text: Option<&str>) -> Result<[f64; 2]> {
    let Some(text) = text else {
        return Ok([1.0; 2]);
    };
    let numbers: Vec<f64> = text
        .split(',')
        .filter_map(|w| w.trim().parse().ok())
        .collect();
    match numbers[..] {
        [f, h] if [f, h].iter().all(|w| *w > 0.0 && *w <= 1.0) => Ok([f, h]),
        _ => Err(parse::bad(
            "--feature-weights",
            text,
            "is not two numbers above 0 and at most 1",
            "give the weights of faults and horizons, such as 1,0.5",
        )),
    }
}

/// `--distance` of `feature`: one positive number.
pub fn positive_distance(distance: f64) -> Result<f64> {
    Ok(parse::distance("--distance", &distance.to_string())?.0)
}

/// `--sigma`, if given: positive.
pub fn feature_scale(sigma: Option<f64>) -> Result<Option<f64>> {
    match sigma {
        Some(s) if !(s.is_finite() && s > 0.0) => Err(refuse(
            "--sigma",
            s,
            "is not a positive number of samples",
            "leave it out, or give about the features' thickness",
        )),
        valid => Ok(valid),
    }
}

/// `--threshold`, if given: finite.
pub fn threshold(threshold: Option<f32>) -> Result<Option<f32>> {
    match threshold {
        Some(t) if !t.is_finite() => Err(refuse(
            "--threshold",
            f64::from(t),
            "is not a finite number",
            "leave it out: the automatic threshold is printed",
        )),
        valid => Ok(valid),
    }
}

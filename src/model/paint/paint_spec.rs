//! The options of `atomesh paint`, as one value.

use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::error::cause;
use crate::files::output::check_output;
use crate::image::formats::InputOptions;
use crate::model::surface::GroupingOptions;
use crate::option_text::serde_as_text;
use crate::option_text::{InvalidValue, PointValue};
use crate::surface_file::SURFACE_EXTENSIONS;
use crate::{Error, Result};

/// Options of `atomesh paint`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct PaintSpec {
    /// Points where paint begins, in physical coordinates (X,Y in 2-D); =N sets the region,
    /// otherwise each seed has its own. May be repeated; `auto` paints every block between surfaces,
    /// `blocks` every block between faults, across horizons
    #[arg(
        long,
        value_name = "X,Y,Z[=N]",
        required = true,
        allow_hyphen_values = true
    )]
    pub seed: Vec<PaintSeed>,
    /// An image; paint flows less easily where its values change
    #[arg(long, value_name = "IMAGE")]
    pub image: Option<PathBuf>,
    /// Largest distance of paint from its seed, in samples, along the shortest path that crosses no
    /// surface
    #[arg(long, value_name = "SAMPLES")]
    pub level: Option<f64>,
    /// Largest width of an opening that paint does not pass, as a fraction of the blocks that it
    /// connects; 0 for none
    #[arg(long, value_name = "SHARE", default_value_t = Self::default().neck)]
    pub neck: f64,
    /// Also write the surfaces around the painted regions: .vtp, .obj, or GOCAD's .ts
    #[arg(long, value_name = "S.vtp")]
    pub surface_out: Option<PathBuf>,
    /// Options that group faces into the surfaces that paint does not cross.
    #[command(flatten)]
    pub grouping: GroupingOptions,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

impl Default for PaintSpec {
    fn default() -> Self {
        Self {
            seed: vec![PaintSeed::Auto],
            image: None,
            level: None,
            neck: 0.3,
            surface_out: None,
            grouping: GroupingOptions::default(),
            input: InputOptions::default(),
        }
    }
}

/// The beginning of paint.
#[derive(Debug, Clone, PartialEq)]
pub enum PaintSeed {
    /// Every block between surfaces has its own paint.
    Auto,
    /// Every block between faults has its own paint; horizons do not stop it.
    Blocks,
    /// A point in physical coordinates, and its region, from 1. Without a region, the number of the
    /// seed is taken.
    Point(PointValue, Option<u32>),
}

impl FromStr for PaintSeed {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        if text == "blocks" {
            return Ok(Self::Blocks);
        }
        let refuse = |problem: &str| InvalidValue::new(problem, seed_remedy::<3>());
        let (point, region) = match text.split_once('=') {
            None => (text, None),
            Some((point, region)) => {
                let region = region.trim().parse().ok();
                let region = region.filter(|region| (1..=1_000_000).contains(region));
                let wrong = || refuse("has no region from 1 to 1000000");
                (point, Some(region.ok_or_else(wrong)?))
            }
        };
        let point = point.parse().map_err(|_| refuse("is not a point"))?;
        Ok(Self::Point(point, region))
    }
}

impl Display for PaintSeed {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Blocks => f.write_str("blocks"),
            Self::Point(point, None) => write!(f, "{point}"),
            Self::Point(point, Some(region)) => write!(f, "{point}={region}"),
        }
    }
}

serde_as_text!(PaintSeed: [",", "="]);

/// Returns what to give as a seed in a mesh of `D` dimensions.
fn seed_remedy<const D: usize>() -> &'static str {
    match D {
        2 => "give X,Y or X,Y=N, such as 10,20.5 or 10,20.5=2, or auto or blocks alone",
        _ => "give X,Y,Z or X,Y,Z=N, such as 10,20.5,30 or 10,20.5,30=2, or auto or blocks alone",
    }
}

/// Positions where paint begins, and their regions.
pub(super) type Seeds<const D: usize> = Vec<([f64; D], u32)>;

impl PaintSpec {
    /// Checks the options, and that the outputs have the right endings and replace neither an input
    /// nor each other.
    ///
    /// # Errors
    /// Returns [`Error::Job`] or [`Error::Io`] that names the option.
    pub fn check_files(&self, mesh: &Path, output: &Path) -> Result<()> {
        let mut inputs = vec![mesh];
        inputs.extend(self.image.as_deref());
        check_output(output, "--output", &["vtu"], &inputs)?;
        if let Some(path) = &self.surface_out {
            inputs.push(output);
            check_output(path, "--surface-out", &SURFACE_EXTENSIONS, &inputs)?;
        }
        self.validate()
    }

    /// Checks that the options make sense together.
    ///
    /// # Errors
    /// Returns [`Error::Job`] that begins with the name of the option that is impossible or has no
    /// effect.
    pub fn validate(&self) -> Result<()> {
        self.input.refuse_label_table()?;
        let refuse = |place: String, problem: &str, remedy: &str| {
            Err(Error::Job(cause(place, problem, remedy)))
        };
        if self.seed.is_empty() {
            let problem = "is missing, so that paint begins nowhere";
            return refuse("seed".into(), problem, seed_remedy::<3>());
        }
        for seed in [PaintSeed::Auto, PaintSeed::Blocks] {
            if self.seed.len() > 1 && self.seed.contains(&seed) {
                let problem = "is given with other seeds";
                return refuse(format!("seed {seed}"), problem, seed_remedy::<3>());
            }
        }
        let level = self.level.unwrap_or(f64::INFINITY);
        for (option, value, max) in [("level", level, f64::INFINITY), ("neck", self.neck, 1.0)] {
            if !(0.0..=max).contains(&value) {
                let remedy = format!("give a number from 0 to {max}");
                return refuse(format!("{option} {value}"), "is out of range", &remedy);
            }
        }
        if self.image.is_none() {
            self.input
                .refuse_unused("no image is given", "omit it, or give the image")?;
        }
        self.grouping.options(None).map(|_| ())
    }

    /// Returns the seeds in a mesh of `D` dimensions; `None` for `auto`
    /// and `blocks`.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for a point that does not have `D` coordinates.
    pub(super) fn seeds<const D: usize>(&self) -> Result<Option<Seeds<D>>> {
        let seed = |(seed, number): (&PaintSeed, u32)| match seed {
            PaintSeed::Auto | PaintSeed::Blocks => None,
            PaintSeed::Point(point, region) => {
                let position = point.coordinates("seed", seed_remedy::<D>());
                Some(position.map(|position| (position, region.unwrap_or(number))))
            }
        };
        self.seed
            .iter()
            .zip(1..)
            .map(seed)
            .collect::<Option<Result<_>>>()
            .transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_are_read_from_texts_and_lists() {
        let json = r#"{"seed": ["1,2,3", [[4, 5, 6], 9], [7, 8, 9]], "neck": 0.5}"#;
        let spec: PaintSpec = serde_json::from_str(json).unwrap();
        spec.validate().unwrap();
        let expected = vec![
            ([1.0, 2.0, 3.0], 1),
            ([4.0, 5.0, 6.0], 9),
            ([7.0, 8.0, 9.0], 3),
        ];
        assert_eq!(spec.seeds::<3>().unwrap(), Some(expected));
        let error = spec.seeds::<2>().unwrap_err().to_string();
        assert!(
            error.starts_with("seed 1,2,3: has 3 values, not 2"),
            "{error}"
        );
        assert_eq!(PaintSpec::default().seeds::<3>().unwrap(), None);
    }

    #[test]
    fn impossible_options_are_refused_by_name() {
        for (json, expected) in [
            (r#"{"seed": []}"#, "seed: is missing"),
            (r#"{"seed": ["auto", "1,2"]}"#, "seed auto: is given with"),
            (
                r#"{"neck": 1.5}"#,
                "neck 1.5: is out of range; give a number from 0 to 1",
            ),
            (
                r#"{"level": -1}"#,
                "level -1: is out of range; give a number from 0 to inf",
            ),
        ] {
            let spec: PaintSpec = serde_json::from_str(json).unwrap();
            let error = spec.validate().unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
        for text in ["1,2,3=0", "1,2,x", "1,2,3=x", "1"] {
            assert!(text.parse::<PaintSeed>().is_err(), "{text}");
        }
    }
}

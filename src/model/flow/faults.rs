//! Options that say how faults resist flow.

use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::FaultLaw;
use super::driver::{BarrierSelection, FaultLaws};
use crate::error::cause;
use crate::files::table::{Term, ValueTable, text_rows};
use crate::model::surface::names::Selector;
use crate::option_text::serde_as_text;
use crate::option_text::{InvalidValue, parse_number};
use crate::{Error, Result};

/// Names of the column of surfaces in tables.
pub(crate) const SURFACE_TERM: Term = Term::new(
    "surface",
    &[
        "fault",
        "name",
        "faultname",
        "surfacename",
        "number",
        "horizon",
        "interface",
    ],
);

/// Tables of factors by surface.
const MULTIPLIERS: ValueTable = ValueTable {
    terms: &[
        SURFACE_TERM,
        Term::new(
            "factor",
            &[
                "multiplier",
                "mult",
                "transmissibilitymultiplier",
                "multflt",
                "value",
            ],
        ),
        Term::new("thickness", &["width", "faultthickness"]),
    ],
    meaning: "a surface, its factor and perhaps its thickness",
    remedy: "write surface,factor or surface,factor,thickness",
};

/// Options that say how the surfaces of a mesh resist flow.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct FaultOptions {
    /// Resistance of faults to flow: closed, open, or a factor by which the permeability is
    /// multiplied there, from 0 to 1, in an export also above 1 [default: closed for flow, open for
    /// export]
    #[arg(long, value_name = "HOW", allow_hyphen_values = true)]
    pub faults: Option<FaultResistance>,
    /// Thickness (m) of the layer to which the factor of --faults applies [default: the distance
    /// between the two cells]
    #[arg(long, value_name = "W")]
    pub fault_thickness: Option<f64>,
    /// Factor of some surfaces: their number or name as `atomesh surface MESH` prints it
    /// (fault3:0.01), the two regions that they separate (1/11:0), or a pattern with * and ?
    /// ('interface_*_11:0'). May be repeated, and the last match applies; or a CSV file of lines
    /// surface,factor or surface,factor,thickness
    #[arg(long, value_name = "WHICH:FACTOR", allow_hyphen_values = true)]
    pub fault_multiplier: Vec<FaultMultiplier>,
    /// Surfaces to which --faults applies: faults, horizons, all, or a list of numbers, names,
    /// pairs of regions and patterns as in --fault-multiplier. All others are open [default:
    /// faults]
    #[arg(long, value_name = "WHICH")]
    pub barriers: Option<BarrierSelection>,
}

/// The resistance of faults to flow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaultResistance {
    /// Nothing flows across.
    Closed,
    /// Faults do not resist.
    Open,
    /// The permeability in faults is multiplied by this factor.
    Factor(f64),
}

impl FromStr for FaultResistance {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        Ok(match text {
            "closed" => Self::Closed,
            "open" => Self::Open,
            factor => Self::Factor(parse_number(factor, "give open, closed, or a multiplier")?),
        })
    }
}

impl Display for FaultResistance {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Closed => f.write_str("closed"),
            Self::Open => f.write_str("open"),
            Self::Factor(factor) => factor.fmt(f),
        }
    }
}

/// Surfaces with a factor of their own.
#[derive(Debug, Clone, PartialEq)]
pub enum FaultMultiplier {
    /// The surfaces that the selector selects, and their factor.
    Surfaces(Selector, f64),
    /// A CSV file of lines surface,factor or surface,factor,thickness.
    File(PathBuf),
}

impl FromStr for FaultMultiplier {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let remedy = "give a surface and its factor, such as 3:0.01 or fault3:0.01, or a CSV file";
        if Path::new(text).is_file() {
            return Ok(Self::File(text.into()));
        }
        let (surface, factor) = text
            .rsplit_once(':')
            .ok_or_else(|| InvalidValue::new("has no ':' and is not a file", remedy))?;
        let selector = parse_selector(surface)
            .ok_or_else(|| InvalidValue::new("names no surface (numbers begin at 1)", remedy))?;
        Ok(Self::Surfaces(selector, parse_number(factor, remedy)?))
    }
}

impl Display for FaultMultiplier {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Surfaces(selector, factor) => write!(f, "{selector}:{factor}"),
            Self::File(path) => write!(f, "{}", path.display()),
        }
    }
}

impl FromStr for BarrierSelection {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        Ok(match text {
            "faults" => Self::Faults,
            "horizons" => Self::Horizons,
            "all" => Self::All,
            text => {
                let selectors = text.split(',').map(parse_selector);
                Self::Selected(selectors.collect::<Option<_>>().ok_or_else(|| {
                    InvalidValue::new(
                        "does not say which surfaces",
                        "give faults, horizons, all, or numbers and names such as 1,fault4",
                    )
                })?)
            }
        })
    }
}

impl Display for BarrierSelection {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Faults => f.write_str("faults"),
            Self::Horizons => f.write_str("horizons"),
            Self::All => f.write_str("all"),
            Self::Selected(selectors) => {
                let texts: Vec<String> = selectors.iter().map(Selector::to_string).collect();
                f.write_str(&texts.join(","))
            }
        }
    }
}

serde_as_text!(
    FaultResistance: [","; 2],
    FaultMultiplier: [":"; 2],
    BarrierSelection: [","; 2],
);

/// Parses what selects surfaces: a number from 1, or a name or pattern. Returns `None` for other
/// numbers.
pub(crate) fn parse_selector(text: &str) -> Option<Selector> {
    let number = text.trim().parse::<f64>();
    match Selector::parse(text)? {
        Selector::Number(0) => None,
        Selector::Name(_) if number.is_ok() => None,
        selector => Some(selector),
    }
}

impl FaultOptions {
    /// Returns the first given option that makes a surface resist flow; `None` if there is none.
    pub(crate) fn given_option(&self) -> Option<&'static str> {
        let given = [
            ("faults", self.faults.is_some()),
            ("fault-multiplier", !self.fault_multiplier.is_empty()),
        ];
        given.iter().find(|option| option.1).map(|option| option.0)
    }

    /// Returns which surfaces resist flow, and how. Files of factors are read. `default` is the
    /// resistance of faults if none is given.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for options that make no sense or have no effect.
    pub(crate) fn laws(&self, default: FaultResistance) -> Result<FaultLaws> {
        let resistance = self.faults.unwrap_or(default);
        if self.barriers.is_some() && resistance == FaultResistance::Open {
            let problem = "selects surfaces that resist flow, but faults let it through (open)";
            return Err(Error::Job(cause("barriers", problem, "omit it")));
        }
        let thickness = self.fault_thickness;
        let law = match resistance {
            FaultResistance::Factor(factor) => FaultLaw::new(factor, thickness)?,
            _ if thickness.is_some() && self.fault_multiplier.is_empty() => {
                let problem = format!(
                    "is that of the layer to which a factor applies, but faults are {resistance}"
                );
                let remedy = "give faults a factor, such as 0.01, or omit it";
                return Err(Error::Job(cause("fault-thickness", problem, remedy)));
            }
            FaultResistance::Closed => FaultLaw::new(0.0, thickness)?,
            FaultResistance::Open => FaultLaw::OPEN,
        };
        let mut overrides: Vec<(Selector, FaultLaw)> = Vec::new();
        for multiplier in &self.fault_multiplier {
            for (place, selector, law) in multiplier.laws(thickness)? {
                if overrides.iter().any(|known| known.0 == selector) {
                    let problem = format!("gives fault {selector} a second factor");
                    return Err(Error::Flow(cause(place, problem, "give each fault once")));
                }
                overrides.push((selector, law));
            }
        }
        Ok(FaultLaws {
            selection: self.barriers.clone().unwrap_or_default(),
            law,
            overrides,
            must_apply: self.faults.is_some(),
        })
    }
}

impl FaultMultiplier {
    /// Returns each selector of surfaces, its law, and the place where it is given.
    fn laws(&self, thickness: Option<f64>) -> Result<Vec<(String, Selector, FaultLaw)>> {
        let path = match self {
            Self::Surfaces(selector, factor) => {
                let law = FaultLaw::new(*factor, thickness)?;
                return Ok(vec![(
                    format!("fault-multiplier {self}"),
                    selector.clone(),
                    law,
                )]);
            }
            Self::File(path) => path,
        };
        let row = |words: &[&str]| {
            let (surface, numbers) = words.split_first()?;
            let numbers: Option<Vec<f64>> = numbers.iter().map(|word| word.parse().ok()).collect();
            let selector = parse_selector(surface)?;
            match numbers?[..] {
                [factor] => Some((selector, factor, thickness)),
                [factor, thickness] => Some((selector, factor, Some(thickness))),
                _ => None,
            }
        };
        let rows = text_rows(path, &MULTIPLIERS, row)?;
        let law = |(line, (selector, factor, thickness))| {
            let place = format!("{}:{line}", path.display());
            Ok((place, selector, FaultLaw::new(factor, thickness)?))
        };
        rows.into_iter().map(law).collect()
    }
}

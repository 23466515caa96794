//! Options that say how faults resist flow.

use std::path::Path;

use clap::Args;

use super::parse::{number, option_error};
use crate::error::cause;
use crate::files::csv::text_rows;
use crate::model::flow::FaultLaw;
use crate::model::flow::driver::{BarrierSelection, FaultLaws};
use crate::model::surface::names::Selector;
use crate::{Error, Result};

/// Options that say how the surfaces of a mesh resist flow.
#[derive(Debug, Clone, Args)]
pub struct FaultOptions {
    /// Resistance of faults to flow: closed, open, or a factor from 0 to 1 by which the
    /// permeability is multiplied there [default: closed for flow, open for export]
    #[arg(long, value_name = "HOW", allow_hyphen_values = true)]
    pub faults: Option<String>,
    /// Thickness (m) of the layer to which the factor of --faults applies [default: the distance
    /// between the two cells]
    #[arg(long, value_name = "W")]
    pub fault_thickness: Option<f64>,
    /// Factor of some surfaces: their number or name as `atomesh surface MESH` prints it
    /// (fault3:0.01), the two regions that they separate (1/11:0), or a pattern with * and ?
    /// ('interface_*_11:0'). May be repeated, and the last match applies; or a CSV file of lines
    /// surface,factor[,thickness]
    #[arg(long, value_name = "WHICH:FACTOR", allow_hyphen_values = true)]
    pub fault_multiplier: Vec<String>,
    /// Surfaces to which --faults applies: faults, horizons, all, or a list of numbers, names,
    /// pairs of regions and patterns as in --fault-multiplier. All others are open [default:
    /// faults]
    #[arg(long, value_name = "WHICH")]
    pub barriers: Option<String>,
}

impl FaultOptions {
    /// Returns the first typed option that makes a surface resist flow; `None` if there is none.
    pub fn given_option(&self) -> Option<&'static str> {
        let typed = [
            ("--faults", self.faults.is_some()),
            ("--fault-multiplier", !self.fault_multiplier.is_empty()),
        ];
        typed.iter().find(|option| option.1).map(|option| option.0)
    }

    /// Returns which surfaces resist flow, and how. `default` is the value of `--faults` if it is
    /// not typed.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for options that make no sense or have no effect.
    pub fn laws(&self, default: &str) -> Result<FaultLaws> {
        let setting = self.faults.as_deref().unwrap_or(default);
        if self.barriers.is_some() && setting == "open" {
            let problem = format!(
                "selects surfaces that resist flow, but --faults {setting} lets it through"
            );
            return Err(Error::Job(cause("--barriers", problem, "omit it")));
        }
        let thickness = self.fault_thickness;
        check_thickness(thickness, setting, !self.fault_multiplier.is_empty())?;
        let law = parse_faults(setting, thickness)?;
        let selection = match self.barriers.as_deref() {
            Some(text) => parse_surface_selection("--barriers", text)?,
            None => BarrierSelection::Faults,
        };
        let mut overrides: Vec<(Selector, FaultLaw)> = Vec::new();
        for text in &self.fault_multiplier {
            for (place, selector, law) in parse_multipliers(text, thickness)? {
                if overrides.iter().any(|known| known.0 == selector) {
                    let problem = format!("gives fault {selector} a second factor");
                    return Err(Error::Flow(cause(place, problem, "give each fault once")));
                }
                overrides.push((selector, law));
            }
        }
        Ok(FaultLaws {
            selection,
            law,
            overrides,
            must_apply: self.faults.is_some(),
        })
    }
}

/// Parses the value of `--faults`: `closed`, `open`, or a multiplier.
fn parse_faults(setting: &str, thickness: Option<f64>) -> Result<FaultLaw> {
    match setting {
        "closed" => FaultLaw::new(0.0, thickness),
        "open" => Ok(FaultLaw::OPEN),
        text => {
            let remedy = "give open, closed, or a multiplier from 0 to 1";
            FaultLaw::new(number("--faults", text, remedy)?, thickness)
        }
    }
}

/// Checks that there is a factor to which a thickness can apply.
fn check_thickness(thickness: Option<f64>, faults: &str, has_factors: bool) -> Result<()> {
    if thickness.is_none() || has_factors || !matches!(faults, "closed" | "open") {
        return Ok(());
    }
    Err(Error::Job(cause(
        "--fault-thickness",
        format!("is that of the layer to which a factor applies, but faults are {faults}"),
        "give a factor, such as --faults 0.01, or omit it",
    )))
}

/// Parses `WHICH:FACTOR`, or reads a CSV file of factors. Returns each surface, its law, and the
/// place where it is given.
fn parse_multipliers(
    text: &str,
    thickness: Option<f64>,
) -> Result<Vec<(String, Selector, FaultLaw)>> {
    let option = "--fault-multiplier";
    let path = Path::new(text);
    if path.is_file() {
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
        let rows = text_rows(
            path,
            row,
            "a surface, its factor and perhaps its thickness",
            "write surface,factor or surface,factor,thickness",
        )?;
        let law = |(line, (selector, factor, thickness))| {
            Ok((
                format!("{text}:{line}"),
                selector,
                FaultLaw::new(factor, thickness)?,
            ))
        };
        return rows.into_iter().map(law).collect();
    }
    let remedy = "give a surface and its factor, such as 3:0.01 or fault3:0.01, or a CSV file";
    let (surface, factor) = text
        .rsplit_once(':')
        .ok_or_else(|| option_error(option, text, "has no ':' and is not a file", remedy))?;
    let selector = parse_selector(surface).ok_or_else(|| {
        let problem = "names no surface (numbers begin at 1)";
        option_error(option, text, problem, remedy)
    })?;
    let law = FaultLaw::new(number(option, factor, remedy)?, thickness)?;
    Ok(vec![(format!("{option} {text}"), selector, law)])
}

/// Parses what selects surfaces: a number from 1, or a name or pattern. Returns `None` for other
/// numbers.
fn parse_selector(text: &str) -> Option<Selector> {
    let number = text.trim().parse::<f64>();
    match Selector::parse(text)? {
        Selector::Number(0) => None,
        Selector::Name(_) if number.is_ok() => None,
        selector => Some(selector),
    }
}

/// Parses a selection of surfaces: `faults`, `horizons`, `all`, or a list of numbers, names and
/// patterns.
pub fn parse_surface_selection(option: &str, text: &str) -> Result<BarrierSelection> {
    Ok(match text {
        "faults" => BarrierSelection::Faults,
        "horizons" => BarrierSelection::Horizons,
        "all" => BarrierSelection::All,
        text => {
            let selectors = text.split(',').map(parse_selector);
            let selectors = selectors.collect::<Option<_>>().ok_or_else(|| {
                let remedy = "give faults, horizons, all, or numbers and names such as 1,fault4";
                option_error(option, text, "does not say which surfaces", remedy)
            })?;
            BarrierSelection::Selected(selectors)
        }
    })
}

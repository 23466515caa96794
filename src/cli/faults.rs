//! How faults resist flow, as typed.

use std::path::Path;

use clap::Args;

use super::parse::{number, option_error};
use crate::error::cause;
use crate::files::csv::text_rows;
use crate::model::flow::FaultLaw;
use crate::model::flow::driver::{BarrierSelection, FaultLaws};
use crate::model::surface::names::Selector;
use crate::{Error, Result};

/// How the surfaces of a mesh resist flow.
#[derive(Debug, Clone, Args)]
pub struct FaultOptions {
    /// How faults resist flow across them: closed, open, or the factor, from 0 to 1, of the
    /// permeability there [default: closed for flow, open for export]
    #[arg(long, value_name = "HOW", allow_hyphen_values = true)]
    pub faults: Option<String>,
    /// Thickness (m) of the layer to which the factor of --faults applies [default: from cell to cell]
    #[arg(long, value_name = "W")]
    pub fault_thickness: Option<f64>,
    /// The factor of some surfaces: by the number or name that `atomesh surface MESH` prints, such as
    /// fault3:0.01, by the regions between which they lie, such as 1/11:0, or by a pattern of names with *
    /// and ?, such as 'interface_*_11:0'; may be repeated, and the last that picks a surface holds; or a
    /// CSV file of lines surface,factor[,thickness]
    #[arg(long, value_name = "WHICH:FACTOR", allow_hyphen_values = true)]
    pub fault_multiplier: Vec<String>,
    /// The surfaces to which --faults applies: faults, horizons, all, or a list of numbers, names, pairs
    /// of regions and patterns, as --fault-multiplier has them. Others are open [default: faults]
    #[arg(long, value_name = "WHICH")]
    pub barriers: Option<String>,
}

impl FaultOptions {
    /// The first option that says that something resists flow, if one is typed.
    pub fn given_option(&self) -> Option<&'static str> {
        let typed = [
            ("--faults", self.faults.is_some()),
            ("--fault-multiplier", !self.fault_multiplier.is_empty()),
        ];
        typed.iter().find(|option| option.1).map(|option| option.0)
    }

    /// Which surfaces resist flow, and how; `usual` is what faults do if nothing is said.
    ///
    /// # Errors
    /// [`Error::Job`] for what makes no sense, or changes nothing.
    pub fn laws(&self, usual: &str) -> Result<FaultLaws> {
        let how = self.faults.as_deref().unwrap_or(usual);
        if self.barriers.is_some() && how == "open" {
            let problem =
                format!("selects surfaces that resist flow, but --faults {how} lets it through");
            return Err(Error::Job(cause("--barriers", problem, "omit it")));
        }
        let thickness = self.fault_thickness;
        check_thickness(thickness, how, !self.fault_multiplier.is_empty())?;
        let law = parse_faults(how, thickness)?;
        let standing = match self.barriers.as_deref() {
            Some(text) => parse_standing("--barriers", text)?,
            None => BarrierSelection::Faults,
        };
        let mut own: Vec<(Selector, FaultLaw)> = Vec::new();
        for text in &self.fault_multiplier {
            for (place, selector, law) in parse_multipliers(text, thickness)? {
                if own.iter().any(|known| known.0 == selector) {
                    let problem = format!("gives fault {selector} a second factor");
                    return Err(Error::Flow(cause(place, problem, "give each fault once")));
                }
                own.push((selector, law));
            }
        }
        Ok(FaultLaws {
            selection: standing,
            law,
            overrides: own,
            must_apply: self.faults.is_some(),
        })
    }
}

/// What faults do: `closed`, `open`, or a multiplier.
fn parse_faults(how: &str, thickness: Option<f64>) -> Result<FaultLaw> {
    match how {
        "closed" => FaultLaw::new(0.0, thickness),
        "open" => Ok(FaultLaw::OPEN),
        text => {
            let remedy = "give open, closed, or a multiplier from 0 to 1";
            FaultLaw::new(number("--faults", text, remedy)?, thickness)
        }
    }
}

/// Checks that a thickness, which is that of the layer that a factor is for, has such a factor.
fn check_thickness(thickness: Option<f64>, faults: &str, factors: bool) -> Result<()> {
    if thickness.is_none() || factors || !matches!(faults, "closed" | "open") {
        return Ok(());
    }
    Err(Error::Job(cause(
        "--fault-thickness",
        format!("is that of the layer to which a factor applies, but faults are {faults}"),
        "give a factor, such as --faults 0.01, or omit it",
    )))
}

/// Surfaces with laws of their own, and where that was said: `WHICH:FACTOR`, or from a CSV file.
fn parse_multipliers(
    text: &str,
    thickness: Option<f64>,
) -> Result<Vec<(String, Selector, FaultLaw)>> {
    let option = "--fault-multiplier";
    let path = Path::new(text);
    if path.is_file() {
        let row = |words: &[&str]| {
            let (which, numbers) = words.split_first()?;
            let numbers: Option<Vec<f64>> = numbers.iter().map(|word| word.parse().ok()).collect();
            let selector = parse_selector(which)?;
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
    let (which, factor) = text
        .rsplit_once(':')
        .ok_or_else(|| option_error(option, text, "has no ':' and is not a file", remedy))?;
    let selector = parse_selector(which).ok_or_else(|| {
        let problem = "names no surface (numbers begin at 1)";
        option_error(option, text, problem, remedy)
    })?;
    let law = FaultLaw::new(number(option, factor, remedy)?, thickness)?;
    Ok(vec![(format!("{option} {text}"), selector, law)])
}

/// What picks surfaces: a number from 1 on, or a pattern. Other numbers pick nothing.
fn parse_selector(text: &str) -> Option<Selector> {
    let number = text.trim().parse::<f64>();
    match Selector::parse(text)? {
        Selector::Number(0) => None,
        Selector::Name(_) if number.is_ok() => None,
        selector => Some(selector),
    }
}

/// Which surfaces are meant: `faults`, `horizons`, `all`, or a list of numbers, names and patterns.
pub fn parse_standing(option: &str, text: &str) -> Result<BarrierSelection> {
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

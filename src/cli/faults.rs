//! How faults resist flow, as typed.

use std::path::Path;

use clap::Args;

use super::parse::{bad, number, rows};
use crate::error::cause;
use crate::model::flow::Faults;
use crate::model::flow::through::{FaultLaws, Standing};
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
    /// The factor of one fault, by the number that `atomesh surface MESH` gives it; may be repeated;
    /// or a CSV file of lines surface,factor[,thickness]
    #[arg(long, value_name = "N:FACTOR", allow_hyphen_values = true)]
    pub fault_multiplier: Vec<String>,
    /// The surfaces to which --faults applies: faults, horizons, all, or numbers N,N,... Others are
    /// open
    /// [default: faults]
    #[arg(long, value_name = "WHICH")]
    pub barriers: Option<String>,
}

impl FaultOptions {
    /// The first option that says that something resists flow, if one is typed.
    pub fn typed(&self) -> Option<&'static str> {
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
        let law = faults(how, thickness)?;
        let standing = match self.barriers.as_deref() {
            Some(text) => standing("--barriers", text)?,
            None => Standing::Faults,
        };
        let mut own: Vec<(u32, Faults)> = Vec::new();
        for text in &self.fault_multiplier {
            for (place, number, law) in multipliers(text, thickness)? {
                if own.iter().any(|known| known.0 == number) {
                    let problem = format!("gives fault {number} a second factor");
                    return Err(Error::Flow(cause(place, problem, "give each fault once")));
                }
                own.push((number, law));
            }
        }
        Ok(FaultLaws { standing, law, own })
    }
}

/// What faults do: `closed`, `open`, or a multiplier.
fn faults(how: &str, thickness: Option<f64>) -> Result<Faults> {
    match how {
        "closed" => Faults::new(0.0, thickness),
        "open" => Ok(Faults::OPEN),
        text => {
            let remedy = "give open, closed, or a multiplier from 0 to 1";
            Faults::new(number("--faults", text, remedy)?, thickness)
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

/// Faults with laws of their own, and where that was said: `N:FACTOR`, or from a CSV file.
fn multipliers(text: &str, thickness: Option<f64>) -> Result<Vec<(String, u32, Faults)>> {
    let number_of =
        |x: f64| (x >= 1.0 && x <= f64::from(u32::MAX) && x.fract() == 0.0).then_some(x as u32);
    let option = "--fault-multiplier";
    let path = Path::new(text);
    if path.is_file() {
        let row = |row: &[f64]| match *row {
            [fault, factor] => Some((number_of(fault)?, factor, thickness)),
            [fault, factor, thickness] => Some((number_of(fault)?, factor, Some(thickness))),
            _ => None,
        };
        let remedy = "write surface,factor or surface,factor,thickness";
        let rows = rows(
            path,
            row,
            "a surface's number, its factor and perhaps its thickness",
            remedy,
        )?;
        let law = |(line, (fault, factor, thickness))| {
            Ok((
                format!("{text}:{line}"),
                fault,
                Faults::new(factor, thickness)?,
            ))
        };
        return rows.into_iter().map(law).collect();
    }
    let remedy = "give the number of a surface and its factor, such as 3:0.01, or a CSV file";
    let (fault, factor) = text
        .split_once(':')
        .ok_or_else(|| bad(option, text, "has no ':' and is not a file", remedy))?;
    let fault = number_of(number(option, fault, remedy)?).ok_or_else(|| {
        bad(
            option,
            text,
            "names no surface (numbers begin at 1)",
            remedy,
        )
    })?;
    let law = Faults::new(number(option, factor, remedy)?, thickness)?;
    Ok(vec![(format!("{option} {text}"), fault, law)])
}

/// Which surfaces are meant: `faults`, `horizons`, `all`, or their numbers.
pub fn standing(option: &str, text: &str) -> Result<Standing> {
    Ok(match text {
        "faults" => Standing::Faults,
        "horizons" => Standing::Horizons,
        "all" => Standing::All,
        text => {
            let numbers = text.split(',').map(|word| word.trim().parse());
            let numbers = numbers
                .collect::<std::result::Result<_, _>>()
                .map_err(|_| {
                    let remedy = "give faults, horizons, all, or numbers such as 1,4";
                    bad(option, text, "does not say which surfaces", remedy)
                })?;
            Standing::Numbered(numbers)
        }
    })
}

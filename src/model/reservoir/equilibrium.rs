//! Fluids in equilibrium at the start of a simulation: contacts, pressures and capillary pressure,
//! by region.

use std::fmt::{self, Display, Formatter};
use std::str::FromStr;

use super::{BAR, GRAVITY, SURFACE_PRESSURE, WATER_DENSITY};
use crate::error::cause;
use crate::option_text::serde_as_text;
use crate::option_text::{InvalidValue, parse_number};
use crate::{Error, Result};

/// Exponent of capillary pressure if none is given.
const DEFAULT_EXPONENT: f64 = 2.0;

/// A contact between two fluids.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ContactKind {
    /// Between oil and water.
    OilWater,
    /// Between gas and oil.
    GasOil,
}

/// A contact between two fluids and its depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactOption {
    /// The equilibration region; all regions if there is none.
    pub region: Option<u32>,
    /// The fluids.
    pub kind: ContactKind,
    /// Depth in metres.
    pub depth: f64,
    /// Capillary pressure at the contact in bar.
    pub capillary_pressure: f64,
}

/// A pressure at a depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DatumOption {
    /// The equilibration region; all regions if there is none.
    pub region: Option<u32>,
    /// Depth in metres.
    pub depth: f64,
    /// Pressure in bar.
    pub pressure: f64,
}

/// Capillary pressure between oil and water (Brooks and Corey 1964): `p = entry (Se)^(-1 /
/// exponent)`, where Se is the saturation of mobile water over the largest one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CapillaryOption {
    /// The number of the table; all tables if there is none.
    pub region: Option<u32>,
    /// Entry pressure in bar.
    pub entry: f64,
    /// Exponent (the index of the distribution of pore sizes).
    pub exponent: f64,
}

/// The fluids of one region in equilibrium.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Equilibrium {
    /// Depth in metres at which the pressure is given.
    pub datum: f64,
    /// Pressure in Pa.
    pub pressure: f64,
    /// Depth of the contact between oil and water in metres.
    pub oil_water: f64,
    /// Capillary pressure there in Pa.
    pub oil_water_capillary: f64,
    /// Depth of the contact between gas and oil in metres; 0 if there is no gas.
    pub gas_oil: f64,
    /// Capillary pressure there in Pa.
    pub gas_oil_capillary: f64,
}

/// Splits `REGION/` from the start of a value.
fn split_region<'a>(
    text: &'a str,
    remedy: &str,
) -> std::result::Result<(Option<u32>, &'a str), InvalidValue> {
    let Some((region, rest)) = text.split_once('/') else {
        return Ok((None, text));
    };
    match region.trim().parse() {
        Ok(region) if region > 0 => Ok((Some(region), rest)),
        _ => Err(InvalidValue::new(
            "has no number of a region before /",
            remedy,
        )),
    }
}

fn write_region(f: &mut Formatter<'_>, region: Option<u32>) -> fmt::Result {
    region.map_or(Ok(()), |region| write!(f, "{region}/"))
}

impl FromStr for ContactOption {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let remedy = "give oil-water=DEPTH or gas-oil=DEPTH, such as oil-water=2450";
        let (region, rest) = split_region(text, remedy)?;
        let (name, value) = rest
            .split_once('=')
            .ok_or_else(|| InvalidValue::new("has no '='", remedy))?;
        let kind = match name {
            "oil-water" => ContactKind::OilWater,
            "gas-oil" => ContactKind::GasOil,
            _ => return Err(InvalidValue::new("is not a known contact", remedy)),
        };
        let (depth, capillary) = value.split_once(':').unwrap_or((value, "0"));
        Ok(Self {
            region,
            kind,
            depth: parse_number(depth, remedy)?,
            capillary_pressure: parse_number(capillary, remedy)?,
        })
    }
}

impl Display for ContactOption {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write_region(f, self.region)?;
        let name = match self.kind {
            ContactKind::OilWater => "oil-water",
            ContactKind::GasOil => "gas-oil",
        };
        write!(f, "{name}={}", self.depth)?;
        if self.capillary_pressure != 0.0 {
            write!(f, ":{}", self.capillary_pressure)?;
        }
        Ok(())
    }
}

impl FromStr for DatumOption {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let remedy = "give a depth in metres and a pressure in bar, such as 2450:245";
        let (region, rest) = split_region(text, remedy)?;
        let (depth, pressure) = rest
            .split_once(':')
            .ok_or_else(|| InvalidValue::new("has no ':'", remedy))?;
        let pressure = parse_number(pressure, remedy)?;
        if pressure <= 0.0 {
            return Err(InvalidValue::new("has no positive pressure", remedy));
        }
        Ok(Self {
            region,
            depth: parse_number(depth, remedy)?,
            pressure,
        })
    }
}

impl Display for DatumOption {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write_region(f, self.region)?;
        write!(f, "{}:{}", self.depth, self.pressure)
    }
}

impl FromStr for CapillaryOption {
    type Err = InvalidValue;

    fn from_str(text: &str) -> std::result::Result<Self, InvalidValue> {
        let remedy = "give the entry pressure in bar, and perhaps an exponent: 0.2 or 0.2:2";
        let (region, rest) = split_region(text, remedy)?;
        let (entry, exponent) = match rest.split_once(':') {
            Some((entry, exponent)) => (entry, parse_number(exponent, remedy)?),
            None => (rest, DEFAULT_EXPONENT),
        };
        let entry = parse_number(entry, remedy)?;
        if entry <= 0.0 || exponent <= 0.0 {
            return Err(InvalidValue::new("is not positive", remedy));
        }
        Ok(Self {
            region,
            entry,
            exponent,
        })
    }
}

impl Display for CapillaryOption {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write_region(f, self.region)?;
        write!(f, "{}:{}", self.entry, self.exponent)
    }
}

serde_as_text!(
    ContactOption: ["="; 2],
    DatumOption: [":"; 2],
    CapillaryOption: [":"; 2],
);

/// Returns the last value for a region: one for this region comes before those for all.
fn last_for<T: Copy>(
    values: &[T],
    region_of: impl Fn(&T) -> Option<u32>,
    region: u32,
) -> Option<T> {
    let last = |wanted| {
        values
            .iter()
            .rev()
            .find(|v| region_of(v) == wanted)
            .copied()
    };
    last(Some(region)).or_else(|| last(None))
}

impl CapillaryOption {
    /// Returns the curve of a table.
    pub fn for_table(options: &[Self], table: u32) -> Option<Self> {
        last_for(options, |option| option.region, table)
    }

    /// Returns the capillary pressure in bar at a saturation of mobile water over the largest one.
    pub fn pressure(&self, saturation: f64) -> f64 {
        self.entry * saturation.powf(-1.0 / self.exponent)
    }
}

/// Returns the equilibrium of regions 1 to `count`. Where no pressure is given, it is that of a column of
/// water at the contact.
///
/// # Errors
/// Returns [`Error::Job`] for a region without a contact between oil and water, for contacts in the wrong
/// order, or for a region that no cell has.
pub fn equilibria(
    contacts: &[ContactOption],
    datums: &[DatumOption],
    count: usize,
) -> Result<Vec<Equilibrium>> {
    let regions = (contacts.iter()).filter_map(|c| Some(("contact", c.to_string(), c.region?)));
    let of_datums = (datums.iter()).filter_map(|d| Some(("datum", d.to_string(), d.region?)));
    for (option, text, region) in regions.chain(of_datums) {
        if region as usize > count {
            let problem =
                format!("is for equilibration region {region}, but the last one is {count}");
            let remedy = "give a region that cells have (eqlnum), or omit it";
            return Err(Error::Job(cause(
                format!("{option} {text}"),
                problem,
                remedy,
            )));
        }
    }
    let of_kind = |kind: ContactKind, region: u32| {
        let of_kind: Vec<ContactOption> = (contacts.iter())
            .filter(|c| c.kind == kind)
            .copied()
            .collect();
        last_for(&of_kind, |contact| contact.region, region)
    };
    let equilibrium = |region: u32| {
        let Some(oil_water) = of_kind(ContactKind::OilWater, region) else {
            let problem = format!("gives none between oil and water for region {region}");
            let remedy = "give oil-water=DEPTH; it may lie below the cells";
            return Err(Error::Job(cause("contact", problem, remedy)));
        };
        let gas_oil = of_kind(ContactKind::GasOil, region);
        if let Some(gas_oil) = gas_oil.filter(|contact| contact.depth > oil_water.depth) {
            let problem = format!(
                "lies below that between oil and water, {} m",
                oil_water.depth
            );
            let remedy = "give a smaller depth";
            return Err(Error::Job(cause(
                format!("contact {gas_oil}"),
                problem,
                remedy,
            )));
        }
        let given = last_for(datums, |datum| datum.region, region);
        let hydrostatic = SURFACE_PRESSURE + WATER_DENSITY * GRAVITY * oil_water.depth;
        let (datum, pressure) = given.map_or((oil_water.depth, hydrostatic), |datum| {
            (datum.depth, datum.pressure * BAR)
        });
        Ok(Equilibrium {
            datum,
            pressure,
            oil_water: oil_water.depth,
            oil_water_capillary: oil_water.capillary_pressure * BAR,
            gas_oil: gas_oil.map_or(0.0, |contact| contact.depth),
            gas_oil_capillary: gas_oil.map_or(0.0, |contact| contact.capillary_pressure * BAR),
        })
    };
    (1..=count as u32).map(equilibrium).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contacts_are_read_and_regions_have_their_own() {
        let contact = |text: &str| text.parse::<ContactOption>().unwrap();
        let contacts = ["oil-water=2450:0.1", "2/oil-water=2500", "gas-oil=2300"].map(contact);
        assert_eq!(contacts.map(|c| c.to_string())[1], "2/oil-water=2500");
        let datums = ["1/2400:250".parse::<DatumOption>().unwrap()];
        let both = equilibria(&contacts, &datums, 2).unwrap();
        assert_eq!((both[0].oil_water, both[1].oil_water), (2450.0, 2500.0));
        assert_eq!(
            (both[0].oil_water_capillary, both[1].oil_water_capillary),
            (1e4, 0.0)
        );
        assert_eq!((both[0].datum, both[0].pressure), (2400.0, 250.0 * BAR));
        let hydrostatic = SURFACE_PRESSURE + 1000.0 * GRAVITY * 2500.0;
        assert_eq!((both[1].datum, both[1].pressure), (2500.0, hydrostatic));
        assert_eq!(both[1].gas_oil, 2300.0);
        let error = |contacts: &[ContactOption], count| {
            equilibria(contacts, &[], count).unwrap_err().to_string()
        };
        assert!(error(&contacts, 1).contains("is for equilibration region 2"));
        assert!(error(&contacts[1..2], 2).contains("between oil and water for region 1"));
        let crossed = ["oil-water=2000", "gas-oil=2300"].map(contact);
        assert!(error(&crossed, 1).contains("lies below"));
        for text in ["2450", "water=3", "0/oil-water=3", "oil-water=x"] {
            assert!(text.parse::<ContactOption>().is_err(), "{text}");
        }
    }

    #[test]
    fn capillary_pressure_is_that_of_brooks_and_corey() {
        let curve: CapillaryOption = "3/0.2:2".parse().unwrap();
        assert_eq!(curve.pressure(1.0), 0.2);
        assert!((curve.pressure(0.25) - 0.4).abs() < 1e-12);
        assert_eq!(CapillaryOption::for_table(&[curve], 3), Some(curve));
        assert_eq!(CapillaryOption::for_table(&[curve], 1), None);
        assert!("-1".parse::<CapillaryOption>().is_err());
    }
}

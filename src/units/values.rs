//! Units of the quantities in tables of values: pressures, rates, permeabilities, fractions.

use super::{Quantity, find};

/// Cubic metres in a barrel.
const BARREL: f64 = 0.158_987_294_928;

/// Cubic metres in a cubic foot.
const CUBIC_FOOT: f64 = 0.028_316_846_592;

/// Bar in a pound per square inch.
const PSI: f64 = 0.068_947_572_931_683_6;

/// Square metres in a darcy.
const DARCY: f64 = 9.869_232_667_160_13e-13;

/// One millidarcy in m^2.
pub const MILLIDARCY: f64 = 9.869_232_667_160_13e-16;

/// Units of a quantity: the size of each, and its names in the form of [`plain_unit`].
type UnitNames = &'static [(f64, &'static [&'static str])];

const PRESSURE_UNITS: UnitNames = &[
    (1.0, &["bar", "bars", "bara"]),
    (PSI, &["psi", "psia"]),
    (1e-2, &["kpa"]),
    (10.0, &["mpa"]),
    (1e-5, &["pa"]),
    (1.013_25, &["atm"]),
];

const LIQUID_RATE_UNITS: UnitNames = &[
    (1.0, &["m3/d", "sm3/d", "rm3/d"]),
    (24.0, &["m3/h"]),
    (86_400.0, &["m3/s"]),
    (BARREL, &["stb/d", "bbl/d", "rb/d", "bpd", "bopd", "bwpd"]),
];

const GAS_RATE_UNITS: UnitNames = &[
    (1.0, &["m3/d", "sm3/d"]),
    (CUBIC_FOOT, &["scf/d", "cf/d", "ft3/d"]),
    (1e3 * CUBIC_FOOT, &["mscf/d", "mcf/d"]),
    (1e6 * CUBIC_FOOT, &["mmscf/d", "mmcf/d"]),
];

const PERMEABILITY_UNITS: UnitNames = &[
    (1.0, &["m2"]),
    (1e-12, &["um2", "\u{b5}m2", "\u{3bc}m2"]),
    (MILLIDARCY, &["md", "millidarcy", "millidarcies"]),
    (DARCY, &["d", "darcy", "darcies"]),
];

const FRACTION_UNITS: UnitNames = &[
    (0.01, &["%", "percent", "pct"]),
    (
        1.0,
        &[
            "-", "1", "fraction", "frac", "v/v", "m3/m3", "dec", "decimal",
        ],
    ),
];

/// A quantity whose unit may stand in the name of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ValueMeasure {
    /// A length, in metres.
    Length,
    /// A pressure, in bar.
    Pressure,
    /// A rate of a liquid, in m^3/day.
    LiquidRate,
    /// A rate of gas, in m^3/day at the surface.
    GasRate,
    /// A permeability, in m^2.
    Permeability,
    /// A fraction, from 0 to 1.
    Fraction,
}

impl ValueMeasure {
    /// Returns the name of the quantity, and units that are known, for messages.
    pub fn texts(self) -> [&'static str; 2] {
        match self {
            Self::Length => ["length", "m, km, cm, mm, ft, in"],
            Self::Pressure => ["pressure", "bar, psi, kPa, MPa, Pa, atm"],
            Self::LiquidRate => ["liquid rate", "m3/day, sm3/day, STB/day, bbl/day"],
            Self::GasRate => ["gas rate", "m3/day, sm3/day, scf/day, Mscf/day, MMscf/day"],
            Self::Permeability => ["permeability", "mD, D, m2"],
            Self::Fraction => ["fraction", "%, fraction, v/v, -"],
        }
    }

    /// Returns the factor that converts values in a unit; `None` if it is not a unit of this quantity.
    pub fn factor(self, unit: &str) -> Option<f64> {
        let known = match self {
            Self::Length => {
                let unit = find(unit)?;
                return (unit.quantity == Quantity::Length).then_some(unit.size);
            }
            Self::Pressure => PRESSURE_UNITS,
            Self::LiquidRate => LIQUID_RATE_UNITS,
            Self::GasRate => GAS_RATE_UNITS,
            Self::Permeability => PERMEABILITY_UNITS,
            Self::Fraction => FRACTION_UNITS,
        };
        let plain = plain_unit(unit);
        let entry = known.iter().find(|(_, names)| names.contains(&&*plain));
        entry.map(|(factor, _)| *factor)
    }
}

/// Returns the name of a unit in lower case, without blanks, with powers as digits, and with `/d` for
/// per day.
fn plain_unit(unit: &str) -> String {
    let is_kept = |c: &char| !c.is_whitespace() && !"^.*\"'".contains(*c);
    let plain: String = unit.chars().filter(is_kept).collect();
    let plain = plain.to_lowercase();
    let plain = plain.replace('\u{b3}', "3").replace('\u{b2}', "2");
    let volume = plain
        .strip_suffix("/day")
        .or_else(|| plain.strip_suffix("perday"));
    match volume {
        Some(volume) => format!("{volume}/d"),
        None => plain,
    }
}

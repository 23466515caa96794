//! Units of length and time: the names by which files and users call them, and their sizes.
//!
//! - `values`: pressures, rates, permeabilities and fractions in tables of values
//!
//! This is the only place that knows names of units. A name is compared without regard to case,
//! spaces, quotes and brackets, so that `ft`, `"FT"`, `[feet]` and `Foot` are one unit.

pub mod values;

/// The quantity that a unit measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// A length; [`Unit::size`] is in metres.
    Length,
    /// A time; [`Unit::size`] is in seconds.
    Time,
}

/// A unit of length or time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit {
    /// Its short name, as atomesh writes it.
    pub symbol: &'static str,
    /// The quantity that it measures.
    pub quantity: Quantity,
    /// Metres or seconds in one unit.
    pub size: f64,
}

/// All units, each with the names by which it is known, in lower case. The first name is the symbol.
const UNITS: [(Quantity, f64, &[&str]); 14] = {
    use Quantity::{Length, Time};
    [
        (
            Length,
            1.0,
            &["m", "meter", "meters", "metre", "metres", "mtr"],
        ),
        (
            Length,
            1e3,
            &["km", "kilometer", "kilometers", "kilometre", "kilometres"],
        ),
        (
            Length,
            1e-2,
            &[
                "cm",
                "centimeter",
                "centimeters",
                "centimetre",
                "centimetres",
            ],
        ),
        (
            Length,
            1e-3,
            &[
                "mm",
                "millimeter",
                "millimeters",
                "millimetre",
                "millimetres",
            ],
        ),
        (
            Length,
            1e-6,
            &[
                "um",
                "\u{b5}m",
                "\u{3bc}m",
                "\\u00b5m",
                "micron",
                "microns",
                "micrometer",
                "micrometers",
                "micrometre",
                "micrometres",
            ],
        ),
        (
            Length,
            1e-9,
            &["nm", "nanometer", "nanometers", "nanometre", "nanometres"],
        ),
        (
            Length,
            1e-10,
            &["angstrom", "angstroms", "\u{e5}", "\u{e5}ngstr\u{f6}m"],
        ),
        (Length, 0.0254, &["in", "inch", "inches"]),
        (
            Length,
            0.3048,
            &["ft", "foot", "feet", "f", "ift", "international foot"],
        ),
        (
            Length,
            1200.0 / 3937.0,
            &[
                "ftus",
                "usft",
                "us-ft",
                "ft_us",
                "us ft",
                "ft us",
                "us foot",
                "us feet",
                "us survey foot",
                "us survey feet",
            ],
        ),
        (Time, 1.0, &["s", "sec", "secs", "second", "seconds"]),
        (
            Time,
            1e-3,
            &["ms", "msec", "msecs", "millisecond", "milliseconds"],
        ),
        (
            Time,
            1e-6,
            &[
                "us",
                "\u{b5}s",
                "\u{3bc}s",
                "usec",
                "microsecond",
                "microseconds",
            ],
        ),
        (Time, 1e-9, &["ns", "nsec", "nanosecond", "nanoseconds"]),
    ]
};

/// Returns the unit of this name; `None` if it is not one that is known.
pub fn find(name: &str) -> Option<Unit> {
    let is_mark = |c: char| c.is_whitespace() || "\"'()[]{}".contains(c);
    let name = name.trim_matches(is_mark).to_lowercase();
    let (quantity, size, names) = UNITS.iter().find(|(_, _, names)| names.contains(&&*name))?;
    Some(Unit {
        symbol: names[0],
        quantity: *quantity,
        size: *size,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_found_by_all_its_names() {
        for (name, symbol) in [
            ("M", "m"),
            ("\"ft\"", "ft"),
            ("[Feet]", "ft"),
            (" ms ", "ms"),
            ("\u{b5}m", "um"),
            ("US survey foot", "ftus"),
            ("Inch", "in"),
        ] {
            assert_eq!(find(name).unwrap().symbol, symbol, "{name}");
        }
        for name in ["", "unitless", "none", "1", "furlong"] {
            assert_eq!(find(name), None, "{name}");
        }
    }

    #[test]
    fn no_name_has_two_units() {
        let all: Vec<&str> = UNITS.iter().flat_map(|unit| unit.2).copied().collect();
        for (i, name) in all.iter().enumerate() {
            assert!(!all[..i].contains(name), "{name}");
            assert_eq!(name.to_lowercase(), *name);
        }
    }
}

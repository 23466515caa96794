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

/// Splits a number from the unit of length behind it, as in `3mm`, `1e-3 m` or `40 ft`. The unit is `None` for
/// a number alone.
///
/// # Errors
/// Returns the problem if the text begins with no finite number, or if no unit of length follows.
pub fn split_length(text: &str) -> Result<(f64, Option<Unit>), String> {
    let text = text.trim();
    let ends = (text.char_indices().map(|(i, c)| i + c.len_utf8())).rev();
    let number = |end: usize| text[..end].trim_end().parse::<f64>().ok();
    let Some((value, end)) = ends.filter_map(|end| Some((number(end)?, end))).next() else {
        return Err("is not a finite number".into());
    };
    if !value.is_finite() {
        return Err("is not a finite number".into());
    }
    match text[end..].trim() {
        "" => Ok((value, None)),
        name if !name.starts_with(char::is_alphabetic) => Err("is not a finite number".into()),
        name => match find(name) {
            Some(unit) if unit.quantity == Quantity::Length => Ok((value, Some(unit))),
            Some(unit) => Err(format!("has the unit {}, which is no length", unit.symbol)),
            None => Err(format!("has the unit '{name}', which is not known")),
        },
    }
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
    fn lengths_have_a_number_and_perhaps_a_unit() {
        for (text, value, symbol) in [
            ("8", 8.0, None),
            (" 2.5 ", 2.5, None),
            ("3mm", 3.0, Some("mm")),
            ("3 mm", 3.0, Some("mm")),
            ("1e-3m", 1e-3, Some("m")),
            ("2e3nm", 2e3, Some("nm")),
            ("0.5in", 0.5, Some("in")),
            ("40ft", 40.0, Some("ft")),
            ("7\u{b5}m", 7.0, Some("um")),
            ("1.5 km", 1.5, Some("km")),
        ] {
            let (number, unit) = split_length(text).unwrap();
            assert_eq!(
                (number, unit.map(|unit| unit.symbol)),
                (value, symbol),
                "{text}"
            );
        }
        for text in ["", "mm", "inf", "3 ms", "3 furlong", "3mm4", "nan m"] {
            assert!(split_length(text).is_err(), "{text}");
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

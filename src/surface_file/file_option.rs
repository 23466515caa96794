//! Files of positions as values of options: surfaces, wells, atoms, horizons.
//!
//! `FILE[:NAME][,fault|horizon][,unit=ft][,z=down][,domain=time][,null=-999][,columns=x,y,_,z]`.
//! The parts after the file say what the file itself does not say.

use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::image::stated::{CoordinateOptions, Domain, ZDirection};
use crate::option_text::{InvalidValue, joined, serde_as_text};
use crate::units;

/// Remedy for a value that is not understood.
const REMEDY: &str = "give FILE or FILE:NAME, and after it what the file does not say: ,fault or ,horizon, \
                      ,unit=ft (of z) or ,unit=m,m,ft, ,z=up or ,z=down, ,domain=time or ,domain=depth, \
                      ,null=-999 or ,null=none, ,columns=x,y,_,z";

/// Names of what may follow a file, each with `=` and a value.
const KEYS: [&str; 6] = ["unit", "z", "domain", "null", "columns", "head"];

/// A file of positions, with the name of one of its parts, and statements about its coordinates.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FileOption {
    /// The file.
    pub path: PathBuf,
    /// The one of the file's parts that is meant, or the name of the only one.
    pub name: Option<String>,
    /// `true` for horizons and `false` for faults; `None` if the file or the dip decides.
    pub is_horizon: Option<bool>,
    /// The statements of the option about the coordinates.
    pub coordinates: CoordinateOptions,
}

impl FileOption {
    /// Returns the option of a file about which nothing is said.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self {
            path: path.into(),
            ..Self::default()
        }
    }

    /// Takes the parts after the file from `text`, `,` first. Returns `None` if they are none.
    fn with_parts(text: &str) -> Option<Result<Self, InvalidValue>> {
        let mut option = Self::default();
        let mut head = Vec::new();
        // The key of the last value, to which further items of a list belong.
        let mut key = "";
        for part in text.split(',').skip(1) {
            let part = part.trim();
            match part.split_once('=') {
                None if part == "fault" || part == "horizon" => {
                    option.is_horizon = Some(part == "horizon");
                }
                Some(("head", value)) => {
                    key = "head";
                    head.push(value);
                }
                None if key == "head" => head.push(part),
                Some((name, value)) if KEYS.contains(&name) => {
                    key = name;
                    if let Err(error) = option.coordinates.set(name, value) {
                        return Some(Err(error));
                    }
                }
                None if ["unit", "null", "columns"].contains(&key) => {
                    if let Err(error) = option.coordinates.set(key, part) {
                        return Some(Err(error));
                    }
                }
                _ => return None,
            }
        }
        if !head.is_empty() {
            let numbers: Option<Vec<f64>> = head.iter().map(|n| n.trim().parse().ok()).collect();
            option.coordinates.head = numbers.and_then(|numbers| numbers.try_into().ok());
            if option.coordinates.head.is_none() {
                let problem = format!("has the unknown value head={}", head.join(","));
                let remedy = "give x, y and the height of the wellhead: head=450000,6780000,25";
                return Some(Err(InvalidValue::new(problem, remedy)));
            }
        }
        Some(option.checked())
    }

    fn checked(self) -> Result<Self, InvalidValue> {
        match self.coordinates.units.len() {
            0 | 1 | 3 => Ok(self),
            count => Err(InvalidValue::new(
                format!("has {count} units"),
                "give the unit of z, such as unit=ft, or those of x, y and z, such as unit=m,m,ft",
            )),
        }
    }
}

impl CoordinateOptions {
    /// Sets a value, or adds an item to a list.
    fn set(&mut self, key: &str, value: &str) -> Result<(), InvalidValue> {
        let unknown = |remedy: &str| {
            let problem = format!("has the unknown value {key}={value}");
            Err(InvalidValue::new(problem, remedy))
        };
        match (key, value) {
            ("unit", name) => match units::find(name) {
                Some(unit) => self.units.push(unit.symbol.to_string()),
                None => return unknown("give a unit of length or time, such as m, ft, ms or s"),
            },
            ("z", "up") => self.z_direction = Some(ZDirection::Up),
            ("z", "down") => self.z_direction = Some(ZDirection::Down),
            ("z", _) => return unknown("give z=up for heights or z=down for depths and times"),
            ("domain", "time") => self.domain = Some(Domain::Time),
            ("domain", "depth") => self.domain = Some(Domain::Depth),
            ("domain", _) => return unknown("give domain=time or domain=depth"),
            ("null", "none") => self.nulls = Some(Vec::new()),
            ("null", number) => match number.trim().parse() {
                Ok(null) => self.nulls.get_or_insert_default().push(null),
                Err(_) => return unknown("give numbers, such as null=-999,0, or null=none"),
            },
            (_, column) => self.columns.push(column.to_string()),
        }
        Ok(())
    }
}

impl FromStr for FileOption {
    type Err = InvalidValue;

    fn from_str(text: &str) -> Result<Self, InvalidValue> {
        // A file whose name has commas is taken whole.
        let commas = text.match_indices(',').map(|(at, _)| at);
        let parsed = commas
            .filter(|_| !Path::new(text).is_file())
            .find_map(|at| Some((&text[..at], Self::with_parts(&text[at..])?)));
        let (rest, option) = match parsed {
            Some((rest, option)) => (rest, option?),
            None => (text, Self::default()),
        };
        if ends_with_unknown_part(rest) {
            let part = rest.rsplit(',').next().unwrap_or_default();
            return Err(InvalidValue::new(
                format!("has the unknown part {part}"),
                REMEDY,
            ));
        }
        // A colon after one letter, or before a separator, is part of a path.
        let split = rest.rsplit_once(':').filter(|(path, name)| {
            path.len() > 1 && !name.contains(['/', '\\']) && !Path::new(rest).is_file()
        });
        let (path, name) = split.map_or((rest, None), |(path, name)| (path, Some(name)));
        if path.is_empty() || name.is_some_and(|name| name.trim().is_empty()) {
            return Err(InvalidValue::new("names no file or no surface", REMEDY));
        }
        Ok(Self {
            path: path.into(),
            name: name.map(|name| name.trim().to_string()),
            ..option
        })
    }
}

/// Returns `true` if a path ends with what looks like a misspelt part of an option.
fn ends_with_unknown_part(path: &str) -> bool {
    let last = path.rsplit_once(',').map(|(_, last)| last);
    let key = last.and_then(|last| last.split_once('='));
    key.is_some_and(|(key, _)| key.bytes().all(|b| b.is_ascii_lowercase() || b == b'-'))
        && !Path::new(path).is_file()
}

impl Display for FileOption {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.path.display())?;
        if let Some(name) = &self.name {
            write!(f, ":{name}")?;
        }
        match self.is_horizon {
            Some(true) => f.write_str(",horizon")?,
            Some(false) => f.write_str(",fault")?,
            None => {}
        }
        let CoordinateOptions {
            units,
            z_direction,
            domain,
            nulls,
            columns,
            head,
        } = &self.coordinates;
        if !units.is_empty() {
            write!(f, ",unit={}", units.join(","))?;
        }
        if let Some(direction) = z_direction {
            write!(f, ",z={direction}")?;
        }
        if let Some(domain) = domain {
            write!(f, ",domain={domain}")?;
        }
        match nulls.as_deref() {
            Some([]) => f.write_str(",null=none")?,
            Some(nulls) => write!(f, ",null={}", joined(nulls))?,
            None => {}
        }
        if !columns.is_empty() {
            write!(f, ",columns={}", columns.join(","))?;
        }
        if let Some(head) = head {
            write!(f, ",head={}", joined(head))?;
        }
        Ok(())
    }
}

serde_as_text!(FileOption: [":"; 2]);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_after_a_file_are_read_and_shown_again() {
        for text in [
            "top.ts",
            "top.ts:Top,horizon",
            r"C:\picks\top.ts",
            r"C:\picks\top.ts:Top,fault,unit=ft,z=down",
            "a,b.ts:x,unit=m,m,ft,domain=depth",
            "p.csv,null=-999,0,columns=x,y,_,z",
            "p.csv,z=up,null=none",
            "w.dev:A-1,head=450000,6780000.5,25",
        ] {
            let option: FileOption = text.parse().unwrap();
            assert_eq!(option.to_string(), text);
        }
        let option: FileOption = "p.csv:Top A,columns=x,y,_,z,fault,unit=feet"
            .parse()
            .unwrap();
        assert_eq!(option.path, Path::new("p.csv"));
        assert_eq!(option.name.as_deref(), Some("Top A"));
        assert_eq!(option.is_horizon, Some(false));
        assert_eq!(option.coordinates.columns, ["x", "y", "_", "z"]);
        assert_eq!(option.coordinates.unit(2), Some("ft"));
        assert_eq!(option.coordinates.unit(0), None);
    }

    #[test]
    fn parts_that_are_not_understood_are_named() {
        for (text, expected) in [
            (",fault", "names no file"),
            ("a.ts:", "names no file or no surface"),
            ("a.ts,unit=furlong", "has the unknown value unit=furlong"),
            ("a.ts,unit=m,ft", "has 2 units"),
            ("a.ts,z=left", "has the unknown value z=left"),
            ("a.ts,null=x", "has the unknown value null=x"),
            ("a.ts,domain=z", "has the unknown value domain=z"),
            ("a.dev,head=1,2", "has the unknown value head=1,2"),
            ("a.ts,unti=ft", "has the unknown part unti=ft"),
        ] {
            let error = text.parse::<FileOption>().unwrap_err().to_string();
            assert!(error.starts_with(expected), "{text}: {error}");
        }
    }
}

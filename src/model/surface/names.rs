//! The names of a mesh's surfaces, and selectors of surfaces by name or number.

use super::SurfaceKind;
use crate::error::cause;
pub use crate::mesh_file::named_regions::interface_name;
use crate::names::{NameRules, WantedName, assign};
use crate::{Error, Result};

/// Largest number of names that an error lists.
const MAX_LISTED_NAMES: usize = 20;
/// Problem and remedy of the error for a selector that selects nothing.
pub(crate) const NO_MATCH_PROBLEM: &str = "matches no surface";
pub(crate) const NO_MATCH_REMEDY: &str =
    "give one of these names, a number that `atomesh surface` prints, or faults, horizons or all";

/// The names of the surfaces of a mesh, from surface 1 on, as all formats use them.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SurfaceNames {
    /// The names of the surfaces that are large enough to have one.
    pub names: Vec<String>,
    /// The kinds of all surfaces, also of those without a name.
    pub kinds: Vec<SurfaceKind>,
}

impl SurfaceNames {
    /// Makes names for surfaces with these kinds. The first `kept_count` surfaces are large enough
    /// to have names. `file_names` are the names of the first surfaces in the mesh's file. No
    /// surface gets a name in `reserved`.
    pub fn new(
        kinds: &[SurfaceKind],
        kept_count: usize,
        file_names: &[String],
        reserved: &[String],
    ) -> Self {
        let kept_surfaces = (1..).zip(&kinds[..kept_count.min(kinds.len())]);
        let surface_names = kept_surfaces.map(|(number, kind): (usize, &SurfaceKind)| {
            let default = || format!("{}{number}", kind.name());
            WantedName::given_or(file_names.get(number - 1).map(String::as_str), default)
        });
        let reserved_names = reserved.iter().map(WantedName::program);
        let wanted: Vec<WantedName> = reserved_names.chain(surface_names).collect();
        let mut names = assign(&NameRules::TEXT, &wanted);
        Self {
            names: names.split_off(reserved.len()),
            kinds: kinds.to_vec(),
        }
    }

    /// Returns the names as text for an error.
    fn list_names(&self) -> String {
        let first = self.names.iter().take(MAX_LISTED_NAMES);
        let first: Vec<&str> = first.map(String::as_str).collect();
        match self.names.len() {
            0 => "the mesh has no surfaces".into(),
            count if count > MAX_LISTED_NAMES => {
                format!(
                    "the mesh has {} and {} more",
                    first.join(", "),
                    count - MAX_LISTED_NAMES
                )
            }
            _ => format!("the mesh has {}", first.join(", ")),
        }
    }

    /// Returns an error for an option whose value matches no surface.
    pub fn no_match_error(
        &self,
        place: impl std::fmt::Display,
        problem: &str,
        remedy: &str,
    ) -> Error {
        let remedy = if self.names.is_empty() {
            "omit it, or give a mesh with features"
        } else {
            remedy
        };
        Error::Flow(cause(
            place,
            format!("{problem}: {}", self.list_names()),
            remedy,
        ))
    }

    /// Checks that a selector from an option selects at least one surface.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] with the names of the surfaces if it selects none.
    pub fn check(&self, option: &str, selector: &Selector) -> Result<()> {
        if (0..self.kinds.len()).any(|index| selector.selects(self, index)) {
            return Ok(());
        }
        Err(self.no_match_error(
            format!("{option} {selector}"),
            NO_MATCH_PROBLEM,
            NO_MATCH_REMEDY,
        ))
    }
}

/// Selects surfaces by number or name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Selector {
    /// The surface with this number, from 1.
    Number(u32),
    /// Surfaces whose names match a pattern, in which `*` stands for any characters and `?` for one
    /// character. `A/B` stands for `interface_A_B` and `interface_B_A`. `scraps` selects all
    /// fragments that are too small to have a name.
    Name(String),
}

impl std::fmt::Display for Selector {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(number) => number.fmt(f),
            Self::Name(name) => name.fmt(f),
        }
    }
}

impl From<u32> for Selector {
    fn from(number: u32) -> Self {
        Self::Number(number)
    }
}

impl Selector {
    /// Parses a number or a pattern. Returns `None` for an empty text.
    pub fn parse(text: &str) -> Option<Self> {
        let text = text.trim();
        match text.parse() {
            Ok(number) => Some(Self::Number(number)),
            Err(_) => (!text.is_empty()).then(|| Self::Name(text.into())),
        }
    }

    /// Returns `true` if it selects the surface at this index in `surfaces`.
    pub fn selects(&self, surfaces: &SurfaceNames, index: usize) -> bool {
        match (self, surfaces.names.get(index)) {
            (Self::Number(number), Some(_)) => *number as usize == index + 1,
            (Self::Number(_), None) => false,
            (Self::Name(_), Some(name)) => self.matches(name),
            (Self::Name(pattern), None) => pattern == "scraps",
        }
    }

    /// Returns `true` if it is a pattern that matches a name.
    pub fn matches(&self, name: &str) -> bool {
        let Self::Name(pattern) = self else {
            return false;
        };
        let is_interface = |(a, b)| {
            let mut names = [[a, b], [b, a]].into_iter().map(interface_name);
            names.any(|pattern| matches_glob(&pattern, name))
        };
        matches_glob(pattern, name) || pattern.split_once('/').is_some_and(is_interface)
    }
}

/// Returns `true` if a pattern with `*` and `?` matches the whole text.
fn matches_glob(pattern: &str, text: &str) -> bool {
    let (pattern, text): (Vec<char>, Vec<char>) =
        (pattern.chars().collect(), text.chars().collect());
    // Positions in pattern and text; the position of the last star and the end of the characters
    // that it stands for.
    let (mut p, mut t, mut star) = (0, 0, None);
    while t < text.len() {
        if pattern.get(p) == Some(&'*') {
            star = Some((p, t));
            p += 1;
        } else if pattern.get(p).is_some_and(|c| *c == '?' || *c == text[t]) {
            (p, t) = (p + 1, t + 1);
        } else if let Some((star_index, reached)) = star {
            star = Some((star_index, reached + 1));
            (p, t) = (star_index + 1, reached + 1);
        } else {
            return false;
        }
    }
    pattern[p..].iter().all(|c| *c == '*')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_match_whole_names() {
        for (pattern, name, expected) in [
            ("fault1", "fault1", true),
            ("fault1", "fault12", false),
            ("fault*", "fault12", true),
            ("fault?", "fault12", false),
            ("*_1?", "interface_1_10", true),
            ("*_1?", "interface_1_1", false),
            ("i*_1*_2", "interface_1_1_2", true),
            ("*", "", true),
            ("1/11", "interface_1_11", true),
            ("11/1", "interface_1_11", true),
            ("?/1?", "interface_3_12", true),
            ("?/1?", "interface_0_1", false),
            ("-3/4", "interface_-3_4", true),
            ("Main-fault", "Main-fault", true),
            ("Main-fault", "Main_fault", false),
            ("A/B", "A/B", true),
        ] {
            let selector = Selector::Name(pattern.into());
            assert_eq!(selector.matches(name), expected, "{pattern} {name}");
        }
    }

    #[test]
    fn a_selector_without_a_match_is_an_error_that_lists_the_names() {
        let kinds = [
            SurfaceKind::Interface,
            SurfaceKind::Fault,
            SurfaceKind::Horizon,
            SurfaceKind::Fault,
        ];
        let file_names = ["interface_1_2".to_string()];
        let names = SurfaceNames::new(&kinds, 3, &file_names, &["fault2".into()]);
        assert_eq!(names.names, ["interface_1_2", "fault2_2", "horizon3"]);
        let parse = |text| Selector::parse(text).unwrap();
        for text in ["1", "3", "2/1", "hor*", "scraps"] {
            names.check("--split", &parse(text)).unwrap();
        }
        for text in ["0", "4", "99", "horizon", "1/3"] {
            let error = names
                .check("--split", &parse(text))
                .unwrap_err()
                .to_string();
            let expected = format!(
                "--split {text}: matches no surface: the mesh has interface_1_2, fault2_2, horizon3; "
            );
            assert!(error.starts_with(&expected), "{error}");
        }
        assert_eq!(Selector::parse(" "), None);
    }
}

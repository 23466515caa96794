//! The names of the surfaces of a mesh, and patterns that pick some of them.

use std::collections::BTreeSet;

use super::SurfaceKind;
use crate::error::cause;
use crate::{Error, Result};

/// Errors list so many names.
const MAX_LISTED_NAMES: usize = 20;
/// What is wrong with a selector that picks nothing, and what helps.
pub(crate) const NO_MATCH_PROBLEM: &str = "matches no surface";
pub(crate) const NO_MATCH_REMEDY: &str =
    "give one of these names, a number that `atomesh surface` prints, or faults, horizons or all";

/// The name of what parts two regions, from the names or numbers of these.
pub fn interface_name([a, b]: [&str; 2]) -> String {
    format!("interface_{a}_{b}").replace('-', "_")
}

/// Adds names to others. A name that is taken gets a low line at its end.
pub fn add_names(names: &mut Vec<String>, more: impl IntoIterator<Item = String>) {
    let mut taken: BTreeSet<String> = names.iter().cloned().collect();
    for mut name in more {
        while !taken.insert(name.clone()) {
            name.push('_');
        }
        names.push(name);
    }
}

/// The names of the surfaces of a mesh, from 1 on, as all formats have them.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SurfaceNames {
    /// The names of those that are large enough to have one.
    pub names: Vec<String>,
    /// The kinds of all, also of those without a name.
    pub kinds: Vec<SurfaceKind>,
}

impl SurfaceNames {
    /// Names for surfaces of these kinds, the first `kept` of which are large enough. `own` are the names
    /// that the first have in the mesh's file, and no name is one of `reserved`.
    pub fn new(kinds: &[SurfaceKind], kept: usize, own: &[String], reserved: &[String]) -> Self {
        let mut names = reserved.to_vec();
        let kept = (1..).zip(&kinds[..kept.min(kinds.len())]);
        let called = kept.map(|(number, kind): (usize, &SurfaceKind)| {
            let own = own.get(number - 1).map(|name| name.replace('-', "_"));
            own.unwrap_or_else(|| format!("{}{number}", kind.name()))
        });
        add_names(&mut names, called);
        Self {
            names: names.split_off(reserved.len()),
            kinds: kinds.to_vec(),
        }
    }

    /// The names, for an error.
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

    /// An error for an option, with what it gives, that is for none of the surfaces.
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

    /// Checks that a selector that an option gives picks at least one surface.
    ///
    /// # Errors
    /// [`Error::Flow`] lists the names if it picks none.
    pub fn check(&self, option: &str, selector: &Selector) -> Result<()> {
        if (0..self.kinds.len()).any(|at| selector.selects(self, at)) {
            return Ok(());
        }
        Err(self.no_match_error(
            format!("{option} {selector}"),
            NO_MATCH_PROBLEM,
            NO_MATCH_REMEDY,
        ))
    }
}

/// What picks surfaces.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Selector {
    /// The surface of a number, from 1 on.
    Number(u32),
    /// Surfaces by a pattern of their names, in which `*` stands for any letters and `?` for one letter;
    /// `A/B` stands for `interface_A_B` and `interface_B_A`, and `scraps` for all that is too small to
    /// have a name.
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
    /// The selector that a text is: a number, or a pattern. `None` for an empty one.
    pub fn parse(text: &str) -> Option<Self> {
        let text = text.trim();
        match text.parse() {
            Ok(number) => Some(Self::Number(number)),
            Err(_) => (!text.is_empty()).then(|| Self::Name(text.into())),
        }
    }

    /// Whether it picks the surface at a place among `surfaces`.
    pub fn selects(&self, surfaces: &SurfaceNames, at: usize) -> bool {
        match (self, surfaces.names.get(at)) {
            (Self::Number(number), Some(_)) => *number as usize == at + 1,
            (Self::Number(_), None) => false,
            (Self::Name(_), Some(name)) => self.matches(name),
            (Self::Name(pattern), None) => pattern == "scraps",
        }
    }

    /// Whether it is a pattern that matches a name.
    pub fn matches(&self, name: &str) -> bool {
        let Self::Name(pattern) = self else {
            return false;
        };
        let pattern = pattern.replace('-', "_");
        match pattern.split_once('/') {
            Some((a, b)) => [[a, b], [b, a]]
                .into_iter()
                .any(|pair| matches_glob(&interface_name(pair), name)),
            None => matches_glob(&pattern, name),
        }
    }
}

/// Whether a pattern with `*` and `?` matches a whole text.
fn matches_glob(pattern: &str, text: &str) -> bool {
    let (pattern, text): (Vec<char>, Vec<char>) =
        (pattern.chars().collect(), text.chars().collect());
    // Where the last star was, and how far its letters reach.
    let (mut p, mut t, mut star) = (0, 0, None);
    while t < text.len() {
        if pattern.get(p) == Some(&'*') {
            star = Some((p, t));
            p += 1;
        } else if pattern.get(p).is_some_and(|c| *c == '?' || *c == text[t]) {
            (p, t) = (p + 1, t + 1);
        } else if let Some((at, reached)) = star {
            star = Some((at, reached + 1));
            (p, t) = (at + 1, reached + 1);
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
        for (pattern, name, want) in [
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
            ("-3/4", "interface__3_4", true),
            ("Main-fault", "Main_fault", true),
        ] {
            let selector = Selector::Name(pattern.into());
            assert_eq!(selector.matches(name), want, "{pattern} {name}");
        }
    }

    #[test]
    fn what_picks_nothing_is_an_error_that_lists_the_names() {
        let kinds = [
            SurfaceKind::Interface,
            SurfaceKind::Fault,
            SurfaceKind::Horizon,
            SurfaceKind::Fault,
        ];
        let own = ["interface_1_2".to_string()];
        let names = SurfaceNames::new(&kinds, 3, &own, &["fault2".into()]);
        assert_eq!(names.names, ["interface_1_2", "fault2_", "horizon3"]);
        let parse = |text| Selector::parse(text).unwrap();
        for text in ["1", "3", "2/1", "hor*", "scraps"] {
            names.check("--split", &parse(text)).unwrap();
        }
        for text in ["0", "4", "99", "horizon", "1/3"] {
            let error = names
                .check("--split", &parse(text))
                .unwrap_err()
                .to_string();
            let want = format!(
                "--split {text}: matches no surface: the mesh has interface_1_2, fault2_, horizon3; "
            );
            assert!(error.starts_with(&want), "{error}");
        }
        assert_eq!(Selector::parse(" "), None);
    }
}

//! Names of regions, surfaces, wells and properties, made legal and distinct for a file format.
//!
//! Users and other programs give names of any form; each file format has rules of its own. [`assign`]
//! is the only place that changes a name:
//!
//! 1. A name that is legal and that no other object has stays as it is.
//! 2. Every other name is changed as little as possible: illegal characters become `_`, a letter is
//!    put before a first character that is not allowed there, and what is too long is cut off.
//! 3. If the result is taken, a number is added: `bone_2`.
//!
//! No changed name takes a name that another object legally has, and no default name (`region2`)
//! takes a name that was given. The result does not depend on the order of the objects: of equal names
//! the first by text stays unchanged.
//!
//! Names are distinct as the readers of a format compare them: without case where they ignore it, and in
//! the first characters where they read no more. [`NameTable`] lists what became of each name.

mod table;

use std::collections::{BTreeMap, BTreeSet};

pub use table::{NameEntry, NameTable};

/// The treatment of upper and lower case by the readers of a format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LetterCase {
    /// `Bone` and `bone` are two names.
    Sensitive,
    /// `Bone` and `bone` are one name.
    Insensitive,
    /// Readers convert names to upper case, so they are written in upper case.
    Upper,
}

/// The rules of a file format for names of one kind.
#[derive(Debug, Clone, Copy)]
pub struct NameRules {
    /// Length of the longest name, in bytes.
    pub max_bytes: usize,
    /// Number of bytes in which names differ, because some readers ignore what follows.
    pub distinct_bytes: usize,
    /// Returns `true` if a name may contain a character.
    pub is_allowed: fn(char) -> bool,
    /// Returns `true` if a name may begin with a character.
    pub is_allowed_first: fn(char) -> bool,
    /// The letter before names that may not begin with their first character.
    pub first_letter: char,
    /// The treatment of upper and lower case.
    pub case: LetterCase,
    /// Names that the format or its readers use themselves.
    pub reserved: &'static [&'static str],
}

impl NameRules {
    /// Rules of formats that hold any text of one line.
    pub const TEXT: Self = Self {
        max_bytes: 1 << 12,
        distinct_bytes: 1 << 12,
        is_allowed: is_text,
        is_allowed_first: is_text,
        first_letter: 'n',
        case: LetterCase::Sensitive,
        reserved: &[],
    };

    /// Rules of formats in which a space ends a name.
    pub const UNSPACED: Self = Self {
        is_allowed: is_unspaced,
        is_allowed_first: is_unspaced,
        ..Self::TEXT
    };

    /// Rules for names of letters, digits and `_` that begin with a letter.
    pub const IDENTIFIER: Self = Self {
        is_allowed: is_identifier,
        is_allowed_first: |c| c.is_ascii_alphabetic(),
        ..Self::TEXT
    };

    /// Rules for names of letters, digits, `_` and `-` that begin with a letter.
    pub const HYPHENATED: Self = Self {
        is_allowed: is_hyphenated,
        is_allowed_first: |c| c.is_ascii_alphabetic(),
        ..Self::TEXT
    };

    /// Rules for names that are part of a file's name, on any system.
    pub const FILE: Self = Self {
        max_bytes: 100,
        distinct_bytes: 100,
        is_allowed: is_hyphenated,
        is_allowed_first: is_hyphenated,
        case: LetterCase::Insensitive,
        ..Self::TEXT
    };

    /// Returns the form in which the readers of the format compare a name.
    pub fn folded(&self, name: &str) -> String {
        let name = match self.case {
            LetterCase::Sensitive => name.to_string(),
            LetterCase::Insensitive | LetterCase::Upper => name.to_uppercase(),
        };
        shortened(&name, self.distinct_bytes).to_string()
    }

    /// Returns `true` if the format holds the name as it is.
    pub fn is_legal(&self, name: &str) -> bool {
        self.legal(name) == name
    }

    /// Returns the legal name that is nearest to a name.
    fn legal(&self, name: &str) -> String {
        let replace = |c| if (self.is_allowed)(c) { c } else { '_' };
        let mut name: String = name.trim().chars().map(replace).collect();
        if !name.starts_with(self.is_allowed_first) {
            name.insert(0, self.first_letter);
        }
        if self.case == LetterCase::Upper {
            name.make_ascii_uppercase();
        }
        shortened(&name, self.max_bytes).to_string()
    }

    /// Returns the name with a number at its end.
    fn numbered(&self, name: &str, number: usize) -> String {
        let limit = self.max_bytes.min(self.distinct_bytes);
        let ending = format!("_{number}");
        match limit.checked_sub(ending.len()) {
            Some(length) if length > 0 => format!("{}{ending}", shortened(name, length)),
            _ => format!("{}{number}", self.first_letter),
        }
    }
}

fn is_text(c: char) -> bool {
    !c.is_control()
}

fn is_unspaced(c: char) -> bool {
    !c.is_control() && !c.is_whitespace()
}

/// Returns `true` for letters, digits and `_` of ASCII.
pub fn is_identifier(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_'
}

fn is_hyphenated(c: char) -> bool {
    is_identifier(c) || c == '-'
}

/// Returns the longest start of a text that has at most `limit` bytes and does not end in a space.
fn shortened(text: &str, limit: usize) -> &str {
    if text.len() <= limit {
        return text;
    }
    let end = (0..=limit).rev().find(|&at| text.is_char_boundary(at));
    text[..end.unwrap_or(0)].trim_end()
}

/// The source of a name. Earlier sources keep their names against later ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum NameSource {
    /// The program uses the name in every file, such as `xmin`.
    Program,
    /// The user or a file gave the name.
    Given,
    /// The program made the name for an object without one, such as `region2`.
    Default,
}

/// A name that an object should have.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WantedName {
    /// The name.
    pub name: String,
    /// Its source.
    pub source: NameSource,
}

impl WantedName {
    /// Creates a name that the program uses in every file.
    pub fn program(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            source: NameSource::Program,
        }
    }

    /// Creates a name that the user or a file gave.
    pub fn given(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            source: NameSource::Given,
        }
    }

    /// Creates a name that was given, or the default name if none was given or it is blank.
    pub fn given_or(name: Option<&str>, default: impl FnOnce() -> String) -> Self {
        match name.filter(|name| !name.trim().is_empty()) {
            Some(name) => Self {
                name: name.into(),
                source: NameSource::Given,
            },
            None => Self {
                name: default(),
                source: NameSource::Default,
            },
        }
    }
}

/// Returns the names that objects get in a format: legal, and distinct from one another.
pub fn assign(rules: &NameRules, wanted: &[WantedName]) -> Vec<String> {
    let legal: Vec<String> = wanted.iter().map(|w| rules.legal(&w.name)).collect();
    let is_changed = |at: usize| match rules.case {
        LetterCase::Upper => !legal[at].eq_ignore_ascii_case(&wanted[at].name),
        _ => legal[at] != wanted[at].name,
    };
    let mut order: Vec<usize> = (0..wanted.len()).collect();
    order.sort_by_key(|&at| {
        let WantedName { name, source } = &wanted[at];
        (is_changed(at), *source, name.as_str(), at)
    });
    let reserved = rules.reserved.iter().map(|name| rules.folded(name));
    let mut taken: BTreeSet<String> = reserved.collect();
    let mut names = vec![String::new(); wanted.len()];
    let mut remaining = Vec::new();
    for at in order {
        if taken.insert(rules.folded(&legal[at])) {
            names[at].clone_from(&legal[at]);
        } else {
            remaining.push(at);
        }
    }
    let mut last_numbers: BTreeMap<String, usize> = BTreeMap::new();
    for at in remaining {
        let number = last_numbers.entry(rules.folded(&legal[at])).or_insert(1);
        names[at] = loop {
            *number += 1;
            let name = rules.numbered(&legal[at], *number);
            if taken.insert(rules.folded(&name)) {
                break name;
            }
        };
    }
    names
}

/// Appends names to a list of distinct names and makes them distinct, too.
pub fn append_distinct(names: &mut Vec<String>, new_names: impl IntoIterator<Item = String>) {
    let known = names.iter().cloned().map(WantedName::program);
    let mut wanted: Vec<WantedName> = known.collect();
    wanted.extend((new_names.into_iter()).map(|name| WantedName {
        name,
        source: NameSource::Given,
    }));
    names.extend_from_slice(&assign(&NameRules::TEXT, &wanted)[names.len()..]);
}

/// Returns a name as a file gives it, without spaces around it, quotes and control characters.
pub fn from_file(text: &str) -> String {
    let text = text.trim().replace(char::is_control, " ");
    let unquoted = text
        .strip_prefix('"')
        .and_then(|text| text.strip_suffix('"'));
    unquoted.unwrap_or(&text).trim().to_string()
}

/// Returns the first name that occurs twice.
pub fn first_repeated<'a>(names: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let mut known = BTreeSet::new();
    names.into_iter().find(|name| !known.insert(*name))
}

/// Returns a name as a value of a CSV file, in quotes if it needs them.
pub fn csv_field(name: &str) -> String {
    if name.contains([',', '"', '\n', ';']) {
        format!("\"{}\"", name.replace('"', "\"\""))
    } else {
        name.to_string()
    }
}

#[cfg(test)]
mod tests;
